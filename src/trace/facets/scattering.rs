//! Scattering by a facet that is not a smooth mirror: sub-facet roughness and diffuse light from
//! below.
//!
//! [`Roughness`] is a Smith surface with Beckmann slopes, on which light takes the random walk of
//! Heitz et al. 2016 ("Multiple-scattering microfacet BSDFs with the Smith model"): the height of
//! the next interaction is drawn, then the normal from the visible ones, until the light leaves.
//! Energy is conserved, and all orders of scattering are included.
//!
//! *Conditioning.* With a = ω_z/|(αu ω_x, αv ω_y)|, Λ is the difference of two terms that leaves
//! 1/(2a²): it loses 2a² roundings, a thousand of them where Λ has fallen to 1e-160, and is 0
//! beyond, where light certainly leaves. `hypot` keeps the denominator from under- and overflow at
//! any α. Towards the horizon (a → 0) Λ grows without bound, and the next interaction is at the
//! light's own position.
//!
//! [`DiffuseBody`] is a Lambert body under the Fresnel boundary: light that enters leaves unpolarised
//! in all directions, weighted by the boundary's transmittance.

use crate::model::fresnel;
use crate::model::rough_boundary::RoughBoundary;
use crate::trace::rng::RandomStream;
use crate::trace::vec3::V3;

/// Beckmann roughness below the relief, in the facet's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Roughness {
    /// α along u (tangent of slope).
    pub alpha_u: f64,
    /// α across.
    pub alpha_v: f64,
}

impl Roughness {
    /// Scales all slopes by a factor.
    #[must_use]
    pub fn times(&self, factor: f64) -> Self {
        Roughness {
            alpha_u: factor * self.alpha_u,
            alpha_v: factor * self.alpha_v,
        }
    }

    /// Smith's Λ for a direction in the facet's frame (z: outwards); below −1 for directions into
    /// the surface.
    #[must_use]
    pub fn lambda(&self, w: &V3) -> f64 {
        let spread = (self.alpha_u * w[0]).hypot(self.alpha_v * w[1]);
        if spread < 1e-12 * w[2].abs() {
            return if w[2] > 0.0 { 0.0 } else { -1.0 };
        }
        let a = w[2] / spread;
        0.5 * ((-a * a).exp() / (a * std::f64::consts::PI.sqrt()) - libm::erfc(a))
    }

    /// Draws a normal (unit, in the facet's frame) from those that a ray along `k` meets: density ∝
    /// D(m) max(0, −k·m). Rays from below are allowed.
    pub fn visible_normal(&self, k: &V3, random: &mut RandomStream) -> V3 {
        // In slopes scaled to the Gaussian density exp(−x² − y²)/π, the weight is linear in the
        // slope along the ray: (−k_z + k_h a)⁺ with the slope a along k's horizontal part.
        let (hu, hv) = (self.alpha_u * k[0], self.alpha_v * k[1]);
        let horizontal = hu.hypot(hv);
        let (c, s) = (-k[2], horizontal);
        let (du, dv) = if horizontal > 0.0 {
            (hu / horizontal, hv / horizontal)
        } else {
            (1.0, 0.0)
        };
        let c_weight = c * std::f64::consts::PI.sqrt();
        let a = loop {
            if c < 0.0 {
                // Upward light meets only slopes beyond t = |c|/s: proposal ∝ a exp(−a²) there.
                let t = -c / s;
                let a = (t * t - (1.0 - random.uniform()).ln()).sqrt();
                if random.uniform() * a < a - t {
                    break a;
                }
                continue;
            }
            // Proposal ∝ exp(−a²) (c + s |a|).
            let a = if random.uniform() * (c_weight + s) < c_weight {
                gauss(random).0
            } else {
                let r = (-(1.0 - random.uniform()).ln()).sqrt();
                if random.bits() & 1 == 0 { r } else { -r }
            };
            if random.uniform() * (c + s * a.abs()) < c + s * a {
                break a;
            }
        };
        let b = gauss(random).0;
        // The normal of slope (p, q) is (−p, −q, 1); `a` is the slope towards the ray.
        let (x, y) = (-(a * du - b * dv), -(a * dv + b * du));
        crate::trace::vec3::unit(&[self.alpha_u * x, self.alpha_v * y, 1.0])
    }

