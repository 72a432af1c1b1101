//! A periodic height field of flat triangles, and rays on it.
//!
//! Call [`HeightField::enter`] for a ray from far away and [`HeightField::onward`] for one that
//! starts on the surface. The two triangles of a cell share the diagonal from (i, j) to (i+1, j+1).
//! The tile repeats without end, and its rim is not special.
//!
//! A ray is followed from cell to cell by its clearance: the height above the surface (or below it,
//! for light inside), which is linear along the ray within a triangle. The clearance at a shared
//! edge is computed once and carried over, so no ray passes between two triangles, and a ray that
//! starts on a triangle cannot hit it again: there is no epsilon anywhere. A ray steeper than the
//! horizon in its direction ([`crate::trace::visibility::horizon_slopes`]) is known to be free.
//!
//! *Conditioning.* Heights are rounded to f32 once; after that, corners are exact numbers.
//! Positions along a ray are start + d t − offset, so they lose t·1e-16 cells: after the million
//! cells at which a ray is given up, 1e-10 of a cell. A hit is where the clearance, linear between
//! two sides of a cell, passes through 0: t_in + Δt c_in/(c_in − c_out) with c_out < 0 ≤ c_in has a
//! sum of two positive numbers in the denominator, never a difference. Walls are as steep as a cell
//! is narrow (slopes to 1e6 and more occur); the vertical part of a normal is then small but keeps
//! its digits, as 1/√(1 + s²).

mod windows;

use pulp::Arch;
use rayon::prelude::*;

use crate::trace::vec3::{V3, unit};
use crate::trace::visibility::horizon_slopes::{HorizonSlopes, greater, lesser};

/// The side of an interface on which light is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// On the side of +n.
    Above,
    /// On the side of −n.
    Below,
}

impl Side {
    /// +1 above, −1 below.
    #[inline]
    #[must_use]
    pub const fn sign(self) -> f64 {
        match self {
            Side::Above => 1.0,
            Side::Below => -1.0,
        }
    }

    /// The other side.
    #[inline]
    #[must_use]
    pub const fn across(self) -> Side {
        match self {
            Side::Above => Side::Below,
            Side::Below => Side::Above,
        }
    }
}

/// A point on a triangle of a field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldSpot {
    /// Cell along x.
    pub i: usize,
    /// Cell along y.
    pub j: usize,
    /// The triangle at (0, 1) of the cell instead of the one at (1, 0).
    pub upper: bool,
    /// Position along x as a fraction of the cell, 0 to 1.
    pub x: f64,
    /// Position along y as a fraction of the cell, 0 to 1.
    pub y: f64,
    /// Height, in the field's unit of length.
    pub z: f64,
}

/// The end of a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Flight {
    /// On the surface.
    Hit(FieldSpot),
    /// The ray leaves the surface.
    Free,
    /// Undecided within [`CELLS_MAX`] cells: an almost horizontal ray.
    Lost,
}

/// Cells along each side of the windows of [`HeightField::outermost_around`].
pub const WINDOW: i64 = 4;

/// Number of crossed cells after which a ray is given up (and counted as truncated).
pub const CELLS_MAX: usize = 1_000_000;

/// Heights at the corners of `nx` × `ny` cells, periodic.
#[derive(Debug, Clone)]
pub struct HeightField {
    nx: usize,
    ny: usize,
    cell_x: f64,
    cell_y: f64,
    /// h00, h10, h01, h11 of each cell; the first index is along x. Rounded to f32 here.
    corners: Vec<[f32; 4]>,
    /// The highest and the lowest corner of the [`WINDOW`] × [`WINDOW`] cells from each cell on.
    high_around: Vec<f32>,
    low_around: Vec<f32>,
    /// The machine's instruction set.
    arch: Arch,
    lowest: f64,
    highest: f64,
    above: HorizonSlopes,
    below: HorizonSlopes,
}

