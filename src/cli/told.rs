//! What a user knows of a parameter before a fit, from the command line: `rho_d=0.3` holds it,
//! `theta_r_deg=10±0.5` (or `10+-0.5`) leaves it free within a standard uncertainty.

use crate::fit::{Quantity, Told};

/// Names as in the report, with the quantity and whether the value is in degrees.
const NAMES: [(&str, Quantity, bool); 10] = [
    ("theta_r_deg", Quantity::ThetaR, true),
    ("alpha_u", Quantity::AlphaU, false),
    ("alpha_v", Quantity::AlphaV, false),
    ("rho_d", Quantity::RhoD, false),
    ("scale", Quantity::Scale, false),
    ("background", Quantity::Background, false),
    ("azimuth_offset_deg", Quantity::AzimuthOffset, true),
    ("tilt_offset_deg", Quantity::TiltOffset, true),
    ("eta", Quantity::Eta, false),
    ("k", Quantity::K, false),
];

/// Why a text is no statement about a parameter.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum ToldError {
    /// No `=` in it.
    #[error("'{0}' has no '='; write NAME=VALUE, for example rho_d=0.3")]
    NoValue(String),
    /// The name is none of a parameter.
    #[error("'{0}' is no parameter; take one of {names}", names = names())]
    Unknown(String),
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
    let (quantity, unit, value) = named(text)?;
    Ok(Told {
        quantity,
        value: number(value)? * unit,
        std: 0.0,
    })
}

/// `NAME=VALUE±STD` or `NAME=VALUE+-STD`: known within a standard uncertainty.
///
/// # Errors
/// See [`ToldError`].
pub fn prior(text: &str) -> Result<Told, ToldError> {
    let (quantity, unit, value) = named(text)?;
    let (mean, std) = value
        .split_once('±')
        .or_else(|| value.split_once("+-"))
        .ok_or_else(|| ToldError::NoUncertainty(text.to_owned()))?;
    let std = number(std)?;
    if std <= 0.0 {
        return Err(ToldError::NoUncertainty(text.to_owned()));
    }
    Ok(Told {
        quantity,
        value: number(mean)? * unit,
        std: std * unit,
    })
}

fn named(text: &str) -> Result<(Quantity, f64, &str), ToldError> {
    let (name, value) = text
        .split_once('=')
        .ok_or_else(|| ToldError::NoValue(text.to_owned()))?;
    let known = NAMES.iter().find(|(known, ..)| *known == name.trim());
    let (_, quantity, degrees) = known.ok_or_else(|| ToldError::Unknown(name.to_owned()))?;
    let unit = if *degrees { 1f64.to_radians() } else { 1.0 };
    Ok((*quantity, unit, value))
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
    }
}
