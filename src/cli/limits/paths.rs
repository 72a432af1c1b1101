//! `--max-seconds` and `--radiance-error` of work on many surfaces, each traced with the same number of paths. A small and a
//! larger pilot run separate the cost of a surface from the cost of a path, and show how many paths fit into the time and
//! reach the error.

use std::time::Instant;

use anyhow::anyhow;

use super::check;
use crate::cli::CliError;
use crate::forecast::Forecast;
use crate::wording::{counted, significant};

/// Limits of a run on many surfaces.
#[derive(Debug, Clone, Copy, Default, PartialEq, clap::Args)]
pub struct PathLimits {
    /// Time limit (approximate): fewer paths are traced if needed, and the number used is reported; surfaces not
    /// reached are named.
    #[arg(long, value_name = "S")]
    pub max_seconds: Option<f64>,
    /// Trace as many paths as it takes to bring the relative standard error below this, instead of --paths.
    #[arg(long = "radiance-error", alias = "target-error", value_name = "E")]
    pub target_error: Option<f64>,
}

/// The plan of a run, made before it starts.
#[derive(Debug, Clone, PartialEq)]
pub struct Planned {
    /// Paths per radiance.
    pub paths: u64,
    /// Expected time and error.
    pub forecast: Forecast,
}

/// The work of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PathWork {
    /// Surfaces to trace.
    pub surfaces: usize,
    /// Surfaces traced at the same time.
    pub abreast: usize,
    /// Paths per radiance, unless a limit changes them.
    pub paths: u64,
    /// Whether surfaces may be left out for lack of time; if not, a limit that cannot be met is refused.
    pub may_miss_some: bool,
}

/// Result of a pilot run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PilotResult {
    /// Number of surfaces, traced one after the other.
    pub surfaces: usize,
    /// Relative standard error of the worst surface.
    pub error: f64,
    /// Seconds spent on work other than paths, for example fits.
    pub apart_s: f64,
}

/// Time of one surface of a pilot, s.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Cost {
    paths: u64,
    paths_s: f64,
    apart_s: f64,
    error: f64,
}

impl Cost {
    fn all_s(&self) -> f64 {
        self.paths_s + self.apart_s
    }

    /// Whether it took clearly longer than a pilot with fewer paths, so that the difference is due to the paths.
    fn is_clearly_beyond(&self, fewer: &Cost) -> bool {
        self.paths_s > CLEARLY * fewer.paths_s
    }
}

/// Largest share of a time limit that pilots may have used before another one is started.
const SECOND_PILOT: f64 = 0.1;
/// The same without a time limit, s.
const PILOTS_S: f64 = 2.0;
/// Numbers of paths of the two pilots.
const PILOTS: [u64; 2] = [64, 512];
/// A pilot shorter than this is repeated, up to `REPEATS` times: other work on the machine disturbs a few milliseconds.
const REPEATED_S: f64 = 0.05;
const REPEATS: usize = 5;
/// Factor between the paths of successive pilots,
const LONGER: u64 = 8;
/// and the ratio of times at which the larger one counts as longer: a smaller difference may be other work on the
/// machine.
const CLEARLY: f64 = 1.5;
/// Most paths of a pilot.
const PILOT_MAX: u64 = 1 << 15;
/// Possible error of a pilot's forecast, as a factor: a limit that is exceeded by less is tried.
const MISS: f64 = 1.3;
/// Fewest and most paths of a run.
pub const PATHS: (u64, u64) = (64, 10_000_000);

/// Refuses a number of paths out of range.
///
/// # Errors
/// Bad input, naming the option.
pub fn check_paths(paths: u64) -> Result<(), CliError> {
    match (PATHS.0..=PATHS.1).contains(&paths) {
        true => Ok(()),
        false => Err(CliError::bad_input(anyhow!(
            "--paths {paths} is out of range: expected 64 to 10 000 000"
        ))),
    }
}

impl PathLimits {
    /// Refuses limits that are not greater than 0.
    ///
    /// # Errors
    /// Bad input, naming the option.
    pub fn check(&self) -> Result<(), CliError> {
        check(&[
            ("--max-seconds", self.max_seconds),
            ("--radiance-error", self.target_error),
        ])
    }

    /// Whether any limit is set.
    #[must_use]
    pub fn is_any(&self) -> bool {
        self.max_seconds.is_some() || self.target_error.is_some()
    }

    /// Plans a run. `pilot` traces some representative surfaces with a number of paths; it returns `None` where it cannot.
    ///
    /// # Errors
    /// No result where the fewest paths do not fit into the time limit and no surface may be left out.
    pub fn plan(
        &self,
        work: &PathWork,
        pilot: &dyn Fn(u64) -> Option<PilotResult>,
    ) -> Result<Option<Planned>, CliError> {
        let started = Instant::now();
        self.plan_timed(work, pilot, &|| started.elapsed().as_secs_f64())
    }

