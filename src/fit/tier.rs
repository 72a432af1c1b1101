//! Adds the costlier tier of the model as a fixed offset: two bounces integrated instead of approximated.
//!
//! The quadrature has no derivatives and costs a thousand closed forms. The fit therefore adds the difference between
//! quadrature and closed form at the fitted values to every observation and fits the closed form again. Two passes
//! suffice, because the difference changes slowly with the parameters.

use super::problem::{Problem, Values};
use crate::model::quadrature::Quadrature;

/// Integration tolerance, as a share of the brightest closed-form radiance.
const TOLERANCE: f64 = 1e-5;

/// Computes what to add to the radiances of the closed form at `values`, one number per observation. Returns `None` if
/// the integration gives a value that is not finite.
#[must_use]
pub fn two_bounces(problem: &Problem<'_>, values: &Values) -> Option<Vec<f64>> {
    let ready = problem.ready(values);
    let count = problem.set().observations.len();
    // For a near rig both are taken at the centre of its views, because the difference is smooth over them. The
    // integrated bounces are those of the ideal sawtooth.
    let closed: Vec<f64> = (0..count)
        .map(|i| problem.ideal_at_centre(i, &ready))
        .collect();
    let brightest = closed.iter().copied().fold(0.0, f64::max);
    let directions: Vec<_> = (0..count)
        .map(|i| problem.directions(i, &ready).0)
        .collect();
    let mut surface = values.surface();
    surface.theta_r = surface.theta_r.abs();
    let integrated = Quadrature::new(&surface, &problem.optics(values))
        .with_polarisation(problem.is_polarised())
        .radiances(&directions, TOLERANCE * brightest);
    let offsets: Vec<f64> = integrated
        .iter()
        .zip(&closed)
        .map(|(q, c)| q.value - c)
        .collect();
    offsets.iter().all(|v| v.is_finite()).then_some(offsets)
}
