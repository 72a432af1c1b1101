//! Runs of the runner with cues for camera, axes and people, and what a recorder notes of them.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures::future::BoxFuture;
use ridged::bench::{AxisName, Camera, CameraError, CaptureRequest, Captured};
use ridged::clock::{Clock, SteppedClock};
use ridged::frame::{Frame, FrameKind, FrameTag};
use ridged::geometry::Pose;
use ridged::lab::RigParts;
use ridged::scan::look::Look;
use ridged::scan::recorder::{RecordError, Recorder, Recovery, Visit};
use ridged::scan::runner::{self, CommandRequest, RunEnd, RunnerSettings, ScanCommand, ScanRun};
use ridged::scan::{OperatorAction, Progress, Rig, ScanState, Shot, Step};
use ridged::sim::faults::{LineFault, ScriptedFaults};
use ridged::sim::rig::{SimulatedRig, Simulation};
use ridged::sim::world::{AxisFault, OnTable, World};
use tokio::sync::{mpsc, oneshot};

/// What the camera states differently.
pub(super) type Statement = fn(&mut FrameTag);

/// What happens when the camera is asked for its n-th frame, from 1.
pub(super) enum Cue {
    /// It fails.
    Fail,
    /// The lamp has gone out: from now on all frames are black.
    Black,
    /// The lamp is far too bright: from now on all frames are full.
    Full,
    /// The camera hangs: from now on it gives the frame before again.
    Hang,
    /// It gives new ones again.
    Wake,
    /// Somebody presses stop while it exposes.
    Stop,
    /// A person gives an order, and the frame comes all the same. For frame 0: before the run begins.
    Order(ScanCommand),
    /// A person gives an order once the point of this frame is recorded.
    OrderAfter(ScanCommand),
    /// Its buffer is this number of frames behind from now on, and it states nothing about its frames. For frame 0: the buffer
    /// holds frames of another pose when the run begins.
    LagUntimed(usize),
    /// Its buffer is one frame behind from now on.
    Lag,
    /// This one frame shows the pose before with new noise; it states nothing about its frames.
    Stale,
    /// The lamp gives this share of its light from now on.
    Fade(f64),
    /// Its frames state this from now on.
    State(Statement),
    /// The computer is suspended while it exposes.
    Suspend,
    /// The controllers have no encoder. For frame 0.
    NoEncoder,
    /// Something happens to an axis while it exposes.
    Cause(AxisName, AxisFault),
    /// From now on its pictures are even, and have these counts at a pose.
    Even(fn(Pose) -> f64),
}

/// The simulated camera, with faults by the number of the frame.
struct CuedCamera {
    camera: Box<dyn Camera>,
    world: Arc<World>,
    /// What all pixels have from now on.
    uniform_dn: Option<u16>,
    hangs: bool,
    last: Option<Frame>,
    cues: BTreeMap<u32, Cue>,
    orders: mpsc::Sender<CommandRequest>,
    asked: u32,
    clock: Arc<SteppedClock>,
    /// Frames that it is behind.
    lag: usize,
    /// The newest frames that it took, oldest first.
    buffer: VecDeque<Captured>,
    stale: bool,
    /// Share of the light that the lamp gives.
    light: f64,
    state: Option<Statement>,
    even: Option<fn(Pose) -> f64>,
    /// Frames with the poses that they show.
    shown: Shown,
    once_recorded: OnceRecorded,
}

/// Frames that the buffer of the camera holds.
const BUFFER: usize = 8;

impl CuedCamera {
    /// Notes what a frame shows.
    fn note(&self, captured: &Captured, exposure_s: f64) {
        let world = &self.world;
        let kind = match (world.lens_capped(), world.on_table()) {
            (true, _) => FrameKind::Dark,
            (false, OnTable::WhiteReference) => FrameKind::Flat,
            (false, _) => FrameKind::Sample,
        };
        self.shown.lock().unwrap().push(Truth {
            frame: captured.frame.clone(),
            pose: world.pose_now(),
            exposure_s,
            kind,
        });
    }

