//! `/accuracy`: the newest results of `ridged accuracy`.

use axum::Json;
use axum::extract::State;
use serde_json::Value;

use super::App;
use super::status::{ApiError, Problem};
use crate::accuracy::AccuracyReport;

/// Error against run time: the newest results of `ridged accuracy --data` in this data folder.
#[utoipa::path(get, path = "/api/v1/accuracy", tag = "health", responses(
    (status = 200, description = "The object of `accuracy --json`", body = AccuracyReport),
    (status = 404, description = "This data folder has no results", body = Problem),
))]
pub(super) async fn get(State(app): State<App>) -> Result<Json<Value>, ApiError> {
    Ok(Json(app.lab.accuracy().await?))
}
