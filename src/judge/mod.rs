//! Conformity: measured parameters and contrast against a specification, with guard bands.
//!
//! Call [`judge`] with a [`Specification`] and the quantities measured ([`Quantity`], for instance
//! from [`parameters`] and [`contrasts`]). Each limit is decided after JCGM 106:2012: with the measured value y, its
//! standard uncertainty u and effective degrees of freedom ν, the probability that the true value
//! conforms is p = F((TU − y)/u) − F((TL − y)/u), F the t distribution (JCGM 106, 7.3 and 9).
//!
//! *Decision rule*: **pass** where 1 − p, the risk that a nonconforming item is accepted, is at most
//! the specification's `max_false_accept_risk`; **fail** where p, the risk that a conforming item is
//! rejected, is at most `max_false_reject_risk`; **cannot tell** between, and where a quantity is
//! not identifiable. For limits far apart this is guarded acceptance: the acceptance limits lie
//! inside the tolerance limits by the guard band g = t(1 − risk) · u (JCGM 106, 8.3.2), which is
//! printed. The whole fails if one item fails and passes if all pass.
//!
//! This room knows no files and no frames: it reads text and numbers.

mod contrast;
mod specification;

pub use contrast::{CONTRAST_MEAN, CONTRAST_MICHELSON_MEAN, Contrasts, contrasts};
pub use specification::{Decision, Limits, Specification, SpecificationError};

use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

use crate::fit::report::{FitReport, LeftOut, ReferencePlane, Status, Timing, VariantName};
use crate::geometry::Pose;
use crate::observation::ObservationSet;

/// A measured number, or why there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct Quantity {
    /// Name, as in the specification.
    pub name: String,
    /// Value with its uncertainty.
    pub measured: Result<Measured, String>,
}

/// A value with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measured {
    /// Best estimate.
    pub value: f64,
    /// Standard uncertainty, everything known in it.
    pub std: f64,
    /// Expanded over standard uncertainty, for the report.
    pub coverage_factor: f64,
    /// Effective degrees of freedom; `None` where practically infinite.
    pub degrees_of_freedom: Option<f64>,
    /// How far the value may be off by what no uncertainty holds.
    pub may_cost: f64,
}

/// What is said of one limit or of all.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Conforms, at the accepted risk.
    Pass,
    /// Does not conform, at the accepted risk.
    Fail,
    /// The uncertainty is too large for either, or the quantity is not known.
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

/// One line of the judgement.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Item {
    /// Quantity, with its unit in the name.
    pub quantity: String,
    /// Measured value.
    pub value: Option<f64>,
    /// Standard uncertainty.
    pub std: Option<f64>,
    /// Expanded uncertainty.
    pub expanded: Option<f64>,
    /// Expanded over standard uncertainty.
    pub coverage_factor: Option<f64>,
    /// Lower tolerance limit.
    pub lower: Option<f64>,
    /// Upper tolerance limit.
    pub upper: Option<f64>,
    /// Width of the guard band. Where both limits are set the risks at both count, which widens it once the tolerance is
    /// but a few standard uncertainties wide.
    pub guard_band: Option<f64>,
    /// Lower acceptance limit: tolerance limit plus guard band; none where the guard bands of both limits meet.
    pub acceptance_lower: Option<f64>,
    /// Upper acceptance limit.
    pub acceptance_upper: Option<f64>,
    /// Probability that the true value conforms.
    pub conformance_probability: Option<f64>,
    /// What follows.
    pub verdict: Verdict,
    /// Why, in words.
    pub reason: String,
}

/// The judgement of one sample.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Judgement {
    /// Of all items together.
    pub verdict: Verdict,
    /// Name of the specification.
    pub specification: String,
    /// The rule by which it was decided.
    pub decision: Decision,
    /// The rule in words.
    pub decision_rule: String,
    /// At least this probable that all items conform (Boole's inequality; correlations would only
    /// help); null where an item is unknown.
    pub conformance_probability_min: Option<f64>,
    /// One line per limit.
    pub items: Vec<Item>,
    /// Sentences for the user, those of the fit among them.
    pub warnings: Vec<String>,
}

