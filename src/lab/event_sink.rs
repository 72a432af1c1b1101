//! Where the owner of the rig reports what happens: each event is recorded in the store and then sent to all listeners.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard};

use tokio::sync::{broadcast, oneshot, watch};

use super::publish;
use crate::clock::Clock;
use crate::scan::runner::RunEnd;
use crate::scan::{Event, RecordedEvent, ScanState};
use crate::store::{Store, StoreError};

/// Gets the first state of a run, or the reason it could not be recorded.
pub(super) type FirstState = oneshot::Sender<Result<ScanState, StoreError>>;

/// The store, the listeners, and the ends of runs.
#[derive(Clone)]
pub(super) struct EventSink {
    pub store: Store,
    pub clock: Arc<dyn Clock>,
    pub events: broadcast::Sender<Arc<RecordedEvent>>,
    pub ends: watch::Sender<HashMap<i64, RunEnd>>,
    pub unrecorded: UnrecordedScans,
}

/// Scans that have ended but whose end could not be written, each with the reason it ended.
#[derive(Clone, Default)]
pub(super) struct UnrecordedScans {
    scans: Arc<Mutex<HashMap<i64, String>>>,
    /// One writer at a time: a scan may be resumed a moment later.
    turn: Arc<tokio::sync::Mutex<()>>,
}

impl UnrecordedScans {
    pub(super) fn all(&self) -> MutexGuard<'_, HashMap<i64, String>> {
        self.scans.lock().expect("no holder of this lock panics")
    }

    /// Returns all of them with their reasons.
    pub(super) fn now(&self) -> HashMap<i64, String> {
        self.all().clone()
    }

    /// Returns the reason of one; none if its end is recorded.
    pub(super) fn why(&self, scan_id: i64) -> Option<String> {
        self.all().get(&scan_id).cloned()
    }

    pub(super) fn has(&self, scan_id: i64) -> bool {
        self.all().contains_key(&scan_id)
    }
}

impl EventSink {
    /// Records an event, then sends it to all listeners.
    pub(super) async fn record(&self, event: Event) {
        match self.store.record(event).await {
            Ok(event) => publish(&self.events, event),
            Err(error) => tracing::error!(%error, "an event could not be recorded: {error}"),
        }
    }

    /// Marks a scan whose end is unrecorded as interrupted, so that it can be resumed or aborted. No effect on others.
    pub(super) async fn record_end_of(&self, scan_id: i64) -> Result<(), StoreError> {
        let _turn = self.unrecorded.turn.lock().await;
        let Some(reason) = self.unrecorded.why(scan_id) else {
            return Ok(());
        };
        let state = ScanState::Interrupted;
        let progress = self.store.last_progress(scan_id).await.unwrap_or_default();
        let written = self
            .store
            .change_state(scan_id, state, Some(&reason), None, progress)
            .await;
        match written {
            Ok(event) => publish(&self.events, event),
            // It has ended before, or another task was faster.
            Err(StoreError::StateConflict { .. }) => {}
            Err(error) => return Err(error),
        }
        self.unrecorded.all().remove(&scan_id);
        Ok(())
    }
}
