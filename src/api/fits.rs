//! `/fits`: start, list, read and cancel fits, and their curves.

use axum::Json;
use axum::extract::State;
use axum::response::{IntoResponse as _, Response};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::openapi::RefOr;
use utoipa::openapi::schema::Schema;
use utoipa::{PartialSchema as _, ToSchema};

use super::caller::Caller;
use super::extract::{Body, Id, Params, page, since};
use super::fields::Fields;
use super::job_body::{FitBody, JobBody};
use super::status::{ApiError, Problem};
use super::{App, Begun, List, jobs};
use crate::fit::report::{Parameters, Status, VariantName};
use crate::job::JobKind;
use crate::lab::{Curve, FitRequest};
use crate::store::jobs::JobFilter;

/// Filter of the list.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct FitParams {
    /// Fits of this part.
    sample_id: Option<i64>,
    /// Fits of this scan.
    scan_id: Option<i64>,
    /// Fits whose report is of this variant.
    variant: Option<VariantName>,
    /// Fits with this status; `cancelled` also finds fits in that state.
    status: Option<Status>,
    /// Started at or after this time, RFC 3339.
    since: Option<String>,
    /// Fits whose ridge angle is at least this, degrees.
    theta_r_deg_min: Option<f64>,
    /// Fits whose ridge angle is at most this, degrees.
    theta_r_deg_max: Option<f64>,
    /// Largest number of rows, 1 to 1000; 100 if omitted.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
    /// Only these fields of the rows, separated by commas, e.g. `id,scan_id,parameters.theta_r_deg`.
    fields: Option<String>,
}

/// Names that `fields` takes: those of a fit, and of its parameters.
fn field_names() -> Vec<String> {
    let names = |schema: RefOr<Schema>| -> Vec<String> {
        match schema {
            RefOr::T(Schema::Object(object)) => object.properties.into_keys().collect(),
            _ => unreachable!("structs are described as objects"),
        }
    };
    let parameters = names(Parameters::schema()).into_iter();
    let parameters = parameters.map(|name| format!("parameters.{name}"));
    names(FitBody::schema())
        .into_iter()
        .chain(parameters)
        .collect()
}

/// Returns the word that reports have for a status.
fn word_of(status: Status) -> String {
    let word = serde_json::to_value(status).expect("a word is JSON");
    word.as_str().expect("a status is a word").to_owned()
}

/// Fits, newest first. A row has some 9 kB; `fields` shortens it, and `/results` has one short row per scan.
#[utoipa::path(get, path = "/api/v1/fits", tag = "fits", params(FitParams), responses(
    (status = 200, description = "A page of fits", body = List<FitBody>),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn list(
    State(app): State<App>,
    Params(params): Params<FitParams>,
) -> Result<Response, ApiError> {
    let fields = params.fields.as_deref();
    let fields = fields.map(|text| Fields::read(text, &field_names()));
    let fields = fields.transpose()?;
    let page = page(params.limit, params.cursor.as_deref())?;
    let filter = JobFilter {
        sample_id: params.sample_id,
        scan_id: params.scan_id,
        variant: params.variant.map(|name| name.to_string()),
        status: params.status.map(word_of),
        since: since(params.since)?,
        theta_r_deg_min: params.theta_r_deg_min,
        theta_r_deg_max: params.theta_r_deg_max,
        ..JobFilter::default()
    };
    let Json(list) = jobs::found(&app, JobKind::Fit, &filter, page).await?;
    let Some(fields) = fields else {
        return Ok(Json(list).into_response());
    };
    let short = |job: JobBody| -> Result<Value, ApiError> {
        let row = serde_json::to_value(job).map_err(|_| ApiError::internal())?;
        Ok(fields.of(&row))
    };
    let items = list
        .items
        .into_iter()
        .map(short)
        .collect::<Result<_, _>>()?;
    Ok(Json(List {
        items,
        next_cursor: list.next_cursor,
        damaged: list.damaged,
    })
    .into_response())
}

/// Start a fit.
#[utoipa::path(post, path = "/api/v1/fits", tag = "fits", request_body = FitRequest, responses(
    (status = 202, description = "The fit runs", body = Begun, headers(("Location" = String, description = "The fit"))),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 404, description = "There is no such scan", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn begin(
    Caller(app): Caller,
    Body(request): Body<FitRequest>,
) -> Result<Response, ApiError> {
    jobs::begin(&app, request).await
}

/// One fit: the object of `fit --json` plus id, scan_id, state and `request`.
#[utoipa::path(get, path = "/api/v1/fits/{id}", tag = "fits", params(("id" = i64, Path, description = "Number of the fit")), responses(
    (status = 200, description = "The fit; `state` running (with `progress` and `forecast`), completed, failed, cancelled or interrupted", body = FitBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn get(State(app): State<App>, Id(id): Id) -> Result<Json<JobBody>, ApiError> {
    jobs::one(&app, JobKind::Fit, id).await
}

/// Cancel a running fit.
#[utoipa::path(post, path = "/api/v1/fits/{id}/cancel", tag = "fits", params(("id" = i64, Path, description = "Number of the fit")), responses(
    (status = 202, description = "It ends within a moment", body = Begun),
    (status = 404, description = "Not found", body = Problem),
    (status = 409, description = "It has ended", body = Problem),
))]
pub(super) async fn cancel(Caller(app): Caller, Id(id): Id) -> Result<Response, ApiError> {
    jobs::cancel(&app, JobKind::Fit, id).await
}

/// Resolution of the curves.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct CurveParams {
    /// Distance of the curve's points, degrees, 0.1 to 90; 3 if omitted.
    step_deg: Option<f64>,
}

/// A fit with its observations.
#[derive(Debug, Serialize, ToSchema)]
pub struct CurvesBody {
    /// Number of the fit.
    fit_id: i64,
    /// Largest observation, in the observations' unit of radiance; residuals are fractions of it.
    peak: f64,
    /// Observed and predicted.
    observations: Vec<PointBody>,
    /// One curve per tilt and variant.
    curves: Vec<Curve>,
}

/// An observation and the prediction of the fit.
#[derive(Debug, Serialize, ToSchema)]
pub struct PointBody {
    /// Camera tilt θc as recorded, degrees.
    theta_c_deg: f64,
    /// Sample azimuth φs as recorded, degrees.
    phi_s_deg: f64,
    /// Observed signal, in the observations' unit of radiance.
    signal: f64,
    /// Its standard uncertainty, in the same unit.
    sigma: f64,
    /// Predicted signal, in the same unit.
    predicted: f64,
    /// (signal − predicted) / peak.
    residual: f64,
}

/// The fitted curves over φs, one per tilt, with the observations.
#[utoipa::path(get, path = "/api/v1/fits/{id}/curve", tag = "fits", params(("id" = i64, Path, description = "Number of the fit"), CurveParams), responses(
    (status = 200, description = "Points and curves in the observations' unit", body = CurvesBody),
    (status = 404, description = "Not found", body = Problem),
    (status = 409, description = "The fit has no report (yet)", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
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
        curves: curves.curves,
    }))
}
