//! Two results beside each other: the difference of each parameter with its expanded uncertainty, and E_n.
//!
//! A line of the budget with the same error in both results cancels as far as its two contributions are equal: of such a
//! line only their difference remains (correlation 1, the same sign). All other lines count as independent. [`shared`]
//! decides from the circumstances of the scans which lines have the same error. The difference is Δ = B − A with
//! u² = Σ(independent) (u_A² + u_B²) + Σ(shared) (u_A − u_B)², U = k·u, and E_n = Δ / U (ISO 13528); the results agree
//! where |E_n| ≤ 1.

pub mod shared;

use serde::Serialize;

use crate::fit::report::{Freedom, Parameter, Parameters, VariantName};
use crate::fit::uncertainty::coverage::coverage_factor;
use shared::{Circumstances, SharedChoice, SharedLine, decided};

/// The result of a scan: what is compared.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredResult {
    /// What it is the result of.
    pub of: ResultOf,
    /// Fitted parameters.
    pub parameters: Parameters,
    /// Degrees of freedom of the lines of their budgets that come from scatter; 0 where the fit does not state them.
    pub freedom: Freedom,
    /// How it was measured.
    pub circumstances: Circumstances,
}

/// The scan and fit of a result.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct ResultOf {
    /// Number of the scan.
    pub scan_id: i64,
    /// Number of the fit: the newest completed one.
    pub fit_id: i64,
    /// Number of the part.
    pub sample_id: i64,
    /// Name of the part.
    pub part: String,
    /// Region of a part that has several.
    pub region: Option<String>,
    /// Variant of the model.
    pub variant: VariantName,
    /// The person at the rig.
    pub operator_name: Option<String>,
    /// When the scan started, or was imported; RFC 3339 in UTC.
    pub measured_at: String,
}

/// A value with its uncertainty, as the fit states it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ComparedValue {
    /// Value, in the unit of the parameter's name.
    pub value: Option<f64>,
    /// Standard uncertainty u (k = 1), same unit.
    pub std: Option<f64>,
    /// Expanded uncertainty U, same unit.
    pub expanded: Option<f64>,
    /// U divided by u.
    pub coverage_factor: Option<f64>,
}

impl From<&Parameter> for ComparedValue {
    fn from(parameter: &Parameter) -> Self {
        ComparedValue {
            value: parameter.value,
            std: parameter.std,
            expanded: parameter.expanded,
            coverage_factor: parameter.coverage_factor,
        }
    }
}

/// The difference of a parameter: second minus first.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Difference {
    /// Second minus first, in the unit of the parameter's name; of an azimuth within ±180°.
    pub value: f64,
    /// Its standard uncertainty (k = 1), same unit.
    pub std: f64,
    /// Its expanded uncertainty, same unit.
    pub expanded: f64,
    /// Expanded divided by standard uncertainty: 2, or Student's t for 95.45 % where the degrees of freedom are fewer than
    /// 50. The lines that cancel have no part in them.
    pub coverage_factor: f64,
    /// E_n: the difference divided by its expanded uncertainty, no unit.
    pub normalised: f64,
    /// Whether |E_n| is at most 1.
    pub agrees: bool,
}

/// A line of the two budgets.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ComparedLine {
    /// Key of the line.
    #[schema(value_type = String)]
    pub line: &'static str,
    /// Its standard uncertainty in the first result, in the unit of the parameter.
    pub first_std: f64,
    /// The same in the second result.
    pub second_std: f64,
    /// Whether it has the same error in both.
    pub shared: bool,
    /// What it contributes to the standard uncertainty of the difference.
    pub difference_std: f64,
}

/// A parameter of both results.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ComparedParameter {
    /// Key of the parameter; its unit is the end of the name.
    #[schema(value_type = String)]
    pub name: &'static str,
    /// First result.
    pub first: ComparedValue,
    /// Second result.
    pub second: ComparedValue,
    /// Second minus first; null where a result has no value or no uncertainty.
    pub difference: Option<Difference>,
    /// Lines of the budgets that are not zero in both.
    pub lines: Vec<ComparedLine>,
}

/// Two results beside each other.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Comparison {
    /// First result, A.
    pub first: ResultOf,
    /// Second result, B.
    pub second: ResultOf,
    /// Lines of the budgets, and whether they have the same error in both results.
    pub shared_lines: Vec<SharedLine>,
    /// The parameters that at least one result has.
    pub parameters: Vec<ComparedParameter>,
    /// What limits the comparison: other parts, other models.
    pub notes: Vec<String>,
}

