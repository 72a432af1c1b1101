//! The printed lobe with its slopes for a register of surfaces: `gradient_paper` without branches.

use std::f64::consts::FRAC_1_PI;

use pulp::Simd;

use super::{Lane, Slopes, TINY};
use crate::model::prepared::Prepared;

/// Numbers that describe a surface; see [`shape`].
pub(crate) const SHAPE: usize = 8;

/// Returns a surface in the form that [`partials`] uses: sine and cosine of θr, 1/a and 1/b, the lobe's peak times
/// F |h|⁴/4, the relative slope of the amplitude with respect to ρd, αu²/a and αv²/b. `f` is the reflectance at the
/// half angle, `h2` is |h|².
pub(crate) fn shape(q: &Prepared, f: f64, h2: f64) -> [f64; SHAPE] {
    let (au, av) = (q.surface.alpha_u, q.surface.alpha_v);
    let more = FRAC_1_PI * (1.0 - f) * (1.0 - f);
    let bracket = f + q.surface.rho_d * more;
    [
        q.sin,
        q.cos,
        q.per_au2,
        q.per_av2,
        0.25 * q.peak * h2 * h2 * bracket,
        more / bracket,
        au * au * q.per_au2,
        av * av * q.per_av2,
    ]
}

/// Returns G1, or G1/(ω·n), with its slopes with respect to θr, v and n.
#[inline(always)]
fn masking<S: Simd>(
    simd: S,
    [s, c]: [Lane<S>; 2],
    w: &[Lane<S>; 3],
    over_cos: bool,
) -> [Lane<S>; 4] {
    let (zero, one, tiny) = (
        Lane::splat(simd, 0.0),
        Lane::splat(simd, 1.0),
        Lane::splat(simd, TINY),
    );
    let tan = s / c;
    let (e, m) = (w[1].mul_add(c, -(w[2] * s)), w[1].mul_add(s, w[2] * c));
    let faces = zero.less(m);
    let per_m = one / m.max(tiny);
    let per_n = one / w[2].max(tiny);
    // On the side that the facets lean to, G1/(ω·n) = 1/(cos θr ω_m); otherwise 1 + tan θr ω_e/ω_m over ω·n.
    let leans = zero.less(e * s);
    let per_cos = per_m / c;
    let square = per_cos * per_cos * c;
    let ratio = e * per_m;
    let open = tan.mul_add(ratio, one);
    let seen = leans.select(one, open);
    let (value, theta, v, n) = (
        leans.select(per_cos, open * per_n),
        leans.select(
            per_cos * (tan - e * per_m),
            (ratio * (one + tan * tan) - tan * (one + ratio * ratio)) * per_n,
        ),
        leans.select(-(square * s), tan * (c - ratio * s) * per_m * per_n),
        leans.select(
            -(square * c),
            (-(tan * (s + ratio * c)) * per_m - open * per_n) * per_n,
        ),
    );
    let shows = faces.and(zero.less(seen));
    let all = if over_cos {
        [value, theta, v, n]
    } else {
        [value * w[2], theta * w[2], v * w[2], n * w[2] + value]
    };
    [
        shows.select(all[0], zero),
        shows.select(all[1], zero),
        shows.select(all[2], zero),
        shows.select(all[3], zero),
    ]
}

/// Returns the radiance with its slopes for directions along u, v, n of a far rig, whose half angle is that of the
/// shape.
#[inline(always)]
pub(crate) fn partials<S: Simd>(
    simd: S,
    shape: &[Lane<S>; SHAPE],
    i: &[Lane<S>; 3],
    o: &[Lane<S>; 3],
) -> Slopes<S> {
    let [s, c, per_a, per_b, peak, more, wu, wv] = *shape;
    let (zero, one, two, four, tiny) = (
        Lane::splat(simd, 0.0),
        Lane::splat(simd, 1.0),
        Lane::splat(simd, 2.0),
        Lane::splat(simd, 4.0),
        Lane::splat(simd, TINY),
    );
    let [gi, gi_theta, gi_v, gi_n] = masking(simd, [s, c], i, false);
    let [go, go_theta, go_v, go_n] = masking(simd, [s, c], o, true);
    let (hu, hv, hn) = (i[0] + o[0], i[1] + o[1], i[2] + o[2]);
    let (he, hm) = (hv.mul_add(c, -(hn * s)), hv.mul_add(s, hn * c));
    let above = zero.less(i[2]).and(zero.less(o[2]));
    let seen = above.and(zero.less(gi * go)).and(zero.less(hm));
    let per = one / hm.max(tiny);
    let (x, y) = (hu * per, he * per);
    let (xa, yb) = (x * per_a, y * per_b);
    let (qx, qy) = (x * xa, y * yb);
    let q = qx + qy;
    let per2 = per * per;
    let lobe = seen.select(q.exp_neg() * peak * per2 * per2, zero);
    let value = lobe * gi * go;
    let (to_u, to_e, to_m) = (-(two * xa * per), -(two * yb * per), (two * q - four) * per);
    let common = [
        value * to_u,
        value * (to_e * c + to_m * s),
        value * (to_m * c - to_e * s),
    ];
    let (for_i, for_o) = (lobe * go, lobe * gi);
    Slopes {
        value,
        theta_r: for_i * gi_theta + for_o * go_theta + value * (to_m * he - to_e * hm),
        ln_alpha_u: value * (two * qx - one) * wu,
        ln_alpha_v: value * (two * qy - one) * wv,
        rho_d: value * more,
        incident: [
            common[0],
            for_i.mul_add(gi_v, common[1]),
            for_i.mul_add(gi_n, common[2]),
        ],
        outgoing: [
            common[0],
            for_o.mul_add(go_v, common[1]),
            for_o.mul_add(go_n, common[2]),
        ],
    }
}
