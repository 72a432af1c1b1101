//! Whether all light that leaves a triangle in one direction is free: certain, not just likely.
//!
//! Call [`is_free`]. The triangle swept along the direction is a beam; over a place that it
//! crosses, its lowest light has come the shortest way, which is a linear function for each edge of the triangle
//! that faces forward. So where that light clears the corners of another triangle, all of the beam
//! clears all of that triangle: a handful of comparisons instead of many rays. "Not free" may be
//! wrong, "free" is not.
//!
//! *Conditioning.* Times are quotients by the rate at which the beam leaves an edge; an edge along the beam has rate 0 and is
//! left out, one nearly along it gives times so long that it bounds nothing. Heights come from single precision and are
//! compared in double with a slack of 1e-9 of the field's relief: a beam that touches may be called free by that
//! much, which is a share of 1e-9 of its light.

use super::height_field::{HeightField, Side, WINDOW};
use super::vec3::V3;

/// Columns of cells that are looked at before it stays undecided.
const COLUMNS_MAX: i64 = 96;
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
    #[inline(always)]
    fn at(&self, x: f64, y: f64) -> f64 {
        self.at_origin + self.x * x + self.y * y
    }
}

/// Four such functions side by side, for vector instructions.
#[derive(Clone, Copy)]
struct Four {
    at_origin: [f64; 4],
    x: [f64; 4],
    y: [f64; 4],
}

impl Four {
    #[inline(always)]
    fn at(&self, x: f64, y: f64) -> [f64; 4] {
        std::array::from_fn(|n| self.at_origin[n] + self.x[n] * x + self.y[n] * y)
    }
}

#[inline(always)]
fn greatest(x: &[f64; 4]) -> f64 {
    greater(greater(x[0], x[1]), greater(x[2], x[3]))
}

/// The beam in the frame of its cell, in cells; heights count away from the surface.
struct Beam {
    d: [f64; 2],
    /// Lowest light by each edge that faces forward, and the triangle's own plane.
    lowest: [Linear; 4],
    n_lowest: usize,
    side_by_side: Four,
    /// Latest times by the edges that face backward: behind them there is no light.
    latest: [Linear; 2],
    n_latest: usize,
    /// Range of x dy − y dx.
    strip: (f64, f64),
}

/// `index` + `shift` on a tile of `n`.
#[inline(always)]
fn wrapped(index: usize, shift: i64, n: usize) -> usize {
    let at = index as i64 + shift;
    if (0..n as i64).contains(&at) {
        at as usize
    } else {
        at.rem_euclid(n as i64) as usize
    }
}

/// Whether everything that leaves the triangle on a side along `k` is free. `k` must lead away from the
/// triangle and from the surface as a whole.
#[must_use]
pub fn is_free(field: &HeightField, i: usize, j: usize, upper: bool, side: Side, k: &V3) -> bool {
    // Compiled for each set of vector instructions; the bits are the same with all of them.
    field.arch().dispatch(Look {
        field,
        i,
        j,
        upper,
        side,
        k,
    })
}

/// One question, as a type and not a closure: a closure of this size is not inlined, and what is not inlined
/// is not compiled for the wider instructions.
struct Look<'a> {
    field: &'a HeightField,
    i: usize,
    j: usize,
    upper: bool,
    side: Side,
    k: &'a V3,
}

impl pulp::WithSimd for Look<'_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> bool {
        looked_at(self)
    }
}

