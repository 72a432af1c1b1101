//! Whether all light that leaves a triangle in one direction is free: certain, not just likely.
//!
//! Call [`is_free`]. The triangle swept along the direction is a beam; over a place that it
//! crosses, its lowest light has come the shortest way, which is a linear function for each edge of the triangle
//! that faces forward. So where that light clears the corners of another triangle, all of the beam
//! clears all of that triangle: a handful of comparisons instead of many rays. "Not free" may be
//! wrong, "free" is not.

use super::height_field::{HeightField, Side};
use super::vec3::V3;

/// Columns of cells that are looked at before it stays undecided.
const COLUMNS_MAX: i64 = 48;
/// Rounding of heights over the steepest triangles, in units of the heights' spread.
const ROUNDING: f64 = 1e-9;

/// Corners of a cell, in the order of the field's heights.
const CORNERS: [(f64, f64); 4] = [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)];
/// The two triangles of a cell as corners.
const TRIANGLES: [[usize; 3]; 2] = [[0, 1, 3], [0, 3, 2]];
/// Their edges as (n, b): inside is n · x ≤ b.
const EDGES: [[([f64; 2], f64); 3]; 2] = [
    [([0.0, -1.0], 0.0), ([1.0, 0.0], 1.0), ([-1.0, 1.0], 0.0)],
    [([-1.0, 0.0], 0.0), ([0.0, 1.0], 1.0), ([1.0, -1.0], 0.0)],
];

/// A function linear over the cells around the start.
#[derive(Clone, Copy)]
struct Linear {
    at_origin: f64,
    x: f64,
    y: f64,
}

impl Linear {
    #[inline]
    fn at(&self, x: f64, y: f64) -> f64 {
        self.at_origin + self.x * x + self.y * y
    }
}

/// The beam in the frame of its cell, in cells; heights count away from the surface.
struct Beam {
    d: [f64; 2],
    /// Lowest light by each edge that faces forward, and the triangle's own plane.
    lowest: [Linear; 4],
    n_lowest: usize,
    /// Latest times by the edges that face backward: behind them there is no light.
    latest: [Linear; 2],
    n_latest: usize,
    /// Range of x dy − y dx.
    strip: (f64, f64),
}

/// Whether everything that leaves the triangle on a side along `k` is free. `k` must lead away from the
/// triangle and from the surface as a whole.
#[must_use]
pub fn is_free(field: &HeightField, i: usize, j: usize, upper: bool, side: Side, k: &V3) -> bool {
    let sign = side.sign();
    let (cell_x, cell_y) = field.cell_size();
    let (nx, ny) = field.cells();
    let d = [k[0] / cell_x, k[1] / cell_y];
    let slopes = field.slopes(i, j, upper);
    let (sx, sy) = (sign * slopes.0 * cell_x, sign * slopes.1 * cell_y);
    // Clearance over the triangle's own plane that the light gains per unit of time.
    let gain = sign * k[2] - sx * d[0] - sy * d[1];
    if gain <= 0.0 || sign * k[2] <= 0.0 {
        return false;
    }
    let own = field.corner_heights(i, j).map(|h| sign * h);
    let beam = Beam::new(&own, upper, d, sx, sy, gain);
    let (low, high) = field.range();
    let slack = ROUNDING * (high - low);
    let outermost = if sign > 0.0 { high } else { -low };
    let along_x = d[0].abs() >= d[1].abs();
    let (ahead, across) = if along_x { (d[0], d[1]) } else { (d[1], d[0]) };
    if ahead == 0.0 {
        return true;
    }
    let forward = if ahead > 0.0 { 1 } else { -1 };
    // Across at an ahead position a and strip coordinate w: (a across ∓ w)/ahead.
    let turn = if along_x { -1.0 } else { 1.0 };
    for step in 0..COLUMNS_MAX {
        let column = step * forward;
        let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
        for a in [column as f64, column as f64 + 1.0] {
            for w in [beam.strip.0, beam.strip.1] {
                let at = (a * across + turn * w) / ahead;
                from = from.min(at);
                to = to.max(at);
            }
        }
        let mut all_clear = true;
        for row in from.floor() as i64..=to.floor() as i64 {
            let (cx, cy) = if along_x {
                (column, row)
            } else {
                (row, column)
            };
            let (wi, wj) = (
                (i as i64 + cx).rem_euclid(nx as i64) as usize,
                (j as i64 + cy).rem_euclid(ny as i64) as usize,
            );
            let h = field.corner_heights(wi, wj).map(|h| sign * h);
            let skip = (cx == 0 && cy == 0).then_some(usize::from(upper));
            if !beam.clears_cell(&h, cx as f64, cy as f64, skip, slack) {
                return false;
            }
            all_clear &= field.escape(side).clears(wi * ny + wj, k)
                || beam.is_over(outermost, cx as f64, cy as f64);
        }
        if all_clear && step > 0 {
            return true;
        }
    }
    false
}

