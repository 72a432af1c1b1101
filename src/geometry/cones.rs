//! How far light's directions spread at both ends of its way: the lamp's cone and the lens's.
//!
//! The one to use: [`Cones`], a fact of the rig. Averages over the cones are the model's affair.

use crate::units::Angle;

/// Half angles of the cones in which the sample sees the lamp and the lens's pupil, both round and evenly
/// filled; 0 for a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cones {
    /// The lamp's.
    pub lamp: Angle,
    /// The lens's; its sine is the numerical aperture on the sample's side.
    pub lens: Angle,
}

impl Cones {
    /// A collimated lamp and a lens stopped down to a point.
    pub const NONE: Cones = Cones {
        lamp: Angle::ZERO,
        lens: Angle::ZERO,
    };

    /// A lamp of that angular radius before a lens stopped down to a point.
    #[must_use]
    pub const fn of_lamp(lamp: Angle) -> Self {
        Cones {
            lamp,
            lens: Angle::ZERO,
        }
    }

    /// What the cones add to α², (Rl² + Rc²)/8 (tangents of slope, squared).
    ///
    /// A disc of radius R has the variance R²/4 along each axis. The half vector moves by half of what
    /// either end moves, the two ends independently: (Rl² + Rc²)/16. A Beckmann lobe has the variance α²/2.
    #[must_use]
    pub fn widening(&self) -> f64 {
        let (lamp, lens) = (self.lamp.rad(), self.lens.rad());
        (lamp * lamp + lens * lens) / 8.0
    }

    /// How far both together can move one end, the other being kept, rad.
    #[must_use]
    pub fn reach(&self) -> f64 {
        self.lamp.rad() + self.lens.rad()
    }
}
