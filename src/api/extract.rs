//! What comes in: bodies, paths and queries, each refused with a problem that names the value.

use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::{FromRequest, FromRequestParts, Path, Query, Request};
use axum::http::request::Parts;
use axum::http::{StatusCode, header};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::error::{ApiError, FieldProblem};
use crate::store::{PageRequest, utc_of, utc_text};
use crate::wording::objects;
use crate::wording::refusals::{missing, plain};

/// Most bytes of a body.
pub const BODY_BYTES_MAX: usize = 8 << 20;

/// A JSON body.
pub struct Body<T>(pub T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequest<S> for Body<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, _: &S) -> Result<Self, ApiError> {
        let bytes = axum::body::to_bytes(request.into_body(), BODY_BYTES_MAX)
            .await
            .map_err(|_| too_large())?;
        from_json(&bytes).map(Body)
    }
}

/// What a body of JSON says.
pub(super) fn from_json<T: DeserializeOwned>(bytes: &[u8]) -> Result<T, ApiError> {
    let read = objects::read(bytes).map_err(|error| json_problem(error, &Value::Null))?;
    let value: T = serde_path_to_error::deserialize(&read).map_err(|e| json_problem(e, &read))?;
    objects::check::<T>(&read).map_err(|refusal| {
        let path = refusal.path().to_string();
        let (field, message) = told(&path, &refusal.into_inner().to_string());
        ApiError::invalid(field, message)
    })?;
    Ok(value)
}

pub(super) fn too_large() -> ApiError {
    ApiError::new(
        StatusCode::PAYLOAD_TOO_LARGE,
        "body-too-large",
        "the body is too large",
        format!(
            "a body may have {BODY_BYTES_MAX} bytes; recorded series come in by `ridged import`"
        ),
    )
}

fn syntax(error: serde_json::Error) -> ApiError {
    ApiError::new(
        StatusCode::BAD_REQUEST,
        "bad-json",
        "the body is not JSON",
        format!(
            "{}; JSON knows no NaN, no Infinity and no number beyond 1.8e308",
            error
                .to_string()
                .replace("EOF while parsing", "it ends within")
        ),
    )
}

/// Where a value is wrong and what is wrong with it, in words.
fn told(path: &str, message: &str) -> (String, String) {
    let path = match path {
        "." => "",
        path => path,
    };
    match (missing(message), path) {
        (Some(name), "") => (name.to_owned(), "is missing".to_owned()),
        (Some(name), path) => (format!("{path}.{name}"), "is missing".to_owned()),
        (None, "") => ("body".to_owned(), plain(message)),
        (None, path) => (path.to_owned(), plain(message)),
    }
}

/// The field that a message is about, where the path to it ends at the object around it: which kind of object it is
/// stands beside the fields, and what reads it forgets which of them it is at.
fn within(path: &str, message: &str, body: &Value) -> Option<String> {
    let got = message
        .strip_prefix("invalid type: ")?
        .split(", expected ")
        .next()?;
    let at = path.split('.').try_fold(body, |at, name| at.get(name))?;
    let said = |value: &Value| match value {
        Value::Null => "null".to_owned(),
        Value::Bool(value) => format!("boolean `{value}`"),
        Value::Number(number) if number.is_f64() => format!("floating point `{number}`"),
        Value::Number(number) => format!("integer `{number}`"),
        Value::String(text) => format!("string {text:?}"),
        Value::Array(_) => "sequence".to_owned(),
        Value::Object(_) => "map".to_owned(),
    };
    let mut named = at
        .as_object()?
        .iter()
        .filter(|(_, value)| said(value) == got);
    match (named.next(), named.next()) {
        (Some((name, _)), None) => Some(format!("{path}.{name}")),
        _ => None,
    }
}

fn json_problem(error: serde_path_to_error::Error<serde_json::Error>, body: &Value) -> ApiError {
    let path = error.path().to_string();
    let inner = error.into_inner();
    if !inner.is_data() {
        return syntax(inner);
    }
    let path = within(&path, &inner.to_string(), body).unwrap_or(path);
    let (field, message) = told(&path, &inner.to_string());
    let inner = inner.to_string();
    let (status, code, title) = if inner.starts_with("unknown field") {
        (
            StatusCode::BAD_REQUEST,
            "unknown-field",
            "there is no such field",
        )
    } else {
        (
            StatusCode::UNPROCESSABLE_ENTITY,
            "invalid-value",
            "a value makes no sense",
        )
    };
    ApiError::new(status, code, title, format!("{field}: {message}"))
        .with(vec![FieldProblem { field, message }])
}

/// The number in a path.
pub struct Id(pub i64);

/// The number in a path, and the name of a file after it.
pub struct IdAndName(pub i64, pub String);

impl<S: Send + Sync> FromRequestParts<S> for Id {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        in_path(parts, state).await.map(Id)
    }
}

