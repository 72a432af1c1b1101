//! Horizon slopes: how steeply a ray must rise from a cell to be certainly free.
//!
//! For every cell and each of eight sectors of the horizon, the slope E that no other point of the
//! periodic surface exceeds, seen in that sector from any point of the cell. The bound is
//! conservative: a ray above it is free; one below it may be free too.
//!
//! A ray that is already high above the cell may rise less steeply. From a point at height h, no
//! point at distance D is higher than h + E D, nor than the highest point H, which that line
//! reaches at D = (H − h)/E. A ray at z ≥ h with a slope of E (H − z)/(H − h) reaches H there too,
//! so it stays above both. The value E/(H − h) is stored for the highest h of the cell: one
//! multiplication gives the required slope of a ray.
//!
//! In the near range (three cells ahead), the steepest triangle in the sector is the bound, because
//! the straight line between two points of a continuous surface is no steeper than the surface
//! between them. Farther away, blocks of 2^l cells are compared by highest and lowest point over
//! the gap between them, level by level. Beyond the coarsest level everything counts as high as the
//! highest point.
//!
//! *Conditioning.* Differences of heights in single precision are accurate to 6e-8 of the heights,
//! slopes and their squares to a few times that; a margin of 1e-5 on every slope covers it. Squares
//! are compared, so there is no division by a horizontal component that may be 0: a vertical ray
//! clears everything. Above a cell that contains the highest point H − h is 0, E/0 infinite and ∞ ·
//! 0 NaN, which no slope exceeds.

use pulp::Arch;
use rayon::prelude::*;

use crate::trace::vec3::V3;

/// Horizon slopes of one side, divided by the height below the highest point: for each octant one
/// per cell. (A ray stays in its octant, so the values that it needs are adjacent in memory.)
#[derive(Debug, Clone)]
pub struct HorizonSlopes {
    per_height: Vec<Vec<f32>>,
    cell_size: (f64, f64),
    /// Highest point of each cell and of the whole field, counted away from the surface.
    high: Vec<f32>,
    highest: f64,
}

/// Horizon slopes for rays in one direction.
#[derive(Debug, Clone, Copy)]
pub struct Towards<'a> {
    per_height: &'a [f32],
    high: &'a [f32],
    highest: f64,
    /// Squares of the direction's components away from the surface and along it.
    rise: f64,
    run: f64,
}

impl Towards<'_> {
    /// The outermost point of a cell.
    #[inline(always)]
    #[must_use]
    pub fn outermost(&self, cell: usize) -> f64 {
        f64::from(self.high[cell])
    }

    /// Whether a ray in this direction is free from this cell on, if it is nowhere lower than `z`
    /// (counted away from the surface).
    #[inline(always)]
    #[must_use]
    pub fn clears(&self, cell: usize, z: f64) -> bool {
        let high = self.outermost(cell);
        let left = self.highest - if z > high { z } else { high };
        let needed = f64::from(self.per_height[cell]) * left;
        // NaN is kept.
        let needed = if needed < 0.0 { 0.0 } else { needed };
        self.rise > needed * needed * self.run
    }
}

/// Number of cells ahead that are bounded by their steepest triangle.
const NEAR: usize = 3;
/// Number of blocks ahead that one level compares; the next level continues from there.
const FAR: usize = 2 * NEAR + 1;
/// Factor on every slope that covers rounding to f32.
const MARGIN: f32 = 1.000_01;

/// An eighth of the horizon: whether x decreases, whether y does, and whether more cells are
/// crossed along y than along x.
#[derive(Debug, Clone, Copy)]
struct Octant {
    back_x: bool,
    back_y: bool,
    along_y: bool,
}

impl Octant {
    /// All octants in the order of their numbers.
    fn all() -> impl IndexedParallelIterator<Item = Octant> {
        (0..8).into_par_iter().map(|number| Octant {
            back_x: number & 1 != 0,
            back_y: number & 2 != 0,
            along_y: number & 4 != 0,
        })
    }

    /// Index of the octant of a ray.
    #[inline(always)]
    fn of(k: &V3, (cell_x, cell_y): (f64, f64)) -> usize {
        let along_y = k[1].abs() * cell_x > k[0].abs() * cell_y;
        usize::from(k[0] < 0.0) + 2 * usize::from(k[1] < 0.0) + 4 * usize::from(along_y)
    }

    /// Whether rays in this octant from some point of one cell can hit another, `ahead_x` and
    /// `ahead_y` cells away: the shorter of the two distances is at most one cell longer than the
    /// longer one.
    #[inline(always)]
    fn meets(self, ahead_x: usize, ahead_y: usize) -> bool {
        if self.along_y {
            ahead_x <= ahead_y + 1
        } else {
            ahead_y <= ahead_x + 1
        }
    }
}