/// Compares two results.
#[must_use]
pub fn compare(
    first: &MeasuredResult,
    second: &MeasuredResult,
    choice: &SharedChoice,
) -> Comparison {
    let lines = decided(&[&first.circumstances, &second.circumstances], choice);
    let others = second.parameters.named();
    let parameters = first.parameters.named().into_iter();
    let parameters = parameters.filter_map(|(name, a)| {
        let (_, b) = others.iter().find(|(other, _)| *other == name)?;
        (a.value.is_some() || b.value.is_some())
            .then(|| parameter(name, [a, b], [first.freedom, second.freedom], &lines))
    });
    let mut notes = Vec::new();
    if first.of.sample_id != second.of.sample_id {
        notes.push("The scans are of different parts.".to_owned());
    }
    if first.of.variant != second.of.variant {
        notes.push(format!(
            "The fits have different models: {} and {}.",
            first.of.variant, second.of.variant
        ));
    }
    Comparison {
        parameters: parameters.collect(),
        first: first.of.clone(),
        second: second.of.clone(),
        shared_lines: lines,
        notes,
    }
}

/// Lines of a budget with their standard uncertainties. A value without a budget has its whole uncertainty in one line.
fn budget(parameter: &Parameter) -> Vec<(&'static str, f64)> {
    match &parameter.budget {
        Some(budget) => budget.named().to_vec(),
        None => vec![("prior", parameter.std.unwrap_or(0.0))],
    }
}

fn parameter(
    name: &'static str,
    [a, b]: [&Parameter; 2],
    freedom: [Freedom; 2],
    shared: &[SharedLine],
) -> ComparedParameter {
    let part = |budget: &[(&str, f64)], line: &str| {
        let found = budget.iter().find(|(other, _)| *other == line);
        found.map_or(0.0, |(_, std)| *std)
    };
    let (of_a, of_b) = (budget(a), budget(b));
    let lines = shared.iter().filter_map(|line| {
        let (first_std, second_std) = (part(&of_a, line.line), part(&of_b, line.line));
        let shared = line.holds_for(name);
        let difference_std = match shared {
            true => (first_std - second_std).abs(),
            false => first_std.hypot(second_std),
        };
        (first_std > 0.0 || second_std > 0.0).then_some(ComparedLine {
            line: line.line,
            first_std,
            second_std,
            shared,
            difference_std,
        })
    });
    let lines: Vec<ComparedLine> = lines.collect();
    ComparedParameter {
        name,
        first: a.into(),
        second: b.into(),
        difference: difference(name, [a, b], freedom, &lines),
        lines,
    }
}

/// Returns the effective degrees of freedom of a difference by Welch–Satterthwaite; none if practically infinite. A line
/// with the same error in both has those of the result with fewer.
fn difference_freedom(lines: &[ComparedLine], [a, b]: [Freedom; 2]) -> Option<f64> {
    let total: f64 = lines.iter().map(|line| line.difference_std.powi(2)).sum();
    let parts = lines.iter().map(|line| {
        let of = |freedom: Freedom| match line.line {
            "counting" if freedom.counting > 0.0 => freedom.counting,
            "model" if freedom.model > 0.0 => freedom.model,
            _ => f64::INFINITY,
        };
        match line.shared {
            true => line.difference_std.powi(4) / of(a).min(of(b)),
            false => line.first_std.powi(4) / of(a) + line.second_std.powi(4) / of(b),
        }
    });
    let freedom = total * total / parts.sum::<f64>();
    freedom.is_finite().then_some(freedom)
}

fn difference(
    name: &str,
    [a, b]: [&Parameter; 2],
    freedom: [Freedom; 2],
    lines: &[ComparedLine],
) -> Option<Difference> {
    let (first, second) = (a.value?, b.value?);
    a.std.and(b.std)?;
    let squares = lines.iter().map(|line| line.difference_std.powi(2));
    let std = squares.sum::<f64>().sqrt();
    let coverage_factor = coverage_factor(difference_freedom(lines, freedom));
    let value = match name {
        "azimuth_offset_deg" => (second - first + 180.0).rem_euclid(360.0) - 180.0,
        _ => second - first,
    };
    let expanded = coverage_factor * std;
    (expanded > 0.0 && expanded.is_finite()).then(|| Difference {
        value,
        std,
        expanded,
        coverage_factor,
        normalised: value / expanded,
        agrees: value.abs() <= expanded,
    })
}