impl<S: Send + Sync> FromRequestParts<S> for IdAndName {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let (id, name) = in_path(parts, state).await?;
        Ok(IdAndName(id, name))
    }
}

/// What is wrong with an id, which is not repeated: it may be of any length.
pub const NO_ID: &str = "the id in the path is no whole number, or has more than 19 digits";

async fn in_path<T: DeserializeOwned + Send, S: Send + Sync>(
    parts: &mut Parts,
    state: &S,
) -> Result<T, ApiError> {
    match Path::from_request_parts(parts, state).await {
        Ok(Path(value)) => Ok(value),
        Err(PathRejection::FailedToDeserializePathParams(_)) => Err(ApiError::bad_request(NO_ID)),
        Err(other) => Err(ApiError::bad_request(other.body_text())),
    }
}

/// Parameters after the question mark.
pub struct Params<T>(pub T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for Params<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        match Query::<T>::from_request_parts(parts, state).await {
            Ok(Query(value)) => Ok(Params(value)),
            Err(QueryRejection::FailedToDeserializeQueryString(error)) => {
                Err(query_problem(&error.body_text()))
            }
            Err(other) => Err(ApiError::bad_request(other.body_text())),
        }
    }
}

/// What is wrong with a parameter: its name, and what was wanted of it.
fn query_problem(text: &str) -> ApiError {
    let text = text
        .strip_prefix("Failed to deserialize query string: ")
        .unwrap_or(text);
    if let Some(unknown) = text.find("unknown field ") {
        let words = plain(&text[unknown..]);
        return ApiError::bad_request(words.replacen("field", "parameter", 1));
    }
    if let Some(name) = missing(text) {
        return ApiError::invalid(name, "is missing");
    }
    match text.split_once(": ") {
        Some((field, problem)) => {
            let wanted = match problem {
                p if p.contains("digit") || p.contains("parse integer") => "is not a whole number",
                p if p.contains("number too") => "is too large or too small a number",
                p if p.contains("float") => "is not a number",
                p if p.contains("bool") => "must be true or false",
                p => return ApiError::invalid(field, plain(p)),
            };
            ApiError::invalid(field, wanted)
        }
        None => ApiError::bad_request(plain(text)),
    }
}

/// Which page of a list.
#[derive(Debug, Clone, Default, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PageParams {
    /// Rows at most, 1 to 1000; 100 if not given.
    #[param(minimum = 1, maximum = 1000)]
    pub limit: Option<u32>,
    /// `next_cursor` of the page before.
    pub cursor: Option<String>,
}

/// Makes a page request of the two parameters that every list has.
pub(super) fn page(limit: Option<u32>, cursor: Option<&str>) -> Result<PageRequest, ApiError> {
    let limit = limit.unwrap_or(100);
    if !(1..=1000).contains(&limit) {
        return Err(ApiError::invalid("limit", "must be 1 to 1000"));
    }
    let cursor = cursor
        .map(str::parse::<i64>)
        .transpose()
        .map_err(|_| ApiError::invalid("cursor", "is not the next_cursor of a page"))?;
    Ok(PageRequest { limit, cursor })
}

/// A query's time as the store writes times.
pub(super) fn since(text: Option<String>) -> Result<Option<String>, ApiError> {
    text.map(|text| match utc_of(&text) {
        Some(time) => Ok(utc_text(time)),
        None => Err(ApiError::invalid(
            "since",
            "must be a time like 2026-03-02T09:00:00Z",
        )),
    })
    .transpose()
}

/// Refuses a query's number that is none.
pub(super) fn finite(field: &str, value: Option<f64>) -> Result<Option<f64>, ApiError> {
    match value {
        Some(value) if !value.is_finite() => {
            Err(ApiError::invalid(field, "must be a finite number"))
        }
        other => Ok(other),
    }
}

/// Whether a request says that its body is JSON.
pub(super) fn says_json(headers: &axum::http::HeaderMap) -> bool {
    headers
        .get(header::CONTENT_TYPE)
        .and_then(|value| value.to_str().ok())
        .and_then(|value| value.split(';').next())
        .is_some_and(|kind| kind.trim().eq_ignore_ascii_case("application/json"))
}

#[cfg(test)]
mod tests {
    use super::within;
    use serde_json::json;

    #[test]
    fn a_field_beside_the_kind_of_its_object_is_found() {
        let body = json!({"material": {"kind": "dielectric", "eta": "a", "eta_std": 0.1}});
        let message = "invalid type: string \"a\", expected f64";
        assert_eq!(
            within("material", message, &body).as_deref(),
            Some("material.eta")
        );
        // Which of two is at fault nobody can tell.
        let both = json!({"material": {"eta": "a", "k": "a"}});
        assert_eq!(within("material", message, &both), None);
        assert_eq!(within("material.eta", message, &body), None);
        assert_eq!(within(".", message, &body), None);
    }
}
