//! Whether all light that leaves a triangle in one direction is certainly free.
//!
//! Call [`is_free`]. The triangle swept along the direction is a swept volume bounded by the edges
//! through which light leaves the triangle. Above each of these edges the lowest light has come
//! from the edge itself, so its height is a linear function of the position. Other triangles are on
//! one side of an edge's line, because all triangles are between lines of the same grid. The part
//! of a triangle inside the volume of an edge is therefore clear if that light clears its corners,
//! including those cut by the sides of the volume: a handful of comparisons instead of many rays.
//! Columns of cells that are entirely below the volume are skipped with one comparison.
//!
//! *Conditioning.* Times are quotients by the rate at which the light leaves an edge. An edge
//! parallel to the direction within 1e-9 has no width and is left out. Along an almost parallel
//! edge light gains height without bound, so height is counted from the edge's own line, on which
//! corners are exact. Heights are single precision and are compared in double precision with a
//! tolerance of 1e-9 of the field's relief: light that only touches the surface may be called free,
//! an error of 1e-9 of its light.

use crate::trace::surfaces::height_field::{HeightField, Side, WINDOW};
use crate::trace::vec3::V3;

/// Number of columns of cells that are tested before the result stays undecided.
const COLUMNS_MAX: i64 = 96;
/// Rounding error of heights over the steepest triangles, in units of the heights' spread.
const ROUNDING: f64 = 1e-9;

/// Rate of leaving an edge, relative to that of passing cells, below which the edge's share of the
/// light is negligible.
const NO_WIDTH: f64 = 1e-9;

/// Corners of a cell, in the order of the field's heights.
const CORNERS: [[f64; 2]; 4] = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
/// The two triangles of a cell as corners.
const TRIANGLES: [[usize; 3]; 2] = [[0, 1, 3], [0, 3, 2]];

/// An edge of a triangle between two corners of its cell: inside is n · x ≤ b.
struct Edge {
    n: [f64; 2],
    b: f64,
    ends: [usize; 2],
}

const fn edge(n: [f64; 2], b: f64, ends: [usize; 2]) -> Edge {
    Edge { n, b, ends }
}

/// The edges of both triangles.
const EDGES: [[Edge; 3]; 2] = [
    [
        edge([0.0, -1.0], 0.0, [0, 1]),
        edge([1.0, 0.0], 1.0, [1, 3]),
        edge([-1.0, 1.0], 0.0, [0, 3]),
    ],
    [
        edge([-1.0, 0.0], 0.0, [0, 2]),
        edge([0.0, 1.0], 1.0, [2, 3]),
        edge([1.0, -1.0], 0.0, [0, 3]),
    ],
];

/// The light that leaves through one edge, in cells from its own; heights count away from the
/// surface.
#[derive(Clone, Copy)]
struct Sheet {
    /// Height of the triangle's plane at (0, 0), and its slopes.
    at_origin: f64,
    slopes: [f64; 2],
    /// The edge's line: the light is where n · x > b.
    n: [f64; 2],
    b: f64,
    /// Height that its lowest ray gains over the plane per unit of n · x − b. Very large if the
    /// light is parallel to the edge; but n · x − b is an integer at the corners, and 0 on the
    /// edge.
    gain: f64,
    /// Range of x dy − y dx.
    strip: [f64; 2],
}

impl Sheet {
    const NONE: Sheet = Sheet {
        at_origin: f64::NEG_INFINITY,
        slopes: [0.0; 2],
        n: [0.0; 2],
        b: 0.0,
        gain: 0.0,
        strip: [0.0; 2],
    };

    /// Height of the light over the corners of a cell at (x, y).
    #[inline(always)]
    fn over(&self, h: &[f64; 4], x: f64, y: f64) -> [f64; 4] {
        let ([sx, sy], [nx, ny]) = (self.slopes, self.n);
        let plane = self.at_origin + sx * x + sy * y;
        let beyond = nx * x + ny * y - self.b;
        [
            plane + self.gain * beyond - h[0],
            (plane + sx) + self.gain * (beyond + nx) - h[1],
            (plane + sy) + self.gain * (beyond + ny) - h[2],
            (plane + (sx + sy)) + self.gain * (beyond + (nx + ny)) - h[3],
        ]
    }

    /// Whether it clears the part of a triangle inside its sides: `w` is x dy − y dx at the
    /// corners, `over` the height above them.
    #[inline(always)]
    fn clears(&self, w: &[f64; 3], over: &[f64; 3]) -> bool {
        let [from, to] = self.strip;
        let mut clear = true;
        for a in 0..3 {
            let b = if a == 2 { 0 } else { a + 1 };
            clear &= w[a] < from || w[a] > to || over[a] >= 0.0;
            for limit in self.strip {
                // Without a division: the mean of the ends at the limit, times their distance.
                let (after, before) = (w[b] - limit, limit - w[a]);
                let mean = over[a] * after + over[b] * before;
                clear &= after * before <= 0.0
                    || if after > 0.0 {
                        mean >= 0.0
                    } else {
                        mean <= 0.0
                    };
            }
        }
        clear
    }
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

/// Whether all light that leaves the triangle on a side along `k` is free. `k` must point away from
/// the triangle and from the surface as a whole.
#[must_use]
pub fn is_free(field: &HeightField, i: usize, j: usize, upper: bool, side: Side, k: &V3) -> bool {
    // Compiled for each vector instruction set; the bits are the same with all of them.
    field.arch().dispatch(VisibilityTest {
        field,
        i,
        j,
        upper,
        side,
        k,
    })
}

/// The arguments of one test. A type instead of a closure, because a closure of this size is not
/// inlined and would not be compiled for the wider instructions.
struct VisibilityTest<'a> {
    field: &'a HeightField,
    i: usize,
    j: usize,
    upper: bool,
    side: Side,
    k: &'a V3,
}

