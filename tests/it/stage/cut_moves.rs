//! Moves that end early: a stop, a pulled plug, a task that is dropped.

use ridged::bench::AxisName::ThetaC;
use ridged::bench::stage::StageError;
use ridged::geometry::Pose;
use ridged::sim::faults::LineFault;
use ridged::units::Angle;

use super::{Rig, assert_at};

#[tokio::test]
async fn a_pulled_plug_ends_the_move_and_the_next_connection_finds_a_still_stage() {
    let rig = Rig::new();
    let stage = rig.homed().await;
    rig.faults.on("move abs", LineFault::Unplug, 1);
    let error = stage.move_to(ThetaC, Angle::ZERO).await.unwrap_err();
    assert!(
        matches!(error, StageError::Disconnected(_)) && error.is_disconnect(),
        "{error:?}"
    );
    assert!(stage.status().await.unwrap_err().is_disconnect());
    assert!(rig.world.is_moving(), "the stop could not reach the device");
    stage.closed().await;
    let stage = rig.connect().await;
    assert!(!rig.world.is_moving());
    assert!(stage.status().await.unwrap().all_homed());
    assert_at(
        stage.move_pose(Pose::from_deg(0.0, 0.0)).await.unwrap(),
        0.0,
        0.0,
    );
}

#[tokio::test]
async fn a_stop_ends_a_move_at_once_and_the_next_one_works() {
    let rig = Rig::new();
    let stage = rig.homed().await;
    rig.clock.hold();
    let moving = tokio::spawn({
        let stage = stage.clone();
        async move { stage.move_pose(Pose::from_deg(40.0, 300.0)).await }
    });
    rig.clock.somebody_sleeps.notified().await;
    assert!(rig.world.is_moving());
    let second = stage.move_pose(Pose::from_deg(0.0, 0.0)).await;
    assert!(matches!(second, Err(StageError::Busy { .. })), "{second:?}");

    let stop = async {
        // The move ends although the clock is held: it does not wait for its time-out.
        let stopped = moving.await.unwrap();
        assert!(matches!(stopped, Err(StageError::Stopped)), "{stopped:?}");
        rig.clock.let_go();
    };
    let (outcome, ()) = tokio::join!(stage.stop(), stop);
    outcome.unwrap();
    assert!(!rig.world.is_moving());
    assert!(rig.world.pose_now().phi_s.deg() < 0.0, "it hardly moved");
    assert_at(
        stage.move_pose(Pose::from_deg(5.0, 5.0)).await.unwrap(),
        5.0,
        5.0,
    );
}

#[tokio::test]
async fn a_stop_during_homing_leaves_the_axis_without_reference() {
    let rig = Rig::new();
    let stage = rig.connect().await;
    rig.clock.hold();
    let homing = tokio::spawn({
        let stage = stage.clone();
        async move { stage.home_all().await }
    });
    rig.clock.somebody_sleeps.notified().await;
    let stopped = async {
        let outcome = homing.await.unwrap();
        assert!(matches!(outcome, Err(StageError::Stopped)), "{outcome:?}");
        rig.clock.let_go();
    };
    let (outcome, ()) = tokio::join!(stage.stop(), stopped);
    outcome.unwrap();
    let error = stage.move_pose(Pose::from_deg(0.0, 0.0)).await.unwrap_err();
    assert!(
        matches!(error, StageError::NotReferenced { .. }),
        "{error:?}"
    );
    assert_eq!(error.axis_to_home(), Some(ThetaC));
}

#[tokio::test]
async fn a_move_whose_future_was_dropped_is_stopped_by_the_next() {
    let rig = Rig::new();
    let stage = rig.homed().await;
    rig.clock.hold();
    let move_away = stage.move_pose(Pose::from_deg(40.0, 300.0));
    tokio::select! {
        _ = move_away => panic!("the clock is held"),
        () = rig.clock.somebody_sleeps.notified() => {}
    }
    assert!(rig.world.is_moving());
    rig.clock.let_go();
    assert_at(
        stage.move_pose(Pose::from_deg(1.0, 2.0)).await.unwrap(),
        1.0,
        2.0,
    );
    assert_at(rig.world.pose_now(), 1.0, 2.0);
}

#[tokio::test]
async fn the_status_can_be_read_during_a_move() {
    let rig = Rig::new();
    let stage = rig.homed().await;
    rig.clock.hold();
    let moving = tokio::spawn({
        let stage = stage.clone();
        async move { stage.move_to(ThetaC, Angle::ZERO).await }
    });
    rig.clock.somebody_sleeps.notified().await;
    let status = stage.status().await.unwrap();
    assert!(status.theta_c.moving && !status.phi_s.moving && status.all_homed());
    rig.clock.let_go();
    moving.await.unwrap().unwrap();
}
