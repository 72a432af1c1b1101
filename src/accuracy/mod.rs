//! Error against run time: the error of every method after a number of seconds.
//!
//! Call [`run`]. It computes a fixed list of scenes, from easy to stiff, by every method that applies, with
//! increasing effort. The error is the distance from a reference that is never the method itself: exact
//! numbers, tables in 60-digit arithmetic, the path tracer of another program, or a long run of another method.
//! [`forecast`] estimates the duration of a fit, [`trace_forecast`] that of a trace, which is measured here too, and
//! [`map_forecast`] that of a map. [`model_error`] measures the errors of the closed forms.
//! [`stated_errors`] draws errors of the size that a series states. This module reads the clock,
//! which is its purpose; it writes no files.

mod fits;
pub mod forecast;
mod forms;
pub mod map_forecast;
pub mod model_error;
pub mod page;
pub mod plan_check;
pub mod plot;
pub mod stated_errors;
pub mod trace_forecast;
mod traced;

use std::sync::atomic::{AtomicBool, Ordering};

use serde::Serialize;

use crate::geometry::Pose;
use crate::model::LeftOut;
use crate::scan::plan::Preset;
use crate::units::Angle;

/// Extent of the measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AccuracyEffort {
    /// Under a minute: few scenes, few photons.
    Quick,
    /// Minutes: all scenes.
    Full,
}

/// One measurement.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct AccuracyPoint {
    /// Scene.
    pub scene: String,
    /// Method.
    pub method: String,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Error, in the quantity's unit.
    pub error: f64,
    /// The quantity that has the error.
    pub quantity: String,
    /// The reference of the error.
    pub reference: String,
}

/// A forecast with the time that the work took.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ForecastOutcome {
    /// Scene.
    pub scene: String,
    /// Seconds forecast before the start.
    pub forecast_s: f64,
    /// Seconds taken.
    pub taken_s: f64,
}

impl ForecastOutcome {
    /// Whether the forecast was right within a factor of 2.
    #[must_use]
    pub fn within_a_factor_of_two(&self) -> bool {
        let ratio = self.forecast_s / self.taken_s;
        (0.5..=2.0).contains(&ratio)
    }
}

/// Convergence of the last steps of a solver, predicted and measured.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ConvergenceRate {
    /// Scene.
    pub scene: String,
    /// The predicted quantity.
    pub quantity: String,
    /// Prediction of theory.
    pub predicted: f64,
    /// Measured value; null where rounding hides it.
    pub found: Option<f64>,
}

/// All measurements.
#[derive(Debug, Clone, PartialEq, Default, Serialize, utoipa::ToSchema)]
pub struct Measurements {
    /// Errors against seconds.
    pub points: Vec<AccuracyPoint>,
    /// Forecasts against seconds.
    pub forecasts: Vec<ForecastOutcome>,
    /// Rates of solvers.
    pub rates: Vec<ConvergenceRate>,
    /// Plans compared with full computations.
    pub proofs: Vec<plan_check::PlanCheck>,
}

/// Measurements with the machine that made them: the object of `accuracy --json`.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct AccuracyReport {
    /// Program, processor, threads, system and seconds of the whole run.
    pub machine: String,
    /// Seconds of the whole run.
    pub seconds: f64,
    /// What was not measured.
    pub left_out: Vec<LeftOut>,
    /// The measurements.
    #[serde(flatten)]
    pub found: Measurements,
    /// When they were written to the data folder, RFC 3339 in UTC; only over HTTP.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub written_at: Option<String>,
}

/// The poses of the full scan, azimuths within tilts.
#[derive(Debug, Clone)]
pub struct FullScan {
    tilts_deg: Vec<f64>,
    azimuths_deg: Vec<f64>,
}

/// The scan at whose poses surfaces are compared: the preset `full`.
#[must_use]
pub fn full_scan() -> FullScan {
    let (tilts_deg, azimuths_deg) = Preset::Full.angles_deg();
    FullScan {
        tilts_deg,
        azimuths_deg,
    }
}

impl FullScan {
    /// Camera tilts.
    pub fn tilts(&self) -> impl ExactSizeIterator<Item = Angle> {
        self.tilts_deg.iter().map(|deg| Angle::from_deg(*deg))
    }

    /// Sample azimuths.
    pub fn azimuths(&self) -> impl ExactSizeIterator<Item = Angle> {
        self.azimuths_deg.iter().map(|deg| Angle::from_deg(*deg))
    }

    /// Pose number `n`.
    #[must_use]
    pub fn pose(&self, n: usize) -> Pose {
        let azimuths = self.azimuths_deg.len();
        Pose::from_deg(
            self.tilts_deg[n / azimuths],
            self.azimuths_deg[n % azimuths],
        )
    }

    /// All poses.
    pub fn poses(&self) -> impl Iterator<Item = Pose> {
        (0..self.tilts_deg.len() * self.azimuths_deg.len()).map(|n| self.pose(n))
    }
}