    /// Fills the buffer with frames of a pose that no test visits.
    async fn fill_buffer(&mut self, frames: usize) {
        let pose = Pose::from_deg(35.0, 0.0);
        self.world.set_pose(pose);
        let request = CaptureRequest {
            kind: FrameKind::Sample,
            pose,
            exposure_s: 0.02,
            repeat: 0,
        };
        for _ in 0..frames {
            let captured = self.camera.capture(&request).await.unwrap();
            self.note(&captured, request.exposure_s);
            self.buffer.push_back(captured);
        }
        self.world.set_pose(Pose::from_deg(0.0, 0.0));
    }
}

/// The order that follows the point that is recorded next.
type OnceRecorded = Arc<Mutex<Option<ScanCommand>>>;

type Shown = Arc<Mutex<Vec<Truth>>>;

/// A frame and what it shows.
struct Truth {
    frame: Frame,
    pose: Pose,
    exposure_s: f64,
    kind: FrameKind,
}

impl Camera for CuedCamera {
    fn describe(&self) -> String {
        self.camera.describe()
    }

    fn capture<'a>(
        &'a mut self,
        request: &'a CaptureRequest,
    ) -> BoxFuture<'a, Result<Captured, CameraError>> {
        self.asked += 1;
        match self.cues.get(&self.asked) {
            None | Some(Cue::NoEncoder) => {}
            Some(Cue::Black) => self.uniform_dn = Some(200),
            Some(Cue::Full) => self.uniform_dn = Some(u16::MAX),
            Some(Cue::Hang) => self.hangs = true,
            Some(Cue::Wake) => self.hangs = false,
            Some(Cue::LagUntimed(frames)) => {
                self.lag = *frames;
                self.state = Some(|tag| *tag = FrameTag::default());
            }
            Some(Cue::Lag) => self.lag = 1,
            Some(Cue::Stale) => self.stale = true,
            Some(Cue::Fade(share)) => self.light = *share,
            Some(Cue::State(state)) => self.state = Some(*state),
            Some(Cue::Suspend) => {
                self.clock.suspend_machine(Duration::from_secs(600));
                // The gap is found before the frame comes.
                return Box::pin(async {
                    tokio::time::sleep(Duration::from_secs(5)).await;
                    Err(CameraError::Failed("the exposure went on".into()))
                });
            }
            Some(Cue::Cause(axis, fault)) => self.world.cause(*axis, *fault),
            Some(Cue::Even(level_dn)) => self.even = Some(*level_dn),
            Some(Cue::Fail) => {
                let failed = CameraError::Failed("the cable came off".into());
                return Box::pin(std::future::ready(Err(failed)));
            }
            Some(Cue::Order(order)) => {
                let request = command_request(*order);
                self.orders.try_send(request).ok().unwrap();
            }
            Some(Cue::OrderAfter(order)) => *self.once_recorded.lock().unwrap() = Some(*order),
            Some(Cue::Stop) => {
                self.orders
                    .try_send(command_request(ScanCommand::Stop))
                    .ok()
                    .unwrap();
                return Box::pin(std::future::pending());
            }
        }
        Box::pin(async move {
            let mut captured = self.camera.capture(request).await?;
            if let Some(dn) = self.uniform_dn {
                let (width, height) = (captured.frame.width_px(), captured.frame.height_px());
                let uniform_dn = vec![dn; (width * height) as usize];
                captured.frame = Frame::new(width, height, uniform_dn).unwrap();
            }
            if let Some(level_dn) = self.even {
                let level_dn = level_dn(self.world.pose_now()).round() as u16;
                let (width, height) = (captured.frame.width_px(), captured.frame.height_px());
                // Noise by the number of the frame, so that no image comes twice.
                let noise =
                    |i: u32| (i.wrapping_mul(self.asked).wrapping_mul(2_654_435_761) >> 28) as u16;
                let pixels_dn = (0..width * height).map(|i| level_dn + noise(i)).collect();
                captured.frame = Frame::new(width, height, pixels_dn).unwrap();
            }
            if self.hangs
                && let Some(last) = &self.last
            {
                captured.frame = last.clone();
            }
            if self.light != 1.0 {
                let dn = captured.frame.pixels_dn().iter();
                let dim = |dn: &u16| (200.0 + self.light * (f64::from(*dn) - 200.0)).round() as u16;
                let (width, height) = (captured.frame.width_px(), captured.frame.height_px());
                captured.frame = Frame::new(width, height, dn.map(dim).collect()).unwrap();
            }
            if std::mem::take(&mut self.stale)
                && let Some(last) = &self.last
            {
                let (width, height) = (last.width_px(), last.height_px());
                let noisy = last
                    .pixels_dn()
                    .iter()
                    .zip(0_u16..)
                    .map(|(dn, i)| dn.saturating_add(i % 3));
                captured.frame = Frame::new(width, height, noisy.collect()).unwrap();
            }
            self.last = Some(captured.frame.clone());
            self.note(&captured, request.exposure_s);
            self.buffer.push_back(captured.clone());
            let newest = self.buffer.len() - 1;
            captured = self.buffer[newest.saturating_sub(self.lag)].clone();
            if newest >= BUFFER {
                self.buffer.pop_front();
            }
            if let Some(state) = self.state {
                state(&mut captured.tag);
            }
            Ok(captured)
        })
    }
}

