//! The full sawtooth with its slopes for a register of surfaces: `gradient_sawtooth` without branches.
//!
//! Names and terms are those of [`crate::model::sawtooth`]. Every branch of the scalar form is a selection between
//! two numbers here, so that lanes may take different ones. Slopes are propagated back in the same way.
//!
//! *Conditioning.* The form is for descents that are refined elsewhere: divisors are held above 1e-9, angles are
//! exact to 1e-9 and Φ to 2e-7, and a lobe beyond e⁻⁶⁰ of its peak counts as e⁻⁶⁰.

use pulp::Simd;

use super::fresnel::{Wall, wall};
use super::{Lane, Mask, Slopes, TINY};
use crate::model::prepared::Prepared;
use crate::model::sawtooth::{RETRO_TILT_MAX, RETRO_TILT_MIN};

/// Numbers that describe a surface; see [`Shape`].
pub(crate) const SHAPE: usize = 22;

/// Inputs that all surfaces share.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Optics {
    eta: f64,
    k: f64,
    /// 1/(π T(1) T(cos θl)).
    diffuse: f64,
    /// The cones' share in the retro lobe's variances.
    cones: f64,
    /// 1/tan of the least and of the greatest tilt of the retro lobe's walls.
    per_tan: (f64, f64),
}

impl Optics {
    pub(crate) fn of(q: &Prepared) -> Self {
        Optics {
            eta: q.table.optics.eta,
            k: q.table.optics.k,
            diffuse: q.table.diffuse[0],
            cones: q.cones,
            per_tan: (1.0 / RETRO_TILT_MIN.tan(), 1.0 / RETRO_TILT_MAX.tan()),
        }
    }
}

/// Returns a surface in the form that [`partials`] uses. `f` is the reflectance at the half angle, `h2` is |h|².
pub(crate) fn shape(q: &Prepared, f: f64, h2: f64) -> [f64; SHAPE] {
    let (au, av) = (q.surface.alpha_u, q.surface.alpha_v);
    let (au2, av2) = (au * au, av * av);
    let [c1, c2, c3] = q.exchange;
    [
        q.sin,
        q.cos,
        q.per_au2,
        q.per_av2,
        0.25 * f * q.peak * h2 * h2,
        au2 * q.per_au2,
        av2 * q.per_av2,
        au2,
        q.per_v_v,
        av2 * q.per_v_v,
        q.per_alpha_v,
        q.c_d,
        c1.value,
        c2.value,
        c3.value,
        c1.partials[0],
        c2.partials[0],
        c3.partials[0],
        c1.partials[1] * q.kappa[1],
        c2.partials[1] * q.kappa[1],
        c3.partials[1] * q.kappa[1],
        q.per_v_v.sqrt(),
    ]
}

/// A surface per lane.
struct Shape<S: Simd> {
    /// sin θr and cos θr: lengths of riser and facet.
    r: Lane<S>,
    p: Lane<S>,
    per_a: Lane<S>,
    per_b: Lane<S>,
    peak: Lane<S>,
    wu: Lane<S>,
    wv: Lane<S>,
    au2: Lane<S>,
    per_v_v: Lane<S>,
    wvv: Lane<S>,
    per_alpha_v: Lane<S>,
    c_d: Lane<S>,
    exchange: [Lane<S>; 3],
    exchange_theta: [Lane<S>; 3],
    exchange_rho_d: [Lane<S>; 3],
    root_per_v_v: Lane<S>,
}

/// One direction in the corner frame (see `sawtooth::Ray`).
#[derive(Clone, Copy)]
struct Ray<S: Simd> {
    u: Lane<S>,
    e: Lane<S>,
    m: Lane<S>,
    /// max(0, ω_m) and max(0, −ω_e).
    up: Lane<S>,
    rho: Lane<S>,
    per_m: Lane<S>,
    per_rho: Lane<S>,
    sigma: Lane<S>,
    open: Lane<S>,
    x: Lane<S>,
    y: Lane<S>,
    on_facet: Mask<S>,
    on_riser: Mask<S>,
    /// Whether e > 0, whether σ < p, and whether a hop over the riser ends on the facet.
    hidden: Mask<S>,
    partly: Mask<S>,
    short: Mask<S>,
}

