//! Both axes on one controller.

use ridged::bench::AxisName::{PhiS, ThetaC};
use ridged::bench::stage::{StageError, StageSettings};
use ridged::geometry::Pose;
use ridged::sim::controller::Controller;
use ridged::sim::world::AxisFault;
use ridged::units::Angle;

use super::{Rig, assert_at, settings};

/// Both stages on one controller, in the settings.
fn on_one_controller() -> StageSettings {
    let mut settings = settings();
    let tilt = &settings.theta_c;
    (settings.phi_s.address, settings.phi_s.serial) = (tilt.address, tilt.serial);
    settings.phi_s.axis = 2;
    settings
}

#[tokio::test]
async fn two_axes_of_one_controller_move_stop_and_fail_each_on_its_own() {
    let rig = Rig::with(Controller::with_both_axes);
    let stage = rig.connect_with(on_one_controller()).await.unwrap();
    assert_eq!(stage.identity().theta_c, stage.identity().phi_s);
    stage.home(ThetaC).await.unwrap();
    // The other axis has not been homed by that.
    let status = stage.status().await.unwrap();
    assert!(status.theta_c.homed && !status.phi_s.homed);
    stage.home(PhiS).await.unwrap();
    let pose = stage.move_pose(Pose::from_deg(20.0, 300.0)).await.unwrap();
    assert_at(pose, 20.0, 300.0);
    assert_at(rig.world.pose_now(), 20.0, 300.0);

    // A fault of one axis is reported for that axis, and the other one continues.
    rig.world
        .arm(PhiS, Angle::from_deg(200.0), AxisFault::Stall);
    let error = stage.move_to(PhiS, Angle::ZERO).await.unwrap_err();
    assert!(
        matches!(error, StageError::Stalled { axis: PhiS, .. }),
        "{error:?}"
    );
    stage.move_to(ThetaC, Angle::ZERO).await.unwrap();
    stage.home(PhiS).await.unwrap();

    // A stop reaches both axes and is answered once.
    rig.clock.hold();
    let moving = tokio::spawn({
        let stage = stage.clone();
        async move { stage.move_pose(Pose::from_deg(40.0, 300.0)).await }
    });
    rig.clock.somebody_sleeps.notified().await;
    let stopped = async {
        assert!(matches!(moving.await.unwrap(), Err(StageError::Stopped)));
        rig.clock.let_go();
    };
    let (outcome, ()) = tokio::join!(stage.stop(), stopped);
    outcome.unwrap();
    assert!(!rig.world.is_moving());

    // The controller has one power supply.
    rig.world.cause(ThetaC, AxisFault::PowerCycle);
    let status = stage.status().await.unwrap();
    assert!(!status.theta_c.homed && !status.phi_s.homed);
    let error = stage.move_to(PhiS, Angle::ZERO).await.unwrap_err();
    assert!(
        matches!(error, StageError::PowerCycled { axis: PhiS }),
        "{error:?}"
    );
}

#[tokio::test]
async fn an_axis_that_the_controller_does_not_have_is_named() {
    let rig = Rig::with(Controller::with_both_axes);
    let mut settings = on_one_controller();
    settings.phi_s.axis = 3;
    let error = rig.connect_with(settings).await.err().unwrap();
    let words = error.to_string();
    assert!(
        words.contains("no axis 3") && words.contains("[stage.phi_s]"),
        "{words}"
    );
}
