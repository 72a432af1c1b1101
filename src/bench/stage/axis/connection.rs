//! Connecting an axis: identifies its controller, checks the settings against it and applies them.

use std::sync::{Arc, Mutex};

use super::super::error::StageError;
use super::super::identity::DeviceIdentity;
use super::super::notice::Notices;
use super::super::prediction::Rates;
use super::super::settings::AxisSettings;
use super::profile::ProfileEntry;
use super::{Axis, SPEED_UNIT};
use crate::bench::AxisName;
use crate::bench::line::PortLine;
use crate::bench::wire::zaber_flags::FlagClass;
use crate::clock::Clock;
use crate::units::Angle;

/// Acceleration data are in microsteps per second squared times this.
const ACCELERATION_UNIT: f64 = 1.6384 / 10_000.0;

impl Axis {
    /// Identifies the device. Nothing is set and nothing moves.
    pub async fn identify(
        name: AxisName,
        settings: AxisSettings,
        line: PortLine,
        clock: Arc<dyn Clock>,
        notices: Notices,
    ) -> Result<Axis, StageError> {
        let mut axis = Axis {
            name,
            counts_per_turn: 1.0,
            rates: Rates {
                speed_deg_s: 1.0,
                acceleration_deg_s2: 1.0,
            },
            identity: DeviceIdentity {
                serial: 0,
                device_id: 0,
                firmware: String::new(),
            },
            profile: Vec::new(),
            settings,
            line,
            clock,
            notices,
            turn: tokio::sync::Mutex::new(()),
            memory: Mutex::default(),
        };
        axis.identity = DeviceIdentity {
            serial: axis.get_number("system.serial").await?,
            device_id: axis.get_number("device.id").await?,
            firmware: axis.ask_controller("get version").await?.data,
        };
        Ok(axis)
    }

    /// Refuses a controller with another serial number than the settings state.
    pub fn check_serial(&self) -> Result<(), StageError> {
        match self.settings.serial {
            Some(expected) if expected != self.identity.serial => Err(StageError::WrongDevice {
                axis: self.name,
                address: self.settings.address,
                expected,
                found: self.identity.serial,
            }),
            _ => Ok(()),
        }
    }

    /// Applies the settings and reads them back. Nothing moves.
    pub async fn set_up(&mut self) -> Result<(), StageError> {
        self.determine_scale().await?;
        self.check_travel().await?;
        self.apply_rates().await?;
        self.check_uptime().await?;
        let flags = self.flags().await?;
        let lost = |flag: &FlagClass| *flag == FlagClass::ReferenceLost;
        let referenced = !flags.iter().any(|flag| lost(&flag.class()));
        {
            let mut memory = self.memory();
            memory.referenced = referenced;
            memory.profile_holds = true;
        }
        self.meet_encoder().await
    }

    /// Sets checksums on every reply and no alerts, which would only fill the line. Returns whether
    /// the device sends checksums from now on.
    pub async fn set_up_line(&mut self) -> Result<bool, StageError> {
        let mut all_checked = true;
        for (name, value) in [("comm.checksum", 1.0), ("comm.alert", 0.0)] {
            match self.ask_controller(&format!("set {name} {value:.0}")).await {
                Ok(_) => self.profile.push(ProfileEntry {
                    name,
                    of_controller: true,
                    value,
                    before_moves: false,
                }),
                // Older firmware lacks this setting.
                Err(StageError::Refused { .. }) => all_checked &= name != "comm.checksum",
                Err(error) => return Err(error),
            }
        }
        if all_checked {
            let reply = self.ask_controller("get comm.checksum").await?;
            all_checked = reply.data == "1";
        }
        Ok(all_checked)
    }

    async fn determine_scale(&mut self) -> Result<(), StageError> {
        let reported: Option<f64> = match self.get_finite("limit.cycle.dist").await {
            Ok(counts) => Some(counts).filter(|c| *c > 0.0),
            Err(StageError::Refused { code, .. }) if code == "BADAXIS" => {
                return Err(StageError::NoSuchAxis {
                    axis: self.name,
                    address: self.settings.address,
                    number: self.settings.axis,
                });
            }
            Err(StageError::Refused { .. } | StageError::Unreadable { .. }) => None,
            Err(error) => return Err(error),
        };
        if let Some(counts) = reported {
            self.keep("limit.cycle.dist", counts, false);
        }
        self.counts_per_turn = match (reported, self.settings.counts_per_turn) {
            (Some(found), Some(expected)) if (found / expected - 1.0).abs() > 1e-6 => {
                return Err(StageError::Disagreement {
                    axis: self.name,
                    name: "limit.cycle.dist",
                    expected,
                    found,
                });
            }
            (Some(counts), _) | (None, Some(counts)) => counts,
            (None, None) => return Err(StageError::NoScale { axis: self.name }),
        };
        Ok(())
    }

    /// Checks that the settings' limits, widened by the backlash approach, are within the device's
    /// limits.
    async fn check_travel(&mut self) -> Result<(), StageError> {
        let needed = (
            self.settings.limit_min - self.settings.backlash,
            self.settings.limit_max,
        );
        let (low, high) = (self.counts(needed.0), self.counts(needed.1));
        let (low, high) = (low.min(high), low.max(high));
        let min = self.get_finite("limit.min").await?;
        let max = self.get_finite("limit.max").await?;
        if min <= low as f64 && max >= high as f64 {
            self.keep("limit.min", min, false);
            self.keep("limit.max", max, false);
            return Ok(());
        }
        let device_angle = |counts: f64| Angle::from_deg(counts / self.counts_per_turn * 360.0);
        Err(StageError::BeyondTravel {
            axis: self.name,
            needed_min: device_angle(low as f64),
            needed_max: device_angle(high as f64),
            travel_min: device_angle(min),
            travel_max: device_angle(max),
        })
    }

    async fn apply_rates(&mut self) -> Result<(), StageError> {
        let counts_per_deg = self.counts_per_turn / 360.0;
        let mut rates = [0.0; 2];
        for (rate, (name, unit, wanted)) in rates.iter_mut().zip([
            ("maxspeed", SPEED_UNIT, self.settings.max_speed_deg_s),
            (
                "accel",
                ACCELERATION_UNIT,
                self.settings.acceleration_deg_s2,
            ),
        ]) {
            let to_data = counts_per_deg * unit;
            let wanted = wanted.map(|w| (w * to_data).round().max(1.0));
            if let Some(wanted) = wanted {
                self.ask(&format!("set {name} {wanted:.0}")).await?;
            }
            let found = self.get_finite(name).await?;
            if let Some(expected) = wanted
                && (found - expected).abs() > 1.0
            {
                return Err(StageError::Disagreement {
                    axis: self.name,
                    name,
                    expected,
                    found,
                });
            }
            self.keep(name, wanted.unwrap_or(found), true);
            // Some devices use 0 for "no limit"; the value then only affects how finely the move is
            // polled.
            *rate = found.max(1.0) / to_data;
        }
        self.rates = Rates {
            speed_deg_s: rates[0],
            acceleration_deg_s2: rates[1],
        };
        Ok(())
    }

    /// Adds a setting of the axis to the profile that the device must keep.
    fn keep(&mut self, name: &'static str, value: f64, before_moves: bool) {
        self.profile.push(ProfileEntry {
            name,
            of_controller: false,
            value,
            before_moves,
        });
    }
}
