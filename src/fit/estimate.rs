//! One variant fitted to one set of observations: starts, descent, the size of the model's misfit.
//!
//! Counting noise is far below what a closed form misses, so weights by counting noise alone would
//! let the dimmest, worst modelled poses decide. Each observation's variance is therefore
//! σ² + d²·s², s = |signal| + a tenth of the peak, with the one number d chosen such that χ² equals
//! its degrees of freedom: d·s is the model's discrepancy.

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use super::least_squares::{householder, sum_of_squares};
use super::problem::{Problem, Quantity, Values, certified};
use super::solver::{Ending, Minimum, Settings, minimise};
use super::start::starts;
use crate::material::Material;
use crate::model::Variant;
use crate::observation::ObservationSet;

/// Share of the peak that the discrepancy's scale never falls below.
const DISCREPANCY_FLOOR: f64 = 0.1;
/// Discrepancy with which the starts are run, before the data have told it.
const FIRST_DISCREPANCY: f64 = 0.03;
/// χ² per observation at the first weights above which more starts are worth their time.
const SUSPICIOUS: f64 = 0.1;
/// How many times more.
const MORE_STARTS: usize = 4;
/// Rounds of discrepancy, weights and refit.
const ROUNDS: usize = 6;

/// How a run over several starts ended.
#[derive(Debug, Clone, PartialEq)]
pub struct StartReport {
    /// Starts tried.
    pub tried: usize,
    /// Starts that ended at the best minimum.
    pub at_minimum: usize,
    /// Starts that ended elsewhere although the solver calls them converged: other minima.
    pub elsewhere: usize,
    /// Starts that did not converge.
    pub not_converged: usize,
}

/// A fitted variant.
#[derive(Debug, Clone)]
pub struct Estimate<'a> {
    /// The problem with its final weights and corrections.
    pub problem: Problem<'a>,
    /// The minimum, in the solver's parameters.
    pub minimum: Minimum,
    /// All values, θr signed as the solver left it (see [`Values::folded`]).
    pub values: Values,
    /// Discrepancy d, as a share of s (see the module's head).
    pub discrepancy: f64,
    /// Standard uncertainty of each observation that stands for the model's misfit, d·s.
    pub misfit: Vec<f64>,
    /// What the starts did.
    pub starts: StartReport,
    /// χ² per degree of freedom with counting noise alone.
    pub chi2_reduced_without_model: f64,
    /// Root mean square residual of the samples as a share of the largest signal.
    pub rms_residual: f64,
    /// Free parameters without those that only move within a stated uncertainty.
    pub fitted: usize,
    /// How far the dear tier moved each free parameter (solver's units); zero without it.
    pub tier_shift: Vec<f64>,
}

/// What is free for a variant on a set, and the values of the rest.
#[must_use]
pub fn free_quantities(set: &ObservationSet, variant: Variant) -> (Vec<Quantity>, Values) {
    let absolute = set.white_reference.is_some();
    let metal = matches!(set.material, Material::Conductor { .. });
    let peak = peak(set);
    let (gain, background) = from_flats(set);
    let fixed = Values {
        theta_r: 0.0,
        alpha_u: 0.1,
        alpha_v: 0.1,
        rho_d: 0.0,
        scale: if absolute { gain } else { peak },
        background,
        azimuth_offset: 0.0,
        tilt_offset: 0.0,
        eta: set.material.index().0,
        k: set.material.index().1,
    };
    let free = Quantity::ALL
        .into_iter()
        .filter(|q| match q {
            // Metal sends nothing back from below. Printed lobe and free gain are one number.
            Quantity::RhoD => !metal && (absolute || variant == Variant::Sawtooth),
            // The flats carry the gain; a reference without flats leaves it at 1.
            Quantity::Scale => !absolute || !set.flats.is_empty(),
            _ => true,
        })
        .collect();
    (free, fixed)
}

/// Gain and stray light that the flats and the prior on stray light give at a tilt zero of 0, or
/// 1 and the prior's mean without flats.
fn from_flats(set: &ObservationSet) -> (f64, f64) {
    let prior = set.background;
    let Some(white) = set.white_reference.filter(|_| !set.flats.is_empty()) else {
        return (1.0, prior.mean);
    };
    // Normal equations of two unknowns.
    let weight = 1.0 / (prior.std * prior.std);
    let (mut aa, mut ab, mut bb) = (0.0, 0.0, weight);
    let (mut ay, mut by) = (0.0, weight * prior.mean);
    for flat in &set.flats {
        let a = white.reflectance / std::f64::consts::PI * set.rig.cos_incidence(flat.theta_c);
        let w = 1.0 / (flat.sigma * flat.sigma);
        aa += w * a * a;
        ab += w * a;
        bb += w;
        ay += w * a * flat.signal;
        by += w * flat.signal;
    }
    let determinant = aa * bb - ab * ab;
    let gain = (ay * bb - by * ab) / determinant;
    let background = (aa * by - ab * ay) / determinant;
    if gain.is_finite() && background.is_finite() && gain > 0.0 {
        (gain, background)
    } else {
        (1.0, prior.mean)
    }
}

