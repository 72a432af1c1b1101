//! The task that owns stages and camera.
//!
//! The owner does one piece of work at a time. The current work is a future that holds the rig and returns it, so two
//! motions cannot overlap. While the rig reports an activity, the owner refuses further requests at once instead of
//! queueing them. Otherwise it accepts a request, if necessary a moment later, once the stages are connected, a target is
//! checked or the rig is returned. A preview ends for any other order, which then waits only until the rig is returned.

mod motion;

use std::collections::VecDeque;
use std::sync::{Arc, Mutex};

use futures::future::BoxFuture;
use serde_json::json;
use tokio::sync::{mpsc, watch};
use tokio_util::sync::CancellationToken;

use super::motions::Motions;
use super::operator_calls::Hands;
use super::pinned_stages::{PinnedStages, record_notices};
use super::preview_work::Previews;
use super::work::{Request, Work};
use crate::bench::stage::{Stage, StageError};
use crate::lab::event_sink::EventSink;
use crate::lab::scans::scan_run::RigContext;
use crate::lab::{Holder, LabError, Occupation, RigParts, RigSide};
use crate::scan::event::RigActivity;
use crate::scan::{Rig, StageAccess};
use crate::store::StoreError;
use motion::MotionOrder;

/// Spawns the task that owns the rig from now on. The task first switches off the lamp if a kill ended the scan `cut_off`.
pub(in crate::lab) async fn take(
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

#[derive(Clone)]
struct Owner {
    context: RigContext,
    access: StageAccess,
}

impl Owner {
    async fn run(self, rig: Rig, mut inbox: mpsc::Receiver<Request>) {
        let mut free = Some(rig);
        let mut current: Option<BoxFuture<'static, Done>> = None;
        // Number of stops before the current motion; `None` if the current work is no motion.
        let mut stoppable: Option<u64> = None;
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
                    () = async { occupied.wait_for(|now| self.is_taken(now, stoppable)).await.ok(); },
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
                    let is_a_motion = matches!(request.work, Work::Motion { .. });
                    stoppable = is_a_motion.then_some(asked_after);
                    preview = match &request.work {
                        Work::Preview(work) => Some(work.give_way.clone()),
                        _ => None,
                    };
                    current = Some(Box::pin(self.clone().work(rig, request)));
                }
                None if self.is_taken(&self.context.occupation.borrow(), stoppable) => {
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

    /// Returns whether the current work refuses further requests. An axis that got a stop is about to be free.
    fn is_taken(&self, now: &Occupation, stoppable: Option<u64>) -> bool {
        let stopped = stoppable.is_some_and(|asked_after| self.access.stops() != asked_after);
        now.activity.is_some() && !now.clears_up && !stopped
    }

    fn refuse(&self, request: Request) {
        let with = self.held_by();
        request.reply.send(Err(LabError::Busy { with })).ok();
    }

    /// Returns what holds the rig. The caller adds a scan's state from the store, so that the owner does not wait for the database.
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
            who,
            stops,
            reply,
        } = request;
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
            Work::Motion { motion, number } => {
                let order = MotionOrder {
                    motion,
                    number,
                    who,
                    stops,
                    reply,
                };
                self.make_motion(&mut rig, &stage, order).await;
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
}
