//! The sawtooth with the terms of real samples: rough walls that conserve light, a translucent body, slopes with tails,
//! rounded crests, flat lands.
//!
//! Names, frame and terms are those of [`super::sawtooth`]; L (o·n) is
//!
//! ```text
//! single + retro + (1 − τ) [direct + hops + exchange] + τ c_d E(i) E(o)
//! ```
//!
//! *Walls*: every transmittance T and every mirror hop F of diffuse light is T̃ and 1 − T̃ of
//! [`super::rough_boundary`]. *Body*: the share τ of the light that enters leaves uniformly over many ridges; E(ω) =
//! T_S(ω) (ω·n) is the light that a ridge transmits, E_f + E_r of the exchange term, at most ω·n. The appearance of a
//! flat piece does not depend on τ. *Slopes* are Student's t ([`slopes`]). *Crests* of radius R (relative to the
//! facet length p = cos θr; R per unit period in the form) shorten facet and riser by R and add an arc ([`crest`]);
//! the retro lobe keeps the riser's straight part f = 1 − R/r, mirror hops the mean of 1 and f. *Lands*, the share of the
//! surface that is flat at the height of the crests, shade nothing more than the crests do: L is that of the ridges and that of
//! a flat piece of the same material (the form at θr = 0), mixed by their shares of the surface.
//!
//! With τ, ι and R 0 and smooth walls the form is the ideal sawtooth. It is written once over [`Number`]. Call
//! [`radiance_of`]; fits call [`partials`].
//!
//! A new term: its formula is a file here, its parameter a field of [`Real`] before the lands. [`Terms`] states whether it is
//! evaluated; a fit that frees it needs its derivative at 0, too.
//!
//! The form omits the mutual masking of slopes on single reflection, the second order of R, and a draft of the riser.

pub(super) mod crest;
mod derivatives;
pub mod slopes;
pub(super) mod three_bounces;
mod walls;

use super::gauss::LEGENDRE_4;
use super::number::Number;
pub use super::real::Real;
use super::sawtooth::{RETRO_TILT_MAX, RETRO_TILT_MIN};
use super::{Optics, Surface};
pub use derivatives::partials;
use slopes::Slopes;
pub use walls::Walls;

/// Largest share of the lands of a search: beyond it the surface is a flat one with some ridges.
pub const LAND_MAX: f64 = 0.8;
/// Largest crest radius of a search, as a share of the riser.
pub const CREST_MAX: f64 = 0.8;

/// A surface's parameters over any [`Number`]; angles in radians.
#[derive(Debug, Clone, Copy)]
pub struct Parameters<N> {
    /// Ridge angle θr ≥ 0.
    pub theta_r: N,
    /// Roughness along the ridges.
    pub alpha_u: N,
    /// Roughness across the ridges.
    pub alpha_v: N,
    /// Lambertian-equivalent reflectance of a flat piece at the rig's own angles.
    pub rho_d: N,
    /// Deviations from an ideal sawtooth.
    pub real: Real<N>,
    /// Factor A on single specular reflection (A² on two).
    pub amplitude: N,
    /// Real part of the index.
    pub eta: N,
    /// Imaginary part of the index.
    pub k: N,
}

impl Parameters<f64> {
    /// Returns the numbers of a surface with θr ≥ 0.
    #[must_use]
    pub fn of(surface: &Surface, real: &Real, optics: &Optics) -> Self {
        Parameters {
            theta_r: surface.theta_r,
            alpha_u: surface.alpha_u,
            alpha_v: surface.alpha_v,
            rho_d: surface.rho_d,
            real: *real,
            amplitude: surface.amplitude,
            eta: optics.eta,
            k: optics.k,
        }
    }
}

/// The terms that are evaluated, decided without the parameters' values.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Terms {
    /// Diffuse light.
    pub body: bool,
    /// Slopes with tails.
    pub tails: bool,
    /// Rounded crests.
    pub crests: bool,
    /// Flat lands.
    pub lands: bool,
    /// Polarised products of two metal mirrors.
    pub metal: bool,
}