    /// Height (as its cumulative probability, 1 at the top) of the next interaction of light at
    /// `height` that moves along `w`; `None` if it leaves.
    pub fn next_height(&self, w: &V3, height: f64, random: &mut RandomStream) -> Option<f64> {
        let u = random.uniform();
        let lambda = self.lambda(w);
        if w[2] > 0.0 {
            // Leaves with probability G1 = height^Λ.
            if lambda == 0.0 || 1.0 - u <= height.powf(lambda) {
                return None;
            }
        }
        Some(height / u_power(1.0 - u, 1.0 / lambda))
    }

    /// Beckmann density of normals in the facet's frame, per solid angle; m unit.
    #[must_use]
    pub fn density(&self, m: &V3) -> f64 {
        if m[2] <= 0.0 {
            return 0.0;
        }
        let (x, y) = (m[0] / (self.alpha_u * m[2]), m[1] / (self.alpha_v * m[2]));
        (-x * x - y * y).exp() / (std::f64::consts::PI * self.alpha_u * self.alpha_v * m[2].powi(4))
    }
}

#[inline]
fn u_power(u: f64, exponent: f64) -> f64 {
    (u.max(f64::MIN_POSITIVE).ln() * exponent).exp()
}

/// Two independent numbers of density exp(−x²)/√π.
fn gauss(random: &mut RandomStream) -> (f64, f64) {
    let r = (-(1.0 - random.uniform()).ln()).sqrt();
    let (s, c) = (std::f64::consts::TAU * random.uniform()).sin_cos();
    (r * c, r * s)
}

/// A Lambert body under a Fresnel boundary.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DiffuseBody {
    /// π c_d: the fraction of the light entered that leaves, per unit of the outer transmittance
    /// T(o).
    pub strength: f64,
    /// Cosines of the angles of incidence and exit at which a flat piece matches a Lambertian.
    pub cosines: [f64; 2],
    /// Fraction τ of its light that leaves uniformly over the ridges, 0 to 1; the rest leaves where
    /// it entered.
    pub translucency: f64,
}

impl DiffuseBody {
    /// Makes a body whose flat piece matches a Lambertian of reflectance `rho_d` at the angles of
    /// incidence and exit with cosines `cos_i`, `cos_o` (index `n` under the medium above).
    #[must_use]
    pub fn new(rho_d: f64, n: f64, cos_i: f64, cos_o: f64) -> Self {
        let t = |cos| fresnel::transmittance(cos, n, 0.0);
        DiffuseBody {
            strength: rho_d / (t(cos_i) * t(cos_o)),
            cosines: [cos_i, cos_o],
            translucency: 0.0,
        }
    }

    /// Returns the body with a fraction of its light that leaves uniformly.
    #[must_use]
    pub fn with_translucency(self, translucency: f64) -> Self {
        DiffuseBody {
            translucency,
            ..self
        }
    }

    /// Returns the body under a rough boundary with the same appearance.
    #[must_use]
    pub fn under(self, boundary: &RoughBoundary, n: f64) -> Self {
        let ratio = |cos: f64| fresnel::transmittance(cos, n, 0.0) / boundary.transmittance(cos, n);
        let [first, second] = self.cosines.map(ratio);
        DiffuseBody {
            strength: self.strength * first * second,
            ..self
        }
    }

