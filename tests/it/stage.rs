//! The stage over a real pseudo-terminal with the simulated controller: the normal course, and below it its faults by kind. Time
//! stands still until a task waits, so no test sleeps.

use std::io::Write;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use futures::future::BoxFuture;
use ridged::bench::AxisName::{PhiS, ThetaC};
use ridged::bench::port::PortAddress;
use ridged::bench::stage::{Stage, StageError, StageLink, StageSettings};
use ridged::clock::{Clock, SteppedClock};
use ridged::geometry::Pose;
use ridged::sim::controller::Controller;
use ridged::sim::faults::{LineFault, ScriptedFaults};
use ridged::sim::server::{PtyServer, serve_pty};
use ridged::sim::world::{World, WorldSettings};
use ridged::units::Angle;
use tokio::sync::Notify;

mod axis_faults;
mod cut_moves;
mod line_faults;
mod one_controller;

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
