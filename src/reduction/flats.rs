//! Flat frames → each pixel's response, defects, and how bright the white reference is per tilt.
//!
//! The response (vignetting × pixel response) belongs to the camera and is the same at every tilt,
//! so all flats are pooled; its mean over the good pixels is 1. The level of each flat stays apart:
//! it follows the lamp's cosine and holds stray light, which the fit settles.
//!
//! *Conditioning.* Counts of a pixel are added as whole numbers (of sixteenths of a count), so a frame that is taken out
//! again leaves no trace; the dark level comes off the sum once. A response is a quotient of sums over their mean,
//! right to the single precision that it is kept in (6e-8, a thousandth of its noise). A pixel or a block without
//! light gives 0 or no number: a defect both ways, never a response.

use rayon::prelude::*;

use super::ReductionError;
use super::darks::{Dark, Darks};
use super::journal::{Journal, Rejection};
use super::load::{Calls, load};
use super::pattern::{Differences, Expected, Verdict, compare};
use super::sensor::{Sensor, median, robust_spread};
use crate::frame::{Frame, FrameKind};
use crate::geometry::RigGeometry;
use crate::units::Angle;

/// Relative scatter of the lamp between frames where nothing measured says better.
const LAMP_SCATTER_DEFAULT: f64 = 5e-4;
/// Poses closer than this are the same pose.
pub(super) const SAME_ANGLE_DEG: f64 = 0.02;
/// A flat further than this share, and this many standard uncertainties of its own, from the others' common level is left
/// out.
const LEVEL_SHARE: f64 = 0.05;
const LEVEL_SIGMAS: f64 = 6.0;
/// The same share near the lamp: as a tilt moves the field towards it or away, its mean changes by this much.
const LEVEL_SHARE_NEAR: f64 = 0.3;

/// What the pixels make of uniform light.
#[derive(Debug, Clone)]
pub(super) struct Response {
    /// Relative response per pixel; mean 1 over good pixels.
    pub(super) pixels: Vec<f32>,
    /// Mean relative variance that the response has left from the flats.
    pub(super) variance: f64,
    /// Pixels that are no defects.
    pub(super) good: Vec<bool>,
}

/// The white reference at one tilt, in counts per second.
#[derive(Debug, Clone, Copy)]
pub(super) struct FlatLevel {
    pub(super) theta_c: Angle,
    pub(super) rate_dn_s: f64,
    pub(super) sigma_dn_s: f64,
}

/// What flats are judged by.
#[derive(Debug, Clone, Copy)]
pub(super) struct Scene {
    /// The sample fills the field evenly, so that it can stand in for missing flats.
    pub(super) uniform: bool,
    /// All pixels share directions and irradiance.
    pub(super) far: bool,
}

/// All flats of a series.
#[derive(Debug)]
pub(super) struct Flats {
    pub(super) response: Response,
    /// By tilt; empty without flats.
    pub(super) levels: Vec<FlatLevel>,
    /// Relative scatter of the lamp from frame to frame, as the flats show it; `None` where they are too few to tell.
    pub(super) lamp_scatter: Option<f64>,
    /// Flat frames used.
    pub(super) n_frames: u32,
}

struct Flat {
    index: usize,
    theta_c_deg: f64,
    exposure_s: f64,
    /// Mean counts above dark over good pixels.
    mean_dn: f64,
    /// Its standard uncertainty by counting and read noise, as a share.
    noise_share: f64,
}