impl Terms {
    /// Returns the terms of a surface; a deviation that `moves` is included even if it is 0.
    #[must_use]
    pub fn of(real: &Real, optics: &Optics, moves: &Real<bool>) -> Self {
        Terms {
            body: optics.k == 0.0,
            tails: moves.tail || real.tail != 0.0,
            crests: moves.crest || real.crest != 0.0,
            lands: moves.land || real.land != 0.0,
            metal: optics.k > 0.0,
        }
    }
}

/// One direction in the corner frame with its geometry on facet and riser.
#[derive(Clone, Copy)]
struct Ray<N> {
    u: N,
    e: N,
    m: N,
    rho: N,
    /// Facet length hidden by the riser; visible; lit by a hop over the riser. Riser length hidden by the facet; lit
    /// by a hop.
    sigma: N,
    open: N,
    x: N,
    hidden: N,
    y: N,
    /// R_s and R_p of the smooth walls.
    facet: (N, N),
    riser: (N, N),
    /// F̃ of the rough walls.
    facet_f: N,
    riser_f: N,
    /// Angle from n of the direction projected across the ridges.
    projected: N,
}

struct Shape<N> {
    s: N,
    p: N,
    /// R per unit period, and the straight share of the riser.
    round: N,
    straight: N,
    one: N,
    zero: N,
}

impl<N: Number> Shape<N> {
    fn of(q: &Parameters<N>) -> Self {
        let (s, p) = q.theta_r.sine_cosine();
        let (one, zero) = (s.like(1.0), s.like(0.0));
        let round = q.real.crest * p;
        let riser = zero.below(s);
        let straight = N::choose(riser, one - round / N::choose(riser, s, one), zero).positive();
        Shape {
            s,
            p,
            round,
            straight,
            one,
            zero,
        }
    }
}

fn ray<N: Number>(w: [N; 3], q: &Parameters<N>, shape: &Shape<N>, walls: &Walls) -> Ray<N> {
    let Shape {
        s, p, one, zero, ..
    } = *shape;
    let e = w[1] * p - w[2] * s;
    let signed = w[1] * s + w[2] * p;
    let (m, rho) = (signed.positive(), (-e).positive());
    let up = zero.below(signed);
    let lean = zero.below(e);
    let back = e.below(zero);
    // Divisors are replaced by 1 where they would be 0 and are not used.
    let safe = |x: N, on: N::Choice| N::choose(on, x, one);
    let m_safe = safe(m, up);
    // A rounded crest hides R (e + m − |(e, m)|) less than a sharp one.
    let across = safe(e * e + m * m, up).root();
    let saved = shape.round * (e.positive() + m - across);
    let hides = ((s * e - saved).positive() / m_safe).smaller(p);
    let sigma = N::choose(up, N::choose(lean, hides, zero), p);
    let leaves = N::choose(lean, (w[2] / m_safe + saved / m_safe).smaller(p), p);
    let open = N::choose(up, leaves.positive(), zero);
    let rho_safe = safe(rho, back);
    let x = N::choose(back, N::choose(up, (s * rho / m_safe).smaller(p), p), zero);
    let y = N::choose(back, (p * m / rho_safe).smaller(s), zero);
    let hidden = N::choose(back, (p * (-signed).positive() / rho_safe).smaller(s), s);
    let dark = (one, one);
    let both = |on: N::Choice, r: (N, N)| (N::choose(on, r.0, dark.0), N::choose(on, r.1, dark.1));
    let facet = both(up, safe(m, up).mirrored(q.eta, q.k));
    let riser = both(back, safe(rho, back).mirrored(q.eta, q.k));
    let rough = |(r_s, r_p): (N, N), cos: N, on: N::Choice, across: N| {
        let f = (r_s + r_p).times(0.5);
        if walls.boundary.is_smooth() {
            return f;
        }
        let (u2, v2) = (w[0] * w[0], across * across);
        let along = (u2 + one.like(1e-30)) / (u2 + v2 + one.like(2e-30));
        let [of_u, of_v] = [0, 1].map(|k| cos.map(|cos| walls.boundary.excess_and_slope(cos)[k]));
        N::choose(on, f - along * of_u - (one - along) * of_v, one)
    };
    Ray {
        u: w[0],
        e,
        m,
        rho,
        sigma,
        open,
        x,
        hidden,
        y,
        facet_f: rough(facet, m, up, e),
        riser_f: rough(riser, rho, back, signed),
        facet,
        riser,
        projected: w[1].angle(w[2]),
    }
}