/// The index `ahead` steps from `index` on a ring of `n`.
#[inline(always)]
fn ahead(index: usize, ahead: usize, back: bool, n: usize) -> usize {
    // Division only for narrow tiles: it takes longer than a whole row.
    let step = if ahead < n { ahead } else { ahead % n };
    let at = if back { index + n - step } else { index + step };
    if at < n { at } else { at - n }
}

impl HorizonSlopes {
    /// The slopes for a ray along `k`, which moves away from the surface.
    #[inline(always)]
    #[must_use]
    pub fn towards(&self, k: &V3) -> Towards<'_> {
        Towards {
            per_height: &self.per_height[Octant::of(k, self.cell_size)],
            high: &self.high,
            highest: self.highest,
            rise: k[2] * k[2],
            run: k[0] * k[0] + k[1] * k[1],
        }
    }

    /// Computes both sides of the field with these corners; each cell's highest and lowest corners
    /// are given too (see `HeightField`).
    pub(in crate::trace) fn of_both_sides(
        arch: Arch,
        cells: (usize, usize),
        cell_size: (f64, f64),
        corners: &[[f32; 4]],
        high: &[f32],
        low: &[f32],
    ) -> (Self, Self) {
        let mirrored = |v: &[f32]| v.iter().map(|x| -x).collect::<Vec<f32>>();
        let of = |sign: f32, high: Vec<f32>, low: Vec<f32>| {
            let highest = high.iter().copied().fold(f32::NEG_INFINITY, greater);
            let mut levels = Level::all(cells, cell_size, high, low);
            let ahead = |octant| {
                // Compiled for each vector instruction set; the bits are the same with all of them.
                arch.dispatch(Ahead {
                    cells,
                    cell_size,
                    octant,
                    sign,
                    corners,
                    levels: &levels,
                    highest,
                })
            };
            HorizonSlopes {
                per_height: Octant::all().map(ahead).collect(),
                cell_size,
                high: levels.swap_remove(0).high,
                highest: f64::from(highest),
            }
        };
        rayon::join(
            || of(1.0, high.to_vec(), low.to_vec()),
            || of(-1.0, mirrored(low), mirrored(high)),
        )
    }
}

/// Blocks of cells with their highest and lowest points.
struct Level {
    blocks: (usize, usize),
    /// Size of one block.
    size: (f64, f64),
    high: Vec<f32>,
    low: Vec<f32>,
}

impl Level {
    /// The cells, and blocks of 2 × 2, 4 × 4 … cells while there are several.
    fn all(
        cells: (usize, usize),
        cell_size: (f64, f64),
        high: Vec<f32>,
        low: Vec<f32>,
    ) -> Vec<Level> {
        let mut levels = vec![Level {
            blocks: cells,
            size: cell_size,
            high,
            low,
        }];
        while let Some(fine) = levels.last()
            && fine.splits()
        {
            let ((bx, by), (wide, deep)) = (fine.blocks, fine.size);
            levels.push(Level {
                blocks: (bx / 2, by / 2),
                size: (2.0 * wide, 2.0 * deep),
                high: coarser(by, &fine.high, greater),
                low: coarser(by, &fine.low, lesser),
            });
        }
        levels
    }

    fn splits(&self) -> bool {
        let enough = |blocks: usize| blocks.is_multiple_of(2) && blocks >= 4 * FAR;
        enough(self.blocks.0) && enough(self.blocks.1)
    }
}

/// For every 2 × 2 numbers in rows of `by`, the value that `pick` selects.
fn coarser(by: usize, fine: &[f32], pick: impl Fn(f32, f32) -> f32) -> Vec<f32> {
    let mut coarse = Vec::with_capacity(fine.len() / 4);
    for rows in fine.chunks(2 * by) {
        let (first, second) = rows.split_at(by);
        let pairs = first.chunks(2).zip(second.chunks(2));
        coarse.extend(pairs.map(|(a, b)| pick(pick(a[0], a[1]), pick(b[0], b[1]))));
    }
    coarse
}

/// The surface ahead of every cell in one octant. A type instead of a closure, because a closure of
/// this size is not inlined and would not be compiled for the wider instructions; loops for the
/// same reason.
struct Ahead<'a> {
    cells: (usize, usize),
    cell_size: (f64, f64),
    octant: Octant,
    /// −1 for the field seen from below.
    sign: f32,
    corners: &'a [[f32; 4]],
    /// All levels, from the cells on; for the side concerned.
    levels: &'a [Level],
    highest: f32,
}

impl pulp::WithSimd for Ahead<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Vec<f32> {
        let mut slopes = self.steepest_triangles();
        raise(&mut slopes, &self.beyond());
        for (s, h) in slopes.iter_mut().zip(&self.levels[0].high) {
            // If no surface rises, no slope is needed, not even where the height difference is 0.
            *s = if *s > 0.0 {
                *s * MARGIN / (self.highest - h)
            } else {
                0.0
            };
        }
        slopes
    }
}

