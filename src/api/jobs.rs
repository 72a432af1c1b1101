//! Jobs: one shape for `/fits`, `/maps`, `/contrasts`, `/verdicts` and `/traces`, and the routes of all but fits.

use std::collections::BTreeMap;

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use serde_json::{Value, json};
use utoipa::ToSchema;

use super::caching::{ASK_EACH_TIME, Caching};
use super::caller::Caller;
use super::document::Binary;
use super::extract::{Body, Id, IdAndName, Params, page, since};
use super::job_body::{
    ContrastBody, JobBody, JobError, MapBody, TraceBody, VerdictBody, result_of_today,
};
use super::status::{self, ApiError, Problem};
use super::{App, Begun, List};
use crate::job::{JobId, JobKind, JobState};
use crate::lab::{ContrastRequest, JobRequest, LabError, MapRequest, TraceRequest, VerdictRequest};
use crate::map::summary::Summary;
use crate::store::jobs::{Job, JobFilter};
use crate::store::{PageRequest, StoreError};

fn body(app: &App, job: Job) -> Result<JobBody, StoreError> {
    let parsed = |text: &str, table| -> Result<Value, StoreError> {
        serde_json::from_str(text).map_err(|e| StoreError::bad_row(table, e))
    };
    // A job leaves the running ones a moment after its last row; its result then has the forecast.
    let (progress, forecast) = match job.state {
        JobState::Running => app.lab.job_progress(job.id()),
        _ => (None, None),
    };
    let request = parsed(&job.request, "jobs")?;
    let result = match (&job.result, job.kind) {
        (Some(result), JobKind::Contrast) => result_of_today(parsed(result, "job_ends")?),
        (Some(result), _) => parsed(result, "job_ends")?,
        (None, JobKind::Fit) => {
            json!({ "variant": request["variant"], "region": request["region"] })
        }
        (None, _) => json!({}),
    };
    Ok(JobBody {
        id: job.number,
        scan_id: job.scan_id,
        sample_id: job.sample_id,
        sample_name: job.sample_name,
        state: job.state,
        request,
        who: job.who,
        created_at: job.created_at,
        ended_at: job.ended_at,
        progress,
        forecast,
        error: JobError::of(job.error_code, job.error_detail),
        result,
    })
}

/// Filter of the list.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct JobParams {
    /// Jobs of any scan of this part.
    sample_id: Option<i64>,
    /// Jobs of this scan.
    scan_id: Option<i64>,
    /// Jobs in this state.
    state: Option<JobState>,
    /// Started at or after this time, RFC 3339.
    since: Option<String>,
    /// Largest number of rows, 1 to 1000; 100 if omitted.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

/// Returns a page of jobs of a kind.
pub(super) async fn found(
    app: &App,
    kind: JobKind,
    filter: &JobFilter,
    page: PageRequest,
) -> Result<Json<List<JobBody>>, ApiError> {
    let found = app.lab.store().jobs(kind, filter, page).await?;
    let mut list = List::after(&found);
    for job in found.items {
        let (id, answer) = (job.number, body(app, job));
        list.take(id, answer.map_err(LabError::from))?;
    }
    Ok(Json(list))
}

async fn list(
    app: &App,
    kind: JobKind,
    params: JobParams,
) -> Result<Json<List<JobBody>>, ApiError> {
    let page = page(params.limit, params.cursor.as_deref())?;
    let filter = JobFilter {
        sample_id: params.sample_id,
        scan_id: params.scan_id,
        state: params.state,
        since: since(params.since)?,
        ..JobFilter::default()
    };
    found(app, kind, &filter, page).await
}

pub(super) async fn begin(app: &App, request: impl Into<JobRequest>) -> Result<Response, ApiError> {
    let id = app.lab.start_job(request).await?;
    let body = Begun {
        id: Some(id.number),
        state: JobState::Running.to_string(),
    };
    let path = format!("/api/v1/{}/{}", id.kind.plural(), id.number);
    Ok(status::accepted(path, body))
}

pub(super) async fn one(app: &App, kind: JobKind, number: i64) -> Result<Json<JobBody>, ApiError> {
    let job = app.lab.store().job(JobId::new(kind, number)).await?;
    Ok(Json(body(app, job)?))
}

