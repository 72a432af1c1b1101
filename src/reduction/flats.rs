//! Flat frames → the response of each pixel, defects, and the level of the white reference per tilt.
//!
//! The response (vignetting × pixel response) belongs to the camera and is the same at every tilt, so all flats are pooled;
//! its mean over the good pixels is 1. The levels of the flats stay separate: they follow the lamp's cosine and contain stray
//! light, which the fit determines.
//!
//! *Conditioning.* Counts of a pixel are added as integers (of sixteenths of a count), so a frame that is removed again leaves
//! no trace; the dark level is subtracted from the sum once. A response is a quotient of sums over their mean,
//! right to the single precision that it is kept in (6e-8, a thousandth of its noise). A pixel or a block without
//! light gives 0 or no number: a defect both ways, never a response.

use std::collections::BTreeMap;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::ReductionError;
use super::darks::{Dark, DarkNoise, Darks};
use super::levels::{CELLS, Moments};
use super::load::{Calls, load};
use super::pattern::{Differences, Expected, Verdict, compare};
use super::reduction_log::{ReductionLog, Rejection};
use super::sensor::{Sensor, median, robust_spread};
use crate::frame::{Frame, FrameKind};
use crate::geometry::RigGeometry;
use crate::units::Angle;

/// Relative scatter of the lamp between frames, if the flats do not determine it.
const LAMP_SCATTER_DEFAULT: f64 = 5e-4;
/// Poses closer than this are the same pose.
pub(super) const SAME_ANGLE_DEG: f64 = 0.02;
/// A flat further than this share, and this many standard uncertainties of its own, from the others' common level is left
/// out.
const LEVEL_SHARE: f64 = 0.05;
const LEVEL_SIGMAS: f64 = 6.0;
/// The same share near the lamp: a tilt moves the field towards or away from it, which changes the mean by this much.
const LEVEL_SHARE_NEAR: f64 = 0.3;

/// The response of the pixels to uniform light.
#[derive(Debug, Clone)]
pub(super) struct Response {
    /// Relative response per pixel; mean 1 over good pixels.
    pub(super) pixels: Vec<f32>,
    /// The flats' relative brightness per pixel, where it is not the response alone: near a lamp its pattern is in it.
    pub(super) flat: Option<Vec<f32>>,
    /// Mean relative variance of the response, from the noise of the flats.
    pub(super) variance: f64,
    /// Part of the summed flats' variance that does not grow with their light, DN².
    pub(super) noise_dn2: f64,
    /// Pixels that are no defects.
    pub(super) good: Vec<bool>,
}

impl Response {
    /// The flats' relative brightness at a pixel.
    pub(super) fn flat(&self, pixel: usize) -> f32 {
        self.flat.as_ref().unwrap_or(&self.pixels)[pixel]
    }

    /// Number of good pixels, sum and sum of squares of the flats' relative brightness there, by cell.
    pub(super) fn cells(&self, sensor: &Sensor) -> Vec<[f64; 3]> {
        let cell_of = cell_of(sensor);
        let mut cells = vec![[0.0; 3]; CELLS * CELLS];
        for pixel in (0..self.good.len()).filter(|pixel| self.good[*pixel]) {
            let (cell, flat) = (&mut cells[cell_of(pixel)], f64::from(self.flat(pixel)));
            cell[0] += 1.0;
            cell[1] += flat;
            cell[2] += flat * flat;
        }
        cells
    }
}

/// The white reference at one tilt, in counts per second.
#[derive(Debug, Clone)]
pub(super) struct FlatLevel {
    pub(super) theta_c: Angle,
    pub(super) rate_dn_s: f64,
    pub(super) sigma_dn_s: f64,
    /// Its frames, by their rows.
    pub(super) frames: Vec<usize>,
}

/// Properties of the field that decide how flats are judged.
#[derive(Debug, Clone, Copy)]
pub(super) struct Field {
    /// The sample fills the field evenly, so that it can replace missing flats.
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
    /// Exposure times and mean counts of the frames that make the response.
    pub(super) lights: Vec<(f64, f64)>,
    /// All flats that can be read and are not full.
    pub(super) frames: Vec<FlatFrame>,
    /// By tilt: the share of the level that is the lamp's pattern; empty where the lamp is far.
    pub(super) lamp_shares: Vec<f64>,
}

