//! How a request reached the daemon. Only this file reads the headers of a proxy.

use std::net::{IpAddr, Ipv6Addr, SocketAddr};

use axum::extract::Request;
use axum::http::HeaderMap;

use super::status::ApiError;

/// The listener that accepted a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Listener {
    /// A loopback address: programs on this machine.
    Loopback,
    /// Any other address, with TLS.
    Public,
    /// An address that only a proxy uses.
    Proxy,
}

/// The connection that a request came on.
#[derive(Debug, Clone, Copy)]
pub(super) struct Via {
    pub listener: Listener,
    /// Whether the connection is encrypted.
    pub is_secure: bool,
    /// Address of the other end.
    pub peer: IpAddr,
}

impl Via {
    pub fn new(listener: Listener, is_secure: bool, peer: SocketAddr) -> Via {
        Via {
            listener,
            is_secure,
            peer: peer.ip().to_canonical(),
        }
    }

    /// Returns the connection of a request. A request that came on none was made in this process.
    pub fn of(request: &Request) -> Via {
        request.extensions().get().copied().unwrap_or(Via {
            listener: Listener::Loopback,
            is_secure: false,
            peer: IpAddr::V6(Ipv6Addr::LOCALHOST),
        })
    }
}

/// The client behind the connection.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Client {
    pub listener: Listener,
    /// Address that limits are counted by.
    pub address: IpAddr,
    /// Whether a program on this machine sent the request itself.
    pub is_local: bool,
    /// Whether the client's connection is encrypted.
    pub is_secure: bool,
    /// The host that the client names, with its port.
    pub host: Option<String>,
}

impl Client {
    /// Returns the client of a request. Behind a proxy, its headers state the client; elsewhere they are ignored.
    ///
    /// # Errors
    /// A request on the proxy's address that did not come from a proxy.
    pub fn of(
        via: Via,
        headers: &HeaderMap,
        host: Option<&str>,
        proxies: &[IpAddr],
    ) -> Result<Client, ApiError> {
        let direct = Client {
            listener: via.listener,
            address: network(via.peer),
            is_local: via.peer.is_loopback(),
            is_secure: via.is_secure,
            host: host.map(str::to_owned),
        };
        if via.listener != Listener::Proxy {
            return Ok(direct);
        }
        let refused = |why: &str| {
            Err(ApiError::not_by_proxy(format!(
                "{why}; the daemon runs with --behind-proxy and answers its proxy here only. On the daemon's machine, \
                 commands use the address in daemon.json of the data folder"
            )))
        };
        let is_proxy = match proxies {
            [] => via.peer.is_loopback(),
            stated => stated.contains(&via.peer),
        };
        if !is_proxy {
            return refused(&format!("{} is not a proxy of server.proxies", via.peer));
        }
        // The last entry is the proxy's own; a client can send those before it.
        let Some(entry) = last_of(headers, "x-forwarded-for") else {
            return refused("the request has no X-Forwarded-For");
        };
        let Some(address) = address_of(entry) else {
            return refused("X-Forwarded-For is not the address of a client");
        };
        let is_secure = match last_of(headers, "x-forwarded-proto") {
            // A proxy is there for its TLS.
            Some("https") | None => true,
            Some("http") => false,
            Some(_) => return refused("X-Forwarded-Proto is neither https nor http"),
        };
        let stated = last_of(headers, "x-forwarded-host");
        Ok(Client {
            address: network(address),
            is_local: false,
            is_secure,
            host: stated.map(str::to_owned).or(direct.host),
            ..direct
        })
    }
}

/// Returns whether the headers of a proxy are there.
pub(super) fn is_forwarded(headers: &HeaderMap) -> bool {
    headers.contains_key("x-forwarded-for") || headers.contains_key("forwarded")
}

/// Returns the last entry of a header that is a list.
fn last_of<'h>(headers: &'h HeaderMap, name: &str) -> Option<&'h str> {
    let text = headers.get_all(name).iter().next_back()?.to_str().ok()?;
    text.rsplit(',').next().map(str::trim)
}

