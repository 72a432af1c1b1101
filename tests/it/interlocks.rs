//! Forbidden regions: on moves, on plans, on jogs and for the order of homing.

use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::body::Body;
use ridged::bench::AxisName::{PhiS, ThetaC};
use ridged::bench::stage::{
    ForbiddenRegion, HomingOrder, JogOrder, Stage, StageError, StageSettings,
};
use ridged::clock::{Clock, ScaledClock};
use ridged::geometry::Pose;
use ridged::lab::{LabError, RigParts, ScanRequest};
use ridged::scan::event::RigActivity;
use ridged::scan::{Rig as ScanRig, ScanState, StageLink};
use ridged::sim::controller::Controller;
use ridged::sim::faults::ScriptedFaults;
use ridged::sim::server::{PtyServer, serve_pty};
use ridged::sim::world::{AxisFault, World, WorldSettings};
use ridged::store::disk::RealDisk;
use ridged::units::Angle;
use serde_json::json;
use tokio::sync::watch;

use crate::bench_in_a_box::{BenchInABox, small};
use crate::http::{is_problem, opened_in, request, send};
use crate::stage::{Rig, assert_at, settings};
use crate::stop::idle;

fn guarded(mut settings: StageSettings) -> StageSettings {
    settings.forbidden = vec![ForbiddenRegion {
        name: "lamp arm".into(),
        reason: "the lens hits it".into(),
        theta_c_deg: [30.0, 60.0],
        phi_s_deg: [80.0, 100.0],
    }];
    settings.homing.order = HomingOrder::ThetaCFirst;
    settings
}

async fn homed(rig: &Rig, settings: StageSettings) -> Stage {
    let notices = Default::default();
    let stage = Stage::connect_known(&rig.link(settings), None, &notices).await;
    let stage = stage.unwrap();
    stage.home_all().await.unwrap();
    stage
}

#[tokio::test]
async fn a_move_goes_one_axis_first_where_only_this_is_free_and_not_at_all_where_nothing_is() {
    let rig = Rig::new();
    let stage = homed(&rig, guarded(settings())).await;
    stage.move_pose(Pose::from_deg(0.0, 90.0)).await.unwrap();
    let around = stage.move_pose(Pose::from_deg(50.0, 120.0)).await.unwrap();
    assert_at(around, 50.0, 120.0);
    for target in [Pose::from_deg(50.0, 70.0), Pose::from_deg(45.0, 90.0)] {
        let refused = stage.move_pose(target).await.unwrap_err();
        let words = refused.to_string();
        assert!(matches!(refused, StageError::Forbidden(_)), "{refused:?}");
        assert!(
            words.contains("lamp arm") && words.contains("the lens hits it"),
            "{words}"
        );
        let refused = stage.move_to(PhiS, target.phi_s).await.unwrap_err();
        assert!(matches!(refused, StageError::Forbidden(_)), "{refused:?}");
        assert_at(rig.world.pose_now(), 50.0, 120.0);
    }
    assert_at(
        stage.move_pose(Pose::from_deg(0.0, 90.0)).await.unwrap(),
        0.0,
        90.0,
    );
}

