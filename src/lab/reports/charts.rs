//! Control charts of stored results: the chart of a parameter, the limits of a specification, and what is due.

use serde::{Deserialize, Serialize};
use time::OffsetDateTime;

use super::comparisons::is_parameter;
use crate::chart::{self, ChartValue, ChartedResult, ControlChart};
use crate::config::DueSection;
use crate::fit::uncertainty::coverage::COVERAGE_FACTOR;
use crate::job::{JobId, JobKind};
use crate::judge::{
    JudgedItem, JudgedQuantity, MeasuredValue, Specification, ToleranceLimits, judge,
};
use crate::lab::jobs::verdicts::VerdictRequest;
use crate::lab::request_checks::invalid;
use crate::lab::scans::due::{Due, due};
use crate::lab::specifications::specified;
use crate::lab::{LabError, definitions};
use crate::repeatability::PARAMETER;
use crate::robust::median;
use crate::store::definitions::DefinitionKind;
use crate::store::results::{Cell, Kind, LIMIT_MAX, ResultQuery, ResultRow, column};
use crate::store::{Store, StoreError};

/// What is charted.
#[derive(Debug, Clone, PartialEq)]
pub struct ChartChoice {
    /// Key of the parameter.
    pub parameter: String,
    /// Filters; order and page do not count.
    pub filters: ResultQuery,
    /// Name of the specification whose limits the chart has; empty for none. If omitted, the specification that the filters
    /// demand, or else the only one of the verdicts.
    pub limits_of: Option<String>,
}

impl Default for ChartChoice {
    fn default() -> Self {
        ChartChoice {
            parameter: PARAMETER.to_owned(),
            filters: ResultQuery::default(),
            limits_of: None,
        }
    }
}

/// Where the guard band comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum GuardBasis {
    /// The newest verdict by the specification.
    Verdict,
    /// The median of the standard uncertainties of the chart, judged as a verdict would.
    MedianUncertainty,
}

/// A specification beside the chart: its limits of the parameter with their guard band, in the unit of the parameter's name.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ChartedSpecification {
    /// Name.
    pub name: String,
    /// Lower tolerance limit; null if there is none.
    pub lower: Option<f64>,
    /// Upper tolerance limit; null if there is none.
    pub upper: Option<f64>,
    /// Width of the guard band inside the limits; null without limits or without values.
    #[schema(minimum = 0)]
    pub guard_band: Option<f64>,
    /// Lower acceptance limit: tolerance limit plus guard band; null also where the guard bands of two limits meet.
    pub acceptance_lower: Option<f64>,
    /// Upper acceptance limit.
    pub acceptance_upper: Option<f64>,
    /// Where the guard band comes from.
    pub guard_basis: Option<GuardBasis>,
    /// Number of the verdict that it comes from.
    #[schema(minimum = 1)]
    pub verdict_id: Option<i64>,
    /// Largest allowed probability that an item which passes does not conform.
    #[schema(exclusive_minimum = 0, exclusive_maximum = 0.5)]
    pub max_false_accept_risk: f64,
    /// Keys of all quantities that the specification limits.
    pub limited: Vec<String>,
}

/// The control chart of a parameter over the newest 1000 results that the filters select.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct ResultChart {
    /// Key of the parameter; its unit is the end of the name.
    pub parameter: String,
    /// Limits, values and runs. U of θr is that of the fit; of other parameters it is 2 u.
    #[serde(flatten)]
    pub chart: ControlChart,
    /// Results among the newest 1000 without a converged fit or without this parameter.
    #[schema(maximum = 1000)]
    pub omitted: usize,
    /// Number of all results that the filters select.
    #[schema(minimum = 0)]
    pub count: i64,
    /// The chosen specification; null if there is none.
    pub specification: Option<ChartedSpecification>,
    /// What the settings ask to measure again at intervals, due or not.
    pub due: Vec<Due>,
}

/// Computes the control chart of a parameter over stored results, oldest first. `now` is the time of the day.
///
/// # Errors
/// [`LabError::Invalid`] for an unknown parameter or specification, or a store error.
pub async fn chart(
    store: &Store,
    choice: &ChartChoice,
    settings: &DueSection,
    now: OffsetDateTime,
) -> Result<ResultChart, LabError> {
    is_parameter(&choice.parameter)?;
    let query = choice.filters.clone().newest(LIMIT_MAX);
    let count = store.count_results(&query).await?;
    let mut rows = store.results(&query).await?.rows;
    rows.reverse();
    let values: Vec<ChartValue> = rows
        .iter()
        .filter_map(|row| value_of(row, &choice.parameter))
        .collect();
    let omitted = rows.len() - values.len();
    let chart = chart::chart(values);
    let specification = specification(store, choice, &rows, &chart).await?;
    Ok(ResultChart {
        parameter: choice.parameter.clone(),
        chart,
        omitted,
        count,
        specification,
        due: due(store, settings, now).await?,
    })
}

