//! The angular spread of light at the lamp and at the lens.
//!
//! [`Cones`] is a property of the rig. The model averages over the cones.

use crate::units::Angle;

/// Half angles of the cones under which the sample sees the lamp and the entrance pupil; both are
/// round and uniformly filled. 0 is a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cones {
    /// Half angle of the lamp.
    pub lamp: Angle,
    /// Half angle of the lens; its sine is the numerical aperture on the sample's side.
    pub lens: Angle,
}

impl Cones {
    /// A collimated lamp and a lens with an infinitely small aperture.
    pub const NONE: Cones = Cones {
        lamp: Angle::ZERO,
        lens: Angle::ZERO,
    };

    /// A lamp of that angular radius and a lens with an infinitely small aperture.
    #[must_use]
    pub const fn of_lamp(lamp: Angle) -> Self {
        Cones {
            lamp,
            lens: Angle::ZERO,
        }
    }

    /// Contribution of the cones to α², (Rl² + Rc²)/8 (tangents of slope, squared).
    ///
    /// A disc of radius R has the variance R²/4 along each axis. The half vector moves by half the
    /// displacement of either end, and the two ends are independent: (Rl² + Rc²)/16. A Beckmann
    /// lobe has the variance α²/2.
    #[must_use]
    pub fn widening(&self) -> f64 {
        let (lamp, lens) = (self.lamp.rad(), self.lens.rad());
        (lamp * lamp + lens * lens) / 8.0
    }

    /// Largest displacement of one end by both cones together, with the other end fixed, in rad.
    #[must_use]
    pub fn reach(&self) -> f64 {
        self.lamp.rad() + self.lens.rad()
    }
}
