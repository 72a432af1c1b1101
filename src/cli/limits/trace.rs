//! `--max-seconds`, `--target-error` and `--tolerance` of the ray tracer: one run of a scene, or several.

use super::{check, check_tolerance};
use crate::cli::CliError;

/// Limits of one run of a scene.
#[derive(Debug, Clone, Copy, Default, PartialEq, clap::Args)]
pub struct TraceLimits {
    /// Stop after this time. The result covers the photons traced until then.
    #[arg(long, value_name = "S")]
    pub max_seconds: Option<f64>,
    /// Stop once the relative error of the reflected bins (root mean square) is below this.
    #[arg(long, value_name = "E")]
    pub target_error: Option<f64>,
    /// Leave out effects that change the reflected energy by at most this share (`ridged explain` lists them). Default:
    /// effects below the run's own standard error.
    #[arg(long, value_name = "E")]
    pub tolerance: Option<f64>,
}

impl TraceLimits {
    /// Refuses limits that are not greater than 0, and a tolerance that is not a share.
    ///
    /// # Errors
    /// Bad input, naming the option.
    pub fn check(&self) -> Result<(), CliError> {
        check(&[
            ("--max-seconds", self.max_seconds),
            ("--target-error", self.target_error),
        ])?;
        check_tolerance(self.tolerance)
    }

    /// Whether the time or the error of the run is limited.
    #[must_use]
    pub fn is_any(&self) -> bool {
        self.max_seconds.is_some() || self.target_error.is_some()
    }
}

/// Limits of several runs, one per angle or wavelength.
#[derive(Debug, Clone, Copy, Default, PartialEq, clap::Args)]
pub struct RunLimits {
    /// Time limit of all runs together (approximate). The remaining runs share the remaining time; the result of a run
    /// covers the photons traced until then.
    #[arg(long, value_name = "S")]
    pub max_seconds: Option<f64>,
    /// End each run once the relative error of its reflected bins (root mean square) is below this.
    #[arg(long, value_name = "E")]
    pub target_error: Option<f64>,
}

impl RunLimits {
    /// Refuses limits that are not greater than 0.
    ///
    /// # Errors
    /// Bad input, naming the option.
    pub fn check(&self) -> Result<(), CliError> {
        check(&[
            ("--max-seconds", self.max_seconds),
            ("--target-error", self.target_error),
        ])
    }

    /// Whether any limit is set.
    #[must_use]
    pub fn is_any(&self) -> bool {
        self.max_seconds.is_some() || self.target_error.is_some()
    }

    /// Whether a run with this relative error has reached the target.
    #[must_use]
    pub fn is_reached(&self, error: Option<f64>) -> bool {
        matches!((self.target_error, error), (Some(target), Some(error)) if error <= target)
    }
}
