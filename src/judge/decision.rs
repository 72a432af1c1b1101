//! The decision about one limit.

use serde::{Deserialize, Serialize};

use super::quantity::MeasuredValue;
use super::specification::{DecisionRule, ToleranceLimits};
use super::true_value::TrueValue;
use crate::wording::stated;

/// The result for one limit, or for all of them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = VerdictWord)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Conforms, at the allowed risk.
    Pass,
    /// Does not conform, at the allowed risk.
    Fail,
    /// The uncertainty is too large for either, or the quantity is not determined.
    CannotTell,
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Verdict::Pass => "pass",
            Verdict::Fail => "fail",
            Verdict::CannotTell => "cannot tell",
        })
    }
}

/// The judgement of one limited quantity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct JudgedItem {
    /// Quantity, with its unit in the name.
    pub quantity: String,
    /// Measured value.
    pub value: Option<f64>,
    /// Standard uncertainty.
    pub std: Option<f64>,
    /// Expanded uncertainty.
    pub expanded: Option<f64>,
    /// Ratio of expanded to standard uncertainty.
    pub coverage_factor: Option<f64>,
    /// Lower tolerance limit.
    pub lower: Option<f64>,
    /// Upper tolerance limit.
    pub upper: Option<f64>,
    /// Width of the guard band. With two limits the risks at both count, which widens it where the tolerance is
    /// only a few standard uncertainties wide.
    pub guard_band: Option<f64>,
    /// Lower acceptance limit: tolerance limit plus guard band; null where the guard bands of two limits meet.
    pub acceptance_lower: Option<f64>,
    /// Upper acceptance limit.
    pub acceptance_upper: Option<f64>,
    /// Probability that the true value conforms.
    pub conformance_probability: Option<f64>,
    /// The result.
    pub verdict: Verdict,
    /// The reason for it.
    pub reason: String,
}

/// Judges a quantity that was not measured.
pub(super) fn undetermined(name: &str, limits: &ToleranceLimits, reason: String) -> JudgedItem {
    JudgedItem {
        quantity: name.to_owned(),
        value: None,
        std: None,
        expanded: None,
        coverage_factor: None,
        lower: limits.lower,
        upper: limits.upper,
        guard_band: None,
        acceptance_lower: None,
        acceptance_upper: None,
        conformance_probability: None,
        verdict: Verdict::CannotTell,
        reason,
    }
}

/// Judges a measured quantity. Where the value may be off by more than its uncertainty includes, both ends of that range
/// must give the same verdict.
pub(super) fn decide(
    name: &str,
    limits: &ToleranceLimits,
    measured: &MeasuredValue,
    rule: &DecisionRule,
) -> JudgedItem {
    let mut item = decide_by_uncertainty(name, limits, measured, rule);
    let holds_at = |value| {
        let moved = MeasuredValue { value, ..*measured };
        decide_by_uncertainty(name, limits, &moved, rule).verdict == item.verdict
    };
    let reach = measured.may_cost;
    if !(holds_at(measured.value - reach) && holds_at(measured.value + reach)) {
        item.verdict = Verdict::CannotTell;
        item.conformance_probability = None;
        item.reason = format!(
            "stage errors that the uncertainty does not include may change the value by {}, which reaches the limit",
            two_digits(reach)
        );
    }
    item
}

pub(super) fn decide_by_uncertainty(
    name: &str,
    limits: &ToleranceLimits,
    m: &MeasuredValue,
    rule: &DecisionRule,
) -> JudgedItem {
    if !(m.value.is_finite() && m.std.is_finite() && m.std >= 0.0) {
        let reason = "its value or uncertainty is not a number".to_owned();
        return undetermined(name, limits, reason);
    }
    let truth = TrueValue::given(m);
    let below_lower = limits.lower.map_or(0.0, |t| truth.below(t));
    let below_upper = limits.upper.map_or(1.0, |t| truth.below(t));
    let above_upper = limits.upper.map_or(0.0, |t| truth.above(t));
    let conforms = (below_upper - below_lower).clamp(0.0, 1.0);
    // 1 − conforms would lose the digits of a small risk.
    let violates = (above_upper + below_lower).clamp(0.0, 1.0);
    let accept_risk = rule.max_false_accept_risk;
    let reject_risk = rule.max_false_reject_risk;
    let one_sided = truth.guard_band(accept_risk);
    let guard_band = match (limits.lower, limits.upper) {
        (Some(lower), Some(upper)) => truth.guard_band_between([lower, upper], accept_risk),
        _ => Some(one_sided),
    };
    // A value between the limits is never rejected, however large its uncertainty: rejection begins outside (JCGM 106,
    // 8.3.3).
    let inside =
        limits.lower.is_none_or(|t| m.value >= t) && limits.upper.is_none_or(|t| m.value <= t);
    let (verdict, reason) = if violates <= accept_risk {
        (
            Verdict::Pass,
            format!(
                "risk of nonconformity {} (allowed {})",
                percent(violates),
                risk(accept_risk)
            ),
        )
    } else if conforms <= reject_risk && !inside {
        (
            Verdict::Fail,
            format!(
                "probability of conformity {} (allowed {})",
                percent(conforms),
                risk(reject_risk)
            ),
        )
    } else {
        let limits = match (limits.lower.and(limits.upper), guard_band) {
            (Some(_), None) => "these limits; no value between them would pass",
            (Some(_), Some(_)) => "these limits",
            (None, _) => "this limit",
        };
        (
            Verdict::CannotTell,
            format!(
                "probability of conformity {}; the uncertainty is too large for {limits}",
                percent(conforms)
            ),
        )
    };
    JudgedItem {
        quantity: name.to_owned(),
        value: Some(m.value),
        std: Some(m.std),
        expanded: Some(m.coverage_factor * m.std),
        coverage_factor: Some(m.coverage_factor),
        lower: limits.lower,
        upper: limits.upper,
        guard_band: Some(guard_band.unwrap_or(one_sided)),
        acceptance_lower: limits.lower.zip(guard_band).map(|(t, g)| t + g),
        acceptance_upper: limits.upper.zip(guard_band).map(|(t, g)| t - g),
        conformance_probability: Some(conforms),
        verdict,
        reason,
    }
}

fn two_digits(value: f64) -> String {
    match (1e-3..1e4).contains(&value) {
        true => {
            let decimals = (1.0 - value.log10().floor()).max(0.0) as usize;
            format!("{value:.decimals$}")
        }
        false => format!("{value:.1e}"),
    }
}

/// Returns an allowed risk with the digits that it was stated with.
fn risk(share: f64) -> String {
    format!("{} %", stated(100.0 * share))
}

fn percent(share: f64) -> String {
    if share < 1e-4 {
        "< 0.01 %".to_owned()
    } else if share > 0.9999 {
        "> 99.99 %".to_owned()
    } else {
        format!("{:.2} %", 100.0 * share)
    }
}