#[inline(always)]
fn looked_at(look: Look<'_>) -> bool {
    let Look {
        field,
        i,
        j,
        upper,
        side,
        k,
    } = look;
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
    let (drift, rims) = (
        across / ahead,
        [turn * beam.strip.0 / ahead, turn * beam.strip.1 / ahead],
    );
    let (rim_from, rim_to) = (lesser(rims[0], rims[1]), greater(rims[0], rims[1]));
    // Rows that the beam crosses between two positions ahead.
    let rows = |first: i64, last: i64| {
        let (a, b) = (drift * first as f64, drift * last as f64);
        (
            floor(lesser(a, b) + rim_from),
            floor(greater(a, b) + rim_to),
        )
    };
    let place = |column: i64, row: i64| {
        if along_x {
            (column, row)
        } else {
            (row, column)
        }
    };
    let mut step = 0;
    while step < COLUMNS_MAX {
        let column = step * forward;
        if step > 0 {
            // Many columns at once, as soon as the beam is over all that is there.
            let first = if forward > 0 { step } else { 1 - step - WINDOW };
            let (from, to) = rows(first, first + WINDOW);
            if to - from < WINDOW {
                let (cx, cy) = place(first, from);
                let wide = place(WINDOW, to - from + 1);
                let top = field.outermost_around(side, wrapped(i, cx, nx), wrapped(j, cy, ny));
                let lowest = beam.lowest_over((cx, cy), wide);
                if lowest >= top {
                    let (from, to) = rows(column, column + 1);
                    let mut cells = (from..=to).map(|row| place(column, row));
                    let free = lowest >= outermost
                        || cells.all(|(cx, cy)| {
                            let cell = wrapped(i, cx, nx) * ny + wrapped(j, cy, ny);
                            field.escape(side).clears(cell, k)
                        });
                    if free {
                        return true;
                    }
                    step += WINDOW;
                    continue;
                }
            }
        }
        let (from, to) = rows(column, column + 1);
        // From its own column on nothing is clear by the cells' escape slopes, or it would not be looked at.
        let mut all_clear = step > 0;
        for row in from..=to {
            let (cx, cy) = place(column, row);
            let (wi, wj) = (wrapped(i, cx, nx), wrapped(j, cy, ny));
            let h = field.corner_heights(wi, wj).map(|h| sign * h);
            let skip = (cx == 0 && cy == 0).then_some(usize::from(upper));
            if !beam.clears_cell(&h, cx as f64, cy as f64, skip, slack) {
                return false;
            }
            all_clear = all_clear && field.escape(side).clears(wi * ny + wj, k);
        }
        if !all_clear && step > 0 {
            let (corner, wide) = (place(column, from), place(1, to - from + 1));
            all_clear = beam.lowest_over(corner, wide) >= outermost;
        }
        if all_clear {
            return true;
        }
        step += 1;
    }
    false
}

/// The smaller of two numbers that are numbers.
#[inline(always)]
fn lesser(a: f64, b: f64) -> f64 {
    if b < a { b } else { a }
}

/// The greater of two numbers that are numbers.
#[inline(always)]
fn greater(a: f64, b: f64) -> f64 {
    if b > a { b } else { a }
}

/// Rounded down; without the library's function, which is slow where the machine's instruction is not
/// counted on.
#[inline(always)]
fn floor(x: f64) -> i64 {
    let whole = x as i64;
    whole - i64::from(whole as f64 > x)
}

