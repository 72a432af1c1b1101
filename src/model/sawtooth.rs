//! The full sawtooth: exact visibility, roughness, diffuse walls, mirror hops, retro lobe.
//!
//! The form goes beyond Luongo et al. 2017; `docs/explanation/sawtooth.md` contains the derivation. Facet and riser meet at a right
//! angle, so one *corner frame* serves both: for a direction ω
//!
//! ```text
//! ω_u = ω·u            along the ridges
//! ω_e = ω·v_m          along the facet, towards the riser's foot (the valley)
//! ω_m = ω·m            along the facet's normal
//! ω_ρ = max(0, −ω_e)   along the riser's normal −e
//! ```
//!
//! Per unit period the facet is p = cos θr long and the riser r = sin θr. L (o·n) is the sum of (a) single
//! reflection, (b) diffuse light with one mirror hop before or after it and diffuse exchange between the walls, (c)
//! the retro lobe of facet and riser. Irradiance is 1 on a surface that faces the light.
//!
//! Call [`radiance_of`]; [`visible_and_lit_fraction`] returns the geometric part. Kinks (min, max, clip) have the
//! derivative of the branch that the comparison selects; at a tie both one-sided derivatives exist and one of them is
//! returned.
//!
//! *Conditioning.* Lengths that vanish are not computed as differences. The visible facet length beside a riser is
//! ω_n/ω_m (p − σ loses cos⁻¹θ digits towards the horizon), also if the retro lobe's pair of walls ends at the
//! facet's crest. The view factors' p + r − 1 is 2 p r/(1 + p + r) (the difference loses 1/min(p, r)). The length
//! that a mirror hop lights and the other end sees is computed from the smaller of the visible and the hidden part.
//! Transmittances 1 − F are differences if F is nearly 1: their digits are those of the index there (η = 20 at normal
//! incidence loses a factor of 5). Random tables in 60-digit arithmetic (α 1e-6 to 1e3, θr 0 to 89.99°, grazing to
//! 1e-12 rad) agree to four roundings per unit of condition number, except for lobes narrower than the directions'
//! own rounding allows (see `crate::geometry`).

use std::f64::consts::PI;

use super::dual::Scalar;
use super::fresnel::{reflectance_of, reflectances_of};
use super::rough_boundary::RoughBoundary;

/// Two decimals that differ by 90 may differ by 90 ± 2⁻⁴⁶ as doubles (half a last bit of each input and of the
/// difference).
const EDGE_ON_DEG: f64 = 3e-14;

/// Least tilt b = −(β_i + β_o)/2 in the length ℓ of the retro lobe's walls, rad. The length divides by tan b, which
/// must not vanish or change sign. The share Φ(b/αv) of facet slopes uses b without this limit.
pub(super) const RETRO_TILT_MIN: f64 = 0.02;
/// Greatest such tilt, rad, so that tan b stays finite towards π/2.
pub(super) const RETRO_TILT_MAX: f64 = 1.5;

/// Returns the fraction of the facets' area that is both lit from and visible from two directions, given as signed
/// angles from n of the directions projected on the n-v plane (degrees, + towards v).
///
/// With ψ = a − θr: g(a) = χ+(cos ψ) [1 − tan θr max(0, tan ψ)]; the result is min(g(a_i), g(a_o)). The parts hidden
/// from light and from camera start at the same valley, so the joint fraction is the smaller one. Exactly edge-on
/// (ψ = ±90° in the given degrees) counts as facing away.
///
/// `theta_r_deg` is within [0, 90); 0 for a flat surface.
#[must_use]
pub fn visible_and_lit_fraction(
    theta_r_deg: f64,
    theta_i_proj_deg: f64,
    theta_o_proj_deg: f64,
) -> f64 {
    let g = |a_deg: f64| {
        let turn = a_deg - theta_r_deg;
        let psi_deg = turn - 360.0 * (turn / 360.0).round();
        // Degrees given as decimals: their difference is 90 if it is so to the last bits.
        if psi_deg.abs() >= 90.0 - EDGE_ON_DEG {
            return 0.0;
        }
        let hidden = theta_r_deg.to_radians().tan() * psi_deg.to_radians().tan().max(0.0);
        (1.0 - hidden).max(0.0)
    };
    g(theta_i_proj_deg).min(g(theta_o_proj_deg))
}

