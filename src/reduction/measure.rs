//! One sample frame → the sums of each segment, or the reason why the frame is left out.
//!
//! *Conditioning.* Dark level and response are removed pixel by pixel before anything is summed, so no digits are lost to the
//! black level. [`super::levels`] states what the sums keep.

use serde::{Deserialize, Serialize};

use super::darks::{Dark, Darks};
use super::flats::{Response, displaced};
use super::levels::{CELLS, Cell, CellCorrection, Level, Pixel, SegmentSums, remove_outliers};
use super::load::Calls;
use super::outlier_pixels::Despiking;
use super::pattern::{Differences, Expected, Verdict, compare};
use super::reduction_log::Rejection;
use super::region::{NOWHERE, Segments};
use super::sensor::{Sensor, median};
use super::shading::Shading;
use crate::frame::Frame;
use crate::robust::MEDIAN_OF_ABS;

/// Smallest number of pixels of a band of rows whose noise is checked, and of those in which equal counts are no chance.
const BAND_PIXELS: usize = 64;
const BAND_LEAST: usize = 32;

/// What a reduction keeps of a frame that passed every check it can pass alone.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct FrameSums {
    /// By segment.
    segments: Vec<SegmentSums>,
    /// Pixels of the segments that are full and all pixels of the segments.
    full: usize,
    pixels: usize,
    /// Fingerprint of the counts; equal frames are copies of each other.
    fingerprint: u64,
    /// Of a frame with full pixels: the sums over the pixels that are expected below full count, where these suffice.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    below_full: Option<BelowFull>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct BelowFull {
    segments: Vec<SegmentSums>,
    pixels: usize,
}

impl FrameSums {
    /// The frame's levels. `index` is its place in the list.
    pub(super) fn measured(
        &self,
        index: usize,
        exposure_s: f64,
        far: bool,
        correction: Option<CellCorrection<'_>>,
    ) -> Measured {
        let levels = |segments: &[SegmentSums]| -> Vec<Level> {
            let of = |s: &SegmentSums| s.level(exposure_s, far, correction);
            segments.iter().map(of).collect()
        };
        let below_full = self.below_full.as_ref().map(|below| {
            Box::new(Measured {
                index,
                exposure_s,
                levels: levels(&below.segments),
                full: 0,
                pixels: below.pixels,
                fingerprint: self.fingerprint,
                below_full: None,
            })
        });
        Measured {
            index,
            exposure_s,
            levels: levels(&self.segments),
            full: self.full,
            pixels: self.pixels,
            fingerprint: self.fingerprint,
            below_full,
        }
    }
}

/// The levels of a frame that passed every check it can pass alone.
#[derive(Debug, Clone)]
pub(super) struct Measured {
    pub(super) index: usize,
    pub(super) exposure_s: f64,
    /// By segment.
    pub(super) levels: Vec<Level>,
    /// Pixels of the segments that are full and all pixels of the segments.
    pub(super) full: usize,
    pub(super) pixels: usize,
    /// Fingerprint of the counts; equal frames are copies of each other.
    pub(super) fingerprint: u64,
    /// The same over the pixels that are expected below full count, where these suffice.
    pub(super) below_full: Option<Box<Measured>>,
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

/// What every frame is measured with.
#[derive(Clone, Copy)]
pub(super) struct MeasurementContext<'a> {
    pub(super) calls: Calls<'a>,
    pub(super) sensor: &'a Sensor,
    pub(super) darks: &'a Darks,
    pub(super) response: &'a Response,
    pub(super) segments: &'a Segments,
    /// Whether all pixels share their directions, so that what varies over a segment is texture.
    pub(super) far: bool,
}

