//! The judgement of all limits together.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::decision::{JudgedItem, Verdict, decide, undetermined};
use super::quantity::{JudgedQuantity, PLANE_DEPENDENT};
use super::specification::{DecisionRule, Specification};
use super::would_decide::WouldDecide;
use crate::fit::report::ReferencePlane;

/// The judgement of one part.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Judgement {
    /// Fails if one item fails, passes if all pass.
    pub verdict: Verdict,
    /// Name of the specification.
    pub specification: String,
    /// The allowed risks.
    pub decision: DecisionRule,
    /// The rule as a sentence.
    pub decision_rule: String,
    /// Lower bound of the probability that all items conform (Boole's inequality; a positive correlation raises it); null
    /// where an item is not determined.
    pub conformance_probability_min: Option<f64>,
    /// One per limited quantity.
    pub items: Vec<JudgedItem>,
    /// What would decide the items that are not decided, by quantity.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub would_decide: BTreeMap<String, WouldDecide>,
    /// Sentences for the user, including the warnings of the fit.
    pub warnings: Vec<String>,
}

/// Judges quantities against a specification. A limit on a quantity that is not in the list ends as *cannot tell*.
#[must_use]
pub fn judge(specification: &Specification, quantities: &[JudgedQuantity]) -> Judgement {
    let rule = &specification.decision;
    let items: Vec<JudgedItem> = specification
        .limits
        .iter()
        .map(|(name, limits)| {
            let quantity = quantities.iter().find(|q| q.name == *name);
            match quantity.map(|q| &q.measured) {
                Some(Ok(measured)) => decide(name, limits, measured, rule),
                Some(Err(reason)) => undetermined(name, limits, reason.clone()),
                None => undetermined(name, limits, "it was not measured".to_owned()),
            }
        })
        .collect();
    let verdict = if items.iter().any(|i| i.verdict == Verdict::Fail) {
        Verdict::Fail
    } else if items.iter().all(|i| i.verdict == Verdict::Pass) {
        Verdict::Pass
    } else {
        Verdict::CannotTell
    };
    let conformance_probability_min = items
        .iter()
        .map(|i| i.conformance_probability)
        .sum::<Option<f64>>()
        .map(|sum| (1.0 - (items.len() as f64 - sum)).max(0.0));
    Judgement {
        verdict,
        specification: specification.name.clone(),
        decision: *rule,
        decision_rule: rule.sentence(),
        conformance_probability_min,
        items,
        would_decide: BTreeMap::new(),
        warnings: Vec::new(),
    }
}

/// Withdraws the quantities that depend on how the sample lies, where the specification refers to the sample's plane and
/// the rig does not state it.
pub(super) fn in_demanded_plane(
    demanded: Option<ReferencePlane>,
    measured: ReferencePlane,
    mut quantities: Vec<JudgedQuantity>,
) -> Vec<JudgedQuantity> {
    if demanded == Some(ReferencePlane::Sample) && measured != ReferencePlane::Sample {
        for quantity in &mut quantities {
            if PLANE_DEPENDENT.contains(&quantity.name.as_str()) {
                quantity.measured = Err(
                    "the specification refers to the plane of the sample, but the angle is measured to the turntable; \
                     set rig.sample_wedge_std_deg to how well samples lie on it"
                        .to_owned(),
                );
            }
        }
    }
    quantities
}
