//! Faults of an axis in and between moves: what is reported, and whether the next move works.

use std::time::Duration;

use ridged::bench::AxisName::{PhiS, ThetaC};
use ridged::bench::stage::StageError;
use ridged::bench::wire::zaber::Activity;
use ridged::bench::wire::zaber_flags::Flag;
use ridged::geometry::Pose;
use ridged::sim::faults::LineFault;
use ridged::sim::world::AxisFault;
use ridged::units::Angle;

use super::{Rig, assert_at, settings};

/// A fault during a move: the expected error, and whether the next move works at once.
async fn fails_with(fault: AxisFault, expected: fn(&StageError) -> bool, next_works: bool) {
    let rig = Rig::new();
    let stage = rig.homed().await;
    rig.world.arm(ThetaC, Angle::from_deg(-40.0), fault);
    let target = Pose::from_deg(0.0, 300.0);
    let error = stage.move_pose(target).await.unwrap_err();
    assert!(expected(&error), "{fault:?}: {error:?}");
    assert!(!rig.world.is_moving(), "the other axis stops too");
    assert!(rig.world.pose_now().phi_s.deg() < 299.0);
    let again = stage.move_pose(target).await;
    assert_eq!(again.is_ok(), next_works, "{fault:?}: {again:?}");
    if fault != AxisFault::EmergencyStop {
        stage.home_all().await.unwrap();
        assert_at(stage.move_pose(target).await.unwrap(), 0.0, 300.0);
        assert_at(rig.world.pose_now(), 0.0, 300.0);
    }
}

#[tokio::test]
async fn a_foreign_stop_is_not_an_arrival() {
    let ni = |e: &StageError| {
        matches!(
            e,
            StageError::Interrupted {
                axis: ThetaC,
                flag: Flag::MovementInterrupted
            }
        )
    };
    fails_with(AxisFault::ForeignStop, ni, true).await;
}

#[tokio::test]
async fn turning_the_manual_knob_is_not_an_arrival() {
    let nc = |e: &StageError| {
        matches!(
            e,
            StageError::Interrupted {
                axis: ThetaC,
                flag: Flag::ManualControl
            }
        )
    };
    fails_with(AxisFault::Knob(Angle::from_deg(3.0)), nc, true).await;
}

#[tokio::test]
async fn a_stall_requires_homing() {
    let stalled = |e: &StageError| matches!(e, StageError::Stalled { axis: ThetaC, position, again: false } if (position.deg() + 40.0).abs() < 0.01);
    fails_with(AxisFault::Stall, stalled, false).await;
}

#[tokio::test]
async fn a_limit_sensor_during_a_move_requires_homing() {
    let wl = |e: &StageError| matches!(e, StageError::Fault { flag, .. } if *flag == Flag::UnexpectedLimit);
    fails_with(AxisFault::LimitSensor, wl, false).await;
}

#[tokio::test]
async fn an_emergency_stop_is_reported_and_lasts() {
    let fh = |e: &StageError| matches!(e, StageError::Fault { flag, .. } if *flag == Flag::EmergencyStop);
    fails_with(AxisFault::EmergencyStop, fh, false).await;
}

#[tokio::test]
async fn a_power_cycle_during_a_move_is_detected() {
    let cycled = |e: &StageError| matches!(e, StageError::PowerCycled { axis: ThetaC });
    fails_with(AxisFault::PowerCycle, cycled, false).await;
}

#[tokio::test]
async fn a_power_cycle_between_moves_is_reported_once() {
    let rig = Rig::new();
    let stage = rig.homed().await;
    stage.move_pose(Pose::from_deg(0.0, 0.0)).await.unwrap();
    rig.world.cause(PhiS, AxisFault::PowerCycle);
    let error = stage
        .move_pose(Pose::from_deg(0.0, 10.0))
        .await
        .unwrap_err();
    assert!(
        matches!(error, StageError::PowerCycled { axis: PhiS }),
        "{error:?}"
    );
    let error = stage
        .move_pose(Pose::from_deg(0.0, 10.0))
        .await
        .unwrap_err();
    assert!(
        matches!(error, StageError::NotReferenced { axis: PhiS }),
        "{error:?}"
    );
    stage.home(PhiS).await.unwrap();
    assert_at(
        stage.move_pose(Pose::from_deg(0.0, 10.0)).await.unwrap(),
        0.0,
        10.0,
    );
}

