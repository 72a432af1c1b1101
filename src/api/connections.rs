//! Bounds the number of open connections and keeps some of them for the stop and for `/healthz`.
//!
//! The operating system limits how many files a process may open, and each connection takes one. Without a bound of its
//! own, the daemon could run out of files and could not accept the connection that carries the stop.
//!
//! A connection takes a seat when it is accepted. Without a free seat it still gets an answer to the stop and to
//! `/healthz`; for any other request it waits a moment for a seat, while all idle connections are closed.

use std::collections::VecDeque;
use std::convert::Infallible;
use std::pin::pin;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock, Weak};
use std::time::Duration;

use axum::Router;
use axum::body::Body;
use axum::extract::Request;
use axum::response::{IntoResponse, Response};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::io::{AsyncRead, AsyncWrite};
use tokio::sync::{Notify, Semaphore};
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

use super::guard::is_stop;
use super::health::is_healthz;
use super::seats::{Limits, Seat, Seats};
use super::status::ApiError;
use super::via::Via;

/// How long a request waits for a seat while idle connections close.
const SEAT_WAIT: Duration = Duration::from_millis(100);
/// How long a client may take for the handshake of TLS.
const HANDSHAKE_WAIT: Duration = Duration::from_secs(10);
/// How long the end of the daemon waits for a client to read an answer that is complete.
const READ_WAIT: Duration = Duration::from_secs(5);

/// All open connections.
pub(super) struct Connections {
    limits: Limits,
    seats: Arc<Seats>,
    /// Closes the idle connections that have a seat.
    crowded: Arc<Notify>,
    ending: CancellationToken,
    /// Connections accepted without a seat, oldest first; at most `limits.reserve`.
    reserve: VecDeque<Weak<Connection>>,
    tasks: tokio::task::JoinSet<()>,
}

impl Connections {
    pub fn new(limits: Limits) -> Self {
        Connections {
            limits,
            seats: Arc::new(Seats::new(&limits)),
            crowded: Arc::default(),
            ending: CancellationToken::new(),
            reserve: VecDeque::new(),
            tasks: tokio::task::JoinSet::new(),
        }
    }

    /// Answers the requests of a connection on a task of its own. `stream` completes when the connection can be used: after
    /// the handshake of TLS, where there is one.
    pub fn accept<S>(
        &mut self,
        stream: impl Future<Output = std::io::Result<S>> + Send + 'static,
        via: Via,
        router: Router,
    ) where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    {
        while self.tasks.try_join_next().is_some() {}
        let connection = Arc::new(Connection {
            seat: OnceLock::new(),
            seats: Arc::clone(&self.seats),
            of_peer: self.seats.of(via),
            via,
            crowded: Arc::clone(&self.crowded),
            ending: self.ending.clone(),
            close: CancellationToken::new(),
            in_hand: AtomicUsize::new(0),
        });
        match self.seats.try_take(connection.of_peer.as_ref()) {
            Some(seat) => drop(connection.seat.set(seat)),
            None => {
                let waits = |c: &Weak<Connection>| c.upgrade().is_some_and(|c| !c.has_seat());
                self.reserve.retain(waits);
                if self.reserve.len() >= self.limits.reserve {
                    self.close_oldest_of_reserve();
                }
                self.reserve.push_back(Arc::downgrade(&connection));
            }
        }
        let head_timeout = self.limits.head_timeout;
        self.tasks.spawn(async move {
            let stream = tokio::select! {
                stream = timeout(HANDSHAKE_WAIT, stream) => stream,
                () = connection.must_close() => return,
            };
            // A client that breaks off is not an error of the daemon.
            if let Ok(Ok(stream)) = stream {
                connection.serve(stream, router, head_timeout).await;
            }
        });
    }

    /// Frees open files when the operating system has no more.
    pub fn close_idle(&mut self) {
        self.crowded.notify_waiters();
        self.close_oldest_of_reserve();
    }

    fn close_oldest_of_reserve(&mut self) {
        let oldest = self.reserve.pop_front();
        if let Some(oldest) = oldest.and_then(|oldest| oldest.upgrade()) {
            oldest.close.cancel();
        }
    }

    /// Closes idle connections and waits for the answers in hand.
    pub async fn end(mut self) {
        self.ending.cancel();
        while self.tasks.join_next().await.is_some() {}
    }
}

/// One connection.
struct Connection {
    seat: OnceLock<Seat>,
    seats: Arc<Seats>,
    /// The seats of its peer; none for a proxy.
    of_peer: Option<Arc<Semaphore>>,
    via: Via,
    crowded: Arc<Notify>,
    ending: CancellationToken,
    /// Closes this connection, unless a handler is at work for it.
    close: CancellationToken,
    /// Requests that handlers are at work on.
    in_hand: AtomicUsize,
}

