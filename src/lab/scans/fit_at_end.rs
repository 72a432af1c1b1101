//! Fits a scan of the rig once it is completed (setting `scan.fit_at_end`, or a recipe), and judges it against its
//! specification. After a restart the daemon starts what it was ended before.

use std::collections::HashSet;
use std::sync::Arc;

use super::recipes::{Recipe, RecipeFit};
use crate::access::DAEMON;
use crate::job::{JobId, JobState};
use crate::lab::{FitRequest, Lab, LabError, StoredSeries, VerdictRequest};
use crate::reduction::FrameSource;
use crate::scan::ScanState;
use crate::store::PageRequest;
use crate::store::definitions::{Definition, DefinitionKind, DefinitionRef, Wanted};
use crate::store::jobs::Job;
use crate::store::scans::{Origin, Scan, ScanFilter};

/// Code of the alarm about a completed scan whose fit did not start.
pub const FIT_NOT_STARTED: &str = "fit-not-started";
/// Code of the alarm about a completed scan that could not be judged against its specification.
pub const NOT_JUDGED: &str = "not-judged";

/// Completed scans that a new daemon examines for a missing fit or verdict, newest first.
const EXAMINED: u32 = 20;

/// Starts the task that fits and judges completed scans. The task ends with the lab.
pub(in crate::lab) fn start(lab: &Lab) {
    if lab.inner.rig.is_some() {
        let mut ends = lab.inner.ends.subscribe();
        let inner = Arc::downgrade(&lab.inner);
        tokio::spawn(async move {
            if let Some(lab) = Lab::of_daemon(&inner)
                && let Err(error) = lab.catch_up().await
            {
                tracing::warn!(%error, "the last scans were not examined for missing fits and verdicts");
            }
            let mut over = HashSet::new();
            while ends.changed().await.is_ok() {
                let ended: Vec<i64> = ends.borrow_and_update().keys().copied().collect();
                for scan_id in ended {
                    if over.contains(&scan_id) {
                        continue;
                    }
                    let Some(lab) = Lab::of_daemon(&inner) else {
                        return;
                    };
                    if let Some(state) = lab.end_of(scan_id).await {
                        over.insert(scan_id);
                        if state == ScanState::Completed {
                            lab.follow(scan_id).await;
                        }
                    }
                }
            }
        });
    }
}

impl Lab {
    /// The final state of a scan; none if it can be resumed.
    async fn end_of(&self, scan_id: i64) -> Option<ScanState> {
        let state = self.store().scan(scan_id).await.ok()?.state;
        state.is_end().then_some(state)
    }

    /// Fits a completed scan if the settings say so, or if its recipe or specification needs a fit.
    async fn follow(&self, scan_id: i64) {
        let is_fitted = match self.store().scan(scan_id).await {
            Ok(scan) => self.is_fitted_at_end(&scan),
            // The fit states the error of the store.
            Err(_) => true,
        };
        if is_fitted {
            self.fit_completed(scan_id).await;
        }
    }

    fn is_fitted_at_end(&self, scan: &Scan) -> bool {
        let by_setting = self.side().is_ok_and(|side| side.settings.fit_at_end);
        by_setting || scan.recipe.is_some() || scan.specification.is_some()
    }

    /// Starts what follows a completed scan by the setting `scan.fit_at_end`, also in a process without a daemon.
    pub async fn fit_at_end(&self, scan_id: i64) {
        if let Some(lab) = Lab::of_daemon(&Arc::downgrade(&self.inner)) {
            lab.fit_completed(scan_id).await;
        }
    }

    /// Starts a fit of each region of a scan, or an alarm that says why it cannot.
    pub(in crate::lab) async fn fit_completed(&self, scan_id: i64) {
        if let Err(error) = self.start_fits(scan_id).await {
            let message =
                format!("scan {scan_id} is completed, but its fit did not start: {error}");
            self.alarm(FIT_NOT_STARTED, message, Some(scan_id)).await;
        }
    }

    /// Starts the fits and verdicts that the last daemon was ended before: of the newest completed scans of the rig, back to
    /// the first that has all of them.
    async fn catch_up(&self) -> Result<(), LabError> {
        let completed = ScanFilter {
            state: Some(ScanState::Completed),
            ..ScanFilter::default()
        };
        let newest = PageRequest {
            limit: EXAMINED,
            cursor: None,
        };
        let scans = self.store().scans(completed, newest).await?.items;
        for scan in scans.iter().filter(|scan| self.is_followed(scan)) {
            if !self.catch_up_with(scan).await? {
                break;
            }
        }
        Ok(())
    }

    /// Whether fits follow a completed scan: one of this rig that has a sample, which an imported series and a scan for
    /// calibrations have not.
    fn is_followed(&self, scan: &Scan) -> bool {
        let of_sample = scan
            .plan
            .as_ref()
            .is_some_and(|plan| !plan.is_calibration());
        scan.origin == Origin::Rig && of_sample && self.is_fitted_at_end(scan)
    }

