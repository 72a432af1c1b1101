//! The full sawtooth with hand-written derivatives (see [`super::prepared`]).
//!
//! Names and terms are those of [`super::sawtooth`]. Each term adds to the sum L (o·n) and to the derivatives of the
//! sum with respect to its inputs (`Back`). At the end these are propagated back to the directions and the parameters
//! (reverse mode).

mod retro;

use std::f64::consts::FRAC_1_PI;

use super::fresnel::{Reflectances, Slopes};
use super::gradient_paper::to_alpha;
use super::prepared::{Partials, Prepared};
use retro::retro;

/// One direction in the corner frame (see `sawtooth::Ray`).
struct Ray {
    u: f64,
    e: f64,
    /// Signed ω·m.
    m: f64,
    rho: f64,
    sigma: f64,
    /// Visible facet length, p − σ.
    open: f64,
    x: f64,
    y: f64,
    /// atan2(e, max(0, m)), for the retro lobe.
    beta: f64,
    facet: Boundary,
    riser: Boundary,
    /// T(ω_m) ω_m and T(ω_ρ) ω_ρ.
    a: f64,
    b: f64,
}

/// Reflectance of a wall for one direction; the polarised parts only for metal.
struct Boundary {
    f: Slopes,
    parts: Option<Reflectances>,
}

/// Derivatives of the sum with respect to one direction's numbers.
#[derive(Default, Clone, Copy)]
struct Back {
    u: f64,
    e: f64,
    m: f64,
    sigma: f64,
    x: f64,
    y: f64,
    a: f64,
    b: f64,
    facet_f: f64,
    riser_f: f64,
    /// Propagated directly to cos, n, k if the polarised parts are used.
    facet_cos: f64,
    riser_cos: f64,
}

/// Derivatives of the sum with respect to the numbers that both directions share.
#[derive(Default)]
struct Shared {
    p: f64,
    r: f64,
    alpha_u: f64,
    alpha_v: f64,
    amplitude: f64,
    eta: f64,
    k: f64,
}

const DARK: Slopes = Slopes {
    value: 1.0,
    cos: 0.0,
    eta: 0.0,
    k: 0.0,
};

impl Boundary {
    /// A wall that faces away from the direction: it reflects all, with zero derivatives.
    fn unseen() -> Self {
        Boundary {
            f: DARK,
            parts: None,
        }
    }

    #[inline]
    fn new(q: &Prepared, cos: f64) -> Self {
        if cos <= 0.0 {
            return Boundary::unseen();
        }
        let optics = &q.table.optics;
        if optics.k == 0.0 {
            Boundary {
                f: q.table.reflectance(cos),
                parts: None,
            }
        } else {
            let parts = Reflectances::at(cos, optics.eta, optics.k);
            Boundary {
                f: parts.unpolarised(),
                parts: Some(parts),
            }
        }
    }
}

impl Ray {
    #[inline]
    fn new(q: &Prepared, w: [f64; 3], walls: bool, risers: bool) -> Self {
        let (s, c) = (q.sin, q.cos);
        let e = w[1] * c - w[2] * s;
        let m = w[1] * s + w[2] * c;
        let rho = (-e).max(0.0);
        let sigma = if m <= 0.0 {
            c
        } else if e > 0.0 {
            (s * e / m).min(c)
        } else {
            0.0
        };
        // p − σ without cancellation; its derivatives are those of σ.
        let open = if m <= 0.0 {
            0.0
        } else if e > 0.0 {
            (w[2] / m).max(0.0)
        } else {
            c
        };
        let (x, y) = if rho <= 0.0 {
            (0.0, 0.0)
        } else if m <= 0.0 {
            (c, 0.0)
        } else if s * rho < c * m {
            (s * rho / m, s)
        } else {
            (c, c * m / rho)
        };
        let (facet, riser) = if walls {
            (Boundary::new(q, m), Boundary::new(q, rho))
        } else {
            (Boundary::unseen(), Boundary::unseen())
        };
        let beta = if risers { e.atan2(m.max(0.0)) } else { 0.0 };
        let a = (1.0 - facet.f.value) * m.max(0.0);
        let b = (1.0 - riser.f.value) * rho;
        Ray {
            u: w[0],
            e,
            m,
            rho,
            sigma,
            open,
            x,
            y,
            beta,
            facet,
            riser,
            a,
            b,
        }
    }

