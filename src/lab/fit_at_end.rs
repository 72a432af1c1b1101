//! Fits a scan of the rig once it is completed (setting `scan.fit_at_end`, or a recipe), and judges it against its
//! specification.

use std::collections::HashSet;
use std::sync::Arc;

use super::recipes::{Recipe, RecipeFit};
use super::{Lab, LabError, StoredSeries, VerdictRequest};
use crate::job::{JobId, JobState};
use crate::reduction::FrameSource;
use crate::scan::ScanState;
use crate::store::definitions::{Definition, DefinitionKind, DefinitionRef, Wanted};
use crate::store::scans::Scan;

/// Code of the alarm about a completed scan whose fit did not start.
pub const FIT_NOT_STARTED: &str = "fit-not-started";
/// Code of the alarm about a completed scan that could not be judged against its specification.
pub const NOT_JUDGED: &str = "not-judged";

/// Starts the task that fits and judges completed scans. The task ends with the lab.
pub(super) fn start(lab: &Lab) {
    if lab.inner.rig.is_some() {
        let mut ends = lab.inner.ends.subscribe();
        let inner = Arc::downgrade(&lab.inner);
        tokio::spawn(async move {
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
                        if state == ScanState::Completed && lab.is_fitted_at_end(scan_id).await {
                            lab.fit_completed(scan_id).await;
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

    /// Whether a scan is fitted without a request: by the settings, or because its recipe or specification needs a fit.
    async fn is_fitted_at_end(&self, scan_id: i64) -> bool {
        let by_setting = self.side().is_ok_and(|side| side.settings.fit_at_end);
        match self.store().scan(scan_id).await {
            Ok(scan) => by_setting || scan.recipe.is_some() || scan.specification.is_some(),
            Err(_) => by_setting,
        }
    }

    /// Starts a fit of each region of a scan, or an alarm that says why it cannot.
    pub(super) async fn fit_completed(&self, scan_id: i64) {
        if let Err(error) = self.start_fits(scan_id).await {
            let message =
                format!("scan {scan_id} is completed, but its fit did not start: {error}");
            self.alarm(FIT_NOT_STARTED, message, Some(scan_id)).await;
        }
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
        // A scan for calibrations only has no sample.
        if scan.plan.as_ref().is_some_and(|plan| plan.is_calibration()) {
            return Ok(());
        }
        let fit = match self.recipe_of(&scan).await? {
            Some(recipe) => recipe.fit,
            None => RecipeFit::default(),
        };
        let series = StoredSeries::open(self.store(), scan_id).await?;
        let regions = Lab::regions(series.manifest());
        let regions: Vec<Option<String>> = match (&fit.region, regions.is_empty()) {
            (Some(region), _) => vec![Some(region.clone())],
            (None, true) => vec![None],
            (None, false) => regions.into_iter().map(Some).collect(),
        };
        for region in regions {
            let fit_id = self.start_job(fit.request(scan_id, region)).await?;
            if let Some(used) = scan.specification.clone() {
                let lab = self.clone();
                tokio::spawn(async move {
                    if let Err(why) = lab.judge_fit(scan_id, fit_id, &used).await {
                        let message = format!("scan {scan_id} is not judged: {why}");
                        lab.alarm(NOT_JUDGED, message, Some(scan_id)).await;
                    }
                });
            }
        }
        Ok(())
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
