//! Poses that do not belong: single ones, and runs of them in time.
//!
//! Where something happens once, a hand in the beam, a knock, a lamp that dips for a minute, the residuals of few poses stand
//! out and the rest is as it should be. [`bad_poses`] finds single ones by studentised deletion residuals, [`bad_block`] a run in
//! time whose signals are all too high or too low by one share, the best of all runs (a sum of residuals alone, CUSUM, misses runs
//! of which the parameters take up a part). Both only tell: the weights of a fit stay as they are.
//!
//! Neither is to pass a misfit of the model for a blunder. A misfit is in many poses: so single poses are told only where at most
//! three are off, and a run only where it takes more than half of χ², and more than any smooth curve in time does.
//!
//! *Conditioning.* Everything is a sum of squares of projections ([`Leftover`]); nothing cancels.

use super::estimate::Estimate;
use super::leftover::Leftover;
use crate::robust;

/// Single poses are told from so many robust standard deviations on …
const POSE_SIGMAS: f64 = 6.0;
/// … where they are beyond what weights alone allow.
const POSE_LEAST: f64 = 2.0;
/// Single poses that may be off; with more it is the model.
const POSES_MAX: usize = 3;
/// A pose that alone determines a parameter cannot be told to be off by it.
const LEVERAGE_MAX: f64 = 0.5;
/// Least poses in a run, and their greatest share of all.
const BLOCK_LEAST: usize = 3;
const BLOCK_SHARE: f64 = 0.5;
/// Standard deviations that a run's offset is away from none, since it is the best of many.
const BLOCK_SIGMAS: f64 = 6.0;
/// Share of χ² that goes with a run.
const BLOCK_EXPLAINS: f64 = 0.5;
/// Degree of the smooth curve in time that has as many parameters as a run: begin, end, size.
const SMOOTH: usize = 3;

/// Single poses that are off.
#[derive(Debug, Clone, PartialEq)]
pub struct BadPoses {
    /// Which observations, worst first.
    pub observations: Vec<usize>,
    /// By how many robust standard deviations the worst one is.
    pub deviations: f64,
    /// Relative error of each.
    pub shares: Vec<f64>,
    /// Share of χ² that goes with them.
    pub explains: f64,
}

/// A run of poses in time that is off.
#[derive(Debug, Clone, PartialEq)]
pub struct BadBlock {
    /// Which observations, in the order of time.
    pub observations: Vec<usize>,
    /// By what share their signals are too high.
    pub share: f64,
    /// Its standard uncertainty.
    pub share_std: f64,
    /// Share of χ² that goes with it.
    pub explains: f64,
}

/// Single poses whose signals do not belong to the rest; `None` where there are none, or more than three.
#[must_use]
pub fn bad_poses(estimate: &Estimate<'_>) -> Option<BadPoses> {
    let mut left = Leftover::of(estimate)?;
    let n = left.observations();
    let before = left.chi2();
    let mut found: Vec<usize> = Vec::new();
    let mut deviations = 0.0;
    loop {
        let others = || (0..n).filter(|i| !found.contains(i));
        let size = |i: usize| {
            let open = 1.0 - left.leverage(i);
            left.residuals[i].abs() / open.max(f64::EPSILON).sqrt()
        };
        let mut sizes: Vec<f64> = others().map(size).collect();
        let scale = robust::median(&mut sizes)? / robust::MEDIAN_OF_ABS;
        let judged = others().filter(|i| left.leverage(*i) < LEVERAGE_MAX);
        let worst = judged.max_by(|a, b| size(*a).total_cmp(&size(*b)))?;
        let off = size(worst);
        if !(off > POSE_SIGMAS * scale && off > POSE_LEAST) {
            break;
        }
        if found.len() == POSES_MAX || found.len() + 1 > n / 8 {
            return None;
        }
        if found.is_empty() {
            deviations = off / scale.max(f64::MIN_POSITIVE);
        }
        found.push(worst);
        let mut row = nalgebra::DVector::zeros(left.residuals.len());
        row[worst] = 1.0;
        if !left.take(&row) {
            return None;
        }
    }
    if found.is_empty() {
        return None;
    }
    let explains = 1.0 - left.chi2() / before;
    let predicted = estimate.problem.predicted(&estimate.values);
    let set = estimate.problem.set();
    let share = |i: &usize| set.observations[*i].signal / predicted[*i] - 1.0;
    Some(BadPoses {
        shares: found.iter().map(share).collect(),
        observations: found,
        deviations,
        explains,
    })
}

