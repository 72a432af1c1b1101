//! Who is connected: how many at a time, who leaves when more come, and the seats that are kept for the stop and for
//! who asks whether the daemon lives.
//!
//! Each connection takes an open file, and the operating system gives a process so many and no more. Without a bound
//! of its own the daemon could not accept the one connection that carries the stop.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::io;
use std::pin::{Pin, pin};
use std::sync::{Arc, Mutex, MutexGuard};
use std::task::{Context, Poll};
use std::time::Duration;

use axum::Router;
use axum::body::{Body, Bytes};
use axum::http::StatusCode;
use axum::response::IntoResponse;
use http_body::{Body as HttpBody, Frame, SizeHint};
use hyper::rt::{Read, ReadBufCursor, Write};
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::TcpStream;
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

use super::error::ApiError;
use super::guard::is_stop;
use super::health::is_healthz;

/// How much the listener takes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Connections at a time.
    pub seats: usize,
    /// Further ones, which get an answer to the stop and to `/healthz` alone.
    pub reserve: usize,
    /// How long the head of a request may take; an idle connection is closed after as long.
    pub head_timeout: Duration,
}

impl Limits {
    /// What leaves most of the open files to the store, the frames and the devices.
    #[must_use]
    pub fn within(open_files: u64) -> Limits {
        let part = |of: u64, least, most| (open_files / of).clamp(least, most) as usize;
        Limits {
            seats: part(2, 16, 512),
            reserve: part(16, 4, 32),
            head_timeout: Duration::from_secs(60),
        }
    }
}

/// A number of seats, and who has them.
struct Room {
    seats: usize,
    guests: Mutex<Guests>,
}

#[derive(Default)]
struct Guests {
    /// By number, which grows without reuse.
    all: BTreeMap<u64, Guest>,
    newest: u64,
}

struct Guest {
    /// Requests whose answers are not out yet: an event stream is one as long as it lasts.
    requests: usize,
    idle_since: Instant,
    leave: CancellationToken,
}

impl Room {
    fn new(seats: usize) -> Arc<Room> {
        Arc::new(Room {
            seats,
            guests: Mutex::default(),
        })
    }

    fn guests(&self) -> MutexGuard<'_, Guests> {
        self.guests.lock().expect("no holder of this lock panics")
    }

    /// A seat, if need be that of the guest who has been idle longest; `None` where nobody is idle.
    fn enter(self: &Arc<Self>) -> Option<Seat> {
        let mut guests = self.guests();
        if guests.all.len() >= self.seats && !guests.send_one_away() {
            return None;
        }
        guests.newest += 1;
        let number = guests.newest;
        let leave = CancellationToken::new();
        let guest = Guest {
            requests: 0,
            idle_since: Instant::now(),
            leave: leave.clone(),
        };
        guests.all.insert(number, guest);
        Some(Seat {
            room: Arc::clone(self),
            number,
            leave,
        })
    }
}

impl Guests {
    /// Whether somebody was idle.
    fn send_one_away(&mut self) -> bool {
        let idle = self.all.iter().filter(|(_, guest)| guest.requests == 0);
        let longest = idle.min_by_key(|(_, guest)| guest.idle_since);
        let Some(number) = longest.map(|(number, _)| *number) else {
            return false;
        };
        if let Some(guest) = self.all.remove(&number) {
            guest.leave.cancel();
        }
        true
    }
}

/// A place for one connection, free again when it is dropped.
struct Seat {
    room: Arc<Room>,
    number: u64,
    leave: CancellationToken,
}

impl Seat {
    fn ask(self: &Arc<Self>) -> Asked {
        if let Some(guest) = self.room.guests().all.get_mut(&self.number) {
            guest.requests += 1;
        }
        Asked(Arc::clone(self))
    }

    fn is_busy(&self) -> bool {
        let guests = self.room.guests();
        guests.all.get(&self.number).is_some_and(|g| g.requests > 0)
    }
}

impl Drop for Seat {
    fn drop(&mut self) {
        self.room.guests().all.remove(&self.number);
    }
}

/// A request in hand, until its answer is out.
struct Asked(Arc<Seat>);

impl Drop for Asked {
    fn drop(&mut self) {
        if let Some(guest) = self.0.room.guests().all.get_mut(&self.0.number) {
            guest.requests -= 1;
            guest.idle_since = Instant::now();
        }
    }
}

/// Requests whose answers are given, but perhaps not out: they leave with the next flush.
type Unsent = Arc<Mutex<Vec<Asked>>>;

/// A body that says when all of it is handed over.
struct Answer {
    body: Body,
    asked: Option<Asked>,
    unsent: Unsent,
}