/// The parameters of surface and optics over any [`Scalar`]; angles in radians.
#[derive(Debug, Clone, Copy)]
pub struct Parameters<S> {
    /// Ridge angle θr.
    pub theta_r: S,
    /// Beckmann roughness along the ridges.
    pub alpha_u: S,
    /// Beckmann roughness across the ridges.
    pub alpha_v: S,
    /// Lambertian-equivalent reflectance of a flat piece at the rig's own angles.
    pub rho_d: S,
    /// Factor A on single specular reflection (A² on two); 1 with an absolute scale.
    pub amplitude: S,
    /// Real part of the index.
    pub eta: S,
    /// Imaginary part of the index.
    pub k: S,
    /// Angle between lamp and camera.
    pub theta_l: f64,
    /// Contribution of the cones of lamp and lens to α²; see [`crate::geometry::Cones::widening`].
    pub widening: f64,
}

/// One direction in the corner frame with its geometry on facet and riser.
#[derive(Clone, Copy)]
struct Ray<S> {
    u: S,
    e: S,
    /// max(0, ω_m)
    m: S,
    /// max(0, −ω_e)
    rho: S,
    /// Facet length hidden by the riser, from the valley.
    sigma: S,
    /// Visible facet length, p − σ. Towards the horizon on the side that the facets lean to, both are nearly p, but
    /// p − (r ω_e/ω_m) is ω_n/ω_m, which loses no digits.
    open: S,
    /// Facet length lit by a mirror hop over the riser, from the valley.
    x: S,
    /// Riser length lit by a mirror hop over the facet, from the valley.
    y: S,
    /// R_s and R_p on the facet and on the riser.
    facet: (S, S),
    riser: (S, S),
}

fn zero<S: Scalar>() -> S {
    S::constant(0.0)
}

fn one<S: Scalar>() -> S {
    S::constant(1.0)
}

impl<S: Scalar> Ray<S> {
    fn new(w: [S; 3], q: &Parameters<S>) -> Self {
        let (s, c) = (q.theta_r.sin(), q.theta_r.cos());
        let e = w[1] * c - w[2] * s;
        let m_signed = w[1] * s + w[2] * c;
        let m = m_signed.larger(zero());
        let rho = (-e).larger(zero());
        let sigma = if m.value() <= 0.0 {
            c
        } else {
            (s * e.larger(zero()) / m).smaller(c)
        };
        let open = if m.value() <= 0.0 {
            zero()
        } else if e.value() > 0.0 {
            (w[2] / m).larger(zero())
        } else {
            c
        };
        let (x, y) = if rho.value() > 0.0 && m.value() > 0.0 {
            ((s * rho / m).smaller(c), (c * m / rho).smaller(s))
        } else if rho.value() > 0.0 {
            (c, zero())
        } else {
            (zero(), zero())
        };
        Ray {
            u: w[0],
            e,
            m,
            rho,
            sigma,
            open,
            x,
            y,
            facet: reflectances_of(m, q.eta, q.k),
            riser: reflectances_of(rho, q.eta, q.k),
        }
    }

    fn facet_f(&self) -> S {
        (self.facet.0 + self.facet.1) * 0.5
    }
    fn riser_f(&self) -> S {
        (self.riser.0 + self.riser.1) * 0.5
    }
    fn facet_t(&self) -> S {
        one::<S>() - self.facet_f()
    }
    fn riser_t(&self) -> S {
        one::<S>() - self.riser_f()
    }
}

impl Ray<f64> {
    /// A direction with the transmittances and reflectances of rough walls.
    fn rough(w: [f64; 3], q: &Parameters<f64>, walls: &RoughBoundary) -> Self {
        let mut ray = Ray::new(w, q);
        let facet = walls.excess(ray.u, ray.e, ray.m);
        let riser = walls.excess(ray.u, ray.m, ray.rho);
        ray.facet = (ray.facet.0 - facet, ray.facet.1 - facet);
        ray.riser = (ray.riser.0 - riser, ray.riser.1 - riser);
        ray
    }
}

