//! Counts wrong tokens per peer, so that a peer that guesses is slowed down.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Wrong tokens that a peer may present in a row.
const BURST: u32 = 10;
/// One more is allowed after this time.
const ONE_MORE_AFTER: Duration = Duration::from_secs(6);
/// Most peers that are remembered; peers that have all their attempts back are forgotten first.
const PEERS_MAX: usize = 4096;

/// Wrong tokens of each peer.
#[derive(Debug, Default)]
pub struct Guesses(Mutex<HashMap<IpAddr, Duration>>);

impl Guesses {
    /// Counts a wrong token. Returns how long the peer has to wait, if it presented too many.
    #[must_use]
    pub fn wrong(&self, peer: IpAddr, now: Duration) -> Option<Duration> {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        // The time at which the peer has all its attempts back: one number says how many it has used.
        if all.len() >= PEERS_MAX {
            all.retain(|_, full_at| *full_at > now);
        }
        if all.len() >= PEERS_MAX && !all.contains_key(&peer) {
            return Some(ONE_MORE_AFTER);
        }
        let full_at = all.entry(peer).or_insert(now);
        let next = (*full_at).max(now) + ONE_MORE_AFTER;
        let most = now + BURST * ONE_MORE_AFTER;
        if next > most {
            return Some(next - most);
        }
        *full_at = next;
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peer_that_guesses_waits_and_others_do_not() {
        let guesses = Guesses::default();
        let (one, other) = ([10, 0, 0, 1].into(), [10, 0, 0, 2].into());
        let start = Duration::from_secs(100);
        for _ in 0..BURST {
            assert_eq!(guesses.wrong(one, start), None);
        }
        let wait = guesses.wrong(one, start).unwrap();
        assert!(wait <= ONE_MORE_AFTER && !wait.is_zero(), "{wait:?}");
        assert_eq!(guesses.wrong(other, start), None);
        assert_eq!(guesses.wrong(one, start + ONE_MORE_AFTER), None);
        assert!(guesses.wrong(one, start + ONE_MORE_AFTER).is_some());
    }

    #[test]
    fn the_number_of_remembered_peers_is_bounded() {
        let guesses = Guesses::default();
        let start = Duration::from_secs(100);
        for peer in 0..2 * PEERS_MAX as u32 {
            let _ = guesses.wrong(std::net::Ipv4Addr::from(peer).into(), start);
        }
        assert_eq!(guesses.0.lock().unwrap().len(), PEERS_MAX);
    }
}
