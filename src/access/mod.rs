//! Who may do what: roles, tokens, sessions of the page, the lease of the rig, and the folders that an import may read.
//!
//! Nothing here knows HTTP. Time is an argument. A secret is stored and compared as its SHA-256, and its `Debug` form
//! does not show it.

mod guesses;
mod lease;
mod role;
mod roots;
mod secret;
mod sessions;
mod token_file;

pub use guesses::Guesses;
pub use lease::{Held, Lease, LeaseAnswer, LeaseTerms};
pub use role::Role;
pub use roots::Roots;
pub use secret::{Fingerprint, Secret};
pub use sessions::Sessions;
pub use token_file::{TOKENS_FILE, TokenFile, TokenFileError, TokenHolder, TokenRow};

/// Name of a caller on this machine that presents no token.
pub const LOCAL: &str = "local";
/// Name in events that the daemon itself causes.
pub const DAEMON: &str = "daemon";