impl Flats {
    /// Reads the flats. Without any the response comes from the sample frames themselves if
    /// `uniform` says that the sample fills the field evenly, and is 1 everywhere if not. Where lamp or camera is near
    /// (`far` is false) the field's mean follows more than the cosine at its centre, and shades off over the field.
    pub(super) fn read(
        calls: &Calls<'_>,
        sensor: &Sensor,
        darks: &Darks,
        rig: &RigGeometry,
        Scene { uniform, far }: Scene,
        journal: &mut Journal,
    ) -> Result<Self, ReductionError> {
        let reach = if far { LEVEL_SHARE } else { LEVEL_SHARE_NEAR };
        let mut flats = accepted(calls, sensor, darks, rig, FrameKind::Flat, reach, journal)?;
        if flats.is_empty() {
            let mut response = flat_response(darks);
            if uniform {
                let mut quiet = Journal::default();
                let kind = FrameKind::Sample;
                let samples = accepted(calls, sensor, darks, rig, kind, reach, &mut quiet)?;
                if samples.len() >= 5 {
                    let sums = Sums::of(calls, sensor, darks, &samples)?;
                    response = sums.response(sensor, darks);
                }
            }
            journal.warn(
                "no usable flat frame: the scale is relative and vignetting is judged from the sample itself; take frames of a white reference at each tilt for an absolute scale".to_owned(),
            );
            return Ok(Flats {
                response,
                levels: Vec::new(),
                lamp_scatter: None,
                n_frames: 0,
            });
        }
        let mut sums = Sums::of(calls, sensor, darks, &flats)?;
        let differences = match far {
            true => Differences::First,
            false => Differences::Second,
        };
        leave_out_displaced(
            calls,
            sensor,
            darks,
            differences,
            &mut flats,
            &mut sums,
            journal,
        )?;
        let response = sums.response(sensor, darks);
        let bad = response.good.iter().filter(|g| !**g).count();
        if bad * 50 > sensor.pixels() {
            journal.warn(format!(
                "{bad} of {} pixels are defects and left out; is the sensor dirty?",
                sensor.pixels()
            ));
        }
        let rates: Vec<(Flat, f64, f64)> = flats
            .into_par_iter()
            .map(|flat| {
                calls.check_cancel()?;
                let frame =
                    load(calls, flat.index, sensor).map_err(|_| ReductionError::Vanished {
                        what: "the flat frames",
                    })?;
                let (rate, variance) = rate_of(&frame, &flat, sensor, darks, &response);
                Ok((flat, rate, variance))
            })
            .collect::<Result<_, ReductionError>>()?;
        let lamp_scatter = lamp_scatter(&rates, rig);
        let n_frames = rates.len() as u32;
        Ok(Flats {
            response,
            levels: by_tilt(rates, lamp_scatter.unwrap_or(LAMP_SCATTER_DEFAULT)),
            lamp_scatter,
            n_frames,
        })
    }
}

fn flat_response(darks: &Darks) -> Response {
    Response {
        pixels: vec![1.0; darks.good.len()],
        variance: 0.0,
        good: darks.good.clone(),
    }
}

/// Frames of one kind that are readable, not full, bright, and (flats) on the lamp's cosine.
fn accepted(
    calls: &Calls<'_>,
    sensor: &Sensor,
    darks: &Darks,
    rig: &RigGeometry,
    kind: FrameKind,
    level_share: f64,
    journal: &mut Journal,
) -> Result<Vec<Flat>, ReductionError> {
    let rows = calls.source.rows();
    let checked: Vec<(usize, Result<Flat, Rejection>)> = calls
        .rows_of(kind)
        .par_iter()
        .map(|index| {
            calls.check_cancel()?;
            let row = &rows[*index];
            let dark = darks.at(row.exposure_s);
            let current = (dark.mean_dn - sensor.black_dn).max(0.0);
            let pixels = darks.good.iter().filter(|good| **good).count().max(1);
            let flat = mean_of(calls, *index, sensor, darks).map(|mean_dn| {
                let variance = sensor.variance_dn2(mean_dn.max(0.0) + current) + dark.variance_dn2;
                Flat {
                    index: *index,
                    theta_c_deg: row.theta_c_deg,
                    exposure_s: row.exposure_s,
                    mean_dn,
                    noise_share: (variance / pixels as f64).sqrt() / mean_dn.abs(),
                }
            });
            Ok((*index, flat))
        })
        .collect::<Result<_, ReductionError>>()?;
    let mut flats = Vec::new();
    for (index, flat) in checked {
        match flat {
            Ok(flat) => flats.push(flat),
            Err(rejection) => journal.reject(index, rejection),
        }
    }
    if kind != FrameKind::Flat {
        return Ok(flats);
    }
    let relative = |f: &Flat| {
        f.mean_dn / f.exposure_s / rig.cos_incidence(Angle::from_deg(f.theta_c_deg)).max(0.05)
    };
    let usual = median(&mut flats.iter().map(relative).collect::<Vec<_>>());
    let judge = flats.len() > 2;
    flats.retain(|flat| {
        let share = relative(flat) / usual - 1.0;
        // Dim flats scatter by their noise; one that is off by less is as good as any.
        let reach = level_share.max(LEVEL_SIGMAS * flat.noise_share);
        let refused = if share < -0.9 || usual <= 0.0 {
            Some(("black", "it shows next to no light".to_owned()))
        } else if judge && share.abs() > reach {
            Some((
                "level",
                format!(
                    "{:+.1} % off the other flats, the lamp's cosine taken out",
                    share * 100.0
                ),
            ))
        } else {
            None
        };
        if let Some((reason, detail)) = &refused {
            journal.reject(flat.index, Rejection::new(reason, detail.clone()));
        }
        refused.is_none()
    });
    Ok(flats)
}

