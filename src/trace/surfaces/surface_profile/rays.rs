//! Rays on a profile: where they enter, what they hit next, and when they are free.

use super::{Piece, SurfaceProfile};
use crate::trace::surfaces::height_field::Side;
use crate::trace::vec3::V3;

/// A point of the profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProfileSpot {
    /// Index of the piece.
    pub piece: usize,
    /// v within the period.
    pub v: f64,
    /// Height.
    pub z: f64,
}

/// The end of a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ProfileFlight {
    /// On the profile.
    Hit(ProfileSpot),
    /// The ray leaves the surface.
    Free,
    /// Undecided after very many periods: almost horizontal.
    Lost,
}

/// Number of pieces that a ray crosses before it is given up.
const PIECES_MAX: usize = 100_000;

impl SurfaceProfile {
    /// A ray from far away on one side that crosses the outermost level at the fraction `at` of the
    /// period. The number of pieces that it crosses is added to `crossed`.
    #[must_use]
    pub fn enter(&self, side: Side, k: &V3, at: f64, crossed: &mut u64) -> ProfileFlight {
        let v = self.pieces[0].from + at * self.period;
        let piece = self
            .pieces
            .partition_point(|p| p.to <= v)
            .min(self.pieces.len() - 1);
        let z = match side {
            Side::Above => self.highest,
            Side::Below => self.lowest,
        };
        let start = ProfileSpot { piece, v, z };
        self.march(&start, false, side.sign(), k, crossed)
    }

    /// A ray that leaves a spot on one side along `k`. The number of pieces that it crosses is
    /// added to `crossed`.
    #[must_use]
    pub fn onward(
        &self,
        spot: &ProfileSpot,
        side: Side,
        k: &V3,
        crossed: &mut u64,
    ) -> ProfileFlight {
        if side == Side::Above && k[2] > 0.0 {
            let free = self.free_above[spot.piece][usize::from(k[1] > 0.0)];
            if k[2] > free * k[1].abs() {
                return ProfileFlight::Free;
            }
        }
        self.march(spot, true, side.sign(), k, crossed)
    }

    fn march(
        &self,
        start: &ProfileSpot,
        on_surface: bool,
        sign: f64,
        k: &V3,
        crossed: &mut u64,
    ) -> ProfileFlight {
        let (dv, dz) = (k[1], k[2]);
        let leaving = sign * dz > 0.0;
        let limit = if sign > 0.0 {
            self.highest
        } else {
            -self.lowest
        };
        if dv == 0.0 {
            if leaving || on_surface {
                return ProfileFlight::Free;
            }
            return ProfileFlight::Hit(self.spot(start.piece, start.v, dv, dz));
        }
        let slope = dz / dv;
        let mut piece = start.piece;
        // Height of the ray at v of this period = base + slope · v.
        let mut base = start.z - slope * start.v;
        let mut v_in = start.v;
        let mut c_in = if on_surface {
            0.0
        } else {
            (sign * (start.z - self.pieces[piece].height(start.v))).max(0.0)
        };
        let mut first = on_surface;
        for n in 1..=PIECES_MAX as u64 {
            let p = &self.pieces[piece];
            let (v_out, z_surface) = if dv > 0.0 {
                (p.to, p.z_to)
            } else {
                (p.from, p.z_from)
            };
            let z_out = base + slope * v_out;
            let c_out = sign * (z_out - z_surface);
            if c_out < 0.0 && !first {
                let v = v_in + (v_out - v_in) * (c_in / (c_in - c_out));
                let v = v.clamp(p.from, p.to);
                *crossed += n;
                return ProfileFlight::Hit(self.spot(piece, v, dv, dz));
            }
            if leaving && sign * z_out > limit {
                *crossed += n;
                return ProfileFlight::Free;
            }
            first = false;
            c_in = c_out.max(0.0);
            v_in = v_out;
            if dv > 0.0 {
                piece += 1;
                if piece == self.pieces.len() {
                    piece = 0;
                    v_in -= self.period;
                    base += slope * self.period;
                }
            } else if piece == 0 {
                piece = self.pieces.len() - 1;
                v_in += self.period;
                base -= slope * self.period;
            } else {
                piece -= 1;
            }
        }
        *crossed += PIECES_MAX as u64;
        ProfileFlight::Lost
    }

    /// The point at which a ray along (`dv`, `dz`), which meets a piece at `v`, meets the curve
    /// that the piece approximates.
    #[inline]
    fn spot(&self, piece: usize, v: f64, dv: f64, dz: f64) -> ProfileSpot {
        let p = &self.pieces[piece];
        let v = match &p.tangents {
            None => v,
            Some([a, b]) => {
                let at = (v - p.from) / (p.to - p.from);
                // Height of the bow above the piece, in its lengths; largest in the middle.
                let above = -0.5 * (a.0 * b.1 - a.1 * b.0) * at * (1.0 - at);
                let [_, c, s] = p.along;
                let moved = above * (dv * c + dz * s) / (dz * c - dv * s);
                // The hit of a ray parallel to the piece is undefined.
                let at = if moved.is_finite() { at + moved } else { at };
                p.from + at.clamp(0.0, 1.0) * (p.to - p.from)
            }
        };
        let z = p.height(v);
        ProfileSpot { piece, v, z }
    }
}

