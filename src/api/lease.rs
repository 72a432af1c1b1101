//! `/lease`: one owner of the rig at a time.
//!
//! An order to the rig presents the lease in the header `Ridged-Lease`. While no client holds a lease, an order needs none,
//! and the rig is held by the caller whose scan or motion runs.

use std::time::Duration;

use axum::Json;
use axum::extract::{Extension, State};
use axum::http::{HeaderMap, HeaderValue};
use axum::response::IntoResponse;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::caller::{Caller, Principal};
use super::extract::Body;
use super::holder::HolderBody;
use super::need::Need;
use super::status::{self, ApiError, Problem};
use super::{App, Begun};
use crate::access::{Held, LeaseAnswer, LeaseTerms, Secret};
use crate::clock::{Clock, SystemClock};
use crate::store::utc_text;
use crate::wording::is_blank;

/// Path of the lease.
pub(super) const LEASE: &str = "/api/v1/lease";
/// Header that presents a lease.
pub(super) const LEASE_HEADER: &str = "ridged-lease";
/// Default and limits of the term of a lease.
const TERM_S: u64 = 600;
const TERM_S_MIN: u64 = 10;
const TERM_S_MAX: u64 = 86_400;
/// Longest name of a lease, in characters.
const NAME_LENGTH_MAX: usize = 100;

/// A lease to take.
#[derive(Debug, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct LeaseRequest {
    /// Name that others are shown, 1 to 100 characters.
    #[schema(min_length = 1, max_length = 100)]
    name: String,
    /// Seconds after its last use at which it expires, 10 to 86 400; 600 if omitted.
    #[serde(default)]
    #[schema(minimum = 10, maximum = 86400)]
    seconds: Option<u64>,
    /// Take it from the caller that holds it.
    #[serde(default)]
    take_over: bool,
}

/// A lease that was taken.
#[derive(Debug, Serialize, ToSchema)]
pub struct LeaseBody {
    /// The lease: send it as `Ridged-Lease` with every order. It is shown only now.
    id: String,
    /// Its name.
    name: String,
    /// Name of the caller.
    who: String,
    /// When it expires if it is not used, RFC 3339 in UTC. Every request that presents it renews it.
    expires_at: String,
    /// The caller from which it was taken; null if the rig was free.
    taken_from: Option<HolderBody>,
}

/// State of the lease.
#[derive(Debug, Serialize, ToSchema)]
pub struct LeaseStateBody {
    /// Who holds the rig; null if it is free.
    holder: Option<HolderBody>,
    /// Whether the request presents the lease that holds the rig.
    own: bool,
}

fn holder_of_lease(held: &Held) -> HolderBody {
    HolderBody {
        who: held.who.clone(),
        name: held.name.clone(),
        until: Some(expires_at(held.left)),
    }
}

fn expires_at(left: Duration) -> String {
    utc_text(SystemClock::new().utc() + left)
}

/// Returns the caller whose scan or motion runs; none if its token was revoked.
pub(super) fn user_of_rig(app: &App) -> Option<HolderBody> {
    let user = app.lab.rig_user()?;
    if app.access.is_revoked(&user.who) {
        return None;
    }
    Some(HolderBody {
        who: user.who,
        name: match user.scan_id {
            Some(scan_id) => format!("scan {scan_id}"),
            None => "a motion".to_owned(),
        },
        until: None,
    })
}

fn presented(value: Option<&HeaderValue>) -> Option<&str> {
    value.map(|value| value.to_str().unwrap_or_default())
}

/// Refuses an order to a rig that another caller holds, and renews the caller's own lease.
///
/// # Errors
/// A problem that names the holder, or that the lease has expired.
pub(super) fn check_lease(
    app: &App,
    need: Need,
    caller: &Principal,
    value: Option<&HeaderValue>,
) -> Result<(), ApiError> {
    let access = &app.access;
    let answer = access
        .lease()
        .check(presented(value), &caller.name, access.now());
    if need != Need::Rig {
        return Ok(());
    }
    match answer {
        LeaseAnswer::Own => Ok(()),
        LeaseAnswer::Held(held) => Err(ApiError::lease_held(holder_of_lease(&held))),
        LeaseAnswer::Lost => Err(ApiError::lease_lost()),
        LeaseAnswer::Free => match user_of_rig(app) {
            Some(user) if user.who != caller.name => Err(ApiError::lease_held(user)),
            _ => Ok(()),
        },
    }
}

