//! The quantities that all pixels share: gain, stray light and tilt offset.
//!
//! signal = gain · (L(θc + Δθc) + s) and flat = gain · (ρ/π cos θi(θc + Δθc) + s). Gain and stray light come from the
//! flats and from a prior: on a dielectric, s is almost indistinguishable from a pixel's diffuse light. [`step`]
//! takes the tilt offset from the pixels.

pub(super) mod step;

use serde::{Deserialize, Serialize};

use crate::geometry::RigGeometry;
use crate::observation::{FlatObservation, WhiteReference};
use crate::units::Angle;

/// Prior standard uncertainty of the stray light as a share of the largest signal.
const STRAY_SHARE: f64 = 0.02;
/// Prior standard uncertainty of the tilt offset.
const TILT_PRIOR_RAD: f64 = 0.17;

/// Values that all pixels share, with standard uncertainties.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Globals {
    /// Signal units per radiance.
    pub gain: f64,
    /// Standard uncertainty of `gain` relative to it, the white reference's certificate included.
    pub gain_relative_std: f64,
    /// Stray light in radiance.
    pub stray: f64,
    /// Standard uncertainty of `stray`.
    pub stray_std: f64,
    /// Offset to add to a recorded tilt.
    #[serde(with = "radians")]
    pub tilt_offset: Angle,
    /// Standard uncertainty of `tilt_offset`.
    #[serde(with = "radians")]
    pub tilt_offset_std: Angle,
}

/// An angle in the unit in which it is stored, so that no bit of it changes.
mod radians {
    use serde::{Deserialize as _, Deserializer, Serializer};

    use crate::units::Angle;

    pub(super) fn serialize<S: Serializer>(angle: &Angle, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_f64(angle.rad())
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Angle, D::Error> {
        f64::deserialize(from).map(Angle::from_rad)
    }
}

impl Globals {
    /// Returns the values before any data are used.
    pub(super) fn first(gain: f64, largest_signal: f64) -> Self {
        Globals {
            gain,
            gain_relative_std: 1.0,
            stray: 0.0,
            stray_std: STRAY_SHARE * largest_signal / gain,
            tilt_offset: Angle::ZERO,
            tilt_offset_std: Angle::from_rad(TILT_PRIOR_RAD),
        }
    }

    /// Computes gain and stray light from the flats at the present tilt offset.
    pub(super) fn with_flats(
        self,
        flats: &[FlatObservation],
        white: &WhiteReference,
        rig: &RigGeometry,
        largest_signal: f64,
    ) -> Self {
        // Unknowns: gain and b = gain · s; prior b = 0 ± STRAY_SHARE · largest.
        let prior = (STRAY_SHARE * largest_signal).powi(-2);
        let (mut aa, mut ab, mut bb, mut ya, mut yb) = (0.0, 0.0, prior, 0.0, 0.0);
        for flat in flats {
            let due = white.reflectance / std::f64::consts::PI
                * rig.cos_incidence(flat.theta_c + self.tilt_offset);
            let w2 = flat.sigma.powi(-2);
            aa += w2 * due * due;
            ab += w2 * due;
            bb += w2;
            ya += w2 * due * flat.signal;
            yb += w2 * flat.signal;
        }
        let determinant = aa * bb - ab * ab;
        let gain = (ya * bb - yb * ab) / determinant;
        let stray = (yb * aa - ya * ab) / determinant;
        let reference = white.reflectance_std / white.reflectance;
        Globals {
            gain,
            gain_relative_std: (bb / determinant / (gain * gain) + reference * reference).sqrt(),
            stray: stray / gain,
            stray_std: (aa / determinant).sqrt() / gain,
            ..self
        }
    }
}
