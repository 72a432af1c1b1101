//! Whether a result is as expected: one tolerance per kind of expectation, none per case.

use serde::Serialize;

/// Half a unit in the last place of 1: the relative error of one rounding.
const ROUNDING: f64 = 1.0 / (1u64 << 53) as f64;
/// Allowed roundings per unit of the condition number. A closed form is a
/// chain of up to fifty roundings of at most half a unit, which add up like a random walk
/// (½·√50 ≈ 4); a form with cancellation loses thousands.
const DIGITS: f64 = 4.0;
/// Allowed standard errors of a sampled value: one row in 16,000 exceeds them by chance.
const SIGMAS: f64 = 4.0;

/// A number or words.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum CheckValue {
    /// A number; JSON has null where it is not finite.
    Number(f64),
    /// Words.
    Words(String),
}

impl std::fmt::Display for CheckValue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            CheckValue::Number(x) if *x != 0.0 && !(1e-3..1e6).contains(&x.abs()) => {
                write!(f, "{x:.12e}")
            }
            CheckValue::Number(x) => write!(f, "{x:.12}"),
            CheckValue::Words(words) => f.write_str(words),
        }
    }
}

/// An expected and an actual value.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judged {
    /// Expected value.
    pub expected: CheckValue,
    /// Actual value.
    pub found: CheckValue,
    /// Allowed difference of numbers; null for words.
    pub allowed: Option<f64>,
    /// Whether they agree.
    pub as_expected: bool,
}

impl Judged {
    /// The difference as a share of the allowed one; `None` for words and where no difference is allowed.
    #[must_use]
    pub fn share(&self) -> Option<f64> {
        match (&self.expected, &self.found, self.allowed) {
            (CheckValue::Number(expected), CheckValue::Number(found), Some(allowed))
                if allowed > 0.0 =>
            {
                Some((found - expected).abs() / allowed)
            }
            _ => None,
        }
    }
}

fn near(expected: f64, found: f64, allowed: f64) -> Judged {
    Judged {
        expected: CheckValue::Number(expected),
        found: CheckValue::Number(found),
        allowed: Some(allowed),
        // False for NaN.
        as_expected: (found - expected).abs() <= allowed,
    }
}

/// Compares a value in doubles with an exact one, given its relative condition number.
#[must_use]
pub fn digits(expected: f64, condition: f64, found: f64) -> Judged {
    // A zero has no digits that a condition number could multiply.
    let allowed = if expected == 0.0 {
        0.0
    } else {
        DIGITS * ROUNDING * (1.0 + condition) * expected.abs()
    };
    near(expected, found, allowed + f64::MIN_POSITIVE)
}

/// Compares a sampled value with an exact one. Tallies are exact to 2⁻⁸², their sums to rounding.
#[must_use]
pub fn sampled(expected: f64, std: f64, found: f64) -> Judged {
    near(expected, found, SIGMAS * std + 1e3 * ROUNDING)
}

/// Compares a value with its limit; `distance` is the small parameter that vanishes in the limit.
#[must_use]
pub fn limit(expected: f64, distance: f64, found: f64) -> Judged {
    near(expected, found, distance * (1.0 + expected.abs()))
}

/// Compares a fitted value and its standard uncertainty with the known truth.
#[must_use]
pub fn covered(truth: f64, std: f64, found: f64) -> Judged {
    near(truth, found, SIGMAS * std)
}

/// Expects a refusal whose reason contains `word`.
#[must_use]
pub fn refused(word: &str, found: &Result<String, String>) -> Judged {
    let (words, as_expected) = match found {
        Ok(value) => (value.clone(), false),
        Err(reason) => (reason.clone(), reason.contains(word)),
    };
    Judged {
        expected: CheckValue::Words(format!("refused: {word}")),
        found: CheckValue::Words(words),
        allowed: None,
        as_expected,
    }
}

/// Expects one of several words.
#[must_use]
pub fn one_of(expected: &[&str], found: &str) -> Judged {
    Judged {
        expected: CheckValue::Words(expected.join(" or ")),
        found: CheckValue::Words(found.to_owned()),
        allowed: None,
        as_expected: expected.contains(&found),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_that_is_not_finite_is_never_as_expected() {
        assert!(!digits(1.0, 1.0, f64::NAN).as_expected);
        assert!(!sampled(1.0, f64::NAN, 1.0).as_expected);
        assert!(!covered(1.0, 0.1, f64::INFINITY).as_expected);
        assert!(!refused("horizon", &Ok("0.1".to_owned())).as_expected);
        assert!(!refused("horizon", &Err("not finite".to_owned())).as_expected);
    }

    #[test]
    fn the_share_of_the_allowed_difference_is_reported() {
        assert!((covered(1.0, 0.5, 2.0).share().unwrap() - 0.5).abs() < 1e-12);
        assert_eq!(one_of(&["a"], "a").share(), None);
        assert!(covered(1.0, 0.5, f64::NAN).share().unwrap().is_nan());
    }

    #[test]
    fn only_the_last_digits_times_the_condition_are_allowed() {
        assert!(digits(1.0, 0.0, 1.0 + 2.0 * f64::EPSILON).as_expected);
        assert!(!digits(1.0, 0.0, 1.0 + 3.0 * f64::EPSILON).as_expected);
        assert!(digits(1.0, 100.0, 1.0 + 200.0 * f64::EPSILON).as_expected);
        assert!(digits(0.0, f64::INFINITY, 0.0).as_expected);
        assert!(!digits(0.0, f64::INFINITY, 1e-300).as_expected);
    }
}
