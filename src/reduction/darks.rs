//! Dark frames → the dark level of each pixel per exposure time, and hot and noisy pixels.
//!
//! Counts are summed as integers, so the result does not depend on the order of the frames.
//!
//! *Conditioning.* Integers are exact to 2⁵³ counts; means are divided once, at the end.

use std::collections::BTreeMap;
use std::sync::Arc;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::ReductionError;
use super::detector::{Correction, Detector};
use super::load::{Calls, load};
use super::reduction_log::{ReductionLog, Rejection};
use super::sensor::{Sensor, median, robust_spread};
use crate::robust::reduced_chi2_at;

/// Pixels further than this many robust standard deviations from the others are defects.
const DEFECT_SIGMAS: f64 = 8.0;

/// Mean dark frame for one exposure time.
#[derive(Debug, Clone)]
pub(super) struct Dark {
    pub(super) exposure_s: f64,
    /// Mean count per pixel.
    pub(super) level_dn: Arc<[f32]>,
    /// Mean variance of `level_dn`: the noise left in the mean.
    pub(super) variance_dn2: f64,
    /// Mean of `level_dn` over good pixels.
    pub(super) mean_dn: f64,
    /// Correction of the counts of this exposure time; `None` for a linear camera.
    pub(super) correction: Option<Correction>,
}

impl Dark {
    /// Returns the count of a linear camera in a pixel, dark level included.
    pub(super) fn linear_dn(&self, pixel: usize, dn: u16) -> f64 {
        let counted = f64::from(dn);
        self.correction.map_or(counted, |by| {
            let dark = f64::from(self.level_dn[pixel]);
            dark + by.curve.linear(counted - dark) / by.time
        })
    }
}

/// What merging needs of a mean dark frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct DarkNoise {
    pub(super) exposure_s: f64,
    pub(super) variance_dn2: f64,
    pub(super) mean_dn: f64,
}

/// The same of all exposure times, ascending.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct DarkNoises(Vec<DarkNoise>);

/// Where an exposure time is among those of the dark frames.
enum Place {
    Own(usize),
    /// Between this one and the next, at this share of the way.
    Between(usize, f64),
}

/// `exposures_s` ascend and are never empty. Beyond their ends the nearest is taken.
fn place(exposures_s: impl Iterator<Item = f64> + Clone, exposure_s: f64) -> Place {
    let close = |a: f64, b: f64| (a - b).abs() <= 1e-6 * a.abs().max(b.abs());
    if let Some(own) = exposures_s.clone().position(|s| close(s, exposure_s)) {
        return Place::Own(own);
    }
    let mut below = None;
    for (at, s) in exposures_s.enumerate() {
        match below {
            Some((low, low_s)) if s > exposure_s => {
                return Place::Between(low, (exposure_s - low_s) / (s - low_s));
            }
            None if s > exposure_s => return Place::Own(0),
            _ => below = Some((at, s)),
        }
    }
    Place::Own(below.map_or(0, |(last, _)| last))
}

impl DarkNoises {
    /// Of the dark frame for an exposure time: measured, or interpolated between (never beyond) the measured times.
    pub(super) fn at(&self, exposure_s: f64) -> DarkNoise {
        let all = &self.0;
        match place(all.iter().map(|d| d.exposure_s), exposure_s) {
            Place::Own(at) => all[at],
            Place::Between(low, share) => {
                let (low, high) = (all[low], all[low + 1]);
                let mix = |a: f64, b: f64| a + share * (b - a);
                DarkNoise {
                    exposure_s,
                    variance_dn2: mix(low.variance_dn2, high.variance_dn2),
                    mean_dn: mix(low.mean_dn, high.mean_dn),
                }
            }
        }
    }

    /// Whether an exposure time has its own dark frames, or lies between two that have.
    pub(super) fn covers(&self, exposure_s: f64) -> bool {
        let first = self.0[0].exposure_s;
        let last = self.0[self.0.len() - 1].exposure_s;
        exposure_s >= first * (1.0 - 1e-6) && exposure_s <= last * (1.0 + 1e-6)
    }

    /// Whether there is any; what was stored by another program may have none.
    pub(super) fn is_usable(&self) -> bool {
        !self.0.is_empty()
    }
}

/// All dark frames of a series.
#[derive(Debug, Clone)]
pub(super) struct Darks {
    /// By exposure time; never empty.
    by_exposure: Vec<Dark>,
    /// Pixels that are neither hot nor noisy.
    pub(super) good: Vec<bool>,
    /// The camera's curve, where it is applied pixel by pixel.
    pub(super) detector: Option<Arc<Detector>>,
    /// Dark frames used.
    pub(super) n_frames: u32,
}

