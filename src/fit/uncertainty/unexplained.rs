//! The part of the residuals at a minimum that the parameters cannot explain.
//!
//! A suspected cause (a drift, a bad pose, a bad block) is a column next to the derivatives. The part that the
//! parameters would explain is projected out, so one linear step gives the decrease of χ² if everything were fitted
//! again.
//!
//! *Conditioning.* Derivatives are scaled to length 1 and spanned by the singular vectors above 1e-10 of the greatest,
//! so null directions explain nothing. A column that the parameters explain to 1 − 1e-8 of its square is rounding and
//! is ignored.

use nalgebra::{DMatrix, DVector};

use crate::fit::estimate::Estimate;
use crate::fit::model_discrepancy::usual_errors;
use crate::fit::problem::Quantity;
use crate::robust;

/// Smallest share of a column's square that has to remain.
const LEFT_MIN: f64 = 1e-8;
/// Singular value, relative to the greatest, below which a direction is null.
const NULL: f64 = 1e-10;

/// Weighted residuals (observation minus model) that no parameter explains.
#[derive(Debug, Clone)]
pub(in crate::fit) struct Leftover {
    /// Orthonormal directions that are projected out, as columns.
    basis: Vec<DVector<f64>>,
    /// One per row of the problem: observations, flats, priors.
    pub residuals: DVector<f64>,
    /// Derivatives before scaling, including that of the gain.
    pub jacobian: Vec<f64>,
    /// Signals of observations and flats divided by their standard uncertainties: the effect of a relative change.
    relative: Vec<f64>,
    observations: usize,
}

impl Leftover {
    /// Computes it for an estimate; `None` if its minimum has values that are not finite. The gain of the samples
    /// relative to the flats is always among the projected directions.
    pub fn of(estimate: &Estimate<'_>) -> Option<Leftover> {
        Leftover::weighted(estimate, &[])
    }

    /// Computes it with less weight for observations that change much within the stated uncertainty of the stages or by the
    /// usual error of the closed form: every pose has an error of its own, and on the flank of a narrow lobe its effect exceeds
    /// the scatter of the other poses.
    pub fn of_steady_poses(estimate: &Estimate<'_>) -> Option<Leftover> {
        let all = Leftover::of(estimate)?;
        let scale = all.scale(0..all.observations())?;
        if scale <= 0.0 {
            return Some(all);
        }
        let problem = &estimate.problem;
        let usual = usual_errors(problem.set()).into_iter().zip(problem.sigma());
        let by_form = usual.map(|(error, sigma)| error / sigma);
        let each = estimate.by_stages().into_iter().zip(by_form);
        let weights: Vec<f64> = each
            .map(|(by_stages, by_form)| 1.0 / (by_stages.hypot(by_form) / scale).hypot(1.0))
            .collect();
        Leftover::weighted(estimate, &weights)
    }

    /// The same with the rows of the observations multiplied by `weights`; all rows are kept as they are if it is empty.
    fn weighted(estimate: &Estimate<'_>, weights: &[f64]) -> Option<Leftover> {
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
        let weight = |row: usize| weights.get(row).copied().unwrap_or(1.0);
        let relative = predicted.iter().zip(problem.sigma()).enumerate();
        let mut relative: Vec<f64> = relative.map(|(i, (p, s))| weight(i) * p / s).collect();
        let observations = relative.len();
        let flats = problem.flat_sigma().iter().enumerate();
        relative.extend(flats.map(|(k, s)| problem.flat_signal(k, &estimate.values) / s));
        if relative.iter().any(|v| !v.is_finite()) {
            return None;
        }
        let mut all = Leftover {
            basis: Vec::new(),
            residuals: -DVector::from_column_slice(&minimum.residuals),
            jacobian: minimum.jacobian.clone(),
            relative,
            observations,
        };
        for (row, weight) in weights.iter().enumerate() {
            all.residuals[row] *= weight;
            let derivatives = all.jacobian.iter_mut().skip(row).step_by(rows);
            derivatives.for_each(|v| *v *= weight);
        }
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

    /// Builds the column of a relative change of each observation.
    pub fn column(&self, of: impl Fn(usize) -> f64) -> DVector<f64> {
        let shares: Vec<f64> = (0..self.observations).map(of).collect();
        self.column_of(&shares)
    }

    /// Builds the column of relative changes of the observations and then of the flats; those beyond the list do not change.
    pub fn column_of(&self, shares: &[f64]) -> DVector<f64> {
        let rows = self.relative.iter().zip(shares).map(|(r, share)| r * share);
        let mut column: Vec<f64> = rows.collect();
        column.resize(self.residuals.len(), 0.0);
        DVector::from_vec(column)
    }

    /// Builds the column of a change of observation `i` only.
    pub fn row(&self, i: usize) -> DVector<f64> {
        let mut column = DVector::zeros(self.residuals.len());
        column[i] = 1.0;
        column
    }

    /// Returns the part of a column that remains after the projection; zero if it is rounding.
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

    /// Projects out one more column; returns `false` if nothing of it remains.
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

    /// Remaining sum of squares.
    pub fn chi2(&self) -> f64 {
        self.residuals.norm_squared()
    }

    /// Rows minus projected directions.
    pub fn freedom(&self) -> f64 {
        self.residuals.len().saturating_sub(self.basis.len()) as f64
    }

    /// Share of row `i` that the parameters follow, 0 to 1.
    pub fn leverage(&self, i: usize) -> f64 {
        self.basis.iter().map(|d| d[i] * d[i]).sum()
    }

    /// Residual of observation `i`, in units that are the same for all if they scatter alike.
    pub fn size(&self, i: usize) -> f64 {
        let open = 1.0 - self.leverage(i);
        self.residuals[i].abs() / open.max(f64::EPSILON).sqrt()
    }

    /// Robust standard deviation of some observations; `None` of none.
    pub fn scale(&self, observations: impl Iterator<Item = usize>) -> Option<f64> {
        let mut sizes: Vec<f64> = observations.map(|i| self.size(i)).collect();
        Some(robust::median(&mut sizes)? / robust::MEDIAN_OF_ABS)
    }

    /// Number of sample observations; their rows come first.
    pub fn observations(&self) -> usize {
        self.observations
    }
}
