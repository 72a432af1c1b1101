//! A surface that is the same all along u: a periodic profile of straight pieces, and rays on it.
//!
//! [`Profile::sawtooth`] makes the ridged surface of Luongo et al. 2017 (pitch facet of length p
//! that leans to +v by θr, riser of length p tan θr at a right angle to it), with rounded crests and
//! valleys if asked. The method is that of [`super::height_field`] in one dimension less: the
//! clearance above the profile is carried from piece to piece.

use super::height_field::Side;
use super::vec3::V3;

/// A straight piece of the profile, from `from` to `to` along v with heights `low`..`high` at its ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piece {
    /// v at the start.
    pub from: f64,
    /// v at the end, greater than `from`.
    pub to: f64,
    /// Height at the start.
    pub z_from: f64,
    /// Height at the end.
    pub z_to: f64,
    /// Unit normal, upwards.
    pub normal: V3,
    /// Unit vector along the piece towards +v.
    pub along: V3,
}

/// A periodic profile of pieces that follow each other along v.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    pieces: Vec<Piece>,
    period: f64,
    lowest: f64,
    highest: f64,
}

/// A point of the profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ProfileSpot {
    /// Which piece.
    pub piece: usize,
    /// v within the period.
    pub v: f64,
    /// Height.
    pub z: f64,
}

/// Where a ray ends.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ProfileFlight {
    /// On the profile.
    Hit(ProfileSpot),
    /// Away for good.
    Free,
    /// Undecided after very many periods: all but horizontal.
    Lost,
}

/// Why a profile cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ProfileError {
    /// The roundings meet each other.
    #[error(
        "round_um = {round} is too large: the roundings of crest and valley would meet (largest: {largest:.3})"
    )]
    TooRound {
        /// What was asked.
        round: f64,
        /// What would still go.
        largest: f64,
    },
}

const PIECES_MAX: usize = 100_000;
/// Straight pieces per rounded corner.
const ARC: usize = 24;

impl Profile {
    /// The sawtooth: ridge angle `theta_r` (rad, 0 < θr < π/2), facet length `pitch`, radius `round` of
    /// crests and valleys (0: sharp), in one unit of length.
    ///
    /// # Errors
    /// A radius so large that the roundings of one facet meet.
    pub fn sawtooth(theta_r: f64, pitch: f64, round: f64) -> Result<Self, ProfileError> {
        let (sin, cos) = theta_r.sin_cos();
        // Crest at v = 0; down the facet towards +v, then up the riser.
        let foot = (pitch * cos, -pitch * sin);
        let period = pitch / cos;
        let mut corners = Vec::new();
        if round == 0.0 {
            corners.push((0.0, 0.0));
            corners.push(foot);
        } else {
            // A right-angled corner loses `round` of both its sides.
            let riser = pitch * theta_r.tan();
            let largest = 0.5 * pitch.min(riser);
            if round > largest {
                return Err(ProfileError::TooRound { round, largest });
            }
            // Unit vectors down the facet and up the riser.
            let (down, up) = ((cos, -sin), (sin, cos));
            let arc = |corners: &mut Vec<(f64, f64)>,
                       corner: (f64, f64),
                       a: (f64, f64),
                       b: (f64, f64)| {
                // From corner − round·a to corner + round·b about corner − round·a + round·b.
                for step in 0..=ARC {
                    let angle = std::f64::consts::FRAC_PI_2 * step as f64 / ARC as f64;
                    let (s, c) = angle.sin_cos();
                    corners.push((
                        corner.0 + round * ((s - 1.0) * a.0 + (1.0 - c) * b.0),
                        corner.1 + round * ((s - 1.0) * a.1 + (1.0 - c) * b.1),
                    ));
                }
            };
            arc(&mut corners, (0.0, 0.0), up, down);
            arc(&mut corners, foot, down, up);
        }
        Ok(Profile::of_corners(&corners, period))
    }

    /// Straight pieces through (v, z) corners of increasing v, closed by the first one a period on.
    ///
    /// Panics where corners do not increase or do not fit the period: an error of the caller.
    #[must_use]
    pub fn of_corners(corners: &[(f64, f64)], period: f64) -> Self {
        let pieces: Vec<Piece> = (0..corners.len())
            .map(|n| {
                let (from, z_from) = corners[n];
                let (to, z_to) = match corners.get(n + 1) {
                    Some(&next) => next,
                    None => (corners[0].0 + period, corners[0].1),
                };
                assert!(to > from, "corners increase along v");
                let length = (to - from).hypot(z_to - z_from);
                let (c, s) = ((to - from) / length, (z_to - z_from) / length);
                Piece {
                    from,
                    to,
                    z_from,
                    z_to,
                    normal: [0.0, -s, c],
                    along: [0.0, c, s],
                }
            })
            .collect();
        let heights = pieces.iter().map(|p| p.z_from);
        Profile {
            period,
            lowest: heights.clone().fold(f64::INFINITY, f64::min),
            highest: heights.fold(f64::NEG_INFINITY, f64::max),
            pieces,
        }
    }

    /// Length of a period along v.
    #[must_use]
    pub fn period(&self) -> f64 {
        self.period
    }

