//! Allowed values of the quantities of a rig, a camera, a white reference and a sample: one table for the manifest of
//! a recorded series, the daemon's settings and the options of a prediction.
//!
//! A quantity has one [`Limit`], the widest that a recorded series may rightly hold; readers check it with
//! [`Limit::holds`]. Where two readers differ on purpose there are two limits, and the second states the reason. The
//! module knows neither where a value was written nor how a refusal is worded there.

/// The allowed values of a quantity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Limit {
    /// Its key with its unit, as in files; options have `-` for `_`.
    pub name: &'static str,
    /// Lower end of the range.
    pub low: f64,
    /// Whether `low` itself is excluded.
    pub above_low: bool,
    /// Upper end of the range.
    pub high: f64,
    /// What to write instead.
    pub remedy: &'static str,
}

impl Limit {
    const fn within(name: &'static str, low: f64, high: f64, remedy: &'static str) -> Limit {
        Limit {
            name,
            low,
            above_low: false,
            high,
            remedy,
        }
    }

    const fn above_0(name: &'static str, high: f64, remedy: &'static str) -> Limit {
        Limit {
            name,
            low: 0.0,
            above_low: true,
            high,
            remedy,
        }
    }

    /// Returns the same quantity with the range `low` to `high`.
    const fn narrowed(self, low: f64, high: f64) -> Limit {
        Limit {
            low,
            above_low: false,
            high,
            ..self
        }
    }

    /// Whether `value` is allowed; a NaN is not.
    #[must_use]
    pub fn holds(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value) && !(self.above_low && value == self.low)
    }

    /// Returns the range in words: `0 to 90`, `above 0 and at most 1.2`.
    #[must_use]
    pub fn allowed(&self) -> String {
        let Limit { low, high, .. } = self;
        match self.above_low {
            true => format!("above {low} and at most {high}"),
            false => format!("{low} to {high}"),
        }
    }
}

const ANGLE: &str = "expected an angle between 0° and 90°";
const ANGLE_STD: &str = "write the standard uncertainty in degrees";
const COUNT: &str = "expected a number between 1 and 65535";
const FINITE: &str = "write a finite number";
const FROM_0: &str = "write it from 0";
const POSITIVE: &str = "write a number above 0";
const TURN: &str = "write it within a turn, −360° to 360°";

/// Angle between lamp and camera; 0 is a lamp in the camera's axis.
pub const THETA_L_DEG: Limit = Limit::within("theta_l_deg", 0.0, 90.0, ANGLE);
/// Half angle of the lamp seen from the sample.
pub const LIGHT_ANGULAR_RADIUS_DEG: Limit =
    Limit::within("light_angular_radius_deg", 0.0, 90.0, ANGLE);
/// Half angle of the lens's pupil seen from the sample.
pub const LENS_ANGULAR_RADIUS_DEG: Limit =
    Limit::within("lens_angular_radius_deg", 0.0, 90.0, ANGLE);
/// Azimuth of the lamp about the camera's axis.
pub const LIGHT_AZIMUTH_DEG: Limit = Limit::within("light_azimuth_deg", -360.0, 360.0, TURN);
/// Angle to add to the recorded φs for the azimuth of v.
pub const AZIMUTH_ZERO_DEG: Limit = Limit::within("azimuth_zero_deg", -360.0, 360.0, TURN);
/// Standard uncertainty of that angle; a larger one carries no information.
pub const AZIMUTH_ZERO_STD_DEG: Limit =
    Limit::within("azimuth_zero_std_deg", 0.0, 180.0, ANGLE_STD);
/// An azimuth of a recorded series. Other programs count full turns, so it may exceed 360°.
pub const RECORDED_AZIMUTH: Limit = Limit::within("azimuth_deg", -1e6, 1e6, FINITE);
/// Standard uncertainty of the inclination of the sample's mean plane to the turntable.
pub const SAMPLE_WEDGE_STD_DEG: Limit = Limit::within("sample_wedge_std_deg", 0.0, 10.0, ANGLE_STD);
/// Standard uncertainty of the angle between lamp and camera.
pub const THETA_L_STD_DEG: Limit = Limit::within("theta_l_std_deg", 0.0, 10.0, ANGLE_STD);
/// Wavelength of the lamp, from the far ultraviolet to the far infrared.
pub const WAVELENGTH_NM: Limit =
    Limit::within("wavelength_nm", 100.0, 1e5, "write it in nanometres");
