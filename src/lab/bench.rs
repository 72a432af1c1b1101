//! The task that owns stages and camera.
//!
//! The owner does one piece of work at a time. The current work is a future that holds the rig and returns it, so two
//! motions cannot overlap. While the rig reports an activity, the owner refuses further requests at once instead of
//! queueing them. Otherwise it accepts a request, if necessary a moment later, once the stages are connected, a target is
//! checked or the rig is returned. A preview ends for any other order, which then waits only until the rig is returned.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use futures::future::BoxFuture;
use serde_json::json;
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

use super::event_sink::EventSink;
use super::hands::Hands;
use super::motions::Motions;
use super::preview_work::Previews;
use super::rig_work::{Request, Work};
use super::scan_run::RigContext;
use super::stages::{PinnedStages, record_notices};
use super::{Holder, LabError, Occupation, RigParts, RigSide};
use crate::bench::stage::{AxisName, Stage, StageError};
use crate::geometry::Pose;
use crate::scan::event::{AxisEvent, RigActivity};
use crate::scan::{Event, Rig, StageAccess};
use crate::store::StoreError;
use crate::units::Angle;

/// Spawns the task that owns the rig from now on. It first switches off the lamp of `cut_off`, a scan that a kill ended.
pub(super) async fn take(
    parts: RigParts,
    sink: EventSink,
    cut_off: Option<i64>,
) -> Result<RigSide, StoreError> {
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
    let access = rig.access().clone();
    let notices = access.notices().subscribe();
    let pinned = PinnedStages::read(id, &fingerprint, access, sink.clone()).await?;
    let (requests, inbox) = mpsc::channel(16);
    let (occupation, occupied) = watch::channel(Occupation::default());
    let hands = Hands::default();
    let motions = Arc::new(Motions::default());
    let previews = Previews::default();
    let side = RigSide {
        id,
        stage_settings: link.settings.clone(),
        port: link.port.to_string(),
        camera,
        access: rig.access().clone(),
        pinned: pinned.clone(),
        jogs: Default::default(),
        motions: Arc::clone(&motions),
        requests,
        occupation: occupied,
        owner: Mutex::new(None),
        settings: settings.clone(),
        hands: hands.clone(),
        previews: previews.clone(),
        sink: sink.clone(),
    };
    let now = side.occupation.clone();
    let scan_now = move || now.borrow().scan_id;
    tokio::spawn(record_notices(notices, sink.clone(), scan_now));
    let owner = Owner {
        access: rig.access().clone(),
        context: RigContext {
            rig_id: id,
            settings,
            occupation: Arc::new(occupation),
            hands,
            pinned,
            motions,
            previews,
            sink,
        },
    };
    let task = tokio::spawn(async move {
        if cut_off.is_some() {
            // A failure is an alarm.
            owner.context.switch_lamp_off(cut_off).await.ok();
        }
        owner.run(rig, inbox).await;
    });
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
    context: RigContext,
    access: StageAccess,
}

