//! `/frames` and the frames of a scan.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::caching::{ASK_EACH_TIME, Caching};
use super::document::Binary;
use super::extract::{Id, Params, page};
use super::status::{ApiError, Problem};
use super::{App, List};
use crate::frame::picture::SIDE_PX_MAX;
use crate::frame::{Frame, FrameKind, FrameTag, Picture};
use crate::store::frames::FrameRecord;
use crate::store::{StoreError, utc_text};

/// A frame.
#[derive(Debug, Serialize, ToSchema)]
pub struct FrameBody {
    /// Number of the frame.
    id: i64,
    /// Number of the scan that took it.
    scan_id: i64,
    /// File name in an export.
    file: String,
    /// Kind of the frame.
    kind: FrameKind,
    /// Camera tilt θc read back from the stage, degrees.
    theta_c_deg: f64,
    /// Sample azimuth φs read back from the stage, degrees.
    phi_s_deg: f64,
    /// Exposure time, s.
    exposure_s: f64,
    /// Number of the repeat, from 0.
    repeat: u32,
    /// Start of the exposure, RFC 3339 in UTC.
    timestamp: String,
    /// SHA-256 of the PNG file, hexadecimal.
    sha256: String,
    /// Columns, px.
    width_px: u32,
    /// Rows, px.
    height_px: u32,
    /// Size of the PNG file, bytes.
    bytes: i64,
    /// Mean count of all pixels, DN.
    mean_dn: f64,
    /// Largest count of a pixel, DN.
    max_dn: u16,
    /// Pixels at or above the saturation level.
    saturated_px: u32,
    /// Whether reductions use the frame.
    accepted: bool,
    /// Why the frame is not used; null if it is used.
    reason: Option<String>,
    /// SHA-256 of the imported file, hexadecimal; null if that is the PNG itself.
    original_sha256: Option<String>,
    /// What the camera's program stated with the frame; null if nothing.
    tag: Option<TagBody>,
    /// Path of the PNG on this server.
    image: String,
}

/// What a camera's program states with a frame.
#[derive(Debug, Serialize, ToSchema)]
pub struct TagBody {
    /// The camera's count of frames.
    counter: Option<u64>,
    /// Start of the exposure, RFC 3339 in UTC.
    exposure_start: Option<String>,
    /// Exposure read back, s.
    exposure_s: Option<f64>,
    /// Gain read back, in the camera's unit.
    gain: Option<f64>,
    /// Serial number of the camera.
    serial: Option<String>,
    /// Temperature of the sensor, °C.
    temperature_c: Option<f64>,
}

impl TagBody {
    fn of(tag: FrameTag) -> TagBody {
        TagBody {
            counter: tag.counter,
            exposure_start: tag.exposure_start.map(utc_text),
            exposure_s: tag.exposure_s,
            gain: tag.gain,
            serial: tag.serial,
            temperature_c: tag.temperature_c,
        }
    }
}

impl From<FrameRecord> for FrameBody {
    fn from(frame: FrameRecord) -> Self {
        FrameBody {
            image: image_of(frame.id),
            id: frame.id,
            scan_id: frame.scan_id,
            file: frame.name,
            kind: frame.kind,
            theta_c_deg: frame.theta_c_deg,
            phi_s_deg: frame.phi_s_deg,
            exposure_s: frame.exposure_s,
            repeat: frame.repeat,
            timestamp: frame.timestamp,
            sha256: frame.sha256,
            width_px: frame.width_px,
            height_px: frame.height_px,
            bytes: frame.bytes,
            mean_dn: frame.mean_dn,
            max_dn: frame.max_dn,
            saturated_px: frame.saturated_px,
            accepted: frame.accepted,
            reason: frame.reason,
            original_sha256: frame.original_sha256,
            tag: None,
        }
    }
}

/// Returns the path of a frame's file on this server.
pub(super) fn image_of(id: i64) -> String {
    format!("/api/v1/frames/{id}/image.png")
}

/// Filter of the list.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct FrameParams {
    /// Frames of this kind.
    kind: Option<FrameKind>,
    /// Largest number of rows, 1 to 1000; 100 if omitted.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

/// Frames of a scan in the order of acquisition.
#[utoipa::path(get, path = "/api/v1/scans/{id}/frames", tag = "frames", params(("id" = i64, Path, description = "Number of the scan"), FrameParams), responses(
    (status = 200, description = "A page of frames", body = List<FrameBody>),
    (status = 404, description = "There is no such scan", body = Problem),
))]
pub(super) async fn of_scan(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<FrameParams>,
) -> Result<Json<List<FrameBody>>, ApiError> {
    let store = app.lab.store();
    store.scan(id).await?;
    let page = page(params.limit, params.cursor.as_deref())?;
    let found = store.frames_of_scan(id, params.kind, page).await?;
    let ids = || found.items.iter().map(|frame| frame.id);
    let (first, last) = (ids().min().unwrap_or(0), ids().max().unwrap_or(0));
    let mut tags = store.tags_of_scan(id, first, last).await?;
    let mut list: List<FrameBody> = found.into();
    for frame in &mut list.items {
        frame.tag = tags.remove(&frame.id).map(TagBody::of);
    }
    Ok(Json(list))
}

/// One frame.
#[utoipa::path(get, path = "/api/v1/frames/{id}", tag = "frames", params(("id" = i64, Path, description = "Number of the frame")), responses(
    (status = 200, description = "The frame", body = FrameBody),
    (status = 404, description = "Not found", body = Problem),
))]
pub(super) async fn get(State(app): State<App>, Id(id): Id) -> Result<Json<FrameBody>, ApiError> {
    let store = app.lab.store();
    let frame = store.frame(id).await?;
    let mut tags = store.tags_of_scan(frame.scan_id, id, id).await?;
    let mut body = FrameBody::from(frame);
    body.tag = tags.remove(&id).map(TagBody::of);
    Ok(Json(body))
}