/// Column or row of the rotation axis, of the centre of tilt or of the principal point, which may lie outside the picture.
pub const ROTATION_AXIS_PX: Limit = Limit::within("rotation_axis_px", -1e6, 1e6, FINITE);
/// From the centre of tilt to lamp or pupil.
pub const DISTANCE_MM: Limit = Limit::above_0("distance_mm", 1e9, POSITIVE);
/// Radius of lamp or pupil; 0 is a point.
pub const RADIUS_MM: Limit = Limit::within("radius_mm", 0.0, 1e9, FROM_0);

/// Columns or rows of a frame.
pub const SIZE_PX: Limit = Limit::within("size_px", 1.0, 65535.0, COUNT);
/// Count at which a pixel is full.
pub const SATURATION_DN: Limit = Limit::within("saturation_dn", 1.0, 65535.0, COUNT);
/// Width or height of the field, or of a patch of a sample's board.
pub const FIELD_MM: Limit = Limit::above_0("field_mm", 1e6, POSITIVE);
/// Counts per electron.
pub const GAIN_DN_PER_ELECTRON: Limit = Limit::above_0("gain_dn_per_electron", 1e6, POSITIVE);
/// Bits of the converter.
pub const BIT_DEPTH: Limit = Limit::within("bit_depth", 1.0, 16.0, "frames have 1 to 16 bits");
/// Count without light.
pub const BLACK_LEVEL_DN: Limit = Limit::within("black_level_dn", 0.0, 65535.0, FROM_0);
/// Read noise.
pub const READ_NOISE_ELECTRONS_RMS: Limit =
    Limit::within("read_noise_electrons_rms", 0.0, 65535.0, FROM_0);

/// Diffuse reflectance of the white reference. A reference that is brighter than a perfect diffuser in some directions
/// is certified above 1.
pub const FLAT_REFLECTANCE: Limit = Limit::above_0(
    "reflectance",
    1.2,
    "a diffuse reflectance is above 0 and at most 1.2",
);
/// Its standard uncertainty.
pub const FLAT_REFLECTANCE_STD: Limit = Limit::within(
    "reflectance_std",
    0.0,
    1.0,
    "write the standard uncertainty, not per cent",
);
/// The same in the settings of a rig, which apply to every scan: it was measured, so it is not 0, and a reference whose
/// reflectance is uncertain by half of it is unusable.
pub const RIGS_REFLECTANCE_STD: Limit = Limit {
    above_low: true,
    ..FLAT_REFLECTANCE_STD.narrowed(0.0, 0.5)
};

/// Exposure time of a lit frame.
pub const EXPOSURE_S: Limit = Limit::within(
    "exposure_s",
    1e-6,
    3600.0,
    "write the exposure time in seconds",
);

/// Relative standard uncertainty of an exposure time.
pub const EXPOSURE_REL_STD: Limit = Limit::within(
    "exposure_rel_std",
    0.0,
    0.1,
    "write a share of the exposure time, not per cent",
);

/// Index of a plastic.
pub const INDEX_OF_REFRACTION: Limit =
    Limit::within("index_of_refraction", 1.0, 10.0, "expected 1 to 10");
/// Real part of a sample's index.
pub const SAMPLE_ETA: Limit = Limit::above_0("eta", 1e6, POSITIVE);
/// Imaginary part of a sample's index, or the uncertainty of a part.
pub const SAMPLE_K: Limit = Limit::within("k", 0.0, 50.0, FROM_0);
/// Index of a plastic sample on the rig; an index of 1 reflects nothing.
pub const RIGS_INDEX: Limit = INDEX_OF_REFRACTION.narrowed(1.0001, 10.0);
/// Real part of a metal sample's index on the rig.
pub const RIGS_ETA: Limit = SAMPLE_ETA.narrowed(0.01, 100.0);
/// Share of a translucent body's light that leaves evenly over the ridges.
pub const TRANSLUCENCY: Limit = Limit::within(
    "translucency",
    0.0,
    1.0,
    "write a share: 0 for an opaque body, 1 for a body all of whose light leaves evenly",
);
/// Standard uncertainty of that share.
pub const TRANSLUCENCY_STD: Limit = Limit::within(
    "translucency_std",
    0.001,
    1.0,
    "write the standard uncertainty of the share; 0.05 is assumed without one",
);
/// Distance from ridge to ridge.
pub const PITCH_LENGTH_UM: Limit = Limit::above_0("pitch_length_um", 1e6, POSITIVE);

