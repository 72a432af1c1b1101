//! What a request needs: the words of the list in `routes`.

use axum::http::Method;

use crate::access::Role;

/// What a request needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Need {
    /// Nothing: the status alone, the page without data, and the login.
    Nothing,
    /// Any token; on this machine none.
    Stop,
    /// At least this role.
    Role(Role),
    /// The role operator, and that no other caller holds the rig.
    Rig,
}

impl Need {
    /// Returns the least role; none where a request without a token is answered.
    pub const fn role(self) -> Option<Role> {
        match self {
            Need::Nothing => None,
            Need::Stop => Some(Role::Viewer),
            Need::Role(role) => Some(role),
            Need::Rig => Some(Role::Operator),
        }
    }
}

/// Status, page and login, without a token.
pub(super) const OPEN: Need = Need::Nothing;
/// The stop of the rig.
pub(super) const STOP: Need = Need::Stop;
/// Reading.
pub(super) const READ: Need = Need::Role(Role::Viewer);
/// Calculations, and what they are made of.
pub(super) const COMPUTE: Need = Need::Role(Role::Analyst);
/// Work of a person at the rig that moves nothing.
pub(super) const OPERATE: Need = Need::Role(Role::Operator);
/// Whatever moves the rig or uses its camera.
pub(super) const RIG: Need = Need::Rig;
/// What a scan of another caller may wait for, although nothing moves: accepting other stages.
pub(super) const ADMIN: Need = Need::Role(Role::Admin);

/// A route: method, path, and what a request to it needs.
pub(super) type Route = (Method, String, Need);
