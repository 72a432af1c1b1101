//! `--max-seconds` and `--tolerance` of maps.

use super::{check, check_tolerance};
use crate::cli::CliError;

/// Limits of a map.
#[derive(Debug, Clone, Copy, Default, PartialEq, clap::Args)]
pub struct MapLimits {
    /// Time limit: no further pixels are begun after it. Pixels not reached have no value and are counted.
    #[arg(long, value_name = "S")]
    pub max_seconds: Option<f64>,
    /// Largest share of the brightest radiance that may be neglected. Decides whether double reflections are integrated
    /// and whether each pixel gets its own directions. Default: neglect nothing. `ridged explain DIR --map` shows the
    /// decisions.
    #[arg(long = "tolerance", alias = "target-error", value_name = "E")]
    pub target_error: Option<f64>,
}

impl MapLimits {
    /// Refuses a time that is not greater than 0, and an error that is not a share.
    ///
    /// # Errors
    /// Bad input, naming the option.
    pub fn check(&self) -> Result<(), CliError> {
        check(&[("--max-seconds", self.max_seconds)])?;
        check_tolerance(self.target_error)
    }

    /// Whether any limit is set.
    #[must_use]
    pub fn is_any(&self) -> bool {
        self.max_seconds.is_some() || self.target_error.is_some()
    }
}
