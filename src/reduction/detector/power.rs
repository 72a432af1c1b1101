//! A power law of the camera, counts ∝ light^γ, which exposures of one pose cannot distinguish from errors of the clock.
//!
//! Under it the ratio of two exposures of one pose is (t₂/t₁)^γ at every level, as if the exposure times had errors that
//! follow ln t with the slope γ − 1. Corrected for such errors, every signal is the same constant times light^γ. A fit of the
//! surface can therefore decide between both ([`crate::fit`]).

use super::{
    CurveFit, CurvePrior, Detector, EXPOSURE_REL_STD_DEFAULT, NEARLY_NONE, SIGNIFICANT_SIZE, TIMES,
    Visit, residuals,
};
use crate::observation::PowerLaw;

/// Range of γ that cameras without a setting of gamma for display have. Beyond it the times in the list are wrong.
const EXPONENTS: std::ops::RangeInclusive<f64> = 0.7..=1.4;
/// Standard uncertainties of an exposure time within which the errors follow ln t.
const ALONG_SIGMAS: f64 = 3.0;

/// Returns the power law that explains the errors of the exposure times as well; `None` if they do not follow ln t.
pub(super) fn power_law(
    visits: &[Visit],
    f: &CurveFit,
    known: &CurvePrior,
    stated: Option<f64>,
) -> Option<PowerLaw> {
    let n = known.times_s.len() as f64;
    let logs: Vec<f64> = known.times_s.iter().map(|s| s.ln()).collect();
    let errors = &f.x.as_slice()[TIMES..];
    let mean = logs.iter().sum::<f64>() / n;
    let of_errors = errors.iter().sum::<f64>() / n;
    let square: f64 = logs.iter().map(|x| (x - mean).powi(2)).sum();
    let along: f64 = (logs.iter().zip(errors))
        .map(|(x, error)| (x - mean) * (error - of_errors))
        .sum();
    let slope = along / square;
    let std = stated.unwrap_or(EXPOSURE_REL_STD_DEFAULT).max(NEARLY_NONE);
    let limit = SIGNIFICANT_SIZE.max(ALONG_SIGMAS * std);
    let follows = (logs.iter().zip(errors))
        .all(|(x, error)| (error - of_errors - slope * (x - mean)).abs() < limit);
    let exponent = 1.0 + slope;
    let (low, high) = (logs.iter()).fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| {
        (low.min(*x), high.max(*x))
    });
    let mut none = f.x.clone();
    none.rows_mut(TIMES, errors.len()).fill(0.0);
    let kept = visits.iter().zip(&f.kept).filter(|(_, kept)| **kept);
    let rows = kept.flat_map(|(visit, _)| residuals(visit, known, &none, f.flicker));
    let chi2_without: f64 = rows.map(|(w, r, _)| w * r * r).sum();
    (follows && EXPONENTS.contains(&exponent)).then(|| PowerLaw {
        exponent,
        std: std / square.sqrt(),
        spread: (slope * (high - low)).abs(),
        explains: (1.0 - f.chi2 / chi2_without).clamp(0.0, 1.0),
        pairs: f.pairs,
        instead_of: String::new(),
    })
}

impl Detector {
    /// Returns the power law that the fit of the surface may prefer to errors of the exposure times, with the warning of the
    /// latter.
    pub(in crate::reduction) fn power_law(&self) -> Option<PowerLaw> {
        let law = self.power_law.clone()?;
        Some(PowerLaw {
            instead_of: self.words()?,
            ..law
        })
    }
}
