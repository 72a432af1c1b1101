//! The task that owns stages and camera.
//!
//! The owner does one piece of work at a time. The current work is a future that holds the rig and returns it, so two
//! motions cannot overlap. While the rig reports an activity, the owner refuses further requests at once instead of
//! queueing them. Otherwise it accepts a request, if necessary a moment later, once the stages are connected, a target is
//! checked or the rig is returned.

use std::collections::{BTreeSet, VecDeque};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures::future::BoxFuture;
use serde_json::json;
use tokio::sync::{mpsc, oneshot, watch};

use super::event_sink::{EventSink, FirstState};
use super::recorder::LabRecorder;
use super::{Holder, LabError, Occupation, RigParts, RigSettings, RigSide, along, publish};
use crate::bench::stage::{AxisName, Stage, StageError};
use crate::frame::Frame;
use crate::geometry::Pose;
use crate::scan::event::{AxisEvent, RigActivity};
use crate::scan::runner::{self, Job, OrderSlip};
use crate::scan::{Event, Plan, Reach, Rig, TravelLimits};
use crate::store::StoreError;
use crate::store::scans::{NewScan, Scan};
use crate::units::Angle;

/// Work for the owner.
pub(super) enum Work {
    /// Connect the stages if they are not connected.
    Connect,
    /// Move one axis.
    Move {
        /// The axis.
        axis: AxisName,
        /// The target.
        target: Angle,
    },
    /// Home one axis.
    Home {
        /// The axis.
        axis: AxisName,
    },
    /// Unpark an axis. Nothing moves.
    Unpark {
        /// The axis.
        axis: AxisName,
    },
    /// Run a scan.
    Scan(Box<ScanWork>),
    /// End the task.
    End,
}

impl Work {
    /// Returns whether the work moves only one axis; a stop ends such work.
    fn is_of_one_axis(&self) -> bool {
        matches!(self, Work::Move { .. } | Work::Home { .. })
    }
}

/// A scan to run.
pub(super) struct ScanWork {
    pub row: ScanRow,
    pub plan: Plan,
    /// Points that are already durable.
    pub done: BTreeSet<u32>,
    /// The saturated points of the sample among them.
    pub full: BTreeSet<u32>,
    /// Time spent on them.
    pub elapsed_s: f64,
    /// Gets the scan's first state.
    pub first_state: Option<FirstState>,
}

/// The row of a scan.
pub(super) enum ScanRow {
    /// A new scan: only the owner of the rig adds its row. Sends the new row, or the reason it could not be written, to
    /// the caller.
    New(Box<NewScan>, oneshot::Sender<Result<Scan, StoreError>>),
    /// The row of an interrupted scan.
    Kept(i64),
}

/// Work and its reply, which is sent when the work starts, not when it is done.
pub(super) struct Request {
    pub work: Work,
    /// Number of stops before the request.
    pub stops: u64,
    pub reply: oneshot::Sender<Result<(), LabError>>,
}

/// Spawns the task that owns the rig from now on.
pub(super) async fn take(parts: RigParts, sink: EventSink) -> Result<RigSide, StoreError> {
    let RigParts { rig, settings } = parts;
    let link = rig.link();
    let camera = rig.camera.describe();
    let fingerprint = json!({
        "rig": settings.rig,
        "camera": settings.camera,
        "camera_is": camera,
        "stages": link.settings,
        "label": settings.label,
    });
    let id = sink.store.rig(&fingerprint.to_string()).await?;
    let (requests, inbox) = mpsc::channel(16);
    let (occupation, occupied) = watch::channel(Occupation::default());
    let side = RigSide {
        id,
        stage_settings: link.settings.clone(),
        port: link.port.to_string(),
        camera,
        stage: rig.reach().watch(),
        reach: rig.reach().clone(),
        requests,
        occupation: occupied,
        owner: Mutex::new(None),
        settings: settings.clone(),
        sink: sink.clone(),
    };
    let owner = Owner {
        reach: rig.reach().clone(),
        rig_id: id,
        settings,
        occupation: Arc::new(occupation),
        sink,
    };
    let task = tokio::spawn(owner.run(rig, inbox));
    *side.owner.lock().expect("no holder of this lock panics") = Some(task);
    Ok(side)
}

/// What finished work returns.
struct Done {
    rig: Rig,
    /// Why the stages could not be reached.
    out_of_reach: Option<Arc<LabError>>,
}

/// A motion of a single axis, which a stop ends.
#[derive(Clone, Copy)]
struct Motion {
    /// Number of stops before the request.
    asked_after: u64,
}

#[derive(Clone)]
struct Owner {
    rig_id: i64,
    settings: RigSettings,
    occupation: Arc<watch::Sender<Occupation>>,
    sink: EventSink,
    reach: Reach,
}

