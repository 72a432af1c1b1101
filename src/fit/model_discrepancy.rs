//! Estimates the model error and the resulting weights of the observations.
//!
//! Counting noise is far below the error of a closed form. With weights by counting noise only, the dimmest poses,
//! which are modelled worst, would decide. The variance of each observation is therefore σ² + d²·s². The scale s is |signal|
//! plus a tenth of the peak ([`misfit_scale`]). The number d is chosen such that χ² equals its degrees of freedom
//! ([`discrepancy_of`]). d·s is the model discrepancy.

use super::least_squares::{householder, sum_of_squares};
use super::problem::{Problem, Values};
use super::{FitOptions, Loss};
use crate::model::Variant;
use crate::observation::ObservationSet;
use crate::robust::reduced_chi2_at;

/// Lower limit of the scale of the discrepancy, as a share of the peak.
const DISCREPANCY_FLOOR: f64 = 0.1;
/// Discrepancy above which a fit of the complete closed form missed the lobe, or the sample is not a sawtooth.
const UNEXPLAINED: f64 = 0.06;
/// Discrepancy above which a fit of the complete closed form warns that it describes another surface. Traced ideal
/// ridges up to 30° give a third of it.
pub(super) const LOUD: f64 = 0.03;
/// Rounds of discrepancy, weights and refit.
pub(super) const ROUNDS: usize = 6;
/// Median of χ² with one degree of freedom.
const MEDIAN_OF_CHI2: f64 = 0.454_936;
/// Variance of a normal sample's variance divided by that of its estimate from the median of squares.
const EFFICIENCY_OF_MEDIAN: f64 = 0.37;
/// Expected discrepancy of the complete closed form with its integrated second bounce. At the true parameters of traced
/// ridges (5° to 18°, plastic and metals), scans along one azimuth give 0.001 to 0.02: 0.003 in half of them, and less
/// than 0.009 in nine of ten.
const TYPICAL: f64 = 0.005;
/// Standard deviation of its logarithm.
const SPREAD: f64 = 0.8;
/// Number of poses that share one model error, which changes slowly from pose to pose.
const ALIKE: f64 = 4.0;
/// Degrees of freedom from which agreement with noise only is not accidental.
const NO_ACCIDENT: f64 = 5.0;
/// Degrees of freedom from which the residuals alone determine the model error.
const ENOUGH: f64 = 10.0;
/// Weight used for zero, so that every residual stays finite.
pub(super) const LEAST_WEIGHT: f64 = 1e-12;
/// Normal quantile exceeded once in four: a larger χ² is examined again.
const LIKELY: f64 = 0.674;
/// Normal quantile exceeded once in a thousand.
const RARE: f64 = 3.09;

/// Usual error of the closed form at the right surface, as a share of the signal and of the peak.
const USUAL: (f64, f64) = (7e-4, 4e-4);

/// Returns the usual error of the closed form at each observation, in the unit of the signals.
#[must_use]
pub fn usual_errors(set: &ObservationSet) -> Vec<f64> {
    let floor = USUAL.1 * peak(set);
    let signals = set.observations.iter().map(|o| o.signal);
    signals.map(|s| floor.hypot(USUAL.0 * s)).collect()
}

/// Largest signal.
#[must_use]
pub fn peak(set: &ObservationSet) -> f64 {
    set.observations
        .iter()
        .map(|o| o.signal.abs())
        .fold(0.0, f64::max)
}

/// Scale of the model error of each observation: its signal plus a tenth of the peak.
pub(super) fn misfit_scale(set: &ObservationSet) -> Vec<f64> {
    let floor = DISCREPANCY_FLOOR * peak(set);
    let signals = set.observations.iter().map(|o| o.signal.abs());
    signals.map(|s| s + floor).collect()
}

/// Weights of the observations by a loss at `values`.
pub(super) fn loss_weights(problem: &Problem<'_>, values: &Values, loss: Loss) -> Vec<f64> {
    let residuals = problem.signal_residuals(values).into_iter();
    let residuals = residuals.zip(problem.sigma());
    residuals.map(|(r, sigma)| loss.weight(r / sigma)).collect()
}

/// Standard uncertainties that give the observations these weights in least squares.
pub(super) fn lightened(sigma: &[f64], weights: &[f64]) -> Vec<f64> {
    let both = sigma.iter().zip(weights);
    both.map(|(s, w)| s / w.max(LEAST_WEIGHT).sqrt()).collect()
}

/// Whether noise, or a small model error, accounts for the scatter.
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
        cost <= freedom * reduced_chi2_at(freedom, RARE)
    }
}

/// Finds the d for which Σ r²/(σ² + d² s²) equals the degrees of freedom; 0 if σ alone suffices. With a robust loss the
/// median of r² replaces its mean.
pub(super) fn discrepancy_of(
    residuals: &[f64],
    sigma: &[f64],
    scale: &[f64],
    fitted: usize,
    loss: Loss,
) -> f64 {
    let freedom = freedom(residuals.len(), fitted);
    // A median scatters like a mean of fewer squares.
    let effective = match loss {
        Loss::Linear => freedom,
        Loss::Huber | Loss::Tukey => EFFICIENCY_OF_MEDIAN * freedom,
    };
    let chi2 = |d| chi2(residuals, sigma, scale, d, loss);
    if chi2(0.0) <= freedom * reduced_chi2_at(effective, LIKELY) {
        return 0.0;
    }
    root(|d| chi2(d) / freedom - 1.0)
}

