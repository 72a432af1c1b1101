//! Beckmann height fields: Gaussian surfaces whose slopes have exactly the requested roughness.
//!
//! Call [`beckmann`]. After Heitz 2015, "Generating procedural Beckmann surfaces": h = √(2/N) Σ
//! cos(φ + f·x) with f = √(−ln(1 − U)) (cos ψ, sin ψ). Two changes make it a tile: the wave vectors
//! are rounded to the tile's lattice, so that it repeats without seams, and they are drawn in
//! strata. The remaining error of a realisation's slope variance is compensated by the cell sizes,
//! one per axis: the variance of the triangles' slopes is exactly α²/2 on both axes.
//!
//! *Conditioning.* A height is a sum of 4096 cosines of either sign: 45 on average in units of one,
//! accurate to 1e-13 of that, then rounded to f32. The roughness does not depend on it: cell sizes
//! are computed from the sum of squared slopes (positive terms), so α is exact except for rounding
//! for any number of cells.

use pulp::Arch;
use rayon::prelude::*;

use super::height_field::HeightField;
use crate::model::LeftOut;
use crate::trace::rng::{Purpose, RandomStream};

/// Default number of cells along each side of a tile.
pub const CELLS: usize = 400;
/// Strata of wave vectors per axis: N = 64² waves.
const STRATA: usize = 64;
/// Largest |f| in units of α (5e-6 of the waves are beyond).
const CUT: f64 = 3.5;
/// Phase per cell of the shortest wave, rad: at least six samples per wave.
const SHORTEST: f64 = 1.0;

/// With fewer cells along a side, there are too few waves for Gaussian statistics.
const CELLS_MANY: usize = 100;

/// The effect of few cells: the waves fall on few points of the lattice, so slopes are no longer
/// normally distributed.
#[must_use]
pub fn few_cells(cells: usize, interface: usize) -> Option<LeftOut> {
    (cells < CELLS_MANY).then(|| {
        LeftOut::new(
            format!("normal slopes of interface {interface}"),
            format!(
                "a tile of {cells} cells contains few waves: the variance of its slopes is α²/2, but their distribution, \
                 especially of steep ones, is not Beckmann's; use {CELLS_MANY} cells or more"
            ),
            None,
        )
    })
}

/// Makes a tile of `cells` × `cells` with Beckmann roughness `alpha_u` along x and `alpha_v` along
/// y (tangent of slope; the slopes are N(0, α²/2) per axis). Heights have unit variance.
#[must_use]
pub fn beckmann(cells: usize, alpha_u: f64, alpha_v: f64, seed: u64) -> HeightField {
    let heights = heights(cells, seed);
    // ⟨(Δh)²⟩ along an axis, over all cells.
    let (mut along_x, mut along_y) = (0.0, 0.0);
    for i in 0..cells {
        let next = (i + 1) % cells;
        for j in 0..cells {
            let h = heights[i * cells + j];
            along_x += (heights[next * cells + j] - h).powi(2);
            along_y += (heights[i * cells + (j + 1) % cells] - h).powi(2);
        }
    }
    let count = (cells * cells) as f64;
    let size = |sum: f64, alpha: f64| (2.0 * sum / count).sqrt() / alpha;
    HeightField::new(
        cells,
        cells,
        size(along_x, alpha_u),
        size(along_y, alpha_v),
        &heights,
    )
}

/// The isotropic field before its cells get their sizes.
fn heights(cells: usize, seed: u64) -> Vec<f64> {
    let waves = waves(cells, seed);
    let reach = waves.iter().map(|w| w.kx.unsigned_abs()).max().unwrap_or(0);
    let table: Vec<(f64, f64)> = (0..cells)
        .map(|a| (std::f64::consts::TAU * a as f64 / cells as f64).sin_cos())
        .collect();
    let amplitude = (2.0 / waves.len() as f64).sqrt();
    // Sum over ky first: for each |kx| the cosine and sine parts along x, as functions of y.
    let mut groups: Vec<Vec<&Wave>> = vec![Vec::new(); reach as usize + 1];
    for wave in &waves {
        groups[wave.kx.unsigned_abs() as usize].push(wave);
    }
    let parts: Vec<(Vec<f64>, Vec<f64>)> = groups
        .par_iter()
        .map(|group| {
            let (mut cosine, mut sine) = (vec![0.0; cells], vec![0.0; cells]);
            for wave in group {
                let (s, c) = wave.phase.sin_cos();
                let sign = if wave.kx < 0 { -1.0 } else { 1.0 };
                let step = wave.ky.rem_euclid(cells as i64) as usize;
                let mut at = 0;
                for (cosine, sine) in cosine.iter_mut().zip(&mut sine) {
                    let (sy, cy) = table[at];
                    // cos(kx x + b) = cos(kx x) cos b − sin(kx x) sin b,  b = φ + ky y.
                    *cosine += amplitude * (c * cy - s * sy);
                    *sine -= sign * amplitude * (s * cy + c * sy);
                    at += step;
                    if at >= cells {
                        at -= cells;
                    }
                }
            }
            (cosine, sine)
        })
        .collect();
    let arch = Arch::new();
    let mut heights = vec![0.0; cells * cells];
    heights
        .par_chunks_mut(cells)
        .enumerate()
        .for_each(|(x, row)| {
            for (k, part) in parts.iter().enumerate() {
                let turn = table[(k * x) % cells];
                // Compiled for each vector instruction set; the bits are the same with all of them.
                arch.dispatch(Sum { row, part, turn });
            }
        });
    heights
}

