//! The part of the diffuse light that is left where two bounces are integrated.

use super::{Parameters, Ray, Shape, Walls, ray};

/// Returns the part of (b) with three or more reflections at the walls: two mirror hops about one diffuse reflection,
/// and the radiosity beyond the first exchange. L (o·n), as in all terms.
pub(in crate::model) fn three_bounces_and_more(
    i: [f64; 3],
    o: [f64; 3],
    q: &Parameters<f64>,
    walls: &Walls,
) -> f64 {
    if q.rho_d == 0.0 || q.theta_r <= 0.0 {
        return 0.0;
    }
    let shape = Shape::of(q);
    let (r, p) = (shape.s, shape.p);
    let [per_rho_d, per_c_d] = walls.body(q.eta, q.k);
    let c_d = q.rho_d * per_rho_d;
    let kappa = c_d * per_c_d;
    let (i, o) = (ray(i, q, &shape, walls), ray(o, q, &shape, walls));
    let facet = |w: &Ray<f64>| (1.0 - w.facet_f) * w.m;
    let riser = |w: &Ray<f64>| (1.0 - w.riser_f) * w.rho;
    let (ti, to) = (facet(&i), facet(&o));
    let (ui, uo) = (riser(&i), riser(&o));
    let hops = ti * i.riser_f * to * o.riser_f * i.x.min(o.x)
        + ui * i.facet_f * uo * o.facet_f * i.y.min(o.y);
    // κ (p + r − 1)/2 = κ p r/(1 + p + r), without the cancellation.
    let per_walls = kappa / (1.0 + p + r);
    let loss = per_walls * per_walls * (p * r);
    let d = 1.0 - loss;
    let e_f = |t: f64, w: &Ray<f64>| t * (w.open + w.riser_f * w.x);
    let e_r = |u: f64, w: &Ray<f64>| u * (r + w.facet_f * w.y);
    let (fi, fo, ri, ro) = (e_f(ti, &i), e_f(to, &o), e_r(ui, &i), e_r(uo, &o));
    let exchanged = loss / d * (fi * fo / p + ri * ro / r) + per_walls / d * (fo * ri + ro * fi);
    let first = per_walls * (to * o.open * ui * r + uo * r * ti * i.open);
    c_d * (hops + exchanged - first)
}
