//! Checks every request before its handler: origin, host, size and form of the body, Idempotency-Key.
//!
//! There is no access control yet, so the daemon listens on loopback only. That excludes other
//! machines, but not other pages in a browser on this one: they may send requests (cross-site POST)
//! or resolve their own name to 127.0.0.1 (DNS rebinding). Therefore every request must name a
//! loopback host, and a request with an `Origin` must come from the host that it is sent to.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::body::{Body, to_bytes};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, Method, Version, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures::StreamExt;
use tokio::sync::{Mutex, OwnedMutexGuard};
use tokio::time::timeout;

use super::App;
use super::extract::{BODY_BYTES_MAX, announces_json};
use super::status::{self, ApiError};
use crate::lab::LabError;
use crate::store::frames::sha256_hex;

/// Most bytes of a refused body that are read, so that a client that is still sending receives the refusal.
const DRAINED_BYTES_MAX: usize = 1 << 30;
/// How long a client may take to send the next part of a body.
pub(super) const CHUNK_WAIT: Duration = Duration::from_secs(30);
/// Longest Idempotency-Key.
pub(super) const KEY_LENGTH_MAX: usize = 200;

/// Refuses requests for other hosts and from other pages.
pub(super) async fn same_machine_same_page(request: Request, next: Next) -> Response {
    match check_origin(request.headers(), request.uri().host(), request.version()) {
        Ok(()) => next.run(request).await,
        Err(problem) => problem.into_response(),
    }
}

fn check_origin(
    headers: &HeaderMap,
    uri_host: Option<&str>,
    version: Version,
) -> Result<(), ApiError> {
    let text = |name| headers.get(name).map(|v| v.to_str().unwrap_or("?"));
    let host = match (text(header::HOST), uri_host) {
        (Some(host), _) => host,
        (None, Some(host)) if version >= Version::HTTP_2 => host,
        _ => return Err(forbidden_host("the request names no host")),
    };
    if !is_loopback(host) {
        return Err(forbidden_host(&format!("`{host}` is not this machine")));
    }
    if let Some(origin) = text(header::ORIGIN)
        && origin != format!("http://{host}")
    {
        return Err(ApiError::forbidden_origin(format!(
            "the request comes from a page of {origin}; only the daemon's own page may send requests"
        )));
    }
    Ok(())
}

fn forbidden_host(why: &str) -> ApiError {
    ApiError::forbidden_host(format!(
        "{why}; use http://127.0.0.1, http://localhost or http://[::1] with the daemon's port"
    ))
}

/// Returns whether `host` (with or without port) can only be this machine.
fn is_loopback(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(v6) => v6.split(']').next().unwrap_or_default(),
        None => host.rsplit_once(':').map_or(host, |(name, _)| name),
    };
    name.eq_ignore_ascii_case("localhost")
        || name.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

/// Returns whether the request is the stop. Nothing may refuse or delay the stop, so its key and body are ignored.
pub(super) fn is_stop(request: &Request) -> bool {
    request.method() == Method::POST && request.uri().path() == super::rig::STOP
}

/// Refuses bodies that are too large or not announced as JSON.
pub(super) async fn check_body(request: Request, next: Next) -> Response {
    if is_stop(&request) {
        return next.run(request).await;
    }
    if !matches!(
        *request.method(),
        Method::POST | Method::PUT | Method::PATCH | Method::DELETE
    ) {
        return next.run(request).await;
    }
    let length = |headers: &HeaderMap| -> Option<usize> {
        headers
            .get(header::CONTENT_LENGTH)?
            .to_str()
            .ok()?
            .parse()
            .ok()
    };
    let announced = length(request.headers());
    let chunked = request.headers().contains_key(header::TRANSFER_ENCODING);
    if announced.is_some_and(|bytes| bytes > BODY_BYTES_MAX) {
        return refuse(request, too_large()).await;
    }
    let has_body = chunked || announced.is_some_and(|bytes| bytes > 0);
    if has_body && !announces_json(request.headers()) {
        return refuse(request, ApiError::wrong_content_type()).await;
    }
    let (parts, body) = request.into_parts();
    // Read here, so that a chunked body that becomes too large is refused in the same way.
    match whole(body, CHUNK_WAIT).await {
        Ok(bytes) => {
            next.run(Request::from_parts(parts, Body::from(bytes)))
                .await
        }
        Err(problem) => problem.into_response(),
    }
}

