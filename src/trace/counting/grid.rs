//! Direction bins of both hemispheres: the bin of a direction, and its projected solid angle.
//!
//! Call [`DirectionGrid::bin`] with a direction, or [`BinFinder`] for many. Bins do not know what
//! is counted in them ([`super::tally`]).

use pulp::Simd;

use crate::model::lanes::Lane;
use crate::trace::surfaces::height_field::Side;
use crate::trace::vec3::V3;

/// Arrangement of the directions of a hemisphere in bins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// Rows are equal steps of the polar angle from ±n, columns are equal steps of the azimuth.
    Polar,
    /// Square pixels of the direction cosines: rows along v, columns along u, both from −1 to 1;
    /// the hemisphere seen from above.
    Disc,
}

/// Direction bins of both hemispheres.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DirectionGrid {
    /// Meaning of rows and columns.
    pub layout: Layout,
    /// Rows: over 0 to 90° of polar angle, or along v.
    pub n_theta: usize,
    /// Columns: over 0 to 360° of azimuth, or along u.
    pub n_phi: usize,
    /// Column of light along ±n, which has no azimuth ([`DirectionGrid::straight_at`]).
    pub straight: usize,
}

impl DirectionGrid {
    /// Makes bins of equal steps of polar angle and azimuth.
    #[must_use]
    pub const fn polar(n_theta: usize, n_phi: usize) -> Self {
        DirectionGrid {
            layout: Layout::Polar,
            n_theta,
            n_phi,
            straight: 0,
        }
    }

    /// Counts light along ±n at an azimuth, for example that of the lamp: it is in every plane of
    /// incidence.
    #[must_use]
    pub fn straight_at(self, phi_deg: f64) -> Self {
        let turn = (phi_deg / 360.0).rem_euclid(1.0);
        let straight = match self.layout {
            Layout::Polar => step(turn * self.n_phi as f64) % self.n_phi,
            Layout::Disc => 0,
        };
        DirectionGrid { straight, ..self }
    }

    /// Makes `n` × `n` pixels over the direction cosines.
    #[must_use]
    pub const fn disc(n: usize) -> Self {
        DirectionGrid {
            layout: Layout::Disc,
            n_theta: n,
            n_phi: n,
            straight: 0,
        }
    }

    /// Number of bins of one side.
    #[must_use]
    pub fn per_side(&self) -> usize {
        self.n_theta * self.n_phi
    }

    /// The bin of a direction; bins of the upper side come first. A direction on the edge of two
    /// bins, except for rounding, is in the later one, whatever path the light took. For many
    /// directions use [`DirectionGrid::finder`].
    #[must_use]
    pub fn bin(&self, side: Side, k: &V3) -> usize {
        let (row, column) = match self.layout {
            Layout::Polar => {
                let sin = (k[0] * k[0] + k[1] * k[1]).sqrt();
                let theta = sin.atan2(k[2].abs());
                let turn = k[1].atan2(k[0]) * (0.5 * std::f64::consts::FRAC_1_PI);
                let turn = if turn < 0.0 { turn + 1.0 } else { turn };
                // The azimuth along ±n is only the sign of a zero.
                let column = if sin < STRAIGHT {
                    self.straight
                } else {
                    step(turn * self.n_phi as f64) % self.n_phi
                };
                (
                    step(theta * std::f64::consts::FRAC_2_PI * self.n_theta as f64),
                    column,
                )
            }
            Layout::Disc => (
                step((0.5 * k[1] + 0.5) * self.n_theta as f64),
                step((0.5 * k[0] + 0.5) * self.n_phi as f64),
            ),
        };
        let bin = row.min(self.n_theta - 1) * self.n_phi + column.min(self.n_phi - 1);
        bin + self.first_of(side)
    }

    /// Makes a finder for the bins of many directions.
    #[must_use]
    pub fn finder(&self) -> BinFinder {
        let turns = match self.layout {
            Layout::Polar => Some((
                Steps::of(self.n_theta, 4 * self.n_theta),
                Steps::of(self.n_phi, self.n_phi),
            )),
            Layout::Disc => None,
        };
        BinFinder { grid: *self, turns }
    }

    /// Index of the first bin of a side.
    #[inline(always)]
    fn first_of(&self, side: Side) -> usize {
        match side {
            Side::Above => 0,
            Side::Below => self.per_side(),
        }
    }

