//! Correction of stray light: from signals to radiances of the sample.
//!
//! Stray light adds to the frames of the sample and of the white reference. It cancels in a difference of
//! signals, but makes the reference look brighter and thus all radiances darker. In a Michelson
//! contrast it does not cancel. Flats at several tilts separate it from the reference, which follows the lamp's
//! cosine, whereas stray light does not.
//!
//! *Conditioning.* Three unknowns (gain, stray light, the tilt's zero) with priors on the latter two as further
//! rows, so the triangular factor is never singular. Flats of one tilt leave stray light at its prior.

use nalgebra::{DMatrix, DVector};

use crate::observation::ObservationSet;
use crate::units::Angle;

/// Standard deviation of the prior on the tilt's zero.
const TILT_ZERO: Angle = Angle::from_deg(3.0);

/// Stray light as radiance where the scale is absolute, otherwise in the unit of the signals.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, utoipa::ToSchema)]
pub struct StrayLight {
    /// Amount in every signal.
    pub radiance: f64,
    /// Its standard uncertainty.
    pub std: f64,
}

impl StrayLight {
    /// Estimates it from the flats and the prior.
    #[must_use]
    pub fn of_flats(set: &ObservationSet) -> Self {
        let known = StrayLight {
            radiance: set.background.mean,
            std: set.background.std,
        };
        let due = dues(set);
        if due.is_empty() || known.std <= 0.0 {
            return known;
        }
        let mut rows: Vec<[f64; 4]> = set
            .flats
            .iter()
            .zip(&due)
            .map(|(flat, [due, slope])| [*due, 1.0, *slope, flat.signal].map(|x| x / flat.sigma))
            .collect();
        rows.push([0.0, 1.0 / known.std, 0.0, known.radiance / known.std]);
        rows.push([0.0, 0.0, 1.0 / TILT_ZERO.rad(), 0.0]);
        let matrix = DMatrix::from_fn(rows.len(), 3, |i, j| rows[i][j]);
        let signals = DVector::from_fn(rows.len(), |i, _| rows[i][3]);
        let qr = matrix.qr();
        let turned = qr.q().transpose() * signals;
        let (Some(solution), Some(inverse)) =
            (qr.r().solve_upper_triangular(&turned), qr.r().try_inverse())
        else {
            return known;
        };
        let gain = solution[0];
        let std = inverse.row(1).norm() / gain;
        let radiance = solution[1] / gain;
        if gain > 0.0 && radiance.is_finite() && std.is_finite() {
            // Stray light is never negative.
            let radiance = radiance.max(0.0);
            StrayLight { radiance, std }
        } else {
            known
        }
    }
}

/// Radiances of the sample, corrected for stray light.
#[derive(Debug, Clone, PartialEq)]
pub struct SampleRadiances {
    /// One per observation.
    pub values: Vec<f64>,
    /// Their derivatives with respect to the stray light.
    pub per_stray: Vec<f64>,
    /// Signal per radiance.
    pub gain: f64,
}

impl SampleRadiances {
    /// Corrects samples and flats for this stray light.
    #[must_use]
    pub fn of(set: &ObservationSet, stray: &StrayLight) -> Self {
        // The gain from the flats: Σ w f (due + s) / Σ w (due + s)², and its derivative.
        let (mut top, mut below, mut top_slope, mut below_slope) = (0.0, 0.0, 0.0, 0.0);
        for (flat, [due, _]) in set.flats.iter().zip(dues(set)) {
            let light = due + stray.radiance;
            let w = (flat.sigma * flat.sigma).recip();
            top += w * flat.signal * light;
            below += w * light * light;
            top_slope += w * flat.signal;
            below_slope += 2.0 * w * light;
        }
        let settled = top / below;
        let (gain, gain_slope) = match settled.is_finite() && settled > 0.0 {
            true => (settled, (top_slope - settled * below_slope) / below),
            false => (1.0, 0.0),
        };
        let signals = || set.observations.iter().map(|o| o.signal);
        SampleRadiances {
            values: signals().map(|s| s / gain - stray.radiance).collect(),
            per_stray: signals()
                .map(|s| -s * gain_slope / (gain * gain) - 1.0)
                .collect(),
            gain,
        }
    }
}

