//! The progress of a job, reported by the threads that work and read by every client that asks.
//!
//! The job gets a [`ProgressMeter`]; [`ProgressMeter::now`] and [`ProgressMeter::forecast`] read it. The meter does not
//! know what is computed.

use std::sync::{Mutex, MutexGuard, OnceLock};
use std::time::Instant;

use serde::Serialize;

use crate::forecast::Forecast;

/// The stage of a job that waits for a slot.
const QUEUED: &str = "waiting for its turn";

/// A snapshot of a job's progress.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
#[schema(as = WorkProgress)]
pub struct JobProgress {
    /// Current stage.
    pub stage: &'static str,
    /// Completed share of this stage, 0 to 1.
    pub fraction: f64,
    /// Seconds since the job got its slot, or since it was requested while it waits for one.
    pub elapsed_s: f64,
    /// Seconds left of this stage at its pace so far; for a stage without a known fraction, seconds left of the
    /// forecast. None before there is a pace, and once the job takes longer than forecast.
    pub time_left_s: Option<f64>,
    /// Position in the queue, 1 for the next job to start; only while the job waits for a slot.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub queued_position: Option<usize>,
}

/// Records the progress of one job.
#[derive(Debug)]
pub(in crate::lab) struct ProgressMeter {
    requested: Instant,
    /// When the job got its slot.
    started: OnceLock<Instant>,
    stage: Mutex<Option<Stage>>,
    forecast: Mutex<Option<DatedForecast>>,
}

/// A forecast and the time at which it was made.
#[derive(Debug, Clone)]
struct DatedForecast {
    at: Instant,
    forecast: Forecast,
}

#[derive(Debug, Clone, Copy)]
struct Stage {
    name: &'static str,
    begun: Instant,
    fraction: f64,
    queued_position: Option<usize>,
}

impl ProgressMeter {
    pub(in crate::lab) fn new() -> Self {
        ProgressMeter {
            requested: Instant::now(),
            started: OnceLock::new(),
            stage: Mutex::new(None),
            forecast: Mutex::new(None),
        }
    }

    /// Records that the job has its slot: the time spent waiting is not part of its run time.
    pub(in crate::lab) fn start(&self) {
        self.started.get_or_init(Instant::now);
    }

    /// Records the job's place in the queue, 1 for the next to start.
    pub(in crate::lab) fn queue(&self, position: usize) {
        let mut stage = self.lock();
        let begun = stage.map_or_else(Instant::now, |stage| stage.begun);
        *stage = Some(Stage {
            name: QUEUED,
            begun,
            fraction: 0.0,
            queued_position: Some(position),
        });
    }

    /// Records the forecast that was made before the work starts.
    pub(in crate::lab) fn set_forecast(&self, forecast: &Forecast) {
        *self.lock_forecast() = Some(DatedForecast {
            at: Instant::now(),
            forecast: forecast.clone(),
        });
    }

    /// Returns the forecast, if there is one.
    pub(in crate::lab) fn forecast(&self) -> Option<Forecast> {
        self.lock_forecast().as_ref().map(|f| f.forecast.clone())
    }

    /// Seconds left of the forecast.
    fn forecast_left_s(&self) -> Option<f64> {
        let dated = self.lock_forecast();
        let dated = dated.as_ref()?;
        let left = dated.forecast.seconds - dated.at.elapsed().as_secs_f64();
        (left > 0.0).then_some(left)
    }

    /// Seconds since the job got its slot, or since it was requested while it waits for one.
    pub(in crate::lab) fn elapsed_s(&self) -> f64 {
        let since = self.started.get().unwrap_or(&self.requested);
        since.elapsed().as_secs_f64()
    }

    fn lock_forecast(&self) -> MutexGuard<'_, Option<DatedForecast>> {
        self.forecast.lock().expect("no holder of this lock panics")
    }

    /// Records that `done` of `total` of a stage are complete. Several threads may report; the largest share counts.
    pub(in crate::lab) fn report(&self, stage: &'static str, done: u64, total: u64) {
        let fraction = if total == 0 {
            0.0
        } else {
            (done as f64 / total as f64).clamp(0.0, 1.0)
        };
        let mut current = self.lock();
        match current.as_mut() {
            Some(s) if s.name == stage => s.fraction = s.fraction.max(fraction),
            _ => {
                *current = Some(Stage {
                    name: stage,
                    begun: Instant::now(),
                    fraction,
                    queued_position: None,
                });
            }
        }
    }

    /// Returns the progress so far; none before the job has reported anything.
    pub(in crate::lab) fn now(&self) -> Option<JobProgress> {
        let stage = (*self.lock())?;
        let spent_s = stage.begun.elapsed().as_secs_f64();
        let at_this_pace =
            (stage.fraction > 0.0).then(|| spent_s * (1.0 - stage.fraction) / stage.fraction);
        Some(JobProgress {
            stage: stage.name,
            fraction: stage.fraction,
            elapsed_s: self.elapsed_s(),
            time_left_s: at_this_pace.or_else(|| self.forecast_left_s()),
            queued_position: stage.queued_position,
        })
    }

    fn lock(&self) -> MutexGuard<'_, Option<Stage>> {
        self.stage.lock().expect("no holder of this lock panics")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_only_advances_and_the_next_starts_at_zero() {
        let meter = ProgressMeter::new();
        assert_eq!(meter.now(), None);
        meter.report("reading", 3, 4);
        // A thread that reports late.
        meter.report("reading", 2, 4);
        let now = meter.now().unwrap();
        assert_eq!((now.stage, now.fraction), ("reading", 0.75));
        assert!(now.time_left_s.unwrap() <= now.elapsed_s / 3.0);
        meter.report("fitting", 0, 1000);
        let now = meter.now().unwrap();
        assert_eq!(
            (now.stage, now.fraction, now.time_left_s),
            ("fitting", 0.0, None)
        );
    }

    #[test]
    fn a_stage_without_a_fraction_shows_the_time_left_of_the_forecast() {
        let meter = ProgressMeter::new();
        meter.report("fitting", 0, 1);
        meter.set_forecast(&Forecast::about(1000.0));
        let left = meter.now().unwrap().time_left_s.unwrap();
        assert!(left > 0.0 && left <= 1000.0);
        meter.set_forecast(&Forecast::about(0.0));
        assert_eq!(meter.now().unwrap().time_left_s, None);
    }

    #[test]
    fn only_a_waiting_job_has_a_position_in_the_queue() {
        let meter = ProgressMeter::new();
        meter.queue(2);
        meter.queue(1);
        let json = serde_json::to_value(meter.now().unwrap()).unwrap();
        assert_eq!(json["queued_position"], 1);
        meter.start();
        meter.report("reading", 0, 1);
        let json = serde_json::to_value(meter.now().unwrap()).unwrap();
        assert!(json.get("queued_position").is_none());
    }
}
