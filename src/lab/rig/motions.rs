//! Motions by number, so that a caller can wait until the rig has arrived.

use std::collections::VecDeque;
use std::time::Duration;

use tokio::sync::watch;

use crate::bench::stage::{StageError, StageStatus};
use crate::geometry::Pose;
use crate::scan::visit::stage_code;

/// Motions that are remembered.
const KEPT: usize = 64;

/// State of a motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum MotionState {
    /// It is about to move, or moves.
    Moving,
    /// It has arrived, and the stages have settled.
    Arrived,
    /// A stop ended it.
    Stopped,
    /// It failed.
    Failed,
}

/// A motion.
#[derive(Debug, Clone, PartialEq)]
pub struct Motion {
    /// Its number.
    pub id: i64,
    /// Its state.
    pub state: MotionState,
    /// Code and message of the failure.
    pub problem: Option<(String, String)>,
    /// Pose read back at its end, if the stages answered.
    pub pose: Option<Pose>,
}

/// The newest motions, oldest first.
#[derive(Debug)]
pub(in crate::lab) struct Motions(watch::Sender<VecDeque<Motion>>);

impl Default for Motions {
    fn default() -> Self {
        Motions(watch::Sender::new(VecDeque::new()))
    }
}

impl Motions {
    /// Adds a motion that is about to start. Numbers differ between motions, also of earlier daemons: `now_us` is the time
    /// in microseconds.
    pub(in crate::lab) fn add(&self, now_us: i64) -> i64 {
        let mut id = now_us;
        self.0.send_modify(|all| {
            id = id.max(all.back().map_or(0, |last| last.id + 1));
            if all.len() == KEPT {
                all.pop_front();
            }
            all.push_back(Motion {
                id,
                state: MotionState::Moving,
                problem: None,
                pose: None,
            });
        });
        id
    }

    /// Removes a motion that was refused.
    pub(in crate::lab) fn forget(&self, id: i64) {
        self.0
            .send_modify(|all| all.retain(|motion| motion.id != id));
    }

    /// Publishes the end of a motion.
    pub(in crate::lab) fn end(
        &self,
        id: i64,
        outcome: &Result<(), StageError>,
        status: Option<&StageStatus>,
    ) {
        self.0.send_modify(|all| {
            let Some(motion) = all.iter_mut().find(|motion| motion.id == id) else {
                return;
            };
            motion.state = match outcome {
                Ok(()) => MotionState::Arrived,
                Err(StageError::Stopped) => MotionState::Stopped,
                Err(_) => MotionState::Failed,
            };
            let error = outcome.as_ref().err();
            motion.problem = error.map(|error| (stage_code(error).to_owned(), error.to_string()));
            motion.pose = status.map(StageStatus::pose);
        });
    }

    /// Returns a motion, once it has ended or after a time; `None` if it is not remembered.
    pub(in crate::lab) async fn once_ended(&self, id: i64, wait: Duration) -> Option<Motion> {
        let mut motions = self.0.subscribe();
        let of = |all: &VecDeque<Motion>| all.iter().find(|motion| motion.id == id).cloned();
        let ended = motions
            .wait_for(|all| of(all).is_none_or(|motion| motion.state != MotionState::Moving));
        tokio::time::timeout(wait, ended).await.ok();
        of(&self.0.borrow())
    }
}