/// Returns the standard uncertainty without the lines that have the same error in all results.
#[must_use]
pub fn scattering_std(name: &str, parameter: &Parameter, shared: &[SharedLine]) -> Option<f64> {
    parameter.std?;
    let rest = budget(parameter).into_iter().filter(|(line, _)| {
        let found = shared.iter().find(|known| known.line == *line);
        !found.is_some_and(|known| known.holds_for(name))
    });
    Some(rest.map(|(_, std)| std * std).sum::<f64>().sqrt())
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::fit::uncertainty::budget::Budget;

    pub(crate) fn result(scan_id: i64, theta_r_deg: f64, budget: Budget) -> MeasuredResult {
        let unknown = || Parameter::unknown("not in this test");
        let angle = |value: f64| Parameter::known(value, budget, None);
        MeasuredResult {
            of: ResultOf {
                scan_id,
                fit_id: scan_id,
                sample_id: 1,
                part: "B-17".into(),
                region: None,
                variant: VariantName::Sawtooth,
                operator_name: None,
                measured_at: format!("2026-03-{scan_id:02}T09:00:00Z"),
            },
            parameters: Parameters {
                theta_r_deg: angle(theta_r_deg),
                azimuth_offset_deg: angle(if scan_id == 1 { 179.5 } else { -179.0 }),
                alpha_u: unknown(),
                alpha_v: unknown(),
                rho_d: unknown(),
                scale: unknown(),
                background: unknown(),
                tilt_offset_deg: unknown(),
                translucency: None,
                crest_radius: None,
                land_share: None,
            },
            freedom: Freedom::default(),
            circumstances: shared::tests::circumstances(),
        }
    }

    fn lines(counting: f64, reference: f64) -> Budget {
        Budget {
            counting,
            reference,
            ..Budget::default()
        }
    }

    #[test]
    fn a_shared_line_cancels_as_far_as_its_contributions_are_equal() {
        let a = result(1, 10.0, lines(0.03, 0.10));
        let b = result(2, 10.1, lines(0.04, 0.12));
        let angle = |choice| {
            let compared = compare(&a, &b, &choice).parameters.remove(0);
            (compared.name, compared.difference.unwrap())
        };
        let chosen = |lines: &str| SharedChoice::read(lines).unwrap();
        let (name, apart) = angle(chosen("none"));
        assert_eq!(name, "theta_r_deg");
        // √(0.03² + 0.04² + 0.10² + 0.12²)
        assert!((apart.std - 0.164_012).abs() < 1e-6, "{apart:?}");
        assert!((apart.normalised - 0.1 / apart.expanded).abs() < 1e-12 && apart.agrees);
        // √(0.03² + 0.04² + 0.02²)
        let (_, together) = angle(chosen("reference"));
        assert!((together.std - 0.053_852).abs() < 1e-6, "{together:?}");
        assert!((together.expanded - 2.0 * together.std).abs() < 1e-12);
    }

    #[test]
    fn a_line_of_few_degrees_of_freedom_counts_unless_it_cancels() {
        let budget = Budget {
            counting: 0.01,
            model: 0.1,
            ..Budget::default()
        };
        let of = |scan| {
            let freedom = Freedom {
                counting: 100.0,
                model: 2.0,
            };
            MeasuredResult {
                freedom,
                ..result(scan, 10.0, budget)
            }
        };
        let factor = |choice| {
            let compared = compare(&of(1), &of(2), &choice).parameters.remove(0);
            compared.difference.unwrap().coverage_factor
        };
        let chosen = |lines: &str| SharedChoice::read(lines).unwrap();
        // Two independent lines of two degrees of freedom each have four together: t = 2.87.
        assert!((factor(chosen("none")) - 2.87).abs() < 0.03);
        assert_eq!(factor(chosen("model")), 2.0);
    }

    #[test]
    fn an_azimuth_differs_by_the_shorter_way() {
        let (a, b) = (
            result(1, 10.0, lines(0.1, 0.0)),
            result(2, 10.0, lines(0.1, 0.0)),
        );
        let compared = compare(&a, &b, &SharedChoice::Recorded);
        let azimuth = compared
            .parameters
            .iter()
            .find(|p| p.name == "azimuth_offset_deg");
        let value = azimuth.unwrap().difference.unwrap().value;
        assert!((value - 1.5).abs() < 1e-12, "{value}");
    }

    #[test]
    fn without_a_value_or_an_uncertainty_there_is_no_difference() {
        let a = result(1, 10.0, lines(0.1, 0.0));
        let mut b = result(2, 10.0, lines(0.1, 0.0));
        b.parameters.theta_r_deg = Parameter::unknown("too few poses");
        let angle = compare(&a, &b, &SharedChoice::Recorded)
            .parameters
            .remove(0);
        assert_eq!((angle.difference, angle.second.value), (None, None));
        let exact = result(1, 10.0, Budget::default());
        let angle = compare(&exact, &exact, &SharedChoice::Recorded);
        assert_eq!(angle.parameters[0].difference, None);
    }
}
