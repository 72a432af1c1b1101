//! A surface that is constant along u: a periodic profile of straight pieces, and rays on it.
//!
//! [`SurfaceProfile::sawtooth`] makes the ridged surface of Luongo et al. 2017 (pitch facet of
//! length p that leans to +v by θr, riser of length p tan θr perpendicular to it), optionally with
//! rounded crests and valleys. The method is that of [`super::height_field`] with one dimension
//! less: the clearance above the profile is carried from piece to piece.
//!
//! Pieces that approximate a curve ([`Corner::bowed`]) are straight for the search of a hit. The
//! hit is then moved to the curve's bow, and the normal there is that of the bow, which turns
//! evenly from end to end. A rounded edge thus reflects without gaps between its pieces, whatever
//! their number.
//!
//! *Conditioning.* As in `height_field`: the clearance at a corner is computed once and carried on,
//! and a hit divides it by a sum of two positive numbers. A piece's direction comes from
//! differences of its corners, so a profile far from v = 0 loses the digits of its offset (at v =
//! 1e6 steps ten digits are left); `measured` refuses rows whose steps vanish in rounding.

mod curved_pieces;
mod error;
mod lobe;
mod rays;

use std::sync::Arc;

use crate::trace::vec3::V3;
use curved_pieces::bows;
pub use error::ProfileError;
use rays::free_slopes;
pub use rays::{ProfileFlight, ProfileSpot};

/// A straight piece of the profile, from `from` to `to` along v with heights `z_from` and `z_to` at
/// its ends, all in the profile's unit of length.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piece {
    /// v at the start, in the unit of the profile.
    pub from: f64,
    /// v at the end, same unit, greater than `from`.
    pub to: f64,
    /// Height at the start, same unit.
    pub z_from: f64,
    /// Height at the end, same unit.
    pub z_to: f64,
    /// Unit normal, upwards.
    pub normal: V3,
    /// Unit vector along the piece towards +v.
    pub along: V3,
    /// For a piece that approximates a curve: the curve's unit tangents (v, z) at both ends.
    pub tangents: Option<[(f64, f64); 2]>,
}

/// A corner of a profile.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Corner {
    /// Position along v.
    pub v: f64,
    /// Height.
    pub z: f64,
    /// Whether the piece that starts here approximates a curve.
    pub bowed: bool,
}

/// A periodic profile of consecutive pieces along v.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceProfile {
    pieces: Vec<Piece>,
    /// Per piece: slopes towards −v and +v above which an upward ray that leaves it is free.
    free_above: Vec<[f64; 2]>,
    period: f64,
    lowest: f64,
    highest: f64,
    turned: bool,
    /// Standard uncertainty of the angle of the lobe, rad.
    lobe_error: f64,
    /// Another profile that agrees with the measurement.
    alternative: Option<Arc<SurfaceProfile>>,
}

/// Corners closer than this fraction of the period are one.
const SAME_PLACE: f64 = 1e-13;
/// Pieces per rounded corner.
pub(in crate::trace) const ARC: usize = 24;

impl SurfaceProfile {
    /// Makes the sawtooth: ridge angle `theta_r` (rad, 0 < θr < π/2), facet length `pitch`, radius
    /// `round` of crests and valleys (0: sharp), in one unit of length.
    ///
    /// # Errors
    /// The radius is so large that the roundings of one facet meet.
    pub fn sawtooth(theta_r: f64, pitch: f64, round: f64) -> Result<Self, ProfileError> {
        SurfaceProfile::rounded(theta_r, pitch, [round, round])
    }

