//! The only file that knows status codes: it turns the errors of other modules into RFC 9457 problems, and makes the
//! answers that are not a plain 200.
//!
//! An error is worded where it arises and passed on unchanged, with its stable `code`. The chain of causes of an
//! internal error goes to the log only.

mod refusals;

use std::time::Duration;

use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::Begun;
use super::holder::HolderBody;
use crate::analysis::AnalysisError;
use crate::lab::LabError;
use crate::scan::plan::PlanProblem;
use crate::store::StoreError;
use crate::store::idempotency::KeptAnswer;
use crate::wording::json::{Fault, Refusal};

/// Media type of a problem.
pub(super) const PROBLEM_JSON: &str = "application/problem+json";

/// A problem by RFC 9457 (`application/problem+json`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Problem {
    /// `urn:ridged:problem:` and the code.
    pub r#type: String,
    /// The kind of problem in words.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// What is wrong, and what to do.
    pub detail: String,
    /// Stable word for programs.
    pub code: String,
    /// Each wrong value, where the problem is about values.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<FieldProblem>,
    /// Who holds the rig, where the problem is that another caller does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub holder: Option<HolderBody>,
}

/// What is wrong with one value.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FieldProblem {
    /// Path of the value, e.g. `plan.theta_c_deg[2]`.
    pub field: String,
    /// What is wrong, with the allowed values.
    pub message: String,
    /// The value and its range, where it is out of one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[schema(nullable = false)]
    pub out_of_range: Option<OutOfRange>,
}

/// A value and the range that it should be in, in the unit of the field.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct OutOfRange {
    /// The value that was sent.
    pub value: f64,
    /// Least allowed value.
    pub lower: f64,
    /// Greatest allowed value.
    pub upper: f64,
}

impl From<PlanProblem> for FieldProblem {
    fn from(problem: PlanProblem) -> Self {
        FieldProblem {
            field: problem.field,
            message: problem.message,
            out_of_range: problem
                .out_of_range
                .map(|[value, lower, upper]| OutOfRange {
                    value,
                    lower,
                    upper,
                }),
        }
    }
}

/// A problem before it is sent.
#[derive(Debug, Clone)]
pub struct ApiError {
    status: StatusCode,
    code: &'static str,
    title: &'static str,
    detail: String,
    errors: Vec<FieldProblem>,
    holder: Option<Box<HolderBody>>,
    retry_after: Option<Duration>,
}

impl ApiError {
    fn new(
        status: StatusCode,
        code: &'static str,
        title: &'static str,
        detail: impl Into<String>,
    ) -> Self {
        ApiError {
            status,
            code,
            title,
            detail: detail.into(),
            errors: Vec::new(),
            holder: None,
            retry_after: None,
        }
    }

    /// A request that cannot be read.
    pub(super) fn bad_request(detail: impl Into<String>) -> Self {
        let title = "the request cannot be read";
        ApiError::new(StatusCode::BAD_REQUEST, "bad-request", title, detail)
    }

    /// A value that is not valid.
    pub(super) fn invalid(field: impl Into<String>, message: impl Into<String>) -> Self {
        let (field, message) = (field.into(), message.into());
        let status = StatusCode::UNPROCESSABLE_ENTITY;
        let detail = format!("{field}: {message}");
        ApiError::new(status, "invalid-value", INVALID, detail).with(vec![FieldProblem {
            field,
            message,
            out_of_range: None,
        }])
    }

    /// There is nothing at that path.
    pub(super) fn not_found(detail: impl Into<String>) -> Self {
        ApiError::new(StatusCode::NOT_FOUND, "not-found", NOT_FOUND, detail)
    }

    /// The route has no such method.
    pub(super) fn method_not_allowed(detail: impl Into<String>) -> Self {
        let title = "this method is not allowed here";
        let status = StatusCode::METHOD_NOT_ALLOWED;
        ApiError::new(status, "method-not-allowed", title, detail)
    }

    /// A request that names another host.
    pub(super) fn forbidden_host(detail: impl Into<String>) -> Self {
        let title = "the request is for another host";
        ApiError::new(StatusCode::FORBIDDEN, "forbidden-host", title, detail)
    }

