//! Carries a plan out: moves, waits, takes frames, hands them on, and tells what happened.
//!
//! [`run`] owns the rig until it returns. It never says that a point is there before the recorder
//! has made frames, angles and row durable; a move that failed, was interrupted or was stopped is
//! never a success. What goes wrong at the rig pauses the scan, so that a person can put it right
//! and resume; what contradicts the plan fails it.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

use tokio::sync::{mpsc, oneshot};

use super::event::{OperatorAction, Progress};
use super::plan::{Shot, Step};
use super::recorder::{RecordError, Recorder, Visit};
use super::rig::Rig;
use super::seen::{Looked, Seen};
use super::state::ScanState;
use super::visit::{self, Trouble};
use crate::bench::AxisName;
use crate::bench::stage::{Stage, StageError};
use crate::clock::Clock;
use crate::frame::Frame;
use crate::geometry::Pose;

/// What a person or the daemon asks of a running scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// Finish the point, then hold.
    Pause,
    /// Go on.
    Resume,
    /// The operator's step is done, whichever it is.
    Continue,
    /// This step of the operator's is done. Whoever did another one has not placed what the next frames are to show.
    Done(OperatorAction),
    /// Stop at once and end.
    Abort,
    /// Stop at once and hold: the stop button.
    Stop,
    /// The daemon ends: stop at once and leave the rest for later.
    ShutDown,
}

/// An order with the way back: the state it led to, or the state that did not permit it.
pub struct OrderSlip {
    /// What is asked.
    pub order: Order,
    /// Answered when the order has taken effect.
    pub reply: oneshot::Sender<Result<ScanState, ScanState>>,
}

/// What the runner needs to know beside the plan.
#[derive(Debug, Clone, PartialEq)]
pub struct RunnerSettings {
    /// Visits to one point before the scan pauses.
    pub attempts_max: u32,
    /// Space that is left alone.
    pub disk_reserve_bytes: u64,
    /// Most bytes one frame can take.
    pub frame_bytes_max: u64,
    /// What a frame must look like.
    pub frame: visit::FrameRules,
}

/// How a run ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RunEnd {
    /// State it ended in.
    pub state: ScanState,
    /// Time spent moving and exposing.
    pub elapsed_s: f64,
    /// Predicted time of the same motions, settling and exposures.
    pub ideal_s: f64,
}

/// A scan to be run.
pub struct Job {
    /// Steps in order.
    pub steps: Vec<Step>,
    /// Points that are durable from an earlier run.
    pub done: BTreeSet<u32>,
    /// Those of the sample among them that fill the camera.
    pub full: BTreeSet<u32>,
    /// Frames of the last of these; empty where it is the first run.
    pub last_frames: Vec<Frame>,
    /// Time that earlier runs spent.
    pub elapsed_s: f64,
    /// Settings.
    pub settings: RunnerSettings,
    /// Time.
    pub clock: Arc<dyn Clock>,
}

/// Runs a scan to an end, to `interrupted`, or to where it cannot even say so.
///
/// # Errors
/// Only if the state itself could not be recorded; everything else is a state.
pub async fn run(
    job: Job,
    rig: &mut Rig,
    recorder: &mut dyn Recorder,
    orders: &mut mpsc::Receiver<OrderSlip>,
) -> Result<RunEnd, RecordError> {
    let before_s = job.elapsed_s;
    let mut runner = Runner::new(job, rig, recorder, orders);
    let state = match runner.drive().await {
        Ok(()) => {
            runner.ledger.progress.phase = None;
            runner.ledger.progress.fraction = 1.0;
            runner.ledger.progress.time_left_s = Some(0.0);
            runner.enter(ScanState::Completed, None).await?;
            ScanState::Completed
        }
        Err(Ending::Recorded(state)) => state,
        Err(Ending::Record(error)) => return Err(error),
    };
    Ok(RunEnd {
        state,
        elapsed_s: runner.ledger.progress.elapsed_s - before_s,
        ideal_s: runner.ledger.ideal_s,
    })
}

/// Why the steps are left before their end.
enum Ending {
    /// The scan is in this state, and that is recorded.
    Recorded(ScanState),
    /// Nothing can be recorded any more.
    Record(RecordError),
}

impl From<RecordError> for Ending {
    fn from(error: RecordError) -> Self {
        Ending::Record(error)
    }
}

