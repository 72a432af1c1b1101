//! What a stage verifies beyond its flags: settings, encoder, lost steps, passing refusals, other devices on the line.

use std::collections::BTreeSet;

use futures::future::BoxFuture;
use ridged::bench::AxisName::{PhiS, ThetaC};
use ridged::bench::stage::{Notices, Stage, StageError, StageNotice, StageSettings};
use ridged::bench::wire::zaber::{Activity, Reply};
use ridged::bench::wire::zaber_flags::Flag;
use ridged::bench::{Camera, CameraError, CaptureRequest, Captured};
use ridged::geometry::Pose;
use ridged::sim::faults::LineFault;
use ridged::sim::world::AxisFault;
use ridged::units::Angle;
use tokio::sync::broadcast::Receiver;

use crate::stage::{Rig, assert_at, settings};

/// A homed stage, and its notices.
async fn watched(rig: &Rig, settings: StageSettings) -> (Stage, Receiver<StageNotice>) {
    let notices = Notices::default();
    let heard = notices.subscribe();
    let stage = Stage::connect_known(&rig.link(settings), None, &notices)
        .await
        .unwrap();
    stage.home_all().await.unwrap();
    (stage, heard)
}

fn codes(notices: &mut Receiver<StageNotice>) -> Vec<(&'static str, String)> {
    std::iter::from_fn(|| notices.try_recv().ok())
        .map(|notice| (notice.code, notice.message))
        .collect()
}

#[tokio::test]
async fn settings_lost_at_a_restart_are_written_again_before_the_next_motion() {
    let rig = Rig::new();
    let mut settings = settings();
    settings.theta_c.max_speed_deg_s = Some(5.0);
    let (stage, mut notices) = watched(&rig, settings).await;
    stage.move_pose(Pose::from_deg(0.0, 0.0)).await.unwrap();
    rig.world.cause(ThetaC, AxisFault::FactoryReset);
    let target = Pose::from_deg(5.0, 0.0);
    let error = stage.move_pose(target).await.unwrap_err();
    assert!(
        matches!(error, StageError::PowerCycled { axis: ThetaC }),
        "{error:?}"
    );
    assert!(codes(&mut notices).is_empty());
    rig.faults
        .on(" home", LineFault::Refuse("BADDATA".into()), 1);
    // The speed is restored before the homing, which is refused here.
    assert!(stage.home(ThetaC).await.is_err());
    let reported = codes(&mut notices);
    let (code, words) = &reported[0];
    assert_eq!(*code, "stage-settings-restored");
    assert!(
        words.contains("maxspeed was") && words.contains("comm.checksum was 0"),
        "{words}"
    );
    stage.home(ThetaC).await.unwrap();
    assert_at(stage.move_pose(target).await.unwrap(), 5.0, 0.0);
    assert!(codes(&mut notices).is_empty());
}

#[tokio::test]
async fn a_speed_that_another_program_set_is_not_used() {
    let rig = Rig::new();
    let (stage, mut notices) = watched(&rig, settings()).await;
    rig.foreign("/1 1 set maxspeed 5000");
    assert_at(
        stage.move_pose(Pose::from_deg(0.0, 0.0)).await.unwrap(),
        0.0,
        0.0,
    );
    let reported = codes(&mut notices);
    assert!(
        reported
            .iter()
            .any(|(_, words)| words.contains("maxspeed was 5000")),
        "{reported:?}"
    );
}

#[tokio::test]
async fn a_setting_that_the_device_does_not_take_is_refused_by_its_name() {
    let rig = Rig::new();
    let (stage, _notices) = watched(&rig, settings()).await;
    rig.foreign("/1 1 set maxspeed 5000");
    let refuse = LineFault::Refuse("BADCOMMAND".into());
    rig.faults.on("set maxspeed", refuse, 1);
    let error = stage.move_to(ThetaC, Angle::ZERO).await.unwrap_err();
    let disagrees = matches!(
        error,
        StageError::Disagreement {
            axis: ThetaC,
            name: "maxspeed",
            ..
        }
    );
    assert!(disagrees, "{error:?}");
}

#[tokio::test]
async fn a_refusal_for_a_moment_is_waited_for_and_a_lasting_one_is_named() {
    for code in ["AGAIN", "STATUSBUSY"] {
        let rig = Rig::new();
        let (stage, _notices) = watched(&rig, settings()).await;
        rig.faults.on("move abs", LineFault::Refuse(code.into()), 3);
        assert_at(
            stage.move_pose(Pose::from_deg(0.0, 0.0)).await.unwrap(),
            0.0,
            0.0,
        );
        assert_eq!(rig.faults.happened(), 3);
        rig.faults
            .on("move abs", LineFault::Refuse(code.into()), 10_000);
        let error = stage
            .move_to(ThetaC, Angle::from_deg(5.0))
            .await
            .unwrap_err();
        assert!(
            matches!(&error, StageError::Refused { code: found, .. } if found == code),
            "{error:?}"
        );
    }
}

