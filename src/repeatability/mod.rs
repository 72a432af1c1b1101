//! Repeatability: scatter of scans of one part, or of several, beside the uncertainty that their fits state, and gauge
//! R&R over parts and operators or days. With it a lab checks the stated uncertainty by itself.

pub mod anova;
mod design;
pub mod gauge;
pub mod scatter;
mod spreads;

use serde::Serialize;

use crate::comparison::shared::{Circumstances, SharedChoice, SharedLine, decided};
use crate::comparison::{MeasuredResult, ResultOf, scattering_std};
use crate::fit::report::Parameter;
use crate::fit::uncertainty::coverage::COVERAGE_FACTOR;
use gauge::{Gauge, GroupedBy, gauge};
use scatter::{Repeated, Scatter, scatter};

/// The parameter that is evaluated if none is stated.
pub const PARAMETER: &str = "theta_r_deg";

/// What is evaluated.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StudyChoice {
    /// Key of the parameter.
    pub parameter: String,
    /// What reproducibility is taken over; by operators where every scan names one and there are several, otherwise by
    /// days.
    pub by: Option<GroupedBy>,
    /// Lines of the budget with the same error in all scans.
    pub shared: SharedChoice,
}

impl Default for StudyChoice {
    fn default() -> Self {
        StudyChoice {
            parameter: PARAMETER.to_owned(),
            by: None,
            shared: SharedChoice::Recorded,
        }
    }
}

/// A result of the study.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct StudiedResult {
    /// Scan and fit.
    #[serde(flatten)]
    pub of: ResultOf,
    /// Value, in the unit of the parameter's name.
    pub value: f64,
    /// Standard uncertainty u (k = 1), same unit.
    pub std: f64,
    /// Expanded uncertainty U, same unit.
    pub expanded: f64,
    /// U divided by u.
    pub coverage_factor: f64,
    /// Standard uncertainty without the lines that have the same error in all scans.
    pub scattering_std: f64,
    /// Value minus the mean of the part.
    pub deviation: f64,
    /// Lines of the budget that are not zero: standard uncertainties.
    #[schema(value_type = std::collections::BTreeMap<String, f64>)]
    pub budget: std::collections::BTreeMap<&'static str, f64>,
}

/// A scan that is not part of the study.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, utoipa::ToSchema)]
pub struct LeftOutScan {
    /// Number of the scan.
    pub scan_id: i64,
    /// Why.
    pub why: String,
}

/// Scatter of several scans, and gauge R&R.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Repeatability {
    /// Key of the parameter; its unit is the end of the name.
    pub parameter: String,
    /// Results, oldest scan first.
    pub results: Vec<StudiedResult>,
    /// Scans without a result.
    pub left_out: Vec<LeftOutScan>,
    /// Lines of the budget, and whether they have the same error in all scans.
    pub shared_lines: Vec<SharedLine>,
    /// Scatter within parts; null where no part has two results.
    pub scatter: Option<Scatter>,
    /// Components of variance; null where the scans have none.
    pub gauge: Option<Gauge>,
    /// Why there are no components of variance, and what to measure.
    pub gauge_note: Option<String>,
}

/// Evaluates results.
#[must_use]
pub fn study(
    mut measured: Vec<MeasuredResult>,
    mut left_out: Vec<LeftOutScan>,
    choice: &StudyChoice,
) -> Repeatability {
    measured.sort_by_key(|result| result.of.scan_id);
    let name = choice.parameter.as_str();
    let known = |result: &MeasuredResult| named(result, name).is_some_and(is_known);
    let (measured, without): (Vec<_>, Vec<_>) = measured.into_iter().partition(known);
    left_out.extend(without.into_iter().map(|result| LeftOutScan {
        scan_id: result.of.scan_id,
        why: format!("fit {} does not determine {name}", result.of.fit_id),
    }));
    left_out.sort_by_key(|scan| scan.scan_id);
    let circumstances: Vec<&Circumstances> = measured.iter().map(|r| &r.circumstances).collect();
    let shared_lines = decided(&circumstances, &choice.shared);
    let parts = levels(measured.iter().map(|r| r.of.sample_id));
    let repeated: Vec<Repeated> = measured
        .iter()
        .zip(&parts)
        .filter_map(|(result, part)| {
            let parameter = named(result, name)?;
            let (value, std) = (parameter.value?, parameter.std?);
            Some(Repeated {
                part: *part,
                value,
                std,
                scattering_std: scattering_std(name, parameter, &shared_lines)?,
                expanded: parameter.expanded.unwrap_or(COVERAGE_FACTOR * std),
            })
        })
        .collect();
    let values: Vec<f64> = repeated.iter().map(|r| r.value).collect();
    let groups = groups(&measured, choice.by);
    let groups = groups.as_ref().map(|(by, levels)| (*by, levels.as_slice()));
    let (gauge, gauge_note) = match gauge(&values, &parts, groups) {
        Ok(gauge) => (Some(gauge), None),
        Err(note) => (None, Some(note)),
    };
    let results = measured.iter().zip(&repeated).map(|(result, own)| {
        let of_part = repeated.iter().filter(|r| r.part == own.part);
        let (n, sum) = of_part.fold((0.0, 0.0), |(n, sum), r| (n + 1.0, sum + r.value));
        let parameter = named(result, name);
        let budget = parameter.and_then(|p| p.budget.as_ref());
        let lines = budget.into_iter().flat_map(|budget| budget.named());
        StudiedResult {
            of: result.of.clone(),
            value: own.value,
            std: own.std,
            expanded: own.expanded,
            coverage_factor: parameter
                .and_then(|p| p.coverage_factor)
                .unwrap_or(COVERAGE_FACTOR),
            scattering_std: own.scattering_std,
            deviation: own.value - sum / n,
            budget: lines.filter(|(_, std)| *std > 0.0).collect(),
        }
    });
    Repeatability {
        parameter: choice.parameter.clone(),
        results: results.collect(),
        left_out,
        scatter: scatter(&repeated),
        shared_lines,
        gauge,
        gauge_note,
    }
}

