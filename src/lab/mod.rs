//! The daemon's verbs. Owns the bench, is the only writer of the store, broadcasts events.
//!
//! [`Lab::open`] starts it, [`Lab::shut_down`] ends it with the rig stopped. One task owns stages
//! and camera (`bench`); everybody else sends it a request and is told at once whether it was taken
//! up. Stopping the stages goes past that task, so it is never refused. What page, command line and
//! log show comes from the store and from [`Lab::events`]; nobody asks the runner. The lab knows no
//! HTTP and no simulator.

mod along;
mod attached;
mod bench;
mod calculations;
mod curves;
mod error;
mod fits;
mod foretell;
mod headway;
pub mod measured;
mod plans;
mod recorder;
mod series;
mod traces;
mod under_way;
pub(crate) mod words;

use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use tokio::sync::{broadcast, mpsc, oneshot, watch};

use crate::bench::stage::{Stage, StageError, StageSettings};
use crate::clock::Clock;
use crate::scan::event::{AxisEvent, RigActivity};
use crate::scan::plan::PlanDefaults;
use crate::scan::runner::{Order, OrderSlip, RunEnd, RunnerSettings};
use crate::scan::{Event, RecordedEvent, Rig, ScanState, TravelLimits};
use crate::series::{CameraFacts, FlatFacts, RigFacts};
use crate::store::disk::Disk;
use crate::store::scans::Scan;
use crate::store::{Recovery, Store, StoreError};
use crate::units::Angle;

pub use crate::bench::stage::AxisName;
pub use calculations::{CalculationRequest, ContrastRequest, MapRequest, VerdictRequest};
pub use curves::{Curve, FitCurves};
pub use error::LabError;
pub use fits::{FitRequest, Reduced};
pub use headway::Progress as CalculationProgress;
pub use plans::{Estimated, ScanRequest};
pub use series::{ImportOptions, Imported, StoredSeries, export};
pub use traces::TraceRequest;
use under_way::AllUnderWay;

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
    /// Whether the stages were told to stop since the work in hand began.
    stopping: Arc<AtomicBool>,
}

/// What the rig is doing, for everybody to see.
#[derive(Debug, Clone, Default)]
struct Occupation {
    activity: Option<RigActivity>,
    scan_id: Option<i64>,
    orders: Option<mpsc::Sender<OrderSlip>>,
    /// Why the stages could not be had the last time they were asked for.
    problem: Option<(String, String)>,
}

/// State of the rig as shown to people.
#[derive(Debug, Clone, PartialEq)]
pub struct RigView {
    /// Whether the stages answer.
    pub connected: bool,
    /// Code and words, where they do not.
    pub problem: Option<(String, String)>,
    /// Time scale of a simulated rig; `None` for a real one.
    pub simulated: Option<f64>,
    /// Port of the stages.
    pub port: String,
    /// Make and model of the camera.
    pub camera: String,
    /// Facts about the camera.
    pub camera_facts: CameraFacts,
    /// Facts about the geometry.
    pub rig_facts: RigFacts,
    /// Camera tilt, then sample azimuth.
    pub axes: [(AxisName, AxisView); 2],
    /// What it is doing.
    pub activity: RigActivity,
    /// Scan that holds it.
    pub scan_id: Option<i64>,
}

