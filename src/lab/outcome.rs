//! What followed a completed scan: its fits, and the verdicts against its specification.

use super::scans::fit_at_end::{FIT_NOT_STARTED, NOT_JUDGED};
use super::scans::incidents::incidents;
use super::{Lab, LabError, VerdictRequest};
use crate::job::{JobKind, JobState};
use crate::scan::IncidentKind;
use crate::store::jobs::{Job, JobFilter};
use crate::store::{PageRequest, StoreError};

/// What followed a completed scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    /// Its fits, newest first.
    pub fits: Vec<Job>,
    /// Its verdicts, newest first.
    pub verdicts: Vec<Job>,
    /// Whether all that follows by itself has ended.
    pub over: bool,
}

impl Outcome {
    /// The word of the newest completed verdict, and the name of its specification.
    ///
    /// # Errors
    /// A stored verdict that cannot be read.
    pub fn verdict(&self) -> Result<Option<(String, String)>, StoreError> {
        let newest = self.verdicts.iter().find_map(|job| job.result.as_ref());
        let Some(result) = newest else {
            return Ok(None);
        };
        let result: serde_json::Value =
            serde_json::from_str(result).map_err(|e| StoreError::bad_row("job_ends", e))?;
        let word = |key: &str| result[key].as_str().map(str::to_owned);
        Ok(word("verdict").zip(word("specification")))
    }

    /// Whether a fit is completed and has no verdict, not even a failed one.
    pub(super) fn awaits_verdict(&self, fit: &Job) -> bool {
        let is_on_it = |verdict: &Job| {
            serde_json::from_str::<VerdictRequest>(&verdict.request)
                .is_ok_and(|made| made.fit_id == Some(fit.number))
        };
        let mut others = self
            .verdicts
            .iter()
            .filter(|verdict| verdict.state != JobState::Interrupted);
        fit.state == JobState::Completed && !others.any(is_on_it)
    }
}

impl Lab {
    /// Returns what followed a completed scan so far.
    ///
    /// # Errors
    /// An unknown scan, or a store error.
    pub async fn outcome(&self, scan_id: i64) -> Result<Outcome, LabError> {
        let store = self.store();
        let of_scan = JobFilter {
            scan_id: Some(scan_id),
            ..JobFilter::default()
        };
        let page = PageRequest {
            limit: 1000,
            cursor: None,
        };
        let jobs = async |kind| Ok::<_, LabError>(store.jobs(kind, &of_scan, page).await?.items);
        let (fits, verdicts) = (jobs(JobKind::Fit).await?, jobs(JobKind::Verdict).await?);
        let judged = store.scan(scan_id).await?.specification.is_some();
        let ended = |jobs: &[Job]| jobs.iter().all(|job| job.state != JobState::Running);
        let completed = fits.iter().filter(|fit| fit.state == JobState::Completed);
        let all_there = !fits.is_empty() && (!judged || verdicts.len() >= completed.count());
        let over = (all_there && ended(&fits) && ended(&verdicts)) || self.gave_up(scan_id).await?;
        Ok(Outcome {
            fits,
            verdicts,
            over,
        })
    }

    /// Whether an alarm says that no fit or no verdict follows.
    pub(super) async fn gave_up(&self, scan_id: i64) -> Result<bool, LabError> {
        let incidents = incidents(self.store(), scan_id).await?;
        Ok(incidents.iter().any(|incident| {
            incident.kind == IncidentKind::Alarm
                && [FIT_NOT_STARTED, NOT_JUDGED].contains(&incident.code.as_str())
        }))
    }

    /// Waits until all that follows a completed scan by itself has ended.
    ///
    /// # Errors
    /// As [`Lab::outcome`].
    pub async fn until_judged(&self, scan_id: i64) -> Result<Outcome, LabError> {
        let mut events = self.events();
        loop {
            let outcome = self.outcome(scan_id).await?;
            if outcome.over {
                return Ok(outcome);
            }
            // Any event wakes this; the store has the jobs.
            events.recv().await.ok();
        }
    }
}
