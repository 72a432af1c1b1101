//! `/rig/preview`: frames at the present pose that are measured and shown, and not stored.

use axum::Json;
use axum::extract::State;
use axum::http::{HeaderName, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::caller::Caller;
use super::document::Binary;
use super::extract::{Body, Id};
use super::frames::counts_of;
use super::lease::user_of_rig;
use super::status::{ApiError, Problem};
use crate::lab::{LabError, PreviewFrame, PreviewRequest, PreviewView};
use crate::preview::Area;
use crate::preview::exposures::Suggestion;
use crate::store::utc_text;

/// A preview to take.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PreviewBody {
    /// Exposures, s: 1 to 8 values, together at most 60 s. Those of the settings if omitted.
    #[serde(default)]
    #[schema(min_items = 1, max_items = 8, example = json!([0.02, 0.06]))]
    exposures_s: Option<Vec<f64>>,
    /// Whether the lamp is on. `false` needs the setting `lamp.off`.
    #[serde(default = "on")]
    #[schema(default = true)]
    lamp: bool,
    /// The part of the frame to measure; the whole frame if omitted.
    #[serde(default)]
    area: Option<Area>,
    /// Number of exposures to suggest for a scan, 0 to 2; as many as are taken, at most 2, if omitted. The daemon may take
    /// further frames of up to 10 s to find them.
    #[serde(default)]
    #[schema(maximum = 2, example = 2)]
    suggest: Option<u32>,
}

fn on() -> bool {
    true
}

/// A preview.
#[derive(Debug, Serialize, ToSchema)]
pub struct PreviewAnswer {
    /// Camera tilt θc read from the stage, degrees.
    theta_c_deg: f64,
    /// Sample azimuth φs read from the stage, degrees.
    phi_s_deg: f64,
    /// Whether both angles count from a reference position. False until the axes are homed.
    referenced: bool,
    /// Whether the lamp was on.
    lamp: bool,
    /// The part of the frame that was measured.
    area: Area,
    /// Whether the newest dark frames of this rig name the defect pixels. Otherwise a lone full pixel counts as a
    /// defect.
    defects_known: bool,
    /// One frame per exposure, in the order of the request.
    frames: Vec<PreviewFrameBody>,
    /// Exposures for a scan from this pose; null if none were requested.
    suggestion: Option<Suggestion>,
}

/// A frame of a preview. The figures are those of the area without its defect pixels.
#[derive(Debug, Serialize, ToSchema)]
pub struct PreviewFrameBody {
    /// Number of the frame. Only the newest frames are kept, in memory.
    id: u64,
    /// Exposure time, s.
    exposure_s: f64,
    /// Start of the exposure, RFC 3339 in UTC.
    taken_at: String,
    /// Columns of the frame, px.
    width_px: u32,
    /// Rows of the frame, px.
    height_px: u32,
    /// Least count, DN.
    min_dn: u16,
    /// Median count, DN.
    median_dn: u16,
    /// Mean count, DN.
    mean_dn: f64,
    /// Greatest count, DN.
    max_dn: u16,
    /// Pixels per bin, from 0 DN.
    histogram: HistogramBody,
    /// Pixels at or above the count of a full pixel.
    saturated_px: u32,
    /// Defect pixels of the area; they take no part in the other figures.
    defect_px: u32,
    /// Figure of focus: the change of brightness from pixel to pixel, root mean square, over the mean brightness, without the
    /// part of the noise. The sharpest picture of one pose and one area has the greatest; null without light.
    focus: Option<f64>,
    /// Picture of 8 bits and at most 512 px on this server.
    image: PictureBody,
    /// Path of the 16-bit counts on this server.
    pixels: String,
}

/// A histogram of 64 bins of equal width.
#[derive(Debug, Serialize, ToSchema)]
pub struct HistogramBody {
    /// Counts per bin, DN. The first bin begins at 0 DN.
    bin_dn: u32,
    /// Pixels of each bin.
    #[schema(min_items = 64, max_items = 64)]
    pixels: Vec<u32>,
}

/// A picture of a frame.
#[derive(Debug, Serialize, ToSchema)]
pub struct PictureBody {
    /// Path of the PNG on this server.
    path: String,
    /// Columns, px.
    width_px: u32,
    /// Rows, px.
    height_px: u32,
    /// Count that is black, DN: 0.2 % of the pixels are darker.
    low_dn: f64,
    /// Count that is white, DN: 0.2 % of the pixels are brighter.
    high_dn: f64,
}

