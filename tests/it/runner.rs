//! The runner by itself, on the simulated rig: what it tells a recorder when camera, disk or people are in its way.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use futures::future::BoxFuture;
use ridged::bench::{AxisName, Camera, CameraError, CaptureRequest, Captured};
use ridged::clock::{Clock, SteppedClock};
use ridged::frame::FrameTag;
use ridged::frame::{Frame, FrameKind};
use ridged::geometry::Pose;
use ridged::lab::RigParts;
use ridged::scan::faults::Reaction;
use ridged::scan::recorder::{RecordError, Recorder, Recovery, Visit};
use ridged::scan::runner::{self, CommandRequest, RunEnd, RunnerSettings, ScanCommand, ScanRun};
use ridged::scan::{OperatorAction, Progress, Rig, ScanState, Shot, Step};
use ridged::sim::rig::{SimulatedRig, Simulation};
use ridged::sim::world::{AxisFault, World};
use ridged::units::Angle;
use tokio::sync::{mpsc, oneshot};

/// What the camera states differently.
type Statement = fn(&mut FrameTag);

/// What happens when the camera is asked for its n-th frame, from 1.
enum Cue {
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
    /// Somebody presses stop, and the frame comes all the same.
    PressStop,
    /// Its buffer is one frame behind from now on, and it states nothing about its frames.
    LagUntimed,
    /// Its buffer is one frame behind from now on; it states when each frame was exposed.
    Lag,
    /// This one frame shows the pose before with new noise; it states nothing about its frames.
    Stale,
    /// The lamp gives this share of its light from now on.
    Fade(f64),
    /// Its frames state this from now on.
    State(Statement),
    /// The computer is suspended while it exposes.
    Suspend,
    /// Something happens to an axis while it exposes.
    Cause(AxisName, AxisFault),
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
    lags: bool,
    buffered: Option<Captured>,
    stale: bool,
    /// Share of the light that the lamp gives.
    light: f64,
    state: Option<Statement>,
    /// Frames with the poses that they show.
    shown: Shown,
}

