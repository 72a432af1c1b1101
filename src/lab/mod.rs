//! The daemon's verbs. Owns the bench, is the only writer of the store, broadcasts events.
//!
//! [`Lab::open`] starts it, [`Lab::shut_down`] ends it with the rig stopped. One task owns stages
//! and camera (`bench`); everybody else sends it a request and is told at once whether it was taken
//! up. Stopping the stages goes past that task, so it is never refused. What page, command line and
//! log show comes from the store and from [`Lab::events`]; nobody asks the runner. The lab knows no
//! HTTP and no simulator.

mod again;
mod along;
mod attached;
mod bench;
mod calculations;
mod curves;
mod error;
mod event_sink;
mod failure;
mod fits;
mod foretell;
mod headway;
pub mod measured;
mod once;
mod plans;
mod recorder;
mod request_checks;
mod rig;
mod series;
mod tasks;
mod traces;
mod turns;
mod under_way;
mod watched;

use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::{broadcast, mpsc, oneshot, watch};

use crate::bench::stage::{Stage, StageError, StageSettings};
use crate::clock::Clock;
use crate::scan::event::RigActivity;
use crate::scan::plan::PlanDefaults;
use crate::scan::runner::{Order, OrderSlip, RunEnd, RunnerSettings};
use crate::scan::{Event, Reach, RecordedEvent, Rig, ScanState};
use crate::series::{CameraFacts, FlatFacts, RigFacts};
use crate::store::disk::Disk;
use crate::store::scans::Scan;
use crate::store::{Recovery, Store, StoreError};

pub use crate::bench::stage::AxisName;
pub use again::Alike;
pub use calculations::{CalculationRequest, ContrastRequest, MapRequest, VerdictRequest};
pub use curves::{Curve, FitCurves};
pub use error::{Holder, LabError};
use fits::Reductions;
pub use fits::{FitRequest, Reduced};
pub use headway::Progress as CalculationProgress;
pub use plans::{Estimated, ScanRequest};
pub use rig::{AxisView, RigView};
pub use series::{Exported, ImportOptions, Imported, StoredSeries, export, export_readable};
pub use traces::TraceRequest;
use turns::AllTurns;
use under_way::AllUnderWay;

/// Space that imports leave alone where nobody says how much.
const RESERVE_BYTES: u64 = 200_000_000;

/// What the lab knows of its rig beside the devices themselves.
#[derive(Debug, Clone)]
pub struct RigSettings {
    /// `[rig]` of the manifests.
    pub rig: RigFacts,
    /// `[camera]` of the manifests.
    pub camera: CameraFacts,
    /// `[flat]` of the manifests.
    pub flat: FlatFacts,
    /// What a plan takes where it says nothing.
    pub defaults: PlanDefaults,
    /// How a scan deals with trouble.
    pub runner: RunnerSettings,
    /// How long dark frames are valid.
    pub dark_valid: Duration,
    /// How long white-reference frames are valid.
    pub flat_valid: Duration,
    /// Whether the rig is a simulated one, and how much faster than life.
    pub simulated: Option<f64>,
    /// Whatever else makes frames of two rigs incomparable (a simulated rig's seed).
    pub label: String,
}

/// A rig to be owned by the lab.
pub struct RigParts {
    /// Stages and camera.
    pub rig: Rig,
    /// Facts about them.
    pub settings: RigSettings,
}

/// The lab's handle; cheap to clone.
#[derive(Clone)]
pub struct Lab {
    inner: Arc<Inner>,
}

struct Inner {
    store: Store,
    clock: Arc<dyn Clock>,
    events: broadcast::Sender<Arc<RecordedEvent>>,
    rig: Option<RigSide>,
    fits: AllUnderWay,
    calculations: AllUnderWay,
    turns: AllTurns,
    /// Whoever estimates a scan does so alone: a large plan keeps a processor busy for seconds, and the stop needs one.
    estimating: Arc<tokio::sync::Mutex<()>>,
    /// Reductions for who only looks at observations.
    reductions: Reductions,
    /// Space that imports leave alone.
    reserve_bytes: AtomicU64,
    /// How scans of this process ended, for who waits for one.
    ends: watch::Sender<HashMap<i64, RunEnd>>,
}