fn command_request(command: ScanCommand) -> CommandRequest {
    CommandRequest {
        command,
        reply: oneshot::channel().0,
    }
}

/// Records the events, and simulates a person who comes after an hour and resumes a paused scan.
pub(super) struct Notebook {
    clock: Arc<dyn Clock>,
    orders: mpsc::Sender<CommandRequest>,
    free_bytes: u64,
    pub(super) states: Vec<ScanState>,
    /// Reason of the last state.
    pub(super) reason: Option<String>,
    pub(super) alarms: Vec<String>,
    pub(super) recoveries: Vec<Recovery>,
    pub(super) withdrawn: Vec<Vec<u32>>,
    /// Accepted points with a frame that shows another pose.
    pub(super) of_another_pose: Vec<u32>,
    /// Accepted points with a frame of another kind or another exposure.
    pub(super) of_another_kind: Vec<u32>,
    world: Arc<World>,
    pub(super) pauses: u32,
    shown: Shown,
    pub(super) accepted: Vec<u32>,
    /// Reported fraction minus the share of the points, at each relevant point.
    pub(super) ahead: Vec<f64>,
    /// Progress and time at each state.
    pub(super) at_states: Vec<(Progress, Duration)>,
    once_recorded: OnceRecorded,
    pub(super) phases: Vec<FrameKind>,
}

