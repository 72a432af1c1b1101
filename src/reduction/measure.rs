//! One sample frame → the level of each segment, or the reason why the frame is left out.
//!
//! *Conditioning.* Dark level and response are taken off pixel by pixel before anything is summed, so a mean loses nothing to
//! black. A cell's variance is Σv² − (Σv)²/n over at most a sixty-fourth of a frame: counts to 65535 with a variance of 1/12 and more lose
//! seven digits of sixteen and keep nine. What rounding makes negative there is 0, and the model's variance, a sum of positive parts,
//! is a floor under every level.

use std::collections::hash_map::DefaultHasher;
use std::hash::{Hash, Hasher};

use super::darks::{Dark, Darks};
use super::flats::{Response, displaced};
use super::journal::Rejection;
use super::load::{Calls, load};
use super::pattern::{Differences, Expected, Verdict, compare};
use super::region::{NOWHERE, Segments};
use super::sensor::{Sensor, median};
use super::shading::Shading;
use super::sloping::Slope;
use super::wild::Field;
use crate::frame::Frame;
use crate::robust::MEDIAN_OF_ABS;

/// A frame is cut into so many cells per edge; spatial scatter is judged between cells.
const CELLS: usize = 8;
/// Pixels further than this from their cell are wild (cosmic rays, dust), where all pixels share their directions.
const WILD_SIGMAS: f64 = 8.0;

/// What a segment counts per second at response 1.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Level {
    /// Pixels averaged.
    pub(super) n: f64,
    /// Mean count above dark per second, response divided out.
    pub(super) rate_dn_s: f64,
    /// Mean of 1/response², what a count's variance is multiplied with.
    pub(super) inverse_response2: f64,
    /// Variance of the mean as the pixels' own scatter shows it.
    pub(super) variance_pixels: f64,
    /// Variance of the mean beyond that, as the scatter between cells shows it: moiré, texture.
    pub(super) variance_texture: f64,
    /// How it slopes over the field.
    pub(super) slope: Slope,
    /// Mean column and row of its pixels, of near rigs; whole numbers are corners.
    pub(super) middle_px: [f64; 2],
}

/// A frame that passed every check it can pass alone.
#[derive(Debug, Clone)]
pub(super) struct Measured {
    pub(super) index: usize,
    pub(super) exposure_s: f64,
    /// By segment.
    pub(super) levels: Vec<Level>,
    /// Pixels of the segments that are full and those there are.
    pub(super) full: usize,
    pub(super) pixels: usize,
    /// Fingerprint of the counts; equal frames are copies of each other.
    pub(super) fingerprint: u64,
}

impl Measured {
    pub(super) fn is_clean(&self) -> bool {
        self.full == 0
    }

    /// Pixel-weighted mean over all segments.
    pub(super) fn mean_rate(&self) -> f64 {
        let n: f64 = self.levels.iter().map(|l| l.n).sum();
        self.levels.iter().map(|l| l.n * l.rate_dn_s).sum::<f64>() / n.max(1.0)
    }
}

/// What is the same for all frames.
#[derive(Clone, Copy)]
pub(super) struct Ground<'a> {
    pub(super) calls: Calls<'a>,
    pub(super) sensor: &'a Sensor,
    pub(super) darks: &'a Darks,
    pub(super) response: &'a Response,
    pub(super) segments: &'a Segments,
    /// Whether all pixels share their directions, so that what varies over a segment is texture.
    pub(super) far: bool,
}

