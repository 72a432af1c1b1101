//! The section for what is measured again at intervals.

use serde::{Deserialize, Serialize};

use crate::wording::is_blank;

/// Longest name of a part, in characters.
const NAME_LENGTH_MAX: usize = 200;

/// `[due]`: what is measured again at intervals. Page, `ridged doctor` and `ridged chart` state what is due.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DueSection {
    /// Name of the check standard: a part that does not change, whose control chart shows whether the rig does. Default: none;
    /// 1 to 200 characters.
    pub check_standard: Option<String>,
    /// Days from a measurement of the check standard to the next one. Default: never due; above 0 and at most 3650.
    pub check_standard_every_days: Option<f64>,
    /// Largest age of the newest dark and white-reference frames, days. Default: never due; above 0 and at most 3650.
    pub references_every_days: Option<f64>,
}

impl DueSection {
    /// No check standard and no intervals.
    pub const NOTHING: DueSection = DueSection {
        check_standard: None,
        check_standard_every_days: None,
        references_every_days: None,
    };

    /// Returns the key of a setting that cannot be used, what it is, and what is allowed.
    pub(super) fn fault(&self) -> Option<(&'static str, String, String)> {
        match &self.check_standard {
            Some(name) if is_blank(name) || name.chars().count() > NAME_LENGTH_MAX => Some((
                "due.check_standard",
                format!("{} characters", name.trim().chars().count()),
                format!("the name of a part, 1 to {NAME_LENGTH_MAX} characters"),
            )),
            None if self.check_standard_every_days.is_some() => Some((
                "due.check_standard",
                "missing beside check_standard_every_days".to_owned(),
                "the name of the part that is due at this interval".to_owned(),
            )),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Config;

    fn read(text: &str) -> Result<Config, String> {
        let config = Config::from_text(text, "rig.toml", []);
        config.map_err(|error| error.to_string())
    }

    #[test]
    fn nothing_is_due_by_default_and_each_key_is_optional() {
        assert_eq!(read("").unwrap().due, super::DueSection::NOTHING);
        let text = "[due]\ncheck_standard = \"CS-1\"\ncheck_standard_every_days = 7\n";
        let due = read(text).unwrap().due;
        assert_eq!(due.check_standard.as_deref(), Some("CS-1"));
        assert_eq!(due.check_standard_every_days, Some(7.0));
        let due = read("[due]\nreferences_every_days = 0.5\n").unwrap().due;
        assert_eq!(due.references_every_days, Some(0.5));
    }

    #[test]
    fn an_interval_without_a_part_and_values_out_of_range_are_named() {
        for (text, words) in [
            (
                "check_standard_every_days = 7.0",
                ["due.check_standard is missing", "the name of the part"],
            ),
            (
                "check_standard = \" \"",
                ["line 2: due.check_standard is 0 characters", "1 to 200"],
            ),
            (
                "references_every_days = 0.0",
                ["due.references_every_days is 0", "above 0 and at most 3650"],
            ),
            (
                "references_every_days = -1.0",
                ["due.references_every_days is -1", "above 0"],
            ),
            (
                "references_every_days = inf",
                ["due.references_every_days is inf", "above 0"],
            ),
            (
                "check_standard = \"CS-1\"\ncheck_standard_every_days = nan",
                ["line 3: due.check_standard_every_days is NaN", "above 0"],
            ),
            (
                "check_standards = \"CS-1\"",
                ["check_standards", "check_standard"],
            ),
        ] {
            let error = read(&format!("[due]\n{text}\n")).unwrap_err();
            for part in words {
                assert!(error.contains(part), "{part} is not in: {error}");
            }
        }
    }
}
