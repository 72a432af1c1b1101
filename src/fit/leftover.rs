//! What is left of the residuals at a minimum once the parameters have taken up all they can.
//!
//! A suspect (a drift, a bad pose, a bad block) is a column beside the derivatives. What the parameters would explain of it is
//! projected out, so one linear step tells what it would take of χ² if all were fitted anew.
//!
//! *Conditioning.* Derivatives are scaled to length 1 and spanned by the singular vectors above 1e-10 of the greatest, so null
//! directions take nothing. A column that the parameters explain to 1 − 1e-8 of its square is rounding, and no suspect.

use nalgebra::{DMatrix, DVector};

use super::estimate::Estimate;
use super::problem::Quantity;

/// Share of a column's square that has to be left of it.
const LEFT_MIN: f64 = 1e-8;
/// Singular value, over the greatest, below which a direction is null.
const NULL: f64 = 1e-10;

/// Weighted residuals (observation less model) that no parameter explains.
#[derive(Debug, Clone)]
pub(super) struct Leftover {
    /// Orthonormal directions that are taken up, as columns.
    basis: Vec<DVector<f64>>,
    /// One per row of the problem: observations, flats, priors.
    pub residuals: DVector<f64>,
    /// Derivatives as they were put in, the gain's among them.
    pub jacobian: Vec<f64>,
    /// Signals over their weights: what a relative change of an observation changes.
    relative: Vec<f64>,
}

impl Leftover {
    /// Of an estimate; `None` where its minimum has no numbers. The gain of the samples over the flats is always among what
    /// is taken up.
    pub fn of(estimate: &Estimate<'_>) -> Option<Leftover> {
        let problem = &estimate.problem;
        let minimum = &estimate.minimum;
        let rows = problem.residual_count();
        let usable = rows > 0
            && minimum.residuals.len() == rows
            && minimum.jacobian.len() == rows * problem.free().len()
            && minimum
                .jacobian
                .iter()
                .chain(&minimum.residuals)
                .all(|v| v.is_finite());
        if !usable {
            return None;
        }
        let predicted = problem.predicted(&estimate.values);
        let relative: Vec<f64> = predicted
            .iter()
            .zip(problem.sigma())
            .map(|(p, s)| p / s)
            .collect();
        if relative.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let mut all = Leftover {
            basis: Vec::new(),
            residuals: -DVector::from_column_slice(&minimum.residuals),
            jacobian: minimum.jacobian.clone(),
            relative,
        };
        if !problem.free().contains(&Quantity::Scale) {
            let gain = all.column(|_| 1.0);
            all.jacobian.extend(gain.iter());
        }
        let columns = all.jacobian.len() / rows;
        let mut scaled = DMatrix::from_column_slice(rows, columns, &all.jacobian);
        for mut column in scaled.column_iter_mut() {
            let length = column.norm();
            if length > 0.0 {
                column /= length;
            }
        }
        let svd = scaled.svd(true, false);
        let u = svd.u?;
        let greatest = svd.singular_values.max();
        all.basis = (svd.singular_values.iter().enumerate())
            .filter(|(_, s)| **s > NULL * greatest)
            .map(|(k, _)| u.column(k).into_owned())
            .collect();
        all.residuals = all.without(&all.residuals);
        Some(all)
    }

    /// The column of a relative change of each observation.
    pub fn column(&self, of: impl Fn(usize) -> f64) -> DVector<f64> {
        let rows = self.relative.iter().enumerate().map(|(i, r)| r * of(i));
        let mut column: Vec<f64> = rows.collect();
        column.resize(self.residuals.len(), 0.0);
        DVector::from_vec(column)
    }

    /// What of a column is not taken up; nothing where that is rounding.
    pub fn without(&self, column: &DVector<f64>) -> DVector<f64> {
        let mut left = column.clone();
        // Twice is enough (Kahan and Parlett).
        for _ in 0..2 {
            for direction in &self.basis {
                let along = direction.dot(&left);
                left.axpy(-along, direction, 1.0);
            }
        }
        match left.norm_squared() > LEFT_MIN * column.norm_squared() {
            true => left,
            false => DVector::zeros(column.len()),
        }
    }

    /// Takes a column up as well; no if nothing of it is left to be.
    pub fn take(&mut self, column: &DVector<f64>) -> bool {
        let left = self.without(column);
        let Some(direction) = left.try_normalize(0.0) else {
            return false;
        };
        let along = direction.dot(&self.residuals);
        self.residuals.axpy(-along, &direction, 1.0);
        self.basis.push(direction);
        true
    }

    /// Sum of squares that is left.
    pub fn chi2(&self) -> f64 {
        self.residuals.norm_squared()
    }

    /// Rows less what is taken up.
    pub fn freedom(&self) -> f64 {
        self.residuals.len().saturating_sub(self.basis.len()) as f64
    }

    /// Share of row `i` that the parameters follow, 0 to 1.
    pub fn leverage(&self, i: usize) -> f64 {
        self.basis.iter().map(|d| d[i] * d[i]).sum()
    }

    /// Observations of the sample; their rows come first.
    pub fn observations(&self) -> usize {
        self.relative.len()
    }
}