/// The reflectances of the walls for one direction.
#[derive(Clone, Copy)]
struct Walls<S: Simd> {
    facet: Wall<S>,
    riser: Wall<S>,
    facet_f: Lane<S>,
    riser_f: Lane<S>,
    /// T(ω_m) ω_m and T(ω_ρ) ω_ρ.
    a: Lane<S>,
    b: Lane<S>,
}

/// Slopes of the sum with respect to one direction's numbers.
#[derive(Clone, Copy)]
struct Back<S: Simd> {
    u: Lane<S>,
    e: Lane<S>,
    m: Lane<S>,
    sigma: Lane<S>,
    x: Lane<S>,
    y: Lane<S>,
    a: Lane<S>,
    b: Lane<S>,
    facet_f: Lane<S>,
    riser_f: Lane<S>,
    facet_cos: Lane<S>,
    riser_cos: Lane<S>,
}

/// Slopes of the sum with respect to the numbers that both directions share.
#[derive(Clone, Copy)]
struct Shared<S: Simd> {
    p: Lane<S>,
    r: Lane<S>,
    ln_alpha_u: Lane<S>,
    ln_alpha_v: Lane<S>,
}

impl<S: Simd> Ray<S> {
    #[inline(always)]
    fn new(simd: S, q: &Shape<S>, w: &[Lane<S>; 3]) -> Self {
        let (zero, one, tiny) = (
            Lane::splat(simd, 0.0),
            Lane::splat(simd, 1.0),
            Lane::splat(simd, TINY),
        );
        let (s, c) = (q.r, q.p);
        let e = w[1].mul_add(c, -(w[2] * s));
        let m = w[1].mul_add(s, w[2] * c);
        let (on_facet, on_riser, hidden) = (zero.less(m), e.less(zero), zero.less(e));
        let (up, rho) = (m.max(zero), (-e).max(zero));
        let (per_m, per_rho) = (one / m.max(tiny), one / rho.max(tiny));
        let sigma = s * e.max(zero) * per_m;
        let partly = sigma.less(c);
        let open = hidden.select((w[2] * per_m).max(zero), c);
        let (over, under) = (s * rho, c * up);
        let short = over.less(under);
        Ray {
            u: w[0],
            e,
            m,
            up,
            rho,
            per_m,
            per_rho,
            sigma: on_facet.select(sigma.min(c), c),
            open: on_facet.select(open, zero),
            x: on_riser.select(short.select(over * per_m, c), zero),
            y: on_riser.select(short.select(s, under * per_rho), zero),
            on_facet,
            on_riser,
            hidden,
            partly,
            short,
        }
    }

    #[inline(always)]
    fn walls(&self, simd: S, optics: &Optics) -> Walls<S> {
        let (one, zero, tiny) = (
            Lane::splat(simd, 1.0),
            Lane::splat(simd, 0.0),
            Lane::splat(simd, TINY),
        );
        macro_rules! boundary {
            ($cos:expr, $seen:expr) => {{
                let w = wall(simd, $cos.max(tiny), optics.eta, optics.k);
                Wall {
                    s: $seen.select(w.s, one),
                    p: $seen.select(w.p, one),
                    to_s: $seen.select(w.to_s, zero),
                    to_p: $seen.select(w.to_p, zero),
                }
            }};
        }
        let facet = boundary!(self.up, self.on_facet);
        let riser = boundary!(self.rho, self.on_riser);
        let (facet_f, riser_f) = (facet.f(simd), riser.f(simd));
        Walls {
            facet,
            riser,
            facet_f,
            riser_f,
            a: (one - facet_f) * self.up,
            b: (one - riser_f) * self.rho,
        }
    }

    /// Returns atan2(ω_e, max(0, ω_m)).
    #[inline(always)]
    fn beta(&self, simd: S) -> Lane<S> {
        let zero = Lane::splat(simd, 0.0);
        let angle = self.e.abs().angle_to(self.up);
        self.on_riser.select(zero - angle, angle)
    }

