//! Escape slopes: how steeply a ray must rise from a cell to be free for certain.
//!
//! For every cell and each of four quarters of the horizon a slope that no other point of the periodic surface
//! exceeds as seen that way from any point on (or over) that cell. Conservative: a ray above it is free; one below may
//! be free too.
//!
//! Near by (three cells ahead) the triangle that rises most steeply that way bounds it, since the straight line between
//! two points of a continuous surface is no steeper than the surface between them. Farther away blocks
//! of 2^l cells are compared by highest and lowest point over the gap between them, level by level,
//! and beyond the coarsest level everything is as high as the highest point.
//!
//! *Conditioning.* Differences of heights in single precision are right to 6e-8 of the heights, slopes and their squares to a
//! few of those; a margin of 1e-5 on every slope is more. Squares of slopes are compared, so nothing is divided by a
//! horizontal part that may be 0: straight up clears everything.

use pulp::Arch;
use rayon::prelude::*;

use super::vec3::V3;

/// Squared escape slopes of one side: four per cell, one for each quarter of the horizon.
#[derive(Debug, Clone)]
pub struct EscapeSlopes {
    squared: Vec<[f32; 4]>,
}

/// Escape slopes as one direction meets them.
#[derive(Debug, Clone, Copy)]
pub struct Towards<'a> {
    squared: &'a [[f32; 4]],
    quarter: usize,
    /// Square of the direction's own slope.
    steepness: f32,
}

impl Towards<'_> {
    /// Whether a ray that way is free from over this cell on.
    #[inline(always)]
    #[must_use]
    pub fn clears(&self, cell: usize) -> bool {
        self.steepness > self.squared[cell][self.quarter]
    }
}

/// Cells ahead of a cell that are bounded by their steepest triangle.
const NEAR: usize = 3;
/// Blocks ahead of a block that one level compares; the next level takes over from there.
const FAR: usize = 2 * NEAR + 1;
/// Added to every slope against rounding to f32.
const MARGIN: f32 = 1.000_01;

/// A quarter of the horizon: whether it is that of falling x, and of falling y.
#[derive(Debug, Clone, Copy)]
struct Quarter {
    back_x: bool,
    back_y: bool,
}

impl Quarter {
    /// In the order of their numbers.
    const ALL: [Quarter; 4] = [
        Quarter {
            back_x: false,
            back_y: false,
        },
        Quarter {
            back_x: true,
            back_y: false,
        },
        Quarter {
            back_x: false,
            back_y: true,
        },
        Quarter {
            back_x: true,
            back_y: true,
        },
    ];

    /// Number of the quarter in which a ray goes.
    #[inline(always)]
    fn of(k: &V3) -> usize {
        usize::from(k[0] < 0.0) + 2 * usize::from(k[1] < 0.0)
    }
}

/// Where `ahead` steps from `index` lead on a ring of `n`.
fn ahead(index: usize, ahead: usize, back: bool, n: usize) -> usize {
    let step = ahead % n;
    (if back { index + n - step } else { index + step }) % n
}

impl EscapeSlopes {
    /// Whether a ray along `k` that moves away from the surface is free from over this cell on.
    #[inline]
    #[must_use]
    pub fn clears(&self, cell: usize, k: &V3) -> bool {
        self.towards(k).clears(cell)
    }

