//! The operations of the daemon. The lab owns the rig, writes the store and broadcasts events.
//!
//! [`Lab::open`] starts it; [`Lab::shut_down`] stops the rig and ends it. Page, command line and log read the store and
//! [`Lab::events`], never the runner. The lab does not know HTTP or the simulator.
//!
//! - `rig`: one task (`rig::owner`) owns stages and camera. Other tasks send it requests, which it accepts or refuses at once. A
//!   stop bypasses this task, so it is never refused.
//! - `scans` plans, queues, runs and records scans.
//! - `assembly` makes the rig of the settings.
//! - `jobs`: fits, maps, contrasts, verdicts and traces, which share the processors.
//! - `exchange`: imports and exports. [`reports`]: reports, charts and comparisons.
//! - [`definitions`], `specifications`, `samples`: what people define: recipes, limits and parts.
//! - `event_sink` records and broadcasts events; `hooks` runs programs at them; `telemetry` logs and counts them.

pub mod assembly;
pub mod definitions;
mod error;
mod event_sink;
mod exchange;
mod failure;
mod hooks;
mod jobs;
mod outcome;
pub mod reports;
mod request_checks;
mod rig;
mod samples;
mod scans;
mod series;
mod specifications;
mod tasks;
mod telemetry;

use std::collections::HashMap;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, Weak};
use std::time::Duration;

use tokio::sync::{broadcast, mpsc, oneshot, watch};
use tokio::time::timeout;

use crate::access::{DAEMON, LOCAL};
use crate::bench::stage::{StageError, StageSettings};
use crate::clock::Clock;
use crate::config::{DueSection, StoreSection};
use crate::geometry::Pose;
use crate::program::Program;
use crate::scan::event::RigActivity;
use crate::scan::faults::OnFailure;
use crate::scan::plan::PlanDefaults;
use crate::scan::runner::{CommandRequest, RunEnd, RunnerSettings, ScanCommand};
use crate::scan::{Event, RecordedEvent, Rig, ScanState, StageAccess};
use crate::series::{CameraFacts, FlatFacts, RigFacts};
use crate::store::disk::Disk;
use crate::store::scans::Scan;
use crate::store::{Recovery, Store, StoreError};

pub use crate::bench::stage::{AxisName, DeviceIdentity, StageIdentity};
pub use definitions::NameOrId;
pub use error::{Holder, LabError};
use event_sink::EventSink;
pub use exchange::export::{Exported, export, export_readable};
pub use exchange::exports::{FrameStack, SurfaceFile, bird_file, surface_file};
pub use exchange::import::{ImportOptions, Imported};
pub use exchange::import_duplicates::ImportDuplicate;
pub use exchange::nexus::NexusFile;
pub use exchange::nexus_download::NexusDownload;
pub use exchange::received::ReceivedFile;
pub use hooks::Hooks;
pub use jobs::chosen_fit::ReportChoice;
pub use jobs::contrasts::ContrastRequest;
pub use jobs::curves::{Curve, FitCurves};
use jobs::fits::Reductions;
pub use jobs::fits::{FitRequest, Reduced};
pub use jobs::maps::MapRequest;
pub use jobs::progress::JobProgress;
use jobs::running::RunningJobs;
use jobs::slots::JobSlots;
pub use jobs::trace_result::TraceResult;
pub use jobs::traces::TraceRequest;
pub use jobs::verdicts::VerdictRequest;
pub use jobs::{JobFile, JobRequest};
pub use outcome::Outcome;
pub use reports::charts::{ChartChoice, ChartedSpecification, GuardBasis, ResultChart, chart};
pub use reports::comparisons::{SCANS_MAX, compare, repeatability};
pub use reports::{report, report_on_series};
pub use rig::jog::{JogRequest, JogView};
pub use rig::motions::{Motion, MotionState};
pub use rig::operator_calls::OperatorCall;
pub use rig::preview_work::{
    PREVIEW_EXPOSURES_MAX, PREVIEW_TIME_S_MAX, PreviewFrame, PreviewRequest, PreviewView,
    SUGGESTED_MAX,
};
pub use rig::{AxisView, RigView};
pub use scans::due::{Due, DueKind, due};
pub use scans::fit_at_end::{FIT_NOT_STARTED, NOT_JUDGED};
pub use scans::orders::OrderRequest;
pub use scans::plans::{Estimated, ScanRequest};
pub use scans::queue::{LeaseHolder, QUEUE_WAITS, QueueView};
pub use scans::recipes::{Recipe, RecipeFit, RecipeLayout, RecipeMaterial};
pub use series::StoredSeries;

/// Events kept in memory for a listener that falls behind; one that misses more reads them from the store.
const EVENTS_KEPT: usize = 1024;

