//! Several runs of a scene, one per angle or wavelength, within limits that they share.
//!
//! Call [`RunLimits::check`] before anything is read, then [`each`]: it prints a forecast where one is worth its time,
//! traces run after run and hands over each result as the run ends.

use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::anyhow;

use super::{CliError, interrupt, unreached};
use crate::accuracy::trace_forecast::{Patience, TraceExtent, of_runs};
use crate::cli::limits::{RunLimits, Stopwatch};
use crate::cli::progress::Bar;
use crate::clock::elapsed_s;
use crate::trace::counting::tally::Totals;
use crate::trace::run::{self, Follow, StopPolicy, TraceProgress};
use crate::trace::scene::PreparedScene;

/// Number of photons from which a forecast is worth its time.
pub(super) const LONG: u64 = 2_000_000;

/// The runs of a command.
pub(super) struct Runs<'a> {
    /// Number of runs.
    pub count: usize,
    /// Photons of each run.
    pub photons: u64,
    /// Quantities that the paths carry.
    pub follow: Follow,
    pub limits: RunLimits,
    /// Runs since the command began.
    pub watch: Stopwatch,
    /// Makes the scene of each run by its number.
    pub make: &'a dyn Fn(usize) -> Result<PreparedScene, CliError>,
}

/// Result of the runs.
pub(super) struct FinishedRuns {
    pub seconds: f64,
    target: Option<f64>,
    /// Photons and error of the run that is farthest from the target.
    worst: Option<(u64, Option<f64>)>,
}

impl FinishedRuns {
    /// Checks that each run reached the target error, after the results are printed.
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
/// Bad input for an invalid scene; no result where a run has no result at its time limit; interrupted after Ctrl-C.
pub(super) fn each(
    runs: &Runs<'_>,
    take: &mut dyn FnMut(usize, &PreparedScene, Totals) -> Result<(), CliError>,
) -> Result<FinishedRuns, CliError> {
    let limits = runs.limits;
    let cancel = interrupt::flag()?;
    let watch = runs.watch;
    let all = runs.photons.saturating_mul(runs.count as u64);
    if limits.is_any() || (std::io::stderr().is_terminal() && all >= LONG) {
        print_forecast(runs, &cancel);
    }
    let bar = Bar::new("photons");
    let mut done = FinishedRuns {
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
        let proceed = |progress: &TraceProgress| {
            bar.at(before.saturating_add(progress.photons), all);
            !(cancel.load(Ordering::Relaxed)
                || late()
                || limits.is_reached(progress.relative_error))
        };
        let ending = StopPolicy::of(share_s, elapsed_s, limits.target_error);
        let totals = run::trace_following(&prepared, runs.follow, ending, &proceed);
        if cancel.load(Ordering::Relaxed) {
            bar.clear();
            return Err(CliError::Interrupted);
        }
        let (photons, error) = (totals.photons(), totals.relative_error());
        if photons == 0 {
            bar.clear();
            return Err(CliError::no_result(anyhow!(
                "run {} of {} has no result after {:.1} s: allow more time, or give fewer photons",
                n + 1,
                runs.count,
                watch.seconds()
            )));
        }
        traced = traced.saturating_add(photons);
        let missed = limits.target_error.is_some() && !limits.is_reached(error) && !late();
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

/// Prints a forecast of the runs, from short pilot runs.
fn print_forecast(runs: &Runs<'_>, cancel: &AtomicBool) {
    let asked = TraceExtent {
        follow: runs.follow,
        target_error: runs.limits.target_error,
    };
    let patience = Patience::usual(runs.limits.max_seconds, cancel);
    let make = |n: usize| (runs.make)(n).ok();
    if let Some(forecast) = of_runs(runs.count, &make, asked, patience) {
        super::say_forecast(forecast, runs.limits.max_seconds);
    }
}
