//! Checks the values of a manifest: each in its range, then those that must agree.

use super::SeriesError;
use super::manifest::{Manifest, SCHEMA, SampleKind, is_lean};
use super::rows::path_problem;
use super::text::{line_of, path_of};
use crate::limits::{self, Limit};

/// An invalid value.
#[derive(Debug)]
pub(super) struct Problem {
    pub section: &'static str,
    pub key: &'static str,
    pub cause: String,
    pub remedy: &'static str,
}

impl Problem {
    pub(super) fn error(self, text: &str, file: &str) -> SeriesError {
        SeriesError::Invalid {
            file: file.to_owned(),
            line: line_of(text, self.section, self.key),
            key: format!("{}: ", path_of(self.section, self.key)),
            cause: self.cause,
            remedy: self.remedy.to_owned(),
        }
    }
}

/// Checks every value.
///
/// # Errors
/// The first that is wrong.
pub(super) fn check(manifest: &Manifest) -> Result<(), Problem> {
    form(manifest)?;
    ranges(manifest)?;
    distances(manifest)?;
    camera(manifest)?;
    material(manifest)?;
    layout(manifest)
}

fn wrong(
    section: &'static str,
    key: &'static str,
    cause: String,
    remedy: &'static str,
) -> Result<(), Problem> {
    Err(Problem {
        section,
        key,
        cause,
        remedy,
    })
}

fn form(manifest: &Manifest) -> Result<(), Problem> {
    if manifest.schema != SCHEMA {
        return wrong(
            "",
            "schema",
            format!("`{}` is another form", manifest.schema),
            "this program reads gonio-series-1",
        );
    }
    if let Some(cause) = path_problem(&manifest.frames) {
        return wrong(
            "",
            "frames",
            format!("`{}` {cause}", manifest.frames),
            "name a file in the series' folder",
        );
    }
    Ok(())
}

/// A value of a manifest: section, key, what it may be, and where it stands.
type Bounded = (
    &'static str,
    &'static str,
    Limit,
    fn(&Manifest) -> Option<f64>,
);

