//! Checks every request before its handler: size and form of the body; counts, times and logs requests.

use std::time::{Duration, Instant};

use axum::body::{Body, BodyDataStream, Bytes};
use axum::extract::{Request, State};
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use futures::StreamExt;
use tokio::time::timeout;

use super::App;
use super::caller::Principal;
use super::extract::{BODY_BYTES_MAX, UPLOAD, announces_json};
use super::peers::BodyRoom;
use super::status::ApiError;
use super::via::Client;

/// Largest part of a refused body that is read, bytes, so that a client that is still sending receives the refusal.
const DRAINED_BYTES_MAX: usize = 1 << 30;
/// How long a client may take to send the next part of a body.
pub(super) const CHUNK_WAIT: Duration = Duration::from_secs(30);
/// Time that a whole body has in addition to its bytes at the least rate, in waits for one part.
const GRACE_WAITS: u32 = 2;
/// Least rate of a body, bytes per second: a body of 8 MB may take half an hour.
const RATE_MIN: u32 = 4096;
/// Largest body without a valid token, bytes: a login fits into it.
const OPEN_BODY_BYTES_MAX: usize = 4096;
/// How long the body of a login may take.
const OPEN_CHUNK_WAIT: Duration = Duration::from_secs(5);

/// Returns whether the request is the stop. Nothing may refuse or delay the stop, so its key and body are ignored.
pub(super) fn is_stop(request: &Request) -> bool {
    request.method() == Method::POST && request.uri().path() == super::rig::STOP
}

/// Content type of all bodies but uploads.
const JSON: &str = "application/json";

/// A body that came packed.
#[derive(Clone, Copy)]
struct Packed;

/// Marks a request whose body is packed: the layer that unpacks it removes the header.
pub(super) async fn mark_packed(mut request: Request, next: Next) -> Response {
    if request.headers().contains_key(header::CONTENT_ENCODING) {
        request.extensions_mut().insert(Packed);
    }
    next.run(request).await
}

/// Refuses bodies that are too large, too many at a time, or not announced as JSON.
pub(super) async fn check_body(State(app): State<App>, request: Request, next: Next) -> Response {
    if is_stop(&request) {
        return next.run(request).await;
    }
    if !matches!(
        *request.method(),
        Method::POST | Method::PUT | Method::PATCH | Method::DELETE
    ) {
        return next.run(request).await;
    }
    let is_packed = request.extensions().get::<Packed>().is_some();
    if request.headers().contains_key(header::CONTENT_ENCODING) {
        return ApiError::wrong_encoding().into_response();
    }
    let is_open = request.extensions().get::<Principal>().is_none();
    // An upload goes to a file, part by part.
    if !is_open && request.uri().path() == UPLOAD {
        return next.run(request).await;
    }
    let (bytes_max, wait) = match is_open {
        true => (OPEN_BODY_BYTES_MAX, OPEN_CHUNK_WAIT),
        false => (BODY_BYTES_MAX, CHUNK_WAIT),
    };
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
    let too_large = announced.is_some_and(|bytes| bytes > bytes_max);
    if too_large && is_open {
        return ApiError::too_large(bytes_max).into_response();
    }
    if too_large {
        return refuse(request, ApiError::too_large(bytes_max)).await;
    }
    let has_body = is_packed || chunked || announced.is_some_and(|bytes| bytes > 0);
    if has_body && !announces_json(request.headers()) {
        return match is_open {
            true => ApiError::wrong_content_type(JSON).into_response(),
            false => refuse(request, ApiError::wrong_content_type(JSON)).await,
        };
    }
    let Some(client) = request.extensions().get::<Client>() else {
        return ApiError::internal().into_response();
    };
    let mut room = app.peers.room_for_body(client.address);
    let (parts, body) = request.into_parts();
    // Read here, so that a chunked body that becomes too large is refused in the same way.
    match whole(body, &mut room, bytes_max, wait, is_packed).await {
        Ok(bytes) => {
            next.run(Request::from_parts(parts, Body::from(bytes)))
                .await
        }
        Err(problem) => problem.into_response(),
    }
}

