//! `ridged check`: stiff and extreme cases, expected and found.

use std::io::{IsTerminal, Write};

use anyhow::anyhow;
use serde::Serialize;

use super::{CliError, interrupt};
use crate::check::{self, Effort, Row};

/// Computes stiff and extreme cases and compares them with what is known.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  ridged check --json | jq '.rows[] | select(.as_expected | not)'\n\nExit code 1 if a row is not as expected."
)]
pub struct Args {
    /// Leave out the fit of a million observations and most photons.
    #[arg(long)]
    pub quick: bool,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct Report<'a> {
    rows: &'a [Row],
    as_expected: usize,
    not_as_expected: usize,
    program: String,
}

/// Runs the command.
///
/// # Errors
/// No result where a row is not as expected or stdout cannot be written; interrupted after Ctrl-C.
pub fn run(args: Args) -> Result<(), CliError> {
    let cancel = interrupt::flag()?;
    let effort = if args.quick {
        Effort::Quick
    } else {
        Effort::Full
    };
    let terminal = std::io::stderr().is_terminal();
    let rows = check::run(effort, &cancel, &mut |name, done, of| {
        if terminal {
            eprintln!("{} of {of}: {name}", done + 1);
        }
    });
    if cancel.load(std::sync::atomic::Ordering::Relaxed) {
        return Err(CliError::Interrupted);
    }
    let failed = rows.iter().filter(|r| !r.judged.as_expected).count();
    let report = Report {
        as_expected: rows.len() - failed,
        not_as_expected: failed,
        rows: &rows,
        program: format!("ridged {}", env!("CARGO_PKG_VERSION")),
    };
    print(&report, args.json).map_err(CliError::no_result)?;
    if failed > 0 {
        return Err(CliError::no_result(anyhow!(
            "{failed} of {} rows are not as expected",
            rows.len()
        )));
    }
    Ok(())
}

fn print(report: &Report<'_>, json: bool) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    if json {
        serde_json::to_writer_pretty(&mut out, report)?;
        return writeln!(out);
    }
    let mut area = "";
    for row in report.rows {
        if row.area != area {
            area = row.area;
            writeln!(out, "\n{area}")?;
        }
        let verdict = if row.judged.as_expected { "ok " } else { "NOT" };
        write!(out, "  {verdict} {}: {}", row.case, row.quantity)?;
        write!(
            out,
            "\n        expected {} ({})",
            row.judged.expected, row.source
        )?;
        if let Some(allowed) = row.judged.allowed {
            write!(out, " ± {allowed:.1e}")?;
        }
        writeln!(out, "\n        found    {}", row.judged.found)?;
    }
    let all = report.rows.len();
    writeln!(
        out,
        "\n{} of {all} rows are as expected",
        report.as_expected
    )
}