impl pulp::WithSimd for VisibilityTest<'_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> bool {
        all_is_free(self)
    }
}

#[inline(always)]
fn all_is_free(test: VisibilityTest<'_>) -> bool {
    let VisibilityTest {
        field,
        i,
        j,
        upper,
        side,
        k,
    } = test;
    let sign = side.sign();
    let (cell_x, cell_y) = field.cell_size();
    let (nx, ny) = field.cells();
    let d = [k[0] / cell_x, k[1] / cell_y];
    let slopes = field.slopes(i, j, upper);
    let slopes = [sign * slopes.0 * cell_x, sign * slopes.1 * cell_y];
    let rise = sign * k[2];
    // Clearance over the triangle's own plane that the light gains per unit of time.
    let gain = rise - slopes[0] * d[0] - slopes[1] * d[1];
    if gain <= 0.0 || rise <= 0.0 {
        return false;
    }
    let along_x = d[0].abs() >= d[1].abs();
    let (axis, ahead, across) = if along_x {
        (0, d[0], d[1])
    } else {
        (1, d[1], d[0])
    };
    if ahead == 0.0 {
        return true;
    }
    let own = field.corner_heights(i, j).map(|h| sign * h);
    let (low, high) = field.range();
    let slack = ROUNDING * (high - low);
    let outermost = if sign > 0.0 { high } else { -low };
    let forward = if ahead > 0.0 { 1 } else { -1 };
    let climb = rise / ahead.abs();
    // Light through the edges that face forward, and where its lowest ray would have come from at
    // the near side of its own column.
    let mut sheets = [Sheet::NONE; 2];
    let (mut count, mut lowest) = (0, f64::INFINITY);
    let near_side = if forward > 0 { 0.0 } else { 1.0 };
    for edge in &EDGES[usize::from(upper)] {
        let rate = edge.n[0] * d[0] + edge.n[1] * d[1];
        if rate <= NO_WIDTH * ahead.abs() || count == 2 {
            continue;
        }
        let w = edge
            .ends
            .map(|c| CORNERS[c][0] * d[1] - CORNERS[c][1] * d[0]);
        sheets[count] = Sheet {
            at_origin: own[0] + slack,
            slopes,
            n: edge.n,
            b: edge.b,
            // Light at a position left the edge (n · x − b)/(n · d) ago.
            gain: gain / rate,
            strip: [lesser(w[0], w[1]), greater(w[0], w[1])],
        };
        count += 1;
        for c in edge.ends {
            let away = (CORNERS[c][axis] - near_side) * forward as f64;
            lowest = lesser(lowest, own[c] - climb * away);
        }
    }
    let sheets = &sheets[..count];
    let mut strip = [f64::INFINITY, f64::NEG_INFINITY];
    for sheet in sheets {
        strip = [
            lesser(strip[0], sheet.strip[0]),
            greater(strip[1], sheet.strip[1]),
        ];
    }
    // The position across at a position ahead a and a strip coordinate w: (a across ∓ w)/ahead.
    let turn = if along_x { -1.0 } else { 1.0 };
    let (drift, rims) = (across / ahead, strip.map(|w| turn * w / ahead));
    let (rim_from, rim_to) = (lesser(rims[0], rims[1]), greater(rims[0], rims[1]));
    // Rows that the light crosses between two positions ahead.
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
    let horizon = field.horizon(side).towards(k);
    let mut step = 0;
    while step < COLUMNS_MAX {
        let column = step * forward;
        let (from, to) = rows(column, column + 1);
        let lowest_here = lowest + climb * step as f64;
        if step > 0 {
            if lowest_here >= outermost {
                return true;
            }
            // Many columns at once, as soon as the light is above all heights there.
            let first = if forward > 0 {
                column
            } else {
                column + 1 - WINDOW
            };
            let (first_row, last_row) = rows(first, first + WINDOW);
            if last_row - first_row < WINDOW {
                let (cx, cy) = place(first, first_row);
                let top = field.outermost_around(side, wrapped(i, cx, nx), wrapped(j, cy, ny));
                if lowest_here >= top {
                    let mut clear = true;
                    for row in from..=to {
                        let (cx, cy) = place(column, row);
                        let cell = wrapped(i, cx, nx) * ny + wrapped(j, cy, ny);
                        clear &= horizon.clears(cell, lowest_here);
                    }
                    if clear {
                        return true;
                    }
                    step += WINDOW;
                    continue;
                }
            }
        }
        // In its own column the horizon slopes decide nothing, or this function would not be
        // called.
        let (mut under, mut clear) = (step > 0, step > 0);
        for row in from..=to {
            let (cx, cy) = place(column, row);
            let cell = wrapped(i, cx, nx) * ny + wrapped(j, cy, ny);
            under &= horizon.outermost(cell) <= lowest_here;
            clear &= horizon.clears(cell, lowest_here);
        }
        if !under {
            for row in from..=to {
                let (cx, cy) = place(column, row);
                let (wi, wj) = (wrapped(i, cx, nx), wrapped(j, cy, ny));
                if step > 0 && horizon.outermost(wi * ny + wj) <= lowest_here {
                    continue;
                }
                let h = field.corner_heights(wi, wj).map(|h| sign * h);
                let skip = (cx == 0 && cy == 0).then_some(usize::from(upper));
                if !clears_cell(sheets, &d, &h, [cx as f64, cy as f64], skip) {
                    return false;
                }
            }
        }
        if clear {
            return true;
        }
        step += 1;
    }
    false
}

