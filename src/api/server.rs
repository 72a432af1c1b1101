//! The listeners: loopback, or with TLS or behind a proxy any address. They wait for requests in hand when they end.

use std::future::Future;
use std::io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
use std::net::{Ipv4Addr, SocketAddr, ToSocketAddrs};
use std::pin::pin;
use std::time::{Duration, Instant};

use axum::Router;
use futures::future::select_all;
use tokio::net::{TcpListener, TcpStream};

use super::connections::Connections;
use super::seats::Limits;
use super::tls::{Tls, TlsError};
use super::via::{Listener, Via};

pub use super::tls::{CertificateState, TlsFiles, check_certificate};

/// Where to listen, and how those who come from other machines are protected.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ListenSettings {
    /// Address and port; port 0 takes a free one.
    pub address: String,
    /// Certificate for TLS.
    pub tls: Option<TlsFiles>,
    /// Whether only a proxy, which has TLS, uses the address.
    pub behind_proxy: bool,
    /// Number of valid tokens.
    pub tokens: usize,
    /// Option that names the data folder of the tokens, for the message that refuses to listen without one.
    pub data_option: String,
}

impl ListenSettings {
    /// Returns settings for this machine only.
    #[must_use]
    pub fn loopback(address: impl Into<String>) -> ListenSettings {
        ListenSettings {
            address: address.into(),
            tls: None,
            behind_proxy: false,
            tokens: 0,
            data_option: String::new(),
        }
    }
}

/// Why the daemon cannot listen.
#[derive(Debug, thiserror::Error)]
pub enum ListenError {
    /// The address cannot be read.
    #[error(
        "`{address}` is not a valid address to listen on; expected one like 127.0.0.1:8787 (port 0 takes a free port)"
    )]
    Malformed {
        /// What was given.
        address: String,
    },
    /// Other machines can reach the address, and nothing encrypts what they send.
    #[error(
        "refusing to listen on {address}: other machines can reach it, and access control there needs TLS: give a certificate \
         (--tls-cert FILE --tls-key FILE), or --behind-proxy if a proxy on this machine has it; or listen on 127.0.0.1 and use an \
         SSH tunnel (ssh -L 8787:127.0.0.1:8787 HOST)"
    )]
    NotEncrypted {
        /// What was given.
        address: String,
    },
    /// Other machines can reach the address, and there is no token.
    #[error(
        "refusing to listen on {address}: other machines can reach it, and access control there needs tokens: create one with \
         `ridged token create NAME --role admin{data_option}`, or listen on 127.0.0.1 and use an SSH tunnel \
         (ssh -L 8787:127.0.0.1:8787 HOST)"
    )]
    NoToken {
        /// What was given.
        address: String,
        /// ` --data DIR`, or nothing.
        data_option: String,
    },
    /// The certificate cannot be used.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// The port is taken or forbidden.
    #[error(
        "cannot listen on {address}; another ridged may be running there: choose another port with --listen"
    )]
    Bind {
        /// What was given.
        address: SocketAddr,
        /// Errors of the operating system.
        source: std::io::Error,
    },
}

/// One listening socket.
struct Socket {
    listener: TcpListener,
    kind: Listener,
    tls: Option<Tls>,
}

/// All sockets of a daemon.
pub struct Sockets {
    /// For programs on this machine, and for the command line; served first.
    local: Socket,
    /// For other machines.
    outside: Option<Socket>,
}

impl Sockets {
    /// Returns the URL that clients use.
    ///
    /// # Errors
    /// Errors of the operating system.
    pub fn url(&self) -> std::io::Result<String> {
        let Some(outside) = &self.outside else {
            return self.local_url();
        };
        let address = outside.listener.local_addr()?;
        Ok(match outside.tls {
            Some(_) => format!("https://{address}"),
            None => format!("http://{address}"),
        })
    }

    /// Returns the URL for programs on this machine.
    ///
    /// # Errors
    /// Errors of the operating system.
    pub fn local_url(&self) -> std::io::Result<String> {
        Ok(format!("http://{}", self.local.listener.local_addr()?))
    }
}

