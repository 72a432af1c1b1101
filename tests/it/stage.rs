//! The stage over a real pseudo-terminal with the simulated controller: the normal course, then
//! once per fault. Time stands still until a task waits, so no test sleeps.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use futures::future::BoxFuture;
use ridged::bench::AxisName::{PhiS, ThetaC};
use ridged::bench::port::PortAddress;
use ridged::bench::stage::{Stage, StageError, StageLink, StageSettings};
use ridged::bench::wire::zaber::Activity;
use ridged::bench::wire::zaber_flags::Flag;
use ridged::clock::{Clock, SteppedClock};
use ridged::geometry::Pose;
use ridged::sim::controller::Controller;
use ridged::sim::faults::{LineFault, ScriptedFaults};
use ridged::sim::server::{PtyServer, serve_pty};
use ridged::sim::world::{AxisFault, World, WorldSettings};
use ridged::units::Angle;
use tokio::sync::Notify;

/// A stepped clock that can be held: sleepers then wait until it is released.
#[derive(Default)]
struct HeldClock {
    inner: SteppedClock,
    held: AtomicBool,
    somebody_sleeps: Notify,
    let_go: Notify,
}

impl HeldClock {
    fn hold(&self) {
        self.held.store(true, Ordering::SeqCst);
    }

    fn let_go(&self) {
        self.held.store(false, Ordering::SeqCst);
        self.let_go.notify_waiters();
    }
}

impl Clock for HeldClock {
    fn now(&self) -> Duration {
        self.inner.now()
    }

    fn utc(&self) -> time::OffsetDateTime {
        self.inner.utc()
    }

    fn sleep(&self, duration: Duration) -> BoxFuture<'_, ()> {
        Box::pin(async move {
            while self.held.load(Ordering::SeqCst) {
                let let_go = self.let_go.notified();
                self.somebody_sleeps.notify_one();
                let_go.await;
            }
            self.inner.sleep(duration).await;
        })
    }
}

pub(crate) struct Rig {
    clock: Arc<HeldClock>,
    pub(crate) world: Arc<World>,
    pub(crate) server: PtyServer,
    pub(crate) faults: ScriptedFaults,
}

impl Rig {
    pub(crate) fn new() -> Self {
        Rig::with(Controller::new)
    }

    fn with(controller: fn(&Arc<World>) -> Controller) -> Self {
        let clock = Arc::new(HeldClock::default());
        let world = Arc::new(World::new(clock.clone(), WorldSettings::default()));
        Rig {
            server: serve_pty(controller(&world)).unwrap(),
            clock,
            world,
            faults: ScriptedFaults::new(),
        }
    }

    pub(crate) fn address(&self) -> PortAddress {
        PortAddress::Serial {
            path: self.server.path().to_owned(),
        }
    }

    async fn connect_with(&self, settings: StageSettings) -> Result<Stage, StageError> {
        let seam = Arc::new(self.faults.clone());
        Stage::connect(self.address(), settings, self.clock.clone(), seam).await
    }

    /// A link with these settings, and what the stage reports beside its errors.
    pub(crate) fn link(&self, settings: StageSettings) -> StageLink {
        StageLink {
            port: self.address(),
            settings,
            clock: self.clock.clone(),
            seam: Arc::new(self.faults.clone()),
        }
    }

    async fn connect(&self) -> Stage {
        self.connect_with(settings()).await.unwrap()
    }

    pub(crate) async fn homed(&self) -> Stage {
        let stage = self.connect().await;
        stage.home_all().await.unwrap();
        stage
    }

    /// Another program sends a command on the same line; the replies reach this program as noise.
    pub(crate) fn foreign(&self, command: &str) {
        let mut line = std::fs::OpenOptions::new()
            .write(true)
            .open(self.server.path())
            .unwrap();
        line.write_all(format!("{command}\n").as_bytes()).unwrap();
    }
}

/// A short time-out, so that a lost reply costs little, and many attempts, so that a loaded machine
/// does not count as a silent device.
pub(crate) fn settings() -> StageSettings {
    StageSettings {
        reply_timeout_ms: 50,
        attempts: 5,
        ..StageSettings::simulated()
    }
}

