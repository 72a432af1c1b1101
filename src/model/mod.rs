//! The reflectance model in closed form: the radiance of a ridged surface towards the camera.
//!
//! Call [`radiance`]; fits prepare a surface once and call [`prepared`], which also returns derivatives.
//! `Variant::Paper` is the BRDF as printed (Luongo et al. 2017, Eqs. 1–6), `Variant::Sawtooth` the full closed form
//! of [`sawtooth`]. All are pure functions of numbers: this module does not depend on files, clocks, cameras or
//! statistics.
//!
//! Directions are unit vectors in the sample frame (u, v, n), see [`crate::geometry`]. Radiance is for irradiance 1
//! on a surface that faces the lamp, so L = f cos θi.

pub mod brdf;
pub mod closed_form;
pub mod cone;
pub mod contrast;
pub mod domain;
pub mod double_double;
pub mod dual;
pub mod extended;
pub mod flat_stack;
pub(crate) mod form;
pub mod fresnel;
pub mod gauss;
pub(crate) mod lanes;
pub mod left_out;
pub mod number;
pub mod optimum;
pub mod paper;
pub mod picture;
pub mod polarisation;
pub mod prepared;
pub mod quadrature;
pub mod real;
mod register;
pub mod rough_boundary;
pub mod sawtooth;
pub mod single_bounce;
pub mod surface_brdf;
mod third_bounce;
pub mod views;

#[cfg(test)]
mod derivative_tests;
#[cfg(test)]
mod extreme_tests;
#[cfg(test)]
mod law_tests;

#[cfg(test)]
use crate::geometry::Pose;
use crate::geometry::{Cones, Directions, RigGeometry};
use crate::material::Material;
pub use left_out::LeftOut;
use real::Real;

/// The closed form that is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Variant {
    /// The BRDF as printed, masking to the pitch normal.
    Paper,
    /// Exact visibility, riser, diffuse and retro terms.
    Sawtooth,
}

/// The parameters of a surface that a fit determines.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Ridge angle θr, rad.
    pub theta_r: f64,
    /// Beckmann roughness along the ridges (tangent of slope).
    pub alpha_u: f64,
    /// Beckmann roughness across the ridges.
    pub alpha_v: f64,
    /// `Paper`: the lobe's ρd as printed. `Sawtooth`: the Lambertian-equivalent reflectance of a flat piece at the
    /// rig's own angles.
    pub rho_d: f64,
    /// Factor on the light: `Paper` on the whole lobe, `Sawtooth` on single specular reflection (squared on two
    /// reflections). 1 with an absolute scale.
    pub amplitude: f64,
}

/// The known inputs of the model besides the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optics {
    /// Real part of the index.
    pub eta: f64,
    /// Imaginary part of the index; 0 for a dielectric.
    pub k: f64,
    /// Angle between lamp and camera, rad; normalises ρd in `Sawtooth`.
    pub theta_l: f64,
    /// The cones of lamp and lens; they widen the lobes (α² + (Rl² + Rc²)/8).
    pub cones: Cones,
}

impl Surface {
    /// Returns the same surface with lobes no narrower than `alpha`, in quadrature. Far from a narrow peak the radiance
    /// underflows to 0 and gives a fit no information, so a fit starts broadened and narrows as it converges.
    #[must_use]
    pub fn broadened(&self, alpha: f64) -> Surface {
        Surface {
            alpha_u: self.alpha_u.hypot(alpha),
            alpha_v: self.alpha_v.hypot(alpha),
            ..*self
        }
    }
}

impl Optics {
    /// Returns the optics of a material on a rig.
    #[must_use]
    pub fn new(rig: &RigGeometry, material: &Material) -> Self {
        let (eta, k) = material.index();
        Optics {
            eta,
            k,
            theta_l: rig.theta_l.rad(),
            cones: rig.cones,
        }
    }
}

/// A radiance with its first derivatives (angles in radians).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gradient {
    /// The radiance.
    pub value: f64,
    /// ∂/∂θr, per radian.
    pub theta_r: f64,
    /// ∂/∂αu.
    pub alpha_u: f64,
    /// ∂/∂αv.
    pub alpha_v: f64,
    /// ∂/∂ρd.
    pub rho_d: f64,
    /// With respect to the deviations of [`extended`]; 0 in the other forms.
    pub real: Real,
    /// ∂/∂A.
    pub amplitude: f64,
    /// ∂/∂n.
    pub eta: f64,
    /// ∂/∂k.
    pub k: f64,
    /// ∂/∂θc, per radian: camera and lamp tilt together.
    pub theta_c: f64,
    /// ∂/∂φs, per radian.
    pub phi_s: f64,
    /// ∂/∂w, per radian: tilt of the sample across v, towards rising azimuth.
    pub wedge: f64,
    /// ∂ by the turn of the lamp about the camera's axis, per radian; 0 where a caller does not need it.
    pub lamp_turn: f64,
}

impl Gradient {
    /// Zero radiance and derivatives.
    pub const ZERO: Gradient = Gradient {
        value: 0.0,
        theta_r: 0.0,
        alpha_u: 0.0,
        alpha_v: 0.0,
        rho_d: 0.0,
        real: Real::NONE,
        amplitude: 0.0,
        eta: 0.0,
        k: 0.0,
        theta_c: 0.0,
        phi_s: 0.0,
        wedge: 0.0,
        lamp_turn: 0.0,
    };

    /// Adds `weight` times another gradient.
    pub fn add(&mut self, weight: f64, other: &Gradient) {
        self.value += weight * other.value;
        self.theta_r += weight * other.theta_r;
        self.alpha_u += weight * other.alpha_u;
        self.alpha_v += weight * other.alpha_v;
        self.rho_d += weight * other.rho_d;
        self.real.add(weight, &other.real);
        self.amplitude += weight * other.amplitude;
        self.eta += weight * other.eta;
        self.k += weight * other.k;
        self.theta_c += weight * other.theta_c;
        self.phi_s += weight * other.phi_s;
        self.wedge += weight * other.wedge;
        self.lamp_turn += weight * other.lamp_turn;
    }
}

/// Returns the radiance for irradiance 1 on a surface that faces the lamp; 0 if lamp or camera is not above the
/// surface. For many directions, build a [`closed_form::ClosedForm`] once.
#[must_use]
pub fn radiance(
    variant: Variant,
    directions: &Directions,
    surface: &Surface,
    optics: &Optics,
) -> f64 {
    closed_form::ClosedForm::new(variant, surface, None, optics).radiance(directions)
}

/// Returns the radiance and its exact derivatives at a true pose (mounting offsets already added).
///
/// For many poses, build a [`prepared::OpticsTable`] and a [`prepared::Prepared`] once.
#[cfg(test)]
pub fn radiance_gradient(
    variant: Variant,
    rig: &RigGeometry,
    pose: Pose,
    surface: &Surface,
    material: &Material,
) -> Gradient {
    let table = prepared::OpticsTable::new(&Optics::new(rig, material));
    prepared::Prepared::new(variant, surface, &table).gradient(rig, pose)
}
