//! Errors that observations share: their changes of the weighted residuals, and how the parts of several scans add up.

use std::f64::consts::PI;

use super::Part;
use crate::fit::causes::lamp_drift::Drift;
use crate::fit::estimate::Estimate;
use crate::fit::known::{drift_std, reference_std};
use crate::fit::problem::{Problem, Quantity, Values};
use crate::geometry::turn_by_wedge;
use crate::material::Material;
use crate::model::Variant;
use crate::observation::ObservationSet;
use crate::units::Angle;

/// Changes of the weighted residuals by sources that all observations share.
pub(super) struct Shared {
    /// Per unit of the gain of the samples relative to the flats.
    pub(super) gain: Vec<f64>,
    /// Per standard uncertainty of the camera's non-linearity.
    pub(super) detector: Vec<f64>,
    /// Per standard uncertainty of an angle: zero of the tilt, its scale, zero of the rotation, its eccentricity along
    /// two directions, and the angle of the lamp to the camera.
    pub(super) angles: [Vec<f64>; ANGLE_ERRORS],
}

/// Number of angle errors of the rig.
pub(super) const ANGLE_ERRORS: usize = 6;

/// Step of the numerical derivative with respect to the lamp's angle (rad): small compared with any lobe width, large
/// compared with rounding.
const LAMP_STEP: f64 = 1e-6;

impl Shared {
    pub(super) fn new(estimate: &Estimate<'_>) -> Self {
        let (problem, values) = (&estimate.problem, &estimate.values);
        let set = problem.set();
        // A prior on an offset limits the error of that stage's zero.
        let (tilt_zero, turn_zero) = (
            known_within(estimate, Quantity::TiltOffset),
            known_within(estimate, Quantity::AzimuthOffset),
        );
        let samples = set.observations.len();
        let none = vec![0.0; problem.residual_count()];
        let mut gain = none.clone();
        let mut detector = none.clone();
        let mut angles: [Vec<f64>; ANGLE_ERRORS] = std::array::from_fn(|_| none.clone());
        let ready = problem.ready(values);
        let along = set.tilt_scale();
        for (i, o) in set.observations.iter().enumerate() {
            let g = problem.corrected(i, &ready);
            let weight = values.scale / problem.sigma()[i];
            gain[i] = weight * g.value;
            detector[i] = o.shared.detector / problem.sigma()[i];
            let by_tilt = |std: f64| weight * g.theta_c * std;
            let by_turn = |std: f64| weight * g.phi_s * std;
            let (tilt, turn) = (o.shared.theta_c_zero.rad(), o.shared.phi_s_zero.rad());
            let (sin, cos) = o.pose.phi_s.sin_cos();
            let changes = [
                by_tilt(tilt.min(tilt_zero)),
                by_tilt(tilt) * along(o.pose.theta_c),
                by_turn(turn.min(turn_zero)),
                by_turn(turn) * sin,
                by_turn(turn) * cos,
            ];
            for (angle, change) in angles.iter_mut().zip(changes) {
                angle[i] = change;
            }
        }
        let zero = set.observations.first();
        let zero = zero.map_or(0.0, |o| o.shared.theta_c_zero.rad());
        let albedo = set.white_reference.map_or(0.0, |w| w.reflectance / PI);
        for (index, flat) in set.flats.iter().enumerate() {
            let [_, slope, _] = problem.flat_cosine(index, values);
            let weight = values.scale * albedo / problem.flat_sigma()[index];
            let change = weight * slope;
            angles[0][samples + index] = change * zero.min(tilt_zero);
            angles[1][samples + index] = change * zero * along(flat.theta_c);
        }
        if let Some(std) = set.theta_l_std {
            angles[5] = by_lamp(problem, values, std);
        }
        Shared {
            gain,
            detector,
            angles,
        }
    }
}

/// Standard uncertainty of an offset as the user states it (rad): 0 if it is held, infinite without a statement.
fn known_within(estimate: &Estimate<'_>, offset: Quantity) -> f64 {
    if estimate.held.contains(&offset) {
        return 0.0;
    }
    let priors = estimate.problem.priors().iter();
    let of_offset = priors.filter(|(quantity, _)| *quantity == offset);
    of_offset
        .map(|(_, prior)| prior.std)
        .fold(f64::INFINITY, f64::min)
}

/// Change of the weighted residuals by one standard uncertainty of the lamp's angle to the camera.
fn by_lamp(problem: &Problem<'_>, values: &Values, std: Angle) -> Vec<f64> {
    let set = problem.set();
    let expected = |by: f64| -> Vec<f64> {
        let moved = set.with_lamp_moved(Angle::from_rad(by));
        let seen = problem.seen_by(&moved);
        let flats = (0..set.flats.len()).map(|index| seen.flat_signal(index, values));
        seen.predicted(values).into_iter().chain(flats).collect()
    };
    let sigma = problem.sigma().iter().chain(problem.flat_sigma());
    let pairs = expected(LAMP_STEP).into_iter().zip(expected(-LAMP_STEP));
    let mut change: Vec<f64> = pairs
        .zip(sigma)
        .map(|((after, before), sigma)| (after - before) / (2.0 * LAMP_STEP) * std.rad() / sigma)
        .collect();
    change.resize(problem.residual_count(), 0.0);
    change
}

