//! Predicts how long moves take, without hardware.

use std::time::Duration;

use super::regions::MoveOrder;
use super::settings::{AxisSettings, StageSettings};
use crate::geometry::Pose;
use crate::units::Angle;

/// Assumed speed if neither the settings nor the device state one.
const SPEED_GUESS_DEG_S: f64 = 20.0;
/// Assumed acceleration if neither states one.
const ACCELERATION_GUESS_DEG_S2: f64 = 60.0;
/// Upper bound of a predicted duration, for any reported speed.
const LONGEST_S: f64 = 1e9;
/// Predicted duration of a move that a forbidden region blocks: an order of poses without it is preferred.
const BLOCKED: Duration = Duration::from_secs(1_000_000);

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
    /// Predicts the duration of a move, including backlash detours, settling, and axes that move one
    /// after the other past a forbidden region.
    #[must_use]
    pub fn predict(&self, from: Pose, to: Pose) -> Duration {
        let settings = &self.settings;
        let tilt = leg(&settings.theta_c, self.theta_c, from.theta_c, to.theta_c);
        let turn = leg(&settings.phi_s, self.phi_s, from.phi_s, to.phi_s);
        match settings.move_order(from, to, [true, true]) {
            Ok(MoveOrder::Together) => tilt.max(turn),
            Ok(MoveOrder::ThetaCFirst | MoveOrder::PhiSFirst) => tilt + turn,
            Err(_) => tilt.max(turn) + BLOCKED,
        }
    }

    /// Predicts how long homing both axes takes from a pose, and returns where they are then: each at the zero of its device.
    #[must_use]
    pub fn predict_homing(&self, from: Pose) -> (Duration, Pose) {
        let settings = &self.settings;
        let home = Pose {
            theta_c: -settings.theta_c.zero,
            phi_s: -settings.phi_s.zero,
        };
        let tilt = self.theta_c.duration(home.theta_c - from.theta_c);
        let turn = self.phi_s.duration(home.phi_s - from.phi_s);
        let takes = match settings.homing.sequence() {
            Some(_) => tilt + turn,
            None => tilt.max(turn),
        };
        (takes, home)
    }
}

impl StageSettings {
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

fn leg(axis: &AxisSettings, rates: Rates, from: Angle, to: Angle) -> Duration {
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
}