/// Reads a whole body. It must arrive in time (see [`Arrival`]), and `room` must have space for it.
async fn whole(
    body: Body,
    room: &mut BodyRoom,
    bytes_max: usize,
    wait: Duration,
    is_packed: bool,
) -> Result<Vec<u8>, ApiError> {
    let mut bytes = Vec::new();
    let mut arrival = Arrival::new(body, wait);
    let unreadable = match is_packed {
        true => "the body is not valid gzip, or the connection broke before it was complete",
        false => BROKEN_OFF,
    };
    while let Some(chunk) = arrival.next_or(unreadable).await? {
        if bytes.len() + chunk.len() > bytes_max {
            drop(bytes);
            // Unpacking ends at the limit: a small packed body can become a very large one.
            if !is_packed {
                arrival.drain().await;
            }
            return Err(ApiError::too_large(bytes_max));
        }
        if !room.take(chunk.len()) {
            return Err(ApiError::too_many_bodies());
        }
        bytes.extend_from_slice(&chunk);
    }
    Ok(bytes)
}

/// Message about a body that ends early.
const BROKEN_OFF: &str = "the connection broke before the body was complete";

/// Reads a body part by part. Each part must arrive in time, and all of them at the least rate, so that a few bytes now and
/// then do not hold a request open without end.
pub(super) struct Arrival {
    stream: BodyDataStream,
    begun: tokio::time::Instant,
    wait: Duration,
    bytes: usize,
}

impl Arrival {
    /// Begins to read a body, each part of which must arrive within `wait`.
    pub(super) fn new(body: Body, wait: Duration) -> Self {
        Arrival {
            stream: body.into_data_stream(),
            begun: tokio::time::Instant::now(),
            wait,
            bytes: 0,
        }
    }

    /// Reads the next part; `None` at the end.
    pub(super) async fn next(&mut self) -> Result<Option<Bytes>, ApiError> {
        self.next_or(BROKEN_OFF).await
    }

    async fn next_or(&mut self, unreadable: &str) -> Result<Option<Bytes>, ApiError> {
        let earned = Duration::from_secs_f64(self.bytes as f64 / f64::from(RATE_MIN));
        let allowed = GRACE_WAITS * self.wait + earned;
        let left = allowed.saturating_sub(self.begun.elapsed());
        match timeout(left.min(self.wait), self.stream.next()).await {
            Ok(part) => {
                let part = part.transpose();
                let part = part.map_err(|_| ApiError::bad_request(unreadable))?;
                self.bytes += part.as_ref().map_or(0, Bytes::len);
                Ok(part)
            }
            Err(_) if left < self.wait => Err(ApiError::too_slow_in_all(RATE_MIN)),
            Err(_) => Err(ApiError::too_slow(self.wait)),
        }
    }

    /// Reads and drops the rest, so that a client that is still sending receives the refusal.
    async fn drain(mut self) {
        let drained = self.bytes;
        while let Ok(Some(_)) = self.next().await {
            if self.bytes - drained > DRAINED_BYTES_MAX {
                return;
            }
        }
    }
}

/// Answers with a problem after the body was read, so that a client that is still sending receives it.
pub(super) async fn refuse(request: Request, problem: ApiError) -> Response {
    // A client that waits for a 100-continue gets its answer at once.
    if !request.headers().contains_key(header::EXPECT) {
        Arrival::new(request.into_body(), CHUNK_WAIT).drain().await;
    }
    problem.into_response()
}

/// Paths of requests that need no disk: the rig, who holds it, and what stops the queue.
const WITHOUT_DISK: &[&str] = &[
    "/api/v1/rig",
    "/api/v1/lease",
    "/api/v1/session",
    "/api/v1/queue/stop",
];

