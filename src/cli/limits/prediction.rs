//! `--max-seconds` and `--quadrature-error` of tables that are predicted in closed form or by quadrature.

use std::io::IsTerminal as _;
use std::time::Instant;

use anyhow::anyhow;

use super::check;
use crate::cli::CliError;
use crate::cli::prediction::Model;
use crate::forecast::Forecast;
use crate::model::contrast::{Pace, TOLERANCE};

/// Limits of a prediction.
#[derive(Debug, Clone, Copy, Default, PartialEq, clap::Args)]
pub struct PredictionLimits {
    /// Time limit: no further surface is begun after it; `left_out` lists those not reached.
    #[arg(long, value_name = "S")]
    pub max_seconds: Option<f64>,
    /// Error to which the quadrature integrates, as a share of a surface's brightest radiance.
    #[arg(long = "quadrature-error", alias = "target-error", value_name = "E")]
    pub target_error: Option<f64>,
}

impl PredictionLimits {
    /// Refuses limits that are not greater than 0, and a target error for a closed form.
    ///
    /// # Errors
    /// Bad input, naming the option.
    pub fn check(&self, variant: Model) -> Result<(), CliError> {
        check(&[
            ("--max-seconds", self.max_seconds),
            ("--quadrature-error", self.target_error),
        ])?;
        if self.target_error.is_some() && variant != Model::Quadrature {
            return Err(CliError::bad_input(anyhow!(
                "--quadrature-error applies only to the quadrature; add --variant quadrature"
            )));
        }
        Ok(())
    }

    /// Returns the tolerance of the quadrature, and `go_on` as its condition to continue.
    #[must_use]
    pub fn pace<'a>(&self, go_on: &'a (dyn Fn() -> bool + Sync)) -> Pace<'a> {
        Pace {
            tolerance: self.target_error.unwrap_or(TOLERANCE),
            go_on,
        }
    }

    /// Prints the expected time of `tables` tables like the pilot's to stderr, where a limit is set, or on a terminal where it
    /// is more than a second.
    pub fn print_forecast(&self, tables: u64, pilot: impl FnOnce()) {
        let started = Instant::now();
        pilot();
        let each_s = started.elapsed().as_secs_f64();
        let forecast = Forecast {
            error: None,
            ..Forecast::about(tables as f64 * each_s).for_work(tables, "tables")
        };
        let forecast = forecast
            .to_error(self.target_error, "a radiance, of the brightest,")
            .within(self.max_seconds);
        let asked = *self != PredictionLimits::default();
        if asked || (forecast.seconds > 1.0 && std::io::stderr().is_terminal()) {
            super::super::say(&format_args!("forecast: {forecast}"));
        }
    }
}