    /// Propagates the slopes from sigma, x, y, a, b and the reflectances back to e, m, p, r.
    #[inline(always)]
    fn lead_back(
        &self,
        simd: S,
        q: &Shape<S>,
        walls: Option<&Walls<S>>,
        g: &mut Back<S>,
        shared: &mut Shared<S>,
    ) {
        let (zero, one) = (Lane::splat(simd, 0.0), Lane::splat(simd, 1.0));
        let (s, c) = (q.r, q.p);
        let within = self.hidden.select(self.partly.select(zero, g.sigma), zero);
        shared.p = shared.p + self.on_facet.select(within, g.sigma);
        let slides = self.hidden.select(self.partly.select(g.sigma, zero), zero);
        let slides = self.on_facet.select(slides, zero) * self.per_m;
        shared.r = slides.mul_add(self.e, shared.r);
        g.e = slides.mul_add(s, g.e);
        g.m = g.m - slides * self.sigma;
        let Some(walls) = walls else {
            return;
        };
        let (x, y) = (
            self.on_riser.select(g.x, zero),
            self.on_riser.select(g.y, zero),
        );
        let over = self.short.select(x, zero) * self.per_m;
        shared.r = over.mul_add(self.rho, shared.r) + self.short.select(y, zero);
        g.e = g.e - over * s;
        g.m = g.m - over * self.x;
        shared.p = shared.p + self.short.select(zero, x);
        let under = self.short.select(zero, y) * self.per_rho;
        let under = self.on_facet.select(under, zero);
        shared.p = under.mul_add(self.m, shared.p);
        g.m = under.mul_add(c, g.m);
        g.e = under.mul_add(self.y, g.e);
        let riser_f = g.riser_f - g.b * self.rho;
        let to_rho = g.riser_cos + g.b * (one - walls.riser_f) + riser_f * walls.riser.slope(simd);
        g.e = g.e - self.on_riser.select(to_rho, zero);
        let facet_f = g.facet_f - g.a * self.up;
        let to_m = g.facet_cos + g.a * (one - walls.facet_f) + facet_f * walls.facet.slope(simd);
        g.m = g.m + self.on_facet.select(to_m, zero);
    }
}