impl Owner {
    async fn run(self, rig: Rig, mut inbox: mpsc::Receiver<Request>) {
        let mut free = Some(rig);
        let mut current: Option<BoxFuture<'static, Done>> = None;
        let mut motion: Option<Motion> = None;
        let mut waiting: VecDeque<Request> = VecDeque::new();
        let mut occupied = self.occupation.subscribe();
        loop {
            let next = match free.is_some() {
                true => waiting.pop_front(),
                false => None,
            };
            let request = match next {
                Some(request) => request,
                None => tokio::select! {
                    request = inbox.recv() => match request {
                        Some(request) => request,
                        None => break,
                    },
                    done = async { current.as_mut().expect("guarded by the branch").await },
                        if current.is_some() =>
                    {
                        current = None;
                        free = Some(done.rig);
                        // The waiting requests share this failed connection attempt.
                        if let Some(why) = done.out_of_reach {
                            for request in waiting.drain(..) {
                                request.reply.send(Err(LabError::Shared(Arc::clone(&why)))).ok();
                            }
                        }
                        continue;
                    }
                    // The current work turned out to be a motion or a scan.
                    () = async { occupied.wait_for(|now| self.is_taken(now, motion)).await.ok(); },
                        if !waiting.is_empty() =>
                    {
                        for request in waiting.drain(..) {
                            self.refuse(request);
                        }
                        continue;
                    }
                },
            };
            // A request whose client has gone is dropped.
            if request.reply.is_closed() {
                continue;
            }
            if matches!(request.work, Work::End) {
                if let Some(work) = current.take() {
                    work.await;
                }
                request.reply.send(Ok(())).ok();
                break;
            }
            match free.take() {
                Some(rig) => {
                    let asked_after = request.stops;
                    let of_one_axis = request.work.is_of_one_axis();
                    motion = of_one_axis.then_some(Motion { asked_after });
                    current = Some(Box::pin(self.clone().work(rig, request)));
                }
                None if self.is_taken(&self.occupation.borrow(), motion) => self.refuse(request),
                None => waiting.push_back(request),
            }
        }
    }

    /// Returns whether the current work refuses further requests. A single axis that got a stop is about to be free.
    fn is_taken(&self, now: &Occupation, motion: Option<Motion>) -> bool {
        let stopped = motion.is_some_and(|motion| self.reach.stops() != motion.asked_after);
        now.activity.is_some() && !stopped
    }

    fn refuse(&self, request: Request) {
        let with = self.held_by();
        request.reply.send(Err(LabError::Busy { with })).ok();
    }

    /// The caller reads a scan's state from the store, so that the owner does not wait for the database.
    fn held_by(&self) -> Holder {
        let occupation = self.occupation.borrow();
        match (occupation.scan_id, occupation.activity) {
            (Some(scan_id), _) => Holder::Scan {
                scan_id,
                state: None,
            },
            (None, Some(RigActivity::Homing)) => Holder::Homing,
            (None, Some(RigActivity::Scanning)) => Holder::Beginning,
            (None, _) => Holder::Moving,
        }
    }

    fn occupy(&self, activity: Option<RigActivity>, scan_id: Option<i64>) {
        self.occupation.send_modify(|now| {
            now.activity = activity;
            now.scan_id = scan_id;
            now.failure = None;
            if scan_id.is_none() {
                now.orders = None;
            }
        });
    }

    /// Does one piece of work and returns the rig.
    async fn work(self, mut rig: Rig, request: Request) -> Done {
        let stage = match self.connect(&mut rig).await {
            Ok(stage) => stage,
            Err(error) => {
                let why = Arc::new(LabError::from(error));
                let refused = Err(LabError::Shared(Arc::clone(&why)));
                request.reply.send(refused).ok();
                return Done {
                    rig,
                    out_of_reach: Some(why),
                };
            }
        };
        Done {
            rig: self.work_with(stage, rig, request).await,
            out_of_reach: None,
        }
    }

