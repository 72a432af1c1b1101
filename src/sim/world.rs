//! The simulated bench: true positions of the two axes, the object on the table, and faults.
//!
//! [`World::new`] makes one; the controller drives its motors, and the camera reads
//! [`World::true_pose_now`]. Everything is a function of the injected clock. Knows no protocol: the
//! controller's assumptions (its counter, its flags) belong to the controller and differ from the
//! truth after a slip or a power cycle, as on a real bench.

use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use super::motion::{Ramps, Trajectory};
use crate::bench::AxisName;
use crate::clock::Clock;
use crate::geometry::Pose;
use crate::units::Angle;

/// The object in front of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OnTable {
    /// The sample.
    Sample,
    /// The white reference.
    WhiteReference,
}

/// How the sample and the camera are mounted: what to add to a recorded angle to get the true one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Mounting {
    /// Added to φs.
    pub azimuth_offset: Angle,
    /// Added to θc; the lamp moves with the camera.
    pub tilt_offset: Angle,
    /// Inclination of the sample's plane to the turntable; the white reference lies flat.
    pub wedge: Angle,
    /// Direction of that inclination, from the lean direction v; it turns with the sample.
    pub wedge_azimuth: Angle,
}

/// One axis: gear, travel and drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mechanics {
    /// Microsteps per turn of the output.
    pub counts_per_turn: f64,
    /// Output angle, counted from the home sensor, at which the recorded angle is zero.
    pub zero: Angle,
    /// Mechanical end of travel, as a recorded angle. The home sensor is there, at count 0.
    pub travel_min: Angle,
    /// The other end.
    pub travel_max: Angle,
    /// Play of the gear: approached from above, the output stops too high by this angle.
    pub backlash: Angle,
    /// Speed after power-up, degrees per second.
    pub speed_deg_s: f64,
    /// Both ramps after power-up, degrees per second squared.
    pub acceleration_deg_s2: f64,
}

impl Mechanics {
    /// Counts from the home sensor for a recorded angle.
    #[must_use]
    pub fn counts(&self, recorded: Angle) -> f64 {
        self.counts_in(recorded + self.zero)
    }

    /// Number of counts in an angle.
    #[must_use]
    pub fn counts_in(&self, angle: Angle) -> f64 {
        angle.deg() / 360.0 * self.counts_per_turn
    }

    /// The recorded angle at a count from the home sensor.
    #[must_use]
    pub fn recorded(&self, counts: f64) -> Angle {
        Angle::from_deg(counts / self.counts_per_turn * 360.0) - self.zero
    }
}

/// Settings of a world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WorldSettings {
    /// The tilt axis.
    pub theta_c: Mechanics,
    /// The rotation axis.
    pub phi_s: Mechanics,
    /// Mounting offsets.
    pub mounting: Mounting,
    /// Seed of all random numbers of this world.
    pub seed: u64,
}

impl Default for WorldSettings {
    fn default() -> Self {
        WorldSettings {
            // A 90:1 and a 120:1 worm on a 200 × 64 motor: 3200 counts per degree, and 128 000 in
            // 30°.
            theta_c: Mechanics {
                counts_per_turn: 1_152_000.0,
                zero: Angle::from_deg(65.0),
                travel_min: Angle::from_deg(-65.0),
                travel_max: Angle::from_deg(65.0),
                backlash: Angle::from_deg(0.01),
                speed_deg_s: 20.0,
                acceleration_deg_s2: 60.0,
            },
            phi_s: Mechanics {
                counts_per_turn: 1_536_000.0,
                zero: Angle::from_deg(30.0),
                travel_min: Angle::from_deg(-30.0),
                travel_max: Angle::from_deg(400.0),
                backlash: Angle::from_deg(0.01),
                speed_deg_s: 30.0,
                acceleration_deg_s2: 90.0,
            },
            mounting: Mounting::default(),
            seed: 1,
        }
    }
}

/// A fault of an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum AxisFault {
    /// The motor stalls.
    Stall,
    /// The axis hits a limit sensor inside its range.
    LimitSensor,
    /// Another program sends `stop`.
    ForeignStop,
    /// The manual knob is turned by this angle; a move in progress ends.
    Knob(Angle),
    /// Another program moves the axis by this angle and clears its flags; a move in progress ends.
    ForeignMove(Angle),
    /// The output slips by this angle; the controller does not detect it.
    Slip(Angle),
    /// The controller restarts: reference and counter are lost.
    PowerCycle,
    /// The controller restarts with the settings of the factory.
    FactoryReset,
    /// The controller is replaced by another one with this serial number, just powered up.
    Replaced(u32),
    /// The emergency-stop button switches the driver off.
    EmergencyStop,
}

