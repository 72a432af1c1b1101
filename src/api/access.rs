//! Who may use the interface: the tokens, the sessions and the lease, and what the settings say.

use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use super::caller::{Principal, Proof};
use crate::access::{DAEMON, Fingerprint, Guesses, LOCAL, Lease, Roots, Sessions, TokenFile};

/// Who may use the interface, and from where.
#[derive(Debug)]
pub struct Access {
    pub(super) tokens: TokenFile,
    pub(super) sessions: Sessions,
    lease: Lease,
    pub(super) guesses: Guesses,
    pub(super) roots: Roots,
    /// Whether a loopback address needs a token, too.
    pub(super) loopback_needs_token: bool,
    /// Names of this machine that a client may use, beside addresses.
    pub(super) hosts: Vec<String>,
    /// Whether the settings state these names.
    pub(super) has_stated_hosts: bool,
    /// Addresses of the proxies; none stands for this machine.
    pub(super) proxies: Vec<IpAddr>,
    /// The secret of the daemon's own user, for the command line.
    pub(super) owner: Option<Fingerprint>,
    started: Instant,
}

impl Access {
    /// Returns the access to the daemon of a data folder: loopback needs no token, and imports read the data folder only.
    #[must_use]
    pub fn of_folder(folder: &Path) -> Access {
        Access {
            tokens: TokenFile::of_folder(folder),
            sessions: Sessions::default(),
            lease: Lease::default(),
            guesses: Guesses::default(),
            roots: Roots::new([folder.to_owned()]),
            loopback_needs_token: false,
            hosts: Vec::new(),
            has_stated_hosts: false,
            proxies: Vec::new(),
            owner: None,
            started: Instant::now(),
        }
    }

    /// Lets imports read these folders.
    #[must_use]
    pub fn with_import_roots(self, roots: Vec<PathBuf>) -> Access {
        Access {
            roots: Roots::new(roots),
            ..self
        }
    }

    /// Asks for a token on loopback addresses, too.
    #[must_use]
    pub fn with_tokens_on_loopback(self, needed: bool) -> Access {
        Access {
            loopback_needs_token: needed,
            ..self
        }
    }

    /// Answers requests that name these hosts, and no other name.
    #[must_use]
    pub fn with_hosts(self, hosts: Vec<String>) -> Access {
        Access {
            hosts,
            has_stated_hosts: true,
            ..self
        }
    }

    /// Answers requests that name this machine.
    #[must_use]
    pub fn with_name_of_machine(self, name: Option<String>) -> Access {
        Access {
            hosts: name.into_iter().collect(),
            ..self
        }
    }

    /// Believes the headers of these proxies.
    #[must_use]
    pub fn with_proxies(self, proxies: Vec<IpAddr>) -> Access {
        let proxies = proxies.iter().map(IpAddr::to_canonical).collect();
        Access { proxies, ..self }
    }

    /// Accepts the secret of the daemon's own user on loopback.
    #[must_use]
    pub fn with_owner(self, secret: Fingerprint) -> Access {
        Access {
            owner: Some(secret),
            ..self
        }
    }

    /// Returns whether a caller that was let in would be let in again: a token may be revoked during a long answer.
    pub(super) fn is_still_valid(&self, caller: &Principal) -> bool {
        match caller.proof {
            Proof::Place | Proof::Owner => true,
            Proof::Token | Proof::Cookie => self.tokens.named(&caller.name).is_some(),
        }
    }

    /// Returns the lease of the rig. It ends with the token of its holder.
    pub(super) fn lease(&self) -> &Lease {
        self.lease.end_of(|who| self.is_revoked(who));
        &self.lease
    }

    /// Returns whether a caller is one whose token was revoked.
    pub(super) fn is_revoked(&self, who: &str) -> bool {
        ![LOCAL, DAEMON].contains(&who) && self.tokens.named(who).is_none()
    }

    /// Returns the time since the daemon started, which sessions and the lease count.
    pub(super) fn now(&self) -> Duration {
        self.started.elapsed()
    }
}
