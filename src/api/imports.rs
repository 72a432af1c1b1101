//! `/imports`: imports a recorded series from this machine into the store.

use std::path::PathBuf;

use axum::extract::Extension;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::caller::{Caller, Principal, Proof};
use super::extract::Body;
use super::status::{self, ApiError, Problem};
use crate::lab::{ImportOptions, LabError};

/// A series to import.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ImportRequest {
    /// Absolute path of the folder on the daemon's machine, below a folder of `import.roots`.
    #[schema(value_type = String)]
    folder: PathBuf,
    /// Leave out unreadable frames instead of refusing the series.
    #[serde(default)]
    skip_unreadable: bool,
}

/// Result of an import.
#[derive(Debug, Serialize, ToSchema)]
pub struct ImportBody {
    /// Number of the new scan.
    scan_id: i64,
    /// Number of its sample.
    sample_id: i64,
    /// Number of frames imported.
    n_frames: usize,
    /// Frames left out, each with the reason.
    skipped: Vec<String>,
    /// The newest scan that already holds the same series; null if there is none.
    same_as_scan_id: Option<i64>,
    /// Otherwise the scan with the same frames whose description differs least; null if there is none.
    like_scan_id: Option<i64>,
    /// Values of the description that differ. Both scans are kept.
    differences: Vec<String>,
}

/// Take a recorded series into the store as a completed scan.
#[utoipa::path(post, path = "/api/v1/imports", tag = "scans", request_body = ImportRequest, responses(
    (status = 201, description = "The new scan", body = ImportBody, headers(("Location" = String, description = "The scan"))),
    (status = 400, description = "The body cannot be read", body = Problem),
    (status = 422, description = "The folder is not below a folder that imports may read (`import.roots` of the settings), is not a series, or a frame cannot be read", body = Problem),
    (status = 507, description = "The disk has no space for the series beside the reserve; nothing was imported", body = Problem),
))]
pub(super) async fn add(
    Caller(app): Caller,
    Extension(caller): Extension<Principal>,
    Body(body): Body<ImportRequest>,
) -> Result<Response, ApiError> {
    if !body.folder.is_absolute() {
        return Err(ApiError::invalid("folder", "must be an absolute path"));
    }
    let folder = match caller.proof {
        // The daemon's user can read these files without the daemon.
        Proof::Owner => body.folder,
        Proof::Place | Proof::Token | Proof::Cookie => {
            let folder = app.access.roots.admit(&body.folder);
            folder.map_err(|problem| ApiError::invalid("folder", problem))?
        }
    };
    let options = ImportOptions {
        skip_unreadable: body.skip_unreadable,
        ..ImportOptions::default()
    };
    // On a task of its own, so that a client that leaves does not leave half a series in the store.
    let import = async move { app.lab.import(&folder, &options, &|_, _| {}).await };
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
    Ok(status::created(location, body))
}
