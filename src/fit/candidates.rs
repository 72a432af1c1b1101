//! Candidates for a thorough search: shapes from the whole box, shapes whose facets face one or two bright poses, and
//! for the most promising of them the best roughnesses.
//!
//! A lobe that is narrower than the distance between poses appears in one or two poses, and no slope leads there. But a
//! pose that is much brighter than the others has its half vector near the facet normal, so for every tilt zero it
//! gives the ridge angle and the azimuth. Two such poses give them for a lobe that is narrow along one axis only. The
//! roughnesses and the place inside the lobe remain to be drawn. No pose meets other lobes. Then only the diffuse light
//! shows where the ridges lean, and any lobe out of sight will do.
//!
//! Call [`starts`]; [`rougher`] tries other roughnesses for an end. If noise creates the minima and selection does not
//! help, [`plain`] and [`rim`] give unselected shapes, and [`bred`] combines known ends. Every shape is judged with its
//! best amplitudes ([`settle`]).

use std::f64::consts::PI;

use nalgebra::Vector3;
use rayon::prelude::*;
use sobol_burley::sample;

use super::problem::{
    ALPHA_MAX, ALPHA_MIN, Problem, Quantity, THETA_R_MAX, TILT_OFFSET_MAX, Values,
};
use super::projection::settle;
use super::start::{distance, spread};
use crate::observation::ObservationSet;
use crate::units::Angle;

/// Shapes drawn.
pub(super) const POOL: u32 = 512;
/// Roughnesses tried along each axis, from the smoothest facet to 1.
pub(super) const SCAN: u32 = 8;
/// Bright poses that facets are turned to.
const ANCHORS: usize = 16;
/// Smoothest of the facets that are rough along both axes; and the range of the azimuth for the others (rad).
const RIM_SMOOTHEST: f64 = 0.1;
const RIM_TURN: f64 = 30.0 * PI / 180.0;
/// Share of a child's values that come from its other parent, and from anywhere.
const FROM_OTHER: f64 = 0.25;
const FROM_ANYWHERE: f64 = 0.2;
/// Range of the other values around the first parent: tilts, azimuth (rad), logarithm of the roughnesses.
const NEAR_LEAN: f64 = 0.01;
const NEAR_TURN: f64 = 0.02;
const NEAR_ROUGHNESS: f64 = 0.1;
/// Half-widths of the lobe within which a bright pose may miss its top.
const OFF_TOP: f64 = 1.2;

/// Number of candidates that a round requests.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wanted {
    /// Promising shapes whose roughnesses are scanned.
    pub scanned: usize,
    /// Shapes that are returned.
    pub starts: usize,
    pub seed: u32,
}

/// Returns the most promising shapes, best first and not too close to each other. With a centre, half of the pool is
/// drawn around it.
pub(super) fn starts(
    problem: &Problem<'_>,
    fallback: &Values,
    centre: Option<&Values>,
    wanted: Wanted,
) -> Vec<Values> {
    let anchors = anchors(problem, centre);
    let settled = |v: &Values| Some(settle(problem, v)).filter(|(cost, _)| cost.is_finite());
    let mut judged: Vec<(f64, Values)> = (0..POOL)
        .into_par_iter()
        .filter_map(|k| {
            let at = |dimension| f64::from(sample(k, dimension, wanted.seed));
            let v = match (k % 4, centre) {
                (0, _) if !anchors.is_empty() => facing(problem.set(), fallback, &anchors, &at),
                (1, _) if anchors.len() > 1 => stripe(problem.set(), fallback, &anchors, &at),
                (_, Some(c)) => around(c, fallback, &at),
                _ => anywhere(fallback, k, &at),
            };
            settled(&v)
        })
        .collect();
    judged.sort_by(|a, b| a.0.total_cmp(&b.0));
    let promising = spread(&judged, &[], wanted.scanned);
    judged.par_extend(
        promising
            .par_iter()
            .flat_map_iter(|v| scan(problem, v).into_iter().take(2)),
    );
    judged.sort_by(|a, b| a.0.total_cmp(&b.0));
    spread(&judged, &[], wanted.starts)
}

