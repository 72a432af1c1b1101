//! `/scans`: plan, begin, command, look.

use axum::Json;
use axum::body::Bytes;
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::asked::ScanAsked;
use super::error::{ApiError, Problem};
use super::extract::{Body, Id, NO_ID, Params, from_json, page};
use super::{App, Begun, List, words};
use crate::lab::{Lab, LabError, ScanRequest};
use crate::scan::event::OperatorStep;
use crate::scan::runner::Order;
use crate::scan::{OperatorAction, Plan, Progress, ScanState};
use crate::store::scans::{Origin, Scan, ScanFilter};

/// How far a scan is.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ProgressBody {
    /// What is being taken: dark, flat or sample; done at the end, null before the start.
    phase: Option<&'static str>,
    /// Points (pose and exposure) whose frames are stored.
    shots_done: u32,
    /// Points (pose and exposure) of the whole plan.
    shots_total: u32,
    /// Frames stored so far.
    frames_done: u32,
    /// Frames of the whole plan.
    frames_total: u32,
    /// Share of the predicted time that is done, 0 to 1.
    fraction: f64,
    /// Time spent moving and exposing, s.
    elapsed_s: f64,
    /// Predicted time left, s; null where it is not known.
    time_left_s: Option<f64>,
}

impl ProgressBody {
    pub(super) fn new(progress: &Progress, state: ScanState) -> Self {
        ProgressBody {
            phase: match state {
                ScanState::Completed => Some("done"),
                _ => progress.phase.map(|kind| kind.as_str()),
            },
            shots_done: progress.shots_done,
            shots_total: progress.shots_total,
            frames_done: progress.frames_done,
            frames_total: progress.frames_total,
            fraction: progress.fraction,
            elapsed_s: progress.elapsed_s,
            time_left_s: progress.time_left_s,
        }
    }
}

/// What a person has to do.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct OperatorBody {
    /// What to do.
    #[schema(value_type = words::OperatorAction)]
    action: &'static str,
    /// The same in words.
    message: &'static str,
}

impl From<OperatorStep> for OperatorBody {
    fn from(step: OperatorStep) -> Self {
        OperatorBody {
            action: step.action.as_str(),
            message: step.message,
        }
    }
}

/// A scan.
#[derive(Debug, Serialize, ToSchema)]
pub struct ScanBody {
    /// Number of the scan.
    id: i64,
    /// Number of the sample.
    sample_id: i64,
    /// The sample's name.
    sample_name: String,
    /// Where it stands.
    #[schema(value_type = words::ScanState)]
    state: ScanState,
    /// Why it stands there, where it is not the plan's own course.
    reason: Option<String>,
    /// Where it comes from: rig or import.
    origin: &'static str,
    /// What a person has to do, while it waits for one.
    operator: Option<OperatorBody>,
    /// The whole plan; of an import, the poses it has.
    #[schema(value_type = Object)]
    plan: Option<Plan>,
    /// How far the scan has come.
    progress: ProgressBody,
    /// Frames that were taken and do not count.
    frames_rejected: u32,
    /// Regions of a sample with patches; a fit has to name one of them. Else empty.
    regions: Vec<String>,
    /// The camera that took the frames.
    camera: ScanCameraBody,
    /// Calibrations it uses, its own included.
    calibration_ids: Vec<i64>,
    /// When the scan was asked for, RFC 3339 in UTC.
    created_at: String,
    /// When it first did something, RFC 3339 in UTC.
    started_at: Option<String>,
    /// When it ended, RFC 3339 in UTC.
    ended_at: Option<String>,
}

/// What has to be known of a camera to look at its frames.
#[derive(Debug, Serialize, ToSchema)]
pub struct ScanCameraBody {
    /// Columns of a frame, px.
    width_px: u32,
    /// Rows of a frame, px.
    height_px: u32,
    /// Count at which a pixel is full, DN.
    saturation_dn: f64,
}

