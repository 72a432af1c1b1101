//! What a manifest may say: ranges, what belongs together, and which slip of the pen was meant.

use super::SeriesError;
use super::manifest::{Manifest, SCHEMA, SampleKind};
use super::rows::path_problem;
use super::text::{line_of, meant};

/// Known keys per section: what a misspelt key may have meant.
const KEYS: [(&str, &[&str]); 6] = [
    (
        "",
        &[
            "schema", "name", "frames", "rig", "camera", "flat", "dark", "sample",
        ],
    ),
    (
        "rig",
        &[
            "theta_l_deg",
            "light_azimuth_deg",
            "azimuth_zero_deg",
            "light_angular_radius_deg",
            "lens_angular_radius_deg",
            "wavelength_nm",
            "rotation_axis_px",
            "light_distance",
            "camera_distance",
            "light_distance_mm",
            "light_radius_mm",
            "camera_distance_mm",
            "lens_radius_mm",
        ],
    ),
    (
        "camera",
        &[
            "projection",
            "width_px",
            "height_px",
            "field_width_mm",
            "field_height_mm",
            "bit_depth",
            "saturation_dn",
            "gain_dn_per_electron",
            "black_level_dn",
            "read_noise_electrons_rms",
            "exposures_s",
        ],
    ),
    ("flat", &["reflectance", "reflectance_std"]),
    (
        "sample",
        &[
            "kind",
            "index_of_refraction",
            "index_of_refraction_std",
            "metal",
            "eta",
            "k",
            "eta_std",
            "k_std",
            "pitch_length_um",
            "layout",
        ],
    ),
    (
        "sample.layout",
        &[
            "patches_x",
            "patches_y",
            "patch_size_mm",
            "centre_mm",
            "even_patches",
            "odd_patches",
        ],
    ),
];

impl Manifest {
    /// Reads the text of a manifest and checks every value; `file` names it in errors.
    ///
    /// # Errors
    /// [`SeriesError::Invalid`] with line, key, cause and remedy of the first thing that is wrong.
    pub fn from_toml(text: &str, file: &str) -> Result<Self, SeriesError> {
        let text = text.trim_start_matches('\u{feff}');
        let table: toml::Table = toml::from_str(text).map_err(|error| SeriesError::Invalid {
            file: file.to_owned(),
            line: error.span().map(|span| line_at(text, span.start)),
            key: String::new(),
            cause: format!("this is no TOML: {}", one_line(error.message())),
            remedy: "repair the line".to_owned(),
        })?;
        slips(&table, text, file)?;
        let manifest: Manifest = toml::from_str(text).map_err(|error| {
            let line = error.span().map(|span| line_at(text, span.start));
            let message = one_line(error.message()).replace("f64", "a number");
            // A type error points at the value; a missing key only at its section.
            let key = line
                .filter(|_| !message.starts_with("missing"))
                .and_then(|n| text.lines().nth(n - 1))
                .and_then(|l| l.split_once('='))
                .map_or(String::new(), |(key, _)| format!("{}: ", key.trim()));
            SeriesError::Invalid {
                file: file.to_owned(),
                line,
                key,
                cause: message,
                remedy: "docs/series.md lists every key".to_owned(),
            }
        })?;
        manifest
            .validate()
            .map_err(|problem| SeriesError::Invalid {
                file: file.to_owned(),
                line: line_of(text, problem.section, problem.key),
                key: format!("{}: ", problem.path()),
                cause: problem.cause,
                remedy: problem.remedy.to_owned(),
            })?;
        Ok(manifest)
    }