/// Radiance of the white reference at each flat and its derivative with respect to the tilt; empty
/// without a reference.
fn dues(set: &ObservationSet) -> Vec<[f64; 2]> {
    let Some(white) = &set.white_reference else {
        return Vec::new();
    };
    let albedo = white.reflectance / std::f64::consts::PI;
    let flats = set.flats.iter();
    flats
        .map(|flat| {
            let (cos, slope) = set.rig.cos_incidence_and_slope(flat.theta_c);
            [albedo * cos, albedo * slope]
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose, RigGeometry};
    use crate::material::Material;
    use crate::observation::{FlatObservation, Observation, Prior, WhiteReference};

    /// Two radiances and flats over some tilts, with stray light of 0.03 in all signals.
    fn hazy(tilts: &[f64]) -> (ObservationSet, [f64; 2]) {
        let (stray, gain, true_values) = (0.03, 0.9, [0.5, 0.2]);
        let rig = RigGeometry::IN_PLANE;
        let signal = |radiance: f64| gain * (radiance + stray);
        let mut set = ObservationSet::bare(
            rig,
            Material::exactly(1.54, 0.0),
            true_values
                .iter()
                .map(|l| Observation::new(Pose::from_deg(0.0, 0.0), signal(*l), 1e-4))
                .collect(),
            Prior {
                mean: 0.0,
                std: 0.05,
            },
        );
        set.white_reference = Some(WhiteReference {
            reflectance: 0.99,
            reflectance_std: 0.005,
        });
        set.flats = tilts
            .iter()
            .map(|deg| {
                let theta_c = Angle::from_deg(*deg);
                let due = 0.99 / std::f64::consts::PI * rig.cos_incidence(theta_c);
                FlatObservation {
                    theta_c,
                    signal: signal(due),
                    sigma: 1e-4,
                    times_s: Vec::new(),
                }
            })
            .collect();
        (set, true_values)
    }

    #[test]
    fn flats_over_tilts_separate_stray_light_from_the_reference() {
        let (set, truth) = hazy(&[-40.0, -20.0, 0.0, 20.0, 40.0]);
        let stray = StrayLight::of_flats(&set);
        assert!(
            (stray.radiance - 0.03).abs() < 3.0 * stray.std + 1e-4,
            "{stray:?}"
        );
        assert!(stray.std < 2e-3, "{stray:?}");
        let radiances = SampleRadiances::of(&set, &stray);
        for (value, true_value) in radiances.values.iter().zip(truth) {
            assert!((value / true_value - 1.0).abs() < 0.01, "{radiances:?}");
        }
        // The derivative, against a difference.
        let step = 1e-6;
        let moved = StrayLight {
            radiance: stray.radiance + step,
            ..stray
        };
        let there = SampleRadiances::of(&set, &moved);
        for ((a, b), slope) in there
            .values
            .iter()
            .zip(&radiances.values)
            .zip(&radiances.per_stray)
        {
            assert!(((a - b) / step - slope).abs() < 1e-4);
        }
    }

    #[test]
    fn flats_of_one_tilt_leave_stray_light_at_its_prior() {
        let (set, _) = hazy(&[0.0]);
        let stray = StrayLight::of_flats(&set);
        assert!((0.03..0.08).contains(&stray.std), "{stray:?}");
        let (mut none, truth) = hazy(&[]);
        none.background.mean = 0.027;
        assert_eq!(StrayLight::of_flats(&none).radiance, 0.027);
        // Without flats the gain is 1.
        let radiances = SampleRadiances::of(&none, &StrayLight::of_flats(&none));
        assert_eq!(radiances.gain, 1.0);
        assert!((radiances.values[0] - (0.9 * (truth[0] + 0.03) - 0.027)).abs() < 1e-12);
    }
}