/// State of one axis.
#[derive(Debug, Clone, PartialEq)]
pub struct AxisView {
    /// Position read just now; `None` if the stage does not answer.
    pub position: Option<Angle>,
    /// Whether it moves.
    pub moving: bool,
    /// Whether it knows its reference.
    pub homed: bool,
    /// Warnings in words.
    pub warnings: Vec<String>,
    /// Serial number.
    pub serial: Option<u32>,
    /// Least position.
    pub limit_min: Angle,
    /// Greatest position.
    pub limit_max: Angle,
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
        let rig = match parts {
            None => None,
            Some(parts) => {
                let told = bench::Told {
                    store: store.clone(),
                    clock: Arc::clone(&clock),
                    events: events.clone(),
                    ends: ends.clone(),
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
                ends,
            }),
        };
        Ok((lab, recovery))
    }

    /// The store, for reading.
    #[must_use]
    pub fn store(&self) -> &Store {
        &self.inner.store
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

    /// Facts about the rig.
    ///
    /// # Errors
    /// [`LabError::NoRig`].
    pub fn rig_settings(&self) -> Result<&RigSettings, LabError> {
        Ok(&self.side()?.settings)
    }

    /// Where the rig stands now, asked of the stages. A rig that is not connected and not in use is
    /// connected by this.
    ///
    /// # Errors
    /// [`LabError::NoRig`]; a stage that does not answer is part of the view.
    pub async fn rig(&self) -> Result<RigView, LabError> {
        let side = self.side()?;
        let stage = side.stage.borrow().clone();
        let stage = match stage {
            Some(stage) => Ok(stage),
            None => self.connect().await,
        };
        let status = match stage {
            Ok(stage) => stage.status().await.map_err(LabError::Stage),
            Err(error) => Err(error),
        };
        let occupation = side.occupation.borrow().clone();
        let (status, problem) = match status {
            Ok(status) => (Some(status), None),
            Err(LabError::Busy { .. }) => (None, occupation.problem),
            Err(error) => (None, Some((error.code().to_owned(), error.to_string()))),
        };
        let axes = AxisName::ALL.map(|name| {
            let limits = match name {
                AxisName::ThetaC => &side.stage_settings.theta_c,
                AxisName::PhiS => &side.stage_settings.phi_s,
            };
            let axis = status.as_ref().map(|status| status.axis(name));
            let view = AxisView {
                position: axis.map(|a| a.position),
                moving: axis.is_some_and(|a| a.moving),
                homed: axis.is_some_and(|a| a.homed),
                warnings: axis.map(|a| a.warnings.clone()).unwrap_or_default(),
                serial: axis.map(|a| a.serial),
                limit_min: limits.limit_min,
                limit_max: limits.limit_max,
            };
            (name, view)
        });
        Ok(RigView {
            connected: status.is_some(),
            problem,
            simulated: side.settings.simulated,
            port: side.port.clone(),
            camera: side.camera.clone(),
            camera_facts: side.settings.camera.clone(),
            rig_facts: side.settings.rig.clone(),
            axes,
            activity: occupation.activity.unwrap_or(RigActivity::Idle),
            scan_id: occupation.scan_id,
        })
    }

    /// Where the axes may go.
    ///
    /// # Errors
    /// [`LabError::NoRig`].
    pub fn limits(&self) -> Result<TravelLimits, LabError> {
        let settings = &self.side()?.stage_settings;
        Ok(TravelLimits {
            theta_c: (settings.theta_c.limit_min, settings.theta_c.limit_max),
            phi_s: (settings.phi_s.limit_min, settings.phi_s.limit_max),
        })
    }

    async fn request(&self, work: bench::Work) -> Result<(), LabError> {
        let (reply, answer) = oneshot::channel();
        self.side()?
            .requests
            .send(bench::Request { work, reply })
            .await
            .map_err(|_| LabError::Stopping)?;
        answer.await.map_err(|_| LabError::Stopping)?
    }

    async fn connect(&self) -> Result<Stage, LabError> {
        self.request(bench::Work::Connect).await?;
        let stage = self.side()?.stage.borrow().clone();
        stage.ok_or(LabError::Busy {
            with: "the stages are being connected".into(),
        })
    }

    /// Connects the stages if they are not, and says why they cannot be had.
    ///
    /// # Errors
    /// [`LabError::NoRig`], [`LabError::Busy`], or why the stage cannot be had.
    pub async fn have_rig(&self) -> Result<(), LabError> {
        self.request(bench::Work::Connect).await
    }

    /// Begins to move an axis; returns once the stage is about to move.
    ///
    /// # Errors
    /// [`LabError::Busy`], [`LabError::NoRig`], a position outside the limits, or why the stage
    /// cannot be had.
    pub async fn move_axis(&self, axis: AxisName, target: Angle) -> Result<(), LabError> {
        if !target.is_finite() {
            return Err(LabError::Invalid {
                field: "position_deg".into(),
                problem: "must be a finite number".into(),
            });
        }
        self.request(bench::Work::Move { axis, target }).await
    }

    /// Begins to look for an axis' reference; returns once the stage is about to move.
    ///
    /// # Errors
    /// As [`Lab::move_axis`].
    pub async fn home(&self, axis: AxisName) -> Result<(), LabError> {
        self.request(bench::Work::Home { axis }).await
    }

    /// Stops both axes at once, whoever moves them; a scan pauses. Never refused.
    ///
    /// # Errors
    /// Only if the stage could not be reached.
    pub async fn stop(&self) -> Result<(), LabError> {
        let side = self.side()?;
        side.stopping.store(true, Ordering::Relaxed);
        let stage = side.stage.borrow().clone();
        let stopped = match stage {
            // Nothing was ever connected: nothing that this daemon started can be moving.
            None => Ok(()),
            Some(stage) => stage.stop().await,
        };
        let orders = side.occupation.borrow().orders.clone();
        if let Some(orders) = orders {
            let (reply, _) = oneshot::channel();
            let slip = OrderSlip {
                order: Order::Stop,
                reply,
            };
            // A full book means that orders wait already, and the stage stands still.
            orders.try_send(slip).ok();
        }
        let event = Event::Rig {
            activity: RigActivity::Stopped,
            theta_c: AxisEvent::UNKNOWN,
            phi_s: AxisEvent::UNKNOWN,
        };
        match self.inner.store.record(event).await {
            Ok(event) => self.tell(event),
            Err(error) => tracing::warn!(%error, "the stop could not be recorded: {error}"),
        }
        Ok(stopped?)
    }

    /// Gives an order to a running scan, or resumes an interrupted one.
    ///
    /// # Errors
    /// [`LabError::NotNow`] if the scan cannot do that where it stands.
    pub async fn order(&self, scan_id: i64, order: Order) -> Result<ScanState, LabError> {
        let scan = self.inner.store.scan(scan_id).await?;
        let asked = match order {
            Order::Pause => "pause",
            Order::Resume => "resume",
            Order::Continue => "continue",
            Order::Abort => "abort",
            Order::Stop | Order::ShutDown => "stop",
        };
        let not_now = |state| LabError::NotNow {
            scan_id,
            state,
            asked,
        };
        let occupation = match &self.inner.rig {
            Some(side) => side.occupation.borrow().clone(),
            None => Occupation::default(),
        };
        let orders = match occupation.orders {
            Some(orders) if occupation.scan_id == Some(scan_id) => orders,
            _ => {
                return match (order, scan.state) {
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
                    (_, state) => Err(not_now(state)),
                };
            }
        };
        let permitted = match order {
            Order::Continue => scan.state == ScanState::WaitingForOperator,
            Order::Resume => matches!(scan.state, ScanState::Paused | ScanState::Pausing),
            Order::Pause => matches!(
                scan.state,
                ScanState::Running | ScanState::WaitingForOperator
            ),
            Order::Abort | Order::Stop | Order::ShutDown => true,
        };
        if !permitted {
            return Err(not_now(scan.state));
        }
        let (reply, answer) = oneshot::channel();
        let sent = orders.send(OrderSlip { order, reply }).await;
        if order == Order::Abort {
            // Homing and connecting do not listen to orders; the stage does.
            let stage = self.side()?.stage.borrow().clone();
            if let Some(stage) = stage {
                stage.stop().await?;
            }
        }
        let answer = match sent {
            Ok(()) => answer.await.ok(),
            Err(_) => None,
        };
        match answer {
            Some(Ok(state)) => Ok(state),
            Some(Err(state)) => Err(not_now(state)),
            // The scan ended before the order was read.
            None => {
                let state = self.inner.store.scan(scan_id).await?.state;
                if order == Order::Abort && state == ScanState::Aborted {
                    Ok(state)
                } else {
                    Err(not_now(state))
                }
            }
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
    pub async fn rest(&self) {
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
                    self.stop_quietly(side).await;
                    answer.await.ok();
                }
            }
            self.stop_quietly(side).await;
            self.request(bench::Work::End).await.ok();
            let owner = side
                .owner
                .lock()
                .expect("no holder of this lock panics")
                .take();
            if let Some(owner) = owner {
                owner.await.ok();
            }
        }
        self.inner.fits.cancel_all().await;
        self.inner.calculations.cancel_all().await;
    }

    /// [`Lab::rest`], then closes the store.
    pub async fn shut_down(&self) {
        self.rest().await;
        self.inner.store.close().await;
    }

    async fn stop_quietly(&self, side: &RigSide) {
        let stage = side.stage.borrow().clone();
        if let Some(stage) = stage
            && let Err(error) = stage.stop().await
            && !matches!(error, StageError::Stopped)
        {
            tracing::error!(%error, "the stages could not be stopped: {error}; look at the rig");
        }
    }
}