    /// Propagates the derivatives from sigma, x, y, a, b and the reflectances back to e, m, p, r, n, k.
    #[inline]
    fn lead_back(&self, q: &Prepared, g: &mut Back, shared: &mut Shared) {
        let (s, c) = (q.sin, q.cos);
        let (e, m) = (self.e, self.m);
        if m <= 0.0 || (e > 0.0 && self.sigma >= c) {
            shared.p += g.sigma;
        } else if e > 0.0 {
            let per_m = g.sigma / m;
            shared.r += per_m * e;
            g.e += per_m * s;
            g.m -= per_m * self.sigma;
        }
        if self.rho > 0.0 {
            if m <= 0.0 {
                shared.p += g.x;
            } else if s * self.rho < c * m {
                shared.r += g.x * self.rho / m + g.y;
                g.e -= g.x * s / m;
                g.m -= g.x * self.x / m;
            } else {
                shared.p += g.x + g.y * m / self.rho;
                g.m += g.y * c / self.rho;
                g.e += g.y * self.y / self.rho;
            }
            g.riser_f -= g.b * self.rho;
            g.riser_cos += g.b * (1.0 - self.riser.f.value) + g.riser_f * self.riser.f.cos;
            g.e -= g.riser_cos;
            shared.eta += g.riser_f * self.riser.f.eta;
            shared.k += g.riser_f * self.riser.f.k;
        }
        if m > 0.0 {
            g.facet_f -= g.a * m;
            g.m += g.facet_cos + g.a * (1.0 - self.facet.f.value) + g.facet_f * self.facet.f.cos;
            shared.eta += g.facet_f * self.facet.f.eta;
            shared.k += g.facet_f * self.facet.f.k;
        }
    }
}

pub(super) fn partials(q: &Prepared, i: [f64; 3], o: [f64; 3]) -> Partials {
    let (s, c) = (q.sin, q.cos);
    // On an opaque surface without a direction that reaches a riser, only single reflection remains.
    let diffuse = !(q.opaque || q.lean);
    let risers = !q.lean && (i[1] * c < i[2] * s || o[1] * c < o[2] * s);
    let ray_i = Ray::new(q, i, diffuse || risers, risers);
    let ray_o = Ray::new(q, o, diffuse || risers, risers);
    let (mut gi, mut go) = (Back::default(), Back::default());
    let mut shared = Shared::default();

    let mut sum = single(q, &ray_i, &ray_o, &mut gi, &mut go, &mut shared);
    let mut exchange = [0.0; 3];
    let mut diffuse_sum = 0.0;
    if diffuse {
        diffuse_sum = self::diffuse(
            q,
            &ray_i,
            &ray_o,
            &mut gi,
            &mut go,
            &mut shared,
            &mut exchange,
        );
        sum += q.c_d * diffuse_sum;
    }
    if risers {
        sum += retro(q, &ray_i, &ray_o, &mut gi, &mut go, &mut shared);
        sum += retro(q, &ray_o, &ray_i, &mut go, &mut gi, &mut shared);
    }

    ray_i.lead_back(q, &mut gi, &mut shared);
    ray_o.lead_back(q, &mut go, &mut shared);

    let per_n = 1.0 / o[2];
    let value = sum * per_n;
    let mut out = Partials {
        value,
        // de = −m dθ, dm = e dθ, dp = −s dθ, dr = c dθ.
        theta_r: per_n
            * (gi.m * ray_i.e - gi.e * ray_i.m + go.m * ray_o.e - go.e * ray_o.m - shared.p * s
                + shared.r * c),
        alpha_u: per_n * shared.alpha_u,
        alpha_v: per_n * shared.alpha_v,
        rho_d: 0.0,
        translucency: 0.0,
        tail: 0.0,
        crest: 0.0,
        amplitude: per_n * shared.amplitude,
        eta: per_n * shared.eta,
        k: per_n * shared.k,
        incident: back_to_sample(&gi, s, c, per_n),
        outgoing: back_to_sample(&go, s, c, per_n),
    };
    out.outgoing[2] -= value * per_n;
    // c_d and κ: c_d = ρd · diffuse[0](n, k), and κ in the same way.
    let mut to_kappa = 0.0;
    for (coefficient, weight) in q.exchange.iter().zip(exchange) {
        out.theta_r += per_n * q.c_d * weight * coefficient.partials[0];
        to_kappa += q.c_d * weight * coefficient.partials[1];
    }
    let table = &q.table;
    if diffuse {
        out.rho_d = per_n * (diffuse_sum * table.diffuse[0] + to_kappa * q.kappa[1]);
        out.eta +=
            per_n * (diffuse_sum * q.surface.rho_d * table.diffuse[1] + to_kappa * q.kappa[2]);
        out.k += per_n * (diffuse_sum * q.surface.rho_d * table.diffuse[2] + to_kappa * q.kappa[3]);
    }
    if q.lean && !q.opaque {
        let albedo = q.surface.rho_d * FRAC_1_PI;
        out.value += albedo * i[2];
        out.rho_d = FRAC_1_PI * i[2];
        out.incident[2] += albedo;
    }
    out
}

