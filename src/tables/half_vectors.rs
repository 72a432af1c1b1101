//! A density of half vectors on the unit square, and the map from uniform numbers to half vectors that it defines.
//!
//! The square has x = √(2 θ/π) and y = (φ + π)/(2π) of the half vector. A density is given at the nodes of a grid and is bilinear
//! between them. The map first selects y by the integral over all x, then x in that row; both are exact for the bilinear
//! density.

use std::f64::consts::PI;

use nalgebra::Vector3;

/// Returns the angle from the normal at x.
pub(super) fn zenith(x: f64) -> f64 {
    x * x * (PI / 2.0)
}

/// Returns x at an angle from the normal.
pub(super) fn of_zenith(theta: f64) -> f64 {
    (theta * (2.0 / PI)).sqrt()
}

/// Returns the half vector at a place of the square.
pub(super) fn vector([x, y]: [f64; 2]) -> Vector3<f64> {
    let (sin, cos) = zenith(x).sin_cos();
    let (sin_phi, cos_phi) = ((2.0 * y - 1.0) * PI).sin_cos();
    Vector3::new(sin * cos_phi, sin * sin_phi, cos)
}

/// Returns the solid angle per area of the square.
pub(super) fn solid_angle(x: f64) -> f64 {
    2.0 * PI * PI * x * zenith(x).sin()
}

/// Values at the nodes of a grid over the square, bilinear between them.
#[derive(Debug, Clone)]
pub(super) struct Grid {
    /// Nodes along x and y.
    pub size: [usize; 2],
    /// Row by row, x fastest.
    pub values: Vec<f64>,
}

impl Grid {
    /// Evaluates a function at every node.
    pub fn new(size: [usize; 2], of: impl Fn([f64; 2]) -> f64) -> Self {
        let at = |k: usize, n: usize| k as f64 / (n - 1) as f64;
        let nodes = (0..size[1]).flat_map(|row| (0..size[0]).map(move |column| (column, row)));
        let values = nodes
            .map(|(column, row)| of([at(column, size[0]), at(row, size[1])]))
            .collect();
        Grid { size, values }
    }

    /// Returns the value at a place.
    pub fn at(&self, place: [f64; 2]) -> f64 {
        let [(column, x), (row, y)] = [0, 1].map(|axis| {
            let cells = self.size[axis] - 1;
            let scaled = place[axis].clamp(0.0, 1.0) * cells as f64;
            let cell = (scaled as usize).min(cells - 1);
            (cell, scaled - cell as f64)
        });
        let value = |row: usize| {
            let k = row * self.size[0] + column;
            lerp(self.values[k], self.values[k + 1], x)
        };
        lerp(value(row), value(row + 1), y)
    }

    /// Returns the values in single precision.
    pub fn single(&self) -> Vec<f32> {
        self.values.iter().map(|x| *x as f32).collect()
    }
}

fn lerp(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}

/// A positive density over the square with the map that it defines.
#[derive(Debug, Clone)]
pub(super) struct Warp {
    /// The density; its integral is 1.
    pub density: Grid,
    /// Integral over x of each row.
    rows: Vec<f64>,
    /// Integral over y up to each row; the last one is 1.
    up_to: Vec<f64>,
}

impl Warp {
    /// Makes the map; every value of `density` is positive.
    pub fn new(mut density: Grid) -> Self {
        let [columns, n_rows] = density.size;
        let width = 1.0 / (columns - 1) as f64;
        let height = 1.0 / (n_rows - 1) as f64;
        let trapezia = |values: &[f64]| -> f64 {
            values
                .windows(2)
                .map(|pair| 0.5 * (pair[0] + pair[1]))
                .sum()
        };
        let mut rows: Vec<f64> = density
            .values
            .chunks(columns)
            .map(|row| width * trapezia(row))
            .collect();
        let total = height * trapezia(&rows);
        density.values.iter_mut().for_each(|x| *x /= total);
        rows.iter_mut().for_each(|x| *x /= total);
        let mut up_to = vec![0.0; n_rows];
        for row in 1..n_rows {
            up_to[row] = up_to[row - 1] + 0.5 * height * (rows[row - 1] + rows[row]);
        }
        Warp {
            density,
            rows,
            up_to,
        }
    }

    /// Returns the place of two uniform numbers.
    pub fn place(&self, uniform: [f64; 2]) -> [f64; 2] {
        let [columns, n_rows] = self.density.size;
        let row = self.up_to[1..n_rows - 1].partition_point(|p| *p < uniform[1]);
        let rest = (uniform[1] - self.up_to[row]) * (n_rows - 1) as f64;
        let y = within(rest, self.rows[row], self.rows[row + 1]);
        let value = |column: usize| {
            let k = row * columns + column;
            lerp(self.density.values[k], self.density.values[k + columns], y)
        };
        let cells = (columns - 1) as f64;
        let mut rest = uniform[0] * lerp(self.rows[row], self.rows[row + 1], y) * cells;
        let mut column = 0;
        while column + 2 < columns {
            let cell = 0.5 * (value(column) + value(column + 1));
            if cell >= rest {
                break;
            }
            rest -= cell;
            column += 1;
        }
        let x = within(rest, value(column), value(column + 1));
        [
            (column as f64 + x) / cells,
            (row as f64 + y) / (n_rows - 1) as f64,
        ]
    }
}

/// Returns t in 0 to 1 with ∫₀ᵗ of the line from `a` to `b` equal to `area`.
fn within(area: f64, a: f64, b: f64) -> f64 {
    let root = (a * a + 2.0 * (b - a) * area.max(0.0)).max(0.0).sqrt();
    (2.0 * area.max(0.0) / (a + root)).min(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_uniform_numbers_lie_below_a_place_as_the_density_has_there() {
        let density = Grid::new([5, 4], |[x, y]| 0.1 + x * x + 3.0 * (y - 0.4).abs());
        let warp = Warp::new(density);
        let n = 400;
        for u in [[0.13, 0.71], [0.5, 0.05], [0.97, 0.5], [0.999, 0.999]] {
            let place = warp.place(u);
            // Midpoint sums of the density below y, and left of x in that row.
            let (mut below, mut left, mut all) = (0.0, 0.0, 0.0);
            for k in 0..n {
                let t = (f64::from(k) + 0.5) / f64::from(n);
                for m in 0..n {
                    let s = (f64::from(m) + 0.5) / f64::from(n);
                    below += warp.density.at([s, t * place[1]]) * place[1];
                }
                left += warp.density.at([t * place[0], place[1]]) * place[0];
                all += warp.density.at([t, place[1]]);
            }
            assert!((below / f64::from(n * n) - u[1]).abs() < 1e-3, "{u:?}");
            assert!((left / all - u[0]).abs() < 1e-3, "{u:?} {}", left / all);
        }
    }

    #[test]
    fn the_square_covers_the_hemisphere_of_half_vectors() {
        let n = 2000;
        let sum: f64 = (0..n)
            .map(|k| solid_angle((f64::from(k) + 0.5) / f64::from(n)) / f64::from(n))
            .sum();
        assert!((sum / (2.0 * PI) - 1.0).abs() < 1e-5, "{sum}");
        let up = vector([of_zenith(0.3), 0.75]);
        assert!((up - Vector3::new(0.0, 0.3f64.sin(), 0.3f64.cos())).norm() < 1e-12);
    }
}