impl HeightField {
    /// Makes a field from `nx` × `ny` heights (index i·ny + j, i along x) on cells of `cell_x` ×
    /// `cell_y`, all in one unit of length. Needs at least one cell, finite heights and positive
    /// cell sizes.
    #[must_use]
    pub fn new(nx: usize, ny: usize, cell_x: f64, cell_y: f64, heights: &[f64]) -> Self {
        assert!(
            nx > 0 && ny > 0 && heights.len() == nx * ny,
            "nx × ny heights"
        );
        #[expect(clippy::cast_possible_truncation, reason = "f32 is the storage")]
        let rounded: Vec<f32> = heights.iter().map(|&h| h as f32).collect();
        let mut corners = Vec::with_capacity(nx * ny);
        for i in 0..nx {
            let next = if i + 1 == nx { 0 } else { i + 1 };
            for j in 0..ny {
                let right = if j + 1 == ny { 0 } else { j + 1 };
                corners.push([
                    rounded[i * ny + j],
                    rounded[next * ny + j],
                    rounded[i * ny + right],
                    rounded[next * ny + right],
                ]);
            }
        }
        let lowest = f64::from(rounded.iter().copied().fold(f32::INFINITY, lesser));
        let highest = f64::from(rounded.iter().copied().fold(f32::NEG_INFINITY, greater));
        let high: Vec<f32> = corners
            .iter()
            .map(|h| greater(greater(h[0], h[1]), greater(h[2], h[3])))
            .collect();
        let low: Vec<f32> = corners
            .iter()
            .map(|h| lesser(lesser(h[0], h[1]), lesser(h[2], h[3])))
            .collect();
        let arch = Arch::new();
        let ((above, below), (high_around, low_around)) = rayon::join(
            || {
                HorizonSlopes::of_both_sides(
                    arch,
                    (nx, ny),
                    (cell_x, cell_y),
                    &corners,
                    &high,
                    &low,
                )
            },
            || {
                rayon::join(
                    || windows::over_windows(nx, ny, &high, greater),
                    || windows::over_windows(nx, ny, &low, lesser),
                )
            },
        );
        HeightField {
            nx,
            ny,
            cell_x,
            cell_y,
            corners,
            high_around,
            low_around,
            arch,
            lowest,
            highest,
            above,
            below,
        }
    }

    /// Cells along x and y.
    #[must_use]
    pub fn cells(&self) -> (usize, usize) {
        (self.nx, self.ny)
    }

    /// Cell sizes along x and y.
    #[must_use]
    pub fn cell_size(&self) -> (f64, f64) {
        (self.cell_x, self.cell_y)
    }

    /// Lowest and highest point.
    #[must_use]
    pub fn range(&self) -> (f64, f64) {
        (self.lowest, self.highest)
    }

    /// Heights of a cell's corners at (0, 0), (1, 0), (0, 1), (1, 1).
    #[inline]
    #[must_use]
    pub fn corner_heights(&self, i: usize, j: usize) -> [f64; 4] {
        self.corners[i * self.ny + j].map(f64::from)
    }

    /// Slopes ∂h/∂x, ∂h/∂y of a triangle.
    #[inline]
    #[must_use]
    pub fn slopes(&self, i: usize, j: usize, upper: bool) -> (f64, f64) {
        let [h00, h10, h01, h11] = self.corners[i * self.ny + j].map(f64::from);
        if upper {
            ((h11 - h01) / self.cell_x, (h01 - h00) / self.cell_y)
        } else {
            ((h10 - h00) / self.cell_x, (h11 - h10) / self.cell_y)
        }
    }

    /// The machine's instruction set.
    #[inline]
    #[must_use]
    pub(in crate::trace) fn arch(&self) -> Arch {
        self.arch
    }

    /// Unit normal of a spot's triangle, upwards.
    #[inline]
    #[must_use]
    pub fn normal(&self, spot: &FieldSpot) -> V3 {
        let (sx, sy) = self.slopes(spot.i, spot.j, spot.upper);
        unit(&[-sx, -sy, 1.0])
    }

    /// Effective ridge angle, rad: the area-weighted median inclination, towards +y about the x
    /// axis, of the triangles whose normal leans to +y, to a thousandth of a degree; `None` if none
    /// leans, or if the median is below that resolution.
    #[must_use]
    pub fn effective_ridge_angle(&self) -> Option<f64> {
        const PER_DEGREE: f64 = 1000.0;
        const COUNT: usize = 90 * PER_DEGREE as usize + 1;
        // A fixed number of parts, so that the sum is the same on any number of threads.
        const PARTS: usize = 4;
        let parts: Vec<Vec<f64>> = (0..PARTS)
            .into_par_iter()
            .map(|part| {
                let mut areas = vec![0.0; COUNT];
                for i in part * self.nx / PARTS..(part + 1) * self.nx / PARTS {
                    for (j, upper) in (0..self.ny).flat_map(|j| [(j, false), (j, true)]) {
                        let (sx, sy) = self.slopes(i, j, upper);
                        if sy < 0.0 {
                            let at = (-sy).atan().to_degrees() * PER_DEGREE;
                            areas[at as usize] += (1.0 + sx * sx + sy * sy).sqrt();
                        }
                    }
                }
                areas
            })
            .collect();
        let areas: Vec<f64> = (0..COUNT)
            .map(|n| parts.iter().map(|p| p[n]).sum())
            .collect();
        let half = 0.5 * areas.iter().sum::<f64>();
        let mut below = 0.0;
        for (n, area) in areas.iter().enumerate() {
            if *area > 0.0 && below + area >= half {
                let within = n as f64 + (half - below) / area;
                return (n > 0).then(|| (within / PER_DEGREE).to_radians());
            }
            below += area;
        }
        None
    }

