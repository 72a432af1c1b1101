//! The costlier tier of the model as a fixed offset: two bounces integrated instead of approximated.
//!
//! The quadrature has no derivatives and costs a thousand closed forms, so the fit never sees it:
//! its difference from the closed form at the fitted values is added to every observation and the
//! closed form is fitted again. Two passes settle, since the difference changes slowly with the
//! parameters.

use super::problem::{Problem, Values};
use crate::model::quadrature::Quadrature;

/// Integration error allowed, as a share of the brightest closed-form radiance.
const TOLERANCE: f64 = 1e-5;

/// What to add to the closed form's radiances at `values`, one per observation; `None` where the
/// integration gives no finite number.
#[must_use]
pub fn two_bounces(problem: &Problem<'_>, values: &Values) -> Option<Vec<f64>> {
    let ready = problem.ready(values);
    let count = problem.set().observations.len();
    // Of a near rig both are taken at the centre of its views: the difference is smooth over them.
    // Integrated are the ideal sawtooth's two bounces.
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