#[tokio::test]
async fn an_axis_is_homed_with_the_other_one_at_its_safe_angle() {
    let rig = Rig::new();
    let mut settings = guarded(settings());
    let stage = homed(&rig, settings.clone()).await;
    stage.move_pose(Pose::from_deg(50.0, 120.0)).await.unwrap();
    rig.world.cause(PhiS, AxisFault::PowerCycle);
    // Without a stated safe angle nothing moves.
    let refused = stage.home(PhiS).await.unwrap_err();
    assert!(
        refused.to_string().contains("safe_theta_c_deg"),
        "{refused}"
    );
    assert_at(rig.world.pose_now(), 50.0, 120.0);
    drop(stage);

    settings.homing.safe_theta_c_deg = Some(0.0);
    let rig = Rig::new();
    let stage = homed(&rig, settings).await;
    stage.move_pose(Pose::from_deg(50.0, 120.0)).await.unwrap();
    rig.world.cause(PhiS, AxisFault::PowerCycle);
    stage.home(PhiS).await.unwrap();
    let now = rig.world.pose_now();
    assert!(
        now.theta_c.deg().abs() < 0.01 && now.phi_s.deg() < -29.0,
        "{now:?}"
    );
    // Neither has a reference: the order of the settings counts.
    rig.world.cause(PhiS, AxisFault::PowerCycle);
    rig.world.cause(ThetaC, AxisFault::PowerCycle);
    let refused = stage.home(PhiS).await.unwrap_err();
    let first = matches!(
        refused,
        StageError::HomingOrder {
            axis: PhiS,
            first: ThetaC
        }
    );
    assert!(first, "{refused:?}");
    stage.home_all().await.unwrap();
    assert!(stage.status().await.unwrap().all_homed());
}