/// A flat that can be read and is not full: what judges it, and what its level is made of.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FlatFrame {
    pub(super) index: usize,
    pub(super) theta_c_deg: f64,
    pub(super) exposure_s: f64,
    /// Mean counts above dark over good pixels.
    pub(super) mean_dn: f64,
    /// Its standard uncertainty by counting and read noise, as a share.
    pub(super) noise_share: f64,
    /// Moments of the counts above dark, by cell: over the pixels that make the level, or over all good ones of a frame that
    /// is left out.
    pub(super) cells: Vec<Moments>,
    /// Sums that make the level; none of a frame that is left out.
    pub(super) level: Option<LevelSums>,
}

/// Sums over the good pixels of a flat that are not full.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct LevelSums {
    n: f64,
    /// Σ counts above dark of a linear camera.
    pub(super) total: f64,
    /// Σ responses.
    weight: f64,
}

/// The level of one flat.
#[derive(Debug, Clone, Copy)]
pub(super) struct FlatRate {
    pub(super) index: usize,
    pub(super) theta_c_deg: f64,
    rate_dn_s: f64,
    variance: f64,
}

impl LevelSums {
    /// Level in counts per second at response 1, and its variance.
    pub(super) fn rate(&self, flat: &FlatFrame, sensor: &Sensor, dark: &DarkNoise) -> FlatRate {
        let current = dark.mean_dn - sensor.black_dn;
        let variance =
            self.n * (sensor.variance_dn2(self.total / self.n + current) + dark.variance_dn2);
        let scale = self.weight * flat.exposure_s;
        FlatRate {
            index: flat.index,
            theta_c_deg: flat.theta_c_deg,
            rate_dn_s: self.total / scale,
            variance: variance / (scale * scale),
        }
    }
}

/// What reading flats needs beside the frames.
pub(super) struct FlatContext<'a> {
    pub(super) calls: &'a Calls<'a>,
    pub(super) sensor: &'a Sensor,
    pub(super) darks: &'a Darks,
    pub(super) rig: &'a RigGeometry,
    pub(super) field: Field,
    /// Why flats are left out for their level, by their place in the list, where that was judged already.
    pub(super) judged: Option<&'a Judged>,
}

/// Flats that are left out for their level, with the reason.
pub(super) type Judged = BTreeMap<usize, Rejection>;

impl Flats {
    /// Reads the flats. Without flats, the response comes from the sample frames if the sample fills the field evenly
    /// (`uniform`), and is 1 everywhere otherwise. If lamp or camera is near (`far` is false), the mean of the field deviates
    /// from the cosine at its centre, and the brightness varies over the field.
    pub(super) fn read(
        context: &FlatContext<'_>,
        log: &mut ReductionLog,
    ) -> Result<Self, ReductionError> {
        let FlatContext {
            calls,
            sensor,
            darks,
            rig,
            field,
            ..
        } = *context;
        let mut all = readable(calls, sensor, darks, FrameKind::Flat, log)?;
        let judged = match context.judged {
            Some(judged) => judged.clone(),
            None => judge(&all, rig, field.far),
        };
        for (index, rejection) in &judged {
            log.reject(*index, rejection.clone());
        }
        let is_used = |flat: &FlatFrame, log: &ReductionLog| !log.has_rejected(flat.index);
        let mut flats: Vec<FlatFrame> = (all.iter())
            .filter(|flat| is_used(flat, log))
            .cloned()
            .collect();
        if flats.is_empty() {
            let mut response = flat_response(darks);
            let mut lights = Vec::new();
            if field.uniform {
                let mut quiet = ReductionLog::default();
                let samples = readable(calls, sensor, darks, FrameKind::Sample, &mut quiet)?;
                if samples.len() >= 5 {
                    let sums = Sums::of(calls, sensor, darks, &samples)?;
                    response = sums.response(sensor, darks);
                    lights = samples.iter().map(|f| (f.exposure_s, f.mean_dn)).collect();
                }
            }
            log.warn(
                "no usable flat frame: the scale is relative and vignetting is estimated from the sample; take frames of a white reference at each tilt for an absolute scale".to_owned(),
            );
            return Ok(Flats {
                response,
                levels: Vec::new(),
                lights,
                frames: all,
                lamp_shares: Vec::new(),
            });
        }
        let mut sums = Sums::of(calls, sensor, darks, &flats)?;
        let differences = match field.far {
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
            log,
        )?;
        let response = sums.response(sensor, darks);
        let bad = response.good.iter().filter(|g| !**g).count();
        if bad * 50 > sensor.pixels() {
            log.warn(format!(
                "{bad} of {} pixels are defects and left out; check the sensor for dirt",
                sensor.pixels()
            ));
        }
        let noises = darks.noises();
        flats
            .par_iter_mut()
            .map(|flat| {
                calls.check_cancel()?;
                let frame =
                    load(calls, flat.index, sensor).map_err(|_| ReductionError::Vanished {
                        what: "the flat frames",
                    })?;
                set_level(flat, &frame, sensor, darks, &response);
                Ok(())
            })
            .collect::<Result<(), ReductionError>>()?;
        let rate = |flat: &FlatFrame| {
            let level = flat.level.as_ref()?;
            Some(level.rate(flat, sensor, &noises.at(flat.exposure_s)))
        };
        let rates: Vec<FlatRate> = flats.iter().filter_map(rate).collect();
        let lamp_scatter = lamp_scatter(&rates, rig);
        let lights = flats.iter().map(|f| (f.exposure_s, f.mean_dn)).collect();
        for flat in flats {
            if let Some(place) = all.iter_mut().find(|f| f.index == flat.index) {
                *place = flat;
            }
        }
        Ok(Flats {
            response,
            levels: by_tilt(rates, lamp_scatter),
            lights,
            frames: all,
            lamp_shares: Vec::new(),
        })
    }
}

