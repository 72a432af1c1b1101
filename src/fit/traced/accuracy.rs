//! When a tracing is accurate enough.

use crate::fit::estimate::Estimate;
use crate::fit::problem::{Quantity, Values};
use crate::fit::uncertainty::budget::Uncertainty;

/// Largest share of the combined uncertainty for which the tracer's line of the budget is small: it adds 3 % to it.
const SMALL_SHARE: f64 = 0.25;
/// A parameter stays if further passes would move it by less than this share of its combined uncertainty.
const STAYING_SHARE: f64 = 0.05;

/// Deviation below which more accuracy is useless, in the units of the solver; `None` for quantities that are not
/// reported as results.
fn useless(quantity: Quantity, values: &Values) -> Option<f64> {
    match quantity {
        Quantity::ThetaR | Quantity::AzimuthOffset | Quantity::TiltOffset | Quantity::Wedge => {
            Some(0.008f64.to_radians())
        }
        Quantity::AlphaU | Quantity::AlphaV => Some(0.002),
        Quantity::RhoD => Some(0.002 * values.rho_d),
        Quantity::Translucency | Quantity::Tail | Quantity::Land => Some(0.005),
        Quantity::CrestRadius => Some(0.002),
        Quantity::Scale
        | Quantity::Background
        | Quantity::Eta
        | Quantity::K
        | Quantity::LampTurn => None,
    }
}

/// Longest of the steps ahead, relative to the step of a parameter that stays.
pub(super) fn length(estimate: &Estimate<'_>, u: &Uncertainty) -> f64 {
    let steps = estimate.traced.iter().flat_map(|t| &t.ahead);
    let free = estimate.problem.free();
    let relative = steps
        .zip(&u.budgets)
        .zip(free)
        .filter_map(|((step, budget), q)| {
            let useless = useless(*q, &estimate.values)?;
            Some(step.abs() / useless.max(STAYING_SHARE * budget.combined()))
        });
    relative.fold(0.0, f64::max)
}

/// Ratio of the tracer's line to its limit, for the worst parameter.
pub(super) fn excess(estimate: &Estimate<'_>, u: &Uncertainty) -> f64 {
    let free = estimate.problem.free();
    let over = u.budgets.iter().zip(free).filter_map(|(budget, q)| {
        let useless = useless(*q, &estimate.values)?;
        Some(budget.tracer / useless.max(SMALL_SHARE * budget.combined()))
    });
    over.filter(|x| x.is_finite()).fold(0.0, f64::max)
}
