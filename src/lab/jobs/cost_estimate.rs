//! Cost estimates of jobs: published before the work starts and stored with its result.
//!
//! [`Lab::publish_forecast`] computes a forecast, sets it in the job's [`ProgressMeter`] and sends it as an event.
//! [`with_cost`] adds it to a result beside the time that the job took. The forecasts themselves come from `accuracy`.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use serde_json::{Value, json};

use crate::lab::jobs::progress::ProgressMeter;
use crate::lab::jobs::work::Work;
use crate::lab::tasks::blocking;
use crate::lab::{Lab, LabError};
use crate::scan::Event;

/// The job that a forecast belongs to.
pub(in crate::lab) struct ForecastSubject {
    /// Kind: fit, map, contrast, verdict or trace.
    pub(in crate::lab) of: String,
    /// Number within the kind.
    pub(in crate::lab) number: i64,
    /// Scan that the job reads.
    pub(in crate::lab) scan_id: Option<i64>,
}

impl Lab {
    /// Computes the forecast of `work` on a blocking thread and publishes it, then returns the work. Without a forecast, or
    /// if the job was cancelled, nothing is published.
    ///
    /// # Errors
    /// [`LabError::Panicked`]: the work is lost.
    pub(in crate::lab) async fn publish_forecast(
        &self,
        subject: ForecastSubject,
        work: Box<dyn Work>,
        progress: &Arc<ProgressMeter>,
        cancel: &Arc<AtomicBool>,
    ) -> Result<Box<dyn Work>, LabError> {
        progress.report("forecasting", 0, 1);
        let flag = Arc::clone(cancel);
        let (work, forecast) = blocking(move || {
            let forecast = work.forecast(&flag);
            (work, forecast)
        })
        .await?;
        if let Some(forecast) = forecast.filter(|_| !cancel.load(Ordering::Relaxed)) {
            progress.set_forecast(&forecast);
            let ForecastSubject {
                of,
                number,
                scan_id,
            } = subject;
            let event = Event::Forecast {
                of,
                number,
                scan_id,
                forecast,
            };
            match self.store().record(event).await {
                Ok(event) => self.publish(event),
                Err(error) => {
                    tracing::warn!(%error, "a forecast could not be stored: {error}");
                }
            }
        }
        Ok(work)
    }
}

/// Adds the seconds that a job took and its forecast to its result, a JSON object.
pub(in crate::lab) fn with_cost(
    result: &str,
    progress: &ProgressMeter,
) -> serde_json::Result<String> {
    let mut object: Value = serde_json::from_str(result)?;
    if object.get("seconds").is_none() {
        object["seconds"] = json!(progress.elapsed_s());
    }
    if let Some(forecast) = progress.forecast() {
        object["forecast"] = json!(forecast);
    }
    serde_json::to_string(&object)
}