    async fn work_with(self, stage: Stage, mut rig: Rig, request: Request) -> Rig {
        let Request { work, stops, reply } = request;
        // Read first: a later stop cancels the motion that starts with this count, and an earlier one shows in the owner's
        // count.
        let stops_of_stage = stage.stops();
        if work.is_of_one_axis() && self.reach.stops() != stops {
            reply.send(Err(StageError::Stopped.into())).ok();
            return rig;
        }
        if work.is_of_one_axis() && reply.is_closed() {
            return rig;
        }
        match work {
            Work::Connect | Work::End => {
                reply.send(Ok(())).ok();
            }
            Work::Unpark { axis } => {
                let unparked = stage.unpark(axis).await;
                if let Err(error) = &unparked {
                    rig.let_go_if_lost(error);
                }
                reply.send(unparked.map_err(LabError::from)).ok();
            }
            Work::Move { axis, target } => {
                if let Err(error) = self.check_move(&stage, axis, target).await {
                    rig.let_go_if_lost(&error);
                    reply.send(Err(error.into())).ok();
                    return rig;
                }
                self.occupy(Some(RigActivity::Moving), None);
                reply.send(Ok(())).ok();
                self.report_axis(RigActivity::Moving, axis, AxisEvent::to(target))
                    .await;
                let moved = stage.move_since(axis, target, stops_of_stage).await;
                let moved = moved.map(|_| ());
                self.settled(&mut rig, &stage, moved).await;
            }
            Work::Home { axis } => {
                self.occupy(Some(RigActivity::Homing), None);
                reply.send(Ok(())).ok();
                self.report_axis(RigActivity::Homing, axis, AxisEvent::UNKNOWN)
                    .await;
                let homed = async {
                    stage.release(axis).await?;
                    stage.home_since(axis, stops_of_stage).await
                };
                let homed = homed.await;
                self.settled(&mut rig, &stage, homed).await;
            }
            Work::Scan(work) => {
                // Held during a scan it would keep open a port that the scan may have to reopen.
                drop(stage);
                self.scan(&mut rig, *work, reply).await;
            }
        }
        rig
    }

    /// Connects the stages and stops an axis that an earlier program left moving.
    async fn connect(&self, rig: &mut Rig) -> Result<Stage, StageError> {
        let known = rig.reach().watch().borrow().is_some();
        let connected = async {
            let stage = rig.connect().await?;
            if !known {
                let status = stage.status().await?;
                if status.theta_c.moving || status.phi_s.moving {
                    tracing::warn!("the stages were moving when they were found; stopping them");
                    stage.stop().await?;
                }
            }
            Ok(stage)
        };
        let connected = connected.await;
        if let Err(error) = &connected {
            rig.let_go_if_lost(error);
        }
        let problem = connected
            .as_ref()
            .err()
            .map(|e: &StageError| (crate::scan::visit::stage_code(e).to_owned(), e.to_string()));
        self.occupation.send_modify(|now| now.problem = problem);
        connected
    }

    async fn check_move(
        &self,
        stage: &Stage,
        axis: AxisName,
        target: Angle,
    ) -> Result<(), StageError> {
        let status = stage.status().await?;
        let homed = status.axis(axis).homed;
        let mut pose = status.pose();
        // Only the moving axis is checked; the other one stays where it is.
        let settings = stage.settings();
        match axis {
            AxisName::ThetaC => {
                pose.theta_c = target;
                pose.phi_s = clamp(
                    pose.phi_s,
                    settings.phi_s.limit_min,
                    settings.phi_s.limit_max,
                );
            }
            AxisName::PhiS => {
                pose.phi_s = target;
                pose.theta_c = clamp(
                    pose.theta_c,
                    settings.theta_c.limit_min,
                    settings.theta_c.limit_max,
                );
            }
        }
        stage.check_limits(pose)?;
        match homed {
            true => Ok(()),
            false => Err(StageError::NotReferenced { axis }),
        }
    }

    async fn settled(&self, rig: &mut Rig, stage: &Stage, outcome: Result<(), StageError>) {
        let status = stage.status().await.ok();
        let failure = outcome
            .as_ref()
            .err()
            .map(|e| (crate::scan::visit::stage_code(e).to_owned(), e.to_string()));
        // At once, so that a client that sees the rig idle also sees the failure, and gets the rig as soon as it is back.
        self.occupation.send_modify(|now| {
            now.activity = None;
            now.failure = failure;
        });
        if let Err(error) = &outcome {
            rig.let_go_if_lost(error);
            if !matches!(error, StageError::Stopped) {
                self.sink
                    .record(Event::Alarm {
                        code: crate::scan::visit::stage_code(error).into(),
                        message: error.to_string(),
                        scan_id: None,
                    })
                    .await;
            }
        }
        let at = |axis: Option<Angle>| axis.map_or(AxisEvent::UNKNOWN, AxisEvent::at);
        let event = Event::Rig {
            activity: RigActivity::Idle,
            theta_c: at(status.as_ref().map(|s| s.theta_c.position)),
            phi_s: at(status.as_ref().map(|s| s.phi_s.position)),
        };
        self.sink.record(event).await;
    }

    async fn report_axis(&self, activity: RigActivity, axis: AxisName, event: AxisEvent) {
        let (theta_c, phi_s) = match axis {
            AxisName::ThetaC => (event, AxisEvent::UNKNOWN),
            AxisName::PhiS => (AxisEvent::UNKNOWN, event),
        };
        let event = Event::Rig {
            activity,
            theta_c,
            phi_s,
        };
        self.sink.record(event).await;
    }

