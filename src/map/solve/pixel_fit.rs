//! One pixel's fit, and the bounds of its parameters.

use super::kernel::{FREE, PACKED, Parameters, packed};

/// Lower bounds; ψ has none.
pub(in crate::map) const LOWER: [f64; FREE] = [0.0, f64::NEG_INFINITY, -6.9, -6.9, 0.0];
/// Upper bounds: 75°, α = 1, ρd = 1. The bound of an amplitude is [`AMPLITUDE_MAX`].
pub(in crate::map) const UPPER: [f64; FREE] = [1.309, f64::INFINITY, 0.0, 0.0, 1.0];
pub(in crate::map) const AMPLITUDE_MAX: f64 = 20.0;

/// Largest standard uncertainties of determined parameters: θr 2°, ln α 0.3.
const THETA_R_STD_MAX_RAD: f64 = 0.035;
const LN_ALPHA_STD_MAX: f64 = 0.3;

/// How a pixel's fit ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::map) enum End {
    /// The next step would be far below a standard deviation.
    Converged,
    /// No step lowers the cost, or the limit of evaluations was reached.
    Stalled,
    /// Fewer observations than [`FREE`] + 1.
    TooFew,
}

/// One pixel's fit.
#[derive(Debug, Clone, Copy)]
pub(in crate::map) struct PixelFit {
    pub(in crate::map) p: Parameters,
    /// Packed covariance for weights 1/σ; `None` if the normal matrix is singular.
    pub(in crate::map) covariance: Option<[f64; PACKED]>,
    pub(in crate::map) chi2: f64,
    pub(in crate::map) n_used: usize,
    /// Evaluations of all observations; an evaluation of a subset counts as its share.
    pub(in crate::map) evaluations: f32,
    pub(in crate::map) end: End,
}

impl PixelFit {
    /// Whether it determines all parameters, at a usual χ² per degree of freedom.
    pub(in crate::map) fn is_identifiable(&self, birge: f64) -> bool {
        let Some(covariance) = &self.covariance else {
            return false;
        };
        let std = |k: usize| (birge * covariance[packed(k, k)]).sqrt();
        std(0) < THETA_R_STD_MAX_RAD && std(2) < LN_ALPHA_STD_MAX && std(3) < LN_ALPHA_STD_MAX
    }

    /// Whether αu, αv or the fifth parameter is at a bound, or θr at its upper one.
    pub(in crate::map) fn at_bound(&self, amplitude: bool) -> bool {
        let upper = upper(amplitude);
        (2..FREE).any(|k| self.p[k] <= LOWER[k] + 1e-9 || self.p[k] >= upper[k] - 1e-9)
            || self.p[0] >= upper[0] - 1e-9
    }
}

pub(super) fn upper(amplitude: bool) -> Parameters {
    let mut upper = UPPER;
    if amplitude {
        upper[4] = AMPLITUDE_MAX;
    }
    upper
}
