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
/// Discrepancy to be expected of the full closed form with its second bounce integrated. At the true parameters of traced
/// ridges (5° to 18°, plastic and metals) it leaves 0.001 to 0.02 in a scan along one azimuth, 0.003 in half of them and less
/// than 0.009 in nine of ten.
const TYPICAL: f64 = 0.005;
/// Spread of its logarithm.
const SPREAD: f64 = 0.8;
/// Poses that share one misfit: it changes slowly from pose to pose.
const ALIKE: f64 = 4.0;
/// Degrees of freedom from which on it is no accident that noise alone explains what is left.
const NO_ACCIDENT: f64 = 5.0;
/// Degrees of freedom from which on the residuals alone say how far the model misses.
const ENOUGH: f64 = 10.0;
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
    let freedom = freedom(residuals.len(), fitted);
    // A median scatters like a mean of fewer squares.
    let told_by = match loss {
        Loss::Linear => freedom,
        Loss::Huber | Loss::Tukey => EFFICIENCY_OF_MEDIAN * freedom,
    };
    let chi2 = |d| chi2(residuals, sigma, scale, d, loss);
    if chi2(0.0) <= freedom * chance(told_by, LIKELY) {
        return 0.0;
    }
    root(|d| chi2(d) / freedom - 1.0)
}

/// The d to go by at the end of a fit whose residuals tell `told` ([`discrepancy_of`]).
///
/// Of few poses the free parameters take up most of a misfit, since it changes as slowly from pose to pose as they let the
/// model do; what is left, and there are surfaces far from the true one that leave hardly any, would then pass for all of
/// it. So there d is at least what goes best with both the residuals and [`TYPICAL`].
pub(super) fn discrepancy_of_few(
    told: f64,
    residuals: &[f64],
    sigma: &[f64],
    scale: &[f64],
    fitted: usize,
    loss: Loss,
) -> f64 {
    let freedom = freedom(residuals.len(), fitted);
    let none = told == 0.0 && (freedom >= NO_ACCIDENT || hidden(sigma, scale));
    if none || !few(freedom) {
        return told;
    }
    let weight = (1.0 - freedom / ENOUGH) / (SPREAD * SPREAD);
    let alike = freedom / ALIKE;
    let both = |d: f64| {
        let chi2 = chi2(residuals, sigma, scale, d, loss);
        alike * (chi2 / freedom - 1.0) - weight * (d / TYPICAL).ln()
    };
    told.max(root(both))
}

/// Whether degrees of freedom are too few to tell how far the model misses.
pub(super) fn few(freedom: f64) -> bool {
    freedom < ENOUGH
}

/// Degrees of freedom that so many observations leave, 1 at least.
pub(super) fn freedom(observations: usize, fitted: usize) -> f64 {
    observations.saturating_sub(fitted).max(1) as f64
}

/// Σ r²/(σ² + d² s²), or what stands for it with a robust loss.
fn chi2(residuals: &[f64], sigma: &[f64], scale: &[f64], d: f64, loss: Loss) -> f64 {
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
}

/// Where a falling function of d ≥ 0 passes through zero; next to 0 where it does not begin above.
fn root(excess: impl Fn(f64) -> f64) -> f64 {
    let (mut low, mut high) = (0.0, 1e-6);
    while excess(high) > 0.0 && high < 1e6 {
        low = high;
        high *= 4.0;
    }
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if excess(middle) > 0.0 {
            low = middle;
        } else {
            high = middle;
        }
    }
    0.5 * (low + high)
}

/// Whether the observations' own uncertainty is so large that a usual misfit adds less than a twentieth to it.
fn hidden(sigma: &[f64], scale: &[f64]) -> bool {
    let shares = sigma
        .iter()
        .zip(scale)
        .map(|(o, s)| (TYPICAL * s / o).powi(2));
    shares.sum::<f64>() < 0.1 * sigma.len() as f64
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

    #[test]
    fn few_residuals_do_not_say_that_the_form_misses_less_than_it_does_on_real_ridges() {
        let d_of = |count: usize, relative: f64| {
            let residuals: Vec<f64> = (0..count)
                .map(|i| relative * if i % 2 == 0 { 1.0 } else { -1.0 })
                .collect();
            let (sigma, scale) = (vec![1e-7; count], vec![1.0; count]);
            let told = discrepancy_of(&residuals, &sigma, &scale, 7, Loss::Linear);
            let few = discrepancy_of_few(told, &residuals, &sigma, &scale, 7, Loss::Linear);
            (told, few)
        };
        // Two degrees of freedom: however well a surface passes through the poses.
        let (told, floor) = d_of(9, 0.0);
        assert_eq!(told, 0.0);
        assert!(floor > 0.5 * TYPICAL && floor < TYPICAL, "{floor}");
        let (told, few) = d_of(9, 1e-4);
        assert!(told < 1e-3 && few >= floor, "{told} {few}");
        // What is missed by more is what it is.
        let (told, few) = d_of(9, 0.02);
        assert_eq!(told, few);
        // The more poses, the more they say themselves; of many they say all, and where noise explains them it does.
        let share = |count| {
            let (told, few) = d_of(count, 5e-4);
            few / told
        };
        let shares = [9, 11, 13, 15].map(share);
        assert!(shares.windows(2).all(|w| w[1] < w[0]), "{shares:?}");
        assert_eq!(share(18), 1.0);
        assert_eq!(d_of(13, 0.0), (0.0, 0.0));
        // Noise that hides what the form misses is left as it is.
        let (residuals, sigma, scale) = ([0.5, -0.5, 0.5], [1.0; 3], [1.0; 3]);
        let noisy = discrepancy_of_few(0.0, &residuals, &sigma, &scale, 1, Loss::Linear);
        assert_eq!(noisy, 0.0);
    }
}