/// What the lab keeps of the rig for those who do not own it.
struct RigSide {
    id: i64,
    settings: RigSettings,
    stage_settings: StageSettings,
    port: String,
    camera: String,
    stage: watch::Receiver<Option<Stage>>,
    requests: mpsc::Sender<bench::Request>,
    occupation: watch::Receiver<Occupation>,
    owner: Mutex<Option<tokio::task::JoinHandle<()>>>,
    reach: Reach,
    told: event_sink::EventSink,
}

/// What the rig is doing, for everybody to see.
#[derive(Debug, Clone, Default)]
struct Occupation {
    activity: Option<RigActivity>,
    scan_id: Option<i64>,
    orders: Option<mpsc::Sender<OrderSlip>>,
    /// Why the stages could not be had the last time they were asked for.
    problem: Option<(String, String)>,
    /// Why the last motion of one axis did not end where it should; none once another is begun.
    failure: Option<(String, String)>,
}

impl Lab {
    /// Opens the store in `folder` and takes the rig, if there is one. Nothing moves.
    ///
    /// # Errors
    /// What the store says.
    pub async fn open(
        folder: &Path,
        disk: Arc<dyn Disk>,
        clock: Arc<dyn Clock>,
        parts: Option<RigParts>,
    ) -> Result<(Lab, Recovery), StoreError> {
        let (store, recovery) = Store::open(folder, disk, Arc::clone(&clock)).await?;
        if !recovery.damaged.is_empty() {
            let message = format!(
                "{} frames are missing or damaged on disk, first {}; restore them from a copy of the data folder",
                recovery.damaged.len(),
                recovery.damaged[0]
            );
            tracing::error!("{message}");
            store
                .record(Event::Alarm {
                    code: "frame-damaged".into(),
                    message,
                    scan_id: None,
                })
                .await?;
        }
        let events = broadcast::Sender::new(1024);
        let ends = watch::Sender::new(HashMap::new());
        let reserve_bytes = match &parts {
            None => RESERVE_BYTES,
            Some(parts) => parts.settings.runner.disk_reserve_bytes,
        };
        let rig = match parts {
            None => None,
            Some(parts) => {
                let told = event_sink::EventSink {
                    store: store.clone(),
                    clock: Arc::clone(&clock),
                    events: events.clone(),
                    ends: ends.clone(),
                    adrift: event_sink::Adrift::default(),
                };
                Some(bench::take(parts, told).await?)
            }
        };
        let lab = Lab {
            inner: Arc::new(Inner {
                store,
                clock,
                events,
                rig,
                fits: AllUnderWay::default(),
                calculations: AllUnderWay::default(),
                turns: AllTurns::default(),
                estimating: Arc::default(),
                reductions: Reductions::default(),
                reserve_bytes: AtomicU64::new(reserve_bytes),
                ends,
            }),
        };
        Ok((lab, recovery))
    }

    /// How much space of the disk an import leaves alone; a scan has it from its rig's settings.
    pub fn keep_free(&self, bytes: u64) {
        self.inner.reserve_bytes.store(bytes, Ordering::Relaxed);
    }

    fn reserve_bytes(&self) -> u64 {
        self.inner.reserve_bytes.load(Ordering::Relaxed)
    }

    /// The store, for reading.
    #[must_use]
    pub fn store(&self) -> &Store {
        &self.inner.store
    }

    /// A kept scan as it stands: one that can be recorded no more is interrupted, whatever the store could keep of it.
    #[must_use]
    pub fn as_it_stands(&self, mut scan: Scan) -> Scan {
        if let Some(why) = self
            .inner
            .rig
            .as_ref()
            .and_then(|side| side.told.adrift.why(scan.id))
            && !scan.state.is_end()
        {
            scan.state = ScanState::Interrupted;
            scan.reason = Some(format!("it cannot be recorded: {why}"));
            scan.operator = None;
        }
        scan
    }

