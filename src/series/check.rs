//! Checks the text of a manifest: its form, its keys (`keys`), and each value (`values`).

use super::SeriesError;
use super::keys::{slips, stray};
use super::manifest::{Manifest, SCHEMA};
use super::text::line_of;
use super::values;
use crate::material::Material;
use crate::wording::toml_text::{self, line_at};

/// Schema name of the manifest of a goniometer's table.
pub const TABLE_SCHEMA: &str = "brdf-table-1";

impl Manifest {
    /// Reads the text of a manifest and checks every value; `file` names it in errors.
    ///
    /// # Errors
    /// [`SeriesError::Invalid`] with line, key, cause and remedy of the first thing that is wrong.
    pub fn from_toml(text: &str, file: &str) -> Result<Self, SeriesError> {
        Manifest::read(text, file, false)
    }

    /// Reads the manifest of a series that comes from outside, whose author can still correct it: additionally, every key must
    /// be where it is read, and the values must agree with each other. A manifest in a store is read as it was taken.
    ///
    /// # Errors
    /// As [`Manifest::from_toml`].
    pub fn from_outside(text: &str, file: &str) -> Result<Self, SeriesError> {
        Manifest::read(text, file, true)
    }

    /// Returns the nominal material that a section `[sample]` states, at the wavelength for a metal by name.
    ///
    /// # Errors
    /// [`SeriesError::Invalid`] names key, cause and remedy, and no line.
    pub fn material_alone(
        sample: &toml::Table,
        wavelength_nm: Option<f64>,
        file: &str,
    ) -> Result<Material, SeriesError> {
        let section = |entries: &[(&str, toml::Value)]| {
            let entries = entries.iter().cloned();
            toml::Value::Table(
                entries
                    .map(|(key, value)| (key.to_owned(), value))
                    .collect(),
            )
        };
        let mut rig = vec![("theta_l_deg", toml::Value::Float(0.0))];
        rig.extend(wavelength_nm.map(|nm| ("wavelength_nm", toml::Value::Float(nm))));
        let camera = [
            ("width_px", toml::Value::Integer(1)),
            ("height_px", toml::Value::Integer(1)),
            ("gain_dn_per_electron", toml::Value::Float(1.0)),
        ];
        let whole: toml::Table = [
            ("schema".to_owned(), toml::Value::String(SCHEMA.to_owned())),
            ("rig".to_owned(), section(&rig)),
            ("camera".to_owned(), section(&camera)),
            ("sample".to_owned(), toml::Value::Table(sample.clone())),
        ]
        .into_iter()
        .collect();
        Ok(Manifest::from_outside(&whole.to_string(), file)?.material())
    }

    fn read(text: &str, file: &str, from_outside: bool) -> Result<Self, SeriesError> {
        let text = text.trim_start_matches('\u{feff}');
        let table: toml::Table = toml::from_str(text).map_err(|error| SeriesError::Invalid {
            file: file.to_owned(),
            line: error.span().map(|span| line_at(text, span.start)),
            key: String::new(),
            cause: format!("this is not TOML: {}", one_line(error.message())),
            remedy: "repair the line".to_owned(),
        })?;
        if table.get("schema").and_then(toml::Value::as_str) == Some(TABLE_SCHEMA) {
            return Err(SeriesError::Invalid {
                file: file.to_owned(),
                line: line_of(text, "", "schema"),
                key: String::new(),
                cause: "this is a table of BRDF, which has no frames".to_owned(),
                remedy: "`ridged fit` reads it, one folder at a time".to_owned(),
            });
        }
        if from_outside && let Some(stray) = stray(&table, "", &table) {
            return Err(stray.error(text, file));
        }
        slips(&table, text, file)?;
        let manifest: Manifest = toml_text::read(text).map_err(|refused| SeriesError::Invalid {
            file: file.to_owned(),
            line: refused.line,
            key: match refused.key.as_str() {
                "" => String::new(),
                key => format!("{key}: "),
            },
            cause: refused.words,
            remedy: "docs/reference/series.md lists every key".to_owned(),
        })?;
        let checked = values::check(&manifest).and_then(|()| match from_outside {
            true => values::check_fit(&manifest),
            false => Ok(()),
        });
        checked.map_err(|problem| problem.error(text, file))?;
        Ok(manifest)
    }
}

