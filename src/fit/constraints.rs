//! Values that the user states before a fit, by the parameter names of the report: [`held`] fixes a value, [`known`]
//! gives it a standard uncertainty.
//!
//! Command line and HTTP both call these functions, so both refuse the same input with the same message. [`agree`]
//! checks all statements together. The callers define the syntax.

use super::{Constraint, Quantity};
use crate::material::Material;
use crate::model::extended::LAND_MAX;
use crate::observation::Prior;

/// Names as in the report, the quantity, whether the value is in degrees, and the valid range. Surfaces are limited to
/// the domain of the model; gains and stray light to magnitudes whose squares fit in a double.
const NAMES: [(&str, Quantity, bool, (f64, f64)); 13] = [
    ("theta_r_deg", Quantity::ThetaR, true, (0.0, 89.0)),
    ("alpha_u", Quantity::AlphaU, false, (1e-6, 1e3)),
    ("alpha_v", Quantity::AlphaV, false, (1e-6, 1e3)),
    ("rho_d", Quantity::RhoD, false, (0.0, 1.0)),
    ("scale", Quantity::Scale, false, (1e-30, 1e30)),
    ("background", Quantity::Background, false, (-1e30, 1e30)),
    (
        "azimuth_offset_deg",
        Quantity::AzimuthOffset,
        true,
        (-360.0, 360.0),
    ),
    ("tilt_offset_deg", Quantity::TiltOffset, true, (-15.0, 15.0)),
    ("eta", Quantity::Eta, false, (0.01, 100.0)),
    ("k", Quantity::K, false, (0.0, 100.0)),
    ("translucency", Quantity::Translucency, false, (0.0, 1.0)),
    ("crest_radius", Quantity::CrestRadius, false, (0.0, 0.8)),
    ("land_share", Quantity::Land, false, (0.0, LAND_MAX)),
];
/// Valid range of the index of a dielectric.
const DIELECTRIC: (f64, f64) = (1.0, 10.0);
/// Smallest standard uncertainty of a prior, as a share of its range or of its value, whichever is smaller.
const STD_MIN: f64 = 1e-9;

/// The statements with an uncertainty, as priors of the problem; the others hold their values.
pub(super) fn priors(stated: &[Constraint]) -> Vec<(Quantity, Prior)> {
    let uncertain = stated.iter().filter(|t| t.std > 0.0);
    uncertain
        .map(|t| {
            let (mean, std) = (t.value, t.std);
            (t.quantity, Prior { mean, std })
        })
        .collect()
}

/// The reason why a statement is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StatementError {
    /// No parameter has this name.
    #[error("unknown parameter '{0}'; use one of {names}", names = names())]
    Unknown(String),
    /// Outside the range of any surface, rig or material.
    #[error("{name} is out of range; give a value from {low} to {high}")]
    OutOfRange {
        /// The parameter.
        name: &'static str,
        /// Smallest value.
        low: f64,
        /// Largest value.
        high: f64,
    },
    /// The standard uncertainty is not a positive number.
    #[error("the standard uncertainty of {name} must be greater than 0")]
    NoUncertainty {
        /// The parameter.
        name: &'static str,
    },
    /// The standard uncertainty is too small for the data to count.
    #[error(
        "the standard uncertainty of {name} is too small for a prior; hold the value fixed instead"
    )]
    TooCertain {
        /// The parameter.
        name: &'static str,
    },
    /// Two statements about one parameter.
    #[error("{name} is stated twice; hold it or give it a prior, once")]
    Twice {
        /// The parameter.
        name: &'static str,
    },
    /// A dielectric has no extinction coefficient. Users who write `k` for one usually mean the gain.
    #[error(
        "k is the extinction coefficient of a metal, but this sample is a dielectric; to state the gain, use scale"
    )]
    NoExtinction,
    /// A metal returns no light from below its surface.
    #[error(
        "rho_d and translucency describe light from below the surface, but this sample is a metal; leave them out"
    )]
    NoDiffuse,
}

fn names() -> String {
    NAMES.map(|(name, ..)| name).join(", ")
}

/// Holds the parameter `name` at `value`, angles in degrees.
///
/// # Errors
/// [`StatementError`].
pub fn held(name: &str, value: f64) -> Result<Constraint, StatementError> {
    Named::of(name)?.stated(value, 0.0)
}

/// States the parameter `name` as `value` with the standard uncertainty `std`, angles in degrees.
///
/// # Errors
/// [`StatementError`].
pub fn known(name: &str, value: f64, std: f64) -> Result<Constraint, StatementError> {
    let named = Named::of(name)?;
    let stated = named.stated(value, std)?;
    if !(std > 0.0 && std.is_finite()) {
        return Err(StatementError::NoUncertainty { name: named.name });
    }
    let (low, high) = named.range;
    let scale = (high - low).min(value.abs().max(1e-3));
    if std < STD_MIN * scale {
        return Err(StatementError::TooCertain { name: named.name });
    }
    Ok(stated)
}

