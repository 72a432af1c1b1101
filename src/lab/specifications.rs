//! Specifications as clients state them: read, checked, and kept as definitions.

use super::definitions::Content;
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
        Specification::check(self).map_err(|error| invalid(error.path, error.words))
    }
}

/// Reads and checks a specification; an error names the part that is wrong.
pub(super) fn specified(value: &serde_json::Value) -> Result<Specification, LabError> {
    let specification: Specification = json::from_value(value).map_err(|refusal| {
        invalid(
            refusal.path_below("specification"),
            refusal.message("field"),
        )
    })?;
    match specification.check() {
        Ok(()) => Ok(specification),
        Err(error) => Err(invalid(
            format!("specification.{}", error.path),
            error.words,
        )),
    }
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