/// The measurements that an effort omits.
#[must_use]
pub fn left_out(effort: AccuracyEffort) -> Vec<LeftOut> {
    match effort {
        AccuracyEffort::Full => Vec::new(),
        AccuracyEffort::Quick => vec![LeftOut::new(
            "some scenes and most photons",
            "--quick: the errors are those of shorter runs, further left on the same lines",
            None,
        )],
    }
}

/// Measures everything. `progress` gets the name of each part before it starts, and the numbers of finished and of all
/// parts. Ends early, with the results so far, once `cancel` is raised.
pub fn run(
    effort: AccuracyEffort,
    cancel: &AtomicBool,
    progress: &dyn Fn(&str, usize, usize),
) -> Measurements {
    let mut found = Measurements::default();
    let scenes = traced::scenes(effort);
    let total = scenes.len() + 2;
    progress("closed forms", 0, total);
    forms::measure(effort, &mut found.points);
    forms::check_plans(effort, &mut found.proofs);
    progress("fit iterations", 1, total);
    fits::measure(cancel, &mut found.points, &mut found.rates);
    for (n, scene) in scenes.iter().enumerate() {
        if cancel.load(Ordering::Relaxed) {
            break;
        }
        progress(&scene.name, n + 2, total);
        traced::measure(scene, effort, cancel, &mut found);
    }
    found
}

/// Points further than this factor from the line do not follow a power law.
const BENT: f64 = 4.0;

/// Slope above which an error no longer falls with time, because only the method's own error is left.
pub const LEVEL: f64 = -0.25;

/// Slope of log error over log seconds by least squares. `None` for fewer than three points, or where
/// they span less than a factor of 3 in time, or where a point is more than a factor of 4 off the line: a solver that
/// converges quadratically does not follow a power law. Nor does a curve with a knee, which [`levels_off`].
#[must_use]
pub fn slope(points: &[&AccuracyPoint]) -> Option<f64> {
    let logs: Vec<(f64, f64)> = points
        .iter()
        .filter(|p| p.seconds > 0.0 && p.error > 0.0)
        .map(|p| (p.seconds.ln(), p.error.ln()))
        .collect();
    let n = logs.len() as f64;
    if logs.len() < 3 {
        return None;
    }
    let mean = |f: &dyn Fn(&(f64, f64)) -> f64| logs.iter().map(f).sum::<f64>() / n;
    let (x, y) = (mean(&|p| p.0), mean(&|p| p.1));
    let xx: f64 = logs.iter().map(|p| (p.0 - x).powi(2)).sum();
    let xy: f64 = logs.iter().map(|p| (p.0 - x) * (p.1 - y)).sum();
    let seconds = |f: fn(f64, f64) -> f64, from: f64| logs.iter().map(|p| p.0).fold(from, f);
    let span = seconds(f64::max, f64::NEG_INFINITY) - seconds(f64::min, f64::INFINITY);
    let slope = xy / xx;
    let straight = logs
        .iter()
        .all(|p| (p.1 - y - slope * (p.0 - x)).abs() <= BENT.ln());
    let knee = slope <= LEVEL && levels_off(points);
    (xx > 0.0 && span >= 3f64.ln() && straight && !knee).then_some(slope)
}

/// Whether the error no longer falls between the two points of the longest run times.
#[must_use]
pub fn levels_off(points: &[&AccuracyPoint]) -> bool {
    let mut by_time: Vec<&&AccuracyPoint> = points
        .iter()
        .filter(|p| p.seconds > 0.0 && p.error > 0.0)
        .collect();
    by_time.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    match by_time.as_slice() {
        [_, .., before, last] => {
            (last.error / before.error).ln() > LEVEL * (last.seconds / before.seconds).ln()
        }
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_of_a_root_is_one_half() {
        let at = |seconds: f64| AccuracyPoint {
            scene: String::new(),
            method: String::new(),
            seconds,
            error: 0.3 / seconds.sqrt(),
            quantity: String::new(),
            reference: String::new(),
        };
        let points: Vec<AccuracyPoint> = [0.1, 1.0, 7.0].into_iter().map(at).collect();
        let refs: Vec<&AccuracyPoint> = points.iter().collect();
        assert!((slope(&refs).unwrap() + 0.5).abs() < 1e-12);
        assert!(slope(&refs[..2]).is_none());
        // The last two points are level: no slope is fitted through the knee.
        let knee: Vec<AccuracyPoint> = [(0.1, 1e-2), (1.0, 1e-3), (3.0, 4e-4), (9.0, 4e-4)]
            .map(|(seconds, error)| AccuracyPoint {
                error,
                ..at(seconds)
            })
            .to_vec();
        let knee: Vec<&AccuracyPoint> = knee.iter().collect();
        assert!(levels_off(&knee) && slope(&knee).is_none());
        assert!(!levels_off(&refs) && slope(&knee[..3]).is_some());
        // Each step squares the error, so there is no power law.
        let squared: Vec<AccuracyPoint> = (0..5)
            .map(|n| AccuracyPoint {
                error: 0.1f64.powi(1 << n),
                ..at(1e-4 * f64::from(n + 1))
            })
            .collect();
        assert!(slope(&squared.iter().collect::<Vec<_>>()).is_none());
    }
}