/// State of an axis's motor at one moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotorNow {
    /// Counts from the home sensor.
    pub position: f64,
    /// Counts per second.
    pub velocity: f64,
    /// Whether a move is running.
    pub moving: bool,
}

#[derive(Debug, Clone, Copy)]
struct ArmedFault {
    set: Duration,
    at: Angle,
    fault: AxisFault,
}

#[derive(Debug)]
struct Axis {
    mechanics: Mechanics,
    began: Duration,
    trajectory: Trajectory,
    gap_at_start: f64,
    powered: bool,
    armed: Option<ArmedFault>,
    happened: Vec<(Duration, AxisFault)>,
}

#[derive(Debug)]
struct Bench {
    axes: [Axis; 2],
    on_table: OnTable,
    lens_capped: bool,
}

/// The simulated bench that controller and camera share.
pub struct World {
    clock: Arc<dyn Clock>,
    settings: WorldSettings,
    bench: Mutex<Bench>,
}

impl std::fmt::Debug for World {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("World")
            .field("settings", &self.settings)
            .field("pose", &self.pose_now())
            .finish_non_exhaustive()
    }
}

impl World {
    /// Makes a bench with the sample on the table, the lens open, and both axes at recorded zero,
    /// not homed.
    #[must_use]
    pub fn new(clock: Arc<dyn Clock>, settings: WorldSettings) -> Self {
        let began = clock.now();
        let axis = |mechanics: Mechanics| Axis {
            mechanics,
            began,
            trajectory: Trajectory::rest(mechanics.counts(Angle::ZERO).round()),
            gap_at_start: 0.0,
            powered: true,
            armed: None,
            happened: Vec::new(),
        };
        World {
            clock,
            settings,
            bench: Mutex::new(Bench {
                axes: [axis(settings.theta_c), axis(settings.phi_s)],
                on_table: OnTable::Sample,
                lens_capped: false,
            }),
        }
    }

    /// True positions of the two stages, as their own angles: what a perfect encoder on the output
    /// would record.
    #[must_use]
    pub fn pose_now(&self) -> Pose {
        let (now, bench) = self.bench();
        Pose {
            theta_c: bench.axes[0].output(now),
            phi_s: bench.axes[1].output(now),
        }
    }

    /// True pose of camera and sample, mounting offsets included.
    #[must_use]
    pub fn true_pose_now(&self) -> Pose {
        let pose = self.pose_now();
        Pose {
            theta_c: pose.theta_c + self.settings.mounting.tilt_offset,
            phi_s: pose.phi_s + self.settings.mounting.azimuth_offset,
        }
    }

    /// Whether any axis moves.
    #[must_use]
    pub fn is_moving(&self) -> bool {
        let (now, bench) = self.bench();
        bench.axes.iter().any(|a| a.motor(now).moving)
    }

    /// The object on the table.
    #[must_use]
    pub fn on_table(&self) -> OnTable {
        self.bench().1.on_table
    }

    /// Places an object on the table.
    pub fn place(&self, what: OnTable) {
        self.bench().1.on_table = what;
    }

    /// Whether the lens is capped.
    #[must_use]
    pub fn lens_capped(&self) -> bool {
        self.bench().1.lens_capped
    }

    /// Puts the lens cap on or takes it off.
    pub fn cap_lens(&self, capped: bool) {
        self.bench().1.lens_capped = capped;
    }

    /// Sets both axes to a pose, at rest and without play; no controller detects it.
    pub fn set_pose(&self, pose: Pose) {
        let (now, mut bench) = self.bench();
        for (axis, angle) in bench.axes.iter_mut().zip([pose.theta_c, pose.phi_s]) {
            let counts = axis.mechanics.counts(angle);
            axis.begin(now, Trajectory::rest(counts));
            axis.gap_at_start = 0.0;
        }
    }

