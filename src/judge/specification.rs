//! The specification file: limits by quantity, and the risks that are accepted.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::quantity::QUANTITIES;
use crate::fit::report::ReferencePlane;
use crate::wording::{self, stated};

/// Limits and decision rule of one kind of part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Specification {
    /// What it specifies, for instance drawing and revision.
    #[schema(max_length = 200)]
    pub name: String,
    /// Allowed risks.
    #[serde(default)]
    pub decision: DecisionRule,
    /// Limits by quantity; see [`QUANTITIES`].
    pub limits: BTreeMap<String, ToleranceLimits>,
    /// The plane to which limits of angles refer. With `sample`, the rig must state how samples lie on its turntable;
    /// without this key, either plane is accepted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_plane: Option<ReferencePlane>,
}

/// Tolerance limits; one of them may be missing.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ToleranceLimits {
    /// Conforming values are at least this.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = -1e300, maximum = 1e300)]
    pub lower: Option<f64>,
    /// Conforming values are at most this.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(minimum = -1e300, maximum = 1e300)]
    pub upper: Option<f64>,
}

/// Allowed risks; the documentation of the module states the rule.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct DecisionRule {
    /// Largest allowed probability that an item which passes does not conform.
    #[schema(exclusive_minimum = 0, exclusive_maximum = 0.5)]
    pub max_false_accept_risk: f64,
    /// Largest allowed probability that an item which fails conforms.
    #[schema(exclusive_minimum = 0, exclusive_maximum = 0.5)]
    pub max_false_reject_risk: f64,
}

impl Default for DecisionRule {
    fn default() -> Self {
        DecisionRule {
            max_false_accept_risk: 0.025,
            max_false_reject_risk: 0.025,
        }
    }
}

impl DecisionRule {
    /// The rule as a sentence for a report.
    #[must_use]
    pub fn sentence(&self) -> String {
        format!(
            "JCGM 106:2012, guarded acceptance: pass where the risk of accepting a nonconforming item is at most {} %, fail where the risk of rejecting a conforming one is at most {} %, otherwise cannot tell",
            100.0 * self.max_false_accept_risk,
            100.0 * self.max_false_reject_risk
        )
    }
}

/// What is wrong with a specification.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{words}")]
pub struct SpecificationError {
    /// Path of the value, e.g. `limits.theta_r_deg`.
    pub path: String,
    /// What is wrong with it, and what is allowed.
    pub words: String,
}

impl Specification {
    /// Refuses unknown quantities, limits that contradict each other and risks out of range.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn check(&self) -> Result<(), SpecificationError> {
        let refused = |path: String, words: String| Err(SpecificationError { path, words });
        if self.limits.is_empty() {
            let words = "[limits] is empty; state at least one limit, for instance theta_r_deg = { lower = 9.5, upper = 10.5 }";
            return refused("limits".to_owned(), words.to_owned());
        }
        for (key, limits) in &self.limits {
            let path = format!("limits.{key}");
            if !QUANTITIES.contains(&key.as_str()) {
                let hint =
                    meant(key).map_or_else(String::new, |m| format!(" (did you mean `{m}`?)"));
                let known = QUANTITIES.join(", ");
                let words = format!(
                    "[limits] has the unknown quantity `{key}`{hint}; known quantities are {known}"
                );
                return refused(path, words);
            }
            if let Err(cause) = limits.check() {
                return refused(path, format!("limits of `{key}`: {cause}"));
            }
        }
        let DecisionRule {
            max_false_accept_risk,
            max_false_reject_risk,
        } = self.decision;
        for (key, value) in [
            ("max_false_accept_risk", max_false_accept_risk),
            ("max_false_reject_risk", max_false_reject_risk),
        ] {
            if !(value > 0.0 && value < 0.5) {
                let words =
                    format!("[decision] {key} = {value}: expected a risk above 0 and below 0.5");
                return refused(format!("decision.{key}"), words);
            }
        }
        Ok(())
    }
}