impl Ground<'_> {
    /// Variance of a segment's mean rate from counting and read noise at a level `rate_dn_s`, which
    /// is not taken from the frame itself: weights made of noisy counts would favour low ones.
    pub(super) fn variance_model(&self, level: &Level, rate_dn_s: f64, exposure_s: f64) -> f64 {
        let dark = self.darks.at(exposure_s);
        let current = (dark.mean_dn - self.sensor.black_dn).max(0.0);
        let count = rate_dn_s.max(0.0) * exposure_s;
        let per_pixel = (self.sensor.variance_dn2(count + current) + dark.variance_dn2)
            * level.inverse_response2.max(1.0)
            + count * count * self.response.variance;
        per_pixel / (level.n.max(1.0) * exposure_s * exposure_s)
    }

    /// Standard uncertainty of a segment's mean rate from the dark frames' noise: the same in every frame of an exposure.
    pub(super) fn dark_std(&self, level: &Level, exposure_s: f64) -> f64 {
        let per_pixel = self.darks.at(exposure_s).variance_dn2 * level.inverse_response2.max(1.0);
        (per_pixel / level.n.max(1.0)).sqrt() / exposure_s
    }

    /// Reads and measures frame `index`.
    pub(super) fn measure(&self, index: usize) -> Result<Measured, Rejection> {
        let row = &self.calls.source.rows()[index];
        let frame = load(&self.calls, index, self.sensor)?;
        let dark = self.darks.at(row.exposure_s);
        let labels = self.segments.labels(row.pose(), &self.response.good);
        let (full, pixels) = self.count_full(&frame, &labels);
        let mut measured = Measured {
            index,
            exposure_s: row.exposure_s,
            levels: Vec::new(),
            full,
            pixels,
            fingerprint: fingerprint(&frame),
        };
        if pixels == 0 {
            return Err(Rejection::new(
                "outside",
                "no pixel of the region lies in the frame",
            ));
        }
        if full * 2 > pixels {
            return Err(Rejection::new(
                "saturated",
                format!("{full} of {pixels} pixels are full"),
            ));
        }
        self.check_alive(&frame, &dark)?;
        measured.levels = self.levels(&frame, &dark, &labels, row.exposure_s, None);
        if let Some(outliers) = self.stray_full(&frame, &labels, &measured, &dark) {
            measured.full -= outliers;
        }
        if measured.is_clean() {
            self.check_pattern(&frame, &dark, &labels, &measured)?;
        }
        Ok(measured)
    }

    /// Measures a frame with full pixels where no other exposure is left: only pixels that are
    /// expected to be well below full count, judged from the segment's median and the pixel's
    /// response, not from the pixel's own noisy count. Not for near rigs, where the rest of the field
    /// would stand for other directions.
    pub(super) fn measure_below_full(&self, index: usize) -> Option<Measured> {
        if !self.far {
            return None;
        }
        let row = &self.calls.source.rows()[index];
        let frame = load(&self.calls, index, self.sensor).ok()?;
        let dark = self.darks.at(row.exposure_s);
        let mut labels = self.segments.labels(row.pose(), &self.response.good);
        let before = labels.iter().filter(|l| **l != NOWHERE).count();
        for segment in 0..self.segments.len() {
            let rates = |pixel: usize| {
                (dark.linear_dn(pixel, frame.pixels_dn()[pixel]) - f64::from(dark.level_dn[pixel]))
                    / f64::from(self.response.pixels[pixel])
            };
            let mut values: Vec<f64> = (0..labels.len())
                .filter(|p| labels[*p] as usize == segment)
                .map(|p| {
                    if self.sensor.is_full(frame.pixels_dn()[p]) {
                        f64::INFINITY
                    } else {
                        rates(p)
                    }
                })
                .collect();
            let usual = median(&mut values);
            let mut below: Vec<f64> = values.iter().map(|v| (usual - v).max(0.0)).collect();
            // Half of the pixels lie below the median: their median distance is that of normal scatter.
            below.retain(|d| *d > 0.0);
            let spread = median(&mut below) / MEDIAN_OF_ABS;
            for (pixel, label) in labels.iter_mut().enumerate() {
                if *label as usize == segment {
                    let light = (usual + 5.0 * spread) * f64::from(self.response.pixels[pixel]);
                    let due = dark.counted_dn(pixel, light);
                    let reachable = usual.is_finite() && due < self.sensor.saturation_dn;
                    if !reachable {
                        *label = NOWHERE;
                    }
                }
            }
        }
        let (full, pixels) = self.count_full(&frame, &labels);
        if pixels < 64.max(before / 50) || full * 1000 > pixels {
            return None;
        }
        let levels = self.levels(&frame, &dark, &labels, row.exposure_s, Some(()));
        Some(Measured {
            index,
            exposure_s: row.exposure_s,
            levels,
            full: 0,
            pixels,
            fingerprint: fingerprint(&frame),
        })
    }

    fn count_full(&self, frame: &Frame, labels: &[u16]) -> (usize, usize) {
        frame
            .pixels_dn()
            .iter()
            .zip(labels)
            .filter(|(_, label)| **label != NOWHERE)
            .fold((0, 0), |(full, n), (dn, _)| {
                (full + usize::from(self.sensor.is_full(*dn)), n + 1)
            })
    }

    /// A few full pixels far above the rest are hits, not the sample: they are left out and the
    /// frame stays. How many, if they are that.
    fn stray_full(
        &self,
        frame: &Frame,
        labels: &[u16],
        measured: &Measured,
        dark: &Dark,
    ) -> Option<usize> {
        if measured.full == 0 || measured.full > 3 + measured.pixels / 2000 {
            return None;
        }
        let far = frame
            .pixels_dn()
            .iter()
            .zip(labels)
            .enumerate()
            .filter(|(_, (dn, label))| **label != NOWHERE && self.sensor.is_full(**dn))
            .all(|(pixel, (_, label))| {
                let level = &measured.levels[*label as usize];
                let due =
                    level.rate_dn_s * measured.exposure_s * f64::from(self.response.pixels[pixel]);
                let scatter = (level.variance_pixels * level.n).sqrt() * measured.exposure_s;
                dark.counted_dn(pixel, due + 12.0 * scatter) < self.sensor.saturation_dn
            });
        far.then_some(measured.full)
    }

    /// A frame, or a part of one, without any noise was not exposed by this sensor.
    fn check_alive(&self, frame: &Frame, dark: &Dark) -> Result<(), Rejection> {
        if self.sensor.read_dn < 0.5 {
            return Ok(());
        }
        let pixels = frame.pixels_dn();
        let rows = (self.sensor.height / 16).max(1);
        let dead: Vec<u16> = pixels
            .chunks(rows * self.sensor.width)
            .filter(|band| {
                band.len() >= 64
                    && !self.sensor.is_full(band[0])
                    && band.iter().all(|dn| *dn == band[0])
            })
            .map(|band| band[0])
            .collect();
        let Some(count) = dead.first() else {
            return Ok(());
        };
        let bands = pixels.len().div_ceil(rows * self.sensor.width);
        let detail = format!(
            "{} of {bands} bands of rows count {count} DN in every pixel, without any noise",
            dead.len()
        );
        Err(Rejection::new(
            match (dead.len() == bands, f64::from(*count) <= dark.mean_dn) {
                (true, true) => "black",
                (true, false) => "constant",
                (false, _) => "torn",
            },
            detail,
        ))
    }

    /// Levels of all segments. `clipped` says that full pixels were labelled away already.
    fn levels(
        &self,
        frame: &Frame,
        dark: &Dark,
        labels: &[u16],
        exposure_s: f64,
        clipped: Option<()>,
    ) -> Vec<Level> {
        let segments = self.segments.len();
        let width = self.sensor.width;
        let cell_of = |pixel: usize| {
            (pixel / width * CELLS / self.sensor.height) * CELLS + pixel % width * CELLS / width
        };
        let response = |pixel: usize| f64::from(self.response.pixels[pixel]);
        let own = |pixel: usize| {
            (dark.linear_dn(pixel, frame.pixels_dn()[pixel]) - f64::from(dark.level_dn[pixel]))
                / response(pixel)
        };
        let counts = |pixel: usize| {
            labels[pixel] != NOWHERE
                && (clipped.is_some() || !self.sensor.is_full(frame.pixels_dn()[pixel]))
        };
        let at = |pixel: usize| labels[pixel] as usize * CELLS * CELLS + cell_of(pixel);
        let tamed = (!self.far).then(|| {
            let value = |pixel| if counts(pixel) { own(pixel) } else { f64::NAN };
            let field = Field {
                values: (0..labels.len()).map(value).collect(),
                labels,
                part: &at,
                parts: segments * CELLS * CELLS,
                response: &response,
                sensor: self.sensor,
            };
            field.tamed()
        });
        let value = |pixel: usize| tamed.as_ref().map_or_else(|| own(pixel), |v| v[pixel]);
        let mut cells = vec![Cell::default(); segments * CELLS * CELLS];
        let mut inverse = vec![0.0; segments];
        let mut places = vec![[0.0; 2]; segments];
        for pixel in (0..labels.len()).filter(|p| counts(*p)) {
            let segment = labels[pixel] as usize;
            cells[at(pixel)].add(value(pixel), response(pixel));
            inverse[segment] += response(pixel).powi(-2);
            if !self.far {
                places[segment][0] += (pixel % width) as f64 + 0.5;
                places[segment][1] += (pixel / width) as f64 + 0.5;
            }
        }
        if self.far {
            let reach = reach_of(&cells);
            for pixel in (0..labels.len()).filter(|p| counts(*p)) {
                let (centre, reach) = reach[at(pixel)];
                if (own(pixel) - centre).abs() > reach {
                    cells[at(pixel)].remove(own(pixel), response(pixel));
                    inverse[labels[pixel] as usize] -= response(pixel).powi(-2);
                }
            }
        }
        let noise = match self.far {
            true => Vec::new(),
            false => self.noise_on_slopes(labels, &counts, &value),
        };
        (0..segments)
            .map(|segment| {
                let cells = &cells[segment * CELLS * CELLS..(segment + 1) * CELLS * CELLS];
                let mut level = Level::of(cells, inverse[segment], exposure_s);
                if !self.far {
                    level.variance_texture = 0.0;
                    if let Some(per_pixel) = noise[segment] {
                        level.variance_pixels =
                            per_pixel / (level.n.max(1.0) * exposure_s * exposure_s);
                    }
                    level.middle_px = places[segment].map(|sum| sum / level.n.max(1.0));
                }
                level
            })
            .collect()
    }

    /// Variance of a pixel of each segment about light that slopes over the field, as it does near a lamp or a camera: by
    /// second differences along the rows, which have no slope. None of a segment with few of them.
    fn noise_on_slopes(
        &self,
        labels: &[u16],
        counts: &impl Fn(usize) -> bool,
        value: &impl Fn(usize) -> f64,
    ) -> Vec<Option<f64>> {
        const FEW: f64 = 32.0;
        const SECOND: Differences = Differences::Second;
        let width = self.sensor.width;
        let mut sums = vec![(0.0, 0.0); self.segments.len()];
        for (row, labels) in labels.chunks_exact(width).enumerate() {
            let counts = |column: usize| counts(row * width + column);
            for column in 2..width {
                let second = SECOND.at(column, labels, |k| value(row * width + k));
                if let Some(second) = second.filter(|_| (column - 2..=column).all(counts)) {
                    let sum: &mut (f64, f64) = &mut sums[labels[column] as usize];
                    sum.0 += 1.0;
                    sum.1 += second * second;
                }
            }
        }
        let variance =
            |(n, squares): (f64, f64)| (n >= FEW).then(|| squares / (SECOND.variance() * n));
        sums.into_iter().map(variance).collect()
    }

    fn shading(&self, frame: &Frame, dark: &Dark, labels: &[u16]) -> Shading {
        let pixels = frame.pixels_dn().iter().enumerate().map(|(pixel, dn)| {
            let response = self.response.pixels[pixel];
            let counts = dark.linear_dn(pixel, *dn) - f64::from(dark.level_dn[pixel]);
            (response > 0.0 && !self.sensor.is_full(*dn))
                .then(|| (labels[pixel], counts, f64::from(response)))
        });
        let size = [self.sensor.width, self.sensor.height];
        Shading::new(size, self.segments.len(), pixels)
    }

    fn check_pattern(
        &self,
        frame: &Frame,
        dark: &Dark,
        labels: &[u16],
        measured: &Measured,
    ) -> Result<(), Rejection> {
        let due: Vec<f32> = measured
            .levels
            .iter()
            .map(|l| (l.rate_dn_s * measured.exposure_s) as f32)
            .collect();
        // Near the lamp or the camera a lobe shades off over a segment, and the pattern with it.
        let shading = (!self.far).then(|| self.shading(frame, dark, labels));
        let light: Vec<f32> = labels
            .iter()
            .enumerate()
            .map(|(pixel, label)| {
                let shaded = shading.as_ref().and_then(|s| s.at(pixel, *label));
                shaded.unwrap_or_else(|| due.get(*label as usize).copied().unwrap_or(0.0))
            })
            .collect();
        // The response's noise goes with the light: of segments the brightest, under a steep lobe the mean of the squares.
        let brightest = due.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
        let lit = || light.iter().zip(labels).filter(|(_, l)| **l != NOWHERE);
        let squares: f64 = lit().map(|(x, _)| f64::from(*x).powi(2)).sum();
        let square = (squares / lit().count().max(1) as f64).max(f64::from(brightest).powi(2));
        let verdict = compare(
            frame.pixels_dn(),
            &Expected {
                dark_dn: &dark.level_dn,
                response: &self.response.pixels,
                light_dn: &light,
                variance_dn2: dark.variance_dn2 + square * self.response.variance,
                labels,
                width: self.sensor.width,
                differences: match self.far {
                    true => Differences::First,
                    false => Differences::Second,
                },
            },
        );
        match verdict {
            Verdict::InPlace => Ok(()),
            other => Err(displaced(other)),
        }
    }
}

