//! When a finding is as expected: one tolerance per kind of expectation, none per case.

use serde::Serialize;

/// Half a unit in the last place of 1: the relative error of one rounding.
const ROUNDING: f64 = 1.0 / (1u64 << 53) as f64;
/// Roundings that a result may be off by for every unit of its condition number. A closed form is a
/// chain of up to fifty roundings of half a unit or less, which add up like a random walk
/// (½·√50 ≈ 4); a form that cancels loses thousands.
const DIGITS: f64 = 4.0;
/// Standard errors that a sampled value may be off: one row in 16,000 by chance.
const SIGMAS: f64 = 4.0;

/// A number or words.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Told {
    /// A number; JSON has null where it is not finite.
    Number(f64),
    /// Words.
    Words(String),
}

impl std::fmt::Display for Told {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Told::Number(x) if *x != 0.0 && !(1e-3..1e6).contains(&x.abs()) => {
                write!(f, "{x:.12e}")
            }
            Told::Number(x) => write!(f, "{x:.12}"),
            Told::Words(words) => f.write_str(words),
        }
    }
}

/// An expectation beside a finding.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judged {
    /// What is expected.
    pub expected: Told,
    /// What was found.
    pub found: Told,
    /// How far a number may be off; null for words.
    pub allowed: Option<f64>,
    /// The verdict.
    pub as_expected: bool,
}

impl Judged {
    /// How much of what is allowed the finding is off by; `None` for words and where nothing is allowed.
    #[must_use]
    pub fn share(&self) -> Option<f64> {
        match (&self.expected, &self.found, self.allowed) {
            (Told::Number(expected), Told::Number(found), Some(allowed)) if allowed > 0.0 => {
                Some((found - expected).abs() / allowed)
            }
            _ => None,
        }
    }
}

fn near(expected: f64, found: f64, allowed: f64) -> Judged {
    Judged {
        expected: Told::Number(expected),
        found: Told::Number(found),
        allowed: Some(allowed),
        // A NaN is near nothing.
        as_expected: (found - expected).abs() <= allowed,
    }
}

/// A value in doubles against one that is exact, with its relative condition number.
#[must_use]
pub fn digits(expected: f64, condition: f64, found: f64) -> Judged {
    // What is nothing, or below the smallest double, has no digits that a condition could multiply.
    let allowed = if expected == 0.0 {
        0.0
    } else {
        DIGITS * ROUNDING * (1.0 + condition) * expected.abs()
    };
    near(expected, found, allowed + f64::MIN_POSITIVE)
}

/// A sampled value against an exact one; tallies are kept to 2⁻⁸², sums of them to rounding.
#[must_use]
pub fn sampled(expected: f64, std: f64, found: f64) -> Judged {
    near(expected, found, SIGMAS * std + 1e3 * ROUNDING)
}

/// A value against its limit, `distance` from it in the small parameter that goes to zero.
#[must_use]
pub fn limit(expected: f64, distance: f64, found: f64) -> Judged {
    near(expected, found, distance * (1.0 + expected.abs()))
}

/// A fitted value with its standard uncertainty against the truth that was put in.
#[must_use]
pub fn covered(truth: f64, std: f64, found: f64) -> Judged {
    near(truth, found, SIGMAS * std)
}

/// A value that must be no number at all but a reason that says `word`.
#[must_use]
pub fn refused(word: &str, found: &Result<String, String>) -> Judged {
    let (told, as_expected) = match found {
        Ok(value) => (value.clone(), false),
        Err(reason) => (reason.clone(), reason.contains(word)),
    };
    Judged {
        expected: Told::Words(format!("refused: {word}")),
        found: Told::Words(told),
        allowed: None,
        as_expected,
    }
}

/// Words that must be one of some.
#[must_use]
pub fn one_of(expected: &[&str], found: &str) -> Judged {
    Judged {
        expected: Told::Words(expected.join(" or ")),
        found: Told::Words(found.to_owned()),
        allowed: None,
        as_expected: expected.contains(&found),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_number_is_never_as_expected() {
        assert!(!digits(1.0, 1.0, f64::NAN).as_expected);
        assert!(!sampled(1.0, f64::NAN, 1.0).as_expected);
        assert!(!covered(1.0, 0.1, f64::INFINITY).as_expected);
        assert!(!refused("horizon", &Ok("0.1".to_owned())).as_expected);
        assert!(!refused("horizon", &Err("not finite".to_owned())).as_expected);
    }

    #[test]
    fn a_finding_says_how_much_of_its_allowance_it_took() {
        assert!((covered(1.0, 0.5, 2.0).share().unwrap() - 0.5).abs() < 1e-12);
        assert_eq!(one_of(&["a"], "a").share(), None);
        assert!(covered(1.0, 0.5, f64::NAN).share().unwrap().is_nan());
    }

    #[test]
    fn the_last_digit_times_the_condition_is_allowed_and_no_more() {
        assert!(digits(1.0, 0.0, 1.0 + 2.0 * f64::EPSILON).as_expected);
        assert!(!digits(1.0, 0.0, 1.0 + 3.0 * f64::EPSILON).as_expected);
        assert!(digits(1.0, 100.0, 1.0 + 200.0 * f64::EPSILON).as_expected);
        assert!(digits(0.0, f64::INFINITY, 0.0).as_expected);
        assert!(!digits(0.0, f64::INFINITY, 1e-300).as_expected);
    }
}