struct Sums {
    frames: u32,
    dn: Vec<u32>,
    dn2: Vec<u64>,
}

impl Darks {
    /// Reads the dark frames, leaves out those that disagree with the rest, and averages them. Without dark frames the black
    /// level of the manifest is used, with a warning. Where the read noise of `sensor` disagrees with the scatter of the
    /// frames, the measured value replaces it.
    pub(super) fn read(
        calls: &Calls<'_>,
        sensor: &mut Sensor,
        log: &mut ReductionLog,
    ) -> Result<Self, ReductionError> {
        let rows = calls.rows_of(crate::frame::FrameKind::Dark);
        let accepted = accepted(calls, &rows, sensor, log)?;
        let mut groups: BTreeMap<u64, Vec<usize>> = BTreeMap::new();
        for index in &accepted {
            let exposure_s = calls.source.rows()[*index].exposure_s;
            groups.entry(exposure_s.to_bits()).or_default().push(*index);
        }
        if groups.is_empty() {
            log.warn(format!(
                "no usable dark frame: the black level of the manifest ({} DN) is used instead and dark current counts as light; take dark frames with the lens capped at each exposure time",
                sensor.black_dn
            ));
            return Ok(Darks {
                by_exposure: vec![Dark {
                    exposure_s: 0.0,
                    level_dn: vec![sensor.black_dn as f32; sensor.pixels()].into(),
                    variance_dn2: 0.0,
                    mean_dn: sensor.black_dn,
                    correction: None,
                }],
                good: vec![true; sensor.pixels()],
                detector: None,
                n_frames: 0,
            });
        }
        let sums: Vec<(f64, Sums)> = groups
            .into_par_iter()
            .map(|(bits, indices)| Ok((f64::from_bits(bits), sum(calls, &indices, sensor)?)))
            .collect::<Result<_, ReductionError>>()?;
        check_read_noise(&sums, sensor, log);
        let good = good_pixels(&sums, sensor);
        let by_exposure = sums
            .into_iter()
            .map(|(exposure_s, sums)| {
                let n = f64::from(sums.frames);
                let level: Arc<[f32]> = sums
                    .dn
                    .iter()
                    .map(|dn| (f64::from(*dn) / n) as f32)
                    .collect();
                let (count, total) = level
                    .iter()
                    .zip(&good)
                    .filter(|(_, good)| **good)
                    .fold((0_u32, 0.0), |(c, t), (dn, _)| (c + 1, t + f64::from(*dn)));
                let mean_dn = total / f64::from(count.max(1));
                Dark {
                    exposure_s,
                    variance_dn2: sensor.variance_dn2(mean_dn - sensor.black_dn) / n,
                    level_dn: level,
                    mean_dn,
                    correction: None,
                }
            })
            .collect();
        Ok(Darks {
            by_exposure,
            good,
            detector: None,
            n_frames: accepted.len() as u32,
        })
    }

    /// Returns the dark frame for an exposure time: measured, or interpolated between (never beyond) the measured exposure
    /// times; with the correction of its counts.
    pub(super) fn at(&self, exposure_s: f64) -> Dark {
        let detector = self.detector.as_ref();
        Dark {
            correction: detector.and_then(|detector| detector.correction(exposure_s)),
            ..self.measured_at(exposure_s)
        }
    }

    fn measured_at(&self, exposure_s: f64) -> Dark {
        let all = &self.by_exposure;
        match place(all.iter().map(|d| d.exposure_s), exposure_s) {
            Place::Own(at) => all[at].clone(),
            Place::Between(low, share) => {
                let (low, high) = (&all[low], &all[low + 1]);
                let mix = |a: f64, b: f64| a + share * (b - a);
                Dark {
                    exposure_s,
                    level_dn: low
                        .level_dn
                        .iter()
                        .zip(high.level_dn.iter())
                        .map(|(a, b)| mix(f64::from(*a), f64::from(*b)) as f32)
                        .collect(),
                    variance_dn2: mix(low.variance_dn2, high.variance_dn2),
                    mean_dn: mix(low.mean_dn, high.mean_dn),
                    correction: None,
                }
            }
        }
    }