/// Returns unselected shapes from the whole box, with medium diffuse parts and the gain that is right on average.
pub(super) fn plain(
    problem: &Problem<'_>,
    fallback: &Values,
    count: u32,
    seed: u32,
) -> Vec<Values> {
    let evened = Evened::new(problem, fallback);
    let shape = |k: u32| {
        let at = |dimension| f64::from(sample(k, dimension, seed));
        let mut v = anywhere(fallback, k, &at);
        let span = |dimension, half_deg: f64| (at(dimension) - 0.5) * 2.0 * half_deg.to_radians();
        // If there are many minima, those of a properly mounted sample come first.
        if !k.is_multiple_of(6) {
            v.azimuth_offset = span(1, 11.0);
        }
        v.tilt_offset = span(2, 11.0);
        evened.with_amplitudes(v, at(5))
    };
    (0..count).map(shape).collect()
}

/// Returns the same from the rim of the box: the steepest and roughest facets that a fit considers, and the largest
/// offsets. The minima of a lobe so broad that it fills the rig are there.
pub(super) fn rim(problem: &Problem<'_>, fallback: &Values, count: u32, seed: u32) -> Vec<Values> {
    let evened = Evened::new(problem, fallback);
    let shape = |k: u32| {
        let at = |dimension| f64::from(sample(k, dimension, seed));
        // Halves of a Sobol sequence are uniform in all dimensions; every second point is not.
        let (smoothest, turn): (f64, f64) = if k < count / 2 {
            (RIM_SMOOTHEST, PI)
        } else {
            (ALPHA_MIN, RIM_TURN)
        };
        let alpha = |share: f64| smoothest * (ALPHA_MAX / smoothest).powf(share);
        let v = Values {
            theta_r: at(0) * THETA_R_MAX,
            azimuth_offset: both_ways(at(1)) * turn,
            tilt_offset: both_ways(at(2)) * TILT_OFFSET_MAX,
            alpha_u: alpha(at(3)),
            alpha_v: alpha(at(4)),
            ..*fallback
        };
        evened.with_amplitudes(v, at(5))
    };
    (0..count).map(shape).collect()
}

/// Returns children of ends; the best ends come first and have most of them. Each child takes its shape from one end,
/// some values from another, and some from anywhere. Deep minima of few observations partly resemble each other: one
/// has the roughness and tilt that suit one observation, another has the azimuth that suits the next.
pub(super) fn bred(parents: &[Values], count: u32, seed: u32) -> Vec<Values> {
    let child = |k: u32| -> Option<Values> {
        let at = |dimension| f64::from(sample(k, dimension, seed));
        let parent = |share: f64| parents.get((share * share * parents.len() as f64) as usize);
        let (one, other) = (parent(at(0))?, parent(at(1))?);
        // The number selects the origin of a value; its remainder is as uniform as the number itself.
        let part = |dimension, of: &dyn Fn(&Values) -> f64, range: (f64, f64), near: f64| {
            let left = at(dimension);
            if left < FROM_OTHER {
                return of(other);
            }
            let left = left - FROM_OTHER;
            if left < FROM_ANYWHERE {
                return range.0 + (range.1 - range.0) * left / FROM_ANYWHERE;
            }
            let share = (left - FROM_ANYWHERE) / (1.0 - FROM_OTHER - FROM_ANYWHERE);
            of(one) + near * both_ways(share)
        };
        let rough = (ALPHA_MIN.ln(), ALPHA_MAX.ln());
        let tilts = (-TILT_OFFSET_MAX, TILT_OFFSET_MAX);
        Some(Values {
            theta_r: part(2, &|v| v.theta_r, (0.0, THETA_R_MAX), NEAR_LEAN),
            alpha_u: part(3, &|v| v.alpha_u.ln(), rough, NEAR_ROUGHNESS).exp(),
            alpha_v: part(4, &|v| v.alpha_v.ln(), rough, NEAR_ROUGHNESS).exp(),
            azimuth_offset: part(5, &|v| v.azimuth_offset, (-PI, PI), NEAR_TURN),
            tilt_offset: part(6, &|v| v.tilt_offset, tilts, NEAR_LEAN),
            ..*one
        })
    };
    (0..count).filter_map(child).collect()
}

