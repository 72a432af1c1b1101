//! The fit of a goniometer's table of BRDF.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use anyhow::anyhow;

use super::{print, refusal, suits, with_bar};
use crate::analysis::{AnalysisOptions, analyse_observations};
use crate::cli::CliError;
use crate::cli::output::ResultArgs;
use crate::fit::{Constraint, Quantity};
use crate::tables::BrdfTable;

/// Reads the table, fits it and prints the result.
///
/// # Errors
/// Bad input for a folder without such a table, a region, or constraints that do not suit the sample.
pub(super) fn run(
    dir: &Path,
    mut options: AnalysisOptions,
    printed: ResultArgs,
    cancel: &AtomicBool,
) -> Result<(), CliError> {
    let table = BrdfTable::open(dir).map_err(CliError::bad_input)?;
    if options.region.is_some() {
        return Err(CliError::bad_input(anyhow!(
            "--region: a table of BRDF has one surface and no regions"
        )));
    }
    let constraints = &mut options.fit.constraints;
    if constraints
        .iter()
        .any(|constraint| constraint.quantity == Quantity::TiltOffset)
    {
        return Err(CliError::bad_input(anyhow!(
            "tilt_offset_deg: a goniometer has no tilt that lamp and detector share; state the errors of its angles and of \
            the sample as theta_std_deg and sample_tilt_std_deg in the manifest"
        )));
    }
    constraints.push(Constraint {
        quantity: Quantity::TiltOffset,
        value: 0.0,
        std: 0.0,
    });
    suits(constraints, &table.material)?;
    let fitted = |observations| {
        let run = with_bar(None, |progress| {
            analyse_observations(observations, &options, progress, cancel)
        });
        run.map_err(refusal)
    };
    let mut analysis = fitted(table.observations())?;
    let values: Vec<f64> = analysis.report.fitted.iter().map(|o| o.fitted).collect();
    if let Some(weighed) = table.weighed_by(&analysis.observations, &values) {
        analysis = fitted(weighed)?;
    }
    print(&analysis, printed)
}