impl Beam {
    fn new(own: &[f64; 4], upper: bool, d: [f64; 2], sx: f64, sy: f64, gain: f64) -> Self {
        let plane = Linear {
            at_origin: own[0],
            x: sx,
            y: sy,
        };
        let none = Linear {
            at_origin: 0.0,
            x: 0.0,
            y: 0.0,
        };
        let mut beam = Beam {
            d,
            lowest: [plane, none, none, none],
            n_lowest: 1,
            latest: [none; 2],
            n_latest: 0,
            strip: (f64::INFINITY, f64::NEG_INFINITY),
        };
        for (n, b) in EDGES[usize::from(upper)] {
            let rate = n[0] * d[0] + n[1] * d[1];
            if rate == 0.0 {
                continue;
            }
            // The time since a place was left by the edge: (n · x − b)/(n · d).
            let time = Linear {
                at_origin: -b / rate,
                x: n[0] / rate,
                y: n[1] / rate,
            };
            if rate > 0.0 {
                beam.lowest[beam.n_lowest] = Linear {
                    at_origin: plane.at_origin + gain * time.at_origin,
                    x: plane.x + gain * time.x,
                    y: plane.y + gain * time.y,
                };
                beam.n_lowest += 1;
            } else if beam.n_latest < 2 {
                beam.latest[beam.n_latest] = time;
                beam.n_latest += 1;
            }
        }
        for corner in TRIANGLES[usize::from(upper)] {
            let w = beam.across(CORNERS[corner]);
            beam.strip = (beam.strip.0.min(w), beam.strip.1.max(w));
        }
        beam
    }

    #[inline]
    fn across(&self, (x, y): (f64, f64)) -> f64 {
        x * self.d[1] - y * self.d[0]
    }

    /// Whether the beam is over a level everywhere in the cell at (cx, cy) from its own.
    #[inline]
    fn is_over(&self, level: f64, cx: f64, cy: f64) -> bool {
        let corners = CORNERS.map(|(x, y)| (x + cx, y + cy));
        let lowest = &self.lowest[..self.n_lowest];
        lowest
            .iter()
            .any(|l| corners.iter().all(|p| l.at(p.0, p.1) >= level))
    }

    /// Whether the beam passes over a cell at (cx, cy) from its own, whose triangle `skip` is its start.
    fn clears_cell(&self, h: &[f64; 4], cx: f64, cy: f64, skip: Option<usize>, slack: f64) -> bool {
        let places = CORNERS.map(|(x, y)| (x + cx, y + cy));
        let lowest = &self.lowest[..self.n_lowest];
        if lowest.iter().any(|l| {
            places
                .iter()
                .zip(h)
                .all(|(p, height)| l.at(p.0, p.1) + slack >= *height)
        }) {
            return true;
        }
        TRIANGLES.iter().enumerate().all(|(n, corners)| {
            if skip == Some(n) {
                return true;
            }
            let corners = corners.map(|c| [places[c].0, places[c].1, h[c]]);
            let below = |l: &Linear| corners.iter().all(|p| l.at(p[0], p[1]) + slack >= p[2]);
            lowest.iter().any(below) || self.clears_triangle(&corners, slack)
        })
    }

