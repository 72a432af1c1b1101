//! Limits of time and error that a user sets: the options of all commands, one wording of refusals, one [`Stopwatch`].
//!
//! [`PredictionLimits`] bound tables of closed forms and quadratures, [`PathLimits`] surfaces traced with many paths
//! each, [`TraceLimits`] and [`RunLimits`] scenes, [`FitLimits`] fits and [`MapLimits`] maps. The command reports what a
//! limit left out.

mod fit;
mod map;
mod paths;
mod prediction;
mod trace;

use std::time::Instant;

use anyhow::anyhow;

use super::CliError;

pub use fit::FitLimits;
pub use map::MapLimits;
pub use paths::{PATHS, PathLimits, PathWork, PilotResult, check_paths};
pub use prediction::PredictionLimits;
pub use trace::{RunLimits, TraceLimits};

/// Refuses limits that are not greater than 0; a limit that is not set passes.
///
/// # Errors
/// Bad input, naming the option.
pub fn check(limits: &[(&str, Option<f64>)]) -> Result<(), CliError> {
    for (name, limit) in limits {
        if limit.is_some_and(|x| !(x > 0.0 && x.is_finite())) {
            return Err(CliError::bad_input(anyhow!(
                "{name} must be greater than 0"
            )));
        }
    }
    Ok(())
}

/// Refuses a tolerance that is not a share.
///
/// # Errors
/// Bad input, naming the option.
pub fn check_tolerance(tolerance: Option<f64>) -> Result<(), CliError> {
    check_share("--tolerance", tolerance)
}

/// Refuses the value of an option that is not a share between 0 and 1.
///
/// # Errors
/// Bad input, naming the option.
pub fn check_share(name: &str, share: Option<f64>) -> Result<(), CliError> {
    if share.is_some_and(|x| !(x > 0.0 && x < 1.0)) {
        return Err(CliError::bad_input(anyhow!(
            "{name} must be between 0 and 1 (0.01 is one per cent)"
        )));
    }
    Ok(())
}

/// The time of a calculation that may have to end early.
#[derive(Debug, Clone, Copy)]
pub struct Stopwatch {
    started: Instant,
    max_seconds: Option<f64>,
}

impl Stopwatch {
    /// Starts now; without `max_seconds` it is never late.
    #[must_use]
    pub fn start(max_seconds: Option<f64>) -> Self {
        Stopwatch {
            started: Instant::now(),
            max_seconds,
        }
    }

    /// Seconds since the start.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }

    /// Whether the time limit has passed.
    #[must_use]
    pub fn is_late(&self) -> bool {
        self.max_seconds
            .is_some_and(|limit| self.seconds() >= limit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_that_is_not_greater_than_0_is_refused_by_name() {
        let refusal =
            |limit| match check(&[("--target-error", None), ("--max-seconds", Some(limit))]) {
                Err(CliError::BadInput(error)) => Some(error.to_string()),
                other => {
                    assert!(other.is_ok());
                    None
                }
            };
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let text = refusal(bad).expect("it is refused");
            assert_eq!(text, "--max-seconds must be greater than 0");
        }
        assert_eq!(refusal(1e-9), None);
    }

    #[test]
    fn a_tolerance_is_a_share() {
        for bad in [0.0, -1.0, 1.0, 5.0, f64::NAN] {
            assert!(
                matches!(check_tolerance(Some(bad)), Err(CliError::BadInput(_))),
                "{bad}"
            );
        }
        assert!(check_tolerance(Some(0.5)).is_ok() && check_tolerance(None).is_ok());
    }

    #[test]
    fn only_a_limit_makes_it_late() {
        assert!(!Stopwatch::start(None).is_late());
        assert!(!Stopwatch::start(Some(1e9)).is_late());
        assert!(Stopwatch::start(Some(0.0)).is_late());
    }
}
