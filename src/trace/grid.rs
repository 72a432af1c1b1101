//! Direction bins of both hemispheres: which one a ray falls into, and how much light it could hold.
//!
//! Call [`Grid::bin`] with a direction of exit. Bins know nothing of what is counted in them ([`super::tally`]).

use super::height_field::Side;
use super::vec3::V3;

/// How the directions of a hemisphere fall into bins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// Rows are equal steps of the polar angle from ±n, columns of the azimuth.
    Polar,
    /// Square pixels of the direction cosines: rows along v, columns along u, both from −1 to 1; the
    /// hemisphere seen from above.
    Disc,
}

/// Direction bins of both hemispheres.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Grid {
    /// What rows and columns are.
    pub layout: Layout,
    /// Rows: over 0 to 90° of polar angle, or along v.
    pub n_theta: usize,
    /// Columns: over 0 to 360° of azimuth, or along u.
    pub n_phi: usize,
}

impl Grid {
    /// Steps of polar angle and azimuth.
    #[must_use]
    pub const fn polar(n_theta: usize, n_phi: usize) -> Self {
        Grid {
            layout: Layout::Polar,
            n_theta,
            n_phi,
        }
    }

    /// `n` × `n` pixels over the direction cosines.
    #[must_use]
    pub const fn disc(n: usize) -> Self {
        Grid {
            layout: Layout::Disc,
            n_theta: n,
            n_phi: n,
        }
    }

    /// Bins of one side.
    #[must_use]
    pub fn per_side(&self) -> usize {
        self.n_theta * self.n_phi
    }

    /// The bin of a direction of exit; those of the upper side come first.
    #[inline]
    #[must_use]
    pub fn bin(&self, side: Side, k: &V3) -> usize {
        let (row, column) = match self.layout {
            Layout::Polar => {
                let sin = (k[0] * k[0] + k[1] * k[1]).sqrt();
                let row = |theta: f64| theta * std::f64::consts::FRAC_2_PI * self.n_theta as f64;
                let column = |phi: f64| {
                    let turn = phi * (0.5 * std::f64::consts::FRAC_1_PI);
                    let turn = if turn < 0.0 { turn + 1.0 } else { turn };
                    turn * self.n_phi as f64
                };
                (
                    inside(row(atan2_nearly(sin, k[2].abs())))
                        .unwrap_or_else(|| row(sin.atan2(k[2].abs())) as usize),
                    inside(column(atan2_nearly(k[1], k[0])))
                        .unwrap_or_else(|| column(k[1].atan2(k[0])) as usize),
                )
            }
            Layout::Disc => (
                ((0.5 * k[1] + 0.5) * self.n_theta as f64) as usize,
                ((0.5 * k[0] + 0.5) * self.n_phi as f64) as usize,
            ),
        };
        let bin = row.min(self.n_theta - 1) * self.n_phi + column.min(self.n_phi - 1);
        match side {
            Side::Above => bin,
            Side::Below => bin + self.per_side(),
        }
    }

    /// Limits (θ_lo, θ_hi, φ_lo, φ_hi) of a bin of one side, degrees. A pixel of a disc has none: its
    /// centre's angles stand for both limits.
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

    /// ∫ cos θ dω over a bin, sr: what a share of the light is divided by to be a BRDF.
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

/// A number rounded down, where it is so far from whole numbers that an error of [`atan2_nearly`] cannot have
/// moved it over one.
#[inline(always)]
fn inside(x: f64) -> Option<usize> {
    // 2e-8 rad of 1440 bins and more to a right angle are 2e-5 bins.
    const EDGE: f64 = 1e-3;
    let whole = x as usize;
    let rest = x - whole as f64;
    (EDGE < rest && rest < 1.0 - EDGE).then_some(whole)
}

/// The angle of a point (x, y), rad in (−π, π], to 2e-8: a third of the time of the right one.
#[inline(always)]
fn atan2_nearly(y: f64, x: f64) -> f64 {
    // Chebyshev fit of atan(q)/q in q² over [0, 1].
    const P: [f64; 9] = [
        0.999_999_984_2,
        -0.333_330_667_8,
        0.199_924_835_8,
        -0.142_025_705_1,
        0.106_367_541,
        -0.074_954_454_4,
        0.042_587_607_5,
        -0.016_005_030_5,
        0.002_834_064_3,
    ];
    let (ax, ay) = (x.abs(), y.abs());
    let steep = ay > ax;
    let (small, large) = if steep { (ax, ay) } else { (ay, ax) };
    // Where both are nothing it is not a number, which is inside no bin.
    let q = small / large;
    let s = q * q;
    let (s2, s4) = (s * s, (s * s) * (s * s));
    let low = (P[0] + P[1] * s) + s2 * (P[2] + P[3] * s);
    let high = (P[4] + P[5] * s) + s2 * (P[6] + P[7] * s) + s4 * P[8];
    let angle = q * (low + s4 * high);
    let angle = if steep {
        std::f64::consts::FRAC_PI_2 - angle
    } else {
        angle
    };
    let angle = if x < 0.0 {
        std::f64::consts::PI - angle
    } else {
        angle
    };
    if y < 0.0 { -angle } else { angle }
}

#[cfg(test)]
mod tests {
    use super::super::vec3::unit;
    use super::*;

    const GRID: Grid = Grid::polar(45, 180);

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
    fn the_short_way_to_a_bin_is_the_long_one() {
        let mut worst = 0.0f64;
        for n in 0..200_000 {
            // Points all around, at the edges of bins too.
            let angle = f64::from(n) * 0.002f64.to_radians() - std::f64::consts::PI;
            let (y, x) = angle.sin_cos();
            worst = worst.max((atan2_nearly(y, x) - y.atan2(x)).abs());
            let z = f64::from(n % 9001) / 9000.0;
            let r = (1.0 - z * z).sqrt();
            let k = [x * r, y * r, z];
            let theta = (k[0] * k[0] + k[1] * k[1]).sqrt().atan2(z);
            let turn = k[1].atan2(k[0]) * (0.5 * std::f64::consts::FRAC_1_PI);
            let turn = if turn < 0.0 { turn + 1.0 } else { turn };
            let row = (theta * std::f64::consts::FRAC_2_PI * 45.0) as usize;
            let bin = row.min(44) * 180 + ((turn * 180.0) as usize).min(179);
            assert_eq!(GRID.bin(Side::Above, &k), bin, "{k:?}");
        }
        assert!(worst < 2e-8, "{worst}");
        for k in [[0.0, 0.0, 1.0], [-0.0, 0.0, -1.0], [-1.0, -0.0, 0.0]] {
            assert!(GRID.bin(Side::Below, &k) < 2 * GRID.per_side());
        }
    }

    #[test]
    fn pixels_tile_the_disc() {
        let disc = Grid::disc(128);
        let total: f64 = (0..disc.per_side())
            .map(|b| disc.projected_solid_angle(b))
            .sum();
        // 64 strips per pixel: the rim's error is of the order of a strip's width squared.
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