    /// The same for many cells that a ray along `k` passes: its slope is worked out once.
    #[inline(always)]
    #[must_use]
    pub fn towards(&self, k: &V3) -> Towards<'_> {
        // Straight up is infinitely steep.
        #[expect(clippy::cast_possible_truncation, reason = "a margin was added")]
        let steepness = (k[2] * k[2] / (k[0] * k[0] + k[1] * k[1])) as f32;
        Towards {
            squared: &self.squared,
            quarter: Quarter::of(k),
            steepness,
        }
    }

    /// For rays above and below the field with these corners, of which each cell's highest and lowest are given too
    /// (see `HeightField`).
    pub(super) fn of_both_sides(
        arch: Arch,
        cells: (usize, usize),
        cell_size: (f64, f64),
        corners: &[[f32; 4]],
        high: &[f32],
        low: &[f32],
    ) -> (Self, Self) {
        let mirrored = |v: &[f32]| v.iter().map(|x| -x).collect::<Vec<f32>>();
        let (high_below, low_below) = (mirrored(low), mirrored(high));
        let of = |sign: f32, high: &[f32], low: &[f32]| {
            let quarters: Vec<Vec<f32>> = Quarter::ALL
                .into_par_iter()
                .map(|quarter| {
                    // Compiled for each set of vector instructions; the bits are the same with all of them.
                    arch.dispatch(Ahead {
                        cells,
                        cell_size,
                        quarter,
                        sign,
                        corners,
                        high,
                        low,
                    })
                })
                .collect();
            let [a, b, c, d] = [0, 1, 2, 3].map(|q: usize| quarters[q].as_slice());
            let four = a.iter().zip(b).zip(c).zip(d);
            EscapeSlopes {
                squared: four.map(|(((a, b), c), d)| [*a, *b, *c, *d]).collect(),
            }
        };
        rayon::join(|| of(1.0, high, low), || of(-1.0, &high_below, &low_below))
    }
}

/// What lies ahead of every cell in one quarter of the horizon, as a type and not a closure: a closure of this size
/// is not inlined, and what is not inlined is not compiled for the wider instructions. Loops for the same reason.
struct Ahead<'a> {
    cells: (usize, usize),
    cell_size: (f64, f64),
    quarter: Quarter,
    /// −1 for the field seen from below.
    sign: f32,
    corners: &'a [[f32; 4]],
    high: &'a [f32],
    low: &'a [f32],
}

impl pulp::WithSimd for Ahead<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Vec<f32> {
        let mut slopes = self.steepest_triangles();
        self.beyond(&mut slopes);
        for s in &mut slopes {
            let slope = greater(*s, 0.0) * MARGIN;
            *s = slope * slope;
        }
        slopes
    }
}

