//! `ridged check`: stiff and extreme cases, expected and actual results.

use std::collections::BTreeMap;
use std::io::IsTerminal as _;
use std::time::Instant;

use anyhow::anyhow;
use serde::Serialize;

use super::{CliError, interrupt, output};
use crate::check::{self, CheckEffort, CheckRow};
use crate::model::LeftOut;

/// Computes stiff and extreme cases and compares them with known results.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Example:\n  ridged check --json | jq '.rows[] | select(.as_expected | not)'\n\nExit code 1 if a row is not as expected."
)]
pub struct Args {
    /// Skip the fit of a million observations and most of the photons.
    #[arg(long)]
    pub quick: bool,
    /// Show every row with its expected and actual result, not only the rows that differ.
    #[arg(long)]
    pub all: bool,
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
}

#[derive(Serialize)]
struct Report<'a> {
    rows: &'a [CheckRow],
    as_expected: usize,
    not_as_expected: usize,
    /// Largest deviation of a result, as a share of the allowed deviation.
    largest_share_of_allowed: Option<f64>,
    /// Seconds per part.
    timing_s: BTreeMap<String, f64>,
    left_out: Vec<LeftOut>,
    program: String,
}

/// Runs the command.
///
/// # Errors
/// No result where a row is not as expected or stdout cannot be written; interrupted after Ctrl-C.
pub fn run(args: Args) -> Result<(), CliError> {
    let cancel = interrupt::flag()?;
    let effort = if args.quick {
        CheckEffort::Quick
    } else {
        CheckEffort::Full
    };
    let terminal = std::io::stderr().is_terminal();
    let mut begun: Vec<(String, Instant)> = Vec::new();
    let rows = check::run(effort, &cancel, &mut |name, done, of| {
        begun.push((name.to_owned(), Instant::now()));
        if terminal {
            super::say(&format_args!("{} of {of}: {name}", done + 1));
        }
    });
    let ends = begun.iter().skip(1).map(|(_, at)| *at);
    let timing_s = begun
        .iter()
        .zip(ends.chain([Instant::now()]))
        .map(|((name, at), end)| (name.clone(), (end - *at).as_secs_f64()))
        .collect();
    if cancel.load(std::sync::atomic::Ordering::Relaxed) {
        return Err(CliError::Interrupted);
    }
    let failed = rows.iter().filter(|r| !r.judged.as_expected).count();
    let report = Report {
        as_expected: rows.len() - failed,
        not_as_expected: failed,
        largest_share_of_allowed: rows
            .iter()
            .filter_map(|r| r.judged.share())
            .reduce(|a, b| if b <= a { a } else { b }),
        timing_s,
        left_out: check::left_out(effort),
        rows: &rows,
        program: format!("ridged {}", env!("CARGO_PKG_VERSION")),
    };
    output::write(args.json, &report, || text(&report, args.all))?;
    if failed > 0 {
        return Err(CliError::no_result(anyhow!(
            "{failed} of {} rows are not as expected",
            rows.len()
        )));
    }
    Ok(())
}

fn text(report: &Report<'_>, all: bool) -> String {
    let mut text = String::new();
    for of_area in report.rows.chunk_by(|a, b| a.area == b.area) {
        let fine = of_area.iter().filter(|row| row.judged.as_expected).count();
        text.push_str(&format!(
            "{}: {fine} of {} as expected\n",
            of_area[0].area,
            of_area.len()
        ));
        for row in of_area.iter().filter(|row| all || !row.judged.as_expected) {
            text.push_str(&shown(row));
        }
    }
    let seconds: f64 = report.timing_s.values().sum();
    text.push_str(&format!(
        "\n{} of {} rows are as expected ({seconds:.1} s)\n",
        report.as_expected,
        report.rows.len()
    ));
    for left in &report.left_out {
        text.push_str(&format!("left out: {} ({})\n", left.what, left.why));
    }
    text
}

fn shown(row: &CheckRow) -> String {
    let judged = &row.judged;
    let verdict = if judged.as_expected { "ok " } else { "NOT" };
    let allowed = judged
        .allowed
        .map_or_else(String::new, |allowed| format!(" ± {allowed:.1e}"));
    format!(
        "  {verdict} {}: {}\n        expected {} ({}){allowed}\n        found    {}\n",
        row.case, row.quantity, judged.expected, row.source, judged.found
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_report_states_error_cost_and_what_it_left_out() {
        let report = Report {
            rows: &[],
            as_expected: 0,
            not_as_expected: 0,
            largest_share_of_allowed: Some(0.5),
            timing_s: BTreeMap::from([("fits".to_owned(), 2.0)]),
            left_out: check::left_out(CheckEffort::Quick),
            program: String::new(),
        };
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!(json["largest_share_of_allowed"], 0.5);
        assert_eq!(json["timing_s"]["fits"], 2.0);
        let left_out = json["left_out"].as_array().unwrap();
        assert!(
            left_out
                .iter()
                .all(|l| l["what"].is_string() && l["why"].is_string())
        );
        assert!(!left_out.is_empty() && check::left_out(CheckEffort::Full).is_empty());
    }
}