impl Beam {
    #[inline(always)]
    fn new(own: &[f64; 4], upper: bool, d: [f64; 2], sx: f64, sy: f64, gain: f64) -> Self {
        let plane = Linear {
            at_origin: own[0],
            x: sx,
            y: sy,
        };
        // Below everything, so that it never matters.
        let none = Linear {
            at_origin: f64::NEG_INFINITY,
            x: 0.0,
            y: 0.0,
        };
        let mut beam = Beam {
            d,
            lowest: [plane, none, none, none],
            n_lowest: 1,
            side_by_side: Four {
                at_origin: [0.0; 4],
                x: [0.0; 4],
                y: [0.0; 4],
            },
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
        beam.side_by_side = Four {
            at_origin: beam.lowest.map(|l| l.at_origin),
            x: beam.lowest.map(|l| l.x),
            y: beam.lowest.map(|l| l.y),
        };
        for corner in TRIANGLES[usize::from(upper)] {
            let w = beam.across(CORNERS[corner]);
            beam.strip = (lesser(beam.strip.0, w), greater(beam.strip.1, w));
        }
        beam
    }

    #[inline(always)]
    fn across(&self, (x, y): (f64, f64)) -> f64 {
        x * self.d[1] - y * self.d[0]
    }

    /// A height that the beam is nowhere below over the `wide` cells from (cx, cy) on, from its own.
    #[inline(always)]
    fn lowest_over(&self, (cx, cy): (i64, i64), wide: (i64, i64)) -> f64 {
        let (x, y) = (wide.0 as f64, wide.1 as f64);
        let at = self.side_by_side.at(cx as f64, cy as f64);
        let Four {
            x: along_x,
            y: along_y,
            ..
        } = &self.side_by_side;
        greatest(&std::array::from_fn(|n| {
            at[n] + lesser(0.0, along_x[n] * x) + lesser(0.0, along_y[n] * y)
        }))
    }

    /// Whether the beam passes over a cell at (cx, cy) from its own, whose triangle `skip` is its start.
    #[inline(always)]
    fn clears_cell(&self, h: &[f64; 4], cx: f64, cy: f64, skip: Option<usize>, slack: f64) -> bool {
        // How far the lowest light by some one edge is over the lower and over the upper triangle.
        let at = self.side_by_side.at(cx, cy);
        let Four { x, y, .. } = &self.side_by_side;
        let diagonal: [f64; 4] =
            std::array::from_fn(|n| lesser(at[n] - h[0], at[n] + (x[n] + y[n]) - h[3]));
        let over = [
            greatest(&std::array::from_fn(|n| {
                lesser(diagonal[n], at[n] + x[n] - h[1])
            })),
            greatest(&std::array::from_fn(|n| {
                lesser(diagonal[n], at[n] + y[n] - h[2])
            })),
        ];
        // Loops from here on, not iterators with closures: those are not inlined either.
        for (n, corners) in TRIANGLES.iter().enumerate() {
            if over[n] + slack >= 0.0 || skip == Some(n) {
                continue;
            }
            let place = |c: usize| [CORNERS[c].0 + cx, CORNERS[c].1 + cy, h[c]];
            if !self.clears_triangle(&corners.map(place), slack) {
                return false;
            }
        }
        true
    }

    /// The same for one triangle: its part in the beam is cut out, and the highest of the lowest light by
    /// each edge must be nowhere below it. (A maximum of linear functions is so exactly where some mean of
    /// them is; means of two are tried, and there are hardly ever more than two that matter.)
    #[inline(always)]
    fn clears_triangle(&self, corners: &[[f64; 3]; 3], slack: f64) -> bool {
        let [dx, dy] = self.d;
        // Most are beside the strip or behind the light as a whole.
        let mut beside = [true, true];
        for [x, y, _] in corners {
            let w = x * dy - y * dx;
            beside[0] &= w <= self.strip.0;
            beside[1] &= w >= self.strip.1;
        }
        if beside[0] || beside[1] {
            return true;
        }
        for time in &self.latest[..self.n_latest] {
            let mut behind = true;
            for p in corners {
                behind &= time.at(p[0], p[1]) < 0.0;
            }
            if behind {
                return true;
            }
        }
        let across = |limit: f64, sign: f64| Linear {
            at_origin: -sign * limit,
            x: sign * dy,
            y: -sign * dx,
        };
        let mut part = Polygon::of(corners);
        part.keep(&across(self.strip.0, 1.0));
        part.keep(&across(self.strip.1, -1.0));
        for time in &self.latest[..self.n_latest] {
            part.keep(time);
        }
        let part = part.corners();
        let over = |l: &Linear, p: &[f64; 3]| l.at(p[0], p[1]) + slack - p[2];
        let lowest = &self.lowest[..self.n_lowest];
        for (n, l) in lowest.iter().enumerate() {
            let mut clear = true;
            for p in part {
                clear &= over(l, p) >= 0.0;
            }
            if clear {
                return true;
            }
            for other in &lowest[..n] {
                // The weights w of `l` with w l + (1 − w) other ≥ 0 at every corner.
                let (mut least, mut most) = (0.0f64, 1.0f64);
                for p in part {
                    let (x, y) = (over(l, p), over(other, p));
                    let rate = x - y;
                    if rate > 0.0 {
                        least = greater(least, -y / rate);
                    } else if rate < 0.0 {
                        most = lesser(most, -y / rate);
                    } else if y < 0.0 {
                        most = f64::NEG_INFINITY;
                    }
                }
                if least <= most {
                    return true;
                }
            }
        }
        false
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
    #[inline(always)]
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