/// The greater of two numbers that are numbers.
#[inline(always)]
fn greater(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

/// Each of `to` raised to its counterpart.
#[inline(always)]
fn raise(to: &mut [f32], by: &[f32]) {
    for (to, by) in to.iter_mut().zip(by) {
        *to = greater(*to, *by);
    }
}

impl Ahead<'_> {
    /// How steeply the steepest triangle within [`NEAR`] cells rises.
    #[inline(always)]
    fn steepest_triangles(&self) -> Vec<f32> {
        let ((nx, ny), (cell_x, cell_y)) = (self.cells, self.cell_size);
        #[expect(clippy::cast_possible_truncation, reason = "a margin is added")]
        let (mut ix, mut iy) = ((1.0 / cell_x) as f32, (1.0 / cell_y) as f32);
        ix *= self.sign * if self.quarter.back_x { -1.0 } else { 1.0 };
        iy *= self.sign * if self.quarter.back_y { -1.0 } else { 1.0 };
        // Of all directions in a quarter that along the rising part of the gradient is steepest.
        let mut own = vec![0.0f32; nx * ny];
        for (own, [h00, h10, h01, h11]) in own.iter_mut().zip(self.corners) {
            let lower = [(h10 - h00) * ix, (h11 - h10) * iy].map(|s| greater(s, 0.0));
            let upper = [(h11 - h01) * ix, (h01 - h00) * iy].map(|s| greater(s, 0.0));
            *own = greater(
                lower[0] * lower[0] + lower[1] * lower[1],
                upper[0] * upper[0] + upper[1] * upper[1],
            );
        }
        let mut rows = own.clone();
        for (out, row) in rows.chunks_mut(ny).zip(own.chunks(ny)) {
            for step in 1..=NEAR {
                let start = ahead(0, step, self.quarter.back_y, ny);
                let (first, last) = out.split_at_mut(ny - start);
                raise(first, &row[start..]);
                raise(last, &row[..start]);
            }
        }
        let mut all = rows.clone();
        for (i, out) in all.chunks_mut(ny).enumerate() {
            for step in 1..=NEAR {
                let from = ahead(i, step, self.quarter.back_x, nx);
                raise(out, &rows[from * ny..(from + 1) * ny]);
            }
        }
        for x in &mut all {
            *x = x.sqrt();
        }
        all
    }

    /// Raises slopes to those of everything farther ahead.
    #[inline(always)]
    fn beyond(&self, slopes: &mut [f32]) {
        let ((nx, ny), (cell_x, cell_y)) = (self.cells, self.cell_size);
        let (mut high, mut low) = (self.high.to_vec(), self.low.to_vec());
        let mut highest = f32::NEG_INFINITY;
        for h in &high {
            highest = greater(highest, *h);
        }
        let (mut bx, mut by, mut size) = (nx, ny, 1usize);
        loop {
            let splits = bx % 2 == 0 && by % 2 == 0 && bx >= 4 * FAR && by >= 4 * FAR;
            let (wide, deep) = (size as f64 * cell_x, size as f64 * cell_y);
            let mut bound = ring(self.quarter, (bx, by), (wide, deep), &high, &low);
            if !splits {
                // Everything beyond this level's reach.
                let gap = FAR as f64 * wide.min(deep);
                #[expect(clippy::cast_possible_truncation, reason = "a margin is added")]
                let inverse = (1.0 / gap) as f32;
                for (b, l) in bound.iter_mut().zip(&low) {
                    *b = greater(*b, (highest - l) * inverse);
                }
            }
            for (i, row) in slopes.chunks_mut(ny).enumerate() {
                let from = &bound[(i / size) * by..(i / size + 1) * by];
                if size == 1 {
                    raise(row, from);
                    continue;
                }
                for (cells, b) in row.chunks_mut(size).zip(from) {
                    for s in cells {
                        *s = greater(*s, *b);
                    }
                }
            }
            if !splits {
                break;
            }
            high = coarser(bx, by, &high, f32::max);
            low = coarser(bx, by, &low, f32::min);
            (bx, by, size) = (bx / 2, by / 2, size * 2);
        }
    }
}

/// Steepest slope from the lowest point of each block to the highest of each block [`NEAR`] + 1 to
/// [`FAR`] blocks ahead.
#[inline(always)]
fn ring(
    quarter: Quarter,
    (bx, by): (usize, usize),
    (wide, deep): (f64, f64),
    high: &[f32],
    low: &[f32],
) -> Vec<f32> {
    let mut bound = vec![0.0f32; bx * by];
    // Rows with a wrapped margin on the side ahead, so that the inner loop runs straight.
    let padded_row = by + FAR;
    let mut padded = Vec::with_capacity(bx * padded_row);
    for (i, row) in high.chunks(by).enumerate() {
        let mut from = if quarter.back_y {
            ahead(0, FAR, true, by)
        } else {
            0
        };
        while padded.len() < (i + 1) * padded_row {
            let left = (i + 1) * padded_row - padded.len();
            padded.extend_from_slice(&row[from..by.min(from + left)]);
            from = 0;
        }
    }
    for (i, out) in bound.chunks_mut(by).enumerate() {
        let low = &low[i * by..(i + 1) * by];
        for away_i in 0..=FAR {
            let row = ahead(i, away_i, quarter.back_x, bx);
            let padded = &padded[row * padded_row..(row + 1) * padded_row];
            for away_j in 0..=FAR {
                if away_i.max(away_j) <= NEAR {
                    continue;
                }
                let gap_x = away_i.saturating_sub(1) as f64 * wide;
                let gap_y = away_j.saturating_sub(1) as f64 * deep;
                #[expect(clippy::cast_possible_truncation, reason = "a margin is added")]
                let inverse = (1.0 / (gap_x * gap_x + gap_y * gap_y).sqrt()) as f32;
                let start = if quarter.back_y { FAR - away_j } else { away_j };
                for ((b, l), h) in out.iter_mut().zip(low).zip(&padded[start..start + by]) {
                    *b = greater(*b, (h - l) * inverse);
                }
            }
        }
    }
    bound
}