struct Runner<'a> {
    job: Job,
    rig: &'a mut Rig,
    recorder: &'a mut dyn Recorder,
    orders: &'a mut mpsc::Receiver<OrderSlip>,
    state: ScanState,
    /// Knows how fast the axes are, once connected.
    stage: Option<Stage>,
    /// Predicted time of all points.
    predicted_total_s: f64,
    /// The share of each in it: one that is taken out of turn has a longer way, and no more of the plan in it.
    in_turn_s: BTreeMap<u32, f64>,
    /// What the visits have shown.
    seen: Seen,
    /// Axes that are not to be trusted until they are homed: something blocked them, or lost their place.
    doubted: BTreeSet<AxisName>,
    ledger: Ledger,
}

/// What grows with every point; put back as a whole if a point could not be recorded.
#[derive(Clone, Copy, Default)]
struct Ledger {
    progress: Progress,
    /// Predicted time of the points that are done, from earlier runs too.
    predicted_done_s: f64,
    /// Predicted time of the points done in this run, retakes included.
    ideal_s: f64,
    /// Where the stages were last read; `None` when not known.
    at: Option<Pose>,
}

impl<'a> Runner<'a> {
    fn new(
        job: Job,
        rig: &'a mut Rig,
        recorder: &'a mut dyn Recorder,
        orders: &'a mut mpsc::Receiver<OrderSlip>,
    ) -> Self {
        let rules = &job.settings.frame;
        let seen =
            Seen::of(&job.steps).after(&job.last_frames, &job.steps, &job.done, &job.full, rules);
        let mut runner = Runner {
            rig,
            recorder,
            orders,
            state: ScanState::Planned,
            stage: None,
            predicted_total_s: 0.0,
            in_turn_s: BTreeMap::new(),
            seen,
            doubted: BTreeSet::new(),
            ledger: Ledger::default(),
            job,
        };
        runner.ledger = runner.count_what_is_left();
        runner
    }

    /// Totals of the plan, and what of it is done from earlier runs.
    fn count_what_is_left(&mut self) -> Ledger {
        let mut ledger = Ledger::default();
        ledger.progress.elapsed_s = self.job.elapsed_s;
        self.predicted_total_s = 0.0;
        let mut at = None;
        for step in &self.job.steps {
            let Step::Shot(shot) = step else { continue };
            ledger.progress.shots_total += 1;
            ledger.progress.frames_total += shot.n_frames();
            let predicted = self.predict(at, shot);
            at = shot.target.or(at);
            self.predicted_total_s += predicted;
            self.in_turn_s.insert(shot.index, predicted);
            if self.job.done.contains(&shot.index) {
                ledger.progress.shots_done += 1;
                ledger.progress.frames_done += shot.n_frames();
                ledger.predicted_done_s += predicted;
            }
        }
        ledger
    }

    fn predict(&self, at: Option<Pose>, shot: &Shot) -> f64 {
        let motion = match (at, shot.target) {
            (Some(at), Some(target)) => match &self.stage {
                Some(stage) => stage.predicted_move(at, target),
                None => self.rig.link().settings.predicted_move(at, target),
            },
            _ => Duration::ZERO,
        };
        motion.as_secs_f64() + shot.exposure_total_s()
    }

    async fn drive(&mut self) -> Result<(), Ending> {
        self.enter(ScanState::Running, None).await?;
        self.make_ready(true).await?;
        // Now that the speeds are known.
        let at = self.ledger.at;
        self.ledger = self.count_what_is_left();
        self.ledger.at = at;
        let steps = std::mem::take(&mut self.job.steps);
        for (i, step) in steps.iter().enumerate() {
            match step {
                Step::Operator(action) => {
                    let rest = &steps[i + 1..];
                    if self.anything_left(*action, rest) {
                        self.ledger.progress.phase = Some(action.kind());
                        self.wait_for_operator(*action).await?;
                    }
                }
                Step::Shot(shot) => {
                    if !self.job.done.contains(&shot.index) {
                        if self.state != ScanState::Running {
                            self.enter(ScanState::Running, None).await?;
                        }
                        self.ledger.progress.phase = Some(shot.kind);
                        self.take(shot).await?;
                        self.decide(&steps).await?;
                    }
                    // An earlier run may have taken the last one and ended before it said so.
                    let more = steps[i + 1..]
                        .iter()
                        .any(|step| matches!(step, Step::Shot(next) if next.kind == shot.kind));
                    if !more {
                        self.recorder.phase_done(shot.kind).await?;
                    }
                }
            }
        }
        Ok(())
    }

