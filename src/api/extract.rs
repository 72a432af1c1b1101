//! Reads what a request carries (body, path, query) and refuses it with a problem that names the wrong value.

use axum::extract::{FromRequest, FromRequestParts, Path, Query, Request};
use axum::http::header;
use axum::http::request::Parts;
use serde::Deserialize;
use serde::de::DeserializeOwned;

use super::status::ApiError;
use crate::store::{PageRequest, utc_of, utc_text};
use crate::wording::json::{self, Fault};

/// Largest body, bytes.
pub const BODY_BYTES_MAX: usize = 8 << 20;

/// The route whose body is not JSON, but an archive that goes to a file.
pub(super) const UPLOAD: &str = "/api/v1/imports/upload";

/// A JSON body.
pub struct Body<T>(pub T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequest<S> for Body<T> {
    type Rejection = ApiError;

    async fn from_request(request: Request, _: &S) -> Result<Self, ApiError> {
        let bytes = axum::body::to_bytes(request.into_body(), BODY_BYTES_MAX)
            .await
            .map_err(|_| ApiError::too_large(BODY_BYTES_MAX))?;
        Ok(Body(json::from_slice(&bytes)?))
    }
}

/// The number in a path.
pub struct Id(pub i64);

/// The number in a path, and the name of a file after it.
pub struct IdAndName(pub i64, pub String);

impl<S: Send + Sync> FromRequestParts<S> for Id {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let Path(id) = in_path(parts, state).await?;
        Ok(Id(id_of(id)?))
    }
}

impl<S: Send + Sync> FromRequestParts<S> for IdAndName {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let Path((id, name)) = in_path(parts, state).await?;
        Ok(IdAndName(id_of(id)?, name))
    }
}

async fn in_path<T: DeserializeOwned + Send, S: Send + Sync>(
    parts: &mut Parts,
    state: &S,
) -> Result<Path<T>, ApiError> {
    let path = Path::<T>::from_request_parts(parts, state).await;
    path.map_err(|refusal| ApiError::bad_request(refusal.body_text()))
}

/// Reads an id of a path. A refusal does not quote it, since it may be of any length.
pub(super) fn id_of(text: String) -> Result<i64, ApiError> {
    let message = "the id in the path is not a whole number of at most 19 digits";
    text.parse().map_err(|_| ApiError::bad_request(message))
}

/// The parameters after the question mark.
pub struct Params<T>(pub T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for Params<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let query = Query::<Vec<(String, String)>>::from_request_parts(parts, state).await;
        let Query(all) = query.map_err(|refusal| ApiError::bad_request(refusal.body_text()))?;
        parameters(&all).map(Params)
    }
}

/// Reads parameters by name and text.
pub(super) fn parameters<T: DeserializeOwned>(all: &[(String, String)]) -> Result<T, ApiError> {
    parameters_beside("", all)
}

/// The same beside parameters that were read before; `known` says so where a name is not known.
fn parameters_beside<T: DeserializeOwned>(
    known: &str,
    all: &[(String, String)],
) -> Result<T, ApiError> {
    json::from_query(all).map_err(|refusal| match refusal.fault() {
        Fault::UnknownField { .. } => {
            ApiError::bad_request(format!("{}{known}", refusal.message("parameter")))
        }
        _ => ApiError::invalid(refusal.path(), refusal.message("parameter")),
    })
}

/// Numbers of scans (`scan_id`, repeated) and the other parameters after the question mark.
pub struct ScansAnd<T>(pub Vec<i64>, pub T);

impl<S: Send + Sync, T: DeserializeOwned> FromRequestParts<S> for ScansAnd<T> {
    type Rejection = ApiError;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, ApiError> {
        let query = Query::<Vec<(String, String)>>::from_request_parts(parts, state).await;
        let Query(all) = query.map_err(|refusal| ApiError::bad_request(refusal.body_text()))?;
        let (scans, others): (Vec<_>, Vec<_>) =
            all.into_iter().partition(|(name, _)| name == "scan_id");
        let ids = scans.iter().map(|(_, text)| text.parse::<i64>());
        let ids = ids.collect::<Result<Vec<_>, _>>();
        let ids = ids.map_err(|_| {
            ApiError::invalid("scan_id", "expected whole numbers: scan_id=1&scan_id=2")
        })?;
        let others = parameters_beside("; `scan_id` names the scans", &others)?;
        Ok(ScansAnd(ids, others))
    }
}

/// Which page of a list.
#[derive(Debug, Clone, Default, Deserialize, utoipa::IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
pub struct PageParams {
    /// Largest number of rows, 1 to 1000; 100 if omitted.
    #[param(minimum = 1, maximum = 1000)]
    pub limit: Option<u32>,
    /// `next_cursor` of the previous page.
    pub cursor: Option<String>,
}

/// Returns the page that the two parameters of every list ask for.
pub(super) fn page(limit: Option<u32>, cursor: Option<&str>) -> Result<PageRequest, ApiError> {
    let limit = limit.unwrap_or(100);
    if !(1..=1000).contains(&limit) {
        return Err(ApiError::invalid("limit", "must be 1 to 1000"));
    }
    // Rows, and places in the queue, are numbered from 1.
    let cursor = cursor
        .map(|text| text.parse().ok().filter(|cursor| *cursor >= 1))
        .map(|cursor| {
            cursor.ok_or(ApiError::invalid(
                "cursor",
                "is not the next_cursor of a page",
            ))
        })
        .transpose()?;
    Ok(PageRequest { limit, cursor })
}

/// Returns a query's time as the store writes times.
pub(super) fn since(text: Option<String>) -> Result<Option<String>, ApiError> {
    text.map(|text| match utc_of(&text) {
        Some(time) => Ok(utc_text(time)),
        None => Err(ApiError::invalid(
            "since",
            "expected a time like 2026-03-02T09:00:00Z",
        )),
    })
    .transpose()
}

/// Returns whether a request announces its body as JSON.
pub(super) fn announces_json(headers: &axum::http::HeaderMap) -> bool {
    headers
        .get(header::CONTENT_TYPE)
        .and_then(|value| value.to_str().ok())
        .and_then(|value| value.split(';').next())
        .is_some_and(|kind| kind.trim().eq_ignore_ascii_case("application/json"))
}