/// Returns the radiance towards `o` for irradiance 1 on a surface that faces the light at `i`; components of the unit
/// vectors along u, v, n, both above the surface. `widening` is the contribution of the cones of lamp and lens to α².
pub fn radiance_of<N: Number>(
    i: [N; 3],
    o: [N; 3],
    q: &Parameters<N>,
    terms: Terms,
    walls: &Walls,
    widening: f64,
) -> N {
    let ridges = of_ridges(i, o, q, terms, walls, widening);
    match terms.lands {
        true => ridges + q.real.land * (of_land(i, o, q, terms, walls, widening) - ridges),
        false => ridges,
    }
}

/// The same of a flat piece of the same material.
fn of_land<N: Number>(
    i: [N; 3],
    o: [N; 3],
    q: &Parameters<N>,
    terms: Terms,
    walls: &Walls,
    widening: f64,
) -> N {
    let zero = q.theta_r.like(0.0);
    let flat = Parameters {
        theta_r: zero,
        real: Real {
            crest: zero,
            ..q.real
        },
        ..*q
    };
    let terms = Terms {
        crests: false,
        ..terms
    };
    of_ridges(i, o, &flat, terms, walls, widening)
}

/// The same of the ridges between the lands.
fn of_ridges<N: Number>(
    i: [N; 3],
    o: [N; 3],
    q: &Parameters<N>,
    terms: Terms,
    walls: &Walls,
    widening: f64,
) -> N {
    let shape = Shape::of(q);
    let (a, b) = (ray(i, q, &shape, walls), ray(o, q, &shape, walls));
    let slopes = Slopes {
        u2: q.alpha_u * q.alpha_u + shape.one.like(widening),
        v2: q.alpha_v * q.alpha_v + shape.one.like(widening),
        tail: q.real.tail,
        widening: if terms.tails { widening } else { 0.0 },
    };
    let mut sum = single(i, o, [&a, &b], q, &shape, &slopes, terms);
    if terms.body {
        sum = sum + diffuse(i, o, [&a, &b], q, &shape, terms, walls);
    }
    sum =
        sum + retro(&a, &b, q, &shape, terms, widening) + retro(&b, &a, q, &shape, terms, widening);
    sum / o[2]
}

/// (a) Single reflection from facet, riser and crest.
fn single<N: Number>(
    i: [N; 3],
    o: [N; 3],
    [a, b]: [&Ray<N>; 2],
    q: &Parameters<N>,
    shape: &Shape<N>,
    slopes: &Slopes<N>,
    terms: Terms,
) -> N {
    let Shape {
        s, p, one, zero, ..
    } = *shape;
    let h = [i[0] + o[0], i[1] + o[1], i[2] + o[2]];
    let h2 = h[0] * h[0] + h[1] * h[1] + h[2] * h[2];
    let (f_s, f_p) = h2.root().times(0.5).mirrored(q.eta, q.k);
    let hm = h[1] * s + h[2] * p;
    let he = h[1] * p - h[2] * s;
    let norm = slopes.norm();
    // D about a wall's normal z; 0 for a half vector behind the wall.
    let d = |y: N, z: N, on: N::Choice| {
        let z = N::choose(on, z, one);
        let z2 = z * z;
        let per = h2 / z2;
        let density = slopes.relative(h[0] * h[0] / z2, y * y / z2) * norm * per * per;
        N::choose(on, density, zero)
    };
    let seen = (a.open.smaller(b.open) - shape.round).positive();
    let facet = zero.below(a.m * b.m * hm.positive() * seen);
    let mut sum = seen * d(he, hm, facet);
    let riser = zero.below(a.rho * b.rho);
    sum = sum + (s - shape.round).positive() * d(hm, -he, riser);
    if terms.crests {
        let arc = crest::range(q.theta_r, a.projected, b.projected);
        let lit = arc.0.below(arc.1);
        let j = crest::lobe(h, arc, slopes, terms.tails);
        sum = sum + N::choose(lit, shape.round * j, zero);
    }
    sum * (f_s + f_p) * q.amplitude.times(0.125)
}

