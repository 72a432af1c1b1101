//! Derivatives of radiances with respect to the angles of the pose.
//!
//! They turn stage errors into errors of a contrast. A fitted model gives them. Without one, they are
//! those of the polynomial through a pose and its two neighbours. Their uncertainty comes from
//! the polynomial through four neighbours: the two disagree on a lobe that the poses do not resolve. At an end of
//! the range, two and three neighbours on one side are used.
//!
//! *Conditioning.* Nodes closer than [`SEPARATE`] are merged, so no weight exceeds a few over that.

use super::compared_tilts::{SAME_ANGLE, SAME_TILT};
use crate::geometry::{Pose, group_angles};
use crate::units::Angle;

/// Neighbours farther away in tilt do not determine a slope.
pub(super) const TILT_REACH: Angle = Angle::from_deg(15.0);
/// The same limit in azimuth, where a lobe is wider by about 1/tan θr.
const AZIMUTH_REACH: Angle = Angle::from_deg(45.0);
/// Neighbours closer than this are repeats of the pose.
pub(super) const SEPARATE: Angle = Angle::from_deg(0.5);

/// A derivative of a radiance, per radian.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadianceSlope {
    /// The derivative.
    pub value: f64,
    /// Its standard uncertainty.
    pub std: f64,
}

/// Slopes of all observations; `None` where the poses do not determine them.
#[derive(Debug, Clone, PartialEq)]
pub struct RadianceSlopes {
    /// ∂L/∂θc.
    pub theta_c: Vec<Option<RadianceSlope>>,
    /// ∂L/∂φs.
    pub phi_s: Vec<Option<RadianceSlope>>,
}

impl RadianceSlopes {
    /// Estimates them from the radiances of neighbouring poses.
    #[must_use]
    pub fn of_neighbours(poses: &[Pose], radiances: &[f64]) -> Self {
        let tilts: Vec<Angle> = poses.iter().map(|p| p.theta_c).collect();
        let tilts = group_angles(&tilts, SAME_TILT);
        let each = |reach: Angle, away: &dyn Fn(usize, usize) -> Option<Angle>| {
            let of = |n: usize| {
                let others = (0..poses.len()).filter_map(|m| {
                    let away = away(n, m)?;
                    (away.abs() <= reach * 3.0).then_some((away.rad(), radiances[m]))
                });
                slope(radiances[n], others.collect(), reach.rad())
            };
            (0..poses.len()).map(of).collect()
        };
        let turned = |n: usize, m: usize| (poses[m].phi_s - poses[n].phi_s).wrapped();
        RadianceSlopes {
            theta_c: each(TILT_REACH, &|n, m| {
                (turned(n, m).abs() <= SEPARATE).then(|| poses[m].theta_c - poses[n].theta_c)
            }),
            phi_s: each(AZIMUTH_REACH, &|n, m| {
                (tilts[n] == tilts[m]).then(|| turned(n, m))
            }),
        }
    }
}

/// The slope at 0, where the value is `here`, from other points (place, value).
fn slope(here: f64, mut others: Vec<(f64, f64)>, reach: f64) -> Option<RadianceSlope> {
    others.retain(|(x, _)| x.abs() > SEPARATE.rad());
    others.sort_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
    // At most three on each side, each within reach of the one before.
    let side = |sign: f64| {
        let mut kept: Vec<(f64, f64)> = Vec::new();
        for (x, y) in others.iter().filter(|(x, _)| x * sign > 0.0) {
            let last = kept.last().map_or(0.0, |l| l.0);
            if kept.len() < 3 && (x - last).abs() > SEPARATE.rad() && (x - last).abs() <= reach {
                kept.push((*x, *y));
            }
        }
        kept
    };
    let (below, above) = (side(-1.0), side(1.0));
    let first = |n: usize| -> Vec<(f64, f64)> {
        let (below, above) = (below.iter().take(n), above.iter().take(n));
        below.chain(above).copied().collect()
    };
    // One and two on either side; at an end, two and three on the one side.
    let (near, wide) = match (below.is_empty(), above.is_empty()) {
        (true, true) => return None,
        (false, false) => (first(1), first(2)),
        _ => (first(2), first(3)),
    };
    let value = derivative(here, &near);
    let std = if wide.len() > near.len() {
        // Higher orders may change it as much again as the next order does.
        2.0 * (derivative(here, &wide) - value).abs()
    } else if near.len() == 2 {
        (derivative(here, &near[..1]) - value).abs()
    } else {
        value.abs()
    };
    Some(RadianceSlope { value, std })
}