    /// The same for one triangle: its part in the beam is cut out, and the highest of the lowest light by
    /// each edge must be nowhere below it. (A maximum of linear functions is so exactly where some mean of
    /// them is; means of two are tried, and there are hardly ever more than two that matter.)
    fn clears_triangle(&self, corners: &[[f64; 3]; 3], slack: f64) -> bool {
        let mut part = Polygon::of(corners);
        let [dx, dy] = self.d;
        let across = |limit: f64, sign: f64| Linear {
            at_origin: -sign * limit,
            x: sign * dy,
            y: -sign * dx,
        };
        part.keep(&across(self.strip.0, 1.0));
        part.keep(&across(self.strip.1, -1.0));
        for time in &self.latest[..self.n_latest] {
            part.keep(time);
        }
        let part = part.corners();
        let over = |l: &Linear, p: &[f64; 3]| l.at(p[0], p[1]) + slack - p[2];
        let lowest = &self.lowest[..self.n_lowest];
        lowest.iter().enumerate().any(|(n, l)| {
            part.iter().all(|p| over(l, p) >= 0.0)
                || lowest[..n].iter().any(|other| {
                    // The weights w of `l` with w l + (1 − w) other ≥ 0 at every corner.
                    let (mut least, mut most) = (0.0f64, 1.0f64);
                    for p in part {
                        let (x, y) = (over(l, p), over(other, p));
                        let rate = x - y;
                        if rate > 0.0 {
                            least = least.max(-y / rate);
                        } else if rate < 0.0 {
                            most = most.min(-y / rate);
                        } else if y < 0.0 {
                            return false;
                        }
                    }
                    least <= most
                })
        })
    }
}

/// A flat convex polygon in space: a triangle, cut up to four times.
struct Polygon {
    corners: [[f64; 3]; 7],
    count: usize,
}

impl Polygon {
    fn of(triangle: &[[f64; 3]; 3]) -> Self {
        let mut corners = [[0.0; 3]; 7];
        corners[..3].copy_from_slice(triangle);
        Polygon { corners, count: 3 }
    }

    fn corners(&self) -> &[[f64; 3]] {
        &self.corners[..self.count]
    }

    /// Cuts off where the function is negative.
    fn keep(&mut self, function: &Linear) {
        let mut kept = [[0.0; 3]; 7];
        let mut count = 0;
        for (n, p) in self.corners().iter().enumerate() {
            let q = &self.corners[(n + 1) % self.count];
            let (a, b) = (function.at(p[0], p[1]), function.at(q[0], q[1]));
            if a >= 0.0 {
                kept[count] = *p;
                count += 1;
            }
            if (a < 0.0) != (b < 0.0) {
                let t = a / (a - b);
                kept[count] = std::array::from_fn(|i| p[i] + t * (q[i] - p[i]));
                count += 1;
            }
        }
        (self.corners, self.count) = (kept, count);
    }
}

#[cfg(test)]
mod tests {
    use super::super::beckmann::beckmann;
    use super::super::height_field::Flight;
    use super::super::rng::{Purpose, Stream};
    use super::super::vec3::{dot, unit};
    use super::*;

    #[test]
    fn every_ray_of_a_free_beam_is_free_and_hardly_a_free_beam_is_missed() {
        let field = beckmann(64, 0.5, 0.35, 3);
        let mut random = Stream::new(5, Purpose::Photon, 0);
        let (mut found, mut missed, mut blocked) = (0, 0, 0);
        for _ in 0..4000 {
            let (i, j, upper) = (random.below(64), random.below(64), random.bits() & 1 == 0);
            let side = if random.bits() & 1 == 0 {
                Side::Above
            } else {
                Side::Below
            };
            let phi = std::f64::consts::TAU * random.uniform();
            let rise = 0.1 + 0.9 * random.uniform();
            let k = unit(&[phi.cos(), phi.sin(), side.sign() * rise]);
            let (sx, sy) = field.slopes(i, j, upper);
            if side.sign() * dot(&k, &unit(&[-sx, -sy, 1.0])) <= 0.0 {
                continue;
            }
            let says_free = is_free(&field, i, j, upper, side, &k);
            let all_free = (0..40).all(|_| {
                let (a, b) = (random.uniform(), random.uniform());
                let (a, b) = if upper {
                    (a.min(b), a.max(b))
                } else {
                    (a.max(b), a.min(b))
                };
                let spot = field.spot_at(i, j, upper, a, b);
                field.onward(&spot, side, &k) == Flight::Free
            });
            match (says_free, all_free) {
                (true, true) => found += 1,
                (true, false) => panic!("a ray of a free beam hits"),
                (false, true) => missed += 1,
                (false, false) => blocked += 1,
            }
        }
        assert!(found > 500 && blocked > 200, "{found} {blocked}");
        // Forty rays may miss an obstacle at a triangle's rim, so some of these are no misses.
        assert!(missed * 50 < found, "{missed} of {found}");
    }
}