/// Per piece, the steepest slope from any of its points to any corner above, towards −v and +v.
/// From a straight piece the slope to a corner is steepest at one of its ends; the corner's
/// repetition a period further has a smaller slope.
pub(super) fn free_slopes(pieces: &[Piece], period: f64) -> Vec<[f64; 2]> {
    let n = pieces.len();
    let corner = |i: usize| {
        let p = &pieces[i % n];
        (p.from + (i / n) as f64 * period, p.z_from)
    };
    // Steepest slope from corner i to those up to a period beyond, by the hull of the points
    // beyond.
    let seen = |rightwards: bool| -> Vec<f64> {
        let at = |i: usize| {
            let (v, z) = corner(if rightwards { i } else { 2 * n - i });
            (if rightwards { v } else { -v }, z)
        };
        let slope = |a: (f64, f64), b: (f64, f64)| (b.1 - a.1) / (b.0 - a.0);
        let mut hull: Vec<(f64, f64)> = Vec::new();
        let mut steepest = vec![0.0; 2 * n + 1];
        for i in (0..=2 * n).rev() {
            let here = at(i);
            while let [.., second, first] = hull[..]
                && slope(here, second) >= slope(here, first)
            {
                hull.pop();
            }
            steepest[i] = hull.last().map_or(0.0, |top| slope(here, *top));
            hull.push(here);
        }
        steepest
    };
    let (right, left) = (seen(true), seen(false));
    (0..n)
        .map(|i| {
            let to_left = left[2 * n - (i + n)].max(left[2 * n - (i + n + 1)]);
            [to_left, right[i].max(right[i + 1])]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_visibility_of_the_facet_is_exact() {
        // The exact visibility g(a) = 1 − tan θr max(0, tan(a − θr)): the fraction of the facet
        // from which a ray at the projected angle a is free.
        let theta = 15f64.to_radians();
        let profile = SurfaceProfile::sawtooth(theta, 1.0, 0.0).unwrap();
        let facet = profile.pieces()[0];
        let steps = 20_000;
        for degrees in [-80.0f64, -40.0, 10.0, 40.0, 70.0, 85.0] {
            let a = degrees.to_radians();
            if (a - theta).cos() <= 0.0 {
                continue;
            }
            let expected = (1.0 - theta.tan() * (a - theta).tan().max(0.0)).max(0.0);
            let free = (0..steps)
                .filter(|n| {
                    let v = facet.from
                        + (facet.to - facet.from) * (f64::from(*n) + 0.5) / f64::from(steps);
                    let spot = ProfileSpot {
                        piece: 0,
                        v,
                        z: facet.height(v),
                    };
                    let k = [0.0, a.sin(), a.cos()];
                    profile.onward(&spot, Side::Above, &k, &mut 0) == ProfileFlight::Free
                })
                .count();
            let share = free as f64 / f64::from(steps);
            assert!(
                (share - expected).abs() < 1.5 / f64::from(steps),
                "{degrees}: {share} {expected}"
            );
        }
    }

    #[test]
    fn rays_hit_a_rounded_edge_at_the_point_of_its_circle_with_the_same_normal() {
        let (theta, round) = (15f64.to_radians(), 0.8);
        let profile = SurfaceProfile::sawtooth(theta, 10.0, round).unwrap();
        let (sin, cos) = theta.sin_cos();
        let (down, up, foot) = ((cos, -sin), (sin, cos), (10.0 * cos, -10.0 * sin));
        // Crest and valley: both centres are on the side of the piece between their edges.
        let crest = (round * (down.0 - up.0), round * (down.1 - up.1));
        let valley = (foot.0 - crest.0, foot.1 - crest.1);
        let (_, top) = profile.range();
        let first = profile.pieces()[0].from;
        let mut met = 0;
        for lean in [-50.0f64, -20.0, 0.0, 20.0, 50.0] {
            let (dv, dz) = (lean.to_radians().sin(), -lean.to_radians().cos());
            for n in 0..20_000 {
                let at = (f64::from(n) + 0.5) / 20_000.0;
                let flight = profile.enter(Side::Above, &[0.0, dv, dz], at, &mut 0);
                let ProfileFlight::Hit(spot) = flight else {
                    panic!("rays from above hit")
                };
                let piece = &profile.pieces()[spot.piece];
                let (_, [_, normal_v, normal_z]) = piece.frame(spot.v);
                // For rays almost along the surface the position is inaccurate.
                if piece.tangents.is_none() || -(dv * normal_v + dz * normal_z) < 0.3 {
                    continue;
                }
                let start = first + at * profile.period();
                let circles = [crest, valley].into_iter().zip([1.0, -1.0]);
                let circles = circles.flat_map(|c| (-3..=3).map(move |period| (c, period)));
                let expected = circles.filter_map(|((centre, side), period)| {
                    let v = start - centre.0 - f64::from(period) * profile.period();
                    let z = top - centre.1;
                    let half = v * dv + z * dz;
                    let root = (half * half - (v * v + z * z - round * round)).sqrt();
                    // From above, the crest's circle is met from outside, the valley's from inside.
                    let way = -half - side * root;
                    let normal = (side * (v + way * dv) / round, side * (z + way * dz) / round);
                    let off = (normal.0 - normal_v).hypot(normal.1 - normal_z);
                    root.is_finite().then_some(off)
                });
                let off = expected.fold(f64::INFINITY, f64::min);
                assert!(off < 2e-3, "{lean} {at}: {off}");
                met += 1;
            }
        }
        assert!(met > 5000, "{met}");
    }

    #[test]
    fn every_ray_from_outside_hits_and_none_passes_through_a_crest() {
        let profile = SurfaceProfile::sawtooth(0.2, 1.0, 0.0).unwrap();
        for n in 0..=1000 {
            let at = f64::from(n) / 1000.0;
            for v in [-1.0, -0.1, 0.0, 0.1, 1.0] {
                for (side, z) in [(Side::Above, -0.2), (Side::Below, 0.2)] {
                    let flight = profile.enter(side, &[0.3, v, z], at.min(0.999_999), &mut 0);
                    assert!(matches!(flight, ProfileFlight::Hit(_)));
                }
            }
        }
    }
}
