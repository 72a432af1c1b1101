//! Scatter of repeated results beside their stated uncertainty.

use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Below this probability the scatter is larger, and above one minus it smaller, than the uncertainty explains.
const UNLIKELY: f64 = 0.05;

/// A result with its uncertainties.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Repeated {
    /// Which part, from 0.
    pub part: usize,
    /// Value.
    pub value: f64,
    /// Standard uncertainty with all lines of the budget.
    pub std: f64,
    /// Standard uncertainty without the lines that have the same error in all results.
    pub scattering_std: f64,
    /// Expanded uncertainty.
    pub expanded: f64,
}

/// Whether the scatter is as large as stated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ScatterVerdict {
    /// The stated uncertainty explains the scatter.
    Consistent,
    /// The scatter is larger: the budget lacks an effect.
    TooLarge,
    /// The scatter is smaller: a line of the budget has the same error in all results, or is too large.
    Small,
}

impl ScatterVerdict {
    /// Returns what it means, and what to do.
    #[must_use]
    pub const fn message(self) -> &'static str {
        match self {
            ScatterVerdict::Consistent => "The scatter is consistent with the stated uncertainty.",
            ScatterVerdict::TooLarge => {
                "The scans scatter more than the stated uncertainty explains. Look for an effect that the budget does not \
                 have, such as remounting."
            }
            ScatterVerdict::Small => {
                "The scans scatter less than stated. Lines of the budget with the same error in all scans do not scatter; \
                 state them as shared to test the rest."
            }
        }
    }
}

/// Scatter within parts beside the stated uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Scatter {
    /// Number of results.
    pub n: usize,
    /// Number of parts.
    pub n_parts: usize,
    /// Mean of the results, in the unit of the parameter; null for several parts.
    pub mean: Option<f64>,
    /// Scatter s: standard deviation of one result about the mean of its part.
    pub std: f64,
    /// Interval of 95 % for it, of normal errors.
    pub std_interval: [f64; 2],
    /// Degrees of freedom of s and χ².
    pub degrees_of_freedom: usize,
    /// Root mean square of the stated standard uncertainties u (k = 1).
    pub stated_std: f64,
    /// Root mean square of the stated expanded uncertainties U.
    pub stated_expanded: f64,
    /// As `stated_std`, without the lines of the budget that have the same error in all results.
    pub scattering_std: f64,
    /// s divided by `scattering_std`; null where that is zero.
    pub ratio: Option<f64>,
    /// χ² of the results about the weighted mean of their part, with `scattering_std`; null where a result has none.
    pub chi_square: Option<f64>,
    /// Probability of a χ² at least this large if the stated uncertainty is right.
    pub probability: Option<f64>,
    /// Whether the scatter is as large as stated.
    pub verdict: Option<ScatterVerdict>,
    /// What the verdict means, and what to do.
    pub message: Option<String>,
}

/// Returns the scatter; none where no part has two results.
#[must_use]
pub fn scatter(results: &[Repeated]) -> Option<Scatter> {
    let n_parts = results.iter().map(|r| r.part + 1).max()?;
    let freedom = results.len().checked_sub(n_parts).filter(|n| *n > 0)?;
    let mut squares = 0.0;
    let mut chi_square = Some(0.0);
    let mut mean = None;
    for part in 0..n_parts {
        let own: Vec<&Repeated> = results.iter().filter(|r| r.part == part).collect();
        let centre = own.iter().map(|r| r.value).sum::<f64>() / own.len() as f64;
        mean = (n_parts == 1).then_some(centre);
        squares += own.iter().map(|r| (r.value - centre).powi(2)).sum::<f64>();
        let weighted = weighted_squares(&own);
        chi_square = chi_square.and_then(|sum| Some(sum + weighted?));
    }
    let std = (squares / freedom as f64).sqrt();
    let chi = ChiSquared::new(freedom as f64).ok()?;
    let end = |p: f64| (squares / chi.inverse_cdf(p)).sqrt();
    let rms = |of: fn(&Repeated) -> f64| {
        let sum = results.iter().map(|r| of(r).powi(2)).sum::<f64>();
        (sum / results.len() as f64).sqrt()
    };
    let scattering_std = rms(|r| r.scattering_std);
    let probability = chi_square.map(|x| chi.sf(x));
    let verdict = probability.map(|p| match p {
        p if p < UNLIKELY => ScatterVerdict::TooLarge,
        p if p > 1.0 - UNLIKELY => ScatterVerdict::Small,
        _ => ScatterVerdict::Consistent,
    });
    Some(Scatter {
        n: results.len(),
        n_parts,
        mean,
        std,
        std_interval: [end(0.975), end(0.025)],
        degrees_of_freedom: freedom,
        stated_std: rms(|r| r.std),
        stated_expanded: rms(|r| r.expanded),
        scattering_std,
        ratio: (scattering_std > 0.0).then(|| std / scattering_std),
        chi_square,
        probability,
        verdict,
        message: verdict.map(|verdict| verdict.message().to_owned()),
    })
}

