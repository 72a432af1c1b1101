//! The page, embedded in the program.

use axum::http::{HeaderMap, Method, Uri, header};
use axum::response::{IntoResponse, Response};

use super::caching::Caching;
use super::status::{self, ApiError};
use crate::wording::hex;

#[derive(rust_embed::RustEmbed)]
#[folder = "web/dist"]
#[allow_missing = true]
struct Dist;

/// Answers requests without a route: a file of the page, the page itself at `/`, or a problem.
pub(super) async fn page(method: Method, uri: Uri, headers: HeaderMap) -> Response {
    let path = match uri.path() {
        "/" => "index.html",
        other => other.trim_start_matches('/'),
    };
    if !matches!(method, Method::GET | Method::HEAD) {
        if path == "index.html" || Dist::get(path).is_some() {
            return only_read();
        }
    } else {
        if let Some(file) = Dist::get(path) {
            return answer(path, &file, &headers);
        }
        if path == "index.html" {
            return status::unavailable(
                "This ridged was built without its page. Run `make web`, then build it again.\n\
                 The HTTP interface works without it; /openapi.json describes it.\n",
            );
        }
    }
    // A script that omits the prefix must not receive the page.
    let below_api = path == "api" || path.starts_with("api/");
    let hint = if below_api {
        "/openapi.json lists them"
    } else {
        "those for scripts begin with /api/v1, and /openapi.json lists them"
    };
    ApiError::not_found(format!("there is no route {}; {hint}", uri.path())).into_response()
}

fn only_read() -> Response {
    let problem = ApiError::method_not_allowed(
        "the page can only be read; the routes for scripts begin with /api/v1, and /openapi.json lists them",
    );
    ([(header::ALLOW, "GET, HEAD")], problem).into_response()
}

fn answer(path: &str, file: &rust_embed::EmbeddedFile, headers: &HeaderMap) -> Response {
    // Files below assets/ have a hash in their name and never change.
    let cache = if path.starts_with("assets/") {
        "public, max-age=31536000, immutable"
    } else {
        "no-cache"
    };
    let tag = hex(&file.metadata.sha256_hash()[..16]);
    let caching = Caching::new(headers, &tag, cache);
    if let Some(answer) = caching.not_modified(file.data.len() as u64) {
        return answer;
    }
    let kind = [(header::CONTENT_TYPE, file.metadata.mimetype().to_owned())];
    (caching.headers(), kind, file.data.clone()).into_response()
}
