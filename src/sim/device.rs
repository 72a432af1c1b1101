//! One axis of a simulated Zaber controller: commands, motion, reference, warning flags and stored
//! settings.
//!
//! [`Device::execute`] runs one command, [`Device::get`] reads a setting. This module holds what
//! the controller assumes (counter, flags, settings); the [`World`] holds the true motion. Knows no
//! bytes and no other axes; `unit` combines the axes of one controller.

pub mod settings;

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;

use self::settings::DeviceSettings;
use super::motion::Ramps;
use super::world::{AxisFault, World};
use crate::bench::AxisName;
use crate::bench::wire::zaber::Activity;
use crate::bench::wire::zaber_flags::Flag;

/// Speed settings are microsteps per second times this.
pub(super) const SPEED_UNIT: f64 = 1.6384;
/// Acceleration settings are microsteps per second squared times this.
pub(super) const ACCELERATION_UNIT: f64 = 1.6384 / 10_000.0;

/// Why a command is refused; also the code that the device replies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reject {
    /// No such axis.
    BadAxis,
    /// No such command or setting, or a read-only one.
    BadCommand,
    /// A value that is malformed, out of range or beyond the travel.
    BadData,
    /// The packets of a long command do not fit together.
    BadSplit,
    /// The command addresses the device, not an axis.
    DeviceOnly,
    /// The driver is off.
    DriverDisabled,
    /// A word longer than `comm.word.size.max`.
    LongWord,
    /// The axis is parked.
    Parked,
    /// Not possible while the axis moves.
    StatusBusy,
}

impl Reject {
    /// The code in the protocol.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Reject::BadAxis => "BADAXIS",
            Reject::BadCommand => "BADCOMMAND",
            Reject::BadData => "BADDATA",
            Reject::BadSplit => "BADSPLIT",
            Reject::DeviceOnly => "DEVICEONLY",
            Reject::DriverDisabled => "DRIVERDISABLED",
            Reject::LongWord => "LONGWORD",
            Reject::Parked => "PARKED",
            Reject::StatusBusy => "STATUSBUSY",
        }
    }
}

/// What a command addresses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Scope {
    /// The controller, with all its axes.
    Device,
    /// One axis.
    Axis,
}

/// Result of a command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CommandResult {
    /// Data of the reply, or the reason of a refusal.
    pub data: Result<String, Reject>,
    /// Texts that follow as info messages.
    pub infos: Vec<&'static str>,
}

