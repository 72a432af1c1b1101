//! The settings of a stage, and the checks and predictions that need no hardware.

use std::fmt::Display;
use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::error::StageError;
use crate::bench::AxisName;
use crate::geometry::Pose;
use crate::units::Angle;

/// Assumed speed if neither the settings nor the device state one.
const SPEED_GUESS_DEG_S: f64 = 20.0;
/// Assumed acceleration if neither states one.
const ACCELERATION_GUESS_DEG_S2: f64 = 60.0;
/// Upper bound of a predicted duration, for any reported speed.
const LONGEST_S: f64 = 1e9;

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
        }
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

    /// Estimates the duration of a move with the speeds of the settings, or usual ones. A connected
    /// stage gives a better value: [`super::Stage::predicted_move`].
    #[must_use]
    pub fn predicted_move(&self, from: Pose, to: Pose) -> Duration {
        self.move_times().predict(from, to)
    }

    /// Returns what predicts moves before a stage is connected.
    #[must_use]
    pub fn move_times(&self) -> MoveTimes {
        let rates = |axis: &AxisSettings| Rates {
            speed_deg_s: axis.max_speed_deg_s.unwrap_or(SPEED_GUESS_DEG_S),
            acceleration_deg_s2: axis
                .acceleration_deg_s2
                .unwrap_or(ACCELERATION_GUESS_DEG_S2),
        };
        MoveTimes {
            theta_c: rates(&self.theta_c),
            phi_s: rates(&self.phi_s),
            settings: self.clone(),
        }
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

/// Speed and acceleration of an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rates {
    pub speed_deg_s: f64,
    pub acceleration_deg_s2: f64,
}

impl Rates {
    /// Duration from rest to rest: a trapezoidal speed profile, or a triangular one for short
    /// moves.
    pub fn duration(&self, way: Angle) -> Duration {
        let (d, v, a) = (way.abs().deg(), self.speed_deg_s, self.acceleration_deg_s2);
        let seconds = if d * a > v * v {
            d / v + v / a
        } else {
            2.0 * (d / a).sqrt()
        };
        // Clamped also where the value is not a number; sums and multiples of it do not overflow.
        Duration::from_secs_f64(seconds.min(LONGEST_S))
    }
}

/// Settings and speeds of the two axes: enough to predict a move, without a link to the devices.
#[derive(Debug, Clone, PartialEq)]
pub struct MoveTimes {
    pub(super) settings: StageSettings,
    pub(super) theta_c: Rates,
    pub(super) phi_s: Rates,
}

impl MoveTimes {
    /// Predicts the duration of a move, including backlash detours and settling.
    #[must_use]
    pub fn predict(&self, from: Pose, to: Pose) -> Duration {
        predicted_move(&self.settings, self.theta_c, self.phi_s, from, to)
    }
}