/// The larger of two numbers, neither of them NaN; `f32::max` would test for NaN.
#[inline(always)]
pub(in crate::trace) fn greater(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

/// The smaller of two numbers, neither of them NaN.
#[inline(always)]
pub(in crate::trace) fn lesser(a: f32, b: f32) -> f32 {
    if b < a { b } else { a }
}

/// Raises each element of `to` to its counterpart.
#[inline(always)]
fn raise(to: &mut [f32], by: &[f32]) {
    for (to, by) in to.iter_mut().zip(by) {
        *to = greater(*to, *by);
    }
}

impl Ahead<'_> {
    /// Slope of the steepest triangle within [`NEAR`] cells.
    #[inline(always)]
    fn steepest_triangles(&self) -> Vec<f32> {
        let ((nx, ny), (cell_x, cell_y), octant) = (self.cells, self.cell_size, self.octant);
        let inverse = [1.0 / cell_x, 1.0 / cell_y];
        let diagonal = 1.0 / cell_x.hypot(cell_y);
        #[expect(clippy::cast_possible_truncation, reason = "a margin is added")]
        let [mut ix, mut iy, dx, dy] =
            [inverse[0], inverse[1], cell_x * diagonal, cell_y * diagonal].map(|x| x as f32);
        ix *= self.sign * if octant.back_x { -1.0 } else { 1.0 };
        iy *= self.sign * if octant.back_y { -1.0 } else { 1.0 };
        // Along the gradient if it is in the octant, otherwise along one of the octant's sides: an
        // axis or the cells' diagonal.
        let steepest = |x: f32, y: f32| {
            let along_diagonal = dx * x + dy * y;
            let (axis, other, turn) = if octant.along_y {
                (y, x, dx * y - dy * x)
            } else {
                (x, y, dy * x - dx * y)
            };
            let side = greater(greater(axis, along_diagonal), 0.0);
            // Without a branch.
            let inside = (other >= 0.0) & (turn >= 0.0);
            if inside { x * x + y * y } else { side * side }
        };
        let mut own = vec![0.0f32; nx * ny];
        for (own, [h00, h10, h01, h11]) in own.iter_mut().zip(self.corners) {
            let lower = steepest((h10 - h00) * ix, (h11 - h10) * iy);
            let upper = steepest((h11 - h01) * ix, (h01 - h00) * iy);
            *own = greater(lower, upper);
        }
        let mut all = own.clone();
        for (i, out) in all.chunks_mut(ny).enumerate() {
            for ahead_x in 0..=NEAR {
                let from = ahead(i, ahead_x, octant.back_x, nx);
                let row = &own[from * ny..(from + 1) * ny];
                for ahead_y in (0..=NEAR).filter(|y| octant.meets(ahead_x, *y)) {
                    let start = ahead(0, ahead_y, octant.back_y, ny);
                    let (first, last) = out.split_at_mut(ny - start);
                    raise(first, &row[start..]);
                    raise(last, &row[..start]);
                }
            }
        }
        for x in &mut all {
            *x = x.sqrt();
        }
        all
    }

    /// Slope to everything farther ahead.
    #[inline(always)]
    fn beyond(&self) -> Vec<f32> {
        let mut bound: Vec<f32> = Vec::new();
        for level in self.levels.iter().rev() {
            let mut finer = ring(self.octant, level);
            let (_, by) = level.blocks;
            if bound.is_empty() {
                // Everything beyond the range of the coarsest level.
                let gap = FAR as f64 * level.size.0.min(level.size.1);
                #[expect(clippy::cast_possible_truncation, reason = "a margin is added")]
                let inverse = (1.0 / gap) as f32;
                for (b, l) in finer.iter_mut().zip(&level.low) {
                    *b = greater(*b, (self.highest - l) * inverse);
                }
            } else {
                for (rows, coarse) in finer.chunks_mut(2 * by).zip(bound.chunks(by / 2)) {
                    for row in rows.chunks_mut(by) {
                        for (two, b) in row.chunks_exact_mut(2).zip(coarse) {
                            two[0] = greater(two[0], *b);
                            two[1] = greater(two[1], *b);
                        }
                    }
                }
            }
            bound = finer;
        }
        bound
    }
}