    /// A request that another page sent.
    pub(super) fn forbidden_origin(detail: impl Into<String>) -> Self {
        let title = "another page may not command the rig";
        ApiError::new(StatusCode::FORBIDDEN, "forbidden-origin", title, detail)
    }

    /// A body of too many bytes.
    pub(super) fn too_large(bytes_max: usize) -> Self {
        ApiError::new(
            StatusCode::PAYLOAD_TOO_LARGE,
            "body-too-large",
            "the body is too large",
            format!("a body may have {bytes_max} bytes; use `ridged import` for recorded series"),
        )
    }

    /// A body that is packed in another way than gzip.
    pub(super) fn wrong_encoding() -> Self {
        ApiError::new(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            "wrong-content-encoding",
            "the body is packed in a way that the daemon does not unpack",
            "expected a body as it is, or with Content-Encoding: gzip",
        )
    }

    /// A body that is announced as something else.
    pub(super) fn wrong_content_type(expected: &str) -> Self {
        ApiError::new(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            "wrong-content-type",
            "the body has another content type",
            format!("send the body with `Content-Type: {expected}`"),
        )
    }

    /// A body that stopped coming.
    pub(super) fn too_slow(waited: Duration) -> Self {
        ApiError::new(
            StatusCode::REQUEST_TIMEOUT,
            "body-too-slow",
            "the body did not come",
            format!(
                "no part of the body arrived for {} s; nothing was done",
                waited.as_secs()
            ),
        )
    }

    /// A body arrived below the least rate.
    pub(super) fn too_slow_in_all(bytes_per_s: u32) -> Self {
        ApiError::new(
            StatusCode::REQUEST_TIMEOUT,
            "body-too-slow",
            "the body did not come",
            format!(
                "the body arrived at less than {bytes_per_s} bytes per second; nothing was done"
            ),
        )
    }

    /// No seat for a connection.
    pub(super) fn too_many_connections() -> Self {
        ApiError::new(
            StatusCode::SERVICE_UNAVAILABLE,
            "too-many-connections",
            "too many connections",
            "too many connections are open and none of them is idle; close some event streams or pages. The stop and \
             /healthz are always answered",
        )
    }

    /// A fault of the daemon; the log has its cause.
    pub(super) fn internal() -> Self {
        let status = StatusCode::INTERNAL_SERVER_ERROR;
        ApiError::new(status, "internal", INTERNAL, INTERNAL_DETAIL)
    }

    /// A request without a valid token.
    fn unauthorized(code: &'static str, title: &'static str, detail: impl Into<String>) -> Self {
        ApiError::new(StatusCode::UNAUTHORIZED, code, title, detail)
    }

    /// A request that is never allowed to this caller.
    fn forbidden(code: &'static str, title: &'static str, detail: impl Into<String>) -> Self {
        ApiError::new(StatusCode::FORBIDDEN, code, title, detail)
    }

    /// A request that is not allowed now.
    fn conflict(code: &'static str, title: &'static str, detail: impl Into<String>) -> Self {
        ApiError::new(StatusCode::CONFLICT, code, title, detail)
    }

    /// One request too many of a peer.
    fn too_many(code: &'static str, title: &'static str, detail: impl Into<String>) -> Self {
        ApiError::new(StatusCode::TOO_MANY_REQUESTS, code, title, detail)
    }

    /// Names who uses the rig, where that is known.
    pub(super) fn with_holder(mut self, holder: Option<HolderBody>) -> Self {
        self.holder = holder.map(Box::new);
        self
    }

    fn with(mut self, errors: Vec<FieldProblem>) -> Self {
        self.errors = errors;
        self
    }

    /// The same problem of a request that calls its only value `field`.
    pub(super) fn of_field(mut self, field: &str) -> Self {
        for error in &mut self.errors {
            field.clone_into(&mut error.field);
        }
        self
    }
}