/// Maps 0 … 1 to −1 … 1.
fn both_ways(share: f64) -> f64 {
    2.0 * share - 1.0
}

/// Sets amplitudes of unselected shapes that are right on average.
struct Evened<'p, 'a> {
    problem: &'p Problem<'a>,
    background: f64,
    signal: f64,
}

impl<'p, 'a> Evened<'p, 'a> {
    fn new(problem: &'p Problem<'a>, fallback: &Values) -> Self {
        let signal = problem.set().observations.iter().map(|o| o.signal).sum();
        let evened = Evened {
            problem,
            background: fallback.background,
            signal: 0.0,
        };
        let signal = evened.over(signal);
        Evened { signal, ..evened }
    }

    /// Subtracts the stray light, which no gain multiplies.
    fn over(&self, sum: f64) -> f64 {
        sum - self.background * self.problem.set().observations.len() as f64
    }

    fn with_amplitudes(&self, mut v: Values, share: f64) -> Values {
        let free = |quantity| self.problem.free().contains(&quantity);
        if free(Quantity::RhoD) {
            v.rho_d = 0.8 * share;
        }
        if free(Quantity::Scale) {
            let factor = self.signal / self.over(self.problem.predicted(&v).iter().sum());
            if factor.is_finite() && factor > 0.0 {
                v.scale *= factor;
            }
        }
        v
    }
}

/// Returns up to `count` other roughnesses for the shape of an end, the most promising first.
pub(super) fn rougher(problem: &Problem<'_>, end: &Values, count: usize) -> Vec<Values> {
    let others: Vec<(f64, Values)> = scan(problem, end)
        .into_iter()
        .filter(|(_, v)| distance(v, end) > 1.0)
        .collect();
    spread(&others, &[], count)
}

/// Returns a shape with every pair of roughnesses, the most promising first.
fn scan(problem: &Problem<'_>, shape: &Values) -> Vec<(f64, Values)> {
    let alpha = |k: u32| ALPHA_MIN.powf(1.0 - f64::from(k) / f64::from(SCAN - 1));
    let mut judged: Vec<(f64, Values)> = (0..SCAN * SCAN)
        .map(|k| Values {
            alpha_u: alpha(k / SCAN),
            alpha_v: alpha(k % SCAN),
            ..*shape
        })
        .map(|v| settle(problem, &v))
        .filter(|(cost, _)| cost.is_finite())
        .collect();
    judged.sort_by(|a, b| a.0.total_cmp(&b.0));
    judged
}

/// Roughnesses from the smoothest that a fit considers to 1.
fn roughness(share: f64) -> f64 {
    ALPHA_MIN.powf(1.0 - share)
}

/// Most samples are mounted within a few degrees of the nominal position, so two of three have small offsets.
fn anywhere(fallback: &Values, k: u32, at: &dyn Fn(u32) -> f64) -> Values {
    let near = !k.is_multiple_of(3);
    let span = |dimension, half_deg: f64| (at(dimension) - 0.5) * 2.0 * half_deg.to_radians();
    Values {
        theta_r: at(0) * 62f64.to_radians(),
        azimuth_offset: span(1, if near { 15.0 } else { 180.0 }),
        tilt_offset: span(2, if near { 4.0 } else { 12.0 }),
        alpha_u: roughness(at(3)),
        alpha_v: roughness(at(4)),
        ..*fallback
    }
}

fn around(centre: &Values, fallback: &Values, at: &dyn Fn(u32) -> f64) -> Values {
    let span = |dimension, half_deg: f64| (at(dimension) - 0.5) * 2.0 * half_deg.to_radians();
    Values {
        theta_r: centre.theta_r + span(0, 4.0),
        azimuth_offset: centre.azimuth_offset + span(1, 8.0),
        tilt_offset: centre.tilt_offset + span(2, 2.0),
        alpha_u: roughness(at(3)),
        alpha_v: roughness(at(4)),
        ..*fallback
    }
}

