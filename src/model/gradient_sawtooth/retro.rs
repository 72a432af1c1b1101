//! The retro lobe, light that is reflected by facet and riser back towards the lamp, and its derivatives.

use std::f64::consts::{FRAC_1_PI, FRAC_1_SQRT_2, FRAC_2_SQRT_PI};

use super::{Back, Ray, Shared};
use crate::model::prepared::Prepared;
use crate::model::sawtooth::{RETRO_TILT_MAX, RETRO_TILT_MIN};

/// Exponent above which the retro lobe is omitted, since it is below 1e-43 of its peak.
const RETRO_EXPONENT_MAX: f64 = 100.0;

/// (c) The retro lobe: `a` reaches the facet, `b` the riser.
#[inline]
pub(super) fn retro(
    q: &Prepared,
    a: &Ray,
    b: &Ray,
    ga: &mut Back,
    gb: &mut Back,
    shared: &mut Shared,
) -> f64 {
    if a.m <= 0.0 || b.rho <= 0.0 || q.sin <= 0.0 {
        return 0.0;
    }
    let (r, p) = (q.sin, q.cos);
    let surface = &q.surface;
    let au2 = surface.alpha_u * surface.alpha_u;
    let spread = 0.5 * (a.m * a.m + b.rho * b.rho);
    let v_u = au2 * spread + q.cones;
    let per_v_v = q.per_v_v;
    let per_v_u = 1.0 / v_u;
    let x = 0.5 * (a.u + b.u);
    let exponent_u = 0.5 * x * x * per_v_u;
    if exponent_u > RETRO_EXPONENT_MAX {
        return 0.0;
    }
    let m_b = b.m.max(0.0);
    let (beta_a, beta_b) = (a.beta, b.beta);
    let y = 0.5 * (beta_b - beta_a);
    let exponent_v = 0.5 * y * y * per_v_v;
    if exponent_u + exponent_v > RETRO_EXPONENT_MAX {
        return 0.0;
    }
    let tilt = -0.5 * (beta_a + beta_b);

    // Length of the pair of walls that reflects light back, with its derivatives.
    let (mut to_p, mut to_r, mut to_sigma, mut to_tilt) = (0.0, 0.0, 0.0, 0.0);
    let length = if a.sigma <= 0.0 {
        to_r = 1.0;
        r
    } else {
        let kept = tilt.clamp(RETRO_TILT_MIN, RETRO_TILT_MAX);
        let tan = kept.tan();
        let per_tan = 1.0 / tan;
        let far = p * per_tan;
        to_sigma = -per_tan;
        // If the facet limits the pair of walls, its length less σ is the visible length, without a difference.
        let (length, cut) = if far < r {
            to_p = per_tan;
            (a.open * per_tan, a.open)
        } else {
            to_r = 1.0;
            (r - a.sigma * per_tan, -a.sigma)
        };
        if length <= 0.0 {
            return 0.0;
        }
        if kept == tilt {
            // d(1/tan)/dtilt = −(1 + tan²)/tan².
            to_tilt = -cut * (1.0 + per_tan * per_tan);
        }
        length
    };
    let z = tilt * q.per_alpha_v;
    let phi = 0.5 * libm::erfc(-z * FRAC_1_SQRT_2);
    let gauss = (-exponent_u - exponent_v).exp() * (per_v_u * per_v_v).sqrt() * (0.5 * FRAC_1_PI);
    let amplitude2 = surface.amplitude * surface.amplitude;
    let bare = 0.25 * phi * b.rho * gauss * length;
    let product = match (&a.facet.parts, &b.riser.parts) {
        (Some(fa), Some(fb)) => 0.5 * (fa.s.value * fb.s.value + fa.p.value * fb.p.value),
        _ => a.facet.f.value * b.riser.f.value,
    };
    let value = amplitude2 * bare * product;
    shared.amplitude += 2.0 * surface.amplitude * bare * product;
    // Reflectances.
    let to_product = amplitude2 * bare;
    if let (Some(fa), Some(fb)) = (&a.facet.parts, &b.riser.parts) {
        let half = 0.5 * to_product;
        ga.facet_cos += half * (fa.s.cos * fb.s.value + fa.p.cos * fb.p.value);
        gb.riser_cos += half * (fb.s.cos * fa.s.value + fb.p.cos * fa.p.value);
        shared.eta += half
            * (fa.s.eta * fb.s.value
                + fa.p.eta * fb.p.value
                + fb.s.eta * fa.s.value
                + fb.p.eta * fa.p.value);
        shared.k += half
            * (fa.s.k * fb.s.value
                + fa.p.k * fb.p.value
                + fb.s.k * fa.s.value
                + fb.p.k * fa.p.value);
    } else {
        ga.facet_f += to_product * b.riser.f.value;
        gb.riser_f += to_product * a.facet.f.value;
    }
    // Length.
    let whole = amplitude2 * product * 0.25 * phi * gauss;
    let per_length = whole * b.rho;
    shared.p += per_length * to_p;
    shared.r += per_length * to_r;
    ga.sigma += per_length * to_sigma;
    // Φ(tilt/αv), the second dependence on the tilt.
    let slope = 0.25
        * amplitude2
        * product
        * b.rho
        * gauss
        * length
        * (-0.5 * z * z).exp()
        * (0.5 * FRAC_2_SQRT_PI * FRAC_1_SQRT_2);
    let to_tilt = per_length * to_tilt + slope * q.per_alpha_v;
    shared.alpha_v -= slope * z * q.per_alpha_v;
    // ω_ρ of the leaving direction (−e).
    let mut to_rho_b = whole * length;
    // The two normal densities.
    let to_x = -value * x * per_v_u;
    let to_v_u = value * (exponent_u - 0.5) * per_v_u;
    let to_y = -value * y * per_v_v;
    let to_v_v = value * (exponent_v - 0.5) * per_v_v;
    ga.u += 0.5 * to_x;
    gb.u += 0.5 * to_x;
    shared.alpha_u += to_v_u * 2.0 * surface.alpha_u * spread;
    ga.m += to_v_u * au2 * a.m;
    to_rho_b += to_v_u * au2 * b.rho;
    gb.e -= to_rho_b;
    shared.alpha_v += to_v_v * 2.0 * surface.alpha_v;
    // β = atan2(e, m).
    let to_beta_a = -0.5 * (to_y + to_tilt);
    let to_beta_b = 0.5 * (to_y - to_tilt);
    let ra = 1.0 / (a.e * a.e + a.m * a.m);
    ga.e += to_beta_a * a.m * ra;
    ga.m -= to_beta_a * a.e * ra;
    let rb = 1.0 / (b.e * b.e + m_b * m_b);
    gb.e += to_beta_b * m_b * rb;
    if b.m > 0.0 {
        gb.m -= to_beta_b * b.e * rb;
    }
    value
}
