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
//! Here are the geometric part, [`visible_and_lit_fraction`], and what the terms need of the boundary. The terms are in
//! [`super::extended`] for any number, and in `super::form` with their derivatives for registers. Kinks (min, max, clip) have the
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

use super::dual::Dual;
use super::number::Number as _;

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

/// Returns T̄ = ∫₀¹ 2 μ T(μ) dμ, the transmittance of a smooth boundary for diffuse light, with ∂/∂η and ∂/∂k.
///
/// Gauss–Legendre in panels that shrink towards grazing, where T falls steeply if the index is near 1. Below index 1
/// (k = 0) the integral starts at the critical angle; g² = η² − 1 + μ² as the variable makes it smooth there.
#[must_use]
pub fn diffuse_transmittance(eta: f64, k: f64) -> Dual<2> {
    let (eta, k) = (Dual::variable(eta, 0), Dual::variable(k, 1));
    let one = eta.like(1.0);
    let passed = |mu: Dual<2>| {
        let (r_s, r_p) = mu.mirrored(eta, k);
        one - (r_s + r_p).times(0.5)
    };
    let mut sum = eta.like(0.0);
    let total = k.value == 0.0 && eta.value < 1.0;
    let coarse = [0.0, 1.0 / 256.0, 1.0 / 64.0, 1.0 / 16.0, 1.0 / 4.0, 1.0];
    // For a step of the index so small that T falls within the first panel, at μ of the order of its root.
    let dip = (eta.value - 1.0).abs().sqrt();
    let panels: Vec<f64> = if k.value == 0.0 && dip > 0.0 && dip < coarse[1] / 16.0 {
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
                    let g = eta.times(t);
                    let mu = (g * g + one - eta * eta).root();
                    passed(mu) * g * eta
                } else {
                    let mu = one.like(t);
                    passed(mu) * mu
                };
                sum = sum + term.times(2.0 * w);
            }
        }
    }
    sum
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