/// (b) Diffuse light.
fn diffuse<N: Number>(
    i: [N; 3],
    o: [N; 3],
    [a, b]: [&Ray<N>; 2],
    q: &Parameters<N>,
    shape: &Shape<N>,
    terms: Terms,
    walls: &Walls,
) -> N {
    let Shape {
        s: r,
        p,
        one,
        zero,
        round,
        straight,
    } = *shape;
    let [per_rho_d, per_c_d] = walls.body(q.eta, q.k);
    let c_d = q.rho_d * per_rho_d;
    let facet = |w: &Ray<N>| (one - w.facet_f) * w.m;
    let riser = |w: &Ray<N>| (one - w.riser_f) * w.rho;
    let (ti, to) = (facet(a), facet(b));
    let (ui, uo) = (riser(a), riser(b));
    let mut direct =
        (a.open.smaller(b.open) - round).positive() * ti * to + (r - round).positive() * ui * uo;
    if terms.crests {
        direct = direct + round * crest_diffuse(i, o, [a, b], q, shape, walls);
    }
    // [x_a − σ_b]⁺ from the smaller of the visible and the hidden length, so that neither end loses the digits of a short
    // one.
    let lit = |a: &Ray<N>, b: &Ray<N>| {
        let hidden = b.sigma.below(b.open);
        N::choose(hidden, a.x - b.sigma, b.open - (p - a.x)).positive()
    };
    let hops = a.riser_f * ti * lit(a, b) * to
        + b.riser_f * to * lit(b, a) * ti
        + a.riser_f * ti * b.riser_f * to * a.x.smaller(b.x)
        + a.facet_f * ui * a.y * uo
        + b.facet_f * uo * b.y * ui
        + a.facet_f * ui * b.facet_f * uo * a.y.smaller(b.y);
    let e_f = |w: &Ray<N>| facet(w) * (w.open + w.riser_f * w.x);
    let e_r = |w: &Ray<N>, hidden: N| riser(w) * (r - hidden + w.facet_f * w.y);
    let kappa = c_d * per_c_d;
    let reach = p + r + one;
    let (phi_fr, phi_rf) = (r / reach, p / reach);
    let loss = kappa * kappa * phi_fr * phi_rf;
    let d = one - loss;
    let (fi, ri) = (e_f(a), e_r(a, zero));
    let delta_f = (loss * fi + kappa * phi_rf * ri) / d;
    let delta_r = (loss * ri + kappa * phi_fr * fi) / d;
    let on = zero.below(r);
    let exchange = e_f(b) * delta_f / p + e_r(b, zero) * delta_r / N::choose(on, r, one);
    let local = direct + hops * (one + straight).times(0.5) + N::choose(on, exchange, zero);
    let through = |w: &Ray<N>, n: N| (e_f(w) + e_r(w, w.hidden)).smaller(n);
    let even = through(a, i[2]) * through(b, o[2]);
    c_d * (local + q.real.translucency * (even - local))
}

