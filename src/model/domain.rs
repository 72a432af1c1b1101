//! Numbers for which the closed forms have an answer in doubles, and a name for those that have none.
//!
//! Call [`check`] before [`super::radiance`] or a gradient where numbers come from outside. What passes
//! gives finite values and derivatives in every direction whose angles are doubles; the ends of the
//! ranges lie where products of the forms' factors would leave the range of doubles, far beyond
//! any surface.

use super::{Optics, Surface};

/// Why there is no radiance.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum OutOfDomain {
    /// A NaN, an infinity or a number at which doubles end.
    #[error("{name} = {value} is not within {low} and {high}")]
    Range {
        /// Which number.
        name: &'static str,
        /// What it is.
        value: f64,
        /// Least value.
        low: f64,
        /// Greatest value.
        high: f64,
    },
    /// Diffuse light of a body that lets next to nothing in: ρd has no unit there.
    #[error(
        "rho_d = {rho_d}, but the boundary lets in a share of {transmittance} only: set rho_d to 0"
    )]
    NothingGetsIn {
        /// The diffuse reflectance asked for.
        rho_d: f64,
        /// What gets in, straight or at θl.
        transmittance: f64,
    },
}

/// Whether a surface with these optics has a radiance.
///
/// # Errors
/// [`OutOfDomain`] names the first number that has none.
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
        (
            "light_angular_radius",
            optics.light_angular_radius,
            0.0,
            1.5,
        ),
    ] {
        // A NaN is within nothing.
        if !(low..=high).contains(&value) {
            return Err(OutOfDomain::Range {
                name,
                value,
                low,
                high,
            });
        }
    }
    // ρd is the reflectance at the rig's own angles: straight in and θl from it.
    let enters = |cos: f64| super::fresnel::transmittance(cos, optics.eta, optics.k);
    let transmittance = enters(1.0).min(enters(optics.theta_l.cos()));
    if surface.rho_d > 0.0 && transmittance < 1e-9 {
        return Err(OutOfDomain::NothingGetsIn {
            rho_d: surface.rho_d,
            transmittance,
        });
    }
    Ok(())
}