#[tokio::test]
async fn a_poll_that_says_idle_during_a_move_is_no_reason_to_move_again() {
    let rig = Rig::new();
    let (stage, _notices) = watched(&rig, settings()).await;
    rig.faults.on("1 1 ", LineFault::Claims(Activity::Idle), 30);
    assert_at(
        stage.move_pose(Pose::from_deg(0.0, 0.0)).await.unwrap(),
        0.0,
        0.0,
    );
    assert_at(rig.world.pose_now(), 0.0, 0.0);
}

#[tokio::test]
async fn the_second_stall_at_one_place_says_so() {
    let rig = Rig::new();
    let (stage, _notices) = watched(&rig, settings()).await;
    let at = Angle::from_deg(-40.0);
    for expected in [false, true, true] {
        rig.world.arm(ThetaC, at, AxisFault::Stall);
        let error = stage.move_to(ThetaC, Angle::ZERO).await.unwrap_err();
        let reported = matches!(error, StageError::Stalled { again, .. } if again == expected);
        assert!(reported, "{error:?}");
        assert_eq!(
            error.to_string().contains("stalled again"),
            expected,
            "{error}"
        );
        stage.home(ThetaC).await.unwrap();
    }
    // A move past it ends the matter.
    stage.move_to(ThetaC, Angle::ZERO).await.unwrap();
    stage.home(ThetaC).await.unwrap();
    rig.world.arm(ThetaC, at, AxisFault::Stall);
    let error = stage.move_to(ThetaC, Angle::ZERO).await.unwrap_err();
    assert!(
        matches!(error, StageError::Stalled { again: false, .. }),
        "{error:?}"
    );
}

#[tokio::test]
async fn steps_lost_at_a_limit_sensor_are_reported_after_homing() {
    for with_encoder in [true, false] {
        let rig = Rig::new();
        if !with_encoder {
            rig.faults.on(
                "get encoder.pos",
                LineFault::Refuse("BADCOMMAND".into()),
                1000,
            );
        }
        let (stage, mut notices) = watched(&rig, settings()).await;
        stage.move_to(ThetaC, Angle::from_deg(-50.0)).await.unwrap();
        rig.world
            .arm(ThetaC, Angle::from_deg(-40.0), AxisFault::LimitSensor);
        let error = stage.move_to(ThetaC, Angle::ZERO).await.unwrap_err();
        let hit = matches!(
            error,
            StageError::Fault {
                flag: Flag::UnexpectedLimit,
                ..
            }
        );
        assert!(hit, "{error:?}");
        rig.world
            .cause(ThetaC, AxisFault::Slip(Angle::from_deg(0.5)));
        stage.home(ThetaC).await.unwrap();
        let reported = codes(&mut notices);
        let (code, words) = &reported[0];
        assert_eq!(*code, "stage-lost-steps");
        assert!(words.contains("limit sensor at -40.0"), "{words}");
        let lost: f64 = words
            .split("it had lost ")
            .nth(1)
            .and_then(|rest| rest.split('°').next())
            .unwrap()
            .parse()
            .unwrap();
        assert!((lost - 0.5).abs() < 0.1, "{words}");
        assert_eq!(words.contains("by the encoder"), with_encoder, "{words}");
    }
}

#[tokio::test]
async fn a_slip_without_a_flag_is_found_by_the_encoder() {
    let rig = Rig::new();
    let (stage, _notices) = watched(&rig, settings()).await;
    stage.move_pose(Pose::from_deg(0.0, 30.0)).await.unwrap();
    rig.world.cause(PhiS, AxisFault::Slip(Angle::from_deg(0.5)));
    let at_rest = stage.check_slip().await.unwrap_err();
    assert!(
        matches!(at_rest, StageError::Slipped { axis: PhiS, .. }),
        "{at_rest:?}"
    );
    let error = stage
        .move_pose(Pose::from_deg(0.0, 60.0))
        .await
        .unwrap_err();
    let StageError::Slipped { axis: PhiS, slip } = error else {
        panic!("{error:?}");
    };
    assert!((slip.deg() - 0.5).abs() < 1e-3, "{slip}");
    stage.home(PhiS).await.unwrap();
    stage.move_pose(Pose::from_deg(0.0, 60.0)).await.unwrap();
    assert_at(rig.world.pose_now(), 0.0, 60.0);
    // Another program sets the counter.
    rig.foreign("/2 1 set pos 0");
    let error = stage
        .move_pose(Pose::from_deg(0.0, 90.0))
        .await
        .unwrap_err();
    assert!(
        matches!(error, StageError::Slipped { axis: PhiS, .. }),
        "{error:?}"
    );
}

/// A rig that takes no frames.
struct NoCamera;

impl Camera for NoCamera {
    fn describe(&self) -> String {
        "no camera".into()
    }