/// Steepest slope from the lowest point of each block to the highest of each block [`NEAR`] + 1 to
/// [`FAR`] blocks ahead.
#[inline(always)]
fn ring(octant: Octant, level: &Level) -> Vec<f32> {
    let ((bx, by), (wide, deep)) = (level.blocks, level.size);
    // Rows with a wrapped margin on the side ahead, so that the inner loop has no branches.
    let padded_row = by + FAR;
    let mut padded = Vec::with_capacity(bx * padded_row);
    for (i, row) in level.high.chunks(by).enumerate() {
        let mut from = if octant.back_y {
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
    // For each compared block: its offset along x, the start of its row, and one over the gap.
    let mut compared = Vec::new();
    for ahead_x in 0..=FAR {
        for ahead_y in 0..=FAR {
            if ahead_x.max(ahead_y) <= NEAR || !octant.meets(ahead_x, ahead_y) {
                continue;
            }
            let gap_x = ahead_x.saturating_sub(1) as f64 * wide;
            let gap_y = ahead_y.saturating_sub(1) as f64 * deep;
            #[expect(clippy::cast_possible_truncation, reason = "a margin is added")]
            let inverse = (1.0 / (gap_x * gap_x + gap_y * gap_y).sqrt()) as f32;
            let start = if octant.back_y {
                FAR - ahead_y
            } else {
                ahead_y
            };
            compared.push((ahead_x, start, inverse));
        }
    }
    let mut bound = vec![0.0f32; bx * by];
    for (i, (out, low)) in bound.chunks_mut(by).zip(level.low.chunks(by)).enumerate() {
        let rows = compared.iter().map(|(ahead_x, start, inverse)| {
            let row = ahead(i, *ahead_x, octant.back_x, bx);
            (&padded[row * padded_row + start..][..by], *inverse)
        });
        let done = steepest_of::<64>(out, low, 0, rows.clone());
        let done = steepest_of::<16>(out, low, done, rows.clone());
        let done = steepest_of::<4>(out, low, done, rows.clone());
        steepest_of::<1>(out, low, done, rows);
    }
    bound
}

/// From `done` on, `N` elements at a time while that many are left, the steepest slope from each of
/// `low` to its counterpart in the rows, which come with one over their distance. Returns the
/// number of elements done.
#[inline(always)]
fn steepest_of<'a, const N: usize>(
    out: &mut [f32],
    low: &[f32],
    mut done: usize,
    rows: impl Iterator<Item = (&'a [f32], f32)> + Clone,
) -> usize {
    let (out, _) = out[done..].as_chunks_mut::<N>();
    let (low, _) = low[done..].as_chunks::<N>();
    for (out, low) in out.iter_mut().zip(low) {
        // Kept in registers over all rows.
        let mut steepest = [0.0f32; N];
        for (row, inverse) in rows.clone() {
            let high = &row[done..done + N];
            for ((s, h), l) in steepest.iter_mut().zip(high).zip(low) {
                *s = greater(*s, (h - l) * inverse);
            }
        }
        *out = steepest;
        done += N;
    }
    done
}

#[cfg(test)]
mod tests {
    use crate::trace::rng::{Purpose, RandomStream};
    use crate::trace::surfaces::height_field::{Flight, HeightField, Side};

    /// Height of the periodic surface at a position in cells.
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
    fn rays_leave_flat_surfaces_and_the_highest_points() {
        let flat = HeightField::new(4, 3, 1.0, 1.0, &[0.5; 12]);
        // One cell's corners and a ridge are the highest points.
        let mut heights = [0.0; 64];
        for at in [9, 10, 17, 18, 40, 41, 42, 43, 44, 45, 46, 47] {
            heights[at] = 1.0;
        }
        let plateau = HeightField::new(8, 8, 1.0, 1.0, &heights);
        for (field, i, j) in [(&flat, 1, 1), (&plateau, 1, 1), (&plateau, 5, 3)] {
            for k in [[1.0, 0.3, 1e-3], [-0.2, 1.0, 0.5], [0.0, 0.0, 1.0]] {
                let from = field.spot_at(i, j, false, 0.0, 0.0);
                assert_eq!(
                    field.onward(&from, Side::Above, &k, &mut 0),
                    Flight::Free,
                    "{k:?}"
                );
            }
        }
    }

    #[test]
    fn a_ray_that_clears_a_cell_is_free() {
        // Hills of all sizes, on tiles that split into blocks and on tiles that do not.
        for (nx, ny, cell_y) in [(64, 56, 0.6), (9, 31, 1.0), (3, 2, 2.0)] {
            let mut random = RandomStream::new(5, Purpose::Surface, nx as u64);
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
                // Half of the rays are already above the surface.
                let lift = (3.0 * random.uniform() - 1.5).max(0.0);
                for (side, sign) in [(Side::Above, 1.0), (Side::Below, -1.0)] {
                    let k = [azimuth.cos(), azimuth.sin(), sign * rise];
                    let cell = i as usize * ny + j as usize;
                    let from = height(&field, i, j) + sign * lift;
                    if !field.horizon(side).towards(&k).clears(cell, sign * from) {
                        continue;
                    }
                    cleared += 1;
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