/// Returns T̄ = ∫₀¹ 2 μ T(μ) dμ, the transmittance of a smooth boundary for diffuse light.
///
/// Gauss–Legendre in panels that shrink towards grazing, where T falls steeply if the index is near 1. Below index 1
/// (k = 0) the integral starts at the critical angle; g² = η² − 1 + μ² as the variable makes it smooth there.
pub fn diffuse_transmittance<S: Scalar>(eta: S, k: S) -> S {
    let mut sum = zero::<S>();
    let total = k.value() == 0.0 && eta.value() < 1.0;
    let coarse = [0.0, 1.0 / 256.0, 1.0 / 64.0, 1.0 / 16.0, 1.0 / 4.0, 1.0];
    // For a step of the index so small that T falls within the first panel, at μ of the order of its root.
    let dip = (eta.value() - 1.0).abs().sqrt();
    let panels: Vec<f64> = if k.value() == 0.0 && dip > 0.0 && dip < coarse[1] / 16.0 {
        let fine = [0.25, 1.0, 4.0, 16.0].map(|t| t * dip);
        [&coarse[..1], &fine, &coarse[1..]].concat()
    } else {
        coarse.to_vec()
    };
    for pair in panels.windows(2) {
        let (low, high) = (pair[0], pair[1]);
        for (node, weight) in super::gauss::LEGENDRE_16 {
            for sign in [-1.0, 1.0] {
                let t = 0.5 * (low + high) + 0.5 * (high - low) * sign * node;
                let w = 0.5 * (high - low) * weight;
                let term = if total {
                    let g = eta * t;
                    let mu = (g * g + one() - eta * eta).sqrt();
                    (one::<S>() - reflectance_of(mu, eta, k)) * g * eta
                } else {
                    let mu = S::constant(t);
                    (one::<S>() - reflectance_of(mu, eta, k)) * mu
                };
                sum = sum + term * (2.0 * w);
            }
        }
    }
    sum
}

/// Returns the radiance towards `o` for irradiance 1 on a surface that faces the light at `i`; components of the unit
/// vectors along u, v, n. 0 if camera or lamp is not above the surface.
pub fn radiance_of<S: Scalar>(i: [S; 3], o: [S; 3], q: &Parameters<S>) -> S {
    if i[2].value() <= 0.0 || o[2].value() <= 0.0 {
        return zero();
    }
    let ray_i = Ray::new(i, q);
    let ray_o = Ray::new(o, q);
    let mut sum = single(i, o, &ray_i, &ray_o, q);
    if S::CARRIES_DERIVATIVES || q.rho_d.value() != 0.0 {
        sum = sum + diffuse(&ray_i, &ray_o, q);
    }
    sum = sum + retro(&ray_i, &ray_o, q) + retro(&ray_o, &ray_i, q);
    sum / o[2]
}

/// (a) Single reflection from facet and riser.
fn single<S: Scalar>(i: [S; 3], o: [S; 3], ri: &Ray<S>, ro: &Ray<S>, q: &Parameters<S>) -> S {
    let (s, c) = (q.theta_r.sin(), q.theta_r.cos());
    let au2 = q.alpha_u * q.alpha_u + S::constant(q.widening);
    let av2 = q.alpha_v * q.alpha_v + S::constant(q.widening);
    let h = [i[0] + o[0], i[1] + o[1], i[2] + o[2]];
    let h2 = h[0] * h[0] + h[1] * h[1] + h[2] * h[2];
    let cos_d = h2.sqrt() * 0.5;
    let f = reflectance_of(cos_d, q.eta, q.k);
    let hm = h[1] * s + h[2] * c;
    let he = h[1] * c - h[2] * s;
    // D about the normal component z with the other two components x (along u) and y.
    let d = |x: S, y: S, z: S| {
        let z2 = z * z;
        let exponent = (x * x / au2 + y * y / av2) / z2;
        let cos2 = z2 / h2;
        (-exponent).exp() / ((au2 * av2).sqrt() * cos2 * cos2 * PI)
    };
    let mut sum = zero::<S>();
    if ri.m.value() > 0.0 && ro.m.value() > 0.0 {
        let seen = ri.open.smaller(ro.open);
        if seen.value() > 0.0 && hm.value() > 0.0 {
            sum = sum + seen * d(h[0], he, hm);
        }
    }
    if ri.rho.value() > 0.0 && ro.rho.value() > 0.0 {
        sum = sum + s * d(h[0], hm, -he);
    }
    sum * f * q.amplitude * 0.25
}

/// Returns the facet length that a mirror hop over the riser lights from `a` and that is visible from `b`, [x_a −
/// σ_b]⁺. It is computed from the smaller of the visible and the hidden length of `b`, so that neither end loses the
/// digits of a short length.
fn lit_and_seen<S: Scalar>(a: &Ray<S>, b: &Ray<S>, p: S) -> S {
    let length = if b.sigma.value() < b.open.value() {
        a.x - b.sigma
    } else {
        b.open - (p - a.x)
    };
    length.larger(zero())
}

