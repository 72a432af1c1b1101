//! Sums over the pixels of a segment, and the level that they give.
//!
//! A frame is cut into cells, and each cell keeps the pixel count, the sums of counts and responses, and the second and third
//! powers of the counts. These sums are what a reduction stores of a frame: with them the camera's curve can be applied later
//! without reading the frame again ([`CellCorrection`]).
//!
//! *Conditioning.* A cell's variance is Σv² − (Σv)²/n over at most a sixty-fourth of a frame: counts to 65535 with a variance
//! of 1/12 and more lose seven digits of sixteen and keep nine. A negative result of rounding is set to 0; the model's
//! variance, a sum of positive parts, is a floor under every level. The curve is expanded about each cell's mean count: the
//! first omitted term is below 1e-6 of the level where the counts of a cell scatter by 10 % and the curve is 6 %.

use serde::{Deserialize, Serialize};

use super::detector::Correction;
use super::sensor::median;
use super::shading_check::Slope;

/// Cells along each edge of a frame. Spatial scatter is judged between cells.
pub(super) const CELLS: usize = 8;
/// Pixels further than this from their cell are outliers (cosmic rays, dust), where all pixels share their directions.
const OUTLIER_SIGMAS: f64 = 8.0;

/// What a segment counts per second at response 1.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Level {
    /// Pixels averaged.
    pub(super) n: f64,
    /// Mean count above dark per second, divided by the response.
    pub(super) rate_dn_s: f64,
    /// Mean of 1/response², the factor on a count's variance.
    pub(super) inverse_response2: f64,
    /// Variance of the mean, from the scatter of the pixels.
    pub(super) variance_pixels: f64,
    /// Variance of the mean beyond that, from the scatter between cells: moiré, texture.
    pub(super) variance_texture: f64,
    /// Slope over the field.
    pub(super) slope: Slope,
    /// Mean column and row of the pixels, of near rigs; whole numbers are corners.
    pub(super) middle_px: [f64; 2],
}

/// Sums over the pixels of one cell. v is the count above dark divided by the response.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "[f64; 9]", into = "[f64; 9]")]
pub(super) struct Cell {
    n: f64,
    /// Σ v and Σ v².
    v: f64,
    v2: f64,
    /// Σ of the counts above dark and of their squares and cubes.
    counts: f64,
    counts2: f64,
    counts3: f64,
    /// Σ of the responses.
    response: f64,
    /// Σ of the flats' relative brightness and of its squares; the response itself where the lamp is far.
    flat: f64,
    flat2: f64,
}

impl From<[f64; 9]> for Cell {
    fn from([n, v, v2, counts, counts2, counts3, response, flat, flat2]: [f64; 9]) -> Cell {
        Cell {
            n,
            v,
            v2,
            counts,
            counts2,
            counts3,
            response,
            flat,
            flat2,
        }
    }
}

impl From<Cell> for [f64; 9] {
    fn from(c: Cell) -> [f64; 9] {
        [
            c.n, c.v, c.v2, c.counts, c.counts2, c.counts3, c.response, c.flat, c.flat2,
        ]
    }
}

impl Cell {
    /// Adds a pixel: its count above dark over its response, that response, and the flats' relative brightness there.
    pub(super) fn add(&mut self, v: f64, response: f64, flat: f64) {
        self.count(v, response, flat, 1.0);
    }

    fn remove(&mut self, v: f64, response: f64, flat: f64) {
        self.count(v, response, flat, -1.0);
    }

    fn count(&mut self, v: f64, response: f64, flat: f64, sign: f64) {
        let counts = v * response;
        self.n += sign;
        self.v += sign * v;
        self.v2 += sign * (v * v);
        self.counts += sign * counts;
        self.counts2 += sign * (counts * counts);
        self.counts3 += sign * (counts * counts * counts);
        self.response += sign * response;
        self.flat += sign * flat;
        self.flat2 += sign * (flat * flat);
    }

    fn is_empty(&self) -> bool {
        *self == Cell::default()
    }

    /// Counts at response 1. The mean of quotients would be too high by the responses' own noise squared (flats in
    /// dim light have one of 10 % and more); a quotient of sums is not.
    fn level(&self) -> f64 {
        if self.response > 0.0 {
            self.counts / self.response
        } else {
            self.mean()
        }
    }

    fn mean(&self) -> f64 {
        if self.n > 0.0 { self.v / self.n } else { 0.0 }
    }

    fn variance(&self) -> f64 {
        if self.n > 1.0 {
            ((self.v2 - self.v * self.v / self.n) / (self.n - 1.0)).max(0.0)
        } else {
            0.0
        }
    }

    /// The moments of the counts.
    fn moments(&self) -> Moments {
        Moments([self.n, self.counts, self.counts2, self.counts3])
    }

