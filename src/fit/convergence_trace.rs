//! Follows a fit over time: each trial step of a descent, and limits on the duration of a fit.
//!
//! Call [`retrace`]. A fit runs many descents at once, so their shared steps show nothing. One descent is therefore
//! repeated with the final weights, from the most promising start to the minimum, and every evaluation of the model is
//! recorded. The caller provides the clock ([`Time`]).

use std::cell::RefCell;
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use super::estimate::Estimate;
use super::least_squares::levenberg_marquardt::{Settings, minimise};
use super::least_squares::{LeastSquares, norm, sum_of_squares};
use super::multistart::starts::starts;
use super::problem::Problem;
use super::uncertainty::budget::Uncertainty;

/// The caller's clock and time limit.
#[derive(Clone, Copy)]
pub struct Time<'t> {
    /// Seconds since the fit began.
    pub now: &'t (dyn Fn() -> f64 + Sync),
    /// Time after which optional work ends: the search for other explanations and the bootstrap. `None`: never.
    pub limit_s: Option<f64>,
    /// Whether to retrace a descent.
    pub retrace: bool,
}

impl Time<'_> {
    /// Whether there is time left.
    #[must_use]
    pub fn allows(&self) -> bool {
        self.limit_s.is_none_or(|limit| (self.now)() < limit)
    }
}

/// One evaluation of the model on the way to the minimum.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = FitIteration)]
pub struct Iteration {
    /// Time since the first one.
    pub seconds: f64,
    /// Sum of squared weighted residuals.
    pub cost: f64,
    /// Largest cosine between the residuals and the derivatives of a parameter: 0 at a minimum.
    pub gradient: f64,
    /// Largest step of a parameter from the last accepted point, in its standard uncertainty.
    pub step: f64,
    /// Largest distance of a parameter from the end of the descent, in its standard uncertainty.
    pub error: f64,
    /// Whether the cost is no higher than at all points before.
    pub accepted: bool,
}

/// Recorded values until the end of the descent is known.
struct Note {
    seconds: f64,
    cost: f64,
    gradient: f64,
    parameters: Vec<f64>,
}

/// A problem that records its evaluations.
struct Noting<'n, 'p, 't> {
    problem: &'n Problem<'p>,
    time: Time<'t>,
    started: f64,
    notes: RefCell<Vec<Note>>,
}

impl LeastSquares for &Noting<'_, '_, '_> {
    fn n_parameters(&self) -> usize {
        self.problem.n_parameters()
    }

    fn n_residuals(&self) -> usize {
        self.problem.n_residuals()
    }

    fn evaluate(&self, x: &[f64], residuals: &mut [f64], jacobian: &mut [f64]) {
        self.problem.evaluate(x, residuals, jacobian);
        let length = norm(residuals);
        let cosine = |column: &[f64]| {
            let dot: f64 = column
                .iter()
                .zip(residuals.iter())
                .map(|(a, b)| a * b)
                .sum();
            let size = norm(column) * length;
            if size > 0.0 { (dot / size).abs() } else { 0.0 }
        };
        self.notes.borrow_mut().push(Note {
            seconds: (self.time.now)() - self.started,
            cost: sum_of_squares(residuals),
            gradient: jacobian
                .chunks_exact(residuals.len().max(1))
                .map(cosine)
                .fold(0.0, f64::max),
            parameters: x.to_vec(),
        });
    }
}

/// Repeats a descent to an estimate with its final weights and records each step.
#[must_use]
pub fn retrace(
    e: &Estimate<'_>,
    u: &Uncertainty,
    seed: u32,
    time: Time<'_>,
    cancel: &AtomicBool,
) -> Vec<Iteration> {
    let mut fallback = e.values;
    (fallback.azimuth_offset, fallback.tilt_offset) = (0.0, 0.0);
    let Some(start) = starts(&e.problem, &fallback, 1, seed).into_iter().next() else {
        return Vec::new();
    };
    let noting = Noting {
        problem: &e.problem,
        time,
        started: (time.now)(),
        notes: RefCell::new(Vec::new()),
    };
    let end = minimise(
        &noting,
        &e.problem.pack(&start),
        &e.problem.bounds(),
        &Settings::default(),
        cancel,
    );
    let std: Vec<f64> = u.budgets.iter().map(|b| b.combined()).collect();
    // In standard uncertainties of the parameter. Undetermined parameters do not count.
    let distance = |a: &[f64], b: &[f64]| -> f64 {
        a.iter()
            .zip(b)
            .zip(&std)
            .map(|((a, b), s)| (a - b).abs() / s)
            .filter(|d| d.is_finite())
            .fold(0.0, f64::max)
    };
    let mut last: Option<(f64, Vec<f64>)> = None;
    let mut iterations = Vec::new();
    for note in noting.notes.into_inner() {
        let accepted = last.as_ref().is_none_or(|(cost, _)| note.cost <= *cost);
        iterations.push(Iteration {
            seconds: note.seconds,
            cost: note.cost,
            gradient: note.gradient,
            step: last
                .as_ref()
                .map_or(0.0, |(_, x)| distance(&note.parameters, x)),
            error: distance(&note.parameters, &end.parameters),
            accepted,
        });
        if accepted {
            last = Some((note.cost, note.parameters));
        }
    }
    iterations
}
