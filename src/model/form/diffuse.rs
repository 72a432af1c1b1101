//! Diffuse light of the sawtooth: direct, over mirror hops, and exchanged between the walls.

use super::ray::{Back, Ray, Shared, Walls};
use super::shape::Shape;
use crate::model::register::Register;

/// Diffuse light without its factor c_d, with its slopes through the coefficients of the exchange.
pub(super) struct Diffuse<R> {
    pub(super) sum: R,
    /// With respect to θr.
    pub(super) to_theta: R,
    /// With respect to κ.
    pub(super) to_kappa: R,
}

/// (b) Diffuse light; the slopes that lead to the directions include c_d.
#[inline(always)]
pub(super) fn diffuse<R: Register>(
    q: &Shape<R>,
    [i, o]: [&Ray<R>; 2],
    [wi, wo]: [&Walls<R>; 2],
    [gi, go]: [&mut Back<R>; 2],
    shared: &mut Shared<R>,
) -> Diffuse<R> {
    let zero = q.r.like(0.0);
    let (r, p, c_d) = (q.r, q.p, q.c_d);
    let (fi, fo) = (wi.facet.f.value, wo.facet.f.value);
    let (ri, ro) = (wi.riser.f.value, wo.riser.f.value);
    let (facets, risers) = (wi.a * wo.a, wi.b * wo.b);
    let seen = i.open.smaller(o.open);
    let (hop_i, hop_o) = (lit_and_seen(i, o, p), lit_and_seen(o, i, p));
    let (both_x, both_y) = (i.x.smaller(o.x), i.y.smaller(o.y));
    let per_facets = seen + ri * hop_i + ro * hop_o + ri * ro * both_x;
    let per_risers = r + fi * i.y + fo * o.y + fi * fo * both_y;
    let direct = facets * per_facets + risers * per_risers;

    let (cf, cr) = (c_d * facets, c_d * risers);
    let lit = R::choose(zero.below(seen), cf, zero);
    shared.p = shared.p + lit;
    let i_hides = o.sigma.below(i.sigma);
    gi.sigma = gi.sigma - R::choose(i_hides, lit, zero);
    go.sigma = go.sigma - R::choose(i_hides, zero, lit);
    let hops = R::choose(zero.below(hop_i), cf * ri, zero);
    gi.x = gi.x + hops;
    go.sigma = go.sigma - hops;
    let hops = R::choose(zero.below(hop_o), cf * ro, zero);
    go.x = go.x + hops;
    gi.sigma = gi.sigma - hops;
    let (twice, i_less) = (cf * ri * ro, i.x.below(o.x));
    gi.x = gi.x + R::choose(i_less, twice, zero);
    go.x = go.x + R::choose(i_less, zero, twice);
    gi.riser_f = cf.fused(hop_i + ro * both_x, gi.riser_f);
    go.riser_f = cf.fused(hop_o + ri * both_x, go.riser_f);
    shared.r = shared.r + cr;
    let (twice, i_less) = (cr * fi * fo, i.y.below(o.y));
    gi.y = cr.fused(fi, gi.y) + R::choose(i_less, twice, zero);
    go.y = cr.fused(fo, go.y) + R::choose(i_less, zero, twice);
    gi.facet_f = cr.fused(i.y + fo * both_y, gi.facet_f);
    go.facet_f = cr.fused(o.y + fi * both_y, go.facet_f);

    // Exchange: E_f = a (p − σ + F_ρ X), E_r = b (r + F_m Y).
    let (open_i, open_o) = (i.open + ri * i.x, o.open + ro * o.x);
    let (deep_i, deep_o) = (r + fi * i.y, r + fo * o.y);
    let (ef_i, ef_o) = (wi.a * open_i, wo.a * open_o);
    let (er_i, er_o) = (wi.b * deep_i, wo.b * deep_o);
    let products = [ef_i * ef_o, ef_o * er_i + er_o * ef_i, er_i * er_o];
    lead_exchange_back(q, (i, wi), [open_i, deep_i], [ef_o, er_o], gi, shared);
    lead_exchange_back(q, (o, wo), [open_o, deep_o], [ef_i, er_i], go, shared);
    gi.a = (c_d * wo.a).fused(per_facets, gi.a);
    go.a = (c_d * wi.a).fused(per_facets, go.a);
    gi.b = (c_d * wo.b).fused(per_risers, gi.b);
    go.b = (c_d * wi.b).fused(per_risers, go.b);
    Diffuse {
        sum: direct + exchanged(&q.exchange, &products),
        to_theta: exchanged(&q.exchange_theta, &products),
        to_kappa: exchanged(&q.exchange_kappa, &products),
    }
}

/// Light exchanged between the walls, from coefficients and products of their irradiances.
#[inline(always)]
fn exchanged<R: Register>(c: &[R; 3], products: &[R; 3]) -> R {
    c[0] * products[0] + c[1] * products[1] + c[2] * products[2]
}

/// Returns [x_a − σ_b]⁺ from the smaller of the visible and the hidden length of `b` (see [`crate::model::sawtooth`]).
#[inline(always)]
fn lit_and_seen<R: Register>(a: &Ray<R>, b: &Ray<R>, p: R) -> R {
    let by_hidden = b.sigma.below(b.open);
    R::choose(by_hidden, a.x - b.sigma, b.open - (p - a.x)).positive()
}

/// The slopes of the exchange with respect to one direction's numbers; `ef` and `er` are those of the other direction.
#[inline(always)]
fn lead_exchange_back<R: Register>(
    q: &Shape<R>,
    (ray, walls): (&Ray<R>, &Walls<R>),
    [open, deep]: [R; 2],
    [ef, er]: [R; 2],
    g: &mut Back<R>,
    shared: &mut Shared<R>,
) {
    let [c1, c2, c3] = q.exchange;
    let to_ef = q.c_d * (c1 * ef + c2 * er);
    let to_er = q.c_d * (c2 * ef + c3 * er);
    g.a = to_ef.fused(open, g.a);
    g.b = to_er.fused(deep, g.b);
    let (ea, eb) = (to_ef * walls.a, to_er * walls.b);
    shared.p = shared.p + ea;
    g.sigma = g.sigma - ea;
    g.x = ea.fused(walls.riser.f.value, g.x);
    g.riser_f = ea.fused(ray.x, g.riser_f);
    shared.r = shared.r + eb;
    g.y = eb.fused(walls.facet.f.value, g.y);
    g.facet_f = eb.fused(ray.y, g.facet_f);
}