    /// Makes the sawtooth with separate radii of crests and valleys (0: sharp), in the unit of
    /// `pitch`.
    ///
    /// # Errors
    /// The radii are so large that the roundings of one facet meet.
    pub fn rounded(
        theta_r: f64,
        pitch: f64,
        [crest, valley]: [f64; 2],
    ) -> Result<Self, ProfileError> {
        let (sin, cos) = theta_r.sin_cos();
        // Crest at v = 0; down the facet towards +v, then up the riser.
        let foot = (pitch * cos, -pitch * sin);
        let period = pitch / cos;
        let mut corners = Vec::new();
        // A rounding removes its radius from both sides of a right-angled corner.
        let riser = pitch * theta_r.tan();
        let (round, largest) = (0.5 * (crest + valley), 0.5 * pitch.min(riser));
        if round > largest {
            return Err(ProfileError::TooRound { round, largest });
        }
        // Unit vectors down the facet and up the riser.
        let (down, up) = ((cos, -sin), (sin, cos));
        for (corner, round, a, b) in [((0.0, 0.0), crest, up, down), (foot, valley, down, up)] {
            if round == 0.0 {
                corners.push(Corner::sharp(corner));
                continue;
            }
            // From corner − round·a to corner + round·b about corner − round·a + round·b.
            for step in 0..=ARC {
                let angle = std::f64::consts::FRAC_PI_2 * step as f64 / ARC as f64;
                let (s, c) = angle.sin_cos();
                corners.push(Corner {
                    v: corner.0 + round * ((s - 1.0) * a.0 + (1.0 - c) * b.0),
                    z: corner.1 + round * ((s - 1.0) * a.1 + (1.0 - c) * b.1),
                    bowed: step < ARC,
                });
            }
        }
        Ok(SurfaceProfile::with_bows(&corners, period))
    }

    /// Makes straight pieces through (v, z) corners of increasing v, closed by the first corner one
    /// period later.
    ///
    /// Corners that coincide except for rounding count once. Panics if other corners do not
    /// increase or do not fit into the period, which is an error of the caller.
    #[must_use]
    pub fn of_corners(corners: &[(f64, f64)], period: f64) -> Self {
        let corners: Vec<Corner> = corners.iter().copied().map(Corner::sharp).collect();
        Self::with_bows(&corners, period)
    }

