//! Specifications as clients state them: read, checked, and kept as definitions.

use super::definitions::{Content, to_json};
use super::request_checks::invalid;
use super::{Lab, LabError};
use crate::judge::Specification;
use crate::store::definitions::DefinitionKind;
use crate::wording::json;

impl Content for Specification {
    const KIND: DefinitionKind = DefinitionKind::Specification;

    fn name(&self) -> &str {
        &self.name
    }

    fn check(&self, _: &Lab) -> Result<(), LabError> {
        let checked = specified(&to_json(self)?);
        checked.map(drop).map_err(|error| match error {
            LabError::Invalid { field, problem } => match field.strip_prefix("specification.") {
                Some(field) => invalid(field, problem),
                None => invalid(field, problem),
            },
            other => other,
        })
    }
}

/// Parses a specification; an error names the part that is wrong.
pub(super) fn specified(value: &serde_json::Value) -> Result<Specification, LabError> {
    let invalid = |field: String, problem: String| LabError::Invalid { field, problem };
    json::from_value::<Specification>(value).map_err(|refusal| {
        invalid(
            refusal.path_below("specification"),
            refusal.message("field"),
        )
    })?;
    // Its errors begin with the name of the file, which is the field here.
    Specification::from_json(value).map_err(|error| {
        let field = match error.path() {
            path if path.is_empty() => "specification".to_owned(),
            path => format!("specification.{path}"),
        };
        let error = error.to_string();
        let problem = error.strip_prefix("specification: ").unwrap_or(&error);
        invalid(field, problem.to_owned())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_specification_names_what_it_limits() {
        let limits = |limits| json!({"name": "part 7", "limits": {"theta_r_deg": limits}});
        specified(&limits(json!({"lower": 9.5, "upper": 10.5}))).unwrap();
        for (value, field) in [
            (
                limits(json!([9.5, 10.5])),
                "specification.limits.theta_r_deg: ",
            ),
            (
                limits(json!({"lower": 11, "upper": 10})),
                "specification.limits.theta_r_deg: ",
            ),
            (
                json!({"name": "part 7", "limits": {"theta": {"lower": 1}}}),
                "specification.limits.theta: ",
            ),
            (
                json!({"name": "part 7", "limits": {"theta_r_deg": {"lower": 1}}, "decision": {"max_false_accept_risk": 2}}),
                "specification.decision.max_false_accept_risk: ",
            ),
            (
                json!({"name": "part 7", "limits": {}}),
                "specification.limits: ",
            ),
            (
                json!(["part 7", {}, {"theta_r_deg": {"lower": 1}}]),
                "specification: ",
            ),
        ] {
            let refused = specified(&value).unwrap_err().to_string();
            assert!(refused.starts_with(field), "{refused}");
        }
    }
}
