//! Carries out a plan: moves, waits, takes frames, passes them to the recorder, and reports.
//!
//! [`run`] owns the rig until it returns. It reports a point only after the recorder has made frames, angles and row durable.
//! A move that failed, was interrupted or was stopped is never a success. A fault of the rig is retried as the settings
//! say (`recovery`), then pauses the scan, so that the operator can fix it and resume (`waiting`); a contradiction to the
//! plan fails the scan.

mod camera_checks;
mod lamp;
mod points;
mod progress;
mod recovery;
mod reference_checks;
mod suspension;
mod waiting;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use tokio::sync::{mpsc, oneshot};

use self::camera_checks::{CameraChecks, Confirmed, is_timed, looks_of};
use self::points::Points;
use self::progress::ProgressState;
use self::recovery::Recovered;
pub use self::suspension::SuspendRules;
use self::suspension::Suspensions;
use super::event::OperatorAction;
use super::faults::{Attempts, FaultPolicy};
use super::frame_history::{FrameHistory, FrameSummary};
use super::frame_rules::FrameRules;
use super::look::Look;
use super::plan::{Shot, Step};
use super::recorder::{RecordError, Recorder, Visit};
use super::reference::ReferenceRules;
use super::rig::Rig;
use super::seen_images::SeenImages;
use super::state::ScanState;
use super::tag_history::{TagHistory, TagRules};
use super::visit::{self, VisitError};
use crate::bench::AxisName;
use crate::bench::stage::MoveTimes;
use crate::clock::{Clock, GapWatch};
use crate::frame::{Frame, FrameKind, FrameTag};
use crate::program::Program;

/// A command to a running scan.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ScanCommand {
    /// Finish the point, then pause.
    Pause,
    /// Continue after a pause.
    Resume,
    /// The current operator step is done.
    Continue,
    /// This operator step is done. Refused if the scan waits for another step.
    Done(OperatorAction),
    /// Stop at once and end.
    Abort,
    /// Stop at once and pause: the stop button.
    Stop,
    /// The daemon ends: stop at once; the scan can be resumed.
    ShutDown,
}

/// A command with its reply channel.
pub struct CommandRequest {
    /// The command.
    pub command: ScanCommand,
    /// Receives the new state once the command has taken effect, or the state that did not permit it.
    pub reply: oneshot::Sender<Result<ScanState, ScanState>>,
}