/// Parses an address. Of names only `localhost` is accepted: another one may lead anywhere.
fn parse(address: &str) -> Result<SocketAddr, ListenError> {
    let malformed = || ListenError::Malformed {
        address: address.into(),
    };
    match address.parse() {
        Ok(resolved) => Ok(resolved),
        Err(_) => match address.rsplit_once(':') {
            Some(("localhost", _)) => address
                .to_socket_addrs()
                .ok()
                .and_then(|mut all| all.find(SocketAddr::is_ipv4))
                .ok_or_else(malformed),
            _ => Err(malformed()),
        },
    }
}

/// Refuses an address that other machines can reach without TLS or a proxy, or without tokens.
fn check(settings: &ListenSettings) -> Result<(SocketAddr, Listener), ListenError> {
    let address = parse(&settings.address)?;
    let is_loopback = address.ip().to_canonical().is_loopback();
    let kind = match (settings.behind_proxy, is_loopback) {
        (true, _) => Listener::Proxy,
        (false, true) => Listener::Loopback,
        (false, false) => Listener::Public,
    };
    if kind == Listener::Public && settings.tls.is_none() {
        return Err(ListenError::NotEncrypted {
            address: settings.address.clone(),
        });
    }
    if kind != Listener::Loopback && settings.tokens == 0 {
        return Err(ListenError::NoToken {
            address: settings.address.clone(),
            data_option: settings.data_option.clone(),
        });
    }
    Ok((address, kind))
}

/// Listens where the settings say. A daemon that serves other machines, and one with TLS, has a loopback address, too: the
/// command line on its own machine needs no certificate, and stops the rig without a token.
///
/// # Errors
/// [`ListenError`] with the reason.
pub async fn listen(settings: &ListenSettings) -> Result<Sockets, ListenError> {
    let (address, kind) = check(settings)?;
    let tls = settings.tls.as_ref().map(Tls::new).transpose()?;
    let bind = async |address| {
        let bound = TcpListener::bind(address).await;
        bound.map_err(|source| ListenError::Bind { address, source })
    };
    let first = Socket {
        listener: bind(address).await?,
        kind,
        tls,
    };
    if kind == Listener::Loopback && first.tls.is_none() {
        return Ok(Sockets {
            local: first,
            outside: None,
        });
    }
    let local = Socket {
        listener: bind((Ipv4Addr::LOCALHOST, 0).into()).await?,
        kind: Listener::Loopback,
        tls: None,
    };
    Ok(Sockets {
        local,
        outside: Some(first),
    })
}

/// Returns the limits of the listeners of this process.
pub(super) fn limits() -> Limits {
    Limits::within(open_files())
}

/// Answers requests until `end` completes, then waits for those in hand.
///
/// # Errors
/// Errors of the operating system.
pub async fn serve(
    sockets: Sockets,
    router: Router,
    end: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    /// Time for connections to close when there are no more open files.
    const OUT_OF_FILES: Duration = Duration::from_millis(50);
    let mut connections = Connections::new(limits());
    let all: Vec<Socket> = std::iter::once(sockets.local)
        .chain(sockets.outside)
        .collect();
    let mut end = pin!(end);
    loop {
        let next = all.iter().map(|socket| Box::pin(socket.listener.accept()));
        let (accepted, which) = tokio::select! {
            biased;
            () = &mut end => break,
            (accepted, which, _) = select_all(next) => (accepted, which),
        };
        match accepted {
            Ok((stream, peer)) => {
                let socket = &all[which];
                accept(&mut connections, socket, stream, peer, router.clone());
            }
            // The client left before it was accepted.
            Err(e)
                if matches!(
                    e.kind(),
                    ConnectionAborted | ConnectionRefused | ConnectionReset
                ) => {}
            Err(error) => {
                tracing::error!(%error, "a connection could not be accepted: {error}");
                connections.close_idle();
                tokio::time::sleep(OUT_OF_FILES).await;
            }
        }
    }
    drop(all);
    connections.end().await;
    Ok(())
}

