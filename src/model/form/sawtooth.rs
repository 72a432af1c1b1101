//! The sawtooth: single reflection, and the sum of all terms.
//!
//! Names and terms are those of [`crate::model::sawtooth`].

use super::diffuse::diffuse;
use super::ray::{Back, Ray, Shared};
use super::retro::retro;
use super::shape::{Derivatives, Fixed, Half, Shape};
use crate::model::register::Register;

#[inline(always)]
pub(super) fn radiance<R: Register>(
    body: bool,
    fixed: &Fixed,
    q: &Shape<R>,
    half: &Half<R>,
    i: &[R; 3],
    o: &[R; 3],
) -> Derivatives<R> {
    let zero = q.r.like(0.0);
    let (ray_i, ray_o) = (Ray::new(q, i), Ray::new(q, o));
    let (mut gi, mut go) = (Back::zero(zero), Back::zero(zero));
    let mut shared = Shared::zero(zero);
    let mut sum = single(q, half, [&ray_i, &ray_o], [&mut gi, &mut go], &mut shared);
    let (mut to_theta, mut to_rho_d) = (zero, zero);
    let any_riser = R::any(ray_i.on_riser) || R::any(ray_o.on_riser);
    // Without diffuse light only the retro lobe needs the walls, and only if a direction reaches a riser.
    let walls = if body || any_riser {
        Some((ray_i.walls(fixed), ray_o.walls(fixed)))
    } else {
        None
    };
    if let Some((wi, wo)) = &walls {
        if body {
            let (rays, walls) = ([&ray_i, &ray_o], [wi, wo]);
            let light = diffuse(q, rays, walls, [&mut gi, &mut go], &mut shared);
            sum = q.c_d.fused(light.sum, sum);
            to_theta = q.c_d * light.to_theta;
            // c_d and κ depend on ρd and the index.
            let to_kappa = q.c_d * light.to_kappa;
            let of = [light.sum, to_kappa];
            to_rho_d = through(of, [fixed.diffuse, fixed.kappa]);
            let [c_d, kappa] = [fixed.diffuse_index, fixed.kappa_index];
            let [to_eta, to_k] = [
                through(of, [c_d[0], kappa[0]]),
                through(of, [c_d[1], kappa[1]]),
            ];
            shared.eta = q.rho_d.fused(to_eta, shared.eta);
            shared.k = q.rho_d.fused(to_k, shared.k);
        }
        if any_riser {
            let betas = [ray_i.beta(), ray_o.beta()];
            let (rays, walls) = ([&ray_i, &ray_o], [wi, wo]);
            let backs = [&mut gi, &mut go];
            sum = sum + retro(fixed, q, rays, walls, betas, backs, &mut shared);
            let (rays, walls) = ([&ray_o, &ray_i], [wo, wi]);
            let backs = [&mut go, &mut gi];
            let betas = [betas[1], betas[0]];
            sum = sum + retro(fixed, q, rays, walls, betas, backs, &mut shared);
        }
    }
    ray_i.lead_back(q, walls.as_ref().map(|w| &w.0), &mut gi, &mut shared);
    ray_o.lead_back(q, walls.as_ref().map(|w| &w.1), &mut go, &mut shared);
    let above = R::both(zero.below(i[2]), zero.below(o[2]));
    let per_n = R::choose(above, o[2].per(), zero);
    let value = sum * per_n;
    // de = −m dθ, dm = e dθ, dp = −s dθ, dr = c dθ.
    let to_theta = to_theta + gi.m * ray_i.e - gi.e * ray_i.m + go.m * ray_o.e
        - go.e * ray_o.m
        - shared.p * q.r
        + shared.r * q.p;
    let (incident, outgoing) = (to_sample(q, per_n, &gi), to_sample(q, per_n, &go));
    Derivatives {
        value,
        theta_r: to_theta * per_n,
        ln_alpha_u: shared.ln_alpha_u * per_n,
        ln_alpha_v: shared.ln_alpha_v * per_n,
        rho_d: to_rho_d * per_n,
        amplitude: shared.amplitude * per_n,
        eta: shared.eta * per_n,
        k: shared.k * per_n,
        incident,
        outgoing: [outgoing[0], outgoing[1], outgoing[2] - value * per_n],
    }
}

/// A slope through c_d and κ.
#[inline(always)]
fn through<R: Register>([to_c_d, to_kappa]: [R; 2], [c_d, kappa]: [f64; 2]) -> R {
    to_c_d.times(c_d) + to_kappa.times(kappa)
}

