//! The second tier: two bounces in the sawtooth's valley, integrated in place of the closed approximation.
//!
//! [`Quadrature::radiance`] (or [`radiance`] for one pose) returns the value and an error estimate for a tolerance. Its
//! difference from the closed form of [`super::sawtooth`] is the fixed offset that a fit adds, and the measure of the
//! closed form's inadequacy.
//!
//! Light with ω·n < 0 inside the profile cannot leave it. Light that crosses the line of crests outwards has ω·n > 0.
//! So all exchange is within one valley: facet and riser, at a right angle, of lengths p and r. Both have Beckmann
//! roughness with Smith masking (Walter et al. 2007, rational form) and a Lambert term under the rough Fresnel
//! boundary ([`super::rough_boundary`]).
//!
//! *One bounce* is exact: visible length times the wall's reflectance, averaged over the cones of lamp and lens by
//! cubature ([`cone`]). *Two bounces*, facet then riser, for lamp direction a and camera direction b (in the corner
//! frame u, e, m):
//!
//! ```text
//! L (o·n) = ∫ dω  a_m f_facet(a, ω) ω_m · f_riser(−ω, b) b_ρ · ℓ(ω)
//! ℓ(ω)    = [min(p, r tan β) − max(σ_a, τ_b tan β)]⁺,   tan β = ω_e/ω_m
//! ```
//!
//! ℓ is the length of facet that is lit and that sends light in the direction ω to a place of the riser which the
//! camera sees: exact occlusion, and a function of β only. With ω = (sin γ, cos γ sin β, cos γ cos β) and dω = cos γ
//! dγ dβ, the kinks of ℓ become cell borders and the rest is smooth. Cells start at the mirror images of lamp and
//! camera, and are halved where two Gauss rules disagree. The reverse path, riser then facet, is the same integral
//! with lamp and camera exchanged. The specular-specular part transfers the polarisation of the first bounce to the
//! second, unless disabled ([`Quadrature::with_polarisation`]). *Three and more bounces*: on metal `third_bounce`,
//! and for diffuse light the closed form's radiosity tail.
//!
//! Only the ray tracer includes rounding, burrs and draft angle.
//!
//! *Conditioning.* All integrands are positive, so sums over cells lose no digits. ℓ(ω) is a difference of lengths
//! that vanishes together with the integrand, so its loss of digits at the end has no effect. Narrow lobes need more
//! cells, not more digits: cells start at the mirror images. A tolerance below 1e-13 of the radiance reaches the
//! rounding of the two rules' difference; then the cells run out and `error` reports it.

mod path;
#[cfg(test)]
mod tests;

use std::f64::consts::{FRAC_PI_2, PI};

use nalgebra::Vector3;
use rayon::prelude::*;

use super::cone::{self, Node};
use super::extended::three_bounces::three_bounces_and_more;
use super::extended::{Parameters, Real, Walls};
use super::fresnel::reflectances;
use super::prepared::OpticsTable;
use super::{Optics, Surface, third_bounce};
use crate::geometry::Directions;
use path::Path;

/// A radiance with the error of the integration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimate {
    /// Radiance for irradiance 1 on a surface facing the lamp.
    pub value: f64,
    /// Estimated integration error, absolute; above the tolerance if the cells ran out.
    pub error: f64,
}

/// One surface, prepared for many poses.
#[derive(Debug, Clone)]
pub struct Quadrature {
    q: Parameters<f64>,
    /// −1 if θr was negative, else 1.
    sign: f64,
    sin: f64,
    cos: f64,
    /// The cones' share of a lobe's squared roughness.
    widening: f64,
    c_d: f64,
    /// The transmittance of diffuse light.
    walls: Walls,
    /// The cubature over the cones of lamp and lens.
    cones: Vec<Node>,
    /// Whether the first mirror polarises the light that reaches the second one.
    polarised: bool,
}

