//! The output of a command on stdout: one JSON object, or text.

use std::io::{IsTerminal as _, Write as _};

use serde::Serialize;

use super::{CliError, terminal};
use crate::fit::report::text::Form;
use crate::wording::layout::{tables, wrapped};

/// How the result of a fit is printed.
#[derive(Debug, Clone, Copy, clap::Args)]
pub struct ResultArgs {
    /// One JSON object on stdout instead of a table.
    #[arg(long)]
    pub json: bool,
    /// Only the parameters, without what they are based on.
    #[arg(long, conflicts_with = "json")]
    pub brief: bool,
}

/// Returns how results are printed on stdout.
pub fn form(brief: bool) -> Form {
    Form {
        colour: std::io::stdout().is_terminal(),
        columns: terminal::columns().unwrap_or(Form::PLAIN.columns),
        brief,
    }
}

/// Writes a report to stdout as JSON, or as the text that `text` returns, in lines that fit the terminal.
///
/// # Errors
/// No result where stdout cannot be written.
pub fn write(
    json: bool,
    report: &impl Serialize,
    text: impl FnOnce() -> String,
) -> Result<(), CliError> {
    let text = if json {
        let mut text = serde_json::to_string_pretty(report).map_err(CliError::no_result)?;
        text.push('\n');
        text
    } else {
        in_columns(&text())
    };
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .map_err(CliError::no_result)
}

/// Columns of a table in a file or for another program: as many as it needs.
const ALL_COLUMNS: usize = 1 << 16;

/// Lays out a text for the width of the terminal. Files and other programs get lines of any length.
pub fn in_columns(text: &str) -> String {
    match terminal::columns() {
        Some(columns) => wrapped(&tables(text, columns), columns),
        None => tables(text, ALL_COLUMNS),
    }
}