/// Every value that has a least and a greatest.
#[rustfmt::skip]
const BOUNDED: &[Bounded] = &[
    ("rig", "theta_l_deg", limits::THETA_L_DEG, |m| Some(m.rig.theta_l_deg)),
    ("rig", "light_angular_radius_deg", limits::LIGHT_ANGULAR_RADIUS_DEG, |m| m.rig.light_angular_radius_deg),
    ("rig", "lens_angular_radius_deg", limits::LENS_ANGULAR_RADIUS_DEG, |m| m.rig.lens_angular_radius_deg),
    ("rig", "light_azimuth_deg", limits::RECORDED_AZIMUTH, |m| Some(m.rig.light_azimuth_deg)),
    ("rig", "azimuth_zero_deg", limits::RECORDED_AZIMUTH, |m| Some(m.rig.azimuth_zero_deg)),
    ("rig", "rotation_axis_px", limits::ROTATION_AXIS_PX, |m| m.rig.rotation_axis_px.map(|at| at[0])),
    ("rig", "rotation_axis_px", limits::ROTATION_AXIS_PX, |m| m.rig.rotation_axis_px.map(|at| at[1])),
    ("rig", "azimuth_zero_std_deg", limits::AZIMUTH_ZERO_STD_DEG, |m| m.rig.azimuth_zero_std_deg),
    ("rig", "tilt_centre_px", limits::ROTATION_AXIS_PX, |m| m.rig.tilt_centre_px.map(|at| at[0])),
    ("rig", "tilt_centre_px", limits::ROTATION_AXIS_PX, |m| m.rig.tilt_centre_px.map(|at| at[1])),
    ("camera", "principal_point_px", limits::ROTATION_AXIS_PX, |m| m.camera.principal_point_px.map(|at| at[0])),
    ("camera", "principal_point_px", limits::ROTATION_AXIS_PX, |m| m.camera.principal_point_px.map(|at| at[1])),
    ("rig", "wavelength_nm", limits::WAVELENGTH_NM, |m| m.rig.wavelength_nm),
    ("rig", "light_distance_mm", limits::DISTANCE_MM, |m| m.rig.light_distance_mm),
    ("rig", "camera_distance_mm", limits::DISTANCE_MM, |m| m.rig.camera_distance_mm),
    ("rig", "light_radius_mm", limits::RADIUS_MM, |m| m.rig.light_radius_mm),
    ("rig", "lens_radius_mm", limits::RADIUS_MM, |m| m.rig.lens_radius_mm),
    ("rig", "theta_l_std_deg", limits::THETA_L_STD_DEG, |m| m.rig.theta_l_std_deg),
    ("rig", "theta_c_std_deg", limits::THETA_L_STD_DEG, |m| m.rig.theta_c_std_deg),
    ("rig", "phi_s_std_deg", limits::THETA_L_STD_DEG, |m| m.rig.phi_s_std_deg),
    ("rig", "lamp_drift_std", limits::FLAT_REFLECTANCE_STD, |m| m.rig.lamp_drift_std),
    ("rig", "sample_wedge_std_deg", limits::SAMPLE_WEDGE_STD_DEG, |m| m.rig.sample_wedge_std_deg),
    ("camera", "width_px", limits::SIZE_PX, |m| Some(f64::from(m.camera.width_px))),
    ("camera", "height_px", limits::SIZE_PX, |m| Some(f64::from(m.camera.height_px))),
    ("camera", "saturation_dn", limits::SATURATION_DN, |m| m.camera.saturation_dn),
    ("camera", "field_width_mm", limits::FIELD_MM, |m| m.camera.field_width_mm),
    ("camera", "field_height_mm", limits::FIELD_MM, |m| m.camera.field_height_mm),
    ("camera", "gain_dn_per_electron", limits::GAIN_DN_PER_ELECTRON, |m| Some(m.camera.gain_dn_per_electron)),
    ("camera", "bit_depth", limits::BIT_DEPTH, |m| m.camera.bit_depth.map(f64::from)),
    ("camera", "black_level_dn", limits::BLACK_LEVEL_DN, |m| m.camera.black_level_dn),
    ("camera", "read_noise_electrons_rms", limits::READ_NOISE_ELECTRONS_RMS, |m| m.camera.read_noise_electrons_rms),
    ("camera", "exposure_rel_std", limits::EXPOSURE_REL_STD, |m| m.camera.exposure_rel_std),
    ("flat", "reflectance", limits::FLAT_REFLECTANCE, |m| m.flat.as_ref()?.reflectance),
    ("flat", "reflectance_std", limits::FLAT_REFLECTANCE_STD, |m| m.flat.as_ref()?.reflectance_std),
    ("sample", "index_of_refraction", limits::INDEX_OF_REFRACTION, |m| m.sample.index_of_refraction),
    ("sample", "index_of_refraction_std", limits::SAMPLE_K, |m| m.sample.index_of_refraction_std),
    ("sample", "eta", limits::SAMPLE_ETA, |m| m.sample.eta),
    ("sample", "eta_std", limits::SAMPLE_K, |m| m.sample.eta_std),
    ("sample", "k", limits::SAMPLE_K, |m| m.sample.k),
    ("sample", "k_std", limits::SAMPLE_K, |m| m.sample.k_std),
    ("sample", "pitch_length_um", limits::PITCH_LENGTH_UM, |m| m.sample.pitch_length_um),
    ("sample", "translucency", limits::TRANSLUCENCY, |m| m.sample.translucency),
    ("sample", "translucency_std", limits::TRANSLUCENCY_STD, |m| m.sample.translucency_std),
    ("sample.layout", "patch_size_mm", limits::FIELD_MM, |m| Some(m.sample.layout.as_ref()?.patch_size_mm)),
];

fn ranges(manifest: &Manifest) -> Result<(), Problem> {
    for (section, key, limit, of) in BOUNDED {
        let Some(value) = of(manifest).filter(|value| !limit.holds(*value)) else {
            continue;
        };
        let most = match value > limit.high {
            true => format!(" (at most {})", short(limit.high)),
            false => String::new(),
        };
        let cause = format!("{} is out of range{most}", short(value));
        return wrong(section, key, cause, limit.remedy);
    }
    Ok(())
}

/// A finite distance is stated, and a lens has one that its angle follows from.
fn distances(manifest: &Manifest) -> Result<(), Problem> {
    let rig = &manifest.rig;
    let pupil = manifest.camera_distance_mm();
    for (key, distance, distance_mm) in [
        ("light_distance", &rig.light_distance, rig.light_distance_mm),
        ("camera_distance", &rig.camera_distance, pupil),
    ] {
        match distance.as_deref() {
            None | Some("infinity") => {}
            Some("finite") if distance_mm.is_some() => {}
            Some("finite") => {
                return wrong(
                    "rig",
                    key,
                    format!("it is finite and `{key}_mm` is missing"),
                    "write the distance in millimetres from the centre of tilt",
                );
            }
            Some(other) => {
                return wrong(
                    "rig",
                    key,
                    format!("`{other}` is unknown"),
                    "a distance is \"infinity\" or \"finite\"",
                );
            }
        }
    }
    if rig.lens_radius_mm.is_some() && pupil.is_none() && rig.lens_angular_radius_deg.is_none() {
        return wrong(
            "rig",
            "lens_radius_mm",
            "it spans no angle without `camera_distance_mm`".into(),
            "write the distance, or lens_angular_radius_deg",
        );
    }
    Ok(())
}