/// Settings of the rig.
#[derive(Debug, Clone)]
pub struct RigSettings {
    /// `[rig]` of the manifests.
    pub rig: RigFacts,
    /// `[camera]` of the manifests.
    pub camera: CameraFacts,
    /// `[flat]` of the manifests.
    pub flat: FlatFacts,
    /// Defaults of plans.
    pub defaults: PlanDefaults,
    /// Settings of the scan runner.
    pub runner: RunnerSettings,
    /// How long dark frames are valid.
    pub dark_valid: Duration,
    /// How long white-reference frames are valid.
    pub flat_valid: Duration,
    /// Where both axes are parked.
    pub park: Option<Pose>,
    /// Switches the lamp off.
    pub lamp_off: Option<Program>,
    /// Whether a completed scan is fitted without a request.
    pub fit_at_end: bool,
    /// What follows a failed order of the queue.
    pub queue_on_failure: OnFailure,
    /// Time scale of a simulated rig; none for a real one.
    pub simulated: Option<f64>,
    /// Anything else that makes frames of two rigs incomparable (a simulated rig's seed).
    pub label: String,
}

/// A rig for the lab to own.
pub struct RigParts {
    /// Stages and camera.
    pub rig: Rig,
    /// Settings of both, and of the scans with them.
    pub settings: RigSettings,
}

/// The lab's handle; cheap to clone.
#[derive(Clone)]
pub struct Lab {
    inner: Arc<Inner>,
    /// The caller that this handle acts for.
    who: Arc<str>,
}

struct Inner {
    store: Store,
    clock: Arc<dyn Clock>,
    events: broadcast::Sender<Arc<RecordedEvent>>,
    rig: Option<RigSide>,
    jobs: RunningJobs,
    slots: JobSlots,
    /// One estimate of a scan at a time: a large plan occupies a processor for seconds, and the stop needs one.
    estimating: Arc<tokio::sync::Mutex<()>>,
    /// Reductions for clients that only read observations.
    reductions: Reductions,
    /// Disk space that imports leave free.
    reserve_bytes: AtomicU64,
    /// How scans of this process ended.
    ends: watch::Sender<HashMap<i64, RunEnd>>,
    /// Whether the data folder was found gone and an alarm was raised.
    folder_gone: AtomicBool,
    queue: Arc<scans::queue::QueueRun>,
    /// What has to be measured again at intervals, by the settings; empty until they are read.
    due: OnceLock<DueSection>,
}

/// The lab's side of the rig, whose stages and camera the owner has.
struct RigSide {
    id: i64,
    settings: RigSettings,
    stage_settings: StageSettings,
    port: String,
    camera: String,
    requests: mpsc::Sender<rig::work::Request>,
    occupation: watch::Receiver<Occupation>,
    owner: Mutex<Option<tokio::task::JoinHandle<()>>>,
    access: StageAccess,
    hands: rig::operator_calls::Hands,
    previews: rig::preview_work::Previews,
    pinned: rig::pinned_stages::PinnedStages,
    jogs: rig::jog::Jogs,
    motions: Arc<rig::motions::Motions>,
    sink: EventSink,
}

/// Who uses the rig now.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RigUser {
    /// The caller that started the scan or the motion.
    pub who: String,
    /// The scan; none for a motion of an axis.
    pub scan_id: Option<i64>,
}

/// What the rig is doing.
#[derive(Debug, Clone, Default)]
struct Occupation {
    activity: Option<RigActivity>,
    /// Whether the daemon switches the lamp off or parks the axes. Requests wait for it instead of being refused.
    clears_up: bool,
    scan_id: Option<i64>,
    /// State of that scan and the reason for it, as recorded last: known also where the store does not answer.
    scan_state: Option<(ScanState, Option<String>)>,
    orders: Option<mpsc::Sender<CommandRequest>>,
    /// Who started the present activity.
    who: Option<Arc<str>>,
    /// Why the stages do not answer: the error of the last connection attempt, or the fault of the link or the stages for which
    /// the scan raised an alarm since it last ran.
    problem: Option<(String, String)>,
    /// Why the last motion of a single axis failed; none once another motion starts.
    failure: Option<(String, String)>,
}

/// How long a daemon that ends waits for a database that another program has locked: the state of a scan that it cannot write is
/// found at the next start.
const LOCK_WAIT_AT_END: Duration = Duration::from_secs(2);

