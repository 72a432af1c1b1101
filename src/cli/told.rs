//! What a user knows of a parameter before a fit, from the command line: `rho_d=0.3` holds it,
//! `theta_r_deg=10±0.5` (or `10+-0.5`) leaves it free within a standard uncertainty.

use crate::fit::{Quantity, Told};

/// Names as in the report, with the quantity, whether the value is in degrees, and from where to where it means
/// anything: surfaces as the model takes them, gains and stray light that leave squares room in a double.
const NAMES: [(&str, Quantity, bool, (f64, f64)); 10] = [
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
];
/// Least standard uncertainty of a prior, as a share of its range or its value, whichever is smaller.
const STD_MIN: f64 = 1e-9;

/// Why a text is no statement about a parameter.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ToldError {
    /// No `=` in it.
    #[error("'{0}' has no '='; write NAME=VALUE, for example rho_d=0.3")]
    NoValue(String),
    /// The name is none of a parameter.
    #[error("'{0}' is no parameter; take one of {names}", names = names())]
    Unknown(String),
    /// No surface, rig or material has it.
    #[error("'{text}': {name} lies from {low} to {high}")]
    OutOfRange {
        /// What was written.
        text: String,
        /// The parameter.
        name: &'static str,
        /// Least value.
        low: f64,
        /// Greatest value.
        high: f64,
    },
    /// So certain that nothing else would count.
    #[error("'{text}': such a small uncertainty holds the value; write --fix {name}=VALUE")]
    TooCertain {
        /// What was written.
        text: String,
        /// The parameter.
        name: &'static str,
    },
    /// Not a number.
    #[error("'{0}' is not a finite number")]
    NotANumber(String),
    /// A prior without its uncertainty.
    #[error(
        "'{0}' has no uncertainty; write NAME=VALUE±STD with a positive STD, for example theta_r_deg=10±0.5"
    )]
    NoUncertainty(String),
}

fn names() -> String {
    NAMES.map(|(name, ..)| name).join(", ")
}

/// `NAME=VALUE`: held fixed.
///
/// # Errors
/// See [`ToldError`].
pub fn fixed(text: &str) -> Result<Told, ToldError> {
    let named = Named::of(text)?;
    Ok(Told {
        quantity: named.quantity,
        value: named.value(named.stated)?,
        std: 0.0,
    })
}

/// `NAME=VALUE±STD` or `NAME=VALUE+-STD`: known within a standard uncertainty.
///
/// # Errors
/// See [`ToldError`].
pub fn prior(text: &str) -> Result<Told, ToldError> {
    let named = Named::of(text)?;
    let (mean, std) = named
        .stated
        .split_once('±')
        .or_else(|| named.stated.split_once("+-"))
        .ok_or_else(|| ToldError::NoUncertainty(text.to_owned()))?;
    let value = named.value(mean)?;
    let std = number(std)?;
    if std <= 0.0 {
        return Err(ToldError::NoUncertainty(text.to_owned()));
    }
    let (low, high) = named.range;
    let scale = (high - low).min((value / named.unit).abs().max(1e-3));
    if std < STD_MIN * scale {
        return Err(ToldError::TooCertain {
            text: text.to_owned(),
            name: named.name,
        });
    }
    Ok(Told {
        quantity: named.quantity,
        value,
        std: std * named.unit,
    })
}

/// A parameter and what is stated of it.
struct Named<'t> {
    text: &'t str,
    name: &'static str,
    quantity: Quantity,
    unit: f64,
    range: (f64, f64),
    stated: &'t str,
}

impl<'t> Named<'t> {
    fn of(text: &'t str) -> Result<Self, ToldError> {
        let (name, stated) = text
            .split_once('=')
            .ok_or_else(|| ToldError::NoValue(text.to_owned()))?;
        let known = NAMES.into_iter().find(|(known, ..)| *known == name.trim());
        let (name, quantity, degrees, range) =
            known.ok_or_else(|| ToldError::Unknown(name.to_owned()))?;
        let unit = if degrees { 1f64.to_radians() } else { 1.0 };
        Ok(Named {
            text,
            name,
            quantity,
            unit,
            range,
            stated,
        })
    }

    /// A value in its range, in natural units.
    fn value(&self, text: &str) -> Result<f64, ToldError> {
        let value = number(text)?;
        let (low, high) = self.range;
        if !(low..=high).contains(&value) {
            return Err(ToldError::OutOfRange {
                text: self.text.to_owned(),
                name: self.name,
                low,
                high,
            });
        }
        Ok(value * self.unit)
    }
}

fn number(text: &str) -> Result<f64, ToldError> {
    let value: Option<f64> = text.trim().parse().ok();
    value
        .filter(|v| v.is_finite())
        .ok_or_else(|| ToldError::NotANumber(text.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_read_in_the_units_of_their_names() {
        let told = fixed("rho_d=0.3").expect("it is one");
        assert_eq!(
            (told.quantity, told.value, told.std),
            (Quantity::RhoD, 0.3, 0.0)
        );
        for text in ["theta_r_deg=10±0.5", "theta_r_deg = 10 +- 0.5"] {
            let told = prior(text).expect("it is one");
            assert_eq!(told.quantity, Quantity::ThetaR);
            assert!((told.value - 10f64.to_radians()).abs() < 1e-15);
            assert!((told.std - 0.5f64.to_radians()).abs() < 1e-15);
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        assert_eq!(fixed("rho_d"), Err(ToldError::NoValue("rho_d".into())));
        assert_eq!(fixed("rho=1"), Err(ToldError::Unknown("rho".into())));
        assert_eq!(fixed("rho_d=x"), Err(ToldError::NotANumber("x".into())));
        assert!(matches!(
            prior("rho_d=0.3"),
            Err(ToldError::NoUncertainty(_))
        ));
        assert!(matches!(
            prior("rho_d=0.3±0"),
            Err(ToldError::NoUncertainty(_))
        ));
        for text in [
            "alpha_u=-0.1",
            "alpha_v=0",
            "theta_r_deg=95",
            "theta_r_deg=-1",
            "scale=0",
            "background=1e300",
            "rho_d=1.01",
            "k=-1",
        ] {
            let refused = fixed(text).expect_err(text).to_string();
            assert!(
                refused.contains(text) && refused.contains("lies from"),
                "{refused}"
            );
        }
        assert!(matches!(
            prior("alpha_u=1e-300±1e-300"),
            Err(ToldError::OutOfRange { .. })
        ));
        let refused = prior("alpha_u=0.1±1e-300")
            .expect_err("certain")
            .to_string();
        assert!(refused.contains("--fix alpha_u="), "{refused}");
    }
}