/// Derivative at 0 of the polynomial through (0, here) and others.
fn derivative(here: f64, others: &[(f64, f64)]) -> f64 {
    let of = |(k, (x, y)): (usize, &(f64, f64))| {
        let rest = others.iter().enumerate().filter(|(m, _)| *m != k);
        let basis: f64 = rest.map(|(_, (other, _))| other / (other - x)).product();
        (y - here) / x * basis
    };
    others.iter().enumerate().map(of).sum()
}

/// A difference between recorded and nominal angle, 0 where the two count as equal.
pub(super) fn beyond_the_same(off: Angle) -> Angle {
    if off.abs() > SAME_ANGLE {
        off
    } else {
        Angle::ZERO
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(tilts: &[f64], of: impl Fn(f64) -> f64) -> RadianceSlopes {
        let poses: Vec<Pose> = tilts.iter().map(|t| Pose::from_deg(*t, 0.0)).collect();
        let values: Vec<f64> = poses.iter().map(|p| of(p.theta_c.rad())).collect();
        RadianceSlopes::of_neighbours(&poses, &values)
    }

    #[test]
    fn a_parabola_has_its_own_slope_whatever_the_spacing() {
        let tilts = [-10.0_f64, -4.0, 0.0, 5.0, 12.0];
        let slopes = at(&tilts, |x| 1.0 + 2.0 * x - 3.0 * x * x);
        for (slope, tilt_deg) in slopes.theta_c.iter().zip(tilts) {
            let slope = slope.unwrap();
            let expected = 2.0 - 6.0 * tilt_deg.to_radians();
            assert!(
                (slope.value - expected).abs() < 1e-12,
                "{slope:?} {expected}"
            );
            assert!(slope.std < 1e-11, "{slope:?}");
        }
        assert_eq!(slopes.phi_s, [None; 5]);
    }

    #[test]
    fn a_lobe_that_poses_hardly_resolve_makes_its_slope_uncertain() {
        let width = 5.0_f64.to_radians();
        let lobe = |x: f64| (-(x / width).powi(2)).exp();
        let tilts: Vec<f64> = (-6..=6).map(|n| 5.0 * f64::from(n) + 2.0).collect();
        let slopes = at(&tilts, lobe);
        for (slope, tilt) in slopes.theta_c.iter().zip(&tilts).skip(2).take(9) {
            let (slope, x) = (slope.unwrap(), tilt.to_radians());
            let truth = -2.0 * x / (width * width) * lobe(x);
            // Within three standard uncertainties, or negligible beside the steepest slope (0.86 / width).
            let off = (slope.value - truth).abs();
            assert!(
                off < 3.0 * slope.std + 0.01 / width,
                "{tilt}: {slope:?} {truth}"
            );
        }
    }

    #[test]
    fn without_a_neighbour_in_reach_there_is_no_slope() {
        let far = at(&[-20.0, 0.0, 0.1, 20.0], |x| x);
        assert_eq!(far.theta_c, [None; 4]);
        // With one neighbour, the uncertainty equals the slope.
        let one = at(&[0.0, 10.0], |x| 3.0 * x).theta_c[0].unwrap();
        assert!((one.value - 3.0).abs() < 1e-12 && (one.std - 3.0).abs() < 1e-12);
    }

    #[test]
    fn azimuths_are_neighbours_across_360_degrees() {
        let azimuths: Vec<f64> = (0..12).map(|n| 30.0 * f64::from(n)).collect();
        let poses: Vec<Pose> = azimuths.iter().map(|a| Pose::from_deg(5.0, *a)).collect();
        let values: Vec<f64> = poses.iter().map(|p| p.phi_s.rad().sin()).collect();
        let slopes = RadianceSlopes::of_neighbours(&poses, &values);
        for (slope, azimuth) in slopes.phi_s.iter().zip(&azimuths) {
            let (slope, truth) = (slope.unwrap(), azimuth.to_radians().cos());
            assert!(
                (slope.value - truth).abs() < 1.1 * slope.std + 1e-9,
                "{slope:?} {truth}"
            );
        }
        assert_eq!(slopes.theta_c, [None; 12]);
    }
}