#[derive(Clone, Copy, Default)]
struct Cell {
    n: f64,
    sum: f64,
    sum2: f64,
    counts: f64,
    response: f64,
}

impl Cell {
    /// A pixel: its counts over its response, and that response.
    fn add(&mut self, v: f64, response: f64) {
        self.n += 1.0;
        self.sum += v;
        self.sum2 += v * v;
        self.counts += v * response;
        self.response += response;
    }

    fn remove(&mut self, v: f64, response: f64) {
        self.n -= 1.0;
        self.sum -= v;
        self.sum2 -= v * v;
        self.counts -= v * response;
        self.response -= response;
    }

    /// Counts at response 1. The mean of quotients would be too high by the responses' own noise squared (flats in
    /// dim light have one of 10 % and more), a quotient of sums is not.
    fn level(&self) -> f64 {
        if self.response > 0.0 {
            self.counts / self.response
        } else {
            self.mean()
        }
    }

    fn mean(&self) -> f64 {
        if self.n > 0.0 { self.sum / self.n } else { 0.0 }
    }

    fn variance(&self) -> f64 {
        if self.n > 1.0 {
            ((self.sum2 - self.sum * self.sum / self.n) / (self.n - 1.0)).max(0.0)
        } else {
            0.0
        }
    }
}

