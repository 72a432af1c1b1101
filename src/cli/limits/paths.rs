//! `--max-seconds` and `--target-error` of work that is many surfaces of so many paths each: a small and a larger
//! pilot part what a surface costs from what a path costs, and say how many paths are affordable and enough.

use std::time::Instant;

use anyhow::anyhow;

use super::check;
use crate::cli::CliError;
use crate::forecast::Forecast;
use crate::wording::{counted, significant};

/// What a user allows.
#[derive(Debug, Clone, Copy, Default, PartialEq, clap::Args)]
pub struct PathLimits {
    /// Take no longer than about this: fewer paths are traced if need be, and how many is told.
    #[arg(long, value_name = "S")]
    pub max_seconds: Option<f64>,
    /// Trace as many paths as bring the tracer's relative standard error below this, instead of --paths.
    #[arg(long, value_name = "E")]
    pub target_error: Option<f64>,
}

/// How a run will go, told before it starts.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// Paths per radiance.
    pub paths: u64,
    /// What that takes.
    pub forecast: Forecast,
}

/// Paths of the two pilots.
const PILOTS: [u64; 2] = [64, 512];
/// A pilot's forecast may be off by so much: a limit that is missed by less is tried.
const MISS: f64 = 1.3;
/// Fewest and most paths of a run.
const PATHS: (u64, u64) = (64, 10_000_000);

impl PathLimits {
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

    /// Whether there is anything to plan.
    #[must_use]
    pub fn is_any(&self) -> bool {
        self.max_seconds.is_some() || self.target_error.is_some()
    }

    /// Plans a run of `surfaces` at `wanted` paths each, of which `abreast` run at the same time. `pilot` does
    /// one of them with a number of paths and returns its relative standard error; `None` where it cannot.
    ///
    /// # Errors
    /// No result where not even the fewest paths fit into the time allowed.
    pub fn plan(
        &self,
        surfaces: usize,
        abreast: usize,
        wanted: u64,
        pilot: &dyn Fn(u64) -> Option<f64>,
    ) -> Result<Option<Planned>, CliError> {
        let started = Instant::now();
        let timed = |paths: u64| {
            let started = Instant::now();
            let error = pilot(paths)?;
            Some((started.elapsed().as_secs_f64(), error))
        };
        let turns = surfaces.div_ceil(abreast.max(1));
        let Some((little, _)) = timed(PILOTS[0]) else {
            return Ok(None);
        };
        self.affords(surfaces, little * turns as f64)?;
        let Some((more, error)) = timed(PILOTS[1]) else {
            return Ok(None);
        };
        let spent = started.elapsed().as_secs_f64();
        Ok(Some(self.told_by(
            [little, more],
            error,
            turns,
            wanted,
            spent,
        )))
    }

    /// Refuses a limit that the fewest paths, which take so long, miss by far.
    fn affords(&self, surfaces: usize, least_s: f64) -> Result<(), CliError> {
        match self.max_seconds {
            Some(limit) if least_s > MISS * limit => Err(CliError::no_result(anyhow!(
                "--max-seconds {limit}: {} with {} paths per radiance, the fewest that tell anything, take about \
                 {} s; allow that, or ask for fewer surfaces",
                counted(surfaces, "surface"),
                PILOTS[0],
                significant(least_s)
            ))),
            _ => Ok(()),
        }
    }

    fn told_by(
        &self,
        seconds: [f64; 2],
        error: f64,
        turns: usize,
        wanted: u64,
        spent: f64,
    ) -> Planned {
        let between = (PILOTS[1] - PILOTS[0]) as f64;
        let per_path = ((seconds[1] - seconds[0]) / between).max(1e-12);
        let start = (seconds[1] - per_path * PILOTS[1] as f64).max(0.0);
        let turns = turns as f64;
        let enough = match self.target_error {
            // Standard errors fall with the root of the paths.
            Some(target) => (PILOTS[1] as f64 * (error / target).powi(2)).ceil() as u64,
            None => wanted,
        };
        let affordable = self.max_seconds.map_or(u64::MAX, |limit| {
            ((((limit - spent) / turns - start) / per_path).max(0.0)) as u64
        });
        let paths = enough.min(affordable).clamp(PATHS.0, PATHS.1);
        let seconds = spent + turns * (start + per_path * paths as f64);
        let error = error * (PILOTS[1] as f64 / paths as f64).sqrt();
        Planned {
            paths,
            forecast: Forecast {
                cut_short: affordable < enough,
                ..Forecast::about(seconds)
                    .for_work(paths, "paths per radiance")
                    .to_error(Some(error), "a radiance")
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_those_for_the_error_and_no_more_than_time_allows() {
        // A surface: 0.1 s and 1 ms per path; 2 % after 512 paths; 10 turns.
        let seconds = PILOTS.map(|paths| 0.1 + 1e-3 * paths as f64);
        let told = |max_seconds, target_error| {
            let limits = PathLimits {
                max_seconds,
                target_error,
            };
            limits.told_by(seconds, 0.02, 10, 4096, 0.0)
        };
        assert_eq!(told(None, Some(0.01)).paths, 2048);
        assert!((told(None, Some(0.01)).forecast.seconds - (1.0 + 20.48)).abs() < 1e-9);
        let short = told(Some(11.0), None);
        assert!(
            short.forecast.cut_short && short.paths.abs_diff(1000) <= 1,
            "{short:?}"
        );
        let error = short.forecast.error.unwrap().value;
        assert!((error - 0.02 * (512.0f64 / 1000.0).sqrt()).abs() < 1e-4);
        let ample = told(Some(1000.0), None);
        assert!(!ample.forecast.cut_short && ample.paths == 4096);
        assert_eq!(told(Some(0.1), None).paths, PATHS.0);
    }

    #[test]
    fn a_limit_that_the_fewest_paths_miss_is_refused_with_what_they_take() {
        let limits = PathLimits {
            max_seconds: Some(5.0),
            target_error: None,
        };
        assert!(limits.affords(70, 6.0).is_ok());
        let Err(CliError::NoResult(refused)) = limits.affords(70, 31.4) else {
            panic!("it is refused");
        };
        let refused = refused.to_string();
        assert!(
            refused.contains("70 surfaces") && refused.contains("31.4 s"),
            "{refused}"
        );
    }
}