/// Returns the radiance at one pair of directions to an absolute tolerance: (value, error estimate).
#[must_use]
pub fn radiance(
    directions: &Directions,
    surface: &Surface,
    optics: &Optics,
    tolerance: f64,
) -> (f64, f64) {
    let estimate =
        Quadrature::new(surface, &OpticsTable::new(optics)).radiance(directions, tolerance);
    (estimate.value, estimate.error)
}

/// A direction in the corner frame with its visible parts of the valley.
#[derive(Clone, Copy)]
struct Ray {
    u: f64,
    e: f64,
    m: f64,
    /// Facet length, from the valley, that the riser hides.
    sigma: f64,
    /// Visible facet length: p − σ without cancellation.
    open: f64,
    /// Riser length, from the valley, that the facet hides.
    tau: f64,
}

/// A wall's lobe: squared roughness of the lobe's width and of its masking.
#[derive(Clone, Copy)]
struct Lobe {
    au2: f64,
    av2: f64,
    /// π times the product of the two roughnesses.
    area: f64,
}

impl Lobe {
    /// Returns D for a half vector (not normalised) along (x, y, z); 0 if it is negligible.
    fn density(self, x: f64, y: f64, z: f64) -> f64 {
        if z <= 0.0 {
            return 0.0;
        }
        let per_z2 = 1.0 / (z * z);
        let exponent = (x * x / self.au2 + y * y / self.av2) * per_z2;
        if exponent > 60.0 {
            return 0.0;
        }
        let widen = (x * x + y * y + z * z) * per_z2;
        (-exponent).exp() * widen * widen / self.area
    }

    /// Returns Smith's masking for Beckmann slopes in the rational form of Walter et al. 2007; direction (x, y, z), z
    /// along the wall's normal.
    fn smith(self, x: f64, y: f64, z: f64) -> f64 {
        third_bounce::smith([self.au2, self.av2], x, y, z)
    }
}

impl Quadrature {
    /// Computes everything that does not depend on the pose. A negative θr equals the positive one at φs + 180°.
    #[must_use]
    pub fn new(surface: &Surface, table: &OpticsTable) -> Self {
        let sign = if surface.theta_r < 0.0 { -1.0 } else { 1.0 };
        let surface = &Surface {
            theta_r: surface.theta_r.abs(),
            ..*surface
        };
        let (sin, cos) = surface.theta_r.sin_cos();
        let optics = &table.optics;
        let walls = Walls::new(surface, &Real::NONE, table);
        let [per_rho_d, _] = walls.body(optics.eta, optics.k);
        Quadrature {
            q: Parameters::of(surface, &Real::NONE, optics),
            widening: optics.cones.widening(),
            sign,
            sin,
            cos,
            c_d: surface.rho_d * per_rho_d,
            walls,
            cones: cone::nodes(&optics.cones, surface.alpha_u.min(surface.alpha_v)),
            polarised: true,
        }
    }

    /// Sets whether the first mirror polarises the light that reaches the second one, as in nature. Many renderers
    /// omit this on plastic: at 45° and index 1.5 the second reflection then lacks 40 % of its light.
    #[must_use]
    pub fn with_polarisation(self, polarised: bool) -> Self {
        Quadrature { polarised, ..self }
    }

    /// Returns the radiance at one pair of directions; `tolerance` is absolute.
    #[must_use]
    pub fn radiance(&self, directions: &Directions, tolerance: f64) -> Estimate {
        let turn = |w: &Vector3<f64>| [self.sign * w.x, self.sign * w.y, w.z];
        let (i, o) = (turn(&directions.incident), turn(&directions.outgoing));
        if i[2] <= 0.0 || o[2] <= 0.0 {
            return Estimate {
                value: 0.0,
                error: 0.0,
            };
        }
        let (a, b) = (self.ray(i), self.ray(o));
        let mut sum = self.one_bounce(i, &b);
        let mut error = 0.0;
        // Either path may use half of the tolerance.
        let allowed = 0.5 * tolerance * o[2];
        for (facet, riser, lamp_first) in [(&a, &b, true), (&b, &a, false)] {
            let (value, off) = self.two_bounces(facet, riser, lamp_first, allowed);
            sum += value;
            error += off;
        }
        if self.q.k > 0.0 {
            sum += self.third_bounce(&a, &b);
        }
        sum += three_bounces_and_more(i, o, &self.q, &self.walls);
        Estimate {
            value: sum / o[2],
            error: error / o[2],
        }
    }

