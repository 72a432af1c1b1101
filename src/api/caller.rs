//! Who sends a request.

use std::convert::Infallible;

use axum::extract::FromRequestParts;
use axum::http::request::Parts;

use super::App;
use crate::access::{LOCAL, Role};

/// How a caller proved who it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Proof {
    /// It is on this machine, where no token is needed.
    Place,
    /// The secret of the daemon's own user.
    Owner,
    /// A token.
    Token,
    /// A cookie, which a browser also sends with requests that another page causes.
    Cookie,
}

/// Who sent a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Principal {
    pub name: String,
    pub role: Role,
    pub proof: Proof,
}

impl Principal {
    /// Returns a caller on this machine that presents no token.
    pub fn local(proof: Proof) -> Principal {
        Principal {
            name: LOCAL.into(),
            role: Role::Admin,
            proof,
        }
    }
}

/// The state of a handler, whose lab acts for the caller.
pub(super) struct Caller(pub App);

impl FromRequestParts<App> for Caller {
    type Rejection = Infallible;

    async fn from_request_parts(parts: &mut Parts, app: &App) -> Result<Self, Infallible> {
        let who = parts.extensions.get::<Principal>();
        let who = who.map_or(LOCAL, |principal| principal.name.as_str());
        Ok(Caller(App {
            lab: app.lab.by(who),
            ..app.clone()
        }))
    }
}