/// Largest signal.
#[must_use]
pub fn peak(set: &ObservationSet) -> f64 {
    set.observations
        .iter()
        .map(|o| o.signal.abs())
        .fold(0.0, f64::max)
}

/// A dearer tier of the model: radiances to add to the closed form's at given values, one per
/// observation; `None` where it has nothing to say.
pub type Tier<'t> = &'t (dyn Fn(&Problem<'_>, &Values) -> Option<Vec<f64>> + Sync);

/// Fits one variant. `None` where nothing could be evaluated at all.
#[must_use]
pub fn estimate<'a>(
    set: &'a ObservationSet,
    variant: Variant,
    count: usize,
    seed: u32,
    tier: Option<Tier<'_>>,
    cancel: &AtomicBool,
) -> Option<Estimate<'a>> {
    let (free, fixed) = free_quantities(set, variant);
    let scale: Vec<f64> = {
        let floor = DISCREPANCY_FLOOR * peak(set);
        set.observations
            .iter()
            .map(|o| o.signal.abs() + floor)
            .collect()
    };
    let own: Vec<f64> = set.observations.iter().map(|o| o.sigma).collect();
    let weights = |d: f64| -> Vec<f64> {
        let both = own.iter().zip(&scale);
        both.map(|(o, s)| o.hypot(d * s)).collect()
    };
    // Flats at their full weight would drag a start about for the last digit of gain and tilt.
    let loose = set
        .flats
        .iter()
        .map(|f| f.sigma.hypot(FIRST_DISCREPANCY * f.signal));
    let first = Problem::new(set, variant, free, fixed)
        .with_sigma(weights(FIRST_DISCREPANCY))
        .with_flat_sigma(loose.collect());
    let settings = Settings::default();
    // The starts only have to find the basin; the rounds below polish.
    let rough = Settings {
        polish_steps: 20,
        max_iterations: 300,
        ..settings
    };
    let run = |count: usize, seed: u32| -> Vec<Minimum> {
        starts(&first, &fixed, count, seed)
            .par_iter()
            .map(|v| minimise(&first, &first.pack(v), &first.bounds(), &rough, cancel))
            .collect()
    };
    let mut runs = run(count, seed);
    let least = runs.iter().map(|m| m.cost).fold(f64::INFINITY, f64::min);
    // The full closed form misses real samples by far less than the first weights allow: more than
    // that says that no start found the lobe. The printed form often misses by so much anyway.
    if variant == Variant::Sawtooth && least > SUSPICIOUS * set.observations.len() as f64 {
        runs.extend(run(MORE_STARTS * count, seed.wrapping_add(1)));
    }
    let best = runs
        .iter()
        .filter(|m| m.cost.is_finite() && m.ending != Ending::NotFinite)
        .min_by(|a, b| a.cost.total_cmp(&b.cost))?
        .clone();
    let starts = weigh_starts(&runs, best.cost);
    // The starts leave the index at its nominal value; from here on it may move.
    let found = first.unpack(&best.parameters);
    let fitted = first.free().len();
    let mut free = first.free().to_vec();
    free.extend(certified(set));
    let mut problem = first.with_free(free).with_flat_sigma(flat_sigma(set));
    let bounds = problem.bounds();
    let mut minimum = best;
    minimum.parameters = problem.pack(&found);
    let mut discrepancy = FIRST_DISCREPANCY;
    let mut shift = vec![0.0; minimum.parameters.len()];
    let settle = |problem: &mut Problem<'a>, minimum: &mut Minimum, discrepancy: &mut f64| {
        for _ in 0..ROUNDS {
            let values = problem.unpack(&minimum.parameters);
            let residuals: Vec<f64> = problem
                .predicted(&values)
                .iter()
                .zip(&set.observations)
                .map(|(p, o)| p - o.signal)
                .collect();
            let next = discrepancy_of(&residuals, &own, &scale, fitted);
            let settled = (next - *discrepancy).abs() <= 1e-3 * next;
            *discrepancy = next;
            *problem = problem.clone().with_sigma(weights(next));
            let again = minimise(&*problem, &minimum.parameters, &bounds, &settings, cancel);
            *minimum = again;
            if settled || cancel.load(Ordering::Relaxed) {
                break;
            }
        }
    };
    settle(&mut problem, &mut minimum, &mut discrepancy);
    let misses = |problem: &Problem<'_>, minimum: &Minimum| -> f64 {
        let values = problem.unpack(&minimum.parameters);
        let predicted = problem.predicted(&values);
        let terms = predicted.iter().zip(&set.observations);
        terms.map(|(p, o)| ((p - o.signal) / o.sigma).powi(2)).sum()
    };
    if let Some(tier) = tier {
        let mut dear = (problem.clone(), minimum.clone(), discrepancy);
        let mut offsets = false;
        for _ in 0..2 {
            let values = dear.0.unpack(&dear.1.parameters);
            let Some(correction) = tier(&dear.0, &values) else {
                break;
            };
            dear.0 = dear.0.with_correction(correction);
            settle(&mut dear.0, &mut dear.1, &mut dear.2);
            offsets = true;
        }
        // A sample painted by the closed form itself would only be spoilt by the tier.
        let better = if dear.2 == 0.0 && discrepancy == 0.0 {
            misses(&dear.0, &dear.1) <= misses(&problem, &minimum)
        } else {
            dear.2 < discrepancy
        };
        if offsets && better {
            for (s, (a, b)) in shift
                .iter_mut()
                .zip(dear.1.parameters.iter().zip(&minimum.parameters))
            {
                *s = a - b;
            }
            (problem, minimum, discrepancy) = dear;
        }
    }
    let values = problem.unpack(&minimum.parameters);
    let predicted = problem.predicted(&values);
    let squares = |weight: &dyn Fn(usize) -> f64| -> f64 {
        let pairs = predicted.iter().zip(&set.observations).enumerate();
        pairs
            .map(|(i, (p, o))| ((p - o.signal) * weight(i)).powi(2))
            .sum()
    };
    let count = set.observations.len();
    let freedom = count.saturating_sub(fitted).max(1) as f64;
    let peak = peak(set);
    Some(Estimate {
        chi2_reduced_without_model: squares(&|i| 1.0 / own[i]) / freedom,
        rms_residual: (squares(&|_| 1.0 / peak) / count as f64).sqrt(),
        misfit: scale.iter().map(|s| discrepancy * s).collect(),
        discrepancy,
        fitted,
        starts,
        values,
        minimum,
        problem,
        tier_shift: shift,
    })
}

