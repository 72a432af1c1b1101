//! The BRDF as printed (Luongo et al. 2017, Eqs. 1–6), with masking measured to the pitch normal.
//!
//! ```text
//! f = G D / (4 |ω_i·n| |ω_o·n|) · [ F(ω_i, h) + (ρd/π) (1 − F)² ],   h ∝ ω_i + ω_o
//! ```
//!
//! *Conditioning.* G1 = 1 − |tan θr tan θp| cancels towards the horizon on the side that the facets lean to, while
//! there G1/(ω·n) = 1/(cos θr ω_m) exactly. On the other side G1 vanishes at the edge of visibility, and its digits
//! there are those of the distance from the edge (its condition number, no more). The exponent is a square over h_m²;
//! the only subtraction is inside h_e.

use std::f64::consts::{FRAC_1_PI, PI};

use super::extended::Parameters;
use super::number::Number;

/// Returns G1(ω) = χ+(ω_p·m) [1 − min(1, |tan θr tan θp|)] (Eq. 2), divided by ω·n if `over_cos`. On the side that the
/// facets lean to, G1/(ω·n) = 1/(cos θr ω_m), without cancellation or a division by zero at grazing.
fn masking<N: Number>(w: [N; 3], sin: N, cos: N, over_cos: bool) -> N {
    let (zero, one) = (sin.like(0.0), sin.like(1.0));
    let e = w[1] * cos - w[2] * sin;
    let m = w[1] * sin + w[2] * cos;
    let up = zero.below(m);
    let along = cos * N::choose(up, m, one);
    let open = (one + sin * e / along).positive();
    let (leaning, facing) = if over_cos {
        (one / along, open / w[2])
    } else {
        (w[2] / along, open)
    };
    let leans = zero.below(e * sin);
    N::choose(up, N::choose(leans, leaning, facing), zero)
}

/// Returns L = f cos θi towards `o` for irradiance 1 on a surface that faces the light at `i`, times the amplitude; the
/// roughness is widened by the cones of lamp and lens (α² + `widening`). Both directions are above the surface.
pub fn radiance_of<N: Number>(i: [N; 3], o: [N; 3], q: &Parameters<N>, widening: f64) -> N {
    let (sin, cos) = q.theta_r.sine_cosine();
    let (zero, one) = (sin.like(0.0), sin.like(1.0));
    let g = masking(i, sin, cos, false) * masking(o, sin, cos, true);
    let h = [i[0] + o[0], i[1] + o[1], i[2] + o[2]];
    let h_m = h[1] * sin + h[2] * cos;
    let facing = zero.below(h_m);
    let h_e = h[1] * cos - h[2] * sin;
    let h2 = h[0] * h[0] + h[1] * h[1] + h[2] * h[2];
    let au2 = q.alpha_u * q.alpha_u + one.like(widening);
    let av2 = q.alpha_v * q.alpha_v + one.like(widening);
    let m2 = N::choose(facing, h_m * h_m, one);
    let cos2 = m2 / h2;
    let exponent = (h[0] * h[0] / au2 + h_e * h_e / av2) / m2;
    let d = (-exponent).exponential() / ((au2 * av2).root() * cos2 * cos2).times(PI);
    let (r_s, r_p) = h2.root().times(0.5).mirrored(q.eta, q.k);
    let f = (r_s + r_p).times(0.5);
    let t = one - f;
    let radiance = q.amplitude * g * d * (f + (q.rho_d * t * t).times(FRAC_1_PI)).times(0.25);
    N::choose(zero.below(g), N::choose(facing, radiance, zero), zero)
}

/// The angle in the printed G.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reading {
    /// θp to the pitch normal m (Fig. 4, Appendix A); this program uses it.
    Pitch,
    /// θp to the half vector, Eq. 4 taken literally.
    Half,
    /// The authors' public renderer: θp to the half vector, and the angle between n and the half vector in place of θr.
    Code,
}