/// Angle between lamp and camera of a prediction: closed forms end at 1.5 rad (`model::domain`); a recorded series may
/// have larger angles.
pub const PREDICTED_THETA_L_DEG: Limit = THETA_L_DEG.narrowed(0.0, 80.0);
/// Half angle of a predicted lamp. No measurement shows how well wider lamps are predicted.
pub const PREDICTED_LIGHT_ANGULAR_RADIUS_DEG: Limit = LIGHT_ANGULAR_RADIUS_DEG.narrowed(0.0, 10.0);
/// Half angle of a predicted lens, for the same reason.
pub const PREDICTED_LENS_ANGULAR_RADIUS_DEG: Limit = LENS_ANGULAR_RADIUS_DEG.narrowed(0.0, 30.0);
/// Real part of the index of a predicted surface: from air in glass to the largest value in the tables of metals.
pub const PREDICTED_ETA: Limit = SAMPLE_ETA.narrowed(1e-3, 1e3);
/// Imaginary part of the index of a predicted surface, including metals in the infrared.
pub const PREDICTED_K: Limit = SAMPLE_K.narrowed(0.0, 1e3);
/// Ridge angle of a surface that a simulated rig renders.
pub const PAINTED_RIDGE_DEG: Limit = Limit::within("theta_r_deg", 0.0, 40.0, ANGLE);
/// Roughness of a surface that a simulated rig renders.
pub const PAINTED_ALPHA: Limit = ALPHA.narrowed(0.01, 0.6);
/// Roughness of a predicted surface.
pub const ALPHA: Limit = Limit::within("alpha", 1e-4, 10.0, POSITIVE);
/// Diffuse reflectance of a predicted surface.
pub const RHO_D: Limit = Limit::within("rho_d", 0.0, 1.0, "write a share, not per cent");
/// Tilt at which a radiance is predicted.
pub const THETA_C_DEG: Limit = Limit::within(
    "theta_c_deg",
    -89.0,
    89.0,
    "the camera must stay above the surface",
);
/// Ridge angle for which a radiance is predicted.
pub const THETA_R_DEG: Limit = Limit::within("theta_r_deg", 0.0, 60.0, "write it in degrees");

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_belongs_to_a_limit_unless_it_is_open() {
        assert!(THETA_L_DEG.holds(0.0) && THETA_L_DEG.holds(90.0));
        assert!(!THETA_L_DEG.holds(90.1) && !THETA_L_DEG.holds(f64::NAN));
        assert!(!FLAT_REFLECTANCE.holds(0.0) && FLAT_REFLECTANCE.holds(1.2));
        assert!(FLAT_REFLECTANCE.holds(f64::MIN_POSITIVE));
        assert!(!RIGS_REFLECTANCE_STD.holds(0.0) && RIGS_REFLECTANCE_STD.holds(0.5));
    }

    #[test]
    fn the_words_of_a_limit_show_its_open_end() {
        assert_eq!(THETA_L_DEG.allowed(), "0 to 90");
        assert_eq!(FLAT_REFLECTANCE.allowed(), "above 0 and at most 1.2");
        assert!(
            FLAT_REFLECTANCE
                .remedy
                .ends_with(&FLAT_REFLECTANCE.allowed())
        );
    }

    #[test]
    fn what_is_predicted_has_a_radiance() {
        for limit in [
            PREDICTED_THETA_L_DEG,
            PREDICTED_LIGHT_ANGULAR_RADIUS_DEG,
            PREDICTED_LENS_ANGULAR_RADIUS_DEG,
        ] {
            assert!(limit.high.to_radians() <= 1.5, "{}", limit.name);
        }
    }
}
