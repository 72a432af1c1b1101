//! Several runs of a scene, one per angle or wavelength, within what the user allows them all.
//!
//! Call [`Limits::check`] before anything is read, then [`each`], which tells a forecast where one is worth its
//! time, traces run after run and hands each over as it ends.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::anyhow;

use super::{CliError, interrupt, unreached};
use crate::accuracy::trace_forecast::{Asked, Patience, of_runs};
use crate::cli::limits::{self, Stopwatch};
use crate::cli::progress::Bar;
use crate::clock::elapsed_s;
use crate::trace::run::{self, Ending, Follow, Progress};
use crate::trace::scene::Prepared;
use crate::trace::tally::Totals;

/// Photons from which on a forecast is worth its time.
pub(super) const LONG: u64 = 2_000_000;

/// What a user allows all runs together and asks of each.
#[derive(Debug, Clone, Copy, Default, PartialEq, clap::Args)]
pub(super) struct Limits {
    /// Take no longer than about this in all: the runs to come share the time that is left, and what each has
    /// traced by then counts.
    #[arg(long, value_name = "S")]
    pub max_seconds: Option<f64>,
    /// End each run once the relative error of its reflected bins (root mean square) is below this.
    #[arg(long, value_name = "E")]
    pub target_error: Option<f64>,
}

impl Limits {
    /// Refuses limits that are not greater than 0.
    ///
    /// # Errors
    /// Bad input, naming the option.
    pub(super) fn check(&self) -> Result<(), CliError> {
        limits::check(&[
            ("--max-seconds", self.max_seconds),
            ("--target-error", self.target_error),
        ])
    }

    fn any(&self) -> bool {
        self.max_seconds.is_some() || self.target_error.is_some()
    }

    fn reached(&self, error: Option<f64>) -> bool {
        matches!((self.target_error, error), (Some(target), Some(error)) if error <= target)
    }
}

/// The runs of a command.
pub(super) struct Runs<'a> {
    /// How many.
    pub count: usize,
    /// Photons of each.
    pub photons: u64,
    /// What their paths carry.
    pub follow: Follow,
    pub limits: Limits,
    /// Runs since the command began.
    pub watch: Stopwatch,
    /// The scene of each by its number.
    pub make: &'a dyn Fn(usize) -> Result<Prepared, CliError>,
}

/// What became of them.
pub(super) struct Done {
    pub seconds: f64,
    target: Option<f64>,
    /// Photons and error of the run that is farthest from the target.
    worst: Option<(u64, Option<f64>)>,
}

impl Done {
    /// Whether each run is as the user asked, once the results are printed.
    ///
    /// # Errors
    /// No result where a run ended above the target error with all its photons.
    pub(super) fn verdict(&self) -> Result<(), CliError> {
        match (self.target, self.worst) {
            (Some(target), Some((photons, error))) => {
                Err(CliError::no_result(unreached(target, error, photons)))
            }
            _ => Ok(()),
        }
    }
}

/// Traces run after run; each is handed over with its number as it ends.
///
/// # Errors
/// Bad input for a scene that cannot be made; no result where a run has nothing to show by the end of its time;
/// interrupted after Ctrl-C.
pub(super) fn each(
    runs: &Runs<'_>,
    take: &mut dyn FnMut(usize, &Prepared, Totals) -> Result<(), CliError>,
) -> Result<Done, CliError> {
    let limits = runs.limits;
    let cancel = interrupt::flag()?;
    let watch = runs.watch;
    let all = runs.photons.saturating_mul(runs.count as u64);
    if limits.any() || (std::io::stderr().is_terminal() && all >= LONG) {
        foretell(runs, &cancel);
    }
    let bar = Bar::new("photons");
    let mut done = Done {
        seconds: 0.0,
        target: limits.target_error,
        worst: None,
    };
    let mut traced = 0u64;
    for n in 0..runs.count {
        let prepared = (runs.make)(n)?;
        let begun = Instant::now();
        let share_s = limits
            .max_seconds
            .map(|limit| (limit - watch.seconds()).max(0.0) / (runs.count - n) as f64);
        let late = || share_s.is_some_and(|share_s| begun.elapsed().as_secs_f64() >= share_s);
        let before = runs.photons.saturating_mul(n as u64);
        let proceed = |progress: &Progress| {
            bar.at(before.saturating_add(progress.photons), all);
            !(cancel.load(Ordering::Relaxed) || late() || limits.reached(progress.relative_error))
        };
        let ending = Ending::of(share_s, elapsed_s, limits.target_error);
        let totals = run::trace_following(&prepared, runs.follow, ending, &proceed);
        if cancel.load(Ordering::Relaxed) {
            bar.clear();
            return Err(CliError::Interrupted);
        }
        let (photons, error) = (totals.photons(), totals.relative_error());
        if photons == 0 {
            bar.clear();
            return Err(CliError::no_result(anyhow!(
                "nothing of run {} of {} was finished in {:.1} s: allow more time or ask for fewer photons",
                n + 1,
                runs.count,
                watch.seconds()
            )));
        }
        traced = traced.saturating_add(photons);
        let missed = limits.target_error.is_some() && !limits.reached(error) && !late();
        let worse = |other: Option<f64>| error.is_none_or(|e| other.is_some_and(|o| e > o));
        if missed && done.worst.is_none_or(|(_, other)| worse(other)) {
            done.worst = Some((photons, error));
        }
        take(n, &prepared, totals)?;
    }
    bar.clear();
    done.seconds = watch.seconds();
    if let Some(limit) = limits
        .max_seconds
        .filter(|_| watch.is_late() && traced < all)
    {
        super::super::say(&format_args!(
            "stopped after {limit} s: {traced} of {all} photons were traced"
        ));
    }
    Ok(done)
}

/// Prints what the runs will take, from short ones.
fn foretell(runs: &Runs<'_>, cancel: &AtomicBool) {
    let asked = Asked {
        follow: runs.follow,
        target_error: runs.limits.target_error,
    };
    let patience = Patience::usual(runs.limits.max_seconds, cancel);
    let make = |n: usize| (runs.make)(n).ok();
    if let Some(forecast) = of_runs(runs.count, &make, asked, patience) {
        super::say_forecast(forecast, runs.limits.max_seconds);
    }
}