fn cell<'r>(row: &'r ResultRow, name: &str) -> &'r Cell {
    column(name).map_or(&Cell::Null, |column| row.cell(column))
}

fn real(row: &ResultRow, name: &str) -> Option<f64> {
    match cell(row, name) {
        Cell::Real(value) => Some(*value),
        _ => None,
    }
}

fn id(row: &ResultRow, name: &str) -> Option<i64> {
    match cell(row, name) {
        Cell::Id(id) => Some(*id),
        _ => None,
    }
}

fn text<'r>(row: &'r ResultRow, name: &str) -> Option<&'r str> {
    match cell(row, name) {
        Cell::Text(text) => Some(text),
        _ => None,
    }
}

/// Returns the value of a row; `None` without a converged fit or without this parameter.
fn value_of(row: &ResultRow, parameter: &str) -> Option<ChartValue> {
    if text(row, "status") != Some("converged") {
        return None;
    }
    let Kind::Real { std: Some(std) } = column(parameter)?.kind else {
        return None;
    };
    // The rows have no other factor.
    let factor = (parameter == PARAMETER).then(|| real(row, "coverage_factor"));
    let owned = |name| text(row, name).map(str::to_owned);
    let of = ChartedResult {
        scan_id: row.scan_id(),
        region: owned("region"),
        fit_id: id(row, "fit_id")?,
        part: owned("part").unwrap_or_default(),
        verdict: owned("verdict").filter(|_| !row.judged_other_values()),
        verdict_id: id(row, "verdict_id"),
        specification: owned("specification"),
        created_at: owned("created_at").unwrap_or_default(),
    };
    ChartValue::new(
        of,
        real(row, parameter)?,
        real(row, std)?,
        factor.flatten().unwrap_or(COVERAGE_FACTOR),
    )
}

/// Returns the name of the chosen specification, and whether it was stated.
fn chosen<'c>(choice: &'c ChartChoice, rows: &'c [ResultRow]) -> Option<(&'c str, bool)> {
    if let Some(stated) = &choice.limits_of {
        return (!stated.is_empty()).then_some((stated, true));
    }
    let demanded = choice.filters.only_text("specification");
    let mut named = rows.iter().filter_map(|row| text(row, "specification"));
    let only = || {
        let first = named.next()?;
        named.all(|name| name == first).then_some(first)
    };
    Some((demanded.or_else(only)?, false))
}

/// A verdict that the rows name: what was judged by, and the result.
struct RowVerdict {
    id: i64,
    specification: Specification,
    items: Vec<JudgedItem>,
}

async fn specification(
    store: &Store,
    choice: &ChartChoice,
    rows: &[ResultRow],
    chart: &ControlChart,
) -> Result<Option<ChartedSpecification>, LabError> {
    let Some((name, is_stated)) = chosen(choice, rows) else {
        return Ok(None);
    };
    let by_it = rows
        .iter()
        .rev()
        .filter(|row| text(row, "specification") == Some(name));
    let newest = match by_it.filter_map(|row| id(row, "verdict_id")).next() {
        Some(id) => row_verdict(store, id).await?,
        None => None,
    };
    let kind = DefinitionKind::Specification;
    let stored = store.definition_named(kind, name).await?;
    let stored = stored.map(|found| definitions::read(&found.content));
    let content: Option<Specification> = match stored.transpose()? {
        Some(content) => Some(content),
        // Limits that were typed for a verdict.
        None => newest.as_ref().map(|verdict| verdict.specification.clone()),
    };
    match content {
        Some(content) => Ok(Some(beside(choice, chart, content, newest.as_ref()))),
        None if is_stated => {
            let short: String = name.chars().take(200).collect();
            let problem = format!(
                "there is no specification `{short}`, and no verdict by it among these results; `ridged specification list` or \
                 GET /api/v1/specifications lists the specifications"
            );
            Err(invalid("limits_of", problem))
        }
        None => Ok(None),
    }
}