    /// The outermost point on a side of the [`WINDOW`] × [`WINDOW`] cells from (i, j) on, counted
    /// away from the surface (for the lower side, of the negated heights).
    #[inline]
    #[must_use]
    pub fn outermost_around(&self, side: Side, i: usize, j: usize) -> f64 {
        let cell = i * self.ny + j;
        match side {
            Side::Above => f64::from(self.high_around[cell]),
            Side::Below => -f64::from(self.low_around[cell]),
        }
    }

    /// The horizon slopes of one side.
    #[inline]
    #[must_use]
    pub fn horizon(&self, side: Side) -> &HorizonSlopes {
        match side {
            Side::Above => &self.above,
            Side::Below => &self.below,
        }
    }

    /// A ray from far away on one side, along `k` towards the surface, that crosses the level of
    /// the outermost point at the fractions `x`, `y` (0 to 1) of the tile. The number of crossed
    /// cells is added to `crossed`.
    #[must_use]
    pub fn enter(&self, side: Side, k: &V3, x: f64, y: f64, crossed: &mut u64) -> Flight {
        let (px, py) = (x * self.nx as f64, y * self.ny as f64);
        let i = (px as usize).min(self.nx - 1);
        let j = (py as usize).min(self.ny - 1);
        let z = match side {
            Side::Above => self.highest,
            Side::Below => self.lowest,
        };
        let spot = FieldSpot {
            i,
            j,
            upper: false,
            x: px - i as f64,
            y: py - j as f64,
            z,
        };
        self.march(&spot, false, side.sign(), k, crossed)
    }

    /// A ray that leaves a spot of the surface on one side, along `k`. The number of crossed cells
    /// is added to `crossed`.
    #[inline]
    #[must_use]
    pub fn onward(&self, spot: &FieldSpot, side: Side, k: &V3, crossed: &mut u64) -> Flight {
        if side.sign() * k[2] > 0.0
            && self
                .horizon(side)
                .towards(k)
                .clears(spot.i * self.ny + spot.j, side.sign() * spot.z)
        {
            return Flight::Free;
        }
        self.march(spot, true, side.sign(), k, crossed)
    }

    /// Height of a triangle's plane at a position in its cell.
    #[inline]
    fn plane(h: &[f64; 4], upper: bool, x: f64, y: f64) -> f64 {
        let [h00, h10, h01, h11] = *h;
        if upper {
            h00 + y * (h01 - h00) + x * (h11 - h01)
        } else {
            h00 + x * (h10 - h00) + y * (h11 - h10)
        }
    }