/// The object of `judge --json`: a judgement and the fit it rests on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VerdictReport {
    /// What follows from the numbers.
    #[serde(flatten)]
    pub judgement: Judgement,
    /// Model that the numbers hang on.
    pub variant: VariantName,
    /// How its fit ended.
    pub status: Status,
    /// Region of the sample.
    pub region: Option<String>,
    /// The plane that θr and azimuth refer to.
    #[serde(default)]
    pub reference_plane: ReferencePlane,
    /// Tilts that mean contrasts are over, degrees; null where none is limited.
    #[serde(default)]
    pub contrast_theta_c_deg: Option<Vec<f64>>,
    /// What the fit left out, why, and what that may cost.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// Seconds of reading, reducing and fitting.
    #[serde(default)]
    pub timing_s: Timing,
    /// Name and version of the program.
    pub program: String,
}

impl VerdictReport {
    /// Judges what a fit and its observations say; `planned` are the poses of the sample's frames, whether they could be
    /// used or not.
    #[must_use]
    pub fn new(
        specification: &Specification,
        report: &FitReport,
        observations: &ObservationSet,
        planned: &[Pose],
    ) -> Self {
        let mut quantities = to_the_plane(
            specification.reference_plane,
            report.reference_plane,
            parameters(report),
        );
        let mut left_out = report.left_out.clone();
        let mut warnings = report.warnings.clone();
        let limited = [CONTRAST_MEAN, CONTRAST_MICHELSON_MEAN];
        let limited = limited
            .iter()
            .any(|q| specification.limits.contains_key(*q));
        let contrasts = limited.then(|| contrasts(observations, planned, report));
        let contrast_theta_c_deg = contrasts.map(|contrasts| {
            quantities.extend(contrasts.quantities);
            warnings.extend(contrasts.warnings);
            left_out.extend(contrasts.left_out);
            contrasts.theta_c_deg
        });
        let mut judgement = judge(specification, &quantities);
        judgement.warnings.extend(warnings);
        VerdictReport {
            judgement,
            contrast_theta_c_deg,
            variant: report.variant,
            status: report.status,
            region: report.region.clone(),
            reference_plane: report.reference_plane,
            left_out,
            timing_s: report.timing_s,
            program: report.program.clone(),
        }
    }
}