pub(super) async fn body(app: &App, scan: Scan) -> Result<ScanBody, LabError> {
    let scan = app.lab.as_it_stands(scan);
    let store = app.lab.store();
    let progress = store.last_progress(scan.id).await?;
    let plan = match scan.plan.clone() {
        Some(plan) => Some(plan),
        None => Some(app.lab.plan_of_import(scan.id).await?),
    };
    let manifest = app.lab.manifest(scan.id).await?;
    Ok(ScanBody {
        regions: Lab::regions(&manifest),
        camera: ScanCameraBody {
            width_px: manifest.camera.width_px,
            height_px: manifest.camera.height_px,
            saturation_dn: manifest.saturation_dn(),
        },
        progress: ProgressBody::new(&progress, scan.state),
        frames_rejected: store.frames_rejected(scan.id).await?,
        calibration_ids: store.calibrations_of_scan(scan.id).await?,
        ended_at: scan.ended_at().map(str::to_owned),
        operator: scan.operator.map(|a| OperatorStep::from(a).into()),
        origin: scan.origin.as_str(),
        id: scan.id,
        sample_id: scan.sample_id,
        sample_name: scan.sample_name,
        state: scan.state,
        reason: scan.reason,
        plan,
        created_at: scan.created_at,
        started_at: match scan.origin {
            Origin::Rig => scan.started_at,
            Origin::Import => None,
        },
    })
}

/// Which scans.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ScanParams {
    /// Of this sample.
    sample_id: Option<i64>,
    /// Scans in this state.
    #[param(value_type = Option<words::ScanState>)]
    state: Option<String>,
    /// Rows at most, 1 to 1000; 100 if not given.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the page before.
    cursor: Option<String>,
}

/// Scans, newest first.
#[utoipa::path(get, path = "/api/v1/scans", tag = "scans", params(ScanParams), responses(
    (status = 200, description = "A page of scans", body = List<ScanBody>),
))]
pub(super) async fn list(
    State(app): State<App>,
    Params(params): Params<ScanParams>,
) -> Result<Json<List<ScanBody>>, ApiError> {
    let state = match params.state.as_deref() {
        None => None,
        Some(word) => Some(ScanState::from_word(word).ok_or_else(|| {
            let known = ScanState::ALL.map(ScanState::as_str).join(", ");
            ApiError::invalid("state", format!("`{word}` is none of {known}"))
        })?),
    };
    let filter = ScanFilter {
        sample_id: params.sample_id,
        state,
    };
    let page = page(params.limit, params.cursor.as_deref())?;
    let found = app.lab.store().scans(filter, page).await?;
    let mut list = List::after(&found);
    for scan in found.items {
        list.take(scan.id, body(&app, scan).await)?;
    }
    Ok(Json(list))
}

/// Begin a scan.
#[utoipa::path(post, path = "/api/v1/scans", tag = "scans", request_body = ScanAsked,
    responses(
    (status = 202, description = "The scan is planned and about to run", body = Begun, headers(("Location" = String, description = "The scan"))),
    (status = 400, description = "The body cannot be understood", body = Problem),
    (status = 404, description = "There is no such sample", body = Problem),
    (status = 409, description = "The rig is busy", body = Problem),
    (status = 422, description = "The plan cannot run; `errors` names everything that is wrong", body = Problem),
    (status = 503, description = "The stages cannot be had", body = Problem),
    (status = 507, description = "The disk has no room for it", body = Problem),
))]
pub(super) async fn begin(
    State(app): State<App>,
    Body(request): Body<ScanRequest>,
) -> Result<impl IntoResponse, ApiError> {
    let scan = app.lab.start_scan(&request).await?;
    Ok(begun(scan.id, scan.state))
}

/// What a scan will take.
#[derive(Debug, Serialize, ToSchema)]
pub struct EstimateBody {
    /// Number of frames.
    n_frames: u32,
    /// Number of points (pose and exposure).
    n_shots: u32,
    /// Time for motion, settling and exposure, s; people not counted.
    duration_s: f64,
    /// Most disk space that the frames can take, bytes.
    disk_bytes: u64,
    /// Free disk space, bytes.
    disk_free_bytes: u64,
    /// What people have to do, in order.
    operator_steps: Vec<OperatorBody>,
    /// Calibrations of earlier scans that it uses.
    calibration_ids: Vec<i64>,
    /// The whole plan, less what those calibrations save.
    #[schema(value_type = Object)]
    plan: Plan,
}

