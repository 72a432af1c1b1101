//! The page, embedded in the program; without it, a word on how to build it.

use axum::http::{HeaderMap, Method, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};

use super::error::ApiError;
use crate::wording::hex;

#[derive(rust_embed::RustEmbed)]
#[folder = "web/dist"]
#[allow_missing = true]
struct Dist;

/// Whatever no route answers: a file of the page, the page itself at `/`, or a problem.
pub(super) async fn page(method: Method, uri: Uri, headers: HeaderMap) -> Response {
    let path = match uri.path() {
        "/" => "index.html",
        other => other.trim_start_matches('/'),
    };
    if matches!(method, Method::GET | Method::HEAD) {
        if let Some(file) = Dist::get(path) {
            return answer(path, &file, &headers);
        }
        if path == "index.html" {
            return (
                StatusCode::SERVICE_UNAVAILABLE,
                "This ridged was built without its page: run `make web`, then build it again.\n\
                 The HTTP interface works all the same; /openapi.json describes it.\n",
            )
                .into_response();
        }
    }
    // A script that forgot the prefix must not take the page for an answer.
    let below_api = path == "api" || path.starts_with("api/");
    let hint = if below_api {
        "/openapi.json lists them"
    } else {
        "those for scripts begin with /api/v1, and /openapi.json lists them"
    };
    ApiError::not_found(format!("there is no route {}; {hint}", uri.path())).into_response()
}

fn answer(path: &str, file: &rust_embed::EmbeddedFile, headers: &HeaderMap) -> Response {
    let etag = format!("\"{}\"", hex(&file.metadata.sha256_hash()[..16]));
    let known = headers
        .get(header::IF_NONE_MATCH)
        .and_then(|v| v.to_str().ok());
    if known == Some(etag.as_str()) {
        return StatusCode::NOT_MODIFIED.into_response();
    }
    // Files below assets/ carry a hash in their name and never change.
    let cache = if path.starts_with("assets/") {
        "public, max-age=31536000, immutable"
    } else {
        "no-cache"
    };
    let headers = [
        (header::CONTENT_TYPE, file.metadata.mimetype().to_owned()),
        (header::ETAG, etag),
        (header::CACHE_CONTROL, cache.to_owned()),
    ];
    (headers, file.data.clone()).into_response()
}