type Shown = Arc<Mutex<Vec<(Frame, Pose)>>>;

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
            None => {}
            Some(Cue::Black) => self.uniform_dn = Some(200),
            Some(Cue::Full) => self.uniform_dn = Some(u16::MAX),
            Some(Cue::Hang) => self.hangs = true,
            Some(Cue::Wake) => self.hangs = false,
            Some(Cue::LagUntimed) => {
                self.lags = true;
                self.state = Some(|tag| *tag = FrameTag::default());
            }
            Some(Cue::Lag) => self.lags = true,
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
            Some(Cue::Fail) => {
                let failed = CameraError::Failed("the cable came off".into());
                return Box::pin(std::future::ready(Err(failed)));
            }
            Some(Cue::PressStop) => {
                self.orders
                    .try_send(command_request(ScanCommand::Stop))
                    .ok()
                    .unwrap();
            }
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
            self.shown
                .lock()
                .unwrap()
                .push((captured.frame.clone(), self.world.pose_now()));
            let fresh = captured.clone();
            if self.lags
                && let Some(behind) = self.buffered.replace(fresh)
            {
                captured = behind;
            } else if !self.lags {
                self.buffered = Some(captured.clone());
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
struct Notebook {
    clock: Arc<dyn Clock>,
    orders: mpsc::Sender<CommandRequest>,
    free_bytes: u64,
    states: Vec<ScanState>,
    alarms: Vec<String>,
    recoveries: Vec<Recovery>,
    withdrawn: Vec<Vec<u32>>,
    /// Accepted points with a frame that shows another pose.
    of_another_pose: Vec<u32>,
    pauses: u32,
    shown: Shown,
    accepted: Vec<u32>,
    /// Reported fraction minus the share of the points, at each relevant point.
    ahead: Vec<f64>,
    phases: Vec<FrameKind>,
}

impl Recorder for Notebook {
    fn state<'a>(
        &'a mut self,
        next: ScanState,
        reason: Option<&'a str>,
        _: Option<OperatorAction>,
        _: Progress,
    ) -> BoxFuture<'a, Result<(), RecordError>> {
        Box::pin(async move {
            self.states.push(next);
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
        if visit.rejected.is_none() {
            let shown = self.shown.lock().unwrap();
            for taken in &visit.frames {
                let frame = shown
                    .iter()
                    .find(|(frame, _)| *frame == taken.captured.frame);
                let apart = frame.map(|(_, pose)| (pose.theta_c - visit.pose.theta_c).abs().deg());
                if apart.is_some_and(|deg| deg > 0.1) {
                    self.of_another_pose.push(visit.shot.index);
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

fn shot(index: u32, kind: FrameKind, theta_c_deg: f64) -> Step {
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

fn samples() -> Vec<Step> {
    let sample = |(index, theta_c_deg)| shot(index, FrameKind::Sample, theta_c_deg);
    [(0, 0.0), (1, 5.0), (2, 10.0)].map(sample).to_vec()
}

/// Six tilts with one frame each.
fn grid() -> Vec<Step> {
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

/// Runs steps to their end.
async fn run(
    steps: Vec<Step>,
    done: &[u32],
    cues: impl IntoIterator<Item = (u32, Cue)>,
    free_bytes: impl FnOnce(&RunnerSettings) -> u64,
) -> (RunEnd, Notebook) {
    run_with(steps, done, cues, free_bytes, |_| {}).await
}

/// The same with other settings.
async fn run_with(
    steps: Vec<Step>,
    done: &[u32],
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
    let link = devices.link().clone();
    let camera = CuedCamera {
        camera: devices.camera,
        world: Arc::clone(&rig.world),
        uniform_dn: None,
        hangs: false,
        last: None,
        cues: cues.into_iter().collect(),
        orders: orders.clone(),
        asked: 0,
        clock: Arc::clone(&stepped),
        lags: false,
        buffered: None,
        stale: false,
        light: 1.0,
        state: None,
        shown: Arc::clone(&shown),
    };
    let mut notebook = Notebook {
        clock: Arc::clone(&clock),
        orders,
        free_bytes: free_bytes(&settings.runner),
        states: Vec::new(),
        alarms: Vec::new(),
        recoveries: Vec::new(),
        withdrawn: Vec::new(),
        of_another_pose: Vec::new(),
        pauses: 0,
        shown: Arc::clone(&shown),
        accepted: Vec::new(),
        ahead: Vec::new(),
        phases: Vec::new(),
    };
    let run = ScanRun {
        steps,
        done: done.iter().copied().collect::<BTreeSet<u32>>(),
        full: BTreeSet::new(),
        last_frames: Vec::new(),
        unchecked: Vec::new(),
        stated: FrameTag::default(),
        elapsed_s: 0.0,
        settings: settings.runner,
        clock,
    };
    let mut devices = Rig::new(link, Box::new(camera));
    let end = runner::run(run, &mut devices, &mut notebook, &mut book).await;
    (end.unwrap(), notebook)
}

#[tokio::test(flavor = "multi_thread")]
async fn who_resumes_after_another_trouble_has_not_looked_at_a_black_sample() {
    let cues = [1, 2, 3].map(|frame| (frame, Cue::Fail));
    let cues = cues.into_iter().chain([(7, Cue::Black)]);
    let (end, reported) = run(samples(), &[], cues, |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    // The second time somebody has, and the third point is as black.
    assert_eq!(reported.alarms, ["camera-failed", "frames-rejected"]);
    assert_eq!(reported.accepted, [0, 1, 2]);
}

#[tokio::test(flavor = "multi_thread")]
async fn one_failure_of_the_camera_is_retried_and_reported_as_a_recovery() {
    let (end, reported) = run(samples(), &[], [(5, Cue::Fail)], |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    assert!(!reported.states.contains(&ScanState::Paused));
    assert_eq!(reported.accepted, [0, 1, 2]);
    assert_eq!(reported.alarms, Vec::<String>::new());
    let [recovery] = reported.recoveries.as_slice() else {
        panic!("{:?}", reported.recoveries);
    };
    assert_eq!(recovery.code, "camera-failed");
    assert_eq!(recovery.points, [1]);
    assert!(!recovery.attended);
    assert!(
        recovery.message.contains("the cable came off"),
        "{}",
        recovery.message
    );
    // The first wait and the second visit.
    assert!(
        recovery.took_s >= 1.0 && recovery.took_s < 10.0,
        "{}",
        recovery.took_s
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fault_that_persists_has_the_reaction_of_the_settings() {
    let failing = || (4..=6).map(|frame| (frame, Cue::Fail));
    for (reaction, state, accepted, alarms) in [
        (
            Reaction::Pause,
            ScanState::Completed,
            &[0, 1, 2][..],
            "camera-failed",
        ),
        (
            Reaction::Skip,
            ScanState::Completed,
            &[0, 2],
            "point-skipped",
        ),
        (Reaction::Abort, ScanState::Failed, &[0], "camera-failed"),
    ] {
        let (end, reported) = run_with(
            samples(),
            &[],
            failing(),
            |_| u64::MAX,
            |settings| {
                settings.faults.reactions.camera = reaction;
            },
        )
        .await;
        assert_eq!(end.state, state, "{reaction:?}");
        assert_eq!(reported.accepted, accepted, "{reaction:?}");
        assert_eq!(reported.alarms, [alarms], "{reaction:?}");
        let paused = reported.states.contains(&ScanState::Paused);
        assert_eq!(paused, reaction == Reaction::Pause);
        // A person resumed it after an hour.
        let attended: Vec<bool> = reported.recoveries.iter().map(|r| r.attended).collect();
        assert_eq!(attended, vec![true; usize::from(paused)]);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_point_whose_axis_was_touched_in_the_exposure_is_taken_again() {
    let turn = Angle::from_deg(0.5);
    for (fault, alarm) in [
        // Turned there and back: only the flag says so.
        (AxisFault::Knob(Angle::ZERO), Some("stage-interrupted")),
        (AxisFault::PowerCycle, Some("stage-power-cycled")),
        (AxisFault::ForeignMove(turn), None),
        // The counter knows nothing of it; the encoder of the next move does.
        (AxisFault::Slip(turn), None),
    ] {
        let cues = [(5, Cue::Cause(AxisName::ThetaC, fault))];
        let (end, reported) = run(samples(), &[], cues, |_| u64::MAX).await;
        assert_eq!(end.state, ScanState::Completed, "{fault:?}");
        assert_eq!(reported.alarms, Vec::from_iter(alarm), "{fault:?}");
        assert_eq!(reported.accepted, [0, 1, 2], "{fault:?}");
        let [recovery] = reported.recoveries.as_slice() else {
            panic!("{fault:?}: {:?}", reported.recoveries);
        };
        assert_eq!(recovery.attended, alarm.is_some(), "{fault:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_blinded_camera_pauses_the_scan_until_somebody_has_looked() {
    let (end, reported) = run(samples(), &[], [(1, Cue::Full)], |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!(reported.alarms, ["frames-rejected"]);
    assert_eq!(reported.accepted, [0, 1, 2]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_that_is_too_bright_is_found_out_at_the_poses_furthest_apart() {
    let grid = |backwards: bool| {
        let at = |index: u32| {
            let pose = Pose::from_deg(f64::from(index / 8) * 2.0, f64::from(index % 8) * 5.0);
            Step::Shot(Shot {
                index,
                kind: FrameKind::Sample,
                pose: Some(pose),
                target: Some(pose),
                exposures_s: vec![0.02],
                repeats: 1,
            })
        };
        let mut steps: Vec<Step> = (0..64).map(at).collect();
        if backwards {
            steps.reverse();
        }
        steps
    };
    for backwards in [false, true] {
        let (end, reported) = run(grid(backwards), &[], [(1, Cue::Full)], |_| u64::MAX).await;
        assert_eq!(end.state, ScanState::Completed);
        // Reported long before all are taken, and each is taken once.
        assert_eq!(reported.alarms, ["frames-rejected"]);
        let mut all = reported.accepted.clone();
        all.sort_unstable();
        assert_eq!(all, (0..64).collect::<Vec<u32>>());
        let ends = [0, 56].map(|i| reported.accepted.iter().position(|a| *a == i).unwrap());
        assert!(ends.iter().all(|at| *at < 20), "{ends:?}");
        // All points are alike: the way to one that is out of turn is no more of the plan.
        assert!(
            reported.ahead.iter().all(|ahead| ahead.abs() < 0.1),
            "{:?}",
            reported.ahead
        );
        // A lamp that is too bright from the middle on has left others as they should be.
        let (_, reported) = run(grid(backwards), &[], [(32, Cue::Full)], |_| u64::MAX).await;
        assert!(
            reported.accepted.is_sorted() || backwards,
            "{:?}",
            reported.accepted
        );
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_hangs_pauses_the_scan_until_it_no_longer_does() {
    // Three frames a visit, three visits before each pause.
    let cues = [(4, Cue::Hang), (4 + 2 * 9, Cue::Wake)];
    let (end, reported) = run(samples(), &[], cues, |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    // Who resumes has not mended it by that.
    assert_eq!(reported.alarms, ["frames-rejected"; 2]);
    assert_eq!(reported.accepted, [0, 1, 2]);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rejected_or_discarded_image_does_not_count_when_it_comes_again() {
    // The stage moves while the second point is taken, and the first image of its retake is the last of those.
    let moved = AxisFault::ForeignMove(Angle::from_deg(0.5));
    let rejected = vec![
        (5, Cue::Cause(AxisName::ThetaC, moved)),
        (7, Cue::Hang),
        (8, Cue::Wake),
    ];
    // The first image of a camera that states nothing is discarded, and comes again.
    let discarded = vec![
        (1, Cue::State(|tag| *tag = FrameTag::default())),
        (2, Cue::Hang),
        (3, Cue::Wake),
    ];
    for (steps, cues, accepted, failures) in [
        (samples(), rejected, 3, "after 2 failures"),
        (grid(), discarded, 6, "bit for bit"),
    ] {
        let (end, reported) = run(steps, &[], cues, |_| u64::MAX).await;
        assert_eq!(end.state, ScanState::Completed);
        assert_eq!(reported.accepted, (0..accepted).collect::<Vec<u32>>());
        let [recovery] = reported.recoveries.as_slice() else {
            panic!("{:?}", reported.recoveries);
        };
        assert!(recovery.message.contains(failures), "{recovery:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_hour_between_stop_and_resume_is_nobodys_motion() {
    let (end, reported) = run(samples(), &[], [(4, Cue::Stop)], |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    assert!(reported.states.contains(&ScanState::Paused));
    assert_eq!(reported.accepted, [0, 1, 2]);
    assert!(end.elapsed_s > 0.0 && end.elapsed_s < 600.0, "{end:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_phase_is_reported_done_whichever_run_took_its_last_point() {
    let steps = || {
        vec![
            shot(0, FrameKind::Dark, 0.0),
            shot(1, FrameKind::Flat, 0.0),
            shot(2, FrameKind::Flat, 5.0),
            shot(3, FrameKind::Sample, 5.0),
        ]
    };
    // Taken in another order before; taken as a whole by a run that was killed before it could say so.
    for done in [&[0, 2][..], &[0, 1, 2]] {
        let (_, reported) = run(steps(), done, [], |_| u64::MAX).await;
        let phases = [FrameKind::Dark, FrameKind::Flat, FrameKind::Sample];
        assert_eq!(reported.phases, phases, "{done:?}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_point_is_begun_where_all_of_its_frames_have_room() {
    let room_for =
        |frames: u64| move |s: &RunnerSettings| s.disk_reserve_bytes + frames * s.frame_bytes_max;
    let (_, reported) = run(samples(), &[], [], room_for(3)).await;
    assert_eq!(reported.alarms, Vec::<String>::new());
    let (end, reported) = run(samples(), &[], [], room_for(2)).await;
    assert_eq!(reported.alarms, ["disk-full"]);
    assert_eq!(end.state, ScanState::Completed);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_is_one_frame_behind_gives_no_frame_of_another_pose() {
    // A check of the reference pose would refuse a camera that lags and does not state when it exposed.
    let none = |settings: &mut RunnerSettings| settings.reference.every = 0;
    for (cue, timed) in [(Cue::Lag, true), (Cue::LagUntimed, false)] {
        let (end, reported) = run_with(grid(), &[], [(3, cue)], |_| u64::MAX, none).await;
        assert_eq!(end.state, ScanState::Completed, "timed: {timed}");
        assert!(
            !reported.states.contains(&ScanState::Paused),
            "{:?}",
            reported.alarms
        );
        assert_eq!(reported.accepted, [0, 1, 2, 3, 4, 5]);
        assert_eq!(
            reported.of_another_pose,
            Vec::<u32>::new(),
            "timed: {timed}"
        );
        assert!(!reported.recoveries.is_empty());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_lags_gives_no_frame_of_where_something_else_moved_an_axis() {
    let none = |settings: &mut RunnerSettings| settings.reference.every = 0;
    let moved = AxisFault::ForeignMove(Angle::from_deg(0.7));
    for exposure in 4..12 {
        let cues = [
            (3, Cue::LagUntimed),
            (exposure, Cue::Cause(AxisName::ThetaC, moved)),
        ];
        let (end, reported) = run_with(grid(), &[], cues, |_| u64::MAX, none).await;
        assert_eq!(end.state, ScanState::Completed, "{exposure}");
        assert_eq!(reported.of_another_pose, Vec::<u32>::new(), "{exposure}");
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn one_stale_frame_with_other_noise_is_found_by_its_look() {
    // Frames that confirm the first two points are the second and the fourth.
    let cues = [
        (1, Cue::State(|tag| *tag = FrameTag::default())),
        (6, Cue::Stale),
    ];
    let (end, reported) = run(grid(), &[], cues, |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!(reported.accepted, [0, 1, 2, 3, 4, 5]);
    assert_eq!(reported.of_another_pose, Vec::<u32>::new());
    assert_eq!(reported.recoveries.len(), 1, "{:?}", reported.recoveries);
    assert!(reported.recoveries[0].message.contains("earlier pose"));
}

#[tokio::test(flavor = "multi_thread")]
async fn what_the_camera_states_wrongly_is_taken_again_and_another_camera_is_refused() {
    let wrong: [(Statement, &str); 3] = [
        (|tag| tag.exposure_s = Some(0.04), "frames-rejected"),
        (|tag| tag.gain = Some(7.0), "frames-rejected"),
        (|tag| tag.serial = Some("another".into()), "camera-replaced"),
    ];
    for (change, alarm) in wrong {
        let cues = [(2, Cue::State(change))];
        let (_, reported) = run(grid(), &[], cues, |_| u64::MAX).await;
        // A person resumes, and nothing is mended by that.
        assert_eq!(reported.accepted, [0], "{alarm}");
        assert!(
            reported.alarms.iter().all(|code| code == alarm),
            "{:?}",
            reported.alarms
        );
    }
    let lost = [(
        2,
        Cue::State(|tag| tag.counter = tag.counter.map(|n| n + 3)),
    )];
    let (end, reported) = run(grid(), &[], lost, |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!(reported.alarms, Vec::<String>::new());
    assert!(reported.recoveries[0].message.contains("frames were lost"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_lamp_that_fades_in_a_block_has_it_taken_again() {
    let all_poses = |settings: &mut RunnerSettings| settings.reference.time_share_max = 10.0;
    let cues = [(4, Cue::Fade(0.9))];
    let (end, reported) = run_with(grid(), &[], cues, |_| u64::MAX, all_poses).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!(reported.alarms, ["reference-changed"]);
    assert_eq!(reported.withdrawn, [[0, 1, 2, 3, 4, 5]]);
    let mut accepted = reported.accepted.clone();
    accepted.sort_unstable();
    assert_eq!(accepted, [0, 1, 2, 3, 4, 5]);
    assert_eq!(
        reported.recoveries.last().unwrap().points,
        [0, 1, 2, 3, 4, 5]
    );
    // Without reference poses it is not found.
    let none = |settings: &mut RunnerSettings| settings.reference.every = 0;
    let cues = [(4, Cue::Fade(0.9))];
    let (_, reported) = run_with(grid(), &[], cues, |_| u64::MAX, none).await;
    assert_eq!(reported.withdrawn.len(), 0);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_computer_that_was_suspended_in_an_exposure_takes_the_point_again() {
    let (end, reported) = run(grid(), &[], [(3, Cue::Suspend)], |_| u64::MAX).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!(reported.alarms, ["host-suspended"]);
    assert_eq!(reported.recoveries[0].points, [2]);
    assert!(!reported.recoveries[0].attended);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_that_is_stopped_while_it_is_suspended_waits_for_a_person() {
    let set_point = |settings: &mut RunnerSettings| settings.tags.temperature_c = Some(-5.0);
    let cues = [
        (3, Cue::State(|tag| tag.temperature_c = Some(-2.0))),
        (5, Cue::PressStop),
        (6, Cue::State(|tag| tag.temperature_c = Some(-4.9))),
    ];
    let (end, reported) = run_with(grid(), &[], cues, |_| u64::MAX, set_point).await;
    assert_eq!(end.state, ScanState::Completed);
    // The person came after an hour; the condition was over long before.
    assert_eq!(reported.pauses, 1);
    let recovery = reported
        .recoveries
        .iter()
        .find(|recovery| recovery.code == "camera-temperature")
        .unwrap();
    assert!(
        recovery.attended && recovery.took_s > 3000.0,
        "{recovery:?}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_is_suspended_while_a_condition_holds_and_resumes_by_itself() {
    let set_point = |settings: &mut RunnerSettings| settings.tags.temperature_c = Some(-5.0);
    let cues = [
        (1, Cue::State(|tag| tag.temperature_c = Some(-5.2))),
        (3, Cue::State(|tag| tag.temperature_c = Some(-2.0))),
        // Within the tolerance, but not within the half of it that ends the suspension.
        (6, Cue::State(|tag| tag.temperature_c = Some(-4.3))),
        (9, Cue::State(|tag| tag.temperature_c = Some(-4.9))),
    ];
    let (end, reported) = run_with(grid(), &[], cues, |_| u64::MAX, set_point).await;
    assert_eq!(end.state, ScanState::Completed);
    assert_eq!(reported.accepted, [0, 1, 2, 3, 4, 5]);
    let code = "camera-temperature";
    assert!(
        reported
            .recoveries
            .iter()
            .any(|r| r.code == code && !r.attended)
    );
    assert!(
        reported.alarms.iter().all(|alarm| alarm == code),
        "{:?}",
        reported.alarms
    );
}
