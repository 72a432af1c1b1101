//! The controllers that belong to the rig: pinned at the first connection, accepted by a person when they change.

use std::sync::{Arc, Mutex};

use crate::bench::stage::{StageIdentity, StageNotice};
use crate::lab::event_sink::EventSink;
use crate::lab::{Lab, LabError};
use crate::scan::{Event, StageAccess};
use crate::store::stages::{RigStages, StagesOrigin};
use crate::store::{Store, StoreError};

/// The controllers of the rig, in the store and in memory.
#[derive(Clone)]
pub(in crate::lab) struct PinnedStages {
    rig_id: i64,
    access: StageAccess,
    sink: EventSink,
    /// Whether the settings state the serial numbers of both controllers.
    are_stated: bool,
    /// Whether the controllers were known before the first connection of these settings.
    are_inherited: bool,
    /// Number of the row; none before the first connection.
    row: Arc<Mutex<Option<i64>>>,
}

impl PinnedStages {
    /// Reads the controllers of a rig. A rig whose settings changed keeps those of the same port addresses.
    pub(in crate::lab) async fn read(
        rig_id: i64,
        settings: &serde_json::Value,
        access: StageAccess,
        sink: EventSink,
    ) -> Result<PinnedStages, StoreError> {
        let own = sink.store.rig_stages(rig_id).await?;
        let known = match &own {
            Some(own) => Some(own.clone()),
            None => of_the_rig_before(&sink.store, settings).await?,
        };
        access.expect(known.as_ref().map(identity_of).transpose()?);
        let is_stated = |axis: &str| {
            let serial = settings.pointer(&format!("/stages/{axis}/serial"));
            serial.is_some_and(serde_json::Value::is_u64)
        };
        Ok(PinnedStages {
            rig_id,
            access,
            sink,
            are_stated: is_stated("theta_c") && is_stated("phi_s"),
            are_inherited: known.is_some(),
            row: Arc::new(Mutex::new(own.map(|own| own.id))),
        })
    }

    fn row(&self) -> Option<i64> {
        *self.row.lock().expect("no holder of this lock panics")
    }

    fn set_row(&self, id: i64) {
        *self.row.lock().expect("no holder of this lock panics") = Some(id);
    }

    /// Stores the controllers that answered at the first connection.
    pub(in crate::lab) async fn pin(&self, found: &StageIdentity) -> Result<i64, StoreError> {
        if let Some(id) = self.row() {
            return Ok(id);
        }
        let origin = StagesOrigin::FirstConnection;
        let identity = text_of(found)?;
        let id = self
            .sink
            .store
            .add_rig_stages(self.rig_id, &identity, origin)
            .await?;
        self.set_row(id);
        if !self.are_stated && !self.are_inherited {
            let alarm = Event::Alarm {
                code: "stages-pinned".into(),
                message: format!(
                    "the controllers of this first connection belong to the rig from now on ({found}), and others will be \
                     refused: move each axis once and check that it is the right one, or state serial in [stage.theta_c] and \
                     [stage.phi_s]"
                ),
                scan_id: None,
            };
            self.sink.record(alarm).await;
        }
        Ok(id)
    }

    /// Notes the controllers with which a scan begins or continues, and tells if they are others than before.
    pub(in crate::lab) async fn note_scan(
        &self,
        scan_id: i64,
        found: &StageIdentity,
    ) -> Result<(), StoreError> {
        let id = self.pin(found).await?;
        let Some(before) = self.sink.store.note_scan_stages(scan_id, id).await? else {
            return Ok(());
        };
        let before = identity_of(&before)?;
        if !before.is_same(found) {
            self.sink
                .record(Event::Alarm {
                    code: "stages-changed".into(),
                    message: format!(
                        "scan {scan_id} continues with other controllers than it began with ({found} instead of {before}), \
                         which a person has accepted"
                    ),
                    scan_id: Some(scan_id),
                })
                .await;
        }
        Ok(())
    }