    fn capture<'a>(
        &'a mut self,
        _: &'a CaptureRequest,
    ) -> BoxFuture<'a, Result<Captured, CameraError>> {
        unreachable!("no frame is taken")
    }
}

#[tokio::test]
async fn a_slip_while_the_link_is_lost_is_found_after_the_next_connection() {
    let bench = Rig::new();
    let mut owner = ridged::scan::Rig::new(bench.link(settings()), Box::new(NoCamera));
    let ready = async |owner: &mut ridged::scan::Rig| {
        owner
            .make_ready(&BTreeSet::new(), true, true)
            .await
            .unwrap()
    };
    let stage = ready(&mut owner).await;
    stage.move_pose(Pose::from_deg(0.0, 30.0)).await.unwrap();
    owner.let_go();
    bench
        .world
        .cause(PhiS, AxisFault::Slip(Angle::from_deg(0.1)));
    let stage = ready(&mut owner).await;
    let error = stage
        .move_pose(Pose::from_deg(0.0, 60.0))
        .await
        .unwrap_err();
    assert!(
        matches!(error, StageError::Slipped { axis: PhiS, .. }),
        "{error:?}"
    );
    // Homing ends the doubt, also over a further connection.
    stage.home(PhiS).await.unwrap();
    owner.let_go();
    let stage = ready(&mut owner).await;
    stage.move_pose(Pose::from_deg(0.0, 60.0)).await.unwrap();
    assert_at(bench.world.pose_now(), 0.0, 60.0);
    // A restarted controller has no reference and another count of its encoder: both are read again.
    owner.let_go();
    bench.world.cause(PhiS, AxisFault::PowerCycle);
    let stage = ready(&mut owner).await;
    stage.move_pose(Pose::from_deg(0.0, 20.0)).await.unwrap();
    assert_at(bench.world.pose_now(), 0.0, 20.0);
}

#[tokio::test]
async fn a_garbled_encoder_reading_is_no_slip_and_an_encoder_in_other_units_is_not_used() {
    let rig = Rig::new();
    let (stage, _notices) = watched(&rig, settings()).await;
    stage.move_pose(Pose::from_deg(0.0, 30.0)).await.unwrap();
    rig.faults.on("get encoder.pos", LineFault::DoubleReply, 2);
    stage.move_pose(Pose::from_deg(5.0, 30.0)).await.unwrap();
    let rig = Rig::new();
    // It never changes.
    rig.faults
        .on("get encoder.pos", LineFault::Says("7".into()), 10_000);
    let mut unchecked = settings();
    unchecked.attempts = 2;
    rig.faults.on(
        "set comm.checksum",
        LineFault::Refuse("BADCOMMAND".into()),
        2,
    );
    let (stage, _notices) = watched(&rig, unchecked).await;
    for theta_c_deg in [0.0, 20.0] {
        stage
            .move_pose(Pose::from_deg(theta_c_deg, 30.0))
            .await
            .unwrap();
    }
}

#[tokio::test]
async fn a_second_device_that_takes_an_address_is_named() {
    let rig = Rig::new();
    let (stage, _notices) = watched(&rig, settings()).await;
    stage.move_pose(Pose::from_deg(0.0, 30.0)).await.unwrap();
    rig.foreign("/2 0 renumber 1");
    let error = stage
        .move_to(ThetaC, Angle::from_deg(20.0))
        .await
        .unwrap_err();
    let named = matches!(
        error,
        StageError::AddressConflict { address: 1 } | StageError::Replaced { .. }
    );
    assert!(named, "{error:?}");
}

#[tokio::test]
async fn replies_to_another_program_are_reported_once() {
    let rig = Rig::new();
    let (stage, mut notices) = watched(&rig, settings()).await;
    let foreign = Reply {
        address: 9,
        axis: 1,
        id: Some(99),
        accepted: true,
        activity: Activity::Idle,
        flag: None,
        data: "5".into(),
    };
    let foreign = LineFault::Before(foreign.encode(true).unwrap());
    rig.faults.on("get pos", foreign, 40);
    for theta_c_deg in [0.0, 5.0, 10.0] {
        let pose = Pose::from_deg(theta_c_deg, 0.0);
        assert_at(stage.move_pose(pose).await.unwrap(), theta_c_deg, 0.0);
    }
    let reported = codes(&mut notices);
    assert_eq!(reported.len(), 1, "{reported:?}");
    assert_eq!(reported[0].0, "stage-foreign-traffic");
}

#[tokio::test]
async fn a_controller_that_was_replaced_on_a_live_line_does_not_move() {
    let rig = Rig::new();
    let (stage, _notices) = watched(&rig, settings()).await;
    rig.world.cause(PhiS, AxisFault::Replaced(777));
    let error = stage.home(PhiS).await.unwrap_err();
    let named = matches!(
        error,
        StageError::Replaced {
            axis: PhiS,
            before: 90_002,
            found: 777
        }
    );
    assert!(named, "{error:?}");
    assert!(stage.is_closed());
    assert!(!rig.world.is_moving());
}
