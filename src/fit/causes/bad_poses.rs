//! Single poses, and runs of them in time, that disagree with the others.
//!
//! After a single event (a hand in the beam, a knock, a lamp that dims for a minute) the residuals of few poses are
//! large and the others are normal. [`bad_poses`] finds single poses by studentised deletion residuals. [`bad_block`]
//! finds a run in time whose signals are too high or too low by one common share, the best of all runs; a CUSUM of the
//! residuals would miss runs that the parameters partly absorb. Both count a pose less whose signal changes much within the
//! uncertainty of the stages or by the usual error of the closed form. Both only report: the weights of a fit stay unchanged.
//!
//! Neither may take a model error for a blunder. A model error affects many poses. Single poses are therefore reported
//! only if at most three are bad, and a run only if it explains more than half of χ² and more than any smooth curve in
//! time.
//!
//! *Conditioning.* Every quantity is a sum of squares of projections ([`Leftover`]); nothing cancels.

use crate::fit::estimate::Estimate;
use crate::fit::uncertainty::unexplained::Leftover;
use crate::geometry::Pose;

/// Robust standard deviations above which a single pose is reported …
const POSE_SIGMAS: f64 = 6.0;
/// … if it also exceeds this number of its own standard uncertainties.
const POSE_LEAST: f64 = 2.0;
/// Largest number of bad single poses; with more, the model is the cause.
const POSES_MAX: usize = 3;
/// Largest leverage of a bad pose. A pose that alone determines a parameter cannot be tested with it. Of few poses, each has a
/// leverage of about a half.
const LEVERAGE_MAX: f64 = 0.9;
/// Smallest number of poses in a run, and their largest share of all poses.
const BLOCK_LEAST: usize = 3;
const BLOCK_SHARE: f64 = 0.5;
/// Standard deviations by which the offset of a run differs from zero; large, because it is the best of many runs.
const BLOCK_SIGMAS: f64 = 6.0;
/// Share of χ² that a run explains.
const BLOCK_EXPLAINS: f64 = 0.5;
/// Angles up to this far apart are one of a plan.
const SAME_DEG: f64 = 0.2;
/// Degree of the smooth curve in time with as many parameters as a run: begin, end, size.
const SMOOTH: usize = 3;

/// Bad single poses.
#[derive(Debug, Clone, PartialEq)]
pub struct BadPoses {
    /// Indices of the observations, worst first.
    pub observations: Vec<usize>,
    /// Robust standard deviations of the worst one.
    pub deviations: f64,
    /// Relative error of each.
    pub shares: Vec<f64>,
    /// Share of χ² that they explain.
    pub explains: f64,
}

/// A bad run of poses in time.
#[derive(Debug, Clone, PartialEq)]
pub struct BadBlock {
    /// Indices of the observations in the order of time.
    pub observations: Vec<usize>,
    /// Relative error of its signals, positive if too high.
    pub share: f64,
    /// Its standard uncertainty.
    pub share_std: f64,
    /// Share of χ² that it explains.
    pub explains: f64,
    /// Whether its poses are those of some tilts or of some azimuths: then a property of the surface at these angles may be the
    /// cause.
    pub is_of_angles: bool,
}

/// Finds single poses whose signals disagree with the others; `None` if there are none, or more than three.
#[must_use]
pub fn bad_poses(estimate: &Estimate<'_>) -> Option<BadPoses> {
    let mut left = Leftover::of_steady_poses(estimate)?;
    let n = left.observations();
    let mut found: Vec<usize> = Vec::new();
    let mut deviations = 0.0;
    loop {
        let judged = (0..n).filter(|i| !found.contains(i) && left.leverage(*i) < LEVERAGE_MAX);
        let worst = judged.max_by(|a, b| left.size(*a).total_cmp(&left.size(*b)))?;
        let off = left.size(worst);
        // The scatter of the others is that without this pose: among few, it bends the fit, and all deviate.
        let mut rest = left.clone();
        if !rest.take(&rest.row(worst)) {
            return None;
        }
        let scale = rest.scale((0..n).filter(|i| *i != worst && !found.contains(i)))?;
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
        left = rest;
    }
    if found.is_empty() {
        return None;
    }
    // The same χ² as that of the other causes.
    let mut all = Leftover::of(estimate)?;
    let before = all.chi2();
    for pose in &found {
        all.take(&all.row(*pose));
    }
    let predicted = estimate.problem.predicted(&estimate.values);
    let set = estimate.problem.set();
    let share = |i: &usize| set.observations[*i].signal / predicted[*i] - 1.0;
    Some(BadPoses {
        shares: found.iter().map(share).collect(),
        observations: found,
        deviations,
        explains: 1.0 - all.chi2() / before,
    })
}

