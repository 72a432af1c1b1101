//! Frames → visits: which frames show one pose at several exposure times, and how high their counts are.

use std::collections::BTreeMap;

use rayon::prelude::*;

use super::{Detector, EXPOSURE_REL_STD_DEFAULT, Known, Seen, Visit};
use crate::frame::{Frame, FrameKind};
use crate::reduction::ReductionError;
use crate::reduction::darks::{Dark, Darks};
use crate::reduction::flats::SAME_ANGLE_DEG;
use crate::reduction::load::{Calls, load};
use crate::reduction::sensor::Sensor;
use crate::series::FrameRow;

/// Visits that are read: more would hardly tell more, and every frame takes its time.
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

/// Compares exposures of one pose. Reads no frame of a series that has one exposure time.
///
/// # Errors
/// [`ReductionError::Cancelled`].
pub(in crate::reduction) fn read(
    calls: &Calls<'_>,
    sensor: &Sensor,
    darks: &Darks,
) -> Result<Detector, ReductionError> {
    let rows = calls.source.rows();
    let lit = |row: &&FrameRow| row.kind != FrameKind::Dark;
    let mut all_times_s: Vec<f64> = rows.iter().filter(lit).map(|row| row.exposure_s).collect();
    all_times_s.sort_unstable_by(f64::total_cmp);
    all_times_s.dedup();
    let stated = calls.source.manifest().camera.exposure_rel_std;
    let known = Known {
        full_dn: sensor.saturation_dn - sensor.black_dn,
        times_s: all_times_s.clone(),
        time_std: stated.unwrap_or(EXPOSURE_REL_STD_DEFAULT),
        // Offsets of real cameras wander by a fraction of their read noise; without dark frames nobody knows them.
        dark_std_dn: match darks.n_frames {
            0 => (0.02 * sensor.black_dn).max(5.0),
            _ => 0.1 * sensor.read_dn.max(1.0),
        },
    };
    let usable = all_times_s.len() > 1 && known.full_dn > 0.0 && known.full_dn.is_finite();
    let groups = if usable { groups(rows) } else { Vec::new() };
    let step = groups.len().div_ceil(VISITS_MAX).max(1);
    let chosen: Vec<&Vec<usize>> = groups.iter().step_by(step).collect();
    let visits: Vec<Option<Visit>> = chosen
        .par_iter()
        .map(|group| {
            calls.check_cancel()?;
            Ok(visit(calls, sensor, darks, &known, group))
        })
        .collect::<Result<_, ReductionError>>()?;
    let visits: Vec<Visit> = visits.into_iter().flatten().collect();
    Ok(Detector::of(&visits, &known, &all_times_s, stated))
}

/// Frames of one pose at several exposure times, each a list of one frame per exposure time: as they follow each other in the
/// list, or, where the list goes through all poses at one exposure time first, over the whole list.
fn groups(rows: &[FrameRow]) -> Vec<Vec<usize>> {
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

/// One visit from its frames; none where fewer than two of them can be compared.
fn visit(
    calls: &Calls<'_>,
    sensor: &Sensor,
    darks: &Darks,
    known: &Known,
    group: &[usize],
) -> Option<Visit> {
    let rows = calls.source.rows();
    let nearly_full = sensor.black_dn + NEARLY_FULL * known.full_dn;
    let mut frames: Vec<(usize, Frame, Dark)> = Vec::new();
    for index in group {
        let exposure_s = rows[*index].exposure_s;
        let time = known.times_s.iter().position(|s| *s == exposure_s)?;
        let Ok(frame) = load(calls, *index, sensor) else {
            continue;
        };
        let (n, full) = frame
            .pixels_dn()
            .iter()
            .zip(&darks.good)
            .filter(|(_, good)| **good)
            .fold((0_usize, 0_usize), |(n, full), (dn, _)| {
                (n + 1, full + usize::from(f64::from(*dn) > nearly_full))
            });
        if n > 0 && (full as f64) <= FULL_SHARE * n as f64 {
            frames.push((time, frame, darks.at(exposure_s)));
        }
    }
    frames.sort_by_key(|(time, ..)| *time);
    if frames.len() < 2 {
        return None;
    }
    let mut bins = vec![[[0.0_f64; 2]; BINS]; frames.len()];
    let mut counts = vec![0.0; frames.len()];
    for pixel in (0..darks.good.len()).filter(|pixel| darks.good[*pixel]) {
        for (count, (_, frame, dark)) in counts.iter_mut().zip(&frames) {
            *count = f64::from(frame.pixels_dn()[pixel]) - f64::from(dark.level_dn[pixel]);
        }
        let hit = (1..frames.len()).any(|j| {
            let ratio = known.times_s[frames[0].0] / known.times_s[frames[j].0];
            let (short, long) = (counts[0], counts[j] * ratio);
            let variance =
                sensor.variance_dn2(short) + ratio * ratio * sensor.variance_dn2(counts[j]);
            (long - short).abs()
                > HIT_SIGMAS * variance.sqrt() + HIT_SHARE * long.abs().max(short.abs())
        });
        if hit || counts.iter().any(|c| *c > NEARLY_FULL * known.full_dn) {
            continue;
        }
        for (count, bins) in counts.iter().zip(&mut bins) {
            let level = (count / known.full_dn * BINS as f64) as usize;
            let bin = &mut bins[level.min(BINS - 1)];
            bin[0] += 1.0;
            bin[1] += count;
        }
    }
    let visit: Visit = frames
        .iter()
        .zip(bins)
        .filter_map(|((time, _, dark), bins)| {
            let bins: Vec<[f64; 2]> = bins.into_iter().filter(|b| b[0] > 0.0).collect();
            let (n, sum) = bins
                .iter()
                .fold((0.0, 0.0), |(n, s), b| (n + b[0], s + b[1]));
            let current = (dark.mean_dn - sensor.black_dn).max(0.0);
            let noise = n * (sensor.variance_dn2(sum / n + current) + dark.variance_dn2);
            let variance = noise / (sum * sum);
            let tells = sum > 0.0 && variance < NOISE_MAX * NOISE_MAX;
            tells.then_some(Seen {
                time: *time,
                bins,
                variance,
            })
        })
        .collect();
    (visit.len() > 1).then_some(visit)
}
