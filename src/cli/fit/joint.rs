//! Several series of one sample: one surface, each scan's own offsets.

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use anyhow::anyhow;

use super::{refusal, with_bar};
use crate::analysis::{AnalysisOptions, JointAnalysisError, analyse_together};
use crate::cli::output::ResultArgs;
use crate::cli::{CliError, output};
use crate::fit::joint::JointError;
use crate::fit::report::text;
use crate::reduction::FrameSource;
use crate::series::Series;

/// Reads, reduces and fits the series together and prints the result.
///
/// # Errors
/// Bad input for a folder that is not a series, or series that are not of one sample; no result where no frame can be
/// used.
pub(super) fn run(
    dirs: &[PathBuf],
    options: &AnalysisOptions,
    printed: ResultArgs,
    cancel: &AtomicBool,
) -> Result<(), CliError> {
    if options.iterations {
        return Err(CliError::bad_input(anyhow!(
            "--iterations records the fit of one series; {} were given",
            dirs.len()
        )));
    }
    let opened = dirs
        .iter()
        .map(|dir| Series::open_own(dir))
        .collect::<Result<Vec<_>, _>>();
    let opened = opened.map_err(CliError::bad_input)?;
    no_twins(dirs, &opened)?;
    for series in &opened {
        super::suits(&options.fit.constraints, &series.manifest().material())?;
    }
    let names: Vec<String> = dirs.iter().map(|d| d.display().to_string()).collect();
    let sources: Vec<(&str, &dyn FrameSource)> = names
        .iter()
        .zip(&opened)
        .map(|(name, series)| (name.as_str(), series as &dyn FrameSource))
        .collect();
    let analysis = with_bar(None, |progress| {
        analyse_together(&sources, options, progress, cancel)
    });
    let analysis = analysis.map_err(|error| match error {
        JointAnalysisError::Scan(reason) => refusal(reason),
        JointAnalysisError::Joint(reason @ JointError::NoFit(..)) => CliError::no_result(reason),
        JointAnalysisError::Joint(reason) => CliError::bad_input(reason),
    })?;
    output::write(printed.json, &analysis.report, || {
        text::joint(&analysis.report, &output::form(printed.brief))
    })
}

/// Refuses a scan that is given twice, under any name: counted twice it would make the uncertainty too small.
fn no_twins(dirs: &[PathBuf], opened: &[Series]) -> Result<(), CliError> {
    for (k, later) in opened.iter().enumerate() {
        let same = |earlier: &Series| {
            earlier.manifest() == later.manifest() && earlier.rows() == later.rows()
        };
        if let Some(first) = opened[..k].iter().position(same) {
            return Err(CliError::bad_input(anyhow!(
                "{} and {} are the same scan (same manifest, same list of frames): give it once",
                dirs[first].display(),
                dirs[k].display()
            )));
        }
    }
    Ok(())
}
