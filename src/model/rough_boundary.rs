//! What passes a boundary that is rough: Fresnel's transmittance averaged over the slopes that a beam meets.
//!
//! The closed form lets light into a facet, and out again, by the transmittance T of a smooth one. Under Beckmann slopes
//! a beam meets some steeper and some flatter, the ones that face it more often (the visible normals of Heitz 2014):
//!
//! ```text
//! T̄(ω) = 1 − ∫ F(ω·m) w(m) dm / ∫ w(m) dm,   w = D(m) max(0, ω·m)
//! ```
//!
//! What a slope mirrors is not looked after: where it meets a second slope most of it enters there, which Smith's masking
//! counts as lost in the lobe too. Mitsuba's `roughplastic` has the same T̄. T̄ − T is 4e-4 of the light at α = 0.12 and 30°, 3e-3 at
//! α = 0.3, and it grows with the angle, so on a bright body with broad lobes it looks like a lobe that leans: 0.3° of
//! ridge angle at α = 0.3 and ρd = 0.7. The quadrature and the tracer have it; call [`RoughBoundary::excess`].
//!
//! *Conditioning.* Sums of positive terms on an even lattice of slopes, which for a bell curve is as good as any rule; T̄ − T is
//! a difference of numbers near 1, good to 1e-15 of them and 1e-9 of what it is used for.

use super::fresnel;

/// Steps in the cosine.
const STEPS: usize = 64;
/// Slopes of the sum in units of α, in the plane of incidence and across it: step, and steps to either side.
const IN_PLANE: (f64, i32) = (0.3, 12);
const BESIDE: (f64, i32) = (0.5, 7);

/// A rough dielectric boundary, tabulated.
#[derive(Debug, Clone)]
pub struct RoughBoundary {
    /// T̄ − T against the cosine, 0 to 1, for beams along u and along v; empty for a boundary that is none.
    tables: [Vec<f64>; 2],
}

impl RoughBoundary {
    /// Roughness along u and v (tangents of slope), real relative index. A body rarer than what surrounds it counts as
    /// smooth: its T has a corner at the critical angle, which no table holds.
    #[must_use]
    pub fn new(alpha_u: f64, alpha_v: f64, eta: f64) -> Self {
        if eta < 1.0 {
            return RoughBoundary::smooth();
        }
        let table = |in_plane: f64, beside: f64| -> Vec<f64> {
            (0..=STEPS)
                .map(|i| {
                    let cos = i as f64 / STEPS as f64;
                    transmittance(cos, in_plane, beside, eta)
                        - fresnel::transmittance(cos, eta, 0.0)
                })
                .collect()
        };
        RoughBoundary {
            tables: [table(alpha_u, alpha_v), table(alpha_v, alpha_u)],
        }
    }

    /// A boundary that lets nothing in, or that is smooth.
    #[must_use]
    pub fn smooth() -> Self {
        RoughBoundary {
            tables: [Vec::new(), Vec::new()],
        }
    }

    /// T̄ − T for a beam: components along u, v and the normal, a unit vector; 0 below the horizon.
    #[must_use]
    pub fn excess(&self, u: f64, v: f64, normal: f64) -> f64 {
        if self.tables[0].is_empty() || normal <= 0.0 {
            return 0.0;
        }
        let at = normal.min(1.0) * STEPS as f64;
        let i = (at as usize).min(STEPS - 1);
        let part = at - i as f64;
        let of = |table: &[f64]| table[i] + part * (table[i + 1] - table[i]);
        let (u2, v2) = (u * u, v * v);
        // Slopes come in by their variances, so a beam in between has the mean by the squares.
        let along = if u2 + v2 > 0.0 { u2 / (u2 + v2) } else { 0.5 };
        along * of(&self.tables[0]) + (1.0 - along) * of(&self.tables[1])
    }
}

/// T̄ of a beam by the roughness in its plane of incidence and across that.
fn transmittance(cos: f64, in_plane: f64, beside: f64, eta: f64) -> f64 {
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    let (mut mirrored, mut met) = (0.0, 0.0);
    for i in -IN_PLANE.1..=IN_PLANE.1 {
        let x = IN_PLANE.0 * f64::from(i);
        let weight_x = (-x * x).exp();
        let x = in_plane * x;
        // ω·m times the length of the normal (−x, −y, 1): it does not depend on y.
        let facing = cos - x * sin;
        if facing <= 0.0 {
            continue;
        }
        for j in 0..=BESIDE.1 {
            let y = BESIDE.0 * f64::from(j);
            // Both signs of y give the same.
            let sides = if j == 0 { 1.0 } else { 2.0 };
            let weight = sides * weight_x * (-y * y).exp() * facing;
            let y = beside * y;
            let length2 = 1.0 + x * x + y * y;
            let f = fresnel::reflectance((facing / length2.sqrt()).min(1.0), eta, 0.0);
            mirrored += weight * f;
            met += weight;
        }
    }
    if met > 0.0 { 1.0 - mirrored / met } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_boundary_with_no_roughness_is_smooth_and_a_normal_beam_is_left_alone() {
        let fine = RoughBoundary::new(1e-4, 1e-4, 1.5);
        for cos in [1.0, 0.8, 0.3] {
            let sin = f64::sqrt(1.0 - cos * cos);
            assert!(fine.excess(sin, 0.0, cos).abs() < 1e-6);
        }
        assert_eq!(RoughBoundary::smooth().excess(0.6, 0.0, 0.8), 0.0);
        assert_eq!(fine.excess(1.0, 0.0, -0.1), 0.0);
    }

    #[test]
    fn slopes_in_the_plane_of_incidence_count_by_the_second_derivative_of_what_they_meet() {
        // To second order T̄ − T = α∥²/4 ∂²/∂x² [T (1 − x tan θ)] + α⊥²/4 ∂²/∂y² [T], taken by differences.
        let (eta, alpha, cos) = (1.54, [0.05, 0.09], 0.75_f64);
        let sin = (1.0 - cos * cos).sqrt();
        let weighed = |x: f64, y: f64| {
            let facing = cos - x * sin;
            let length = (1.0 + x * x + y * y).sqrt();
            fresnel::transmittance(facing / length, eta, 0.0) * facing / cos
        };
        let h = 1e-3;
        let second = |f: &dyn Fn(f64) -> f64| (f(h) - 2.0 * f(0.0) + f(-h)) / (h * h);
        let by_x = second(&|x| weighed(x, 0.0));
        let by_y = second(&|y| weighed(0.0, y));
        let rough = RoughBoundary::new(alpha[0], alpha[1], eta);
        for (u, v, [a, b]) in [(sin, 0.0, alpha), (0.0, sin, [alpha[1], alpha[0]])] {
            let expected = 0.25 * (a * a * by_x + b * b * by_y);
            let found = rough.excess(u, v, cos);
            assert!(
                (found - expected).abs() < 0.05 * expected.abs(),
                "{found} {expected}"
            );
        }
    }
}
