//! The fit of a scan that a report, a comparison or a study takes.

use crate::fit::FitReport;
use crate::job::{JobId, JobKind, JobState};
use crate::lab::LabError;
use crate::scan::ScanState;
use crate::store::jobs::{Job, JobFilter};
use crate::store::scans::Scan;
use crate::store::{PageRequest, Store, StoreError};

/// Rows read at a time.
const ROWS: PageRequest = PageRequest {
    cursor: None,
    limit: 1000,
};

/// Which fit of a scan a report is on; the newest completed one by default.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ReportChoice {
    /// This fit.
    pub fit_id: Option<i64>,
    /// The newest one of this region.
    pub region: Option<String>,
}

/// Returns the fit, its result and the number of its observations.
///
/// # Errors
/// An unknown fit, a fit of another scan, [`LabError::NoReport`] without a completed fit, or a store error.
pub(in crate::lab) async fn chosen(
    store: &Store,
    scan: &Scan,
    choice: &ReportChoice,
) -> Result<(Job, FitReport, i64), LabError> {
    let invalid = |problem: String| LabError::Invalid {
        field: "fit_id".into(),
        problem,
    };
    let jobs = match choice.fit_id {
        Some(fit_id) => {
            let job = store.job(JobId::new(JobKind::Fit, fit_id)).await?;
            if job.scan_id != Some(scan.id) {
                let other = job.scan_id.unwrap_or_default();
                let problem = format!("fit {fit_id} is a fit of scan {other}, not of {}", scan.id);
                return Err(invalid(problem));
            }
            vec![job]
        }
        None => {
            let filter = JobFilter {
                scan_id: Some(scan.id),
                ..JobFilter::default()
            };
            store.jobs(JobKind::Fit, &filter, ROWS).await?.items
        }
    };
    let region = choice.region.as_deref();
    for job in &jobs {
        let (Some(result), Some(set_id)) = (&job.result, job.set_id) else {
            continue;
        };
        let result: FitReport =
            serde_json::from_str(result).map_err(|e| StoreError::bad_row("job_ends", e))?;
        if region.is_none() || result.region.as_deref() == region {
            return Ok((job.clone(), result, set_id));
        }
    }
    Err(LabError::NoReport {
        scan_id: scan.id,
        why: why_none(scan, &jobs, choice),
    })
}

/// States why a scan has no fit to report, and the way to one.
fn why_none(scan: &Scan, jobs: &[Job], choice: &ReportChoice) -> String {
    let fit_it = format!(
        "fit it with `ridged fit --scan {} --store`, on its page, or with POST /api/v1/fits",
        scan.id
    );
    if let Some(running) = jobs.iter().find(|job| job.state == JobState::Running) {
        return format!("fit {} is running; wait for its end", running.number);
    }
    if let (Some(region), true) = (&choice.region, jobs.iter().any(|job| job.result.is_some())) {
        return format!("it has no completed fit of the region `{region}`; {fit_it}");
    }
    if let Some(failed) = jobs.iter().find(|job| job.error_detail.is_some()) {
        let detail = failed.error_detail.as_deref().unwrap_or_default();
        return format!("fit {} failed ({detail}); {fit_it}", failed.number);
    }
    match scan.state {
        state if state.is_end() || state == ScanState::Interrupted => {
            format!("it has no completed fit; {fit_it}")
        }
        state => format!("it is {state} and has no fit; wait for its end"),
    }
}
