//! The output of a command on stdout: one JSON object, or text.

use std::io::Write as _;

use serde::Serialize;

use super::CliError;

/// Writes a report to stdout as JSON, or as the text that `text` returns.
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
        text()
    };
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes())
        .and_then(|()| out.flush())
        .map_err(CliError::no_result)
}