/// Returns the radiance with its slopes for directions along u, v, n of a far rig, whose half angle is that of the
/// shape.
#[inline(always)]
pub(crate) fn partials<S: Simd>(
    simd: S,
    optics: &Optics,
    shape: &[Lane<S>; SHAPE],
    i: &[Lane<S>; 3],
    o: &[Lane<S>; 3],
) -> Slopes<S> {
    let q = &Shape {
        r: shape[0],
        p: shape[1],
        per_a: shape[2],
        per_b: shape[3],
        peak: shape[4],
        wu: shape[5],
        wv: shape[6],
        au2: shape[7],
        per_v_v: shape[8],
        wvv: shape[9],
        per_alpha_v: shape[10],
        c_d: shape[11],
        exchange: [shape[12], shape[13], shape[14]],
        exchange_theta: [shape[15], shape[16], shape[17]],
        exchange_rho_d: [shape[18], shape[19], shape[20]],
        root_per_v_v: shape[21],
    };
    let (zero, one, tiny) = (
        Lane::splat(simd, 0.0),
        Lane::splat(simd, 1.0),
        Lane::splat(simd, TINY),
    );
    let (ray_i, ray_o) = (Ray::new(simd, q, i), Ray::new(simd, q, o));
    let mut gi = Back {
        u: zero,
        e: zero,
        m: zero,
        sigma: zero,
        x: zero,
        y: zero,
        a: zero,
        b: zero,
        facet_f: zero,
        riser_f: zero,
        facet_cos: zero,
        riser_cos: zero,
    };
    let mut go = gi;
    let mut shared = Shared {
        p: zero,
        r: zero,
        ln_alpha_u: zero,
        ln_alpha_v: zero,
    };
    let mut sum = single(simd, q, &ray_i, &ray_o, [&mut gi, &mut go], &mut shared);
    let (mut to_theta, mut to_rho_d) = (zero, zero);
    // Metal has no diffuse light; only the retro lobe needs its walls, and only if a direction reaches a riser.
    let opaque = optics.k > 0.0;
    let any_riser = ray_i.on_riser.any() || ray_o.on_riser.any();
    let walls =
        (!opaque || any_riser).then(|| (ray_i.walls(simd, optics), ray_o.walls(simd, optics)));
    if let Some((wi, wo)) = &walls {
        if !opaque {
            let d = diffuse(
                simd,
                q,
                [&ray_i, &ray_o],
                [wi, wo],
                [&mut gi, &mut go],
                &mut shared,
            );
            sum = q.c_d.mul_add(d.sum, sum);
            to_theta = q.c_d * d.to_theta;
            to_rho_d = Lane::splat(simd, optics.diffuse).mul_add(d.sum, q.c_d * d.to_rho_d);
        }
        if any_riser {
            let betas = [ray_i.beta(simd), ray_o.beta(simd)];
            sum = sum
                + retro(
                    simd,
                    optics,
                    q,
                    [&ray_i, &ray_o],
                    [wi, wo],
                    betas,
                    [&mut gi, &mut go],
                    &mut shared,
                );
            sum = sum
                + retro(
                    simd,
                    optics,
                    q,
                    [&ray_o, &ray_i],
                    [wo, wi],
                    [betas[1], betas[0]],
                    [&mut go, &mut gi],
                    &mut shared,
                );
        }
    }
    ray_i.lead_back(simd, q, walls.as_ref().map(|w| &w.0), &mut gi, &mut shared);
    ray_o.lead_back(simd, q, walls.as_ref().map(|w| &w.1), &mut go, &mut shared);
    let above = zero.less(i[2]).and(zero.less(o[2]));
    let per_n = above.select(one / o[2].max(tiny), zero);
    let value = sum * per_n;
    let to_theta = to_theta + gi.m * ray_i.e - gi.e * ray_i.m + go.m * ray_o.e
        - go.e * ray_o.m
        - shared.p * q.r
        + shared.r * q.p;
    macro_rules! to_sample {
        ($g:expr) => {
            [
                $g.u * per_n,
                ($g.e * q.p + $g.m * q.r) * per_n,
                ($g.m * q.p - $g.e * q.r) * per_n,
            ]
        };
    }
    let incident = to_sample!(gi);
    let outgoing = to_sample!(go);
    Slopes {
        value,
        theta_r: to_theta * per_n,
        ln_alpha_u: shared.ln_alpha_u * per_n,
        ln_alpha_v: shared.ln_alpha_v * per_n,
        rho_d: to_rho_d * per_n,
        incident,
        outgoing: [outgoing[0], outgoing[1], outgoing[2] - value * per_n],
    }
}

/// (a) Single reflection. |h|² is that of the rig, so it has no slope.
#[inline(always)]
fn single<S: Simd>(
    simd: S,
    q: &Shape<S>,
    i: &Ray<S>,
    o: &Ray<S>,
    [gi, go]: [&mut Back<S>; 2],
    shared: &mut Shared<S>,
) -> Lane<S> {
    let (zero, one, two, four, tiny) = (
        Lane::splat(simd, 0.0),
        Lane::splat(simd, 1.0),
        Lane::splat(simd, 2.0),
        Lane::splat(simd, 4.0),
        Lane::splat(simd, TINY),
    );
    let (hu, he, hm) = (i.u + o.u, i.e + o.e, i.m + o.m);
    // D F/4 about a wall's normal z, with logarithmic slopes with respect to x, y, z and ln αu, ln αv.
    macro_rules! lobe {
        ($y:expr, $z:expr, $on:expr) => {{
            let per = one / $z.max(tiny);
            let (x, y) = (hu * per, $y * per);
            let (xa, yb) = (x * q.per_a, y * q.per_b);
            let (qx, qy) = (x * xa, y * yb);
            let all = qx + qy;
            let per2 = per * per;
            let d = $on.select(all.exp_neg() * q.peak * per2 * per2, zero);
            (
                d,
                -(two * xa * per),
                -(two * yb * per),
                (two * all - four) * per,
                (two * qx - one) * q.wu,
                (two * qy - one) * q.wv,
            )
        }};
    }
    let seen = i.open.min(o.open);
    let on_facet = i.on_facet.and(o.on_facet).and(zero.less(seen));
    let (d, to_u, to_y, to_z, to_au, to_av) = lobe!(he, hm, on_facet);
    let part = seen * d;
    let mut value = part;
    let mut to_h = [part * to_u, part * to_y, part * to_z];
    shared.ln_alpha_u = part.mul_add(to_au, shared.ln_alpha_u);
    shared.ln_alpha_v = part.mul_add(to_av, shared.ln_alpha_v);
    shared.p = shared.p + d;
    let i_hides = o.sigma.less(i.sigma);
    gi.sigma = gi.sigma - i_hides.select(d, zero);
    go.sigma = go.sigma - i_hides.select(zero, d);
    let on_riser = i.on_riser.and(o.on_riser);
    if on_riser.any() {
        let z = i.rho + o.rho;
        let (d, to_u, to_y, to_z, to_au, to_av) = lobe!(hm, z, on_riser);
        let part = q.r * d;
        value = value + part;
        to_h[0] = part.mul_add(to_u, to_h[0]);
        to_h[1] = to_h[1] - part * to_z;
        to_h[2] = part.mul_add(to_y, to_h[2]);
        shared.ln_alpha_u = part.mul_add(to_au, shared.ln_alpha_u);
        shared.ln_alpha_v = part.mul_add(to_av, shared.ln_alpha_v);
        shared.r = shared.r + d;
    }
    gi.u = gi.u + to_h[0];
    gi.e = gi.e + to_h[1];
    gi.m = gi.m + to_h[2];
    go.u = go.u + to_h[0];
    go.e = go.e + to_h[1];
    go.m = go.m + to_h[2];
    value
}

