//! `/scans/{id}/frames.tif`, `brdf.json`, `surface.bsdf` and `scan.nxs`: a scan for other programs.

use std::collections::BTreeMap;
use std::sync::Arc;

use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use futures::stream;
use serde::Deserialize;
use serde_json::Value;
use utoipa::ToSchema;

use super::App;
use super::document::Binary;
use super::extract::{Id, Params};
use super::status::{ApiError, Problem};
use crate::lab::{FrameStack, LabError, NexusDownload, ReportChoice};

/// Region of the observations.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct BrdfParams {
    /// Region of a part with several regions.
    region: Option<String>,
}

/// A file of the BiRD project's universal BRDF format, version 1.0. `metadata.schema` names the schema of the format.
#[derive(ToSchema)]
#[expect(dead_code, reason = "it describes an answer")]
pub(super) struct BirdFile {
    /// What was measured, by whom and with what.
    metadata: BTreeMap<String, Value>,
    /// Columns of equal length: directions in degrees, BRDF and its standard uncertainty in 1/sr.
    data: BTreeMap<String, BirdColumn>,
}

/// A column of a BiRD file.
#[derive(ToSchema)]
#[expect(dead_code, reason = "it describes an answer")]
pub(super) struct BirdColumn {
    /// Unit of the values, where they have one.
    unit: Option<String>,
    /// The values: numbers, or words of a notation.
    values: Vec<Value>,
    /// Notation of the words.
    notation: Option<String>,
    /// What the values are.
    comments: Option<String>,
}

/// The observations of a scan as BRDF, in the universal format of the BiRD project (JSON, version 1.0): directions in the
/// sample frame, BRDF and its standard uncertainty (k = 1), 1/sr.
#[utoipa::path(get, path = "/api/v1/scans/{id}/brdf.json", tag = "observations", params(("id" = i64, Path, description = "Number of the scan"), BrdfParams), responses(
    (status = 200, description = "A BiRD file: `metadata` and `data`", body = BirdFile),
    (status = 404, description = "There is no such scan", body = Problem),
    (status = 422, description = "The scan has no white reference, its frames give no observations, or a region must be named", body = Problem),
))]
pub(super) async fn brdf(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<BrdfParams>,
) -> Result<impl IntoResponse, ApiError> {
    let file: Value = app.lab.bird_file(id, params.region.as_deref()).await?;
    Ok((attachment(id, "brdf.json"), Json(file)))
}

/// Which fit has the surface.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct SurfaceParams {
    /// Number of the fit; the newest completed one if omitted.
    fit_id: Option<i64>,
    /// Region of a part with several regions: the newest fit of it.
    region: Option<String>,
}

/// The fitted surface of a scan as a measured material of the RGL database, which Mitsuba 3 reads: the closed form at the fitted
/// parameters, f cos θo over a hemisphere of directions of incidence.
#[utoipa::path(get, path = "/api/v1/scans/{id}/surface.bsdf", tag = "fits", params(("id" = i64, Path, description = "Number of the scan"), SurfaceParams), responses(
    (status = 200, description = "The tensor file with one wavelength, about 22 MB", content_type = "application/octet-stream", body = Binary),
    (status = 404, description = "There is no such scan or fit", body = Problem),
    (status = 409, description = "The scan has no completed fit (`no-fit`)", body = Problem),
    (status = 422, description = "The fit does not determine the surface, or belongs to another scan", body = Problem),
))]
pub(super) async fn surface(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<SurfaceParams>,
) -> Result<impl IntoResponse, ApiError> {
    let choice = ReportChoice {
        fit_id: params.fit_id,
        region: params.region,
    };
    let file = app.lab.surface_file(id, &choice).await?;
    let kind = [(header::CONTENT_TYPE, "application/octet-stream")];
    Ok((kind, attachment(id, "surface.bsdf"), file.bytes))
}

/// A scan as a NeXus file (HDF5): all frames (16 bits, compressed) with poses, exposure and time, the observations with their
/// uncertainty, and the newest completed fit.
#[utoipa::path(get, path = "/api/v1/scans/{id}/scan.nxs", tag = "frames", params(("id" = i64, Path, description = "Number of the scan")), responses(
    (status = 200, description = "The file", content_type = "application/x-hdf5", body = Binary),
    (status = 404, description = "There is no such scan", body = Problem),
    (status = 422, description = "The scan has no frames, or the file cannot be written", body = Problem),
    (status = 507, description = "The disk has no space for the file beside the reserve", body = Problem),
))]
pub(super) async fn nexus(State(app): State<App>, Id(id): Id) -> Result<Response, ApiError> {
    let file = app.lab.nexus_download(id).await?;
    let kind = [
        (header::CONTENT_TYPE, "application/x-hdf5".to_owned()),
        (header::CONTENT_LENGTH, file.bytes().to_string()),
    ];
    let parts = stream::try_unfold(file, NexusDownload::next);
    Ok((kind, attachment(id, "frames.nxs"), Body::from_stream(parts)).into_response())
}

/// All frames of a scan, calibrations included, as one 16-bit TIFF with a page per frame. The description of each page is JSON
/// with file, kind, angles and exposure.
#[utoipa::path(get, path = "/api/v1/scans/{id}/frames.tif", tag = "frames", params(("id" = i64, Path, description = "Number of the scan")), responses(
    (status = 200, description = "The stack, not compressed; a BigTIFF above 4 GB", content_type = "image/tiff", body = Binary),
    (status = 404, description = "There is no such scan", body = Problem),
    (status = 422, description = "The scan has no frames", body = Problem),
))]
pub(super) async fn stack(State(app): State<App>, Id(id): Id) -> Result<Response, ApiError> {
    let stack = Arc::new(FrameStack::open(app.lab.store(), id).await?);
    let length = stack.bytes();
    let pages = stream::try_unfold(None, move |next| page(Arc::clone(&stack), next));
    let kind = [
        (header::CONTENT_TYPE, "image/tiff".to_owned()),
        (header::CONTENT_LENGTH, length.to_string()),
    ];
    Ok((kind, attachment(id, "frames.tif"), Body::from_stream(pages)).into_response())
}

/// Returns the header of a stack, then page after page. An error ends the connection before the stated length.
async fn page(
    stack: Arc<FrameStack>,
    index: Option<usize>,
) -> Result<Option<(Vec<u8>, Option<usize>)>, LabError> {
    let Some(index) = index else {
        return Ok(Some((stack.header(), Some(0))));
    };
    if index == stack.n_pages() {
        return Ok(None);
    }
    let read = stack.page_to_send(index).await;
    let bytes =
        read.inspect_err(|error| tracing::warn!("a stack of frames ends early: {error}"))?;
    Ok(Some((bytes, Some(index + 1))))
}

fn attachment(scan_id: i64, name: &str) -> [(header::HeaderName, String); 1] {
    let disposition = format!("attachment; filename=\"scan-{scan_id}-{name}\"");
    [(header::CONTENT_DISPOSITION, disposition)]
}
