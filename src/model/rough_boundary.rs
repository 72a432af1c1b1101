//! The transmittance of a rough wall: all light that its facets do not reflect.
//!
//! The slopes that face a beam reflect it, in proportion to their visible area (the visible normals of Heitz 2014).
//! Light that would leave below the wall's mean plane, or that is masked, does not leave. The rest enters:
//!
//! ```text
//! R̃(ω) = ∫ F(ω·m) G₁(ω′) w(m) dm / ∫ w(m) dm,   w = D(m) max(0, ω·m),   ω′ = ω mirrored at m,   T̃ = 1 − R̃
//! ```
//!
//! with Smith's masking G₁, which is 0 below the wall. T̃ and R̃ apply to every entrance, exit and mirror hop of
//! diffuse light, so that energy is conserved: with T averaged over the slopes but the smooth F on mirror hops, a
//! riser at grazing incidence would emit an excess of 1e-3 to 2.5e-3 at α 0.15 to 0.25. Without roughness T̃ − T
//! is zero. It is 4e-4 of the light at α = 0.12 and 30°, 3e-3 at α = 0.3, and grows with the angle, so on a bright body
//! with broad lobes its effect is like a lobe that leans.
//!
//! Slopes follow Beckmann's distribution, or have tails ([`super::slopes`]); R̃ is then interpolated in the tail ι
//! between Beckmann (0) and GGX (1). The quadrature, the tracer and [`super::extended`] use it; call
//! [`RoughBoundary::excess`].
//!
//! *Conditioning.* The sums are over positive terms of the slopes that reflect the beam upwards. They end where it
//! would go below the wall, so sixteen Gauss nodes are exact to 1e-6 for Beckmann's slopes and to 1e-4 for GGX's. The
//! projected area of the wall is known (Smith). T̃ − T is a difference of numbers near 1; its table is exact to 1e-4,
//! and to 1e-3 at cosines below 0.03.

use std::f64::consts::{FRAC_PI_2, PI};

use super::gauss::LEGENDRE_16;
use super::{Optics, fresnel};

/// Steps in the root of the cosine: towards grazing, R̃ varies within a few hundredths of the cosine.
const STEPS: usize = 96;
/// Beckmann's slopes across the plane of incidence in units of α: step, and steps to either side; and the range in
/// the plane.
const BESIDE: (f64, i32) = (0.5, 7);
const REACH: f64 = 3.6;
/// Height of a direction in units of the slopes above which Beckmann's masking differs from 1 by less than 1e-6.
const UNMASKED: f64 = 3.0;

/// A rough dielectric wall, tabulated.
#[derive(Debug, Clone)]
pub struct RoughBoundary {
    /// T̃ − T against the root of the cosine, 0 to 1, for beams along u and along v; empty for a smooth wall.
    tables: [Vec<f64>; 2],
}

impl RoughBoundary {
    /// Tabulates a wall of a roughness along u and v (tangents of slope), the slopes' tail ι (0: Beckmann, 1 and
    /// more: GGX), and a real relative index. A body rarer than its surroundings counts as smooth: its T has a corner
    /// at the critical angle, which a table cannot represent.
    #[must_use]
    pub fn new(alpha_u: f64, alpha_v: f64, tail: f64, eta: f64) -> Self {
        if eta < 1.0 {
            return RoughBoundary::smooth();
        }
        let share = tail.clamp(0.0, 1.0);
        let table = |in_plane: f64, beside: f64| -> Vec<f64> {
            let wall = Wall {
                alpha: [in_plane, beside],
                eta,
            };
            let sent_back = |cos: f64| match share {
                0.0 => wall.beckmann(cos),
                1.0 => wall.ggx(cos),
                _ => (1.0 - share) * wall.beckmann(cos) + share * wall.ggx(cos),
            };
            let cosines = (0..=STEPS).map(|i| (i as f64 / STEPS as f64).powi(2));
            cosines
                .map(|cos| fresnel::reflectance(cos, eta, 0.0) - sent_back(cos))
                .collect()
        };
        let along = table(alpha_u, alpha_v);
        let across = if alpha_u == alpha_v {
            along.clone()
        } else {
            table(alpha_v, alpha_u)
        };
        RoughBoundary {
            tables: [along, across],
        }
    }

    /// A wall that is smooth, or that transmits nothing.
    #[must_use]
    pub fn smooth() -> Self {
        RoughBoundary {
            tables: [Vec::new(), Vec::new()],
        }
    }