    /// Starts what a scan lacks; false where it lacks nothing. An alarm has said why nothing follows a scan that was given up.
    async fn catch_up_with(&self, scan: &Scan) -> Result<bool, LabError> {
        if self.gave_up(scan.id).await? {
            return Ok(true);
        }
        let outcome = self.outcome(scan.id).await?;
        // A fit that a person asked for is not repeated, and stands for no fit that follows by itself.
        let own: Vec<&Job> = outcome
            .fits
            .iter()
            .filter(|fit| fit.who == DAEMON)
            .collect();
        if own.is_empty() && !outcome.fits.is_empty() {
            return Ok(false);
        }
        let mut lacks = false;
        for request in self.requests_at_end(scan).await? {
            let newest = own.iter().find(|fit| {
                serde_json::from_str::<FitRequest>(&fit.request)
                    .is_ok_and(|made| made.region == request.region)
            });
            let fit_id = match newest {
                None => self.start_job(request).await?,
                Some(fit) if fit.state == JobState::Interrupted => self.start_job(request).await?,
                Some(fit) if scan.specification.is_some() && outcome.awaits_verdict(fit) => {
                    fit.id()
                }
                Some(_) => continue,
            };
            self.judge_once_fitted(scan, fit_id);
            lacks = true;
        }
        Ok(lacks)
    }

    /// Reads the version that a scan refers to.
    async fn used(
        &self,
        kind: DefinitionKind,
        used: &DefinitionRef,
    ) -> Result<Definition, LabError> {
        let store = self.store();
        let version = Wanted::Version(used.version);
        Ok(store.definition(kind, used.id, version).await?)
    }

    /// Returns the recipe of a scan, in the version that it was started with; none for a scan of a plan.
    ///
    /// # Errors
    /// A store error, or a stored recipe that this program cannot read.
    pub async fn recipe_of(&self, scan: &Scan) -> Result<Option<Recipe>, LabError> {
        let Some(used) = &scan.recipe else {
            return Ok(None);
        };
        let used = self.used(DefinitionKind::Recipe, used).await?;
        Recipe::of_content(&used.content).map(Some)
    }

    async fn start_fits(&self, scan_id: i64) -> Result<(), LabError> {
        let scan = self.store().scan(scan_id).await?;
        for request in self.requests_at_end(&scan).await? {
            let fit_id = self.start_job(request).await?;
            self.judge_once_fitted(&scan, fit_id);
        }
        Ok(())
    }

    /// The fits that follow a scan: one for each region.
    async fn requests_at_end(&self, scan: &Scan) -> Result<Vec<FitRequest>, LabError> {
        // A scan for calibrations only has no sample.
        if scan.plan.as_ref().is_some_and(|plan| plan.is_calibration()) {
            return Ok(Vec::new());
        }
        let fit = match self.recipe_of(scan).await? {
            Some(recipe) => recipe.fit,
            None => RecipeFit::default(),
        };
        let series = StoredSeries::open(self.store(), scan.id).await?;
        let regions = Lab::regions(series.manifest());
        let regions: Vec<Option<String>> = match (&fit.region, regions.is_empty()) {
            (Some(region), _) => vec![Some(region.clone())],
            (None, true) => vec![None],
            (None, false) => regions.into_iter().map(Some).collect(),
        };
        let requests = regions.into_iter();
        Ok(requests
            .map(|region| fit.request(scan.id, region))
            .collect())
    }

    /// Judges a fit against the specification of its scan, if there is one, as soon as the fit is completed.
    fn judge_once_fitted(&self, scan: &Scan, fit_id: JobId) {
        if let Some(used) = scan.specification.clone() {
            let (lab, scan_id) = (self.clone(), scan.id);
            tokio::spawn(async move {
                if let Err(why) = lab.judge_fit(scan_id, fit_id, &used).await {
                    let message = format!("scan {scan_id} is not judged: {why}");
                    lab.alarm(NOT_JUDGED, message, Some(scan_id)).await;
                }
            });
        }
    }

    /// Waits for the end of a fit and judges its result against a specification.
    async fn judge_fit(
        &self,
        scan_id: i64,
        fit_id: JobId,
        used: &DefinitionRef,
    ) -> Result<(), LabError> {
        if self.end_of_job(fit_id).await? != JobState::Completed {
            // The fit's own row states why.
            return Ok(());
        }
        let used = self.used(DefinitionKind::Specification, used).await?;
        let request = VerdictRequest {
            scan_id,
            specification: used.content,
            fit_id: Some(fit_id.number),
            ..VerdictRequest::default()
        };
        self.start_job(request).await?;
        Ok(())
    }

    /// Waits until a job has ended.
    ///
    /// # Errors
    /// An unknown job, or a store error.
    pub async fn end_of_job(&self, id: JobId) -> Result<JobState, LabError> {
        let mut events = self.events();
        loop {
            let state = self.store().job(id).await?.state;
            if state != JobState::Running {
                return Ok(state);
            }
            // Any event wakes this; the store has the state.
            events.recv().await.ok();
        }
    }
}
