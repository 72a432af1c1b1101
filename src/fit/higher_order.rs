//! Adds the higher order of the model as a fixed offset: two bounces integrated instead of approximated.
//!
//! The quadrature has no derivatives and costs a thousand closed forms. The fit therefore adds the difference between
//! quadrature and closed form at the fitted values to every observation and fits the closed form again. Two passes
//! suffice, because the difference changes slowly with the parameters.

use super::FitOptions;
use super::model_discrepancy::peak;
use super::problem::{Problem, Values};
use super::subsample::subset;
use crate::model::quadrature::Quadrature;

/// Integration tolerance, as a share of the brightest closed-form radiance.
const TOLERANCE: f64 = 1e-5;
/// Poses at which the effect of a higher order is tested.
const PROBED: usize = 16;

/// A higher order of the model: radiances to add to those of the closed form at given values, one per observation;
/// `None` if it has no result.
pub type HigherOrder<'t> = &'t (dyn Fn(&Problem<'_>, &Values) -> Option<Vec<f64>> + Sync);

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
    let directions: Vec<_> = (0..count).map(|i| problem.directions(i, &ready)).collect();
    let mut surface = values.surface();
    surface.theta_r = surface.theta_r.abs();
    let integrated = Quadrature::new(&surface, &problem.optics(values))
        .with_polarisation(problem.is_polarised())
        .radiances(&directions, TOLERANCE * brightest);
    // Flat lands have no second bounce.
    let ridged = 1.0 - values.real.land;
    let offsets: Vec<f64> = integrated
        .iter()
        .zip(&closed)
        .map(|(q, c)| ridged * (q.value - c))
        .collect();
    offsets.iter().all(|v| v.is_finite()).then_some(offsets)
}

/// Returns the effect of leaving out a higher order, as a share of the peak, if the tolerance allows that.
pub(super) fn dispensable(
    problem: &Problem<'_>,
    values: &Values,
    higher_order: HigherOrder<'_>,
    options: &FitOptions,
) -> Option<f64> {
    let tolerance = options.tolerance?;
    higher_order_cost(problem, values, higher_order).filter(|cost| *cost <= tolerance)
}

/// Returns the effect of a higher order at given values: its largest change over [`PROBED`] observations and the
/// brightest, as a share of the peak. Returns `None` if the higher order has no result.
fn higher_order_cost(
    problem: &Problem<'_>,
    values: &Values,
    higher_order: HigherOrder<'_>,
) -> Option<f64> {
    let set = problem.set();
    let count = set.observations.len();
    let mut probed: Vec<usize> = (0..PROBED).map(|k| k * count / PROBED).collect();
    let signal = |i: &usize| set.observations[*i].signal;
    probed.extend((0..count).max_by(|a, b| signal(a).total_cmp(&signal(b))));
    probed.sort_unstable();
    probed.dedup();
    let few = subset(set, &probed);
    let free = problem.free().to_vec();
    let offsets = higher_order(
        &Problem::new(&few, problem.variant(), free, *values),
        values,
    )?;
    let largest = offsets.iter().map(|o| o.abs()).fold(0.0, f64::max);
    Some(largest * values.scale.abs() / peak(set).max(f64::MIN_POSITIVE))
}
