//! What a user states of a parameter before a fit, by the names of the report: [`held`] at a value, or [`known`]
//! within a standard uncertainty.
//!
//! Command line and HTTP both ask here, so that they refuse the same with the same words; [`agree`] looks at all
//! statements together. How a statement is written is theirs: this file knows no syntax.

use super::{Quantity, Told};
use crate::material::Material;

/// Names as in the report, with the quantity, whether the value is in degrees, and from where to where it means
/// anything: surfaces as the model takes them, gains and stray light that leave squares room in a double.
const NAMES: [(&str, Quantity, bool, (f64, f64)); 12] = [
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
];
/// From where to where the index of a dielectric lies.
const DIELECTRIC: (f64, f64) = (1.0, 10.0);
/// Least standard uncertainty of a prior, as a share of its range or its value, whichever is smaller.
const STD_MIN: f64 = 1e-9;

/// Why nothing can be stated like that.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum StatementError {
    /// The name is none of a parameter.
    #[error("'{0}' is not a parameter; take one of {names}", names = names())]
    Unknown(String),
    /// No surface, rig or material has it.
    #[error("{name} lies from {low} to {high}")]
    OutOfRange {
        /// The parameter.
        name: &'static str,
        /// Least value.
        low: f64,
        /// Greatest value.
        high: f64,
    },
    /// A standard uncertainty that is none.
    #[error("the standard uncertainty of {name} must be greater than 0")]
    NoUncertainty {
        /// The parameter.
        name: &'static str,
    },
    /// So certain that nothing else would count.
    #[error("such a small uncertainty holds the value; fix {name} instead of giving it a prior")]
    TooCertain {
        /// The parameter.
        name: &'static str,
    },
    /// One parameter, two statements.
    #[error("{name} is both held and given a prior, or named twice; name each parameter once")]
    Twice {
        /// The parameter.
        name: &'static str,
    },
    /// A dielectric has no extinction, and whoever writes `k` for it means the gain.
    #[error(
        "k is the imaginary part of a metal's index, and this sample is a dielectric; the gain of the signals is called scale"
    )]
    NoExtinction,
    /// Light does not come back from below a metal's surface.
    #[error(
        "rho_d and translucency tell of light from below the surface, and this sample is a metal: its ρd is 0 and needs no statement"
    )]
    NoDiffuse,
}

fn names() -> String {
    NAMES.map(|(name, ..)| name).join(", ")
}

/// The parameter `name` held at `value`, angles in degrees.
///
/// # Errors
/// [`StatementError`].
pub fn held(name: &str, value: f64) -> Result<Told, StatementError> {
    Named::of(name)?.told(value, 0.0)
}

/// The parameter `name` known as `value` within the standard uncertainty `std`, angles in degrees.
///
/// # Errors
/// [`StatementError`].
pub fn known(name: &str, value: f64, std: f64) -> Result<Told, StatementError> {
    let named = Named::of(name)?;
    let told = named.told(value, std)?;
    if !(std > 0.0 && std.is_finite()) {
        return Err(StatementError::NoUncertainty { name: named.name });
    }
    let (low, high) = named.range;
    let scale = (high - low).min(value.abs().max(1e-3));
    if std < STD_MIN * scale {
        return Err(StatementError::TooCertain { name: named.name });
    }
    Ok(told)
}

/// Refuses statements that contradict each other, or the material of the sample.
///
/// # Errors
/// [`StatementError::Twice`], [`StatementError::NoExtinction`], [`StatementError::NoDiffuse`], and [`StatementError::OutOfRange`] where a dielectric has no
/// such index.
pub fn agree(told: &[Told], material: &Material) -> Result<(), StatementError> {
    for (k, one) in told.iter().enumerate() {
        if told[..k].iter().any(|other| other.quantity == one.quantity) {
            let name = NAMES.iter().find(|(_, q, ..)| *q == one.quantity);
            return Err(StatementError::Twice {
                name: name.map_or("a parameter", |(name, ..)| name),
            });
        }
    }
    let of_k = told.iter().any(|t| t.quantity == Quantity::K);
    let dielectric = matches!(material, Material::Dielectric { .. });
    if of_k && dielectric {
        return Err(StatementError::NoExtinction);
    }
    let of_rho_d = told
        .iter()
        .any(|t| matches!(t.quantity, Quantity::RhoD | Quantity::Translucency) && t.value > 0.0);
    if of_rho_d && !dielectric {
        return Err(StatementError::NoDiffuse);
    }
    let (low, high) = DIELECTRIC;
    let of_eta = told.iter().find(|t| t.quantity == Quantity::Eta);
    if of_eta.is_some_and(|t| dielectric && !(low..=high).contains(&t.value)) {
        return Err(StatementError::OutOfRange {
            name: "eta",
            low,
            high,
        });
    }
    Ok(())
}

/// A parameter that there is.
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

    /// A value in its range, in natural units.
    fn told(&self, value: f64, std: f64) -> Result<Told, StatementError> {
        let (low, high) = self.range;
        if !(low..=high).contains(&value) {
            return Err(StatementError::OutOfRange {
                name: self.name,
                low,
                high,
            });
        }
        Ok(Told {
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
    fn each_parameter_is_stated_once_and_only_of_materials_that_have_it() {
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
        assert_eq!(refused.to_string(), "eta lies from 1 to 10");
        assert_eq!(agree(&[vacuum], &metal), Ok(()));
        let refused = agree(&twice, &PLASTIC).unwrap_err();
        assert!(refused.to_string().starts_with("theta_r_deg"), "{refused}");
    }

    #[test]
    fn nothing_is_stated_that_is_no_number() {
        for wrong in [f64::NAN, f64::INFINITY] {
            assert!(held("scale", wrong).is_err());
            assert!(known("rho_d", 0.5, wrong).is_err());
        }
    }
}