/// Settings of the runner.
#[derive(Debug, Clone, PartialEq)]
pub struct RunnerSettings {
    /// What follows a fault.
    pub faults: FaultPolicy,
    /// Disk space that stays free.
    pub disk_reserve_bytes: u64,
    /// Largest size of one frame's file.
    pub frame_bytes_max: u64,
    /// Rules that an accepted frame satisfies.
    pub frame: FrameRules,
    /// Rules for what the camera states about its frames.
    pub tags: TagRules,
    /// When the scan returns to a reference pose.
    pub reference: ReferenceRules,
    /// Conditions that pass by themselves.
    pub suspend: SuspendRules,
    /// Switches the lamp on before the first exposure.
    pub lamp_on: Option<Program>,
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
pub struct ScanRun {
    /// Steps in order.
    pub steps: Vec<Step>,
    /// Points that earlier runs made durable.
    pub done: BTreeSet<u32>,
    /// Those of the sample among them that saturate the camera.
    pub full: BTreeSet<u32>,
    /// Last frames of earlier runs, also of points that do not count; empty in the first run.
    pub last_frames: Vec<Frame>,
    /// Points of earlier runs that no reference check covered, with the look of their frames, in the order taken.
    pub unchecked: Vec<(u32, Vec<Look>)>,
    /// What the camera stated about the frames so far, calibrations included.
    pub stated: FrameTag,
    /// Time that earlier runs spent.
    pub elapsed_s: f64,
    /// Settings.
    pub settings: RunnerSettings,
    /// Time.
    pub clock: Arc<dyn Clock>,
}

/// Runs a scan to its end or to `interrupted`.
///
/// # Errors
/// [`RecordError`] if the state itself could not be recorded. Every other failure is a state.
pub async fn run(
    run: ScanRun,
    rig: &mut Rig,
    recorder: &mut dyn Recorder,
    commands: &mut mpsc::Receiver<CommandRequest>,
) -> Result<RunEnd, RecordError> {
    let before_s = run.elapsed_s;
    let mut runner = Runner::new(run, rig, recorder, commands);
    let state = match runner.drive().await {
        Ok(()) => {
            runner.totals.progress.phase = None;
            runner.totals.progress.fraction = 1.0;
            runner.totals.progress.time_left_s = Some(0.0);
            let left_out = runner.left_out();
            runner
                .enter(ScanState::Completed, left_out.as_deref())
                .await?;
            ScanState::Completed
        }
        Err(Ending::Recorded(state)) => state,
        Err(Ending::Record(error)) => return Err(error),
    };
    Ok(RunEnd {
        state,
        elapsed_s: runner.totals.progress.elapsed_s - before_s,
        ideal_s: runner.totals.ideal_s,
    })
}

/// Why the steps ended early.
enum Ending {
    /// The scan is in this state, and that is recorded.
    Recorded(ScanState),
    /// Recording failed.
    Record(RecordError),
}

impl From<RecordError> for Ending {
    fn from(error: RecordError) -> Self {
        Ending::Record(error)
    }
}

struct Runner<'a> {
    run: ScanRun,
    rig: &'a mut Rig,
    recorder: &'a mut dyn Recorder,
    commands: &'a mut mpsc::Receiver<CommandRequest>,
    state: ScanState,
    /// Predicts moves. The runner keeps no handle of the stage: one that outlives its link would keep the port open and
    /// block the next connection.
    move_times: MoveTimes,
    /// Whether both axes have an encoder.
    slips_show: bool,
    /// Predicted time of all points.
    predicted_total_s: f64,
    /// Predicted time of each point in the order of the plan. A point taken out of turn has a longer way but the same share.
    in_turn_s: BTreeMap<u32, f64>,
    /// What the visits showed.
    history: FrameHistory,
    /// Images that the camera returned.
    seen: SeenImages,
    /// Axes that must be homed: they were blocked, or lost their position.
    doubted: BTreeSet<AxisName>,
    /// The fault that the scan has to recover from.
    trouble: Option<recovery::Trouble>,
    /// Points that the scan continues without.
    skipped: BTreeSet<u32>,
    /// What the camera stated about its frames.
    tags: TagHistory,
    camera_checks: CameraChecks,
    /// The points of the sample, for the checks at reference poses.
    points: Points,
    suspensions: Suspensions,
    /// Frames of each point of the plan.
    frames_of: BTreeMap<u32, u32>,
    totals: ProgressState,
}

impl<'a> Runner<'a> {
    fn new(
        run: ScanRun,
        rig: &'a mut Rig,
        recorder: &'a mut dyn Recorder,
        commands: &'a mut mpsc::Receiver<CommandRequest>,
    ) -> Self {
        let history = FrameHistory::of(&run.steps).after(&run.steps, &run.done, &run.full);
        let seen = SeenImages::of(&run.last_frames, &run.settings.frame);
        let mut runner = Runner {
            move_times: rig.link().settings.move_times(),
            trouble: recovery::Trouble::of_a_run_after(&run),
            skipped: BTreeSet::new(),
            tags: TagHistory::after(&run.settings.tags, &run.stated),
            camera_checks: CameraChecks::new(),
            points: Points::default(),
            suspensions: Suspensions::default(),
            frames_of: BTreeMap::new(),
            rig,
            recorder,
            commands,
            state: ScanState::Planned,
            slips_show: false,
            predicted_total_s: 0.0,
            in_turn_s: BTreeMap::new(),
            history,
            seen,
            doubted: BTreeSet::new(),
            totals: ProgressState::default(),
            run,
        };
        runner.totals = runner.count_what_is_left();
        runner
    }

