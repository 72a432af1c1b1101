//! Where the owner of the rig reports what happens: each event is recorded in the store and then sent to all listeners.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard};

use tokio::sync::{broadcast, oneshot, watch};

use super::tell;
use crate::clock::Clock;
use crate::scan::runner::RunEnd;
use crate::scan::{Event, RecordedEvent, ScanState};
use crate::store::{Store, StoreError};

/// Answered with the first state that a run came to, or why not even that could be recorded.
pub(super) type FirstState = oneshot::Sender<Result<ScanState, StoreError>>;

/// Where the rig's owner reports what happens: the store, then the events, then who waits for the end of a run.
#[derive(Clone)]
pub(super) struct EventSink {
    pub store: Store,
    pub clock: Arc<dyn Clock>,
    pub events: broadcast::Sender<Arc<RecordedEvent>>,
    pub ends: watch::Sender<HashMap<i64, RunEnd>>,
    pub adrift: Adrift,
}

/// Scans that nobody runs any more and whose state still says otherwise, because it could not be written; each with
/// the reason why it ended.
#[derive(Clone, Default)]
pub(super) struct Adrift {
    scans: Arc<Mutex<HashMap<i64, String>>>,
    /// Who brings one in does so alone: it may be resumed a moment later.
    turn: Arc<tokio::sync::Mutex<()>>,
}

impl Adrift {
    pub(super) fn all(&self) -> MutexGuard<'_, HashMap<i64, String>> {
        self.scans.lock().expect("no holder of this lock panics")
    }

    /// Those that are adrift now, and why.
    pub(super) fn now(&self) -> HashMap<i64, String> {
        self.all().clone()
    }

    /// Why a scan is adrift; none where it is not.
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
            Ok(event) => tell(&self.events, event),
            Err(error) => tracing::error!(%error, "an event could not be recorded: {error}"),
        }
    }

    /// Marks a scan that is adrift as interrupted, so that it can be resumed or aborted; nothing where it is not.
    pub(super) async fn bring_in(&self, scan_id: i64) -> Result<(), StoreError> {
        let _turn = self.adrift.turn.lock().await;
        let Some(reason) = self.adrift.why(scan_id) else {
            return Ok(());
        };
        let state = ScanState::Interrupted;
        let progress = self.store.last_progress(scan_id).await.unwrap_or_default();
        let written = self
            .store
            .change_state(scan_id, state, Some(&reason), None, progress)
            .await;
        match written {
            Ok(event) => tell(&self.events, event),
            // It had come to an end before, or somebody else was faster.
            Err(StoreError::StateConflict { .. }) => {}
            Err(error) => return Err(error),
        }
        self.adrift.all().remove(&scan_id);
        Ok(())
    }
}
