//! The text of a manifest, checked: its form, slips of the pen with what was meant, and each value by `values`.

use super::SeriesError;
use super::manifest::Manifest;
use super::text::{line_of, meant};
use super::values;
use crate::wording::refusals::plain;

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
            "sample_wedge_std_deg",
            "theta_l_std_deg",
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
            cause: format!("this is not TOML: {}", one_line(error.message())),
            remedy: "repair the line".to_owned(),
        })?;
        slips(&table, text, file)?;
        let manifest: Manifest = toml::from_str(text).map_err(|error| {
            let line = error.span().map(|span| line_at(text, span.start));
            let message = one_line(error.message());
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
                cause: plain(&message),
                remedy: "docs/series.md lists every key".to_owned(),
            }
        })?;
        values::check(&manifest).map_err(|problem| problem.told(text, file))?;
        Ok(manifest)
    }

    /// The same of a series that comes from outside, where whoever wrote it can still correct it: its values also fit
    /// each other.
    ///
    /// # Errors
    /// As [`Manifest::from_toml`].
    pub fn from_outside(text: &str, file: &str) -> Result<Self, SeriesError> {
        let manifest = Manifest::from_toml(text, file)?;
        values::check_camera(&manifest).map_err(|problem| problem.told(text, file))?;
        Ok(manifest)
    }
}

/// A value that may not be.
#[derive(Debug)]
pub(super) struct Problem {
    pub section: &'static str,
    pub key: &'static str,
    pub cause: String,
    pub remedy: &'static str,
}

impl Problem {
    fn told(self, text: &str, file: &str) -> SeriesError {
        SeriesError::Invalid {
            file: file.to_owned(),
            line: line_of(text, self.section, self.key),
            key: format!("{}: ", self.path()),
            cause: self.cause,
            remedy: self.remedy.to_owned(),
        }
    }

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
                ["line 9", "not TOML", "repair"],
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
    fn a_camera_that_contradicts_itself_is_refused_where_it_can_be_corrected() {
        let broken = CHECKER.replacen("bit_depth = 16", "bit_depth = 12", 1);
        let refused = Manifest::from_outside(&broken, "manifest.toml").unwrap_err();
        let said = refused.to_string();
        for word in [
            "line 34",
            "camera.saturation_dn",
            "at most 4095",
            "bit_depth = 12",
        ] {
            assert!(said.contains(word), "`{word}` is not in: {said}");
        }
        assert!(Manifest::from_toml(&broken, "manifest.toml").is_ok());
        assert!(Manifest::from_outside(CHECKER, "manifest.toml").is_ok());
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