/// (b) Diffuse light: direct, with one mirror hop before or after, exchanged between the walls.
fn diffuse<S: Scalar>(i: &Ray<S>, o: &Ray<S>, q: &Parameters<S>) -> S {
    let (r, p) = (q.theta_r.sin(), q.theta_r.cos());
    let at = |mu: f64| one::<S>() - reflectance_of(S::constant(mu), q.eta, q.k);
    let c_d = q.rho_d / (at(1.0) * at(q.theta_l.cos()) * PI);
    let facet = |w: &Ray<S>| w.facet_t() * w.m;
    let riser = |w: &Ray<S>| w.riser_t() * w.rho;
    let (ti, to) = (facet(i), facet(o));
    let (ui, uo) = (riser(i), riser(o));
    let mut sum = i.open.smaller(o.open) * ti * to + r * ui * uo;
    sum = sum
        + i.riser_f() * ti * lit_and_seen(i, o, p) * to
        + o.riser_f() * to * lit_and_seen(o, i, p) * ti
        + i.riser_f() * ti * o.riser_f() * to * i.x.smaller(o.x);
    sum = sum
        + i.facet_f() * ui * i.y * uo
        + o.facet_f() * uo * o.y * ui
        + i.facet_f() * ui * o.facet_f() * uo * i.y.smaller(o.y);

    let e_f = |w: &Ray<S>| facet(w) * (w.open + w.riser_f() * w.x);
    let e_r = |w: &Ray<S>| riser(w) * (r + w.facet_f() * w.y);
    if r.value() > 0.0 {
        let t_bar = diffuse_transmittance(q.eta, q.k);
        let kappa = c_d * t_bar * t_bar * PI;
        // The view factors (p + r − 1)/(2p) and (p + r − 1)/(2r) without their cancellation at either end of θr:
        // (p + r)² − 1 = 2 p r. The first exchange is not computed as a difference either.
        let reach = p + r + one();
        let (phi_fr, phi_rf) = (r / reach, p / reach);
        let loss = kappa * kappa * phi_fr * phi_rf;
        let d = one::<S>() - loss;
        let (fi, ri) = (e_f(i), e_r(i));
        let delta_f = (loss * fi + kappa * phi_rf * ri) / d;
        let delta_r = (loss * ri + kappa * phi_fr * fi) / d;
        sum = sum + e_f(o) * delta_f / p + e_r(o) * delta_r / r;
    }
    c_d * sum
}

/// Returns the part of (b) with three or more reflections at the walls: two mirror hops about one diffuse reflection,
/// and the radiosity beyond the first exchange. L (o·n), as in all terms. `walls` are rough.
pub(super) fn three_bounces_and_more(
    i: [f64; 3],
    o: [f64; 3],
    q: &Parameters<f64>,
    walls: &RoughBoundary,
    c_d: f64,
    kappa: f64,
) -> f64 {
    if q.rho_d == 0.0 || q.theta_r <= 0.0 {
        return 0.0;
    }
    let (r, p) = (q.theta_r.sin(), q.theta_r.cos());
    let (i, o) = (Ray::rough(i, q, walls), Ray::rough(o, q, walls));
    let (ti, to) = (i.facet_t() * i.m, o.facet_t() * o.m);
    let (ui, uo) = (i.riser_t() * i.rho, o.riser_t() * o.rho);
    let hops = ti * i.riser_f() * to * o.riser_f() * i.x.min(o.x)
        + ui * i.facet_f() * uo * o.facet_f() * i.y.min(o.y);
    // κ (p + r − 1)/2 = κ p r/(1 + p + r), without the cancellation.
    let per_walls = kappa / (1.0 + p + r);
    let loss = per_walls * per_walls * (p * r);
    let d = 1.0 - loss;
    let e_f = |t: f64, w: &Ray<f64>| t * (w.open + w.riser_f() * w.x);
    let e_r = |u: f64, w: &Ray<f64>| u * (r + w.facet_f() * w.y);
    let (fi, fo, ri, ro) = (e_f(ti, &i), e_f(to, &o), e_r(ui, &i), e_r(uo, &o));
    let exchanged = loss / d * (fi * fo / p + ri * ro / r) + per_walls / d * (fo * ri + ro * fi);
    let first = per_walls * (to * o.open * ui * r + uo * r * ti * i.open);
    c_d * (hops + exchanged - first)
}

/// Returns the density of the normal distribution of variance `v`.
fn normal_density<S: Scalar>(x: S, v: S) -> S {
    (-(x * x) / (v * 2.0)).exp() / (v * (2.0 * PI)).sqrt()
}

/// Returns Φ, the integral of the standard normal density.
fn normal_integral<S: Scalar>(x: S) -> S {
    let value = x.value();
    let slope = (-0.5 * value * value).exp() / (2.0 * PI).sqrt();
    x.map(
        0.5 * libm::erfc(-value * std::f64::consts::FRAC_1_SQRT_2),
        slope,
    )
}

