//! The settings of a stage, and the checks and predictions that need no hardware.

use std::fmt::Display;

use serde::{Deserialize, Serialize};

use super::error::StageError;
use super::homing_order::HomingSettings;
use super::regions::{ForbiddenRegion, REGIONS_MAX, Span};
use crate::bench::AxisName;
use crate::geometry::Pose;
use crate::units::Angle;

/// Both axes and the line to them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageSettings {
    /// Speed of a serial line in baud; firmware 7 defaults to 115200. Ignored for TCP.
    #[serde(default = "default_baud")]
    pub baud: u32,
    /// Time-out of a reply, 10 to 10 000 ms of real time.
    #[serde(default = "default_reply_timeout_ms")]
    pub reply_timeout_ms: u64,
    /// Attempts until the device counts as silent, 1 to 10.
    #[serde(default = "default_attempts")]
    pub attempts: u32,
    /// The tilt axis.
    pub theta_c: AxisSettings,
    /// The rotation axis.
    pub phi_s: AxisSettings,
    /// Regions that no motion enters; at most 100.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub forbidden: Vec<ForbiddenRegion>,
    /// Order of homing.
    #[serde(default, skip_serializing_if = "HomingSettings::is_default")]
    pub homing: HomingSettings,
}

/// One axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisSettings {
    /// Address of its controller on the chain, 1 to 99.
    pub address: u8,
    /// Number of the axis on a controller with several axes, 1 to 9.
    #[serde(default = "default_axis", skip_serializing_if = "is_default_axis")]
    pub axis: u8,
    /// Serial number of its controller; a controller with another one is refused.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<u32>,
    /// Smallest allowed recorded angle. An approach starts up to `backlash_deg` below it.
    #[serde(rename = "limit_min_deg", with = "degrees")]
    pub limit_min: Angle,
    /// Largest allowed recorded angle.
    #[serde(rename = "limit_max_deg", with = "degrees")]
    pub limit_max: Angle,
    /// Device angle, from the device's own zero, at recorded angle 0.
    #[serde(rename = "zero_deg", with = "degrees", default)]
    pub zero: Angle,
    /// Whether the device's counts decrease while the recorded angle increases.
    #[serde(default)]
    pub reversed: bool,
    /// Every target is approached from at least this far below; 0 disables this.
    #[serde(
        rename = "backlash_deg",
        with = "degrees",
        default = "default_backlash"
    )]
    pub backlash: Angle,
    /// Largest deviation from the target that counts as arrived.
    #[serde(
        rename = "tolerance_deg",
        with = "degrees",
        default = "default_tolerance"
    )]
    pub tolerance: Angle,
    /// Largest difference between encoder and counter, since the last homing, that is no slip; for a
    /// device with an encoder.
    #[serde(
        rename = "encoder_tolerance_deg",
        with = "degrees",
        default = "default_encoder_tolerance",
        skip_serializing_if = "is_default_encoder_tolerance"
    )]
    pub encoder_tolerance: Angle,
    /// Wait between arrival and exposure, in milliseconds.
    #[serde(default = "default_settle_ms")]
    pub settle_ms: u64,
    /// Microsteps per turn of the output, for a device that does not report them
    /// (`limit.cycle.dist`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub counts_per_turn: Option<f64>,
    /// Speed to set on the device; unchanged if omitted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max_speed_deg_s: Option<f64>,
    /// Acceleration to set on the device; unchanged if omitted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acceleration_deg_s2: Option<f64>,
    /// Time limit for homing, in seconds.
    #[serde(default = "default_home_timeout_s")]
    pub home_timeout_s: f64,
}

