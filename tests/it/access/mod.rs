//! Who gets in: the real server on loopback, asked over plain TCP, over TLS, and as a proxy asks. `docs/reference/access.md` names a
//! test for each threat.

mod command_line;
mod lease;
mod limits;
mod proxy;
mod threats;
mod tls;

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use ridged::access::{Role, TokenFile};
use ridged::api::Access;
use ridged::api::server::{self, ListenSettings};
use ridged::daemon::Daemon;
use ridged::scan::RecordedEvent;
use ridged::store::disk::RealDisk;
use serde_json::Value;
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};
use tokio::net::TcpStream;

use crate::bench_in_a_box::BenchInABox;

const AT: &str = "2026-01-01T00:00:00Z";
/// How long an answer may take before a test fails.
const PATIENCE: Duration = Duration::from_secs(60);

/// A daemon on loopback with its rig, its tokens and its folder.
pub struct Served {
    pub bench: BenchInABox,
    pub daemon: Daemon,
    pub tokens: TokenFile,
    /// Where clients ask.
    pub address: SocketAddr,
    /// The address of the command line.
    pub local: SocketAddr,
}

/// How a daemon is served.
#[derive(Default)]
pub struct Serving {
    pub token_on_loopback: bool,
    pub behind_proxy: bool,
    pub tls: Option<server::TlsFiles>,
    pub roots: Vec<PathBuf>,
}

/// Callers with tokens: a name and the token.
pub struct Tokens {
    pub viewer: String,
    pub analyst: String,
    pub operator: String,
    pub admin: String,
}

impl Served {
    /// Serves a lab with a simulated rig whose operator steps are done by itself.
    pub async fn new(serving: Serving) -> (Served, Tokens) {
        let bench = BenchInABox::with(Arc::new(RealDisk), true).await;
        let folder = bench.lab.store().folder().to_owned();
        let tokens = TokenFile::of_folder(&folder);
        let make = |role: Role| {
            let name = format!("the-{role}");
            let secret = tokens.create(&name, role, AT).unwrap();
            secret.reveal().to_owned()
        };
        let all = Tokens {
            viewer: make(Role::Viewer),
            analyst: make(Role::Analyst),
            operator: make(Role::Operator),
            admin: make(Role::Admin),
        };
        let settings = ListenSettings {
            tls: serving.tls,
            behind_proxy: serving.behind_proxy,
            tokens: tokens.count_valid().unwrap(),
            ..ListenSettings::loopback("127.0.0.1:0")
        };
        let sockets = server::listen(&settings).await.unwrap();
        let address = |url: String| url.rsplit('/').next().unwrap().parse().unwrap();
        let local = address(sockets.local_url().unwrap());
        let access = Access::of_folder(&folder)
            .with_tokens_on_loopback(serving.token_on_loopback)
            .with_hosts(vec!["lab-pc".into()])
            .with_import_roots(serving.roots);
        let daemon = Daemon::start(bench.lab.clone(), sockets, access).unwrap();
        let served = Served {
            address: address(daemon.url.clone()),
            local,
            bench,
            daemon,
            tokens,
        };
        (served, all)
    }

    /// Serves a lab that asks every caller for a token.
    pub async fn with_tokens() -> (Served, Tokens) {
        Served::new(Serving {
            token_on_loopback: true,
            ..Serving::default()
        })
        .await
    }

    pub async fn connect(&self) -> TcpStream {
        TcpStream::connect(self.address).await.unwrap()
    }

    /// Sends a request on a connection of its own.
    pub async fn ask(&self, request: Ask<'_>) -> Answer {
        request.on(&mut self.connect().await, self.address).await
    }

    /// Returns all events, once `enough` is true of them: some are recorded behind the answer.
    pub async fn events(&self, enough: impl Fn(&[RecordedEvent]) -> bool) -> Vec<RecordedEvent> {
        let read = async {
            loop {
                let events = self.bench.lab.store().events_after(0, 1000).await.unwrap();
                if enough(&events) {
                    return events;
                }
                tokio::task::yield_now().await;
            }
        };
        let events = tokio::time::timeout(PATIENCE, read).await;
        events.expect("the events are recorded")
    }

    pub async fn end(self) {
        self.daemon.end().await.unwrap();
        self.bench.end().await;
    }
}

/// A request.
#[derive(Clone)]
pub struct Ask<'a> {
    pub method: &'a str,
    pub path: String,
    /// Headers beside `Host`; a `host` here replaces it.
    pub headers: Vec<(&'a str, String)>,
    pub body: Option<String>,
}

pub fn get(path: &str) -> Ask<'_> {
    Ask {
        method: "GET",
        path: path.to_owned(),
        headers: Vec::new(),
        body: None,
    }
}