/// Mean counts above dark of a frame that is not clipped.
fn mean_of(
    calls: &Calls<'_>,
    index: usize,
    sensor: &Sensor,
    darks: &Darks,
) -> Result<f64, Rejection> {
    let frame = load(calls, index, sensor)?;
    let dark = darks.at(calls.source.rows()[index].exposure_s);
    let (mut n, mut full, mut total) = (0_usize, 0_usize, 0.0);
    for (pixel, dn) in frame.pixels_dn().iter().enumerate() {
        if darks.good[pixel] {
            n += 1;
            full += usize::from(sensor.is_full(*dn));
            total += dark.linear_dn(pixel, *dn) - f64::from(dark.level_dn[pixel]);
        }
    }
    let detail = || format!("{full} of {n} pixels are full");
    if full * 2 > n {
        return Err(Rejection::new("saturated", detail()));
    }
    if full > 3 + n / 1000 {
        return Err(Rejection::new("partly saturated", detail()));
    }
    Ok(total / n.max(1) as f64)
}

/// Counts are summed in so many parts of one: whole counts stay whole, and those corrected for the camera's curve lose nothing.
const PARTS: f64 = 16.0;

/// Whole-number sums of counts in parts of one, a set per exposure time.
struct Sums {
    groups: Vec<(f64, u32, Vec<u64>)>,
}

/// A linear camera's count in whole parts.
fn in_parts(dark: &Dark, pixel: usize, dn: u16) -> u64 {
    (PARTS * dark.linear_dn(pixel, dn)).round() as u64
}

impl Sums {
    fn of(
        calls: &Calls<'_>,
        sensor: &Sensor,
        darks: &Darks,
        flats: &[Flat],
    ) -> Result<Self, ReductionError> {
        let mut exposures: Vec<f64> = flats.iter().map(|f| f.exposure_s).collect();
        exposures.sort_unstable_by(f64::total_cmp);
        exposures.dedup();
        let groups = exposures
            .into_par_iter()
            .map(|exposure_s| {
                let mut total = vec![0_u64; sensor.pixels()];
                let mut frames = 0;
                let dark = darks.at(exposure_s);
                for flat in flats.iter().filter(|f| f.exposure_s == exposure_s) {
                    calls.check_cancel()?;
                    let Ok(frame) = load(calls, flat.index, sensor) else {
                        continue;
                    };
                    frames += 1;
                    for (pixel, dn) in frame.pixels_dn().iter().enumerate() {
                        total[pixel] += in_parts(&dark, pixel, *dn);
                    }
                }
                Ok((exposure_s, frames, total))
            })
            .collect::<Result<_, ReductionError>>()?;
        Ok(Sums { groups })
    }

    fn remove(&mut self, flat: &Flat, frame: &Frame, darks: &Darks) {
        let dark = darks.at(flat.exposure_s);
        for (_, frames, total) in self
            .groups
            .iter_mut()
            .filter(|(exposure_s, ..)| *exposure_s == flat.exposure_s)
        {
            *frames -= 1;
            for (pixel, dn) in frame.pixels_dn().iter().enumerate() {
                total[pixel] -= in_parts(&dark, pixel, *dn);
            }
        }
    }

    /// Counts above dark per pixel, summed over all frames (`minus` one of them).
    fn light(&self, darks: &Darks, minus: Option<(&Flat, &Frame)>) -> Vec<f64> {
        let mut light = vec![0.0; darks.good.len()];
        for (exposure_s, frames, total) in &self.groups {
            let own = minus.filter(|(flat, _)| flat.exposure_s == *exposure_s);
            let n = f64::from(*frames) - f64::from(u8::from(own.is_some()));
            let dark = darks.at(*exposure_s);
            for (pixel, light) in light.iter_mut().enumerate() {
                let less = own.map_or(0, |(_, frame)| {
                    in_parts(&dark, pixel, frame.pixels_dn()[pixel])
                });
                let counts = (total[pixel] - less) as f64 / PARTS;
                *light += counts - n * f64::from(dark.level_dn[pixel]);
            }
        }
        light
    }