/// χ² about the weighted mean; none where a result has no uncertainty of its own.
fn weighted_squares(own: &[&Repeated]) -> Option<f64> {
    let mut sums = (0.0, 0.0);
    for result in own {
        let weight = result.scattering_std.powi(-2);
        if !weight.is_finite() {
            return None;
        }
        sums = (sums.0 + weight, sums.1 + weight * result.value);
    }
    let centre = sums.1 / sums.0;
    let terms = own
        .iter()
        .map(|r| ((r.value - centre) / r.scattering_std).powi(2));
    Some(terms.sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn repeated(part: usize, value: f64, std: f64) -> Repeated {
        Repeated {
            part,
            value,
            std,
            scattering_std: std,
            expanded: 2.0 * std,
        }
    }

    #[test]
    fn scatter_and_chi_square_are_those_of_the_text_book() {
        let values = [10.01, 10.05, 9.97, 10.02].map(|v| repeated(0, v, 0.02));
        let found = scatter(&values).unwrap();
        assert!((found.mean.unwrap() - 10.0125).abs() < 1e-12);
        // s² = 3.275e-3 / 3
        assert!((found.std - 0.033_040_4).abs() < 1e-6, "{found:?}");
        assert!((found.chi_square.unwrap() - 8.1875).abs() < 1e-9);
        // erfc √(x/2) + √(2x/π) e^(−x/2) for three degrees of freedom.
        assert!(
            (found.probability.unwrap() - 0.042_291_490_5).abs() < 1e-9,
            "{found:?}"
        );
        assert_eq!(found.verdict, Some(ScatterVerdict::TooLarge));
        assert!((found.ratio.unwrap() - 1.652).abs() < 1e-3);
        // Table of χ² with 3 degrees of freedom: 0.2158 and 9.348.
        let [low, high] = found.std_interval;
        assert!((low - (3.275e-3_f64 / 9.348).sqrt()).abs() < 1e-5);
        assert!((high - (3.275e-3_f64 / 0.2158).sqrt()).abs() < 1e-4);
    }

    #[test]
    fn several_parts_scatter_each_about_its_own_mean() {
        let apart = [(0, 1.0), (0, 1.2), (1, 5.0), (1, 5.2), (2, 7.0)];
        let values = apart.map(|(part, v)| repeated(part, v, 0.1));
        let found = scatter(&values).unwrap();
        assert_eq!(
            (found.degrees_of_freedom, found.n_parts, found.mean),
            (2, 3, None)
        );
        assert!((found.std - 0.02_f64.sqrt()).abs() < 1e-12);
        assert_eq!(found.verdict, Some(ScatterVerdict::Consistent));
    }

    #[test]
    fn without_repeats_there_is_no_scatter_and_without_uncertainty_no_test() {
        assert_eq!(scatter(&[]), None);
        assert_eq!(
            scatter(&[repeated(0, 1.0, 0.1), repeated(1, 2.0, 0.1)]),
            None
        );
        let exact = scatter(&[repeated(0, 1.0, 0.0), repeated(0, 2.0, 0.0)]).unwrap();
        assert_eq!(
            (exact.chi_square, exact.ratio, exact.verdict),
            (None, None, None)
        );
        let wide = scatter(&[
            repeated(0, 1.0, 9.0),
            repeated(0, 1.1, 9.0),
            repeated(0, 0.9, 9.0),
        ]);
        assert_eq!(wide.unwrap().verdict, Some(ScatterVerdict::Small));
    }
}