/// Adds the waves of one |kx| to a row. A type instead of a closure, because closures are not
/// inlined and would not be compiled for the wider instructions.
struct Sum<'a> {
    row: &'a mut [f64],
    /// Cosine and sine parts.
    part: &'a (Vec<f64>, Vec<f64>),
    /// Sine and cosine of the row's phase.
    turn: (f64, f64),
}

impl pulp::WithSimd for Sum<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let ((cosine, sine), (s, c)) = (self.part, self.turn);
        for ((h, a), b) in self.row.iter_mut().zip(cosine).zip(sine) {
            *h += c * a + s * b;
        }
    }
}

struct Wave {
    kx: i64,
    ky: i64,
    phase: f64,
}

fn waves(cells: usize, seed: u64) -> Vec<Wave> {
    let mut random = RandomStream::new(seed, Purpose::Surface, 0);
    // Lattice steps per unit of f/α; small tiles contain at least a few waves.
    let per_unit = cells as f64 * SHORTEST / (std::f64::consts::TAU * CUT);
    let inside = 1.0 - (-CUT * CUT).exp();
    let mut waves = Vec::with_capacity(STRATA * STRATA);
    for a in 0..STRATA {
        for b in 0..STRATA {
            let u1 = inside * (a as f64 + random.uniform()) / STRATA as f64;
            let u2 = (b as f64 + random.uniform()) / STRATA as f64;
            let phase = std::f64::consts::TAU * random.uniform();
            let f = per_unit * (-(1.0 - u1).ln()).sqrt();
            let (s, c) = (std::f64::consts::TAU * u2).sin_cos();
            let (kx, ky) = ((f * c).round() as i64, (f * s).round() as i64);
            if (kx, ky) != (0, 0) {
                waves.push(Wave { kx, ky, phase });
            }
        }
    }
    waves
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Moments {
        variance_x: f64,
        variance_y: f64,
        covariance: f64,
        kurtosis: f64,
    }

    fn moments(field: &HeightField) -> Moments {
        let (nx, ny) = field.cells();
        let (mut xx, mut yy, mut xy, mut fourth) = (0.0, 0.0, 0.0, 0.0);
        for i in 0..nx {
            for j in 0..ny {
                for upper in [false, true] {
                    let (sx, sy) = field.slopes(i, j, upper);
                    xx += sx * sx;
                    yy += sy * sy;
                    xy += sx * sy;
                    fourth += sx.powi(4);
                }
            }
        }
        let n = (2 * nx * ny) as f64;
        Moments {
            variance_x: xx / n,
            variance_y: yy / n,
            covariance: xy / n,
            kurtosis: fourth / n / (xx / n).powi(2),
        }
    }

    #[test]
    fn slopes_have_the_requested_roughness_on_both_axes() {
        for (alpha_u, alpha_v, seed) in [(0.1, 0.1, 1), (0.4, 0.4, 2), (0.06, 0.18, 3)] {
            let m = moments(&beckmann(CELLS, alpha_u, alpha_v, seed));
            // α within 0.5 % is required; the cell sizes make it exact up to the f32 of the
            // heights.
            assert!(((2.0 * m.variance_x).sqrt() / alpha_u - 1.0).abs() < 1e-5);
            assert!(((2.0 * m.variance_y).sqrt() / alpha_v - 1.0).abs() < 1e-5);
            // About 1200 independent patches of slope: 5 standard errors of a Gaussian's moments.
            let correlation = m.covariance / (m.variance_x * m.variance_y).sqrt();
            assert!(correlation.abs() < 5.0 / 1200f64.sqrt(), "{correlation}");
            assert!((m.kurtosis - 3.0).abs() < 5.0 * (24.0f64 / 1200.0).sqrt());
        }
    }

    #[test]
    fn the_slopes_distribution_is_beckmanns() {
        // Fraction of normals steeper than tan θ: exp(−tan²θ/α²). Averaged over 4 fields.
        let alpha = 0.3;
        let mut steeper = [0.0; 3];
        let mut count = 0.0;
        for seed in 0..4 {
            let field = beckmann(CELLS, alpha, alpha, seed);
            for i in 0..CELLS {
                for j in 0..CELLS {
                    let (sx, sy) = field.slopes(i, j, (i + j) % 2 == 0);
                    let t2 = (sx * sx + sy * sy) / (alpha * alpha);
                    for (n, limit) in steeper.iter_mut().zip([0.25, 1.0, 2.25]) {
                        *n += f64::from(u8::from(t2 > limit));
                    }
                    count += 1.0;
                }
            }
        }
        for (n, limit) in steeper.iter().zip([0.25f64, 1.0, 2.25]) {
            let share = n / count;
            let expected = (-limit).exp();
            // About 5,000 independent patches of slope in four fields.
            let sigma = (expected * (1.0 - expected) / 5000.0).sqrt();
            assert!((share - expected).abs() < 4.0 * sigma, "{share} {expected}");
        }
    }

    #[test]
    fn equal_seeds_give_equal_fields_and_different_seeds_do_not() {
        let range = |seed| beckmann(64, 0.2, 0.2, seed).range();
        assert_eq!(range(5), range(5));
        assert_ne!(range(5), range(6));
    }
}