    /// Whether there is no correction for roughness.
    #[must_use]
    pub fn is_smooth(&self) -> bool {
        self.tables[0].is_empty()
    }

    /// Returns T̃ − T for a beam: components of a unit vector along u, v and the normal; 0 below the horizon.
    #[must_use]
    pub fn excess(&self, u: f64, v: f64, normal: f64) -> f64 {
        if self.is_smooth() || normal <= 0.0 {
            return 0.0;
        }
        let (u2, v2) = (u * u, v * v);
        // Slopes enter by their variances, so a beam in between gets the mean weighted by the squares.
        let along = if u2 + v2 > 0.0 { u2 / (u2 + v2) } else { 0.5 };
        let [of_u, of_v] = self.excess_and_slope(normal);
        along * of_u.0 + (1.0 - along) * of_v.0
    }

    /// Returns T̃ − T at a cosine with its slope, for beams along u and along v; 0 below the horizon.
    #[must_use]
    pub fn excess_and_slope(&self, cos: f64) -> [(f64, f64); 2] {
        if self.is_smooth() || cos <= 0.0 {
            return [(0.0, 0.0); 2];
        }
        let root = cos.min(1.0).sqrt();
        let at = root * STEPS as f64;
        let i = (at as usize).min(STEPS - 1);
        let part = at - i as f64;
        let per_cos = 0.5 * STEPS as f64 / root;
        [0, 1].map(|k| {
            let (low, high) = (self.tables[k][i], self.tables[k][i + 1]);
            (low + part * (high - low), (high - low) * per_cos)
        })
    }

    /// Returns T̃ of a beam at a cosine, averaged over the azimuths along u and v.
    #[must_use]
    pub fn transmittance(&self, cos: f64, eta: f64) -> f64 {
        let [of_u, of_v] = self.excess_and_slope(cos);
        fresnel::transmittance(cos, eta, 0.0) + 0.5 * (of_u.0 + of_v.0)
    }

    /// Returns T(1) T(cos θl) of a smooth flat piece over T̃(1) T̃(cos θl) of this one. By this factor a body's
    /// diffuse strength is larger, so that its ρd is the reflectance of a flat rough piece at the rig's own angles.
    #[must_use]
    pub fn per_entrance(&self, optics: &Optics) -> f64 {
        if self.is_smooth() {
            return 1.0;
        }
        let ratio = |cos: f64| {
            fresnel::transmittance(cos, optics.eta, 0.0) / self.transmittance(cos, optics.eta)
        };
        ratio(1.0) * ratio(optics.theta_l.cos())
    }
}

/// Slopes (tangents, in the plane of incidence and across it) in units of their α, for beams of one plane of incidence.
#[derive(Clone, Copy)]
struct Wall {
    alpha: [f64; 2],
    eta: f64,
}

impl Wall {
    /// Returns R̃ of a beam at a cosine with Beckmann's slopes.
    fn beckmann(&self, cos: f64) -> f64 {
        let beam = Beam::new(cos);
        let steep = self.alpha[0] * beam.sin;
        let a = cos / steep;
        let met = 0.5 * cos * (1.0 + libm::erf(a)) + 0.5 * steep * (-a * a).exp() / PI.sqrt();
        let masking = |[x, y, z]: [f64; 3]| {
            let a = z / (self.alpha[0] * x).hypot(self.alpha[1] * y);
            if a > UNMASKED {
                return 1.0;
            }
            2.0 / (1.0 + libm::erf(a) + (-a * a).exp() / (a * PI.sqrt()))
        };
        let mut sum = 0.0;
        for j in 0..=BESIDE.1 {
            let y = BESIDE.0 * f64::from(j);
            // Both signs of y give the same.
            let sides = if j == 0 { 1.0 } else { 2.0 };
            let across = self.alpha[1] * y;
            let most = (beam.last(across) / self.alpha[0]).min(REACH);
            let row = gauss(-REACH, most, |x| {
                (-x * x).exp() * self.sent_back(&beam, self.alpha[0] * x, across, masking)
            });
            sum += sides * BESIDE.0 * (-y * y).exp() * row;
        }
        sum / PI / met
    }