impl Level {
    fn of(cells: &[Cell], inverse_response2: f64, exposure_s: f64) -> Level {
        let n: f64 = cells.iter().map(|c| c.n).sum();
        if n < 1.0 {
            return Level::default();
        }
        let mean = cells.iter().map(|c| c.sum).sum::<f64>() / n;
        let level = cells.iter().map(|c| c.n * c.level()).sum::<f64>() / n;
        // Within cells the scatter is noise and fine texture; both average with the pixels.
        let within = cells
            .iter()
            .map(|c| c.variance() * (c.n - 1.0).max(0.0))
            .sum::<f64>()
            / (n - cells.len() as f64).max(1.0);
        // Between cells the mean square of well filled cells, weighted by pixels.
        let filled: Vec<&Cell> = cells.iter().filter(|c| c.n > 0.0).collect();
        let freedom = filled.len() as f64 - 1.0;
        let texture = if freedom >= 3.0 {
            let between = filled
                .iter()
                .map(|c| c.n * (c.mean() - mean).powi(2))
                .sum::<f64>()
                / freedom;
            // Mean squares of white noise scatter by √(2/freedom): less than three of that is none.
            if between > within * (1.0 + 3.0 * (2.0 / freedom).sqrt()) {
                between - within
            } else {
                0.0
            }
        } else {
            0.0
        };
        let scale = n * exposure_s * exposure_s;
        Level {
            slope: slope_of(cells, mean, within),
            n,
            rate_dn_s: level / exposure_s,
            inverse_response2: inverse_response2 / n,
            variance_pixels: within / scale,
            variance_texture: texture / scale,
            middle_px: [0.0; 2],
        }
    }
}

