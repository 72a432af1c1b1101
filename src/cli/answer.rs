//! What a command answers on stdout: one JSON object, or the text that it makes for people.

use std::io::Write as _;

use serde::Serialize;

use super::CliError;

/// Puts a report on stdout as JSON, or what `text` makes of it.
///
/// # Errors
/// No result where stdout cannot be written.
pub fn put(
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
