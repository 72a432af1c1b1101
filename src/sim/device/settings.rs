//! The settings of a simulated controller: names, scopes and ranges.

use super::super::world::Mechanics;
use super::{ACCELERATION_UNIT, Device, Reject, SPEED_UNIT, Scope};
use crate::bench::AxisName;
use crate::bench::wire::zaber::{Activity, PACKET_BYTES_MAX, WORD_BYTES_MAX};
use crate::units::Angle;

/// Largest number of packets of one command (`comm.command.packets.max`).
pub const COMMAND_PACKETS_MAX: u32 = 10;

/// Largest number of settings in one `get` (`get.settings.max`).
pub(in crate::sim) const GET_SETTINGS_MAX: usize = 10;

/// The settings that a controller stores, also without power, in the protocol's units.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::sim) struct DeviceSettings {
    pub address: u8,
    pub serial: u32,
    pub device_id: u32,
    pub alert: bool,
    pub checksum: bool,
    pub limit_min: i64,
    pub limit_max: i64,
    pub max_speed: i64,
    pub accel_only: i64,
    pub decel_only: i64,
    pub top_speed: i64,
    pub top_acceleration: i64,
    pub cycle_dist: i64,
    pub index_dist: i64,
    pub driver_enabled: bool,
    pub user_data: [u32; 16],
}

impl DeviceSettings {
    /// The settings as delivered: speeds, ramps and limits of the mechanics.
    pub fn factory(axis: AxisName, mechanics: &Mechanics) -> Self {
        let counts = |deg: f64| mechanics.counts_in(Angle::from_deg(deg));
        let max_speed = (counts(mechanics.speed_deg_s) * SPEED_UNIT).round() as i64;
        let accel =
            ((counts(mechanics.acceleration_deg_s2) * ACCELERATION_UNIT).round() as i64).max(1);
        let (address, serial, device_id) = match axis {
            AxisName::ThetaC => (1, 90_001, 50_105),
            AxisName::PhiS => (2, 90_002, 50_106),
        };
        DeviceSettings {
            address,
            serial,
            device_id,
            alert: false,
            checksum: false,
            limit_min: mechanics.counts(mechanics.travel_min).ceil() as i64,
            limit_max: mechanics.counts(mechanics.travel_max).floor() as i64,
            max_speed,
            accel_only: accel,
            decel_only: accel,
            top_speed: max_speed.saturating_mul(4),
            top_acceleration: accel.saturating_mul(20),
            cycle_dist: mechanics.counts_per_turn.round() as i64,
            index_dist: (mechanics.counts_per_turn / 12.0).round() as i64,
            driver_enabled: true,
            user_data: [0; 16],
        }
    }
}

/// Whether a setting belongs to the axis rather than to the controller.
pub(in crate::sim) fn is_of_the_axis(name: &str) -> bool {
    const AXIS: [&str; 13] = [
        "pos",
        "vel",
        "maxspeed",
        "accel",
        "motion.",
        "limit.",
        "resolution",
        "encoder.",
        "driver.",
        "parking.",
        "peripheral",
        "cloop.",
        "user.",
    ];
    AXIS.iter().any(|start| name.starts_with(start))
}

fn user_slot(name: &str) -> Option<usize> {
    let slot: usize = name.strip_prefix("user.data.")?.parse().ok()?;
    (slot < 16).then_some(slot)
}

