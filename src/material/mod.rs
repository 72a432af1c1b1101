//! Optical material of a surface: a complex refractive index with its uncertainty.

pub mod tables;

use serde::{Deserialize, Serialize};

/// Complex refractive index N = n + ik (convention exp(−iωt)) with standard uncertainties.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Material {
    /// Transparent below the surface; light that enters may return diffusely.
    Dielectric {
        /// Index of refraction n.
        eta: f64,
        /// Standard uncertainty of n.
        eta_std: f64,
    },
    /// Opaque: light that enters is absorbed.
    Conductor {
        /// Real part n.
        eta: f64,
        /// Imaginary part k ≥ 0.
        k: f64,
        /// Standard uncertainty of n.
        eta_std: f64,
        /// Standard uncertainty of k.
        k_std: f64,
    },
}

impl Material {
    /// Makes a material whose index n + ik has no uncertainty; transparent if k is 0.
    #[must_use]
    pub const fn exactly(eta: f64, k: f64) -> Self {
        if k == 0.0 {
            Material::Dielectric { eta, eta_std: 0.0 }
        } else {
            Material::Conductor {
                eta,
                k,
                eta_std: 0.0,
                k_std: 0.0,
            }
        }
    }

    /// Real part n and imaginary part k of the index.
    #[must_use]
    pub const fn index(&self) -> (f64, f64) {
        match *self {
            Material::Dielectric { eta, .. } => (eta, 0.0),
            Material::Conductor { eta, k, .. } => (eta, k),
        }
    }
}
