//! Whether the daemon lives, is ready, and how it fares.

use axum::Json;
use axum::extract::{Request, State};
use axum::http::{Method, StatusCode, header};
use axum::response::IntoResponse;
use serde::Serialize;
use utoipa::ToSchema;

use super::App;
use super::error::ApiError;
use crate::store::ROOM_TO_OPEN_KB;

/// Where it is asked whether the daemon lives.
pub(super) const HEALTHZ: &str = "/healthz";

/// Whether it is the question whether the daemon lives.
pub(super) fn is_healthz(request: &Request) -> bool {
    matches!(*request.method(), Method::GET | Method::HEAD) && request.uri().path() == HEALTHZ
}

/// Whether it lives; answered however many are connected.
#[utoipa::path(get, path = "/healthz", tag = "health", responses((status = 200, description = "The daemon is alive", body = String)))]
pub(super) async fn healthz() -> &'static str {
    "ok\n"
}

/// Whether it can work.
#[derive(Debug, Serialize, ToSchema)]
pub struct ReadyBody {
    /// Whether everything is there.
    ready: bool,
    /// Whether the store answers and keeps what it is told.
    store: bool,
    /// Whether the stages answer; true for a daemon without a rig.
    rig: bool,
    /// Why it is not ready; null if it is.
    problem: Option<String>,
}

/// Whether it can work: store and stages answer, and the disk has room.
#[utoipa::path(get, path = "/readyz", tag = "health", responses(
    (status = 200, description = "Ready to serve requests", body = ReadyBody),
    (status = 503, description = "It cannot; `problem` says why", body = ReadyBody),
))]
pub(super) async fn readyz(State(app): State<App>) -> impl IntoResponse {
    let store = app.lab.store().check_commits().await;
    let (rig, problem) = match app.lab.rig().await {
        Ok(view) => (view.connected, view.problem.map(|(_, detail)| detail)),
        Err(crate::lab::LabError::NoRig) => (true, None),
        Err(error) => (false, Some(error.to_string())),
    };
    let unrecorded = app.lab.unrecorded_scans().into_iter().next();
    let free = app.lab.store().free_bytes().ok();
    let no_room = free.filter(|bytes| *bytes < 1024 * ROOM_TO_OPEN_KB);
    let kept = store.is_ok() && unrecorded.is_none() && no_room.is_none();
    let ready = kept && rig;
    let status = match ready {
        true => StatusCode::OK,
        false => StatusCode::SERVICE_UNAVAILABLE,
    };
    let problem = match (&store, unrecorded) {
        (Err(error), _) => Some(error.to_string()),
        (Ok(()), Some((scan, why))) => Some(format!("scan {scan} cannot be recorded: {why}")),
        (Ok(()), None) => match no_room {
            Some(bytes) => Some(format!(
                "the disk of the data folder has {bytes} bytes left: nothing more can be kept; make room"
            )),
            None => problem,
        },
    };
    let body = ReadyBody {
        ready,
        store: kept,
        rig,
        problem,
    };
    (status, Json(body))
}

/// Says what each metric is, in the text that monitors read.
pub(super) fn describe_metrics() {
    use ::metrics::{Unit, describe_counter, describe_gauge, describe_histogram};
    describe_counter!(
        "ridged_scan_states_total",
        "States that scans came to, by state"
    );
    describe_counter!(
        "ridged_frames_total",
        "Frames kept, by whether they are used"
    );
    describe_counter!(
        "ridged_task_states_total",
        "States that fits, maps, contrasts, verdicts and traces came to, by task and state"
    );
    describe_counter!("ridged_alarms_total", "Alarms, by code");
    describe_counter!(
        "ridged_stage_line_total",
        "Exchanges with the stages, and what went wrong on the line: timeout, garbled, stray or alert"
    );
    describe_counter!(
        "ridged_http_requests_total",
        "Requests answered, by method and status"
    );
    describe_histogram!(
        "ridged_http_request_seconds",
        Unit::Seconds,
        "Time to answer a request"
    );
    describe_gauge!(
        "ridged_disk_free_bytes",
        Unit::Bytes,
        "Space left where the data folder is"
    );
}

/// Counters and timings for Prometheus: scans and other work by the states they came to, frames, alarms, the line to the
/// stages, requests, space left. Each `# HELP` line says what a metric is.
#[utoipa::path(get, path = "/metrics", tag = "health", responses((status = 200, description = "Prometheus text", content_type = "text/plain", body = String)))]
pub(super) async fn metrics(State(app): State<App>) -> impl IntoResponse {
    if let Ok(free) = app.lab.store().free_bytes() {
        ::metrics::gauge!("ridged_disk_free_bytes").set(free as f64);
    }
    (
        [(header::CONTENT_TYPE, "text/plain; version=0.0.4")],
        (app.render_metrics)(),
    )
}

/// This document.
pub(super) async fn openapi(State(app): State<App>) -> Result<impl IntoResponse, ApiError> {
    Ok((
        [(header::CONTENT_TYPE, "application/json")],
        app.openapi.to_string(),
    ))
}
