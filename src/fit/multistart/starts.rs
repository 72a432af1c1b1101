//! Starts of a fit: from the shape of the bright spot, from the brightest poses, and from a scrambled Sobol sequence
//! over the ridge angle, the roughness and the full circle of azimuths.
//!
//! Over the slopes of the half vector in the frame of the sample, the logarithm of a single reflection is a paraboloid.
//! Its top is the facet normal, and its curvatures are the roughnesses. A linear regression on the bright poses gives
//! all four at once, so accurately that most fits need no other start. The other starts cover cases in which the
//! paraboloid is wrong.
//!
//! A lobe that is far narrower than the distance to its peak has no slope to follow, so candidates have broad lobes (α
//! ≥ 0.05) and the solver narrows them. Each candidate is judged after a linear step has set its linear parameters
//! (gain or diffuse part).

use std::f64::consts::PI;

use nalgebra::Vector3;
use sobol_burley::sample;

use super::variable_projection::settle;
use crate::fit::least_squares::{householder, solve_upper};
use crate::fit::problem::{Problem, Values};
use crate::observation::ObservationSet;
use crate::units::Angle;

/// Candidates judged per requested start.
const CANDIDATES_PER_START: u32 = 12;

/// Returns the `count` most promising starts, best first; reproducible for a seed. `fallback` gives the values that no
/// start varies (stray light, tilt zero and fixed values).
#[must_use]
pub fn starts(problem: &Problem<'_>, fallback: &Values, count: usize, seed: u32) -> Vec<Values> {
    let spots = from_bright_spot(problem.set(), fallback);
    let mut candidates = from_brightest(problem.set(), fallback);
    let brightest = candidates.first().copied();
    let wanted = CANDIDATES_PER_START * u32::try_from(count).unwrap_or(u32::MAX);
    for k in 0..wanted {
        let at = |dimension| f64::from(sample(k, dimension, seed));
        let mut values = *fallback;
        // Half of them anywhere; half around the brightest pose, with narrower lobes too.
        if let Some(near) = brightest.filter(|_| k % 2 == 1) {
            values.theta_r = (near.theta_r + (at(0) - 0.5) * 10f64.to_radians()).abs();
            values.azimuth_offset = near.azimuth_offset + (at(3) - 0.5) * 60f64.to_radians();
            values.alpha_u = 0.02 * 15f64.powf(at(1));
            values.alpha_v = 0.02 * 15f64.powf(at(2));
        } else {
            values.theta_r = at(0) * 30f64.to_radians();
            values.azimuth_offset = (at(3) - 0.5) * 2.0 * PI;
            values.alpha_u = 0.05 * 8f64.powf(at(1));
            values.alpha_v = 0.05 * 8f64.powf(at(2));
        }
        candidates.push(values);
    }
    let judge = |candidates: Vec<Values>| {
        let settled = candidates.iter().map(|v| settle(problem, v));
        let mut judged: Vec<(f64, Values)> = settled.filter(|(cost, _)| cost.is_finite()).collect();
        judged.sort_by(|a, b| a.0.total_cmp(&b.0));
        judged
    };
    // The paraboloids come first at any cost: a narrow lobe with a small offset costs more than a broad lobe that is
    // entirely wrong.
    let mut judged = judge(spots);
    judged.truncate(count.div_ceil(2));
    let spots = judged.len();
    judged.extend(judge(candidates));
    let (spots, others) = judged.split_at(spots);
    spread(others, spots, count)
}

/// Returns `count` of the judged candidates, best first and not too close to each other. Those of `first` come first
/// and may be closer.
pub(in crate::fit) fn spread(
    judged: &[(f64, Values)],
    first: &[(f64, Values)],
    count: usize,
) -> Vec<Values> {
    let mut chosen: Vec<Values> = Vec::new();
    for radius in [1.0, 0.3, 0.0] {
        for (k, (_, values)) in first.iter().chain(judged).enumerate() {
            if chosen.len() == count {
                return chosen;
            }
            let radius = if k < first.len() {
                0.1_f64.min(radius)
            } else {
                radius
            };
            if chosen.iter().all(|c| distance(c, values) > radius) {
                chosen.push(*values);
            }
        }
    }
    chosen
}

/// Shares of the range from the dimmest to the brightest signal above which a pose belongs to the bright spot.
const BRIGHT: [f64; 4] = [0.02, 0.1, 0.25, 0.5];

/// Numbers of poses around the brightest one that are tried as the bright spot.
const NEIGHBOURS: [usize; 3] = [6, 9, 14];