fn weigh_starts(runs: &[Minimum], best: f64) -> StartReport {
    let same = |m: &&Minimum| m.cost <= best + 1e-6 * best.max(1.0);
    let at_minimum = runs.iter().filter(same).count();
    let elsewhere = runs
        .iter()
        .filter(|m| !same(m) && m.ending.is_success())
        .count();
    StartReport {
        tried: runs.len(),
        at_minimum,
        elsewhere,
        not_converged: runs.len() - at_minimum - elsewhere,
    }
}

/// The d for which Σ r²/(σ² + d² s²) equals the degrees of freedom; 0 where σ alone suffices.
fn discrepancy_of(residuals: &[f64], sigma: &[f64], scale: &[f64], fitted: usize) -> f64 {
    let freedom = residuals.len().saturating_sub(fitted).max(1) as f64;
    let chi2 = |d: f64| -> f64 {
        residuals
            .iter()
            .zip(sigma)
            .zip(scale)
            .map(|((r, o), s)| r * r / (o * o + d * d * s * s))
            .sum()
    };
    if chi2(0.0) <= freedom {
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
fn flat_sigma(set: &ObservationSet) -> Vec<f64> {
    let own: Vec<f64> = set.flats.iter().map(|f| f.sigma).collect();
    let m = own.len();
    if m < 5 {
        return own;
    }
    let mut a = vec![0.0; 3 * m];
    let mut b = vec![0.0; m];
    for (i, flat) in set.flats.iter().enumerate() {
        let incident = set.rig.rig_directions(flat.theta_c).incident;
        for (j, column) in [1.0, incident.z, -incident.x].into_iter().enumerate() {
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
        let d = discrepancy_of(&residuals, &sigma, &scale, 2);
        let chi2: f64 = (0..6)
            .map(|i| residuals[i].powi(2) / (sigma[i].powi(2) + (d * scale[i]).powi(2)))
            .sum();
        assert!((chi2 - 4.0).abs() < 1e-9);
        assert_eq!(discrepancy_of(&residuals, &[1.0; 6], &scale, 2), 0.0);
    }
}
