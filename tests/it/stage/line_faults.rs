//! Faults of the line under a stage: lost, late, doubled and garbled replies.

use ridged::bench::AxisName::ThetaC;
use ridged::bench::stage::StageError;
use ridged::geometry::Pose;
use ridged::sim::faults::LineFault;
use ridged::units::Angle;

use super::{Rig, assert_at};

/// With a fault on the line during a move, the axis still arrives, and moves only once.
async fn arrives_in_spite_of(command: &str, fault: LineFault, times: u32) {
    let rig = Rig::new();
    let stage = rig.homed().await;
    rig.faults.on(command, fault.clone(), times);
    let pose = stage.move_pose(Pose::from_deg(-20.0, 40.0)).await.unwrap();
    assert_at(pose, -20.0, 40.0);
    assert_at(rig.world.pose_now(), -20.0, 40.0);
    assert!(rig.faults.happened() > 0, "{fault:?} never happened");
}

#[tokio::test]
async fn a_lost_reply_to_a_move_does_not_interrupt_it() {
    arrives_in_spite_of("move abs", LineFault::LoseReply, 1).await;
}

#[tokio::test]
async fn a_lost_move_command_is_repeated() {
    arrives_in_spite_of("move abs", LineFault::LoseCommand, 1).await;
    arrives_in_spite_of("move abs", LineFault::GarbleCommand, 1).await;
}

#[tokio::test]
async fn a_command_that_never_arrives_is_an_error() {
    let rig = Rig::new();
    let stage = rig.homed().await;
    // The axis has a reference and is at rest without a flag, as after homing.
    rig.faults.on(" home", LineFault::LoseCommand, 1000);
    let error = stage.home(ThetaC).await.unwrap_err();
    assert!(
        matches!(error, StageError::NotCarriedOut { .. }),
        "{error:?}"
    );
    rig.faults.on(" move abs", LineFault::LoseCommand, 1000);
    let error = stage
        .move_to(ThetaC, Angle::from_deg(20.0))
        .await
        .unwrap_err();
    assert!(
        matches!(error, StageError::NotCarriedOut { .. }),
        "{error:?}"
    );
    let words = error.to_string();
    assert!(
        words.contains("answers questions") && words.contains("3 attempts"),
        "{words}"
    );
}

#[tokio::test]
async fn lost_and_garbled_polls_are_repeated() {
    arrives_in_spite_of("get pos", LineFault::LoseReply, 2).await;
    arrives_in_spite_of("get pos", LineFault::GarbleReply, 3).await;
    arrives_in_spite_of("get pos", LineFault::DropByte, 3).await;
}

#[tokio::test]
async fn a_late_reply_is_not_taken_for_the_next_one() {
    arrives_in_spite_of("get pos", LineFault::LateReply, 2).await;
    arrives_in_spite_of("move abs", LineFault::LateReply, 1).await;
}

#[tokio::test]
async fn duplicate_replies_have_no_effect() {
    arrives_in_spite_of("/", LineFault::DoubleReply, 1000).await;
}

#[tokio::test]
async fn a_spurious_idle_alert_is_not_an_arrival() {
    let alert = b"!01 1 IDLE --\r\n!02 1 IDLE --\r\n".to_vec();
    arrives_in_spite_of("/", LineFault::Before(alert), 1000).await;
}