/// Diffuse light, its slope with respect to θr through the exchange, and that with respect to ρd through κ; all
/// without the factor c_d.
struct Diffuse<S: Simd> {
    sum: Lane<S>,
    to_theta: Lane<S>,
    to_rho_d: Lane<S>,
}

/// (b) Diffuse light; the slopes that lead to the directions include c_d.
#[inline(always)]
fn diffuse<S: Simd>(
    simd: S,
    q: &Shape<S>,
    [i, o]: [&Ray<S>; 2],
    [wi, wo]: [&Walls<S>; 2],
    [gi, go]: [&mut Back<S>; 2],
    shared: &mut Shared<S>,
) -> Diffuse<S> {
    let zero = Lane::splat(simd, 0.0);
    let (r, p, c_d) = (q.r, q.p, q.c_d);
    let (fi, fo) = (wi.facet_f, wo.facet_f);
    let (ri, ro) = (wi.riser_f, wo.riser_f);
    let (facets, risers) = (wi.a * wo.a, wi.b * wo.b);
    macro_rules! lit_and_seen {
        ($a:expr, $b:expr) => {
            $b.sigma
                .less($b.open)
                .select($a.x - $b.sigma, $b.open - (p - $a.x))
                .max(zero)
        };
    }
    let seen = i.open.min(o.open);
    let hop_i = lit_and_seen!(i, o);
    let hop_o = lit_and_seen!(o, i);
    let (both_x, both_y) = (i.x.min(o.x), i.y.min(o.y));
    let per_facets = seen + ri * hop_i + ro * hop_o + ri * ro * both_x;
    let per_risers = r + fi * i.y + fo * o.y + fi * fo * both_y;
    let mut sum = facets * per_facets + risers * per_risers;

    let (cf, cr) = (c_d * facets, c_d * risers);
    let lit = zero.less(seen).select(cf, zero);
    shared.p = shared.p + lit;
    let i_hides = o.sigma.less(i.sigma);
    gi.sigma = gi.sigma - i_hides.select(lit, zero);
    go.sigma = go.sigma - i_hides.select(zero, lit);
    let hops = zero.less(hop_i).select(cf * ri, zero);
    gi.x = gi.x + hops;
    go.sigma = go.sigma - hops;
    let hops = zero.less(hop_o).select(cf * ro, zero);
    go.x = go.x + hops;
    gi.sigma = gi.sigma - hops;
    let (twice, i_less) = (cf * ri * ro, i.x.less(o.x));
    gi.x = gi.x + i_less.select(twice, zero);
    go.x = go.x + i_less.select(zero, twice);
    gi.riser_f = cf.mul_add(hop_i + ro * both_x, gi.riser_f);
    go.riser_f = cf.mul_add(hop_o + ri * both_x, go.riser_f);
    shared.r = shared.r + cr;
    let (twice, i_less) = (cr * fi * fo, i.y.less(o.y));
    gi.y = cr.mul_add(fi, gi.y) + i_less.select(twice, zero);
    go.y = cr.mul_add(fo, go.y) + i_less.select(zero, twice);
    gi.facet_f = cr.mul_add(i.y + fo * both_y, gi.facet_f);
    go.facet_f = cr.mul_add(o.y + fi * both_y, go.facet_f);

    // Exchange: E_f = a (p − σ + F_ρ X), E_r = b (r + F_m Y).
    let (open_i, open_o) = (i.open + ri * i.x, o.open + ro * o.x);
    let (deep_i, deep_o) = (r + fi * i.y, r + fo * o.y);
    let (ef_i, ef_o) = (wi.a * open_i, wo.a * open_o);
    let (er_i, er_o) = (wi.b * deep_i, wo.b * deep_o);
    let products = [ef_i * ef_o, ef_o * er_i + er_o * ef_i, er_i * er_o];
    macro_rules! exchanged {
        ($coefficients:expr) => {
            $coefficients[0] * products[0]
                + $coefficients[1] * products[1]
                + $coefficients[2] * products[2]
        };
    }
    sum = sum + exchanged!(q.exchange);
    let [c1, c2, c3] = q.exchange;
    macro_rules! to_walls {
        ($w:expr, $walls:expr, $g:expr, $open:expr, $deep:expr, $ef:expr, $er:expr) => {
            // ef and er belong to the other direction.
            let to_ef = c_d * (c1 * $ef + c2 * $er);
            let to_er = c_d * (c2 * $ef + c3 * $er);
            $g.a = to_ef.mul_add($open, $g.a);
            $g.b = to_er.mul_add($deep, $g.b);
            let (ea, eb) = (to_ef * $walls.a, to_er * $walls.b);
            shared.p = shared.p + ea;
            $g.sigma = $g.sigma - ea;
            $g.x = ea.mul_add($walls.riser_f, $g.x);
            $g.riser_f = ea.mul_add($w.x, $g.riser_f);
            shared.r = shared.r + eb;
            $g.y = eb.mul_add($walls.facet_f, $g.y);
            $g.facet_f = eb.mul_add($w.y, $g.facet_f);
        };
    }
    to_walls!(i, wi, gi, open_i, deep_i, ef_o, er_o);
    to_walls!(o, wo, go, open_o, deep_o, ef_i, er_i);
    gi.a = (c_d * wo.a).mul_add(per_facets, gi.a);
    go.a = (c_d * wi.a).mul_add(per_facets, go.a);
    gi.b = (c_d * wo.b).mul_add(per_risers, gi.b);
    go.b = (c_d * wi.b).mul_add(per_risers, go.b);
    Diffuse {
        sum,
        to_theta: exchanged!(q.exchange_theta),
        to_rho_d: exchanged!(q.exchange_rho_d),
    }
}