fn flat_response(darks: &Darks) -> Response {
    Response {
        pixels: vec![1.0; darks.good.len()],
        flat: None,
        variance: 0.0,
        noise_dn2: 0.0,
        good: darks.good.clone(),
    }
}

/// Frames of one kind that are readable and not full.
fn readable(
    calls: &Calls<'_>,
    sensor: &Sensor,
    darks: &Darks,
    kind: FrameKind,
    log: &mut ReductionLog,
) -> Result<Vec<FlatFrame>, ReductionError> {
    let rows = calls.source.rows();
    let checked: Vec<(usize, Result<FlatFrame, Rejection>)> = calls
        .rows_of(kind)
        .par_iter()
        .map(|index| {
            calls.check_cancel()?;
            let row = &rows[*index];
            let dark = darks.at(row.exposure_s);
            let current = (dark.mean_dn - sensor.black_dn).max(0.0);
            let pixels = darks.good.iter().filter(|good| **good).count().max(1);
            let flat = mean_of(calls, *index, sensor, darks).map(|(mean_dn, cells)| {
                let variance = sensor.variance_dn2(mean_dn.max(0.0) + current) + dark.variance_dn2;
                FlatFrame {
                    index: *index,
                    theta_c_deg: row.theta_c_deg,
                    exposure_s: row.exposure_s,
                    mean_dn,
                    noise_share: (variance / pixels as f64).sqrt() / mean_dn.abs(),
                    cells,
                    level: None,
                }
            });
            Ok((*index, flat))
        })
        .collect::<Result<_, ReductionError>>()?;
    let mut flats = Vec::new();
    for (index, flat) in checked {
        match flat {
            Ok(flat) => flats.push(flat),
            Err(rejection) => log.reject(index, rejection),
        }
    }
    Ok(flats)
}

