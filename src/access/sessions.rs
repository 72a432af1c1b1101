//! Sessions of the page: a cookie stands for a token, so that the browser does not keep the token itself.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::secret::{Fingerprint, Secret};

/// A session ends after this time without a request.
const IDLE: Duration = Duration::from_secs(24 * 3600);
/// Most sessions of one token; the one that was used least recently ends.
const PER_TOKEN: usize = 16;

/// All sessions of this process. A restart ends them.
#[derive(Debug, Default)]
pub struct Sessions(Mutex<HashMap<Fingerprint, Session>>);

#[derive(Debug)]
struct Session {
    token: String,
    used: Duration,
}

impl Sessions {
    fn all(&self) -> MutexGuard<'_, HashMap<Fingerprint, Session>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Opens a session for the token of this name.
    ///
    /// # Errors
    /// The system provides no random numbers.
    pub fn open(&self, token: &str, now: Duration) -> std::io::Result<Secret> {
        let secret = Secret::random()?;
        let mut all = self.all();
        all.retain(|_, session| now < session.used + IDLE);
        let of_token = |all: &HashMap<Fingerprint, Session>| {
            let own = all.iter().filter(|(_, session)| session.token == token);
            own.map(|(id, session)| (session.used, *id))
                .collect::<Vec<_>>()
        };
        let own = of_token(&all);
        if own.len() >= PER_TOKEN
            && let Some((_, oldest)) = own.into_iter().min_by_key(|(used, _)| *used)
        {
            all.remove(&oldest);
        }
        let session = Session {
            token: token.to_owned(),
            used: now,
        };
        all.insert(secret.fingerprint(), session);
        Ok(secret)
    }

    /// Returns the name of the token behind a session, and counts this as its use.
    #[must_use]
    pub fn token_of(&self, presented: &str, now: Duration) -> Option<String> {
        let mut all = self.all();
        let session = all.get_mut(&Fingerprint::of(presented))?;
        if now >= session.used + IDLE {
            return None;
        }
        session.used = now;
        Some(session.token.clone())
    }

    /// Ends a session.
    pub fn close(&self, presented: &str) {
        self.all().remove(&Fingerprint::of(presented));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_ends_when_it_is_closed_or_not_used() {
        let sessions = Sessions::default();
        let start = Duration::from_secs(7);
        let one = sessions.open("anna", start).unwrap();
        let of = |secret: &Secret, now| sessions.token_of(secret.reveal(), now);
        assert_eq!(of(&one, start + IDLE / 2), Some("anna".into()));
        assert_eq!(of(&one, start + IDLE), Some("anna".into()));
        assert_eq!(of(&one, start + 2 * IDLE), None);
        let two = sessions.open("anna", start).unwrap();
        sessions.close(two.reveal());
        assert_eq!(of(&two, start), None);
        assert_eq!(sessions.token_of("ridged_anna", start), None);
    }

    #[test]
    fn a_token_has_a_bounded_number_of_sessions() {
        let sessions = Sessions::default();
        let at = |s: u64| Duration::from_secs(s);
        let first = sessions.open("anna", at(0)).unwrap();
        let other = sessions.open("bert", at(0)).unwrap();
        for s in 1..=PER_TOKEN as u64 {
            sessions.open("anna", at(s)).unwrap();
        }
        assert_eq!(sessions.token_of(first.reveal(), at(20)), None);
        assert!(sessions.token_of(other.reveal(), at(20)).is_some());
        assert_eq!(sessions.all().len(), PER_TOKEN + 1);
    }
}
