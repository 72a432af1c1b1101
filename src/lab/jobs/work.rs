//! What a kind of job adds to the jobs: its work and its result.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use serde::Serialize;

use super::progress::ProgressMeter;
use crate::analysis;
use crate::forecast::Forecast;
use crate::lab::failure::Failure;
use crate::observation::ObservationSet;
use crate::scan::event::ShortValue;

/// The work of a job: checked, with all its inputs.
pub(in crate::lab) trait Work: Send + Sync + 'static {
    /// JSON of all options with their defaults, to be stored beside the request.
    fn options(&self) -> Result<Option<String>, serde_json::Error> {
        Ok(None)
    }

    /// Estimates the cost from short runs; none where it cannot.
    fn forecast(&self, cancel: &AtomicBool) -> Option<Forecast>;

    /// Computes the result; kinds with files write them into `folder`.
    fn run(
        &self,
        folder: &Path,
        progress: &ProgressMeter,
        cancel: &AtomicBool,
    ) -> Result<Finished, Failure>;
}

/// The result of a job.
pub(in crate::lab) struct Finished {
    /// JSON as the command of that name prints it.
    pub json: String,
    /// What is stored of a fit beside its report.
    pub fit: Option<FinishedFit>,
}

impl Finished {
    /// A result that is stored as JSON.
    pub(in crate::lab) fn new(result: &impl Serialize) -> Result<Self, Failure> {
        let json = serde_json::to_string(result).map_err(Failure::not_json)?;
        Ok(Finished { json, fit: None })
    }

    /// The result of a fit.
    pub(in crate::lab) fn with_fit(self, fit: FinishedFit) -> Self {
        Finished {
            fit: Some(fit),
            ..self
        }
    }
}

/// What is stored of a finished fit beside its report.
pub(in crate::lab) struct FinishedFit {
    pub scan_id: i64,
    pub last_frame_id: i64,
    pub observations: ObservationSet,
    pub variant: String,
    pub status: String,
    pub theta_r_deg: Option<ShortValue>,
}

/// Reports the progress of an analysis.
pub(in crate::lab) fn report_analysis(meter: &ProgressMeter, progress: analysis::Progress) {
    match progress {
        analysis::Progress::Reducing { done, total } => {
            meter.report("reading frames", done as u64, total as u64);
        }
        analysis::Progress::Fitting => meter.report("fitting", 0, 1),
        analysis::Progress::Tracing { done, total } => meter.report("tracing", done, total),
    }
}

/// Returns the word that serde writes for a unit variant.
pub(in crate::lab) fn word<T: Serialize>(value: &T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => word,
        _ => String::new(),
    }
}