/// Each cell's mean, and how far from it a pixel is wild.
fn reach_of(cells: &[Cell]) -> Vec<(f64, f64)> {
    let mut deviations: Vec<f64> = cells
        .iter()
        .filter(|c| c.n > 8.0)
        .map(|c| c.variance().sqrt())
        .collect();
    let usual = median(&mut deviations);
    let reach = |c: &Cell| match usual > 0.0 {
        true => WILD_SIGMAS * c.variance().sqrt().clamp(usual, 2.0 * usual),
        false => f64::INFINITY,
    };
    cells.iter().map(|c| (c.mean(), reach(c))).collect()
}

/// Slope of the cells' means about `mean`, with `within` the variance of a pixel.
fn slope_of(cells: &[Cell], mean: f64, within: f64) -> Slope {
    if mean <= 0.0 || cells.iter().any(|c| c.n == 0.0) {
        return Slope::default();
    }
    // Middles of the cells, from −1 at one edge of the frame to 1 at the other.
    let place = |k: usize| (2 * k + 1) as f64 / CELLS as f64 - 1.0;
    let along = |at: fn(usize) -> usize| {
        let (mut top, mut below) = (0.0, 0.0);
        for (k, cell) in cells.iter().enumerate() {
            let x = place(at(k));
            top += cell.n * x * (cell.mean() - mean);
            below += cell.n * x * x;
        }
        (top / below / mean, (within / below).sqrt() / mean)
    };
    let (across, down) = (along(|k| k % CELLS), along(|k| k / CELLS));
    Slope {
        across: across.0,
        down: down.0,
        std: across.1.max(down.1),
    }
}

fn fingerprint(frame: &Frame) -> u64 {
    let mut hasher = DefaultHasher::new();
    frame.pixels_dn().hash(&mut hasher);
    hasher.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noisy_responses_do_not_make_a_level_brighter() {
        // A hundred counts at response 1, seen through responses that noise puts 30 % too high or too low by turns.
        let mut cells = [Cell::default(); 4];
        for pixel in 0..400 {
            let told = if pixel % 2 == 0 { 1.3 } else { 0.7 };
            cells[pixel % 4 / 2].add(100.0 / told, told);
        }
        let level = Level::of(&cells, 400.0, 0.1);
        assert!((level.rate_dn_s - 1000.0).abs() < 1e-9, "{level:?}");
    }
}
