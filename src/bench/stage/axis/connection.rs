//! Connecting an axis: identifies its controller, checks the settings against it and applies them.

use std::sync::{Arc, Mutex};

use super::super::error::StageError;
use super::super::settings::{AxisSettings, Rates};
use super::{Axis, ControllerIdentity};
use crate::bench::AxisName;
use crate::bench::line::PortLine;
use crate::bench::wire::zaber_flags::Flag;
use crate::clock::Clock;
use crate::units::Angle;

/// Speed data are in microsteps per second times this.
const SPEED_UNIT: f64 = 1.6384;
/// Acceleration data are in microsteps per second squared times this.
const ACCELERATION_UNIT: f64 = 1.6384 / 10_000.0;

impl Axis {
    /// Identifies the device, applies the settings and reads them back. Nothing moves.
    pub async fn connect(
        name: AxisName,
        settings: AxisSettings,
        line: PortLine,
        clock: Arc<dyn Clock>,
    ) -> Result<Axis, StageError> {
        let mut axis = Axis {
            name,
            counts_per_turn: 1.0,
            rates: Rates {
                speed_deg_s: 1.0,
                acceleration_deg_s2: 1.0,
            },
            identity: ControllerIdentity {
                serial: 0,
                device_id: 0,
                firmware: String::new(),
            },
            settings,
            line,
            clock,
            turn: tokio::sync::Mutex::new(()),
            memory: Mutex::default(),
        };
        axis.identify().await?;
        axis.determine_scale().await?;
        axis.check_travel().await?;
        axis.apply_rates().await?;
        axis.check_uptime().await?;
        let flags = axis.flags().await?;
        axis.memory().referenced = !flags.contains(&Flag::NoReference);
        Ok(axis)
    }

    async fn identify(&mut self) -> Result<(), StageError> {
        let serial: u32 = self.get_number("system.serial").await?;
        if let Some(expected) = self.settings.serial
            && expected != serial
        {
            return Err(StageError::WrongDevice {
                axis: self.name,
                address: self.settings.address,
                expected,
                found: serial,
            });
        }
        self.identity = ControllerIdentity {
            serial,
            device_id: self.get_number("device.id").await?,
            firmware: self.ask_controller("get version").await?.data,
        };
        Ok(())
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
    async fn check_travel(&self) -> Result<(), StageError> {
        let needed = (
            self.settings.limit_min - self.settings.backlash,
            self.settings.limit_max,
        );
        let (low, high) = (self.counts(needed.0), self.counts(needed.1));
        let (low, high) = (low.min(high), low.max(high));
        let min = self.get_finite("limit.min").await?;
        let max = self.get_finite("limit.max").await?;
        if min <= low as f64 && max >= high as f64 {
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
}
