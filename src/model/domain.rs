//! The domain in which the closed forms have a result as an f64, and a named error outside it.
//!
//! Call [`check`] before [`super::radiance`] or a gradient if the numbers come from outside. Numbers that pass give
//! finite values and derivatives in every direction whose angles are doubles. The ranges end where products of the
//! forms' factors would leave the range of doubles, far beyond any real surface.

use super::sawtooth::diffuse_transmittance;
use super::{Optics, Surface};

/// The reason why there is no radiance.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum OutOfDomain {
    /// A number is NaN, infinite or too extreme for doubles.
    #[error("{name} = {value:e} is out of range ({low:e} to {high:e})")]
    Range {
        /// Name of the number.
        name: &'static str,
        /// Its value.
        value: f64,
        /// Least value.
        low: f64,
        /// Greatest value.
        high: f64,
    },
    /// The boundary transmits next to nothing, so ρd has no unit.
    #[error(
        "rho_d = {rho_d}, but the boundary transmits only a share of {transmittance}; set rho_d to 0"
    )]
    NothingGetsIn {
        /// The requested diffuse reflectance.
        rho_d: f64,
        /// The transmittance, at normal incidence or at θl, whichever is less.
        transmittance: f64,
    },
    /// Two walls would exchange diffuse light without loss: the series diverges.
    #[error(
        "rho_d = {rho_d} implies that a wall returns {albedo} times the diffuse light it receives; lower rho_d or set \
         the body's index (eta = {eta})"
    )]
    GivesMoreThanItGets {
        /// The requested diffuse reflectance.
        rho_d: f64,
        /// Share of diffuse light that a wall returns, above 1.
        albedo: f64,
        /// The relative index.
        eta: f64,
    },
}

/// Checks whether a surface with these optics has a radiance.
///
/// # Errors
/// [`OutOfDomain`] names the first invalid number.
pub fn check(surface: &Surface, optics: &Optics) -> Result<(), OutOfDomain> {
    let right_angle = std::f64::consts::FRAC_PI_2;
    for (name, value, low, high) in [
        ("theta_r", surface.theta_r, -right_angle, right_angle),
        ("alpha_u", surface.alpha_u, 1e-50, 1e50),
        ("alpha_v", surface.alpha_v, 1e-50, 1e50),
        ("rho_d", surface.rho_d, 0.0, 1e3),
        ("amplitude", surface.amplitude, 0.0, 1e15),
        ("eta", optics.eta, 1e-6, 1e6),
        ("k", optics.k, 0.0, 1e6),
        ("theta_l", optics.theta_l, -1.5, 1.5),
        ("light_angular_radius", optics.cones.lamp.rad(), 0.0, 1.5),
        ("lens_angular_radius", optics.cones.lens.rad(), 0.0, 1.5),
    ] {
        // A NaN is not within any range.
        if !(low..=high).contains(&value) {
            return Err(OutOfDomain::Range {
                name,
                value,
                low,
                high,
            });
        }
    }
    // ρd is the reflectance at the rig's own angles: normal incidence and θl.
    let enters = |cos: f64| super::fresnel::transmittance(cos, optics.eta, optics.k);
    let transmittance = enters(1.0).min(enters(optics.theta_l.cos()));
    if surface.rho_d > 0.0 && transmittance < 1e-9 {
        return Err(OutOfDomain::NothingGetsIn {
            rho_d: surface.rho_d,
            transmittance,
        });
    }
    // The exchange between facet and riser is a geometric series of ratio κ² φ_fr φ_rf.
    let t_bar = diffuse_transmittance(optics.eta, optics.k).value;
    let albedo = surface.rho_d * t_bar * t_bar / (enters(1.0) * enters(optics.theta_l.cos()));
    let (sin, cos) = surface.theta_r.abs().sin_cos();
    let gap = sin + cos - 1.0;
    let diverges = sin > 0.0 && albedo * albedo * gap * gap >= 4.0 * sin * cos;
    if surface.rho_d > 0.0 && diverges {
        return Err(OutOfDomain::GivesMoreThanItGets {
            rho_d: surface.rho_d,
            albedo,
            eta: optics.eta,
        });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const SURFACE: Surface = Surface {
        theta_r: 0.7,
        alpha_u: 0.1,
        alpha_v: 0.1,
        rho_d: 1.0,
        amplitude: 1.0,
    };
    const PLASTIC: Optics = Optics {
        eta: 1.54,
        k: 0.0,
        theta_l: 0.17,
        cones: crate::geometry::Cones::NONE,
    };

    #[test]
    fn surfaces_of_real_labs_are_within_the_domain() {
        for theta_r in [-1.5, 0.0, 1e-17, 0.1, 0.7, 1.5] {
            let surface = Surface { theta_r, ..SURFACE };
            assert_eq!(check(&surface, &PLASTIC), Ok(()), "theta_r {theta_r}");
        }
    }

    #[test]
    fn walls_that_return_more_than_they_receive_are_refused_only_if_they_face_each_other() {
        // T is small at θl = 1.4 rad and large at normal incidence: no body has ρd = 1 there.
        let optics = Optics {
            eta: 0.9,
            k: 1e-3,
            theta_l: 1.4,
            ..PLASTIC
        };
        let refused = check(&SURFACE, &optics);
        assert!(
            matches!(refused, Err(OutOfDomain::GivesMoreThanItGets { albedo, .. }) if albedo > 1.0),
            "{refused:?}"
        );
        let flat = Surface {
            theta_r: 0.0,
            ..SURFACE
        };
        assert_eq!(check(&flat, &optics), Ok(()));
    }

    #[test]
    fn a_number_out_of_range_is_named() {
        let surface = Surface {
            alpha_v: f64::NAN,
            ..SURFACE
        };
        let message = check(&surface, &PLASTIC).map_err(|e| e.to_string());
        assert_eq!(
            message,
            Err("alpha_v = NaN is out of range (1e-50 to 1e50)".to_owned())
        );
    }
}
