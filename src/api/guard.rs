//! Who may come in: only this machine, and no page but our own; how much, and twice the same once.
//!
//! There is no access control yet, so the daemon listens on loopback only. That keeps other
//! machines out, but not the browser of the person at this one: a page from elsewhere may send it
//! requests (cross-site POST), or name itself 127.0.0.1 (DNS rebinding). Hence every request must
//! name a loopback host, and one that carries an `Origin` must come from the very host it goes to.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use axum::body::{Body, to_bytes};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, Method, StatusCode, Version, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures::StreamExt;
use tokio::sync::{Mutex, OwnedMutexGuard};
use tokio::time::timeout;

use super::App;
use super::error::ApiError;
use super::extract::{BODY_BYTES_MAX, says_json, too_large};
use crate::lab::LabError;
use crate::store::frames::sha256_hex;
use crate::store::idempotency::KeptAnswer;

/// A refused body is read up to here, so that a client which is still sending gets to see why.
const DRAINED_BYTES_MAX: usize = 1 << 30;
/// How long a client may take to send the next piece of a body.
pub(super) const CHUNK_WAIT: Duration = Duration::from_secs(30);
/// Longest Idempotency-Key.
pub(super) const KEY_LENGTH_MAX: usize = 200;

/// Refuses hosts that are not this machine and origins that are not this page.
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
        return Err(ApiError::new(
            StatusCode::FORBIDDEN,
            "forbidden-origin",
            "another page may not command the rig",
            format!("a page from {origin} asks; only the daemon's own page may"),
        ));
    }
    Ok(())
}

fn forbidden_host(why: &str) -> ApiError {
    ApiError::new(
        StatusCode::FORBIDDEN,
        "forbidden-host",
        "the request is for another host",
        format!(
            "{why}; use http://127.0.0.1, http://localhost or http://[::1] with the daemon's port"
        ),
    )
}

/// Whether `host` (with or without port) can only mean this machine.
fn is_loopback(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(v6) => v6.split(']').next().unwrap_or_default(),
        None => host.rsplit_once(':').map_or(host, |(name, _)| name),
    };
    name.eq_ignore_ascii_case("localhost")
        || name.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

/// Whether it is the stop, which nothing may refuse, delay or answer in its place: it goes past keys and bodies.
pub(super) fn is_stop(request: &Request) -> bool {
    request.method() == Method::POST && request.uri().path() == super::rig::STOP
}

/// Refuses bodies that are too large or no JSON, before anybody reads them.
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
    if has_body && !says_json(request.headers()) {
        let problem = ApiError::new(
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            "wrong-content-type",
            "`Content-Type` must be `application/json`",
            "send the body with `Content-Type: application/json`",
        );
        return refuse(request, problem).await;
    }
    let (parts, body) = request.into_parts();
    // Read here, so that a chunked body that grows too large is refused in the same way.
    match whole(body, CHUNK_WAIT).await {
        Ok(bytes) => {
            next.run(Request::from_parts(parts, Body::from(bytes)))
                .await
        }
        Err(problem) => problem.into_response(),
    }
}

/// All of a body, of which a piece comes at least every `wait`.
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
            Ok(Some(Err(_))) => return Err(ApiError::bad_request("the body broke off")),
            Err(_) => return Err(too_slow()),
        }
    }
}

fn too_slow() -> ApiError {
    ApiError::new(
        StatusCode::REQUEST_TIMEOUT,
        "body-too-slow",
        "the body did not come",
        format!(
            "nothing more of the body came for {} s; nothing was done",
            CHUNK_WAIT.as_secs()
        ),
    )
}

async fn refuse(request: Request, problem: ApiError) -> Response {
    // A client that asks before it sends gets its answer at once.
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

/// A POST that carries an Idempotency-Key acts once; sent again it gets the first answer.
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
    // A client that goes away drops what it waits for, at any `.await`: on a task of its own the action is done and
    // its answer is kept all the same.
    let acting = tokio::spawn(async move { keyed(&app, &key, request, next).await });
    match acting.await {
        Ok(Ok(response)) => response,
        Ok(Err(problem)) => problem.into_response(),
        // The layer for handlers that panic answers it.
        Err(broken) if broken.is_panic() => std::panic::resume_unwind(broken.into_panic()),
        Err(_) => ApiError::from(LabError::Stopping).into_response(),
    }
}