    /// Returns the radiances of many poses, computed on all cores, in order.
    #[must_use]
    pub fn radiances(&self, directions: &[Directions], tolerance: f64) -> Vec<Estimate> {
        directions
            .par_iter()
            .map(|d| self.radiance(d, tolerance))
            .collect()
    }

    fn third_bounce(&self, i: &Ray, o: &Ray) -> f64 {
        let alpha2 = |lobe: Lobe| [lobe.au2, lobe.av2];
        let valley = third_bounce::Valley {
            sin: self.sin,
            cos: self.cos,
            eta: self.q.eta,
            k: self.q.k,
            first: alpha2(self.lobe(true)),
            last: alpha2(self.lobe(false)),
            between: alpha2(self.lobe(false)),
        };
        let end = |w: &Ray| third_bounce::End {
            u: w.u,
            e: w.e,
            m: w.m,
            tau: w.tau,
        };
        self.q.amplitude.powi(3) * third_bounce::radiance(&valley, &end(i), &end(o))
    }

    fn ray(&self, w: [f64; 3]) -> Ray {
        let (s, c) = (self.sin, self.cos);
        let e = w[1] * c - w[2] * s;
        let m = w[1] * s + w[2] * c;
        let sigma = if m <= 0.0 {
            c
        } else {
            (s * e.max(0.0) / m).min(c)
        };
        let open = if m <= 0.0 {
            0.0
        } else if e > 0.0 {
            (w[2] / m).max(0.0)
        } else {
            c
        };
        let tau = if e >= 0.0 {
            s
        } else {
            (c * (-m).max(0.0) / -e).min(s)
        };
        Ray {
            u: w[0],
            e,
            m,
            sigma,
            open,
            tau,
        }
    }

    /// Returns a wall's transmittance for a direction along the ridges, across them and along the wall's normal.
    fn transmittance(&self, u: f64, across: f64, normal: f64) -> f64 {
        let (s, p) = reflectances(normal, self.q.eta, self.q.k);
        1.0 - 0.5 * (s + p) + self.walls.boundary.excess(u, across, normal)
    }

    fn reflectance(&self, cos: f64) -> f64 {
        let (s, p) = reflectances(cos, self.q.eta, self.q.k);
        0.5 * (s + p)
    }

    fn lobe(&self, widened: bool) -> Lobe {
        let cones = if widened { self.widening } else { 0.0 };
        let au2 = self.q.alpha_u * self.q.alpha_u + cones;
        let av2 = self.q.alpha_v * self.q.alpha_v + cones;
        Lobe {
            au2,
            av2,
            area: PI * (au2 * av2).sqrt(),
        }
    }