fn address_of(entry: &str) -> Option<IpAddr> {
    let address = match entry.parse::<IpAddr>() {
        Ok(address) => address,
        Err(_) => match entry.parse::<SocketAddr>() {
            Ok(with_port) => with_port.ip(),
            Err(_) => entry
                .strip_prefix('[')?
                .strip_suffix(']')?
                .parse::<IpAddr>()
                .ok()?,
        },
    };
    Some(address.to_canonical())
}

/// Returns what counts as one peer: an IPv4 address, or the network of 64 bits that one IPv6 host chooses its addresses from.
pub(super) fn network(address: IpAddr) -> IpAddr {
    match address.to_canonical() {
        IpAddr::V6(v6) if !v6.is_loopback() => {
            let [a, b, c, d, ..] = v6.segments();
            IpAddr::V6(Ipv6Addr::new(a, b, c, d, 0, 0, 0, 0))
        }
        other => other,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(fields: &[(&'static str, &str)]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for (name, value) in fields {
            headers.append(*name, value.parse().unwrap());
        }
        headers
    }

    fn by_proxy(peer: &str, fields: &[(&'static str, &str)]) -> Result<Client, ApiError> {
        let via = Via::new(Listener::Proxy, false, format!("{peer}:9").parse().unwrap());
        Client::of(via, &headers(fields), Some("lab:80"), &[])
    }

    #[test]
    fn only_the_entry_of_the_proxy_itself_is_believed() {
        let fields = [
            ("x-forwarded-for", "127.0.0.1, 10.0.0.7"),
            ("x-forwarded-for", "192.0.2.4"),
            ("x-forwarded-proto", "https"),
            ("x-forwarded-host", "lab.example"),
        ];
        let client = by_proxy("127.0.0.1", &fields).unwrap();
        assert_eq!(client.address, IpAddr::from([192, 0, 2, 4]));
        assert!(client.is_secure && !client.is_local);
        assert_eq!(client.host.as_deref(), Some("lab.example"));
        let only_for = by_proxy("127.0.0.1", &fields[1..2]).unwrap();
        assert!(only_for.is_secure && only_for.host.as_deref() == Some("lab:80"));
        let via = Via::new(Listener::Public, true, "10.0.0.5:9".parse().unwrap());
        let client = Client::of(via, &headers(&fields), Some("lab:80"), &[]).unwrap();
        assert_eq!(client.address, IpAddr::from([10, 0, 0, 5]));
        assert_eq!(client.host.as_deref(), Some("lab:80"));
    }

    #[test]
    fn a_request_that_did_not_come_from_a_proxy_is_refused() {
        let proto = ("x-forwarded-proto", "https");
        let client = ("x-forwarded-for", "192.0.2.4");
        for (peer, fields) in [
            ("127.0.0.1", &[][..]),
            ("127.0.0.1", &[proto]),
            ("127.0.0.1", &[("x-forwarded-for", "unknown"), proto]),
            ("127.0.0.1", &[client, ("x-forwarded-proto", "gopher")]),
            ("10.0.0.5", &[client, proto]),
        ] {
            assert!(by_proxy(peer, fields).is_err(), "{peer} {fields:?}");
        }
    }

    #[test]
    fn addresses_of_one_host_are_one_peer() {
        let network = |text: &str| network(text.parse().unwrap());
        assert_eq!(network("2001:db8:1:2::5"), network("2001:db8:1:2:9::7"));
        assert_ne!(network("2001:db8:1:2::5"), network("2001:db8:1:3::5"));
        assert_eq!(network("::ffff:10.0.0.5"), network("10.0.0.5"));
        assert_ne!(network("::1"), network("::2"));
        assert_eq!(address_of("[2001:db8::1]:443"), "2001:db8::1".parse().ok());
        assert_eq!(address_of("192.0.2.4:443"), "192.0.2.4".parse().ok());
    }
}