/// Reads a verdict; `None` if it has no result.
async fn row_verdict(store: &Store, id: i64) -> Result<Option<RowVerdict>, LabError> {
    /// The part of a verdict's result that is read here.
    #[derive(Deserialize)]
    struct Judged {
        items: Vec<JudgedItem>,
    }
    let bad = |e| StoreError::bad_row("job_ends", e);
    let job = store.job(JobId::new(JobKind::Verdict, id)).await?;
    let Some(result) = &job.result else {
        return Ok(None);
    };
    let judged: Judged = serde_json::from_str(result).map_err(bad)?;
    let request: VerdictRequest = serde_json::from_str(&job.request).map_err(bad)?;
    Ok(Some(RowVerdict {
        id,
        specification: specified(&request.specification)
            .map_err(|e| StoreError::bad_row("jobs", e))?,
        items: judged.items,
    }))
}

/// Puts the limits of a specification beside a chart.
fn beside(
    choice: &ChartChoice,
    chart: &ControlChart,
    content: Specification,
    newest: Option<&RowVerdict>,
) -> ChartedSpecification {
    let limits = content.limits.get(&choice.parameter).copied();
    let none = ToleranceLimits {
        lower: None,
        upper: None,
    };
    let ToleranceLimits { lower, upper } = limits.unwrap_or(none);
    let is_this = |item: &&JudgedItem| {
        item.quantity == choice.parameter
            && (item.lower, item.upper) == (lower, upper)
            && item.guard_band.is_some()
    };
    let judged = newest.and_then(|verdict| {
        let item = verdict.items.iter().find(is_this)?;
        Some((item.clone(), GuardBasis::Verdict, Some(verdict.id)))
    });
    let guarded = limits.and_then(|limits| {
        judged.or_else(|| {
            let item = of_median(&choice.parameter, limits, chart, &content)?;
            Some((item, GuardBasis::MedianUncertainty, None))
        })
    });
    let item = guarded.as_ref().map(|(item, ..)| item);
    ChartedSpecification {
        lower,
        upper,
        guard_band: item.and_then(|item| item.guard_band),
        acceptance_lower: item.and_then(|item| item.acceptance_lower),
        acceptance_upper: item.and_then(|item| item.acceptance_upper),
        guard_basis: guarded.as_ref().map(|(_, basis, _)| *basis),
        verdict_id: guarded.as_ref().and_then(|(.., id)| *id),
        max_false_accept_risk: content.decision.max_false_accept_risk,
        limited: content.limits.into_keys().collect(),
        name: content.name,
    }
}

