//! The pending branches of a photon.

use crate::trace::photons::interface::ReliefPoint;
use crate::trace::photons::light::PhotonState;
use crate::trace::surfaces::height_field::Side;
use crate::trace::vec3::V3;

/// Largest number of pending branches of one photon; beyond it one branch is drawn.
const WAITING: usize = 12;

/// A photon that has just left a point.
#[derive(Debug, Clone, Copy)]
pub(super) struct State<L> {
    pub(super) light: L,
    pub(super) k: V3,
    pub(super) side: Side,
    pub(super) interface: usize,
    pub(super) place: ReliefPoint,
    pub(super) interactions: u32,
}

/// Pending branches of a photon. One instance serves all photons of a thread in turn.
#[derive(Debug)]
pub struct Waiting<L> {
    states: [Option<State<L>>; WAITING],
    count: usize,
    /// Number of splits of the photon so far.
    pub(super) splits: u32,
}

impl<L: PhotonState> Waiting<L> {
    /// Makes an empty list.
    #[must_use]
    pub fn none() -> Self {
        Waiting {
            states: [const { None }; WAITING],
            count: 0,
            splits: 0,
        }
    }

    #[inline]
    pub(super) fn has_room(&self) -> bool {
        self.count < WAITING
    }

    #[inline]
    pub(super) fn push(&mut self, state: State<L>) {
        self.states[self.count] = Some(state);
        self.count += 1;
    }

    #[inline]
    pub(super) fn pop(&mut self) -> Option<State<L>> {
        self.count = self.count.checked_sub(1)?;
        self.states[self.count].take()
    }

    #[inline]
    pub(super) fn clear(&mut self) {
        while self.pop().is_some() {}
    }
}