impl Connection {
    fn has_seat(&self) -> bool {
        self.seat.get().is_some()
    }

    fn has_work(&self) -> bool {
        self.in_hand.load(Ordering::Relaxed) > 0
    }

    async fn serve<S>(self: Arc<Self>, stream: S, router: Router, head_timeout: Duration)
    where
        S: AsyncRead + AsyncWrite + Unpin + Send + 'static,
    {
        let answer = |request: hyper::Request<hyper::body::Incoming>| {
            let (this, router) = (Arc::clone(&self), router.clone());
            async move {
                this.in_hand.fetch_add(1, Ordering::Relaxed);
                let response = this.answer(request.map(Body::new), router).await;
                this.in_hand.fetch_sub(1, Ordering::Relaxed);
                Ok::<_, Infallible>(response)
            }
        };
        let http = http1::Builder::new()
            .timer(TokioTimer::new())
            .header_read_timeout(head_timeout)
            // A client that has closed its sending half still reads the answer.
            .half_close(true)
            .serve_connection(TokioIo::new(stream), hyper::service::service_fn(answer));
        let mut http = pin!(http);
        tokio::select! {
            // A client that breaks off is not an error of the daemon.
            _ = &mut http => return,
            () = self.must_close() => {}
        }
        if self.close.is_cancelled() && !self.has_work() {
            return;
        }
        // Closes an idle connection at once, and any other one after the answer in hand.
        http.as_mut().graceful_shutdown();
        tokio::select! {
            _ = &mut http => return,
            () = self.ending.cancelled() => {}
        }
        while timeout(READ_WAIT, &mut http).await.is_err() && self.has_work() {}
    }

    async fn must_close(&self) {
        loop {
            tokio::select! {
                () = self.ending.cancelled() => return,
                () = self.close.cancelled() => return,
                () = self.crowded.notified() => if self.has_seat() { return },
            }
        }
    }

    async fn answer(&self, mut request: Request, router: Router) -> Response {
        request.extensions_mut().insert(self.via);
        if !is_urgent(&request) && !self.take_seat().await {
            return ApiError::too_many_connections().into_response();
        }
        let Ok(response) = router.oneshot(request).await;
        response
    }

    async fn take_seat(&self) -> bool {
        if self.has_seat() {
            return true;
        }
        let peer = self.of_peer.as_ref();
        let seat = match self.seats.try_take(peer) {
            Some(seat) => seat,
            None => {
                self.crowded.notify_waiters();
                match timeout(SEAT_WAIT, self.seats.take(peer)).await {
                    Ok(Some(seat)) => seat,
                    _ => return false,
                }
            }
        };
        self.seat.set(seat).is_ok()
    }
}

