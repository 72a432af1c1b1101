//! The keys of a manifest: slips of the pen with what was meant, and known ones where nothing reads them.

use super::SeriesError;
use super::text::{line_of, meant, other_unit, path_of};

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
            "azimuth_zero_std_deg",
            "light_angular_radius_deg",
            "lens_angular_radius_deg",
            "wavelength_nm",
            "tilt_centre_px",
            "rotation_axis_px",
            "light_distance",
            "camera_distance",
            "light_distance_mm",
            "light_radius_mm",
            "sample_wedge_std_deg",
            "theta_l_std_deg",
            "theta_c_std_deg",
            "phi_s_std_deg",
            "lamp_drift_std",
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
            "principal_point_px",
            "bit_depth",
            "saturation_dn",
            "gain_dn_per_electron",
            "black_level_dn",
            "read_noise_electrons_rms",
            "exposures_s",
            "exposure_rel_std",
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
            "translucency",
            "translucency_std",
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

/// Keys of one section that another one may have as well: as a second place, or as a note that says something else (the
/// exposures of the flats, a certificate's coverage factor k).
const AT_HOME_TOO: [(&str, &str); 3] = [
    ("camera", "camera_distance_mm"),
    ("flat", "exposures_s"),
    ("flat", "k"),
];

/// A known key where nothing reads it.
pub(super) struct Stray {
    section: String,
    key: String,
    /// Where it is read.
    home: &'static str,
}

impl Stray {
    pub(super) fn error(self, text: &str, file: &str) -> SeriesError {
        let Stray { section, key, home } = self;
        // An inline table has no header: its own line then.
        let (outer, name) = section.rsplit_once('.').unwrap_or(("", &section));
        let line = line_of(text, &section, &key).or_else(|| line_of(text, outer, name));
        let here = match section.as_str() {
            "" => "above the sections".to_owned(),
            section => format!("in [{section}]"),
        };
        SeriesError::Invalid {
            file: file.to_owned(),
            line,
            key: String::new(),
            cause: format!("key `{key}` belongs in [{home}]; {here} nothing reads it"),
            remedy: "move it there, or into a section [notes] if it is only a note".to_owned(),
        }
    }
}

/// The first key in `table`, which is `[section]` of the `whole`, that would be read in another section and here counts as a
/// note. `[dark]` and sections called notes are for notes alone.
pub(super) fn stray(table: &toml::Table, section: &str, whole: &toml::Table) -> Option<Stray> {
    let own = KEYS.iter().find(|(name, _)| *name == section);
    let own: &[&str] = own.map_or(&[], |(_, keys)| keys);
    for (key, value) in table {
        if !own.contains(&key.as_str())
            && !is_at_home_too(section, key, whole)
            && let Some(home) = home_of(key, value)
        {
            return Some(Stray {
                section: section.to_owned(),
                key: key.clone(),
                home,
            });
        }
        let inner = path_of(section, key);
        let found = value
            .as_table()
            .filter(|_| inner != "dark" && key != "notes")
            .and_then(|table| stray(table, &inner, whole));
        if found.is_some() {
            return found;
        }
    }
    None
}

/// The section that reads a key. Of what anything may have (a name, a kind), none.
fn home_of(key: &str, value: &toml::Value) -> Option<&'static str> {
    if key == "kind" || (key == "layout" && !value.is_table()) {
        return None;
    }
    let sections = KEYS.iter().filter(|(name, _)| !name.is_empty());
    let mut homes = sections.filter(|(_, keys)| keys.contains(&key));
    homes.next().map(|(name, _)| *name)
}

fn is_at_home_too(section: &str, key: &str, whole: &toml::Table) -> bool {
    // A sample's index is that at a wavelength; the rig states which one shines.
    let rig = |key: &str| whole.get("rig").is_some_and(|rig| rig.get(key).is_some());
    AT_HOME_TOO.contains(&(section, key))
        || ((section, key) == ("sample", "wavelength_nm") && rig("wavelength_nm"))
}

