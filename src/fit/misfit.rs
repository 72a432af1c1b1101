//! How far a model misses what it is fitted to: the size of that, and the weights it leaves the observations.
//!
//! Counting noise is far below what a closed form misses, so weights by counting noise alone would
//! let the dimmest, worst modelled poses decide. Each observation's variance is therefore
//! σ² + d²·s², s = |signal| + a tenth of the peak ([`misfit_scale`]), with the one number d chosen such that χ²
//! equals its degrees of freedom ([`discrepancy_of`]): d·s is the model's discrepancy.

use super::least_squares::{householder, sum_of_squares};
use super::problem::{Problem, Values};
use super::{FitOptions, Loss};
use crate::model::Variant;
use crate::observation::ObservationSet;

/// Share of the peak that the discrepancy's scale never falls below.
const DISCREPANCY_FLOOR: f64 = 0.1;
/// Discrepancy above which a fit of the full closed form has missed the lobe, or the sample is no
/// sawtooth.
const UNEXPLAINED: f64 = 0.06;
/// Discrepancy above which a fit of the full closed form says aloud that it describes another
/// surface: ideal ridges up to 30°, traced, are fitted to a third of it.
pub(super) const LOUD: f64 = 0.03;
/// Rounds of discrepancy, weights and refit.
pub(super) const ROUNDS: usize = 6;
/// Median of χ² with one degree of freedom.
const MEDIAN_OF_CHI2: f64 = 0.454_936;
/// Variance of a normal sample's variance over that of its estimate by the median of squares.
const EFFICIENCY_OF_MEDIAN: f64 = 0.37;
/// Weight that stands for none, so that every residual stays finite.
pub(super) const LEAST_WEIGHT: f64 = 1e-12;
/// Normal quantile that one in four passes: a χ² above it is looked at once more.
pub(super) const LIKELY: f64 = 0.674;
/// Normal quantile that one in twenty passes.
pub(super) const SELDOM: f64 = 1.645;
/// Normal quantile that one in a thousand passes.
pub(super) const RARE: f64 = 3.09;

/// Largest signal.
#[must_use]
pub fn peak(set: &ObservationSet) -> f64 {
    set.observations
        .iter()
        .map(|o| o.signal.abs())
        .fold(0.0, f64::max)
}

/// Scale on which the model may miss each observation: its signal and a tenth of the peak.
pub(super) fn misfit_scale(set: &ObservationSet) -> Vec<f64> {
    let floor = DISCREPANCY_FLOOR * peak(set);
    let signals = set.observations.iter().map(|o| o.signal.abs());
    signals.map(|s| s + floor).collect()
}

/// Weight that a loss leaves each observation at `values`.
pub(super) fn loss_weights(problem: &Problem<'_>, values: &Values, loss: Loss) -> Vec<f64> {
    let predicted = problem.predicted(values);
    let pairs = predicted.iter().zip(&problem.set().observations);
    let residuals = pairs.map(|(p, o)| p - o.signal).zip(problem.sigma());
    residuals.map(|(r, sigma)| loss.weight(r / sigma)).collect()
}

/// Standard uncertainties with which least squares give each observation that weight.
pub(super) fn lightened(problem: &Problem<'_>, weights: &[f64]) -> Vec<f64> {
    let both = problem.sigma().iter().zip(weights);
    both.map(|(s, w)| s / w.max(LEAST_WEIGHT).sqrt()).collect()
}

/// Whether the scatter is what noise, or a small misfit of the model, accounts for.
pub(super) fn explained(
    variant: Variant,
    options: &FitOptions,
    discrepancy: f64,
    cost: f64,
    freedom: f64,
) -> bool {
    if options.misfit {
        variant == Variant::Paper || discrepancy <= UNEXPLAINED
    } else {
        cost <= freedom * chance(freedom, RARE)
    }
}

/// χ²/ν that noise alone passes as seldom as a normal variable passes `quantile` (Wilson and Hilferty
/// 1931).
pub(super) fn chance(freedom: f64, quantile: f64) -> f64 {
    let spread = 2.0 / (9.0 * freedom);
    (1.0 - spread + quantile * spread.sqrt()).powi(3)
}

/// The d for which Σ r²/(σ² + d² s²) equals the degrees of freedom; 0 where σ alone suffices.
/// With a robust loss the median of r² stands for its mean.
pub(super) fn discrepancy_of(
    residuals: &[f64],
    sigma: &[f64],
    scale: &[f64],
    fitted: usize,
    loss: Loss,
) -> f64 {
    let freedom = residuals.len().saturating_sub(fitted).max(1) as f64;
    let chi2 = |d: f64| -> f64 {
        let squares = residuals
            .iter()
            .zip(sigma)
            .zip(scale)
            .map(|((r, o), s)| r * r / (o * o + d * d * s * s));
        if loss == Loss::Linear {
            return squares.sum();
        }
        let mut squares: Vec<f64> = squares.collect();
        squares.sort_by(f64::total_cmp);
        squares[squares.len() / 2] / MEDIAN_OF_CHI2 * squares.len() as f64
    };
    // A median scatters like a mean of fewer squares.
    let told_by = match loss {
        Loss::Linear => freedom,
        Loss::Huber | Loss::Tukey => EFFICIENCY_OF_MEDIAN * freedom,
    };
    if chi2(0.0) <= freedom * chance(told_by, LIKELY) {
        return 0.0;
    }
    let (mut low, mut high) = (0.0, 1e-6);
    while chi2(high) > freedom && high < 1e6 {
        low = high;
        high *= 4.0;
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if chi2(middle) > freedom {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// Standard uncertainties of the flats: where they scatter by more than their counting noise (the
/// lamp does), scaled by the Birge ratio of a fit of gain, stray light and tilt zero to them alone. A
/// sample that its variant cannot describe has no say in it, or it would pull the stray light along.
pub(super) fn flat_sigma(set: &ObservationSet) -> Vec<f64> {
    let own: Vec<f64> = set.flats.iter().map(|f| f.sigma).collect();
    let m = own.len();
    if m < 5 {
        return own;
    }
    let mut a = vec![0.0; 3 * m];
    let mut b = vec![0.0; m];
    for (i, flat) in set.flats.iter().enumerate() {
        let (cos, slope) = set.rig.cos_incidence_and_slope(flat.theta_c);
        for (j, column) in [1.0, cos, slope].into_iter().enumerate() {
            a[i + j * m] = column / flat.sigma;
        }
        b[i] = flat.signal / flat.sigma;
    }
    householder(&mut a, m, 3, &mut b);
    // What is left below the triangle are the residuals in other axes.
    let chi2 = sum_of_squares(&b[3..]);
    let factor = (chi2 / (m - 3) as f64).sqrt().max(1.0);
    own.iter().map(|s| s * factor).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_discrepancy_brings_chi2_to_its_degrees_of_freedom_and_is_zero_where_noise_suffices() {
        let residuals = [0.3, -0.2, 0.25, -0.3, 0.1, 0.2];
        let (sigma, scale) = ([0.01; 6], [1.0, 2.0, 1.0, 1.5, 1.0, 1.0]);
        let d = discrepancy_of(&residuals, &sigma, &scale, 2, Loss::Linear);
        let chi2: f64 = (0..6)
            .map(|i| residuals[i].powi(2) / (sigma[i].powi(2) + (d * scale[i]).powi(2)))
            .sum();
        assert!((chi2 - 4.0).abs() < 1e-9);
        assert_eq!(
            discrepancy_of(&residuals, &[1.0; 6], &scale, 2, Loss::Linear),
            0.0
        );
    }
}