/// A run of poses in time whose signals are too high or too low by one share; `None` where there is none, or no times.
#[must_use]
pub fn bad_block(estimate: &Estimate<'_>) -> Option<BadBlock> {
    let set = estimate.problem.set();
    let times: Vec<f64> = (set.observations.iter())
        .map(|o| o.taken_s)
        .collect::<Option<_>>()?;
    let left = Leftover::of(estimate)?;
    let n = left.observations();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| times[*a].total_cmp(&times[*b]));
    let most = (BLOCK_SHARE * n as f64) as usize;
    let before = left.chi2();
    if n < 2 * BLOCK_LEAST || most < BLOCK_LEAST || left.freedom() < 4.0 || before <= 0.0 {
        return None;
    }
    // Columns of single poses, what the parameters explain taken off; a run is the sum of its own.
    let single: Vec<_> = order
        .iter()
        .map(|i| left.without(&left.column(|k| f64::from(u8::from(k == *i)))))
        .collect();
    let mut best: Option<(f64, usize, usize, f64, f64)> = None;
    for from in 0..n {
        let mut column = nalgebra::DVector::zeros(left.residuals.len());
        for (to, own) in single.iter().enumerate().skip(from).take(most) {
            column += own;
            let (square, along) = (column.norm_squared(), column.dot(&left.residuals));
            if to + 1 - from < BLOCK_LEAST || square <= 0.0 {
                continue;
            }
            let gain = along * along / square;
            if best.is_none_or(|(most, ..)| gain > most) {
                best = Some((gain, from, to, along / square, square));
            }
        }
    }
    let (gain, from, to, share, square) = best?;
    let after = before - gain;
    let noise = after / (left.freedom() - 3.0).max(1.0);
    let share_std = (noise / square).sqrt();
    let mut smooth = left.clone();
    let (first, last) = (times[order[0]], times[order[n - 1]]);
    if last > first {
        for degree in 1..=SMOOTH {
            let place = |i: usize| 2.0 * (times[i] - first) / (last - first) - 1.0;
            smooth.take(&left.column(|i| place(i).powi(degree as i32)));
        }
    }
    let told = share.abs() > BLOCK_SIGMAS * share_std
        && after < (1.0 - BLOCK_EXPLAINS) * before
        && after < 0.5 * smooth.chi2();
    told.then(|| BadBlock {
        observations: order[from..=to].to_vec(),
        share,
        share_std,
        explains: gain / before,
    })
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::fit::estimate::estimate;
    use crate::fit::painted::{TRUTH, painted};
    use crate::fit::{FitOptions, VariantChoice};
    use crate::geometry::Pose;
    use crate::model::Variant;
    use crate::observation::ObservationSet;

    /// Five tilts at eight azimuths, a pose a minute, all azimuths of a tilt before the next.
    fn series(seed: u64, spoilt: impl Fn(usize) -> f64) -> ObservationSet {
        let poses = (0..40)
            .map(|k| Pose::from_deg(f64::from(k / 8) * 10.0 - 20.0, f64::from(k % 8) * 45.0));
        let mut set = painted(poses, &TRUTH, 1e-3, seed);
        for (k, o) in set.observations.iter_mut().enumerate() {
            o.taken_s = Some(60.0 * k as f64);
            o.signal *= spoilt(k);
        }
        set
    }

    fn fitted(set: &ObservationSet) -> Estimate<'_> {
        let options = FitOptions {
            variant: VariantChoice::Sawtooth,
            starts: 3,
            ..FitOptions::default()
        };
        let never = AtomicBool::new(false);
        estimate(set, Variant::Sawtooth, &options, None, &never).expect("it has a minimum")
    }

    #[test]
    fn single_poses_are_found_with_their_errors_and_many_are_not() {
        for (seed, bad) in [(1, vec![17]), (2, vec![17, 33])] {
            let set = series(seed, |k| if bad.contains(&k) { 1.04 } else { 1.0 });
            let found = bad_poses(&fitted(&set)).expect("they stand out");
            let mut poses = found.observations.clone();
            poses.sort_unstable();
            assert_eq!(poses, bad);
            assert!(found.explains > 0.5 && found.deviations > 6.0, "{found:?}");
            assert!(
                found.shares.iter().all(|s| (s - 0.04).abs() < 0.015),
                "{found:?}"
            );
        }
        let many = series(3, |k| if k % 6 == 0 { 1.04 } else { 1.0 });
        assert_eq!(bad_poses(&fitted(&many)), None);
        for seed in 10..16 {
            let set = series(seed, |_| 1.0);
            let estimate = fitted(&set);
            assert_eq!(bad_poses(&estimate), None, "{seed}");
            assert_eq!(bad_block(&estimate), None, "{seed}");
        }
    }

    #[test]
    fn a_run_in_time_is_found_and_a_drift_or_a_single_pose_is_none() {
        for (seed, from, to) in [(4, 11, 18), (5, 0, 6), (6, 26, 39)] {
            let set = series(seed, |k| if (from..=to).contains(&k) { 0.97 } else { 1.0 });
            let found = bad_block(&fitted(&set)).expect("it stands out");
            let (first, last) = (found.observations[0], *found.observations.last().unwrap());
            assert!(
                first.abs_diff(from) <= 1 && last.abs_diff(to) <= 1,
                "{from} {to}: {found:?}"
            );
            assert!((found.share + 0.03).abs() < 0.01, "{found:?}");
            assert!(found.explains > 0.5);
        }
        let drifts = series(7, |k| 1.0 - 0.04 * k as f64 / 39.0);
        assert_eq!(bad_block(&fitted(&drifts)), None);
        let single = series(8, |k| if k == 20 { 1.04 } else { 1.0 });
        assert_eq!(bad_block(&fitted(&single)), None);
    }
}
