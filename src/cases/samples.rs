//! Samples: matter and form.

use crate::material::Material;
use crate::model::Surface;

/// Material and surface of a sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SampleCase {
    /// What it is made of.
    pub material: Material,
    /// Its form and diffuse reflectance.
    pub surface: Surface,
}

/// A polymer with ridges of 11°.
pub const POLYMER: SampleCase = SampleCase {
    material: Material::Dielectric {
        eta: 1.5,
        eta_std: 0.0,
    },
    surface: Surface {
        theta_r: 11.0_f64.to_radians(),
        alpha_u: 0.09,
        alpha_v: 0.12,
        rho_d: 0.3,
        amplitude: 1.0,
    },
};

/// The polymer's form in a metal that absorbs only a hundredth of the light: k = 30.
pub const MIRROR: SampleCase = SampleCase {
    material: Material::Conductor {
        eta: 1.5,
        k: 30.0,
        eta_std: 0.0,
        k_std: 0.0,
    },
    surface: Surface {
        rho_d: 0.0,
        ..POLYMER.surface
    },
};

/// Steel with ridges of 0.2 rad.
pub const STEEL: SampleCase = SampleCase {
    material: Material::Conductor {
        eta: 2.9,
        k: 3.1,
        eta_std: 0.0,
        k_std: 0.0,
    },
    surface: Surface {
        theta_r: 0.2,
        alpha_u: 0.1,
        alpha_v: 0.12,
        rho_d: 0.0,
        amplitude: 1.0,
    },
};

impl SampleCase {
    /// With other roughnesses.
    #[must_use]
    pub const fn with_alpha(self, alpha_u: f64, alpha_v: f64) -> Self {
        SampleCase {
            material: self.material,
            surface: Surface {
                alpha_u,
                alpha_v,
                ..self.surface
            },
        }
    }
}
