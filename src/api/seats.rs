//! Seats of connections: how many get an answer, in all and per peer.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::time::Duration;

use tokio::sync::{OwnedSemaphorePermit, Semaphore};

use super::via::{Listener, Via, network};

/// What the listener accepts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Connections that get an answer to every request.
    pub seats: usize,
    /// Most of these that one peer has; a proxy stands for many.
    pub seats_of_peer: usize,
    /// Further connections, which get an answer to the stop and to `/healthz` only.
    pub reserve: usize,
    /// How long the head of a request may take. An idle connection is closed after the same time.
    pub head_timeout: Duration,
}

impl Limits {
    /// Returns limits that leave most of the open files to the store, the frames and the devices.
    #[must_use]
    pub fn within(open_files: u64) -> Limits {
        let part = |of: u64, least, most| (open_files / of).clamp(least, most) as usize;
        let seats = part(2, 16, 512);
        Limits {
            seats,
            seats_of_peer: seats / 2,
            reserve: part(16, 4, 32),
            head_timeout: Duration::from_secs(60),
        }
    }
}

/// The seats of all connections, and of each peer.
pub(super) struct Seats {
    of_all: Arc<Semaphore>,
    of_peer: Mutex<HashMap<IpAddr, Weak<Semaphore>>>,
    limit_of_peer: usize,
}

/// A seat of a connection, held until it is dropped.
pub(super) struct Seat {
    _of_all: OwnedSemaphorePermit,
    _of_peer: Option<OwnedSemaphorePermit>,
}

impl Seats {
    pub fn new(limits: &Limits) -> Seats {
        Seats {
            of_all: Arc::new(Semaphore::new(limits.seats)),
            of_peer: Mutex::default(),
            limit_of_peer: limits.seats_of_peer,
        }
    }

    /// Returns the seats of the peer of a connection.
    pub fn of(&self, via: Via) -> Option<Arc<Semaphore>> {
        if via.listener == Listener::Proxy {
            return None;
        }
        let mut all = self.of_peer.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|_, seats| seats.strong_count() > 0);
        let place = all.entry(network(via.peer)).or_default();
        Some(place.upgrade().unwrap_or_else(|| {
            let seats = Arc::new(Semaphore::new(self.limit_of_peer));
            *place = Arc::downgrade(&seats);
            seats
        }))
    }

    pub fn try_take(&self, peer: Option<&Arc<Semaphore>>) -> Option<Seat> {
        let of_peer = match peer {
            Some(seats) => Some(Arc::clone(seats).try_acquire_owned().ok()?),
            None => None,
        };
        let of_all = Arc::clone(&self.of_all).try_acquire_owned().ok()?;
        Some(Seat {
            _of_all: of_all,
            _of_peer: of_peer,
        })
    }

    /// Waits for a seat.
    pub async fn take(&self, peer: Option<&Arc<Semaphore>>) -> Option<Seat> {
        let of_peer = match peer {
            Some(seats) => Some(Arc::clone(seats).acquire_owned().await.ok()?),
            None => None,
        };
        let of_all = Arc::clone(&self.of_all).acquire_owned().await.ok()?;
        Some(Seat {
            _of_all: of_all,
            _of_peer: of_peer,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn most_open_files_are_left_to_others() {
        for open_files in [64, 256, 1024, 65_536] {
            let limits = Limits::within(open_files);
            let taken = (limits.seats + limits.reserve) as u64;
            assert!(taken * 3 <= open_files * 2, "{open_files}: {limits:?}");
        }
    }
}
