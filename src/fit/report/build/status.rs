//! The status of a fit: whether its end is a minimum that the data determine.

use nalgebra::DVector;

use super::{HOPELESS_ANGLE, HOPELESS_LOG_ALPHA};
use crate::fit::estimate::Estimate;
use crate::fit::least_squares::levenberg_marquardt::{Ending, Minimum};
use crate::fit::problem::Quantity;
use crate::fit::report::Status;
use crate::fit::uncertainty::budget::Uncertainty;

/// Decrease of the cost promised by a further step, below which an end counts as a minimum: a thousandth of a standard
/// uncertainty away.
const AT_BOTTOM: f64 = 1e-6;

/// Derives the status of an end.
pub(in crate::fit) fn status(e: &Estimate<'_>, uncertainty: &Uncertainty) -> Status {
    let ending = match e.minimum.ending {
        // In a flat valley the cost stops falling before the steps are short.
        Ending::ConvergedByCost | Ending::Stalled | Ending::MaxIterations
            if promised(&e.minimum, uncertainty) <= AT_BOTTOM =>
        {
            Ending::ConvergedByGradient
        }
        ending => ending,
    };
    match ending {
        Ending::Cancelled => Status::Cancelled,
        Ending::NotFinite => Status::NotFinite,
        _ if !uncertainty.covariance.null_directions.is_empty() => Status::RankDeficient,
        Ending::RankDeficient => Status::RankDeficient,
        Ending::ConvergedByStep | Ending::ConvergedByGradient if !e.explained => Status::Stalled,
        _ if shape_unknown(e, uncertainty) => Status::RankDeficient,
        Ending::ConvergedByStep | Ending::ConvergedByGradient if !e.minimum.at_bound.is_empty() => {
            Status::AtBound
        }
        Ending::ConvergedByStep | Ending::ConvergedByGradient => Status::Converged,
        Ending::ConvergedByCost | Ending::Stalled | Ending::MaxIterations => Status::Stalled,
    }
}

/// Predicts by how much one more step lowers the cost, from the derivatives at an end: gᵀ C g.
pub(super) fn promised(end: &Minimum, uncertainty: &Uncertainty) -> f64 {
    let (m, n) = (end.residuals.len(), end.parameters.len());
    let covariance = &uncertainty.covariance.matrix;
    if end.jacobian.len() != m * n || covariance.nrows() != n {
        return f64::INFINITY;
    }
    let columns = end.jacobian.chunks_exact(m.max(1));
    let along = |column: &[f64]| column.iter().zip(&end.residuals).map(|(j, r)| j * r).sum();
    let gradient = DVector::from_iterator(n, columns.map(along));
    gradient.dot(&(covariance * &gradient))
}

/// Whether ridge angle or roughness is practically undetermined, which is equivalent to a null direction.
fn shape_unknown(e: &Estimate<'_>, u: &Uncertainty) -> bool {
    e.problem.free().iter().enumerate().any(|(j, q)| {
        let limit = match q {
            Quantity::ThetaR => HOPELESS_ANGLE,
            Quantity::AlphaU | Quantity::AlphaV => HOPELESS_LOG_ALPHA,
            _ => return false,
        };
        let std = u.budgets[j].combined();
        std.is_nan() || std >= limit
    })
}
