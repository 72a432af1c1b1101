//! Frames → visits: which frames show one pose at several exposure times, and the levels of their counts.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::{CurvePrior, Detector, EXPOSURE_REL_STD_DEFAULT, FrameLevels, Visit};
use crate::frame::{Frame, FrameKind};
use crate::reduction::darks::{Dark, Darks};
use crate::reduction::flats::SAME_ANGLE_DEG;
use crate::reduction::sensor::Sensor;
use crate::series::{FrameRow, Manifest};

/// Visits that are compared. More would add little, and every frame takes its time.
const VISITS_MAX: usize = 64;
/// Frames of a visit that are read.
const FRAMES_MAX: usize = 6;
/// Levels that counts are sorted into: within one the curve is as good as straight.
const BINS: usize = 256;
/// Counts above this share of full scale may be clipped by their noise.
const NEARLY_FULL: f64 = 0.97;
/// Share of the pixels that may be that full, as hot ones are.
const FULL_SHARE: f64 = 1e-3;
/// Relative standard uncertainty of a frame's light beyond which it tells nothing.
const NOISE_MAX: f64 = 5e-3;
/// Pixels that differ by more than a curve explains, and more than this many standard deviations, were hit by something.
const HIT_SIGMAS: f64 = 8.0;
const HIT_SHARE: f64 = 0.3;

/// Levels of the counts of one frame of a visit, as a reduction keeps them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(in crate::reduction) struct Exposure {
    exposure_s: f64,
    /// Pixels and their counts above dark, by level.
    bins: Vec<[f64; 2]>,
    /// Relative variance of the sum by counting and read noise.
    variance: f64,
}

/// The comparable frames of one visit; empty where fewer than two can be compared.
pub(in crate::reduction) type Exposures = Vec<Exposure>;

/// The groups of frames that are compared, spread over the series.
pub(in crate::reduction) fn shown(groups: &[Vec<usize>]) -> impl Iterator<Item = &Vec<usize>> {
    let step = groups.len().div_ceil(VISITS_MAX).max(1);
    groups.iter().step_by(step)
}

/// Exposure times of flats and samples, ascending.
fn times_s(rows: &[FrameRow]) -> Vec<f64> {
    let lit = rows.iter().filter(|row| row.kind != FrameKind::Dark);
    let mut all: Vec<f64> = lit.map(|row| row.exposure_s).collect();
    all.sort_unstable_by(f64::total_cmp);
    all.dedup();
    all
}

/// Compares exposures of one pose. `has_darks` says whether the dark level was measured.
pub(in crate::reduction) fn compare(
    manifest: &Manifest,
    rows: &[FrameRow],
    sensor: &Sensor,
    has_darks: bool,
    visits: &[&Exposures],
) -> Detector {
    let all_times_s = times_s(rows);
    let stated = manifest.camera.exposure_rel_std;
    let known = CurvePrior {
        full_dn: full_dn(sensor),
        times_s: all_times_s.clone(),
        time_std: stated.unwrap_or(EXPOSURE_REL_STD_DEFAULT),
        // Offsets of real cameras wander by a fraction of their read noise; without dark frames they are unknown.
        dark_std_dn: match has_darks {
            false => (0.02 * sensor.black_dn).max(5.0),
            true => 0.1 * sensor.read_dn.max(1.0),
        },
    };
    let seen = |exposure: &Exposure| {
        let time = all_times_s.iter().position(|s| *s == exposure.exposure_s)?;
        Some(FrameLevels {
            time,
            bins: exposure.bins.clone(),
            variance: exposure.variance,
        })
    };
    let visit = |exposures: &&Exposures| -> Option<Visit> { exposures.iter().map(seen).collect() };
    let visits: Vec<Visit> = visits
        .iter()
        .filter_map(visit)
        .filter(|visit| visit.len() > 1)
        .collect();
    Detector::of(&visits, &known, &all_times_s, stated)
}

fn full_dn(sensor: &Sensor) -> f64 {
    sensor.saturation_dn - sensor.black_dn
}

/// Groups of frames of one pose at several exposure times; none of a series that has one exposure time.
pub(in crate::reduction) fn groups(rows: &[FrameRow], sensor: &Sensor) -> Vec<Vec<usize>> {
    let full_dn = full_dn(sensor);
    match times_s(rows).len() > 1 && full_dn > 0.0 && full_dn.is_finite() {
        true => groups_of(rows),
        false => Vec::new(),
    }
}

