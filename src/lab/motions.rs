//! Motions by number, so that a caller can wait until the rig has arrived.

use std::collections::VecDeque;
use std::time::Duration;

use tokio::sync::watch;

use super::rig_work::Work;
use super::{Lab, LabError};
use crate::bench::stage::{StageError, StageStatus};
use crate::geometry::Pose;
use crate::scan::visit::stage_code;
use crate::units::Angle;

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
pub(super) struct Motions(watch::Sender<VecDeque<Motion>>);

impl Default for Motions {
    fn default() -> Self {
        Motions(watch::Sender::new(VecDeque::new()))
    }
}

impl Motions {
    /// Adds a motion that is about to start. Numbers differ between motions, also of earlier daemons: `now_us` is the time
    /// in microseconds.
    fn add(&self, now_us: i64) -> i64 {
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
    fn forget(&self, id: i64) {
        self.0
            .send_modify(|all| all.retain(|motion| motion.id != id));
    }

    /// Publishes the end of a motion.
    pub(super) fn end(
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
}

impl Lab {
    /// Starts a motion and returns its number, just before a stage moves.
    pub(super) async fn begin_motion(&self, work: Work) -> Result<i64, LabError> {
        let side = self.side()?;
        let now_ns = side.sink.clock.utc().unix_timestamp_nanos();
        let id = side
            .motions
            .add(i64::try_from(now_ns / 1000).unwrap_or_default());
        match self.request_as(work, Some(id)).await {
            Ok(()) => Ok(id),
            Err(error) => {
                side.motions.forget(id);
                Err(error)
            }
        }
    }

    /// Starts to move both axes; returns the number of the motion, just before a stage moves. They move at the same time, or
    /// one after the other where only this is free of forbidden regions. An axis without a target stays where it is.
    ///
    /// # Errors
    /// As [`Lab::move_axis`]; [`LabError::Invalid`] without a target.
    pub async fn move_rig(
        &self,
        theta_c: Option<Angle>,
        phi_s: Option<Angle>,
    ) -> Result<i64, LabError> {
        let finite = |target: Option<Angle>, field: &str| match target {
            Some(angle) if !angle.is_finite() => Err(LabError::Invalid {
                field: field.into(),
                problem: "must be a finite number".into(),
            }),
            _ => Ok(()),
        };
        finite(theta_c, "theta_c_deg")?;
        finite(phi_s, "phi_s_deg")?;
        match (theta_c, phi_s) {
            (Some(theta_c), Some(phi_s)) => {
                let target = Pose { theta_c, phi_s };
                self.begin_motion(Work::MoveBoth { target }).await
            }
            (Some(theta_c), None) => self.move_axis(super::AxisName::ThetaC, theta_c).await,
            (None, Some(phi_s)) => self.move_axis(super::AxisName::PhiS, phi_s).await,
            (None, None) => Err(LabError::Invalid {
                field: "theta_c_deg".into(),
                problem: "is missing; expected theta_c_deg, phi_s_deg or both".into(),
            }),
        }
    }

    /// Returns a motion, once it has ended or after a time; `None` if it is not remembered.
    ///
    /// # Errors
    /// [`LabError::NoRig`].
    pub async fn motion(&self, id: i64, wait: Duration) -> Result<Option<Motion>, LabError> {
        let mut motions = self.side()?.motions.0.subscribe();
        let of = |all: &VecDeque<Motion>| all.iter().find(|motion| motion.id == id).cloned();
        let ended = motions
            .wait_for(|all| of(all).is_none_or(|motion| motion.state != MotionState::Moving));
        tokio::time::timeout(wait, ended).await.ok();
        let now = of(&self.side()?.motions.0.borrow());
        Ok(now)
    }
}