/// Parts of one source over all scans. A common error adds up with its sign; independent errors add in quadrature.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Common {
    sum: f64,
    squares: f64,
}

impl Common {
    pub(super) fn add(&mut self, part: f64) {
        self.sum += part;
        self.squares += part * part;
    }

    pub(super) fn size(self, same: bool) -> f64 {
        if same {
            self.sum.abs()
        } else {
            self.squares.sqrt()
        }
    }
}

/// Changes of the residuals, each from its first row on, by one standard uncertainty of each error that rows share.
pub(super) fn common_changes(
    parts: &[Part<'_, '_>],
    shared: &[Shared],
    drifts: &[Option<Drift>],
    same_reference: bool,
    same_rig: bool,
) -> Vec<(Vec<f64>, usize)> {
    let times = |change: &[f64], std: f64| change.iter().map(|c| c * std).collect();
    let (mut of_reference, mut changes) = (Vec::new(), Vec::new());
    let mut of_angles: [Vec<(Vec<f64>, usize)>; ANGLE_ERRORS] = Default::default();
    let mut first = 0;
    for ((part, shared), drift) in parts.iter().zip(shared).zip(drifts) {
        let set = part.estimate.problem.set();
        of_reference.push((times(&shared.gain, reference_std(set)), first));
        changes.push((times(&shared.gain, drift_std(set)), first));
        changes.push((shared.detector.clone(), first));
        let drifted = drift.iter().flat_map(|drift| &drift.changes);
        changes.extend(drifted.map(|change| (change.clone(), first)));
        for (all, change) in of_angles.iter_mut().zip(&shared.angles) {
            all.push((change.clone(), first));
        }
        first += part.estimate.problem.residual_count();
    }
    let of_angles = of_angles.into_iter().map(|parts| (parts, same_rig));
    for (parts, is_one_error) in std::iter::once((of_reference, same_reference)).chain(of_angles) {
        match is_one_error {
            // The parts follow each other, so one change has them all.
            true => changes.push((
                parts.into_iter().flat_map(|(change, _)| change).collect(),
                0,
            )),
            false => changes.extend(parts),
        }
    }
    changes
}

/// Roughness above which the ridge angle depends on where the body's light leaves. Below it the lobes are so narrow
/// that diffuse light does not move them.
const BODY_MATTERS: f64 = 0.14;

/// Change of the weighted residuals of the samples for a translucent instead of an opaque body; none if it does not
/// matter or is fitted.
pub(super) fn by_body(estimate: &Estimate<'_>) -> Option<Vec<f64>> {
    let (problem, values) = (&estimate.problem, &estimate.values);
    let dielectric = matches!(problem.set().material, Material::Dielectric { .. });
    let fitted = problem.is_extended() && problem.free().contains(&Quantity::Translucency);
    let rough = values.alpha_u.max(values.alpha_v) >= BODY_MATTERS;
    if !dielectric || fitted || !rough || problem.variant() != Variant::Sawtooth {
        return None;
    }
    let extended = match problem.is_extended() {
        true => problem.clone(),
        false => problem.clone().with_walls_of(values),
    };
    let ready = extended.ready(values);
    let each = problem.sigma().iter().enumerate();
    Some(
        each.map(|(i, sigma)| {
            values.scale * extended.corrected(i, &ready).real.translucency / sigma
        })
        .collect(),
    )
}

/// Places the changes of the sample rows among all rows; none if no part has any.
pub(super) fn stacked(
    parts: &[Part<'_, '_>],
    changes: &[Option<Vec<f64>>],
    m: usize,
) -> Option<Vec<f64>> {
    changes.iter().any(Option::is_some).then(|| {
        let mut all = vec![0.0; m];
        let mut first = 0;
        for (part, change) in parts.iter().zip(changes) {
            for (to, from) in all[first..].iter_mut().zip(change.iter().flatten()) {
                *to = *from;
            }
            first += part.estimate.problem.residual_count();
        }
        all
    })
}

/// Error of a parameter caused by a wedge of the sample, which leaves no trace in the residuals, for one standard
/// uncertainty of the wedge.
pub(super) fn through_wedge(set: &ObservationSet, quantity: Quantity, values: &Values) -> f64 {
    let Some(wedge) = set.wedge_std else {
        return 0.0;
    };
    match quantity {
        Quantity::ThetaR => wedge.rad(),
        // A fit that contains the wedge has the zero alone in its azimuth.
        Quantity::AzimuthOffset if values.wedge == 0.0 => {
            turn_by_wedge(wedge, Angle::from_rad(values.theta_r)).rad()
        }
        _ => 0.0,
    }
}
