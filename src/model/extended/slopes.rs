//! Slopes of a rough wall with tails: Student's t in two dimensions, which includes Beckmann and GGX.
//!
//! ```text
//! P(x, y) = 1/(π αu αv) · (1 + ι q)^−γ,   q = x²/αu² + y²/αv²,   ι = 1/(γ − 1)
//! ```
//!
//! (Ribardière et al. 2017; reference 7 of the second paper.) ι = 0 is Beckmann's exp(−q), ι = 1 is GGX (γ = 2); ι is
//! the *tail*. The density is regular at ι = 0, so a fit may start there. α is the same scale for all; the quantity
//! to compare between distributions is the half width: [`half_width_over_alpha`].
//!
//! *Conditioning.* ln P is −(1 + ι) q g(ι q) with g(z) = ln(1 + z)/z, which has no cancellation at 0.

use std::f64::consts::PI;

use crate::model::number::Number;

/// Largest tail of a search: γ = 5/3, below which the mean slope hardly exists.
pub const TAIL_MAX: f64 = 1.5;

/// Roughness of a wall's slopes as squares of α, the cones of lamp and lens included, with their tail.
#[derive(Clone, Copy)]
pub(super) struct Slopes<N> {
    pub u2: N,
    pub v2: N,
    pub tail: N,
    /// Contribution of the cones to both squares.
    pub widening: f64,
}

impl<N: Number> Slopes<N> {
    /// Returns P(x, y) π √(αu² αv²): the density without its norm.
    pub(super) fn relative(&self, x2: N, y2: N) -> N {
        let (one, two) = (x2.like(1.0), x2.like(2.0));
        let (qx, qy) = (x2 / self.u2, y2 / self.v2);
        let q = qx + qy;
        let density = relative_density(self.tail, q);
        let z = self.tail * q;
        let steep = one + self.tail;
        if self.widening == 0.0 {
            return density;
        }
        // A disc of variance R²/16 per axis widens P by R²/32 ∇²P. The squares of α already include the part that is
        // correct without tails.
        let per = steep / (one + z);
        let sum = one / self.u2 + one / self.v2;
        let square = qx / self.u2 + qy / self.v2;
        let bend = square * per * ((one + two * self.tail) / (one + z) - one);
        let rest = bend - (sum * (per - one)).times(0.5);
        density * rest.times(self.widening).exponential()
    }

    /// Returns 1/(π √(αu² αv²)).
    pub(super) fn norm(&self) -> N {
        let root = (self.u2 * self.v2).root();
        root.like(1.0 / PI) / root
    }

    /// Returns the share of slopes below b on an axis of roughness α: Φ(b/α) for Beckmann, Student's t with tails
    /// (Wallace 1959, within 2e-3).
    pub(super) fn share_below(&self, b: N) -> N {
        let z = (self.tail * b * b).times(0.5);
        let stretched = (log_over(z)).root() * b;
        let sixteen = b.like(16.0);
        let factor = (sixteen + self.tail) / (sixteen + self.tail.times(3.0));
        (stretched * factor).map(|x| {
            let slope = (-0.5 * x * x).exp() / (2.0 * PI).sqrt();
            (
                0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2),
                slope,
            )
        })
    }
}

/// Returns P π αu αv, the density over its peak, where the slopes have q = x²/αu² + y²/αv².
pub fn relative_density<N: Number>(tail: N, q: N) -> N {
    let steep = q.like(1.0) + tail;
    (-(steep * q * log_over(tail * q))).exponential()
}

/// Returns ln(1 + z)/z.
fn log_over<N: Number>(z: N) -> N {
    z.map(|z| {
        if z.abs() < 1e-3 {
            let value = 1.0 - z * (0.5 - z * (1.0 / 3.0 - z * (0.25 - z * 0.2)));
            let slope = -0.5 + z * (2.0 / 3.0 - z * (0.75 - z * 0.8));
            (value, slope)
        } else {
            let value = z.ln_1p() / z;
            (value, (1.0 / (1.0 + z) - value) / z)
        }
    })
}

/// Returns the Beckmann roughness of the same half width at half maximum, over α: √((γ − 1)(2^{1/γ} − 1)/ln 2); 1
/// without tails.
#[must_use]
pub fn half_width_over_alpha(tail: f64) -> f64 {
    if tail <= 0.0 {
        return 1.0;
    }
    let per_gamma = tail / (1.0 + tail);
    ((per_gamma * std::f64::consts::LN_2).exp_m1() / tail / std::f64::consts::LN_2).sqrt()
}

/// Returns the tail of a γ above 1.
#[must_use]
pub fn tail(gamma: f64) -> f64 {
    1.0 / (gamma - 1.0)
}

/// Returns γ of a tail; `None` for Beckmann.
#[must_use]
pub fn gamma(tail: f64) -> Option<f64> {
    (tail > 0.0).then(|| 1.0 + 1.0 / tail)
}