fn back_to_sample(g: &Back, s: f64, c: f64, scale: f64) -> [f64; 3] {
    [
        g.u * scale,
        (g.e * c + g.m * s) * scale,
        (g.m * c - g.e * s) * scale,
    ]
}

/// (a) Single reflection.
#[inline]
fn single(
    q: &Prepared,
    i: &Ray,
    o: &Ray,
    gi: &mut Back,
    go: &mut Back,
    shared: &mut Shared,
) -> f64 {
    let seen = i.open.min(o.open);
    let on_facet = i.m > 0.0 && o.m > 0.0 && seen > 0.0;
    let on_riser = i.rho > 0.0 && o.rho > 0.0;
    if !on_facet && !on_riser {
        return 0.0;
    }
    let (hu, he, hm) = (i.u + o.u, i.e + o.e, i.m + o.m);
    let h2 = hu * hu + he * he + hm * hm;
    let length = h2.sqrt();
    let f = q.table.mirrored(0.5 * length);
    let quarter = 0.25 * q.surface.amplitude;
    let mut lobes = 0.0;
    // Derivatives of the lobes (without F and A/4) with respect to h_u, h_e, h_m.
    let mut to_h = [0.0; 3];
    if on_facet {
        let l = lobe(q, hu, he, hm, h2);
        let part = seen * l.d;
        lobes += part;
        to_h[0] += part * l.to_u;
        to_h[1] += part * l.to_y;
        to_h[2] += part * l.to_z;
        shared.alpha_u += quarter * f.value * part * l.to_alpha_u;
        shared.alpha_v += quarter * f.value * part * l.to_alpha_v;
        let bare = quarter * f.value * l.d;
        shared.p += bare;
        if i.sigma > o.sigma {
            gi.sigma -= bare;
        } else {
            go.sigma -= bare;
        }
    }
    if on_riser {
        let l = lobe(q, hu, hm, -he, h2);
        let part = q.sin * l.d;
        lobes += part;
        to_h[0] += part * l.to_u;
        to_h[1] -= part * l.to_z;
        to_h[2] += part * l.to_y;
        shared.alpha_u += quarter * f.value * part * l.to_alpha_u;
        shared.alpha_v += quarter * f.value * part * l.to_alpha_v;
        shared.r += quarter * f.value * l.d;
    }
    // |h|² in D (squared) and in the Fresnel angle cos = |h|/2.
    let to_h2 = quarter * lobes * (f.value * 2.0 / h2 + f.cos * 0.25 / length);
    let back = quarter * f.value;
    for g in [gi, go] {
        g.u += back * to_h[0] + to_h2 * 2.0 * hu;
        g.e += back * to_h[1] + to_h2 * 2.0 * he;
        g.m += back * to_h[2] + to_h2 * 2.0 * hm;
    }
    shared.amplitude += 0.25 * f.value * lobes;
    shared.eta += quarter * lobes * f.eta;
    shared.k += quarter * lobes * f.k;
    quarter * f.value * lobes
}

/// D and its logarithmic derivatives at fixed |h|².
struct Lobe {
    d: f64,
    to_u: f64,
    to_y: f64,
    to_z: f64,
    to_alpha_u: f64,
    to_alpha_v: f64,
}

/// Returns D about the wall's normal; the half vector's components are (u, y, z).
#[inline]
fn lobe(q: &Prepared, u: f64, y: f64, z: f64, h2: f64) -> Lobe {
    if z <= 0.0 {
        return Lobe {
            d: 0.0,
            to_u: 0.0,
            to_y: 0.0,
            to_z: 0.0,
            to_alpha_u: 0.0,
            to_alpha_v: 0.0,
        };
    }
    let per_z = 1.0 / z;
    let (a, b) = (u * per_z, y * per_z);
    let (au, bv) = (a * q.per_au2, b * q.per_av2);
    let exponent = a * au + b * bv;
    let widen = h2 * per_z * per_z;
    Lobe {
        d: (-exponent).exp() * q.peak * widen * widen,
        to_u: -2.0 * au * per_z,
        to_y: -2.0 * bv * per_z,
        to_z: (2.0 * exponent - 4.0) * per_z,
        to_alpha_u: to_alpha(a * au, q.per_au2, q.surface.alpha_u),
        to_alpha_v: to_alpha(b * bv, q.per_av2, q.surface.alpha_v),
    }
}