    /// Accepts controllers that were refused, if they are those with these serial numbers.
    async fn accept(&self, serials: [u32; 2]) -> Result<StageIdentity, LabError> {
        let is_asked =
            |found: &StageIdentity| [found.theta_c.serial, found.phi_s.serial] == serials;
        let Some(found) = self.access.refused() else {
            return match self.access.stage().map(|stage| stage.identity()) {
                Some(own) if is_asked(&own) => Ok(own),
                own => Err(LabError::OtherStagesAnswer {
                    found: own.map(|own| own.to_string()),
                }),
            };
        };
        if !is_asked(&found) {
            return Err(LabError::OtherStagesAnswer {
                found: Some(found.to_string()),
            });
        }
        let identity = text_of(&found)?;
        let store = &self.sink.store;
        let id = store
            .add_rig_stages(self.rig_id, &identity, StagesOrigin::Accepted)
            .await?;
        self.set_row(id);
        self.access.expect(Some(found.clone()));
        self.sink
            .record(Event::Alarm {
                code: "stages-accepted".into(),
                message: format!(
                    "a person accepted other controllers for this rig: {found}. Home both axes and check the zero of each \
                     angle before you measure"
                ),
                scan_id: None,
            })
            .await;
        Ok(found)
    }
}

/// Returns the controllers of the last rig of this store, if it has the same addresses and is no other simulation.
async fn of_the_rig_before(
    store: &Store,
    settings: &serde_json::Value,
) -> Result<Option<RigStages>, StoreError> {
    let Some(newest) = store.newest_stages().await? else {
        return Ok(None);
    };
    let then = store.rig_settings(newest.rig_id).await?;
    let then: serde_json::Value =
        serde_json::from_str(&then).map_err(|e| StoreError::bad_row("rigs", e))?;
    let same = |path: &str| then.pointer(path) == settings.pointer(path);
    let is_same_rig = [
        "/label",
        "/stages/theta_c/address",
        "/stages/theta_c/axis",
        "/stages/phi_s/address",
        "/stages/phi_s/axis",
    ]
    .into_iter()
    .all(same);
    Ok(is_same_rig.then_some(newest))
}

pub(in crate::lab) fn identity_of(row: &RigStages) -> Result<StageIdentity, StoreError> {
    serde_json::from_str(&row.identity).map_err(|e| StoreError::bad_row("rig_stages", e))
}

fn text_of(identity: &StageIdentity) -> Result<String, StoreError> {
    serde_json::to_string(identity).map_err(|e| StoreError::bad_row("rig_stages", e))
}

/// Records what the stages report beside their errors, as alarms, until the rig is gone.
pub(in crate::lab) async fn record_notices(
    mut notices: tokio::sync::broadcast::Receiver<StageNotice>,
    sink: EventSink,
    scan_now: impl Fn() -> Option<i64>,
) {
    use tokio::sync::broadcast::error::RecvError;
    loop {
        match notices.recv().await {
            Ok(StageNotice { code, message }) => {
                let scan_id = scan_now();
                sink.record(Event::Alarm {
                    code: code.into(),
                    message,
                    scan_id,
                })
                .await;
            }
            // The older ones are in the log.
            Err(RecvError::Lagged(_)) => {}
            Err(RecvError::Closed) => return,
        }
    }
}

impl Lab {
    /// Accepts the controllers with these serial numbers (θc, φs), which answer instead of those of the rig. A scan that
    /// waits may then be resumed with them.
    ///
    /// # Errors
    /// [`LabError::OtherStagesAnswer`] if others answer, [`LabError::NoRig`], or a store error.
    pub async fn accept_stages(&self, serials: [u32; 2]) -> Result<StageIdentity, LabError> {
        let side = self.side()?;
        if side.access.stage().is_none() && side.access.refused().is_none() {
            // To learn who answers; a refusal is what this is about.
            self.have_rig().await.ok();
        }
        let accepted = side.pinned.accept(serials).await?;
        let scan_id = side.occupation.borrow().scan_id;
        if let Some(scan_id) = scan_id {
            side.pinned.note_scan(scan_id, &accepted).await?;
        }
        Ok(accepted)
    }
}
