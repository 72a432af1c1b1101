//! `/fits`: begin, look, search, cancel, and the curve beside the points.

use axum::Json;
use axum::extract::State;
use axum::response::IntoResponse;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::ToSchema;

use super::answered::FitAnswered;
use super::asked::FitAsked;
use super::error::{ApiError, Problem};
use super::extract::{Body, Id, Params, finite, page, since};
use super::{App, Begun, List, jobs, words};
use crate::fit::report::{Status, VariantName};
use crate::job::JobKind;
use crate::lab::FitRequest;
use crate::store::jobs::JobFilter;
use crate::wording::refusals::plain;

/// Which fits.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct FitParams {
    /// Of this sample.
    sample_id: Option<i64>,
    /// Of this scan.
    scan_id: Option<i64>,
    /// Of this variant.
    #[param(value_type = Option<words::FitVariantName>)]
    variant: Option<String>,
    /// With this status; `cancelled` finds fits in that state.
    #[param(value_type = Option<words::FitStatus>)]
    status: Option<String>,
    /// Begun at or after, RFC 3339.
    since: Option<String>,
    /// Fits whose ridge angle is at least this, degrees.
    theta_r_deg_min: Option<f64>,
    /// Fits whose ridge angle is at most this, degrees.
    theta_r_deg_max: Option<f64>,
    /// Rows at most, 1 to 1000; 100 if not given.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the page before.
    cursor: Option<String>,
}

/// A word of a report's own enumeration, as it stands in the store; refused with the words that there are.
fn a_word_of<T: DeserializeOwned>(
    field: &str,
    word: Option<String>,
) -> Result<Option<String>, ApiError> {
    if let Some(word) = &word {
        serde_json::from_value::<T>(Value::String(word.clone()))
            .map_err(|e| ApiError::invalid(field, plain(&e.to_string())))?;
    }
    Ok(word)
}

/// Fits, newest first.
#[utoipa::path(get, path = "/api/v1/fits", tag = "fits", params(FitParams), responses(
    (status = 200, description = "A page of fits", body = List<FitAnswered>),
    (status = 422, description = "A value makes no sense", body = Problem),
))]
pub(super) async fn list(
    State(app): State<App>,
    Params(params): Params<FitParams>,
) -> Result<Json<List<Value>>, ApiError> {
    let page = page(params.limit, params.cursor.as_deref())?;
    let filter = JobFilter {
        sample_id: params.sample_id,
        scan_id: params.scan_id,
        variant: a_word_of::<VariantName>("variant", params.variant)?,
        status: a_word_of::<Status>("status", params.status)?,
        since: since(params.since)?,
        theta_r_deg_min: finite("theta_r_deg_min", params.theta_r_deg_min)?,
        theta_r_deg_max: finite("theta_r_deg_max", params.theta_r_deg_max)?,
        ..JobFilter::default()
    };
    jobs::found(&app, JobKind::Fit, &filter, page).await
}

/// Begin a fit.
#[utoipa::path(post, path = "/api/v1/fits", tag = "fits", request_body = FitAsked, responses(
    (status = 202, description = "The fit runs", body = Begun, headers(("Location" = String, description = "The fit"))),
    (status = 400, description = "The body cannot be understood", body = Problem),
    (status = 404, description = "There is no such scan", body = Problem),
    (status = 422, description = "A value makes no sense", body = Problem),
))]
pub(super) async fn begin(
    State(app): State<App>,
    Body(request): Body<FitRequest>,
) -> Result<impl IntoResponse, ApiError> {
    jobs::begin(&app, request).await
}

/// One fit: the object of `fit --json` plus id, scan_id, state and `request` (what was asked for).
#[utoipa::path(get, path = "/api/v1/fits/{id}", tag = "fits", params(("id" = i64, Path, description = "Number of the fit")), responses(
    (status = 200, description = "The fit; `state` running (with `progress` and `forecast`), completed, failed, cancelled or interrupted", body = FitAnswered),
    (status = 404, description = "There is none", body = Problem),
))]
pub(super) async fn get(State(app): State<App>, Id(id): Id) -> Result<Json<Value>, ApiError> {
    jobs::one(&app, JobKind::Fit, id).await
}

