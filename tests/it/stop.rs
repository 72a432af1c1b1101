//! The stop, where it is hardest: without a link, beside keys, with bodies that are none.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use axum::body::Body;
use futures::FutureExt;
use ridged::api::Access;
use ridged::api::server::{self, ListenSettings};
use ridged::bench::AxisName::{PhiS, ThetaC};
use ridged::bench::port::{NoFaults, Port, PortAddress, PortError, PortSeam};
use ridged::clock::{Clock, ScaledClock, SteppedClock};
use ridged::daemon::Daemon;
use ridged::lab::{Lab, LabError, RigParts, ScanRequest};
use ridged::scan::event::RigActivity;
use ridged::scan::plan::{DarkRequest, FlatRequest};
use ridged::scan::runner::ScanCommand;
use ridged::scan::{Event, Incident, PlanRequest, RecordedEvent, Rig, ScanState, StageLink};
use ridged::sim::faults::{LineFault, ScriptedFaults};
use ridged::sim::rig::{SimulatedRig, Simulation};
use ridged::sim::world::AxisFault;
use ridged::store::PageRequest;
use ridged::store::disk::RealDisk;
use ridged::units::Angle;
use tokio::sync::broadcast::Receiver;
use tower::ServiceExt;

use crate::bench_in_a_box::{BenchInABox, in_time, small};
use crate::cut_short::by_hand;
use crate::http::{is_problem, opened, request, router_of, send};

/// A lab whose line to the stages can be disturbed. Time stands still while no task waits, so what moves goes on moving.
async fn disturbed(change: impl FnOnce(&mut StageLink)) -> (Lab, SimulatedRig, tempfile::TempDir) {
    disturbed_on(Arc::new(SteppedClock::new()), change).await
}

pub async fn disturbed_on(
    clock: Arc<dyn Clock>,
    change: impl FnOnce(&mut StageLink),
) -> (Lab, SimulatedRig, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let (rig, mut parts) = SimulatedRig::with_clock(Simulation::default(), clock).unwrap();
    let mut link = parts.rig.link().clone();
    change(&mut link);
    parts.rig = Rig::new(link, parts.rig.camera);
    let clock = Arc::clone(&rig.clock);
    let (lab, _) = Lab::open(folder.path(), Arc::new(RealDisk), clock, Some(parts))
        .await
        .unwrap();
    (lab, rig, folder)
}

/// Waits for an event, also for one that the store cannot record.
pub async fn next(
    events: &mut Receiver<Arc<RecordedEvent>>,
    wanted: impl Fn(&Event) -> bool,
) -> Arc<RecordedEvent> {
    let waiting = async {
        loop {
            let event = events.recv().await.unwrap();
            if wanted(&event.event) {
                return event;
            }
        }
    };
    in_time(waiting).await
}

