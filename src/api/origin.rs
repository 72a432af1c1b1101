//! Which host a request may name and which page it may come from.
//!
//! A browser sends requests that another page causes (cross-site requests), and a page may resolve its own name to the
//! address of this machine (DNS rebinding). Therefore every request must name a host that is this machine's own, a request
//! with an `Origin` must come from that host, and a write that a cookie authenticates must show that it comes from the page.

use std::net::IpAddr;

use axum::extract::{Request, State};
use axum::http::{HeaderMap, Method, Version, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::App;
use super::access::Access;
use super::caller::Proof;
use super::guard::is_stop;
use super::status::ApiError;
use super::via::{Client, Listener, Via, is_forwarded};

/// Shows that a program, and not a form of another page, sent a request: a browser lets no other page set it.
pub(super) const OWN_HEADER: &str = "ridged-request";

/// Finds the client of a request, and refuses requests for other hosts and from other pages.
pub(super) async fn same_machine_same_page(
    State(app): State<App>,
    mut request: Request,
    next: Next,
) -> Response {
    match checked(&app, &request) {
        Ok(client) => {
            request.extensions_mut().insert(client);
            next.run(request).await
        }
        Err(problem) => problem.into_response(),
    }
}

fn checked(app: &App, request: &Request) -> Result<Client, ApiError> {
    let mut via = Via::of(request);
    let headers = request.headers();
    // The stop on this machine needs no proxy.
    if via.listener == Listener::Proxy && is_stop(request) && !is_forwarded(headers) {
        via.listener = Listener::Loopback;
    }
    let host = match (text(headers, header::HOST), request.uri().host()) {
        (Some(host), _) => Some(host),
        (None, Some(host)) if request.version() >= Version::HTTP_2 => Some(host),
        _ => None,
    };
    let client = Client::of(via, headers, host, &app.access.proxies)?;
    check_origin(headers, &client, &app.access)?;
    // Following a link of another site shows an answer to the user only, and sends no cookie.
    let is_link = request.method() == Method::GET
        && text(headers, "sec-fetch-mode") == Some("navigate")
        && text(headers, "sec-fetch-dest") == Some("document");
    if !is_link && is_cross_site(headers) {
        return Err(ApiError::forbidden_origin(
            "another site's page caused the request; only the daemon's own page may send requests",
        ));
    }
    Ok(client)
}

fn text(headers: &HeaderMap, name: impl header::AsHeaderName) -> Option<&str> {
    headers.get(name).map(|v| v.to_str().unwrap_or("?"))
}

/// Returns whether a browser says that another site's page caused the request.
fn is_cross_site(headers: &HeaderMap) -> bool {
    matches!(
        text(headers, "sec-fetch-site"),
        Some("cross-site" | "same-site")
    )
}

fn check_origin(headers: &HeaderMap, client: &Client, access: &Access) -> Result<(), ApiError> {
    let Some(host) = client.host.as_deref() else {
        return Err(forbidden_host(client, "the request names no host"));
    };
    if !is_own(host, client.listener, access) {
        return Err(forbidden_host(
            client,
            &format!("`{host}` is not this machine"),
        ));
    }
    let scheme = if client.is_secure { "https" } else { "http" };
    if let Some(origin) = text(headers, header::ORIGIN)
        && origin != format!("{scheme}://{host}")
    {
        return Err(ApiError::forbidden_origin(format!(
            "the request comes from a page of {origin}; only the daemon's own page may send requests"
        )));
    }
    Ok(())
}

fn forbidden_host(client: &Client, why: &str) -> ApiError {
    ApiError::forbidden_host(match client.listener {
        Listener::Loopback => format!(
            "{why}; use http://127.0.0.1, http://localhost or http://[::1] with the daemon's port"
        ),
        Listener::Public | Listener::Proxy => {
            format!("{why}; use its address, or add the name to server.hosts in the settings")
        }
    })
}

/// Returns whether `host` (with or without port) is this machine's own. No page can make a browser send another address than
/// that of the page, so an address is safe; a name is safe if the settings state it. Behind a proxy, which serves names of its
/// own, every name is accepted unless the settings state them: all its clients need a token.
fn is_own(host: &str, listener: Listener, access: &Access) -> bool {
    let name = match host.strip_prefix('[') {
        Some(v6) => v6.split(']').next().unwrap_or_default(),
        None => host.rsplit_once(':').map_or(host, |(name, _)| name),
    };
    if name.eq_ignore_ascii_case("localhost") {
        return true;
    }
    match (name.parse::<IpAddr>(), listener) {
        (Ok(ip), Listener::Loopback) => ip.is_loopback(),
        (Ok(_), Listener::Public | Listener::Proxy) => true,
        (Err(_), Listener::Loopback) => false,
        (Err(_), Listener::Proxy) if !access.has_stated_hosts => !name.is_empty(),
        (Err(_), Listener::Public | Listener::Proxy) => {
            let mut hosts = access.hosts.iter();
            hosts.any(|known| known.eq_ignore_ascii_case(name))
        }
    }
}

/// Refuses a write that a cookie authenticates, unless it shows that it comes from the daemon's own page.
pub(super) fn check_write(
    method: &Method,
    headers: &HeaderMap,
    client: &Client,
    proof: Proof,
) -> Result<(), ApiError> {
    let reads = matches!(*method, Method::GET | Method::HEAD | Method::OPTIONS);
    if reads || proof != Proof::Cookie {
        return Ok(());
    }
    // An `Origin` of another host was refused before.
    let from_page = headers.contains_key(header::ORIGIN)
        || text(headers, "sec-fetch-site") == Some("same-origin")
        || headers.contains_key(OWN_HEADER);
    match from_page {
        true => Ok(()),
        false => Err(ApiError::forbidden_origin(format!(
            "the cookie alone does not show that the daemon's own page ({}) sent the request; send `Origin`, or \
             `Authorization: Bearer TOKEN` instead of the cookie",
            client.host.as_deref().unwrap_or("?")
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn client(host: &str, listener: Listener) -> Client {
        Client {
            listener,
            address: [127, 0, 0, 1].into(),
            is_local: true,
            is_secure: listener == Listener::Public,
            host: (!host.is_empty()).then(|| host.to_owned()),
        }
    }

    fn headers(fields: &[(&'static str, &str)]) -> HeaderMap {
        let mut headers = HeaderMap::new();
        for (name, value) in fields {
            headers.append(*name, value.parse().unwrap());
        }
        headers
    }

    fn passes(host: &str, origin: Option<&str>, listener: Listener) -> bool {
        let fields: Vec<_> = origin
            .map(|origin| ("origin", origin))
            .into_iter()
            .collect();
        let access = Access::of_folder("data".as_ref()).with_hosts(vec!["lab-pc".into()]);
        check_origin(&headers(&fields), &client(host, listener), &access).is_ok()
    }

    #[test]
    fn only_loopback_hosts_pass_on_loopback() {
        for host in [
            "127.0.0.1:8787",
            "localhost:1",
            "LOCALHOST",
            "[::1]:8787",
            "127.9.9.9",
        ] {
            assert!(passes(host, None, Listener::Loopback), "{host}");
        }
        for host in [
            "lab-pc",
            "127.0.0.1.nip.io:8787",
            "192.168.0.4:8787",
            "localhost.evil.example",
            "[fe80::1]:8787",
            "",
        ] {
            assert!(!passes(host, None, Listener::Loopback), "{host}");
        }
    }

    #[test]
    fn beyond_loopback_only_addresses_and_stated_names_pass() {
        for listener in [Listener::Public, Listener::Proxy] {
            for host in ["192.168.0.4:8787", "lab-pc:8787", "LAB-PC", "[fe80::1]:1"] {
                assert!(passes(host, None, listener), "{host}");
            }
            for host in ["evil.example", "lab-pc.evil.example:8787", "", "lab-pc."] {
                assert!(!passes(host, None, listener), "{host}");
            }
        }
    }

    #[test]
    fn a_proxy_decides_which_names_it_serves_unless_the_settings_do() {
        let access = Access::of_folder("data".as_ref()).with_name_of_machine(Some("lab-pc".into()));
        let passes = |host: &str, listener| {
            check_origin(&HeaderMap::new(), &client(host, listener), &access).is_ok()
        };
        assert!(passes("rig.example.org", Listener::Proxy));
        assert!(!passes("", Listener::Proxy));
        assert!(passes("lab-pc:8787", Listener::Public));
        assert!(!passes("rig.example.org", Listener::Public));
    }

    #[test]
    fn only_the_own_page_is_an_origin() {
        let own = "http://127.0.0.1:8787";
        assert!(passes("127.0.0.1:8787", Some(own), Listener::Loopback));
        for origin in [
            "http://127.0.0.1:5173",
            "http://localhost:8787",
            "https://127.0.0.1:8787",
            "https://evil.example",
            "null",
        ] {
            let passes = passes("127.0.0.1:8787", Some(origin), Listener::Loopback);
            assert!(!passes, "{origin}");
        }
        assert!(passes(
            "lab-pc:1",
            Some("https://lab-pc:1"),
            Listener::Public
        ));
        assert!(!passes(
            "lab-pc:1",
            Some("http://lab-pc:1"),
            Listener::Public
        ));
    }

    #[test]
    fn a_cookie_alone_writes_nothing() {
        let client = client("lab-pc", Listener::Public);
        let passes = |method: Method, fields: &[(&'static str, &str)], proof| {
            check_write(&method, &headers(fields), &client, proof).is_ok()
        };
        assert!(!passes(Method::POST, &[], Proof::Cookie));
        assert!(!passes(Method::DELETE, &[], Proof::Cookie));
        assert!(!passes(
            Method::POST,
            &[("sec-fetch-site", "none")],
            Proof::Cookie
        ));
        assert!(passes(Method::GET, &[], Proof::Cookie));
        assert!(passes(Method::POST, &[], Proof::Token));
        for field in [
            ("origin", "https://lab-pc"),
            ("sec-fetch-site", "same-origin"),
            (OWN_HEADER, "1"),
        ] {
            assert!(passes(Method::POST, &[field], Proof::Cookie), "{field:?}");
        }
    }
}