/// Refuses a key that is one or two letters away from a known one which is missing.
pub(super) fn slips(table: &toml::Table, text: &str, file: &str) -> Result<(), SeriesError> {
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
                    remedy: match other_unit(key, right) {
                        Some(unit) => format!("convert the value to {unit} and write `{right}`"),
                        None => format!("did you mean `{right}`?"),
                    },
                });
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::Manifest;
    use super::*;

    const CHECKER: &str = include_str!("../../tests/data/series/checker/manifest.toml");

    fn refusal_from_outside(text: &str) -> String {
        Manifest::from_outside(text, "manifest.toml")
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn a_known_key_in_another_section_is_refused_with_its_own() {
        for (from, to, words) in [
            (
                "[sample]\n",
                "[sample]\nsample_wedge_std_deg = 0.2\n",
                [
                    "line 52",
                    "`sample_wedge_std_deg` belongs in [rig]",
                    "in [sample]",
                ],
            ),
            (
                "[camera]\n",
                "[camera]\nazimuth_zero_deg = 90\n",
                [
                    "line 26",
                    "`azimuth_zero_deg` belongs in [rig]",
                    "in [camera]",
                ],
            ),
            (
                "name = \"checker\"\n",
                "name = \"checker\"\nlight_azimuth_deg = 90.0\n",
                [
                    "line 3",
                    "`light_azimuth_deg` belongs in [rig]",
                    "above the sections",
                ],
            ),
            (
                "[camera]\n",
                "[light]\nlight_angular_radius_deg = 2.0\n[camera]\n",
                [
                    "line 26",
                    "`light_angular_radius_deg` belongs in [rig]",
                    "[light]",
                ],
            ),
            (
                "[camera]\n",
                "[rig.lamp]\nwavelength_nm = 633.0\n[camera]\n",
                ["line 26", "`wavelength_nm` belongs in [rig]", "[rig.lamp]"],
            ),
            (
                "transport =",
                "light = { light_azimuth_deg = 90.0 }\ntransport =",
                [
                    "line 6",
                    "`light_azimuth_deg` belongs in [rig]",
                    "in [light]",
                ],
            ),
            (
                "[flat]\n",
                "[flat]\nbit_depth = 12\n",
                ["line 42", "`bit_depth` belongs in [camera]", "in [flat]"],
            ),
            (
                "[sample]\n",
                "[sample]\npatch_size_mm = 9.0\n",
                [
                    "line 52",
                    "belongs in [sample.layout]",
                    "section [notes] if",
                ],
            ),
            // It has no effect beside the name of a metal.
            (
                "rotation = \"phi_s about +z, counter-clockwise seen from +z\"\nwavelength_nm = 550.0\n",
                "",
                ["`wavelength_nm` belongs in [rig]", "in [sample]", "line"],
            ),
        ] {
            let text = CHECKER.replacen(from, to, 1);
            assert_ne!(text, CHECKER, "{from} is not in the manifest");
            let said = refusal_from_outside(&text);
            for word in words {
                assert!(said.contains(word), "{to}: `{word}` is not in: {said}");
            }
        }
    }

    #[test]
    fn notes_stay_notes_whatever_they_are_called() {
        for (from, to) in [
            ("[camera]\n", "[notes]\ntheta_l_deg = 11.0\n[camera]\n"),
            ("[camera]\n", "[rig.notes]\nbit_depth = 12\n[camera]\n"),
            ("[dark]\n", "[dark]\nblack_level_dn = 201.3\n"),
            (
                "[flat]\n",
                "[flat]\nkind = \"sintered\"\nname = \"R 7\"\nk = 2\n",
            ),
            (
                "[rig]\n",
                "[rig]\ncamera = \"U3-3080\"\nlayout = \"rig.png\"\n",
            ),
        ] {
            let text = CHECKER.replacen(from, to, 1);
            assert_ne!(text, CHECKER, "{from} is not in the manifest");
            let manifest = Manifest::from_outside(&text, "manifest.toml").unwrap();
            assert_eq!(manifest.rig.theta_l_deg, 10.0);
        }
        // What is in a store already is read as it was taken.
        let stored = CHECKER.replacen("[sample]\n", "[sample]\nsample_wedge_std_deg = 0.2\n", 1);
        assert!(Manifest::from_toml(&stored, "manifest.toml").is_ok());
    }

    #[test]
    fn the_document_lists_every_key() {
        let document = include_str!("../../docs/reference/series.md");
        for (section, keys) in KEYS {
            for key in keys {
                let named = document.contains(&format!("`{key}`"))
                    || document.contains(&format!("{key}]`**"));
                assert!(named, "{section}.{key} is not in docs/reference/series.md");
            }
        }
    }
}
