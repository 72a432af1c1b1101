//! The coverage factor k of an expanded uncertainty U = k u.
//!
//! Source: GUM (JCGM 100:2008), annex G. U covers 95.45 % of the values: k = 2 for a normal distribution, and the quantile
//! of Student's t where the standard uncertainty itself has few degrees of freedom.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Expanded uncertainty divided by standard uncertainty for a normal distribution.
pub const COVERAGE_FACTOR: f64 = 2.0;
/// Coverage probability of [`COVERAGE_FACTOR`] for a normal distribution.
pub const COVERAGE: f64 = 0.9545;
/// Effective degrees of freedom from which on k is [`COVERAGE_FACTOR`]. There, t is larger by 2.4 %.
const FREEDOM_MANY: f64 = 50.0;
/// Degrees of freedom from which on t equals the normal distribution in all printed digits.
const FREEDOM_NORMAL: f64 = 1e4;

/// Returns Student's t of these degrees of freedom; `None` where they are unknown or large enough for a normal distribution. Fewer than
/// one count as one.
#[must_use]
pub fn student(degrees_of_freedom: Option<f64>) -> Option<StudentsT> {
    degrees_of_freedom
        .filter(|freedom| *freedom < FREEDOM_NORMAL)
        .and_then(|freedom| StudentsT::new(0.0, 1.0, freedom.max(1.0)).ok())
}

/// Returns the coverage factor k for effective degrees of freedom; `None` for infinitely many.
#[must_use]
pub fn coverage_factor(degrees_of_freedom: Option<f64>) -> f64 {
    let few = degrees_of_freedom.filter(|freedom| *freedom < FREEDOM_MANY);
    student(few).map_or(COVERAGE_FACTOR, |t| t.inverse_cdf(0.5 * (1.0 + COVERAGE)))
}

/// Returns `k = 4.07` for a factor that is not [`COVERAGE_FACTOR`]: tables state k = 2 in their headings.
#[must_use]
pub fn other_factor(factor: Option<f64>) -> Option<String> {
    factor
        .filter(|k| *k != COVERAGE_FACTOR)
        .map(|k| format!("k = {k:.2}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_degrees_of_freedom_give_the_quantile_of_students_t_and_many_give_two() {
        // GUM, table G.2, column 95.45 %.
        let table = [
            (1.0, 13.97),
            (2.0, 4.53),
            (3.0, 3.31),
            (5.0, 2.65),
            (10.0, 2.28),
            (20.0, 2.13),
            (45.0, 2.06),
        ];
        for (freedom, k) in table {
            let found = coverage_factor(Some(freedom));
            assert!((found - k).abs() < 0.006, "{freedom}: {found} {k}");
        }
        for many in [
            None,
            Some(50.0),
            Some(999.0),
            Some(f64::INFINITY),
            Some(f64::NAN),
        ] {
            assert_eq!(coverage_factor(many), COVERAGE_FACTOR, "{many:?}");
        }
        assert_eq!(coverage_factor(Some(0.3)), coverage_factor(Some(1.0)));
        let between = coverage_factor(Some(2.1));
        assert!(between > 4.0 && between < 4.53, "{between}");
    }
}