    /// As [`SurfaceProfile::of_corners`], where some pieces approximate curves.
    #[must_use]
    pub fn with_bows(corners: &[Corner], period: f64) -> Self {
        let same = |to: f64, from: f64| (to - from).abs() <= SAME_PLACE * period;
        let mut corners = corners.to_vec();
        corners.dedup_by(|next, kept| {
            let one = same(next.v, kept.v);
            // Of two coincident corners, the later one starts a piece.
            kept.bowed = if one { next.bowed } else { kept.bowed };
            one
        });
        while corners.len() > 1 && same(corners[0].v + period, corners[corners.len() - 1].v) {
            corners.pop();
        }
        let bowed: Vec<bool> = corners.iter().map(|c| c.bowed).collect();
        let corners: Vec<(f64, f64)> = corners.iter().map(|c| (c.v, c.z)).collect();
        let mut pieces: Vec<Piece> = (0..corners.len())
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
                    tangents: None,
                }
            })
            .collect();
        for (n, tangents) in bows(&pieces, &bowed) {
            pieces[n].tangents = Some(tangents);
        }
        let heights = pieces.iter().map(|p| p.z_from);
        SurfaceProfile {
            free_above: free_slopes(&pieces, period),
            period,
            lowest: heights.clone().fold(f64::INFINITY, f64::min),
            highest: heights.fold(f64::NEG_INFINITY, f64::max),
            pieces,
            turned: false,
            lobe_error: 0.0,
            alternative: None,
        }
    }

    /// Makes a measured profile from rows of v and height in one unit; the last row closes the
    /// period at the height of the first (a difference up to a tenth of the profile's height is
    /// levelled).
    ///
    /// # Errors
    /// The rows are not a closed profile of ridges.
    pub fn measured(rows: &[(f64, f64)]) -> Result<Self, ProfileError> {
        for (n, (v, z)) in rows.iter().enumerate() {
            let row = n + 1;
            if !(v.abs() < 1e12 && z.abs() < 1e12) {
                return Err(ProfileError::NotFinite { row });
            }
            if n > 0 && *v <= rows[n - 1].0 {
                return Err(ProfileError::NotIncreasing { row, v: *v });
            }
        }
        let [first, .., last] = rows else {
            return Err(ProfileError::TooShort { rows: rows.len() });
        };
        if rows.len() < 3 {
            return Err(ProfileError::TooShort { rows: rows.len() });
        }
        let (low, high) = lowest_and_highest(rows.iter().map(|r| r.1));
        if (last.1 - first.1).abs() > 0.1 * (high - low) {
            return Err(ProfileError::Open {
                first: first.1,
                last: last.1,
            });
        }
        // The period is a difference: if the rows' step is below its rounding, the last corner
        // would come after the period's end.
        let period = last.0 - first.0;
        if first.0 + period <= rows[rows.len() - 2].0 {
            return Err(ProfileError::NotIncreasing {
                row: rows.len(),
                v: last.0,
            });
        }
        // Heights are counted from their middle, whatever the zero of the file, to keep the digits
        // of rays.
        let middle = 0.5 * (low + high);
        let corners = rows[..rows.len() - 1].iter().map(|(v, z)| (*v, z - middle));
        let profile = SurfaceProfile::of_corners(&corners.collect::<Vec<_>>(), period);
        match profile.effective_ridge_angle() {
            Some(_) => Ok(profile),
            None => Err(ProfileError::LeansNowhere),
        }
    }

    /// Returns the profile with +v towards the lean of its longer flanks, the facets: reversed if
    /// they lean the other way.
    #[must_use]
    pub fn facets_to_v(self) -> Self {
        let across = |side: f64| -> f64 {
            let leaning = self.pieces.iter().filter(|p| side * p.normal[1] > 0.0);
            leaning.map(|p| p.to - p.from).sum()
        };
        if across(1.0) >= across(-1.0) {
            return self;
        }
        let n = self.pieces.len();
        let corners = (0..n).rev().map(|i| Corner {
            v: -self.pieces[i].from,
            z: self.pieces[i].z_from,
            bowed: self.pieces[(i + n - 1) % n].tangents.is_some(),
        });
        SurfaceProfile {
            turned: !self.turned,
            lobe_error: self.lobe_error,
            alternative: self.alternative.clone(),
            ..SurfaceProfile::with_bows(&corners.collect::<Vec<_>>(), self.period)
        }
    }

    /// Whether [`SurfaceProfile::facets_to_v`] reversed it.
    #[must_use]
    pub fn is_turned(&self) -> bool {
        self.turned
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

    /// Effective ridge angle, rad: the area-weighted median inclination of the parts whose normal
    /// leans to +v; `None` if no part does.
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

    /// Adds another shape that also agrees with the measurement, as the limit of the possible ones.
    #[must_use]
    pub fn with_alternative(self, alternative: SurfaceProfile) -> Self {
        SurfaceProfile {
            alternative: Some(Arc::new(alternative)),
            ..self
        }
    }

    /// The shape added by [`SurfaceProfile::with_alternative`].
    #[must_use]
    pub fn alternative(&self) -> Option<&SurfaceProfile> {
        self.alternative.as_deref()
    }

    /// Number of ridges: flanks that fall towards +v by more than half the profile's height.
    #[must_use]
    pub fn ridges(&self) -> usize {
        let half = 0.5 * (self.highest - self.lowest);
        let (mut count, mut is_down) = (0, false);
        // Passed twice, so that a ridge that is cut at the start counts once.
        let (mut top, mut bottom) = (f64::NEG_INFINITY, f64::INFINITY);
        for (n, piece) in self.pieces.iter().chain(&self.pieces).enumerate() {
            (top, bottom) = (top.max(piece.z_from), bottom.min(piece.z_from));
            if !is_down && top - piece.z_from > half {
                (is_down, bottom) = (true, piece.z_from);
                count += usize::from(n >= self.pieces.len());
            } else if is_down && piece.z_from - bottom > half {
                (is_down, top) = (false, piece.z_from);
            }
        }
        count
    }

    /// Scales the heights so that the effective ridge angle becomes `theta_r` (rad, from 0 to π/2);
    /// `None` if no part leans to +v.
    #[must_use]
    pub fn with_ridge_angle(&self, theta_r: f64) -> Option<Self> {
        let mut scaled = self.clone();
        let mut factor = 1.0;
        // The areas that weight the median change slightly with the scale; repeated steps converge.
        for _ in 0..3 {
            factor *= theta_r.tan() / scaled.effective_ridge_angle()?.tan();
            let corners = self.pieces.iter().map(|p| Corner {
                v: p.from,
                z: factor * p.z_from,
                bowed: p.tangents.is_some(),
            });
            scaled = SurfaceProfile::with_bows(&corners.collect::<Vec<_>>(), self.period);
            scaled.turned = self.turned;
            scaled.lobe_error = self.lobe_error;
            scaled.alternative.clone_from(&self.alternative);
        }
        Some(scaled)
    }
}