    /// Limits (θ_lo, θ_hi, φ_lo, φ_hi) of a bin of one side, degrees. For a pixel of a disc both
    /// limits are its centre.
    #[must_use]
    pub fn limits_deg(&self, bin: usize) -> [f64; 4] {
        let (row, column) = (bin / self.n_phi, bin % self.n_phi);
        match self.layout {
            Layout::Polar => {
                let theta = |r: usize| 90.0 * r as f64 / self.n_theta as f64;
                let phi = |c: usize| 360.0 * c as f64 / self.n_phi as f64;
                [theta(row), theta(row + 1), phi(column), phi(column + 1)]
            }
            Layout::Disc => {
                let (x, y) = self.cosines(row, column);
                let theta = x.hypot(y).min(1.0).asin().to_degrees();
                let phi = y.atan2(x).to_degrees().rem_euclid(360.0);
                [theta, theta, phi, phi]
            }
        }
    }

    /// Direction cosines of a pixel's centre.
    fn cosines(&self, row: usize, column: usize) -> (f64, f64) {
        (
            (2 * column + 1) as f64 / self.n_phi as f64 - 1.0,
            (2 * row + 1) as f64 / self.n_theta as f64 - 1.0,
        )
    }

    /// ∫ cos θ dω over a bin, sr: the divisor that converts a fraction of the light to a BRDF.
    #[must_use]
    pub fn projected_solid_angle(&self, bin: usize) -> f64 {
        match self.layout {
            Layout::Polar => {
                let [lo, hi, _, _] = self.limits_deg(bin);
                let (a, b) = (lo.to_radians().sin(), hi.to_radians().sin());
                0.5 * (b * b - a * a) * std::f64::consts::TAU / self.n_phi as f64
            }
            Layout::Disc => self.area_in_disc(bin / self.n_phi, bin % self.n_phi),
        }
    }

    /// Area of a pixel inside the unit disc, by strips.
    fn area_in_disc(&self, row: usize, column: usize) -> f64 {
        const STRIPS: usize = 64;
        let (x, y) = self.cosines(row, column);
        let (wide, high) = (2.0 / self.n_phi as f64, 2.0 / self.n_theta as f64);
        let (half_x, half_y) = (0.5 * wide, 0.5 * high);
        if (x.abs() + half_x).hypot(y.abs() + half_y) <= 1.0 {
            return wide * high;
        }
        let step = high / STRIPS as f64;
        (0..STRIPS)
            .map(|strip| {
                let y = y - half_y + (strip as f64 + 0.5) * step;
                let reach = (1.0 - y * y).max(0.0).sqrt();
                ((x + half_x).min(reach) - (x - half_x).max(-reach)).max(0.0) * step
            })
            .sum()
    }
}

/// A direction closer than this to ±n has no azimuth.
const STRAIGHT: f64 = 1e-12;
/// A direction closer than this fraction of a bin to an edge is on it; rounding, which differs
/// between paths, is much smaller.
const ON_EDGE: f64 = 1e-9;

/// The step that contains a position counted in steps.
#[inline]
fn step(position: f64) -> usize {
    let nearest = position.round();
    let on_edge = (position - nearest).abs() < ON_EDGE;
    (if on_edge { nearest } else { position }) as usize
}

/// As [`DirectionGrid::bin`], for many directions and without computing angles: it uses a monotonic
/// function of the angle, y/(|x| + |y|) and its equivalents in the other quadrants, and a table of
/// the bins' edges in that function.
#[derive(Debug)]
pub struct BinFinder {
    grid: DirectionGrid,
    /// Rows and columns of a polar grid.
    turns: Option<(Steps, Steps)>,
}

impl BinFinder {
    /// The bin of a direction, equal to [`DirectionGrid::bin`].
    #[inline(always)]
    #[must_use]
    pub fn bin(&self, side: Side, k: &V3) -> usize {
        let Some((rows, columns)) = &self.turns else {
            return self.grid.bin(side, k);
        };
        let sin = (k[0] * k[0] + k[1] * k[1]).sqrt();
        let place = Bearing {
            tilt: sin / (sin + k[2].abs()),
            turn: quarters(k[0], k[1]),
        };
        self.bin_at(rows, columns, side, place)
            .unwrap_or_else(|| self.grid.bin(side, k))
    }

    /// The same for a known [`Bearing`] ([`Bearing::of_each`]).
    #[inline(always)]
    #[must_use]
    pub(in crate::trace) fn bin_of(&self, side: Side, k: &V3, place: Bearing) -> usize {
        let found = match &self.turns {
            Some((rows, columns)) => self.bin_at(rows, columns, side, place),
            None => None,
        };
        found.unwrap_or_else(|| self.grid.bin(side, k))
    }

