//! The line of a key in a manifest, and the known key that a misspelt one was probably meant to be.

use crate::wording::toml_text;

/// Returns the path of a key in a section; the top has no name.
pub(super) fn path_of(section: &str, key: &str) -> String {
    match section {
        "" => key.to_owned(),
        section => format!("{section}.{key}"),
    }
}

/// Returns the line (from 1) on which `key` of `[section]` is set, or the section's own line if the key is missing.
/// `section` is empty for the top.
pub(super) fn line_of(text: &str, section: &str, key: &str) -> Option<usize> {
    toml_text::line_of(text, &path_of(section, key)).or_else(|| match section {
        "" => Some(1),
        section => toml_text::line_of(text, section),
    })
}

/// Suffixes of keys that are a unit, longer ones before those that they end in.
const UNITS: [&str; 12] = [
    "_dn_per_electron",
    "_electrons_rms",
    "_deg",
    "_rad",
    "_mm",
    "_um",
    "_nm",
    "_m",
    "_px",
    "_ms",
    "_s",
    "_dn",
];

/// A key without its unit.
fn unitless(key: &str) -> &str {
    let end = UNITS.iter().find_map(|unit| key.strip_suffix(unit));
    end.unwrap_or(key)
}

/// Unit of a key in words, where `word` has another one: degrees for `theta_c_rad` in place of `theta_c_deg`.
pub(super) fn other_unit(word: &str, key: &str) -> Option<&'static str> {
    let unit = |of: &str| {
        let of = of.to_lowercase();
        UNITS.iter().find(|unit| of.ends_with(**unit)).copied()
    };
    let wanted = unit(key)?;
    let named = match wanted {
        "_deg" => "degrees",
        "_mm" => "millimetres",
        "_um" => "micrometres",
        "_s" => "seconds",
        "_ms" => "milliseconds",
        "_nm" => "nanometres",
        _ => return None,
    };
    unit(word).filter(|unit| *unit != wanted).map(|_| named)
}

/// Returns the word of `known` that `word` was probably meant to be: at most two edits away (one for short words), or
/// equal but for the unit. Case does not matter.
pub(super) fn meant<'a>(word: &str, known: &[&'a str]) -> Option<&'a str> {
    let edits_max = if word.len() < 6 { 1 } else { 2 };
    let bare = word.to_lowercase();
    let same = |k: &&&str| unitless(k) == unitless(&bare);
    if let Some(k) = known.iter().find(same) {
        return Some(k);
    }
    known
        .iter()
        .map(|k| (strsim::levenshtein(&bare, &k.to_lowercase()), *k))
        .filter(|(distance, _)| *distance <= edits_max)
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, k)| k)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_found_in_its_own_section() {
        let text = "a = 1\n\n[rig]\n a = 2\n[camera]\n\"a\" = 3\n";
        assert_eq!(line_of(text, "", "a"), Some(1));
        assert_eq!(line_of(text, "rig", "a"), Some(4));
        assert_eq!(line_of(text, "camera", "a"), Some(6));
        assert_eq!(line_of(text, "camera", "b"), Some(5));
        assert_eq!(line_of(text, "sample", "b"), None);
        assert_eq!(line_of("x = 1\nrig.a = 2\n", "rig", "a"), Some(2));
    }

    #[test]
    fn two_slips_are_forgiven_and_three_are_not() {
        let known = ["theta_l_deg", "width_px"];
        assert_eq!(meant("theta_1_deg", &known), Some("theta_l_deg"));
        assert_eq!(meant("thetal_dge", &known), None);
        assert_eq!(meant("Width_px", &known), Some("width_px"));
    }

    #[test]
    fn a_value_in_another_unit_is_converted_and_not_only_renamed() {
        assert_eq!(other_unit("theta_c_rad", "theta_c_deg"), Some("degrees"));
        assert_eq!(
            other_unit("light_distance_m", "light_distance_mm"),
            Some("millimetres")
        );
        assert_eq!(other_unit("theta_1_deg", "theta_l_deg"), None);
        assert_eq!(other_unit("theta_c", "theta_c_deg"), None);
        assert_eq!(other_unit("width_px", "width"), None);
    }

    #[test]
    fn a_unit_that_is_missing_or_another_is_a_slip() {
        let known = ["lens_angular_radius_deg", "gain_dn_per_electron", "metal"];
        assert_eq!(meant("lens_angular_radius", &known), Some(known[0]));
        assert_eq!(meant("lens_angular_radius_rad", &known), Some(known[0]));
        assert_eq!(meant("gain", &known), Some(known[1]));
        assert_eq!(meant("lens", &known), None);
        assert_eq!(meant("lens_serial", &known), None);
    }
}
