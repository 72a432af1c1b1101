//! Constraints of a fit from the command line: `rho_d=0.3` fixes a parameter, `theta_r_deg=10±0.5` (or `10+-0.5`) states
//! a prior with a standard uncertainty. The `fit` module checks names and ranges.

use crate::fit::Constraint;
use crate::fit::constraints::{StatementError, held, known};

/// Why a text is not a constraint.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ConstraintArgError {
    /// No `=` in it.
    #[error("'{0}' has no '='; write NAME=VALUE, for example rho_d=0.3")]
    NoValue(String),
    /// Not a number.
    #[error("'{0}' is not a finite number")]
    NotANumber(String),
    /// A prior without its uncertainty.
    #[error(
        "'{0}' has no uncertainty; write NAME=VALUE±STD with a positive STD, for example theta_r_deg=10±0.5"
    )]
    NoUncertainty(String),
    /// A constraint that the fit refuses.
    #[error("'{text}': {problem}")]
    Refused {
        /// The text.
        text: String,
        /// The reason.
        problem: StatementError,
    },
}

/// Reads `NAME=VALUE`: a fixed parameter.
///
/// # Errors
/// See [`ConstraintArgError`].
pub fn fixed(text: &str) -> Result<Constraint, ConstraintArgError> {
    let (name, stated) = parted(text)?;
    held(name, number(stated)?).map_err(|problem| refused(text, problem))
}

/// Reads `NAME=VALUE±STD` or `NAME=VALUE+-STD`: a prior with a standard uncertainty.
///
/// # Errors
/// See [`ConstraintArgError`].
pub fn prior(text: &str) -> Result<Constraint, ConstraintArgError> {
    let (name, stated) = parted(text)?;
    let (mean, std) = stated
        .split_once('±')
        .or_else(|| stated.split_once("+-"))
        .ok_or_else(|| ConstraintArgError::NoUncertainty(text.to_owned()))?;
    match known(name, number(mean)?, number(std)?) {
        Err(StatementError::NoUncertainty { .. }) => {
            Err(ConstraintArgError::NoUncertainty(text.to_owned()))
        }
        other => other.map_err(|problem| refused(text, problem)),
    }
}

fn refused(text: &str, problem: StatementError) -> ConstraintArgError {
    let text = text.to_owned();
    ConstraintArgError::Refused { text, problem }
}

/// Splits a text into name and value.
fn parted(text: &str) -> Result<(&str, &str), ConstraintArgError> {
    let (name, stated) = text
        .split_once('=')
        .ok_or_else(|| ConstraintArgError::NoValue(text.to_owned()))?;
    Ok((name.trim(), stated))
}

fn number(text: &str) -> Result<f64, ConstraintArgError> {
    let value: Option<f64> = text.trim().parse().ok();
    value
        .filter(|v| v.is_finite())
        .ok_or_else(|| ConstraintArgError::NotANumber(text.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::Quantity;

    #[test]
    fn values_are_read_in_the_units_of_their_names() {
        let constraint = fixed("rho_d=0.3").expect("it is one");
        assert_eq!(
            (constraint.quantity, constraint.value, constraint.std),
            (Quantity::RhoD, 0.3, 0.0)
        );
        for text in ["theta_r_deg=10±0.5", "theta_r_deg = 10 +- 0.5"] {
            let constraint = prior(text).expect("it is one");
            assert_eq!(constraint.quantity, Quantity::ThetaR);
            assert!((constraint.value - 10f64.to_radians()).abs() < 1e-15);
            assert!((constraint.std - 0.5f64.to_radians()).abs() < 1e-15);
        }
    }

    #[test]
    fn a_refusal_names_the_wrong_part() {
        assert_eq!(
            fixed("rho_d"),
            Err(ConstraintArgError::NoValue("rho_d".into()))
        );
        let refused = fixed("rho=1").expect_err("no name").to_string();
        assert!(refused.contains("unknown parameter 'rho'"), "{refused}");
        assert_eq!(
            fixed("rho_d=x"),
            Err(ConstraintArgError::NotANumber("x".into()))
        );
        assert!(matches!(
            prior("rho_d=0.3"),
            Err(ConstraintArgError::NoUncertainty(_))
        ));
        assert!(matches!(
            prior("rho_d=0.3±0"),
            Err(ConstraintArgError::NoUncertainty(_))
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
                refused.contains(text) && refused.contains("out of range"),
                "{refused}"
            );
        }
        assert!(matches!(
            prior("alpha_u=1e-300±1e-300"),
            Err(ConstraintArgError::Refused {
                problem: StatementError::OutOfRange { .. },
                ..
            })
        ));
        let refused = prior("alpha_u=0.1±1e-300")
            .expect_err("certain")
            .to_string();
        assert!(
            refused.contains("alpha_u") && refused.contains("hold the value fixed"),
            "{refused}"
        );
    }
}
