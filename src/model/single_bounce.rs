//! Light scattered once by a rough surface of small mirrors: the Mueller BRDF in closed form.
//!
//! Call [`mueller_brdf`]: isotropic Beckmann slopes, no masking. The ray tracer's single-bounce part must agree with
//! it if masking is negligible, and so must SCATMECH's facet model with shadowing "none".
//!
//! *Conditioning.* No angle is subtracted from another: slope and angle at the facet come from h's components, and
//! frames are turned by `atan2`. The density's exponent remains: it magnifies a rounding of h by tan²/α², so an
//! element far out in the lobe's tail has that many roundings, and one at the lobe a handful. For directions that
//! graze from opposite sides h itself is a small difference, which is the condition of the problem, not of the form.

use nalgebra::Vector3;

use super::polarisation::{Boundary, Mueller};

/// Directions of a single scattering as SCATMECH counts them: k_in = (sin θi, 0, −cos θi),
/// k_out = (sin θs cos φs, sin θs sin φs, cos θs), so that the mirror direction is φs = 0.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scattering {
    /// Angle of incidence θi, rad.
    pub theta_i: f64,
    /// Polar angle of scattering θs, rad.
    pub theta_s: f64,
    /// Azimuth of scattering φs, rad.
    pub phi_s: f64,
}

/// Returns the Mueller BRDF in sr⁻¹, M = D(h) F / (4 cos θi cos θs), between the frames (z × k, k × s) of the two
/// beams. `alpha` is the Beckmann α of the tangent of slope; `n + ik` is the index under air.
///
/// Returns `None` if a direction is not above the surface or a number is invalid.
#[must_use]
pub fn mueller_brdf(scattering: &Scattering, alpha: f64, n: f64, k: f64) -> Option<Mueller> {
    let (sin_i, cos_i) = scattering.theta_i.sin_cos();
    let (sin_s, cos_s) = scattering.theta_s.sin_cos();
    let (sin_p, cos_p) = scattering.phi_s.sin_cos();
    let usable = cos_i > 0.0
        && cos_s > 0.0
        && alpha > 0.0
        && n > 0.0
        && k >= 0.0
        && [alpha, n, k, sin_p].iter().all(|x| x.is_finite());
    if !usable {
        return None;
    }
    let k_in = Vector3::new(sin_i, 0.0, -cos_i);
    let k_out = Vector3::new(sin_s * cos_p, sin_s * sin_p, cos_s);
    let h = (k_out - k_in).normalize();
    let cos = h.dot(&k_out);
    let tangent2 = (h.x * h.x + h.y * h.y) / (h.z * h.z);
    let d =
        (-tangent2 / (alpha * alpha)).exp() / (std::f64::consts::PI * alpha * alpha * h.z.powi(4));
    let reflection = Boundary::new(1.0, n, k).at(cos).reflected.mueller();
    // s of each macro frame in closed form, so that it is defined at normal incidence too (φ = 0).
    let s_in = Vector3::new(0.0, 1.0, 0.0);
    let s_out = Vector3::new(-sin_p, cos_p, 0.0);
    // For normal incidence and exit no plane is distinguished; that of the macro frame serves for both beams.
    let across = h.cross(&k_in);
    let s_hit = if across == Vector3::zeros() {
        s_in
    } else {
        across
    };
    let into = turn(&k_in, &s_in, &s_hit);
    let out = turn(&k_out, &s_hit, &s_out);
    let f = d / (4.0 * cos_i * cos_s);
    Some(Mueller((out * reflection * into).0 * f))
}

/// Rotation of the frame of a beam along `k` from `s` to the direction of `s_new` (any length).
fn turn(k: &Vector3<f64>, s: &Vector3<f64>, s_new: &Vector3<f64>) -> Mueller {
    let p = k.cross(s);
    Mueller::rotation(s_new.dot(&p).atan2(s_new.dot(s)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_normal_incidence_and_exit_the_frame_of_exit_turns_with_its_azimuth() {
        for (eta, k) in [(1.5, 0.0), (0.2, 3.4)] {
            for phi_s in [0.0, 0.3, 0.785, 1.571, 2.5, 3.2, -1.0] {
                let at = |theta: f64| {
                    let scattering = Scattering {
                        theta_i: theta,
                        theta_s: theta,
                        phi_s,
                    };
                    mueller_brdf(&scattering, 0.4, eta, k).unwrap().0
                };
                let difference = (at(0.0) - at(1e-9)).amax();
                assert!(difference < 1e-9, "{eta} {phi_s}: {difference}");
            }
        }
    }

    #[test]
    fn the_unmasked_single_bounce_agrees_with_scatmech() {
        let mut reader = csv::Reader::from_path("tests/data/polarised/scatmech.csv").unwrap();
        let mut rows = 0;
        let mut worst = 0.0f64;
        for record in reader.records() {
            let record = record.unwrap();
            if &record[3] != "none" {
                continue;
            }
            let number = |i: usize| record[i].parse::<f64>().unwrap();
            let scattering = Scattering {
                theta_i: number(5).to_radians(),
                theta_s: number(6).to_radians(),
                phi_s: number(7).to_radians(),
            };
            let m = mueller_brdf(&scattering, number(4), number(1), number(2)).unwrap();
            for i in 0..4 {
                for j in 0..4 {
                    let expected = number(8 + 4 * i + j);
                    worst = worst.max((m.0[(i, j)] - expected).abs() / number(8));
                }
            }
            rows += 1;
        }
        assert_eq!(rows, 975);
        assert!(worst < 1e-8, "{worst}");
    }

    #[test]
    fn the_reversed_path_is_the_reciprocal_one() {
        // M(θi, θs, φ) = O M(θs, θi, −φ)ᵀ O.
        let there = Scattering {
            theta_i: 0.4,
            theta_s: 1.1,
            phi_s: 0.7,
        };
        let back = Scattering {
            theta_i: 1.1,
            theta_s: 0.4,
            phi_s: -0.7,
        };
        let a = mueller_brdf(&there, 0.5, 0.18, 3.4).unwrap();
        let b = mueller_brdf(&back, 0.5, 0.18, 3.4).unwrap();
        assert!((a.0 - b.reversed_path().0).abs().max() < 1e-14 * a.0[(0, 0)]);
    }
}