async fn file(
    app: &App,
    kind: JobKind,
    number: i64,
    name: &str,
    headers: &HeaderMap,
) -> Result<Response, ApiError> {
    let file = app
        .lab
        .find_job_file(JobId::new(kind, number), name)
        .await?;
    let caching = Caching::new(headers, &file.tag(), ASK_EACH_TIME);
    if let Some(answer) = caching.not_modified(file.bytes) {
        return Ok(answer);
    }
    let bytes = file.read().await?;
    let kind = match name.rsplit_once('.').map(|(_, extension)| extension) {
        Some("png") => "image/png",
        Some("tif") => "image/tiff",
        Some("csv") => "text/csv; charset=utf-8",
        Some("json") => "application/json",
        _ => "application/octet-stream",
    };
    Ok((caching.headers(), [(header::CONTENT_TYPE, kind)], bytes).into_response())
}

pub(super) async fn cancel(app: &App, kind: JobKind, number: i64) -> Result<Response, ApiError> {
    app.lab.cancel_job(JobId::new(kind, number)).await?;
    let body = Begun {
        id: Some(number),
        state: JobState::Cancelled.to_string(),
    };
    Ok(status::ordered(body))
}

/// Maps, newest first.
#[utoipa::path(get, path = "/api/v1/maps", tag = "maps", params(JobParams), responses(
    (status = 200, description = "A page of maps", body = List<MapBody>),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn maps(
    State(app): State<App>,
    Params(params): Params<JobParams>,
) -> Result<Json<List<JobBody>>, ApiError> {
    list(&app, JobKind::Map, params).await
}

/// Start a map, a fit of every pixel of a scan.
#[utoipa::path(post, path = "/api/v1/maps", tag = "maps", request_body(content = MapRequest, description =
    "`scan_id`, optional `max_seconds` (pixels not reached within this time have no value) and `target_error` (share of the brightest radiance that the model may omit)"), responses(
    (status = 202, description = "It runs", body = Begun, headers(("Location" = String, description = "The map"))),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 404, description = "There is no such scan", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn begin_map(
    Caller(app): Caller,
    Body(request): Body<MapRequest>,
) -> Result<impl IntoResponse, ApiError> {
    begin(&app, request).await
}

/// One map: the object of `map --json` plus the fields of its job. Its `files` are below `files/`.
#[utoipa::path(get, path = "/api/v1/maps/{id}", tag = "maps", params(("id" = i64, Path, description = "Number of the map")), responses(
    (status = 200, description = "The map; `state` running (with `progress`), completed, failed, cancelled or interrupted", body = MapBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn map(State(app): State<App>, Id(id): Id) -> Result<Json<JobBody>, ApiError> {
    one(&app, JobKind::Map, id).await
}

/// Cancel a running map.
#[utoipa::path(post, path = "/api/v1/maps/{id}/cancel", tag = "maps", params(("id" = i64, Path, description = "Number of the map")), responses(
    (status = 202, description = "It ends within a moment", body = Begun),
    (status = 404, description = "Not found", body = Problem),
    (status = 409, description = "It has ended", body = Problem),
))]
pub(super) async fn cancel_map(
    Caller(app): Caller,
    Id(id): Id,
) -> Result<impl IntoResponse, ApiError> {
    cancel(&app, JobKind::Map, id).await
}

/// A file of a map: float32 TIFF, PNG picture, CSV or JSON.
#[utoipa::path(get, path = "/api/v1/maps/{id}/files/{name}", tag = "maps", params(
    ("id" = i64, Path, description = "Number of the map"),
    ("name" = String, Path, description = "One of its `files`, e.g. theta_r_deg.png"),
), responses(
    (status = 200, description = "The file",
        content((Binary = "image/tiff"), (Binary = "image/png"), (String = "text/csv"), (Summary = "application/json"))),
    (status = 304, description = "The client has the file"),
    (status = 404, description = "There is no such map", body = Problem),
    (status = 409, description = "The map has no files (yet)", body = Problem),
    (status = 422, description = "The map has no such file", body = Problem),
))]
pub(super) async fn map_file(
    State(app): State<App>,
    IdAndName(id, name): IdAndName,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    file(&app, JobKind::Map, id, &name, &headers).await
}

/// Contrasts, newest first.
#[utoipa::path(get, path = "/api/v1/contrasts", tag = "contrasts", params(JobParams), responses(
    (status = 200, description = "A page of contrasts", body = List<ContrastBody>),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn contrasts(
    State(app): State<App>,
    Params(params): Params<JobParams>,
) -> Result<Json<List<JobBody>>, ApiError> {
    list(&app, JobKind::Contrast, params).await
}