/// Returns the d to use at the end of a fit whose residuals give `found` ([`discrepancy_of`]).
///
/// With few poses the free parameters absorb most of a model error, because both change slowly from pose to pose. The
/// remainder, which can be almost zero even for surfaces far from the true one, would then pass for all of it. In that
/// case d is at least the value that agrees best with both the residuals and [`TYPICAL`].
pub(super) fn discrepancy_of_few(
    found: f64,
    residuals: &[f64],
    sigma: &[f64],
    scale: &[f64],
    fitted: usize,
    loss: Loss,
) -> f64 {
    let freedom = freedom(residuals.len(), fitted);
    let none = found == 0.0 && (freedom >= NO_ACCIDENT || hidden(sigma, scale));
    if none || !few(freedom) {
        return found;
    }
    let weight = (1.0 - freedom / ENOUGH) / (SPREAD * SPREAD);
    let alike = freedom / ALIKE;
    let both = |d: f64| {
        let chi2 = chi2(residuals, sigma, scale, d, loss);
        alike * (chi2 / freedom - 1.0) - weight * (d / TYPICAL).ln()
    };
    found.max(root(both))
}

/// Whether the degrees of freedom are too few to determine the model error.
pub(super) fn few(freedom: f64) -> bool {
    freedom < ENOUGH
}

/// Degrees of freedom of this number of observations, at least 1.
pub(super) fn freedom(observations: usize, fitted: usize) -> f64 {
    observations.saturating_sub(fitted).max(1) as f64
}

/// Σ r²/(σ² + d² s²), or its equivalent with a robust loss.
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

/// Zero of a decreasing function of d ≥ 0; nearly 0 if the function is not positive at first.
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

/// Whether the noise is so large that a typical model error adds less than a twentieth to it.
fn hidden(sigma: &[f64], scale: &[f64]) -> bool {
    let shares = sigma
        .iter()
        .zip(scale)
        .map(|(o, s)| (TYPICAL * s / o).powi(2));
    shares.sum::<f64>() < 0.1 * sigma.len() as f64
}

/// Standard uncertainties of the flats. If the flats scatter by more than their counting noise (because of the lamp),
/// they are scaled by the Birge ratio of a fit of gain, stray light and tilt zero to the flats only. The sample is
/// excluded, because a variant that cannot describe it would change the stray light.
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
    // The entries below the triangle are the residuals in rotated axes.
    let chi2 = sum_of_squares(&b[3..]);
    let factor = (chi2 / (m - 3) as f64).sqrt().max(1.0);
    own.iter().map(|s| s * factor).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_discrepancy_sets_chi2_to_its_degrees_of_freedom_and_is_zero_if_noise_suffices() {
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
    fn few_residuals_do_not_lower_the_model_error_below_that_of_real_ridges() {
        let d_of = |count: usize, relative: f64| {
            let residuals: Vec<f64> = (0..count)
                .map(|i| relative * if i % 2 == 0 { 1.0 } else { -1.0 })
                .collect();
            let (sigma, scale) = (vec![1e-7; count], vec![1.0; count]);
            let found = discrepancy_of(&residuals, &sigma, &scale, 7, Loss::Linear);
            let few = discrepancy_of_few(found, &residuals, &sigma, &scale, 7, Loss::Linear);
            (found, few)
        };
        // Two degrees of freedom: the limit holds however well a surface fits the poses.
        let (found, floor) = d_of(9, 0.0);
        assert_eq!(found, 0.0);
        assert!(floor > 0.5 * TYPICAL && floor < TYPICAL, "{floor}");
        let (found, few) = d_of(9, 1e-4);
        assert!(found < 1e-3 && few >= floor, "{found} {few}");
        // A larger error is used as it is.
        let (found, few) = d_of(9, 0.02);
        assert_eq!(found, few);
        // The more poses, the more the residuals decide. With many poses they decide alone, and d is 0 if noise
        // explains them.
        let share = |count| {
            let (found, few) = d_of(count, 5e-4);
            few / found
        };
        let shares = [9, 11, 13, 15].map(share);
        assert!(shares.windows(2).all(|w| w[1] < w[0]), "{shares:?}");
        assert_eq!(share(18), 1.0);
        assert_eq!(d_of(13, 0.0), (0.0, 0.0));
        // Noise that hides the model error is left unchanged.
        let (residuals, sigma, scale) = ([0.5, -0.5, 0.5], [1.0; 3], [1.0; 3]);
        let noisy = discrepancy_of_few(0.0, &residuals, &sigma, &scale, 1, Loss::Linear);
        assert_eq!(noisy, 0.0);
    }
}