/// Reads a whole body. Each part must arrive within `wait`.
async fn whole(body: Body, wait: Duration) -> Result<Vec<u8>, ApiError> {
    let mut bytes = Vec::new();
    let mut stream = body.into_data_stream();
    loop {
        match timeout(wait, stream.next()).await {
            Ok(None) => return Ok(bytes),
            Ok(Some(Ok(chunk))) if bytes.len() + chunk.len() <= BODY_BYTES_MAX => {
                bytes.extend_from_slice(&chunk);
            }
            Ok(Some(Ok(_))) => {
                drain(stream).await;
                return Err(too_large());
            }
            Ok(Some(Err(_))) => {
                return Err(ApiError::bad_request(
                    "the connection broke before the body was complete",
                ));
            }
            Err(_) => return Err(ApiError::too_slow(wait)),
        }
    }
}

fn too_large() -> ApiError {
    ApiError::too_large(BODY_BYTES_MAX)
}

async fn refuse(request: Request, problem: ApiError) -> Response {
    // A client that waits for a 100-continue gets its answer at once.
    if !request.headers().contains_key(header::EXPECT) {
        drain(request.into_body().into_data_stream()).await;
    }
    problem.into_response()
}

async fn drain(mut stream: axum::body::BodyDataStream) {
    let mut drained = 0;
    while let Ok(Some(Ok(chunk))) = timeout(CHUNK_WAIT, stream.next()).await {
        drained += chunk.len();
        if drained > DRAINED_BYTES_MAX {
            return;
        }
    }
}

/// Executes a POST with an Idempotency-Key once. Sent again, it gets the first answer.
pub(super) async fn once_per_key(State(app): State<App>, request: Request, next: Next) -> Response {
    if is_stop(&request) {
        return next.run(request).await;
    }
    let key = request.headers().get("idempotency-key").cloned();
    let Some(key) = key.filter(|_| request.method() == Method::POST) else {
        return next.run(request).await;
    };
    let key = match key.to_str() {
        Ok(key) if !key.is_empty() && key.len() <= KEY_LENGTH_MAX => key.to_owned(),
        _ => {
            let message = format!("must have 1 to {KEY_LENGTH_MAX} visible characters");
            return ApiError::invalid("Idempotency-Key", message).into_response();
        }
    };
    // When a client leaves, its request is dropped at any `.await`. On a task of its own the action is completed and
    // its answer is kept.
    let acting = tokio::spawn(async move { keyed(&app, &key, request, next).await });
    match acting.await {
        Ok(Ok(response)) => response,
        Ok(Err(problem)) => problem.into_response(),
        // The layer that catches panics answers.
        Err(broken) if broken.is_panic() => std::panic::resume_unwind(broken.into_panic()),
        Err(_) => ApiError::from(LabError::Stopping).into_response(),
    }
}

/// One lock per key, so that requests with other keys do not wait for an import that takes minutes.
#[derive(Clone, Default)]
pub(super) struct KeyLocks(Arc<std::sync::Mutex<HashMap<String, Arc<Mutex<()>>>>>);

impl KeyLocks {
    /// Waits for the lock of `key`.
    async fn of(&self, key: &str) -> OwnedMutexGuard<()> {
        let lock = {
            let mut all = self.0.lock().expect("no holder of this lock panics");
            // Unused locks are removed.
            all.retain(|_, lock| Arc::strong_count(lock) > 1);
            Arc::clone(all.entry(key.to_owned()).or_default())
        };
        lock.lock_owned().await
    }
}

async fn keyed(app: &App, key: &str, request: Request, next: Next) -> Result<Response, ApiError> {
    let (parts, body) = request.into_parts();
    let body = to_bytes(body, BODY_BYTES_MAX)
        .await
        .map_err(|_| too_large())?;
    let mut fingerprint = format!("{} {}\n", parts.method, parts.uri).into_bytes();
    fingerprint.extend_from_slice(&body);
    let fingerprint = sha256_hex(&fingerprint);
    // The second of two simultaneous requests must find the first one's answer.
    let _lock = app.key_locks.of(key).await;
    let store = app.lab.store();
    if let Some(kept) = store.kept_answer(key, &fingerprint).await? {
        return Ok(status::repeated(kept));
    }
    let response = next.run(Request::from_parts(parts, Body::from(body))).await;
    if !response.status().is_success() {
        // Nothing was done, so the key can be used again.
        return Ok(response);
    }
    let (parts, body) = response.into_parts();
    let body = to_bytes(body, usize::MAX)
        .await
        .map_err(|_| ApiError::internal())?;
    let answer = status::to_keep(parts.status, &parts.headers, &body);
    app.lab.keep_answer(key, &fingerprint, &answer).await?;
    Ok(Response::from_parts(parts, Body::from(body)))
}