/// Who holds the rig: the holder of the lease, or else the caller whose scan or motion runs.
#[utoipa::path(get, path = "/api/v1/lease", tag = "access", responses(
    (status = 200, description = "The holder, and until when", body = LeaseStateBody),
))]
pub(super) async fn get(
    State(app): State<App>,
    Extension(caller): Extension<Principal>,
    headers: HeaderMap,
) -> Json<LeaseStateBody> {
    let access = &app.access;
    let id = presented(headers.get(LEASE_HEADER));
    let own = access.lease().check(id, &caller.name, access.now()) == LeaseAnswer::Own;
    let held = access.lease().holder(access.now());
    Json(LeaseStateBody {
        holder: held
            .as_ref()
            .map(holder_of_lease)
            .or_else(|| user_of_rig(&app)),
        own,
    })
}

/// Take the lease of the rig, or change the terms of one's own (present it). While it lasts, only orders that present it are
/// accepted; reading and the stop need none.
#[utoipa::path(post, path = "/api/v1/lease", tag = "access", request_body = LeaseRequest, responses(
    (status = 201, description = "The lease", body = LeaseBody),
    (status = 409, description = "Another caller holds the rig (`lease-held`; `holder` says who, and until when): wait, or take it over", body = Problem),
    (status = 422, description = "A value is not valid", body = Problem),
))]
pub(super) async fn take(
    Caller(app): Caller,
    Extension(caller): Extension<Principal>,
    headers: HeaderMap,
    Body(request): Body<LeaseRequest>,
) -> Result<impl IntoResponse, ApiError> {
    let LeaseRequest {
        name,
        seconds,
        take_over,
    } = request;
    let length = name.trim().chars().count();
    if is_blank(&name) || length > NAME_LENGTH_MAX || name.chars().any(char::is_control) {
        let message = format!("must have 1 to {NAME_LENGTH_MAX} printable characters");
        return Err(ApiError::invalid("name", message));
    }
    let seconds = seconds.unwrap_or(TERM_S);
    if !(TERM_S_MIN..=TERM_S_MAX).contains(&seconds) {
        let message = format!("must be {TERM_S_MIN} to {TERM_S_MAX} s, got {seconds}");
        return Err(ApiError::invalid("seconds", message));
    }
    let terms = LeaseTerms {
        name: name.trim().to_owned(),
        term: Duration::from_secs(seconds),
        take_over,
    };
    let user = user_of_rig(&app).filter(|user| user.who != caller.name);
    if let Some(user) = &user
        && !take_over
        && app.access.lease().holder(app.access.now()).is_none()
    {
        return Err(ApiError::lease_held(user.clone()));
    }
    let secret = Secret::random().map_err(|error| {
        tracing::error!(%error, "no lease: {error}");
        ApiError::internal()
    })?;
    let access = &app.access;
    let id = presented(headers.get(LEASE_HEADER));
    let taken = access
        .lease()
        .take(&terms, &caller.name, id, secret, access.now());
    let (secret, before) = taken.map_err(|held| ApiError::lease_held(holder_of_lease(&held)))?;
    let taken_from = before.as_ref().map(holder_of_lease).or(user);
    let order = match &taken_from {
        Some(from) => format!(
            "lease `{}` taken over from {} ({})",
            terms.name, from.who, from.name
        ),
        None => format!("lease `{}` taken for {seconds} s", terms.name),
    };
    app.lab.record_order(order, None).await;
    Ok(status::made(LeaseBody {
        id: secret.reveal().to_owned(),
        name: terms.name,
        who: caller.name,
        expires_at: expires_at(terms.term),
        taken_from,
    }))
}

/// Return the lease that the request presents.
#[utoipa::path(delete, path = "/api/v1/lease", tag = "access", responses(
    (status = 200, description = "The rig is free", body = Begun),
    (status = 409, description = "The request does not present the lease of its caller (`lease-held`, `lease-lost`)", body = Problem),
))]
pub(super) async fn release(
    Caller(app): Caller,
    Extension(caller): Extension<Principal>,
    headers: HeaderMap,
) -> Result<Json<Begun>, ApiError> {
    let access = &app.access;
    let id = presented(headers.get(LEASE_HEADER));
    if !access.lease().release(id, &caller.name, access.now()) {
        return Err(match access.lease().holder(access.now()) {
            Some(held) => ApiError::lease_held(holder_of_lease(&held)),
            None => ApiError::lease_lost(),
        });
    }
    app.lab.record_order("lease returned", None).await;
    Ok(Json(Begun {
        id: None,
        state: "free".into(),
    }))
}