    /// Scans that can be recorded no more, and why.
    #[must_use]
    pub fn adrift(&self) -> HashMap<i64, String> {
        let side = self.inner.rig.as_ref();
        side.map_or_else(HashMap::new, |side| side.told.adrift.now())
    }

    /// Every event from now on; a listener that is too slow is told how many it missed and reads
    /// them from the store.
    #[must_use]
    pub fn events(&self) -> broadcast::Receiver<Arc<RecordedEvent>> {
        self.inner.events.subscribe()
    }

    /// The lab's time.
    #[must_use]
    pub fn clock(&self) -> &Arc<dyn Clock> {
        &self.inner.clock
    }

    fn tell(&self, event: RecordedEvent) {
        tell(&self.inner.events, event);
    }

    fn side(&self) -> Result<&RigSide, LabError> {
        self.inner.rig.as_ref().ok_or(LabError::NoRig)
    }

    /// Gives an order to a running scan, or resumes an interrupted one.
    ///
    /// # Errors
    /// [`LabError::NotNow`] if the scan cannot do that where it stands, [`LabError::AbortedInMotion`], or what the store
    /// says.
    pub async fn order(&self, scan_id: i64, order: Order) -> Result<ScanState, LabError> {
        let scan = self.inner.store.scan(scan_id).await?;
        let not_now = |state| LabError::NotNow {
            scan_id,
            state,
            asked: asked(order),
        };
        let occupation = match &self.inner.rig {
            Some(side) => side.occupation.borrow().clone(),
            None => Occupation::default(),
        };
        let orders = match occupation.orders {
            Some(orders) if occupation.scan_id == Some(scan_id) => orders,
            _ => return self.order_unheld(scan_id, order).await,
        };
        let permitted = match order {
            Order::Continue | Order::Done(_) => scan.state == ScanState::WaitingForOperator,
            Order::Resume => matches!(scan.state, ScanState::Paused | ScanState::Pausing),
            Order::Pause => matches!(
                scan.state,
                ScanState::Running | ScanState::WaitingForOperator
            ),
            Order::Abort | Order::Stop | Order::ShutDown => true,
        };
        if !permitted {
            return Err(not_now(match scan.state {
                // Somebody has just taken it up, and its row does not say so yet.
                ScanState::Interrupted => ScanState::Running,
                state => state,
            }));
        }
        let (reply, answer) = oneshot::channel();
        let sent = orders.send(OrderSlip { order, reply }).await;
        let side = self.side()?;
        let stopped = match order {
            // Homing and connecting do not listen to orders; the stage does.
            Order::Abort => side.reach.stop_what_may_move().await,
            _ => Ok(()),
        };
        let answer = match sent {
            Ok(()) => answer.await.ok(),
            Err(_) => None,
        };
        let state = match answer {
            Some(Ok(state)) => state,
            Some(Err(state)) => {
                return match (order, self.inner.store.scan(scan_id).await?.operator) {
                    (Order::Done(done), Some(waits_for)) if done != waits_for => {
                        Err(LabError::OtherStep {
                            scan_id,
                            done,
                            waits_for,
                        })
                    }
                    _ => Err(not_now(state)),
                };
            }
            // The scan ended before the order was read, or because what it led to could not be written.
            None => {
                let mut occupation = side.occupation.clone();
                let gone = occupation.wait_for(|now| now.scan_id != Some(scan_id));
                // An owner that is gone holds no scan either.
                gone.await.ok();
                if side.told.adrift.has(scan_id) {
                    return self.order_unheld(scan_id, order).await;
                }
                let state = self.inner.store.scan(scan_id).await?.state;
                if order != Order::Abort || state != ScanState::Aborted {
                    return Err(not_now(state));
                }
                state
            }
        };
        match stopped {
            Ok(()) => Ok(state),
            Err(source) => Err(LabError::AbortedInMotion { scan_id, source }),
        }
    }

