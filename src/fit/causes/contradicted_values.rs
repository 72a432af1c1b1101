//! Stated values that the data contradict.

use crate::fit::estimate::Estimate;
use crate::fit::model_discrepancy::LOUD;
use crate::fit::problem::Quantity;
use crate::fit::uncertainty::covariance::covariance;
use crate::observation::Prior;

/// A stated value that the data contradict.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::fit) struct Denial {
    /// The quantity.
    pub quantity: Quantity,
    /// The stated value.
    pub prior: Prior,
    /// Whether the user stated it; otherwise it comes from a certificate or is typical of a rig.
    pub by_user: bool,
    /// Difference between the stated value and the data, in standard deviations of that difference.
    pub deviations: f64,
    /// Share of the prior in the fitted value.
    pub leverage: f64,
    /// Change of the prior's residual with the free parameter, in the units of the solver.
    pub slope: f64,
    /// What dropping the statement changes in each free parameter, in the units of the solver, to first order.
    pub shift: Vec<f64>,
}

impl Denial {
    /// The same deviations if the data's value also has a standard uncertainty `shared`, in the units of the solver, from
    /// errors that all observations share. The prior reduced it by its leverage.
    pub(in crate::fit) fn deviations_with(&self, shared: f64) -> f64 {
        let by_scatter = (1.0 - self.leverage).sqrt();
        self.deviations * by_scatter / by_scatter.hypot(self.slope * shared)
    }

    /// Whether a certificate of the material is contradicted.
    pub(in crate::fit) fn is_of_material(&self) -> bool {
        !self.by_user && matches!(self.quantity, Quantity::Eta | Quantity::K)
    }
}

/// Whether a contradiction of the material means something: a large model error is absorbed by a fitted index, and without
/// a lobe the light hardly depends on it.
pub(in crate::fit) fn determines_the_material(e: &Estimate<'_>) -> bool {
    e.discrepancy <= LOUD && e.no_lobe.is_none()
}

/// Standard deviations between stated value and data above which a contradiction is reported.
pub(in crate::fit) const DENIED: f64 = 4.0;
/// Largest leverage of a prior; a larger one would amplify rounding.
const LEVERAGE_MAX: f64 = 0.9996;

/// Lists stated values that the data contradict. A residual r = (x − prior)/σ with leverage h is reduced by its own
/// influence on the fit; r/√(1 − h) is the difference between data and prior in its standard deviations.
pub(in crate::fit) fn denials(e: &Estimate<'_>) -> Vec<Denial> {
    let (problem, end) = (&e.problem, &e.minimum);
    let rows = end.residuals.len();
    let first = rows.saturating_sub(problem.priors().len());
    let free = problem.free();
    if rows != problem.residual_count() || free.len() * rows != end.jacobian.len() {
        return Vec::new();
    }
    let covariance = covariance(&end.jacobian, rows, &end.residuals).matrix;
    let priors = problem.priors().iter().zip(first..);
    priors
        .filter_map(|((quantity, prior), row)| {
            let j = problem.column(*quantity)?;
            let slope = end.jacobian[row + j * rows];
            let leverage = (slope * slope * covariance[(j, j)]).clamp(0.0, LEVERAGE_MAX);
            let deviations = end.residuals[row].abs() / (1.0 - leverage).sqrt();
            let pull = slope * end.residuals[row] / (1.0 - leverage);
            (deviations > DENIED).then(|| Denial {
                shift: (0..free.len()).map(|k| covariance[(k, j)] * pull).collect(),
                quantity: *quantity,
                prior: *prior,
                by_user: problem
                    .stated()
                    .iter()
                    .any(|(stated, _)| stated == quantity),
                deviations,
                leverage,
                slope,
            })
        })
        .collect()
}