/// Returns the name of the report, the value and the standard uncertainty of a statement, angles in degrees: what [`held`]
/// and [`known`] take.
#[must_use]
pub fn stated(constraint: &Constraint) -> (&'static str, f64, f64) {
    let found = NAMES.iter().find(|(_, q, ..)| *q == constraint.quantity);
    let (name, _, is_degrees, _) = found.expect("every statement is made by name");
    let unit = if *is_degrees { 1f64.to_radians() } else { 1.0 };
    (name, constraint.value / unit, constraint.std / unit)
}

/// Checks that the statements do not contradict each other or the material of the sample.
///
/// # Errors
/// [`StatementError::Twice`], [`StatementError::NoExtinction`], [`StatementError::NoDiffuse`], and
/// [`StatementError::OutOfRange`] for an index that a dielectric cannot have.
pub fn agree(stated: &[Constraint], material: &Material) -> Result<(), StatementError> {
    for (k, one) in stated.iter().enumerate() {
        if stated[..k]
            .iter()
            .any(|other| other.quantity == one.quantity)
        {
            let name = NAMES.iter().find(|(_, q, ..)| *q == one.quantity);
            return Err(StatementError::Twice {
                name: name.map_or("a parameter", |(name, ..)| name),
            });
        }
    }
    let of_k = stated.iter().any(|t| t.quantity == Quantity::K);
    let dielectric = matches!(material, Material::Dielectric { .. });
    if of_k && dielectric {
        return Err(StatementError::NoExtinction);
    }
    let of_rho_d = stated
        .iter()
        .any(|t| matches!(t.quantity, Quantity::RhoD | Quantity::Translucency) && t.value > 0.0);
    if of_rho_d && !dielectric {
        return Err(StatementError::NoDiffuse);
    }
    let (low, high) = DIELECTRIC;
    let of_eta = stated.iter().find(|t| t.quantity == Quantity::Eta);
    if of_eta.is_some_and(|t| dielectric && !(low..=high).contains(&t.value)) {
        return Err(StatementError::OutOfRange {
            name: "eta",
            low,
            high,
        });
    }
    Ok(())
}

/// An existing parameter.
struct Named {
    name: &'static str,
    quantity: Quantity,
    unit: f64,
    range: (f64, f64),
}

impl Named {
    fn of(name: &str) -> Result<Self, StatementError> {
        let found = NAMES.into_iter().find(|(known, ..)| *known == name);
        let (name, quantity, degrees, range) =
            found.ok_or_else(|| StatementError::Unknown(name.to_owned()))?;
        let unit = if degrees { 1f64.to_radians() } else { 1.0 };
        Ok(Named {
            name,
            quantity,
            unit,
            range,
        })
    }

    /// Converts a value within its range to natural units.
    fn stated(&self, value: f64, std: f64) -> Result<Constraint, StatementError> {
        let (low, high) = self.range;
        if !(low..=high).contains(&value) {
            return Err(StatementError::OutOfRange {
                name: self.name,
                low,
                high,
            });
        }
        Ok(Constraint {
            quantity: self.quantity,
            value: value * self.unit,
            std: std * self.unit,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLASTIC: Material = Material::Dielectric {
        eta: 1.5,
        eta_std: 0.01,
    };

    #[test]
    fn each_parameter_is_stated_once_and_exists_for_the_material() {
        let angle = known("theta_r_deg", 10.0, 0.5).unwrap();
        assert!((angle.std - 0.5f64.to_radians()).abs() < 1e-15);
        let index = held("k", 3.0).unwrap();
        assert_eq!(agree(&[angle], &PLASTIC), Ok(()));
        let metal = Material::Conductor {
            eta: 1.0,
            k: 6.0,
            eta_std: 0.1,
            k_std: 0.1,
        };
        assert_eq!(agree(&[index], &metal), Ok(()));
        let refused = agree(&[index], &PLASTIC).unwrap_err();
        assert!(refused.to_string().contains("scale"), "{refused}");
        let twice = [held("theta_r_deg", 9.0).unwrap(), angle];
        let vacuum = held("eta", 0.9).unwrap();
        let refused = agree(&[vacuum], &PLASTIC).unwrap_err();
        assert_eq!(
            refused.to_string(),
            "eta is out of range; give a value from 1 to 10"
        );
        assert_eq!(agree(&[vacuum], &metal), Ok(()));
        let refused = agree(&twice, &PLASTIC).unwrap_err();
        assert!(refused.to_string().starts_with("theta_r_deg"), "{refused}");
    }

    #[test]
    fn values_that_are_not_finite_are_refused() {
        for wrong in [f64::NAN, f64::INFINITY] {
            assert!(held("scale", wrong).is_err());
            assert!(known("rho_d", 0.5, wrong).is_err());
        }
    }
}