    /// Gives an order to a scan that nobody runs.
    async fn order_unheld(&self, scan_id: i64, order: Order) -> Result<ScanState, LabError> {
        if let Some(side) = &self.inner.rig {
            side.told.bring_in(scan_id).await?;
        }
        let scan = self.inner.store.scan(scan_id).await?;
        match (order, scan.state) {
            (Order::Resume, ScanState::Interrupted) => self.resume(&scan).await,
            (Order::Abort, ScanState::Interrupted) => {
                let reason = Some("aborted by the operator");
                let progress = self.store().last_progress(scan_id).await?;
                let event = self
                    .inner
                    .store
                    .change_state(scan_id, ScanState::Aborted, reason, None, progress)
                    .await?;
                self.tell(event);
                Ok(ScanState::Aborted)
            }
            (_, state) => Err(LabError::NotNow {
                scan_id,
                state,
                asked: asked(order),
            }),
        }
    }

    /// Waits until a scan has ended or was interrupted, or until `enough` says so of one of its
    /// events after number `after`.
    ///
    /// # Errors
    /// What the store says.
    pub async fn wait_for_scan(
        &self,
        scan_id: i64,
        after: i64,
        mut enough: impl FnMut(&RecordedEvent) -> bool,
    ) -> Result<Scan, LabError> {
        let mut events = self.events();
        let mut last = after;
        loop {
            for event in self.inner.store.events_after(last, 1000).await? {
                last = event.id;
                if event.event.scan_id() == Some(scan_id) && enough(&event) {
                    return Ok(self.inner.store.scan(scan_id).await?);
                }
            }
            let scan = self.inner.store.scan(scan_id).await?;
            if scan.state.is_end() || scan.state == ScanState::Interrupted {
                return Ok(scan);
            }
            // Whatever wakes this, the store has the whole story.
            events.recv().await.ok();
        }
    }

    /// How a scan of this process ended, with its times.
    #[must_use]
    pub fn run_end(&self, scan_id: i64) -> Option<RunEnd> {
        self.inner.ends.borrow().get(&scan_id).copied()
    }

    /// Stops the rig, leaves a running scan interrupted and cancels fits and calculations; the store stays open for
    /// those who still look.
    ///
    /// # Errors
    /// The stages could not be reached, and may be moving; all else is done.
    pub async fn rest(&self) -> Result<(), StageError> {
        let mut stopped = Ok(());
        if let Some(side) = &self.inner.rig {
            let orders = side.occupation.borrow().orders.clone();
            if let Some(orders) = orders {
                let (reply, answer) = oneshot::channel();
                let slip = OrderSlip {
                    order: Order::ShutDown,
                    reply,
                };
                if orders.send(slip).await.is_ok() {
                    // Homing and connecting do not listen to orders; the stage does.
                    side.reach.stop_what_may_move().await.ok();
                    answer.await.ok();
                }
            }
            stopped = side.reach.stop_what_may_move().await;
            // First: an owner that is still held here when it ends has broken off.
            let owner = side
                .owner
                .lock()
                .expect("no holder of this lock panics")
                .take();
            self.request(bench::Work::End).await.ok();
            if let Some(owner) = owner {
                owner.await.ok();
            }
        }
        self.inner.fits.cancel_all().await;
        self.inner.calculations.cancel_all().await;
        stopped
    }

    /// [`Lab::rest`], then closes the store.
    pub async fn shut_down(&self) {
        // Stages that could not be stopped are in the log.
        self.rest().await.ok();
        self.inner.store.close().await;
    }
}

fn asked(order: Order) -> &'static str {
    match order {
        Order::Pause => "pause",
        Order::Resume => "resume",
        Order::Continue | Order::Done(_) => "continue",
        Order::Abort => "abort",
        Order::Stop | Order::ShutDown => "stop",
    }
}

fn tell(events: &broadcast::Sender<Arc<RecordedEvent>>, event: RecordedEvent) {
    watched::log(&event);
    watched::count(&event.event);
    // Nobody listening is fine: the store has it.
    events.send(Arc::new(event)).ok();
}
