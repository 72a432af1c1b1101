//! `/scans`: estimate, start, command and read scans.

use axum::Json;
use axum::body::Bytes;
use axum::extract::{Path, State};
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::caller::Caller;
use super::extract::{Body, Id, Params, id_of, page};
use super::status::{self, ApiError, Problem};
use super::{App, Begun, List};
use crate::frame::FrameKind;
use crate::lab::{Estimated, Lab, LabError, ScanRequest};
use crate::scan::event::OperatorStep;
use crate::scan::runner::ScanCommand;
use crate::scan::{OperatorAction, Plan, Progress, ScanState};
use crate::store::definitions::DefinitionRef;
use crate::store::earlier::EarlierSample;
use crate::store::records::tag_fault;
use crate::store::scans::{Origin, Scan, ScanFilter};
use crate::wording::json;

/// Phase of a scan: the kind of the frames being taken, and done at its end.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Phase {
    /// Dark frames.
    Dark,
    /// Frames of the white reference.
    Flat,
    /// Frames of the sample.
    Sample,
    /// All frames are stored.
    Done,
}

impl From<FrameKind> for Phase {
    fn from(kind: FrameKind) -> Self {
        match kind {
            FrameKind::Dark => Phase::Dark,
            FrameKind::Flat => Phase::Flat,
            FrameKind::Sample => Phase::Sample,
        }
    }
}

/// Progress of a scan.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ProgressBody {
    /// Phase of the scan; null before the start.
    phase: Option<Phase>,
    /// Points (pose and exposure) whose frames are stored.
    shots_done: u32,
    /// Points (pose and exposure) of the whole plan.
    shots_total: u32,
    /// Frames stored so far.
    frames_done: u32,
    /// Frames of the whole plan.
    frames_total: u32,
    /// Elapsed share of the predicted time, 0 to 1.
    fraction: f64,
    /// Time spent moving and exposing, s.
    elapsed_s: f64,
    /// Predicted time left, s; null if unknown.
    time_left_s: Option<f64>,
}