fn camera(manifest: &Manifest) -> Result<(), Problem> {
    let camera = &manifest.camera;
    if !["orthographic", "perspective"].contains(&camera.projection.as_str()) {
        return wrong(
            "camera",
            "projection",
            format!("`{}` is unknown", camera.projection),
            "a projection is \"orthographic\" or \"perspective\"",
        );
    }
    if camera
        .exposures_s
        .iter()
        .any(|e| !e.is_finite() || *e < 0.0)
    {
        return wrong(
            "camera",
            "exposures_s",
            "an exposure time is negative or not finite".into(),
            "write seconds",
        );
    }
    Ok(())
}

/// Values that do not fit each other, or words that say nothing. It is no part of [`check`]: what is in a store already
/// cannot be corrected any more, and is read as it was taken.
///
/// # Errors
/// The first that the others leave no room for.
pub(super) fn check_fit(manifest: &Manifest) -> Result<(), Problem> {
    one_distance(manifest)?;
    near(manifest)?;
    camera_fits(manifest)?;
    leans(manifest)
}

/// A distance is stated once, or twice the same.
fn one_distance(manifest: &Manifest) -> Result<(), Problem> {
    let (rig, camera) = (&manifest.rig, &manifest.camera);
    let endless = |word: &Option<String>| word.as_deref() == Some("infinity");
    let (light, lens) = (endless(&rig.light_distance), endless(&rig.camera_distance));
    for (section, key, word, beside) in [
        (
            "rig",
            "light_distance_mm",
            "light_distance",
            light && rig.light_distance_mm.is_some(),
        ),
        (
            "rig",
            "camera_distance_mm",
            "camera_distance",
            lens && rig.camera_distance_mm.is_some(),
        ),
        (
            "camera",
            "camera_distance_mm",
            "camera_distance",
            lens && camera.camera_distance_mm.is_some(),
        ),
    ] {
        if beside {
            return wrong(
                section,
                key,
                format!("rig.{word} = \"infinity\" says otherwise"),
                "leave out the one that is wrong",
            );
        }
    }
    match (rig.camera_distance_mm, camera.camera_distance_mm) {
        (Some(of_rig), Some(of_camera)) if of_rig != of_camera => wrong(
            "camera",
            "camera_distance_mm",
            format!(
                "{} contradicts rig.camera_distance_mm = {}",
                short(of_camera),
                short(of_rig)
            ),
            "leave out the one that is wrong",
        ),
        _ => Ok(()),
    }
}

/// What directions of single pixels need is stated.
fn near(manifest: &Manifest) -> Result<(), Problem> {
    let (rig, camera) = (&manifest.rig, &manifest.camera);
    let pupil = manifest.camera_distance_mm();
    let why = match (rig.light_distance_mm, pupil) {
        (Some(_), _) => "rig.light_distance_mm",
        (None, Some(_)) => "camera_distance_mm",
        (None, None) => "projection = \"perspective\"",
    };
    if camera.projection == "perspective" && pupil.is_none() && rig.camera_distance.is_none() {
        return wrong(
            "rig",
            "camera_distance_mm",
            "a camera with projection = \"perspective\" needs it and it is missing".into(),
            "write the distance of its pupil from the centre of tilt in millimetres, or projection = \"orthographic\" for a \
             telecentric lens",
        );
    }
    if !manifest.is_telecentric() && camera.field_width_mm.is_none() {
        return wrong(
            "camera",
            "field_width_mm",
            format!(
                "every pixel has its own directions for {why}, which needs it, and it is missing"
            ),
            "write the width of the field in millimetres, in the plane through the centre of tilt",
        );
    }
    let field_mm = match manifest.is_telecentric() {
        true => 0.0,
        false => camera.field_width_mm.unwrap_or(0.0),
    };
    let lamp = ("rig", "light_distance_mm", rig.light_distance_mm);
    let section = match rig.camera_distance_mm {
        Some(_) => "rig",
        None => "camera",
    };
    for (section, key, distance_mm) in [lamp, (section, "camera_distance_mm", pupil)] {
        if let Some(distance_mm) = distance_mm.filter(|d| *d < 0.5 * field_mm) {
            return wrong(
                section,
                key,
                format!(
                    "{} mm is less than half the width of the field ({} mm)",
                    short(distance_mm),
                    short(field_mm)
                ),
                "write the distance from the centre of tilt in millimetres",
            );
        }
    }
    if let Some(allowed) = manifest.misaimed() {
        return wrong(
            "camera",
            "principal_point_px",
            format!("the optical axis passes the centre of tilt too far off: allowed is {allowed}"),
            "write the foot of the optical axis in columns and rows, or leave it out",
        );
    }
    Ok(())
}

