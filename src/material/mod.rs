//! What a surface is made of, as optics sees it: a complex index with its uncertainty.

pub mod tables;

use serde::{Deserialize, Serialize};

/// Complex refractive index N = n + ik (convention exp(−iωt)) with standard uncertainties.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Material {
    /// Transparent below the surface; light that enters may come back diffusely.
    Dielectric {
        /// Index of refraction n.
        eta: f64,
        /// Standard uncertainty of n.
        eta_std: f64,
    },
    /// Opaque: what enters is lost.
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
    /// Real part n and imaginary part k of the index.
    #[must_use]
    pub const fn index(&self) -> (f64, f64) {
        match *self {
            Material::Dielectric { eta, .. } => (eta, 0.0),
            Material::Conductor { eta, k, .. } => (eta, k),
        }
    }
}