fn tell(events: &broadcast::Sender<Arc<RecordedEvent>>, event: RecordedEvent) {
    log(&event);
    // Nobody listening is fine: the store has it.
    events.send(Arc::new(event)).ok();
}

/// The log sees the same events as everybody else.
fn log(event: &RecordedEvent) {
    let id = event.id;
    match &event.event {
        Event::Rig { activity, .. } => tracing::debug!(id, "rig: {activity:?}"),
        Event::Scan {
            scan_id,
            state,
            reason,
            ..
        } => {
            let reason = reason.as_deref().unwrap_or("as planned");
            tracing::info!(id, scan_id, %state, "scan {scan_id} is {state} ({reason})");
        }
        Event::Frame {
            scan_id,
            frame_id,
            theta_c_deg,
            phi_s_deg,
            ..
        } => tracing::debug!(
            id,
            scan_id,
            frame_id,
            "scan {scan_id}: frame {frame_id} at θc {theta_c_deg:.3}°, φs {phi_s_deg:.3}°"
        ),
        Event::Fit { fit_id, state, .. } => {
            tracing::info!(id, fit_id, "fit {fit_id} is {state}");
        }
        Event::Uncertainty { scan_id, certainty } => tracing::debug!(
            id,
            scan_id,
            "scan {scan_id}: {} after {} poses and {:.0} s",
            certainty.status,
            certainty.n_observations,
            certainty.elapsed_s
        ),
        Event::Calculation {
            kind,
            calculation_id,
            state,
            ..
        } => tracing::info!(id, calculation_id, "{kind} {calculation_id} is {state}"),
        Event::Forecast {
            of,
            number,
            forecast,
            ..
        } => tracing::info!(id, of, number, "{of} {number} will take {forecast}"),
        Event::Alarm {
            code,
            message,
            scan_id,
        } => tracing::warn!(id, code, scan_id, "{code}: {message}"),
    }
}