    async fn scan(
        &self,
        rig: &mut Rig,
        work: ScanWork,
        reply: oneshot::Sender<Result<(), LabError>>,
    ) {
        self.occupy(Some(RigActivity::Scanning), None);
        let scan_id = match work.row {
            ScanRow::Kept(scan_id) => scan_id,
            ScanRow::New(new, reply_row) => match self.sink.store.add_scan(&new).await {
                Ok((scan, event)) => {
                    publish(&self.sink.events, event);
                    let scan_id = scan.id;
                    reply_row.send(Ok(scan)).ok();
                    scan_id
                }
                Err(error) => {
                    self.occupy(None, None);
                    reply_row.send(Err(error)).ok();
                    reply.send(Ok(())).ok();
                    return;
                }
            },
        };
        let (book, mut orders) = mpsc::channel::<OrderSlip>(16);
        self.occupation.send_modify(|now| {
            now.scan_id = Some(scan_id);
            now.orders = Some(book);
        });
        reply.send(Ok(())).ok();
        let stage = rig.connect().await.ok();
        let start = match &stage {
            Some(stage) => stage.status().await.map(|status| status.pose()).ok(),
            None => None,
        };
        let start = start.unwrap_or(Pose::from_deg(0.0, 0.0));
        let (stages, plan) = (rig.link().settings.clone(), work.plan.clone());
        // Ordering a large plan takes seconds.
        let in_order = move || {
            let move_time = |from, to| match &stage {
                Some(stage) => stage.predicted_move(from, to),
                None => stages.predicted_move(from, to),
            };
            let limits = TravelLimits {
                theta_c: (stages.theta_c.limit_min, stages.theta_c.limit_max),
                phi_s: (stages.phi_s.limit_min, stages.phi_s.limit_max),
            };
            plan.steps(&limits, start, &move_time)
        };
        let steps = tokio::task::spawn_blocking(in_order)
            .await
            .expect("putting poses in order does not panic");
        let mut recorder = LabRecorder {
            sink: self.sink.clone(),
            scan_id,
            rig_id: self.rig_id,
            saturation_dn: self.settings.camera.full_count(),
            plan: work.plan,
            first_state: work.first_state,
            occupation: Arc::clone(&self.occupation),
        };
        let last_frames = match work.done.is_empty() {
            true => Vec::new(),
            false => self.last_frames(scan_id).await,
        };
        let job = Job {
            steps,
            done: work.done,
            full: work.full,
            last_frames,
            elapsed_s: work.elapsed_s,
            settings: self.settings.runner.clone(),
            clock: Arc::clone(&self.sink.clock),
        };
        let along = along::begin(&self.sink, scan_id);
        let end = runner::run(job, rig, &mut recorder, &mut orders).await;
        drop(along);
        match end {
            Ok(end) => self.sink.ends.send_modify(|ends| {
                ends.insert(scan_id, end);
            }),
            Err(error) => {
                tracing::error!(scan_id, %error, "scan {scan_id} can no longer be recorded: {error}");
                // The runner may have ended during a move; a stop that does not arrive is in the log.
                rig.reach().stop_what_may_move().await.ok();
                self.sink
                    .unrecorded
                    .all()
                    .insert(scan_id, error.to_string());
                tokio::spawn(interrupt_when_possible(self.sink.clone(), scan_id));
            }
        }
        self.occupy(None, None);
    }

    /// Returns the newest accepted frames of a scan; none if they cannot be read, which the scan's end will report.
    async fn last_frames(&self, scan_id: i64) -> Vec<Frame> {
        const ENOUGH: usize = 8;
        let store = self.sink.store.clone();
        let Ok(records) = store.frames_for_reduction(scan_id).await else {
            return Vec::new();
        };
        let own = records.into_iter().filter(move |r| r.scan_id == scan_id);
        let newest: Vec<String> = own.map(|r| r.sha256).rev().take(ENOUGH).collect();
        let read = move || -> Vec<Frame> {
            let frames = newest.iter().filter_map(|sha256| {
                let png = store.read_png(sha256).ok()?;
                Frame::from_png(&png).ok()
            });
            frames.collect()
        };
        tokio::task::spawn_blocking(read).await.unwrap_or_default()
    }
}

/// Marks a scan whose state could not be written as interrupted as soon as the store accepts it.
async fn interrupt_when_possible(sink: EventSink, scan_id: i64) {
    while sink.record_end_of(scan_id).await.is_err() && !sink.store.is_closed() {
        sink.clock.sleep(Duration::from_secs(5)).await;
    }
}

fn clamp(angle: Angle, min: Angle, max: Angle) -> Angle {
    if angle < min {
        min
    } else if angle > max {
        max
    } else {
        angle
    }
}