impl ToleranceLimits {
    fn check(&self) -> Result<(), String> {
        let given = [self.lower, self.upper];
        if given.iter().flatten().any(|x| !x.is_finite()) {
            return Err("expected a finite number".to_owned());
        }
        match given {
            [None, None] => Err("state lower, upper or both".to_owned()),
            [Some(lower), Some(upper)] if lower >= upper => Err(format!(
                "lower = {} is not below upper = {}",
                stated(lower),
                stated(upper)
            )),
            _ => Ok(()),
        }
    }
}

/// The quantity whose name, without its unit, begins with the key, or the other way round; otherwise the one with the most
/// similar name.
fn meant(key: &str) -> Option<&'static str> {
    let plain = |s: &str| -> String {
        s.chars()
            .filter(char::is_ascii_alphanumeric)
            .collect::<String>()
            .to_ascii_lowercase()
    };
    let word = plain(key);
    let by_stem = QUANTITIES.into_iter().find(|q| {
        let name = plain(q);
        let stem = name.strip_suffix("deg").unwrap_or(&name).to_owned();
        !word.is_empty() && (word.starts_with(&stem) || stem.starts_with(&word))
    });
    by_stem.or_else(|| wording::meant(key, &QUANTITIES))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wording::toml_text;

    fn checked(text: &str) -> Result<Specification, String> {
        let specification: Specification =
            toml_text::read(text).map_err(|refused| refused.to_string())?;
        match specification.check() {
            Ok(()) => Ok(specification),
            Err(error) => Err(error.to_string()),
        }
    }

    fn refusal(text: &str) -> String {
        checked(text).unwrap_err()
    }

    #[test]
    fn the_example_in_the_docs_is_a_specification() {
        let text = include_str!("../../docs/examples/specification.toml");
        let specification = checked(text).unwrap();
        assert_eq!(specification.limits.len(), 5);
        assert!((specification.decision.max_false_accept_risk - 0.025).abs() < 1e-12);
    }

    #[test]
    fn unknown_keys_are_refused_by_name() {
        let ok = "name = \"s\"\n[limits]\ntheta_r_deg = { upper = 10.5 }\n";
        assert!(checked(ok).is_ok());
        assert!(refusal(&ok.replace("name", "nmae")).contains("nmae"));
        let limits = refusal(&ok.replace("theta_r_deg", "theta_r"));
        assert!(
            limits.contains("`theta_r`") && limits.contains("(did you mean `theta_r_deg`?)"),
            "{limits}"
        );
        let limits = refusal(&ok.replace("theta_r_deg", "thtea_r_deg"));
        assert!(limits.contains("(did you mean `theta_r_deg`?)"), "{limits}");
        assert!(refusal(&ok.replace("upper", "uper")).contains("uper"));
        assert!(refusal(&format!("{ok}[decision]\nrisk = 0.1\n")).contains("risk"));
    }

    #[test]
    fn the_plane_is_one_of_two_words() {
        let with = |plane: &str| {
            format!(
                "name = \"s\"\nreference_plane = \"{plane}\"\n[limits]\ntheta_r_deg = {{ upper = 10.5 }}\n"
            )
        };
        let read = |plane: &str| checked(&with(plane)).unwrap();
        assert_eq!(read("sample").reference_plane, Some(ReferencePlane::Sample));
        assert_eq!(
            read("turntable").reference_plane,
            Some(ReferencePlane::Turntable)
        );
        assert!(refusal(&with("stage")).contains("turntable"));
    }

    #[test]
    fn invalid_limits_and_risks_are_named() {
        let with = |limits: &str| refusal(&format!("name = \"s\"\n[limits]\nalpha_u = {limits}\n"));
        assert!(with("{}").contains("state lower, upper or both"));
        assert!(with("{ lower = 0.2, upper = 0.1 }").contains("is not below"));
        assert!(with("{ lower = nan }").contains("finite"));
        assert!(refusal("name = \"s\"\n[limits]\n").contains("empty"));
        let risk = "name = \"s\"\n[limits]\nalpha_u = { lower = 0.1 }\n[decision]\nmax_false_accept_risk = 0.5\n";
        assert!(refusal(risk).contains("max_false_accept_risk"));
    }
}
