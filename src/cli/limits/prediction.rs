//! `--max-seconds` and `--target-error` of tables that are predicted in closed form or by quadrature.

use std::io::IsTerminal as _;
use std::time::Instant;

use anyhow::anyhow;

use super::check;
use crate::cli::CliError;
use crate::cli::prediction::Model;
use crate::forecast::Forecast;
use crate::model::contrast::{Pace, TOLERANCE};

/// What a prediction may take, and how wrong the quadrature may be.
#[derive(Debug, Clone, Copy, Default, PartialEq, clap::Args)]
pub struct PredictionLimits {
    /// Time limit: no further surface is begun after it; `left_out` lists those not reached.
    #[arg(long, value_name = "S")]
    pub max_seconds: Option<f64>,
    /// Error to which the quadrature integrates, as a share of a surface's brightest radiance.
    #[arg(long, value_name = "E")]
    pub target_error: Option<f64>,
}

impl PredictionLimits {
    /// Refuses limits that are not greater than 0, and an error of a form that has none to choose.
    ///
    /// # Errors
    /// Bad input, naming the option.
    pub fn check(&self, variant: Model) -> Result<(), CliError> {
        check(&[
            ("--max-seconds", self.max_seconds),
            ("--target-error", self.target_error),
        ])?;
        if self.target_error.is_some() && variant != Model::Quadrature {
            return Err(CliError::bad_input(anyhow!(
                "--target-error is for the integral, closed forms have the error that they have: add --variant quadrature"
            )));
        }
        Ok(())
    }

    /// To the error that the quadrature is asked for, as long as `go_on` says.
    #[must_use]
    pub fn pace<'a>(&self, go_on: &'a (dyn Fn() -> bool + Sync)) -> Pace<'a> {
        Pace {
            tolerance: self.target_error.unwrap_or(TOLERANCE),
            go_on,
        }
    }

    /// Says on stderr what `tables` of tables like a pilot's will take, where a limit is set or it is more than a
    /// second and a terminal is there to tell it to.
    pub fn foretell(&self, tables: u64, pilot: impl FnOnce()) {
        let started = Instant::now();
        pilot();
        let each_s = started.elapsed().as_secs_f64();
        let told = Forecast {
            error: None,
            ..Forecast::about(tables as f64 * each_s).for_work(tables, "tables")
        };
        let told = told
            .to_error(self.target_error, "a radiance, of the brightest,")
            .within(self.max_seconds);
        let asked = *self != PredictionLimits::default();
        if asked || (told.seconds > 1.0 && std::io::stderr().is_terminal()) {
            super::super::say(&format_args!("forecast: {told}"));
        }
    }
}