    #[inline(always)]
    fn bin_at(&self, rows: &Steps, columns: &Steps, side: Side, place: Bearing) -> Option<usize> {
        let (row, column) = (rows.at(place.tilt)?, columns.at(place.turn)?);
        Some(row * self.grid.n_phi + column + self.grid.first_of(side))
    }
}

/// Monotonic functions of a direction's polar angle and azimuth: in quarters of a turn, but not
/// linear.
#[derive(Debug, Clone, Copy)]
pub(in crate::trace) struct Bearing<T = f64> {
    pub(in crate::trace) tilt: T,
    pub(in crate::trace) turn: T,
}

impl<S: Simd> Bearing<Lane<S>> {
    /// The bearings of a register of directions; the bits equal those of single directions.
    #[inline(always)]
    pub(in crate::trace) fn of_each(simd: S, k: &[Lane<S>; 3]) -> Self {
        macro_rules! k {
            ($x:expr) => {
                Lane::splat(simd, $x)
            };
        }
        let [x, y, z] = *k;
        let sin = (x * x + y * y).sqrt();
        let (ax, ay) = (x.abs(), y.abs());
        let (left, behind) = (x.less(k!(0.0)), y.less(k!(0.0)));
        let part = behind.select(left.select(ay, ax), left.select(ax, ay)) / (ax + ay);
        let whole = behind.select(left.select(k!(2.0), k!(3.0)), left.select(k!(1.0), k!(0.0)));
        Bearing {
            tilt: sin / (sin + z.abs()),
            turn: whole + part,
        }
    }
}

/// Number of quarters of a turn from (1, 0) to a point, increasing with the angle; NaN at the
/// origin.
#[inline(always)]
fn quarters(x: f64, y: f64) -> f64 {
    let (ax, ay) = (x.abs(), y.abs());
    let odd = (x < 0.0) != (y < 0.0);
    let part = if odd { ax } else { ay } / (ax + ay);
    let whole = match (y < 0.0, odd) {
        (false, false) => 0.0,
        (false, true) => 1.0,
        (true, false) => 2.0,
        (true, true) => 3.0,
    };
    whole + part
}

/// Equal steps of an angle in [`quarters`].
#[derive(Debug)]
struct Steps {
    /// Start of each step, and the end of the last one.
    edges: Vec<f64>,
    /// The step at the start of each of equal parts.
    first: Vec<u32>,
    parts_per_quarter: f64,
}

/// Closer to an edge than this the angle itself decides: wider than [`ON_EDGE`] on any grid.
const EDGE: f64 = 1e-8;

impl Steps {
    /// Makes `count` steps, `per_turn` of them a full turn.
    fn of(count: usize, per_turn: usize) -> Self {
        let mut edges: Vec<f64> = (0..=count)
            .map(|n| {
                let (whole, rest) = (4 * n / per_turn, 4 * n % per_turn);
                let angle = std::f64::consts::FRAC_PI_2 * rest as f64 / per_turn as f64;
                whole as f64 + quarters(angle.cos(), angle.sin())
            })
            .collect();
        let span = 4.0 * count as f64 / per_turn as f64;
        edges.push(f64::INFINITY);
        // Steps differ by at most a factor of two, so no part contains two edges; the table still
        // fits into the first cache.
        let parts = (4 * count).next_power_of_two();
        let mut step = 0;
        let first = (0..=parts).map(|part| {
            let begin = span * part as f64 / parts as f64;
            while edges[step + 1] <= begin {
                step += 1;
            }
            step.min(count) as u32
        });
        Steps {
            first: first.collect(),
            edges,
            parts_per_quarter: parts as f64 / span,
        }
    }