impl Recorder for Notebook {
    fn state<'a>(
        &'a mut self,
        next: ScanState,
        reason: Option<&'a str>,
        operator: Option<OperatorAction>,
        progress: Progress,
    ) -> BoxFuture<'a, Result<(), RecordError>> {
        Box::pin(async move {
            self.states.push(next);
            self.reason = reason.map(str::to_owned);
            self.at_states.push((progress, self.clock.now()));
            if let Some(action) = operator {
                self.world.cap_lens(action == OperatorAction::CapLens);
                match action {
                    OperatorAction::CapLens => {}
                    OperatorAction::PlaceWhiteReference => {
                        self.world.place(OnTable::WhiteReference)
                    }
                    OperatorAction::PlaceSample => self.world.place(OnTable::Sample),
                }
                let done = command_request(ScanCommand::Continue);
                self.orders.try_send(done).ok().unwrap();
            }
            // A suspended scan resumes by itself.
            let suspended = reason.is_some_and(|reason| reason.starts_with("suspended"));
            if next == ScanState::Paused && !suspended {
                self.clock.sleep(Duration::from_secs(3600)).await;
                self.free_bytes = u64::MAX;
                // No person comes for ever.
                self.pauses += 1;
                let order = match self.pauses {
                    ..20 => ScanCommand::Resume,
                    _ => ScanCommand::Abort,
                };
                self.orders.try_send(command_request(order)).ok().unwrap();
            }
            Ok(())
        })
    }

    fn visit(
        &mut self,
        visit: Visit,
        progress: Progress,
    ) -> BoxFuture<'_, Result<(), RecordError>> {
        if let Some(order) = self.once_recorded.lock().unwrap().take() {
            self.orders.try_send(command_request(order)).ok().unwrap();
        }
        if visit.rejected.is_none() {
            let shown = self.shown.lock().unwrap();
            for taken in &visit.frames {
                let truth = shown
                    .iter()
                    .find(|truth| truth.frame == taken.captured.frame);
                let Some(truth) = truth else { continue };
                let index = visit.shot.index;
                let tilt = (truth.pose.theta_c - visit.pose.theta_c).abs().deg();
                let turn = (truth.pose.phi_s - visit.pose.phi_s)
                    .deg()
                    .rem_euclid(360.0);
                let apart = tilt.max(turn.min(360.0 - turn));
                if apart > 0.1 && visit.shot.target.is_some() {
                    self.of_another_pose.push(index);
                }
                if truth.kind != visit.shot.kind || truth.exposure_s != taken.exposure_s {
                    self.of_another_kind.push(index);
                }
            }
            drop(shown);
            self.accepted.push(visit.shot.index);
            let share = f64::from(progress.shots_done) / f64::from(progress.shots_total);
            self.ahead.push(progress.fraction - share);
        }
        Box::pin(std::future::ready(Ok(())))
    }

    fn phase_done(&mut self, kind: FrameKind) -> BoxFuture<'_, Result<(), RecordError>> {
        self.phases.push(kind);
        Box::pin(std::future::ready(Ok(())))
    }

    fn alarm<'a>(&'a mut self, code: &'a str, _: &'a str) -> BoxFuture<'a, ()> {
        self.alarms.push(code.to_owned());
        Box::pin(std::future::ready(()))
    }

    fn withdraw<'a>(
        &'a mut self,
        points: &'a [u32],
        _: &'a str,
    ) -> BoxFuture<'a, Result<(), RecordError>> {
        self.accepted.retain(|index| !points.contains(index));
        self.withdrawn.push(points.to_vec());
        Box::pin(std::future::ready(Ok(())))
    }

    fn recovered(&mut self, recovery: Recovery) -> BoxFuture<'_, ()> {
        self.recoveries.push(recovery);
        Box::pin(std::future::ready(()))
    }

    fn free_bytes(&self) -> BoxFuture<'_, Result<u64, RecordError>> {
        Box::pin(std::future::ready(Ok(self.free_bytes)))
    }
}

pub(super) fn shot(index: u32, kind: FrameKind, theta_c_deg: f64) -> Step {
    let pose = Pose::from_deg(theta_c_deg, 0.0);
    Step::Shot(Shot {
        index,
        kind,
        pose: Some(pose),
        target: Some(pose),
        exposures_s: vec![0.02],
        repeats: 3,
    })
}

pub(super) fn samples() -> Vec<Step> {
    let sample = |(index, theta_c_deg)| shot(index, FrameKind::Sample, theta_c_deg);
    [(0, 0.0), (1, 5.0), (2, 10.0)].map(sample).to_vec()
}

/// Six tilts with one frame each.
pub(super) fn grid() -> Vec<Step> {
    let pose = |index: u32| Pose::from_deg(4.0 * f64::from(index), 0.0);
    let step = |index: u32| {
        Step::Shot(Shot {
            index,
            kind: FrameKind::Sample,
            pose: Some(pose(index)),
            target: Some(pose(index)),
            exposures_s: vec![0.02],
            repeats: 1,
        })
    };
    (0..6).map(step).collect()
}

/// The same points with these exposures.
pub(super) fn with_exposures(steps: Vec<Step>, exposures_s: &[f64]) -> Vec<Step> {
    let change = |step| match step {
        Step::Shot(shot) => Step::Shot(Shot {
            exposures_s: exposures_s.to_vec(),
            ..shot
        }),
        step => step,
    };
    steps.into_iter().map(change).collect()
}

/// Runs steps to their end.
pub(super) async fn run(
    steps: Vec<Step>,
    done: &[u32],
    cues: impl IntoIterator<Item = (u32, Cue)>,
    free_bytes: impl FnOnce(&RunnerSettings) -> u64,
) -> (RunEnd, Notebook) {
    run_with(steps, done, cues, free_bytes, |_| {}).await
}

/// The same with other settings.
pub(super) async fn run_with(
    steps: Vec<Step>,
    done: &[u32],
    cues: impl IntoIterator<Item = (u32, Cue)>,
    free_bytes: impl FnOnce(&RunnerSettings) -> u64,
    change: impl FnOnce(&mut RunnerSettings),
) -> (RunEnd, Notebook) {
    run_after(steps, done, &[], cues, free_bytes, change).await
}

