//! Observations of a scan, as JSON or CSV.

use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::extract::{Id, Params, page};
use super::status::{ApiError, Problem};
use crate::observation::RejectedFrame;

/// Largest difference between a requested angle and a position read back, degrees.
const MATCH_DEG: f64 = 0.5;

/// Filter and form of the observations.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ObservationParams {
    /// Only at this tilt, within 0.5°.
    theta_c_deg: Option<f64>,
    /// Only at this azimuth, within 0.5°.
    phi_s_deg: Option<f64>,
    /// Region of a part with several regions.
    region: Option<String>,
    /// json (default) or csv.
    #[param(value_type = Option<String>)]
    format: Option<Format>,
    /// Largest number of rows, 1 to 1000; all if omitted.
    #[param(minimum = 1, maximum = 1000)]
    limit: Option<u32>,
    /// `next_cursor` of the previous page.
    cursor: Option<String>,
}

/// Form of an answer.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Format {
    /// One object.
    #[default]
    Json,
    /// A table.
    Csv,
}

/// A reduced measurement.
#[derive(Debug, Clone, Serialize, ToSchema)]
pub struct ObservationBody {
    /// Camera tilt θc read back from the stage, degrees.
    theta_c_deg: f64,
    /// Sample azimuth φs read back from the stage, degrees.
    phi_s_deg: f64,
    /// Radiance for a lamp irradiance of 1 on a surface that faces the lamp; in an arbitrary unit if not `absolute`.
    signal: f64,
    /// Its standard uncertainty in the unit of `signal`, without errors common to all observations.
    sigma: f64,
    /// Number of frames of this observation.
    n_frames: u32,
}

/// Observations of a scan.
#[derive(Debug, Serialize, ToSchema)]
pub struct ObservationsBody {
    /// The observations.
    items: Vec<ObservationBody>,
    /// Hand it back as `cursor` for the next page; null at the end.
    next_cursor: Option<String>,
    /// Number of the scan.
    scan_id: i64,
    /// False while more frames may follow.
    complete: bool,
    /// Whether a white reference defines the scale.
    absolute: bool,
    /// Region of the part; null for the whole.
    region: Option<String>,
    /// Frames left out.
    rejected_frames: Vec<RejectedFrame>,
    /// Warnings, as sentences.
    warnings: Vec<String>,
}

/// Observations of a scan, reduced from its frames.
#[utoipa::path(get, path = "/api/v1/scans/{id}/observations", tag = "observations", params(("id" = i64, Path, description = "Number of the scan"), ObservationParams), responses(
    (status = 200, description = "The observations; CSV columns: theta_c_deg, phi_s_deg, signal, sigma, n_frames",
        content((ObservationsBody = "application/json"), (String = "text/csv"))),
    (status = 404, description = "There is no such scan", body = Problem),
    (status = 422, description = "The frames give no observations, or a region must be named", body = Problem),
))]
pub(super) async fn of_scan(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<ObservationParams>,
) -> Result<Response, ApiError> {
    let reduced = app.lab.observations(id, params.region.as_deref()).await?;
    let near = |value: f64, asked: Option<f64>| asked.is_none_or(|a| (value - a).abs() < MATCH_DEG);
    let items: Vec<ObservationBody> = reduced
        .set
        .observations
        .iter()
        .map(|o| ObservationBody {
            theta_c_deg: o.pose.theta_c.deg_for_tables(),
            phi_s_deg: o.pose.phi_s.deg_for_tables(),
            signal: o.signal,
            sigma: o.sigma,
            n_frames: o.n_frames,
        })
        .filter(|o| near(o.theta_c_deg, params.theta_c_deg) && near(o.phi_s_deg, params.phi_s_deg))
        .collect();
    let (items, next_cursor) = cut(items, params.limit, params.cursor.as_deref())?;
    match params.format.unwrap_or_default() {
        Format::Json => Ok(Json(ObservationsBody {
            items,
            next_cursor,
            scan_id: id,
            complete: reduced.complete,
            absolute: reduced.set.white_reference.is_some(),
            region: reduced.set.region,
            rejected_frames: reduced.set.rejected_frames,
            warnings: reduced.set.warnings,
        })
        .into_response()),
        Format::Csv => Ok(csv(id, &items)),
    }
}

/// Returns a page of the observations. Its cursor is the place of its first row.
fn cut(
    items: Vec<ObservationBody>,
    limit: Option<u32>,
    cursor: Option<&str>,
) -> Result<(Vec<ObservationBody>, Option<String>), ApiError> {
    if limit.is_none() && cursor.is_none() {
        return Ok((items, None));
    }
    let page = page(limit, cursor)?;
    let first = usize::try_from(page.cursor.unwrap_or(0)).unwrap_or(0);
    let end = first.saturating_add(page.limit as usize);
    let next = (end < items.len()).then(|| end.to_string());
    let items = items
        .into_iter()
        .skip(first)
        .take(page.limit as usize)
        .collect();
    Ok((items, next))
}

fn csv(scan_id: i64, items: &[ObservationBody]) -> Response {
    let mut text = String::from("theta_c_deg,phi_s_deg,signal,sigma,n_frames\n");
    for o in items {
        // The shortest digits that read back as the same number.
        text.push_str(&format!(
            "{},{},{},{},{}\n",
            o.theta_c_deg, o.phi_s_deg, o.signal, o.sigma, o.n_frames
        ));
    }
    let headers = [
        (header::CONTENT_TYPE, "text/csv; charset=utf-8".to_owned()),
        (
            header::CONTENT_DISPOSITION,
            format!("attachment; filename=\"scan-{scan_id}-observations.csv\""),
        ),
    ];
    (headers, text).into_response()
}
