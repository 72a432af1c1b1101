//! Liveness, readiness and metrics.

use axum::extract::{Request, State};
use axum::http::{Method, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

use super::App;
use super::document;
use super::status;
use crate::logging;
use crate::store::ROOM_TO_OPEN_KB;

/// Path of the liveness check.
pub(super) const HEALTHZ: &str = "/healthz";

/// Returns whether the request is the liveness check.
pub(super) fn is_healthz(request: &Request) -> bool {
    matches!(*request.method(), Method::GET | Method::HEAD) && request.uri().path() == HEALTHZ
}

/// Liveness: answered however many connections are open.
#[utoipa::path(get, path = "/healthz", tag = "health", responses((status = 200, description = "The daemon is alive", body = String)))]
pub(super) async fn healthz() -> &'static str {
    "ok\n"
}

/// Readiness of the daemon.
#[derive(Debug, Serialize, ToSchema)]
pub struct ReadyBody {
    /// Whether store and rig are ready.
    ready: bool,
    /// Whether the store commits, records all running scans and has disk space.
    store: bool,
    /// Whether the stages answer; true for a daemon without a rig.
    rig: bool,
    /// Why it is not ready; null if it is ready.
    problem: Option<String>,
}

/// Readiness: store and stages answer, and the disk has space.
#[utoipa::path(get, path = "/readyz", tag = "health", responses(
    (status = 200, description = "Ready to serve requests", body = ReadyBody),
    (status = 503, description = "Not ready; `problem` states why", body = ReadyBody),
))]
pub(super) async fn readyz(State(app): State<App>) -> Response {
    let store = match app.lab.check_folder().await {
        Ok(()) => app.lab.store().check_commits().await,
        gone => gone,
    };
    let (rig, problem) = match app.lab.rig().await {
        Ok(view) => (view.connected, view.problem.map(|(_, detail)| detail)),
        Err(crate::lab::LabError::NoRig) => (true, None),
        Err(error) => (false, Some(error.to_string())),
    };
    let unrecorded = app.lab.unrecorded_scans().into_iter().next();
    let free = match &store {
        Ok(()) => app.lab.store().free_bytes().await.ok(),
        // A disk that does not answer does not answer this either.
        Err(_) => None,
    };
    let no_room = free.filter(|bytes| *bytes < 1024 * ROOM_TO_OPEN_KB);
    let kept = store.is_ok() && unrecorded.is_none() && no_room.is_none();
    let ready = kept && rig;
    let problem = match (&store, unrecorded) {
        (Err(error), _) => Some(error.to_string()),
        (Ok(()), Some((scan, why))) => Some(format!("scan {scan} cannot be recorded: {why}")),
        (Ok(()), None) => match no_room {
            Some(bytes) => Some(format!(
                "the disk of the data folder has {bytes} bytes left, too few to record anything; free some space"
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
    status::readiness(ready, body)
}

/// Registers the description of each metric.
pub(super) fn describe_metrics() {
    use ::metrics::{Unit, describe_counter, describe_gauge, describe_histogram};
    describe_counter!(
        "ridged_scan_states_total",
        "State changes of scans, by new state"
    );
    describe_counter!(
        "ridged_frames_total",
        "Frames stored, by whether they are used"
    );
    describe_counter!(
        "ridged_frames_decoded_total",
        "Frames read from the store and decoded for a reduction or a map"
    );
    describe_counter!(
        "ridged_task_states_total",
        "State changes of fits, maps, contrasts, verdicts and traces, by task and new state"
    );
    describe_counter!("ridged_alarms_total", "Alarms, by code");
    describe_counter!(
        "ridged_hooks_total",
        "Hooks, by name and outcome: done, failed or dropped"
    );
    describe_counter!(
        "ridged_stage_line_total",
        "Exchanges with the stages, and faults of the line: timeout, garbled, stray or alert"
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
    describe_counter!(
        "ridged_log_lines_left_out_total",
        "Lines of the log left out because stderr had no reader"
    );
    describe_gauge!(
        "ridged_disk_free_bytes",
        Unit::Bytes,
        "Free space on the disk of the data folder"
    );
}

/// Counters and timings for Prometheus: state changes of scans and jobs, frames, alarms, the line to the stages, requests,
/// disk space. Each `# HELP` line describes a metric.
#[utoipa::path(get, path = "/metrics", tag = "health", responses((status = 200, description = "Prometheus text", content_type = "text/plain", body = String)))]
pub(super) async fn metrics(State(app): State<App>) -> impl IntoResponse {
    let store = app.lab.store();
    if store.check_disk().await.is_ok()
        && let Ok(free) = store.free_bytes().await
    {
        ::metrics::gauge!("ridged_disk_free_bytes").set(free as f64);
    }
    ::metrics::counter!("ridged_log_lines_left_out_total").absolute(logging::lines_left_out());
    (
        [(header::CONTENT_TYPE, "text/plain; version=0.0.4")],
        (app.render_metrics)(),
    )
}

/// This document.
pub(super) async fn openapi() -> impl IntoResponse {
    (
        [(header::CONTENT_TYPE, "application/json")],
        document::openapi(),
    )
}
