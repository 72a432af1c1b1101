//! `--max-seconds`, `--tracer-error` and `--tolerance` of fits.

use anyhow::anyhow;

use super::{check, check_tolerance};
use crate::cli::CliError;

/// Limits of a fit.
#[derive(Debug, Clone, Copy, Default, PartialEq, clap::Args)]
pub struct FitLimits {
    /// Time limit of the fit. The search for other minima, the ray tracer and the bootstrap stop there; their results so far
    /// are used.
    #[arg(long, value_name = "S")]
    pub max_seconds: Option<f64>,
    /// Stop the ray tracer once its standard error, as a share of the largest radiance, is below this. Default: once
    /// its line of the budget is small.
    #[arg(long = "tracer-error", alias = "target-error", value_name = "E")]
    pub target_error: Option<f64>,
    /// Largest share of the brightest observation that the model may neglect to save time: the integrated second bounce
    /// is left out if it changes less. `left_out` lists what was neglected.
    #[arg(long, value_name = "E")]
    pub tolerance: Option<f64>,
}

impl FitLimits {
    /// Refuses limits that are not greater than 0, and an error for the ray tracer where it does not run.
    ///
    /// # Errors
    /// Bad input, naming the option and the remedy.
    pub fn check(&self, traces: bool) -> Result<(), CliError> {
        if self.target_error.is_some() && !traces {
            return Err(CliError::bad_input(anyhow!(
                "--tracer-error applies only to the ray tracer; add --variant traced or --check-traced"
            )));
        }
        check_tolerance(self.tolerance)?;
        check(&[
            ("--max-seconds", self.max_seconds),
            ("--tracer-error", self.target_error),
        ])
    }
}