impl From<PreviewFrame> for PreviewFrameBody {
    fn from(frame: PreviewFrame) -> Self {
        let PreviewFrame {
            id,
            exposure_s,
            taken_at,
            size_px: (width_px, height_px),
            figures,
            picture,
        } = frame;
        PreviewFrameBody {
            id,
            exposure_s,
            taken_at: utc_text(taken_at),
            width_px,
            height_px,
            min_dn: figures.min_dn,
            median_dn: figures.median_dn,
            mean_dn: figures.mean_dn,
            max_dn: figures.max_dn,
            histogram: HistogramBody {
                bin_dn: figures.bin_dn,
                pixels: figures.histogram,
            },
            saturated_px: figures.saturated_px,
            defect_px: figures.defect_px,
            focus: figures.focus,
            image: PictureBody {
                path: format!("/api/v1/rig/preview/{id}/image.png"),
                width_px: picture.width_px,
                height_px: picture.height_px,
                low_dn: picture.low_dn,
                high_dn: picture.high_dn,
            },
            pixels: format!("/api/v1/rig/preview/{id}/pixels"),
        }
    }
}

impl From<PreviewView> for PreviewAnswer {
    fn from(view: PreviewView) -> Self {
        let pose = view.stages.pose();
        PreviewAnswer {
            theta_c_deg: pose.theta_c.deg_for_tables(),
            phi_s_deg: pose.phi_s.deg_for_tables(),
            referenced: view.stages.all_homed(),
            lamp: view.lamp,
            area: view.area,
            defects_known: view.defects_known,
            frames: view
                .frames
                .into_iter()
                .map(PreviewFrameBody::from)
                .collect(),
            suggestion: view.suggestion,
        }
    }
}

/// Take a frame per exposure at the present pose and measure it. Nothing moves, and nothing is stored. Any other order to the
/// rig comes first and ends the preview.
#[utoipa::path(post, path = "/api/v1/rig/preview", tag = "rig", request_body = PreviewBody, responses(
    (status = 200, description = "The frames and their figures", body = PreviewAnswer),
    (status = 409, description = "A motion or a scan, also a paused one, holds the rig, or another order came first (`busy`; `holder` says who uses the rig); or the lamp has no command to switch it off (`no-lamp-switch`)", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
    (status = 503, description = "The stages are not available, or the camera or the lamp failed", body = Problem),
))]
pub(super) async fn take(
    Caller(app): Caller,
    Body(body): Body<PreviewBody>,
) -> Result<Json<PreviewAnswer>, ApiError> {
    let request = PreviewRequest {
        exposures_s: body.exposures_s,
        lamp: body.lamp,
        area: body.area,
        suggest: body.suggest.map(|suggest| suggest as usize),
    };
    match app.lab.preview(request).await {
        Ok(view) => Ok(Json(view.into())),
        Err(busy @ LabError::Busy { .. }) => {
            Err(ApiError::from(busy).with_holder(user_of_rig(&app)))
        }
        Err(error) => Err(error.into()),
    }
}

/// The 8-bit picture of a preview's frame.
#[utoipa::path(get, path = "/api/v1/rig/preview/{id}/image.png", tag = "rig", params(("id" = i64, Path, description = "Number of the frame")), responses(
    (status = 200, description = "The picture", content_type = "image/png", body = Binary),
    (status = 404, description = "The frame is no longer kept", body = Problem),
))]
pub(super) async fn image(State(app): State<App>, Id(id): Id) -> Result<Response, ApiError> {
    let found = u64::try_from(id).ok();
    let picture = found.and_then(|id| app.lab.preview_picture(id));
    let picture = picture.ok_or_else(|| gone(id))?;
    let headers = [
        (header::CONTENT_TYPE, "image/png"),
        // Numbers begin again with the daemon.
        (header::CACHE_CONTROL, "no-store"),
    ];
    Ok((headers, picture.png.clone()).into_response())
}

/// The 16-bit counts of a preview's frame.
#[utoipa::path(get, path = "/api/v1/rig/preview/{id}/pixels", tag = "rig", params(("id" = i64, Path, description = "Number of the frame")), responses(
    (status = 200, description = "Little-endian u16, row by row from the top left; size in x-width-px and x-height-px", content_type = "application/octet-stream", body = Binary),
    (status = 404, description = "The frame is no longer kept", body = Problem),
))]
pub(super) async fn pixels(State(app): State<App>, Id(id): Id) -> Result<Response, ApiError> {
    let found = u64::try_from(id).ok();
    let frame = found.and_then(|id| app.lab.preview_counts(id));
    let frame = frame.ok_or_else(|| gone(id))?;
    let no_store: [(HeaderName, &str); 1] = [(header::CACHE_CONTROL, "no-store")];
    Ok((no_store, counts_of(&frame)).into_response())
}

fn gone(id: i64) -> ApiError {
    ApiError::not_found(format!(
        "the preview frame {id} is not kept: the daemon keeps the newest ones only; take another preview"
    ))
}