/// Turns facets so that a bright pose sees their lobe.
fn facing(
    set: &ObservationSet,
    fallback: &Values,
    anchors: &[usize],
    at: &dyn Fn(u32) -> f64,
) -> Values {
    let tilt = tilt(at);
    let (alpha_u, alpha_v) = (roughness(at(3)), roughness(at(4)));
    let (theta_r, azimuth) = facing_normal(set, one_of(anchors, at(5) * at(6)), tilt);
    let across = off_top(set, alpha_u, at(0)) / theta_r.sin().max(0.02);
    Values {
        theta_r: theta_r + off_top(set, alpha_v, at(1)),
        azimuth_offset: azimuth + across.clamp(-PI, PI),
        tilt_offset: tilt,
        alpha_u,
        alpha_v,
        ..*fallback
    }
    .folded()
}

/// Lays a lobe that is narrow along v and wide along u through two bright poses.
fn stripe(
    set: &ObservationSet,
    fallback: &Values,
    anchors: &[usize],
    at: &dyn Fn(u32) -> f64,
) -> Values {
    let tilt = tilt(at);
    let first = one_of(anchors, at(5) * at(6));
    let second = one_of(anchors, at(0));
    let both = half_vector(set, first, tilt).cross(&half_vector(set, second, tilt));
    // The upward axis of the facets is perpendicular to both half vectors; u is horizontal.
    let level = both.x.hypot(both.y);
    let (axis, level) = if both.z <= 0.0 {
        (both, level)
    } else {
        (-both, level)
    };
    if level < 1e-6 {
        return facing(set, fallback, anchors, at);
    }
    let alpha_v = roughness(at(4));
    Values {
        theta_r: (-axis.z).atan2(level) + off_top(set, alpha_v, at(1)),
        azimuth_offset: axis.y.atan2(axis.x),
        tilt_offset: tilt,
        alpha_u: roughness(0.5 + 0.5 * at(3)),
        alpha_v,
        ..*fallback
    }
    .folded()
}

/// The first anchors are the brightest and most likely in the lobe.
fn one_of(anchors: &[usize], share: f64) -> usize {
    anchors[(share * anchors.len() as f64) as usize]
}

/// Zeros of the tilt stage, small ones more often.
fn tilt(at: &dyn Fn(u32) -> f64) -> f64 {
    (at(2) - 0.5) * 2.0 * 12f64.to_radians() * at(7)
}

/// Distance of a bright pose from the top of the lobe, as a slope.
fn off_top(set: &ObservationSet, alpha: f64, share: f64) -> f64 {
    (alpha * alpha + set.rig.cones.widening()).sqrt().min(0.5) * OFF_TOP * (2.0 * share - 1.0)
}

/// Returns ridge angle and azimuth offset for which the facet normal is the half vector of an observation, with the
/// tilt zero `tilt`.
pub(super) fn facing_normal(set: &ObservationSet, index: usize, tilt: f64) -> (f64, f64) {
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

/// Returns alternately the brightest poses and those that are brighter than an end so far expects.
fn anchors(problem: &Problem<'_>, centre: Option<&Values>) -> Vec<usize> {
    let observations = &problem.set().observations;
    let ranked = |excess: Vec<f64>| {
        let mut order: Vec<usize> = (0..excess.len()).collect();
        order.sort_by(|a, b| excess[*b].total_cmp(&excess[*a]));
        order
    };
    let mut bright = ranked(observations.iter().map(|o| o.signal).collect());
    let Some(centre) = centre else {
        bright.truncate(ANCHORS);
        return bright;
    };
    let expected = problem.predicted(centre);
    let left = observations
        .iter()
        .zip(expected)
        .zip(problem.sigma())
        .map(|((o, e), s)| (o.signal - e) / s);
    let missed = ranked(left.collect());
    let pairs = missed.into_iter().zip(bright);
    let mut both: Vec<usize> = Vec::new();
    for index in pairs.flat_map(|(a, b)| [a, b]) {
        if !both.contains(&index) && both.len() < ANCHORS {
            both.push(index);
        }
    }
    both
}

#[cfg(test)]
#[path = "candidates_tests.rs"]
mod tests;
