//! Knowledge available before a fit (certificates, stray light, stated values) and errors that all observations share.

use std::f64::consts::FRAC_1_PI;

use nalgebra::{Matrix2, Vector2};

use super::quantity::Quantity;
use crate::geometry::RigGeometry;
use crate::material::Material;
use crate::observation::{FlatObservation, ObservationSet, Prior, WhiteReference};
use crate::units::Angle;

/// Returns the priors of the free quantities that have one. A value that the user states replaces a certificate.
pub(super) fn priors(
    set: &ObservationSet,
    free: &[Quantity],
    user: &[(Quantity, Prior)],
) -> Vec<(Quantity, Prior)> {
    let (eta, k) = set.material.index();
    let (eta_std, k_std) = match set.material {
        Material::Dielectric { eta_std, .. } => (eta_std, 0.0),
        Material::Conductor { eta_std, k_std, .. } => (eta_std, k_std),
    };
    let of = |q: &Quantity| match q {
        Quantity::Background => Some(set.background),
        Quantity::Translucency => set.translucency,
        Quantity::Eta => Some(Prior {
            mean: eta,
            std: eta_std,
        }),
        Quantity::K => Some(Prior {
            mean: k,
            std: k_std,
        }),
        _ => None,
    };
    let stated = |q: &Quantity| {
        let by_user = user.iter().find(|(t, _)| t == q).map(|(_, prior)| *prior);
        by_user.or_else(|| of(q))
    };
    free.iter()
        .filter_map(|q| stated(q).map(|prior| (*q, prior)))
        .collect()
}

/// Quantities with a certified uncertainty, which are fitted within it.
#[must_use]
pub fn certified(set: &ObservationSet) -> Vec<Quantity> {
    priors(set, &[Quantity::Eta, Quantity::K], &[])
        .into_iter()
        .filter(|(_, prior)| prior.std > 0.0)
        .map(|(q, _)| q)
        .collect()
}

/// Relative standard uncertainty of the white reference; 0 without one.
#[must_use]
pub fn reference_std(set: &ObservationSet) -> f64 {
    set.white_reference
        .map_or(0.0, |w| w.reflectance_std / w.reflectance)
}

/// Relative standard uncertainty of the lamp between flats and samples: the largest of all observations.
#[must_use]
pub fn drift_std(set: &ObservationSet) -> f64 {
    set.observations
        .iter()
        .map(|o| (o.shared.led_drift / o.signal).abs())
        .filter(|share| share.is_finite())
        .fold(0.0, f64::max)
        .min(0.1)
}

/// Computes gain and stray light of the signals, each with its standard uncertainty, from the flats at a tilt zero and a
/// prior on the stray light. Returns `None` if they determine no positive gain.
#[must_use]
pub fn gain_and_stray_light(
    white: &WhiteReference,
    flats: &[FlatObservation],
    rig: &RigGeometry,
    tilt_zero: Angle,
    prior: Prior,
) -> Option<[(f64, f64); 2]> {
    // Normal equations of two unknowns.
    let weight = prior.std.powi(-2);
    let mut normal = Matrix2::new(0.0, 0.0, 0.0, weight);
    let mut right = Vector2::new(0.0, weight * prior.mean);
    for flat in flats {
        let cosine = rig.cos_incidence(flat.theta_c + tilt_zero);
        let row = Vector2::new(white.reflectance * FRAC_1_PI * cosine, 1.0);
        let weight = flat.sigma.powi(-2);
        normal += row * row.transpose() * weight;
        right += row * (weight * flat.signal);
    }
    let covariance = normal.try_inverse()?;
    let found = covariance * right;
    let is_determined = found.x > 0.0 && found.iter().all(|x| x.is_finite());
    is_determined.then(|| [0, 1].map(|k| (found[k], covariance[(k, k)].sqrt())))
}