pub fn post<'a>(path: &str, body: &Value) -> Ask<'a> {
    Ask {
        method: "POST",
        path: path.to_owned(),
        headers: vec![("content-type", "application/json".into())],
        body: Some(body.to_string()),
    }
}

pub fn order<'a>(path: &str) -> Ask<'a> {
    Ask {
        method: "POST",
        path: path.to_owned(),
        headers: Vec::new(),
        body: None,
    }
}

impl<'a> Ask<'a> {
    pub fn with(mut self, name: &'a str, value: impl Into<String>) -> Ask<'a> {
        self.headers.push((name, value.into()));
        self
    }

    pub fn by(self, token: &str) -> Ask<'a> {
        self.with("authorization", format!("Bearer {token}"))
    }

    /// The head as it is sent; `length` is that of the body that is announced.
    pub fn head(&self, address: SocketAddr, length: usize) -> String {
        let mut head = format!(
            "{} {} HTTP/1.1\r\nconnection: close\r\n",
            self.method, self.path
        );
        if !self.headers.iter().any(|(name, _)| *name == "host") {
            head.push_str(&format!("host: {address}\r\n"));
        }
        for (name, value) in &self.headers {
            head.push_str(&format!("{name}: {value}\r\n"));
        }
        if length > 0 {
            head.push_str(&format!("content-length: {length}\r\n"));
        }
        head + "\r\n"
    }

    /// Sends the request and reads the answer.
    pub async fn on<S>(&self, stream: &mut S, address: SocketAddr) -> Answer
    where
        S: AsyncRead + AsyncWrite + Unpin,
    {
        let body = self.body.as_deref().unwrap_or_default();
        let text = self.head(address, body.len()) + body;
        stream.write_all(text.as_bytes()).await.unwrap();
        answer(stream).await
    }
}

/// An answer.
#[derive(Debug)]
pub struct Answer {
    pub status: u16,
    pub head: String,
    pub text: String,
}

impl Answer {
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.text).unwrap_or(Value::Null)
    }

    pub fn code(&self) -> String {
        self.json()["code"].as_str().unwrap_or_default().to_owned()
    }

    /// The values of a header.
    pub fn header(&self, name: &str) -> Vec<&str> {
        let lines = self.head.lines().filter_map(|line| line.split_once(':'));
        lines
            .filter(|(key, _)| key.eq_ignore_ascii_case(name))
            .map(|(_, value)| value.trim())
            .collect()
    }

    /// Asserts status and code.
    #[track_caller]
    pub fn is(&self, status: u16, code: &str) {
        assert_eq!(
            (self.status, self.code().as_str()),
            (status, code),
            "{self:?}"
        );
    }

    #[track_caller]
    pub fn is_ok(&self) {
        assert!((200..300).contains(&self.status), "{self:?}");
    }
}

/// Reads an answer to its end.
pub async fn answer<S: AsyncRead + Unpin>(stream: &mut S) -> Answer {
    let mut bytes = Vec::new();
    let read = tokio::time::timeout(PATIENCE, stream.read_to_end(&mut bytes)).await;
    // A connection that breaks after the answer is the end of it.
    let _ = read.expect("the answer comes");
    parsed(&String::from_utf8_lossy(&bytes))
}

/// Reads the head of an answer, and leaves the connection open.
pub async fn head<S: AsyncRead + Unpin>(stream: &mut S) -> Answer {
    let mut bytes = Vec::new();
    let read = async {
        while !bytes.ends_with(b"\r\n\r\n") {
            match stream.read_u8().await {
                Ok(byte) => bytes.push(byte),
                Err(_) => break,
            }
        }
    };
    tokio::time::timeout(PATIENCE, read)
        .await
        .expect("the head comes");
    parsed(&String::from_utf8_lossy(&bytes))
}

fn parsed(text: &str) -> Answer {
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or((text, ""));
    let status = head.split(' ').nth(1).and_then(|word| word.parse().ok());
    let chunked = head.to_lowercase().contains("transfer-encoding: chunked");
    Answer {
        status: status.unwrap_or(0),
        head: head.to_owned(),
        text: match chunked {
            true => unchunked(body),
            false => body.to_owned(),
        },
    }
}

fn unchunked(mut body: &str) -> String {
    let mut text = String::new();
    while let Some((size, rest)) = body.split_once("\r\n") {
        let size = usize::from_str_radix(size, 16).unwrap_or(0);
        if size == 0 || rest.len() < size {
            break;
        }
        text.push_str(&rest[..size]);
        body = rest[size..].trim_start_matches("\r\n");
    }
    text
}
