//! The page, embedded in the program; without it, a word on how to build it.

use axum::http::{HeaderMap, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};

use super::error::ApiError;

#[derive(rust_embed::RustEmbed)]
#[folder = "web/dist"]
#[allow_missing = true]
struct Dist;

/// Whatever no route answers: a file of the page, the page itself, or a problem.
pub(super) async fn page(uri: Uri, headers: HeaderMap) -> Response {
    let path = uri.path().trim_start_matches('/');
    if path.starts_with("api/") {
        return ApiError::not_found(format!(
            "there is no route {}; /openapi.json lists them",
            uri.path()
        ))
        .into_response();
    }
    let path = if path.is_empty() { "index.html" } else { path };
    if let Some(file) = Dist::get(path) {
        return answer(path, &file, &headers);
    }
    let asks_for_a_page = !path.contains('.') || path == "index.html";
    match Dist::get("index.html") {
        Some(file) if asks_for_a_page => answer("index.html", &file, &headers),
        None if asks_for_a_page => (
            StatusCode::SERVICE_UNAVAILABLE,
            "This ridged was built without its page: run `make web`, then build it again.\n\
             The HTTP interface works all the same; /openapi.json describes it.\n",
        )
            .into_response(),
        _ => ApiError::not_found(format!("there is no file {}", uri.path())).into_response(),
    }
}

fn answer(path: &str, file: &rust_embed::EmbeddedFile, headers: &HeaderMap) -> Response {
    let etag = format!(
        "\"{}\"",
        file.metadata
            .sha256_hash()
            .iter()
            .take(16)
            .map(|b| format!("{b:02x}"))
            .collect::<String>()
    );
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