/// The same after a run that took the points `done` but did not check them: the last ones with an even picture of these counts.
pub(super) async fn run_after(
    steps: Vec<Step>,
    done: &[u32],
    unchecked_dn: &[(u32, Option<u16>)],
    cues: impl IntoIterator<Item = (u32, Cue)>,
    free_bytes: impl FnOnce(&RunnerSettings) -> u64,
    change: impl FnOnce(&mut RunnerSettings),
) -> (RunEnd, Notebook) {
    let stepped = Arc::new(SteppedClock::new());
    let clock: Arc<dyn Clock> = stepped.clone();
    let shown = Shown::default();
    let (rig, parts) = SimulatedRig::with_clock(Simulation::default(), Arc::clone(&clock)).unwrap();
    let (orders, mut book) = mpsc::channel(16);
    let RigParts {
        rig: devices,
        mut settings,
    } = parts;
    change(&mut settings.runner);
    let mut link = devices.link().clone();
    let mut cues: BTreeMap<u32, Cue> = cues.into_iter().collect();
    let first = cues.remove(&0);
    if let Some(Cue::NoEncoder) = first {
        let faults = ScriptedFaults::new();
        faults.on(
            "encoder.pos",
            LineFault::Refuse("BADCOMMAND".into()),
            u32::MAX,
        );
        link.seam = Arc::new(faults);
    }
    if let Some(Cue::Order(order)) = first {
        orders.try_send(command_request(order)).ok().unwrap();
    }
    let once_recorded = OnceRecorded::default();
    let mut camera = CuedCamera {
        camera: devices.camera,
        world: Arc::clone(&rig.world),
        uniform_dn: None,
        hangs: false,
        last: None,
        cues,
        orders: orders.clone(),
        asked: 0,
        clock: Arc::clone(&stepped),
        lag: 0,
        buffer: VecDeque::new(),
        stale: false,
        light: 1.0,
        state: None,
        even: None,
        shown: Arc::clone(&shown),
        once_recorded: Arc::clone(&once_recorded),
    };
    if let Some(Cue::LagUntimed(frames)) = first {
        camera.lag = frames;
        camera.state = Some(|tag| *tag = FrameTag::default());
        camera.fill_buffer(frames).await;
    }
    let mut notebook = Notebook {
        clock: Arc::clone(&clock),
        orders,
        free_bytes: free_bytes(&settings.runner),
        states: Vec::new(),
        reason: None,
        alarms: Vec::new(),
        recoveries: Vec::new(),
        withdrawn: Vec::new(),
        of_another_pose: Vec::new(),
        of_another_kind: Vec::new(),
        world: Arc::clone(&rig.world),
        pauses: 0,
        shown: Arc::clone(&shown),
        accepted: Vec::new(),
        ahead: Vec::new(),
        at_states: Vec::new(),
        once_recorded: Arc::clone(&once_recorded),
        phases: Vec::new(),
    };
    let (width, height) = (settings.camera.width_px, settings.camera.height_px);
    let look = |dn: &u16| {
        let noise = |i: u32| (i.wrapping_mul(2_654_435_761) >> 28) as u16;
        let pixels_dn = (0..width * height).map(|i| dn + noise(i)).collect();
        let frame = Frame::new(width, height, pixels_dn).unwrap();
        Look::of(&frame, 0.02, &settings.runner.frame)
    };
    let unchecked = unchecked_dn.iter();
    let unchecked = unchecked.map(|(index, dn)| (*index, dn.iter().map(look).collect()));
    let unchecked = unchecked.collect();
    let run = ScanRun {
        steps,
        done: done.iter().copied().collect::<BTreeSet<u32>>(),
        full: BTreeSet::new(),
        last_frames: Vec::new(),
        unchecked,
        stated: FrameTag::default(),
        elapsed_s: 0.0,
        settings: settings.runner,
        clock,
    };
    let mut devices = Rig::new(link, Box::new(camera));
    let end = runner::run(run, &mut devices, &mut notebook, &mut book).await;
    (end.unwrap(), notebook)
}