/// Returns ∫ T̃(m·i) T̃(m·o) (m·i)(m·o) dψ over the crest's arc.
fn crest_diffuse<N: Number>(
    i: [N; 3],
    o: [N; 3],
    [a, b]: [&Ray<N>; 2],
    q: &Parameters<N>,
    shape: &Shape<N>,
    walls: &Walls,
) -> N {
    let (one, zero) = (shape.one, shape.zero);
    let (low, high) = crest::range(q.theta_r, a.projected, b.projected);
    let (middle, half) = ((low + high).times(0.5), (high - low).times(0.5).positive());
    let passed = |w: [N; 3], sin: N, cos: N| {
        let cosine = w[1] * sin + w[2] * cos;
        let on = zero.below(cosine);
        let (r_s, r_p) = N::choose(on, cosine, one).mirrored(q.eta, q.k);
        let [of_u, of_v] =
            [0, 1].map(|k| cosine.map(|cos| walls.boundary.excess_and_slope(cos)[k]));
        let t = one - (r_s + r_p).times(0.5) + (of_u + of_v).times(0.5);
        N::choose(on, t * cosine, zero)
    };
    let mut sum = zero;
    // Two panels of four nodes.
    for side in [-0.5, 0.5] {
        for (node, weight) in LEGENDRE_4 {
            let (sin, cos) = (middle + half.times(side + 0.5 * node)).sine_cosine();
            sum = sum + (passed(i, sin, cos) * passed(o, sin, cos)).times(0.5 * weight);
        }
    }
    sum * half
}

/// (c) The retro lobe: light that reaches the facet first (`a`) and leaves from the riser (`b`).
fn retro<N: Number>(
    a: &Ray<N>,
    b: &Ray<N>,
    q: &Parameters<N>,
    shape: &Shape<N>,
    terms: Terms,
    widening: f64,
) -> N {
    let Shape {
        s: r,
        p,
        one,
        zero,
        straight,
        ..
    } = *shape;
    let on = zero.below(a.m * b.rho * r);
    let (beta_a, beta_b) = (a.e.angle(a.m), b.e.angle(b.m));
    let tilt = (beta_a + beta_b).times(-0.5);
    let kept = tilt
        .larger(one.like(RETRO_TILT_MIN))
        .smaller(one.like(RETRO_TILT_MAX));
    let (sin, cos) = kept.sine_cosine();
    let per_tan = cos / sin;
    let far = p * per_tan;
    let within = N::choose(
        far.below(r),
        a.open * per_tan,
        (r - a.sigma * per_tan).positive(),
    );
    let length = N::choose(zero.below(a.sigma), within, r) * straight;
    let cones = 0.5 * widening;
    let v_u = (q.alpha_u * q.alpha_u * (a.m * a.m + b.rho * b.rho)).times(0.5) + one.like(cones);
    let v_v = q.alpha_v * q.alpha_v + one.like(cones);
    let f = if terms.metal {
        (a.facet.0 * b.riser.0 + a.facet.1 * b.riser.1).times(0.5)
    } else {
        (a.facet.0 + a.facet.1) * (b.riser.0 + b.riser.1).times(0.25)
    };
    // The density of both slopes; with tails, of the width that is exact at its peak.
    let kappa = one + q.real.tail.times(0.5);
    let (du, db) = ((a.u + b.u).times(0.5), (beta_b - beta_a).times(0.5));
    let pair = Slopes {
        u2: (kappa * v_u).times(2.0),
        v2: (kappa * v_v).times(2.0),
        tail: q.real.tail,
        widening: 0.0,
    };
    let density = pair.relative(du * du, db * db) * pair.norm();
    let share = pair.share_below(tilt / q.alpha_v);
    let product = q.amplitude * q.amplitude * length * share * f * b.rho * density;
    N::choose(on, product.times(0.25), zero)
}

#[cfg(test)]
pub(crate) use tests::reference;
#[cfg(test)]
mod tests;