/// Whether the light passes over a cell at a position from its own; `skip` is the triangle at which
/// it starts.
#[inline(always)]
fn clears_cell(
    sheets: &[Sheet],
    d: &[f64; 2],
    h: &[f64; 4],
    at: [f64; 2],
    skip: Option<usize>,
) -> bool {
    let mut over = [[0.0; 4]; 2];
    let mut clear = [skip == Some(0), skip == Some(1)];
    for (over, sheet) in over.iter_mut().zip(sheets) {
        *over = sheet.over(h, at[0], at[1]);
        // Light through the other edge is at least as high as light through this one.
        let diagonal = lesser(over[0], over[3]);
        clear[0] |= lesser(diagonal, over[1]) >= 0.0;
        clear[1] |= lesser(diagonal, over[2]) >= 0.0;
    }
    if clear[0] && clear[1] {
        return true;
    }
    let w: [f64; 4] =
        std::array::from_fn(|c| (CORNERS[c][0] + at[0]) * d[1] - (CORNERS[c][1] + at[1]) * d[0]);
    for (n, corners) in TRIANGLES.iter().enumerate() {
        if clear[n] {
            continue;
        }
        let inner = if n == 0 {
            [2.0 / 3.0, 1.0 / 3.0]
        } else {
            [1.0 / 3.0, 2.0 / 3.0]
        };
        for (over, sheet) in over.iter().zip(sheets) {
            let beyond =
                sheet.n[0] * (at[0] + inner[0]) + sheet.n[1] * (at[1] + inner[1]) > sheet.b;
            if !beyond {
                continue;
            }
            if !sheet.clears(&corners.map(|c| w[c]), &corners.map(|c| over[c])) {
                return false;
            }
        }
    }
    true
}

/// The smaller of two numbers, neither of them NaN.
#[inline(always)]
fn lesser(a: f64, b: f64) -> f64 {
    if b < a { b } else { a }
}

/// The larger of two numbers, neither of them NaN.
#[inline(always)]
fn greater(a: f64, b: f64) -> f64 {
    if b > a { b } else { a }
}

/// Rounds down, without the library's function, which is slow unless the machine's instruction is
/// enabled.
#[inline(always)]
fn floor(x: f64) -> i64 {
    let whole = x as i64;
    whole - i64::from(whole as f64 > x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::rng::{Purpose, RandomStream};
    use crate::trace::surfaces::beckmann::beckmann;
    use crate::trace::surfaces::height_field::Flight;
    use crate::trace::vec3::{dot, unit};

    #[test]
    fn steep_light_over_an_almost_flat_field_is_free_along_any_edge() {
        let field = beckmann(32, 1e-6, 1e-6, 1);
        for across in [0.0, 1e-16, 2.6e-7, -2.6e-7, 1e-3] {
            for k in [
                [0.8, across, 0.6],
                [across, -0.8, 0.6],
                [0.5, 0.5 + across, 0.7],
            ] {
                for at in 0..32 * 32 {
                    for upper in [false, true] {
                        let free = is_free(&field, at / 32, at % 32, upper, Side::Above, &k);
                        assert!(free, "{at} {upper} {k:?}");
                    }
                }
            }
        }
    }

    #[test]
    fn every_ray_of_free_light_is_free_and_free_light_is_rarely_missed() {
        let field = beckmann(64, 0.5, 0.35, 3);
        let mut random = RandomStream::new(5, Purpose::Photon, 0);
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
                field.onward(&spot, side, &k, &mut 0) == Flight::Free
            });
            match (says_free, all_free) {
                (true, true) => found += 1,
                (true, false) => panic!("a ray of free light hits"),
                (false, true) => missed += 1,
                (false, false) => blocked += 1,
            }
        }
        assert!(found > 500 && blocked > 200, "{found} {blocked}");
        // Forty rays may miss an obstacle at a triangle's rim, so some of these are not missed.
        assert!(missed * 50 < found, "{missed} of {found}");
    }
}