    async fn drive(&mut self) -> Result<(), Ending> {
        self.rig.access().allow_unasked_motion();
        self.enter(ScanState::Running, None).await?;
        self.make_ready().await?;
        if self.rig.access().may_have_slipped() && !self.slips_show {
            // In an earlier scan or run that nothing confirmed, or before the daemon started.
            self.doubted.extend(AxisName::ALL);
            self.make_ready().await?;
        }
        self.rig.access().set_may_have_slipped(true);
        // Again, now with the speeds of the connected axes.
        let at = self.totals.at;
        self.totals = self.count_what_is_left();
        self.totals.at = at;
        let steps = std::mem::take(&mut self.run.steps);
        self.remember_unchecked(&steps);
        if self.totals.progress.shots_done < self.totals.progress.shots_total {
            self.switch_lamp_on().await?;
        }
        self.pause_if_asked().await?;
        for (i, step) in steps.iter().enumerate() {
            match step {
                Step::Operator(action) => {
                    let rest = &steps[i + 1..];
                    if self.anything_left(*action, rest) {
                        self.totals.progress.phase = Some(action.kind());
                        self.wait_for_operator(*action).await?;
                    }
                }
                Step::Shot(shot) => {
                    if !self.run.done.contains(&shot.index) {
                        self.totals.progress.phase = Some(shot.kind);
                        self.take(shot).await?;
                        self.decide(&steps).await?;
                    }
                    if shot.kind == FrameKind::Sample {
                        let done = &self.run.done;
                        let next = steps[i + 1..].iter().find_map(|step| match step {
                            Step::Shot(next) if !done.contains(&next.index) => next.target,
                            Step::Shot(_) | Step::Operator(_) => None,
                        });
                        self.check_reference(next).await?;
                        self.pause_if_asked().await?;
                    }
                    // An earlier run may have taken the last one and ended before it reported so.
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

    /// Takes the poses that distinguish a lobe from a series that is too bright, out of turn.
    async fn decide(&mut self, steps: &[Step]) -> Result<(), Ending> {
        while let Some(index) = self.history.undecided(&self.run.settings.frame) {
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
                if shot.kind == action.kind() && !self.run.done.contains(&shot.index))
        })
    }

    async fn enter(&mut self, next: ScanState, reason: Option<&str>) -> Result<(), RecordError> {
        self.recorder
            .state(next, reason, None, self.totals.progress)
            .await?;
        self.state = next;
        Ok(())
    }

    /// Takes one point, and again while it is rejected, until it is accepted, skipped, or the operator is needed.
    async fn take(&mut self, shot: &Shot) -> Result<(), Ending> {
        let mut attempts = Attempts::default();
        let mut visits = 0;
        loop {
            self.check_disk(shot).await?;
            self.suspend_if_needed(shot.exposures_s[0]).await?;
            let before = self.totals;
            let started = self.run.clock.now();
            let Some(outcome) = self.visit(shot, visits).await? else {
                // It was stopped and resumed; the waiting time counts as no motion.
                continue;
            };
            let error = match outcome {
                Ok(mut visit) => {
                    self.note_temperature(&visit);
                    if self.discards(&visit) {
                        continue;
                    }
                    visits += 1;
                    let rules = &self.run.settings.frame;
                    let summary = FrameSummary::at(&visit, rules);
                    if visit.rejected.is_none() {
                        visit.rejected = self.history.fault(&summary, rules);
                    }
                    let looks = looks_of(&visit, rules);
                    if visit.rejected.is_none() {
                        visit.rejected = self.camera_checks.as_dark(shot, &looks, rules);
                    }
                    if visit.rejected.is_none() && !is_timed(&visit) {
                        match self.confirm(shot, &looks).await? {
                            Confirmed::Yes => {}
                            Confirmed::No(why) => visit.rejected = Some(why),
                            Confirmed::Stopped => continue,
                            Confirmed::Failed(error) => {
                                self.camera_checks.doubt();
                                let next = self
                                    .recover(error, &mut attempts, Some(shot), false)
                                    .await?;
                                if next == Recovered::Skipped {
                                    return self.pause_if_asked().await;
                                }
                                continue;
                            }
                        }
                    }
                    if let Some(why) = visit.discarded.take() {
                        self.note_discarded(shot, &why);
                    }
                    let rejected = visit.rejected.clone();
                    self.count(shot, rejected.is_none());
                    match self.recorder.visit(visit, self.totals.progress).await {
                        Ok(()) => {}
                        Err(RecordError::DiskFull(why)) => {
                            // The point was not recorded; it is taken again once there is room.
                            self.totals = before;
                            self.hold_with(&why, Some("disk-full"), None).await?;
                            continue;
                        }
                        Err(error) => return Err(error.into()),
                    }
                    let took = self.run.clock.now().saturating_sub(started);
                    self.totals.progress.elapsed_s += took.as_secs_f64();
                    match rejected {
                        None => {
                            self.history.remember(&summary);
                            self.remember_look(shot, looks, self.totals.ideal_s - before.ideal_s);
                            self.run.done.insert(shot.index);
                            self.report_recovery(shot).await;
                            return self.pause_if_asked().await;
                        }
                        Some(why) => VisitError::Frames(why),
                    }
                }
                Err(error) => error,
            };
            self.camera_checks.doubt();
            let next = self
                .recover(error, &mut attempts, Some(shot), false)
                .await?;
            if next == Recovered::Skipped {
                return self.pause_if_asked().await;
            }
        }
    }

    /// Returns what a complete scan has no frames of, and what no check confirmed.
    fn left_out(&self) -> Option<String> {
        let count = self.skipped.len();
        let skipped = (count > 0).then(|| {
            let points = crate::wording::counted(count, "point");
            format!("{points} skipped after faults; the alarms of the scan name them")
        });
        let parts: Vec<String> = skipped.into_iter().chain(self.unconfirmed()).collect();
        (!parts.is_empty()).then(|| parts.join("; "))
    }

    /// Moves and captures while it listens to commands; `None` where it was stopped and resumed. The outer error ends the
    /// scan.
    async fn visit(
        &mut self,
        shot: &Shot,
        attempt: u32,
    ) -> Result<Option<Result<Visit, VisitError>>, Ending> {
        let stage = match self.stage_for_a_move().await? {
            Some(Ok(stage)) => stage,
            Some(Err(error)) => return Ok(Some(Err(VisitError::Stage(error)))),
            None => return Ok(None),
        };
        let settings = &self.run.settings;
        let clock = Arc::clone(&self.run.clock);
        let context = visit::VisitContext {
            rules: &settings.frame,
            tag_rules: &settings.tags,
            tags: &mut self.tags,
            seen: &mut self.seen,
            clock: &*clock,
        };
        let access = self.rig.access().clone();
        let camera = self.rig.camera.as_mut();
        let visit = visit::visit(&stage, camera, shot, attempt, context);
        let mut gaps = GapWatch::new(&*clock);
        let watched = async {
            tokio::select! {
                biased;
                // Before the outcome: after a gap it says nothing about the stages.
                gap = gaps.next(&*clock) => Err(gap),
                outcome = visit => Ok(outcome),
            }
        };
        let orders = waiting::Orders {
            commands: &mut *self.commands,
            recorder: &mut *self.recorder,
            state: &mut self.state,
            progress: self.totals.progress,
            access,
        };
        let cut = match orders.during(watched).await? {
            Ok(Ok(outcome)) => {
                if outcome.is_err() {
                    self.totals.at = None;
                }
                return Ok(Some(outcome));
            }
            Ok(Err(gap)) => {
                drop(stage);
                self.totals.at = None;
                self.rig.let_go();
                let gap_s = gap.as_secs_f64();
                return Ok(Some(Err(VisitError::Suspended { gap_s })));
            }
            Err(cut) => cut,
        };
        drop(stage);
        self.stop_motion().await;
        self.cut_short(cut).await?;
        Ok(None)
    }
}
