//! Fits very large sets of observations, of which only the descent can use all.
//!
//! A search evaluates every observation about ten thousand times, and an integration costs a thousand closed forms per
//! pose. Neither needs a million observations. Above [`ALL`] observations, therefore:
//!
//! - Repeats of one pose become one observation, their weighted mean ([`merged`]). This is exact for least squares;
//!   their scatter is kept for χ².
//! - The search for the lobe and the minima, and the decision on the higher order, use a subset: [`SPREAD`]
//!   observations spread over the poses, and the brightest of each neighbourhood.
//! - The last descent, the weights and the uncertainties use all observations, block by block. Each block of rows of
//!   the derivatives is reduced to a triangle, so that no copy of the whole is made. The solver works on a problem of a
//!   few rows with the same cost, gradient and steps.
//! - The higher order is integrated on a grid of poses and interpolated. The grid is refined until it agrees with
//!   poses in between.
//!
//! [`super::one_variant`] does so, and [`Thinned`](super::estimate::Thinned) records what was left out.
//!
//! *Conditioning.* Repeats are merged with their weights as Σ w y/Σ w and keep Σ w (y − ȳ)² (a sum of squares of
//! differences, not a difference of sums). The triangles of blocks are stacked and reduced again by QR, which is
//! orthogonal at every stage, so a million rows lose no more digits than a few hundred.

mod blocks;
mod everywhere;

use std::collections::HashMap;

use rayon::prelude::*;

use super::Loss;
use crate::geometry::Pose;
use crate::observation::{Observation, ObservationSet, SharedErrors};
use crate::units::Angle;
pub(super) use blocks::minimise;
#[cfg(test)]
pub(super) use blocks::triangle;
pub(super) use everywhere::everywhere;

/// Number of observations up to which all are used.
pub(super) const ALL: usize = 4096;
/// Strata of the poses; two observations of each are kept.
const SPREAD: usize = 1024;
/// Repeats merged into one observation each.
#[derive(Debug, Clone, PartialEq)]
pub struct Merged {
    /// The set with one observation per pose.
    pub set: ObservationSet,
    /// Number of observations before.
    pub observations: usize,
    /// Scatter of the repeats of a pose about their mean: χ² and its degrees of freedom.
    pub within: (f64, f64),
}

/// Poses that agree to the last bit are equal.
fn key(pose: Pose) -> (u64, u64) {
    (pose.theta_c.rad().to_bits(), pose.phi_s.rad().to_bits())
}

/// Merges the observations of each pose if there are very many and the merge is exact. For least squares, repeats count
/// only by their weighted mean if everything else about them is equal. A robust loss needs each of them, and views that
/// change from frame to frame are not repeats. The model error of a pose is the same in all repeats, so it counts once.
#[must_use]
pub fn merged(set: &ObservationSet, loss: Loss) -> Option<Merged> {
    if set.observations.len() <= ALL || loss != Loss::Linear || !set.views.is_empty() {
        return None;
    }
    let mut places: HashMap<(u64, u64), usize> = HashMap::new();
    let mut groups: Vec<Vec<&Observation>> = Vec::new();
    for o in &set.observations {
        let place = *places.entry(key(o.pose)).or_insert(groups.len());
        if place == groups.len() {
            groups.push(Vec::new());
        }
        groups[place].push(o);
    }
    if groups.len() == set.observations.len() {
        return None;
    }
    let mut within = (0.0, 0.0);
    let observations = groups
        .iter()
        .map(|group| {
            let weights: f64 = group.iter().map(|o| o.sigma.powi(-2)).sum();
            let mean = |of: &dyn Fn(&Observation) -> f64| {
                group.iter().map(|o| of(o) / o.sigma.powi(2)).sum::<f64>() / weights
            };
            let signal = mean(&|o| o.signal);
            let squares = group
                .iter()
                .map(|o| ((o.signal - signal) / o.sigma).powi(2));
            within.0 += squares.sum::<f64>();
            within.1 += group.len() as f64 - 1.0;
            // Common errors are linear in the signals, so the mean applies to them too.
            Observation {
                pose: group[0].pose,
                signal,
                sigma: weights.powf(-0.5),
                shared: SharedErrors {
                    white_reference: mean(&|o| o.shared.white_reference),
                    led_drift: mean(&|o| o.shared.led_drift),
                    detector: mean(&|o| o.shared.detector),
                    theta_c_zero: Angle::from_rad(mean(&|o| o.shared.theta_c_zero.rad())),
                    phi_s_zero: Angle::from_rad(mean(&|o| o.shared.phi_s_zero.rad())),
                },
                n_frames: group.iter().map(|o| o.n_frames).sum(),
                taken_s: (group.iter().all(|o| o.taken_s.is_some()))
                    .then(|| mean(&|o| o.taken_s.unwrap_or(0.0))),
                row: group[0].row,
            }
        })
        .collect();
    Some(Merged {
        observations: set.observations.len(),
        within,
        set: ObservationSet {
            observations,
            ..set.clone()
        },
    })
}

/// Selects representative observations: the middle one and the brightest of each of [`SPREAD`] strata of the poses
/// (slabs of tilts, in each runs of azimuths), so that a lobe narrower than a stratum is not missed. The result is in
/// ascending order and reproducible. Returns `None` if all observations can be used.
#[must_use]
pub fn representative(set: &ObservationSet) -> Option<Vec<usize>> {
    let observations = &set.observations;
    if observations.len() <= ALL {
        return None;
    }
    let tilt = |i: &usize| observations[*i].pose.theta_c.rad();
    let azimuth = |i: &usize| observations[*i].pose.phi_s.rad();
    let mut order: Vec<usize> = (0..observations.len()).collect();
    order.par_sort_by(|a, b| tilt(a).total_cmp(&tilt(b)).then(a.cmp(b)));
    let slabs = (SPREAD as f64).sqrt() as usize;
    let runs = SPREAD / slabs;
    let mut kept = Vec::with_capacity(2 * SPREAD);
    for (n, slab) in parts(&mut order, slabs).enumerate() {
        slab.sort_by(|a, b| azimuth(a).total_cmp(&azimuth(b)).then(a.cmp(b)));
        for (m, run) in parts(slab, runs).enumerate() {
            // A different place in each, because poses form grids.
            let place = (n * 7 + m * 3) % 11;
            kept.push(run[(run.len() * (2 * place + 1) / 22).min(run.len() - 1)]);
            let brightest = run.iter().max_by(|a, b| {
                observations[**a]
                    .signal
                    .total_cmp(&observations[**b].signal)
            });
            kept.extend(brightest);
        }
    }
    kept.sort_unstable();
    kept.dedup();
    Some(kept)
}

/// Cuts a list into `count` parts of nearly equal length, none empty.
fn parts(list: &mut [usize], count: usize) -> impl Iterator<Item = &mut [usize]> {
    let length = list.len().div_ceil(count).max(1);
    list.chunks_mut(length)
}

/// Returns the set with only some of its observations.
#[must_use]
pub fn subset(set: &ObservationSet, kept: &[usize]) -> ObservationSet {
    let mut few = ObservationSet {
        observations: kept.iter().map(|i| set.observations[*i]).collect(),
        views: Vec::new(),
        flats: set.flats.clone(),
        power_law: set.power_law.clone(),
        rejected_frames: set.rejected_frames.clone(),
        warnings: set.warnings.clone(),
        region: set.region.clone(),
        ..*set
    };
    if !set.views.is_empty() {
        few.views = kept.iter().map(|i| set.views[*i].clone()).collect();
    }
    few
}

#[cfg(test)]
#[path = "subsample_tests.rs"]
mod tests;