    /// Plans a run; `now` returns the time, s.
    fn plan_timed(
        &self,
        work: &PathWork,
        pilot: &dyn Fn(u64) -> Option<PilotResult>,
        now: &dyn Fn() -> f64,
    ) -> Result<Option<Planned>, CliError> {
        let started_s = now();
        let spent_s = || now() - started_s;
        let costly = |limit: f64| spent_s() > SECOND_PILOT * limit;
        let is_costly = || self.max_seconds.map_or(spent_s() > PILOTS_S, costly);
        let once = |paths: u64| {
            let begun_s = now();
            let trial = pilot(paths)?;
            let (each, all_s) = (trial.surfaces.max(1) as f64, now() - begun_s);
            Some(Cost {
                paths,
                paths_s: (all_s - trial.apart_s).max(0.0) / each,
                apart_s: trial.apart_s / each,
                error: trial.error,
            })
        };
        let timed = |paths: u64| {
            let begun_s = now();
            let mut best: Cost = once(paths)?;
            for _ in 1..REPEATS {
                if now() - begun_s > REPEATED_S || is_costly() {
                    break;
                }
                let again = once(paths)?;
                // Other work on the machine only makes pilots longer.
                if again.all_s() < best.all_s() {
                    best = again;
                }
            }
            Some(best)
        };
        let turns = work.surfaces.div_ceil(work.abreast.max(1));
        let Some(little) = timed(PILOTS[0]) else {
            return Ok(None);
        };
        if !work.may_miss_some {
            self.affords(work.surfaces, little.all_s() * turns as f64)?;
        }
        let more = if work.may_miss_some && self.max_seconds.is_some_and(costly) {
            // The time of the pilots is no longer available.
            None
        } else {
            let Some(mut more) = timed(PILOTS[1]) else {
                return Ok(None);
            };
            // Where the surface takes most of both times, only more paths show the cost of one.
            while !more.is_clearly_beyond(&little) && more.paths < PILOT_MAX && !is_costly() {
                let Some(longer) = timed(LONGER * more.paths) else {
                    return Ok(None);
                };
                more = longer;
            }
            Some(more)
        };
        Ok(Some(self.planned_from(
            little,
            more,
            turns,
            work.paths,
            spent_s(),
        )))
    }

    /// Refuses a limit that even the fewest paths exceed by far.
    fn affords(&self, surfaces: usize, least_s: f64) -> Result<(), CliError> {
        match self.max_seconds {
            Some(limit) if least_s > MISS * limit => Err(CliError::no_result(anyhow!(
                "--max-seconds {limit}: {} with {} paths per radiance, the fewest that give a result, take about \
                {} s; allow more time, or give fewer surfaces",
                counted(surfaces, "surface"),
                PILOTS[0],
                significant(least_s)
            ))),
            _ => Ok(()),
        }
    }

    /// Refuses a run that ended above the target error; `what` is the noun of a surface.
    ///
    /// # Errors
    /// No result, with the number of paths that would suffice.
    pub fn verdict(&self, what: &str, paths: u64, error: f64) -> Result<(), CliError> {
        match self.target_error {
            Some(target) if error > target => Err(CliError::no_result(anyhow!(
                "not every {what} reached the target error {target}: {paths} paths gave {} at worst; about {} paths are needed \
                (--paths)",
                significant(error),
                significant((paths as f64 * (error / target).powi(2)).ceil())
            ))),
            _ => Ok(()),
        }
    }

