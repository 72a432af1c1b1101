//! The range of each quantity that a fit considers.

use std::f64::consts::PI;

use super::{Problem, Quantity};
use crate::fit::least_squares::levenberg_marquardt::Bounds;
use crate::model::Variant;
use crate::model::extended::slopes::TAIL_MAX;
use crate::model::extended::{CREST_MAX, LAND_MAX};

/// Smallest and largest gain as multiples of the brightest signal. Without a limit, a lobe that all poses miss by far
/// could be scaled up until its skirt equals the signal. The fit's form of the model is 0 from 43 decades below the top
/// of a lobe; for the narrowest lobe this limit stays a share of 1e-12 of the brightest signal.
const GAIN: (f64, f64) = (1e-12, 1e24);
/// Steepest ridge that a fit considers, rad.
pub const THETA_R_MAX: f64 = 75.0 * PI / 180.0;
/// Smoothest facet that a fit considers.
pub const ALPHA_MIN: f64 = 1e-4;
/// Largest zero of the tilt that a fit considers, rad.
pub const TILT_OFFSET_MAX: f64 = 15.0 * PI / 180.0;
/// Largest tilt of the sample across v that a fit considers, rad: larger ones are seen.
const WEDGE_MAX: f64 = 5.0 * PI / 180.0;
/// Largest turn of the lamp about the camera's axis that a fit considers, rad.
const LAMP_TURN_MAX: f64 = 15.0 * PI / 180.0;
/// Roughest facet that a fit considers.
pub const ALPHA_MAX: f64 = 2.0;

impl Problem<'_> {
    /// The bounds of the solver.
    #[must_use]
    pub fn bounds(&self) -> Bounds {
        let (eta, k) = self.set.material.index();
        let signals = self.set.observations.iter().map(|o| o.signal.abs());
        let brightest = signals.fold(0.0, f64::max);
        let range = |q: &Quantity| match q {
            // If the azimuth is held, θr cannot change its sign.
            Quantity::ThetaR if !self.free.contains(&Quantity::AzimuthOffset) => (0.0, THETA_R_MAX),
            Quantity::ThetaR => (-THETA_R_MAX, THETA_R_MAX),
            Quantity::AlphaU | Quantity::AlphaV => (ALPHA_MIN.ln(), ALPHA_MAX.ln()),
            // The amplitude of the printed lobe, A = F + (ρd/π)(1 − F)², stays positive. Its ρd may exceed 1, which
            // shows that the variant does not describe the sample.
            Quantity::RhoD => match self.variant {
                Variant::Paper => {
                    let f = normal_reflectance(eta, k);
                    (-0.99 * PI * f / ((1.0 - f) * (1.0 - f)), 1e3)
                }
                // Not 0, where the model omits the diffuse terms and their derivatives.
                Variant::Sawtooth => (1e-9, 1.0),
            },
            // In the unit of the signals.
            Quantity::Scale => {
                let unit = brightest.max(f64::MIN_POSITIVE);
                (GAIN.0 * unit, GAIN.1 * unit)
            }
            Quantity::Background | Quantity::AzimuthOffset => (f64::NEG_INFINITY, f64::INFINITY),
            Quantity::Eta => (0.01, f64::INFINITY),
            Quantity::K => (0.0, f64::INFINITY),
            Quantity::TiltOffset => (-TILT_OFFSET_MAX, TILT_OFFSET_MAX),
            Quantity::Translucency => (0.0, 1.0),
            Quantity::Tail => (0.0, TAIL_MAX),
            Quantity::CrestRadius => (0.0, CREST_MAX),
            Quantity::Land => (0.0, LAND_MAX),
            Quantity::Wedge => (-WEDGE_MAX, WEDGE_MAX),
            Quantity::LampTurn => (-LAMP_TURN_MAX, LAMP_TURN_MAX),
        };
        let (lower, upper) = self.free.iter().map(range).unzip();
        Bounds { lower, upper }
    }
}

/// Fresnel reflectance at normal incidence; within 1e-4 of that at 5°.
fn normal_reflectance(eta: f64, k: f64) -> f64 {
    ((eta - 1.0).powi(2) + k * k) / ((eta + 1.0).powi(2) + k * k)
}
