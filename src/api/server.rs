//! The listener: loopback only, and an end that waits for what is under way.

use std::future::Future;
use std::net::{IpAddr, SocketAddr, ToSocketAddrs};

use axum::Router;
use tokio::net::TcpListener;

/// Why the daemon does not listen.
#[derive(Debug, thiserror::Error)]
pub enum ListenError {
    /// The address makes no sense.
    #[error(
        "`{address}` is not an address to listen on; give one like 127.0.0.1:8787 (port 0 takes a free one)"
    )]
    Malformed {
        /// What was given.
        address: String,
    },
    /// The address can be reached from other machines.
    #[error(
        "refusing to listen on {address}: it can be reached from other machines, and there is no access control yet, so anybody there could move the rig; listen on 127.0.0.1 and reach it through an SSH tunnel (ssh -L 8787:127.0.0.1:8787 HOST)"
    )]
    NotLoopback {
        /// What was given.
        address: String,
    },
    /// The port is taken or forbidden.
    #[error("cannot listen on {address}; is another ridged running? --listen takes another port")]
    Bind {
        /// What was given.
        address: SocketAddr,
        /// What the operating system says.
        source: std::io::Error,
    },
}

/// Reads an address and refuses what is not loopback.
///
/// # Errors
/// [`ListenError`] says why.
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
/// [`ListenError`] says why.
pub async fn bind(address: &str) -> Result<TcpListener, ListenError> {
    let address = loopback(address)?;
    TcpListener::bind(address)
        .await
        .map_err(|source| ListenError::Bind { address, source })
}

/// Answers requests until `end` completes, then lets those under way finish.
///
/// # Errors
/// What the operating system says.
pub async fn serve(
    listener: TcpListener,
    router: Router,
    end: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    axum::serve(listener, router)
        .with_graceful_shutdown(end)
        .await
}

#[cfg(test)]
mod tests {
    use super::*;

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