/// Returns the flats that are black, or off the lamp's cosine that the others follow.
pub(super) fn judge(flats: &[FlatFrame], rig: &RigGeometry, far: bool) -> Judged {
    let level_share = if far { LEVEL_SHARE } else { LEVEL_SHARE_NEAR };
    let relative = |f: &FlatFrame| {
        f.mean_dn / f.exposure_s / rig.cos_incidence(Angle::from_deg(f.theta_c_deg)).max(0.05)
    };
    let usual = median(&mut flats.iter().map(relative).collect::<Vec<_>>());
    let judge = flats.len() > 2;
    let refused = |flat: &FlatFrame| {
        let share = relative(flat) / usual - 1.0;
        // Dim flats scatter by their noise; a smaller deviation is no fault.
        let reach = level_share.max(LEVEL_SIGMAS * flat.noise_share);
        if share < -0.9 || usual <= 0.0 {
            let why = match flat.mean_dn < 0.0 {
                true => {
                    "it is darker than the dark frames: light reached those, or their kinds are swapped"
                }
                false => "it shows almost no light",
            };
            Some(Rejection::new("black", why))
        } else if judge && share.abs() > reach {
            Some(Rejection::new(
                "level",
                format!(
                    "{:+.1} % off the other flats, corrected for the lamp's cosine",
                    share * 100.0
                ),
            ))
        } else {
            None
        }
    };
    let refused = flats.iter().map(|flat| (flat.index, refused(flat)));
    refused
        .filter_map(|(index, why)| Some((index, why?)))
        .collect()
}

/// Number of the cell that a pixel is in.
fn cell_of(sensor: &Sensor) -> impl Fn(usize) -> usize {
    let (width, height) = (sensor.width, sensor.height);
    move |pixel| (pixel / width * CELLS / height) * CELLS + pixel % width * CELLS / width
}

/// Mean counts above dark of a frame that is not clipped, and their moments by cell.
fn mean_of(
    calls: &Calls<'_>,
    index: usize,
    sensor: &Sensor,
    darks: &Darks,
) -> Result<(f64, Vec<Moments>), Rejection> {
    let frame = load(calls, index, sensor)?;
    let dark = darks.at(calls.source.rows()[index].exposure_s);
    let (mut n, mut full, mut total) = (0_usize, 0_usize, 0.0);
    let cell_of = cell_of(sensor);
    let mut cells = vec![Moments::default(); CELLS * CELLS];
    for (pixel, dn) in frame.pixels_dn().iter().enumerate() {
        if darks.good[pixel] {
            n += 1;
            full += usize::from(sensor.is_full(*dn));
            let counts = dark.linear_dn(pixel, *dn) - f64::from(dark.level_dn[pixel]);
            total += counts;
            cells[cell_of(pixel)].add(counts);
        }
    }
    let detail = || format!("{full} of {n} pixels are full");
    if full * 2 > n {
        return Err(Rejection::new("saturated", detail()));
    }
    if full > 3 + n / 1000 {
        return Err(Rejection::new("partly saturated", detail()));
    }
    Ok((total / n.max(1) as f64, cells))
}

/// Parts of a count in the sums: integer counts stay exact, and counts corrected for the camera's curve keep their precision.
const PARTS: f64 = 16.0;

/// Integer sums of counts in sixteenths, one set per exposure time.
struct Sums {
    groups: Vec<(f64, u32, Vec<u64>)>,
}

/// Returns a linear camera's count in sixteenths.
fn in_parts(dark: &Dark, pixel: usize, dn: u16) -> u64 {
    (PARTS * dark.linear_dn(pixel, dn)).round() as u64
}

impl Sums {
    fn of(
        calls: &Calls<'_>,
        sensor: &Sensor,
        darks: &Darks,
        flats: &[FlatFrame],
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

    fn remove(&mut self, flat: &FlatFrame, frame: &Frame, darks: &Darks) {
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

    /// Returns the counts above dark per pixel, summed over all frames (without the frame `minus`).
    fn light(&self, darks: &Darks, minus: Option<(&FlatFrame, &Frame)>) -> Vec<f64> {
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
            flat: None,
            variance: noise / (mean * mean),
            noise_dn2: noise - sensor.gain_dn * mean,
            good,
        }
    }
}

/// Marks pixels whose response deviates from their surroundings: dead, stuck, dirty.
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

/// Leaves out, one by one, flats without the fixed pattern of the others.
fn leave_out_displaced(
    calls: &Calls<'_>,
    sensor: &Sensor,
    darks: &Darks,
    differences: Differences,
    flats: &mut Vec<FlatFrame>,
    sums: &mut Sums,
    log: &mut ReductionLog,
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
        log.reject(flat.index, displaced(verdicts[worst]));
    }
    Ok(())
}