fn one_line(message: &str) -> String {
    message.split_whitespace().collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::material::tables;

    const CHECKER: &str = include_str!("../../tests/data/series/checker/manifest.toml");
    const POLYMER: &str = include_str!("../../tests/data/series/polymer-10/manifest.toml");

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
                [
                    "line 9: rig.theta_l_deg",
                    "a number",
                    "docs/reference/series.md",
                ],
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

    fn refusal_from_outside(text: &str) -> String {
        Manifest::from_outside(text, "manifest.toml")
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn a_stated_distance_is_finite_without_the_word() {
        let stated = "light_distance_mm = 100.0\ncamera_distance_mm = 100.0";
        let near = CHECKER
            .replacen("light_distance = \"infinity\"", stated, 1)
            .replacen("camera_distance = \"infinity\"", "", 1);
        let manifest = Manifest::from_outside(&near, "manifest.toml").unwrap();
        assert!(!manifest.is_telecentric());
        assert!(
            Manifest::from_outside(CHECKER, "")
                .unwrap()
                .is_telecentric()
        );
        for (text, words) in [
            (
                POLYMER
                    .replacen(
                        "light_distance = \"infinity\"",
                        "light_distance_mm = 100.0",
                        1,
                    )
                    .replacen("field_width_mm = 51.2\n", "", 1),
                [
                    "line 25: camera.field_width_mm",
                    "rig.light_distance_mm",
                    "missing",
                ],
            ),
            (
                near.replacen("[camera]\n", "[camera]\ncamera_distance_mm = 120.0\n", 1),
                [
                    "line 27: camera.camera_distance_mm",
                    "120",
                    "rig.camera_distance_mm = 100",
                ],
            ),
            (
                CHECKER.replacen(
                    "light_distance = \"infinity\"",
                    "light_distance = \"infinity\"\nlight_distance_mm = 100.0",
                    1,
                ),
                [
                    "line 12: rig.light_distance_mm",
                    "light_distance = \"infinity\"",
                    "leave",
                ],
            ),
            (
                CHECKER.replacen("[camera]\n", "[camera]\ncamera_distance_mm = 450.0\n", 1),
                [
                    "line 26: camera.camera_distance_mm",
                    "camera_distance = \"infinity\"",
                    "leave",
                ],
            ),
            (
                near.replacen("orthographic", "perspective", 1).replacen(
                    "camera_distance_mm = 100.0\n",
                    "",
                    1,
                ),
                ["line 8: rig.camera_distance_mm", "perspective", "missing"],
            ),
        ] {
            let said = refusal_from_outside(&text);
            for word in words {
                assert!(said.contains(word), "`{word}` is not in: {said}");
            }
        }
    }

    #[test]
    fn a_lean_direction_that_cannot_be_read_is_refused() {
        let words = "\"(i+j) even: lean direction v at phi_s (ridges run along u = v x n)\"";
        let with = |value: &str| CHECKER.replacen(words, &format!("\"{value}\""), 1);
        for reported in [
            "leans left",
            "v at phi_s + ninety deg",
            "v at phi_s plus 90 deg",
            "v at phi_s turned by 90 deg",
            "v at phi_s 90 deg",
            "v at phi_s + 1,5 deg",
            "v at phi_s + 1.5.2 deg",
            "v at phi_s + 9e1 deg",
            "v at phi_s + 1.5708 rad",
            "v at phi_s_recorded",
        ] {
            let said = refusal_from_outside(&with(reported));
            for word in ["sample.layout.even_patches", reported, "phi_s + 90 deg"] {
                assert!(said.contains(word), "`{word}` is not in: {said}");
            }
            let line = with(reported)
                .lines()
                .position(|l| l.contains(reported))
                .unwrap()
                + 1;
            assert!(said.contains(&format!("line {line}:")), "{said}");
        }
        for reported in [
            "v at phi_s",
            "v at phi_s, as on the drawing of 2024",
            "v at phi_s as recorded",
            "v at phi_s+90",
            "v at phi_s - 45.5°",
            "v at phi_s − 45.5 deg (ridges along u)",
            "v at phi_s + 90, measured",
        ] {
            assert!(
                Manifest::from_outside(&with(reported), "").is_ok(),
                "{reported}"
            );
        }
    }

    #[test]
    fn how_well_the_stages_and_the_lamp_are_known_is_a_number_in_its_range() {
        let with = |reported: &str| CHECKER.replacen("[rig]\n", &format!("[rig]\n{reported}\n"), 1);
        let stated = with("theta_c_std_deg = 0.05\nphi_s_std_deg = 1\nlamp_drift_std = 0.0");
        let manifest = Manifest::from_outside(&stated, "").unwrap();
        let of = |m: &Manifest| {
            let rig = &m.rig;
            (rig.theta_c_std_deg, rig.phi_s_std_deg, rig.lamp_drift_std)
        };
        assert_eq!(of(&manifest), (Some(0.05), Some(1.0), Some(0.0)));
        let again = Manifest::from_toml(&manifest.to_toml(), "").unwrap();
        assert_eq!(of(&again), of(&manifest));
        let silent = Manifest::from_outside(CHECKER, "").unwrap();
        assert_eq!(of(&silent), (None, None, None));
        for (reported, words) in [
            (
                "theta_c_std_deg = -0.1",
                ["line 9: rig.theta_c_std_deg", "out of range"],
            ),
            (
                "phi_s_std_deg = 11.0",
                ["line 9: rig.phi_s_std_deg", "at most 10"],
            ),
            (
                "phi_s_std_deg = nan",
                ["line 9: rig.phi_s_std_deg", "out of range"],
            ),
            (
                "lamp_drift_std = 2.0",
                ["line 9: rig.lamp_drift_std", "not per cent"],
            ),
            (
                "lamp_drift_std = \"1 %\"",
                ["line 9: rig.lamp_drift_std", "number"],
            ),
        ] {
            let said = refusal(&with(reported));
            for word in words {
                assert!(said.contains(word), "`{word}` is not in: {said}");
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

        assert!(refusal(&named("metal = \"Unobtainium\"")).contains("known ones are Ag, Al"));
        let infrared =
            named("metal = \"Cr\"").replacen("wavelength_nm = 550", "wavelength_nm = 5000", 1);
        assert!(refusal(&infrared).contains("which covers"));
        let unstated = named("metal = \"Cr\"").replacen("wavelength_nm = 550", "#", 1);
        assert!(refusal(&unstated).contains("rig.wavelength_nm: sample.metal = \"Cr\" needs it"));
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