fn named<'r>(result: &'r MeasuredResult, name: &str) -> Option<&'r Parameter> {
    let all = result.parameters.named().into_iter();
    all.into_iter()
        .find(|(known, _)| *known == name)
        .map(|(_, parameter)| parameter)
}

fn is_known(parameter: &Parameter) -> bool {
    parameter.value.is_some() && parameter.std.is_some()
}

/// Numbers of different values in their order, from 0.
fn levels<T: PartialEq>(all: impl Iterator<Item = T>) -> Vec<usize> {
    let mut known: Vec<T> = Vec::new();
    all.map(|value| match known.iter().position(|k| *k == value) {
        Some(at) => at,
        None => {
            known.push(value);
            known.len() - 1
        }
    })
    .collect()
}

/// The groups of the results. An operator that is not named is one of its own.
fn groups(measured: &[MeasuredResult], by: Option<GroupedBy>) -> Option<(GroupedBy, Vec<usize>)> {
    let of = |by: GroupedBy| {
        levels(measured.iter().map(|result| match by {
            GroupedBy::Operator => result.of.operator_name.as_deref().unwrap_or_default(),
            GroupedBy::Day => result.of.measured_at.get(..10).unwrap_or_default(),
        }))
    };
    let several = |levels: &[usize]| levels.iter().any(|level| *level > 0);
    if let Some(by) = by {
        return Some((by, of(by)));
    }
    let all_named = measured.iter().all(|r| r.of.operator_name.is_some());
    [GroupedBy::Operator, GroupedBy::Day]
        .into_iter()
        .filter(|by| *by == GroupedBy::Day || all_named)
        .map(|by| (by, of(by)))
        .find(|(_, levels)| several(levels))
}

#[cfg(test)]
mod tests {
    use super::gauge::GaugeDesign;
    use super::*;
    use crate::comparison::tests::result;
    use crate::fit::uncertainty::budget::Budget;

    /// Scans of two parts by two operators, twice each, with errors of the counting by these numbers.
    fn scans() -> Vec<MeasuredResult> {
        let errors = [0.01, -0.02, 0.03, 0.0, -0.01, 0.02, 0.0, -0.03];
        let of = |i: usize| {
            let budget = Budget {
                counting: 0.02,
                model: 0.3,
                ..Budget::default()
            };
            let part = i / 4;
            let mut result = result(i as i64 + 1, 10.0 + part as f64 + errors[i], budget);
            result.of.sample_id = part as i64 + 1;
            result.circumstances.sample_id = result.of.sample_id;
            result.of.operator_name = Some(["anna", "ben"][i / 2 % 2].into());
            result
        };
        (0..8).map(of).collect()
    }

    #[test]
    fn lines_that_all_scans_share_do_not_count_in_the_test_of_the_scatter() {
        let of_one: Vec<_> = scans().into_iter().take(4).collect();
        let study_of = |shared| {
            let choice = StudyChoice {
                shared,
                ..StudyChoice::default()
            };
            study(of_one.clone(), Vec::new(), &choice).scatter.unwrap()
        };
        let recorded = study_of(SharedChoice::Recorded);
        assert!(
            (recorded.scattering_std - 0.02).abs() < 1e-12,
            "{recorded:?}"
        );
        assert!((recorded.stated_std - 0.02_f64.hypot(0.3)).abs() < 1e-12);
        assert_eq!(recorded.verdict, Some(scatter::ScatterVerdict::Consistent));
        let apart = study_of(SharedChoice::Stated(Vec::new()));
        assert_eq!(apart.verdict, Some(scatter::ScatterVerdict::Small));
    }

    #[test]
    fn operators_are_the_groups_where_all_scans_name_one_and_days_otherwise() {
        let by = |measured: Vec<MeasuredResult>| {
            let found = study(measured, Vec::new(), &StudyChoice::default());
            found.gauge.map(|gauge| (gauge.design, gauge.by))
        };
        assert_eq!(
            by(scans()),
            Some((GaugeDesign::Crossed, Some(GroupedBy::Operator)))
        );
        let mut unnamed = scans();
        unnamed[0].of.operator_name = None;
        for (i, result) in unnamed.iter_mut().enumerate() {
            result.of.measured_at = format!("2026-03-0{}T09:00:00Z", i % 2 + 1);
        }
        assert_eq!(
            by(unnamed),
            Some((GaugeDesign::Crossed, Some(GroupedBy::Day)))
        );
    }

    #[test]
    fn a_scan_whose_fit_has_no_value_is_named() {
        let mut measured = scans();
        measured[2].parameters.theta_r_deg = Parameter::unknown("too few poses");
        let found = study(measured, Vec::new(), &StudyChoice::default());
        assert_eq!(found.results.len(), 7);
        assert_eq!(found.left_out[0].scan_id, 3);
        assert!(found.left_out[0].why.contains("does not determine"));
        let deviations: f64 = found.results.iter().map(|r| r.deviation).sum();
        assert!(deviations.abs() < 1e-12);
    }

    #[test]
    fn no_scans_are_no_study() {
        let found = study(Vec::new(), Vec::new(), &StudyChoice::default());
        assert_eq!((found.scatter, found.gauge.is_some()), (None, false));
        assert!(found.gauge_note.is_some());
    }
}