/// (c) Light that reaches the facet first (direction `a`) and leaves from the riser (`b`); the reverse path has lamp
/// and camera exchanged.
fn retro<S: Scalar>(a: &Ray<S>, b: &Ray<S>, q: &Parameters<S>) -> S {
    if a.m.value() <= 0.0 || b.rho.value() <= 0.0 {
        return zero();
    }
    let (r, p) = (q.theta_r.sin(), q.theta_r.cos());
    if r.value() <= 0.0 {
        return zero();
    }
    let beta_a = a.e.atan2(a.m);
    let beta_b = b.e.atan2(b.m);
    let tilt = (beta_a + beta_b) * -0.5;
    let length = if a.sigma.value() <= 0.0 {
        r
    } else {
        let kept = tilt
            .larger(S::constant(RETRO_TILT_MIN))
            .smaller(S::constant(RETRO_TILT_MAX))
            .tan();
        // If the facet limits the pair of walls, its length less σ is the visible length, without a difference.
        let far = p / kept;
        if far.value() < r.value() {
            a.open / kept
        } else {
            (r - a.sigma / kept).larger(zero())
        }
    };
    if length.value() <= 0.0 {
        return zero();
    }
    let cones = 0.5 * q.widening;
    let v_u = q.alpha_u * q.alpha_u * (a.m * a.m + b.rho * b.rho) * 0.5 + S::constant(cones);
    let v_v = q.alpha_v * q.alpha_v + S::constant(cones);
    let f = if q.k.value() > 0.0 {
        (a.facet.0 * b.riser.0 + a.facet.1 * b.riser.1) * 0.5
    } else {
        a.facet_f() * b.riser_f()
    };
    q.amplitude
        * q.amplitude
        * length
        * normal_integral(tilt / q.alpha_v)
        * f
        * b.rho
        * normal_density((a.u + b.u) * 0.5, v_u)
        * normal_density((beta_b - beta_a) * 0.5, v_v)
        * 0.25
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Cones, Pose, RigGeometry};
    use crate::model::{Optics, Surface, Variant, radiance};
    use crate::units::Angle;

    fn table(text: &str) -> Vec<Vec<f64>> {
        text.lines()
            .skip(1)
            .map(|line| line.split(',').map(|x| x.parse().unwrap()).collect())
            .collect()
    }

    #[test]
    fn the_visibility_agrees_with_ray_casting() {
        let rows = table(include_str!("../../tests/data/sawtooth-visibility.csv"));
        assert_eq!(rows.len(), 1445);
        for row in rows {
            let seen = visible_and_lit_fraction(row[0], row[1], row[2]);
            // The table's 8000 midpoint samples per facet are good to 6e-5.
            assert!((seen - row[3]).abs() <= 1e-4, "{row:?}: {seen}");
        }
    }

    #[test]
    fn exactly_edge_on_counts_as_facing_away() {
        assert_eq!(visible_and_lit_fraction(20.0, -70.0, 0.0), 0.0);
        assert!(visible_and_lit_fraction(20.0, -69.999_999, 0.0) > 0.9);
        for tenths in 1..900 {
            let theta_r_deg = f64::from(tenths) / 10.0;
            let edge_deg = f64::from(tenths - 900) / 10.0;
            assert_eq!(
                visible_and_lit_fraction(theta_r_deg, edge_deg, edge_deg),
                0.0
            );
        }
    }

    #[test]
    fn the_closed_form_agrees_with_an_independent_transcription() {
        let rows = table(include_str!("../../tests/data/sawtooth-closed-form.csv"));
        assert_eq!(rows.len(), 400);
        let peak = rows.iter().map(|r| r[11]).fold(0.0, f64::max);
        let mut worst: f64 = 0.0;
        for row in &rows {
            let rig = RigGeometry {
                theta_l: Angle::from_deg(row[7]),
                cones: Cones::of_lamp(Angle::from_deg(row[8])),
                ..RigGeometry::IN_PLANE
            };
            let surface = Surface {
                theta_r: row[0].to_radians(),
                alpha_u: row[1],
                alpha_v: row[2],
                amplitude: row[3],
                rho_d: row[4],
            };
            let optics = Optics {
                eta: row[5],
                k: row[6],
                theta_l: row[7].to_radians(),
                cones: Cones::of_lamp(Angle::from_deg(row[8])),
            };
            let directions = rig.directions(Pose::from_deg(row[9], row[10]));
            let value = radiance(Variant::Sawtooth, &directions, &surface, &optics);
            worst = worst.max((value - row[11]).abs());
        }
        assert!(worst <= 1e-12 * peak, "{worst:e} against a peak of {peak}");
    }
}
