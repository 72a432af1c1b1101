//! What would decide where the verdict is *cannot tell*: the uncertainty that is needed at the present value, and by how
//! much a measurement has to improve for it.
//!
//! The lines of the budget combine in quadrature, u² = Σ uᵢ². Where u² has to fall by Δ to the needed uncertainty:
//!
//! - repeats: counting noise falls with 1/√N, so that N = u_c² / (u_c² − Δ) times as many frames per pose are needed;
//! - poses: counting noise and model error fall with 1/√N, so that N = (u_c² + u_m²) / (u_c² + u_m² − Δ) times as many poses
//!   are needed. This takes the model error of further poses as independent of that of the present ones;
//! - any other line: it has to fall to √(uᵢ² − Δ).
//!
//! A way that does not suffice by itself is not listed. The value is assumed to stay: a new measurement may move it.
//!
//! The lines of angles and material stay as they are with more poses of the same azimuths and tilts. Other azimuths and
//! tilts constrain the zeros of the stages and the index better, by how much depends on the grid. No sentence excludes that.

use serde::{Deserialize, Serialize};

use super::decision::{JudgedItem, Verdict, decide_by_uncertainty};
use super::quantity::MeasuredValue;
use super::specification::{DecisionRule, ToleranceLimits};
use crate::fit::report::Parameter;
use crate::fit::uncertainty::coverage::COVERAGE_FACTOR;
use crate::observation::WhiteReference;
use crate::wording::names::budget_line;
use crate::wording::percent;

/// Halvings of the interval that contains the needed uncertainty.
const BISECTIONS: usize = 50;
/// Largest factor of repeats or poses that is proposed.
const FACTOR_MAX: f64 = 100.0;

/// What would decide an item.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct WouldDecide {
    /// The verdict at the present value once the uncertainty is small enough.
    pub verdict: Verdict,
    /// Largest standard uncertainty that gives it, in the unit of the value.
    pub std_max: f64,
    /// Changes that suffice, each by itself.
    pub ways: Vec<Way>,
    /// The same as sentences.
    pub message: String,
}

/// A change of the measurement that suffices by itself.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = WayToDecide)]
#[serde(tag = "change", rename_all = "kebab-case")]
pub enum Way {
    /// More frames per pose.
    Repeats {
        /// Times as many frames per pose, a whole number.
        factor: u32,
    },
    /// More poses.
    Poses {
        /// Poses in addition to the present ones.
        more: u32,
        /// Poses in all.
        total: u32,
    },
    /// A better white reference.
    Reference {
        /// Largest relative standard uncertainty of its reflectance.
        reflectance_rel_std_max: f64,
        /// The present one.
        reflectance_rel_std: f64,
    },
    /// A smaller contribution of another line of the budget.
    Line {
        /// Name of the line.
        line: String,
        /// Share of its present size that it may have.
        share_max: f64,
    },
}

/// The measurement that an item rests on.
pub(super) struct Basis<'a> {
    /// The fitted parameter; none for a contrast.
    pub parameter: Option<&'a Parameter>,
    /// Number of fitted poses.
    pub poses: usize,
    /// The white reference, if there is one.
    pub reference: Option<WhiteReference>,
}

/// Computes what would decide an item; `None` where it is decided, where its value is not known, or where no smaller
/// uncertainty would decide.
pub(super) fn would_decide(
    item: &JudgedItem,
    limits: &ToleranceLimits,
    rule: &DecisionRule,
    basis: &Basis<'_>,
) -> Option<WouldDecide> {
    if item.verdict != Verdict::CannotTell {
        return None;
    }
    let (value, std) = (item.value?, item.std?);
    // Where errors beyond the uncertainty prevent the verdict, a smaller uncertainty does not help.
    item.conformance_probability?;
    let at = |std: f64| {
        let measured = MeasuredValue {
            value,
            std,
            coverage_factor: item.coverage_factor.unwrap_or(COVERAGE_FACTOR),
            degrees_of_freedom: basis.parameter.and_then(|p| p.degrees_of_freedom),
            may_cost: 0.0,
        };
        decide_by_uncertainty(&item.quantity, limits, &measured, rule).verdict
    };
    let (mut enough, mut too_large) = (0.0, std);
    for _ in 0..BISECTIONS {
        let middle = 0.5 * (enough + too_large);
        match at(middle) {
            Verdict::CannotTell => too_large = middle,
            Verdict::Pass | Verdict::Fail => enough = middle,
        }
    }
    // At a limit, half of the values conform whatever the uncertainty is.
    if enough <= 1e-6 * std {
        return None;
    }
    let verdict = at(enough);
    let budget = basis.parameter.and_then(|p| p.budget);
    let lines = budget.map(|budget| budget.named());
    let ways = match &lines {
        Some(lines) => ways(lines, std * std - enough * enough, basis),
        None => Vec::new(),
    };
    let needed = format!(
        "At this value a standard uncertainty of at most {} (now {}) gives {verdict}.",
        in_unit(enough, &item.quantity),
        in_unit(std, &item.quantity)
    );
    let how = match (&lines, ways.is_empty()) {
        (None, _) => "More repeats or poses reduce it.".to_owned(),
        (Some(lines), true) => stuck(lines, enough, &item.quantity),
        (Some(_), false) => {
            let ways: Vec<String> = ways.iter().map(ToString::to_string).collect();
            format!("One of these suffices: {}.", ways.join("; or "))
        }
    };
    Some(WouldDecide {
        verdict,
        std_max: enough,
        ways,
        message: format!("{needed} {how}"),
    })
}