const INVALID: &str = "a value is not valid";
const NOT_FOUND: &str = "not found";
const INTERNAL: &str = "internal error";
const INTERNAL_DETAIL: &str = "internal error; the daemon's log has the details";

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let body = Problem {
            r#type: format!("urn:ridged:problem:{}", self.code),
            title: self.title.into(),
            status: self.status.as_u16(),
            detail: self.detail,
            code: self.code.into(),
            errors: self.errors,
            holder: self.holder.map(|holder| *holder),
        };
        let mut response = (self.status, axum::Json(body)).into_response();
        let headers = response.headers_mut();
        headers.insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
        if self.status == StatusCode::UNAUTHORIZED {
            let scheme = HeaderValue::from_static("Bearer realm=\"ridged\"");
            headers.insert(header::WWW_AUTHENTICATE, scheme);
        }
        if let Some(wait) = self.retry_after {
            headers.insert(header::RETRY_AFTER, HeaderValue::from(wait.as_secs() + 1));
        }
        response
    }
}

impl From<Refusal> for ApiError {
    fn from(refusal: Refusal) -> Self {
        let (status, code, title) = match refusal.fault() {
            Fault::Syntax(words) => {
                let detail =
                    format!("{words}; JSON has no NaN, no Infinity and no number beyond 1.8e308");
                let title = "the body is not JSON";
                return ApiError::new(StatusCode::BAD_REQUEST, "bad-json", title, detail);
            }
            Fault::UnknownField { .. } => {
                (StatusCode::BAD_REQUEST, "unknown-field", "unknown field")
            }
            Fault::Missing | Fault::Repeated | Fault::ListForObject | Fault::Invalid(_) => {
                (StatusCode::UNPROCESSABLE_ENTITY, "invalid-value", INVALID)
            }
        };
        let (path, message) = (refusal.path(), refusal.message("field"));
        let field = if path.is_empty() {
            "body".to_owned()
        } else {
            path
        };
        ApiError::new(status, code, title, format!("{field}: {message}")).with(vec![FieldProblem {
            field,
            message,
            out_of_range: None,
        }])
    }
}

impl From<StoreError> for ApiError {
    fn from(error: StoreError) -> Self {
        LabError::Store(error).into()
    }
}

impl From<LabError> for ApiError {
    fn from(error: LabError) -> Self {
        let code = error.code();
        let (status, title) = kind(&error, code);
        if status.is_server_error() {
            log_chain(&error);
        }
        if status == StatusCode::INTERNAL_SERVER_ERROR {
            return ApiError::new(status, code, title, INTERNAL_DETAIL);
        }
        let problem = ApiError::new(status, code, title, error.to_string());
        if let Some((axis, [value, lower, upper])) = error.outside_travel() {
            return problem.with(vec![FieldProblem {
                field: format!("{axis}_deg"),
                message: error.to_string(),
                out_of_range: Some(OutOfRange {
                    value,
                    lower,
                    upper,
                }),
            }]);
        }
        match error {
            LabError::Plan(plan) => {
                problem.with(plan.problems.into_iter().map(FieldProblem::from).collect())
            }
            LabError::Invalid {
                field,
                problem: message,
            } => problem.with(vec![FieldProblem {
                field,
                message,
                out_of_range: None,
            }]),
            _ => problem,
        }
    }
}