/// Frames of one pose at several exposure times, each a list of one frame per exposure time: as they follow each other in the
/// list, or, where the list goes through all poses at one exposure time first, over the whole list.
fn groups_of(rows: &[FrameRow]) -> Vec<Vec<usize>> {
    let one_each = |frames: &[usize]| {
        let mut chosen: Vec<usize> = Vec::new();
        for index in frames {
            let taken = |c: &usize| rows[*c].exposure_s == rows[*index].exposure_s;
            if chosen.len() < FRAMES_MAX && !chosen.iter().any(taken) {
                chosen.push(*index);
            }
        }
        (chosen.len() > 1).then_some(chosen)
    };
    let lit = || (0..rows.len()).filter(|i| rows[*i].kind != FrameKind::Dark);
    let same = |a: &FrameRow, b: &FrameRow| {
        let (a, b, kinds) = (a.pose(), b.pose(), a.kind == b.kind);
        kinds
            && (a.theta_c - b.theta_c).deg().abs() <= SAME_ANGLE_DEG
            && (a.phi_s - b.phi_s).wrapped().deg().abs() <= SAME_ANGLE_DEG
    };
    let mut runs: Vec<Vec<usize>> = Vec::new();
    for index in lit() {
        match runs.last_mut() {
            Some(run) if same(&rows[run[0]], &rows[index]) => run.push(index),
            _ => runs.push(vec![index]),
        }
    }
    let groups: Vec<Vec<usize>> = runs.iter().filter_map(|run| one_each(run)).collect();
    if !groups.is_empty() {
        return groups;
    }
    let mut poses: BTreeMap<(bool, i64, i64), Vec<usize>> = BTreeMap::new();
    for index in lit() {
        let row = &rows[index];
        let place = |deg: f64| (deg / (5.0 * SAME_ANGLE_DEG)).round() as i64;
        let key = (
            row.kind == FrameKind::Flat,
            place(row.theta_c_deg),
            place(row.phi_s_deg),
        );
        poses.entry(key).or_default().push(index);
    }
    poses
        .values()
        .filter_map(|frames| one_each(frames))
        .collect()
}

/// The levels of a visit's frames, each with its exposure time; empty where fewer than two of them can be compared.
pub(in crate::reduction) fn read_exposures(
    sensor: &Sensor,
    darks: &Darks,
    visited: &[(f64, &Frame)],
) -> Exposures {
    let full_dn = full_dn(sensor);
    let nearly_full = sensor.black_dn + NEARLY_FULL * full_dn;
    let mut frames: Vec<(f64, &Frame, Dark)> = Vec::new();
    for (exposure_s, frame) in visited {
        let (n, full) = frame
            .pixels_dn()
            .iter()
            .zip(&darks.good)
            .filter(|(_, good)| **good)
            .fold((0_usize, 0_usize), |(n, full), (dn, _)| {
                (n + 1, full + usize::from(f64::from(*dn) > nearly_full))
            });
        if n > 0 && (full as f64) <= FULL_SHARE * n as f64 {
            frames.push((*exposure_s, *frame, darks.at(*exposure_s)));
        }
    }
    frames.sort_by(|a, b| a.0.total_cmp(&b.0));
    if frames.len() < 2 {
        return Exposures::new();
    }
    let mut bins = vec![[[0.0_f64; 2]; BINS]; frames.len()];
    let mut counts = vec![0.0; frames.len()];
    for pixel in (0..darks.good.len()).filter(|pixel| darks.good[*pixel]) {
        for (count, (_, frame, dark)) in counts.iter_mut().zip(&frames) {
            *count = f64::from(frame.pixels_dn()[pixel]) - f64::from(dark.level_dn[pixel]);
        }
        let hit = (1..frames.len()).any(|j| {
            let ratio = frames[0].0 / frames[j].0;
            let (short, long) = (counts[0], counts[j] * ratio);
            let variance =
                sensor.variance_dn2(short) + ratio * ratio * sensor.variance_dn2(counts[j]);
            (long - short).abs()
                > HIT_SIGMAS * variance.sqrt() + HIT_SHARE * long.abs().max(short.abs())
        });
        if hit || counts.iter().any(|c| *c > NEARLY_FULL * full_dn) {
            continue;
        }
        for (count, bins) in counts.iter().zip(&mut bins) {
            let level = (count / full_dn * BINS as f64) as usize;
            let bin = &mut bins[level.min(BINS - 1)];
            bin[0] += 1.0;
            bin[1] += count;
        }
    }
    let exposures: Exposures = frames
        .iter()
        .zip(bins)
        .filter_map(|((exposure_s, _, dark), bins)| {
            let bins: Vec<[f64; 2]> = bins.into_iter().filter(|b| b[0] > 0.0).collect();
            let (n, sum) = bins
                .iter()
                .fold((0.0, 0.0), |(n, s), b| (n + b[0], s + b[1]));
            let current = (dark.mean_dn - sensor.black_dn).max(0.0);
            let noise = n * (sensor.variance_dn2(sum / n + current) + dark.variance_dn2);
            let variance = noise / (sum * sum);
            let is_significant = sum > 0.0 && variance < NOISE_MAX * NOISE_MAX;
            is_significant.then_some(Exposure {
                exposure_s: *exposure_s,
                bins,
                variance,
            })
        })
        .collect();
    match exposures.len() > 1 {
        true => exposures,
        false => Exposures::new(),
    }
}