fn default_baud() -> u32 {
    115_200
}
fn default_reply_timeout_ms() -> u64 {
    300
}
fn default_attempts() -> u32 {
    3
}
fn default_axis() -> u8 {
    1
}
/// The default is not written, so that settings files without this key stay unchanged.
fn is_default_axis(axis: &u8) -> bool {
    *axis == default_axis()
}
fn default_backlash() -> Angle {
    Angle::from_deg(0.2)
}
fn default_tolerance() -> Angle {
    Angle::from_deg(0.005)
}
fn default_encoder_tolerance() -> Angle {
    Angle::from_deg(0.05)
}
/// Not written either.
fn is_default_encoder_tolerance(tolerance: &Angle) -> bool {
    *tolerance == default_encoder_tolerance()
}
fn default_settle_ms() -> u64 {
    100
}
fn default_home_timeout_s() -> f64 {
    120.0
}

/// Angles in files are in degrees, without the rounding errors of the conversion.
mod degrees {
    use crate::units::Angle;
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(angle: &Angle, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_f64((angle.deg() * 1e10).round() / 1e10)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(d: D) -> Result<Angle, D::Error> {
        f64::deserialize(d).map(Angle::from_deg)
    }
}

impl StageSettings {
    /// The settings of the simulated rig's defaults.
    #[must_use]
    pub fn simulated() -> Self {
        let axis = |address: u8, serial: u32, min: f64, max: f64, zero: f64| AxisSettings {
            address,
            axis: default_axis(),
            serial: Some(serial),
            limit_min: Angle::from_deg(min),
            limit_max: Angle::from_deg(max),
            zero: Angle::from_deg(zero),
            reversed: false,
            backlash: default_backlash(),
            tolerance: default_tolerance(),
            encoder_tolerance: default_encoder_tolerance(),
            settle_ms: default_settle_ms(),
            counts_per_turn: None,
            max_speed_deg_s: None,
            acceleration_deg_s2: None,
            home_timeout_s: default_home_timeout_s(),
        };
        StageSettings {
            baud: default_baud(),
            reply_timeout_ms: default_reply_timeout_ms(),
            attempts: default_attempts(),
            theta_c: axis(1, 90_001, -60.0, 60.0, 65.0),
            phi_s: axis(2, 90_002, -20.0, 390.0, 30.0),
            forbidden: Vec::new(),
            homing: HomingSettings::default(),
        }
    }

    /// Returns the settings of the simulated stages where these permit motion: with their forbidden regions, their order of
    /// homing, and their limits as far as the simulated stages go. Everything else belongs to the devices.
    #[must_use]
    pub fn on_simulated_stages(&self) -> Self {
        let mut simulated = StageSettings {
            forbidden: self.forbidden.clone(),
            homing: self.homing.clone(),
            ..StageSettings::simulated()
        };
        for (axis, stated) in [
            (&mut simulated.theta_c, &self.theta_c),
            (&mut simulated.phi_s, &self.phi_s),
        ] {
            let (min, max) = (axis.limit_min, axis.limit_max);
            let within = |angle: Angle| match angle {
                below if below < min => min,
                above if above > max => max,
                angle => angle,
            };
            axis.limit_min = within(stated.limit_min);
            axis.limit_max = within(stated.limit_max);
        }
        simulated
    }

    /// Addresses of the controllers, each once.
    #[must_use]
    pub fn addresses(&self) -> Vec<u8> {
        let mut all = vec![self.theta_c.address, self.phi_s.address];
        all.dedup();
        all
    }

    /// The settings of one axis.
    #[must_use]
    pub fn axis(&self, axis: AxisName) -> &AxisSettings {
        match axis {
            AxisName::ThetaC => &self.theta_c,
            AxisName::PhiS => &self.phi_s,
        }
    }