impl Lab {
    /// Opens the store in `folder` and takes ownership of the rig, if there is one. Nothing moves.
    ///
    /// # Errors
    /// A store error.
    pub async fn open(
        folder: &Path,
        disk: Arc<dyn Disk>,
        clock: Arc<dyn Clock>,
        parts: Option<RigParts>,
    ) -> Result<(Lab, Recovery), StoreError> {
        let (store, recovery) = Store::open(folder, disk, Arc::clone(&clock)).await?;
        exchange::received::discard_all(&store).await;
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
        let events = broadcast::Sender::new(EVENTS_KEPT);
        let ends = watch::Sender::new(HashMap::new());
        let reserve_bytes = match &parts {
            None => StoreSection::default().reserve_bytes(),
            Some(parts) => parts.settings.runner.disk_reserve_bytes,
        };
        let rig = match parts {
            None => None,
            Some(parts) => {
                let (clock, events) = (Arc::clone(&clock), events.clone());
                let sink = EventSink::new(store.clone(), clock, events, ends.clone());
                let cut_off = recovery.interrupted_scans.last().copied();
                Some(rig::owner::take(parts, sink, cut_off).await?)
            }
        };
        let lab = Lab {
            inner: Arc::new(Inner {
                store,
                clock,
                events,
                rig,
                jobs: RunningJobs::default(),
                slots: JobSlots::default(),
                estimating: Arc::default(),
                reductions: Reductions::default(),
                reserve_bytes: AtomicU64::new(reserve_bytes),
                ends,
                folder_gone: AtomicBool::new(false),
                queue: Arc::default(),
                due: OnceLock::new(),
            }),
            who: LOCAL.into(),
        };
        scans::fit_at_end::start(&lab);
        scans::queue::start(&lab).await?;
        Ok((lab, recovery))
    }

    /// Sets the disk space that imports leave free; scans take it from their rig's settings.
    pub fn keep_free(&self, bytes: u64) {
        self.inner.reserve_bytes.store(bytes, Ordering::Relaxed);
    }

    fn reserve_bytes(&self) -> u64 {
        self.inner.reserve_bytes.load(Ordering::Relaxed)
    }

    /// Returns the daemon's own handle for a task that must not keep the lab alive; none once the lab has ended.
    fn of_daemon(inner: &Weak<Inner>) -> Option<Lab> {
        Some(Lab {
            inner: inner.upgrade()?,
            who: DAEMON.into(),
        })
    }

    /// Returns a handle that acts for a caller: what it starts and causes is recorded under this name.
    #[must_use]
    pub fn by(&self, who: &str) -> Lab {
        Lab {
            inner: Arc::clone(&self.inner),
            who: who.into(),
        }
    }

    /// Returns who uses the rig now, and for what; `None` while it is free.
    #[must_use]
    pub fn rig_user(&self) -> Option<RigUser> {
        let side = self.inner.rig.as_ref()?;
        let now = side.occupation.borrow();
        now.activity?;
        Some(RigUser {
            who: now.who.as_deref()?.to_owned(),
            scan_id: now.scan_id,
        })
    }

    /// Records an order of this handle's caller.
    pub async fn record_order(&self, order: impl Into<String>, scan_id: Option<i64>) {
        let order = order.into();
        let event = Event::Order { order, scan_id };
        let inner = &self.inner;
        match &inner.rig {
            // The answer to an order does not wait for the database.
            Some(side) => side.sink.report_by(&self.who, event),
            None => self.record(event, Some(&self.who)).await,
        }
    }

    /// Records an alarm of the daemon, and sends it to all listeners.
    async fn alarm(&self, code: &str, message: String, scan_id: Option<i64>) {
        let code = code.into();
        let alarm = Event::Alarm {
            code,
            message,
            scan_id,
        };
        self.record(alarm, None).await;
    }

    async fn record(&self, event: Event, who: Option<&str>) {
        let inner = &self.inner;
        let clock = inner.clock.as_ref();
        event_sink::record(&inner.store, &inner.events, clock, event, who).await;
    }

    /// Returns the store, for reading.
    #[must_use]
    pub fn store(&self) -> &Store {
        &self.inner.store
    }

    /// Returns a stored scan with its true state: a scan whose end could not be written is interrupted.
    #[must_use]
    pub fn with_unrecorded_end(&self, mut scan: Scan) -> Scan {
        if let Some(why) = self
            .inner
            .rig
            .as_ref()
            .and_then(|side| side.sink.unrecorded.why(scan.id))
            && !scan.state.is_end()
        {
            scan.state = ScanState::Interrupted;
            scan.reason = Some(format!("it can no longer be recorded: {why}"));
            scan.operator = None;
        }
        scan
    }

    /// Returns the scans whose end could not be written, and why they ended.
    #[must_use]
    pub fn unrecorded_scans(&self) -> HashMap<i64, String> {
        let side = self.inner.rig.as_ref();
        side.map_or_else(HashMap::new, |side| side.sink.unrecorded.now())
    }