    /// Returns the direct reflection off both walls, averaged over the cones of lamp and lens.
    fn one_bounce(&self, i: [f64; 3], o: &Ray) -> f64 {
        let (x, y) = cone::across(&i.into());
        let lobe = self.lobe(false);
        let smith_facet = lobe.smith(o.u, o.e, o.m);
        let smith_riser = lobe.smith(o.u, o.m, -o.e);
        self.cones
            .iter()
            .map(|node| {
                let w = [0, 1, 2].map(|j| i[j] + node.x * x[j] + node.y * y[j]);
                let per_length = 1.0 / (w[0] * w[0] + w[1] * w[1] + w[2] * w[2]).sqrt();
                let w = w.map(|c| c * per_length);
                if w[2] <= 0.0 {
                    return 0.0;
                }
                let i = self.ray(w);
                let (hu, he, hm) = (i.u + o.u, i.e + o.e, i.m + o.m);
                let f = self.reflectance(0.5 * (hu * hu + he * he + hm * hm).sqrt());
                let specular = 0.25 * self.q.amplitude * f;
                let mut sum = 0.0;
                let facet = i.open.min(o.open);
                if i.m > 0.0 && o.m > 0.0 && facet > 0.0 {
                    let g = lobe.smith(i.u, i.e, i.m) * smith_facet;
                    sum += facet * specular * g * lobe.density(hu, he, hm);
                    if self.c_d > 0.0 {
                        sum += facet
                            * self.c_d
                            * self.transmittance(i.u, i.e, i.m)
                            * self.transmittance(o.u, o.e, o.m)
                            * i.m
                            * o.m;
                    }
                }
                let riser = self.sin - i.tau.max(o.tau);
                if i.e < 0.0 && o.e < 0.0 && riser > 0.0 {
                    let g = lobe.smith(i.u, i.m, -i.e) * smith_riser;
                    sum += riser * specular * g * lobe.density(hu, hm, -he);
                    if self.c_d > 0.0 {
                        sum += riser
                            * self.c_d
                            * self.transmittance(i.u, i.m, -i.e)
                            * self.transmittance(o.u, o.m, -o.e)
                            * i.e
                            * o.e;
                    }
                }
                sum * node.weight
            })
            .sum()
    }

    /// Returns L (o·n) and its error for the path to the facet first (direction `a`) and the riser second (direction
    /// `b`).
    fn two_bounces(&self, a: &Ray, b: &Ray, lamp_on_facet: bool, tolerance: f64) -> (f64, f64) {
        let (r, p) = (self.sin, self.cos);
        if a.m <= 0.0 || b.e >= 0.0 || r <= 0.0 || a.sigma >= p || b.tau >= r {
            return (0.0, 0.0);
        }
        // Both cones widen the lobe of the wall that the lamp illuminates.
        let path = Path {
            walls: self,
            a: *a,
            b: *b,
            facet: self.lobe(lamp_on_facet),
            riser: self.lobe(!lamp_on_facet),
            masking: self.lobe(false),
            smith_a: self.lobe(false).smith(a.u, a.e, a.m),
            smith_b: self.lobe(false).smith(b.u, b.m, -b.e),
            diffuse_a: self.c_d * self.transmittance(a.u, a.e, a.m) * a.m,
            diffuse_b: self.c_d * self.transmittance(b.u, b.m, -b.e) * -b.e,
        };
        let low = (a.sigma / r).atan();
        let mut betas = vec![low, FRAC_PI_2, (p / r).atan()];
        let mut gammas = vec![-FRAC_PI_2, FRAC_PI_2];
        // Mirror images of both directions, with the lobes' widths in β and γ.
        let images = [
            ((-a.e).atan2(a.m), -a.u, a.m, path.facet),
            ((-b.e).atan2(b.m), b.u, -b.e, path.riser),
        ];
        for (beta, u, normal, lobe) in images {
            let gamma = u.clamp(-1.0, 1.0).asin();
            let (in_beta, in_gamma) = (2.0 * lobe.av2.sqrt(), 2.0 * normal * lobe.au2.sqrt());
            for k in [-2.5, 0.0, 2.5] {
                betas.push(beta + k * in_beta);
                gammas.push(gamma + k * in_gamma);
            }
        }
        borders(&mut betas, low, FRAC_PI_2);
        borders(&mut gammas, -FRAC_PI_2, FRAC_PI_2);
        path.integrate(&betas, &gammas, tolerance)
    }
}

/// Sorts the edges, keeps those within the range, and drops those too close to their neighbour.
fn borders(edges: &mut Vec<f64>, low: f64, high: f64) {
    edges.retain(|x| (low..=high).contains(x));
    edges.sort_by(f64::total_cmp);
    edges.dedup_by(|b, a| *b - *a < 1e-9);
}