    fn march(
        &self,
        start: &FieldSpot,
        on_surface: bool,
        sign: f64,
        k: &V3,
        crossed: &mut u64,
    ) -> Flight {
        let (dx, dy) = (k[0] / self.cell_x, k[1] / self.cell_y);
        // Heights count away from the surface, on the side of the light.
        let (start_z, dz) = (sign * start.z, sign * k[2]);
        let leaving = dz > 0.0;
        let slopes = if sign > 0.0 { &self.above } else { &self.below };
        let slopes = slopes.towards(k);
        let (mut i, mut j) = (start.i, start.j);
        // Position in the current cell = start + d t − offset.
        let (mut x0, mut y0) = (start.x, start.y);
        let first_crossing = |p: f64, d: f64| {
            if d > 0.0 {
                (1.0 - p) / d
            } else if d < 0.0 {
                -p / d
            } else {
                f64::INFINITY
            }
        };
        let (mut tx, mut ty) = (first_crossing(x0, dx), first_crossing(y0, dy));
        if tx.min(ty) == f64::INFINITY {
            // A vertical ray is decided in this cell.
            return self.vertical(start, on_surface, leaving);
        }
        let (step_x, step_y) = (1.0 / dx.abs(), 1.0 / dy.abs());
        let (shift_x, shift_y) = (
            if dx > 0.0 { -1.0 } else { 1.0 },
            if dy > 0.0 { -1.0 } else { 1.0 },
        );
        // A step back over the rim wraps to the largest number.
        let (step_i, step_j) = (
            if dx > 0.0 { 1 } else { usize::MAX },
            if dy > 0.0 { 1 } else { usize::MAX },
        );
        let mut t_in = 0.0;
        let mut z_in = start_z;
        let mut first = on_surface;
        // Clearance at t_in; unknown after cells that the ray cleared as a whole.
        let mut known = on_surface.then_some(0.0);
        let mut cell = i * self.ny + j;
        for n in 1..=CELLS_MAX as u64 {
            // The nearer side, selected without a branch, which could not be predicted.
            let along_x = tx <= ty;
            let t_out = if along_x { tx } else { ty };
            let z_out = start_z + dz * t_out;
            let nearest = if leaving { z_in } else { z_out };
            if first || nearest <= slopes.outermost(cell) {
                let h = self.corners[cell].map(|h| sign * f64::from(h));
                let (x_in, y_in) = (x0 + dx * t_in, y0 + dy * t_in);
                let (x_out, y_out) = (x0 + dx * t_out, y0 + dy * t_out);
                let (mut u_in, u_out) = (x_in - y_in, x_out - y_out);
                if first {
                    u_in = if start.upper {
                        u_in.min(0.0)
                    } else {
                        u_in.max(0.0)
                    };
                }
                let upper = if first {
                    start.upper
                } else {
                    u_in < 0.0 || (u_in == 0.0 && u_out < 0.0)
                };
                let mut c_in = known
                    .unwrap_or_else(|| z_in - Self::plane(&h, upper, x_in, y_in))
                    .max(0.0);
                let mut seen_from = t_in;
                let crosses = if upper { u_out > 0.0 } else { u_out < 0.0 };
                if crosses {
                    let t_mid = t_in + (t_out - t_in) * (u_in / (u_in - u_out));
                    let at = 0.5 * ((x0 + dx * t_mid) + (y0 + dy * t_mid));
                    let c_mid = start_z + dz * t_mid - (h[0] + at * (h[3] - h[0]));
                    if c_mid < 0.0 && !first {
                        let t = t_in + (t_mid - t_in) * (c_in / (c_in - c_mid));
                        *crossed += n;
                        return Flight::Hit(self.spot_at(i, j, upper, x0 + dx * t, y0 + dy * t));
                    }
                    c_in = c_mid.max(0.0);
                    seen_from = t_mid;
                    first = false;
                }
                let upper = upper != crosses;
                let c_out = z_out - Self::plane(&h, upper, x_out, y_out);
                if c_out < 0.0 && !first {
                    let t = seen_from + (t_out - seen_from) * (c_in / (c_in - c_out));
                    *crossed += n;
                    return Flight::Hit(self.spot_at(i, j, upper, x0 + dx * t, y0 + dy * t));
                }
                known = Some(c_out.max(0.0));
                first = false;
            } else {
                known = None;
            }
            (t_in, z_in) = (t_out, z_out);
            let across = !along_x;
            tx += if along_x { step_x } else { 0.0 };
            ty += if across { step_y } else { 0.0 };
            x0 += if along_x { shift_x } else { 0.0 };
            y0 += if across { shift_y } else { 0.0 };
            i = i.wrapping_add(if along_x { step_i } else { 0 });
            j = j.wrapping_add(if across { step_j } else { 0 });
            if i >= self.nx {
                i = if step_i == 1 { 0 } else { self.nx - 1 };
            }
            if j >= self.ny {
                j = if step_j == 1 { 0 } else { self.ny - 1 };
            }
            cell = i * self.ny + j;
            if leaving && slopes.clears(cell, z_in) {
                *crossed += n;
                return Flight::Free;
            }
        }
        *crossed += CELLS_MAX as u64;
        Flight::Lost
    }

    /// A ray along ±n.
    fn vertical(&self, start: &FieldSpot, on_surface: bool, leaving: bool) -> Flight {
        if leaving || on_surface {
            return Flight::Free;
        }
        let upper = start.y > start.x;
        Flight::Hit(self.spot_at(start.i, start.j, upper, start.x, start.y))
    }

    /// Makes a spot from a position on a triangle.
    #[inline]
    #[must_use]
    pub fn spot_at(&self, i: usize, j: usize, upper: bool, x: f64, y: f64) -> FieldSpot {
        let h = self.corners[i * self.ny + j].map(f64::from);
        let (x, y) = (x.clamp(0.0, 1.0), y.clamp(0.0, 1.0));
        FieldSpot {
            i,
            j,
            upper,
            x,
            y,
            z: Self::plane(&h, upper, x, y),
        }
    }
}

#[cfg(test)]
#[path = "height_field_tests.rs"]
mod tests;