/// Finds a run of poses in time whose signals are too high or too low by one share; `None` if there is none, or there
/// are no times.
#[must_use]
pub fn bad_block(estimate: &Estimate<'_>) -> Option<BadBlock> {
    let set = estimate.problem.set();
    let times: Vec<f64> = (set.observations.iter())
        .map(|o| o.taken_s)
        .collect::<Option<_>>()?;
    let left = Leftover::of_steady_poses(estimate)?;
    let n = left.observations();
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| times[*a].total_cmp(&times[*b]));
    let most = (BLOCK_SHARE * n as f64) as usize;
    let before = left.chi2();
    if n < 2 * BLOCK_LEAST || most < BLOCK_LEAST || left.freedom() < 4.0 || before <= 0.0 {
        return None;
    }
    // Columns of single poses without the part that the parameters explain; a run is the sum of its poses.
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
    let significant = share.abs() > BLOCK_SIGMAS * share_std
        && after < (1.0 - BLOCK_EXPLAINS) * before
        && after < 0.5 * smooth.chi2();
    let poses = |k: &usize| set.observations[*k].pose;
    let angles: [&dyn Fn(&Pose) -> f64; 2] = [&|p| p.theta_c.deg(), &|p| p.phi_s.deg()];
    // Poses out of the run at angles of the run.
    let beside = angles.map(|angle| {
        let within: Vec<f64> = order[from..=to].iter().map(|k| angle(&poses(k))).collect();
        let out = order[..from].iter().chain(&order[to + 1..]);
        let same = |k: &&usize| {
            within
                .iter()
                .any(|a| (a - angle(&poses(k))).abs() < SAME_DEG)
        };
        out.filter(same).count()
    });
    significant.then(|| BadBlock {
        is_of_angles: beside.iter().any(|n| 4 * n <= to + 1 - from),
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
    use crate::fit::one_variant::estimate;
    use crate::fit::painted::{TRUTH, painted};
    use crate::fit::problem::Values;
    use crate::fit::{FitOptions, VariantChoice};
    use crate::model::Variant;
    use crate::observation::ObservationSet;
    use crate::units::Angle;

    /// Five tilts at eight azimuths, one pose per minute, all azimuths of a tilt before the next.
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
    fn single_bad_poses_are_found_with_their_errors_and_many_are_not() {
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
    fn the_stages_own_errors_on_the_flank_of_a_narrow_lobe_are_no_bad_poses() {
        let narrow = Values {
            theta_r: 0.07,
            alpha_u: 0.05,
            alpha_v: 0.05,
            ..TRUTH
        };
        let recorded = |k: usize| ((k / 8) as f64 * 10.0 - 20.0, (k % 8) as f64 * 45.0);
        for seed in 20..28 {
            // Errors of two directions, which repeat after 7 and after 5 poses.
            let by = |k: usize| {
                let part = |of: usize| ((k * 3 + seed as usize) % of) as f64 - (of / 2) as f64;
                (0.004 * part(7), 0.004 * part(5))
            };
            let actual = (0..40).map(|k| {
                let ((tilt, turn), (a, b)) = (recorded(k), by(k));
                Pose::from_deg(tilt + a, turn + b)
            });
            let mut set = painted(actual, &narrow, 1e-4, seed);
            for (k, o) in set.observations.iter_mut().enumerate() {
                o.pose = Pose::from_deg(recorded(k).0, recorded(k).1);
                o.taken_s = Some(60.0 * k as f64);
                o.shared.theta_c_zero = Angle::from_deg(0.01);
                o.shared.phi_s_zero = Angle::from_deg(0.01);
            }
            // In every second series something shades a pose beside the lobe.
            let shaded = (seed % 2 == 0).then_some(1);
            if let Some(k) = shaded {
                set.observations[k].signal *= 0.8;
            }
            let estimate = fitted(&set);
            let poses = bad_poses(&estimate).map(|found| found.observations);
            assert_eq!(poses, shaded.map(|k| vec![k]), "{seed}");
            assert_eq!(bad_block(&estimate), None, "{seed}");
        }
    }

    #[test]
    fn a_bad_run_is_found_and_a_drift_or_a_single_pose_is_not_a_run() {
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