impl MeasurementContext<'_> {
    /// Measures frame `index`.
    pub(super) fn measure(&self, index: usize, frame: &Frame) -> Result<FrameSums, Rejection> {
        let row = &self.calls.source.rows()[index];
        let dark = self.darks.at(row.exposure_s);
        let labels = self.segments.labels(row.pose(), &self.response.good);
        let (full, pixels) = self.count_full(frame, &labels);
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
        self.check_alive(frame, &dark)?;
        let segments = self.sums(frame, &dark, &labels, None);
        let mut sums = FrameSums {
            segments,
            full,
            pixels,
            fingerprint: fingerprint(frame),
            below_full: None,
        };
        let measured = sums.measured(index, row.exposure_s, self.far, None);
        if let Some(outliers) = self.stray_full(frame, &labels, &measured, &dark) {
            sums.full -= outliers;
        }
        match sums.full {
            0 => self.check_pattern(frame, &dark, &labels, &measured)?,
            _ => sums.below_full = self.measure_below_full(frame, &dark, labels),
        }
        Ok(sums)
    }

    /// Measures a frame with full pixels, for poses without another exposure: only pixels that are
    /// expected to be well below full count, judged from the segment's median and the pixel's
    /// response, not from the pixel's own noisy count. Not for near rigs, where the rest of the field
    /// would stand for other directions.
    fn measure_below_full(
        &self,
        frame: &Frame,
        dark: &Dark,
        mut labels: Vec<u16>,
    ) -> Option<BelowFull> {
        if !self.far {
            return None;
        }
        let before = labels.iter().filter(|l| **l != NOWHERE).count();
        for segment in 0..self.segments.len() {
            let rates = |pixel: usize| {
                (f64::from(frame.pixels_dn()[pixel]) - f64::from(dark.level_dn[pixel]))
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
                    let due = f64::from(dark.level_dn[pixel]) + light;
                    let reachable = usual.is_finite() && due < self.sensor.saturation_dn;
                    if !reachable {
                        *label = NOWHERE;
                    }
                }
            }
        }
        let (full, pixels) = self.count_full(frame, &labels);
        if pixels < 64.max(before / 50) || full * 1000 > pixels {
            return None;
        }
        Some(BelowFull {
            segments: self.sums(frame, dark, &labels, Some(())),
            pixels,
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

    /// Returns the number of full pixels if they are few and far above the rest: then they are hits and not the sample, and
    /// the frame is used without them.
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
                f64::from(dark.level_dn[pixel]) + due + 12.0 * scatter < self.sensor.saturation_dn
            });
        far.then_some(measured.full)
    }

    /// Refuses a frame, or a part of one, without any noise: this sensor did not expose it.
    fn check_alive(&self, frame: &Frame, dark: &Dark) -> Result<(), Rejection> {
        if self.sensor.read_dn < 0.5 {
            return Ok(());
        }
        let (mut dead, bands) = bands_without_noise(frame);
        dead.retain(|dn| !self.sensor.is_full(*dn));
        let Some(count) = dead.first() else {
            return Ok(());
        };
        let detail = format!(
            "{} of {bands} bands of rows count {count} DN in every pixel, without any noise: the sensor did not expose, or \
             is full there",
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

    /// Sums of all segments. `clipped` says that full pixels were labelled away already.
    fn sums(
        &self,
        frame: &Frame,
        dark: &Dark,
        labels: &[u16],
        clipped: Option<()>,
    ) -> Vec<SegmentSums> {
        let segments = self.segments.len();
        let width = self.sensor.width;
        let cell_of = |pixel: usize| {
            (pixel / width * CELLS / self.sensor.height) * CELLS + pixel % width * CELLS / width
        };
        let response = |pixel: usize| f64::from(self.response.pixels[pixel]);
        let flat = |pixel: usize| f64::from(self.response.flat(pixel));
        let own = |pixel: usize| {
            (f64::from(frame.pixels_dn()[pixel]) - f64::from(dark.level_dn[pixel]))
                / response(pixel)
        };
        let counts = |pixel: usize| {
            labels[pixel] != NOWHERE
                && (clipped.is_some() || !self.sensor.is_full(frame.pixels_dn()[pixel]))
        };
        let at = |pixel: usize| labels[pixel] as usize * CELLS * CELLS + cell_of(pixel);
        let despiked = (!self.far).then(|| {
            let value = |pixel| if counts(pixel) { own(pixel) } else { f64::NAN };
            let despiking = Despiking {
                values: (0..labels.len()).map(value).collect(),
                labels,
                part: &at,
                parts: segments * CELLS * CELLS,
                response: &response,
                sensor: self.sensor,
            };
            despiking.despiked()
        });
        let value = |pixel: usize| despiked.as_ref().map_or_else(|| own(pixel), |v| v[pixel]);
        let mut cells = vec![Cell::default(); segments * CELLS * CELLS];
        let mut inverse = vec![0.0; segments];
        let mut places = vec![[0.0; 2]; segments];
        for pixel in (0..labels.len()).filter(|p| counts(*p)) {
            let segment = labels[pixel] as usize;
            cells[at(pixel)].add(value(pixel), response(pixel), flat(pixel));
            inverse[segment] += response(pixel).powi(-2);
            if !self.far {
                places[segment][0] += (pixel % width) as f64 + 0.5;
                places[segment][1] += (pixel / width) as f64 + 0.5;
            }
        }
        if self.far {
            let pixels = (0..labels.len()).filter(|p| counts(*p)).map(|pixel| Pixel {
                cell: at(pixel),
                v: own(pixel),
                response: response(pixel),
                flat: flat(pixel),
            });
            remove_outliers(&mut cells, pixels, |pixel| {
                inverse[pixel.cell / (CELLS * CELLS)] -= pixel.response.powi(-2);
            });
        }
        let noise = match self.far {
            true => vec![None; segments],
            false => self.noise_on_slopes(labels, &counts, &value),
        };
        (0..segments)
            .map(|segment| {
                let cells = &cells[segment * CELLS * CELLS..(segment + 1) * CELLS * CELLS];
                SegmentSums::new(cells, inverse[segment], noise[segment], places[segment])
            })
            .collect()
    }

    /// Returns the variance of a pixel of each segment about light that slopes over the field, as it does near a lamp or a
    /// camera: from second differences along the rows, which contain no slope. None for a segment with few of them.
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
            let counts = f64::from(*dn) - f64::from(dark.level_dn[pixel]);
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
        // Near the lamp or the camera a lobe varies over a segment, and the pattern with it.
        let shading = (!self.far).then(|| self.shading(frame, dark, labels));
        let light: Vec<f32> = labels
            .iter()
            .enumerate()
            .map(|(pixel, label)| {
                let shaded = shading.as_ref().and_then(|s| s.at(pixel, *label));
                shaded.unwrap_or_else(|| due.get(*label as usize).copied().unwrap_or(0.0))
            })
            .collect();
        // The noise of the response is proportional to the light: that of the brightest segment, or under a steep lobe the
        // mean of the squares.
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

/// FNV-1a over the counts: the same in every version of the program, since it is stored.
fn fingerprint(frame: &Frame) -> u64 {
    let step = |hash: u64, dn: &u16| (hash ^ u64::from(*dn)).wrapping_mul(0x0100_0000_01b3);
    frame.pixels_dn().iter().fold(0xcbf2_9ce4_8422_2325, step)
}

/// A frame's outcome: its sums, or why it is left out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) enum FrameOutcome {
    /// The sums of a frame that counts.
    Reduced(FrameSums),
    /// Why the frame is rejected.
    LeftOut(Rejection),
}

impl FrameOutcome {
    /// Whether it has this number of segments; stored sums may come from another segmentation.
    pub(super) fn is_of(&self, segments: usize) -> bool {
        match self {
            FrameOutcome::Reduced(sums) => {
                let below = sums
                    .below_full
                    .as_ref()
                    .map_or(segments, |b| b.segments.len());
                sums.segments.len() == segments && below == segments
            }
            FrameOutcome::LeftOut(_) => true,
        }
    }
}

/// Returns the count of each band of rows that has one count only, and the number of bands.
fn bands_without_noise(frame: &Frame) -> (Vec<u16>, usize) {
    let (width, pixels) = (frame.width_px() as usize, frame.pixels_dn());
    let rows = (frame.height_px() as usize / 16).max(BAND_PIXELS.div_ceil(width));
    let bands = pixels.chunks(rows * width);
    let count = bands.len();
    let dead = bands
        .filter(|band| band.len() >= BAND_LEAST && band.iter().all(|dn| *dn == band[0]))
        .map(|band| band[0]);
    (dead.collect(), count)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_any_size_without_noise_are_recognised() {
        let bands = |side: u32, counts: &dyn Fn(u32) -> u16| {
            let counts = (0..side * side).map(counts);
            bands_without_noise(&Frame::new(side, side, counts.collect()).unwrap())
        };
        assert_eq!(bands(6, &|_| 33_000), (vec![33_000], 1));
        assert_eq!(bands(6, &|n| 33_000 + u16::from(n == 7)), (vec![], 1));
        // Too few pixels for equal counts to mean anything.
        assert_eq!(bands(5, &|_| 33_000), (vec![], 1));
        let torn = |n: u32| if n < 64 * 32 { 5 } else { (n % 7) as u16 };
        assert_eq!(bands(64, &torn), (vec![5; 8], 16));
    }
}