/// Fits the paraboloid to the logarithm of the bright spot, for several definitions of bright: all above a share of the
/// range, or the brightest pose with its neighbours (a narrow lobe on a dark ground).
fn from_bright_spot(set: &ObservationSet, fallback: &Values) -> Vec<Values> {
    let signals = || set.observations.iter().map(|o| o.signal);
    let (low, high) = (
        signals().fold(f64::INFINITY, f64::min),
        signals().fold(f64::NEG_INFINITY, f64::max),
    );
    let points: Vec<([f64; 2], f64)> = set
        .observations
        .iter()
        .enumerate()
        .map(|(i, o)| {
            let h = half_vector(set, i, 0.0);
            ([h.x / h.z, h.y / h.z], (o.signal - low) / (high - low))
        })
        .collect();
    let mut spots: Vec<Vec<_>> = BRIGHT
        .iter()
        .map(|share| points.iter().copied().filter(|p| p.1 > *share).collect())
        .collect();
    let mut near: Vec<_> = points.iter().copied().filter(|p| p.1 > 1e-6).collect();
    if let Some((centre, _)) = near.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)) {
        let from = |p: &[f64; 2]| (p[0] - centre[0]).hypot(p[1] - centre[1]);
        near.sort_by(|a, b| from(&a.0).total_cmp(&from(&b.0)));
        spots.extend(
            NEIGHBOURS
                .iter()
                .map(|k| near[..near.len().min(*k)].to_vec()),
        );
    }
    spots
        .iter()
        .filter_map(|spot| paraboloid(spot))
        .map(|top| {
            let mut values = *fallback;
            let [x, y] = top.slopes;
            values.theta_r = x.hypot(y).atan();
            values.azimuth_offset = y.atan2(x);
            values.alpha_v = top.along.clamp(0.01, 1.0);
            values.alpha_u = top.across.clamp(0.01, 1.0);
            values
        })
        .collect()
}

/// Top of a paraboloid, with its widths along the direction of the top and across it.
struct Top {
    slopes: [f64; 2],
    along: f64,
    across: f64,
}

/// Returns the top of the logarithm's paraboloid, which has one width if there are too few points for two; `None` if it has
/// no top.
fn paraboloid(points: &[([f64; 2], f64)]) -> Option<Top> {
    let two_widths = || {
        let [_, x, y, xx, xy, yy] = regression(points, |x, y| [1.0, x, y, x * x, x * y, y * y])?;
        top([x, y], [xx, xy, yy])
    };
    let one_width = || {
        let [_, x, y, q] = regression(points, |x, y| [1.0, x, y, x * x + y * y])?;
        top([x, y], [q, 0.0, q])
    };
    two_widths().or_else(one_width)
}

/// Weighted regression of the logarithm on some terms of the slopes.
fn regression<const N: usize>(
    points: &[([f64; 2], f64)],
    terms: impl Fn(f64, f64) -> [f64; N],
) -> Option<[f64; N]> {
    let m = points.len();
    if m < N {
        return None;
    }
    let (mut a, mut b) = (vec![0.0; N * m], vec![0.0; m]);
    for (i, ([x, y], value)) in points.iter().enumerate() {
        // A relative error of the value is an absolute error of its logarithm; bright values count most.
        for (j, term) in terms(*x, *y).into_iter().enumerate() {
            a[i + j * m] = value * term;
        }
        b[i] = value * value.ln();
    }
    householder(&mut a, m, N, &mut b);
    solve_upper(&a, m, N, &mut b)
        .then(|| b.first_chunk().copied())
        .flatten()
}

/// Returns the top of … + b·s + sᵀ Q s with Q = [[qxx, qxy/2], [qxy/2, qyy]], which is at −Q⁻¹ b/2.
fn top([bx, by]: [f64; 2], [qxx, qxy, qyy]: [f64; 3]) -> Option<Top> {
    let determinant = qxx * qyy - 0.25 * qxy * qxy;
    if !(qxx < 0.0 && determinant > 0.0) {
        return None;
    }
    let x = -0.5 * (qyy * bx - 0.5 * qxy * by) / determinant;
    let y = -0.5 * (qxx * by - 0.5 * qxy * bx) / determinant;
    let size = x.hypot(y);
    if !(size.is_finite() && size < 2.0) {
        return None;
    }
    let (c, s) = if size > 0.0 {
        (x / size, y / size)
    } else {
        (1.0, 0.0)
    };
    let curvature = |c: f64, s: f64| -(qxx * c * c + qxy * c * s + qyy * s * s);
    Some(Top {
        slopes: [x, y],
        along: 1.0 / curvature(c, s).sqrt(),
        across: 1.0 / curvature(-s, c).sqrt(),
    })
}

/// At the brightest pose the half vector is close to the facet normal.
fn from_brightest(set: &ObservationSet, fallback: &Values) -> Vec<Values> {
    let mut order: Vec<usize> = (0..set.observations.len()).collect();
    order.sort_by(|a, b| {
        let signal = |i: &usize| set.observations[*i].signal;
        signal(b).total_cmp(&signal(a))
    });
    let mut found = Vec::new();
    for &i in order.iter().take(3) {
        let (theta_r, azimuth) = facing_normal(set, i, fallback.tilt_offset);
        for (alpha_u, alpha_v) in [
            (0.08, 0.08),
            (0.2, 0.2),
            (0.05, 0.2),
            (0.2, 0.05),
            (0.04, 0.04),
        ] {
            let mut values = *fallback;
            values.theta_r = theta_r;
            values.alpha_u = alpha_u;
            values.alpha_v = alpha_v;
            values.azimuth_offset = azimuth;
            found.push(values.folded());
        }
    }
    found
}