    /// Checks all settings.
    ///
    /// # Errors
    /// [`StageError::BadSetting`] names the first invalid key and its allowed values.
    pub fn validate(&self) -> Result<(), StageError> {
        let bad = |key: &str, found: &dyn Display, allowed: &str| {
            Err(StageError::BadSetting {
                key: key.to_owned(),
                found: found.to_string(),
                allowed: allowed.to_owned(),
            })
        };
        if !(300..=4_000_000).contains(&self.baud) {
            return bad("baud", &self.baud, "300 to 4 000 000");
        }
        if !(10..=10_000).contains(&self.reply_timeout_ms) {
            return bad("reply_timeout_ms", &self.reply_timeout_ms, "10 to 10 000");
        }
        if !(1..=10).contains(&self.attempts) {
            return bad("attempts", &self.attempts, "1 to 10");
        }
        for name in AxisName::ALL {
            if let Err((key, found, allowed)) = self.axis(name).check() {
                return bad(&format!("{name}.{key}"), &found, &allowed);
            }
        }
        let (tilt, turn) = (&self.theta_c, &self.phi_s);
        let one_controller = tilt.address == turn.address;
        if one_controller && tilt.axis == turn.axis {
            let allowed = "an address other than that of theta_c, or, on a controller with several axes, the same one with \
                           another phi_s.axis";
            return bad("phi_s.address", &turn.address, allowed);
        }
        if let (Some(one), Some(other)) = (tilt.serial, turn.serial)
            && (one == other) != one_controller
        {
            let allowed = match one_controller {
                true => "that of theta_c, which is on the same controller",
                false => "a serial number other than that of theta_c",
            };
            return bad("phi_s.serial", &other, allowed);
        }
        if let Err((key, found, allowed)) = self.check_regions() {
            return bad(&key, &found, &allowed);
        }
        Ok(())
    }

    /// Checks a pose against the limits of both axes, without hardware.
    ///
    /// # Errors
    /// [`StageError::OutsideLimits`], or [`StageError::NotANumber`].
    pub fn check_limits(&self, pose: Pose) -> Result<(), StageError> {
        self.check_limit(AxisName::ThetaC, pose.theta_c)?;
        self.check_limit(AxisName::PhiS, pose.phi_s)
    }

    /// Checks an angle against the limits of its axis.
    ///
    /// # Errors
    /// [`StageError::OutsideLimits`], or [`StageError::NotANumber`].
    pub fn check_limit(&self, axis: AxisName, target: Angle) -> Result<(), StageError> {
        let settings = self.axis(axis);
        if !target.is_finite() {
            return Err(StageError::NotANumber { axis });
        }
        // The conversion through radians may change the last digits.
        let slack = Angle::from_deg(1e-9);
        if target < settings.limit_min - slack || target > settings.limit_max + slack {
            return Err(StageError::OutsideLimits {
                axis,
                target,
                min: settings.limit_min,
                max: settings.limit_max,
            });
        }
        Ok(())
    }

