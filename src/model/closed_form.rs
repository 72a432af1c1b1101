//! The closed form of one surface, prepared once and evaluated in many directions; without derivatives.

use super::extended::{self, Parameters, Real, Terms, Walls};
use super::prepared::OpticsTable;
use super::{Optics, Surface, Variant, paper};
use crate::geometry::Directions;

/// A surface with all that its closed form needs besides the directions.
#[derive(Debug, Clone)]
pub struct ClosedForm {
    variant: Variant,
    /// −1 if θr was negative: that equals the positive one at φs + 180°.
    sign: f64,
    parameters: Parameters<f64>,
    terms: Terms,
    walls: Walls,
    widening: f64,
}

impl ClosedForm {
    /// Prepares a surface. `real` selects the form of real samples ([`extended`]), which is one of the sawtooth; without it
    /// the walls are smooth, as those of an ideal sawtooth.
    #[must_use]
    pub fn new(variant: Variant, surface: &Surface, real: Option<&Real>, optics: &Optics) -> Self {
        let sign = if surface.theta_r < 0.0 { -1.0 } else { 1.0 };
        let surface = Surface {
            theta_r: surface.theta_r.abs(),
            ..*surface
        };
        let body = surface.rho_d != 0.0;
        let walls = match (variant, body, real) {
            (Variant::Paper, ..) | (Variant::Sawtooth, false, _) => Walls::dark(),
            (Variant::Sawtooth, true, Some(real)) => {
                Walls::new(&surface, real, &OpticsTable::new(optics))
            }
            (Variant::Sawtooth, true, None) => Walls::smooth(&OpticsTable::new(optics)),
        };
        let real = real.unwrap_or(&Real::NONE);
        ClosedForm {
            variant,
            sign,
            parameters: Parameters::of(&surface, real, optics),
            terms: Terms {
                body,
                ..Terms::of(real, optics, &Real::default())
            },
            walls,
            widening: optics.cones.widening(),
        }
    }

    /// Returns the radiance for irradiance 1 on a surface that faces the lamp; 0 if lamp or camera is not above the
    /// surface.
    #[must_use]
    pub fn radiance(&self, directions: &Directions) -> f64 {
        let [i, o] = [directions.incident, directions.outgoing]
            .map(|w| [self.sign * w.x, self.sign * w.y, w.z]);
        if i[2] <= 0.0 || o[2] <= 0.0 {
            return 0.0;
        }
        let (q, widening) = (&self.parameters, self.widening);
        match self.variant {
            Variant::Paper => paper::radiance_of(i, o, q, widening),
            Variant::Sawtooth => extended::radiance_of(i, o, q, self.terms, &self.walls, widening),
        }
    }
}