/// Returns status and title of an error.
fn kind(error: &LabError, code: &str) -> (StatusCode, &'static str) {
    match error {
        LabError::Busy { .. } => (StatusCode::CONFLICT, "the rig is busy"),
        LabError::NotNow { .. } | LabError::NotOfThisRig { .. } => (
            StatusCode::CONFLICT,
            "not allowed in this state of the scan",
        ),
        LabError::OtherStep { .. } => (StatusCode::CONFLICT, "the scan waits for another step"),
        LabError::Shared(error) => kind(error, code),
        LabError::Panicked => (StatusCode::INTERNAL_SERVER_ERROR, INTERNAL),
        LabError::JobConflict { .. } => (StatusCode::CONFLICT, "not allowed in this state"),
        LabError::NoRig => (StatusCode::SERVICE_UNAVAILABLE, "this daemon has no rig"),
        LabError::Stopping => (StatusCode::SERVICE_UNAVAILABLE, "the daemon is stopping"),
        LabError::Plan(_) => (StatusCode::UNPROCESSABLE_ENTITY, "the plan cannot run"),
        LabError::NoRoom { .. } | LabError::NoRoomFor { .. } => {
            (StatusCode::INSUFFICIENT_STORAGE, "the disk is full")
        }
        LabError::BrokenOff => (StatusCode::SERVICE_UNAVAILABLE, "cancelled"),
        LabError::Stage(_) if code == "outside-limits" => (
            StatusCode::UNPROCESSABLE_ENTITY,
            "the position is outside the travel",
        ),
        LabError::Stage(_) if code == "forbidden-region" => (
            StatusCode::UNPROCESSABLE_ENTITY,
            "the motion enters a forbidden region",
        ),
        LabError::Stage(_) if code == "homing-blocked" => {
            (StatusCode::CONFLICT, "the axis cannot be homed now")
        }
        LabError::JogEnded => (StatusCode::CONFLICT, "the jog has ended"),
        LabError::OtherStagesAnswer { .. } => (StatusCode::CONFLICT, "other controllers answer"),
        LabError::Stage(_) if code == "stage-not-referenced" => {
            (StatusCode::CONFLICT, "the axis has no reference position")
        }
        LabError::Stage(_) if code == "stopped" => (StatusCode::CONFLICT, "stopped"),
        LabError::Stage(_) => (
            StatusCode::SERVICE_UNAVAILABLE,
            "the stages are not available",
        ),
        LabError::NotStopped { .. }
        | LabError::StopUnconfirmed
        | LabError::AbortUnconfirmed { .. }
        | LabError::AbortedInMotion { .. } => (
            StatusCode::SERVICE_UNAVAILABLE,
            "the stages could not be stopped",
        ),
        LabError::NoLampSwitch => (StatusCode::CONFLICT, "the lamp has no switch"),
        LabError::Lamp(_) => (StatusCode::SERVICE_UNAVAILABLE, "the lamp failed"),
        LabError::Camera(_) => (StatusCode::SERVICE_UNAVAILABLE, "the camera failed"),
        LabError::Series(_)
        | LabError::Archive(_)
        | LabError::Frame { .. }
        | LabError::Invalid { .. } => (StatusCode::UNPROCESSABLE_ENTITY, INVALID),
        LabError::Analysis(AnalysisError::Reduction(_)) => (
            StatusCode::UNPROCESSABLE_ENTITY,
            "the frames give no observations",
        ),
        LabError::Analysis(AnalysisError::Cancelled) => {
            (StatusCode::CONFLICT, "the analysis was cancelled")
        }
        LabError::NoReport { .. } => (StatusCode::CONFLICT, "the scan has nothing to report"),
        LabError::Store(StoreError::NotFound { .. } | StoreError::NoVersion { .. }) => {
            (StatusCode::NOT_FOUND, NOT_FOUND)
        }
        LabError::Store(StoreError::NameTaken { .. } | StoreError::PartNameTaken { .. }) => {
            (StatusCode::CONFLICT, "the name is taken")
        }
        LabError::Store(StoreError::ExternalIdTaken { .. }) => {
            (StatusCode::CONFLICT, "another order has this external id")
        }
        LabError::Store(StoreError::OrderConflict { .. }) | LabError::QueueConflict { .. } => {
            (StatusCode::CONFLICT, "not allowed in this state")
        }
        LabError::EmptyQueue => (StatusCode::CONFLICT, "no order waits"),
        LabError::Store(StoreError::VersionConflict { .. }) => {
            (StatusCode::CONFLICT, "there is a newer version")
        }
        LabError::Store(StoreError::DiskFull { .. }) => {
            (StatusCode::INSUFFICIENT_STORAGE, "the disk is full")
        }
        LabError::Store(StoreError::NoAnswer)
        | LabError::WaitsForDatabase {
            no_answer: true, ..
        } => (StatusCode::SERVICE_UNAVAILABLE, "the disk does not answer"),
        LabError::Store(StoreError::Locked) | LabError::WaitsForDatabase { .. } => (
            StatusCode::SERVICE_UNAVAILABLE,
            "the database is locked by another program",
        ),
        LabError::Store(StoreError::FolderGone { .. }) => (
            StatusCode::SERVICE_UNAVAILABLE,
            "the data folder is not the one that was opened",
        ),
        LabError::Store(_) if code == "disk-failed" => (
            StatusCode::SERVICE_UNAVAILABLE,
            "the disk of the data folder fails",
        ),
        LabError::Store(StoreError::Damaged { .. }) => {
            (StatusCode::SERVICE_UNAVAILABLE, "the database is damaged")
        }
        LabError::Store(StoreError::StateConflict { .. }) => (
            StatusCode::CONFLICT,
            "not allowed in this state of the scan",
        ),
        LabError::Store(StoreError::KeyReused) => (
            StatusCode::UNPROCESSABLE_ENTITY,
            "the Idempotency-Key belongs to another request",
        ),
        LabError::Store(_) | LabError::Export(_) => {
            (StatusCode::INTERNAL_SERVER_ERROR, "the store failed")
        }
    }
}

