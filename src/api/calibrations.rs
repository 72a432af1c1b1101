//! `/calibrations`: dark and white-reference frames that later scans can use.

use axum::Json;
use axum::extract::State;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::caller::Caller;
use super::extract::{Body, Id, Params, page, since};
use super::scans::begun;
use super::status::{ApiError, Problem};
use super::{App, Begun, List};
use crate::frame::FrameKind;
use crate::lab::{LabError, ScanRequest};
use crate::store::calibrations::{Calibration, CalibrationFilter};
use crate::store::utc_text;

/// A set of calibration frames.
#[derive(Debug, Serialize, ToSchema)]
pub struct CalibrationBody {
    /// Number of the calibration.
    id: i64,
    /// Kind of its frames: dark or flat.
    kind: FrameKind,
    /// Number of the scan that took the frames.
    scan_id: i64,
    /// Exposure times, s.
    exposures_s: Vec<f64>,
    /// Camera tilts θc, degrees; empty for dark frames.
    theta_c_deg: Vec<f64>,
    /// Number of frames.
    n_frames: u32,
    /// When the frames were taken, RFC 3339 in UTC.
    created_at: String,
    /// End of its validity under the current settings, RFC 3339 in UTC.
    valid_until: String,
    /// Whether scans can use it now.
    valid: bool,
}

/// Filter of the list.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct CalibrationParams {
    /// Taken or used by this scan.
    scan_id: Option<i64>,
    /// Calibrations of this kind, dark or flat.
    kind: Option<FrameKind>,
    /// Made at or after this time, RFC 3339.
    since: Option<String>,
    /// Largest number of rows, 1 to 1000; 100 if omitted.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

fn body(app: &App, kept: Calibration) -> Result<CalibrationBody, LabError> {
    let (until, valid) = app
        .lab
        .calibration_valid_until(kept.kind, &kept.created_at)?;
    Ok(CalibrationBody {
        id: kept.id,
        kind: kept.kind,
        scan_id: kept.scan_id,
        exposures_s: kept.exposures_s,
        theta_c_deg: kept.theta_c_deg,
        n_frames: kept.n_frames,
        created_at: kept.created_at,
        valid_until: utc_text(until),
        valid,
    })
}

/// Calibrations, newest first.
#[utoipa::path(get, path = "/api/v1/calibrations", tag = "calibrations", params(CalibrationParams), responses(
    (status = 200, description = "A page of calibrations", body = List<CalibrationBody>),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn list(
    State(app): State<App>,
    Params(params): Params<CalibrationParams>,
) -> Result<Json<List<CalibrationBody>>, ApiError> {
    let page = page(params.limit, params.cursor.as_deref())?;
    if params.kind == Some(FrameKind::Sample) {
        return Err(ApiError::invalid("kind", "must be dark or flat"));
    }
    let filter = CalibrationFilter {
        scan_id: params.scan_id,
        kind: params.kind,
        since: since(params.since)?,
    };
    let found = app.lab.store().calibrations(&filter, page).await?;
    let mut list = List::after(&found);
    for kept in found.items {
        list.take(kept.id, body(&app, kept))?;
    }
    Ok(Json(list))
}

/// Take dark and white-reference frames only, for later scans. The answer names the scan that takes them; when it is
/// done, `?scan_id=` lists the calibrations.
#[utoipa::path(post, path = "/api/v1/calibrations", tag = "calibrations", request_body(content = ScanRequest,
        description = "As for a scan. Of the plan's angles only tilts are needed, and none for dark frames only"),
    responses(
    (status = 202, description = "The scan that takes them is planned and about to run", body = Begun, headers(("Location" = String, description = "That scan"))),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 404, description = "There is no such part", body = Problem),
    (status = 409, description = "The rig is busy", body = Problem),
    (status = 422, description = "The plan cannot run; `errors` lists everything that is wrong", body = Problem),
    (status = 503, description = "The stages cannot be had", body = Problem),
    (status = 507, description = "The disk has no room for it", body = Problem),
))]
pub(super) async fn take(
    Caller(app): Caller,
    Body(mut request): Body<ScanRequest>,
) -> Result<Response, ApiError> {
    if request.recipe.is_some() || request.specification.is_some() {
        return Err(ApiError::invalid(
            "recipe",
            "calibrations have no part to measure or judge: give a plan",
        ));
    }
    let plan = request.plan.get_or_insert_default();
    if plan.repeats.is_some_and(|repeats| repeats > 0) {
        return Err(ApiError::invalid(
            "plan.repeats",
            "must be 0 or omitted, since calibrations have no frames of the sample; set `dark.repeats` and `flat.repeats`",
        ));
    }
    plan.repeats = Some(0);
    let scan = app.lab.start_scan(&request).await?;
    Ok(begun(scan.id, scan.state))
}

/// One calibration. Its frames are those of its kind in the scan that took them.
#[utoipa::path(get, path = "/api/v1/calibrations/{id}", tag = "calibrations",
    params(("id" = i64, Path, description = "Number of the calibration")), responses(
    (status = 200, description = "The calibration", body = CalibrationBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn get(
    State(app): State<App>,
    Id(id): Id,
) -> Result<Json<CalibrationBody>, ApiError> {
    let kept = app.lab.store().calibration(id).await?;
    Ok(Json(body(&app, kept)?))
}