    /// The sums that a linear camera with a correct clock would have given.
    fn corrected(&self, by: &CellCorrection<'_>) -> Cell {
        if self.n < 1.0 {
            return *self;
        }
        let counts = self.moments().corrected(by.camera);
        let response = self.response * by.response.factor([self.n, self.flat, self.flat2]);
        let slope = by.camera.slope(self.counts / self.n);
        let with = |counts, response, v: f64, variance: f64| Cell {
            v,
            v2: variance * (self.n - 1.0) + v * v / self.n,
            counts,
            response,
            ..*self
        };
        if !(self.response > 0.0 && response > 0.0 && self.counts != 0.0) {
            return with(
                counts,
                response,
                self.v * slope,
                self.variance() * slope * slope,
            );
        }
        let scale = (counts / response) / (self.counts / self.response);
        let noise = slope * self.response / response;
        with(
            counts,
            response,
            self.v * scale,
            self.variance() * noise * noise,
        )
    }
}

/// Number, sum, sum of squares and sum of cubes of counts above dark.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Moments(pub(super) [f64; 4]);

impl Moments {
    pub(super) fn add(&mut self, counts: f64) {
        self.0[0] += 1.0;
        self.0[1] += counts;
        self.0[2] += counts * counts;
        self.0[3] += counts * counts * counts;
    }

    /// Sum of the counts of a linear camera, by the curve's expansion to third order about the mean count.
    pub(super) fn corrected(&self, by: Correction) -> f64 {
        let [n, sum, sum2, sum3] = self.0;
        if n < 1.0 {
            return 0.0;
        }
        let mean = sum / n;
        let second = (sum2 / n - mean * mean).max(0.0);
        let third = sum3 / n - 3.0 * mean * (sum2 / n) + 2.0 * mean * mean * mean;
        let [value, _, by2, by3] = by.expansion(mean);
        n * (value + 0.5 * by2 * second + by3 * third / 6.0)
    }
}

/// How the response changes where the flats' counts are corrected: r' ∝ H(q), q being the flats' uncorrected relative
/// brightness at a pixel and H(q) = Σ g(q Λ), the sum over the lights Λ of the flats.
#[derive(Debug, Clone)]
pub(super) struct ResponseCorrection {
    /// The correction of each flat's exposure time with the flat's mean count.
    pub(super) lights: Vec<(Correction, f64)>,
    /// Mean of H over the good pixels.
    pub(super) mean: f64,
}

impl ResponseCorrection {
    /// Sum of H over pixels of which number, sum and sum of squares of q are given.
    pub(super) fn sum(&self, [n, flat, flat2]: [f64; 3]) -> f64 {
        if n < 1.0 {
            return 0.0;
        }
        let mean = flat / n;
        let scatter = (flat2 / n - mean * mean).max(0.0);
        let of = |(correction, light): &(Correction, f64)| {
            let [value, _, by2, _] = correction.expansion(mean * light);
            value + 0.5 * by2 * light * light * scatter
        };
        n * self.lights.iter().map(of).sum::<f64>()
    }

    /// Corrected over uncorrected response of such pixels.
    fn factor(&self, sums: [f64; 3]) -> f64 {
        match sums[1] > 0.0 && self.mean > 0.0 {
            true => self.sum(sums) / (sums[1] * self.mean),
            false => 1.0,
        }
    }
}

/// What turns the sums of a cell into those of a linear camera.
#[derive(Debug, Clone, Copy)]
pub(super) struct CellCorrection<'a> {
    pub(super) camera: Correction,
    pub(super) response: &'a ResponseCorrection,
}

/// What a reduction keeps of one segment in one frame.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct SegmentSums {
    /// Cells that have pixels, with their numbers row by row.
    cells: Vec<(u16, Cell)>,
    /// Σ 1/response².
    inverse_response2: f64,
    /// Variance of a pixel about light that slopes over the field, of near rigs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    noise: Option<f64>,
    /// Sum of columns and of rows, of near rigs.
    #[serde(default, skip_serializing_if = "is_zero")]
    places: [f64; 2],
}

fn is_zero(places: &[f64; 2]) -> bool {
    *places == [0.0; 2]
}

impl SegmentSums {
    pub(super) fn new(
        cells: &[Cell],
        inverse_response2: f64,
        noise: Option<f64>,
        places: [f64; 2],
    ) -> Self {
        let cells = (0_u16..).zip(cells.iter().copied());
        SegmentSums {
            cells: cells.filter(|(_, cell)| !cell.is_empty()).collect(),
            inverse_response2,
            noise,
            places,
        }
    }

