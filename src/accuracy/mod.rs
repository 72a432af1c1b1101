//! Error against run time: how wrong each way of computing an answer is after how many seconds.
//!
//! Call [`run`]. A fixed list of scenes, from easy to stiff, is computed by every method that applies, at
//! growing effort; the error is the distance from a reference that is never the method itself: exact
//! numbers, tables in 60-digit arithmetic, a path tracer of others, or a long run of another method.
//! [`forecast`] tells beforehand how long a fit will take, [`trace_forecast`] a trace, and is measured here too,
//! [`map_forecast`] a map. [`model_error`] says where the closed forms are wrong. This room looks at the clock, which is its purpose; it writes no files.

mod fits;
pub mod forecast;
mod forms;
pub mod map_forecast;
pub mod model_error;
pub mod page;
pub mod plot;
pub mod proof;
pub mod trace_forecast;
mod traced;

use std::sync::atomic::{AtomicBool, Ordering};

use serde::Serialize;

use crate::geometry::Pose;
use crate::model::LeftOut;
use crate::scan::plan::Preset;
use crate::units::Angle;

/// How much time the whole may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effort {
    /// Under a minute: few scenes, few photons.
    Quick,
    /// Minutes: all scenes.
    Full,
}

/// One measurement.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Point {
    /// Scene.
    pub scene: String,
    /// Method.
    pub method: String,
    /// Wall-clock seconds.
    pub seconds: f64,
    /// Error, in the quantity's unit.
    pub error: f64,
    /// What is off by the error.
    pub quantity: String,
    /// What the error is against.
    pub reference: String,
}

/// A forecast beside what it took.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Foretold {
    /// Scene.
    pub scene: String,
    /// Seconds told before the start.
    pub forecast_s: f64,
    /// Seconds taken.
    pub taken_s: f64,
}

impl Foretold {
    /// Whether it was right within a factor of 2.
    #[must_use]
    pub fn within_a_factor_of_two(&self) -> bool {
        let ratio = self.forecast_s / self.taken_s;
        (0.5..=2.0).contains(&ratio)
    }
}

/// How a solver's last steps close in, as theory says and as found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Rate {
    /// Scene.
    pub scene: String,
    /// What is predicted.
    pub quantity: String,
    /// As theory says.
    pub predicted: f64,
    /// As found; null where rounding came first.
    pub found: Option<f64>,
}

/// All measurements.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Measurements {
    /// Errors against seconds.
    pub points: Vec<Point>,
    /// Forecasts against seconds.
    pub forecasts: Vec<Foretold>,
    /// Rates of solvers.
    pub rates: Vec<Rate>,
    /// Plans beside everything on.
    pub proofs: Vec<proof::Proof>,
}

/// The poses of the full scan, azimuths within tilts.
#[derive(Debug, Clone)]
pub struct FullScan {
    tilts_deg: Vec<f64>,
    azimuths_deg: Vec<f64>,
}

/// The scan at whose poses surfaces are compared.
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

/// What the measurements of some effort do without.
#[must_use]
pub fn left_out(effort: Effort) -> Vec<LeftOut> {
    match effort {
        Effort::Full => Vec::new(),
        Effort::Quick => vec![LeftOut::new(
            "some scenes and most photons",
            "--quick: the errors are those of shorter runs, further to the left on the same lines",
            None,
        )],
    }
}

/// Measures everything; `progress` is told what starts, and how much is done of how much. Ends early, with
/// what is measured, once `cancel` is raised.
pub fn run(
    effort: Effort,
    cancel: &AtomicBool,
    progress: &dyn Fn(&str, usize, usize),
) -> Measurements {
    let mut found = Measurements::default();
    let scenes = traced::scenes(effort);
    let total = scenes.len() + 2;
    progress("closed forms", 0, total);
    forms::measure(effort, &mut found.points);
    forms::prove(effort, &mut found.proofs);
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

/// A point this far off a line, as a factor, says that there is no power law.
const BENT: f64 = 4.0;

/// Slope above which an error does not fall with time: what a method leaves out is all that is left of it.
pub const LEVEL: f64 = -0.25;

/// Slope of log error over log seconds by least squares; `None` for fewer than three points of effort, or where
/// the effort spans less than a factor of 3, or a point lies more than a factor of 4 off the line: a solver that
/// converges quadratically keeps no power law, and a slope would say nothing of it.
#[must_use]
pub fn slope(points: &[&Point]) -> Option<f64> {
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
    (xx > 0.0 && span >= 3f64.ln() && straight).then_some(slope)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_slope_of_a_root_is_one_half() {
        let at = |seconds: f64| Point {
            scene: String::new(),
            method: String::new(),
            seconds,
            error: 0.3 / seconds.sqrt(),
            quantity: String::new(),
            reference: String::new(),
        };
        let points: Vec<Point> = [0.1, 1.0, 7.0].into_iter().map(at).collect();
        let refs: Vec<&Point> = points.iter().collect();
        assert!((slope(&refs).unwrap() + 0.5).abs() < 1e-12);
        assert!(slope(&refs[..2]).is_none());
        // Each step squares the error: no power of the time.
        let squared: Vec<Point> = (0..5)
            .map(|n| Point {
                error: 0.1f64.powi(1 << n),
                ..at(1e-4 * f64::from(n + 1))
            })
            .collect();
        assert!(slope(&squared.iter().collect::<Vec<_>>()).is_none());
    }
}