    /// Subscribes to all events from now on. A listener that falls behind learns how many it missed and reads them from
    /// the store.
    #[must_use]
    pub fn events(&self) -> broadcast::Receiver<Arc<RecordedEvent>> {
        self.inner.events.subscribe()
    }

    /// Returns the lab's clock.
    #[must_use]
    pub fn clock(&self) -> &Arc<dyn Clock> {
        &self.inner.clock
    }

    /// Checks that the data folder is the one that was opened and that its disk answers. Raises one alarm when it does not.
    ///
    /// # Errors
    /// [`StoreError::FolderGone`] or [`StoreError::NoAnswer`].
    pub async fn check_folder(&self) -> Result<(), StoreError> {
        let inner = &self.inner;
        let checked = match inner.store.check_disk().await {
            Ok(()) => inner.store.find_folder().await,
            silent => silent,
        };
        let was_gone = inner.folder_gone.swap(checked.is_err(), Ordering::SeqCst);
        match &checked {
            // It could not be recorded, and a scan that waits for the disk says so itself.
            Err(StoreError::NoAnswer) if !was_gone => {
                let sink = inner.rig.as_ref().map(|side| &side.sink);
                if sink.is_none_or(|sink| sink.waits().is_none()) {
                    let alarm = Event::Alarm {
                        code: error::store_code(&StoreError::NoAnswer).into(),
                        message: StoreError::NoAnswer.to_string(),
                        scan_id: None,
                    };
                    self.publish(RecordedEvent::unrecorded(inner.clock.utc(), alarm));
                }
            }
            Err(gone) if !was_gone => {
                let code = error::store_code(gone);
                self.alarm(code, gone.to_string(), None).await;
            }
            Ok(()) if was_gone => tracing::info!("the data folder is back"),
            _ => {}
        }
        checked
    }

    fn publish(&self, event: RecordedEvent) {
        publish(&self.inner.events, event);
    }

    fn side(&self) -> Result<&RigSide, LabError> {
        self.inner.rig.as_ref().ok_or(LabError::NoRig)
    }

    /// Stops the rig, interrupts a running scan, parks the axes if that is set and permitted, and cancels all jobs; the
    /// store stays open for readers.
    ///
    /// # Errors
    /// The stages could not be reached and may be moving; everything else is done.
    pub async fn rest(&self) -> Result<(), StageError> {
        /// How long an end repeats a stop that is not confirmed. The system kills a service that does not end.
        const STOP_AT_END_FOR: Duration = Duration::from_secs(10);
        let mut stopped = Ok(());
        if let Some(side) = &self.inner.rig {
            side.sink.ending.cancel();
            self.store().end_waits(LOCK_WAIT_AT_END);
            // Before the daemon's own stop. A link that was never opened stays closed.
            let parks = side.access.may_move_unasked() && side.access.stage().is_some();
            let orders = side.occupation.borrow().orders.clone();
            if let Some(orders) = orders {
                let (reply, answer) = oneshot::channel();
                let request = CommandRequest {
                    command: ScanCommand::ShutDown,
                    reply,
                };
                if orders.send(request).await.is_ok() {
                    // Homing and connecting do not read commands; the stage does.
                    side.access.stop_what_may_move().await.ok();
                    answer.await.ok();
                }
            }
            stopped = side.access.stop_within(STOP_AT_END_FOR).await;
            side.access.end_standing_stop();
            // Taken first: a handle that is still here when the owner ends means that it panicked.
            let owner = side
                .owner
                .lock()
                .expect("no holder of this lock panics")
                .take();
            if parks && stopped.is_ok() && side.settings.park.is_some() {
                self.request(rig::work::Work::Park).await.ok();
            }
            self.request(rig::work::Work::End).await.ok();
            if let Some(owner) = owner {
                owner.await.ok();
            }
        }
        self.inner.jobs.interrupt_all().await;
        if let Some(side) = &self.inner.rig {
            // A locked database must not keep the daemon from ending.
            let written = async {
                side.sink.live_fits.ended().await;
                side.sink.flush().await;
            };
            timeout(Duration::from_secs(5), written).await.ok();
        }
        stopped
    }

    /// Does what [`Lab::rest`] does, then closes the store.
    pub async fn shut_down(&self) {
        // A stop that failed is in the log.
        self.rest().await.ok();
        self.inner.store.close().await;
    }
}

/// Logs and counts an event, and sends it to all listeners.
fn publish(events: &broadcast::Sender<Arc<RecordedEvent>>, event: RecordedEvent) {
    telemetry::log(&event);
    telemetry::count(&event.event);
    // Without listeners the store still has the event.
    events.send(Arc::new(event)).ok();
}