/// Whether a request needs the disk of the data folder, and does not see to it itself.
fn needs_disk(method: &Method, path: &str) -> bool {
    // The orders to a scan are taken or refused by what they are for.
    let is_order = *method == Method::POST && path.starts_with("/api/v1/scans/");
    let is_free = |free: &&str| {
        path.strip_prefix(*free)
            .is_some_and(|rest| !rest.starts_with(|c: char| c != '/'))
    };
    path.starts_with("/api/") && !is_order && !WITHOUT_DISK.iter().any(is_free)
}

/// Refuses a request that needs the disk of the data folder where the disk does not answer: what only reads as soon as it
/// waits, everything else before it begins.
pub(super) async fn check_disk(State(app): State<App>, request: Request, next: Next) -> Response {
    let method = request.method();
    if !needs_disk(method, request.uri().path()) {
        return next.run(request).await;
    }
    let store = app.lab.store().clone();
    if matches!(*method, Method::GET | Method::HEAD) {
        return tokio::select! {
            biased;
            response = next.run(request) => response,
            silent = store.silence() => ApiError::from(silent).into_response(),
        };
    }
    match store.check_disk().await {
        Ok(()) => next.run(request).await,
        Err(silent) => ApiError::from(silent).into_response(),
    }
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
    use super::super::peers::Peers;
    use super::*;

    #[test]
    fn neither_the_rig_nor_an_order_needs_the_disk_and_everything_else_does() {
        for (method, path, needs) in [
            (Method::GET, "/api/v1/rig", false),
            (Method::POST, "/api/v1/rig/stop", false),
            (Method::POST, "/api/v1/scans/3/abort", false),
            (Method::POST, "/api/v1/queue/stop", false),
            (Method::DELETE, "/api/v1/lease", false),
            (Method::GET, "/healthz", false),
            (Method::GET, "/assets/index.js", false),
            (Method::GET, "/api/v1/rigs", true),
            (Method::GET, "/api/v1/scans/3", true),
            (Method::POST, "/api/v1/scans", true),
            (Method::POST, "/api/v1/queue/orders", true),
        ] {
            assert_eq!(needs_disk(&method, path), needs, "{method} {path}");
        }
    }

    #[tokio::test]
    async fn a_body_that_does_not_arrive_times_out() {
        let peers = Peers::new(1);
        let mut room = peers.room_for_body([10, 0, 0, 1].into());
        let some = futures::stream::iter([Ok::<_, std::io::Error>("{")]);
        let body = Body::from_stream(some.chain(futures::stream::pending()));
        let wait = Duration::from_millis(1);
        let problem = whole(body, &mut room, 100, wait, false).await.unwrap_err();
        assert_eq!(problem.into_response().status(), 408);
        let body = Body::from("{}");
        let read = whole(body, &mut room, 100, CHUNK_WAIT, false).await;
        assert_eq!(read.unwrap(), b"{}");
        let long = whole(Body::from("{ }"), &mut room, 2, CHUNK_WAIT, false).await;
        assert_eq!(long.unwrap_err().into_response().status(), 413);
    }

    #[tokio::test(start_paused = true)]
    async fn a_body_of_a_few_bytes_now_and_then_is_refused_and_that_of_a_slow_line_is_not() {
        // Parts of this size, one every 10 s.
        let read = async |bytes: usize, parts: usize| {
            let peers = Peers::new(1);
            let mut room = peers.room_for_body([10, 0, 0, 1].into());
            let part = move |n: usize| async move {
                tokio::time::sleep(Duration::from_secs(10)).await;
                (n < parts).then(|| (Ok::<_, std::io::Error>(vec![b'1'; bytes]), n + 1))
            };
            let body = Body::from_stream(futures::stream::unfold(0, part));
            whole(body, &mut room, BODY_BYTES_MAX, CHUNK_WAIT, false).await
        };
        let begun = tokio::time::Instant::now();
        let problem = read(10, usize::MAX).await.unwrap_err();
        assert_eq!(problem.into_response().status(), 408);
        assert!(begun.elapsed() < Duration::from_secs(70));
        let slow = read(50_000, 160).await.unwrap();
        assert_eq!(slow.len(), 8_000_000);
    }
}