impl Drop for Answer {
    fn drop(&mut self) {
        let asked = self.asked.take();
        let mut unsent = self.unsent.lock().expect("no holder of this lock panics");
        unsent.extend(asked);
    }
}

impl HttpBody for Answer {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(context)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

/// A connection that knows what it has not got rid of.
struct Line {
    io: TokioIo<TcpStream>,
    unsent: Unsent,
    /// Since when the other end takes nothing.
    blocked: Arc<Mutex<Option<Instant>>>,
}

impl Line {
    fn wrote(&self, poll: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        let mut blocked = self.blocked.lock().expect("no holder of this lock panics");
        *blocked = match poll {
            Poll::Pending => blocked.or_else(|| Some(Instant::now())),
            Poll::Ready(_) => None,
        };
        poll
    }
}

impl Read for Line {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: ReadBufCursor<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_read(context, buffer)
    }
}

impl Write for Line {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let poll = Pin::new(&mut self.io).poll_write(context, bytes);
        self.wrote(poll)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let poll = Pin::new(&mut self.io).poll_write_vectored(context, parts);
        self.wrote(poll)
    }

    fn is_write_vectored(&self) -> bool {
        self.io.is_write_vectored()
    }

    /// Comes once everything before is written.
    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let poll = Pin::new(&mut self.io).poll_flush(context);
        if poll.is_ready() {
            let mut unsent = self.unsent.lock().expect("no holder of this lock panics");
            unsent.clear();
        }
        poll
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.io).poll_shutdown(context)
    }
}

/// Everybody who is connected.
pub(super) struct Visitors {
    limits: Limits,
    hall: Arc<Room>,
    reserve: Arc<Room>,
    ending: CancellationToken,
    tasks: tokio::task::JoinSet<()>,
}

impl Visitors {
    pub fn new(limits: Limits) -> Self {
        Visitors {
            limits,
            hall: Room::new(limits.seats),
            reserve: Room::new(limits.reserve),
            ending: CancellationToken::new(),
            tasks: tokio::task::JoinSet::new(),
        }
    }

    /// Answers what comes on a connection.
    pub fn receive(&mut self, stream: TcpStream, router: Router) {
        while self.tasks.try_join_next().is_some() {}
        let (seat, urgent_only) = match (self.hall.enter(), &self.reserve) {
            (Some(seat), _) => (seat, false),
            (None, reserve) => match reserve.enter() {
                Some(seat) => (seat, true),
                // Each of the reserve is about to be answered.
                None => return,
            },
        };
        let ending = self.ending.clone();
        let head_timeout = self.limits.head_timeout;
        self.tasks.spawn(async move {
            converse(
                stream,
                router,
                Arc::new(seat),
                urgent_only,
                head_timeout,
                ending,
            )
            .await;
        });
    }

    /// Frees an open file where there are no more.
    pub fn send_one_away(&self) {
        self.hall.guests().send_one_away();
    }

    /// Lets what is under way finish.
    pub async fn end(mut self) {
        self.ending.cancel();
        while self.tasks.join_next().await.is_some() {}
    }
}

async fn converse(
    stream: TcpStream,
    router: Router,
    seat: Arc<Seat>,
    urgent_only: bool,
    head_timeout: Duration,
    ending: CancellationToken,
) {
    /// How long a connection that has nothing under way may take to end.
    const LAST_WORDS: Duration = Duration::from_millis(200);
    /// How long the end waits for one who reads nothing of the answer.
    const PATIENCE: Duration = Duration::from_secs(5);
    let line = Line {
        io: TokioIo::new(stream),
        unsent: Unsent::default(),
        blocked: Arc::default(),
    };
    let (unsent, blocked) = (Arc::clone(&line.unsent), Arc::clone(&line.blocked));
    let at_seat = Arc::clone(&seat);
    let answer = move |request: hyper::Request<hyper::body::Incoming>| {
        let request = request.map(Body::new);
        let asked = at_seat.ask();
        let (router, unsent) = (router.clone(), Arc::clone(&unsent));
        async move {
            let response = match urgent_only && !is_urgent(&request) {
                true => too_many().into_response(),
                false => match router.oneshot(request).await {
                    Ok(response) => response,
                },
            };
            Ok::<_, Infallible>(response.map(|body| Answer {
                body,
                asked: Some(asked),
                unsent,
            }))
        }
    };
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(head_timeout)
        .keep_alive(!urgent_only)
        // Who has said all may still listen.
        .half_close(true)
        .serve_connection(line, hyper::service::service_fn(answer));
    let mut connection = pin!(connection);
    tokio::select! {
        // A client that breaks off is no news.
        _ = &mut connection => return,
        () = seat.leave.cancelled() => return,
        () = ending.cancelled() => {}
    }
    connection.as_mut().graceful_shutdown();
    let deaf = || {
        let since = *blocked.lock().expect("no holder of this lock panics");
        since.is_some_and(|since| since.elapsed() > PATIENCE)
    };
    // One that never asked anything does not notice.
    while tokio::time::timeout(LAST_WORDS, &mut connection)
        .await
        .is_err()
        && seat.is_busy()
        && !deaf()
    {}
}