impl ProgressBody {
    pub(super) fn new(progress: &Progress, state: ScanState) -> Self {
        ProgressBody {
            phase: match state {
                ScanState::Completed => Some(Phase::Done),
                _ => progress.phase.map(Phase::from),
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

/// A scan.
#[derive(Debug, Serialize, ToSchema)]
pub struct ScanBody {
    /// Number of the scan.
    id: i64,
    /// Number of the part.
    sample_id: i64,
    /// Name of the part.
    sample_name: String,
    /// State of the scan.
    state: ScanState,
    /// Reason for the state, if it is not the normal course.
    reason: Option<String>,
    /// Origin of the scan.
    origin: Origin,
    /// The operator step that it waits for; else null.
    operator: Option<OperatorStep>,
    /// The whole plan; of an import, its poses.
    plan: Plan,
    /// Progress of the scan.
    progress: ProgressBody,
    /// Number of frames that were taken and rejected.
    frames_rejected: u32,
    /// Regions of a part with patches, one of which a fit must name; else empty.
    regions: Vec<String>,
    /// The camera that took the frames.
    camera: ScanCameraBody,
    /// Calibrations that it uses, including its own.
    calibration_ids: Vec<i64>,
    /// The version of the recipe that it was started with; null for a scan of a plan.
    recipe: Option<DefinitionRef>,
    /// Expanded uncertainty (k = 2) of θr that the recipe asks for, degrees; null if it states none.
    target_expanded_deg: Option<f64>,
    /// The version of the specification that it is judged against.
    specification: Option<DefinitionRef>,
    /// The person at the rig.
    operator_name: Option<String>,
    /// Lot of the part.
    lot: Option<String>,
    /// Number of the part or order in another system.
    external_id: Option<String>,
    /// The order of the queue that it measures; null for a scan that was started by itself.
    order_id: Option<i64>,
    /// Who started it: the name of a token, or `local`.
    who: String,
    /// Parts that it was assigned to before, oldest first.
    earlier_samples: Vec<EarlierSample>,
    /// Tags, in the order in which they were given.
    tags: Vec<String>,
    /// Free text on the scan.
    note: Option<String>,
    /// Whether lists leave the scan out unless they are asked for archived scans.
    archived: bool,
    /// When the scan was requested, RFC 3339 in UTC.
    created_at: String,
    /// When it started, RFC 3339 in UTC.
    started_at: Option<String>,
    /// When it ended, RFC 3339 in UTC.
    ended_at: Option<String>,
}

/// Properties of the camera that displaying its frames needs.
#[derive(Debug, Serialize, ToSchema)]
pub struct ScanCameraBody {
    /// Columns of a frame, px.
    width_px: u32,
    /// Rows of a frame, px.
    height_px: u32,
    /// Count at which a pixel is full, DN.
    saturation_dn: f64,
    /// Whether its program states when each frame of the sample was exposed. If not, the scan could compare pictures only, and
    /// cannot exclude a frame of an earlier pose. Null before the first frame, and for an import.
    states_exposure_start: Option<bool>,
}

pub(super) async fn body(app: &App, scan: Scan) -> Result<ScanBody, LabError> {
    let scan = app.lab.with_unrecorded_end(scan);
    let store = app.lab.store();
    let progress = store.last_progress(scan.id).await?;
    let plan = match scan.plan.clone() {
        Some(plan) => plan,
        None => app.lab.plan_of_import(scan.id).await?,
    };
    let manifest = app.lab.manifest(scan.id).await?;
    let recipe = app.lab.recipe_of(&scan).await?;
    Ok(ScanBody {
        regions: Lab::regions(&manifest),
        camera: ScanCameraBody {
            width_px: manifest.camera.width_px,
            height_px: manifest.camera.height_px,
            saturation_dn: manifest.saturation_dn(),
            states_exposure_start: match scan.origin {
                Origin::Rig => store.frames_are_timed(scan.id).await?,
                Origin::Import => None,
            },
        },
        progress: ProgressBody::new(&progress, scan.state),
        frames_rejected: store.frames_rejected(scan.id).await?,
        calibration_ids: store.calibrations_of_scan(scan.id).await?,
        ended_at: scan.ended_at().map(str::to_owned),
        operator: scan.operator.map(OperatorStep::from),
        origin: scan.origin,
        id: scan.id,
        sample_id: scan.sample_id,
        sample_name: scan.sample_name,
        state: scan.state,
        reason: scan.reason,
        plan,
        target_expanded_deg: recipe.and_then(|recipe| recipe.target_expanded_deg),
        recipe: scan.recipe,
        specification: scan.specification,
        operator_name: scan.operator_name,
        lot: scan.lot,
        external_id: scan.external_id,
        order_id: scan.order_id,
        who: scan.who,
        earlier_samples: scan.earlier_samples,
        tags: scan.record.tags,
        note: scan.record.note,
        archived: scan.record.archived,
        created_at: scan.created_at,
        started_at: match scan.origin {
            Origin::Rig => scan.started_at,
            Origin::Import => None,
        },
    })
}

/// Filter of the list.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ScanParams {
    /// Scans of this part.
    sample_id: Option<i64>,
    /// Scans in this state.
    state: Option<ScanState>,
    /// Scans with this tag.
    tag: Option<String>,
    /// true: only archived scans; false, or omitted: only others; all: both.
    #[serde(default)]
    #[param(inline, value_type = Option<Archived>)]
    archived: Archived,
    /// Largest number of rows, 1 to 1000; 100 if omitted.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

/// Which scans a list has.
#[derive(Debug, Clone, Copy, Default, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Archived {
    /// Archived scans.
    True,
    /// Scans that are not archived.
    #[default]
    False,
    /// Both.
    All,
}

/// Scans, newest first.
#[utoipa::path(get, path = "/api/v1/scans", tag = "scans", params(ScanParams), responses(
    (status = 200, description = "A page of scans", body = List<ScanBody>),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn list(
    State(app): State<App>,
    Params(params): Params<ScanParams>,
) -> Result<Json<List<ScanBody>>, ApiError> {
    let filter = ScanFilter {
        sample_id: params.sample_id,
        state: params.state,
        archived: match params.archived {
            Archived::True => Some(true),
            Archived::False => Some(false),
            Archived::All => None,
        },
        tag: match params.tag {
            Some(tag) => match tag_fault(&tag) {
                Some(problem) => return Err(ApiError::invalid("tag", problem)),
                None => Some(tag),
            },
            None => None,
        },
    };
    let page = page(params.limit, params.cursor.as_deref())?;
    let found = app.lab.store().scans(filter, page).await?;
    let mut list = List::after(&found);
    for scan in found.items {
        list.take(scan.id, body(&app, scan).await)?;
    }
    Ok(Json(list))
}

/// Start a scan.
#[utoipa::path(post, path = "/api/v1/scans", tag = "scans", request_body = ScanRequest,
    responses(
    (status = 202, description = "The scan is planned and about to run", body = Begun, headers(("Location" = String, description = "The scan"))),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 404, description = "There is no such part", body = Problem),
    (status = 409, description = "The rig is busy", body = Problem),
    (status = 422, description = "The plan cannot run; `errors` lists everything that is wrong", body = Problem),
    (status = 503, description = "The stages are not available", body = Problem),
    (status = 507, description = "The disk has no space for it", body = Problem),
))]
pub(super) async fn begin(
    Caller(app): Caller,
    Body(request): Body<ScanRequest>,
) -> Result<Response, ApiError> {
    let scan = app.lab.start_scan(&request).await?;
    Ok(begun(scan.id, scan.state))
}