/// A lean direction that is stated can be read.
fn leans(manifest: &Manifest) -> Result<(), Problem> {
    let Some(layout) = &manifest.sample.layout else {
        return Ok(());
    };
    for (key, words) in [
        ("even_patches", &layout.even_patches),
        ("odd_patches", &layout.odd_patches),
    ] {
        if let Some(words) = words.as_deref().filter(|words| !is_lean(words)) {
            return wrong(
                "sample.layout",
                key,
                format!("no lean direction can be read from \"{words}\""),
                "write \"lean direction v at phi_s\", with an angle where there is one: \"v at phi_s + 90 deg\"",
            );
        }
    }
    Ok(())
}

fn camera_fits(manifest: &Manifest) -> Result<(), Problem> {
    match manifest.camera.contradiction() {
        None => Ok(()),
        Some(found) => wrong(
            "camera",
            found.key,
            format!(
                "{} does not fit: allowed is {}",
                short(found.value),
                found.allowed
            ),
            "correct the one that is wrong",
        ),
    }
}

fn material(manifest: &Manifest) -> Result<(), Problem> {
    let sample = &manifest.sample;
    if let (Some(metal), None) = (&sample.metal, manifest.rig.wavelength_nm) {
        return wrong(
            "rig",
            "wavelength_nm",
            format!("sample.metal = \"{metal}\" needs it and it is missing"),
            "write the lamp's wavelength in nm, or eta and k instead of the metal",
        );
    }
    if let Some(Err(cause)) = manifest.metal() {
        return wrong(
            "sample",
            "metal",
            cause,
            "name one of them and the lamp's wavelength, or write eta and k",
        );
    }
    match sample.kind {
        SampleKind::Dielectric if sample.metal.is_some() => {
            return wrong(
                "sample",
                "metal",
                "the sample's kind is dielectric".into(),
                "write kind = \"conductor\", or leave the metal out",
            );
        }
        SampleKind::Dielectric if sample.k.is_some_and(|k| k != 0.0) => {
            return wrong(
                "sample",
                "k",
                "only a conductor has it".into(),
                "leave it out (what a dielectric absorbs below its surface is part of rho_d), or write kind = \"conductor\"",
            );
        }
        // Under either of its names.
        SampleKind::Dielectric
            if sample
                .eta
                .is_some_and(|n| !limits::INDEX_OF_REFRACTION.holds(n)) =>
        {
            return wrong(
                "sample",
                "eta",
                format!("{} is out of range", sample.eta.unwrap_or_default()),
                limits::INDEX_OF_REFRACTION.remedy,
            );
        }
        SampleKind::Dielectric if sample.index_of_refraction.or(sample.eta).is_none() => {
            return wrong(
                "sample",
                "index_of_refraction",
                "a dielectric needs it and it is missing".into(),
                "write the index of the material, 1.5 for most plastics",
            );
        }
        SampleKind::Conductor
            if sample.metal.is_none() && (sample.eta.is_none() || sample.k.is_none()) =>
        {
            return wrong(
                "sample",
                if sample.eta.is_none() { "eta" } else { "k" },
                "a conductor needs it and it is missing".into(),
                "write the metal's eta and k at the lamp's wavelength, or its name as metal",
            );
        }
        _ => {}
    }
    Ok(())
}

fn layout(manifest: &Manifest) -> Result<(), Problem> {
    if let Some(layout) = &manifest.sample.layout {
        let patches = u64::from(layout.patches_x) * u64::from(layout.patches_y);
        if patches == 0 || patches > 10_000 {
            return wrong(
                "sample.layout",
                "patches_x",
                format!("{patches} patches make no board"),
                "write 1 to 10,000 patches",
            );
        }
        if !layout.centre_mm.iter().all(|c| c.is_finite()) {
            return wrong(
                "sample.layout",
                "centre_mm",
                "it is not finite".into(),
                "write a finite number",
            );
        }
        if manifest.camera.field_width_mm.is_none() {
            return wrong(
                "camera",
                "field_width_mm",
                "a sample with a layout needs it and it is missing".into(),
                "write the width of the field in millimetres",
            );
        }
    }
    Ok(())
}

/// A number in few digits, however large or small it is.
fn short(value: f64) -> String {
    if value == 0.0 || (1e-4..1e7).contains(&value.abs()) {
        format!("{value}")
    } else {
        format!("{value:e}")
    }
}
