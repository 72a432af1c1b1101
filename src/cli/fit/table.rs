//! The fit of a goniometer's table of BRDF.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use anyhow::anyhow;

use super::{print, refusal, suits, with_bar};
use crate::analysis::{AnalysisOptions, analyse_observations};
use crate::cli::CliError;
use crate::fit::{Quantity, Told};
use crate::tables::BrdfTable;

/// Reads, fits and prints.
///
/// # Errors
/// Bad input for a folder that holds no such table, a region, or statements that do not suit the sample.
pub(super) fn run(
    dir: &Path,
    mut options: AnalysisOptions,
    json: bool,
    cancel: &AtomicBool,
) -> Result<(), CliError> {
    let table = BrdfTable::open(dir).map_err(CliError::bad_input)?;
    if options.region.is_some() {
        return Err(CliError::bad_input(anyhow!(
            "--region: a table of BRDF is of one surface and has no regions"
        )));
    }
    let told = &mut options.fit.told;
    if told
        .iter()
        .any(|told| told.quantity == Quantity::TiltOffset)
    {
        return Err(CliError::bad_input(anyhow!(
            "tilt_offset_deg: a goniometer has no tilt that lamp and detector share; how its angles and the sample err is \
             theta_std_deg and sample_tilt_std_deg of the manifest"
        )));
    }
    told.push(Told {
        quantity: Quantity::TiltOffset,
        value: 0.0,
        std: 0.0,
    });
    suits(told, &table.material)?;
    let observations = table.observations();
    let analysis = with_bar(None, |progress| {
        analyse_observations(observations, &options, progress, cancel)
    })
    .map_err(refusal)?;
    print(&analysis, json)
}
