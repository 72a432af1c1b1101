//! `/scans/{id}/report`: the report on a scan, to print or as JSON.

use axum::Json;
use axum::extract::State;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use serde::Deserialize;

use super::App;
use super::extract::{Id, Params};
use super::status::{ApiError, Problem};
use crate::lab::ReportChoice;
use crate::report::MeasurementReport;
use crate::store::utc_text;

/// Choice of the fit, and form of the report.
#[derive(Debug, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct ReportParams {
    /// Number of the fit; the newest completed one if omitted.
    fit_id: Option<i64>,
    /// Region of a part with several regions: the newest fit of it.
    region: Option<String>,
    /// html (default) or json.
    #[param(value_type = Option<String>)]
    format: Option<Format>,
}

/// Form of a report.
#[derive(Debug, Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Format {
    /// A page to print.
    #[default]
    Html,
    /// One object.
    Json,
}

/// A report needs its styles and nothing else.
const POLICY: &str =
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'none'";

/// The report on a scan: result, uncertainty budget, verdict, rig, calibrations and hashes. HTML without scripts and other
/// files, to print on A4, or JSON with all digits; `sha256` is over its canonical form by RFC 8785.
#[utoipa::path(get, path = "/api/v1/scans/{id}/report", tag = "scans", params(("id" = i64, Path, description = "Number of the scan"), ReportParams), responses(
    (status = 200, description = "The report", content((String = "text/html"), (MeasurementReport = "application/json"))),
    (status = 404, description = "There is no such scan or fit", body = Problem),
    (status = 409, description = "The scan has no completed fit (`no-fit`)", body = Problem),
    (status = 422, description = "The fit belongs to another scan", body = Problem),
))]
pub(super) async fn of_scan(
    State(app): State<App>,
    Id(id): Id,
    Params(params): Params<ReportParams>,
) -> Result<Response, ApiError> {
    let choice = ReportChoice {
        fit_id: params.fit_id,
        region: params.region,
    };
    let report = app.lab.report(id, &choice).await?;
    let named = |place: &str, extension: &str| {
        let name = format!("{place}; filename=\"report-scan-{id}.{extension}\"");
        (header::CONTENT_DISPOSITION, name)
    };
    Ok(match params.format.unwrap_or_default() {
        Format::Html => {
            let printed_at = utc_text(app.lab.clock().utc());
            let headers = [
                (header::CONTENT_TYPE, "text/html; charset=utf-8".to_owned()),
                (header::CONTENT_SECURITY_POLICY, POLICY.to_owned()),
                named("inline", "html"),
            ];
            (headers, report.html(&printed_at)).into_response()
        }
        Format::Json => ([named("attachment", "json")], Json(report.sealed())).into_response(),
    })
}
