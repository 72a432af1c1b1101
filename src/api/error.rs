//! The only file that knows status codes: from what the rooms refuse to RFC 9457 problems.
//!
//! The client gets a stable `code`, cause and remedy; the chain of causes of an internal error goes
//! to the log only.

use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::analysis::AnalysisError;
use crate::lab::LabError;
use crate::store::StoreError;
use crate::wording::numbers::readable;

/// How a problem is announced.
pub(super) const PROBLEM_JSON: &str = "application/problem+json";

/// A problem as RFC 9457 has it (`application/problem+json`).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Problem {
    /// `urn:ridged:problem:` and the code.
    pub r#type: String,
    /// The kind of problem in words.
    pub title: String,
    /// HTTP status.
    pub status: u16,
    /// What happened here, and what to do.
    pub detail: String,
    /// Stable word for programs.
    pub code: String,
    /// Single values that are wrong, where there are some.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub errors: Vec<FieldProblem>,
}

/// What is wrong with one value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct FieldProblem {
    /// Path of the value, e.g. `plan.theta_c_deg[2]`.
    pub field: String,
    /// What is wrong, with the allowed values.
    pub message: String,
}

/// A problem on its way out.
#[derive(Debug, Clone)]
pub struct ApiError {
    status: StatusCode,
    code: &'static str,
    title: &'static str,
    detail: String,
    errors: Vec<FieldProblem>,
}

impl ApiError {
    /// A problem with a status and a stable code.
    pub fn new(
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
        }
    }

    /// A request that cannot be understood.
    pub fn bad_request(detail: impl Into<String>) -> Self {
        let title = "the request cannot be understood";
        ApiError::new(StatusCode::BAD_REQUEST, "bad-request", title, detail)
    }

    /// A value that makes no sense.
    pub fn invalid(field: impl Into<String>, message: impl Into<String>) -> Self {
        let (field, message) = (field.into(), message.into());
        let status = StatusCode::UNPROCESSABLE_ENTITY;
        let title = "a value makes no sense";
        ApiError::new(
            status,
            "invalid-value",
            title,
            format!("{field}: {message}"),
        )
        .with(vec![FieldProblem { field, message }])
    }

    /// Nothing is there.
    pub fn not_found(detail: impl Into<String>) -> Self {
        ApiError::new(
            StatusCode::NOT_FOUND,
            "not-found",
            "there is no such thing",
            detail,
        )
    }

    /// Names the values that are wrong.
    #[must_use]
    pub fn with(mut self, errors: Vec<FieldProblem>) -> Self {
        self.errors = errors;
        self
    }
}

impl IntoResponse for ApiError {
    fn into_response(self) -> Response {
        let errors = self.errors.into_iter().map(|error| FieldProblem {
            message: readable(&error.message),
            ..error
        });
        let body = Problem {
            r#type: format!("urn:ridged:problem:{}", self.code),
            title: self.title.into(),
            status: self.status.as_u16(),
            detail: readable(&self.detail),
            code: self.code.into(),
            errors: errors.collect(),
        };
        let mut response = (self.status, axum::Json(body)).into_response();
        response
            .headers_mut()
            .insert(header::CONTENT_TYPE, HeaderValue::from_static(PROBLEM_JSON));
        response
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
            let detail = "something went wrong inside; the daemon's log has the details";
            return ApiError::new(status, code, title, detail);
        }
        let problem = ApiError::new(status, code, title, error.to_string());
        match error {
            LabError::Plan(plan) => problem.with(
                plan.problems
                    .into_iter()
                    .map(|p| FieldProblem {
                        field: p.field,
                        message: p.message,
                    })
                    .collect(),
            ),
            LabError::Invalid {
                field,
                problem: message,
            } => problem.with(vec![FieldProblem { field, message }]),
            _ => problem,
        }
    }
}

/// The one map from what the rooms refuse to a status.
fn kind(error: &LabError, code: &str) -> (StatusCode, &'static str) {
    match error {
        LabError::Busy { .. } => (StatusCode::CONFLICT, "the rig is busy"),
        LabError::NotNow { .. } | LabError::NotOfThisRig { .. } => (
            StatusCode::CONFLICT,
            "not allowed in this state of the scan",
        ),
        LabError::OtherStep { .. } => (StatusCode::CONFLICT, "the scan waits for another step"),
        LabError::Shared(error) => kind(error, code),
        LabError::Panicked => (
            StatusCode::INTERNAL_SERVER_ERROR,
            "something went wrong inside",
        ),
        LabError::JobConflict { .. } => (StatusCode::CONFLICT, "not allowed in this state"),
        LabError::NoRig => (StatusCode::SERVICE_UNAVAILABLE, "this daemon has no rig"),
        LabError::Stopping => (StatusCode::SERVICE_UNAVAILABLE, "the daemon is stopping"),
        LabError::Plan(_) => (StatusCode::UNPROCESSABLE_ENTITY, "the plan cannot run"),
        LabError::NoRoom { .. } | LabError::NoRoomToImport { .. } => {
            (StatusCode::INSUFFICIENT_STORAGE, "the disk is full")
        }
        LabError::BrokenOff => (StatusCode::SERVICE_UNAVAILABLE, "it was cancelled"),
        LabError::Stage(_) if code == "outside-limits" => (
            StatusCode::UNPROCESSABLE_ENTITY,
            "the position is outside the travel",
        ),
        LabError::Stage(_) if code == "stage-not-referenced" => {
            (StatusCode::CONFLICT, "the axis does not know where it is")
        }
        LabError::Stage(_) if code == "stopped" => (StatusCode::CONFLICT, "a stop came first"),
        LabError::Stage(_) => (StatusCode::SERVICE_UNAVAILABLE, "the stages cannot be had"),
        LabError::NotStopped { .. } | LabError::AbortedInMotion { .. } => (
            StatusCode::SERVICE_UNAVAILABLE,
            "the stages could not be stopped",
        ),
        LabError::Camera(_) => (StatusCode::SERVICE_UNAVAILABLE, "the camera failed"),
        LabError::Series(_) | LabError::Frame { .. } | LabError::Invalid { .. } => {
            (StatusCode::UNPROCESSABLE_ENTITY, "a value makes no sense")
        }
        LabError::Analysis(AnalysisError::Reduction(_)) => (
            StatusCode::UNPROCESSABLE_ENTITY,
            "the frames give no observations",
        ),
        LabError::Analysis(AnalysisError::Cancelled) => {
            (StatusCode::CONFLICT, "the analysis was cancelled")
        }
        LabError::NothingMeasured => (StatusCode::NOT_FOUND, "there is no measurement"),
        LabError::Store(StoreError::NotFound { .. }) => {
            (StatusCode::NOT_FOUND, "there is no such thing")
        }
        LabError::Store(StoreError::DiskFull { .. }) => {
            (StatusCode::INSUFFICIENT_STORAGE, "the disk is full")
        }
        LabError::Store(StoreError::StateConflict { .. }) => (
            StatusCode::CONFLICT,
            "not allowed in this state of the scan",
        ),
        LabError::Store(StoreError::KeyReused) => (
            StatusCode::UNPROCESSABLE_ENTITY,
            "the Idempotency-Key belongs to another request",
        ),
        LabError::Store(_) | LabError::Export(_) => (
            StatusCode::INTERNAL_SERVER_ERROR,
            "the store could not do it",
        ),
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
