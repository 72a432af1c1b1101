//! Facets whose slopes have tails: Student's t as a mixture of Beckmann slopes of all scales.
//!
//! With g of the gamma distribution of shape 1/ι and scale 1, Beckmann slopes of roughness α λ, λ²
//! = 1/(g ι), are Student's t slopes with the tail ι ([`crate::model::extended::slopes`]). A
//! visible normal is therefore a Beckmann one after the scale has been drawn in proportion to the
//! area that the ray meets. Smith's Λ is interpolated in ι between Beckmann and GGX, as for the
//! walls of the closed form.
//!
//! *Conditioning.* Scales are drawn by ratios of positive numbers; without a tail only
//! [`Roughness`] is used.

use rand_distr::{Distribution, Gamma};

use super::scattering::Roughness;
use crate::trace::rng::RandomStream;
use crate::trace::vec3::V3;

/// Roughness with a tail.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tailed {
    /// The scale of the slopes.
    pub roughness: Roughness,
    /// ι, 0 to 1.5; 0 is Beckmann.
    pub tail: f64,
}

/// Draws after which a scale of 1 is used; a ray normally accepts one within a few.
const DRAWS_MAX: u32 = 1000;

impl Tailed {
    /// Density of normals, per solid angle; m unit, in the facet's frame.
    #[must_use]
    pub fn density(&self, m: &V3) -> f64 {
        if self.tail == 0.0 {
            return self.roughness.density(m);
        }
        if m[2] <= 0.0 {
            return 0.0;
        }
        let Roughness { alpha_u, alpha_v } = self.roughness;
        let (x, y) = (m[0] / (alpha_u * m[2]), m[1] / (alpha_v * m[2]));
        let q = x * x + y * y;
        let power = -(1.0 + 1.0 / self.tail) * (self.tail * q).ln_1p();
        power.exp() / (std::f64::consts::PI * alpha_u * alpha_v * m[2].powi(4))
    }

    /// Smith's G₁ of a direction above the facet.
    #[must_use]
    pub fn seen(&self, w: &V3) -> f64 {
        let beckmann = self.roughness.lambda(w);
        if self.tail == 0.0 {
            return 1.0 / (1.0 + beckmann);
        }
        let spread = (self.roughness.alpha_u * w[0]).hypot(self.roughness.alpha_v * w[1]);
        let ggx = 0.5 * (1.0f64.hypot(spread / w[2]) - 1.0);
        let share = self.tail.min(1.0);
        1.0 / (1.0 + (1.0 - share) * beckmann + share * ggx)
    }

    /// Draws a normal from those that a ray along `k` meets on the facet.
    pub fn visible_normal(&self, k: &V3, random: &mut RandomStream) -> V3 {
        self.roughness
            .times(self.scale(k, random))
            .visible_normal(k, random)
    }

    /// Draws a scale of the slopes in proportion to the area that the ray meets.
    fn scale(&self, k: &V3, random: &mut RandomStream) -> f64 {
        let shape = 1.0 / self.tail;
        let (Ok(plain), Ok(wide)) = (Gamma::new(shape, 1.0), Gamma::new(shape - 0.5, 1.0)) else {
            return 1.0;
        };
        let steep = (self.roughness.alpha_u * k[0]).hypot(self.roughness.alpha_v * k[1]);
        let cos = (-k[2]).max(0.0);
        // The projected area of slopes of scale λ is at most cos + λ s/(2√π); the mean of λ is ι^−½
        // Γ(1/ι − ½)/Γ(1/ι).
        let per_scale = 0.5 * steep / std::f64::consts::PI.sqrt();
        let mean = (libm::lgamma(shape - 0.5) - libm::lgamma(shape)).exp() / self.tail.sqrt();
        let of_wide = per_scale * mean / (cos + per_scale * mean);
        let down = k.map(|x| -x);
        for _ in 0..DRAWS_MAX {
            let g: f64 = if random.uniform() < of_wide {
                wide.sample(random)
            } else {
                plain.sample(random)
            };
            let scale = 1.0 / (g * self.tail).sqrt();
            let met = cos * (1.0 + self.roughness.times(scale).lambda(&down));
            if met.is_finite() && random.uniform() * (cos + scale * per_scale) < met {
                return scale;
            }
        }
        1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::rng::Purpose;
    use crate::trace::vec3::unit;

    #[test]
    fn visible_normals_follow_the_density() {
        // The mean of a bounded function over visible normals equals that over all slopes, weighted
        // by their projected area.
        let rough = Roughness {
            alpha_u: 0.3,
            alpha_v: 0.15,
        };
        for tail in [0.3, 1.0, 1.4] {
            let slopes = Tailed {
                roughness: rough,
                tail,
            };
            for k in [[0.4, 0.3, -0.8], [0.8, 0.2, -0.4]] {
                let k = unit(&k);
                let mut random = RandomStream::new(3, Purpose::Photon, 0);
                let f = |m: &V3| m[2] * m[2];
                let n = 40_000;
                let (mut sum, mut square) = (0.0, 0.0);
                for _ in 0..n {
                    let value = f(&slopes.visible_normal(&k, &mut random));
                    sum += value;
                    square += value * value;
                }
                let mean = sum / f64::from(n);
                let std = ((square / f64::from(n) - mean * mean) / f64::from(n)).sqrt();
                // Rings of equal probability: 1 − (1 + ι q)^(−1/ι) = share.
                let (mut top, mut bottom) = (0.0, 0.0);
                for i in 0..600 {
                    let s = (f64::from(i) + 0.5) / 600.0;
                    // Uniform in (1 − s)³ towards the tail.
                    let left = (1.0 - s).powi(3);
                    let radius = ((left.powf(-tail) - 1.0) / tail).sqrt();
                    for j in 0..60 {
                        let (sin, cos) =
                            (std::f64::consts::TAU * (f64::from(j) + 0.5) / 60.0).sin_cos();
                        let m = unit(&[
                            -rough.alpha_u * radius * cos,
                            -rough.alpha_v * radius * sin,
                            1.0,
                        ]);
                        let facing = -(m[0] * k[0] + m[1] * k[1] + m[2] * k[2]) / m[2];
                        if facing > 0.0 {
                            let weight = facing * (1.0 - s).powi(2);
                            top += weight * f(&m);
                            bottom += weight;
                        }
                    }
                }
                let expected = top / bottom;
                assert!(
                    (mean - expected).abs() < 4.0 * std + 1e-3,
                    "{tail} {k:?}: {mean} {expected} {std}"
                );
            }
        }
    }

    #[test]
    fn without_a_tail_they_are_beckmanns() {
        let rough = Roughness {
            alpha_u: 0.3,
            alpha_v: 0.15,
        };
        let thin = Tailed {
            roughness: rough,
            tail: 1e-6,
        };
        let m = unit(&[0.2, -0.1, 1.0]);
        assert!((thin.density(&m) / rough.density(&m) - 1.0).abs() < 1e-4);
        assert!((thin.seen(&m) - 1.0 / (1.0 + rough.lambda(&m))).abs() < 1e-5);
    }
}
