//! A measured profile across the ridges, from a CSV file of positions and heights in µm.

use std::path::Path;

use anyhow::Context;

use crate::cli::{CliError, heights};
use crate::trace::profile::Profile;

/// Reads a profile.
///
/// # Errors
/// Bad input for a file that cannot be read or is no closed profile of ridges.
pub(super) fn read(path: &Path) -> Result<Profile, CliError> {
    let name = path.display().to_string();
    let content = std::fs::read(path)
        .with_context(|| format!("cannot read {name}"))
        .map_err(CliError::bad_input)?;
    heights::read(&name, &content)
        .map_err(anyhow::Error::msg)
        .and_then(|map| map.profile().map_err(anyhow::Error::from))
        .with_context(|| name)
        .map_err(CliError::bad_input)
}
