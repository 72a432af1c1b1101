//! `/session`: who is logged in, login and logout of the page.
//!
//! A browser sends no header of its own with images and event streams, so the page exchanges a token for a cookie.

use axum::Json;
use axum::extract::{Extension, State};
use axum::http::{HeaderMap, header};
use axum::response::{AppendHeaders, IntoResponse};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::App;
use super::authentication::{cookie_name, refuse_guess, session_of};
use super::caller::{Principal, Proof};
use super::extract::Body;
use super::status::{ApiError, Problem};
use super::via::Client;
use crate::access::Role;

/// Path of the session.
pub(super) const SESSION: &str = "/api/v1/session";

/// A login.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LoginRequest {
    /// The token that `ridged token create` printed.
    #[schema(max_length = 4000)]
    token: String,
}

/// Who sends requests.
#[derive(Debug, Serialize, ToSchema)]
pub struct SessionBody {
    /// Name of the token; `local` for a caller on the daemon's machine without one.
    who: String,
    /// What this caller may do.
    role: Role,
    /// Whether a login made this session, so that a logout ends it.
    logged_in: bool,
}

impl From<Principal> for SessionBody {
    fn from(principal: Principal) -> Self {
        SessionBody {
            who: principal.name,
            role: principal.role,
            logged_in: principal.proof == Proof::Cookie,
        }
    }
}

/// Who sends this request.
#[utoipa::path(get, path = "/api/v1/session", tag = "access", responses(
    (status = 200, description = "Name and role", body = SessionBody),
))]
pub(super) async fn get(Extension(principal): Extension<Principal>) -> Json<SessionBody> {
    Json(principal.into())
}

/// Log in with a token. The answer sets a cookie, which stands for the token until it is not used for a day, the daemon ends,
/// or a logout. For pages; a program sends `Authorization: Bearer TOKEN`.
#[utoipa::path(post, path = "/api/v1/session", tag = "access", request_body = LoginRequest, responses(
    (status = 200, description = "Logged in", body = SessionBody, headers(("Set-Cookie" = String, description = "The session"))),
    (status = 401, description = "The token is not valid", body = Problem),
    (status = 429, description = "Too many wrong tokens", body = Problem),
))]
pub(super) async fn login(
    State(app): State<App>,
    Extension(client): Extension<Client>,
    Body(request): Body<LoginRequest>,
) -> Result<impl IntoResponse, ApiError> {
    let access = &app.access;
    let Some(holder) = access.tokens.holder(request.token.trim()) else {
        return Err(refuse_guess(access, client.address).await);
    };
    let session = access.sessions.open(&holder.name, access.now());
    let session = session.map_err(|error| {
        tracing::error!(%error, "a session could not be opened: {error}");
        ApiError::internal()
    })?;
    tracing::info!(who = holder.name, "{} has logged in", holder.name);
    let body = SessionBody {
        who: holder.name,
        role: holder.role,
        logged_in: true,
    };
    Ok((cookie(&client, session.reveal(), None), Json(body)))
}

/// Log out: end the session of the cookie.
#[utoipa::path(delete, path = "/api/v1/session", tag = "access", responses(
    (status = 200, description = "There is no session (any more)", body = super::Begun),
))]
pub(super) async fn logout(
    State(app): State<App>,
    Extension(client): Extension<Client>,
    headers: HeaderMap,
) -> impl IntoResponse {
    if let Some(session) = session_of(&headers, &client) {
        app.access.sessions.close(session);
    }
    let body = super::Begun {
        id: None,
        state: "logged-out".into(),
    };
    (cookie(&client, "", Some(0)), Json(body))
}

type Cookie = AppendHeaders<[(header::HeaderName, String); 1]>;

fn cookie(client: &Client, value: &str, max_age_s: Option<u32>) -> Cookie {
    let name = cookie_name(client.is_secure);
    let mut text = format!("{name}={value}; Path=/; HttpOnly; SameSite=Strict");
    if client.is_secure {
        text.push_str("; Secure");
    }
    if let Some(seconds) = max_age_s {
        text.push_str(&format!("; Max-Age={seconds}"));
    }
    AppendHeaders([(header::SET_COOKIE, text)])
}