/// Whether it is answered however many are connected: the stop, and whether the daemon lives. A monitor that hears
/// nothing would have a daemon started anew that is only full, in the middle of its scan.
fn is_urgent(request: &axum::extract::Request) -> bool {
    is_stop(request) || is_healthz(request)
}

fn too_many() -> ApiError {
    ApiError::new(
        StatusCode::SERVICE_UNAVAILABLE,
        "too-many-connections",
        "too many connections",
        "too many connections are open and none of them is idle; close some event streams or pages; the stop \
         and /healthz are answered all the same",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::api::server::serve_within;
    use axum::routing::{get, post};
    use std::net::SocketAddr;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::sync::{broadcast, oneshot};

    const LIMITS: Limits = Limits {
        seats: 6,
        reserve: 2,
        head_timeout: Duration::from_secs(60),
    };

    /// More than the operating system takes from one who reads nothing.
    const MUCH: usize = 16 << 20;

    /// A listener with a stop, an answer to `/`, a long one to `/much` and a stream that lasts until the last of the news.
    struct Daemon {
        address: SocketAddr,
        news: broadcast::Sender<&'static str>,
        end: oneshot::Sender<()>,
        server: tokio::task::JoinHandle<io::Result<()>>,
    }

    async fn daemon(limits: Limits) -> Daemon {
        let news = broadcast::Sender::new(16);
        let listens = news.clone();
        let stream = move || {
            let listener = listens.subscribe();
            let lines = futures::stream::unfold(Some(listener), |listener| async {
                let mut listener = listener?;
                let line = listener.recv().await.ok()?;
                let goes_on = (line != "last").then_some(listener);
                Some((Ok::<_, Infallible>(line), goes_on))
            });
            std::future::ready(Body::from_stream(lines))
        };
        let router = Router::new()
            .route("/", get(async || "here"))
            .route(crate::api::health::HEALTHZ, get(async || "ok"))
            .route("/events", get(stream))
            .route("/much", get(async || vec![b'x'; MUCH]))
            .route(crate::api::rig::STOP, post(async || "stopped"));
        let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let (end, ended) = oneshot::channel::<()>();
        let ended = async move {
            ended.await.ok();
        };
        let server = tokio::spawn(serve_within(listener, router, limits, ended));
        Daemon {
            address,
            news,
            end,
            server,
        }
    }

    impl Daemon {
        async fn connect(&self) -> TcpStream {
            TcpStream::connect(self.address).await.unwrap()
        }

        /// Sends a request and reads until `enough` is there or the end.
        async fn ask(&self, line: &str, enough: &str) -> (TcpStream, String) {
            let mut stream = self.connect().await;
            let head = format!("{line} HTTP/1.1\r\nhost: 127.0.0.1\r\n\r\n");
            stream.write_all(head.as_bytes()).await.unwrap();
            let got = read(&mut stream, enough).await;
            (stream, got)
        }
    }

    async fn read(stream: &mut TcpStream, enough: &str) -> String {
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

    #[tokio::test]
    async fn the_stop_and_the_question_of_life_get_through_however_many_are_connected() {
        let daemon = daemon(LIMITS).await;
        let mut streams = Vec::new();
        for _ in 0..LIMITS.seats {
            let (stream, head) = daemon.ask("GET /events", "\r\n\r\n").await;
            assert!(head.starts_with("HTTP/1.1 200"), "{head}");
            streams.push(stream);
        }
        let mut idle = Vec::new();
        for _ in 0..50 {
            idle.push(daemon.connect().await);
        }
        let (_, refused) = daemon.ask("GET /", "too-many").await;
        assert!(refused.starts_with("HTTP/1.1 503"), "{refused}");
        let stop = format!("POST {}", crate::api::rig::STOP);
        let (_, stopped) = daemon.ask(&stop, "stopped").await;
        assert!(stopped.starts_with("HTTP/1.1 200"), "{stopped}");
        // More often than there are seats in reserve: each is free again once it has answered.
        for _ in 0..3 * LIMITS.reserve {
            let alive = format!("GET {}", crate::api::health::HEALTHZ);
            let (_, alive) = daemon.ask(&alive, "ok").await;
            assert!(alive.starts_with("HTTP/1.1 200"), "{alive}");
        }
        // Who listens is sent away by nobody.
        daemon.news.send("news").unwrap();
        for stream in &mut streams {
            assert!(read(stream, "news").await.contains("news"));
        }
    }

    #[tokio::test]
    async fn who_was_idle_longest_leaves_when_more_come() {
        let daemon = daemon(LIMITS).await;
        let mut first = daemon.connect().await;
        let (mut stream, _) = daemon.ask("GET /events", "\r\n\r\n").await;
        let mut idle = Vec::new();
        for _ in 0..50 {
            idle.push(daemon.connect().await);
        }
        let (_, answer) = daemon.ask("GET /", "here").await;
        assert!(answer.starts_with("HTTP/1.1 200"), "{answer}");
        assert_eq!(read(&mut first, "more").await, "");
        daemon.news.send("news").unwrap();
        assert!(read(&mut stream, "news").await.contains("news"));
    }

    #[tokio::test]
    async fn a_head_that_does_not_end_is_given_up_and_a_stream_is_not() {
        let daemon = daemon(Limits {
            head_timeout: Duration::from_millis(50),
            ..LIMITS
        })
        .await;
        let (mut stream, _) = daemon.ask("GET /events", "\r\n\r\n").await;
        let mut slow = daemon.connect().await;
        slow.write_all(b"GET / HTTP/1.1\r\nhost: 127.0.")
            .await
            .unwrap();
        let rest = read(&mut slow, "never").await;
        assert!(!rest.contains("200"), "{rest}");
        daemon.news.send("news").unwrap();
        assert!(read(&mut stream, "news").await.contains("news"));
    }

    #[tokio::test]
    async fn the_end_waits_for_answers_and_for_nobody_who_is_idle() {
        let daemon = daemon(LIMITS).await;
        let _idle = daemon.connect().await;
        let (mut stream, _) = daemon.ask("GET /events", "\r\n\r\n").await;
        daemon.end.send(()).unwrap();
        daemon.news.send("last").unwrap();
        let rest = read(&mut stream, "0\r\n\r\n").await;
        assert!(rest.contains("last"), "{rest}");
        daemon.server.await.unwrap().unwrap();
    }

    /// Begins to ask for a long answer and reads its head.
    async fn much_of(daemon: &Daemon) -> (TcpStream, usize) {
        let (stream, got) = daemon.ask("GET /much", "\r\n\r\n").await;
        let (_, body) = got.split_once("\r\n\r\n").unwrap();
        (stream, body.len())
    }

    async fn rest_of(mut stream: TcpStream, had: usize) -> usize {
        let mut rest = Vec::new();
        while had + rest.len() < MUCH && stream.read_buf(&mut rest).await.is_ok_and(|n| n > 0) {}
        had + rest.len()
    }

    #[tokio::test]
    async fn a_long_answer_is_cut_neither_by_others_nor_by_the_end() {
        let daemon = daemon(LIMITS).await;
        let (first, had_first) = much_of(&daemon).await;
        let mut idle = Vec::new();
        for _ in 0..50 {
            idle.push(daemon.connect().await);
        }
        assert_eq!(rest_of(first, had_first).await, MUCH);
        let (last, had_last) = much_of(&daemon).await;
        daemon.end.send(()).unwrap();
        tokio::time::sleep(Duration::from_millis(400)).await;
        assert_eq!(rest_of(last, had_last).await, MUCH);
        daemon.server.await.unwrap().unwrap();
    }

    #[tokio::test]
    async fn the_end_does_not_wait_for_one_who_reads_nothing() {
        let daemon = daemon(LIMITS).await;
        let (_deaf, _) = much_of(&daemon).await;
        daemon.end.send(()).unwrap();
        daemon.server.await.unwrap().unwrap();
    }

    #[tokio::test]
    async fn who_has_said_all_still_gets_the_answer() {
        let daemon = daemon(LIMITS).await;
        for line in ["GET / HTTP/1.1", "GET / HTTP/1.0"] {
            let mut stream = daemon.connect().await;
            let head = format!("{line}\r\nhost: 127.0.0.1\r\n\r\n");
            stream.write_all(head.as_bytes()).await.unwrap();
            stream.shutdown().await.unwrap();
            // To the end of the connection, which is not kept for one who says no more.
            let got = read(&mut stream, "never").await;
            assert!(got.ends_with("here"), "{got}");
        }
    }

    #[test]
    fn most_open_files_are_left_to_others() {
        for open_files in [64, 256, 1024, 65_536] {
            let limits = Limits::within(open_files);
            let taken = (limits.seats + limits.reserve) as u64;
            assert!(taken * 3 <= open_files * 2, "{open_files}: {limits:?}");
        }
    }
}
