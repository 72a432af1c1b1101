//! The printed lobe with hand-written derivatives (see [`super::prepared`]).

use super::prepared::{Partials, Prepared};

/// G1 or G1/(ω·n) with its derivatives with respect to θr and to the v and n components.
struct Masking {
    value: f64,
    theta_r: f64,
    v: f64,
    n: f64,
}

/// On the side that the facets lean to, G1/(ω·n) = 1/(cos θr ω_m); on the other, G1 = 1 + tan θr ω_e/ω_m. At ω_e = 0
/// the derivative of the latter branch is returned (the kink of |tan θp|).
fn masking(q: &Prepared, w: [f64; 3], over_cos: bool) -> Masking {
    let (s, c) = (q.sin, q.cos);
    let (e, m) = (w[1] * c - w[2] * s, w[1] * s + w[2] * c);
    let none = Masking {
        value: 0.0,
        theta_r: 0.0,
        v: 0.0,
        n: 0.0,
    };
    if m <= 0.0 {
        return none;
    }
    // dm = s dv + c dn + e dθ, de = c dv − s dn − m dθ.
    if e * s > 0.0 {
        let per_cos = 1.0 / (c * m);
        let (theta_r, v, n) = (
            per_cos * (q.tan - e * per_cos * c),
            -per_cos * per_cos * c * s,
            -per_cos * per_cos * c * c,
        );
        if over_cos {
            return Masking {
                value: per_cos,
                theta_r,
                v,
                n,
            };
        }
        return Masking {
            value: per_cos * w[2],
            theta_r: theta_r * w[2],
            v: v * w[2],
            n: n * w[2] + per_cos,
        };
    }
    let tan = q.tan;
    let per_m = 1.0 / m;
    let ratio = e * per_m;
    let open = 1.0 + tan * ratio;
    if open <= 0.0 {
        return none;
    }
    let theta_r = ratio * (1.0 + tan * tan) + tan * (-1.0 - ratio * ratio);
    let v = tan * (c - ratio * s) * per_m;
    let n = tan * (-s - ratio * c) * per_m;
    if over_cos {
        let per_n = 1.0 / w[2];
        Masking {
            value: open * per_n,
            theta_r: theta_r * per_n,
            v: v * per_n,
            n: (n - open * per_n) * per_n,
        }
    } else {
        Masking {
            value: open,
            theta_r,
            v,
            n,
        }
    }
}

pub(super) fn partials(q: &Prepared, i: [f64; 3], o: [f64; 3]) -> Partials {
    let gi = masking(q, i, false);
    let go = masking(q, o, true);
    let (s, c) = (q.sin, q.cos);
    let h = [i[0] + o[0], i[1] + o[1], i[2] + o[2]];
    let hm = h[1] * s + h[2] * c;
    if gi.value <= 0.0 || go.value <= 0.0 || hm <= 0.0 {
        return Partials::default();
    }
    let he = h[1] * c - h[2] * s;
    let h2 = h[0] * h[0] + h[1] * h[1] + h[2] * h[2];
    let per_m = 1.0 / hm;
    let (x, y) = (h[0] * per_m, he * per_m);
    let (xu, yv) = (x * q.per_au2, y * q.per_av2);
    let exponent = x * xu + y * yv;
    let widen = h2 * per_m * per_m;
    let d = (-exponent).exp() * q.peak * widen * widen;
    let length = h2.sqrt();
    let f = q.table.reflectance(0.5 * length);
    let t = 1.0 - f.value;
    let scale = q.surface.rho_d * std::f64::consts::FRAC_1_PI;
    let bracket = f.value + scale * t * t;
    let bracket_f = 1.0 - 2.0 * scale * t;
    let masked = gi.value * go.value;
    let quarter = 0.25 * q.surface.amplitude;
    let lobe = quarter * masked * d;
    let value = lobe * bracket;

    // Logarithmic derivatives of D with respect to h_u, h_e, h_m and |h|².
    let to_u = -2.0 * xu * per_m;
    let to_e = -2.0 * yv * per_m;
    let to_m = (2.0 * exponent - 4.0) * per_m;
    // |h|² enters D as its square, and the Fresnel angle as cos = |h|/2.
    let to_h2 = value * 2.0 / h2 + lobe * bracket_f * f.cos * 0.25 / length;
    let along = |component: f64, own: f64| value * own + to_h2 * 2.0 * component;
    let common = [
        along(h[0], to_u),
        along(h[1], to_e * c + to_m * s),
        along(h[2], to_m * c - to_e * s),
    ];
    let unmasked_i = quarter * go.value * d * bracket;
    let unmasked_o = quarter * gi.value * d * bracket;
    let au = to_alpha(x * xu, q.per_au2, q.surface.alpha_u);
    let av = to_alpha(y * yv, q.per_av2, q.surface.alpha_v);
    Partials {
        value,
        theta_r: unmasked_i * gi.theta_r
            + unmasked_o * go.theta_r
            + value * (to_m * he - to_e * hm),
        alpha_u: value * au,
        alpha_v: value * av,
        rho_d: lobe * t * t * std::f64::consts::FRAC_1_PI,
        translucency: 0.0,
        tail: 0.0,
        crest: 0.0,
        amplitude: 0.25 * masked * d * bracket,
        eta: lobe * bracket_f * f.eta,
        k: lobe * bracket_f * f.k,
        incident: [
            common[0],
            common[1] + unmasked_i * gi.v,
            common[2] + unmasked_i * gi.n,
        ],
        outgoing: [
            common[0],
            common[1] + unmasked_o * go.v,
            common[2] + unmasked_o * go.n,
        ],
    }
}

/// Returns ∂ ln D/∂α for 1/(α² + lamp) = `per_a2` and this axis's share of the exponent.
#[inline]
pub(super) fn to_alpha(share: f64, per_a2: f64, alpha: f64) -> f64 {
    (2.0 * share - 1.0) * per_a2 * alpha
}
