//! The printed lobe.

use std::f64::consts::FRAC_1_PI;

use super::shape::{Derivatives, Half, Shape};
use crate::model::register::Register;

/// G1 or G1/(ω·n) with its slopes with respect to θr and to the v and n components.
struct Masking<R> {
    value: R,
    theta_r: R,
    v: R,
    n: R,
}

/// Returns G1/(ω·n) if `over_cos`, else G1. On the side that the facets lean to, G1/(ω·n) = 1/(cos θr ω_m); on the
/// other, G1 = 1 + tan θr ω_e/ω_m. At ω_e = 0 the slope of the latter is returned (the kink of |tan θp|).
#[inline(always)]
fn masking<R: Register>([s, c]: [R; 2], w: &[R; 3], over_cos: bool) -> Masking<R> {
    let (zero, one) = (s.like(0.0), s.like(1.0));
    let tan = s / c;
    let (e, m) = (w[1].fused(c, -(w[2] * s)), w[1].fused(s, w[2] * c));
    let per_m = m.positive().per();
    let per_n = w[2].positive().per();
    // dm = s dv + c dn + e dθ, de = c dv − s dn − m dθ.
    let leans = zero.below(e * s);
    let per_cos = per_m / c;
    let square = per_cos * per_cos * c;
    let ratio = e * per_m;
    let open = tan.fused(ratio, one);
    let value = R::choose(leans, per_cos, open * per_n);
    let theta_r = R::choose(
        leans,
        per_cos * (tan - ratio),
        (ratio * (one + tan * tan) - tan * (one + ratio * ratio)) * per_n,
    );
    let v = R::choose(leans, -(square * s), tan * (c - ratio * s) * per_m * per_n);
    let n = R::choose(
        leans,
        -(square * c),
        (-(tan * (s + ratio * c)) * per_m - open * per_n) * per_n,
    );
    let seen = R::both(zero.below(m), zero.below(R::choose(leans, one, open)));
    let all = if over_cos {
        [value, theta_r, v, n]
    } else {
        [value * w[2], theta_r * w[2], v * w[2], n.fused(w[2], value)]
    };
    Masking {
        value: R::choose(seen, all[0], zero),
        theta_r: R::choose(seen, all[1], zero),
        v: R::choose(seen, all[2], zero),
        n: R::choose(seen, all[3], zero),
    }
}

#[inline(always)]
pub(super) fn radiance<R: Register>(
    q: &Shape<R>,
    half: &Half<R>,
    i: &[R; 3],
    o: &[R; 3],
) -> Derivatives<R> {
    let (s, c) = (q.r, q.p);
    let (zero, one, two, four) = (s.like(0.0), s.like(1.0), s.like(2.0), s.like(4.0));
    let gi = masking([s, c], i, false);
    let go = masking([s, c], o, true);
    let (hu, hv, hn) = (i[0] + o[0], i[1] + o[1], i[2] + o[2]);
    let (he, hm) = (hv.fused(c, -(hn * s)), hv.fused(s, hn * c));
    let above = R::both(zero.below(i[2]), zero.below(o[2]));
    let seen = R::both(
        above,
        R::both(zero.below(gi.value * go.value), zero.below(hm)),
    );
    let per = R::choose(seen, hm, one).per();
    let (x, y) = (hu * per, he * per);
    let (xa, yb) = (x * q.per_a, y * q.per_b);
    let (qx, qy) = (x * xa, y * yb);
    let all = qx + qy;
    let widen = half.h2 * per * per;
    // F + ρd T²/π with its slope with respect to F.
    let f = &half.f;
    let enters = one - f.value;
    let albedo = q.rho_d.times(FRAC_1_PI);
    let bracket = (albedo * enters).fused(enters, f.value);
    let bracket_f = one - two * albedo * enters;
    // Without masking, A and the bracket.
    let d = all.falling() * q.peak * widen * widen;
    let d = R::choose(seen, d.times(0.25), zero);
    let masked = gi.value * go.value;
    let bare = d * masked;
    let lobe = bare * q.amplitude;
    let value = lobe * bracket;
    let (to_u, to_e, to_m) = (
        -(two * xa * per),
        -(two * yb * per),
        (two * all - four) * per,
    );
    let mut common = [
        value * to_u,
        value * (to_e * c + to_m * s),
        value * (to_m * c - to_e * s),
    ];
    let per_f = lobe * bracket_f;
    if half.varies {
        let to_h2 = half.slope(value, per_f);
        let twice = to_h2 + to_h2;
        common = [
            twice.fused(hu, common[0]),
            twice.fused(hv, common[1]),
            twice.fused(hn, common[2]),
        ];
    }
    let unmasked = d * q.amplitude * bracket;
    let (for_i, for_o) = (unmasked * go.value, unmasked * gi.value);
    Derivatives {
        value,
        theta_r: for_i * gi.theta_r + for_o * go.theta_r + value * (to_m * he - to_e * hm),
        ln_alpha_u: value * (two * qx - one) * q.share_u,
        ln_alpha_v: value * (two * qy - one) * q.share_v,
        rho_d: lobe * enters * enters.times(FRAC_1_PI),
        amplitude: bare * bracket,
        eta: per_f * f.eta,
        k: per_f * f.k,
        incident: [
            common[0],
            for_i.fused(gi.v, common[1]),
            for_i.fused(gi.n, common[2]),
        ],
        outgoing: [
            common[0],
            for_o.fused(go.v, common[1]),
            for_o.fused(go.n, common[2]),
        ],
    }
}
