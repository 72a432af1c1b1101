//! `/calibrations`: dark and white-reference frames that later scans may use.

use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

use super::error::ApiError;
use super::extract::{PageParams, Params, page};
use super::{App, List};
use crate::store::utc_text;

/// A set of calibration frames.
#[derive(Debug, Serialize, ToSchema)]
pub struct CalibrationBody {
    /// Its number.
    id: i64,
    /// dark or flat.
    kind: String,
    /// Scan that took the frames.
    scan_id: i64,
    /// Exposures.
    exposures_s: Vec<f64>,
    /// Tilts; empty for dark frames.
    theta_c_deg: Vec<f64>,
    /// Frames.
    n_frames: u32,
    /// RFC 3339 UTC.
    created_at: String,
    /// Until when scans may use it, as the settings are now.
    valid_until: String,
    /// Whether they may now.
    valid: bool,
}

/// Calibrations, newest first.
#[utoipa::path(get, path = "/api/v1/calibrations", tag = "calibrations", params(PageParams), responses(
    (status = 200, description = "A page of calibrations", body = List<CalibrationBody>),
))]
pub(super) async fn list(
    State(app): State<App>,
    Params(params): Params<PageParams>,
) -> Result<Json<List<CalibrationBody>>, ApiError> {
    let page = page(params.limit, params.cursor.as_deref())?;
    let found = app.lab.store().calibrations(page).await?;
    let mut items = Vec::with_capacity(found.items.len());
    for c in found.items {
        let (until, valid) = app.lab.calibration_valid_until(&c.kind, &c.created_at)?;
        items.push(CalibrationBody {
            id: c.id,
            kind: c.kind,
            scan_id: c.scan_id,
            exposures_s: c.exposures_s,
            theta_c_deg: c.theta_c_deg,
            n_frames: c.n_frames,
            created_at: c.created_at,
            valid_until: utc_text(until),
            valid,
        });
    }
    Ok(Json(List {
        items,
        next_cursor: found.next_cursor.map(|c| c.to_string()),
    }))
}