/// The lowest and the highest of some heights.
pub(in crate::trace) fn lowest_and_highest(heights: impl Iterator<Item = f64>) -> (f64, f64) {
    heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), h| {
        (low.min(h), high.max(h))
    })
}

impl Corner {
    /// Makes a corner between straight pieces.
    #[must_use]
    pub fn sharp((v, z): (f64, f64)) -> Self {
        let bowed = false;
        Corner { v, z, bowed }
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
    fn the_sawtooth_has_the_facets_of_the_drawing() {
        let theta = 0.3f64;
        let profile = SurfaceProfile::sawtooth(theta, 2.0, 0.0).unwrap();
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
    fn rounded_ridges_keep_their_period_and_their_median_angle() {
        let theta = 15f64.to_radians();
        let profile = SurfaceProfile::sawtooth(theta, 10.0, 0.4).unwrap();
        let last = profile.pieces().last().unwrap();
        assert!((last.to - profile.pieces()[0].from - profile.period()).abs() < 1e-12);
        let angle = profile.effective_ridge_angle().unwrap();
        assert!((angle - theta).abs() < 1e-12, "{}", angle.to_degrees());
        assert!(profile.range().1 < 0.0);
        assert!(SurfaceProfile::sawtooth(theta, 10.0, 2.0).is_err());
    }

    #[test]
    fn a_profile_keeps_its_shape_at_another_ridge_angle() {
        let profile = SurfaceProfile::sawtooth(0.2, 10.0, 0.4).unwrap();
        let steeper = profile.with_ridge_angle(0.21).unwrap();
        assert!((steeper.effective_ridge_angle().unwrap() - 0.21).abs() < 1e-12);
        assert_eq!(steeper.pieces().len(), profile.pieces().len());
        let ratio = 0.21f64.tan() / 0.2f64.tan();
        let (low, high) = (profile.range(), steeper.range());
        assert!((high.1 - high.0 - ratio * (low.1 - low.0)).abs() < 1e-12);
    }

    #[test]
    fn a_profile_measured_in_reverse_is_oriented_by_its_facets_lean() {
        let mirrored =
            SurfaceProfile::measured(&[(0.0, 0.0), (3.06, -17.36), (101.54, 0.0)]).unwrap();
        assert!(mirrored.effective_ridge_angle().unwrap() > 1.0);
        let turned = mirrored.facets_to_v();
        let angle = turned.effective_ridge_angle().unwrap().to_degrees();
        assert!((angle - 10.0).abs() < 0.01, "{angle}");
        assert!(turned.is_turned() && (turned.period() - 101.54).abs() < 1e-12);
        assert!(turned.with_ridge_angle(0.2).unwrap().is_turned());
        let sawtooth = SurfaceProfile::sawtooth(0.2, 10.0, 0.4).unwrap();
        assert_eq!(sawtooth.clone().facets_to_v(), sawtooth);
        assert!(!sawtooth.is_turned());
    }

    #[test]
    fn a_measured_profile_is_accepted_or_refused_with_its_row() {
        let good = SurfaceProfile::measured(&[(0.0, 0.0), (9.7, -1.7), (10.0, 0.0)]).unwrap();
        let angle = good.effective_ridge_angle().unwrap();
        assert!((angle.tan() - 1.7 / 9.7).abs() < 1e-12);
        let bad: [(&[(f64, f64)], &str); 6] = [
            (&[], "three rows"),
            (&[(0.0, 0.0), (1.0, 0.0)], "three rows"),
            (&[(0.0, 0.0), (1.0, -1.0), (1.0, 0.0), (2.0, 0.0)], "row 3"),
            (&[(0.0, 0.0), (1.0, f64::NAN), (2.0, 0.0)], "row 2"),
            (&[(0.0, 0.0), (1.0, -1.0), (2.0, -1.0)], "whole periods"),
            (&[(0.0, 0.0), (1.0, 0.0), (2.0, 0.0)], "leans"),
        ];
        for (rows, part) in bad {
            let why = SurfaceProfile::measured(rows).unwrap_err().to_string();
            assert!(why.contains(part), "{rows:?}: {why}");
        }
    }
}
