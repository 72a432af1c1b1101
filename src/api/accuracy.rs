//! `/accuracy`: the newest results of `ridged accuracy`.

use axum::Json;
use axum::extract::State;
use serde_json::Value;

use super::App;
use super::status::ApiError;
use crate::accuracy::AccuracyReport;

/// Error against run time: the newest results of `ridged accuracy --data` in this data folder.
#[utoipa::path(get, path = "/api/v1/accuracy", tag = "health", responses(
    (status = 200, description = "The object of `accuracy --json`; without points if there is no measurement yet", body = AccuracyReport),
))]
pub(super) async fn get(State(app): State<App>) -> Result<Json<Value>, ApiError> {
    Ok(Json(app.lab.accuracy().await?))
}