/// Start a contrast table of a scan.
#[utoipa::path(post, path = "/api/v1/contrasts", tag = "contrasts", request_body(content = ContrastRequest, description = "`scan_id`, optional `region`"), responses(
    (status = 202, description = "It runs", body = Begun, headers(("Location" = String, description = "The contrast"))),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 404, description = "There is no such scan", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn begin_contrast(
    Caller(app): Caller,
    Body(request): Body<ContrastRequest>,
) -> Result<impl IntoResponse, ApiError> {
    begin(&app, request).await
}

/// One contrast table: the object of `contrast --json` plus the fields of its job.
#[utoipa::path(get, path = "/api/v1/contrasts/{id}", tag = "contrasts", params(("id" = i64, Path, description = "Number of the contrast")), responses(
    (status = 200, description = "The contrast", body = ContrastBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn contrast(
    State(app): State<App>,
    Id(id): Id,
) -> Result<Json<JobBody>, ApiError> {
    one(&app, JobKind::Contrast, id).await
}

/// Cancel a running contrast.
#[utoipa::path(post, path = "/api/v1/contrasts/{id}/cancel", tag = "contrasts", params(("id" = i64, Path, description = "Number of the contrast")), responses(
    (status = 202, description = "It ends within a moment", body = Begun),
    (status = 404, description = "Not found", body = Problem),
    (status = 409, description = "It has ended", body = Problem),
))]
pub(super) async fn cancel_contrast(
    Caller(app): Caller,
    Id(id): Id,
) -> Result<impl IntoResponse, ApiError> {
    cancel(&app, JobKind::Contrast, id).await
}

/// Verdicts, newest first.
#[utoipa::path(get, path = "/api/v1/verdicts", tag = "verdicts", params(JobParams), responses(
    (status = 200, description = "A page of verdicts", body = List<VerdictBody>),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn verdicts(
    State(app): State<App>,
    Params(params): Params<JobParams>,
) -> Result<Json<List<JobBody>>, ApiError> {
    list(&app, JobKind::Verdict, params).await
}

/// Start a verdict, which judges a scan against a specification.
#[utoipa::path(post, path = "/api/v1/verdicts", tag = "verdicts", request_body(content = VerdictRequest, description =
    "`scan_id`, `specification` (`name`, `limits`, e.g. {\"theta_r_deg\": {\"lower\": 9.5, \"upper\": 10.5}}, optional `decision` and `reference_plane`: \"sample\" needs `sample_wedge_std_deg` in the settings of the rig to judge angles), optional `variant` and `region`, `max_seconds`, `target_error` (of the ray tracer), `tolerance`"), responses(
    (status = 202, description = "It runs", body = Begun, headers(("Location" = String, description = "The verdict"))),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 404, description = "There is no such scan", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn begin_verdict(
    Caller(app): Caller,
    Body(request): Body<VerdictRequest>,
) -> Result<impl IntoResponse, ApiError> {
    begin(&app, request).await
}

/// One verdict: the object of `judge --json` plus the fields of its job.
#[utoipa::path(get, path = "/api/v1/verdicts/{id}", tag = "verdicts", params(("id" = i64, Path, description = "Number of the verdict")), responses(
    (status = 200, description = "The verdict: pass, fail or cannot-tell, with every limit's reason", body = VerdictBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn verdict(State(app): State<App>, Id(id): Id) -> Result<Json<JobBody>, ApiError> {
    one(&app, JobKind::Verdict, id).await
}

/// Cancel a running verdict.
#[utoipa::path(post, path = "/api/v1/verdicts/{id}/cancel", tag = "verdicts", params(("id" = i64, Path, description = "Number of the verdict")), responses(
    (status = 202, description = "It ends within a moment", body = Begun),
    (status = 404, description = "Not found", body = Problem),
    (status = 409, description = "It has ended", body = Problem),
))]
pub(super) async fn cancel_verdict(
    Caller(app): Caller,
    Id(id): Id,
) -> Result<impl IntoResponse, ApiError> {
    cancel(&app, JobKind::Verdict, id).await
}

/// Traces, newest first.
#[utoipa::path(get, path = "/api/v1/traces", tag = "traces", params(JobParams), responses(
    (status = 200, description = "A page of traces", body = List<TraceBody>),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn traces(
    State(app): State<App>,
    Params(params): Params<JobParams>,
) -> Result<Json<List<JobBody>>, ApiError> {
    list(&app, JobKind::Trace, params).await
}

