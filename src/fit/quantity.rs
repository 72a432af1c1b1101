//! What a fit can look for, and values of all of it.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use crate::model::Surface;
use crate::model::extended::Real;
use crate::units::Angle;

/// What a fit can look for, in the order in which reports list it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// Ridge angle θr.
    ThetaR,
    /// Roughness along the ridges.
    AlphaU,
    /// Roughness across the ridges.
    AlphaV,
    /// Diffuse reflectance.
    RhoD,
    /// Gain g of the signals.
    Scale,
    /// Stray light B.
    Background,
    /// Zero of the rotation stage Δφs.
    AzimuthOffset,
    /// Zero of the tilt stage Δθc.
    TiltOffset,
    /// Real part of the index, within its uncertainty.
    Eta,
    /// Imaginary part of the index, within its uncertainty.
    K,
    /// Share τ of a body's light that leaves evenly over the ridges.
    Translucency,
    /// Tail ι of the facets' slopes, 0 for Beckmann.
    Tail,
    /// Radius of the crests over the facets' length.
    CrestRadius,
}

impl Quantity {
    /// Those that a report lists.
    pub const ALL: [Quantity; 8] = [
        Quantity::ThetaR,
        Quantity::AlphaU,
        Quantity::AlphaV,
        Quantity::RhoD,
        Quantity::Scale,
        Quantity::Background,
        Quantity::AzimuthOffset,
        Quantity::TiltOffset,
    ];

    /// Those of [`Real`], which only samples that need them are fitted with.
    pub const REAL: [Quantity; 3] = [
        Quantity::Translucency,
        Quantity::Tail,
        Quantity::CrestRadius,
    ];
}

/// Values of all quantities in natural units: angles in radians, θr signed, roughness as is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Values {
    /// Signed ridge angle θr, rad.
    pub theta_r: f64,
    /// Beckmann roughness along the ridges, tangent of slope.
    pub alpha_u: f64,
    /// Beckmann roughness across the ridges, tangent of slope.
    pub alpha_v: f64,
    /// Diffuse reflectance, 0 to 1.
    pub rho_d: f64,
    /// Gain g: signal per unit of radiance.
    pub scale: f64,
    /// Stray light B, in the signals' unit.
    pub background: f64,
    /// Zero of the rotation stage Δφs, rad.
    pub azimuth_offset: f64,
    /// Zero of the tilt stage Δθc, rad.
    pub tilt_offset: f64,
    /// Real part of the index.
    pub eta: f64,
    /// Imaginary part of the index.
    pub k: f64,
    /// What real samples have beside an ideal sawtooth.
    pub real: Real,
}

impl Values {
    /// One of them, as the solver sees it (roughnesses as logarithms).
    #[must_use]
    pub fn inner(&self, quantity: Quantity) -> f64 {
        match quantity {
            Quantity::ThetaR => self.theta_r,
            Quantity::AlphaU => self.alpha_u.ln(),
            Quantity::AlphaV => self.alpha_v.ln(),
            Quantity::RhoD => self.rho_d,
            Quantity::Scale => self.scale,
            Quantity::Background => self.background,
            Quantity::AzimuthOffset => self.azimuth_offset,
            Quantity::TiltOffset => self.tilt_offset,
            Quantity::Eta => self.eta,
            Quantity::K => self.k,
            Quantity::Translucency => self.real.translucency,
            Quantity::Tail => self.real.tail,
            Quantity::CrestRadius => self.real.crest,
        }
    }

    /// One of them as people state it: θr ≥ 0 with its azimuth, roughness as it is.
    #[must_use]
    pub fn natural(&self, quantity: Quantity) -> f64 {
        match quantity {
            Quantity::AlphaU => self.alpha_u,
            Quantity::AlphaV => self.alpha_v,
            _ => self.folded().inner(quantity),
        }
    }

    /// Puts back what [`Values::natural`] gives.
    pub fn set_natural(&mut self, quantity: Quantity, value: f64) {
        match quantity {
            Quantity::AlphaU => self.alpha_u = value,
            Quantity::AlphaV => self.alpha_v = value,
            _ => self.set_inner(quantity, value),
        }
    }

    /// Puts back what [`Values::inner`] gives.
    pub fn set_inner(&mut self, quantity: Quantity, value: f64) {
        match quantity {
            Quantity::ThetaR => self.theta_r = value,
            Quantity::AlphaU => self.alpha_u = value.exp(),
            Quantity::AlphaV => self.alpha_v = value.exp(),
            Quantity::RhoD => self.rho_d = value,
            Quantity::Scale => self.scale = value,
            Quantity::Background => self.background = value,
            Quantity::AzimuthOffset => self.azimuth_offset = value,
            Quantity::TiltOffset => self.tilt_offset = value,
            Quantity::Eta => self.eta = value,
            Quantity::K => self.k = value,
            Quantity::Translucency => self.real.translucency = value,
            Quantity::Tail => self.real.tail = value,
            Quantity::CrestRadius => self.real.crest = value,
        }
    }

    /// The same surface with θr ≥ 0 and the azimuth in (−180°, 180°].
    #[must_use]
    pub fn folded(mut self) -> Self {
        if self.theta_r < 0.0 {
            self.theta_r = -self.theta_r;
            self.azimuth_offset += PI;
        }
        self.azimuth_offset = Angle::from_rad(self.azimuth_offset).wrapped().rad();
        self
    }

    /// The surface as the model wants it, θr as it stands.
    #[must_use]
    pub fn surface(&self) -> Surface {
        Surface {
            theta_r: self.theta_r,
            alpha_u: self.alpha_u,
            alpha_v: self.alpha_v,
            rho_d: self.rho_d,
            amplitude: 1.0,
        }
    }
}
