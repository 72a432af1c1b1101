//! The fit of a goniometer's table of BRDF.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::anyhow;

use super::{print, refusal, suits, with_bar};
use crate::analysis::{Analysis, AnalysisOptions, analyse_observations};
use crate::cli::CliError;
use crate::cli::output::ResultArgs;
use crate::fit::{Constraint, FitOptions, Quantity, VariantChoice};
use crate::observation::ObservationSet;
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
    let began = Instant::now();
    let mut observations = table.observations();
    if table.is_noisy() {
        let first = fitted(observations, &for_weights(&options), cancel)?;
        let signals: Vec<f64> = first.report.fitted.iter().map(|o| o.fitted).collect();
        observations = table.weighed_by(first.observations, &signals);
        let left = |limit: f64| (limit - began.elapsed().as_secs_f64()).max(0.0);
        options.max_seconds = options.max_seconds.map(left);
    }
    print(&fitted(observations, &options, cancel)?, printed)
}

fn fitted(
    observations: ObservationSet,
    options: &AnalysisOptions,
    cancel: &AtomicBool,
) -> Result<Analysis, CliError> {
    let run = with_bar(None, |progress| {
        analyse_observations(observations, options, progress, cancel)
    });
    run.map_err(refusal)
}

/// The options of the fit that only gives the weights: the closed form, without intervals.
fn for_weights(options: &AnalysisOptions) -> AnalysisOptions {
    AnalysisOptions {
        fit: FitOptions {
            variant: VariantChoice::Sawtooth,
            profile: false,
            bootstrap: 0,
            judge: false,
            ..options.fit.clone()
        },
        max_seconds: options.max_seconds,
        ..AnalysisOptions::default()
    }
}
