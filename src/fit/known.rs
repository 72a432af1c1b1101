//! Knowledge available before a fit (certificates, stray light, stated values) and errors that all observations share.

use super::quantity::Quantity;
use crate::material::Material;
use crate::observation::{ObservationSet, Prior};

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
