//! How far a calculation has come, told by the thread that works and read by any that asks.
//!
//! Make a [`Headway`], hand it to the work, and call [`Headway::now`] and [`Headway::forecast`]. It does not
//! know what is calculated.

use std::sync::{Mutex, MutexGuard, OnceLock};
use std::time::Instant;

use serde::Serialize;

use crate::forecast::Forecast;

/// How far a calculation has come.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Progress {
    /// What is being done.
    pub stage: &'static str,
    /// Share of this stage that is done, 0 to 1.
    pub fraction: f64,
    /// Seconds since the calculation began.
    pub elapsed_s: f64,
    /// Seconds left of this stage at the pace so far; where it cannot say how far it is, of all that was foretold; none
    /// before there is a pace, and once it takes longer than foretold.
    pub time_left_s: Option<f64>,
}

/// A place where work says how far it has come.
#[derive(Debug)]
pub(super) struct Headway {
    begun: Instant,
    /// When its turn came.
    started: OnceLock<Instant>,
    stage: Mutex<Option<Reached>>,
    forecast: Mutex<Option<Foretold>>,
}

/// A forecast, and when it was told.
#[derive(Debug, Clone)]
struct Foretold {
    at: Instant,
    forecast: Forecast,
}

#[derive(Debug, Clone, Copy)]
struct Reached {
    stage: &'static str,
    begun: Instant,
    fraction: f64,
}

impl Headway {
    pub(super) fn new() -> Self {
        Headway {
            begun: Instant::now(),
            started: OnceLock::new(),
            stage: Mutex::new(None),
            forecast: Mutex::new(None),
        }
    }

    /// Its turn has come: what it waited is no time that it takes.
    pub(super) fn start(&self) {
        self.started.get_or_init(Instant::now);
    }

    /// What it will take, told once before the work starts.
    pub(super) fn foretell(&self, forecast: &Forecast) {
        *self.lock_forecast() = Some(Foretold {
            at: Instant::now(),
            forecast: forecast.clone(),
        });
    }

    /// What it will take; none while nobody knows.
    pub(super) fn forecast(&self) -> Option<Forecast> {
        self.lock_forecast().as_ref().map(|f| f.forecast.clone())
    }

    /// Seconds left of what was foretold.
    fn left_as_foretold(&self) -> Option<f64> {
        let told = self.lock_forecast();
        let told = told.as_ref()?;
        let left = told.forecast.seconds - told.at.elapsed().as_secs_f64();
        (left > 0.0).then_some(left)
    }

    /// Seconds since it began, or while it waits for its turn, since it was asked for.
    pub(super) fn elapsed_s(&self) -> f64 {
        let since = self.started.get().unwrap_or(&self.begun);
        since.elapsed().as_secs_f64()
    }

    fn lock_forecast(&self) -> MutexGuard<'_, Option<Foretold>> {
        self.forecast.lock().expect("no holder of this lock panics")
    }

    /// `done` of `total` of a stage; several threads may tell, the furthest counts.
    pub(super) fn tell(&self, stage: &'static str, done: u64, total: u64) {
        let fraction = if total == 0 {
            0.0
        } else {
            (done as f64 / total as f64).clamp(0.0, 1.0)
        };
        let mut reached = self.lock();
        match reached.as_mut() {
            Some(r) if r.stage == stage => r.fraction = r.fraction.max(fraction),
            _ => {
                *reached = Some(Reached {
                    stage,
                    begun: Instant::now(),
                    fraction,
                });
            }
        }
    }

    /// How far it has come by now; none before the work has said anything.
    pub(super) fn now(&self) -> Option<Progress> {
        let reached = (*self.lock())?;
        let spent_s = reached.begun.elapsed().as_secs_f64();
        let at_this_pace =
            (reached.fraction > 0.0).then(|| spent_s * (1.0 - reached.fraction) / reached.fraction);
        Some(Progress {
            stage: reached.stage,
            fraction: reached.fraction,
            elapsed_s: self.elapsed_s(),
            time_left_s: at_this_pace.or_else(|| self.left_as_foretold()),
        })
    }

    fn lock(&self) -> MutexGuard<'_, Option<Reached>> {
        self.stage.lock().expect("no holder of this lock panics")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_only_goes_forward_and_the_next_begins_anew() {
        let headway = Headway::new();
        assert_eq!(headway.now(), None);
        headway.tell("reading", 3, 4);
        // A thread that was slow to tell.
        headway.tell("reading", 2, 4);
        let now = headway.now().unwrap();
        assert_eq!((now.stage, now.fraction), ("reading", 0.75));
        assert!(now.time_left_s.unwrap() <= now.elapsed_s / 3.0);
        headway.tell("fitting", 0, 1000);
        let now = headway.now().unwrap();
        assert_eq!(
            (now.stage, now.fraction, now.time_left_s),
            ("fitting", 0.0, None)
        );
    }

    #[test]
    fn a_stage_that_cannot_say_how_far_it_is_has_the_time_that_was_foretold_and_none_beyond() {
        let headway = Headway::new();
        headway.tell("fitting", 0, 1);
        headway.foretell(&Forecast::about(1000.0));
        let left = headway.now().unwrap().time_left_s.unwrap();
        assert!(left > 0.0 && left <= 1000.0);
        headway.foretell(&Forecast::about(0.0));
        assert_eq!(headway.now().unwrap().time_left_s, None);
    }
}