/// Waits for the events in the store: an answer comes before they are recorded.
async fn recorded(lab: &Lab, enough: impl Fn(&[RecordedEvent]) -> bool) {
    let waiting = async {
        while !enough(&lab.store().events_after(0, 1000).await.unwrap()) {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
    };
    in_time(waiting).await;
}

/// Waits until a motion has ended, without asking the stages.
pub async fn idle(events: &mut Receiver<Arc<RecordedEvent>>) {
    let is_idle = |event: &Event| matches!(event, Event::Rig { activity, .. } if *activity == RigActivity::Idle);
    next(events, is_idle).await;
}

/// A lab whose line went as an axis began to move.
async fn lost_in_motion() -> (ScriptedFaults, Lab, SimulatedRig, tempfile::TempDir) {
    let faults = ScriptedFaults::new();
    let (lab, rig, folder) = disturbed(|link| link.seam = Arc::new(faults.clone())).await;
    let mut events = lab.events();
    lab.home(PhiS).await.unwrap();
    idle(&mut events).await;
    // The stage hears the move; its answer finds no line any more.
    faults.on("move abs", LineFault::Unplug, 1);
    lab.move_axis(PhiS, Angle::from_deg(300.0)).await.unwrap();
    idle(&mut events).await;
    assert!(rig.world.is_moving());
    (faults, lab, rig, folder)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_reaches_what_moves_on_after_its_link_was_lost() {
    let (faults, lab, rig, _folder) = lost_in_motion().await;
    lab.stop().await.unwrap();
    assert!(!rig.world.is_moving());
    // Without a line, no answer says that the stage stands.
    faults.unplug();
    let router = router_of(&lab);
    // The first question finds the line gone; the next finds none.
    for _ in 0..2 {
        let rig = request("GET", "/api/v1/rig").body(Body::empty()).unwrap();
        let rig = send(&router, rig).await.body;
        assert_eq!(rig["connected"], false, "{rig}");
        for axis in ["theta_c", "phi_s"] {
            assert!(rig["axes"][axis]["moving"].is_null(), "{rig}");
        }
    }
    let refused = lab.stop().await.unwrap_err();
    assert!(matches!(refused, LabError::NotStopped { .. }), "{refused}");
    assert!(
        refused
            .to_string()
            .contains("use the hardware emergency switch"),
        "{refused}"
    );
    let is_alarm = |event: &Event| matches!(event, Event::Alarm { message, .. } if message.contains("did not reach"));
    recorded(&lab, |all| all.iter().any(|e| is_alarm(&e.event))).await;
    faults.plug_in();
    lab.stop().await.unwrap();
    lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_that_is_lost_on_the_line_is_sent_again_until_the_axes_are_at_rest() {
    let faults = ScriptedFaults::new();
    let seam = Arc::new(faults.clone());
    // Slowly enough that the axis still moves once a stop and its retries are lost.
    let clock: Arc<dyn Clock> = Arc::new(ScaledClock::new(2.0));
    let (lab, rig, _folder) = disturbed_on(clock, |link| link.seam = seam).await;
    let mut events = lab.events();
    lab.home(PhiS).await.unwrap();
    idle(&mut events).await;
    let moving = lab.move_axis(PhiS, Angle::from_deg(350.0)).await.unwrap();
    let until_moving = async |moves: bool| {
        let waiting = async {
            while rig.world.is_moving() != moves {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        };
        let waited = tokio::time::timeout(Duration::from_secs(60), waiting).await;
        assert!(waited.is_ok(), "moving: {}", !moves);
    };
    until_moving(true).await;
    // It is sent every 100 ms for 1.8 s, then again.
    faults.on("stop", LineFault::LoseCommand, 22);
    let refused = lab.stop().await.unwrap_err();
    assert!(matches!(refused, LabError::NotStopped { .. }), "{refused}");
    until_moving(false).await;
    let at = rig.world.pose_now().phi_s.deg();
    assert!(at < 340.0, "it arrived at {at}°");
    // Before it was at rest, it had no position.
    let motion = lab.motion(moving, Duration::from_secs(60)).await.unwrap();
    let pose = motion.unwrap().pose;
    let apart = pose.map_or(0.0, |pose| (pose.phi_s.deg() - at).abs());
    assert!(apart < 0.5, "{pose:?} instead of {at}°");
    lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_ends_stops_what_it_lost() {
    let (_faults, lab, rig, _folder) = lost_in_motion().await;
    lab.shut_down().await;
    assert!(!rig.world.is_moving());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_ends_repeats_its_stop_and_reports_stages_that_may_be_moving() {
    // More than one stop with its retries is lost.
    let (faults, lab, rig, _folder) = lost_in_motion().await;
    faults.on("stop", LineFault::LoseCommand, 6);
    lab.rest().await.unwrap();
    assert!(!rig.world.is_moving());
    lab.store().close().await;

    let (faults, lab, rig, _folder) = lost_in_motion().await;
    faults.unplug();
    let settings = ListenSettings::loopback("127.0.0.1:0");
    let sockets = server::listen(&settings).await.unwrap();
    let access = Access::of_folder(lab.store().folder());
    let daemon = Daemon::start(lab.clone(), sockets, access).unwrap();
    let ended = daemon.end().await.unwrap_err().to_string();
    assert!(ended.contains("may be moving"), "{ended}");
    assert!(
        ended.contains("use the hardware emergency switch"),
        "{ended}"
    );
    assert!(rig.world.is_moving());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stop_without_a_port_says_that_it_reached_nothing() {
    let nowhere = |link: &mut StageLink| link.port = "/dev/there-is-no-such-port".parse().unwrap();
    let (lab, _rig, _folder) = disturbed(nowhere).await;
    let router = router_of(&lab);
    let stop = request("POST", "/api/v1/rig/stop").body(Body::empty());
    let answer = send(&router, stop.unwrap()).await;
    is_problem(&answer, 503, "port-missing");
    assert!(
        answer.detail().contains("does not exist"),
        "{}",
        answer.detail()
    );
    assert!(
        answer
            .detail()
            .contains("use the hardware emergency switch"),
        "{}",
        answer.detail()
    );
    lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_that_lost_its_stage_leaves_the_port_to_the_stop() {
    let bench = BenchInABox::impatient().await;
    let scan = bench.start(small(&[0.0, 10.0], &[0.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    bench.rig.world.set_powered(PhiS, false);
    bench.rig.world.cap_lens(true);
    bench
        .lab
        .order(scan.id, ScanCommand::Continue)
        .await
        .unwrap();
    // The dark frame needs no motion; the next point does.
    let hands = bench.rig.operate(&bench.lab, true);
    bench.until(scan.id, ScanState::Paused).await;
    let view = bench.lab.rig().await.unwrap();
    let (code, why) = view.problem.unwrap();
    assert!(!view.connected && code == "scan-paused", "{code}");
    assert!(why.contains("does not answer"), "{why}");
    bench.rig.world.set_powered(PhiS, true);
    bench.lab.stop().await.unwrap();
    hands.abort();
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_link_that_is_lost_in_a_pause_is_the_problem_of_the_rig_whatever_paused_the_scan() {
    let faults = ScriptedFaults::new();
    let seam = Arc::new(faults.clone());
    let (lab, rig, _folder) = disturbed(|link| link.seam = seam).await;
    rig.add_samples(&lab).await.unwrap();
    let request = ScanRequest::of(2, small(&[0.0, 10.0], &[0.0]));
    let scan = lab.start_scan(&request).await.unwrap();
    let paused = async || {
        loop {
            match lab.store().scan(scan.id).await.unwrap().state {
                ScanState::WaitingForOperator => lab.stop().await.unwrap(),
                ScanState::Paused => return,
                _ => tokio::time::sleep(Duration::from_millis(5)).await,
            }
        }
    };
    in_time(paused()).await;
    faults.unplug();
    // The first look finds that the link is lost; the second one finds it closed.
    for _ in 0..2 {
        let view = lab.rig().await.unwrap();
        let (code, why) = view.problem.unwrap();
        assert!(!view.connected);
        assert_eq!(code, "stage-disconnected", "{why}");
        assert!(why.contains("connection"), "{why}");
    }
    faults.plug_in();
    lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_abort_is_answered_within_a_second_while_the_controllers_are_silent() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let scan = bench.start(small(&[0.0, 10.0], &[0.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    for axis in [ThetaC, PhiS] {
        bench.rig.world.set_powered(axis, false);
    }
    let asked = std::time::Instant::now();
    let aborted = bench.lab.order(scan.id, ScanCommand::Abort).await;
    let took = asked.elapsed();
    assert!(took < Duration::from_millis(1500), "{took:?}");
    assert_eq!(aborted.unwrap_err().code(), "stop-unconfirmed");
    assert_eq!(bench.finish(scan.id).await.state, ScanState::Aborted);
    for axis in [ThetaC, PhiS] {
        bench.rig.world.set_powered(axis, true);
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_resume_while_the_controller_is_silent_leaves_the_port_to_what_comes_next() {
    let bench = BenchInABox::impatient().await;
    let scan = bench.start(small(&[0.0, 10.0], &[0.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    bench.rig.world.set_powered(PhiS, false);
    // The dark frame needs no motion; the next point does.
    let hands = bench.rig.operate(&bench.lab, true);
    bench.until(scan.id, ScanState::Paused).await;
    // Twice: the second resume finds a link that the first one opened or lost.
    for _ in 0..2 {
        let resumed = bench.lab.order(scan.id, ScanCommand::Resume).await;
        resumed.unwrap();
        bench.until(scan.id, ScanState::Paused).await;
        let why = bench.lab.store().scan(scan.id).await.unwrap().reason;
        let why = why.unwrap();
        assert!(why.contains("does not answer"), "{why}");
    }
    bench.rig.world.set_powered(PhiS, true);
    bench.lab.stop().await.unwrap();
    let resumed = bench.lab.order(scan.id, ScanCommand::Resume).await;
    resumed.unwrap();
    assert_eq!(bench.finish(scan.id).await.state, ScanState::Completed);
    hands.abort();
    bench.end().await;
}

/// Two poses of the sample, without calibrations.
fn sample_only() -> PlanRequest {
    PlanRequest {
        dark: DarkRequest { repeats: Some(0) },
        flat: FlatRequest {
            repeats: Some(0),
            ..FlatRequest::default()
        },
        ..small(&[0.0, 10.0], &[0.0])
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn power_that_comes_back_moves_nothing_without_a_person_or_the_settings() {
    for unattended in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let allow = |mut parts: RigParts| {
            parts.settings.runner.faults.home_after_power_cycle = unattended;
            parts
        };
        let disk = Arc::new(RealDisk);
        let bench = BenchInABox::open_as(folder.path(), disk, false, Duration::ZERO, allow).await;
        let scan = bench.start(sample_only()).await;
        bench.until(scan.id, ScanState::WaitingForOperator).await;
        let halfway = Angle::from_deg(5.0);
        bench.rig.world.arm(ThetaC, halfway, AxisFault::PowerCycle);
        bench
            .lab
            .order(scan.id, ScanCommand::Continue)
            .await
            .unwrap();
        if !unattended {
            bench.until(scan.id, ScanState::Paused).await;
            let view = bench.lab.rig().await.unwrap();
            assert!(!view.axes[0].1.homed && !bench.rig.world.is_moving());
            let (_, reason) = view.scan_state.unwrap();
            let reason = reason.unwrap();
            assert!(reason.contains("scan.home_after_power_cycle"), "{reason}");
            assert!(reason.contains("then resume"), "{reason}");
            bench.lab.order(scan.id, ScanCommand::Resume).await.unwrap();
        }
        let scan = bench.finish(scan.id).await;
        assert_eq!(scan.state, ScanState::Completed, "{:?}", scan.reason);
        let page = PageRequest::default();
        let incidents = bench
            .lab
            .store()
            .scan_events(scan.id, &Incident::KINDS, page);
        let incidents = incidents.await.unwrap().items;
        let Some(Event::Recovered {
            attended,
            code,
            points,
            ..
        }) = incidents.last().map(|e| &e.event)
        else {
            panic!("{incidents:?}");
        };
        assert_eq!(
            (*attended, code.as_str()),
            (!unattended, "stage-power-cycled")
        );
        assert_eq!(points.len(), 1);
        bench.end().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plug_that_is_pulled_for_a_moment_does_not_end_the_night() {
    let faults = ScriptedFaults::new();
    let (lab, rig, _folder) = disturbed(|link| link.seam = Arc::new(faults.clone())).await;
    rig.add_samples(&lab).await.unwrap();
    let plan = sample_only();
    let request = ScanRequest::of(2, plan);
    // The first move of the scan finds no line; the plug is back at the next attempt.
    faults.on("move abs", LineFault::Unplug, 1);
    let mut events = lab.events();
    let scan = lab.start_scan(&request).await.unwrap();
    let hands = rig.operate(&lab, true);
    let scan = in_time(lab.wait_for_scan(scan.id, 0, |_| false))
        .await
        .unwrap();
    assert_eq!(scan.state, ScanState::Completed, "{:?}", scan.reason);
    let mut codes = Vec::new();
    while let Ok(event) = events.try_recv() {
        match &event.event {
            Event::Alarm { code, .. } => codes.push(code.clone()),
            Event::Scan { state, .. } => assert_ne!(*state, ScanState::Paused),
            Event::Recovered { attended, .. } => {
                assert!(!attended);
                codes.push("recovered".into());
            }
            _ => {}
        }
    }
    assert_eq!(codes, ["stage-disconnected", "recovered"]);
    hands.abort();
    lab.shut_down().await;
}

/// Counts how often a port is opened.
#[derive(Default)]
struct Openings(AtomicUsize);

impl PortSeam for Openings {
    fn open(&self, address: &PortAddress, baud: u32) -> Result<Box<dyn Port>, PortError> {
        self.0.fetch_add(1, Ordering::SeqCst);
        NoFaults.open(address, baud)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_silent_controller_is_asked_once_for_all_who_wait() {
    let openings = Arc::new(Openings::default());
    let seam = Arc::clone(&openings);
    let (lab, rig, _folder) = disturbed(|link| link.seam = seam).await;
    for axis in [ThetaC, PhiS] {
        rig.world.set_powered(axis, false);
    }
    let views = futures::future::join_all((0..12).map(|_| lab.rig())).await;
    for view in views {
        let (code, why) = view.unwrap().problem.unwrap();
        assert_eq!(code, "stage-silent", "{why}");
    }
    // The first one's, and at most one more for those who came as it was given up.
    let opened = openings.0.load(Ordering::SeqCst);
    assert!(opened <= 2, "opened {opened} times");
    lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_motion_that_no_client_waits_for_any_more_does_not_begin() {
    let (lab, rig, _folder) = disturbed(|_| {}).await;
    for axis in [ThetaC, PhiS] {
        rig.world.set_powered(axis, false);
    }
    // The client gives up while the controller is silent, and the controller comes on a moment later.
    assert!(lab.home(ThetaC).now_or_never().is_none());
    for axis in [ThetaC, PhiS] {
        rig.world.set_powered(axis, true);
    }
    // The first question may have met the silence.
    let mut view = lab.rig().await.unwrap();
    for _ in 0..3 {
        if !view.connected {
            view = lab.rig().await.unwrap();
        }
    }
    assert!(view.connected, "{:?}", view.problem);
    assert_eq!(view.activity, RigActivity::Idle);
    assert!(!view.axes[0].1.homed && !rig.world.is_moving());
    lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_rig_says_why_it_is_not_there_while_a_motion_waits_for_it() {
    let (lab, rig, _folder) = disturbed(|_| {}).await;
    for axis in [ThetaC, PhiS] {
        rig.world.set_powered(axis, false);
    }
    let (homed, view) = tokio::join!(lab.home(ThetaC), lab.rig());
    assert_eq!(homed.unwrap_err().code(), "stage-silent");
    let (code, why) = view.unwrap().problem.unwrap();
    assert_eq!(code, "stage-silent", "{why}");
    lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_abort_that_does_not_reach_the_stages_says_so() {
    let bench = BenchInABox::impatient().await;
    let scan = bench.start(small(&[0.0, 10.0], &[0.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    for axis in [ThetaC, PhiS] {
        bench.rig.world.set_powered(axis, false);
    }
    let reported = bench
        .lab
        .order(scan.id, ScanCommand::Abort)
        .await
        .unwrap_err();
    assert!(
        matches!(reported, LabError::AbortedInMotion { .. }),
        "{reported}"
    );
    let reported = reported.to_string();
    assert!(
        reported.contains("is aborted") && reported.contains("emergency switch"),
        "{reported}"
    );
    let scan = bench.lab.store().scan(scan.id).await.unwrap();
    assert_eq!(scan.state, ScanState::Aborted);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_that_cannot_be_recorded_leaves_nothing_moving() {
    // Slowly enough that somebody can come in the middle of a move.
    let clock: Arc<dyn Clock> = Arc::new(ScaledClock::new(2.0));
    let (lab, rig, folder) = disturbed_on(clock, |_| {}).await;
    rig.add_samples(&lab).await.unwrap();
    let plan = PlanRequest {
        dark: DarkRequest { repeats: Some(0) },
        flat: FlatRequest {
            repeats: Some(0),
            ..FlatRequest::default()
        },
        ..small(&[-55.0, 55.0], &[0.0])
    };
    let mut events = lab.events();
    let request = ScanRequest::of(2, plan);
    let scan = lab.start_scan(&request).await.unwrap();
    let hands = rig.operate(&lab, true);
    next(&mut events, |event| matches!(event, Event::Frame { .. })).await;
    by_hand(
        folder.path(),
        "CREATE TRIGGER full BEFORE INSERT ON scan_states BEGIN SELECT RAISE(ABORT, 'full'); END",
    )
    .await;
    let moves = async {
        while !rig.world.is_moving() {
            tokio::task::yield_now().await;
        }
    };
    in_time(moves).await;
    let refused = lab.order(scan.id, ScanCommand::Pause).await.unwrap_err();
    assert_eq!(refused.code(), "store-failed", "{refused}");
    assert!(!rig.world.is_moving());
    hands.abort();
    lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn no_key_and_no_body_keeps_a_stop_from_stopping() {
    let (bench, router) = opened().await;
    for body in ["", "reason=door", "{"] {
        let stop = request("POST", "/api/v1/rig/stop")
            .header("idempotency-key", "the same")
            .header("content-type", "application/x-www-form-urlencoded")
            .header("content-length", body.len())
            .body(Body::from(body))
            .unwrap();
        let answer = send(&router, stop).await;
        assert_eq!(answer.status, 200, "{}", answer.body);
    }
    let stopped = |event: &Event| matches!(event, Event::Rig { activity, .. } if *activity == RigActivity::Stopped);
    let three = |all: &[RecordedEvent]| all.iter().filter(|e| stopped(&e.event)).count() == 3;
    recorded(&bench.lab, three).await;
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn who_hangs_up_right_after_a_stop_has_said_it() {
    let (bench, router) = opened().await;
    let stop = request("POST", "/api/v1/rig/stop").body(Body::empty());
    let mut call = Box::pin(router.clone().oneshot(stop.unwrap()));
    // As the listener does it: what is asked begins, then the connection is gone and the answer with it.
    assert!(futures::poll!(call.as_mut()).is_pending());
    drop(call);
    let stopped = |event: &Event| matches!(event, Event::Rig { activity, .. } if *activity == RigActivity::Stopped);
    recorded(&bench.lab, |all| all.iter().any(|e| stopped(&e.event))).await;
    bench.end().await;
}
