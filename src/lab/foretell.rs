//! What work that was asked for will take, told before it starts and kept with its result.
//!
//! Call [`Lab::foretell`] with a way to make the forecast; it goes to the work's [`ProgressMeter`], where whoever asks how
//! far it is finds it, and to everybody as an event. [`with_cost`] writes it into a result beside what was
//! taken. It does not know how forecasts are made: that is `accuracy`'s.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use serde_json::{Value, json};

use super::job_progress::ProgressMeter;
use super::tasks::blocking;
use super::{Lab, LabError};
use crate::forecast::Forecast;
use crate::scan::Event;

/// The work whose forecast is told.
pub(super) struct Foretold {
    /// fit, map, contrast, verdict or trace.
    pub(super) of: String,
    /// Its number among those.
    pub(super) number: i64,
    /// Scan it is of.
    pub(super) scan_id: Option<i64>,
}

impl Lab {
    /// Makes the forecast of `work` away from the runtime's threads and tells it. Nothing is told where there is
    /// none, or the work was cancelled meanwhile; the work goes on all the same.
    ///
    /// # Errors
    /// [`LabError::Panicked`]: the work is lost.
    pub(super) async fn foretell<W: Send + 'static>(
        &self,
        what: Foretold,
        work: W,
        make: impl FnOnce(&W, &AtomicBool) -> Option<Forecast> + Send + 'static,
        progress: &Arc<ProgressMeter>,
        cancel: &Arc<AtomicBool>,
    ) -> Result<W, LabError> {
        progress.report("forecasting", 0, 1);
        let flag = Arc::clone(cancel);
        let (work, forecast) = blocking(move || {
            let forecast = make(&work, &flag);
            (work, forecast)
        })
        .await?;
        if let Some(forecast) = forecast.filter(|_| !cancel.load(Ordering::Relaxed)) {
            progress.set_forecast(&forecast);
            let Foretold {
                of,
                number,
                scan_id,
            } = what;
            let event = Event::Forecast {
                of,
                number,
                scan_id,
                forecast,
            };
            match self.store().record(event).await {
                Ok(event) => self.publish(event),
                Err(error) => {
                    tracing::warn!(%error, "a forecast could not be kept: {error}");
                }
            }
        }
        Ok(work)
    }
}

/// A result (one JSON object) with the seconds that it took, and the forecast that was made of them.
pub(super) fn with_cost(result: &str, progress: &ProgressMeter) -> serde_json::Result<String> {
    let mut object: Value = serde_json::from_str(result)?;
    if object.get("seconds").is_none() {
        object["seconds"] = json!(progress.elapsed_s());
    }
    if let Some(forecast) = progress.forecast() {
        object["forecast"] = json!(forecast);
    }
    serde_json::to_string(&object)
}