    /// The seed of this world.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.settings.seed
    }

    /// The mounting of sample and camera.
    #[must_use]
    pub fn mounting(&self) -> Mounting {
        self.settings.mounting
    }

    /// Gear, travel and drive of an axis.
    #[must_use]
    pub fn mechanics(&self, axis: AxisName) -> Mechanics {
        match axis {
            AxisName::ThetaC => self.settings.theta_c,
            AxisName::PhiS => self.settings.phi_s,
        }
    }

    /// The world's time.
    #[must_use]
    pub fn now(&self) -> Duration {
        self.clock.now()
    }

    /// Position and speed of an axis's motor.
    #[must_use]
    pub fn motor(&self, axis: AxisName) -> MotorNow {
        let (now, bench) = self.bench();
        bench.axes[index(axis)].motor(now)
    }

    /// Drives a motor from its present state towards `target` (counts from the home sensor).
    pub fn drive_to(&self, axis: AxisName, target: f64, ramps: Ramps) {
        let (now, mut bench) = self.bench();
        let axis = &mut bench.axes[index(axis)];
        let motor = axis.motor(now);
        axis.begin(
            now,
            Trajectory::to(motor.position, motor.velocity, target, ramps),
        );
    }

    /// Stops a motor with a ramp (counts/s²), or at once if `deceleration` is `None`.
    pub fn brake(&self, axis: AxisName, deceleration: Option<f64>) {
        let (now, mut bench) = self.bench();
        bench.axes[index(axis)].brake(now, deceleration);
    }

    /// Whether the controller of this axis has power.
    #[must_use]
    pub fn powered(&self, axis: AxisName) -> bool {
        self.bench().1.axes[index(axis)].powered
    }

    /// Cuts or restores the power of one controller. Cutting stops its motor; restoring restarts
    /// the controller.
    pub fn set_powered(&self, axis: AxisName, powered: bool) {
        let (now, mut bench) = self.bench();
        let axis = &mut bench.axes[index(axis)];
        if axis.powered && !powered {
            axis.brake(now, None);
        } else if !axis.powered && powered {
            axis.happened.push((now, AxisFault::PowerCycle));
        }
        axis.powered = powered;
    }

    /// Causes a fault now.
    pub fn cause(&self, axis: AxisName, fault: AxisFault) {
        let (now, mut bench) = self.bench();
        bench.axes[index(axis)].apply_fault(now, fault);
    }

    /// Causes a fault once, when the axis next passes the recorded angle `at`.
    pub fn arm(&self, axis: AxisName, at: Angle, fault: AxisFault) {
        let (set, mut bench) = self.bench();
        bench.axes[index(axis)].armed = Some(ArmedFault { set, at, fault });
    }

    /// Returns the faults since the last call with their times, for the axis's controller.
    pub fn take_faults(&self, axis: AxisName) -> Vec<(Duration, AxisFault)> {
        let (_, mut bench) = self.bench();
        std::mem::take(&mut bench.axes[index(axis)].happened)
    }

    /// The bench, advanced to the present time.
    fn bench(&self) -> (Duration, MutexGuard<'_, Bench>) {
        let now = self.clock.now();
        let mut bench = self.bench.lock().expect("no holder of this lock panics");
        for axis in &mut bench.axes {
            axis.trigger_armed_fault(now);
        }
        (now, bench)
    }
}

fn index(axis: AxisName) -> usize {
    match axis {
        AxisName::ThetaC => 0,
        AxisName::PhiS => 1,
    }
}

impl Axis {
    fn since_start_s(&self, now: Duration) -> f64 {
        now.saturating_sub(self.began).as_secs_f64()
    }

    fn motor(&self, now: Duration) -> MotorNow {
        let t = self.since_start_s(now);
        let (position, velocity) = self.trajectory.at(t);
        MotorNow {
            position,
            velocity,
            moving: t < self.trajectory.duration_s(),
        }
    }

    fn gap(&self, now: Duration) -> f64 {
        let play = self.mechanics.counts_in(self.mechanics.backlash);
        self.trajectory
            .gap(self.gap_at_start, play, self.since_start_s(now))
    }

    fn output(&self, now: Duration) -> Angle {
        self.mechanics
            .recorded(self.motor(now).position + self.gap(now))
    }

    fn begin(&mut self, now: Duration, trajectory: Trajectory) {
        self.gap_at_start = self.gap(now);
        self.began = now;
        self.trajectory = trajectory;
    }

    fn brake(&mut self, now: Duration, deceleration: Option<f64>) {
        let motor = self.motor(now);
        let trajectory = match deceleration {
            Some(rate) => Trajectory::brake(motor.position, motor.velocity, rate),
            None => Trajectory::rest(motor.position.round()),
        };
        self.begin(now, trajectory);
    }

    /// Causes the armed fault if the motor has passed its position.
    fn trigger_armed_fault(&mut self, now: Duration) {
        let Some(armed) = self.armed else {
            return;
        };
        let Some(t) = self.trajectory.time_at(self.mechanics.counts(armed.at)) else {
            return;
        };
        let moment = self.began + Duration::from_secs_f64(t);
        // Positions that the present trajectory passed before the fault was armed do not count.
        if (armed.set..=now).contains(&moment) {
            self.armed = None;
            self.apply_fault(moment, armed.fault);
        }
    }