pub(crate) fn assert_at(pose: Pose, theta_c_deg: f64, phi_s_deg: f64) {
    // One microstep of the coarser axis is 0.0003°.
    assert!(
        (pose.theta_c.deg() - theta_c_deg).abs() < 5e-4,
        "theta_c {}",
        pose.theta_c
    );
    assert!(
        (pose.phi_s.deg() - phi_s_deg).abs() < 5e-4,
        "phi_s {}",
        pose.phi_s
    );
}

#[tokio::test]
async fn a_stage_homes_moves_and_reads_back_where_it_is() {
    let rig = Rig::new();
    let stage = rig.connect().await;
    assert_eq!(stage.identity().phi_s.serial, 90_002);
    let status = stage.status().await.unwrap();
    assert!(!status.all_homed() && !status.theta_c.moving);
    assert!(
        status.theta_c.warnings[0].starts_with("WR: no reference"),
        "{status:?}"
    );

    stage.home_all().await.unwrap();
    let status = stage.status().await.unwrap();
    assert!(status.all_homed() && status.phi_s.warnings.is_empty());
    assert_at(status.pose(), -65.0, -30.0);

    for (theta_c_deg, phi_s_deg) in [(-20.0, 0.0), (0.0, 90.0), (20.0, 180.0), (-10.0, 30.0)] {
        let target = Pose::from_deg(theta_c_deg, phi_s_deg);
        assert_at(
            stage.move_pose(target).await.unwrap(),
            theta_c_deg,
            phi_s_deg,
        );
        assert!(!rig.world.is_moving());
        // The play of the gear is taken up: the counter shows the true position.
        assert_at(rig.world.pose_now(), theta_c_deg, phi_s_deg);
    }
    let angle = stage.move_to(PhiS, Angle::from_deg(12.0)).await.unwrap();
    assert!((angle.deg() - 12.0).abs() < 5e-4);
}

#[tokio::test]
async fn without_the_approach_from_below_the_position_is_off_by_the_play() {
    let rig = Rig::new();
    let mut settings = settings();
    settings.phi_s.backlash = Angle::ZERO;
    let stage = rig.connect_with(settings).await.unwrap();
    stage.home_all().await.unwrap();
    stage.move_pose(Pose::from_deg(0.0, 90.0)).await.unwrap();
    let read = stage.move_pose(Pose::from_deg(0.0, 60.0)).await.unwrap();
    assert_at(read, 0.0, 60.0);
    // The world's gear has 0.01° of play.
    assert_at(rig.world.pose_now(), 0.0, 60.01);
}

#[tokio::test]
async fn limits_and_a_missing_reference_refuse_before_anything_moves() {
    let rig = Rig::new();
    let stage = rig.connect().await;
    let before = stage.move_pose(Pose::from_deg(0.0, 0.0)).await;
    assert!(
        matches!(before, Err(StageError::NotReferenced { .. })),
        "{before:?}"
    );
    stage.home_all().await.unwrap();
    for pose in [Pose::from_deg(61.0, 0.0), Pose::from_deg(0.0, 391.0)] {
        let outside = stage.move_pose(pose).await;
        assert!(
            matches!(outside, Err(StageError::OutsideLimits { .. })),
            "{outside:?}"
        );
    }
    let nan = stage.move_to(ThetaC, Angle::from_deg(f64::NAN)).await;
    assert!(matches!(nan, Err(StageError::NotANumber { .. })));
    assert!(!rig.world.is_moving());
    assert_at(rig.world.pose_now(), -64.99, -29.99);
}

#[tokio::test]
async fn settings_are_applied_and_read_back() {
    let rig = Rig::new();
    let mut settings = settings();
    settings.theta_c.max_speed_deg_s = Some(5.0);
    settings.theta_c.acceleration_deg_s2 = Some(100.0);
    let stage = rig.connect_with(settings.clone()).await.unwrap();
    let way = stage.predicted_move(Pose::from_deg(0.0, 0.0), Pose::from_deg(10.0, 0.0));
    // 10/5 + 5/100 s and 0.1 s to settle; the device's ramp is an integer, 52 for 52.4.
    assert!((way.as_secs_f64() - 2.15).abs() < 2e-3, "{way:?}");

    drop(stage);
    settings.theta_c.max_speed_deg_s = Some(500.0);
    let refused = Rig::new().connect_with(settings).await.err();
    assert!(
        matches!(refused, Some(StageError::Refused { .. })),
        "{refused:?}"
    );
}