/// Start a trace of polarised light through a scene.
#[utoipa::path(post, path = "/api/v1/traces", tag = "traces", request_body(content = TraceRequest, description =
    "`scene` (the text of its TOML, or an object of the same keys), optional `files` (those that the scene names by `path`: an object of contents in base64, kept with the result as `given-NAME`), `photons` (instead of the scene's), `max_seconds`, `target_error` (relative error of the reflected bins), `compare` (traces every path with and without polarisation, at eight wavelengths if a material depends on it) and `surfaces` (2 to 1000 random surfaces of the same statistics; `surfaces` of the result separates photon noise from their spread)"), responses(
    (status = 202, description = "It runs", body = Begun, headers(("Location" = String, description = "The trace"))),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 422, description = "The scene is not valid", body = Problem),
))]
pub(super) async fn begin_trace(
    Caller(app): Caller,
    Body(request): Body<TraceRequest>,
) -> Result<impl IntoResponse, ApiError> {
    begin(&app, request).await
}

/// One trace: the object of `trace --json` plus the fields of its job, `light`, `bins` (the content of its files), `comparison`
/// (with `compare`: ADM and MDM of Wang et al. 2017, and their mask) and `warnings`. Its `files` are below `files/`.
#[utoipa::path(get, path = "/api/v1/traces/{id}", tag = "traces", params(("id" = i64, Path, description = "Number of the trace")), responses(
    (status = 200, description = "The trace", body = TraceBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn trace(State(app): State<App>, Id(id): Id) -> Result<Json<JobBody>, ApiError> {
    one(&app, JobKind::Trace, id).await
}

/// Cancel a running trace.
#[utoipa::path(post, path = "/api/v1/traces/{id}/cancel", tag = "traces", params(("id" = i64, Path, description = "Number of the trace")), responses(
    (status = 202, description = "It ends within a moment", body = Begun),
    (status = 404, description = "Not found", body = Problem),
    (status = 409, description = "It has ended", body = Problem),
))]
pub(super) async fn cancel_trace(
    Caller(app): Caller,
    Id(id): Id,
) -> Result<impl IntoResponse, ApiError> {
    cancel(&app, JobKind::Trace, id).await
}

/// The file `plane.json` of a trace: light in the plane of incidence.
#[derive(ToSchema)]
#[schema(as = TracePlane)]
#[expect(dead_code, reason = "it describes an answer")]
struct PlaneFile {
    /// States of the lamp, the scene's first.
    states: Vec<BTreeMap<String, Value>>,
    /// Settings of the polarisers before the camera.
    settings: Vec<BTreeMap<String, Value>>,
    /// Readings of the virtual ellipsometer by direction, where there are some.
    points: Option<Vec<BTreeMap<String, Value>>>,
    /// Reflected light by direction, where there is some.
    lobe: Option<Vec<BTreeMap<String, Value>>>,
}

/// A file of a trace: `bins.csv` (the table of `trace --out`), `plane.json` (the plane of incidence: the virtual ellipsometer's
/// readings, and polarised against scalar), or little-endian 32-bit floats: `bins.f32` (for each of `bins.sides`, each bin by polar angle and
/// azimuth, and each of `bins.numbers`: value and standard error, sr⁻¹, NaN without light),
/// `difference.f32` (for each bin of the upper side: d = (polarised − scalar)/scalar averaged over the wavelengths, its standard
/// error, ADM and MDM; NaN if the bin does not count).
#[utoipa::path(get, path = "/api/v1/traces/{id}/files/{name}", tag = "traces", params(
    ("id" = i64, Path, description = "Number of the trace"),
    ("name" = String, Path, description = "One of its `files`, e.g. bins.csv"),
), responses(
    (status = 200, description = "The file",
        content((String = "text/csv"), (PlaneFile = "application/json"), (Binary = "application/octet-stream"))),
    (status = 304, description = "The client has the file"),
    (status = 404, description = "There is no such trace", body = Problem),
    (status = 409, description = "The trace has no files (yet)", body = Problem),
    (status = 422, description = "The trace has no such file", body = Problem),
))]
pub(super) async fn trace_file(
    State(app): State<App>,
    IdAndName(id, name): IdAndName,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    file(&app, JobKind::Trace, id, &name, &headers).await
}