    /// The segment's level; `far` says whether all pixels share their directions.
    pub(super) fn level(
        &self,
        exposure_s: f64,
        far: bool,
        correction: Option<CellCorrection<'_>>,
    ) -> Level {
        let mut cells = [Cell::default(); CELLS * CELLS];
        let (mut inverse, mut noise) = (self.inverse_response2, self.noise);
        for (at, cell) in &self.cells {
            // A row from a file may name any cell.
            if let Some(place) = cells.get_mut(usize::from(*at)) {
                *place = correction.map_or(*cell, |by| cell.corrected(&by));
            }
        }
        if let Some(by) = correction {
            let sum = |part: fn(&Cell) -> f64| -> f64 {
                self.cells.iter().map(|(_, cell)| part(cell)).sum()
            };
            let after: f64 = cells.iter().map(|cell| cell.response).sum();
            let (n, before) = (sum(|c| c.n), sum(|c| c.response));
            if n >= 1.0 && before > 0.0 && after > 0.0 {
                inverse *= (before / after).powi(2);
                let slope = by.camera.slope(sum(|c| c.counts) / n) * before / after;
                noise = noise.map(|variance| variance * slope * slope);
            }
        }
        let mut level = Level::of(&cells, inverse, exposure_s);
        if !far {
            level.variance_texture = 0.0;
            if let Some(per_pixel) = noise {
                level.variance_pixels = per_pixel / (level.n.max(1.0) * exposure_s * exposure_s);
            }
            level.middle_px = self.places.map(|sum| sum / level.n.max(1.0));
        }
        level
    }
}

impl Level {
    /// Root mean square deviation of the cells from the level, as a share of it, beyond noise.
    pub(super) fn unevenness(&self) -> f64 {
        let cells = (CELLS * CELLS) as f64;
        (self.variance_texture * cells).sqrt() / self.rate_dn_s.abs().max(f64::MIN_POSITIVE)
    }

    pub(super) fn of(cells: &[Cell], inverse_response2: f64, exposure_s: f64) -> Level {
        let n: f64 = cells.iter().map(|c| c.n).sum();
        if n < 1.0 {
            return Level::default();
        }
        let mean = cells.iter().map(|c| c.v).sum::<f64>() / n;
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
            // Mean squares of white noise scatter by √(2/freedom): less than three of that is no texture.
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

/// A pixel of a frame as its cell sums it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pixel {
    pub(super) cell: usize,
    pub(super) v: f64,
    pub(super) response: f64,
    pub(super) flat: f64,
}

/// Takes the outliers of a frame out of its cells: pixels further from their cell's mean than [`OUTLIER_SIGMAS`]. `each` is
/// called for every pixel that was taken out.
pub(super) fn remove_outliers(
    cells: &mut [Cell],
    pixels: impl Iterator<Item = Pixel>,
    mut each: impl FnMut(&Pixel),
) {
    let reach = reach_of(cells);
    for pixel in pixels {
        let (centre, reach) = reach[pixel.cell];
        if (pixel.v - centre).abs() > reach {
            cells[pixel.cell].remove(pixel.v, pixel.response, pixel.flat);
            each(&pixel);
        }
    }
}

/// Each cell's mean, and the distance from it beyond which a pixel is an outlier.
fn reach_of(cells: &[Cell]) -> Vec<(f64, f64)> {
    let mut deviations: Vec<f64> = cells
        .iter()
        .filter(|c| c.n > 8.0)
        .map(|c| c.variance().sqrt())
        .collect();
    let usual = median(&mut deviations);
    let reach = |c: &Cell| match usual > 0.0 {
        true => OUTLIER_SIGMAS * c.variance().sqrt().clamp(usual, 2.0 * usual),
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

#[cfg(test)]
mod tests {
    use super::super::detector::Curve;
    use super::*;

    #[test]
    fn noisy_responses_do_not_make_a_level_brighter() {
        // A hundred counts at response 1, seen through responses that noise puts 30 % too high or too low by turns.
        let mut cells = [Cell::default(); 4];
        for pixel in 0..400 {
            let response = if pixel % 2 == 0 { 1.3 } else { 0.7 };
            cells[pixel % 4 / 2].add(100.0 / response, response, response);
        }
        let level = Level::of(&cells, 400.0, 0.1);
        assert!((level.rate_dn_s - 1000.0).abs() < 1e-9, "{level:?}");
    }

    #[test]
    fn the_curve_applied_to_the_sums_is_the_curve_applied_to_the_pixels() {
        for (c, spread) in [(0.06, 0.1), (-0.05, 0.1), (0.1, 0.1), (0.2, 0.05)] {
            let by = Correction {
                curve: Curve {
                    c,
                    full_dn: 65_000.0,
                },
                time: 1.003,
            };
            let counts =
                |k: i32| 40_000.0 * (1.0 + spread * (f64::from(k * 37 % 101) / 50.0 - 1.0));
            let mut moments = Moments::default();
            let mut due = 0.0;
            for k in 0..256 {
                moments.add(counts(k));
                due += by.curve.linear(counts(k)) / by.time;
            }
            let found = moments.corrected(by);
            assert!((found / due - 1.0).abs() < 2e-6, "{c}: {found} {due}");
        }
    }
}
