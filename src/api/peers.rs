//! What one peer may take at a time: event streams and bytes of unfinished bodies. The number of its connections is bounded
//! in `connections`.

use std::collections::HashMap;
use std::net::IpAddr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most event streams of one peer.
const STREAMS_MAX: usize = 64;
/// Most bytes of the bodies that one peer has in progress, and that all peers have.
const BODY_BYTES_OF_PEER: usize = 32 << 20;
const BODY_BYTES_OF_ALL: usize = 128 << 20;

/// Counts per peer.
#[derive(Debug, Clone)]
pub(super) struct Peers {
    counts: Arc<Mutex<Counts>>,
    streams_of_peer: usize,
    streams_of_all: usize,
}

#[derive(Debug, Default)]
struct Counts {
    peers: HashMap<IpAddr, Count>,
    all: Count,
}

#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
struct Count {
    streams: usize,
    body_bytes: usize,
}

impl Peers {
    /// Returns the counts of a listener with this number of seats: event streams take half of them at most, and those of one
    /// peer a quarter.
    pub fn new(seats: usize) -> Peers {
        Peers {
            counts: Arc::default(),
            streams_of_peer: (seats / 4).clamp(1, STREAMS_MAX),
            streams_of_all: (seats / 2).max(1),
        }
    }

    fn counts(&self) -> MutexGuard<'_, Counts> {
        self.counts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lets a peer open an event stream; none if it has too many.
    pub fn stream(&self, peer: IpAddr) -> Option<StreamPlace> {
        let mut counts = self.counts();
        if counts.all.streams >= self.streams_of_all {
            return None;
        }
        let of_peer = counts.peers.entry(peer).or_default();
        if of_peer.streams >= self.streams_of_peer {
            return None;
        }
        of_peer.streams += 1;
        counts.all.streams += 1;
        drop(counts);
        Some(StreamPlace {
            peers: self.clone(),
            peer,
        })
    }

    /// Returns the room for one body of a peer, with nothing taken yet.
    pub fn room_for_body(&self, peer: IpAddr) -> BodyRoom {
        BodyRoom {
            peers: self.clone(),
            peer,
            taken: 0,
        }
    }

    fn give_back(&self, peer: IpAddr, count: Count) {
        let mut counts = self.counts();
        counts.all.streams -= count.streams;
        counts.all.body_bytes -= count.body_bytes;
        if let Some(of_peer) = counts.peers.get_mut(&peer) {
            of_peer.streams -= count.streams;
            of_peer.body_bytes -= count.body_bytes;
            if *of_peer == Count::default() {
                counts.peers.remove(&peer);
            }
        }
    }
}

/// The place of one event stream, held until it is dropped.
#[derive(Debug)]
pub(super) struct StreamPlace {
    peers: Peers,
    peer: IpAddr,
}

impl Drop for StreamPlace {
    fn drop(&mut self) {
        let count = Count {
            streams: 1,
            body_bytes: 0,
        };
        self.peers.give_back(self.peer, count);
    }
}

/// The room of one body, held until the request is answered.
#[derive(Debug)]
pub(super) struct BodyRoom {
    peers: Peers,
    peer: IpAddr,
    taken: usize,
}

impl BodyRoom {
    /// Takes room for more bytes; false if there is none.
    pub fn take(&mut self, bytes: usize) -> bool {
        let mut counts = self.peers.counts();
        let of_peer = counts.peers.get(&self.peer).copied().unwrap_or_default();
        if of_peer.body_bytes + bytes > BODY_BYTES_OF_PEER
            || counts.all.body_bytes + bytes > BODY_BYTES_OF_ALL
        {
            return false;
        }
        counts.all.body_bytes += bytes;
        counts.peers.entry(self.peer).or_default().body_bytes += bytes;
        self.taken += bytes;
        true
    }
}

impl Drop for BodyRoom {
    fn drop(&mut self) {
        let count = Count {
            streams: 0,
            body_bytes: self.taken,
        };
        self.peers.give_back(self.peer, count);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn peer(n: u8) -> IpAddr {
        [10, 0, 0, n].into()
    }

    #[test]
    fn one_peer_does_not_take_the_streams_of_the_others() {
        let peers = Peers::new(16);
        let streams: Vec<_> = (0..600).filter_map(|_| peers.stream(peer(1))).collect();
        assert_eq!(streams.len(), 4);
        assert!(peers.stream(peer(2)).is_some());
        drop(streams);
        assert!(peers.stream(peer(1)).is_some());
        let of_many: Vec<_> = (0..100).filter_map(|n| peers.stream(peer(n))).collect();
        assert_eq!(of_many.len(), 8);
        drop(of_many);
        assert!(peers.counts().peers.is_empty());
    }

    #[test]
    fn the_bodies_of_one_peer_and_of_all_are_bounded() {
        let peers = Peers::new(16);
        let take = |n| {
            let mut room = peers.room_for_body(peer(n));
            room.take(8 << 20).then_some(room)
        };
        let of_one: Vec<_> = (0..40).filter_map(|_| take(1)).collect();
        assert_eq!(of_one.len(), 4);
        let of_all: Vec<_> = (0..40).filter_map(take).collect();
        assert_eq!(of_all.len(), 12);
        drop((of_one, of_all));
        assert!(peers.counts().peers.is_empty());
        assert_eq!(peers.counts().all, Count::default());
    }
}