/// Lists the changes that reduce the variance by `excess`, each by itself.
fn ways(lines: &[(&'static str, f64)], excess: f64, basis: &Basis<'_>) -> Vec<Way> {
    let variance = |name: &str| -> f64 {
        let line = lines.iter().find(|(line, _)| *line == name);
        line.map_or(0.0, |(_, std)| std * std)
    };
    let factor = |falls: f64| {
        let factor = falls / (falls - excess);
        (falls > excess && factor <= FACTOR_MAX).then_some(factor)
    };
    let mut ways = Vec::new();
    let counting = variance("counting");
    if let Some(factor) = factor(counting) {
        ways.push(Way::Repeats {
            factor: factor.ceil() as u32,
        });
    }
    if let Some(factor) = factor(counting + variance("model")) {
        let total = (basis.poses as f64 * factor).ceil();
        ways.push(Way::Poses {
            more: (total - basis.poses as f64) as u32,
            total: total as u32,
        });
    }
    for (line, std) in lines {
        let left = std * std - excess;
        if matches!(*line, "counting" | "model") || left <= 0.0 {
            continue;
        }
        let share_max = (left / (std * std)).sqrt();
        ways.push(match (*line, basis.reference) {
            ("reference", Some(reference)) => {
                let now = reference.reflectance_std / reference.reflectance;
                Way::Reference {
                    reflectance_rel_std_max: share_max * now,
                    reflectance_rel_std: now,
                }
            }
            _ => Way::Line {
                line: (*line).to_owned(),
                share_max,
            },
        });
    }
    ways
}

/// States why no single change suffices: the largest lines, which have to shrink together.
fn stuck(lines: &[(&'static str, f64)], enough: f64, quantity: &str) -> String {
    let mut sorted: Vec<_> = lines.iter().filter(|(_, std)| *std > 0.0).collect();
    sorted.sort_by(|a, b| b.1.total_cmp(&a.1));
    let largest: Vec<String> = sorted
        .iter()
        .take(3)
        .map(|(line, std)| format!("{line} {}", in_unit(*std, quantity)))
        .collect();
    let alone = |name: &str| matches!(name, "counting" | "model");
    let rest: f64 = lines
        .iter()
        .filter(|(name, _)| !alone(name))
        .map(|(_, std)| std * std)
        .sum();
    let poses = match rest.sqrt() > enough {
        true => "More poses of this grid do not reach it; a grid of more azimuths and tilts may.",
        false => "No single change of this grid reaches it.",
    };
    format!(
        "{poses} The largest lines of the budget have to shrink together: {}.",
        largest.join(", ")
    )
}

/// A positive value with three significant digits and its unit.
fn in_unit(value: f64, quantity: &str) -> String {
    let decimals = (2.0 - value.log10().floor()).clamp(0.0, 12.0) as usize;
    let unit = if quantity.ends_with("_deg") { "°" } else { "" };
    format!("{value:.decimals$}{unit}")
}

impl std::fmt::Display for Way {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Way::Repeats { factor } => write!(f, "{factor} times as many frames per pose"),
            Way::Poses { more, total } => write!(f, "{more} more poses ({total} in all)"),
            Way::Reference {
                reflectance_rel_std_max,
                reflectance_rel_std,
            } => write!(
                f,
                "a white reference certified to {} (k = 1; now {})",
                percent(*reflectance_rel_std_max),
                percent(*reflectance_rel_std)
            ),
            Way::Line { line, share_max } => {
                let source = match budget_line(line) {
                    "" => line,
                    source => source,
                };
                write!(
                    f,
                    "the part “{source}” of the uncertainty at {} of its size",
                    percent(*share_max)
                )
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::uncertainty::budget::Budget;

    const UPPER: ToleranceLimits = ToleranceLimits {
        lower: None,
        upper: Some(10.0),
    };

    fn of(value: f64, budget: Budget) -> (JudgedItem, Option<WouldDecide>, Parameter) {
        let parameter = Parameter::known(value, budget, None);
        let measured = MeasuredValue {
            value,
            std: parameter.std.unwrap(),
            coverage_factor: 2.0,
            degrees_of_freedom: None,
            may_cost: 0.0,
        };
        let rule = DecisionRule::default();
        let item = decide_by_uncertainty("theta_r_deg", &UPPER, &measured, &rule);
        let basis = Basis {
            parameter: Some(&parameter),
            poses: 15,
            reference: Some(WhiteReference {
                reflectance: 0.98,
                reflectance_std: 0.0098,
            }),
        };
        let found = would_decide(&item, &UPPER, &rule, &basis);
        (item, found, parameter)
    }

    /// The verdict at the same value with this budget.
    fn verdict(value: f64, budget: Budget) -> Verdict {
        of(value, budget).0.verdict
    }

    #[test]
    fn the_stated_number_of_repeats_and_poses_decides_and_one_less_does_not() {
        let now = Budget {
            counting: 0.04,
            model: 0.02,
            angles: 0.01,
            ..Budget::default()
        };
        let value = 9.95;
        assert_eq!(verdict(value, now), Verdict::CannotTell);
        let (_, found, _) = of(value, now);
        let found = found.unwrap();
        assert_eq!(found.verdict, Verdict::Pass);
        let after = |counting: f64, model: f64| Budget {
            counting: now.counting / counting.sqrt(),
            model: now.model / model.sqrt(),
            ..now
        };
        let Way::Repeats { factor } = found.ways[0] else {
            panic!("{found:?}");
        };
        let factor = f64::from(factor);
        assert_eq!(verdict(value, after(factor, 1.0)), Verdict::Pass);
        assert_eq!(
            verdict(value, after(factor - 1.0, 1.0)),
            Verdict::CannotTell
        );
        let Way::Poses { more, total } = found.ways[1] else {
            panic!("{found:?}");
        };
        assert_eq!(more + 15, total);
        let by = |poses: u32| f64::from(poses) / 15.0;
        assert_eq!(verdict(value, after(by(total), by(total))), Verdict::Pass);
        let fewer = by(total - 1);
        assert_eq!(verdict(value, after(fewer, fewer)), Verdict::CannotTell);
        let says = format!(
            "{factor} times as many frames per pose; or {more} more poses ({total} in all)"
        );
        assert!(found.message.contains(&says), "{}", found.message);
    }

    #[test]
    fn the_line_that_dominates_is_the_way() {
        let now = Budget {
            counting: 0.005,
            reference: 0.04,
            ..Budget::default()
        };
        let (_, found, _) = of(9.95, now);
        let found = found.unwrap();
        let [
            Way::Reference {
                reflectance_rel_std_max,
                reflectance_rel_std,
            },
        ] = found.ways[..]
        else {
            panic!("{found:?}");
        };
        let better = Budget {
            reference: now.reference * reflectance_rel_std_max / reflectance_rel_std,
            ..now
        };
        assert!((better.combined() - found.std_max).abs() < 1e-9);
        // Two lines of which neither suffices by itself.
        let (_, both, _) = of(
            9.95,
            Budget {
                angles: 0.03,
                wedge: 0.03,
                ..Budget::default()
            },
        );
        let both = both.unwrap();
        assert!(both.ways.is_empty(), "{both:?}");
        let says =
            "More poses of this grid do not reach it; a grid of more azimuths and tilts may.";
        assert!(both.message.contains(says), "{}", both.message);
        let largest = "angles 0.0300°, wedge 0.0300°";
        assert!(both.message.contains(largest), "{}", both.message);
        assert_eq!(in_unit(4.51e-4, "rho_d"), "0.000451");
    }

    #[test]
    fn a_value_outside_needs_an_uncertainty_that_fails_it_and_one_at_the_limit_has_none() {
        let now = Budget {
            counting: 0.04,
            ..Budget::default()
        };
        let (_, found, _) = of(10.05, now);
        assert_eq!(found.unwrap().verdict, Verdict::Fail);
        assert_eq!(of(10.0, now).1, None);
        // Decided already.
        assert_eq!(of(9.5, now).1, None);
    }
}