impl From<Result<String, Reject>> for CommandResult {
    fn from(data: Result<String, Reject>) -> Self {
        CommandResult {
            data,
            infos: Vec::new(),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Motion {
    None,
    Move,
    /// Moves until it stalls: the target is beyond the mechanical end.
    IntoTheEnd,
    Home,
}

/// One axis with its controller's stored state.
#[derive(Debug)]
pub struct Device {
    pub(super) world: Arc<World>,
    pub(super) axis: AxisName,
    pub(super) settings: DeviceSettings,
    pub(super) parked: bool,
    /// The counter shows the motor position plus this.
    pub(super) counter_offset: f64,
    flags: BTreeSet<Flag>,
    motion: Motion,
    pub(super) booted: Duration,
}

impl Device {
    /// Makes a controller that was just powered up: its counter is 0 at any axis position.
    #[must_use]
    pub fn new(world: Arc<World>, axis: AxisName) -> Self {
        let settings = DeviceSettings::factory(axis, &world.mechanics(axis));
        let mut device = Device {
            settings,
            parked: false,
            counter_offset: 0.0,
            flags: BTreeSet::new(),
            motion: Motion::None,
            booted: Duration::ZERO,
            world,
            axis,
        };
        let now = device.world.now();
        device.boot(now);
        device
    }

    /// Whether it has power; without power it neither receives nor sends.
    #[must_use]
    pub fn powered(&self) -> bool {
        self.world.powered(self.axis)
    }

    /// Whether the axis moves.
    #[must_use]
    pub fn activity(&self) -> Activity {
        if self.motion == Motion::None {
            Activity::Idle
        } else {
            Activity::Busy
        }
    }

    /// All raised flags, the highest first.
    #[must_use]
    pub fn flags(&self) -> &BTreeSet<Flag> {
        &self.flags
    }

    /// Applies what happened since the last call. Returns true if a motion has ended.
    pub fn refresh(&mut self) -> bool {
        let was_moving = self.motion != Motion::None;
        for (moment, fault) in self.world.take_faults(self.axis) {
            self.apply_fault(moment, fault);
        }
        if self.motion != Motion::None && !self.world.motor(self.axis).moving {
            match self.motion {
                Motion::Home => {
                    self.counter_offset = 0.0;
                    self.flags.remove(&Flag::NoReference);
                    self.flags.remove(&Flag::NotHomed);
                }
                Motion::IntoTheEnd => {
                    self.flags.insert(Flag::Stalled);
                }
                Motion::Move | Motion::None => {}
            }
            self.motion = Motion::None;
        }
        was_moving && self.motion == Motion::None
    }

    fn apply_fault(&mut self, moment: Duration, fault: AxisFault) {
        match fault {
            AxisFault::Stall => {
                self.flags.insert(Flag::Stalled);
                self.motion = Motion::None;
            }
            AxisFault::LimitSensor => {
                self.flags.insert(Flag::UnexpectedLimit);
                self.motion = Motion::None;
            }
            AxisFault::ForeignStop => {
                if self.motion != Motion::None {
                    self.flags.insert(Flag::MovementInterrupted);
                    self.motion = Motion::Move;
                }
            }
            AxisFault::Knob(_) => {
                self.flags.insert(Flag::ManualControl);
                self.motion = Motion::None;
            }
            AxisFault::ForeignMove(_) => self.motion = Motion::None,
            AxisFault::Slip(by) => {
                self.counter_offset -= self.world.mechanics(self.axis).counts_in(by).round();
            }
            AxisFault::PowerCycle => self.boot(moment),
            AxisFault::FactoryReset => {
                self.reset_settings();
                self.boot(moment);
            }
            AxisFault::Replaced(serial) => {
                self.reset_settings();
                self.settings.serial = serial;
                self.boot(moment);
            }
            AxisFault::EmergencyStop => {
                self.flags.insert(Flag::EmergencyStop);
                self.settings.driver_enabled = false;
                self.motion = Motion::None;
            }
        }
    }

    /// Sets the settings of the factory; address and identity stay.
    fn reset_settings(&mut self) {
        let factory = DeviceSettings::factory(self.axis, &self.world.mechanics(self.axis));
        self.settings = DeviceSettings {
            address: self.settings.address,
            serial: self.settings.serial,
            device_id: self.settings.device_id,
            ..factory
        };
    }

    /// Restarts: the reference is lost and any motion stops.
    pub(super) fn boot(&mut self, moment: Duration) {
        self.booted = moment;
        self.counter_offset = -self.world.motor(self.axis).position.round();
        self.flags = BTreeSet::from([Flag::NoReference, Flag::NotHomed]);
        self.motion = Motion::None;
        self.settings.driver_enabled = true;
    }

    /// Milliseconds since power-up, on the world's clock.
    pub(super) fn uptime_ms(&self) -> u128 {
        self.world.now().saturating_sub(self.booted).as_millis()
    }

    /// The counter's value.
    pub(super) fn counter(&self) -> f64 {
        (self.world.motor(self.axis).position + self.counter_offset).round()
    }

    /// Sets the counter; the reference then counts as known although the axis was not homed.
    pub(super) fn set_counter(&mut self, counts: f64) {
        self.counter_offset = counts - self.world.motor(self.axis).position.round();
        self.flags.remove(&Flag::NoReference);
    }

    /// Runs one command other than a query, for the device or for its axis.
    pub fn execute(&mut self, scope: Scope, words: &[&str]) -> CommandResult {
        let done = || Ok("0".to_owned());
        match words {
            [] => done(),
            ["set", name, value] => self.set(scope, name, value).and_then(|()| done()),
            ["warnings", "clear"] => {
                self.flags.retain(|flag| !clears(*flag));
                done()
            }
            ["home"] => self.home().and_then(|()| done()),
            ["move", rest @ ..] => self.move_command(rest).and_then(|()| done()),
            ["stop"] => self.stop(true).and_then(|()| done()),
            ["estop"] => self.stop(false).and_then(|()| done()),
            ["driver", what @ ("enable" | "disable")] => {
                self.set_driver(*what == "enable");
                done()
            }
            ["tools", "parking", what @ ("park" | "unpark")] => {
                self.park(*what == "park").and_then(|()| done())
            }
            ["tools", "echo"] => done(),
            ["tools", "echo", text @ ..] => Ok(text.join(" ")),
            ["io", "info"] => Ok("0 0 0 0".to_owned()),
            ["activate"] => done(),
            ["system", "reset"] if scope == Scope::Device => {
                self.world.brake(self.axis, None);
                self.boot(self.world.now());
                done()
            }
            ["system", "reset"] => Err(Reject::DeviceOnly),
            ["help", ..] => {
                return CommandResult {
                    data: done(),
                    infos: HELP.to_vec(),
                };
            }
            _ => Err(Reject::BadCommand),
        }
        .into()
    }

    fn home(&mut self) -> Result<(), Reject> {
        let ramps = self.ramps(None, None)?;
        self.begin(0.0, ramps, Motion::Home)
    }

    fn move_command(&mut self, words: &[&str]) -> Result<(), Reject> {
        let number = |word: &str| word.parse::<i64>().map_err(|_| Reject::BadData);
        let (low, high) = (
            self.settings.limit_min as f64,
            self.settings.limit_max as f64,
        );
        let (kind, value, speed, acceleration) = match words {
            [kind] => (*kind, None, None, None),
            [kind @ ("min" | "max"), v] => (*kind, None, Some(number(v)?), None),
            [kind @ ("min" | "max"), v, a] => (*kind, None, Some(number(v)?), Some(number(a)?)),
            [kind, value] => (*kind, Some(number(value)?), None, None),
            ["vel", value, a] => ("vel", Some(number(value)?), None, Some(number(a)?)),
            [kind, value, v] => (*kind, Some(number(value)?), Some(number(v)?), None),
            [kind, value, v, a] => (
                *kind,
                Some(number(value)?),
                Some(number(v)?),
                Some(number(a)?),
            ),
            _ => return Err(Reject::BadCommand),
        };
        let referenced = !self.flags.contains(&Flag::NoReference);
        let target = match (kind, value) {
            ("min", None) if referenced => low,
            ("max", None) if referenced => high,
            ("min" | "max", None) => return Err(Reject::BadData),
            ("abs", Some(counts)) if referenced => counts as f64,
            ("abs", Some(_)) => return Err(Reject::BadData),
            ("rel", Some(counts)) => self.counter() + counts as f64,
            ("index", Some(n)) if referenced && n >= 1 => {
                (n - 1) as f64 * self.settings.index_dist as f64
            }
            ("index", Some(_)) => return Err(Reject::BadData),
            ("vel", Some(0)) => return self.stop(true),
            ("vel", Some(v)) => {
                let ramps = self.ramps(Some(v.saturating_abs()), acceleration)?;
                // Without a reference the limits are meaningless: move on to the mechanical end.
                let far = if referenced { 0.0 } else { 1e12 };
                let target = if v > 0 { high + far } else { low - far };
                return self.begin(target - self.counter_offset, ramps, Motion::Move);
            }
            _ => return Err(Reject::BadCommand),
        };
        if referenced && !(low..=high).contains(&target) {
            return Err(Reject::BadData);
        }
        let ramps = self.ramps(speed, acceleration)?;
        self.begin(target - self.counter_offset, ramps, Motion::Move)
    }

    fn ramps(&self, speed: Option<i64>, acceleration: Option<i64>) -> Result<Ramps, Reject> {
        let settings = &self.settings;
        let within = |value: i64, max: i64| {
            if (1..=max).contains(&value) {
                Ok(value as f64)
            } else {
                Err(Reject::BadData)
            }
        };
        let speed = within(speed.unwrap_or(settings.max_speed), settings.top_speed)?;
        let ramp = |own: i64| within(acceleration.unwrap_or(own), settings.top_acceleration);
        Ok(Ramps {
            speed: speed / SPEED_UNIT,
            acceleration: ramp(settings.accel_only)? / ACCELERATION_UNIT,
            deceleration: ramp(settings.decel_only)? / ACCELERATION_UNIT,
        })
    }

    /// Starts a motion to `target`, in counts from the home sensor.
    fn begin(&mut self, target: f64, ramps: Ramps, motion: Motion) -> Result<(), Reject> {
        if self.parked {
            return Err(Reject::Parked);
        }
        if !self.settings.driver_enabled {
            return Err(Reject::DriverDisabled);
        }
        if self.motion == Motion::None {
            self.flags.remove(&Flag::MovementInterrupted);
            self.flags.remove(&Flag::ManualControl);
            self.flags.remove(&Flag::Displaced);
        } else {
            self.flags.insert(Flag::MovementInterrupted);
        }
        let mechanics = self.world.mechanics(self.axis);
        let ends = (
            mechanics.counts(mechanics.travel_min),
            mechanics.counts(mechanics.travel_max),
        );
        let reachable = target.clamp(ends.0, ends.1);
        // Half a count of tolerance: limits are whole counts, mechanical ends are not.
        self.motion = if (reachable - target).abs() > 0.5 {
            Motion::IntoTheEnd
        } else {
            motion
        };
        self.world.drive_to(self.axis, reachable, ramps);
        Ok(())
    }

    fn stop(&mut self, with_ramp: bool) -> Result<(), Reject> {
        if self.motion != Motion::None {
            self.flags.insert(Flag::MovementInterrupted);
            self.motion = Motion::Move;
            let rate = self.settings.decel_only as f64 / ACCELERATION_UNIT;
            self.world.brake(self.axis, with_ramp.then_some(rate));
        }
        Ok(())
    }

    pub(super) fn set_driver(&mut self, enabled: bool) {
        self.settings.driver_enabled = enabled;
        if enabled {
            self.flags.remove(&Flag::DriverOff);
            self.flags.remove(&Flag::EmergencyStop);
        } else {
            self.world.brake(self.axis, None);
            self.flags.insert(Flag::DriverOff);
        }
    }

    fn park(&mut self, park: bool) -> Result<(), Reject> {
        if self.motion != Motion::None {
            return Err(Reject::StatusBusy);
        }
        self.parked = park;
        Ok(())
    }
}

const HELP: [&str; 4] = [
    "a simulated controller, with these commands",
    "home, move abs rel vel min max index, stop, estop, get, set,",
    "warnings, driver enable or disable, tools echo, tools parking,",
    "renumber, system reset, io info, activate, help",
];

/// Whether `warnings clear` clears this flag.
fn clears(flag: Flag) -> bool {
    matches!(
        flag,
        Flag::EncoderError
            | Flag::IndexError
            | Flag::EncoderSync
            | Flag::Overdrive
            | Flag::Stalled
            | Flag::Twisted
            | Flag::OutOfBounds
            | Flag::PathDeviation
            | Flag::LimitError
            | Flag::UnexpectedLimit
            | Flag::StallRecovered
    )
}
