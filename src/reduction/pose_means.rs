//! Levels of the segments of a pose → one level of the pose. Worn patches and poses without a level are left out by name.

use super::flats::SAME_ANGLE_DEG;
use super::load::Calls;
use super::merge::{Merged, PoseLevels};
use super::reduction_log::{ReductionLog, Rejection};
use super::region::{Region, Segments};
use super::sensor::median;
use crate::frame::FrameKind;
use crate::series::FrameRow;
use crate::wording::counted;

/// Returns the poses that have a level, with it. The frames of the others are left out: an observation of 0 ± 0 would outweigh
/// all others. Levels of patches should be `alike` where all pixels have the same directions.
pub(super) fn levels<'a>(
    rows: &[FrameRow],
    poses: &'a [PoseLevels],
    alike: bool,
    log: &mut ReductionLog,
) -> Vec<(&'a PoseLevels, Merged)> {
    let means = poses.iter().map(|pose| (pose, over_segments(pose, alike)));
    let (levels, without): (Vec<_>, Vec<_>) = means.partition(|(_, level)| is_level(level));
    if !without.is_empty() {
        log.warn(format!(
            "{} left out: no usable pixel, or no finite level",
            counted(without.len(), "pose")
        ));
    }
    for index in without.iter().flat_map(|(pose, _)| &pose.frames) {
        let exposure_s = rows[*index].exposure_s;
        let detail = format!(
            "all pixels of its pose are full, outliers or left out, or {exposure_s:?} s of exposure give no finite level"
        );
        log.reject(*index, Rejection::new("no level", detail));
    }
    levels
}

/// Returns whether a level is valid: its pose has a usable pixel, and its numbers are within the range of doubles.
fn is_level(level: &Merged) -> bool {
    level.n > 0.0
        && level.rate_dn_s.is_finite()
        && level.variance > 0.0
        && level.variance.is_finite()
}

/// Returns the pixel-weighted mean of the segments of a pose. If they should be `alike`, patches that scatter more than their
/// uncertainties raise the uncertainty of the mean to their scatter.
fn over_segments(pose: &PoseLevels, alike: bool) -> Merged {
    let used: Vec<&Merged> = pose.segments.iter().filter(|s| s.n > 0.0).collect();
    let n: f64 = used.iter().map(|s| s.n).sum();
    if n <= 0.0 {
        return Merged::default();
    }
    let rate = used.iter().map(|s| s.n * s.rate_dn_s).sum::<f64>() / n;
    let own = used
        .iter()
        .map(|s| (s.n / n).powi(2) * s.variance)
        .sum::<f64>();
    let between = if alike && used.len() >= 3 {
        let k = used.len() as f64;
        used.iter()
            .map(|s| (s.rate_dn_s - rate).powi(2))
            .sum::<f64>()
            / ((k - 1.0) * k)
    } else {
        0.0
    };
    Merged {
        n,
        rate_dn_s: rate,
        variance: own.max(between),
        dark_std_dn_s: used
            .iter()
            .map(|s| (s.n / n * s.dark_std_dn_s).powi(2))
            .sum::<f64>()
            .sqrt(),
        ..Merged::default()
    }
}

/// Warns of the poses of which no frame can be used.
pub(super) fn warn_of_lost_poses(calls: &Calls<'_>, poses: &[PoseLevels], log: &mut ReductionLog) {
    let mut lost: Vec<String> = Vec::new();
    for index in calls.rows_of(FrameKind::Sample) {
        let pose = calls.source.rows()[index].pose();
        let near = |p: &PoseLevels| {
            let limit = 2.0 * SAME_ANGLE_DEG;
            (p.pose.theta_c - pose.theta_c).deg().abs() <= limit
                && (p.pose.phi_s - pose.phi_s).wrapped().deg().abs() <= limit
        };
        if !poses.iter().any(near) {
            let words = format!("(θc {:.1}, φs {:.1})", pose.theta_c, pose.phi_s);
            if !lost.contains(&words) {
                lost.push(words);
            }
        }
    }
    if !lost.is_empty() {
        let shown = lost.iter().take(8).cloned().collect::<Vec<_>>().join(", ");
        let more = if lost.len() > 8 { ", …" } else { "" };
        log.warn(format!(
            "{} without a usable frame give no observation: {shown}{more}",
            counted(lost.len(), "pose")
        ));
    }
}

/// Leaves out of `even` and `odd` the patches that disagree with the others: worn, dirty or damaged.
pub(super) fn leave_out_worn_patches(
    segments: &Segments,
    chosen: Option<Region>,
    poses: &mut [PoseLevels],
    log: &mut ReductionLog,
) {
    /// A patch is worn beyond this many times the usual deviation …
    const TIMES: f64 = 4.0;
    /// … and this share of the brightest level.
    const SHARE: f64 = 0.01;
    let Segments::Patches { patches, .. } = segments else {
        return;
    };
    if patches.len() < 3 {
        return;
    }
    let mut squares = vec![0.0; patches.len()];
    let mut brightest = 0.0_f64;
    for pose in poses.iter() {
        let middle = median(
            &mut pose
                .segments
                .iter()
                .map(|s| s.rate_dn_s)
                .collect::<Vec<_>>(),
        );
        brightest = brightest.max(middle);
        for (square, s) in squares.iter_mut().zip(&pose.segments) {
            *square += (s.rate_dn_s - middle).powi(2);
        }
    }
    let rms: Vec<f64> = squares
        .iter()
        .map(|s| (s / poses.len().max(1) as f64).sqrt() / brightest)
        .collect();
    let usual = median(&mut rms.clone());
    let kind = if chosen.is_some_and(Region::is_odd) {
        "odd"
    } else {
        "even"
    };
    for (label, rms) in rms.iter().enumerate() {
        if *rms > (TIMES * usual).max(SHARE) {
            let (i, j) = patches[label];
            log.warn(format!(
                "patch-{i}-{j} disagrees with the other {kind} patches ({:.1} % of the brightest level, rms over the poses) and is left out of `{kind}`; check whether it is worn or dirty",
                rms * 100.0
            ));
            for pose in poses.iter_mut() {
                pose.segments[label].n = 0.0;
            }
        }
    }
}
