//! Minima at a kink of the residuals, where no slope vanishes.
//!
//! What stands along the ridges is shadowed by either flank or by the other: visibility has a kink there, and the cost may
//! have its minimum on it, rising to both sides while every further step promises a gain. Such a parameter is held where
//! it is, the others are polished around it, and the end counts if the cost still rises to both its sides.

use argmin::core::{Error, Problem};

use super::{LeastSquares, LevenbergMarquardt};

/// How far to both sides of a point its slopes are looked at, as a share of ‖D x‖.
const ASIDE: f64 = 1e-10;

impl LevenbergMarquardt<'_> {
    /// Parameters to whose both sides the cost rises, within a distance that is none.
    pub(super) fn kinks<P: LeastSquares>(
        &mut self,
        problem: &mut Problem<P>,
    ) -> Result<Vec<bool>, Error> {
        let mut kinks = self.within_bounds();
        let size = self.size();
        for (j, kink) in kinks.iter_mut().enumerate().filter(|(_, free)| **free) {
            let aside = ASIDE * size / self.scale[j];
            let above = self.slope_beside(problem, j, aside)?;
            let below = self.slope_beside(problem, j, -aside)?;
            *kink = below < 0.0 && above > 0.0;
        }
        Ok(kinks)
    }

    /// Half the cost's derivative by a parameter, a step along it.
    fn slope_beside<P: LeastSquares>(
        &mut self,
        problem: &mut Problem<P>,
        j: usize,
        step: f64,
    ) -> Result<f64, Error> {
        self.trial_x.copy_from_slice(&self.x);
        self.trial_x[j] += step;
        self.bounds.clamp(&mut self.trial_x);
        self.evaluate(problem)?;
        let column = &self.trial_j[j * self.m..(j + 1) * self.m];
        Ok(column.iter().zip(&self.trial_r).map(|(a, b)| a * b).sum())
    }
}
