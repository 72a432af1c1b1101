//! `/imports`: a recorded series on this machine into the store.

use std::path::PathBuf;

use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::IntoResponse;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::error::{ApiError, Problem};
use super::extract::Body;
use crate::lab::{ImportOptions, LabError};

/// A series to be imported.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ImportRequest {
    /// Absolute path of its folder on the daemon's machine.
    #[schema(value_type = String)]
    folder: PathBuf,
    /// Leave out frames that cannot be read, instead of refusing the series.
    #[serde(default)]
    skip_unreadable: bool,
}

/// What an import did.
#[derive(Debug, Serialize, ToSchema)]
pub struct ImportBody {
    /// The scan it became.
    scan_id: i64,
    /// The sample it is of.
    sample_id: i64,
    /// Frames kept.
    n_frames: usize,
    /// Frames left out, with the reason.
    skipped: Vec<String>,
    /// The newest scan that holds the very same series already; null where it is new.
    same_as_scan_id: Option<i64>,
    /// Where none does: the scan that holds the same frames and differs least in what it says of them; else null.
    like_scan_id: Option<i64>,
    /// What it says otherwise, value by value. Both scans are kept.
    differences: Vec<String>,
}

/// Take a recorded series into the store as a completed scan.
#[utoipa::path(post, path = "/api/v1/imports", tag = "scans", request_body = ImportRequest, responses(
    (status = 201, description = "The scan it became", body = ImportBody, headers(("Location" = String, description = "The scan"))),
    (status = 400, description = "The body cannot be understood", body = Problem),
    (status = 422, description = "The folder is not a series, or a frame cannot be read", body = Problem),
    (status = 507, description = "The series would not leave the reserve free, or the disk is full; nothing was imported", body = Problem),
))]
pub(super) async fn add(
    State(app): State<App>,
    Body(body): Body<ImportRequest>,
) -> Result<impl IntoResponse, ApiError> {
    if !body.folder.is_absolute() {
        return Err(ApiError::invalid("folder", "must be an absolute path"));
    }
    let options = ImportOptions {
        skip_unreadable: body.skip_unreadable,
        ..ImportOptions::default()
    };
    // On a task of its own: a client that goes away does not leave half a series behind.
    let import = async move { app.lab.import(&body.folder, &options, &|_, _| {}).await };
    let imported = tokio::spawn(import)
        .await
        .map_err(|_| ApiError::from(LabError::Stopping))??;
    let location = format!("/api/v1/scans/{}", imported.scan_id);
    let body = ImportBody {
        scan_id: imported.scan_id,
        sample_id: imported.sample_id,
        n_frames: imported.n_frames,
        skipped: imported.skipped,
        same_as_scan_id: imported.same_as,
        like_scan_id: imported.like.as_ref().map(|like| like.scan_id),
        differences: imported.like.map_or_else(Vec::new, |like| like.differences),
    };
    Ok((
        StatusCode::CREATED,
        [(header::LOCATION, location)],
        Json(body),
    ))
}
