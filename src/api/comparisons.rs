//! `/comparisons` and `/repeatability`: results of scans beside each other.

use axum::Json;
use axum::extract::State;
use serde::Deserialize;

use super::App;
use super::extract::ScansAnd;
use super::status::{ApiError, Problem};
use crate::comparison::Comparison;
use crate::comparison::shared::SharedChoice;
use crate::lab;
use crate::repeatability::gauge::GroupedBy;
use crate::repeatability::{PARAMETER, Repeatability, StudyChoice};

/// How two scans are compared.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct CompareParams {
    /// Region of a part with several regions: the newest fits of it.
    region: Option<String>,
    /// Lines of the budget with the same error in both scans, separated by commas, or `none`. If omitted, the lines that
    /// the records of the scans show as the same.
    shared: Option<String>,
}

/// How the scatter of several scans is evaluated.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct RepeatabilityParams {
    /// Key of the parameter; `theta_r_deg` if omitted.
    parameter: Option<String>,
    /// What reproducibility is taken over: operator or day (UTC). If omitted, operators where every scan names one and
    /// there are several, otherwise days.
    #[param(value_type = Option<GroupedBy>)]
    by: Option<GroupedBy>,
    /// Region of a part with several regions: the newest fits of it.
    region: Option<String>,
    /// Lines of the budget with the same error in all scans, separated by commas, or `none`. If omitted, the lines that
    /// the records of the scans show as the same.
    shared: Option<String>,
}

fn shared(text: Option<&str>) -> Result<SharedChoice, ApiError> {
    let choice = text.map(SharedChoice::read).transpose();
    let choice = choice.map_err(|problem| ApiError::invalid("shared", problem))?;
    Ok(choice.unwrap_or_default())
}

/// Two scans beside each other by their newest fits: for each parameter the difference B − A with its expanded uncertainty
/// and E_n. Lines of the budget with the same error in both scans cancel as far as they are equal.
#[utoipa::path(get, path = "/api/v1/comparisons", tag = "comparisons", params(
    ("scan_id" = Vec<i64>, Query, description = "Numbers of the two scans, A and B: scan_id=1&scan_id=2"),
    CompareParams,
), responses(
    (status = 200, description = "The comparison", body = Comparison),
    (status = 404, description = "There is no such scan", body = Problem),
    (status = 409, description = "A scan has no completed fit (`no-fit`)", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn compare(
    State(app): State<App>,
    ScansAnd(scan_ids, params): ScansAnd<CompareParams>,
) -> Result<Json<Comparison>, ApiError> {
    let shared = shared(params.shared.as_deref())?;
    let region = params.region.as_deref();
    let compared = lab::compare(app.lab.store(), &scan_ids, region, &shared).await?;
    Ok(Json(compared))
}

/// Scatter of scans of one part, or of several parts, beside the uncertainty that their newest fits state, with χ² and its
/// probability; and gauge R&R over parts and operators or days, as far as the scans allow it.
#[utoipa::path(get, path = "/api/v1/repeatability", tag = "comparisons", params(
    ("scan_id" = Vec<i64>, Query, description = "Numbers of the scans, 2 to 200: scan_id=1&scan_id=2&scan_id=3"),
    RepeatabilityParams,
), responses(
    (status = 200, description = "The study; `left_out` lists scans without a result", body = Repeatability),
    (status = 404, description = "There is no such scan", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn repeatability(
    State(app): State<App>,
    ScansAnd(scan_ids, params): ScansAnd<RepeatabilityParams>,
) -> Result<Json<Repeatability>, ApiError> {
    let choice = StudyChoice {
        shared: shared(params.shared.as_deref())?,
        by: params.by,
        parameter: params.parameter.unwrap_or_else(|| PARAMETER.to_owned()),
    };
    let region = params.region.as_deref();
    let study = lab::repeatability(app.lab.store(), &scan_ids, region, &choice).await?;
    Ok(Json(study))
}