/// Returns the label of a method in the metrics. Unknown methods share one label.
fn counted(method: &Method) -> &'static str {
    match *method {
        Method::GET => "GET",
        Method::HEAD => "HEAD",
        Method::POST => "POST",
        Method::OPTIONS => "OPTIONS",
        _ => "other",
    }
}

/// Counts, times and logs requests, and sets the security headers.
pub(super) async fn measure(request: Request, next: Next) -> Response {
    let started = Instant::now();
    let method = request.method().clone();
    let path = request.uri().path().to_owned();
    let mut response = next.run(request).await;
    let status = response.status().as_u16();
    let took_s = started.elapsed().as_secs_f64();
    metrics::counter!("ridged_http_requests_total", "method" => counted(&method), "status" => status.to_string())
        .increment(1);
    metrics::histogram!("ridged_http_request_seconds").record(took_s);
    tracing::debug!(%method, path, status, took_s, "{method} {path}: {status} in {took_s:.4} s");
    let headers = response.headers_mut();
    for (name, value) in [
        ("x-content-type-options", "nosniff"),
        ("x-frame-options", "DENY"),
        ("referrer-policy", "no-referrer"),
        (
            "content-security-policy",
            "default-src 'self'; img-src 'self' data: blob:; style-src 'self' 'unsafe-inline'; frame-ancestors 'none'",
        ),
    ] {
        headers
            .entry(name)
            .or_insert(axum::http::HeaderValue::from_static(value));
    }
    headers
        .entry(header::CACHE_CONTROL)
        .or_insert(axum::http::HeaderValue::from_static("no-store"));
    response
}

#[cfg(test)]
mod tests {
    use super::*;
    use futures::FutureExt;

    fn headers(host: &str, origin: Option<&str>) -> HeaderMap {
        let mut headers = HeaderMap::new();
        headers.insert(header::HOST, host.parse().unwrap());
        if let Some(origin) = origin {
            headers.insert(header::ORIGIN, origin.parse().unwrap());
        }
        headers
    }

    fn passes(host: &str, origin: Option<&str>) -> bool {
        check_origin(&headers(host, origin), None, Version::HTTP_11).is_ok()
    }

    #[test]
    fn only_loopback_hosts_pass() {
        for host in [
            "127.0.0.1:8787",
            "localhost:1",
            "LOCALHOST",
            "[::1]:8787",
            "127.9.9.9",
        ] {
            assert!(passes(host, None), "{host}");
        }
        for host in [
            "lab.example",
            "127.0.0.1.nip.io:8787",
            "192.168.0.4:8787",
            "localhost.evil.example",
            "[fe80::1]:8787",
            "",
        ] {
            assert!(!passes(host, None), "{host}");
        }
    }

    #[test]
    fn only_the_own_page_is_an_origin() {
        assert!(passes("127.0.0.1:8787", Some("http://127.0.0.1:8787")));
        for origin in [
            "http://127.0.0.1:5173",
            "http://localhost:8787",
            "https://evil.example",
            "null",
        ] {
            assert!(!passes("127.0.0.1:8787", Some(origin)), "{origin}");
        }
    }

    #[tokio::test]
    async fn a_key_waits_for_its_own_lock_only_and_is_removed_after() {
        let locks = KeyLocks::default();
        let first = locks.of("import").await;
        let mut again = Box::pin(locks.of("import"));
        assert!((&mut again).now_or_never().is_none());
        let other = locks.of("scan").now_or_never();
        assert!(other.is_some());
        drop((first, other));
        again.await;
        locks.of("last").await;
        let left = locks.0.lock().unwrap().len();
        assert_eq!(left, 1);
    }

    #[tokio::test]
    async fn a_body_that_does_not_arrive_times_out() {
        let some = futures::stream::iter([Ok::<_, std::io::Error>("{")]);
        let body = Body::from_stream(some.chain(futures::stream::pending()));
        let problem = whole(body, Duration::from_millis(1)).await.unwrap_err();
        assert_eq!(problem.into_response().status(), 408);
        let body = Body::from("{}");
        assert_eq!(whole(body, CHUNK_WAIT).await.unwrap(), b"{}");
    }

    #[test]
    fn a_request_without_a_host_is_refused() {
        assert!(check_origin(&HeaderMap::new(), None, Version::HTTP_10).is_err());
    }
}
