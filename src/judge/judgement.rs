//! The judgement of all limits together.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::decision::{JudgedItem, Verdict, decide, undetermined};
use super::quantity::{JudgedQuantity, MeasuredValue, PLANE_DEPENDENT};
use super::specification::{DecisionRule, Specification, ToleranceLimits};
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
                Some(Ok(measured)) if name == "azimuth_offset_deg" => {
                    decide(name, limits, &beside(limits, measured), rule)
                }
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

/// An azimuth by the turn that is nearest to its limits: −179.9° for limits about 180° is 180.1°.
fn beside(limits: &ToleranceLimits, measured: &MeasuredValue) -> MeasuredValue {
    let limits = [limits.lower, limits.upper];
    let stated: Vec<f64> = limits.into_iter().flatten().collect();
    let middle = stated.iter().sum::<f64>() / stated.len().max(1) as f64;
    let turns = ((middle - measured.value) / 360.0).round();
    MeasuredValue {
        value: measured.value + 360.0 * turns,
        ..*measured
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_azimuth_is_compared_with_its_limits_on_their_turn() {
        let at = |value: f64, lower: Option<f64>, upper: Option<f64>| {
            let measured = MeasuredValue {
                value,
                std: 0.1,
                coverage_factor: 2.0,
                degrees_of_freedom: None,
                may_cost: 0.0,
            };
            beside(&ToleranceLimits { lower, upper }, &measured).value
        };
        assert!((at(-179.9, Some(179.0), Some(181.0)) - 180.1).abs() < 1e-9);
        assert!((at(179.9, Some(-181.0), Some(-179.0)) + 180.1).abs() < 1e-9);
        assert_eq!(at(3.0, Some(-2.0), Some(2.0)), 3.0);
        assert_eq!(at(3.0, None, Some(2.0)), 3.0);
    }
}