/// Returns the rejection of a frame whose fixed pattern is displaced.
pub(super) fn displaced(verdict: Verdict) -> Rejection {
    match verdict {
        Verdict::Shifted(columns, rows) => Rejection::new(
            "shifted",
            format!(
                "the sensor's fixed pattern is displaced by {columns:+} columns, {rows:+} rows"
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

/// Sums the pixels that make the level of a flat.
fn set_level(
    flat: &mut FlatFrame,
    frame: &Frame,
    sensor: &Sensor,
    darks: &Darks,
    response: &Response,
) {
    let dark = darks.at(flat.exposure_s);
    let (mut n, mut total, mut weight) = (0.0, 0.0, 0.0);
    let cell_of = cell_of(sensor);
    let mut cells = vec![Moments::default(); CELLS * CELLS];
    for (pixel, dn) in frame.pixels_dn().iter().enumerate() {
        if response.good[pixel] && !sensor.is_full(*dn) {
            n += 1.0;
            let counts = dark.linear_dn(pixel, *dn) - f64::from(dark.level_dn[pixel]);
            total += counts;
            weight += f64::from(response.pixels[pixel]);
            cells[cell_of(pixel)].add(counts);
        }
    }
    flat.level = Some(LevelSums { n, total, weight });
    flat.cells = cells;
}

/// Returns the relative scatter of the flats about K (cos θi + a sin θi + s) beyond counting noise; `None` for too few flats.
pub(super) fn lamp_scatter(rates: &[FlatRate], rig: &RigGeometry) -> Option<f64> {
    const FREEDOM_MIN: usize = 3;
    if rates.len() < 3 + FREEDOM_MIN {
        return None;
    }
    let mean = rates.iter().map(|r| r.rate_dn_s).sum::<f64>() / rates.len() as f64;
    let basis = |flat: &FlatRate| {
        let theta = Angle::from_deg(flat.theta_c_deg);
        let cos = rig.cos_incidence(theta);
        let step = Angle::from_deg(0.5);
        let slope = rig.cos_incidence(theta + step) - rig.cos_incidence(theta - step);
        nalgebra::Vector3::new(cos, slope * 50.0, 1.0)
    };
    let rows = rates.len();
    let matrix = nalgebra::DMatrix::from_fn(rows, 3, |i, j| basis(&rates[i])[j]);
    let seen = nalgebra::DVector::from_fn(rows, |i, _| rates[i].rate_dn_s / mean);
    // Flats at one or two tilts make the basis rank-deficient, hence the pseudo-inverse.
    let svd = matrix.clone().svd(true, true);
    let tolerance = 1e-9 * svd.singular_values.max();
    let rank = svd.rank(tolerance);
    let solution = svd.solve(&seen, tolerance).ok()?;
    let left = (matrix * solution - seen).norm_squared() / (rows - rank) as f64;
    let noise = rates.iter().map(|r| r.variance).sum::<f64>() / (rows as f64 * mean * mean);
    Some((left - noise).max(0.0).sqrt())
}

/// Flats of one tilt averaged with their weights.
pub(super) fn by_tilt(mut rates: Vec<FlatRate>, lamp_scatter: Option<f64>) -> Vec<FlatLevel> {
    let lamp_scatter = lamp_scatter.unwrap_or(LAMP_SCATTER_DEFAULT);
    rates.sort_by(|a, b| {
        (a.theta_c_deg, a.index)
            .partial_cmp(&(b.theta_c_deg, b.index))
            .expect("angles are finite")
    });
    let mut levels: Vec<FlatLevel> = Vec::new();
    let mut from = 0;
    while from < rates.len() {
        let first = rates[from].theta_c_deg;
        let group: Vec<&FlatRate> = rates[from..]
            .iter()
            .take_while(|flat| flat.theta_c_deg - first <= SAME_ANGLE_DEG)
            .collect();
        let (mut weight, mut rate, mut theta) = (0.0, 0.0, 0.0);
        for flat in &group {
            let w = 1.0 / (flat.variance + (lamp_scatter * flat.rate_dn_s).powi(2));
            weight += w;
            rate += w * flat.rate_dn_s;
            theta += flat.theta_c_deg;
        }
        levels.push(FlatLevel {
            theta_c: Angle::from_deg(theta / group.len() as f64),
            rate_dn_s: rate / weight,
            sigma_dn_s: (1.0 / weight).sqrt(),
            frames: group.iter().map(|flat| flat.index).collect(),
        });
        from += group.len();
    }
    levels
}