    /// What merging needs of them.
    pub(super) fn noises(&self) -> DarkNoises {
        let of = |dark: &Dark| DarkNoise {
            exposure_s: dark.exposure_s,
            variance_dn2: dark.variance_dn2,
            mean_dn: dark.mean_dn,
        };
        DarkNoises(self.by_exposure.iter().map(of).collect())
    }
}

/// Returns the indices of usable dark frames: readable, not full, and at the level of the others of the same exposure time.
fn accepted(
    calls: &Calls<'_>,
    rows: &[usize],
    sensor: &Sensor,
    log: &mut ReductionLog,
) -> Result<Vec<usize>, ReductionError> {
    let checked: Vec<(usize, Result<f64, Rejection>)> = rows
        .par_iter()
        .map(|index| {
            calls.check_cancel()?;
            Ok((*index, level_of(calls, *index, sensor)))
        })
        .collect::<Result<_, ReductionError>>()?;
    let mut groups: BTreeMap<u64, Vec<(usize, f64)>> = BTreeMap::new();
    for (index, level) in checked {
        match level {
            Ok(level_dn) => {
                let exposure_s = calls.source.rows()[index].exposure_s;
                groups
                    .entry(exposure_s.to_bits())
                    .or_default()
                    .push((index, level_dn));
            }
            Err(rejection) => log.reject(index, rejection),
        }
    }
    let mut accepted = Vec::new();
    for group in groups.values() {
        // Light leaks only add counts: of two frames that disagree the darker one counts.
        let mut levels: Vec<f64> = group.iter().map(|(_, level)| *level).collect();
        let usual = if levels.len() > 2 {
            median(&mut levels)
        } else {
            levels.iter().copied().fold(f64::INFINITY, f64::min)
        };
        // Offsets of real cameras drift by a fraction of their read noise between frames.
        let wander_dn = (2.0 * sensor.read_dn).max(2.0).max(0.02 * usual);
        for (index, level_dn) in group {
            if (level_dn - usual).abs() > wander_dn {
                log.reject(
                    *index,
                    Rejection::new(
                        "level",
                        format!(
                            "a mean of {level_dn:.1} DN where the other dark frames of this exposure have {usual:.1} DN"
                        ),
                    ),
                );
            } else {
                accepted.push(*index);
            }
        }
    }
    Ok(accepted)
}

fn level_of(calls: &Calls<'_>, index: usize, sensor: &Sensor) -> Result<f64, Rejection> {
    let frame = load(calls, index, sensor)?;
    let pixels = frame.pixels_dn();
    let full = pixels.iter().filter(|dn| sensor.is_full(**dn)).count();
    if full * 2 > pixels.len() {
        return Err(Rejection::new(
            "saturated",
            format!("{full} of {} pixels are full", pixels.len()),
        ));
    }
    let first = pixels[0];
    // A handful of pixels may be equal by chance.
    if sensor.read_dn > 0.5 && pixels.len() > 8 && pixels.iter().all(|dn| *dn == first) {
        return Err(Rejection::new(
            "black",
            format!("every pixel counts {first} DN, without any noise"),
        ));
    }
    let mut values: Vec<f64> = pixels.iter().map(|dn| f64::from(*dn)).collect();
    // The median ignores hot pixels. Counts are integers, so the mean of the counts near it is used.
    let (centre, spread) = robust_spread(&mut values);
    let reach = 5.0 * spread.max(1.0);
    let (n, total) = values
        .iter()
        .filter(|x| (**x - centre).abs() <= reach)
        .fold((0_u32, 0.0), |(n, t), x| (n + 1, t + x));
    Ok(total / f64::from(n.max(1)))
}

fn sum(calls: &Calls<'_>, indices: &[usize], sensor: &Sensor) -> Result<Sums, ReductionError> {
    let pixels = sensor.pixels();
    let mut sums = Sums {
        frames: 0,
        dn: vec![0; pixels],
        dn2: vec![0; pixels],
    };
    for index in indices {
        calls.check_cancel()?;
        // It was readable before; a frame that disappeared since is left out.
        let Ok(frame) = load(calls, *index, sensor) else {
            continue;
        };
        sums.frames += 1;
        for ((dn, total), total2) in frame
            .pixels_dn()
            .iter()
            .zip(&mut sums.dn)
            .zip(&mut sums.dn2)
        {
            *total += u32::from(*dn);
            *total2 += u64::from(*dn) * u64::from(*dn);
        }
    }
    if sums.frames == 0 {
        return Err(ReductionError::Vanished {
            what: "the dark frames",
        });
    }
    Ok(sums)
}