/// (c) The retro lobe: `a` reaches the facet, `b` the riser.
#[inline(always)]
#[expect(
    clippy::too_many_arguments,
    reason = "the arguments are pairs, one of each direction"
)]
fn retro<S: Simd>(
    simd: S,
    optics: &Optics,
    q: &Shape<S>,
    [a, b]: [&Ray<S>; 2],
    [wa, wb]: [&Walls<S>; 2],
    [beta_a, beta_b]: [Lane<S>; 2],
    [ga, gb]: [&mut Back<S>; 2],
    shared: &mut Shared<S>,
) -> Lane<S> {
    macro_rules! k {
        ($x:expr) => {
            Lane::splat(simd, $x)
        };
    }
    let (zero, one, half, tiny) = (k!(0.0), k!(1.0), k!(0.5), k!(TINY));
    let (r, p) = (q.r, q.p);
    let spread = half * (a.up * a.up + b.rho * b.rho);
    let per_v_u = one / q.au2.mul_add(spread, k!(optics.cones)).max(k!(1e-18));
    let x = half * (a.u + b.u);
    let y = half * (beta_b - beta_a);
    let exponent_u = half * x * x * per_v_u;
    let exponent_v = half * y * y * q.per_v_v;
    let tilt = -(half * (beta_a + beta_b));

    // 1/tan of the tilt from the sum of both directions' unit vectors, held within bounds.
    let (most, least) = optics.per_tan;
    let (la, lb) = (
        one / (a.e * a.e + a.up * a.up).max(tiny * tiny).sqrt(),
        one / (b.e * b.e + b.up * b.up).max(tiny * tiny).sqrt(),
    );
    let (along, up) = (-(a.e * la + b.e * lb), a.up * la + b.up * lb);
    let as_is = k!(0.0).less(along);
    let raw = as_is.select(up / along.max(tiny), k!(most));
    let per_tan = raw.min(k!(most)).max(k!(least));
    let moves = k!(least).less(raw).and(raw.less(k!(most)));
    let by_facet = (p * per_tan).less(r);
    let cut = by_facet.select(a.open, -a.sigma);
    let beside = by_facet.select(a.open * per_tan, r - a.sigma * per_tan);
    let hidden = zero.less(a.sigma);
    let length = hidden.select(beside, r);
    let to_p = hidden.select(by_facet.select(per_tan, zero), zero);
    let to_r = hidden.select(by_facet.select(zero, one), one);
    let to_sigma = hidden.select(-per_tan, zero);
    let to_tilt = moves.select(-(cut * (one + per_tan * per_tan)), zero);
    let to_tilt = hidden.select(to_tilt, zero);
    let on = a.on_facet.and(b.on_riser).and(zero.less(length));

    let z = tilt * q.per_alpha_v;
    let (phi, bell) = z.normal_share();
    let gauss = (exponent_u + exponent_v).exp_neg() * (per_v_u.sqrt() * q.root_per_v_v);
    let gauss = on.select(gauss * k!(0.125 * std::f64::consts::FRAC_1_PI), zero);
    let metal = optics.k > 0.0;
    let product = if metal {
        half * (wa.facet.s * wb.riser.s + wa.facet.p * wb.riser.p)
    } else {
        wa.facet_f * wb.riser_f
    };
    let bare = phi * b.rho * gauss * length;
    let value = bare * product;
    if metal {
        let h = half * bare;
        ga.facet_cos = ga.facet_cos + h * (wa.facet.to_s * wb.riser.s + wa.facet.to_p * wb.riser.p);
        gb.riser_cos = gb.riser_cos + h * (wb.riser.to_s * wa.facet.s + wb.riser.to_p * wa.facet.p);
    } else {
        ga.facet_f = bare.mul_add(wb.riser_f, ga.facet_f);
        gb.riser_f = bare.mul_add(wa.facet_f, gb.riser_f);
    }
    let whole = product * phi * gauss;
    let per_length = whole * b.rho;
    shared.p = per_length.mul_add(to_p, shared.p);
    shared.r = per_length.mul_add(to_r, shared.r);
    ga.sigma = per_length.mul_add(to_sigma, ga.sigma);
    let slope = product * b.rho * gauss * length * bell;
    let to_tilt = per_length * to_tilt + slope * q.per_alpha_v;
    shared.ln_alpha_v = shared.ln_alpha_v - slope * z;
    let mut to_rho = whole * length;
    let to_x = -(value * x * per_v_u);
    let to_v_u = value * (exponent_u - half) * per_v_u;
    let to_y = -(value * y * q.per_v_v);
    ga.u = half.mul_add(to_x, ga.u);
    gb.u = half.mul_add(to_x, gb.u);
    let two = k!(2.0);
    shared.ln_alpha_u = shared.ln_alpha_u + two * to_v_u * q.au2 * spread;
    ga.m = (to_v_u * q.au2).mul_add(a.up, ga.m);
    to_rho = (to_v_u * q.au2).mul_add(b.rho, to_rho);
    gb.e = gb.e - to_rho;
    shared.ln_alpha_v = shared.ln_alpha_v + two * value * (exponent_v - half) * q.wvv;
    // β = atan2(e, m).
    let to_beta_a = -(half * (to_y + to_tilt)) * la * la;
    let to_beta_b = half * (to_y - to_tilt) * lb * lb;
    ga.e = to_beta_a.mul_add(a.up, ga.e);
    ga.m = ga.m - to_beta_a * a.e;
    gb.e = to_beta_b.mul_add(b.up, gb.e);
    gb.m = gb.m - b.on_facet.select(to_beta_b * b.e, zero);
    value
}