    /// Takes the poses that tell a lobe from a series that is too bright before their turn, where it may be either.
    async fn decide(&mut self, steps: &[Step]) -> Result<(), Ending> {
        while let Some(index) = self.seen.undecided(&self.job.settings.frame) {
            let pose = steps.iter().find_map(|step| match step {
                Step::Shot(shot) if shot.index == index => Some(shot),
                Step::Shot(_) | Step::Operator(_) => None,
            });
            let Some(pose) = pose else { return Ok(()) };
            self.take(pose).await?;
        }
        Ok(())
    }

    fn anything_left(&self, action: OperatorAction, rest: &[Step]) -> bool {
        rest.iter().any(|step| {
            matches!(step, Step::Shot(shot)
                if shot.kind == action.kind() && !self.job.done.contains(&shot.index))
        })
    }

    async fn enter(&mut self, next: ScanState, reason: Option<&str>) -> Result<(), RecordError> {
        self.recorder
            .state(next, reason, None, self.ledger.progress)
            .await?;
        self.state = next;
        Ok(())
    }

    /// Connects and homes; a rig that cannot be had pauses the scan until it is resumed. `by_a_person`: whether somebody
    /// has just asked for motion, and stands clear of the stages.
    async fn make_ready(&mut self, mut by_a_person: bool) -> Result<(), Ending> {
        loop {
            let (rig, doubted) = (&mut *self.rig, &self.doubted);
            let ready = async {
                let stage = rig.make_ready(doubted, by_a_person).await?;
                let status = stage.status().await?;
                Ok::<_, StageError>((stage, status))
            };
            match ready.await {
                Ok((stage, status)) => {
                    self.doubted.clear();
                    self.stage = Some(stage);
                    self.ledger.at = Some(status.pose());
                    return Ok(());
                }
                Err(error) => {
                    self.doubted.extend(error.axis_to_home());
                    self.hold(&Trouble::Stage(error)).await?;
                    by_a_person = true;
                }
            }
        }
    }

    /// Takes one point, again where it does not count, until it does or a person is needed.
    async fn take(&mut self, shot: &Shot) -> Result<(), Ending> {
        let mut attempt = 0;
        loop {
            self.check_disk(shot).await?;
            let before = self.ledger;
            let started = self.job.clock.now();
            let Some(outcome) = self.visit(shot, attempt).await? else {
                // It was stopped and resumed; what was waited is nobody's motion.
                continue;
            };
            attempt += 1;
            let trouble = match outcome {
                Ok(mut visit) => {
                    let rules = &self.job.settings.frame;
                    let looked = Looked::at(&visit, rules);
                    if visit.rejected.is_none() {
                        visit.rejected = self.seen.fault(&looked, rules);
                    }
                    let rejected = visit.rejected.clone();
                    self.count(shot, rejected.is_none());
                    match self.recorder.visit(visit, self.ledger.progress).await {
                        Ok(()) => {}
                        Err(RecordError::DiskFull(why)) => {
                            // The point is not there; it is taken again once there is room.
                            self.ledger = before;
                            self.hold_with(&why, Some("disk-full"), None).await?;
                            continue;
                        }
                        Err(error) => return Err(error.into()),
                    }
                    let took = self.job.clock.now().saturating_sub(started);
                    self.ledger.progress.elapsed_s += took.as_secs_f64();
                    match rejected {
                        None => {
                            self.seen.remember(looked);
                            self.job.done.insert(shot.index);
                            return self.pause_if_asked().await;
                        }
                        Some(why) => Trouble::Frames(why),
                    }
                }
                Err(trouble) => trouble,
            };
            if let Trouble::Stage(error) = &trouble {
                self.doubted.extend(error.axis_to_home());
                // A handle that is kept keeps the port, and nobody could connect or stop anew.
                if error.is_disconnect() {
                    self.stage = None;
                }
                self.rig.let_go_if_lost(error);
            }
            if trouble.contradicts_the_plan() {
                let why = trouble.to_string();
                self.enter(ScanState::Failed, Some(&why)).await?;
                return Err(Ending::Recorded(ScanState::Failed));
            }
            let ask = !trouble.may_be_retried() || attempt >= self.job.settings.attempts_max;
            if ask {
                self.hold(&trouble).await?;
                attempt = 0;
                // Somebody has looked at a black sample and says to go on: some are. Who resumes after any
                // other trouble has not looked.
                if let Trouble::Frames(rejected) = &trouble {
                    self.job.settings.frame.looked_at.note(rejected);
                }
            }
            if matches!(trouble, Trouble::Stage(_)) {
                self.make_ready(ask).await?;
            }
        }
    }