/// Judges quantities against a specification.
///
/// Limits on quantities that are not in the list cannot be told, with that reason.
#[must_use]
pub fn judge(specification: &Specification, quantities: &[Quantity]) -> Judgement {
    let decision = &specification.decision;
    let items: Vec<Item> = specification
        .limits
        .iter()
        .map(|(name, limits)| {
            let measured = quantities.iter().find(|q| q.name == *name).map_or_else(
                || Err("it was not measured".to_owned()),
                |q| q.measured.clone(),
            );
            match measured {
                Ok(m) => decide(name, limits, &m, decision),
                Err(reason) => unknown(name, limits, reason),
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
        decision: *decision,
        decision_rule: decision.in_words(),
        conformance_probability_min,
        items,
        warnings: Vec::new(),
    }
}

/// What depends on how the sample lies is not known where the specification counts to the sample's plane and the rig does
/// not state it.
fn to_the_plane(
    demanded: Option<ReferencePlane>,
    measured: ReferencePlane,
    mut quantities: Vec<Quantity>,
) -> Vec<Quantity> {
    if demanded == Some(ReferencePlane::Sample) && measured != ReferencePlane::Sample {
        for quantity in &mut quantities {
            if specification::TO_A_PLANE.contains(&quantity.name.as_str()) {
                quantity.measured = Err(
                    "the specification counts angles to the sample's plane, and it is measured to the turntable: \
                     rig.sample_wedge_std_deg does not state how well samples lie on it"
                        .to_owned(),
                );
            }
        }
    }
    quantities
}

fn unknown(name: &str, limits: &Limits, reason: String) -> Item {
    Item {
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

/// Decides one limit. Where a value may be off by more than its uncertainty holds, both ends have to say the same.
fn decide(name: &str, limits: &Limits, m: &Measured, decision: &Decision) -> Item {
    let mut item = decide_as_known(name, limits, m, decision);
    let at = |value| decide_as_known(name, limits, &Measured { value, ..*m }, decision).verdict;
    let holds = [m.value - m.may_cost, m.value + m.may_cost].map(|end| at(end) == item.verdict);
    if holds != [true; 2] {
        item.verdict = Verdict::CannotTell;
        item.conformance_probability = None;
        item.reason = format!(
            "errors of the stages may change it by {}, which is not in its uncertainty and reaches the limit",
            number(m.may_cost)
        );
    }
    item
}

fn decide_as_known(name: &str, limits: &Limits, m: &Measured, decision: &Decision) -> Item {
    if !(m.value.is_finite() && m.std.is_finite() && m.std >= 0.0) {
        return unknown(
            name,
            limits,
            "its value or uncertainty is not a number".to_owned(),
        );
    }
    let distribution = Deviation::of(m);
    let below_upper = limits.upper.map_or(1.0, |t| distribution.below(t));
    let below_lower = limits.lower.map_or(0.0, |t| distribution.below(t));
    // The complement by its own sum: 1 − p would lose the digits of a small risk.
    let above_upper = limits.upper.map_or(0.0, |t| distribution.above(t));
    let conforms = (below_upper - below_lower).clamp(0.0, 1.0);
    let violates = (above_upper + below_lower).clamp(0.0, 1.0);
    let alone = distribution.quantile(1.0 - decision.max_false_accept_risk) * m.std;
    let between = match (limits.lower, limits.upper) {
        (Some(lower), Some(upper)) => {
            distribution.guard_band_between([lower, upper], decision.max_false_accept_risk, alone)
        }
        _ => Some(alone),
    };
    // An uncertainty that is too large for the limits is no reason to reject what was measured between them: rejection
    // begins outside (JCGM 106, 8.3.3).
    let inside =
        limits.lower.is_none_or(|t| m.value >= t) && limits.upper.is_none_or(|t| m.value <= t);
    // No value would pass: there is no interval of acceptance.
    let closed = between.is_none();
    let guard_band = between.unwrap_or(alone);
    let (verdict, reason) = if violates <= decision.max_false_accept_risk {
        (
            Verdict::Pass,
            format!(
                "the risk that it does not conform is {}, at most {} is accepted",
                percent(violates),
                percent(decision.max_false_accept_risk)
            ),
        )
    } else if conforms <= decision.max_false_reject_risk && !inside {
        (
            Verdict::Fail,
            format!(
                "the chance that it conforms is {}, at most {} is accepted",
                percent(conforms),
                percent(decision.max_false_reject_risk)
            ),
        )
    } else {
        (
            Verdict::CannotTell,
            format!(
                "the chance that it conforms is {}: the uncertainty is too large for {}",
                percent(conforms),
                match (limits.lower.and(limits.upper), closed) {
                    (Some(_), true) => "these limits, no value between them would pass",
                    (Some(_), false) => "these limits",
                    (None, _) => "this limit",
                }
            ),
        )
    };
    Item {
        quantity: name.to_owned(),
        value: Some(m.value),
        std: Some(m.std),
        expanded: Some(m.coverage_factor * m.std),
        coverage_factor: Some(m.coverage_factor),
        lower: limits.lower,
        upper: limits.upper,
        guard_band: Some(guard_band),
        acceptance_lower: limits.lower.filter(|_| !closed).map(|t| t + guard_band),
        acceptance_upper: limits.upper.filter(|_| !closed).map(|t| t - guard_band),
        conformance_probability: Some(conforms),
        verdict,
        reason,
    }
}

/// Two digits of a number.
fn number(value: f64) -> String {
    match (1e-3..1e4).contains(&value) {
        true => {
            let decimals = (1.0 - value.log10().floor()).max(0.0) as usize;
            format!("{value:.decimals$}")
        }
        false => format!("{value:.1e}"),
    }
}

fn percent(share: f64) -> String {
    if share < 1e-4 {
        "below 0.01 %".to_owned()
    } else if share > 0.9999 {
        "above 99.99 %".to_owned()
    } else {
        format!("{:.2} %", 100.0 * share)
    }
}

/// Halvings of an interval after which doubles have no more digits for it.
const BISECTIONS: usize = 60;

/// The distribution of the true value about the measured one.
struct Deviation {
    value: f64,
    std: f64,
    freedom: Option<StudentsT>,
}

impl Deviation {
    fn of(m: &Measured) -> Self {
        Deviation {
            value: m.value,
            std: m.std,
            // Beyond a few thousand degrees of freedom t is normal to all digits printed.
            freedom: m
                .degrees_of_freedom
                .filter(|f| f.is_finite() && *f >= 1.0 && *f < 1e4)
                .and_then(|f| StudentsT::new(0.0, 1.0, f).ok()),
        }
    }

    /// How far inside two limits a measured value's risk to lie beyond either falls to `risk`; `None` where no value
    /// between them has so little. `alone` is the same of one limit, and less.
    fn guard_band_between(&self, [lower, upper]: [f64; 2], risk: f64, alone: f64) -> Option<f64> {
        let half = 0.5 * (upper - lower);
        let risk_at = |inside: f64| {
            let measured = Deviation {
                value: lower + inside,
                std: self.std,
                freedom: self.freedom,
            };
            measured.below(lower) + measured.above(upper)
        };
        // The middle has the least risk.
        if risk_at(half) > risk {
            return None;
        }
        let (mut out, mut inside) = (alone.min(half), half);
        if risk_at(out) <= risk {
            return Some(out);
        }
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (out + inside);
            match risk_at(middle) <= risk {
                true => inside = middle,
                false => out = middle,
            }
        }
        Some(inside)
    }

    /// Probability that the true value lies below a limit.
    fn below(&self, limit: f64) -> f64 {
        if self.std == 0.0 {
            return if self.value <= limit { 1.0 } else { 0.0 };
        }
        self.cdf((limit - self.value) / self.std)
    }

    /// Probability that the true value lies above a limit.
    fn above(&self, limit: f64) -> f64 {
        if self.std == 0.0 {
            return if self.value > limit { 1.0 } else { 0.0 };
        }
        self.cdf((self.value - limit) / self.std)
    }

    fn cdf(&self, z: f64) -> f64 {
        match &self.freedom {
            Some(t) => t.cdf(z),
            None => Normal::standard().cdf(z),
        }
    }

    fn quantile(&self, probability: f64) -> f64 {
        match &self.freedom {
            Some(t) => t.inverse_cdf(probability),
            None => Normal::standard().inverse_cdf(probability),
        }
    }
}

/// What a fit says, by the names that a specification uses.
#[must_use]
pub fn parameters(report: &FitReport) -> Vec<Quantity> {
    let no_answer = match report.status {
        Status::Converged | Status::AtBound | Status::RankDeficient => None,
        Status::Stalled | Status::NotFinite | Status::TooFewObservations | Status::Cancelled => {
            Some("the fit has no answer; its status and warnings say why")
        }
    };
    report
        .parameters
        .named()
        .into_iter()
        .map(|(name, parameter)| {
            let measured = match (no_answer, parameter.value, parameter.std) {
                (Some(reason), ..) => Err(reason.to_owned()),
                (None, Some(value), Some(std)) if parameter.identifiable => Ok(Measured {
                    value,
                    std,
                    coverage_factor: parameter
                        .coverage_factor
                        .unwrap_or(crate::fit::report::COVERAGE_FACTOR),
                    degrees_of_freedom: parameter.degrees_of_freedom,
                    may_cost: 0.0,
                }),
                _ => Err(parameter.note.as_ref().map_or_else(
                    || "the data cannot determine it on this rig".to_owned(),
                    |note| format!("the data cannot determine it: {note}"),
                )),
            };
            Quantity {
                name: name.to_owned(),
                measured,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn measured(value: f64, std: f64) -> Measured {
        Measured {
            value,
            std,
            coverage_factor: 2.0,
            degrees_of_freedom: None,
            may_cost: 0.0,
        }
    }

    fn specification(text: &str) -> Specification {
        Specification::from_toml(text, "spec.toml").unwrap()
    }

    fn verdict_of(text: &str, value: f64, std: f64) -> Item {
        let quantity = Quantity {
            name: "theta_r_deg".to_owned(),
            measured: Ok(measured(value, std)),
        };
        judge(&specification(text), &[quantity]).items.remove(0)
    }

    const ONE_SIDED: &str = "name = \"s\"\n[limits]\ntheta_r_deg = { upper = 10.5 }\n[decision]\nmax_false_accept_risk = 0.05\nmax_false_reject_risk = 0.05\n";

    #[test]
    fn limits_closer_than_their_guard_bands_have_no_acceptance_interval() {
        let both = ONE_SIDED.replace("{ upper", "{ lower = 10.2, upper");
        let item = verdict_of(&both, 10.35, 0.1);
        assert_eq!(item.verdict, Verdict::CannotTell);
        assert_eq!((item.acceptance_lower, item.acceptance_upper), (None, None));
        assert!(
            item.reason.contains("no value between them would pass"),
            "{}",
            item.reason
        );
        let item = verdict_of(&both, 10.35, 0.05);
        assert!(item.acceptance_lower < item.acceptance_upper);
    }

    #[test]
    fn the_acceptance_limit_is_where_pass_begins() {
        // One-sided 95 %: g = 1.644854 u.
        let item = verdict_of(ONE_SIDED, 10.0, 0.1);
        assert!((item.guard_band.unwrap() - 0.164_485_362_695).abs() < 1e-9);
        let limit = item.acceptance_upper.unwrap();
        assert_eq!(
            verdict_of(ONE_SIDED, limit - 1e-6, 0.1).verdict,
            Verdict::Pass
        );
        assert_eq!(
            verdict_of(ONE_SIDED, limit + 1e-6, 0.1).verdict,
            Verdict::CannotTell
        );
        assert_eq!(
            verdict_of(ONE_SIDED, 10.5, 0.1).verdict,
            Verdict::CannotTell
        );
        let fails = 10.5 + item.guard_band.unwrap();
        assert_eq!(
            verdict_of(ONE_SIDED, fails - 1e-6, 0.1).verdict,
            Verdict::CannotTell
        );
        assert_eq!(
            verdict_of(ONE_SIDED, fails + 1e-6, 0.1).verdict,
            Verdict::Fail
        );
    }

    #[test]
    fn between_two_limits_the_acceptance_interval_is_where_values_pass() {
        let text = "name = \"s\"\n[limits]\ntheta_r_deg = { lower = 9.8, upper = 10.2 }\n";
        let verdict = |value, std| verdict_of(text, value, std).verdict;
        for std in [0.01, 0.05, 0.08, 0.088] {
            let item = verdict_of(text, 10.0, std);
            let (low, high) = (
                item.acceptance_lower.unwrap(),
                item.acceptance_upper.unwrap(),
            );
            assert!((low - 9.8 - item.guard_band.unwrap()).abs() < 1e-12);
            assert_eq!(verdict(low + 1e-7, std), Verdict::Pass, "{std}");
            assert_eq!(verdict(low - 1e-7, std), Verdict::CannotTell, "{std}");
            assert_eq!(verdict(high - 1e-7, std), Verdict::Pass, "{std}");
            assert_eq!(verdict(high + 1e-7, std), Verdict::CannotTell, "{std}");
        }
        // Guard bands of one limit each would leave room at the middle, where 3.6 % risk is more than 2.5 %.
        let item = verdict_of(text, 10.0, 0.2 / 2.1);
        assert_eq!(item.verdict, Verdict::CannotTell);
        assert_eq!((item.acceptance_lower, item.acceptance_upper), (None, None));
        assert!(
            item.reason
                .ends_with("these limits, no value between them would pass")
        );
    }

    #[test]
    fn two_limits_give_the_probability_between_them() {
        let text = "name = \"s\"\n[limits]\ntheta_r_deg = { lower = 9.8, upper = 10.2 }\n";
        // ±2 u about the value: 95.449974 %.
        let item = verdict_of(text, 10.0, 0.1);
        assert!((item.conformance_probability.unwrap() - 0.954_499_736_1).abs() < 1e-9);
        assert_eq!(item.verdict, Verdict::CannotTell);
        assert_eq!(verdict_of(text, 10.0, 0.05).verdict, Verdict::Pass);
        // An uncertainty wider than the tolerance can never pass, and does not fail either.
        assert_eq!(verdict_of(text, 10.0, 1.0).verdict, Verdict::CannotTell);
        // Nor where hardly any of its distribution lies between the limits; outside them it may.
        let wide = verdict_of(text, 10.1, 20.0);
        assert!(wide.conformance_probability.unwrap() < 0.01, "{wide:?}");
        assert_eq!(wide.verdict, Verdict::CannotTell);
        assert_eq!(verdict_of(text, 10.3, 20.0).verdict, Verdict::Fail);
        assert_eq!(verdict_of(text, 11.0, 0.1).verdict, Verdict::Fail);
    }

    #[test]
    fn few_degrees_of_freedom_widen_the_guard_band() {
        let few = Measured {
            degrees_of_freedom: Some(4.0),
            ..measured(10.0, 0.1)
        };
        let spec = specification(ONE_SIDED);
        let item = decide(
            "theta_r_deg",
            &spec.limits["theta_r_deg"],
            &few,
            &spec.decision,
        );
        // t(0.95; 4) = 2.131847.
        assert!((item.guard_band.unwrap() - 0.213_184_7).abs() < 1e-6);
    }

    #[test]
    fn what_no_uncertainty_holds_leaves_a_limit_open_only_within_its_reach() {
        let spec = specification(ONE_SIDED);
        let with = |value, may_cost| {
            let m = Measured {
                may_cost,
                ..measured(value, 0.1)
            };
            decide(
                "theta_r_deg",
                &spec.limits["theta_r_deg"],
                &m,
                &spec.decision,
            )
        };
        assert_eq!(with(10.0, 0.3).verdict, Verdict::Pass);
        assert_eq!(with(12.0, 0.3).verdict, Verdict::Fail);
        let open = with(10.0, 0.4);
        assert_eq!(open.verdict, Verdict::CannotTell);
        assert_eq!(open.conformance_probability, None);
        assert!(open.reason.contains("by 0.40"), "{}", open.reason);
    }

    #[test]
    fn without_uncertainty_a_limit_is_a_limit() {
        assert_eq!(verdict_of(ONE_SIDED, 10.5, 0.0).verdict, Verdict::Pass);
        assert_eq!(
            verdict_of(ONE_SIDED, 10.500_001, 0.0).verdict,
            Verdict::Fail
        );
    }

    #[test]
    fn angles_to_the_samples_plane_cannot_be_told_where_nobody_states_how_it_lies() {
        let text = "name = \"s\"\nreference_plane = \"sample\"\n[limits]\ntheta_r_deg = { upper = 10.5 }\nalpha_u = { upper = 10.5 }\n";
        let spec = specification(text);
        let quantities = || {
            ["theta_r_deg", "alpha_u"].map(|name| Quantity {
                name: name.to_owned(),
                measured: Ok(measured(10.0, 0.01)),
            })
        };
        let verdict = |demanded, plane| {
            let quantities = to_the_plane(demanded, plane, quantities().to_vec());
            judge(&spec, &quantities)
        };
        let (turntable, sample) = (ReferencePlane::Turntable, ReferencePlane::Sample);
        let open = verdict(spec.reference_plane, turntable);
        assert_eq!(open.verdict, Verdict::CannotTell);
        // Roughness is the same to any plane.
        assert_eq!(open.items[0].verdict, Verdict::Pass);
        let reason = &open.items[1].reason;
        assert!(reason.contains("sample_wedge_std_deg"), "{reason}");
        for (demanded, plane) in [
            (spec.reference_plane, sample),
            (None, turntable),
            (Some(turntable), turntable),
            (Some(turntable), sample),
        ] {
            assert_eq!(verdict(demanded, plane).verdict, Verdict::Pass);
        }
    }

    #[test]
    fn one_failure_fails_the_whole_and_an_unknown_leaves_it_open() {
        let text =
            "name = \"s\"\n[limits]\ntheta_r_deg = { upper = 10.5 }\nrho_d = { lower = 0.1 }\n";
        let theta = |value| Quantity {
            name: "theta_r_deg".to_owned(),
            measured: Ok(measured(value, 0.01)),
        };
        let rho = Quantity {
            name: "rho_d".to_owned(),
            measured: Err("k is free".to_owned()),
        };
        let spec = specification(text);
        let open = judge(&spec, &[theta(10.0), rho.clone()]);
        assert_eq!(open.verdict, Verdict::CannotTell);
        assert_eq!(open.conformance_probability_min, None);
        assert_eq!(open.items[0].quantity, "rho_d");
        assert!(open.items[0].reason.contains("k is free"));
        assert_eq!(judge(&spec, &[theta(12.0), rho]).verdict, Verdict::Fail);
        assert!(
            judge(&spec, &[theta(10.0)]).items[0]
                .reason
                .contains("not measured")
        );
    }
}