    /// Returns R̃ with GGX's slopes; x = √(1 + y²) tan φ and y = tan ψ make their tails finite.
    fn ggx(&self, cos: f64) -> f64 {
        let beam = Beam::new(cos);
        let met = 0.5 * (cos + cos.hypot(self.alpha[0] * beam.sin));
        let masking = |[x, y, z]: [f64; 3]| {
            let steep = (self.alpha[0] * x).hypot(self.alpha[1] * y) / z;
            2.0 / (1.0 + 1.0f64.hypot(steep))
        };
        let sum = gauss(0.0, FRAC_PI_2, |psi| {
            let across = self.alpha[1] * psi.tan();
            let secant = 1.0 / psi.cos();
            let most = (beam.last(across) / (self.alpha[0] * secant)).atan();
            let row = gauss(-FRAC_PI_2, most, |phi| {
                let along = self.alpha[0] * secant * phi.tan();
                phi.cos().powi(2) * self.sent_back(&beam, along, across, masking)
            });
            2.0 * psi.cos() * row
        });
        sum / PI / met
    }

    /// Returns (ω·m) F G₁(ω′) of a slope, with ω·m times the length of its normal; 0 if ω′ does not leave.
    fn sent_back(&self, beam: &Beam, x: f64, y: f64, masking: impl Fn([f64; 3]) -> f64) -> f64 {
        let facing = beam.cos - x * beam.sin;
        let per_length2 = 1.0 / (1.0 + x * x + y * y);
        // ω′ = 2 (ω·m) m − ω.
        let twice = 2.0 * facing * per_length2;
        let out = [-twice * x - beam.sin, -twice * y, twice - beam.cos];
        if facing <= 0.0 || out[2] <= 0.0 {
            return 0.0;
        }
        let f = fresnel::reflectance((facing * per_length2.sqrt()).min(1.0), self.eta, 0.0);
        facing * f * masking(out)
    }
}

/// A beam by its angle to the mean normal.
struct Beam {
    sin: f64,
    cos: f64,
}

impl Beam {
    fn new(cos: f64) -> Self {
        let sin = ((1.0 - cos) * (1.0 + cos)).max(0.0).sqrt();
        Beam { sin, cos }
    }

    /// Returns the slope in the plane of incidence above which a normal of this slope across it reflects the beam
    /// below the wall; −∞ if no slope reflects it upwards.
    fn last(&self, across: f64) -> f64 {
        let flat = 1.0 - across * across;
        let square = self.sin * self.sin + self.cos * self.cos * flat;
        if square <= 0.0 {
            return f64::NEG_INFINITY;
        }
        self.cos * flat / (self.sin + square.sqrt())
    }
}

/// Integrates f from `low` to `high` with sixteen nodes; 0 if the range is empty.
fn gauss(low: f64, high: f64, f: impl Fn(f64) -> f64) -> f64 {
    if high <= low {
        return 0.0;
    }
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
    let pair =
        |(node, weight): &(f64, f64)| weight * (f(middle + half * node) + f(middle - half * node));
    half * LEGENDRE_16.iter().map(pair).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wall_without_roughness_is_smooth_and_a_beam_from_below_is_not_corrected() {
        let fine = RoughBoundary::new(1e-4, 1e-4, 0.0, 1.5);
        for cos in [1.0, 0.8, 0.3] {
            let sin = f64::sqrt(1.0 - cos * cos);
            assert!(fine.excess(sin, 0.0, cos).abs() < 1e-6);
        }
        assert_eq!(RoughBoundary::smooth().excess(0.6, 0.0, 0.8), 0.0);
        assert_eq!(fine.excess(1.0, 0.0, -0.1), 0.0);
    }

    #[test]
    fn the_reflectance_of_a_wall_agrees_with_a_finer_independent_integral() {
        let rows = crate::model::extended::reference("wall_albedo");
        assert_eq!(rows.len(), 30);
        let mut worst: f64 = 0.0;
        for row in rows {
            let tail = if row.gamma.is_finite() { 1.0 } else { 0.0 };
            let wall = RoughBoundary::new(row.alpha_u, row.alpha_v, tail, row.index);
            let [u, v, n] = row.i;
            let found = 1.0 - fresnel::transmittance(n, row.index, 0.0) - wall.excess(u, v, n);
            worst = worst.max((found - row.value).abs());
            let allowed = if tail > 0.0 || n < 0.3 { 2e-4 } else { 1e-4 };
            assert!((found - row.value).abs() < allowed, "{row:?}: {found}");
        }
        assert!(worst > 0.0);
    }
}