impl Device {
    /// Reads a setting. A controller setting is refused on an axis.
    pub(in crate::sim) fn get(&self, scope: Scope, name: &str) -> Result<String, Reject> {
        let settings = &self.settings;
        let mechanics = self.world.mechanics(self.axis);
        let motor = self.world.motor(self.axis);
        let value = match name {
            "deviceid" | "device.id" => settings.device_id.to_string(),
            "system.serial" => settings.serial.to_string(),
            "version" => "7.38".to_owned(),
            "version.build" => "1412".to_owned(),
            "system.voltage" => "48.1".to_owned(),
            "system.temperature" => "31.4".to_owned(),
            "system.uptime" => self.uptime_ms().to_string(),
            "comm.address" => settings.address.to_string(),
            "comm.alert" => u8::from(settings.alert).to_string(),
            "comm.checksum" => u8::from(settings.checksum).to_string(),
            "comm.protocol" => "2".to_owned(),
            "comm.packet.size.max" => PACKET_BYTES_MAX.to_string(),
            "comm.word.size.max" => WORD_BYTES_MAX.to_string(),
            "comm.command.packets.max" => COMMAND_PACKETS_MAX.to_string(),
            "comm.rs232.baud" => "115200".to_owned(),
            "comm.next.owner" => "0".to_owned(),
            "device.hw.modified" => "0".to_owned(),
            "get.settings.max" => GET_SETTINGS_MAX.to_string(),
            "pos" => format!("{:.0}", self.counter()),
            "vel" => format!("{:.0}", motor.velocity * SPEED_UNIT),
            "motion.busy" => u8::from(self.activity() == Activity::Busy).to_string(),
            "maxspeed" => settings.max_speed.to_string(),
            "accel" | "motion.accelonly" => settings.accel_only.to_string(),
            "motion.decelonly" => settings.decel_only.to_string(),
            "motion.index.dist" => settings.index_dist.to_string(),
            "motion.index.num" => "12".to_owned(),
            "limit.min" => settings.limit_min.to_string(),
            "limit.max" => settings.limit_max.to_string(),
            "limit.cycle.dist" => settings.cycle_dist.to_string(),
            "limit.home.triggered" => u8::from(motor.position.abs() < 0.5).to_string(),
            "limit.start.pos" => "0".to_owned(),
            "limit.range.mode" => "0".to_owned(),
            "resolution" => "64".to_owned(),
            "encoder.pos" => format!("{:.0}", motor.position),
            "encoder.pos.error" => format!("{:.0}", motor.position - self.counter()),
            "driver.enabled" => u8::from(settings.driver_enabled).to_string(),
            "driver.temperature" => "36.2".to_owned(),
            "parking.state" => u8::from(self.parked).to_string(),
            "peripheralid" | "peripheral.id" | "peripheral.serial" => "0".to_owned(),
            "cloop.settle.tolerance" => "10".to_owned(),
            "cloop.settle.period" => "50".to_owned(),
            "cloop.displace.tolerance" => {
                format!("{:.0}", mechanics.counts_in(Angle::from_deg(1.0)))
            }
            _ => match user_slot(name) {
                Some(slot) => settings.user_data[slot].to_string(),
                None => return Err(Reject::BadCommand),
            },
        };
        if scope == Scope::Axis && !is_of_the_axis(name) {
            return Err(Reject::DeviceOnly);
        }
        Ok(value)
    }

    /// Writes a setting.
    pub(in crate::sim) fn set(
        &mut self,
        scope: Scope,
        name: &str,
        value: &str,
    ) -> Result<(), Reject> {
        // Refuses unknown names and wrong scopes before the check for read-only settings.
        self.get(scope, name)?;
        let value: i64 = value.parse().map_err(|_| Reject::BadData)?;
        let within = |range: std::ops::RangeInclusive<i64>| {
            if range.contains(&value) {
                Ok(value)
            } else {
                Err(Reject::BadData)
            }
        };
        let moving = self.activity() == Activity::Busy;
        let (top_speed, top_acceleration) =
            (self.settings.top_speed, self.settings.top_acceleration);
        let settings = &mut self.settings;
        match name {
            "comm.address" => settings.address = within(1..=99)? as u8,
            "comm.alert" => settings.alert = within(0..=1)? == 1,
            "comm.checksum" => settings.checksum = within(0..=1)? == 1,
            "maxspeed" => settings.max_speed = within(1..=top_speed)?,
            "accel" => {
                let accel = within(1..=top_acceleration)?;
                (settings.accel_only, settings.decel_only) = (accel, accel);
            }
            "motion.accelonly" => settings.accel_only = within(1..=top_acceleration)?,
            "motion.decelonly" => settings.decel_only = within(1..=top_acceleration)?,
            "motion.index.dist" => settings.index_dist = within(1..=i64::from(i32::MAX))?,
            "pos" | "limit.min" | "limit.max" if moving => return Err(Reject::StatusBusy),
            "pos" => {
                let counts = within(-1_000_000_000..=1_000_000_000)?;
                self.set_counter(counts as f64);
            }
            "limit.min" => settings.limit_min = within(-1_000_000_000..=settings.limit_max)?,
            "limit.max" => settings.limit_max = within(settings.limit_min..=1_000_000_000)?,
            "driver.enabled" => {
                let enabled = within(0..=1)? == 1;
                self.set_driver(enabled);
            }
            _ => match user_slot(name) {
                Some(slot) => {
                    settings.user_data[slot] = within(0..=i64::from(u32::MAX))? as u32;
                }
                None => return Err(Reject::BadCommand),
            },
        }
        Ok(())
    }
}