/// The 16-bit grey PNG of a frame; it never changes.
#[utoipa::path(get, path = "/api/v1/frames/{id}/image.png", tag = "frames", params(("id" = i64, Path, description = "Number of the frame")), responses(
    (status = 200, description = "The file, bit for bit", content_type = "image/png", body = Binary),
    (status = 304, description = "The client has the file"),
    (status = 404, description = "There is no such frame", body = Problem),
))]
pub(super) async fn image(
    State(app): State<App>,
    Id(id): Id,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let frame = app.lab.store().frame(id).await?;
    let caching = Caching::new(&headers, &frame.sha256, ASK_EACH_TIME);
    if let Some(answer) = caching.not_modified(frame.bytes.unsigned_abs()) {
        return Ok(answer);
    }
    let png = read(&app, &frame).await?;
    Ok((
        caching.headers(),
        [(header::CONTENT_TYPE, "image/png")],
        png,
    )
        .into_response())
}

/// The counts of a frame, for browsers, which reduce a 16-bit PNG to 8 bits.
#[utoipa::path(get, path = "/api/v1/frames/{id}/pixels", tag = "frames", params(("id" = i64, Path, description = "Number of the frame")), responses(
    (status = 200, description = "Little-endian u16, row by row from the top left; size in x-width-px and x-height-px", content_type = "application/octet-stream", body = Binary),
    (status = 304, description = "The client has the file"),
    (status = 404, description = "There is no such frame", body = Problem),
))]
pub(super) async fn pixels(
    State(app): State<App>,
    Id(id): Id,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let frame = app.lab.store().frame(id).await?;
    let caching = Caching::new(&headers, &frame.sha256, ASK_EACH_TIME);
    let count = u64::from(frame.width_px) * u64::from(frame.height_px);
    if let Some(answer) = caching.not_modified(size_of::<u16>() as u64 * count) {
        return Ok(answer);
    }
    let store = app.lab.store().clone();
    // Decoding blocks too, and the threads of the runtime must stay free for requests such as the stop.
    let read = tokio::task::spawn_blocking(move || {
        let png = store.read_png(&frame.sha256)?;
        let frame = Frame::from_png(&png).map_err(StoreError::Frame)?;
        Ok::<_, StoreError>(counts_of(&frame))
    });
    let counts = read.await.expect("decoding a file does not panic")?;
    Ok((caching.headers(), counts).into_response())
}

/// Returns the counts of a frame with its size.
pub(super) fn counts_of(frame: &Frame) -> impl IntoResponse + use<> {
    let bytes = frame.pixels_dn().iter().flat_map(|dn| dn.to_le_bytes());
    let bytes: Vec<u8> = bytes.collect();
    let name = HeaderName::from_static;
    let size = [
        (name("x-width-px"), frame.width_px().to_string()),
        (name("x-height-px"), frame.height_px().to_string()),
    ];
    let kind = [(header::CONTENT_TYPE, "application/octet-stream")];
    (size, kind, bytes)
}

/// Size of a picture.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PreviewParams {
    /// Greatest width and height, px, 16 to 512; 512 if omitted.
    #[param(minimum = 16, maximum = 512)]
    width: Option<u32>,
}

/// An 8-bit picture of a frame for the eye: averaged over squares of pixels until it fits the width, black at the count below
/// which 0.2 % of the pixels lie, white at the count above which 0.2 % lie. It never changes.
#[utoipa::path(get, path = "/api/v1/frames/{id}/preview.png", tag = "frames", params(("id" = i64, Path, description = "Number of the frame"), PreviewParams), responses(
    (status = 200, description = "8-bit grey PNG; the counts of black and white are in x-low-dn and x-high-dn", content_type = "image/png", body = Binary),
    (status = 304, description = "The client has the file"),
    (status = 404, description = "There is no such frame", body = Problem),
))]
pub(super) async fn preview(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<PreviewParams>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let width = params.width.unwrap_or(SIDE_PX_MAX);
    if !(16..=SIDE_PX_MAX).contains(&width) {
        let problem = format!("is {width} px, expected 16 to {SIDE_PX_MAX} px");
        return Err(ApiError::invalid("width", problem));
    }
    let frame = app.lab.store().frame(id).await?;
    let tag = format!("{}-{width}", frame.sha256);
    let caching = Caching::new(&headers, &tag, ASK_EACH_TIME);
    if let Some(answer) = caching.unchanged() {
        return Ok(answer);
    }
    let store = app.lab.store().clone();
    let made = tokio::task::spawn_blocking(move || {
        let png = store.read_png(&frame.sha256)?;
        let frame = Frame::from_png(&png).map_err(StoreError::Frame)?;
        Picture::of(&frame, width, None).map_err(StoreError::Frame)
    });
    let picture = made.await.expect("making a picture does not panic")?;
    let name = HeaderName::from_static;
    let ends = [
        (name("x-low-dn"), picture.low_dn.to_string()),
        (name("x-high-dn"), picture.high_dn.to_string()),
    ];
    let kind = [(header::CONTENT_TYPE, "image/png")];
    Ok((caching.headers(), ends, kind, picture.png).into_response())
}

async fn read(app: &App, frame: &FrameRecord) -> Result<Vec<u8>, ApiError> {
    let store = app.lab.store().clone();
    let sha256 = frame.sha256.clone();
    let png = tokio::task::spawn_blocking(move || store.read_png(&sha256))
        .await
        .expect("reading a file does not panic")?;
    Ok(png)
}