    fn apply_fault(&mut self, now: Duration, fault: AxisFault) {
        let ramp = self
            .mechanics
            .counts_in(Angle::from_deg(self.mechanics.acceleration_deg_s2));
        match fault {
            AxisFault::Stall
            | AxisFault::LimitSensor
            | AxisFault::PowerCycle
            | AxisFault::FactoryReset
            | AxisFault::Replaced(_)
            | AxisFault::EmergencyStop => {
                self.brake(now, None);
            }
            AxisFault::ForeignStop => self.brake(now, Some(ramp)),
            AxisFault::Knob(by) | AxisFault::ForeignMove(by) | AxisFault::Slip(by) => {
                let to = (self.motor(now).position + self.mechanics.counts_in(by)).round();
                self.begin(now, Trajectory::rest(to));
            }
        }
        self.happened.push((now, fault));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::SteppedClock;

    fn world() -> (Arc<SteppedClock>, World) {
        let clock = Arc::new(SteppedClock::new());
        (clock.clone(), World::new(clock, WorldSettings::default()))
    }

    fn ramps(mechanics: Mechanics) -> Ramps {
        let acceleration = mechanics.counts_in(Angle::from_deg(mechanics.acceleration_deg_s2));
        Ramps {
            speed: mechanics.counts_in(Angle::from_deg(mechanics.speed_deg_s)),
            acceleration,
            deceleration: acceleration,
        }
    }

    #[test]
    fn an_axis_moves_only_with_the_clock() {
        let (clock, world) = world();
        let mechanics = world.mechanics(AxisName::ThetaC);
        world.drive_to(
            AxisName::ThetaC,
            mechanics.counts(Angle::from_deg(20.0)),
            ramps(mechanics),
        );
        assert!(world.is_moving());
        assert_eq!(world.pose_now().theta_c.deg(), 0.0);
        // Trapezoid: v/a + d/v = 1/3 + 1 s; the middle of the way at half of it.
        clock.advance(Duration::from_secs_f64(2.0 / 3.0));
        assert!((world.pose_now().theta_c.deg() - 10.0).abs() < 1e-6);
        clock.advance(Duration::from_secs_f64(2.0 / 3.0 + 1e-6));
        assert!(!world.is_moving());
        assert!((world.pose_now().theta_c.deg() - 20.0).abs() < 1e-9);
    }

    #[test]
    fn the_true_pose_includes_the_mounting() {
        let clock = Arc::new(SteppedClock::new());
        let mounting = Mounting {
            azimuth_offset: Angle::from_deg(7.0),
            tilt_offset: Angle::from_deg(0.4),
            ..Mounting::default()
        };
        let world = World::new(
            clock,
            WorldSettings {
                mounting,
                ..WorldSettings::default()
            },
        );
        world.set_pose(Pose::from_deg(-20.0, 90.0));
        let (recorded, truth) = (world.pose_now(), world.true_pose_now());
        assert!(
            (truth.theta_c - recorded.theta_c - mounting.tilt_offset)
                .abs()
                .deg()
                < 1e-12
        );
        assert!((truth.phi_s.deg() - 97.0).abs() < 1e-9);
    }

    #[test]
    fn a_position_reached_from_above_is_off_by_the_play() {
        let (clock, world) = world();
        let mechanics = world.mechanics(AxisName::PhiS);
        world.set_pose(Pose::from_deg(0.0, 50.0));
        for (target_deg, expected_deg) in [(40.0, 40.01), (39.0, 39.01), (60.0, 60.0)] {
            let target = mechanics.counts(Angle::from_deg(target_deg));
            world.drive_to(AxisName::PhiS, target, ramps(mechanics));
            clock.advance(Duration::from_secs(9));
            assert!((world.pose_now().phi_s.deg() - expected_deg).abs() < 1e-9);
        }
    }

    #[test]
    fn an_armed_stall_stops_the_axis_at_its_position() {
        let (clock, world) = world();
        let mechanics = world.mechanics(AxisName::ThetaC);
        world.arm(AxisName::ThetaC, Angle::from_deg(5.0), AxisFault::Stall);
        let target = mechanics.counts(Angle::from_deg(20.0));
        world.drive_to(AxisName::ThetaC, target, ramps(mechanics));
        clock.advance(Duration::from_secs(9));
        assert!((world.pose_now().theta_c.deg() - 5.0).abs() < 1e-3);
        let faults = world.take_faults(AxisName::ThetaC);
        assert!(matches!(faults[..], [(_, AxisFault::Stall)]), "{faults:?}");
        world.drive_to(AxisName::ThetaC, target, ramps(mechanics));
        clock.advance(Duration::from_secs(9));
        assert!(
            (world.pose_now().theta_c.deg() - 20.0).abs() < 1e-9,
            "it happens once"
        );
    }
}
