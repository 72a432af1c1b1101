//! Fits a scan of the rig once it is completed (setting `scan.fit_at_end`).

use std::collections::HashSet;
use std::sync::{Arc, Weak};

use super::{FitRequest, Inner, Lab, LabError, StoredSeries, event_sink};
use crate::access::DAEMON;
use crate::reduction::FrameSource;
use crate::scan::{Event, ScanState};

/// Code of the alarm about a completed scan whose fit did not start.
pub const FIT_NOT_STARTED: &str = "fit-not-started";

/// Starts the task that fits completed scans, if the settings ask for it. The task ends with the lab.
pub(super) fn start(lab: &Lab) {
    let wanted = lab
        .inner
        .rig
        .as_ref()
        .is_some_and(|side| side.settings.fit_at_end);
    if wanted {
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
                    let Some(lab) = alive(&inner) else { return };
                    if let Some(state) = lab.end_of(scan_id).await {
                        over.insert(scan_id);
                        if state == ScanState::Completed {
                            lab.fit_completed(scan_id).await;
                        }
                    }
                }
            }
        });
    }
}

fn alive(inner: &Weak<Inner>) -> Option<Lab> {
    let inner = inner.upgrade()?;
    Some(Lab {
        inner,
        who: DAEMON.into(),
    })
}

impl Lab {
    /// The final state of a scan; none if it can be resumed.
    async fn end_of(&self, scan_id: i64) -> Option<ScanState> {
        let state = self.store().scan(scan_id).await.ok()?.state;
        state.is_end().then_some(state)
    }

    /// Starts a fit of each region of a scan, or an alarm that says why it cannot.
    pub(super) async fn fit_completed(&self, scan_id: i64) {
        if let Err(error) = self.start_fits(scan_id).await {
            let alarm = Event::Alarm {
                code: FIT_NOT_STARTED.into(),
                message: format!("scan {scan_id} is completed, but its fit did not start: {error}"),
                scan_id: Some(scan_id),
            };
            let inner = &self.inner;
            let clock = inner.clock.as_ref();
            event_sink::record(&inner.store, &inner.events, clock, alarm, None).await;
        }
    }

    async fn start_fits(&self, scan_id: i64) -> Result<(), LabError> {
        let plan = self.store().scan(scan_id).await?.plan;
        // A scan for calibrations only has no sample.
        if plan.is_some_and(|plan| plan.is_calibration()) {
            return Ok(());
        }
        let series = StoredSeries::open(self.store(), scan_id).await?;
        let regions = Lab::regions(series.manifest());
        let whole = regions.is_empty().then_some(None);
        for region in whole.into_iter().chain(regions.into_iter().map(Some)) {
            let request = FitRequest {
                scan_id,
                region,
                ..FitRequest::default()
            };
            self.start_job(request).await?;
        }
        Ok(())
    }
}