/// Returns [x_a − σ_b]⁺ from the smaller of the visible and the hidden length of `b` (see [`super::sawtooth`]).
#[inline]
fn lit_and_seen(a: &Ray, b: &Ray, p: f64) -> f64 {
    let length = if b.sigma < b.open {
        a.x - b.sigma
    } else {
        b.open - (p - a.x)
    };
    length.max(0.0)
}

/// (b) Diffuse light without its factor c_d (the derivatives include it). `exchange` receives the products that the
/// three exchange coefficients multiply.
#[inline]
fn diffuse(
    q: &Prepared,
    i: &Ray,
    o: &Ray,
    gi: &mut Back,
    go: &mut Back,
    shared: &mut Shared,
    exchange: &mut [f64; 3],
) -> f64 {
    let (r, p, c_d) = (q.sin, q.cos, q.c_d);
    let (fi, fo) = (i.facet.f.value, o.facet.f.value);
    let (ri, ro) = (i.riser.f.value, o.riser.f.value);
    let facets = i.a * o.a;
    let risers = i.b * o.b;

    let seen = i.open.min(o.open);
    let hop_i = lit_and_seen(i, o, p);
    let hop_o = lit_and_seen(o, i, p);
    let both_x = i.x.min(o.x);
    let both_y = i.y.min(o.y);
    let per_facets = seen + ri * hop_i + ro * hop_o + ri * ro * both_x;
    let per_risers = r + fi * i.y + fo * o.y + fi * fo * both_y;
    let mut sum = facets * per_facets + risers * per_risers;

    let cf = c_d * facets;
    let cr = c_d * risers;
    if seen > 0.0 {
        shared.p += cf;
        if i.sigma > o.sigma {
            gi.sigma -= cf;
        } else {
            go.sigma -= cf;
        }
    }
    if hop_i > 0.0 {
        gi.x += cf * ri;
        go.sigma -= cf * ri;
    }
    if hop_o > 0.0 {
        go.x += cf * ro;
        gi.sigma -= cf * ro;
    }
    if i.x < o.x {
        gi.x += cf * ri * ro;
    } else {
        go.x += cf * ri * ro;
    }
    gi.riser_f += cf * (hop_i + ro * both_x);
    go.riser_f += cf * (hop_o + ri * both_x);
    shared.r += cr;
    gi.y += cr * fi;
    go.y += cr * fo;
    if i.y < o.y {
        gi.y += cr * fi * fo;
    } else {
        go.y += cr * fi * fo;
    }
    gi.facet_f += cr * (i.y + fo * both_y);
    go.facet_f += cr * (o.y + fi * both_y);

    // Exchange: E_f = a (p − σ + F_ρ X), E_r = b (r + F_m Y).
    let open = |w: &Ray| w.open + w.riser.f.value * w.x;
    let deep = |w: &Ray| r + w.facet.f.value * w.y;
    let (open_i, open_o, deep_i, deep_o) = (open(i), open(o), deep(i), deep(o));
    let (ef_i, ef_o) = (i.a * open_i, o.a * open_o);
    let (er_i, er_o) = (i.b * deep_i, o.b * deep_o);
    let [c1, c2, c3] = [
        q.exchange[0].value,
        q.exchange[1].value,
        q.exchange[2].value,
    ];
    *exchange = [ef_i * ef_o, ef_o * er_i + er_o * ef_i, er_i * er_o];
    sum += c1 * exchange[0] + c2 * exchange[1] + c3 * exchange[2];
    let mut exchanged = |w: &Ray, g: &mut Back, open_w: f64, deep_w: f64, ef: f64, er: f64| {
        // ef and er belong to the other direction.
        let to_ef = c_d * (c1 * ef + c2 * er);
        let to_er = c_d * (c2 * ef + c3 * er);
        g.a += to_ef * open_w;
        g.b += to_er * deep_w;
        let (ea, eb) = (to_ef * w.a, to_er * w.b);
        shared.p += ea;
        g.sigma -= ea;
        g.x += ea * w.riser.f.value;
        g.riser_f += ea * w.x;
        shared.r += eb;
        g.y += eb * w.facet.f.value;
        g.facet_f += eb * w.y;
    };
    exchanged(i, gi, open_i, deep_i, ef_o, er_o);
    exchanged(o, go, open_o, deep_o, ef_i, er_i);

    gi.a += c_d * o.a * per_facets;
    go.a += c_d * i.a * per_facets;
    gi.b += c_d * o.b * per_risers;
    go.b += c_d * i.b * per_risers;
    sum
}