/// Returns ridge angle and azimuth offset for which the facet normal is the half vector of an observation, with the
/// tilt zero `tilt`.
fn facing_normal(set: &ObservationSet, index: usize, tilt: f64) -> (f64, f64) {
    let h = half_vector(set, index, tilt);
    (h.z.clamp(-1.0, 1.0).acos(), h.y.atan2(h.x))
}

/// Returns the half vector of an observation, with the tilt zero `tilt`, in the frame of the sample for an azimuth
/// offset of 0: x along v, which leans to where the facet normal points.
fn half_vector(set: &ObservationSet, index: usize, tilt: f64) -> Vector3<f64> {
    let pose = set.observations[index].pose;
    let rig = set.rig_directions(index).tilted(Angle::from_rad(tilt));
    let h = (rig.incident + rig.outgoing).normalize();
    let (s, c) = (pose.phi_s + set.rig.azimuth_zero + set.region_azimuth).sin_cos();
    Vector3::new(h.x * c + h.y * s, h.y * c - h.x * s, h.z)
}

/// Distance above which two ends are different surfaces (see [`distance`]).
pub(in crate::fit) const APART: f64 = 0.3;
/// Distance below which two ends lead to the same minimum.
pub(in crate::fit) const SAME_SPOT: f64 = 0.05;
/// Smallest distance between two surfaces that a report distinguishes: 0.05°, 0.7 % of α.
pub(in crate::fit) const ONE_SURFACE: f64 = 0.01;

/// Distance between two starts, in units that a descent bridges easily.
pub(in crate::fit) fn distance(a: &Values, b: &Values) -> f64 {
    let lean = |v: &Values| {
        let (s, c) = v.azimuth_offset.sin_cos();
        (v.theta_r.sin() * c, v.theta_r.sin() * s)
    };
    let ((ax, ay), (bx, by)) = (lean(a), lean(b));
    let apart = (ax - bx).hypot(ay - by) / 0.08;
    let rougher = (a.alpha_u / b.alpha_u)
        .ln()
        .hypot((a.alpha_v / b.alpha_v).ln())
        / 0.7;
    let tilted = (a.tilt_offset - b.tilt_offset) / 0.08;
    apart.hypot(rougher).hypot(tilted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::painted::{TRUTH, painted};
    use crate::geometry::Pose;

    #[test]
    fn the_top_and_widths_of_an_exact_paraboloid_are_recovered() {
        // Top at slope 0.2 in the direction of 30°, width 0.1 along it and 0.06 across.
        let (s, c) = 30f64.to_radians().sin_cos();
        let mut points = Vec::new();
        for i in 0..5 {
            for j in 0..5 {
                let (x, y) = (0.07 * f64::from(i), 0.06 * f64::from(j) - 0.05);
                let along = (x * c + y * s - 0.2) / 0.1;
                let across = (y * c - x * s) / 0.06;
                points.push(([x, y], (-along * along - across * across).exp()));
            }
        }
        let top = paraboloid(&points).expect("a top");
        assert!((top.slopes[0] - 0.2 * c).abs() < 1e-9 && (top.slopes[1] - 0.2 * s).abs() < 1e-9);
        assert!((top.along - 0.1).abs() < 1e-9 && (top.across - 0.06).abs() < 1e-9);
    }

    #[test]
    fn points_without_a_top_give_no_start() {
        let points: Vec<_> = (0..9)
            .map(|k| {
                let (x, y) = (0.1 * f64::from(k % 3), 0.1 * f64::from(k / 3));
                ([x, y], (x * x + y * y).exp())
            })
            .collect();
        assert!(paraboloid(&points).is_none());
    }

    #[test]
    fn a_facet_that_faces_a_pose_has_its_normal_in_the_half_vector() {
        let poses = (0..40).map(|k| (10 * (k % 5) - 20, 45 * (k / 5)));
        let poses = poses.map(|(tilt, turn)| Pose::from_deg(f64::from(tilt), f64::from(turn)));
        let set = painted(poses, &TRUTH, 1e-3, 1);
        for index in [0, 7, 22] {
            let (theta_r, azimuth) = facing_normal(&set, index, 0.05);
            let mut pose = set.observations[index].pose;
            pose.theta_c += Angle::from_rad(0.05);
            pose.phi_s += Angle::from_rad(azimuth);
            let d = set.rig.directions(pose);
            let h = (d.incident + d.outgoing).normalize();
            let (s, c) = theta_r.sin_cos();
            assert!((h - Vector3::new(0.0, s, c)).norm() < 1e-12);
        }
    }
}