    fn count(&mut self, shot: &Shot, accepted: bool) {
        let predicted = self.predict(self.ledger.at, shot);
        let ledger = &mut self.ledger;
        ledger.ideal_s += predicted;
        ledger.at = shot.target.or(ledger.at);
        if !accepted {
            return;
        }
        let progress = &mut ledger.progress;
        progress.shots_done += 1;
        progress.frames_done += shot.n_frames();
        let in_turn_s = self.in_turn_s.get(&shot.index).copied();
        let done_s = ledger.predicted_done_s + in_turn_s.unwrap_or(predicted);
        ledger.predicted_done_s = done_s.min(self.predicted_total_s);
        if self.predicted_total_s > 0.0 {
            progress.fraction = ledger.predicted_done_s / self.predicted_total_s;
        }
        // The pace of this run so far; the first point has none yet.
        let spent_s = progress.elapsed_s - self.job.elapsed_s;
        let pace = if spent_s > 0.0 && ledger.ideal_s > predicted {
            spent_s / (ledger.ideal_s - predicted)
        } else {
            1.0
        };
        progress.time_left_s = Some((self.predicted_total_s - ledger.predicted_done_s) * pace);
    }

    /// Moves and captures, listening to orders all the while; `None` where it was stopped, and resumed since. The
    /// outer error ends the scan.
    async fn visit(
        &mut self,
        shot: &Shot,
        attempt: u32,
    ) -> Result<Option<Result<Visit, Trouble>>, Ending> {
        let stage = match self.rig.connect().await {
            Ok(stage) => stage,
            Err(error) => return Ok(Some(Err(Trouble::Stage(error)))),
        };
        let rules = self.job.settings.frame.clone();
        let camera = self.rig.camera.as_mut();
        let mut work = Box::pin(visit::visit(&stage, camera, shot, attempt, &rules));
        let cut = loop {
            tokio::select! {
                biased;
                slip = self.orders.recv() => {
                    let slip = slip.unwrap_or_else(shut_down);
                    match (slip.order, self.state) {
                        (Order::Pause, ScanState::Running) => {
                            self.recorder.state(ScanState::Pausing, None, None, self.ledger.progress).await?;
                            self.state = ScanState::Pausing;
                            slip.reply.send(Ok(self.state)).ok();
                        }
                        (Order::Resume, ScanState::Pausing) => {
                            self.recorder.state(ScanState::Running, None, None, self.ledger.progress).await?;
                            self.state = ScanState::Running;
                            slip.reply.send(Ok(self.state)).ok();
                        }
                        (Order::Stop | Order::Abort | Order::ShutDown, _) => break slip,
                        _ => { slip.reply.send(Err(self.state)).ok(); }
                    }
                }
                outcome = &mut work => {
                    drop(work);
                    if outcome.is_err() {
                        self.ledger.at = None;
                    }
                    return Ok(Some(outcome));
                }
            }
        };
        drop(work);
        if let Err(error) = stage.stop().await {
            tracing::error!(%error, "the stop of a scan did not reach the stage: {error}");
        }
        self.ledger.at = None;
        match cut.order {
            Order::Stop => {
                self.hold_with(Trouble::STOPPED, None, Some(cut)).await?;
                self.make_ready(true).await?;
                Ok(None)
            }
            order => self.end_by(order, cut).await,
        }
    }

    async fn end_by<T>(&mut self, order: Order, slip: OrderSlip) -> Result<T, Ending> {
        let (state, reason) = match order {
            Order::Abort => (ScanState::Aborted, "aborted by the operator"),
            _ => (
                ScanState::Interrupted,
                "the daemon was stopped; resume it to go on",
            ),
        };
        self.enter(state, Some(reason)).await?;
        slip.reply.send(Ok(state)).ok();
        Err(Ending::Recorded(state))
    }