    /// The step of a number of quarters; `None` if rounding could matter.
    #[inline(always)]
    fn at(&self, quarters: f64) -> Option<usize> {
        let part = (quarters * self.parts_per_quarter) as usize;
        let step = self.first[part.min(self.first.len() - 1)] as usize;
        let step = step + usize::from(self.edges[step + 1] <= quarters);
        let inside = quarters - self.edges[step] > EDGE && self.edges[step + 1] - quarters > EDGE;
        // The last edges have no step.
        (inside && step + 2 < self.edges.len()).then_some(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::vec3::unit;

    const GRID: DirectionGrid = DirectionGrid::polar(45, 180);

    #[test]
    fn bins_tile_the_hemisphere() {
        let total: f64 = (0..GRID.per_side())
            .map(|b| GRID.projected_solid_angle(b))
            .sum();
        assert!((total - std::f64::consts::PI).abs() < 1e-12);
        for (theta, phi) in [(0.5f64, 1.0f64), (31.0, 359.5), (89.9, 180.5)] {
            let (s, c) = theta.to_radians().sin_cos();
            let (sp, cp) = phi.to_radians().sin_cos();
            let bin = GRID.bin(Side::Above, &[s * cp, s * sp, c]);
            let [a, b, d, e] = GRID.limits_deg(bin);
            assert!(a <= theta && theta < b && d <= phi && phi < e);
        }
        assert!(GRID.bin(Side::Below, &[1.0, -1e-300, -0.0]) < 2 * GRID.per_side());
    }

    #[test]
    fn a_finder_gives_the_same_bins_as_the_angles() {
        for grid in [
            GRID,
            DirectionGrid::polar(1, 1),
            DirectionGrid::polar(7, 3),
            DirectionGrid::polar(400, 1001),
        ] {
            let finder = grid.finder();
            let mut short = 0;
            for n in 0..200_000 {
                // Points all around, also at the edges of bins.
                let angle = f64::from(n) * 0.002f64.to_radians() - std::f64::consts::PI;
                let (y, x) = angle.sin_cos();
                let z = f64::from(n % 9001) / 9000.0;
                let r = (1.0 - z * z).sqrt();
                let k = [x * r, y * r, z];
                let (rows, columns) = finder.turns.as_ref().unwrap();
                let found = (rows.at(r / (r + z)), columns.at(quarters(x, y)));
                short += u32::from(found.0.is_some() && found.1.is_some());
                for side in [Side::Above, Side::Below] {
                    assert_eq!(finder.bin(side, &k), grid.bin(side, &k), "{k:?}");
                }
            }
            assert!(short > 190_000, "{short}");
            let straight = [
                [0.0, 0.0, 1.0],
                [-0.0, 0.0, -1.0],
                [-1.0, -0.0, 0.0],
                [1.0, -1e-300, 0.0],
            ];
            for k in straight {
                assert_eq!(
                    finder.bin(Side::Below, &k),
                    grid.bin(Side::Below, &k),
                    "{k:?}"
                );
            }
        }
    }

    #[test]
    fn directions_that_differ_by_rounding_are_in_one_bin_even_at_its_edge() {
        let ulps = |x: f64, n: i32| x + f64::from(n) * x.abs() * f64::EPSILON;
        for grid in [
            GRID,
            DirectionGrid::polar(1, 1),
            DirectionGrid::polar(7, 3),
            DirectionGrid::polar(1440, 1440),
            DirectionGrid::disc(128),
            DirectionGrid::disc(9),
        ] {
            let finder = grid.finder();
            for row in 1..=45 {
                for column in 0..36 {
                    let (s, c) = (f64::from(row) * 2f64.to_radians()).sin_cos();
                    let (sp, cp) = (f64::from(column) * 10f64.to_radians()).sin_cos();
                    let bin = grid.bin(Side::Above, &[s * cp, s * sp, c]);
                    for n in [-4, -1, 1, 4] {
                        let near = [ulps(s * cp, n), ulps(s * sp, -n), ulps(c, n)];
                        assert_eq!(grid.bin(Side::Above, &near), bin, "{grid:?} {row} {column}");
                        assert_eq!(finder.bin(Side::Above, &near), bin, "{grid:?} {near:?}");
                    }
                }
            }
            // Azimuth 0 is 360°, and along n there is none.
            for [a, b] in [
                [[0.6, 1e-17, 0.8], [0.6, -1e-17, 0.8]],
                [[0.0, 0.0, 1.0], [-1e-17, -0.0, 1.0]],
            ] {
                assert_eq!(grid.bin(Side::Above, &a), grid.bin(Side::Above, &b));
                assert_eq!(finder.bin(Side::Above, &b), grid.bin(Side::Above, &b));
            }
        }
    }

    #[test]
    fn pixels_tile_the_disc() {
        let disc = DirectionGrid::disc(128);
        let total: f64 = (0..disc.per_side())
            .map(|b| disc.projected_solid_angle(b))
            .sum();
        // 64 strips per pixel: the error at the rim is of the order of a strip's width squared.
        assert!((total - std::f64::consts::PI).abs() < 1e-5, "{total}");
        let k = unit(&[0.5, -0.7, 0.2]);
        let [theta, _, phi, _] = disc.limits_deg(disc.bin(Side::Above, &k));
        let (s, z) = theta.to_radians().sin_cos();
        let (sp, cp) = phi.to_radians().sin_cos();
        assert!((s * cp - k[0]).abs() < 1.0 / 128.0 && (s * sp - k[1]).abs() < 1.0 / 128.0);
        assert!(z > 0.0);
        assert!(disc.bin(Side::Below, &[1.0, 0.0, -0.0]) < 2 * disc.per_side());
    }
}