fn coarser(bx: usize, by: usize, fine: &[f32], pick: fn(f32, f32) -> f32) -> Vec<f32> {
    let mut coarse = Vec::with_capacity(bx * by / 4);
    for i in (0..bx).step_by(2) {
        for j in (0..by).step_by(2) {
            let (a, b) = (fine[i * by + j], fine[i * by + j + 1]);
            let (c, d) = (fine[(i + 1) * by + j], fine[(i + 1) * by + j + 1]);
            coarse.push(pick(pick(a, b), pick(c, d)));
        }
    }
    coarse
}

#[cfg(test)]
mod tests {
    use super::super::height_field::{HeightField, Side};
    use super::super::rng::{Purpose, Stream};

    /// Height of the periodic surface over a place in cells.
    fn height(field: &HeightField, x: f64, y: f64) -> f64 {
        let (nx, ny) = field.cells();
        let (i, j) = (x.floor(), y.floor());
        let corners = field.corner_heights(
            (i as i64).rem_euclid(nx as i64) as usize,
            (j as i64).rem_euclid(ny as i64) as usize,
        );
        let (u, v) = (x - i, y - j);
        let [h00, h10, h01, h11] = corners;
        if v > u {
            h00 + u * (h11 - h01) + v * (h01 - h00)
        } else {
            h00 + u * (h10 - h00) + v * (h11 - h10)
        }
    }

    #[test]
    fn what_clears_a_cell_meets_nothing() {
        // Hills of all sizes, on tiles that split into blocks and on such that do not.
        for (nx, ny, cell_y) in [(64, 56, 0.6), (9, 31, 1.0), (3, 2, 2.0)] {
            let mut random = Stream::new(5, Purpose::Surface, nx as u64);
            let heights: Vec<f64> = (0..nx * ny)
                .map(|at| {
                    let (x, y) = ((at / ny) as f64 / nx as f64, (at % ny) as f64 / ny as f64);
                    let wave = |n: f64, m: f64| (std::f64::consts::TAU * (n * x + m * y)).sin();
                    2.0 * wave(1.0, 2.0) + wave(3.0, -2.0) + 0.4 * random.uniform()
                })
                .collect();
            let field = HeightField::new(nx, ny, 1.0, cell_y, &heights);
            let (low, high) = field.range();
            let mut cleared = 0;
            for _ in 0..4000 {
                let (i, j) = (random.uniform() * nx as f64, random.uniform() * ny as f64);
                let azimuth = std::f64::consts::TAU * random.uniform();
                let rise = 2.5 * random.uniform();
                for (side, sign) in [(Side::Above, 1.0), (Side::Below, -1.0)] {
                    let k = [azimuth.cos(), azimuth.sin(), sign * rise];
                    let cell = i as usize * ny + j as usize;
                    if !field.escape(side).clears(cell, &k) {
                        continue;
                    }
                    cleared += 1;
                    let from = height(&field, i, j);
                    let mut t = 0.0;
                    while sign * (from + t * k[2]) <= (sign * low).max(sign * high) {
                        let there = height(&field, i + t * k[0], j + t * k[1] / cell_y);
                        assert!(
                            sign * (from + t * k[2] - there) >= -1e-6,
                            "{nx} × {ny}, {side:?}: from ({i}, {j}) along {k:?} after {t}"
                        );
                        t += 0.05;
                    }
                }
            }
            assert!(cleared > 800, "{nx} × {ny}: {cleared}");
        }
    }
}