    /// Relative response, defects marked.
    fn response(&self, sensor: &Sensor, darks: &Darks) -> Response {
        let light = self.light(darks, None);
        let mut good = darks.good.clone();
        mark_defects(&light, sensor, &mut good);
        let (n, total) = light
            .iter()
            .zip(&good)
            .filter(|(_, good)| **good)
            .fold((0_u32, 0.0), |(n, t), (x, _)| (n + 1, t + x));
        let mean = (total / f64::from(n.max(1))).max(f64::MIN_POSITIVE);
        let mut noise = sensor.gain_dn * mean;
        for (exposure_s, frames, _) in &self.groups {
            let frames = f64::from(*frames);
            noise += frames * sensor.variance_dn2(0.0)
                + frames * frames * darks.at(*exposure_s).variance_dn2;
        }
        Response {
            pixels: light.iter().map(|x| (x / mean) as f32).collect(),
            variance: noise / (mean * mean),
            good,
        }
    }
}

/// Marks pixels whose response stands out from their surroundings: dead, stuck, dirty.
fn mark_defects(light: &[f64], sensor: &Sensor, good: &mut [bool]) {
    const BLOCK: usize = 16;
    let columns = sensor.width.div_ceil(BLOCK);
    let block_of =
        |pixel: usize| (pixel / sensor.width / BLOCK) * columns + (pixel % sensor.width) / BLOCK;
    let mut blocks = vec![Vec::new(); columns * sensor.height.div_ceil(BLOCK)];
    for (pixel, x) in light.iter().enumerate() {
        if good[pixel] {
            blocks[block_of(pixel)].push(*x);
        }
    }
    let usual: Vec<f64> = blocks.iter_mut().map(|b| median(b)).collect();
    let relative = |pixel: usize| light[pixel] / usual[block_of(pixel)] - 1.0;
    let mut away: Vec<f64> = (0..light.len())
        .filter(|p| good[*p])
        .map(relative)
        .collect();
    let (_, spread) = robust_spread(&mut away);
    let reach = (8.0 * spread).max(0.02);
    for (pixel, good) in good.iter_mut().enumerate() {
        // NaN (a block without light) is a defect too.
        *good &= relative(pixel).abs() <= reach;
    }
}

/// Leaves out, one after the other, flats that do not carry the pattern of all the others.
fn leave_out_displaced(
    calls: &Calls<'_>,
    sensor: &Sensor,
    darks: &Darks,
    differences: Differences,
    flats: &mut Vec<Flat>,
    sums: &mut Sums,
    journal: &mut Journal,
) -> Result<(), ReductionError> {
    let even = vec![1.0; sensor.pixels()];
    while flats.len() > 2 {
        let verdicts: Vec<Verdict> = flats
            .par_iter()
            .map(|flat| {
                calls.check_cancel()?;
                let Ok(frame) = load(calls, flat.index, sensor) else {
                    return Ok(Verdict::Absent);
                };
                let others = sums.light(darks, Some((flat, &frame)));
                let dark = darks.at(flat.exposure_s);
                let labels: Vec<u16> = darks
                    .good
                    .iter()
                    .zip(&others)
                    .map(|(good, x)| if *good && *x > 0.0 { 0 } else { u16::MAX })
                    .collect();
                let mean_others = others.iter().sum::<f64>() / others.len().max(1) as f64;
                let share = flat.mean_dn / mean_others;
                let response: Vec<f32> = others.iter().map(|x| (x * share) as f32).collect();
                // Poisson noise of the other flats, scaled to this one.
                let variance_dn2 =
                    share * share * sensor.variance_dn2(mean_others) + dark.variance_dn2;
                Ok(compare(
                    frame.pixels_dn(),
                    &Expected {
                        dark_dn: &dark.level_dn,
                        response: &response,
                        light_dn: &even,
                        variance_dn2,
                        labels: &labels,
                        width: sensor.width,
                        differences,
                    },
                ))
            })
            .collect::<Result<_, ReductionError>>()?;
        let Some(worst) = verdicts.iter().position(|v| *v != Verdict::InPlace) else {
            break;
        };
        let flat = flats.remove(worst);
        if let Ok(frame) = load(calls, flat.index, sensor) {
            sums.remove(&flat, &frame, darks);
        }
        journal.reject(flat.index, displaced(verdicts[worst]));
    }
    Ok(())
}

