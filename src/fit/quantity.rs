//! The quantities that a fit can determine, and their values.

use std::f64::consts::{FRAC_PI_2, PI};

use serde::{Deserialize, Serialize};

use crate::model::Surface;
use crate::model::extended::Real;
use crate::units::Angle;

/// A quantity that a fit can determine, in the order of the reports.
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
    /// Share τ of the body's light that leaves evenly over the ridges.
    Translucency,
    /// Tail ι of the slope distribution, 0 for Beckmann.
    Tail,
    /// Radius of the crests divided by the length of the facets.
    CrestRadius,
    /// Share of the surface that is flat between the ridges.
    Land,
    /// Tilt of the sample on the turntable across v.
    Wedge,
    /// Turn of the lamp about the camera's axis, from its stated place.
    LampTurn,
}

impl Quantity {
    /// The quantities that every report lists.
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

    /// The deviations of real samples and rigs, fitted only where the data need them.
    pub const REAL: [Quantity; 6] = [
        Quantity::Translucency,
        Quantity::Tail,
        Quantity::CrestRadius,
        Quantity::Land,
        Quantity::Wedge,
        Quantity::LampTurn,
    ];
}

/// Values of all quantities in natural units: angles in radians, θr signed, roughness itself.
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
    /// Stray light B, in the unit of the signals.
    pub background: f64,
    /// Zero of the rotation stage Δφs, rad.
    pub azimuth_offset: f64,
    /// Zero of the tilt stage Δθc, rad.
    pub tilt_offset: f64,
    /// Real part of the index.
    pub eta: f64,
    /// Imaginary part of the index.
    pub k: f64,
    /// Deviations of real samples from an ideal sawtooth.
    pub real: Real,
    /// Tilt w of the sample on the turntable across v, towards rising azimuth, rad.
    pub wedge: f64,
    /// Turn of the lamp about the camera's axis, added to its azimuth, rad.
    pub lamp_turn: f64,
}

impl Values {
    /// An ideal rig and no deviations of the sample: zeros, and gain 1. Surface and index are 0 and have to be set.
    pub const IDEAL: Values = Values {
        theta_r: 0.0,
        alpha_u: 0.0,
        alpha_v: 0.0,
        rho_d: 0.0,
        scale: 1.0,
        background: 0.0,
        azimuth_offset: 0.0,
        tilt_offset: 0.0,
        eta: 0.0,
        k: 0.0,
        real: Real::NONE,
        wedge: 0.0,
        lamp_turn: 0.0,
    };

    /// Returns a value in the units of the solver (roughnesses as logarithms).
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
            Quantity::Land => self.real.land,
            Quantity::Wedge => self.wedge,
            Quantity::LampTurn => self.lamp_turn,
        }
    }

    /// Returns a value as users state it: θr ≥ 0 with its azimuth, roughness itself.
    #[must_use]
    pub fn natural(&self, quantity: Quantity) -> f64 {
        match quantity {
            Quantity::AlphaU => self.alpha_u,
            Quantity::AlphaV => self.alpha_v,
            _ => self.folded().inner(quantity),
        }
    }

    /// Sets a value in the form of [`Values::natural`].
    pub fn set_natural(&mut self, quantity: Quantity, value: f64) {
        match quantity {
            Quantity::AlphaU => self.alpha_u = value,
            Quantity::AlphaV => self.alpha_v = value,
            _ => self.set_inner(quantity, value),
        }
    }

    /// Sets a value in the form of [`Values::inner`].
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
            Quantity::Land => self.real.land = value,
            Quantity::Wedge => self.wedge = value,
            Quantity::LampTurn => self.lamp_turn = value,
        }
    }

    /// Returns the same surface with θr ≥ 0 and the azimuth in (−180°, 180°].
    #[must_use]
    pub fn folded(mut self) -> Self {
        if self.theta_r < 0.0 {
            self.theta_r = -self.theta_r;
            self.azimuth_offset += PI;
            self.wedge = -self.wedge;
        }
        self.azimuth_offset = Angle::from_rad(self.azimuth_offset).wrapped().rad();
        self
    }

    /// Returns the same sharp corners with facet and riser exchanged: ridges of 90° − θr that lean the other way. Their lobes are at the
    /// same places; the rest of the closed form is not symmetric under the exchange.
    #[must_use]
    pub fn exchanged(&self) -> Self {
        let here = self.folded();
        let there = Values {
            theta_r: FRAC_PI_2 - here.theta_r,
            azimuth_offset: here.azimuth_offset + PI,
            wedge: -here.wedge,
            ..here
        };
        there.folded()
    }

    /// Converts to the surface of the model, with θr signed.
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
