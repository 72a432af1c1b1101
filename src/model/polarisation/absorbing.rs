//! A smooth boundary with an absorbing layer on one side, or on both.
//!
//! Light in such a layer is a wave whose planes of equal amplitude are parallel to its surface, as below any plane
//! through which light enters from outside. With S = n₁ sin θ of the medium that it came from, equal in all media,
//! q² = N² − S² and Im q ≥ 0, it travels at tan θ = S/Re q and decays by 2 Im q per unit of vacuum phase. So its angle
//! determines S:
//!
//! ```text
//! S = m sin θ,  Re q = m cos θ,  Re q Im q = n k,  m² = ½ [n² − k² + √((n² − k²)² + 4 n²k²/cos² θ)]
//! ```
//!
//! which is Snell's law with the index m of this direction. Amplitudes are r_s = (q₁ − q₂)/(q₁ + q₂) and
//! r_p = (N₂²q₁ − N₁²q₂)/(N₂²q₁ + N₁²q₂). Light that is not reflected continues, except into a metal and under total
//! reflection at a transparent medium: there the layer absorbs the rest.
//!
//! *Approximation.* Within an absorbing layer the incident and the reflected beam interfere next to the boundary.
//! Therefore the reflected and refracted powers add up to 1 + 4 (Im r)²/(1 − |r|²) in place of 1, and p under total
//! reflection steeper than 45° may be reflected with more than its power. Here they add up to 1 and no power exceeds
//! 1, so no photon gains weight. [`excess`] returns the size of this approximation.

use nalgebra::Complex;

use super::{Channel, Split};
use crate::model::fresnel::{principal_sqrt, sin_squared};

/// The media on both sides, relative to the real index of the one that light comes from.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Media {
    here: Complex<f64>,
    beyond: Complex<f64>,
    /// N₂² − N₁², formed without cancellation.
    lift: Complex<f64>,
    /// Whether light can continue beyond.
    enters: bool,
}

/// Returns the square of the direction-dependent index m, for light at cos θ = `cos` in a medium.
fn apparent_squared(index: Complex<f64>, cos: f64) -> f64 {
    let (n, k) = (index.re, index.im);
    let lift = (n - k) * (n + k);
    0.5 * (lift + lift.hypot(2.0 * n * k / cos))
}

/// Returns the optical depth along the path of light at cos θ = `cos`, over that of the straight path through the
/// layer. It differs slightly from 1/cos θ, since the direction-dependent index differs from n.
#[must_use]
pub fn slant(index: Complex<f64>, cos: f64) -> f64 {
    index.re / (apparent_squared(index, cos).sqrt() * cos)
}

impl Media {
    pub(super) fn new(here: Complex<f64>, beyond: Complex<f64>, enters: bool) -> Self {
        let unit = 1.0 / here.re;
        let (a, b) = (here * unit, beyond * unit);
        Media {
            here: a,
            beyond: b,
            lift: ((beyond - here) * unit) * (a + b),
            enters,
        }
    }

    pub(super) fn enters(&self) -> bool {
        self.enters
    }

    pub(super) fn at(&self, cos: f64) -> Split {
        let (a, b) = (self.here, self.beyond);
        let apparent = apparent_squared(a, cos);
        let across = apparent.sqrt() * cos;
        let q_a = Complex::new(across, a.im / across);
        let along = sin_squared(cos) * apparent;
        // q₂² = q₁² + (N₂² − N₁²).
        let q_b = principal_sqrt(if b.im == 0.0 {
            Complex::new(b.re * b.re - along, 0.0)
        } else {
            q_a * q_a + self.lift
        });
        let (a2, b2) = (a * a, b * b);
        let over_s = 1.0 / (q_a + q_b);
        let over_p = 1.0 / (b2 * q_a + a2 * q_b);
        let r_s = -self.lift * over_s * over_s;
        let r_p = (self.lift * over_p) * ((a2 * b2 - (a2 + b2) * along) * over_p);
        let (s, p) = (r_s.norm_sqr().min(1.0), r_p.norm_sqr().min(1.0));
        let z = of_modulus(r_s * r_p.conj(), (s * p).sqrt());
        let reflected = Channel {
            s,
            p,
            re: z.re,
            im: z.im,
        };
        if !self.enters || q_b.re <= 0.0 {
            return Split {
                reflected,
                refracted: Channel::NONE,
                cos_refracted: 0.0,
                ratio: 1.0,
            };
        }
        let (s, p) = (1.0 - s, 1.0 - p);
        let z = of_modulus(over_s * (a * b * over_p).conj(), (s * p).sqrt());
        let apparent_beyond = (along + q_b.re * q_b.re).sqrt();
        Split {
            reflected,
            refracted: Channel {
                s,
                p,
                re: z.re,
                im: z.im,
            },
            cos_refracted: q_b.re / apparent_beyond,
            ratio: apparent.sqrt() / apparent_beyond,
        }
    }
}

/// Returns a complex number of the same phase and the given modulus; 0 if there is no phase.
fn of_modulus(z: Complex<f64>, modulus: f64) -> Complex<f64> {
    let norm = z.norm();
    if norm > 0.0 {
        z * (modulus / norm)
    } else {
        Complex::new(0.0, 0.0)
    }
}

/// Returns the amount by which reflected and refracted light together exceed 1, for light from an absorbing layer
/// back through the boundary above it, as a share of the light in the medium above at cos θ = `cos`: 4 (Im r)², the
/// greater of s and p. Light that has crossed the layer twice has less.
#[must_use]
pub fn excess(above: f64, layer: Complex<f64>, cos: f64) -> f64 {
    let media = Media::new(Complex::new(above, 0.0), layer, true);
    let (a, b) = (media.here, media.beyond);
    let q_a = Complex::new(cos, 0.0);
    let q_b = principal_sqrt(q_a * q_a + media.lift);
    let (a2, b2) = (a * a, b * b);
    let r_s = (q_a - q_b) / (q_a + q_b);
    let r_p = (b2 * q_a - a2 * q_b) / (b2 * q_a + a2 * q_b);
    4.0 * (r_s.im * r_s.im).max(r_p.im * r_p.im)
}