/// Whose turn it is, key by key. What carries other keys does not wait for an import that takes minutes.
#[derive(Clone, Default)]
pub(super) struct Turns(Arc<std::sync::Mutex<HashMap<String, Arc<Mutex<()>>>>>);

impl Turns {
    /// Completes when nobody else is at work under `key`, and holds the turn as long as it is kept.
    async fn of(&self, key: &str) -> OwnedMutexGuard<()> {
        let turn = {
            let mut all = self.0.lock().expect("no holder of this lock panics");
            // Keys that nobody is at work under or waits for are forgotten.
            all.retain(|_, turn| Arc::strong_count(turn) > 1);
            Arc::clone(all.entry(key.to_owned()).or_default())
        };
        turn.lock_owned().await
    }
}

async fn keyed(app: &App, key: &str, request: Request, next: Next) -> Result<Response, ApiError> {
    let (parts, body) = request.into_parts();
    let body = to_bytes(body, BODY_BYTES_MAX)
        .await
        .map_err(|_| too_large())?;
    let mut told = format!("{} {}\n", parts.method, parts.uri).into_bytes();
    told.extend_from_slice(&body);
    let told = sha256_hex(&told);
    // The second of two at once must find the first one's answer.
    let _turn = app.turns.of(key).await;
    let store = app.lab.store();
    if let Some(kept) = store.kept_answer(key, &told).await? {
        let status = StatusCode::from_u16(kept.status).unwrap_or(StatusCode::OK);
        let mut response = (
            status,
            [(header::CONTENT_TYPE, "application/json")],
            kept.body,
        )
            .into_response();
        if let Some(location) = kept.location.and_then(|l| l.parse().ok()) {
            response.headers_mut().insert(header::LOCATION, location);
        }
        return Ok(response);
    }
    let response = next.run(Request::from_parts(parts, Body::from(body))).await;
    if !response.status().is_success() {
        // Nothing was done: the same key may try again.
        return Ok(response);
    }
    let (parts, body) = response.into_parts();
    let body = to_bytes(body, usize::MAX)
        .await
        .map_err(|_| ApiError::bad_request("the answer broke off"))?;
    let answer = KeptAnswer {
        status: parts.status.as_u16(),
        location: parts
            .headers
            .get(header::LOCATION)
            .and_then(|l| l.to_str().ok())
            .map(str::to_owned),
        body: String::from_utf8_lossy(&body).into_owned(),
    };
    app.lab.keep_answer(key, &told, &answer).await?;
    Ok(Response::from_parts(parts, Body::from(body)))
}

/// A method as it is counted: whatever a client invents is one.
fn counted(method: &Method) -> &'static str {
    match *method {
        Method::GET => "GET",
        Method::HEAD => "HEAD",
        Method::POST => "POST",
        Method::OPTIONS => "OPTIONS",
        _ => "other",
    }
}

/// Counts and times requests, and logs each at debug.
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
    async fn a_key_waits_for_its_own_turn_only_and_is_forgotten_after() {
        let turns = Turns::default();
        let first = turns.of("import").await;
        let mut again = Box::pin(turns.of("import"));
        assert!((&mut again).now_or_never().is_none());
        let other = turns.of("scan").now_or_never();
        assert!(other.is_some());
        drop((first, other));
        again.await;
        turns.of("last").await;
        let left = turns.0.lock().unwrap().len();
        assert_eq!(left, 1);
    }

    #[tokio::test]
    async fn a_body_that_does_not_come_is_not_waited_for() {
        let some = futures::stream::iter([Ok::<_, std::io::Error>("{")]);
        let body = Body::from_stream(some.chain(futures::stream::pending()));
        let problem = whole(body, Duration::from_millis(1)).await.unwrap_err();
        let status = problem.into_response().status();
        assert_eq!(status, StatusCode::REQUEST_TIMEOUT);
        let body = Body::from("{}");
        assert_eq!(whole(body, CHUNK_WAIT).await.unwrap(), b"{}");
    }

    #[test]
    fn a_request_without_a_host_is_refused() {
        assert!(check_origin(&HeaderMap::new(), None, Version::HTTP_10).is_err());
    }
}
