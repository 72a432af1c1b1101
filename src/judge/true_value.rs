//! The distribution of the true value about the measured one, and what follows for tolerance limits.

use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

use super::quantity::MeasuredValue;
use crate::fit::uncertainty::coverage::student;

/// Halvings after which an interval of doubles cannot shrink any more.
const BISECTIONS: usize = 60;

/// Student's t, or the normal distribution, scaled by the standard uncertainty.
pub(super) struct TrueValue {
    value: f64,
    std: f64,
    /// `None` for a normal distribution.
    student: Option<StudentsT>,
}

impl TrueValue {
    /// The distribution that a measured value implies.
    pub(super) fn given(measured: &MeasuredValue) -> Self {
        TrueValue {
            value: measured.value,
            std: measured.std,
            student: student(measured.degrees_of_freedom),
        }
    }

    /// Distance inside a single tolerance limit at which the risk of violating it is `risk`.
    pub(super) fn guard_band(&self, risk: f64) -> f64 {
        let quantile = match &self.student {
            Some(t) => t.inverse_cdf(1.0 - risk),
            None => Normal::standard().inverse_cdf(1.0 - risk),
        };
        quantile * self.std
    }

    /// Distance inside two tolerance limits at which the risk of violating either is `risk`; `None` where no value between
    /// them has so small a risk.
    pub(super) fn guard_band_between(&self, [lower, upper]: [f64; 2], risk: f64) -> Option<f64> {
        let half = 0.5 * (upper - lower);
        let risk_at = |inside: f64| {
            let there = TrueValue {
                value: lower + inside,
                std: self.std,
                student: self.student,
            };
            there.below(lower) + there.above(upper)
        };
        // The middle has the smallest risk.
        if risk_at(half) > risk {
            return None;
        }
        let (mut too_small, mut enough) = (self.guard_band(risk).min(half), half);
        if risk_at(too_small) <= risk {
            return Some(too_small);
        }
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (too_small + enough);
            match risk_at(middle) <= risk {
                true => enough = middle,
                false => too_small = middle,
            }
        }
        Some(enough)
    }

    /// Probability that the true value lies below a limit.
    pub(super) fn below(&self, limit: f64) -> f64 {
        if self.std == 0.0 {
            return if self.value <= limit { 1.0 } else { 0.0 };
        }
        self.cdf((limit - self.value) / self.std)
    }

    /// Probability that the true value lies above a limit.
    pub(super) fn above(&self, limit: f64) -> f64 {
        if self.std == 0.0 {
            return if self.value > limit { 1.0 } else { 0.0 };
        }
        self.cdf((self.value - limit) / self.std)
    }

    fn cdf(&self, z: f64) -> f64 {
        match &self.student {
            Some(t) => t.cdf(z),
            None => Normal::standard().cdf(z),
        }
    }
}