fn guard(parts: RigParts) -> RigParts {
    let RigParts { rig, settings } = parts;
    let link = rig.link().clone();
    let link = StageLink {
        settings: guarded(link.settings),
        ..link
    };
    RigParts {
        rig: ScanRig::new(link, rig.camera),
        settings,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_plan_with_forbidden_points_is_refused_with_their_list_and_one_around_them_runs() {
    let folder = tempfile::tempdir().unwrap();
    let disk = Arc::new(RealDisk);
    let bench = BenchInABox::open_as(folder.path(), disk, true, Duration::ZERO, guard).await;
    let plan = small(&[0.0, 40.0], &[60.0, 90.0, 120.0]);
    let request = ScanRequest::of(2, plan);
    let refused = bench.lab.start_scan(&request).await.unwrap_err();
    let LabError::Plan(error) = refused else {
        panic!("{refused:?}");
    };
    let words: Vec<&str> = error.problems.iter().map(|p| p.message.as_str()).collect();
    let inside =
        |w: &&str| w.contains("40.000°") && w.contains("90.000°") && w.contains("lamp arm");
    assert!(words.iter().any(inside), "{words:?}");
    assert!(!bench.rig.world.is_moving());
    // Both sides of the region: the order of the points avoids it.
    let scan = bench.start(small(&[0.0, 40.0], &[60.0, 120.0])).await;
    let scan = bench.finish(scan.id).await;
    assert_eq!(scan.state, ScanState::Completed, "{:?}", scan.reason);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_axes_are_parked_past_a_forbidden_region() {
    let folder = tempfile::tempdir().unwrap();
    let disk = Arc::new(RealDisk);
    let parking = |parts| {
        let mut parts = guard(parts);
        // Only the azimuth may move first from φs = 90°.
        parts.settings.park = Some(Pose::from_deg(50.0, 120.0));
        parts
    };
    let bench = BenchInABox::open_as(folder.path(), disk, true, Duration::ZERO, parking).await;
    let scan = bench.start(small(&[0.0], &[90.0])).await;
    let mut events = bench.lab.events();
    bench.until(scan.id, ScanState::Completed).await;
    idle(&mut events).await;
    assert_at(bench.rig.world.pose_now(), 50.0, 120.0);
    bench.end().await;
}

/// A stage in real time: a jog depends on a person.
struct RealTimeRig {
    world: Arc<World>,
    _server: PtyServer,
    stage: Stage,
}

async fn in_real_time(settings: StageSettings) -> RealTimeRig {
    let clock: Arc<dyn Clock> = Arc::new(ScaledClock::new(20.0));
    let world = Arc::new(World::new(Arc::clone(&clock), WorldSettings::default()));
    let server = serve_pty(Controller::new(&world)).unwrap();
    let link = StageLink {
        port: server.path().to_str().unwrap().parse().unwrap(),
        settings: StageSettings {
            reply_timeout_ms: 500,
            attempts: 5,
            ..settings
        },
        clock,
        seam: Arc::new(ScriptedFaults::new()),
    };
    let stage = Stage::connect_known(&link, None, &Default::default()).await;
    let stage = stage.unwrap();
    stage.home_all().await.unwrap();
    RealTimeRig {
        world,
        _server: server,
        stage,
    }
}

fn order(speed_deg_s: f64, for_ms: u64) -> JogOrder {
    JogOrder {
        speed_deg_s,
        until: Instant::now() + Duration::from_millis(for_ms),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_jog_stops_by_itself_when_it_is_not_renewed() {
    let rig = in_real_time(StageSettings::simulated()).await;
    rig.stage.move_pose(Pose::from_deg(0.0, 0.0)).await.unwrap();
    let (_renew, orders) = watch::channel(order(2.0, 300));
    let stops = rig.stage.stops();
    let began = Instant::now();
    let end = rig.stage.jog(PhiS, orders, stops, |_| {}).await.unwrap();
    assert!(began.elapsed() >= Duration::from_millis(290));
    // Up to 0.3 s at 20 times 2°/s, less where the machine is busy.
    assert!(end.deg() > 0.2, "{end}");
    assert!(!rig.world.is_moving());
    let at = rig.world.pose_now().phi_s;
    assert!((at - end).abs().deg() < 0.02, "{at} {end}");
    let status = rig.stage.status().await.unwrap();
    assert_eq!(
        status.phi_s.warnings,
        Vec::<String>::new(),
        "its own stop is no news"
    );
    assert!(rig.world.pose_now().theta_c.deg().abs() < 0.01);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_jog_ends_with_its_client_with_a_stop_and_with_speed_zero() {
    let rig = in_real_time(StageSettings::simulated()).await;
    rig.stage.move_pose(Pose::from_deg(0.0, 0.0)).await.unwrap();
    let long = order(1.0, 60_000);
    // The client is gone.
    let (renew, orders) = watch::channel(long);
    drop(renew);
    rig.stage
        .jog(PhiS, orders, rig.stage.stops(), |_| {})
        .await
        .unwrap();
    // It lets go.
    let (renew, orders) = watch::channel(long);
    let stops = rig.stage.stops();
    let (ended, ()) = tokio::join!(rig.stage.jog(PhiS, orders, stops, |_| {}), async {
        tokio::time::sleep(Duration::from_millis(150)).await;
        renew.send_replace(order(0.0, 0));
    });
    ended.unwrap();
    // Somebody stops the stage.
    let (_renew, orders) = watch::channel(long);
    let (ended, stopped) = tokio::join!(rig.stage.jog(PhiS, orders, stops, |_| {}), async {
        tokio::time::sleep(Duration::from_millis(150)).await;
        rig.stage.stop().await
    });
    stopped.unwrap();
    assert!(matches!(ended, Err(StageError::Stopped)), "{ended:?}");
    assert!(!rig.world.is_moving());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_jog_waits_before_a_forbidden_region_and_at_the_limit() {
    let rig = in_real_time(guarded(StageSettings::simulated())).await;
    rig.stage
        .move_pose(Pose::from_deg(45.0, 60.0))
        .await
        .unwrap();
    let (renew, orders) = watch::channel(order(20.0, 60_000));
    let stops = rig.stage.stops();
    let why = Arc::new(std::sync::Mutex::new(None));
    let reported = Arc::clone(&why);
    let at_end = move |reason: Option<String>| {
        if reason.is_some() {
            renew.send_replace(order(0.0, 0));
            *reported.lock().unwrap() = reason;
        }
    };
    let end = rig.stage.jog(PhiS, orders, stops, at_end).await.unwrap();
    assert!(end.deg() > 79.9 && end.deg() < 80.0, "{end}");
    let why = why.lock().unwrap().clone().unwrap();
    assert!(why.contains("lamp arm"), "{why}");
    // Back is free, as far as the limit.
    let (renew, orders) = watch::channel(order(-30.0, 60_000));
    let at_end = move |reason: Option<String>| {
        if reason.is_some() {
            renew.send_replace(order(0.0, 0));
        }
    };
    let end = rig.stage.jog(PhiS, orders, stops, at_end).await.unwrap();
    assert!((end - Angle::from_deg(-20.0)).abs().deg() < 0.02, "{end}");
}

#[tokio::test(flavor = "multi_thread")]
async fn an_axis_without_reference_is_not_jogged() {
    let rig = in_real_time(StageSettings::simulated()).await;
    rig.world.cause(PhiS, AxisFault::PowerCycle);
    let (_renew, orders) = watch::channel(order(1.0, 60_000));
    let refused = rig.stage.jog(PhiS, orders, rig.stage.stops(), |_| {}).await;
    assert!(
        matches!(refused, Err(StageError::PowerCycled { axis: PhiS })),
        "{refused:?}"
    );
    assert!(!rig.world.is_moving());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_jog_of_a_client_is_renewed_by_its_number_and_a_stop_ends_it_for_good() {
    let folder = tempfile::tempdir().unwrap();
    let (rig, lab, router) = opened_in(folder.path(), 20.0).await;
    let jog = async |body: serde_json::Value| {
        let asked = request("POST", "/api/v1/rig/jog")
            .header("content-type", "application/json")
            .body(Body::from(body.to_string()));
        send(&router, asked.unwrap()).await
    };
    let idle = async || {
        let is_busy = |activity| activity != RigActivity::Idle;
        while is_busy(lab.rig().await.unwrap().activity) {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    let begin = json!({ "axis": "phi_s", "speed_deg_s": 2.0 });
    is_problem(&jog(begin.clone()).await, 409, "stage-not-referenced");
    lab.home_both().await.unwrap();
    idle().await;
    let wrong = json!({ "axis": "psi", "speed_deg_s": 2.0 });
    is_problem(&jog(wrong).await, 422, "invalid-value");
    let endless = json!({ "axis": "phi_s", "speed_deg_s": 1e9 });
    is_problem(&jog(endless).await, 422, "invalid-value");
    let unknown = json!({ "axis": "phi_s", "speed_deg_s": 2.0, "jog": 1 });
    is_problem(&jog(unknown).await, 409, "jog-ended");

    let begun = jog(begin.clone()).await;
    assert_eq!(begun.status, 200, "{}", begun.body);
    let number = begun.body["jog"].clone();
    is_problem(&jog(begin.clone()).await, 409, "busy");
    let renew = json!({ "axis": "phi_s", "speed_deg_s": 2.0, "jog": number });
    for _ in 0..4 {
        tokio::time::sleep(Duration::from_millis(100)).await;
        assert_eq!(jog(renew.clone()).await.status, 200);
    }
    let end = json!({ "axis": "phi_s", "speed_deg_s": 0.0, "jog": number });
    let ended = jog(end.clone()).await;
    assert_eq!(ended.body["ended"], true, "{}", ended.body);
    assert!(!rig.world.is_moving());
    // Ending it again changes nothing; renewing it starts nothing.
    assert_eq!(jog(end).await.status, 200);
    is_problem(&jog(renew).await, 409, "jog-ended");

    // Released by a stop: the renewals that are still under way start nothing.
    idle().await;
    let number = jog(begin.clone()).await.body["jog"].clone();
    lab.stop().await.unwrap();
    idle().await;
    let late = json!({ "axis": "phi_s", "speed_deg_s": 2.0, "jog": number });
    is_problem(&jog(late).await, 409, "jog-ended");
    assert!(!rig.world.is_moving());

    // Its client is gone: it moves for half a second.
    let before = rig.world.pose_now().phi_s;
    jog(begin).await;
    idle().await;
    let moved = rig.world.pose_now().phi_s - before;
    assert!(moved.deg() > 0.5 && moved.deg() < 60.0, "{moved}");
    assert!(!rig.world.is_moving());
    lab.shut_down().await;
}