/// Slopes with respect to the components of a direction in the sample's frame.
#[inline(always)]
fn to_sample<R: Register>(q: &Shape<R>, per_n: R, g: &Back<R>) -> [R; 3] {
    [
        g.u * per_n,
        (g.e * q.p + g.m * q.r) * per_n,
        (g.m * q.p - g.e * q.r) * per_n,
    ]
}

/// D about a wall's normal, with its logarithmic slopes at constant |h|².
struct Lobe<R> {
    d: R,
    to_u: R,
    to_y: R,
    to_z: R,
    to_ln_alpha_u: R,
    to_ln_alpha_v: R,
}

/// Evaluates D for a half vector with the components (u, y, z); 0 where it is not `on` the wall.
#[inline(always)]
fn lobe<R: Register>(q: &Shape<R>, h2: R, [u, y, z]: [R; 3], on: R::Choice) -> Lobe<R> {
    let (zero, one, two, four) = (u.like(0.0), u.like(1.0), u.like(2.0), u.like(4.0));
    let per = R::choose(on, z, one).per();
    let (x, y) = (u * per, y * per);
    let (xa, yb) = (x * q.per_a, y * q.per_b);
    let (qx, qy) = (x * xa, y * yb);
    let all = qx + qy;
    let widen = h2 * per * per;
    Lobe {
        d: R::choose(on, all.falling() * q.peak * widen * widen, zero),
        to_u: -(two * xa * per),
        to_y: -(two * yb * per),
        to_z: (two * all - four) * per,
        to_ln_alpha_u: (two * qx - one) * q.share_u,
        to_ln_alpha_v: (two * qy - one) * q.share_v,
    }
}

/// (a) Single reflection.
#[inline(always)]
fn single<R: Register>(
    q: &Shape<R>,
    half: &Half<R>,
    [i, o]: [&Ray<R>; 2],
    [gi, go]: [&mut Back<R>; 2],
    shared: &mut Shared<R>,
) -> R {
    let zero = q.r.like(0.0);
    let seen = i.open.smaller(o.open);
    let on_facet = R::both(R::both(i.on_facet, o.on_facet), zero.below(seen));
    let on_riser = R::both(i.on_riser, o.on_riser);
    let any_riser = R::any(on_riser);
    if !any_riser && !R::any(on_facet) {
        return zero;
    }
    let (hu, he, hm) = (i.u + o.u, i.e + o.e, i.m + o.m);
    // Slopes without the factor A F/4, which all have in common.
    let l = lobe(q, half.h2, [hu, he, hm], on_facet);
    let factor = half.f.value * q.amplitude.times(0.25);
    let mut lobes = seen * l.d;
    let d = l.d * factor;
    let part = seen * d;
    let mut value = part;
    let mut to_h = [part * l.to_u, part * l.to_y, part * l.to_z];
    shared.ln_alpha_u = part.fused(l.to_ln_alpha_u, shared.ln_alpha_u);
    shared.ln_alpha_v = part.fused(l.to_ln_alpha_v, shared.ln_alpha_v);
    shared.p = shared.p + d;
    let i_hides = o.sigma.below(i.sigma);
    gi.sigma = gi.sigma - R::choose(i_hides, d, zero);
    go.sigma = go.sigma - R::choose(i_hides, zero, d);
    if any_riser {
        let l = lobe(q, half.h2, [hu, hm, i.rho + o.rho], on_riser);
        lobes = q.r.fused(l.d, lobes);
        let d = l.d * factor;
        let part = q.r * d;
        value = value + part;
        to_h[0] = part.fused(l.to_u, to_h[0]);
        to_h[1] = to_h[1] - part * l.to_z;
        to_h[2] = part.fused(l.to_y, to_h[2]);
        shared.ln_alpha_u = part.fused(l.to_ln_alpha_u, shared.ln_alpha_u);
        shared.ln_alpha_v = part.fused(l.to_ln_alpha_v, shared.ln_alpha_v);
        shared.r = shared.r + d;
    }
    let per_f = lobes * q.amplitude.times(0.25);
    if half.varies {
        let to_h2 = half.slope(value, per_f);
        let twice = to_h2 + to_h2;
        to_h = [
            twice.fused(hu, to_h[0]),
            twice.fused(he, to_h[1]),
            twice.fused(hm, to_h[2]),
        ];
    }
    for g in [gi, go] {
        g.u = g.u + to_h[0];
        g.e = g.e + to_h[1];
        g.m = g.m + to_h[2];
    }
    shared.amplitude = shared.amplitude + lobes * half.f.value.times(0.25);
    shared.eta = shared.eta + per_f * half.f.eta;
    shared.k = shared.k + per_f * half.f.k;
    value
}
