//! Problems of access: who sends a request, who holds the rig, and what one peer may take.

use std::time::Duration;

use super::ApiError;
use crate::access::Role;
use crate::api::holder::HolderBody;

impl ApiError {
    /// A request on the address of a proxy that did not come from it.
    pub(in crate::api) fn not_by_proxy(detail: impl Into<String>) -> Self {
        let title = "the request did not come through the proxy";
        ApiError::forbidden("not-by-proxy", title, detail)
    }

    /// A request without a token, where one is needed.
    pub(in crate::api) fn no_token() -> Self {
        ApiError::unauthorized(
            "no-token",
            "a token is needed",
            "send `Authorization: Bearer TOKEN`, or log in on the page; `ridged token create` on the daemon's machine makes a \
             token",
        )
    }

    /// A token that is not valid.
    pub(in crate::api) fn wrong_token() -> Self {
        ApiError::unauthorized(
            "wrong-token",
            "the token is not valid",
            "the token is not valid, or was revoked; `ridged token list` on the daemon's machine shows the valid ones",
        )
    }

    /// Too many tokens that are not valid.
    pub(in crate::api) fn too_many_guesses(wait: Duration) -> Self {
        let title = "too many wrong tokens";
        let detail = format!(
            "too many wrong tokens came from this address; try again in {} s",
            wait.as_secs() + 1
        );
        ApiError {
            retry_after: Some(wait),
            ..ApiError::too_many("too-many-guesses", title, detail)
        }
    }

    /// A caller whose role does not allow the request.
    pub(in crate::api) fn role_too_low(name: &str, role: Role, needed: Role) -> Self {
        ApiError::forbidden(
            "role-too-low",
            "the role does not allow this",
            format!(
                "the token `{name}` has the role {role}, and this needs the role {needed}; use another token \
                 (`ridged token create NAME --role {needed}` on the daemon's machine)"
            ),
        )
    }

    /// An order to a rig that another caller holds.
    pub(in crate::api) fn lease_held(holder: HolderBody) -> Self {
        let until = match &holder.until {
            Some(until) => format!("until {until}, or longer if it is used"),
            None => "until its end".to_owned(),
        };
        let detail = format!(
            "{} holds the rig ({}) {until}; wait, or take the rig over (`take_over` of POST /api/v1/lease, \
             `ridged rig lease take --take-over`, or the page). If the lease is yours, give it to the command (`--lease`, \
             RIDGED_LEASE). Stop is always allowed",
            holder.who, holder.name
        );
        let title = "another caller holds the rig";
        ApiError {
            holder: Some(Box::new(holder)),
            ..ApiError::conflict("lease-held", title, detail)
        }
    }

    /// An order with a lease that has ended.
    pub(in crate::api) fn lease_lost() -> Self {
        ApiError::conflict(
            "lease-lost",
            "the lease has ended",
            "the request presents no lease that lasts: it has expired, was taken over, or ended with the daemon, or the header \
             `Ridged-Lease` is missing; take a new one (POST /api/v1/lease), or send the order without one",
        )
    }

    /// Too many event streams of one peer, or of all.
    pub(in crate::api) fn too_many_streams() -> Self {
        ApiError::too_many(
            "too-many-streams",
            "too many event streams",
            "too many event streams are open from this address, or in all; close some of them",
        )
    }

    /// Too many bodies in progress of one peer, or of all.
    pub(in crate::api) fn too_many_bodies() -> Self {
        ApiError::too_many(
            "too-many-bodies",
            "too many bodies at a time",
            "too many large bodies are in progress from this address, or in all; send them one after the other",
        )
    }
}