/// The words for a frame whose pattern is not in its place.
pub(super) fn displaced(verdict: Verdict) -> Rejection {
    match verdict {
        Verdict::Shifted(columns, rows) => Rejection::new(
            "shifted",
            format!(
                "the sensor's fixed pattern lies {columns:+} columns, {rows:+} rows from its place"
            ),
        ),
        Verdict::Torn { tiles } => Rejection::new(
            "torn",
            format!("the sensor's fixed pattern is missing in {tiles} of 16 parts of the frame"),
        ),
        Verdict::Absent | Verdict::InPlace => Rejection::new(
            "shifted",
            "the sensor's fixed pattern is not where it is in the other frames",
        ),
    }
}

/// Level in counts per second at response 1, and its variance.
fn rate_of(
    frame: &Frame,
    flat: &Flat,
    sensor: &Sensor,
    darks: &Darks,
    response: &Response,
) -> (f64, f64) {
    let dark = darks.at(flat.exposure_s);
    let (mut n, mut total, mut weight) = (0.0, 0.0, 0.0);
    for (pixel, dn) in frame.pixels_dn().iter().enumerate() {
        if response.good[pixel] && !sensor.is_full(*dn) {
            n += 1.0;
            total += dark.linear_dn(pixel, *dn) - f64::from(dark.level_dn[pixel]);
            weight += f64::from(response.pixels[pixel]);
        }
    }
    let current = dark.mean_dn - sensor.black_dn;
    let variance = n * (sensor.variance_dn2(total / n + current) + dark.variance_dn2);
    let scale = weight * flat.exposure_s;
    (total / scale, variance / (scale * scale))
}

/// Relative scatter of the flats about K (cos θi + a sin θi + s), counting noise taken out; `None`
/// where there are too few to tell.
fn lamp_scatter(rates: &[(Flat, f64, f64)], rig: &RigGeometry) -> Option<f64> {
    const FREEDOM_MIN: usize = 3;
    if rates.len() < 3 + FREEDOM_MIN {
        return None;
    }
    let mean = rates.iter().map(|(_, rate, _)| rate).sum::<f64>() / rates.len() as f64;
    let basis = |flat: &Flat| {
        let theta = Angle::from_deg(flat.theta_c_deg);
        let cos = rig.cos_incidence(theta);
        let step = Angle::from_deg(0.5);
        let slope = rig.cos_incidence(theta + step) - rig.cos_incidence(theta - step);
        nalgebra::Vector3::new(cos, slope * 50.0, 1.0)
    };
    let rows = rates.len();
    let matrix = nalgebra::DMatrix::from_fn(rows, 3, |i, j| basis(&rates[i].0)[j]);
    let seen = nalgebra::DVector::from_fn(rows, |i, _| rates[i].1 / mean);
    // Flats at one or two tilts leave the basis short of rank; the pseudo-inverse copes.
    let svd = matrix.clone().svd(true, true);
    let tolerance = 1e-9 * svd.singular_values.max();
    let rank = svd.rank(tolerance);
    let solution = svd.solve(&seen, tolerance).ok()?;
    let left = (matrix * solution - seen).norm_squared() / (rows - rank) as f64;
    let noise =
        rates.iter().map(|(_, _, variance)| variance).sum::<f64>() / (rows as f64 * mean * mean);
    Some((left - noise).max(0.0).sqrt())
}

/// Flats of one tilt averaged with their weights.
fn by_tilt(mut rates: Vec<(Flat, f64, f64)>, lamp_scatter: f64) -> Vec<FlatLevel> {
    rates.sort_by(|a, b| {
        (a.0.theta_c_deg, a.0.index)
            .partial_cmp(&(b.0.theta_c_deg, b.0.index))
            .expect("angles are finite")
    });
    let mut levels: Vec<FlatLevel> = Vec::new();
    let mut from = 0;
    while from < rates.len() {
        let first = rates[from].0.theta_c_deg;
        let group: Vec<&(Flat, f64, f64)> = rates[from..]
            .iter()
            .take_while(|(flat, ..)| flat.theta_c_deg - first <= SAME_ANGLE_DEG)
            .collect();
        let (mut weight, mut rate, mut theta) = (0.0, 0.0, 0.0);
        for (flat, r, variance) in &group {
            let w = 1.0 / (variance + (lamp_scatter * r).powi(2));
            weight += w;
            rate += w * r;
            theta += flat.theta_c_deg;
        }
        levels.push(FlatLevel {
            theta_c: Angle::from_deg(theta / group.len() as f64),
            rate_dn_s: rate / weight,
            sigma_dn_s: (1.0 / weight).sqrt(),
        });
        from += group.len();
    }
    levels
}
