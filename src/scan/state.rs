//! The one state machine of a scan.
//!
//! ```text
//!                    ┌────────────── waiting-for-operator ◄──┐
//!                    │ continue         ▲                    │ cap, white reference, sample
//!  planned ──────────┼──────────────────┘                    │
//!     │              ▼                                       │
//!     └──────────► running ──────────────────────────────────┘
//!                  │  │  ▲ ▲
//!            pause │  │  │ └───────────── resume ─── interrupted ◄── daemon died or was stopped
//!                  ▼  │  │ resume                        (from any state that is not an end)
//!             pausing │  │
//!                  │  │  │
//!                  ▼  ▼  │
//!                 paused ┘      (stop button, lost link and full disk lead here too)
//!
//!  running ──► completed          any state that is not an end ──► aborted, failed
//! ```
//!
//! Happy path: planned → waiting-for-operator (cap) → running → waiting-for-operator (white
//! reference) → running → waiting-for-operator (sample) → running → completed. While a scan is in
//! any state between `planned` and its end it holds the rig. `interrupted` holds nothing: a client that
//! resumes it takes the rig again and redoes every point that was not committed.

use crate::words::words;

words! {
    /// State of a scan.
    #[derive(utoipa::ToSchema)]
    pub enum ScanState {
        /// Checked and stored; nothing has moved.
        Planned = "planned",
        /// The operator must act at the rig, then order `continue`.
        WaitingForOperator = "waiting-for-operator",
        /// Moving and taking frames.
        Running = "running",
        /// Finishing the current point before it pauses.
        Pausing = "pausing",
        /// Holds the rig, does nothing; `resume` continues it.
        Paused = "paused",
        /// The daemon ended while the scan ran; every committed point is there.
        Interrupted = "interrupted",
        /// Every point of the plan is committed.
        Completed = "completed",
        /// A person ended it.
        Aborted = "aborted",
        /// An error ended it.
        Failed = "failed",
    }
}

use ScanState::{
    Aborted, Completed, Failed, Interrupted, Paused, Pausing, Planned, Running, WaitingForOperator,
};

/// Every permitted transition; what is not here does not happen.
pub const TRANSITIONS: &[(ScanState, &[ScanState])] = &[
    (
        Planned,
        &[
            Running,
            WaitingForOperator,
            Paused,
            Interrupted,
            Aborted,
            Failed,
        ],
    ),
    (
        WaitingForOperator,
        &[Running, Paused, Interrupted, Aborted, Failed],
    ),
    (
        Running,
        &[
            WaitingForOperator,
            Pausing,
            Paused,
            Interrupted,
            Completed,
            Aborted,
            Failed,
        ],
    ),
    (
        Pausing,
        &[Paused, Running, Completed, Interrupted, Aborted, Failed],
    ),
    (
        Paused,
        &[Running, WaitingForOperator, Interrupted, Aborted, Failed],
    ),
    (
        Interrupted,
        &[Running, WaitingForOperator, Paused, Aborted, Failed],
    ),
    (Completed, &[]),
    (Aborted, &[]),
    (Failed, &[]),
];

impl ScanState {
    /// The states that may come next.
    #[must_use]
    pub fn next(self) -> &'static [ScanState] {
        TRANSITIONS
            .iter()
            .find(|(from, _)| *from == self)
            .map_or(&[], |(_, to)| to)
    }

    /// Whether the table permits going from here to `next`.
    #[must_use]
    pub fn may_become(self, next: ScanState) -> bool {
        self.next().contains(&next)
    }

    /// Whether nothing comes after this state.
    #[must_use]
    pub fn is_end(self) -> bool {
        self.next().is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_names_every_state_once() {
        for state in ScanState::ALL {
            let rows = TRANSITIONS
                .iter()
                .filter(|(from, _)| *from == state)
                .count();
            assert_eq!(rows, 1, "{state}");
        }
    }

    #[test]
    fn every_state_is_reached_from_planned_and_reaches_an_end() {
        let reach = |start: ScanState| {
            let mut seen = vec![start];
            let mut at = 0;
            while at < seen.len() {
                for next in seen[at].next() {
                    if !seen.contains(next) {
                        seen.push(*next);
                    }
                }
                at += 1;
            }
            seen
        };
        assert_eq!(reach(Planned).len(), ScanState::ALL.len());
        for state in ScanState::ALL {
            assert!(reach(state).iter().any(|s| s.is_end()), "{state}");
        }
    }

    #[test]
    fn what_has_not_ended_can_be_aborted_and_can_fail() {
        for state in ScanState::ALL.into_iter().filter(|s| !s.is_end()) {
            assert!(
                state.may_become(Aborted) && state.may_become(Failed),
                "{state}"
            );
        }
    }
}