#[tokio::test]
async fn a_restart_hidden_by_another_program_is_detected_by_the_uptime() {
    let rig = Rig::new();
    let stage = rig.homed().await;
    stage.move_pose(Pose::from_deg(0.0, 0.0)).await.unwrap();
    rig.clock.inner.advance(Duration::from_secs(1000));
    stage.move_pose(Pose::from_deg(0.0, 5.0)).await.unwrap();
    rig.world.cause(PhiS, AxisFault::PowerCycle);
    // `set pos` clears WR and homing clears WH, so no flag is left.
    rig.foreign("/2 1 home");
    stage.status().await.unwrap();
    rig.clock.inner.advance(Duration::from_secs(100));
    let error = stage
        .move_pose(Pose::from_deg(0.0, 10.0))
        .await
        .unwrap_err();
    assert!(
        matches!(error, StageError::PowerCycled { axis: PhiS }),
        "{error:?}"
    );
}

#[tokio::test]
async fn an_axis_at_a_wrong_position_without_a_flag_is_moved_again() {
    let rig = Rig::new();
    let stage = rig.homed().await;
    let by = Angle::from_deg(-2.0);
    rig.world
        .arm(ThetaC, Angle::from_deg(-40.0), AxisFault::ForeignMove(by));
    let pose = stage.move_pose(Pose::from_deg(0.0, 0.0)).await.unwrap();
    assert_at(pose, 0.0, 0.0);
    assert_at(rig.world.pose_now(), 0.0, 0.0);
}

#[tokio::test]
async fn a_move_that_takes_far_too_long_is_stopped() {
    let rig = Rig::new();
    let stage = rig.homed().await;
    // The first question finds it at rest; from then on it never says so.
    rig.faults.on("get pos", LineFault::DoubleReply, 1);
    let endless = LineFault::Claims(Activity::Busy);
    rig.faults.on("get pos", endless, 1_000_000);
    let error = stage.move_to(ThetaC, Angle::ZERO).await.unwrap_err();
    let StageError::TimedOut {
        axis: ThetaC,
        waited_s,
        predicted_s,
    } = error
    else {
        panic!("{error:?}")
    };
    // The limit is one and a half times the prediction plus a second.
    assert!(waited_s > 1.5 * predicted_s + 1.0 && waited_s < 1.5 * predicted_s + 1.5);
    assert!(!rig.world.is_moving());
}

#[tokio::test]
async fn homing_that_is_cut_off_names_its_key() {
    let rig = Rig::new();
    let mut settings = settings();
    settings.phi_s.home_timeout_s = 2.0;
    // From recorded 0 to the home switch, 30° away.
    settings.phi_s.max_speed_deg_s = Some(1.0);
    let stage = rig.connect_with(settings).await.unwrap();
    let error = stage.home(PhiS).await.unwrap_err();
    assert!(
        matches!(error, StageError::HomingTimedOut { axis: PhiS, .. }),
        "{error:?}"
    );
    assert_eq!(error.axis_to_home(), Some(PhiS));
    let words = error.to_string();
    for part in ["home_timeout_s in [stage.phi_s]", "within 2 s"] {
        assert!(words.contains(part), "{part}: {words}");
    }
    assert!(!rig.world.is_moving());
    // The same for any other late motion: even the shortest has a duration above 0.
    let late = StageError::TimedOut {
        axis: PhiS,
        waited_s: 1.01,
        predicted_s: 0.02,
    };
    assert!(!late.to_string().contains("0.0 s"), "{late}");
}

#[tokio::test]
async fn the_error_of_a_parked_axis_names_the_command_to_unpark_it() {
    let rig = Rig::new();
    let stage = rig.homed().await;
    stage.move_pose(Pose::from_deg(5.0, 10.0)).await.unwrap();
    rig.foreign("/1 1 tools parking park");
    stage.status().await.unwrap();
    let refused = stage.move_to(ThetaC, Angle::ZERO).await.unwrap_err();
    let words = refused.to_string();
    assert!(words.contains("ridged rig unpark"), "{words}");
    // Homing on the stage does not unpark: only an operator's command may.
    assert!(stage.home(ThetaC).await.is_err());
    stage.unpark(ThetaC).await.unwrap();
    assert!(!rig.world.is_moving());
    let pose = stage.move_pose(Pose::from_deg(0.0, 10.0)).await.unwrap();
    assert_at(pose, 0.0, 10.0);

    rig.foreign("/1 1 tools parking park");
    stage.status().await.unwrap();
    stage.release(ThetaC).await.unwrap();
    stage.home(ThetaC).await.unwrap();
}
