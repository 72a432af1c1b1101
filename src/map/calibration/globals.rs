//! The quantities that all pixels share: gain, stray light and tilt offset.
//!
//! signal = gain · (L(θc + Δθc) + s) and flat = gain · (ρ/π cos θi(θc + Δθc) + s). Gain and stray light come from the flats and
//! from a prior: on a dielectric, s is almost indistinguishable from a pixel's diffuse light. Without flats they come from the
//! fit of the pixels' mean, as do s on metal and the tilt offset; the sampled pixels then refine these (`calibration`).

use serde::{Deserialize, Serialize};

use crate::fit::known::gain_and_stray_light;
use crate::geometry::{Pose, RigGeometry};
use crate::material::Material;
use crate::observation::{FlatObservation, Prior, WhiteReference};
use crate::units::Angle;

/// Standard uncertainty of the stray light, as a share of the largest signal, if nothing determines it.
const STRAY_SHARE: f64 = 0.02;
/// Standard uncertainty of the tilt offset if nothing determines it.
const TILT_PRIOR_RAD: f64 = 0.17;

/// Inputs that are known beforehand.
pub(in crate::map) struct Given<'a> {
    pub(in crate::map) rig: RigGeometry,
    pub(in crate::map) material: &'a Material,
    pub(in crate::map) recorded: &'a [Pose],
    /// The white reference over its tilts.
    pub(in crate::map) flats: &'a [FlatObservation],
    pub(in crate::map) white: Option<WhiteReference>,
    /// Largest signal of the sampled pixels.
    pub(in crate::map) largest: f64,
    /// Share of the brightest radiance that may be omitted.
    pub(in crate::map) target_error: Option<f64>,
}

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

    pub(in crate::map) fn serialize<S: Serializer>(
        angle: &Angle,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        to.serialize_f64(angle.rad())
    }

    pub(in crate::map) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Angle, D::Error> {
        f64::deserialize(from).map(Angle::from_rad)
    }
}

impl Globals {
    /// Returns the values before any data are used.
    pub(in crate::map) fn first(largest_signal: f64) -> Self {
        Globals {
            gain: 1.0,
            gain_relative_std: 1.0,
            stray: 0.0,
            stray_std: STRAY_SHARE * largest_signal,
            tilt_offset: Angle::ZERO,
            tilt_offset_std: Angle::from_rad(TILT_PRIOR_RAD),
        }
    }

    /// Computes the gain, and except on metal the stray light, from the flats at the present tilt offset; without flats they
    /// stay.
    pub(in crate::map) fn with_flats(self, given: &Given<'_>) -> Self {
        let Some(white) = &given.white else {
            return self;
        };
        let prior = Prior {
            mean: 0.0,
            std: STRAY_SHARE * given.largest,
        };
        let by_flats =
            gain_and_stray_light(white, given.flats, &given.rig, self.tilt_offset, prior);
        let Some([(gain, std), (stray, stray_std)]) = by_flats else {
            return self;
        };
        let reference = white.reflectance_std / white.reflectance;
        let own = Globals {
            gain,
            gain_relative_std: (std / gain).hypot(reference),
            ..self
        };
        match given.material {
            Material::Conductor { .. } => own,
            Material::Dielectric { .. } => own.with(Which::Stray, (stray / gain, stray_std / gain)),
        }
    }

    /// Returns one of the values with its standard uncertainty.
    pub(in crate::map) fn get(&self, which: Which) -> (f64, f64) {
        match which {
            Which::Gain => (self.gain, self.gain * self.gain_relative_std),
            Which::Stray => (self.stray, self.stray_std),
            Which::Tilt => (self.tilt_offset.rad(), self.tilt_offset_std.rad()),
        }
    }

    /// Returns the values with another one of them.
    pub(in crate::map) fn with(mut self, which: Which, (value, std): (f64, f64)) -> Self {
        match which {
            Which::Gain => (self.gain, self.gain_relative_std) = (value, std / value),
            Which::Stray => (self.stray, self.stray_std) = (value, std),
            Which::Tilt => {
                self.tilt_offset = Angle::from_rad(value);
                self.tilt_offset_std = Angle::from_rad(std);
            }
        }
        self
    }
}

/// One of the shared quantities.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::map) enum Which {
    Gain,
    Stray,
    Tilt,
}