/// What a scan will take; nothing moves and nothing is stored.
#[utoipa::path(post, path = "/api/v1/scans/estimate", tag = "scans", request_body = ScanAsked, responses(
    (status = 200, description = "Time, room and operator steps", body = EstimateBody),
    (status = 400, description = "The body cannot be understood", body = Problem),
    (status = 404, description = "There is no such sample", body = Problem),
    (status = 422, description = "The plan cannot run; `errors` names everything that is wrong", body = Problem),
))]
pub(super) async fn estimate(
    State(app): State<App>,
    Body(request): Body<ScanRequest>,
) -> Result<Json<EstimateBody>, ApiError> {
    let estimated = app.lab.estimate(&request).await?;
    Ok(Json(EstimateBody {
        n_frames: estimated.estimate.n_frames,
        n_shots: estimated.estimate.n_shots,
        duration_s: estimated.estimate.duration_s,
        disk_bytes: estimated.estimate.disk_bytes,
        disk_free_bytes: estimated.free_bytes,
        operator_steps: estimated
            .operator_steps
            .into_iter()
            .map(|action| OperatorStep::from(action).into())
            .collect(),
        calibration_ids: estimated.calibration_ids,
        plan: estimated.plan,
    }))
}

/// One scan.
#[utoipa::path(get, path = "/api/v1/scans/{id}", tag = "scans", params(("id" = i64, Path, description = "Number of the scan")), responses(
    (status = 200, description = "The scan", body = ScanBody),
    (status = 404, description = "There is none", body = Problem),
))]
pub(super) async fn get(State(app): State<App>, Id(id): Id) -> Result<Json<ScanBody>, ApiError> {
    let scan = app.lab.store().scan(id).await?;
    Ok(Json(body(&app, scan).await?))
}

/// What an order says that needs no more than its name.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct NothingBody {}

/// Which of the operator's steps is done.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ContinueBody {
    /// What was done, as `operator.action` of the scan asked for it; the step waited for if not given.
    #[schema(value_type = Option<words::OperatorAction>)]
    action: Option<OperatorAction>,
}

/// Pause, resume, abort, or say that the operator's step is done.
#[utoipa::path(post, path = "/api/v1/scans/{id}/{order}", tag = "scans", params(
    ("id" = i64, Path, description = "Number of the scan"),
    ("order" = String, Path, description = "pause, resume, abort or continue; resume also takes an interrupted scan up again"),
), request_body(content = Option<ContinueBody>, description = "With continue, the step that is done; else empty"), responses(
    (status = 202, description = "The state that the scan came to", body = Begun),
    (status = 400, description = "The id is not a whole number, or the body cannot be understood", body = Problem),
    (status = 404, description = "There is no such scan or order", body = Problem),
    (status = 409, description = "Not allowed in this state of the scan, or it waits for another step (`other-step`)", body = Problem),
    (status = 422, description = "There is no such step, or the Idempotency-Key was used for another request", body = Problem),
    (status = 503, description = "The stages cannot be had; of an abort: the scan is aborted, the stop did not reach the stages, and they may be moving", body = Problem),
    (status = 507, description = "The disk has no room for it", body = Problem),
))]
pub(super) async fn command(
    State(app): State<App>,
    Path((id, order)): Path<(String, String)>,
    body: Bytes,
) -> Result<impl IntoResponse, ApiError> {
    let id: i64 = id.parse().map_err(|_| ApiError::bad_request(NO_ID))?;
    let order = match order.as_str() {
        "pause" => Order::Pause,
        "resume" => Order::Resume,
        "abort" => Order::Abort,
        "continue" => {
            let done: Option<ContinueBody> = match body.is_empty() {
                true => None,
                false => from_json(&body)?,
            };
            let step = done.and_then(|done| done.action);
            step.map_or(Order::Continue, Order::Done)
        }
        other => {
            return Err(ApiError::not_found(format!(
                "a scan cannot `{other}`: pause, resume, abort or continue"
            )));
        }
    };
    let takes_a_step = matches!(order, Order::Continue | Order::Done(_));
    if !takes_a_step && !body.is_empty() {
        let NothingBody {} = from_json(&body)?;
    }
    let state = app.lab.order(id, order).await?;
    Ok(begun(id, state))
}

/// The answer that names the scan and where it is.
pub(super) fn begun(id: i64, state: ScanState) -> impl IntoResponse + use<> {
    let body = Begun {
        id: Some(id),
        state: state.to_string(),
    };
    (
        StatusCode::ACCEPTED,
        [(header::LOCATION, format!("/api/v1/scans/{id}"))],
        Json(body),
    )
}