    /// Lowest and highest point.
    #[must_use]
    pub fn range(&self) -> (f64, f64) {
        (self.lowest, self.highest)
    }

    /// The pieces in order.
    #[must_use]
    pub fn pieces(&self) -> &[Piece] {
        &self.pieces
    }

    /// Effective ridge angle, rad: the median inclination, by area, of the parts whose normal leans
    /// to +v; `None` where nothing does.
    #[must_use]
    pub fn effective_ridge_angle(&self) -> Option<f64> {
        let mut leaning: Vec<(f64, f64)> = self
            .pieces
            .iter()
            .filter(|p| p.normal[1] > 0.0)
            .map(|p| {
                let length = (p.to - p.from).hypot(p.z_to - p.z_from);
                (p.normal[1].atan2(p.normal[2]), length)
            })
            .collect();
        leaning.sort_by(|a, b| a.0.total_cmp(&b.0));
        let half = 0.5 * leaning.iter().map(|l| l.1).sum::<f64>();
        let mut below = 0.0;
        for (angle, length) in leaning {
            below += length;
            if below >= half {
                return Some(angle);
            }
        }
        None
    }

    /// A ray from far away on a side that crosses the outermost level at the fraction `at` of the
    /// period.
    #[must_use]
    pub fn enter(&self, side: Side, k: &V3, at: f64) -> ProfileFlight {
        let v = self.pieces[0].from + at * self.period;
        let piece = self
            .pieces
            .partition_point(|p| p.to <= v)
            .min(self.pieces.len() - 1);
        let z = match side {
            Side::Above => self.highest,
            Side::Below => self.lowest,
        };
        self.march(&ProfileSpot { piece, v, z }, false, side.sign(), k)
    }

    /// A ray that leaves a spot on a side along `k`.
    #[must_use]
    pub fn onward(&self, spot: &ProfileSpot, side: Side, k: &V3) -> ProfileFlight {
        self.march(spot, true, side.sign(), k)
    }

    fn march(&self, start: &ProfileSpot, on_surface: bool, sign: f64, k: &V3) -> ProfileFlight {
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
            let z = self.pieces[start.piece].height(start.v);
            return ProfileFlight::Hit(ProfileSpot { z, ..*start });
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
        for _ in 0..PIECES_MAX {
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
                return ProfileFlight::Hit(ProfileSpot {
                    piece,
                    v,
                    z: p.height(v),
                });
            }
            if leaving && sign * z_out > limit {
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
        ProfileFlight::Lost
    }
}

impl Piece {
    /// Height at a v within the piece.
    #[must_use]
    pub fn height(&self, v: f64) -> f64 {
        self.z_from + (v - self.from) / (self.to - self.from) * (self.z_to - self.z_from)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sawtooth_has_the_drawn_facets() {
        let theta = 0.3f64;
        let profile = Profile::sawtooth(theta, 2.0, 0.0).unwrap();
        assert!((profile.period() - 2.0 / theta.cos()).abs() < 1e-15);
        let [facet, riser] = profile.pieces() else {
            panic!("two pieces")
        };
        let close = |a: V3, b: V3| a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-14);
        assert!(close(facet.normal, [0.0, theta.sin(), theta.cos()]));
        assert!(close(riser.normal, [0.0, -theta.cos(), theta.sin()]));
        let length = (riser.to - riser.from).hypot(riser.z_to - riser.z_from);
        assert!((length - 2.0 * theta.tan()).abs() < 1e-14);
        assert!((profile.effective_ridge_angle().unwrap() - theta).abs() < 1e-14);
    }

    #[test]
    fn visibility_of_the_facet_is_the_exact_one() {
        // The exact visibility g(a) = 1 − tan θr max(0, tan(a − θr)): the share of the facet
        // from which a ray at the projected angle a is free.
        let theta = 15f64.to_radians();
        let profile = Profile::sawtooth(theta, 1.0, 0.0).unwrap();
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
                    profile.onward(&spot, Side::Above, &k) == ProfileFlight::Free
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
    fn rounded_ridges_keep_their_period_and_their_median_angle() {
        let theta = 15f64.to_radians();
        let profile = Profile::sawtooth(theta, 10.0, 0.4).unwrap();
        let last = profile.pieces().last().unwrap();
        assert!((last.to - profile.pieces()[0].from - profile.period()).abs() < 1e-12);
        let angle = profile.effective_ridge_angle().unwrap();
        assert!((angle - theta).abs() < 1e-12, "{}", angle.to_degrees());
        assert!(profile.range().1 < 0.0);
        assert!(Profile::sawtooth(theta, 10.0, 2.0).is_err());
    }

    #[test]
    fn every_ray_from_outside_hits_and_none_slips_through_a_crest() {
        let profile = Profile::sawtooth(0.2, 1.0, 0.0).unwrap();
        for n in 0..=1000 {
            let at = f64::from(n) / 1000.0;
            for v in [-1.0, -0.1, 0.0, 0.1, 1.0] {
                for (side, z) in [(Side::Above, -0.2), (Side::Below, 0.2)] {
                    let flight = profile.enter(side, &[0.3, v, z], at.min(0.999_999));
                    assert!(matches!(flight, ProfileFlight::Hit(_)));
                }
            }
        }
    }
}