/// Estimate of a scan.
#[derive(Debug, Serialize, ToSchema)]
pub struct EstimateBody {
    /// Number of frames.
    n_frames: u32,
    /// Number of points (pose and exposure).
    n_shots: u32,
    /// Time for motion, settling and exposure, s, without waiting for the operator.
    duration_s: f64,
    /// Largest disk space that the frames can take, bytes.
    disk_bytes: u64,
    /// Free disk space, bytes.
    disk_free_bytes: u64,
    /// Disk space that scans leave free, bytes: a scan begins where its frames have room beside it.
    disk_reserve_bytes: u64,
    /// Operator steps, in order.
    operator_steps: Vec<OperatorStep>,
    /// Calibrations of earlier scans that it uses.
    calibration_ids: Vec<i64>,
    /// The whole plan without the frames that those calibrations replace.
    plan: Plan,
}

/// Estimate a scan. Nothing moves and nothing is stored.
#[utoipa::path(post, path = "/api/v1/scans/estimate", tag = "scans", request_body = ScanRequest, responses(
    (status = 200, description = "Time, disk space and operator steps", body = EstimateBody),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 404, description = "There is no such part", body = Problem),
    (status = 422, description = "The plan cannot run; `errors` lists everything that is wrong", body = Problem),
))]
pub(super) async fn estimate(
    State(app): State<App>,
    Body(request): Body<ScanRequest>,
) -> Result<Json<EstimateBody>, ApiError> {
    let estimated = app.lab.estimate(&request).await?;
    Ok(Json(estimated.into()))
}

impl From<Estimated> for EstimateBody {
    fn from(estimated: Estimated) -> Self {
        let steps = estimated.operator_steps.into_iter();
        EstimateBody {
            n_frames: estimated.estimate.n_frames,
            n_shots: estimated.estimate.n_shots,
            duration_s: estimated.estimate.duration_s,
            disk_bytes: estimated.estimate.disk_bytes,
            disk_free_bytes: estimated.free_bytes,
            disk_reserve_bytes: estimated.reserve_bytes,
            operator_steps: steps.map(OperatorStep::from).collect(),
            calibration_ids: estimated.calibration_ids,
            plan: estimated.plan,
        }
    }
}

/// One scan.
#[utoipa::path(get, path = "/api/v1/scans/{id}", tag = "scans", params(("id" = i64, Path, description = "Number of the scan")), responses(
    (status = 200, description = "The scan", body = ScanBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn get(State(app): State<App>, Id(id): Id) -> Result<Json<ScanBody>, ApiError> {
    let scan = app.lab.store().scan(id).await?;
    Ok(Json(body(&app, scan).await?))
}

/// Body of a command without parameters.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct NothingBody {}

/// The operator step that is done.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ContinueBody {
    /// The step that was done, as in `operator.action` of the scan; the current step if omitted.
    action: Option<OperatorAction>,
}

/// Pause, resume or abort a scan, or confirm an operator step.
#[utoipa::path(post, path = "/api/v1/scans/{id}/{order}", tag = "scans", params(
    ("id" = i64, Path, description = "Number of the scan"),
    ("order" = String, Path, description = "pause, resume, abort or continue; resume also resumes an interrupted scan"),
), request_body(content = Option<ContinueBody>, description = "With continue, the step that is done; else empty"), responses(
    (status = 202, description = "The new state of the scan", body = Begun),
    (status = 400, description = "The id is not a whole number, or the body cannot be read", body = Problem),
    (status = 404, description = "There is no such scan or order", body = Problem),
    (status = 409, description = "Not allowed in this state of the scan, or it waits for another step (`other-step`)", body = Problem),
    (status = 422, description = "There is no such step, or the Idempotency-Key was used for another request", body = Problem),
    (status = 503, description = "The stages are not available; after an abort: the scan is aborted, but the stop did not reach the stages, which may be moving", body = Problem),
    (status = 507, description = "The disk has no space for it", body = Problem),
))]
pub(super) async fn command(
    Caller(app): Caller,
    Path((id, order)): Path<(String, String)>,
    body: Bytes,
) -> Result<Response, ApiError> {
    let id = id_of(id)?;
    let order = match order.as_str() {
        "pause" => ScanCommand::Pause,
        "resume" => ScanCommand::Resume,
        "abort" => ScanCommand::Abort,
        "continue" => {
            let done: Option<ContinueBody> = match body.is_empty() {
                true => None,
                false => json::from_slice(&body)?,
            };
            let step = done.and_then(|done| done.action);
            step.map_or(ScanCommand::Continue, ScanCommand::Done)
        }
        other => {
            return Err(ApiError::not_found(format!(
                "there is no command `{other}`; expected pause, resume, abort or continue"
            )));
        }
    };
    let takes_a_step = matches!(order, ScanCommand::Continue | ScanCommand::Done(_));
    if !takes_a_step && !body.is_empty() {
        let NothingBody {} = json::from_slice(&body)?;
    }
    let state = app.lab.order(id, order).await?;
    Ok(begun(id, state))
}

/// Returns the answer that names the scan and its state.
pub(super) fn begun(id: i64, state: ScanState) -> Response {
    let body = Begun {
        id: Some(id),
        state: state.to_string(),
    };
    status::accepted(format!("/api/v1/scans/{id}"), body)
}