    fn planned_from(
        &self,
        little: Cost,
        more: Option<Cost>,
        turns: usize,
        wanted: u64,
        spent: f64,
    ) -> Planned {
        let known = more.unwrap_or(little);
        let per_path = match more {
            Some(more) if more.is_clearly_beyond(&little) => {
                (more.paths_s - little.paths_s) / (more.paths - little.paths) as f64
            }
            // At most the time of all surfaces.
            _ => known.paths_s / known.paths as f64,
        };
        let per_path = per_path.max(1e-12);
        let start = known.apart_s + (known.paths_s - per_path * known.paths as f64).max(0.0);
        let error = known.error;
        let turns = turns as f64;
        let enough = match self.target_error {
            // Standard errors fall with the root of the paths.
            Some(target) => (known.paths as f64 * (error / target).powi(2)).ceil() as u64,
            None => wanted,
        };
        let affordable = self.max_seconds.map_or(u64::MAX, |limit| {
            ((((limit - spent) / turns - start) / per_path).max(0.0)) as u64
        });
        let paths = enough.min(affordable).clamp(PATHS.0, PATHS.1);
        let seconds = spent + turns * (start + per_path * paths as f64);
        let error = error * (known.paths as f64 / paths as f64).sqrt();
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
    fn paths_reach_the_error_within_the_time() {
        // A surface: 0.1 s and 1 ms per path; 2 % after 512 paths; 10 turns.
        let cost = |paths: u64, apart_s: f64| Cost {
            paths,
            paths_s: 0.1 - apart_s + 1e-3 * paths as f64,
            apart_s,
            error: 0.02 * (PILOTS[1] as f64 / paths as f64).sqrt(),
        };
        let (little, more) = (cost(PILOTS[0], 0.0), cost(PILOTS[1], 0.0));
        let planned = |max_seconds, target_error| {
            let limits = PathLimits {
                max_seconds,
                target_error,
            };
            limits.planned_from(little, Some(more), 10, 4096, 0.0)
        };
        assert_eq!(planned(None, Some(0.01)).paths, 2048);
        assert!((planned(None, Some(0.01)).forecast.seconds - (1.0 + 20.48)).abs() < 1e-9);
        let short = planned(Some(11.0), None);
        assert!(
            short.forecast.cut_short && short.paths.abs_diff(1000) <= 1,
            "{short:?}"
        );
        let error = short.forecast.error.unwrap().value;
        assert!((error - 0.02 * (512.0f64 / 1000.0).sqrt()).abs() < 1e-4);
        let ample = planned(Some(1000.0), None);
        assert!(!ample.forecast.cut_short && ample.paths == 4096);
        assert_eq!(planned(Some(0.1), None).paths, PATHS.0);
        // Fits that take longer with fewer paths do not hide the cost of a path.
        let fitted = |paths, apart_s| Cost {
            paths_s: 1e-3 * paths as f64,
            apart_s,
            ..cost(paths, 0.0)
        };
        let limits = PathLimits {
            max_seconds: Some(20.0),
            target_error: None,
        };
        let (little, more) = (fitted(PILOTS[0], 3.0), fitted(PILOTS[1], 1.0));
        for planned in [
            limits.planned_from(little, Some(more), 10, 4096, 0.0),
            limits.planned_from(more, None, 10, 4096, 0.0),
        ] {
            assert!(planned.paths.abs_diff(1000) <= 1, "{planned:?}");
            assert!((planned.forecast.seconds - 20.0).abs() < 0.1, "{planned:?}");
        }
    }

    #[test]
    fn pilots_of_equal_time_do_not_make_paths_free() {
        let cost = |paths, paths_s| Cost {
            paths,
            paths_s,
            apart_s: 0.0,
            error: 0.02,
        };
        let limits = PathLimits {
            max_seconds: Some(10.0),
            target_error: None,
        };
        for more_s in [0.004, 0.005, 0.006] {
            let (little, more) = (cost(PILOTS[0], 0.005), cost(PILOTS[1], more_s));
            let planned = limits.planned_from(little, Some(more), 100, 1_000_000, 0.0);
            // 0.1 s for each turn, of paths of some 10 µs at most.
            assert!(planned.forecast.cut_short, "{planned:?}");
            assert!((8_000..14_000).contains(&planned.paths), "{planned:?}");
        }
    }

    #[test]
    fn pilots_grow_until_the_cost_of_a_path_is_separable() {
        let asked = std::cell::RefCell::new(Vec::new());
        let now_s = std::cell::Cell::new(0.0);
        let pilot = |paths: u64| {
            asked.borrow_mut().push(paths);
            now_s.set(now_s.get() + 0.06 + 20e-6 * paths as f64);
            Some(PilotResult {
                surfaces: 1,
                error: 0.1,
                apart_s: 0.0,
            })
        };
        let limits = PathLimits {
            max_seconds: Some(60.0),
            target_error: None,
        };
        let work = PathWork {
            surfaces: 10,
            abreast: 1,
            paths: 1_000_000,
            may_miss_some: false,
        };
        let planned = limits.plan_timed(&work, &pilot, &|| now_s.get());
        let planned = planned.unwrap().unwrap();
        assert_eq!(*asked.borrow(), [64, 512, 4096]);
        // 6 s a turn, less the pilots and what the surface takes, at 20 µs.
        assert!((295_000..296_000).contains(&planned.paths), "{planned:?}");
    }

    #[test]
    fn no_limit_is_refused_where_surfaces_may_be_left_out_and_a_costly_pilot_is_the_last() {
        let limits = PathLimits {
            max_seconds: Some(1e-3),
            target_error: None,
        };
        let work = |may_miss_some| PathWork {
            surfaces: 70,
            abreast: 1,
            paths: 4096,
            may_miss_some,
        };
        let asked = std::cell::Cell::new(0);
        let now_s = std::cell::Cell::new(0.0);
        let pilot = |_| {
            asked.set(asked.get() + 1);
            now_s.set(now_s.get() + 2e-3);
            Some(PilotResult {
                surfaces: 2,
                error: 0.1,
                apart_s: 0.0,
            })
        };
        let plan = |may_miss_some| limits.plan_timed(&work(may_miss_some), &pilot, &|| now_s.get());
        assert!(plan(false).is_err());
        let planned = plan(true).unwrap().unwrap();
        assert!(planned.forecast.cut_short && planned.paths == PATHS.0);
        assert_eq!(asked.get(), 2);
    }

    #[test]
    fn a_limit_that_the_fewest_paths_exceed_is_refused_with_their_time() {
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
