//! `/imports`: imports a recorded series into the store, from a folder of this machine or as an upload.

use std::path::PathBuf;
use std::sync::Arc;

use axum::extract::{Extension, Request};
use axum::http::header;
use axum::response::Response;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::caller::{Caller, Principal, Proof};
use super::extract::{Body, Params};
use super::guard;
use super::status::{self, ApiError, Problem};
use crate::lab::{ImportOptions, Imported, LabError, ReceivedFile};

/// Uploads at a time.
pub(super) const UPLOADS_MAX: usize = 2;
/// Content types of a zip archive; browsers on Windows send the second one.
const ZIP: [&str; 2] = ["application/zip", "application/x-zip-compressed"];
/// Longest name of an upload, in characters and in bytes.
const NAME_LENGTH_MAX: usize = 200;
const NAME_BYTES_MAX: usize = 250;

/// A series to import.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ImportRequest {
    /// Absolute path of the folder on the daemon's machine, below a folder of `import.roots`.
    #[schema(value_type = String, max_length = 4096)]
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
    /// Number of its part.
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
    answer(async move { app.lab.import(&folder, &options, &|_, _| {}).await }).await
}

/// Answers with the new scan. On a task of its own, so that a client that leaves does not leave half a series in the
/// store.
async fn answer(
    import: impl Future<Output = Result<Imported, LabError>> + Send + 'static,
) -> Result<Response, ApiError> {
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

/// How an upload is imported.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct UploadParams {
    /// Name of the archive, which a series without a name gets; at most 200 characters.
    #[param(max_length = 200)]
    name: Option<String>,
    /// Leave out unreadable frames instead of refusing the series.
    #[serde(default)]
    skip_unreadable: bool,
}

/// Send a recorded series as a zip archive, and take it into the store as a completed scan.
///
/// The archive has manifest.toml, the table of frames and the frames, at the top or in one folder; at most 65,535 files and
/// 4 GB. An Idempotency-Key is ignored: the answer names an earlier scan of the same series.
#[utoipa::path(post, path = "/api/v1/imports/upload", tag = "scans", params(UploadParams),
    request_body(content = Vec<u8>, content_type = "application/zip", description = "The archive"), responses(
    (status = 201, description = "The new scan", body = ImportBody, headers(("Location" = String, description = "The scan"))),
    (status = 400, description = "The query cannot be read, or the body broke off", body = Problem),
    (status = 408, description = "The body stopped coming", body = Problem),
    (status = 415, description = "The body is not announced as a zip archive", body = Problem),
    (status = 422, description = "The archive cannot be read or contains no series, or a frame cannot be read", body = Problem),
    (status = 429, description = "Two other uploads are in progress", body = Problem),
    (status = 507, description = "The disk has no space for the series beside the reserve; nothing was imported", body = Problem),
))]
pub(super) async fn upload(
    Caller(app): Caller,
    Params(params): Params<UploadParams>,
    request: Request,
) -> Result<Response, ApiError> {
    let file_name = file_name_of(params.name.as_deref())?;
    let announced = request.headers().get(header::CONTENT_TYPE);
    let announced = announced.and_then(|kind| kind.to_str().ok());
    if !announced.is_some_and(|kind| ZIP.contains(&kind)) {
        let refused = ApiError::wrong_content_type(ZIP[0]);
        return Ok(guard::refuse(request, refused).await);
    }
    let Ok(place_in_line) = Arc::clone(&app.uploads).try_acquire_owned() else {
        return Ok(guard::refuse(request, ApiError::too_many_bodies()).await);
    };
    let mut archive = app.lab.receive(&file_name).await?;
    receive(request.into_body(), &mut archive).await?;
    let options = ImportOptions {
        skip_unreadable: params.skip_unreadable,
        ..ImportOptions::default()
    };
    answer(async move {
        let _held = place_in_line;
        let imported = app
            .lab
            .import_archive(archive.path(), &options, &|_, _| {})
            .await;
        archive.discard().await;
        imported
    })
    .await
}

/// Returns the name for the file of an upload.
fn file_name_of(name: Option<&str>) -> Result<String, ApiError> {
    let name = name.unwrap_or("series.zip");
    let is_plain =
        !name.contains(['/', '\\']) && !name.starts_with('.') && !name.contains(char::is_control);
    match is_plain
        && (1..=NAME_LENGTH_MAX).contains(&name.chars().count())
        && name.len() < NAME_BYTES_MAX
    {
        true => Ok(name.to_owned()),
        false => Err(ApiError::invalid(
            "name",
            format!("must be the plain name of a file, of 1 to {NAME_LENGTH_MAX} characters"),
        )),
    }
}

/// Writes a body to a file.
async fn receive(body: axum::body::Body, file: &mut ReceivedFile) -> Result<(), ApiError> {
    let mut arrival = guard::Arrival::new(body, guard::CHUNK_WAIT);
    while let Some(part) = arrival.next().await? {
        file.add(&part).await?;
    }
    Ok(file.end().await?)
}
