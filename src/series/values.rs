//! What the values of a manifest may be: each in its range, then what belongs together.

use super::check::Problem;
use super::manifest::{Manifest, SCHEMA, SampleKind};
use super::rows::path_problem;

/// What a value must be that is only bounded to be a number, and to be more than nothing.
const FINITE: &str = "write a finite number";
const POSITIVE: &str = "write a number above 0";

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

/// Section, least and largest value, remedy, and the values that are bounded so.
type Group<'a> = (
    &'static str,
    f64,
    f64,
    &'static str,
    &'a [(&'static str, Option<f64>)],
);

fn ranges(manifest: &Manifest) -> Result<(), Problem> {
    let (rig, camera, sample) = (&manifest.rig, &manifest.camera, &manifest.sample);
    let flat = manifest.flat.as_ref();
    let tiny = f64::MIN_POSITIVE;
    let axis = |i: usize| rig.rotation_axis_px.map(|a| a[i]);
    let groups: [Group<'_>; 16] = [
        (
            "rig",
            0.0,
            90.0,
            "an angle between 0° and 90° stands here",
            &[
                ("theta_l_deg", Some(rig.theta_l_deg)),
                ("light_angular_radius_deg", rig.light_angular_radius_deg),
                ("lens_angular_radius_deg", rig.lens_angular_radius_deg),
            ],
        ),
        (
            "rig",
            -1e6,
            1e6,
            FINITE,
            &[
                ("light_azimuth_deg", Some(rig.light_azimuth_deg)),
                ("azimuth_zero_deg", Some(rig.azimuth_zero_deg)),
                ("rotation_axis_px", axis(0)),
                ("rotation_axis_px", axis(1)),
            ],
        ),
        (
            "rig",
            100.0,
            1e5,
            "write it in nanometres",
            &[("wavelength_nm", rig.wavelength_nm)],
        ),
        (
            "rig",
            tiny,
            1e9,
            POSITIVE,
            &[
                ("light_distance_mm", rig.light_distance_mm),
                ("camera_distance_mm", rig.camera_distance_mm),
            ],
        ),
        (
            "rig",
            0.0,
            1e9,
            "write it from 0",
            &[
                ("light_radius_mm", rig.light_radius_mm),
                ("lens_radius_mm", rig.lens_radius_mm),
            ],
        ),
        (
            "camera",
            1.0,
            65535.0,
            "a number between 1 and 65535 stands here",
            &[
                ("width_px", Some(f64::from(camera.width_px))),
                ("height_px", Some(f64::from(camera.height_px))),
                ("saturation_dn", camera.saturation_dn),
            ],
        ),
        (
            "camera",
            tiny,
            1e6,
            POSITIVE,
            &[
                ("field_width_mm", camera.field_width_mm),
                ("field_height_mm", camera.field_height_mm),
                ("gain_dn_per_electron", Some(camera.gain_dn_per_electron)),
            ],
        ),
        (
            "camera",
            1.0,
            16.0,
            "frames have 1 to 16 bits",
            &[("bit_depth", camera.bit_depth.map(f64::from))],
        ),
        (
            "camera",
            0.0,
            65535.0,
            "write it from 0",
            &[
                ("black_level_dn", camera.black_level_dn),
                ("read_noise_electrons_rms", camera.read_noise_electrons_rms),
            ],
        ),
        (
            "flat",
            1e-3,
            1.2,
            "a diffuse reflectance lies between 0 and 1",
            &[("reflectance", flat.and_then(|f| f.reflectance))],
        ),
        (
            "flat",
            0.0,
            1.0,
            "write the standard uncertainty, not per cent",
            &[("reflectance_std", flat.and_then(|f| f.reflectance_std))],
        ),
        (
            "rig",
            0.0,
            10.0,
            "write the standard uncertainty in degrees",
            &[("sample_wedge_std_deg", rig.sample_wedge_std_deg)],
        ),
        (
            "sample",
            1.0,
            10.0,
            "n lies from 1 to 10",
            &[("index_of_refraction", sample.index_of_refraction)],
        ),
        (
            "sample",
            tiny,
            1e6,
            POSITIVE,
            &[
                ("eta", sample.eta),
                ("pitch_length_um", sample.pitch_length_um),
            ],
        ),
        (
            "sample",
            0.0,
            50.0,
            "write it from 0",
            &[
                ("k", sample.k),
                ("index_of_refraction_std", sample.index_of_refraction_std),
                ("eta_std", sample.eta_std),
                ("k_std", sample.k_std),
            ],
        ),
        (
            "sample.layout",
            tiny,
            1e6,
            POSITIVE,
            &[(
                "patch_size_mm",
                sample.layout.as_ref().map(|l| l.patch_size_mm),
            )],
        ),
    ];
    for (section, low, high, remedy, values) in groups {
        for (key, value) in values {
            if value.is_some_and(|x| !x.is_finite() || x < low || x > high) {
                let value = value.unwrap_or(f64::NAN);
                let most = match value > high {
                    true => format!(" (at most {})", short(high)),
                    false => String::new(),
                };
                return wrong(
                    section,
                    key,
                    format!("{} is out of range{most}", short(value)),
                    remedy,
                );
            }
        }
    }
    Ok(())
}

/// A finite distance is stated, and a lens has one that its angle follows from.
fn distances(manifest: &Manifest) -> Result<(), Problem> {
    let (rig, camera) = (&manifest.rig, &manifest.camera);
    for (key, distance, distance_mm) in [
        ("light_distance", &rig.light_distance, rig.light_distance_mm),
        (
            "camera_distance",
            &rig.camera_distance,
            rig.camera_distance_mm.or(camera.camera_distance_mm),
        ),
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
    let pupil = rig.camera_distance_mm.or(camera.camera_distance_mm);
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

fn material(manifest: &Manifest) -> Result<(), Problem> {
    let sample = &manifest.sample;
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
                FINITE,
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