/// Sum of squared deviations from the pixel's own mean, and its degrees of freedom.
fn scatter(sums: &Sums, pixel: usize) -> (f64, f64) {
    let n = f64::from(sums.frames);
    let dn = f64::from(sums.dn[pixel]);
    let about = sums.dn2[pixel] as f64 - dn * dn / n;
    (about.max(0.0), n - 1.0)
}

/// Returns the counts of dark current in the shortest exposure, from the levels of longer ones; 0 without another exposure.
fn dark_current_dn(sums: &[(f64, Sums)], exposure_s: f64) -> f64 {
    let level = |sums: &Sums| {
        let n = f64::from(sums.frames);
        let mut levels: Vec<f64> = sums.dn.iter().map(|dn| f64::from(*dn) / n).collect();
        median(&mut levels)
    };
    match (sums.first(), sums.last()) {
        (Some((short_s, short)), Some((long_s, long))) if long_s > short_s => {
            let per_s = (level(long) - level(short)) / (long_s - short_s);
            per_s.max(0.0) * exposure_s
        }
        _ => 0.0,
    }
}

/// Compares the scatter between repeats with the manifest's read noise. If they disagree, the repeats count.
fn check_read_noise(sums: &[(f64, Sums)], sensor: &mut Sensor, log: &mut ReductionLog) {
    let mut ratios = Vec::new();
    let pixels = sensor.pixels();
    // The shortest exposure has the least dark current in it.
    let Some((exposure_s, shortest)) = sums.iter().find(|(_, s)| s.frames > 1) else {
        return;
    };
    for pixel in 0..pixels {
        let (about, freedom) = scatter(shortest, pixel);
        ratios.push(about / freedom);
    }
    // The mean without the largest percent: hot pixels would dominate it.
    ratios.sort_unstable_by(f64::total_cmp);
    let kept = &ratios[..ratios.len() - ratios.len() / 100];
    let measured = kept.iter().sum::<f64>() / kept.len() as f64;
    let freedom = f64::from(shortest.frames - 1) * kept.len() as f64;
    // Dark current adds shot noise that grows with the exposure.
    let dark_dn = dark_current_dn(sums, *exposure_s);
    let expected = sensor.variance_dn2(dark_dn);
    let certain = (2.0 / freedom).sqrt() < 0.05;
    if certain && (measured > 1.5 * expected || measured < expected / 1.7) {
        log.warn(format!(
            "repeated dark frames of {exposure_s} s scatter by {:.2} DN but the manifest's gain and read noise, with the shot noise of {dark_dn:.1} DN of dark current (which grows with the exposure), predict {:.2} DN: the measured noise is used; check gain_dn_per_electron and read_noise_electrons_rms",
            measured.sqrt(),
            expected.sqrt()
        ));
        let read_dn2 = measured - sensor.gain_dn * dark_dn - 1.0 / 12.0;
        sensor.read_dn = read_dn2.max(0.0).sqrt();
    }
}

/// Returns the pixels without an outlying dark level or scatter between repeats.
fn good_pixels(sums: &[(f64, Sums)], sensor: &Sensor) -> Vec<bool> {
    let pixels = sensor.pixels();
    let mut good = vec![true; pixels];
    for (_, group) in sums {
        let n = f64::from(group.frames);
        let mut levels: Vec<f64> = group.dn.iter().map(|dn| f64::from(*dn) / n).collect();
        let (centre, spread) = robust_spread(&mut levels);
        let reach = DEFECT_SIGMAS * spread.max((sensor.variance_dn2(0.0) / n).sqrt());
        for (good, dn) in good.iter_mut().zip(&group.dn) {
            *good &= (f64::from(*dn) / n - centre).abs() <= reach;
        }
    }
    let expected: Vec<f64> = sums
        .iter()
        .map(|(_, s)| {
            let mut levels: Vec<f64> =
                s.dn.iter()
                    .map(|dn| f64::from(*dn) / f64::from(s.frames))
                    .collect();
            sensor.variance_dn2(median(&mut levels) - sensor.black_dn)
        })
        .collect();
    let freedom: f64 = sums.iter().map(|(_, s)| f64::from(s.frames) - 1.0).sum();
    if freedom >= 2.0 {
        let limit = freedom * reduced_chi2_at(freedom, 6.0);
        for (pixel, good) in good.iter_mut().enumerate() {
            let chi2: f64 = sums
                .iter()
                .zip(&expected)
                .map(|((_, s), variance)| scatter(s, pixel).0 / variance)
                .sum();
            *good &= chi2 <= limit;
        }
    }
    good
}
