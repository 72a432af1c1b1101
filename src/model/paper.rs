//! The BRDF as printed (Luongo et al. 2017, Eqs. 1–6), masking measured to the pitch normal.
//!
//! ```text
//! f = G D / (4 |ω_i·n| |ω_o·n|) · [ F(ω_i, h) + (ρd/π) (1 − F)² ],   h ∝ ω_i + ω_o
//! ```

use std::f64::consts::PI;

use super::dual::Scalar;
use super::fresnel::reflectance_of;
use super::sawtooth::Parameters;

/// G1(ω) = χ+(ω_p·m) [1 − min(1, |tan θr tan θp|)] (Eq. 2) over any [`Scalar`], divided by ω·n if
/// `over_cos`. On the side that the facets lean to, G1/(ω·n) = 1/(cos θr ω_m): no cancellation and
/// no division by zero at grazing.
fn masking<S: Scalar>(w: [S; 3], sin: S, cos: S, over_cos: bool) -> S {
    let e = w[1] * cos - w[2] * sin;
    let m = w[1] * sin + w[2] * cos;
    let zero = S::constant(0.0);
    if m.value() <= 0.0 {
        return zero;
    }
    if e.value() * sin.value() > 0.0 {
        let per_cos = S::constant(1.0) / (cos * m);
        return if over_cos { per_cos } else { per_cos * w[2] };
    }
    let open = (S::constant(1.0) + sin * e / (cos * m)).larger(zero);
    if over_cos { open / w[2] } else { open }
}

/// L = f cos θi towards `o` for irradiance 1 on a surface facing the light at `i`, times the
/// amplitude; roughness widened by the lamp's disc (α² + R²/8).
pub fn radiance_of<S: Scalar>(i: [S; 3], o: [S; 3], q: &Parameters<S>) -> S {
    let zero = S::constant(0.0);
    if i[2].value() <= 0.0 || o[2].value() <= 0.0 {
        return zero;
    }
    let (sin, cos) = (q.theta_r.sin(), q.theta_r.cos());
    let g = masking(i, sin, cos, false) * masking(o, sin, cos, true);
    let h = [i[0] + o[0], i[1] + o[1], i[2] + o[2]];
    let h_m = h[1] * sin + h[2] * cos;
    if g.value() <= 0.0 || h_m.value() <= 0.0 {
        return zero;
    }
    let h_e = h[1] * cos - h[2] * sin;
    let h2 = h[0] * h[0] + h[1] * h[1] + h[2] * h[2];
    let lamp = S::constant(q.light_angular_radius * q.light_angular_radius / 8.0);
    let au2 = q.alpha_u * q.alpha_u + lamp;
    let av2 = q.alpha_v * q.alpha_v + lamp;
    let m2 = h_m * h_m;
    let cos2 = m2 / h2;
    let exponent = (h[0] * h[0] / au2 + h_e * h_e / av2) / m2;
    let d = (-exponent).exp() / ((au2 * av2).sqrt() * cos2 * cos2 * PI);
    let f = reflectance_of(h2.sqrt() * 0.5, q.eta, q.k);
    let t = S::constant(1.0) - f;
    q.amplitude * g * d * (f + q.rho_d * t * t * (1.0 / PI)) * 0.25
}