/// Cancel a fit that runs.
#[utoipa::path(post, path = "/api/v1/fits/{id}/cancel", tag = "fits", params(("id" = i64, Path, description = "Number of the fit")), responses(
    (status = 202, description = "It will end within a moment", body = Begun),
    (status = 404, description = "There is none", body = Problem),
    (status = 409, description = "It has ended", body = Problem),
))]
pub(super) async fn cancel(
    State(app): State<App>,
    Id(id): Id,
) -> Result<impl IntoResponse, ApiError> {
    jobs::cancel(&app, JobKind::Fit, id).await
}

/// How finely.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct CurveParams {
    /// Distance of the curve's points, 0.1 to 90; 3 if not given.
    step_deg: Option<f64>,
}

/// A fit beside its observations.
#[derive(Debug, Serialize, ToSchema)]
pub struct CurvesBody {
    /// Number of the fit.
    fit_id: i64,
    /// Largest observation, in the observations' unit of radiance; residuals are fractions of it.
    peak: f64,
    /// Observed and predicted.
    observations: Vec<PointBody>,
    /// One curve per tilt and variant.
    curves: Vec<CurveBody>,
}

/// An observation and what the fit predicts there.
#[derive(Debug, Serialize, ToSchema)]
pub struct PointBody {
    /// Camera tilt θc as recorded, degrees.
    theta_c_deg: f64,
    /// Sample azimuth φs as recorded, degrees.
    phi_s_deg: f64,
    /// Observed signal, in the observations' unit of radiance.
    signal: f64,
    /// Its own standard uncertainty, in the same unit.
    sigma: f64,
    /// Predicted signal, in the same unit.
    predicted: f64,
    /// (signal − predicted) / peak.
    residual: f64,
}

/// Predicted signal over φs at one tilt.
#[derive(Debug, Serialize, ToSchema)]
pub struct CurveBody {
    /// Variant of the model that predicts it.
    #[schema(value_type = words::FitVariantName)]
    variant: String,
    /// Camera tilt θc as recorded, degrees.
    theta_c_deg: f64,
    /// Sample azimuths φs as recorded, degrees.
    phi_s_deg: Vec<f64>,
    /// Predicted signals at these azimuths, in the observations' unit of radiance.
    signal: Vec<f64>,
}

/// The fitted curve over φs for each tilt, with the observations.
#[utoipa::path(get, path = "/api/v1/fits/{id}/curve", tag = "fits", params(("id" = i64, Path, description = "Number of the fit"), CurveParams), responses(
    (status = 200, description = "Points and curves in the observations' unit", body = CurvesBody),
    (status = 404, description = "There is none", body = Problem),
    (status = 409, description = "The fit has no report (yet)", body = Problem),
    (status = 422, description = "A value makes no sense", body = Problem),
))]
pub(super) async fn curve(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<CurveParams>,
) -> Result<Json<CurvesBody>, ApiError> {
    let curves = app.lab.curves(id, params.step_deg.unwrap_or(3.0)).await?;
    let peak = curves.peak;
    Ok(Json(CurvesBody {
        fit_id: id,
        peak,
        observations: curves
            .observations
            .into_iter()
            .map(|o| PointBody {
                theta_c_deg: o.theta_c_deg,
                phi_s_deg: o.phi_s_deg,
                signal: o.signal,
                sigma: o.sigma,
                predicted: o.fitted,
                residual: if peak > 0.0 {
                    (o.signal - o.fitted) / peak
                } else {
                    0.0
                },
            })
            .collect(),
        curves: curves
            .curves
            .into_iter()
            .map(|c| CurveBody {
                variant: c.variant,
                theta_c_deg: c.theta_c_deg,
                phi_s_deg: c.phi_s_deg,
                signal: c.signal,
            })
            .collect(),
    }))
}