fn predicted_move(
    settings: &StageSettings,
    theta_c: Rates,
    phi_s: Rates,
    from: Pose,
    to: Pose,
) -> Duration {
    let leg = |axis: &AxisSettings, rates: Rates, from: Angle, to: Angle| {
        if (to - from).abs() <= axis.tolerance * 0.5 {
            return Duration::ZERO;
        }
        let motion = if axis.needs_detour(from, to, true) {
            let below = to - axis.backlash;
            rates.duration(below - from) + rates.duration(axis.backlash)
        } else {
            rates.duration(to - from)
        };
        motion + Duration::from_millis(axis.settle_ms)
    };
    let tilt = leg(&settings.theta_c, theta_c, from.theta_c, to.theta_c);
    let turn = leg(&settings.phi_s, phi_s, from.phi_s, to.phi_s);
    tilt.max(turn)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_unchanged_by_writing_and_reading() {
        let settings = StageSettings::simulated();
        let text = toml::to_string(&settings).unwrap();
        assert!(text.contains("limit_min_deg = -60.0"), "{text}");
        assert_eq!(toml::from_str::<StageSettings>(&text).unwrap(), settings);
    }

    #[test]
    fn a_minimal_file_suffices_and_an_unknown_key_is_named() {
        let text = "[theta_c]\naddress = 1\nlimit_min_deg = -30\nlimit_max_deg = 30\n\
                    [phi_s]\naddress = 2\nlimit_min_deg = 0\nlimit_max_deg = 360\n";
        let settings: StageSettings = toml::from_str(text).unwrap();
        settings.validate().unwrap();
        assert_eq!(settings.baud, 115_200);
        let error = toml::from_str::<StageSettings>(&format!("{text}limit_deg = 3\n")).unwrap_err();
        assert!(error.to_string().contains("limit_deg"), "{error}");
    }

    #[test]
    fn an_invalid_value_is_refused_with_its_key() {
        type Change = fn(&mut StageSettings);
        let cases: [(&str, Change); 12] = [
            ("theta_c.limit_min_deg", |s| {
                s.theta_c.limit_min = Angle::from_deg(90.0)
            }),
            ("theta_c.limit_max_deg", |s| {
                s.theta_c.limit_max = Angle::from_deg(f64::NAN)
            }),
            ("phi_s.tolerance_deg", |s| s.phi_s.tolerance = Angle::ZERO),
            ("phi_s.backlash_deg", |s| {
                s.phi_s.backlash = Angle::from_deg(-1.0)
            }),
            ("phi_s.address", |s| s.phi_s.address = 1),
            ("phi_s.serial", |s| s.phi_s.serial = s.theta_c.serial),
            ("theta_c.address", |s| s.theta_c.address = 0),
            ("theta_c.axis", |s| s.theta_c.axis = 10),
            // One controller has one serial number.
            ("phi_s.serial", |s| {
                (s.phi_s.address, s.phi_s.axis) = (s.theta_c.address, 2)
            }),
            ("theta_c.max_speed_deg_s", |s| {
                s.theta_c.max_speed_deg_s = Some(f64::INFINITY)
            }),
            ("phi_s.home_timeout_s", |s| {
                s.phi_s.home_timeout_s = f64::NAN
            }),
            ("attempts", |s| s.attempts = 0),
        ];
        for (expected, change) in cases {
            let mut settings = StageSettings::simulated();
            change(&mut settings);
            match settings.validate() {
                Err(StageError::BadSetting { key, .. }) => assert_eq!(key, expected),
                other => panic!("{expected}: {other:?}"),
            }
        }
    }

    #[test]
    fn two_axes_of_one_controller_differ_by_their_number() {
        let mut settings = StageSettings::simulated();
        settings.phi_s.serial = settings.theta_c.serial;
        settings.phi_s.address = settings.theta_c.address;
        settings.phi_s.axis = 2;
        settings.validate().unwrap();
        assert_eq!(settings.addresses(), [1]);
        let text = toml::to_string(&settings).unwrap();
        assert_eq!(text.matches("axis = ").count(), 1, "{text}");
        assert_eq!(toml::from_str::<StageSettings>(&text).unwrap(), settings);
    }

    #[test]
    fn the_limits_themselves_are_allowed_and_values_beyond_are_not() {
        let settings = StageSettings::simulated();
        assert!(settings.check_limits(Pose::from_deg(-60.0, 390.0)).is_ok());
        assert!(matches!(
            settings.check_limits(Pose::from_deg(-60.001, 0.0)),
            Err(StageError::OutsideLimits {
                axis: AxisName::ThetaC,
                ..
            })
        ));
        assert!(matches!(
            settings.check_limits(Pose::from_deg(0.0, f64::NAN)),
            Err(StageError::NotANumber {
                axis: AxisName::PhiS
            })
        ));
    }

    #[test]
    fn a_downward_move_includes_the_detour() {
        let settings = StageSettings::simulated();
        let (low, high) = (Pose::from_deg(0.0, 0.0), Pose::from_deg(10.0, 0.0));
        // 20°/s, 60°/s²: 10/20 + 20/60 s, plus 100 ms to settle.
        let up = settings.predicted_move(low, high).as_secs_f64();
        assert!((up - (0.5 + 1.0 / 3.0 + 0.1)).abs() < 1e-9);
        let down = settings.predicted_move(high, low).as_secs_f64();
        assert!((down - (up + 0.2 / 20.0 + 2.0 * (0.2f64 / 60.0).sqrt())).abs() < 1e-9);
        assert_eq!(settings.predicted_move(low, low), Duration::ZERO);
    }
}