fn log_chain(error: &LabError) {
    let mut chain = error.to_string();
    let mut source = std::error::Error::source(error);
    while let Some(cause) = source {
        chain.push_str(": ");
        chain.push_str(&cause.to_string());
        source = cause.source();
    }
    tracing::error!("a request failed: {chain}");
}

/// Returns 202 for work that has begun, and where to look at it.
pub(super) fn accepted(location: impl Into<String>, body: Begun) -> Response {
    let location = [(header::LOCATION, location.into())];
    (StatusCode::ACCEPTED, location, axum::Json(body)).into_response()
}

/// Returns 202 for an order that is carried out within a moment.
pub(super) fn ordered(body: Begun) -> Response {
    (StatusCode::ACCEPTED, axum::Json(body)).into_response()
}

/// Returns 201 for a new row, and where it is.
pub(super) fn created(location: String, body: impl Serialize) -> Response {
    let location = [(header::LOCATION, location)];
    (StatusCode::CREATED, location, axum::Json(body)).into_response()
}

/// Returns 201 for something new that has no place of its own.
pub(super) fn made(body: impl Serialize) -> Response {
    (StatusCode::CREATED, axum::Json(body)).into_response()
}

/// Returns 304 for a file that the client has.
pub(super) fn not_modified(headers: impl axum::response::IntoResponseParts) -> Response {
    (StatusCode::NOT_MODIFIED, headers, ()).into_response()
}

/// Returns 200 when the daemon is ready, else 503, with the same body.
pub(super) fn readiness(ready: bool, body: impl Serialize) -> Response {
    let status = match ready {
        true => StatusCode::OK,
        false => StatusCode::SERVICE_UNAVAILABLE,
    };
    (status, axum::Json(body)).into_response()
}

/// Returns 503 and a text for people.
pub(super) fn unavailable(text: &'static str) -> Response {
    (StatusCode::SERVICE_UNAVAILABLE, text).into_response()
}

/// Returns the first answer to a request that was sent again under the same key.
pub(super) fn repeated(kept: KeptAnswer) -> Response {
    let status = StatusCode::from_u16(kept.status).unwrap_or(StatusCode::OK);
    let kind = [(header::CONTENT_TYPE, "application/json")];
    let mut response = (status, kind, kept.body).into_response();
    if let Some(location) = kept.location.and_then(|location| location.parse().ok()) {
        response.headers_mut().insert(header::LOCATION, location);
    }
    response
}

/// Returns what to keep of the answer to a request with a key.
pub(super) fn to_keep(status: StatusCode, headers: &HeaderMap, body: &[u8]) -> KeptAnswer {
    let location = headers.get(header::LOCATION);
    KeptAnswer {
        status: status.as_u16(),
        location: location
            .and_then(|location| location.to_str().ok())
            .map(str::to_owned),
        body: String::from_utf8_lossy(body).into_owned(),
    }
}