    /// Draws a direction of exit with density cos/π in the facet's frame.
    pub fn direction(random: &mut RandomStream) -> V3 {
        let (r2, phi) = (random.uniform(), std::f64::consts::TAU * random.uniform());
        let (s, c) = phi.sin_cos();
        let r = r2.sqrt();
        [r * c, r * s, (1.0 - r2).sqrt()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::rng::Purpose;
    use crate::trace::vec3::{dot, unit};

    #[test]
    fn visible_normals_have_the_projected_area_of_smith_s_surface() {
        // E[1/(−k·m)] under the visible density is 1/projected area = 1/(cos (1 + Λ)) times ∫D =
        // the mean of D over normals facing the ray; check the mean of m_z/(−k·m) =
        // P(facing)/(area).
        let rough = Roughness {
            alpha_u: 0.5,
            alpha_v: 0.2,
        };
        let mut random = RandomStream::new(1, Purpose::Photon, 0);
        for k in [
            [0.3, 0.5, -0.8],
            [0.9, 0.1, -0.2],
            [0.0, 0.0, -1.0],
            [0.5, 0.2, 0.6],
        ] {
            let k = unit(&k);
            let w = k.map(|x| -x);
            let n = 200_000;
            let (mut sum, mut square) = (0.0, 0.0);
            for _ in 0..n {
                let m = rough.visible_normal(&k, &mut random);
                assert!(dot(&m, &w) >= 0.0);
                // A bounded function of the normal with known expectation: m_z > 0 slopes.
                let f = (w[2] + 1.5).min(dot(&m, &w) / m[2]).recip().min(5.0);
                sum += f;
                square += f * f;
            }
            // The same by direct sampling of all normals, weighted by the projected area.
            let (mut top, mut bottom, mut top2) = (0.0, 0.0, 0.0);
            for _ in 0..n {
                let (x, y) = gauss(&mut random);
                let facing = (w[2] - rough.alpha_u * x * w[0] - rough.alpha_v * y * w[1]).max(0.0);
                if facing == 0.0 {
                    continue;
                }
                let f = (w[2] + 1.5).min(facing).recip().min(5.0);
                top += facing * f;
                top2 += (facing * f).powi(2);
                bottom += facing;
            }
            let n = f64::from(n);
            let mean = sum / n;
            let sigma = ((square / n - mean * mean) / n).sqrt()
                + ((top2 / n).sqrt() / n.sqrt()) / (bottom / n);
            assert!(
                (mean - top / bottom).abs() < 4.0 * sigma,
                "{mean} {}",
                top / bottom
            );
            // Projected area: cos (1 + Λ).
            let area = bottom / n;
            let expected = w[2] * (1.0 + rough.lambda(&w));
            assert!(
                (area - expected).abs() < 0.01 * area.max(0.1),
                "{area} {expected}"
            );
        }
    }

    #[test]
    fn lambda_of_opposite_directions_sums_to_minus_one() {
        let rough = Roughness {
            alpha_u: 0.3,
            alpha_v: 0.6,
        };
        let w = unit(&[0.7, -0.3, 0.4]);
        let sum = rough.lambda(&w) + rough.lambda(&w.map(|x| -x));
        assert!((sum + 1.0).abs() < 1e-14);
    }

    #[test]
    fn a_rough_boundary_transmits_what_its_visible_normals_do_not_reflect() {
        let (alpha, eta) = (0.3, 1.54);
        let rough = Roughness {
            alpha_u: alpha,
            alpha_v: alpha,
        };
        let table = RoughBoundary::new(alpha, alpha, 0.0, eta);
        let mut random = RandomStream::new(5, Purpose::Photon, 0);
        for angle_deg in [0.0, 30.0, 50.0, 70.0] {
            let (sin, cos) = f64::to_radians(angle_deg).sin_cos();
            let n = 100_000;
            let (mut sum, mut square) = (0.0, 0.0);
            for _ in 0..n {
                let m = rough.visible_normal(&[-sin, 0.0, -cos], &mut random);
                let facing = m[0] * sin + m[2] * cos;
                let out = [
                    2.0 * facing * m[0] - sin,
                    2.0 * facing * m[1],
                    2.0 * facing * m[2] - cos,
                ];
                let leaves = if out[2] > 0.0 {
                    1.0 / (1.0 + rough.lambda(&out))
                } else {
                    0.0
                };
                let mirrored = leaves * fresnel::reflectance(facing.min(1.0), eta, 0.0);
                sum += mirrored;
                square += mirrored * mirrored;
            }
            let mean = sum / f64::from(n);
            let std = ((square / f64::from(n) - mean * mean) / f64::from(n)).sqrt();
            let expected = fresnel::transmittance(cos, eta, 0.0) + table.excess(sin, 0.0, cos);
            // In addition to the noise, the table's steps and Smith's rational form.
            let allowed = 4.0 * std + 2e-4;
            assert!(
                (1.0 - mean - expected).abs() < allowed,
                "{angle_deg}: {mean} {expected}"
            );
        }
    }
}
