//! All scans as one least-squares problem.

use crate::fit::least_squares::LeastSquares;
use crate::fit::least_squares::levenberg_marquardt::Bounds;
use crate::fit::problem::Problem;

/// All scans as one problem, with their rows stacked.
pub(super) struct Stacked<'j, 'a> {
    pub(super) problems: &'j [Problem<'a>],
    pub(super) columns: &'j [Vec<usize>],
    pub(super) n: usize,
}

impl LeastSquares for &Stacked<'_, '_> {
    fn n_parameters(&self) -> usize {
        self.n
    }

    fn n_residuals(&self) -> usize {
        self.problems.iter().map(Problem::residual_count).sum()
    }

    fn evaluate(&self, x: &[f64], residuals: &mut [f64], jacobian: &mut [f64]) {
        let m = residuals.len();
        jacobian.fill(0.0);
        let mut first = 0;
        for (problem, columns) in self.problems.iter().zip(self.columns) {
            let rows = problem.residual_count();
            let own: Vec<f64> = columns.iter().map(|c| x[*c]).collect();
            let mut slopes = vec![0.0; rows * own.len()];
            problem.evaluate(&own, &mut residuals[first..first + rows], &mut slopes);
            for (c, column) in columns.iter().zip(slopes.chunks_exact(rows)) {
                let at = c * m + first;
                jacobian[at..at + rows].copy_from_slice(column);
            }
            first += rows;
        }
    }
}

/// Bounds of all scans; for common parameters the intersection of their bounds.
pub(super) fn bounds(stacked: &Stacked<'_, '_>) -> Bounds {
    let mut all = Bounds::none(stacked.n);
    for (problem, columns) in stacked.problems.iter().zip(stacked.columns) {
        let own = problem.bounds();
        for (k, c) in columns.iter().enumerate() {
            all.lower[*c] = all.lower[*c].max(own.lower[k]);
            all.upper[*c] = all.upper[*c].min(own.upper[k]);
        }
    }
    all
}