/// Returns G(ω_i, ω_o) in one of its three readings; unit vectors along u, v, n above the surface.
///
/// Only [`Reading::Pitch`] is a property of the surface; the other two serve for comparison.
#[must_use]
pub fn shadowing_and_masking(reading: Reading, i: [f64; 3], o: [f64; 3], theta_r: f64) -> f64 {
    let (sin, cos) = theta_r.sin_cos();
    if reading == Reading::Pitch {
        return masking(i, sin, cos, false) * masking(o, sin, cos, false);
    }
    let sum = [i[0] + o[0], i[1] + o[1], i[2] + o[2]];
    let length = (sum[0] * sum[0] + sum[1] * sum[1] + sum[2] * sum[2]).sqrt();
    let h = sum.map(|x| x / length);
    let ridge_tan = match reading {
        Reading::Code => h[0].hypot(h[1]) / h[2],
        _ => sin / cos,
    };
    let g1 = |w: [f64; 3]| {
        // ω_p·h and |ω_p × h| of the projection on the n-v plane.
        let along = w[1] * h[1] + w[2] * h[2];
        if along <= 0.0 {
            return 0.0;
        }
        let across = (w[2] * h[0])
            .hypot(w[1] * h[0])
            .hypot(w[1] * h[2] - w[2] * h[1]);
        (1.0 - ridge_tan * across / along).max(0.0)
    };
    g1(i) * g1(o)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cases::reference::{PRINTED_BRDF, ReferenceTable, directions_of, surface_of};
    use crate::model::real::Real;

    fn direction(theta: f64, phi: f64) -> [f64; 3] {
        let (s, c) = theta.sin_cos();
        [s * phi.cos(), s * phi.sin(), c]
    }

    #[test]
    fn the_three_readings_agree_where_the_half_vector_is_the_pitch_normal() {
        // In the n-v plane, mirrored at m: h = m, and all three tangents are the same.
        for theta_r in [0.05f64, 0.17, 0.3] {
            for away in [0.02f64, 0.2, 0.6] {
                let at = |angle: f64| [0.0, angle.sin(), angle.cos()];
                let (i, o) = (at(theta_r + away), at(theta_r - away));
                let pitch = shadowing_and_masking(Reading::Pitch, i, o, theta_r);
                let expected = (1.0 - theta_r.tan() * away.tan()).powi(2);
                for reading in [Reading::Pitch, Reading::Half, Reading::Code] {
                    let g = shadowing_and_masking(reading, i, o, theta_r);
                    assert!((g - expected).abs() < 1e-14, "{reading:?} {g} {pitch}");
                }
            }
        }
    }

    #[test]
    fn off_the_peak_the_readings_differ() {
        let (i, o) = (direction(0.3, 0.4), direction(0.5, 2.5));
        let [p, h, c] = [Reading::Pitch, Reading::Half, Reading::Code]
            .map(|reading| shadowing_and_masking(reading, i, o, 0.3));
        assert!((p - h).abs() > 1e-3 && (p - c).abs() > 1e-3 && (h - c).abs() > 1e-3);
    }

    #[test]
    fn the_fast_form_is_the_printed_brdf_times_the_cosine() {
        let table = ReferenceTable::read(PRINTED_BRDF);
        for (n, row) in table.rows().enumerate() {
            let case = row.case();
            let (surface, optics) = surface_of(&case);
            let d = directions_of(&case);
            let q = Parameters::of(&surface, &Real::NONE, &optics);
            let widening = optics.cones.widening();
            let l = radiance_of(d.incident.into(), d.outgoing.into(), &q, widening);
            let (f, cond, cos_i) = (row.number("f"), row.number("cond"), case.theta_i.cos());
            // Vectors in doubles lose the digits that the angles' own rounding loses, times a few operations. For
            // opposite grazing directions the sum cancels; only the exact form covers these.
            if row.text("case").starts_with("opposite") {
                continue;
            }
            let bound = 64.0 * f64::EPSILON * (1.0 + cond) * f * cos_i;
            assert!(
                (l - f * cos_i).abs() <= bound.max(1e-300),
                "row {n}: {l} {}",
                f * cos_i
            );
        }
    }
}
