//! Ranges of all numeric settings: those of the rig come from [`limits`], the others are defined here.

use super::Config;
use crate::limits::{self, Limit};

/// A numeric setting: key, range, and access to its value.
type Bounded = (&'static str, Limit, fn(&Config) -> Option<f64>);

/// Every setting with a range.
#[rustfmt::skip]
pub(super) const BOUNDED: &[Bounded] = &[
    ("store.reserve_mb", within(1.0, 1e6), |c| Some(c.store.reserve_mb as f64)),
    ("rig.theta_l_deg", limits::THETA_L_DEG, |c| Some(c.rig.theta_l_deg)),
    ("rig.light_azimuth_deg", limits::LIGHT_AZIMUTH_DEG, |c| Some(c.rig.light_azimuth_deg)),
    ("rig.azimuth_zero_deg", limits::AZIMUTH_ZERO_DEG, |c| Some(c.rig.azimuth_zero_deg)),
    ("rig.azimuth_zero_std_deg", limits::AZIMUTH_ZERO_STD_DEG, |c| c.rig.azimuth_zero_std_deg),
    ("rig.rotation_axis_px", limits::ROTATION_AXIS_PX, |c| c.rig.rotation_axis_px.map(|at| at[0])),
    ("rig.rotation_axis_px", limits::ROTATION_AXIS_PX, |c| c.rig.rotation_axis_px.map(|at| at[1])),
    ("rig.tilt_centre_px", limits::ROTATION_AXIS_PX, |c| c.rig.tilt_centre_px.map(|at| at[0])),
    ("rig.tilt_centre_px", limits::ROTATION_AXIS_PX, |c| c.rig.tilt_centre_px.map(|at| at[1])),
    ("camera.principal_point_px", limits::ROTATION_AXIS_PX, |c| c.camera.principal_point_px.map(|at| at[0])),
    ("camera.principal_point_px", limits::ROTATION_AXIS_PX, |c| c.camera.principal_point_px.map(|at| at[1])),
    ("rig.theta_l_std_deg", limits::THETA_L_STD_DEG, |c| c.rig.theta_l_std_deg),
    ("rig.theta_c_std_deg", limits::THETA_L_STD_DEG, |c| c.rig.theta_c_std_deg),
    ("rig.phi_s_std_deg", limits::THETA_L_STD_DEG, |c| c.rig.phi_s_std_deg),
    ("rig.lamp_drift_std", limits::FLAT_REFLECTANCE_STD, |c| c.rig.lamp_drift_std),
    ("rig.sample_wedge_std_deg", limits::SAMPLE_WEDGE_STD_DEG, |c| c.rig.sample_wedge_std_deg),
    ("rig.light_angular_radius_deg", limits::LIGHT_ANGULAR_RADIUS_DEG, |c| c.rig.light_angular_radius_deg),
    ("rig.lens_angular_radius_deg", limits::LENS_ANGULAR_RADIUS_DEG, |c| c.rig.lens_angular_radius_deg),
    ("rig.wavelength_nm", limits::WAVELENGTH_NM, |c| Some(c.rig.wavelength_nm)),
    ("rig.light_distance_mm", limits::DISTANCE_MM, |c| c.rig.light_distance_mm),
    ("rig.light_radius_mm", limits::RADIUS_MM, |c| c.rig.light_radius_mm),
    ("rig.camera_distance_mm", limits::DISTANCE_MM, |c| c.rig.camera_distance_mm),
    ("rig.lens_radius_mm", limits::RADIUS_MM, |c| c.rig.lens_radius_mm),
    ("camera.timeout_s", within(0.1, 3600.0), |c| Some(c.camera.timeout_s)),
    ("camera.width_px", limits::SIZE_PX, |c| Some(f64::from(c.camera.width_px))),
    ("camera.height_px", limits::SIZE_PX, |c| Some(f64::from(c.camera.height_px))),
    ("camera.field_width_mm", limits::FIELD_MM, |c| c.camera.field_width_mm),
    ("camera.field_height_mm", limits::FIELD_MM, |c| c.camera.field_height_mm),
    ("camera.bit_depth", limits::BIT_DEPTH, |c| Some(f64::from(c.camera.bit_depth))),
    ("camera.saturation_dn", limits::SATURATION_DN, |c| c.camera.saturation_dn),
    ("camera.gain_dn_per_electron", limits::GAIN_DN_PER_ELECTRON, |c| Some(c.camera.gain_dn_per_electron)),
    ("camera.black_level_dn", limits::BLACK_LEVEL_DN, |c| Some(c.camera.black_level_dn)),
    ("camera.read_noise_electrons_rms", limits::READ_NOISE_ELECTRONS_RMS, |c| Some(c.camera.read_noise_electrons_rms)),
    ("camera.exposure_rel_std", limits::EXPOSURE_REL_STD, |c| c.camera.exposure_rel_std),
    ("camera.dark_current_electrons_per_s", within(0.0, 1e6), |c| Some(c.camera.dark_current_electrons_per_s)),
    ("flat.reflectance", limits::FLAT_REFLECTANCE, |c| Some(c.flat.reflectance)),
    ("flat.reflectance_std", limits::RIGS_REFLECTANCE_STD, |c| Some(c.flat.reflectance_std)),
    ("flat.repeats", within(0.0, 1000.0), |c| Some(f64::from(c.flat.repeats))),
    ("flat.valid_h", within(0.0, 8760.0), |c| Some(c.flat.valid_h)),
    ("dark.repeats", within(0.0, 1000.0), |c| Some(f64::from(c.dark.repeats))),
    ("dark.valid_h", within(0.0, 8760.0), |c| Some(c.dark.valid_h)),
    ("hooks.time_limit_s", within(0.1, 600.0), |c| Some(c.hooks.time_limit_s)),
    ("lamp.time_limit_s", within(0.1, 3600.0), |c| Some(c.lamp.time_limit_s)),
    ("scan.attempts_max", within(1.0, 100.0), |c| Some(f64::from(c.scan.attempts_max))),
    ("scan.retry_after_s", within(0.0, 3600.0), |c| Some(c.scan.retry_after_s)),
    ("scan.retry_after_max_s", within(0.0, 3600.0), |c| Some(c.scan.retry_after_max_s)),
    ("scan.reconnect_for_s", within(0.0, 86_400.0), |c| Some(c.scan.reconnect_for_s)),
    ("scan.reference_every", within(0.0, 1e6), |c| Some(f64::from(c.scan.reference_every))),
    ("scan.reference_time_share", within(0.0, 10.0), |c| Some(c.scan.reference_time_share)),
    ("scan.reference_change_max", within(0.001, 1.0), |c| Some(c.scan.reference_change_max)),
    ("scan.unlit_share_max", within(0.01, 10.0), |c| Some(c.scan.unlit_share_max)),
    ("scan.suspend_times_max", within(0.0, 1000.0), |c| Some(f64::from(c.scan.suspend_times_max))),
    ("scan.suspend_calm_s", within(0.0, 3600.0), |c| Some(c.scan.suspend_calm_s)),
    ("scan.suspend_for_max_s", within(1.0, 86_400.0), |c| Some(c.scan.suspend_for_max_s)),
    ("camera.clock_tolerance_s", within(0.0, 3600.0), |c| Some(c.camera.clock_tolerance_s)),
    ("camera.temperature_c", within(-273.0, 200.0), |c| c.camera.temperature_c),
    ("camera.temperature_tolerance_k", within(0.01, 100.0), |c| Some(c.camera.temperature_tolerance_k)),
    ("due.check_standard_every_days", days(), |c| c.due.check_standard_every_days),
    ("due.references_every_days", days(), |c| c.due.references_every_days),
    ("scan.capped_mean_dn_max", within(0.0, 65535.0), |c| Some(c.scan.capped_mean_dn_max)),
];

/// A limit of a quantity that only the daemon has.
const fn within(low: f64, high: f64) -> Limit {
    Limit {
        name: "",
        low,
        above_low: false,
        high,
        remedy: "",
    }
}

/// An interval of up to ten years.
const fn days() -> Limit {
    Limit {
        above_low: true,
        ..within(0.0, 3650.0)
    }
}
