//! Secrets: 256 random bits as text, and their fingerprints.

use std::fmt;

use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use sha2::{Digest, Sha256};

/// Random bytes of a secret.
const BYTES: usize = 32;
/// Begins every secret, so that a scanner for leaked secrets can find one.
const PREFIX: &str = "ridged_";

/// A secret as its holder presents it. It is shown once, when it is made.
#[derive(Clone, PartialEq, Eq)]
pub struct Secret(String);

impl Secret {
    /// Returns a new secret from the random numbers of the operating system.
    ///
    /// # Errors
    /// The operating system provides no random numbers.
    pub fn random() -> std::io::Result<Secret> {
        let mut bytes = [0; BYTES];
        getrandom::fill(&mut bytes).map_err(|error| {
            std::io::Error::other(format!("the system provides no random numbers: {error}"))
        })?;
        Ok(Secret(format!("{PREFIX}{}", URL_SAFE_NO_PAD.encode(bytes))))
    }

    /// Returns the text, for its holder.
    #[must_use]
    pub fn reveal(&self) -> &str {
        &self.0
    }

    /// Returns the fingerprint, which is what is stored.
    #[must_use]
    pub fn fingerprint(&self) -> Fingerprint {
        Fingerprint::of(&self.0)
    }
}

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(not shown)")
    }
}

/// SHA-256 of a secret. It does not lead back to 256 random bits, so no slow hash is needed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Fingerprint([u8; BYTES]);

impl Fingerprint {
    /// Returns the fingerprint of a text that a client presents.
    #[must_use]
    pub fn of(presented: &str) -> Fingerprint {
        Fingerprint(Sha256::digest(presented.as_bytes()).into())
    }

    /// Returns the 64 hexadecimal digits.
    #[must_use]
    pub fn hex(&self) -> String {
        self.0.iter().map(|byte| format!("{byte:02x}")).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_secret_has_256_bits_differs_from_the_next_and_is_not_in_its_debug_form() {
        let (one, other) = (Secret::random().unwrap(), Secret::random().unwrap());
        assert_ne!(one, other);
        let text = one.reveal().strip_prefix(PREFIX).unwrap();
        assert_eq!(URL_SAFE_NO_PAD.decode(text).unwrap().len(), 32);
        assert!(!format!("{one:?}").contains(text));
        assert_eq!(one.fingerprint(), Fingerprint::of(one.reveal()));
        // `printf abc | sha256sum`
        assert!(Fingerprint::of("abc").hex().starts_with("ba7816bf8f01cfea"));
    }
}
