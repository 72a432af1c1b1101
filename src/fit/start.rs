//! Where a fit starts: from the brightest pose, and from a scrambled Sobol set over the ridge angle,
//! the roughness and the whole circle of azimuths.
//!
//! A lobe that is far narrower than the distance to its peak has no slope to follow, so candidates
//! have broad lobes (α ≥ 0.05) and the solver narrows them. Each candidate is judged after its
//! linear parameters (gain or diffuse part) were set by a linear step.

use std::f64::consts::PI;

use sobol_burley::sample;

use super::least_squares::LeastSquares;
use super::problem::{Problem, Quantity, Values};
use crate::geometry::Pose;
use crate::observation::ObservationSet;

/// Candidates judged per requested start.
const CANDIDATES_PER_START: u32 = 12;

/// The `count` most promising starts, best first; reproducible for a seed. `fallback` gives what no
/// start varies (stray light, tilt zero and what is fixed).
#[must_use]
pub fn starts(problem: &Problem<'_>, fallback: &Values, count: usize, seed: u32) -> Vec<Values> {
    let mut candidates = from_brightest(problem.set(), fallback);
    let wanted = CANDIDATES_PER_START * u32::try_from(count).unwrap_or(u32::MAX);
    for k in 0..wanted {
        let at = |dimension| f64::from(sample(k, dimension, seed));
        let mut values = *fallback;
        values.theta_r = at(0) * 30f64.to_radians();
        values.alpha_u = 0.05 * 8f64.powf(at(1));
        values.alpha_v = 0.05 * 8f64.powf(at(2));
        values.azimuth_offset = (at(3) - 0.5) * 2.0 * PI;
        candidates.push(values);
    }
    let mut judged: Vec<(f64, Values)> = candidates
        .into_iter()
        .map(|values| settle_linear(problem, values))
        .filter(|(cost, _)| cost.is_finite())
        .collect();
    judged.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut chosen: Vec<Values> = Vec::new();
    for radius in [1.0, 0.3, 0.0] {
        for (_, values) in &judged {
            if chosen.len() == count {
                return chosen;
            }
            if chosen.iter().all(|c| distance(c, values) > radius) {
                chosen.push(*values);
            }
        }
    }
    chosen
}

/// At the brightest pose the half vector is close to the facet's normal.
fn from_brightest(set: &ObservationSet, fallback: &Values) -> Vec<Values> {
    let mut order: Vec<usize> = (0..set.observations.len()).collect();
    order.sort_by(|a, b| {
        let signal = |i: &usize| set.observations[*i].signal;
        signal(b).total_cmp(&signal(a))
    });
    let mut found = Vec::new();
    for &i in order.iter().take(3) {
        let Pose { theta_c, phi_s } = set.observations[i].pose;
        let rig = set.rig.rig_directions(theta_c);
        let h = (rig.incident + rig.outgoing).normalize();
        // v stands at azimuth φs + zero + Δφ in the rig's frame; the facet leans to where h points.
        let lean = h.y.atan2(h.x);
        let azimuth = lean - (phi_s + set.rig.azimuth_zero + set.region_azimuth).rad();
        for alpha in [0.08, 0.2] {
            let mut values = *fallback;
            values.theta_r = h.z.clamp(-1.0, 1.0).acos();
            values.alpha_u = alpha;
            values.alpha_v = alpha;
            values.azimuth_offset = azimuth;
            found.push(values.folded());
        }
    }
    found
}

/// Sets gain (where only the samples carry it) or diffuse part by one linear step on the samples;
/// returns the cost after it.
fn settle_linear(problem: &Problem<'_>, mut values: Values) -> (f64, Values) {
    let linear = if problem.set().flats.is_empty() && problem.free().contains(&Quantity::Scale) {
        Some(Quantity::Scale)
    } else if problem.free().contains(&Quantity::RhoD) {
        Some(Quantity::RhoD)
    } else {
        None
    };
    let bounds = problem.bounds();
    let (n, m) = (problem.n_parameters(), problem.n_residuals());
    let mut r = vec![0.0; m];
    let mut j = vec![0.0; m * n];
    if let Some(k) = linear.and_then(|q| problem.free().iter().position(|f| *f == q)) {
        let mut x = problem.pack(&values);
        problem.evaluate(&x, &mut r, &mut j);
        let column = &j[k * m..(k + 1) * m];
        let (mut top, mut bottom) = (0.0, 0.0);
        for (c, r) in column.iter().zip(&r) {
            top += c * r;
            bottom += c * c;
        }
        if bottom > 0.0 {
            x[k] = (x[k] - top / bottom).clamp(bounds.lower[k], bounds.upper[k]);
            let predicted = r.iter().zip(column).map(|(r, c)| r - c * top / bottom);
            let cost = predicted.map(|v| v * v).sum();
            values = problem.unpack(&x);
            return (cost, values);
        }
    }
    problem.evaluate(&problem.pack(&values), &mut r, &mut j);
    (r.iter().map(|v| v * v).sum(), values)
}

/// How different two starts are, in units of what a descent bridges easily.
fn distance(a: &Values, b: &Values) -> f64 {
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
    apart.hypot(rougher)
}
