//! `--max-seconds`, `--target-error` and `--tolerance` of fits.

use anyhow::anyhow;

use super::{check, check_tolerance};
use crate::cli::CliError;

/// What a fit may take, and how wrong it may be.
#[derive(Debug, Clone, Copy, Default, PartialEq, clap::Args)]
pub struct FitLimits {
    /// Time limit of the fit: the search for other explanations, the ray tracer and the bootstrap end there, and what
    /// they have reached counts.
    #[arg(long, value_name = "S")]
    pub max_seconds: Option<f64>,
    /// Stop the ray tracer once its standard error, as a share of the largest radiance, is below this. Default: once
    /// its line of the budget is small.
    #[arg(long, value_name = "E")]
    pub target_error: Option<f64>,
    /// Largest share of the brightest observation that the model may neglect to save time: the integrated second bounce
    /// is left out if it changes less. `left_out` lists what was neglected.
    #[arg(long, value_name = "E")]
    pub tolerance: Option<f64>,
}

impl FitLimits {
    /// Refuses limits that are not greater than 0, and such as nothing is there to obey.
    ///
    /// # Errors
    /// Bad input, naming the option and what would give it a meaning.
    pub fn check(&self, traces: bool) -> Result<(), CliError> {
        if self.target_error.is_some() && !traces {
            return Err(CliError::bad_input(anyhow!(
                "--target-error is for the ray tracer, the closed forms have no error by chance: add --variant traced, \
                 or --judge where there is one"
            )));
        }
        check_tolerance(self.tolerance)?;
        check(&[
            ("--max-seconds", self.max_seconds),
            ("--target-error", self.target_error),
        ])
    }
}
