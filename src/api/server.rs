//! The listener: accepts connections on loopback only, and waits for requests in hand when it ends.

use std::future::Future;
use std::io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
use std::net::{IpAddr, SocketAddr, ToSocketAddrs};
use std::pin::pin;
use std::time::Duration;

use axum::Router;
use tokio::net::TcpListener;

use super::connections::{Connections, Limits};

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
    /// The address can be reached from other machines.
    #[error(
        "refusing to listen on {address}: other machines can reach it and could move the rig, since there is no access control; listen on 127.0.0.1 and use an SSH tunnel (ssh -L 8787:127.0.0.1:8787 HOST)"
    )]
    NotLoopback {
        /// What was given.
        address: String,
    },
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

/// Parses an address and refuses any that is not loopback.
///
/// # Errors
/// [`ListenError`] with the reason.
pub fn loopback(address: &str) -> Result<SocketAddr, ListenError> {
    let malformed = || ListenError::Malformed {
        address: address.into(),
    };
    let resolved: SocketAddr = match address.parse() {
        Ok(resolved) => resolved,
        Err(_) => match address.rsplit_once(':') {
            Some(("localhost", _)) => address
                .to_socket_addrs()
                .ok()
                .and_then(|mut all| all.find(SocketAddr::is_ipv4))
                .ok_or_else(malformed)?,
            _ => return Err(malformed()),
        },
    };
    let inside = match resolved.ip() {
        IpAddr::V4(ip) => ip.is_loopback(),
        IpAddr::V6(ip) => ip.is_loopback(),
    };
    if inside {
        Ok(resolved)
    } else {
        Err(ListenError::NotLoopback {
            address: address.into(),
        })
    }
}

/// Binds a loopback address.
///
/// # Errors
/// [`ListenError`] with the reason.
pub async fn bind(address: &str) -> Result<TcpListener, ListenError> {
    let address = loopback(address)?;
    TcpListener::bind(address)
        .await
        .map_err(|source| ListenError::Bind { address, source })
}

/// Answers requests until `end` completes, then waits for those in hand.
///
/// # Errors
/// Errors of the operating system.
pub async fn serve(
    listener: TcpListener,
    router: Router,
    end: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    /// Time for connections to close when there are no more open files.
    const OUT_OF_FILES: Duration = Duration::from_millis(50);
    let mut connections = Connections::new(Limits::within(open_files()));
    let mut end = pin!(end);
    loop {
        let accepted = tokio::select! {
            biased;
            () = &mut end => break,
            accepted = listener.accept() => accepted,
        };
        match accepted {
            Ok((stream, _)) => connections.accept(stream, router.clone()),
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
    drop(listener);
    connections.end().await;
    Ok(())
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

    #[test]
    fn only_loopback_is_listened_on() {
        for address in [
            "127.0.0.1:8787",
            "127.0.0.1:0",
            "[::1]:80",
            "localhost:8787",
        ] {
            assert!(loopback(address).is_ok(), "{address}");
        }
        for address in [
            "0.0.0.0:8787",
            "[::]:8787",
            "192.168.1.2:80",
            "[::ffff:10.0.0.1]:80",
        ] {
            let refused = loopback(address);
            assert!(
                matches!(refused, Err(ListenError::NotLoopback { .. })),
                "{address}"
            );
        }
        for address in ["", "8787", "127.0.0.1", "lab:8787", "127.0.0.1:99999"] {
            let refused = loopback(address);
            assert!(
                matches!(refused, Err(ListenError::Malformed { .. })),
                "{address}"
            );
        }
    }
}