    /// Holds until there is room for all frames of a point.
    async fn check_disk(&mut self, shot: &Shot) -> Result<(), Ending> {
        let settings = &self.job.settings;
        let needed =
            settings.disk_reserve_bytes + u64::from(shot.n_frames()) * settings.frame_bytes_max;
        loop {
            let free = self.recorder.free_bytes()?;
            if free >= needed {
                return Ok(());
            }
            let why = format!(
                "the disk is full: {} MB are free and {} MB are needed; free some space, then resume",
                free / 1_000_000,
                needed / 1_000_000
            );
            self.hold_with(&why, Some("disk-full"), None).await?;
        }
    }

    async fn pause_if_asked(&mut self) -> Result<(), Ending> {
        if self.state == ScanState::Pausing {
            self.enter(ScanState::Paused, None).await?;
            self.wait_for_resume().await?;
        }
        Ok(())
    }

    async fn hold(&mut self, trouble: &Trouble) -> Result<(), Ending> {
        let code = trouble.code();
        let reason = match trouble {
            // What stages and camera say of themselves knows of no scan that waits.
            Trouble::Stage(error) if error.axis_to_home().is_some() => {
                format!("{trouble}; put it right, then resume: the scan homes it first")
            }
            Trouble::Stage(_) | Trouble::Camera(_) if code.is_some() => {
                format!("{trouble}; put it right, then resume")
            }
            _ => trouble.to_string(),
        };
        self.hold_with(&reason, code, None).await
    }

    /// Pauses for a reason, raises the alarm if it has a code, and waits to be resumed.
    async fn hold_with(
        &mut self,
        reason: &str,
        code: Option<&str>,
        slip: Option<OrderSlip>,
    ) -> Result<(), Ending> {
        // First, so that whoever sees the scan paused finds the alarm that says why.
        if let Some(code) = code {
            self.recorder.alarm(code, reason).await;
        }
        self.enter(ScanState::Paused, Some(reason)).await?;
        if let Some(slip) = slip {
            slip.reply.send(Ok(ScanState::Paused)).ok();
        }
        self.wait_for_resume().await
    }

    async fn wait_for_resume(&mut self) -> Result<(), Ending> {
        loop {
            let slip = self.orders.recv().await.unwrap_or_else(shut_down);
            match slip.order {
                Order::Resume | Order::Continue => {
                    self.enter(ScanState::Running, None).await?;
                    slip.reply.send(Ok(self.state)).ok();
                    return Ok(());
                }
                Order::Abort | Order::ShutDown => return self.end_by(slip.order, slip).await,
                Order::Stop | Order::Pause => {
                    slip.reply.send(Ok(self.state)).ok();
                }
                // What was done is another matter than why it holds.
                Order::Done(_) => {
                    slip.reply.send(Err(self.state)).ok();
                }
            }
        }
    }

    async fn wait_for_operator(&mut self, action: OperatorAction) -> Result<(), Ending> {
        loop {
            if self.state != ScanState::WaitingForOperator {
                self.recorder
                    .state(
                        ScanState::WaitingForOperator,
                        None,
                        Some(action),
                        self.ledger.progress,
                    )
                    .await?;
                self.state = ScanState::WaitingForOperator;
            }
            let slip = self.orders.recv().await.unwrap_or_else(shut_down);
            match slip.order {
                Order::Done(other) if other != action => {
                    slip.reply.send(Err(self.state)).ok();
                }
                Order::Continue | Order::Resume | Order::Done(_) => {
                    self.enter(ScanState::Running, None).await?;
                    slip.reply.send(Ok(self.state)).ok();
                    return Ok(());
                }
                Order::Abort | Order::ShutDown => return self.end_by(slip.order, slip).await,
                Order::Pause | Order::Stop => {
                    let reason = match slip.order {
                        Order::Stop => Some(Trouble::STOPPED),
                        _ => None,
                    };
                    self.enter(ScanState::Paused, reason).await?;
                    slip.reply.send(Ok(self.state)).ok();
                    self.wait_for_resume().await?;
                }
            }
        }
    }
}

/// What a closed order book means: whoever held it is gone.
fn shut_down() -> OrderSlip {
    OrderSlip {
        order: Order::ShutDown,
        reply: oneshot::channel().0,
    }
}
