//! The line `shape`: what the linear interval of a parameter leaves out, a curved valley and other minima.

use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use crate::fit::estimate::Estimate;
use crate::fit::least_squares::levenberg_marquardt::Minimum;
use crate::fit::problem::Quantity;
use crate::fit::uncertainty::covariance::Covariance;
use crate::fit::uncertainty::coverage::COVERAGE_FACTOR;
use crate::fit::uncertainty::profile::profile;
use crate::units::Angle;

/// Standard uncertainty above which a linear interval is not trusted.
const STRAIGHT_ANGLE: f64 = 0.2 * PI / 180.0;
/// The same for the logarithm of a roughness.
const STRAIGHT_LOG_ALPHA: f64 = 0.05;
/// The same for the diffuse reflectance.
const STRAIGHT_RHO_D: f64 = 0.02;

/// Addition that extends the expanded uncertainty to the farthest minimum that the data do not exclude, at least to the
/// distance `least`, and to that minimum's own standard uncertainty, taken as `own`: U = d + k u, so (U/k)² − u² is added.
pub(super) fn to_rivals(estimate: &Estimate<'_>, j: usize, own: f64, least: f64) -> f64 {
    let quantity = estimate.problem.free()[j];
    let here = estimate.values.folded().inner(quantity);
    let distance = |m: &Minimum| {
        let there = estimate
            .problem
            .unpack(&m.parameters)
            .folded()
            .inner(quantity);
        match quantity {
            Quantity::AzimuthOffset => Angle::from_rad(there - here).wrapped().rad().abs(),
            // The report states α ± U, which has to reach a greater α, too: α(1 + x), not α exp(x).
            Quantity::AlphaU | Quantity::AlphaV if there > here => (there - here).exp_m1(),
            _ => (there - here).abs(),
        }
    };
    let others = estimate.rivals.iter().chain(&estimate.no_lobe);
    let farthest = others.map(distance).fold(least, f64::max);
    let way = farthest / COVERAGE_FACTOR;
    match own.is_finite() {
        true => (way * (way + 2.0 * own)).sqrt(),
        false => way,
    }
}

/// Excess of the profile interval of a poorly determined parameter over the linear interval.
pub(super) fn bent(estimate: &Estimate<'_>, covariance: &Covariance, j: usize) -> f64 {
    let quantity = estimate.problem.free()[j];
    let std = covariance.matrix[(j, j)].sqrt();
    let straight = match quantity {
        Quantity::ThetaR | Quantity::AzimuthOffset | Quantity::TiltOffset => STRAIGHT_ANGLE,
        Quantity::AlphaU | Quantity::AlphaV => STRAIGHT_LOG_ALPHA,
        Quantity::RhoD => STRAIGHT_RHO_D,
        _ => return 0.0,
    };
    let known =
        covariance.identifiable[j] && std.is_finite() && estimate.minimum.ending.is_success();
    if !known || std < straight {
        return 0.0;
    }
    let never = AtomicBool::new(false);
    let rise = COVERAGE_FACTOR * COVERAGE_FACTOR;
    let guess = COVERAGE_FACTOR * std;
    let p = profile(&estimate.problem, &estimate.minimum, j, guess, rise, &never);
    let here = estimate.minimum.parameters[j];
    let reach = |end: Option<f64>| end.map_or(f64::INFINITY, |x| (x - here).abs());
    let half = reach(p.lower).max(reach(p.upper)) / COVERAGE_FACTOR;
    (half * half - std * std).max(0.0).sqrt()
}