#[tokio::test]
async fn the_wrong_device_is_refused() {
    let rig = Rig::new();
    let mut swapped = settings();
    (swapped.theta_c.serial, swapped.phi_s.serial) = (Some(90_002), Some(90_001));
    let error = rig.connect_with(swapped).await.err().unwrap();
    assert!(matches!(
        error,
        StageError::WrongDevice {
            axis: ThetaC,
            found: 90_001,
            ..
        }
    ));
    assert!(
        error.to_string().contains("cables may be swapped"),
        "{error}"
    );

    let mut scaled = settings();
    scaled.phi_s.counts_per_turn = Some(1_000_000.0);
    let error = Rig::new().connect_with(scaled).await.err().unwrap();
    assert!(
        matches!(error, StageError::Disagreement { axis: PhiS, .. }),
        "{error}"
    );

    let mut beyond = settings();
    beyond.phi_s.limit_max = Angle::from_deg(500.0);
    let error = Rig::new().connect_with(beyond).await.err().unwrap();
    assert!(
        matches!(error, StageError::BeyondTravel { axis: PhiS, .. }),
        "{error}"
    );
    assert!(error.to_string().contains("zero_deg"), "{error}");
}

#[tokio::test]
async fn a_silent_device_and_a_missing_port_give_different_errors() {
    let rig = Rig::new();
    rig.world.set_powered(PhiS, false);
    let error = rig.connect_with(settings()).await.err().unwrap();
    assert!(matches!(error, StageError::NoReply(_)), "{error}");
    assert!(error.to_string().contains("address 2"), "{error}");
    assert!(
        error
            .to_string()
            .contains("check cable and power, baud rate"),
        "{error}"
    );

    let address = "/dev/there-is-no-such-port".parse().unwrap();
    let seam = Arc::new(ScriptedFaults::new());
    let error = Stage::connect(address, settings(), rig.clock.clone(), seam)
        .await
        .err()
        .unwrap();
    assert!(error.to_string().contains("does not exist"), "{error}");
}

#[tokio::test]
async fn a_second_stage_on_the_port_is_refused() {
    let rig = Rig::new();
    let _first = rig.connect().await;
    let error = rig.connect_with(settings()).await.err().unwrap();
    assert!(
        error.to_string().contains("in use by another program"),
        "{error}"
    );
}

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
async fn an_infinite_limit_or_speed_is_refused() {
    for (asked, word) in [
        ("get limit.max", "inf"),
        ("get limit.min", "-inf"),
        ("get maxspeed", "NaN"),
        ("get limit.cycle.dist", "inf"),
    ] {
        let rig = Rig::new();
        rig.faults.on(asked, LineFault::Says(word.into()), 1);
        // The settings may state the microsteps of a device that does not report them.
        let error = rig.connect_with(settings()).await.err().unwrap();
        let unreadable = matches!(&error, StageError::Unreadable { answer, .. } if answer == word);
        let no_scale = matches!(&error, StageError::NoScale { .. });
        assert!(
            unreadable && asked != "get limit.cycle.dist" || no_scale,
            "{asked}: {error:?}"
        );
    }
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

/// A camera for rigs that take no frames.
pub(crate) fn no_camera() -> Box<dyn ridged::bench::Camera> {
    struct NoCamera;
    impl ridged::bench::Camera for NoCamera {
        fn describe(&self) -> String {
            "no camera".into()
        }

        fn capture<'a>(
            &'a mut self,
            _: &'a ridged::bench::CaptureRequest,
        ) -> BoxFuture<'a, Result<ridged::bench::Captured, ridged::bench::CameraError>> {
            Box::pin(async { Err(ridged::bench::CameraError::Failed("there is none".into())) })
        }
    }
    Box::new(NoCamera)
}
