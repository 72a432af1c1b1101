//! Escape slopes: how steeply a ray must rise from a cell to be free for certain.
//!
//! For every cell a slope that no other point of the periodic surface exceeds as seen from any
//! point on (or over) that cell. Conservative: a ray above it is free; one below may be free too.
//!
//! Near by (three cells around) the steepest triangle bounds it, since the straight line between two
//! points of a continuous surface is no steeper than the surface between them. Farther away blocks
//! of 2^l cells are compared by highest and lowest point over the gap between them, level by level,
//! and beyond the coarsest level everything is as high as the highest point.

use super::vec3::V3;

/// Squared escape slopes of one side, one per cell.
#[derive(Debug, Clone)]
pub struct EscapeSlopes {
    squared: Vec<f32>,
}

/// Cells around a cell that are bounded by their steepest triangle.
const NEAR: usize = 3;
/// Blocks around a block that one level compares; the next level takes over from there.
const FAR: usize = 2 * NEAR + 1;
/// Added to every slope against rounding to f32.
const MARGIN: f32 = 1.000_01;

impl EscapeSlopes {
    /// Whether a ray along `k` that moves away from the surface is free from over this cell on.
    #[inline]
    #[must_use]
    pub fn clears(&self, cell: usize, k: &V3) -> bool {
        k[2] * k[2] > f64::from(self.squared[cell]) * (k[0] * k[0] + k[1] * k[1])
    }

    /// For rays above and below the field with these corners, of which each cell's highest and lowest are given too
    /// (see `HeightField`).
    pub(super) fn of_both_sides(
        nx: usize,
        ny: usize,
        cell_x: f64,
        cell_y: f64,
        corners: &[[f32; 4]],
        high: &[f32],
        low: &[f32],
    ) -> (Self, Self) {
        let steepest = steepest_around(nx, ny, cell_x, cell_y, corners);
        let mirrored = |v: &[f32]| v.iter().map(|x| -x).collect::<Vec<f32>>();
        let (high_below, low_below) = (mirrored(low), mirrored(high));
        rayon::join(
            || {
                of_one_side(
                    nx,
                    ny,
                    cell_x,
                    cell_y,
                    &steepest,
                    high.to_vec(),
                    low.to_vec(),
                )
            },
            || of_one_side(nx, ny, cell_x, cell_y, &steepest, high_below, low_below),
        )
    }
}

/// Norm of the steepest triangle's slope within [`NEAR`] cells.
fn steepest_around(
    nx: usize,
    ny: usize,
    cell_x: f64,
    cell_y: f64,
    corners: &[[f32; 4]],
) -> Vec<f32> {
    #[expect(clippy::cast_possible_truncation, reason = "a margin is added")]
    let (ix, iy) = ((1.0 / cell_x) as f32, (1.0 / cell_y) as f32);
    let own: Vec<f32> = corners
        .iter()
        .map(|&[h00, h10, h01, h11]| {
            let lower = ((h10 - h00) * ix).powi(2) + ((h11 - h10) * iy).powi(2);
            let upper = ((h11 - h01) * ix).powi(2) + ((h01 - h00) * iy).powi(2);
            lower.max(upper)
        })
        .collect();
    let mut rows = vec![0.0f32; nx * ny];
    for (out, row) in rows.chunks_mut(ny).zip(own.chunks(ny)) {
        for shift in 0..=2 * NEAR {
            let start = (ny * (NEAR + 1) + shift - NEAR) % ny;
            for (o, x) in out.iter_mut().zip(row[start..].iter().chain(&row[..start])) {
                *o = o.max(*x);
            }
        }
    }
    let mut all = vec![0.0f32; nx * ny];
    for (i, out) in all.chunks_mut(ny).enumerate() {
        for shift in 0..=2 * NEAR {
            let from = (i + nx * (NEAR + 1) + shift - NEAR) % nx;
            for (o, x) in out.iter_mut().zip(&rows[from * ny..(from + 1) * ny]) {
                *o = o.max(*x);
            }
        }
    }
    for x in &mut all {
        *x = x.sqrt();
    }
    all
}

fn of_one_side(
    nx: usize,
    ny: usize,
    cell_x: f64,
    cell_y: f64,
    steepest: &[f32],
    mut high: Vec<f32>,
    mut low: Vec<f32>,
) -> EscapeSlopes {
    let mut slope = steepest.to_vec();
    let highest = high.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let (mut bx, mut by, mut size) = (nx, ny, 1usize);
    loop {
        let splits = bx % 2 == 0 && by % 2 == 0 && bx >= 4 * FAR && by >= 4 * FAR;
        let mut bound = ring(
            bx,
            by,
            size as f64 * cell_x,
            size as f64 * cell_y,
            &high,
            &low,
        );
        if !splits {
            // Everything beyond this level's reach.
            let gap = FAR as f64 * size as f64 * cell_x.min(cell_y);
            #[expect(clippy::cast_possible_truncation, reason = "a margin is added")]
            let inverse = (1.0 / gap) as f32;
            for (b, l) in bound.iter_mut().zip(&low) {
                *b = b.max((highest - l) * inverse);
            }
        }
        for (i, row) in slope.chunks_mut(ny).enumerate() {
            let from = &bound[(i / size) * by..];
            for (j, s) in row.iter_mut().enumerate() {
                *s = s.max(from[j / size]);
            }
        }
        if !splits {
            break;
        }
        high = coarser(bx, by, &high, f32::max);
        low = coarser(bx, by, &low, f32::min);
        (bx, by, size) = (bx / 2, by / 2, size * 2);
    }
    for s in &mut slope {
        *s = (s.max(0.0) * MARGIN).powi(2);
    }
    EscapeSlopes { squared: slope }
}

/// Steepest slope from the lowest point of each block to the highest of each block [`NEAR`] + 1 to
/// [`FAR`] blocks away.
fn ring(bx: usize, by: usize, wide: f64, deep: f64, high: &[f32], low: &[f32]) -> Vec<f32> {
    use rayon::prelude::*;
    let mut bound = vec![0.0f32; bx * by];
    // Rows with a wrapped margin on both sides, so that the inner loop runs straight.
    let padded_row = by + 2 * FAR;
    let mut padded = Vec::with_capacity(bx * padded_row);
    for row in high.chunks(by) {
        padded.extend((0..padded_row).map(|j| row[(j + by * (FAR + 1) - FAR) % by]));
    }
    bound
        .par_chunks_mut(by)
        .with_min_len(16)
        .enumerate()
        .for_each(|(i, out)| {
            let low = &low[i * by..(i + 1) * by];
            for di in 0..=2 * FAR {
                let row = (i + bx * (FAR + 1) + di - FAR) % bx;
                let padded = &padded[row * padded_row..(row + 1) * padded_row];
                let away_i = di.abs_diff(FAR);
                for dj in 0..=2 * FAR {
                    let away_j = dj.abs_diff(FAR);
                    if away_i.max(away_j) <= NEAR {
                        continue;
                    }
                    let gap_x = away_i.saturating_sub(1) as f64 * wide;
                    let gap_y = away_j.saturating_sub(1) as f64 * deep;
                    #[expect(clippy::cast_possible_truncation, reason = "a margin is added")]
                    let inverse = (1.0 / gap_x.hypot(gap_y)) as f32;
                    for ((b, l), h) in out.iter_mut().zip(low).zip(&padded[dj..]) {
                        let slope = (h - l) * inverse;
                        *b = if slope > *b { slope } else { *b };
                    }
                }
            }
        });
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