/// Returns whether the request is answered however many connections there are: the stop, and `/healthz`. A supervisor
/// that gets no answer from `/healthz` would restart a daemon that is only busy, in the middle of its scan.
fn is_urgent(request: &Request) -> bool {
    is_stop(request) || is_healthz(request)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::via::Listener;
    use axum::routing::{get, post};
    use tokio::io::{AsyncReadExt, AsyncWriteExt, DuplexStream};
    use tokio::sync::broadcast;

    const LIMITS: Limits = Limits {
        seats: 6,
        seats_of_peer: 6,
        reserve: 2,
        head_timeout: Duration::from_secs(60),
    };

    /// More bytes than a connection holds for a client that does not read.
    const LONG: usize = 1 << 20;

    /// A listener with a stop, an answer to `/`, a long one to `/long` and a stream that ends with the word "last".
    struct Daemon {
        connections: Connections,
        router: Router,
        news: broadcast::Sender<&'static str>,
    }

    fn daemon() -> Daemon {
        daemon_of(LIMITS)
    }

    fn daemon_of(limits: Limits) -> Daemon {
        let news = broadcast::Sender::new(16);
        let subscribe = news.clone();
        let stream = move || {
            let listener = subscribe.subscribe();
            let lines = futures::stream::unfold(Some(listener), |listener| async {
                let mut listener = listener?;
                let line = listener.recv().await.ok()?;
                let more = (line != "last").then_some(listener);
                Some((Ok::<_, Infallible>(line), more))
            });
            std::future::ready(Body::from_stream(lines))
        };
        let router = Router::new()
            .route("/", get(async || "here"))
            .route(crate::api::health::HEALTHZ, get(async || "ok"))
            .route("/events", get(stream))
            .route("/long", get(async || vec![b'x'; LONG]))
            .route(crate::api::rig::STOP, post(async || "stopped"));
        Daemon {
            connections: Connections::new(limits),
            router,
            news,
        }
    }

    impl Daemon {
        fn connect(&mut self) -> DuplexStream {
            self.connect_from(1)
        }

        fn connect_from(&mut self, peer: u8) -> DuplexStream {
            let (client, server) = tokio::io::duplex(1 << 16);
            let via = Via::new(Listener::Public, false, ([10, 0, 0, peer], 9).into());
            let ready = std::future::ready(Ok(server));
            self.connections.accept(ready, via, self.router.clone());
            client
        }

        /// Sends a request and reads until `enough` has come, or to the end.
        async fn ask(&mut self, line: &str, enough: &str) -> (DuplexStream, String) {
            self.ask_from(1, line, enough).await
        }

        async fn ask_from(&mut self, peer: u8, line: &str, enough: &str) -> (DuplexStream, String) {
            let mut stream = self.connect_from(peer);
            let head = format!("{line} HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n");
            stream.write_all(head.as_bytes()).await.unwrap();
            let got = read(&mut stream, enough).await;
            (stream, got)
        }
    }

    async fn read(stream: &mut DuplexStream, enough: &str) -> String {
        let mut got = Vec::new();
        loop {
            let mut some = [0; 4096];
            match stream.read(&mut some).await {
                Ok(n) if n > 0 => got.extend_from_slice(&some[..n]),
                _ => break,
            }
            if String::from_utf8_lossy(&got).contains(enough) {
                break;
            }
        }
        String::from_utf8_lossy(&got).into_owned()
    }

    #[tokio::test(start_paused = true)]
    async fn the_stop_and_healthz_are_answered_however_many_connections_there_are() {
        let mut daemon = daemon();
        let mut streams = Vec::new();
        for _ in 0..LIMITS.seats {
            let (stream, head) = daemon.ask("GET /events", "\r\n\r\n").await;
            assert!(head.starts_with("HTTP/1.1 200"), "{head}");
            streams.push(stream);
        }
        let idle: Vec<_> = (0..50).map(|_| daemon.connect()).collect();
        let (_, refused) = daemon.ask("GET /", "too-many").await;
        assert!(refused.starts_with("HTTP/1.1 503"), "{refused}");
        let stop = format!("POST {}", crate::api::rig::STOP);
        let (_, stopped) = daemon.ask(&stop, "stopped").await;
        assert!(stopped.starts_with("HTTP/1.1 200"), "{stopped}");
        // More often than the reserve has room: a connection that has its answer makes room.
        for _ in 0..3 * LIMITS.reserve {
            let alive = format!("GET {}", crate::api::health::HEALTHZ);
            let (_, alive) = daemon.ask(&alive, "ok").await;
            assert!(alive.starts_with("HTTP/1.1 200"), "{alive}");
        }
        // Event streams stay open.
        daemon.news.send("news").unwrap();
        for stream in &mut streams {
            assert!(read(stream, "news").await.contains("news"));
        }
        drop(idle);
    }

    #[tokio::test(start_paused = true)]
    async fn one_peer_does_not_take_the_seats_of_another() {
        let mut daemon = daemon_of(Limits {
            seats_of_peer: 3,
            ..LIMITS
        });
        let mut busy = Vec::new();
        for _ in 0..3 {
            busy.push(daemon.ask("GET /events", "\r\n\r\n").await.0);
        }
        let (_, refused) = daemon.ask("GET /", "too-many").await;
        assert!(refused.starts_with("HTTP/1.1 503"), "{refused}");
        let (_, answered) = daemon.ask_from(2, "GET /", "here").await;
        assert!(answered.starts_with("HTTP/1.1 200"), "{answered}");
        let stop = format!("POST {}", crate::api::rig::STOP);
        let (_, stopped) = daemon.ask(&stop, "stopped").await;
        assert!(stopped.starts_with("HTTP/1.1 200"), "{stopped}");
        drop(busy);
    }

    #[tokio::test(start_paused = true)]
    async fn an_unfinished_handshake_is_given_up() {
        let mut daemon = daemon();
        let via = Via::new(Listener::Public, false, ([10, 0, 0, 1], 9).into());
        let never = std::future::pending::<std::io::Result<DuplexStream>>();
        daemon.connections.accept(never, via, daemon.router.clone());
        tokio::time::sleep(2 * HANDSHAKE_WAIT).await;
        assert!(daemon.connections.tasks.try_join_next().is_some());
    }

    #[tokio::test(start_paused = true)]
    async fn idle_connections_make_room_for_a_request() {
        let mut daemon = daemon();
        let mut first = daemon.connect();
        let (mut stream, _) = daemon.ask("GET /events", "\r\n\r\n").await;
        let (mut kept_alive, _) = daemon.ask("GET /", "here").await;
        let idle: Vec<_> = (0..50).map(|_| daemon.connect()).collect();
        let (_, answer) = daemon.ask("GET /", "here").await;
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        assert_eq!(read(&mut first, "more").await, "");
        assert_eq!(read(&mut kept_alive, "more").await, "");
        daemon.news.send("news").unwrap();
        assert!(read(&mut stream, "news").await.contains("news"));
        drop(idle);
    }

    #[tokio::test(start_paused = true)]
    async fn an_unfinished_head_and_an_idle_connection_time_out_and_a_stream_does_not() {
        let mut daemon = daemon();
        let (mut stream, _) = daemon.ask("GET /events", "\r\n\r\n").await;
        let (mut idle, _) = daemon.ask("GET /", "here").await;
        let mut slow = daemon.connect();
        let part = b"GET / HTTP/1.1\r\nhost: 127.0.";
        slow.write_all(part).await.unwrap();
        let start = tokio::time::Instant::now();
        let rest = read(&mut slow, "never").await;
        assert!(!rest.contains("200"), "{rest}");
        assert_eq!(read(&mut idle, "never").await, "");
        let took = start.elapsed();
        assert!(took >= LIMITS.head_timeout && took < 2 * LIMITS.head_timeout);
        daemon.news.send("news").unwrap();
        assert!(read(&mut stream, "news").await.contains("news"));
    }

    #[tokio::test(start_paused = true)]
    async fn a_crowd_of_unfinished_heads_does_not_keep_the_stop_out() {
        let mut daemon = daemon();
        let mut slow = Vec::new();
        for _ in 0..50 {
            let mut stream = daemon.connect();
            // Some are closed at once.
            stream.write_all(b"GET / HT").await.ok();
            tokio::task::yield_now().await;
            slow.push(stream);
        }
        let stop = format!("POST {}", crate::api::rig::STOP);
        let start = tokio::time::Instant::now();
        let (_, stopped) = daemon.ask(&stop, "stopped").await;
        assert!(stopped.starts_with("HTTP/1.1 200"), "{stopped}");
        assert!(start.elapsed() < SEAT_WAIT);
    }

    #[tokio::test(start_paused = true)]
    async fn the_end_waits_for_answers_and_not_for_idle_connections() {
        let mut daemon = daemon();
        let idle = daemon.connect();
        let (mut stream, _) = daemon.ask("GET /events", "\r\n\r\n").await;
        let start = tokio::time::Instant::now();
        let end = tokio::spawn(daemon.connections.end());
        daemon.news.send("last").unwrap();
        let rest = read(&mut stream, "0\r\n\r\n").await;
        assert!(rest.contains("last"), "{rest}");
        end.await.unwrap();
        assert!(start.elapsed() < READ_WAIT);
        drop(idle);
    }

    /// Asks for a long answer and reads its head.
    async fn long_answer(daemon: &mut Daemon) -> (DuplexStream, usize) {
        let (stream, got) = daemon.ask("GET /long", "\r\n\r\n").await;
        let (_, body) = got.split_once("\r\n\r\n").unwrap();
        (stream, body.len())
    }

    async fn rest_of(mut stream: DuplexStream, had: usize) -> usize {
        let mut rest = Vec::new();
        while had + rest.len() < LONG && stream.read_buf(&mut rest).await.is_ok_and(|n| n > 0) {}
        had + rest.len()
    }

    #[tokio::test(start_paused = true)]
    async fn neither_other_connections_nor_the_end_cut_a_long_answer() {
        let mut daemon = daemon();
        let (first, had_first) = long_answer(&mut daemon).await;
        let idle: Vec<_> = (0..50).map(|_| daemon.connect()).collect();
        let (_, answer) = daemon.ask("GET /", "here").await;
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        assert_eq!(rest_of(first, had_first).await, LONG);
        let (last, had_last) = long_answer(&mut daemon).await;
        let end = tokio::spawn(daemon.connections.end());
        tokio::time::sleep(READ_WAIT / 2).await;
        assert_eq!(rest_of(last, had_last).await, LONG);
        end.await.unwrap();
        drop(idle);
    }

    #[tokio::test(start_paused = true)]
    async fn the_end_does_not_wait_for_a_client_that_does_not_read() {
        let mut daemon = daemon();
        let (deaf, _) = long_answer(&mut daemon).await;
        let start = tokio::time::Instant::now();
        daemon.connections.end().await;
        assert!(start.elapsed() < 2 * READ_WAIT);
        drop(deaf);
    }

    #[tokio::test(start_paused = true)]
    async fn a_client_that_has_closed_its_sending_half_gets_the_answer() {
        let mut daemon = daemon();
        for line in ["GET / HTTP/1.1", "GET / HTTP/1.0"] {
            let mut stream = daemon.connect();
            let head = format!("{line}\r\nhost: 127.0.0.1\r\n\r\n");
            stream.write_all(head.as_bytes()).await.unwrap();
            stream.shutdown().await.unwrap();
            // To the end of the connection, which is not kept alive for such a client.
            let got = read(&mut stream, "never").await;
            assert!(got.ends_with("here"), "{got}");
        }
    }
}
