//! Authentication: finds out who sends a request, and whether the table allows it. This comes before any body is read.

use std::net::IpAddr;
use std::time::Duration;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::App;
use super::access::Access;
use super::caller::{Principal, Proof};
use super::lease::{LEASE_HEADER, check_lease};
use super::need::Need;
use super::origin;
use super::status::ApiError;
use super::table;
use super::via::{Client, Listener};
use crate::access::Fingerprint;

/// How long a refused guess is held back once a peer has presented too many.
const GUESS_WAIT: Duration = Duration::from_millis(200);

/// What a request presents.
enum Presented {
    Nothing,
    /// The credential is not valid.
    Wrong,
    Valid(Principal),
}

/// Name of the cookie. A browser accepts the first name only over TLS and from this host itself.
pub(super) fn cookie_name(is_secure: bool) -> &'static str {
    match is_secure {
        true => "__Host-ridged-session",
        false => "ridged-session",
    }
}

/// Returns the session that the cookies of a request name.
pub(super) fn session_of<'h>(headers: &'h HeaderMap, client: &Client) -> Option<&'h str> {
    let name = cookie_name(client.is_secure);
    let lines = headers.get_all(header::COOKIE).iter();
    lines
        .filter_map(|line| line.to_str().ok())
        .flat_map(|line| line.split(';'))
        .filter_map(|pair| pair.trim().split_once('='))
        .find_map(|(key, value)| (key == name).then_some(value))
}

fn presented(access: &Access, headers: &HeaderMap, client: &Client) -> Presented {
    if let Some(value) = headers.get(header::AUTHORIZATION) {
        let text = value.to_str().unwrap_or_default();
        let token = match text.split_once(' ') {
            Some((scheme, token)) if scheme.eq_ignore_ascii_case("bearer") => token.trim(),
            _ => return Presented::Wrong,
        };
        let is_owner = access.owner == Some(Fingerprint::of(token));
        if is_owner && client.is_local {
            return Presented::Valid(Principal::local(Proof::Owner));
        }
        return match access.tokens.holder(token) {
            Some(holder) => Presented::Valid(Principal {
                name: holder.name,
                role: holder.role,
                proof: Proof::Token,
            }),
            None => Presented::Wrong,
        };
    }
    let Some(session) = session_of(headers, client) else {
        return Presented::Nothing;
    };
    let token = access.sessions.token_of(session, access.now());
    match token.and_then(|name| access.tokens.named(&name)) {
        Some(holder) => Presented::Valid(Principal {
            name: holder.name,
            role: holder.role,
            proof: Proof::Cookie,
        }),
        // A session ends with the daemon: its cookie is not a guess.
        None => Presented::Nothing,
    }
}

/// Refuses a wrong token. A peer that presented too many waits.
pub(super) async fn refuse_guess(access: &Access, peer: IpAddr) -> ApiError {
    match access.guesses.wrong(peer, access.now()) {
        None => ApiError::wrong_token(),
        Some(wait) => {
            tracing::warn!(%peer, "{peer} presents one wrong token after the other");
            tokio::time::sleep(GUESS_WAIT).await;
            ApiError::too_many_guesses(wait)
        }
    }
}

/// Returns the caller of a request, if the table allows the request.
async fn caller(
    app: &App,
    need: Need,
    method: &Method,
    headers: &HeaderMap,
    client: &Client,
) -> Result<Option<Principal>, ApiError> {
    let access = &app.access;
    let here = Principal::local(Proof::Place);
    let stops_here = need == Need::Stop && client.is_local;
    let needs_no_token =
        client.listener == Listener::Loopback && client.is_local && !access.loopback_needs_token;
    let principal = match presented(access, headers, client) {
        Presented::Valid(principal) => Some(principal),
        // Nothing refuses a stop on this machine.
        Presented::Wrong | Presented::Nothing if stops_here => Some(here),
        Presented::Wrong if need == Need::Nothing => None,
        Presented::Wrong => return Err(refuse_guess(access, client.address).await),
        Presented::Nothing if needs_no_token => Some(here),
        Presented::Nothing => None,
    };
    if let Some(role) = need.role() {
        let principal = principal.as_ref().ok_or_else(ApiError::no_token)?;
        if principal.role < role {
            return Err(ApiError::role_too_low(
                &principal.name,
                principal.role,
                role,
            ));
        }
    }
    if let Some(principal) = &principal {
        origin::check_write(method, headers, client, principal.proof)?;
        check_lease(app, need, principal, headers.get(LEASE_HEADER))?;
    }
    Ok(principal)
}

/// Finds out who sends a request, and refuses it if the table does not allow it.
pub(super) async fn authenticate(
    State(app): State<App>,
    mut request: Request,
    next: Next,
) -> Response {
    let Some(client) = request.extensions().get::<Client>().cloned() else {
        return ApiError::internal().into_response();
    };
    let route = request.extensions().get::<MatchedPath>();
    let route = route.map(MatchedPath::as_str);
    let (method, headers) = (request.method(), request.headers());
    let need = table::need_of(method, route, request.uri().path());
    match caller(&app, need, method, headers, &client).await {
        Ok(principal) => {
            if let Some(principal) = principal {
                request.extensions_mut().insert(principal);
            }
            next.run(request).await
        }
        // The body is not read: the connection ends with the answer.
        Err(problem) => problem.into_response(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_is_read_from_its_own_cookie_only() {
        let mut client = Client {
            listener: Listener::Public,
            address: [10, 0, 0, 1].into(),
            is_local: false,
            is_secure: true,
            host: None,
        };
        let mut headers = HeaderMap::new();
        let line = "a=1; ridged-session=plain; __Host-ridged-session=safe";
        headers.insert(header::COOKIE, line.parse().unwrap());
        assert_eq!(session_of(&headers, &client), Some("safe"));
        client.is_secure = false;
        assert_eq!(session_of(&headers, &client), Some("plain"));
        headers.clear();
        assert_eq!(session_of(&headers, &client), None);
    }
}