fn accept(
    connections: &mut Connections,
    socket: &Socket,
    stream: TcpStream,
    peer: SocketAddr,
    router: Router,
) {
    let via = Via::new(socket.kind, socket.tls.is_some(), peer);
    match &socket.tls {
        None => connections.accept(std::future::ready(Ok(stream)), via, router),
        Some(tls) => {
            let tls = tls.acceptor(Instant::now());
            connections.accept(async move { tls.accept(stream).await }, via, router);
        }
    }
}

/// Raises the limit of open files as far as the operating system permits, and returns it.
fn open_files() -> u64 {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    /// More than the daemon needs; some systems permit more than they can provide.
    const ENOUGH: u64 = 65_536;
    let limit = getrlimit(Resource::Nofile);
    let most = limit.maximum.unwrap_or(ENOUGH).min(ENOUGH);
    match limit.current {
        Some(now) if now < most => {
            let more = Rlimit {
                current: Some(most),
                maximum: limit.maximum,
            };
            match setrlimit(Resource::Nofile, more) {
                Ok(()) => most,
                Err(_) => now,
            }
        }
        now => now.unwrap_or(ENOUGH),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_files_may_be_open_as_the_system_permits() {
        use rustix::process::{Resource, getrlimit};
        let files = open_files();
        let limit = getrlimit(Resource::Nofile);
        let most = limit.maximum.unwrap_or(u64::MAX).min(65_536);
        assert!(files >= most, "{files} of {most}");
        assert_eq!(open_files(), files);
    }

    fn kind(
        address: &str,
        has_tls: bool,
        behind_proxy: bool,
        tokens: usize,
    ) -> Result<Listener, ListenError> {
        let files = TlsFiles {
            certificate: "cert.pem".into(),
            key: "key.pem".into(),
        };
        let settings = ListenSettings {
            tls: has_tls.then_some(files),
            behind_proxy,
            tokens,
            ..ListenSettings::loopback(address)
        };
        check(&settings).map(|(_, kind)| kind)
    }

    #[test]
    fn loopback_needs_neither_tls_nor_tokens() {
        for address in [
            "127.0.0.1:8787",
            "127.0.0.1:0",
            "[::1]:80",
            "localhost:8787",
            "[::ffff:127.0.0.1]:80",
        ] {
            let kind = kind(address, false, false, 0);
            assert!(matches!(kind, Ok(Listener::Loopback)), "{address}");
        }
        for address in ["", "8787", "127.0.0.1", "lab:8787", "127.0.0.1:99999"] {
            let refused = kind(address, true, false, 1);
            let is_malformed = matches!(refused, Err(ListenError::Malformed { .. }));
            assert!(is_malformed, "{address}");
        }
    }

    #[test]
    fn other_addresses_need_tls_or_a_proxy_and_a_token() {
        for address in [
            "0.0.0.0:8787",
            "[::]:8787",
            "192.168.1.2:80",
            "[::ffff:10.0.0.1]:80",
        ] {
            let plain = kind(address, false, false, 1);
            let is_refused = matches!(plain, Err(ListenError::NotEncrypted { .. }));
            assert!(is_refused, "{address}");
            for (has_tls, behind_proxy) in [(true, false), (false, true), (true, true)] {
                let refused = kind(address, has_tls, behind_proxy, 0);
                let is_refused = matches!(refused, Err(ListenError::NoToken { .. }));
                assert!(is_refused, "{address}");
            }
            assert!(matches!(
                kind(address, true, false, 1),
                Ok(Listener::Public)
            ));
            assert!(matches!(kind(address, false, true, 1), Ok(Listener::Proxy)));
        }
        // A proxy on this machine brings clients from others.
        let refused = kind("127.0.0.1:8787", false, true, 0);
        assert!(matches!(refused, Err(ListenError::NoToken { .. })));
    }
}
