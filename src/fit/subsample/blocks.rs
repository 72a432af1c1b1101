//! Descents over all observations, block by block.

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use super::ALL;
use crate::fit::least_squares::levenberg_marquardt;
use crate::fit::least_squares::levenberg_marquardt::{Bounds, Minimum, Settings};
use crate::fit::least_squares::{LeastSquares, householder, sum_of_squares};
use crate::fit::problem::Problem;

/// Rows that are reduced to one triangle at a time.
pub(super) const BLOCK: usize = 2048;

/// [`levenberg_marquardt::minimise`] for a problem of any size, with bounds that may be narrower than its own: block by block if it
/// has many observations.
pub(in crate::fit) fn minimise(
    problem: &Problem<'_>,
    start: &[f64],
    bounds: &Bounds,
    settings: &Settings,
    cancel: &AtomicBool,
) -> Minimum {
    if problem.set().observations.len() <= ALL {
        return levenberg_marquardt::minimise(problem, start, bounds, settings, cancel);
    }
    let mut minimum =
        levenberg_marquardt::minimise(Blocks(problem), start, bounds, settings, cancel);
    let rows = problem.residual_count();
    minimum.residuals = vec![0.0; rows];
    minimum.jacobian = vec![0.0; rows * problem.free().len()];
    problem.evaluate(
        &minimum.parameters,
        &mut minimum.residuals,
        &mut minimum.jacobian,
    );
    minimum
}

impl Problem<'_> {
    /// Descends from `start` inside the bounds of the problem.
    #[must_use]
    pub fn descend(&self, start: &[f64], settings: &Settings, cancel: &AtomicBool) -> Minimum {
        minimise(self, start, &self.bounds(), settings, cancel)
    }
}

/// A problem with few rows: the triangle R of [J r] = Q R has the same JᵀJ, Jᵀr and rᵀr, so a solver takes the same
/// steps with its columns.
pub(super) struct Blocks<'p, 'a>(pub(super) &'p Problem<'a>);

impl LeastSquares for Blocks<'_, '_> {
    fn n_parameters(&self) -> usize {
        self.0.free().len()
    }

    fn n_residuals(&self) -> usize {
        self.0.free().len() + 1
    }

    fn evaluate(&self, x: &[f64], residuals: &mut [f64], jacobian: &mut [f64]) {
        let problem = self.0;
        let (n, samples) = (problem.free().len(), problem.set().observations.len());
        let rest = problem.residual_count() - samples;
        let values = problem.unpack(x);
        let ready = problem.ready(&values);
        let blocks = samples.div_ceil(BLOCK);
        let triangles: Vec<Vec<f64>> = (0..=blocks)
            .into_par_iter()
            .map(|block| {
                let first = block * BLOCK;
                let count = if block < blocks {
                    BLOCK.min(samples - first)
                } else {
                    rest
                };
                let rows = count.max(n + 1);
                let mut a = vec![0.0; rows * (n + 1)];
                let (j, r) = a.split_at_mut(rows * n);
                if block < blocks {
                    let mut row = vec![0.0; n];
                    for i in 0..count {
                        r[i] = problem.sample_row(first + i, &ready, &values, &mut row);
                        for (k, d) in row.iter().enumerate() {
                            j[i + k * rows] = *d;
                        }
                    }
                } else {
                    problem.other_rows(&values, 0, rows, r, j);
                }
                triangle(a, rows, n + 1)
            })
            .collect();
        let rows = (n + 1) * triangles.len();
        let mut stacked = vec![0.0; rows * (n + 1)];
        for (b, t) in triangles.iter().enumerate() {
            for k in 0..=n {
                let from = &t[k * (n + 1)..(k + 1) * (n + 1)];
                stacked[k * rows + b * (n + 1)..][..=n].copy_from_slice(from);
            }
        }
        let all = triangle(stacked, rows, n + 1);
        jacobian.copy_from_slice(&all[..n * (n + 1)]);
        residuals.copy_from_slice(&all[n * (n + 1)..]);
    }
}

/// Computes the triangle R of a column-major m × n matrix, n × n. All entries are NaN if an entry is not finite or the
/// squares of a column overflow. Reflections are orthogonal, so R is as well conditioned as the matrix; its normal
/// equations would square the condition number.
pub(in crate::fit) fn triangle(mut a: Vec<f64>, m: usize, n: usize) -> Vec<f64> {
    if !sum_of_squares(&a).is_finite() {
        return vec![f64::NAN; n * n];
    }
    householder(&mut a, m, n, &mut vec![0.0; m]);
    let mut r = vec![0.0; n * n];
    for j in 0..n {
        r[j * n..=j * n + j].copy_from_slice(&a[j * m..=j * m + j]);
    }
    if r.iter().any(|v| !v.is_finite()) {
        return vec![f64::NAN; n * n];
    }
    r
}
