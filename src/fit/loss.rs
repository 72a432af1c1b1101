//! Weight of residuals: least squares, or a loss that limits the influence of outliers.
//!
//! A loss ρ replaces each residual r of the sample by r̃ = sign(r) √ρ(r). Then Σ r̃² is the loss itself, and the solver
//! remains a least-squares solver with exact derivatives. At the minimum the estimate equals that of least squares with
//! weights w = ρ'(r)/(2r) (Huber 1964; Beaton and Tukey 1974); the budget uses this form. The residuals passed here are
//! divided by their standard uncertainty. Flats and priors are not transformed.
//!
//! *Conditioning.* Tukey's ρ = c²/3 (1 − (1 − u)³) is computed as r² (1 − u + u²/3), which keeps its digits at small r.
//! Beyond its limit r̃ is constant with derivative 0, so an outlier of any size harms no sum. Huber's √ρ is the root of
//! |r| minus half the limit, which is never small there.

use serde::{Deserialize, Serialize};

/// How residuals count.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Loss {
    /// Least squares.
    #[default]
    Linear,
    /// Quadratic up to 1.345 standard uncertainties, linear beyond: 95 % efficient for normal errors, with limited
    /// influence of each outlier.
    Huber,
    /// Tukey's biweight, 4.685 standard uncertainties wide: 95 % efficient for normal errors; distant outliers have no
    /// influence.
    Tukey,
}

const HUBER: f64 = 1.345;
const TUKEY: f64 = 4.685;

impl Loss {
    /// Returns r̃ and dr̃/dr.
    #[must_use]
    pub fn bent(self, r: f64) -> (f64, f64) {
        match self {
            Loss::Linear => (r, 1.0),
            Loss::Huber if r.abs() <= HUBER => (r, 1.0),
            Loss::Huber => {
                // √(c (2|r| − c)), without a product that could overflow.
                let bent = (2.0 * HUBER).sqrt() * (r.abs() - 0.5 * HUBER).sqrt();
                (bent.copysign(r), HUBER / bent)
            }
            Loss::Tukey => {
                let u = (r / TUKEY) * (r / TUKEY);
                if u >= 1.0 {
                    return ((TUKEY / 3f64.sqrt()).copysign(r), 0.0);
                }
                // ρ = c²/3 (1 − (1 − u)³) = r² (1 − u + u²/3), without cancellation at small r.
                let root = (1.0 - u + u * u / 3.0).sqrt();
                (r * root, (1.0 - u) * (1.0 - u) / root)
            }
        }
    }

    /// Returns the equivalent least-squares weight of the residual.
    #[must_use]
    pub fn weight(self, r: f64) -> f64 {
        match self {
            Loss::Linear => 1.0,
            Loss::Huber => (HUBER / r.abs()).min(1.0),
            Loss::Tukey => {
                let u = (r / TUKEY) * (r / TUKEY);
                (1.0 - u).max(0.0).powi(2)
            }
        }
    }
}

impl std::fmt::Display for Loss {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Loss::Linear => "linear",
            Loss::Huber => "huber",
            Loss::Tukey => "tukey",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bent_residual_squares_to_the_loss_and_its_slope_is_exact() {
        for loss in [Loss::Linear, Loss::Huber, Loss::Tukey] {
            for k in -60..=60 {
                let r = 0.1 * f64::from(k) + 0.013;
                let (bent, slope) = loss.bent(r);
                let h = 1e-5;
                let difference = (loss.bent(r + h).0 - loss.bent(r - h).0) / (2.0 * h);
                // Central differences: h² times the third derivative, which is below 1 here.
                assert!((difference - slope).abs() < 1e-8, "{loss} {r}");
                // ρ' = 2 r̃ dr̃/dr = 2 w r.
                assert!(
                    (bent * slope - loss.weight(r) * r).abs() < 1e-12,
                    "{loss} {r}"
                );
            }
        }
    }

    #[test]
    fn small_residuals_count_in_full_and_distant_ones_have_limited_influence() {
        for loss in [Loss::Linear, Loss::Huber, Loss::Tukey] {
            assert!((loss.bent(1e-6).0 - 1e-6).abs() < 1e-17);
        }
        let pull = |loss: Loss| loss.weight(100.0) * 100.0;
        assert!((pull(Loss::Huber) - 1.345).abs() < 1e-12);
        assert_eq!(pull(Loss::Tukey), 0.0);
    }
}