    /// Checks ranges and what belongs together.
    ///
    /// # Errors
    /// The first value that is wrong.
    pub(super) fn validate(&self) -> Result<(), Problem> {
        let p = |section, key, cause: String, remedy| Problem {
            section,
            key,
            cause,
            remedy,
        };
        if self.schema != SCHEMA {
            return Err(p(
                "",
                "schema",
                format!("`{}` is another form", self.schema),
                "this program reads gonio-series-1",
            ));
        }
        if let Some(cause) = path_problem(&self.frames) {
            return Err(p(
                "",
                "frames",
                format!("`{}` {cause}", self.frames),
                "name a file in the series' folder",
            ));
        }
        let rig = &self.rig;
        let camera = &self.camera;
        let flat = self.flat.as_ref();
        let sample = &self.sample;
        let finite = "write a finite number";
        let positive = "write a number above 0";
        type Group<'a> = (
            &'static str,
            f64,
            f64,
            &'static str,
            &'a [(&'static str, Option<f64>)],
        );
        let tiny = f64::MIN_POSITIVE;
        let axis = |i: usize| rig.rotation_axis_px.map(|a| a[i]);
        let groups: [Group<'_>; 15] = [
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
                finite,
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
                positive,
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
                positive,
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
                positive,
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
                positive,
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
                    return Err(p(
                        section,
                        key,
                        format!("{} is out of range{most}", short(value)),
                        remedy,
                    ));
                }
            }
        }
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
                    return Err(p(
                        "rig",
                        key,
                        format!("it is finite and `{key}_mm` is missing"),
                        "write the distance in millimetres from the centre of tilt",
                    ));
                }
                Some(other) => {
                    return Err(p(
                        "rig",
                        key,
                        format!("`{other}` is unknown"),
                        "a distance is \"infinity\" or \"finite\"",
                    ));
                }
            }
        }
        let pupil = rig.camera_distance_mm.or(camera.camera_distance_mm);
        if rig.lens_radius_mm.is_some() && pupil.is_none() && rig.lens_angular_radius_deg.is_none()
        {
            return Err(p(
                "rig",
                "lens_radius_mm",
                "it spans no angle without `camera_distance_mm`".into(),
                "write the distance, or lens_angular_radius_deg",
            ));
        }
        if !["orthographic", "perspective"].contains(&camera.projection.as_str()) {
            return Err(p(
                "camera",
                "projection",
                format!("`{}` is unknown", camera.projection),
                "a projection is \"orthographic\" or \"perspective\"",
            ));
        }
        if camera
            .exposures_s
            .iter()
            .any(|e| !e.is_finite() || *e < 0.0)
        {
            return Err(p(
                "camera",
                "exposures_s",
                "an exposure time is negative or not finite".into(),
                "write seconds",
            ));
        }
        if let Some(Err(cause)) = self.metal() {
            return Err(p(
                "sample",
                "metal",
                cause,
                "name one of them and the lamp's wavelength, or write eta and k",
            ));
        }
        match sample.kind {
            SampleKind::Dielectric if sample.metal.is_some() => {
                return Err(p(
                    "sample",
                    "metal",
                    "the sample's kind is dielectric".into(),
                    "write kind = \"conductor\", or leave the metal out",
                ));
            }
            SampleKind::Dielectric if sample.index_of_refraction.or(sample.eta).is_none() => {
                return Err(p(
                    "sample",
                    "index_of_refraction",
                    "a dielectric needs it and it is missing".into(),
                    "write the index of the material, 1.5 for most plastics",
                ));
            }
            SampleKind::Conductor
                if sample.metal.is_none() && (sample.eta.is_none() || sample.k.is_none()) =>
            {
                return Err(p(
                    "sample",
                    if sample.eta.is_none() { "eta" } else { "k" },
                    "a conductor needs it and it is missing".into(),
                    "write the metal's eta and k at the lamp's wavelength, or its name as metal",
                ));
            }
            _ => {}
        }
        if let Some(layout) = &sample.layout {
            let patches = u64::from(layout.patches_x) * u64::from(layout.patches_y);
            if patches == 0 || patches > 10_000 {
                return Err(p(
                    "sample.layout",
                    "patches_x",
                    format!("{patches} patches make no board"),
                    "write 1 to 10,000 patches",
                ));
            }
            if !layout.centre_mm.iter().all(|c| c.is_finite()) {
                return Err(p(
                    "sample.layout",
                    "centre_mm",
                    "it is not finite".into(),
                    finite,
                ));
            }
            if camera.field_width_mm.is_none() {
                return Err(p(
                    "camera",
                    "field_width_mm",
                    "a sample with a layout needs it and it is missing".into(),
                    "write the width of the field in millimetres",
                ));
            }
        }
        Ok(())
    }
}

/// A value that may not be.
#[derive(Debug)]
pub(super) struct Problem {
    section: &'static str,
    key: &'static str,
    cause: String,
    remedy: &'static str,
}

impl Problem {
    fn path(&self) -> String {
        if self.section.is_empty() {
            self.key.to_owned()
        } else {
            format!("{}.{}", self.section, self.key)
        }
    }
}

/// Refuses a key that is one or two letters away from a known one which is missing.
fn slips(table: &toml::Table, text: &str, file: &str) -> Result<(), SeriesError> {
    for (section, known) in KEYS {
        let mut found = Some(table);
        for part in section.split('.').filter(|p| !p.is_empty()) {
            found = found.and_then(|t| t.get(part)).and_then(|v| v.as_table());
        }
        let Some(found) = found else { continue };
        let missing: Vec<&str> = known
            .iter()
            .filter(|k| !found.contains_key(**k))
            .copied()
            .collect();
        for key in found.keys().filter(|k| !known.contains(&k.as_str())) {
            if let Some(right) = meant(key, &missing) {
                return Err(SeriesError::Invalid {
                    file: file.to_owned(),
                    line: line_of(text, section, key),
                    key: String::new(),
                    cause: format!("key `{key}` is unknown"),
                    remedy: format!("did you mean `{right}`?"),
                });
            }
        }
    }
    Ok(())
}

fn line_at(text: &str, byte: usize) -> usize {
    text.as_bytes()
        .iter()
        .take(byte)
        .filter(|b| **b == b'\n')
        .count()
        + 1
}

fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// A number in few digits, however large or small it is.
fn short(value: f64) -> String {
    if value == 0.0 || (1e-4..1e7).contains(&value.abs()) {
        format!("{value}")
    } else {
        format!("{value:e}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::material::tables;

    const CHECKER: &str = include_str!("../../tests/data/series/checker/manifest.toml");

    fn refusal(text: &str) -> String {
        Manifest::from_toml(text, "manifest.toml")
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn a_wrong_value_is_named_with_line_key_and_remedy() {
        for (from, to, words) in [
            (
                "gonio-series-1",
                "gonio-series-9",
                ["line 1", "schema", "gonio-series-1"],
            ),
            (
                "theta_l_deg = 10.0",
                "theta_l_deg = nan",
                ["line 9", "rig.theta_l_deg", "0° and 90°"],
            ),
            (
                "theta_l_deg = 10.0",
                "theta_l_deg = \"10\"",
                ["line 9: theta_l_deg", "a number", "docs/series.md"],
            ),
            (
                "theta_l_deg = 10.0",
                "theta_1_deg = 10.0",
                ["line 9", "theta_1_deg", "`theta_l_deg`"],
            ),
            (
                "azimuth_zero_deg = 0.0",
                "azimut_zero_deg = 0.0",
                ["line", "azimut_zero_deg", "mean"],
            ),
            (
                "theta_l_deg = 10.0",
                "",
                ["missing", "theta_l_deg", "manifest.toml"],
            ),
            (
                "theta_l_deg = 10.0",
                "theta_l_deg = ",
                ["line 9", "no TOML", "repair"],
            ),
            (
                "width_px = 256",
                "width_px = 0",
                ["camera.width_px", "line 27", "65535"],
            ),
            (
                "frames.csv",
                "../frames.csv",
                ["frames", "out of the folder", "line 3"],
            ),
            (
                "index_of_refraction = 1.54",
                "",
                ["index_of_refraction", "dielectric", "1.5"],
            ),
            (
                "\"dielectric\"",
                "\"conductor\"",
                ["sample.eta", "conductor", "metal"],
            ),
            (
                "\"dielectric\"",
                "\"wood\"",
                ["wood", "dielectric", "conductor"],
            ),
            (
                "patches_x = 4",
                "patches_x = 0",
                ["sample.layout.patches_x", "0 patches", "line"],
            ),
        ] {
            let broken = CHECKER.replacen(from, to, 1);
            assert_ne!(broken, CHECKER, "{from} is not in the manifest");
            let said = refusal(&broken);
            for word in words {
                assert!(said.contains(word), "{to}: `{word}` is not in: {said}");
            }
        }
    }

    #[test]
    fn the_document_lists_every_key() {
        let document = include_str!("../../docs/series.md");
        for (section, keys) in KEYS {
            for key in keys {
                let named = document.contains(&format!("`{key}`"))
                    || document.contains(&format!("{key}]`**"));
                assert!(named, "{section}.{key} is not in docs/series.md");
            }
        }
    }

    #[test]
    fn a_pupil_of_some_radius_needs_its_distance() {
        let broken = CHECKER.replacen("[camera]", "lens_radius_mm = 4.0\n[camera]", 1);
        assert!(refusal(&broken).contains("camera_distance_mm"));
        let angle = "lens_radius_mm = 4.0\nlens_angular_radius_deg = 2.0\n[camera]";
        assert!(Manifest::from_toml(&CHECKER.replacen("[camera]", angle, 1), "").is_ok());
    }

    #[test]
    fn a_metal_may_be_named_and_what_is_stated_beside_it_counts_more() {
        let plastic = "index_of_refraction = 1.54";
        let named = |metal: &str| {
            CHECKER
                .replacen("\"dielectric\"", "\"conductor\"", 1)
                .replacen(plastic, metal, 1)
        };
        let manifest = Manifest::from_toml(&named("metal = \"Cr\""), "").unwrap();
        let wavelength_nm = manifest.rig.wavelength_nm.unwrap();
        let table = tables::metal("Cr", wavelength_nm).unwrap();
        assert_eq!(manifest.material(), table);
        assert_eq!(
            Manifest::from_toml(&manifest.to_toml(), "").unwrap(),
            manifest
        );
        let stated = named("metal = \"Cr\"\nk = 4.4\nk_std = 0.1");
        let stated = Manifest::from_toml(&stated, "").unwrap().material();
        assert_eq!(stated.index(), (table.index().0, 4.4));

        assert!(refusal(&named("metal = \"Unobtainium\"")).contains("known are Ag, Al"));
        let infrared =
            named("metal = \"Cr\"").replacen("wavelength_nm = 550", "wavelength_nm = 5000", 1);
        assert!(refusal(&infrared).contains("reaches from"));
        let clear = CHECKER.replacen(plastic, "metal = \"Cr\"", 1);
        assert!(refusal(&clear).contains("dielectric"));
    }

    #[test]
    fn a_finite_lamp_needs_its_distance() {
        let near = CHECKER.replacen(
            "light_distance = \"infinity\"",
            "light_distance = \"finite\"",
            1,
        );
        assert!(refusal(&near).contains("light_distance_mm"));
        let near = near.replacen(
            "[camera]",
            "light_distance_mm = 400.0\nlight_radius_mm = 7.0\n[camera]",
            1,
        );
        let manifest = Manifest::from_toml(&near, "").unwrap();
        assert!(!manifest.is_telecentric());
    }
}