    /// Checks the forbidden regions and the order of homing.
    fn check_regions(&self) -> Result<(), (String, String, String)> {
        if self.forbidden.len() > REGIONS_MAX {
            let found = format!("{} regions", self.forbidden.len());
            return Err(("forbidden".into(), found, format!("at most {REGIONS_MAX}")));
        }
        for (n, region) in self.forbidden.iter().enumerate() {
            if let Err((key, found, allowed)) = region.check() {
                return Err((format!("forbidden[{n}].{key}"), found, allowed.into()));
            }
        }
        if !self.forbidden.is_empty() && self.homing.sequence().is_none() {
            let allowed = "theta_c-first or phi_s-first beside forbidden regions: the axis that may home wherever the other \
                           one is";
            return Err(("homing.order".into(), "together".into(), allowed.into()));
        }
        for axis in AxisName::ALL {
            let Some(deg) = self.homing.safe_deg(axis) else {
                continue;
            };
            let key = format!("homing.safe_{axis}_deg");
            let angle = Angle::from_deg(deg);
            if self.check_limit(axis, angle).is_err() {
                let allowed = format!("within the limits of {axis}");
                return Err((key, deg.to_string(), allowed));
            }
            let at = Span::between(deg, deg, self.axis(axis).tolerance.deg());
            let blocking = self.forbidden.iter().find(|region| match axis {
                AxisName::ThetaC => region.meets_theta_c(at),
                AxisName::PhiS => region.meets_phi_s(at),
            });
            if let Some(region) = blocking {
                let allowed =
                    format!("outside the {axis} of all forbidden regions, also of {region}");
                return Err((key, deg.to_string(), allowed));
            }
        }
        Ok(())
    }
}

impl AxisSettings {
    /// Returns the first invalid key, its value and the allowed values.
    fn check(&self) -> Result<(), (&'static str, String, String)> {
        let bad = |key: &'static str, found: &dyn Display, allowed: &str| {
            Err((key, found.to_string(), allowed.to_owned()))
        };
        if !(1..=99).contains(&self.address) {
            return bad("address", &self.address, "1 to 99");
        }
        if !(1..=9).contains(&self.axis) {
            return bad("axis", &self.axis, "1 to 9");
        }
        for (key, angle) in [
            ("limit_min_deg", self.limit_min),
            ("limit_max_deg", self.limit_max),
            ("zero_deg", self.zero),
            ("backlash_deg", self.backlash),
            ("tolerance_deg", self.tolerance),
        ] {
            if !angle.is_finite() || angle.abs() > Angle::from_deg(36_000.0) {
                return bad(
                    key,
                    &in_degrees(angle),
                    "a number of degrees, at most 36 000",
                );
            }
        }
        let (min, max) = (in_degrees(self.limit_min), in_degrees(self.limit_max));
        if self.limit_min >= self.limit_max {
            let allowed = format!("below limit_max_deg, which is {max}");
            return bad("limit_min_deg", &min, &allowed);
        }
        if self.backlash < Angle::ZERO || self.backlash > Angle::from_deg(10.0) {
            return bad("backlash_deg", &in_degrees(self.backlash), "0 to 10");
        }
        if self.tolerance <= Angle::ZERO || self.tolerance > Angle::from_deg(1.0) {
            let found = in_degrees(self.tolerance);
            return bad("tolerance_deg", &found, "above 0, and at most 1");
        }
        if self.encoder_tolerance <= Angle::ZERO || self.encoder_tolerance > Angle::from_deg(10.0) {
            let found = in_degrees(self.encoder_tolerance);
            return bad("encoder_tolerance_deg", &found, "above 0, and at most 10");
        }
        if self.settle_ms > 60_000 {
            return bad("settle_ms", &self.settle_ms, "at most 60 000");
        }
        for (key, value, max, allowed) in [
            ("counts_per_turn", self.counts_per_turn, 1e9, "1e9"),
            ("max_speed_deg_s", self.max_speed_deg_s, 1e4, "10 000"),
            (
                "acceleration_deg_s2",
                self.acceleration_deg_s2,
                1e6,
                "1 000 000",
            ),
            ("home_timeout_s", Some(self.home_timeout_s), 3600.0, "3600"),
        ] {
            if let Some(value) = value.filter(|v| !(*v > 0.0 && *v <= max)) {
                return bad(key, &value, &format!("above 0, and at most {allowed}"));
            }
        }
        Ok(())
    }

    /// Returns whether a target must be approached by way of a point below it. `engaged`: the last
    /// move ended upwards, so the play of the gear is already taken up.
    pub(super) fn needs_detour(&self, from: Angle, target: Angle, engaged: bool) -> bool {
        let direct = (engaged && target >= from) || target - from >= self.backlash;
        !direct && self.backlash > Angle::ZERO
    }
}

/// Degrees without the rounding errors of the conversion through radians.
fn in_degrees(angle: Angle) -> f64 {
    let deg = angle.deg();
    let rounded = (deg * 1e9).round() / 1e9;
    if rounded.is_finite() { rounded } else { deg }
}

#[cfg(test)]
#[path = "settings_tests.rs"]
mod tests;
