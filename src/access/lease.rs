//! The lease of the rig: one holder at a time, for a stated time, renewed by use.
//!
//! A lease is a secret of its holder. It belongs to one caller: the secret alone does not help another one. Reading and
//! the stop need no lease.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use super::secret::{Fingerprint, Secret};

/// What a client asks for.
#[derive(Debug, Clone, PartialEq)]
pub struct LeaseTerms {
    /// Name that others are shown.
    pub name: String,
    /// How long it lasts after its last use.
    pub term: Duration,
    /// Take it from its holder.
    pub take_over: bool,
}

/// Who holds the lease.
#[derive(Debug, Clone, PartialEq)]
pub struct Held {
    /// Name of the lease.
    pub name: String,
    /// The caller that took it.
    pub who: String,
    /// Time until it expires if it is not used.
    pub left: Duration,
}

/// What an order finds.
#[derive(Debug, Clone, PartialEq)]
pub enum LeaseAnswer {
    /// No client holds a lease, and the caller presents none.
    Free,
    /// The caller holds it; it is renewed.
    Own,
    /// Another client holds it, or the caller did not present it.
    Held(Held),
    /// The caller presents a lease that has expired or was taken over, and no client holds one.
    Lost,
}

#[derive(Debug)]
struct Current {
    id: Fingerprint,
    name: String,
    who: String,
    term: Duration,
    until: Duration,
}

impl Current {
    fn held(&self, now: Duration) -> Held {
        Held {
            name: self.name.clone(),
            who: self.who.clone(),
            left: self.until.saturating_sub(now),
        }
    }

    fn is_of(&self, presented: Option<&str>, who: &str) -> bool {
        self.who == who && presented.is_some_and(|id| Fingerprint::of(id) == self.id)
    }
}

/// The lease of one rig. A restart of the daemon ends it.
#[derive(Debug, Default)]
pub struct Lease(Mutex<Option<Current>>);

impl Lease {
    fn current(&self, now: Duration) -> MutexGuard<'_, Option<Current>> {
        let mut current = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if current.as_ref().is_some_and(|lease| lease.until <= now) {
            *current = None;
        }
        current
    }

    /// Ends the lease of a holder that is let in no more.
    pub fn end_of(&self, is_revoked: impl Fn(&str) -> bool) {
        let mut current = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if current.as_ref().is_some_and(|lease| is_revoked(&lease.who)) {
            *current = None;
        }
    }

    /// Returns the holder.
    #[must_use]
    pub fn holder(&self, now: Duration) -> Option<Held> {
        self.current(now).as_ref().map(|lease| lease.held(now))
    }

    /// Takes the lease. Returns its secret and from whom it was taken, or its holder.
    ///
    /// # Errors
    /// The holder, if another client holds it and the terms do not say to take it over.
    pub fn take(
        &self,
        terms: &LeaseTerms,
        who: &str,
        presented: Option<&str>,
        secret: Secret,
        now: Duration,
    ) -> Result<(Secret, Option<Held>), Held> {
        let mut current = self.current(now);
        let before = current
            .as_ref()
            .filter(|lease| !lease.is_of(presented, who));
        let before = before.map(|lease| lease.held(now));
        if let Some(holder) = &before
            && !terms.take_over
        {
            return Err(holder.clone());
        }
        *current = Some(Current {
            id: secret.fingerprint(),
            name: terms.name.clone(),
            who: who.to_owned(),
            term: terms.term,
            until: now + terms.term,
        });
        Ok((secret, before))
    }

    /// Returns what the lease says about a request of `who` that presents a lease or none, and renews the caller's own.
    #[must_use]
    pub fn check(&self, presented: Option<&str>, who: &str, now: Duration) -> LeaseAnswer {
        match (self.current(now).as_mut(), presented) {
            (Some(lease), _) if lease.is_of(presented, who) => {
                lease.until = now + lease.term;
                LeaseAnswer::Own
            }
            (Some(lease), _) => LeaseAnswer::Held(lease.held(now)),
            (None, Some(_)) => LeaseAnswer::Lost,
            (None, None) => LeaseAnswer::Free,
        }
    }

    /// Gives the lease back. Returns whether it was the caller's.
    #[must_use]
    pub fn release(&self, presented: Option<&str>, who: &str, now: Duration) -> bool {
        let mut current = self.current(now);
        let is_own = current
            .as_ref()
            .is_some_and(|lease| lease.is_of(presented, who));
        if is_own {
            *current = None;
        }
        is_own
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TERM: Duration = Duration::from_secs(600);

    fn terms(name: &str, take_over: bool) -> LeaseTerms {
        LeaseTerms {
            name: name.into(),
            term: TERM,
            take_over,
        }
    }

    fn take(lease: &Lease, name: &str, take_over: bool, now: Duration) -> Result<Secret, Held> {
        let secret = Secret::random().unwrap();
        let taken = lease.take(&terms(name, take_over), name, None, secret, now);
        taken.map(|(secret, _)| secret)
    }

    #[test]
    fn a_lease_lasts_while_it_is_used_and_ends_by_itself() {
        let lease = Lease::default();
        let at = |s: u64| Duration::from_secs(s);
        assert_eq!(lease.check(None, "anna", at(0)), LeaseAnswer::Free);
        let own = take(&lease, "anna", false, at(0)).unwrap();
        let check = |who: &str, id: Option<&str>, s| lease.check(id, who, at(s));
        for s in [300, 800, 1300] {
            assert_eq!(check("anna", Some(own.reveal()), s), LeaseAnswer::Own);
            assert!(matches!(check("anna", None, s), LeaseAnswer::Held(_)));
        }
        assert_eq!(lease.holder(at(1300)).unwrap().left, TERM);
        assert_eq!(lease.holder(at(1900)), None);
        assert_eq!(check("anna", Some(own.reveal()), 1900), LeaseAnswer::Lost);
        assert_eq!(check("bert", None, 1900), LeaseAnswer::Free);
    }

    #[test]
    fn a_lease_is_taken_over_by_saying_so_only_and_its_secret_does_not_help_another_caller() {
        let lease = Lease::default();
        let now = Duration::from_secs(5);
        let annas = take(&lease, "anna", false, now).unwrap();
        let holder = take(&lease, "bert", false, now).unwrap_err();
        assert_eq!(
            (holder.who.as_str(), holder.name.as_str(), holder.left),
            ("anna", "anna", TERM)
        );
        let stolen = lease.check(Some(annas.reveal()), "bert", now);
        assert!(matches!(stolen, LeaseAnswer::Held(_)), "{stolen:?}");
        assert!(!lease.release(Some(annas.reveal()), "bert", now));
        let berts = take(&lease, "bert", true, now).unwrap();
        let lost = lease.check(Some(annas.reveal()), "anna", now);
        assert!(
            matches!(&lost, LeaseAnswer::Held(held) if held.who == "bert"),
            "{lost:?}"
        );
        assert!(lease.release(Some(berts.reveal()), "bert", now));
        assert_eq!(lease.holder(now), None);
    }

    #[test]
    fn a_holder_may_change_the_terms_of_its_own_lease() {
        let lease = Lease::default();
        let now = Duration::from_secs(5);
        let first = take(&lease, "anna", false, now).unwrap();
        let longer = LeaseTerms {
            term: 2 * TERM,
            ..terms("night", false)
        };
        let second = Secret::random().unwrap();
        let taken = lease.take(&longer, "anna", Some(first.reveal()), second, now);
        let (_, before) = taken.unwrap();
        assert_eq!(before, None);
        assert_eq!(lease.holder(now).unwrap().left, 2 * TERM);
    }
}