/// Judges a value within the limits that has the median standard uncertainty of a chart; `None` without values.
fn of_median(
    parameter: &str,
    limits: ToleranceLimits,
    chart: &ControlChart,
    content: &Specification,
) -> Option<JudgedItem> {
    let mut all: Vec<f64> = chart.points.iter().map(|point| point.std).collect();
    let measured = MeasuredValue {
        value: limits.lower.or(limits.upper)?,
        std: median(&mut all)?,
        coverage_factor: COVERAGE_FACTOR,
        degrees_of_freedom: None,
        may_cost: 0.0,
    };
    let only = Specification {
        limits: [(parameter.to_owned(), limits)].into(),
        ..content.clone()
    };
    let quantity = JudgedQuantity {
        name: parameter.to_owned(),
        measured: Ok(measured),
    };
    judge(&only, &[quantity]).items.pop()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chart::tests::chart_of;
    use crate::fit::report::Parameters;
    use serde_json::json;

    #[test]
    fn every_parameter_of_a_fit_can_be_charted() {
        for name in Parameters::NAMES {
            let std = format!("{name}_std");
            let kind = column(name).unwrap().kind;
            let Kind::Real { std: Some(of) } = kind else {
                panic!("{name}: {kind:?}");
            };
            assert_eq!(of, std);
        }
    }

    fn row(cells: &[(&str, Cell)]) -> ResultRow {
        let usual = [
            ("scan_id", Cell::Id(7)),
            ("fit_id", Cell::Id(9)),
            ("part", Cell::Text("B-17".into())),
            ("status", Cell::Text("converged".into())),
            ("theta_r_deg", Cell::Real(10.0)),
            ("theta_r_deg_std", Cell::Real(0.02)),
            ("coverage_factor", Cell::Real(2.5)),
            ("alpha_u", Cell::Real(0.12)),
            ("alpha_u_std", Cell::Real(0.001)),
        ];
        ResultRow::of(usual.into_iter().chain(cells.iter().cloned()).collect())
    }

    #[test]
    fn a_value_is_that_of_a_converged_fit_with_the_factor_of_its_parameter() {
        let expanded = |cells: &[(&str, Cell)], parameter| {
            let value = value_of(&row(cells), parameter)?;
            Some(chart::chart(vec![value]).points[0].expanded)
        };
        assert_eq!(expanded(&[], "theta_r_deg"), Some(0.05));
        assert_eq!(expanded(&[], "alpha_u"), Some(0.002));
        assert_eq!(expanded(&[], "alpha_v"), None);
        let at_bound = [("status", Cell::Text("at-bound".into()))];
        assert_eq!(expanded(&at_bound, "theta_r_deg"), None);
        let unknown = [("theta_r_deg", Cell::Null)];
        assert_eq!(expanded(&unknown, "theta_r_deg"), None);
    }

    #[test]
    fn the_specification_is_the_stated_one_or_the_filter_or_the_only_one_of_the_verdicts() {
        let by = |name: &str| row(&[("specification", Cell::Text(name.into()))]);
        let name = |limits_of: Option<&str>, filters: &[(&str, &str)], rows: &[ResultRow]| {
            let choice = ChartChoice {
                limits_of: limits_of.map(str::to_owned),
                filters: ResultQuery::read_filters(filters.iter().copied()).unwrap(),
                ..ChartChoice::default()
            };
            chosen(&choice, rows).map(|(name, is_stated)| (name.to_owned(), is_stated))
        };
        let found = |name: &str, is_stated| Some((name.to_owned(), is_stated));
        let (one, two) = ([by("A"), row(&[]), by("A")], [by("A"), by("B")]);
        assert_eq!(name(None, &[], &one), found("A", false));
        assert_eq!(name(None, &[], &two), None);
        assert_eq!(name(None, &[], &[]), None);
        let filter = [("specification", "B")];
        assert_eq!(name(None, &filter, &two), found("B", false));
        assert_eq!(name(Some("C"), &filter, &two), found("C", true));
        assert_eq!(name(Some(""), &filter, &two), None);
        assert_eq!(name(None, &[("specification", "")], &two), None);
    }

    fn spec(limits: serde_json::Value) -> Specification {
        let content = json!({ "name": "drawing 4711", "limits": limits });
        serde_json::from_value(content).unwrap()
    }

    #[test]
    fn the_guard_band_is_that_of_the_newest_verdict_or_of_the_median_u() {
        let choice = ChartChoice::default();
        let chart = chart_of(&[10.0, 10.1, 10.2]);
        let content = spec(
            json!({ "theta_r_deg": { "lower": 9.0, "upper": 11.0 }, "rho_d": { "upper": 0.4 } }),
        );
        let found = beside(&choice, &chart, content.clone(), None);
        assert_eq!(found.guard_basis, Some(GuardBasis::MedianUncertainty));
        // 1.959964 standard uncertainties of 0.1°.
        let guard = found.guard_band.unwrap();
        assert!((guard - 0.195_996_4).abs() < 1e-6, "{guard}");
        assert_eq!(found.acceptance_lower, Some(9.0 + guard));
        assert_eq!(found.acceptance_upper, Some(11.0 - guard));
        assert_eq!(found.limited, ["rho_d", "theta_r_deg"]);

        let item = |upper: f64| RowVerdict {
            id: 4,
            specification: content.clone(),
            items: judge(
                &spec(json!({ "theta_r_deg": { "lower": 9.0, "upper": upper } })),
                &[JudgedQuantity {
                    name: "theta_r_deg".into(),
                    measured: Ok(MeasuredValue {
                        value: 10.0,
                        std: 0.05,
                        coverage_factor: 2.0,
                        degrees_of_freedom: None,
                        may_cost: 0.0,
                    }),
                }],
            )
            .items,
        };
        let by_verdict = beside(&choice, &chart, content.clone(), Some(&item(11.0)));
        assert_eq!(by_verdict.guard_basis, Some(GuardBasis::Verdict));
        assert_eq!(by_verdict.verdict_id, Some(4));
        assert!((by_verdict.guard_band.unwrap() - 0.097_998_2).abs() < 1e-6);
        // A verdict by other limits does not count.
        let other = beside(&choice, &chart, content.clone(), Some(&item(10.9)));
        assert_eq!(
            (other.guard_basis, other.verdict_id),
            (found.guard_basis, None)
        );

        // Guard bands that meet leave no value that passes.
        let narrow = spec(json!({ "theta_r_deg": { "lower": 9.9, "upper": 10.1 } }));
        let narrow = beside(&choice, &chart, narrow, None);
        assert!(narrow.guard_band.is_some() && narrow.acceptance_lower.is_none());
        // Without values or limits there is no guard band.
        let empty = beside(&choice, &chart_of(&[]), content, None);
        assert_eq!((empty.lower, empty.guard_band), (Some(9.0), None));
        let none = beside(
            &choice,
            &chart,
            spec(json!({ "rho_d": { "upper": 0.4 } })),
            None,
        );
        assert_eq!(
            (none.lower, none.upper, none.guard_basis),
            (None, None, None)
        );
    }
}