impl Owner {
    async fn run(self, rig: Rig, mut inbox: mpsc::Receiver<Request>) {
        let mut free = Some(rig);
        let mut current: Option<BoxFuture<'static, Done>> = None;
        let mut motion: Option<Motion> = None;
        let mut preview: Option<CancellationToken> = None;
        let mut waiting: VecDeque<Request> = VecDeque::new();
        let mut occupied = self.context.occupation.subscribe();
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
            if let Some(preview) = &preview
                && request.work.comes_before_a_preview()
            {
                preview.cancel();
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
                    let is_a_motion = request.work.is_a_motion();
                    motion = is_a_motion.then_some(Motion { asked_after });
                    preview = match &request.work {
                        Work::Preview(work) => Some(work.give_way.clone()),
                        _ => None,
                    };
                    current = Some(Box::pin(self.clone().work(rig, request)));
                }
                None if self.is_taken(&self.context.occupation.borrow(), motion) => {
                    self.refuse(request)
                }
                None => {
                    let is_preview = |other: &Request| matches!(other.work, Work::Preview(_));
                    let first_preview = waiting.iter().position(is_preview);
                    match first_preview.filter(|_| request.work.comes_before_a_preview()) {
                        Some(at) => waiting.insert(at, request),
                        None => waiting.push_back(request),
                    }
                }
            }
        }
    }

    /// Returns whether the current work refuses further requests. A single axis that got a stop is about to be free.
    fn is_taken(&self, now: &Occupation, motion: Option<Motion>) -> bool {
        let stopped = motion.is_some_and(|motion| self.access.stops() != motion.asked_after);
        now.activity.is_some() && !now.clears_up && !stopped
    }

    fn refuse(&self, request: Request) {
        let with = self.held_by();
        request.reply.send(Err(LabError::Busy { with })).ok();
    }

    /// The caller reads a scan's state from the store, so that the owner does not wait for the database.
    fn held_by(&self) -> Holder {
        let occupation = self.context.occupation.borrow();
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
        let Request {
            work,
            motion,
            who,
            stops,
            reply,
        } = request;
        // Read first: a later stop cancels the motion that starts with this count, and an earlier one shows in the owner's
        // count.
        let stops_of_stage = stage.stops();
        if work.is_a_motion() && self.access.stops() != stops {
            reply.send(Err(StageError::Stopped.into())).ok();
            return rig;
        }
        if work.is_a_motion() && reply.is_closed() {
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
                self.access.allow_unasked_motion();
                self.context.begin(RigActivity::Moving, &who);
                reply.send(Ok(())).ok();
                self.report_axis(&who, RigActivity::Moving, axis, AxisEvent::to(target));
                let moved = stage.move_since(axis, target, stops_of_stage).await;
                let moved = moved.map(|_| ());
                self.settled(&mut rig, &stage, &who, motion, moved).await;
            }
            Work::MoveBoth { target } => {
                if let Err(error) = self.check_move_both(&stage, target).await {
                    rig.let_go_if_lost(&error);
                    reply.send(Err(error.into())).ok();
                    return rig;
                }
                self.access.allow_unasked_motion();
                self.context.begin(RigActivity::Moving, &who);
                reply.send(Ok(())).ok();
                let event = Event::Rig {
                    activity: RigActivity::Moving,
                    theta_c: AxisEvent::to(target.theta_c),
                    phi_s: AxisEvent::to(target.phi_s),
                };
                self.context.sink.report_by(&who, event);
                let moved = stage.move_pose_since(target, stops_of_stage).await;
                let moved = moved.map(|_| ());
                self.settled(&mut rig, &stage, &who, motion, moved).await;
            }
            Work::Home { axis } => {
                self.access.allow_unasked_motion();
                self.context.begin(RigActivity::Homing, &who);
                reply.send(Ok(())).ok();
                self.report_axis(&who, RigActivity::Homing, axis, AxisEvent::UNKNOWN);
                let homed = async {
                    stage.release(axis).await?;
                    stage.home_since(axis, stops_of_stage).await
                };
                let homed = homed.await;
                self.settled(&mut rig, &stage, &who, motion, homed).await;
            }
            Work::HomeBoth => {
                self.access.allow_unasked_motion();
                self.context.begin(RigActivity::Homing, &who);
                reply.send(Ok(())).ok();
                let event = Event::Rig {
                    activity: RigActivity::Homing,
                    theta_c: AxisEvent::UNKNOWN,
                    phi_s: AxisEvent::UNKNOWN,
                };
                self.context.sink.report_by(&who, event);
                let homed = async {
                    for axis in AxisName::ALL {
                        stage.release(axis).await?;
                    }
                    stage.home_all_since(stops_of_stage).await
                };
                let homed = homed.await;
                self.settled(&mut rig, &stage, &who, motion, homed).await;
            }
            Work::Jog(work) => {
                if let Err(error) = stage.check_jog(work.axis).await {
                    rig.let_go_if_lost(&error);
                    reply.send(Err(error.into())).ok();
                    return rig;
                }
                self.access.allow_unasked_motion();
                self.context.begin(RigActivity::Moving, &who);
                reply.send(Ok(())).ok();
                let (axis, order) = (work.axis, work.order.clone());
                let at_end = |why| work.at_end(why);
                let jogged = stage.jog(axis, order, stops_of_stage, at_end).await;
                self.settled(&mut rig, &stage, &who, motion, jogged.map(|_| ()))
                    .await;
            }
            Work::Preview(work) => {
                reply.send(Ok(())).ok();
                self.context.preview(&mut rig, &stage, *work).await;
            }
            Work::Scan(work) => {
                self.context.run_scan(&mut rig, *work, &who, reply).await;
            }
            Work::Park => {
                self.context.park(&mut rig).await;
                reply.send(Ok(())).ok();
            }
        }
        rig
    }

    /// Connects the stages and stops an axis that an earlier program left moving.
    async fn connect(&self, rig: &mut Rig) -> Result<Stage, StageError> {
        let known = rig.access().stage().is_some();
        let connected = async {
            let stage = rig.connect().await?;
            if !known {
                let status = stage.status().await?;
                if status.theta_c.moving || status.phi_s.moving {
                    tracing::warn!("the stages were moving when they were found; stopping them");
                    stage.stop().await?;
                }
            }
            if let Err(error) = self.context.pinned.pin(&stage.identity()).await {
                // The next connection tries again; until then this process remembers them.
                tracing::error!(%error, "the controllers of the rig could not be stored: {error}");
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
        self.context
            .occupation
            .send_modify(|now| now.problem = problem);
        connected
    }

    async fn check_move(
        &self,
        stage: &Stage,
        axis: AxisName,
        target: Angle,
    ) -> Result<(), StageError> {
        // Only the moving axis is checked; the other one stays where it is.
        stage.settings().check_limit(axis, target)?;
        if !stage.status().await?.axis(axis).homed {
            return Err(StageError::NotReferenced { axis });
        }
        stage.check_move(axis, target).await
    }

    async fn check_move_both(&self, stage: &Stage, target: Pose) -> Result<(), StageError> {
        stage.check_limits(target)?;
        let status = stage.status().await?;
        let unknown = AxisName::ALL
            .into_iter()
            .find(|axis| !status.axis(*axis).homed);
        if let Some(axis) = unknown {
            return Err(StageError::NotReferenced { axis });
        }
        stage.check_move_pose(target).await
    }

    async fn settled(
        &self,
        rig: &mut Rig,
        stage: &Stage,
        who: &Arc<str>,
        motion: Option<i64>,
        outcome: Result<(), StageError>,
    ) {
        let is_stopped = matches!(outcome, Err(StageError::Stopped));
        // A stopped axis has no position before it is at rest.
        let status = match is_stopped && stage.at_rest().await.is_err() {
            true => None,
            false => stage.status().await.ok(),
        };
        let failure = outcome
            .as_ref()
            .err()
            .map(|e| (crate::scan::visit::stage_code(e).to_owned(), e.to_string()));
        // At once, so that a client that sees the rig idle also sees the failure, and gets the rig as soon as it is back.
        self.context.occupation.send_modify(|now| {
            now.activity = None;
            now.failure = failure;
        });
        // After the rig is free, so that a caller that waited gets it.
        if let Some(id) = motion {
            self.context.motions.end(id, &outcome, status.as_ref());
        }
        if let Err(error) = &outcome {
            self.access.forbid_unasked_motion();
            rig.let_go_if_lost(error);
            if !is_stopped {
                let alarm = Event::Alarm {
                    code: crate::scan::visit::stage_code(error).into(),
                    message: error.to_string(),
                    scan_id: None,
                };
                self.context.sink.report_by(who, alarm);
            }
        }
        let at = |axis: Option<Angle>| axis.map_or(AxisEvent::UNKNOWN, AxisEvent::at);
        let event = Event::Rig {
            activity: RigActivity::Idle,
            theta_c: at(status.as_ref().map(|s| s.theta_c.position)),
            phi_s: at(status.as_ref().map(|s| s.phi_s.position)),
        };
        self.context.sink.report_by(who, event);
    }

    /// Does not wait for the database: a motion that was requested must not begin much later.
    fn report_axis(&self, who: &Arc<str>, activity: RigActivity, axis: AxisName, event: AxisEvent) {
        let (theta_c, phi_s) = match axis {
            AxisName::ThetaC => (event, AxisEvent::UNKNOWN),
            AxisName::PhiS => (AxisEvent::UNKNOWN, event),
        };
        let event = Event::Rig {
            activity,
            theta_c,
            phi_s,
        };
        self.context.sink.report_by(who, event);
    }
}
