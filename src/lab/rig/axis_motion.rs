//! Motions of one or both axes that are not part of a scan: moves, homing and jogs.

use std::sync::{Arc, Mutex};

use tokio::sync::{oneshot, watch};

use super::owner::Owner;
use crate::bench::stage::{AxisName, JogOrder, Stage, StageError};
use crate::geometry::Pose;
use crate::lab::LabError;
use crate::scan::event::{AxisEvent, RigActivity};
use crate::scan::{Event, Rig};
use crate::units::Angle;

/// A motion that a stop ends.
pub(in crate::lab) enum AxisMotion {
    /// Move one axis.
    Move {
        /// The axis.
        axis: AxisName,
        /// The target.
        target: Angle,
    },
    /// Move both axes.
    MoveBoth {
        /// The target.
        target: Pose,
    },
    /// Home one axis.
    Home {
        /// The axis.
        axis: AxisName,
    },
    /// Home both axes, in the order of the settings.
    HomeBoth,
    /// Jog one axis.
    Jog(JogWork),
}

impl AxisMotion {
    fn activity(&self) -> RigActivity {
        match self {
            AxisMotion::Home { .. } | AxisMotion::HomeBoth => RigActivity::Homing,
            AxisMotion::Move { .. } | AxisMotion::MoveBoth { .. } | AxisMotion::Jog(_) => {
                RigActivity::Moving
            }
        }
    }

    /// Returns the event that reports the start. The start of a jog is no event: it moves only while it is renewed.
    fn start(&self) -> Option<Event> {
        let unknown = AxisEvent::UNKNOWN;
        let one = |axis: &AxisName, event| match axis {
            AxisName::ThetaC => (event, unknown),
            AxisName::PhiS => (unknown, event),
        };
        let (theta_c, phi_s) = match self {
            AxisMotion::Move { axis, target } => one(axis, AxisEvent::to(*target)),
            AxisMotion::MoveBoth { target } => {
                (AxisEvent::to(target.theta_c), AxisEvent::to(target.phi_s))
            }
            AxisMotion::Home { .. } | AxisMotion::HomeBoth => (unknown, unknown),
            AxisMotion::Jog(_) => return None,
        };
        Some(Event::Rig {
            activity: self.activity(),
            theta_c,
            phi_s,
        })
    }

    /// Refuses a motion that the stages cannot or must not make now.
    async fn check(&self, stage: &Stage) -> Result<(), StageError> {
        match self {
            AxisMotion::Move { axis, target } => {
                // Only the moving axis is checked; the other one stays where it is.
                stage.settings().check_limit(*axis, *target)?;
                check_homed(stage, &[*axis]).await?;
                stage.check_move(*axis, *target).await
            }
            AxisMotion::MoveBoth { target } => {
                stage.check_limits(*target)?;
                check_homed(stage, &AxisName::ALL).await?;
                stage.check_move_pose(*target).await
            }
            AxisMotion::Home { .. } | AxisMotion::HomeBoth => Ok(()),
            AxisMotion::Jog(work) => stage.check_jog(work.axis).await,
        }
    }

    /// Moves until the motion is complete, has failed, or a stop after number `stops` ends it.
    async fn make(self, stage: &Stage, stops: u64) -> Result<(), StageError> {
        match self {
            AxisMotion::Move { axis, target } => {
                stage.move_since(axis, target, stops).await.map(|_| ())
            }
            AxisMotion::MoveBoth { target } => {
                stage.move_pose_since(target, stops).await.map(|_| ())
            }
            AxisMotion::Home { axis } => {
                stage.release(axis).await?;
                stage.home_since(axis, stops).await
            }
            AxisMotion::HomeBoth => {
                for axis in AxisName::ALL {
                    stage.release(axis).await?;
                }
                stage.home_all_since(stops).await
            }
            AxisMotion::Jog(work) => {
                let order = work.order.clone();
                let at_end = |why| work.at_end(why);
                stage.jog(work.axis, order, stops, at_end).await.map(|_| ())
            }
        }
    }
}

async fn check_homed(stage: &Stage, axes: &[AxisName]) -> Result<(), StageError> {
    let status = stage.status().await?;
    match axes.iter().find(|axis| !status.axis(**axis).homed) {
        Some(axis) => Err(StageError::NotReferenced { axis: *axis }),
        None => Ok(()),
    }
}

/// What the owner of the rig needs to jog.
#[derive(Debug)]
pub(in crate::lab) struct JogWork {
    pub axis: AxisName,
    pub order: watch::Receiver<JogOrder>,
    pub at_end: Arc<Mutex<Option<String>>>,
}

impl JogWork {
    pub fn at_end(&self, why: Option<String>) {
        *self.at_end.lock().expect("no holder of this lock panics") = why;
    }
}

/// A motion that a caller ordered.
pub(in crate::lab) struct MotionOrder {
    pub motion: AxisMotion,
    /// Number of the motion, if the caller can wait for it.
    pub number: Option<i64>,
    /// The caller.
    pub who: Arc<str>,
    /// Number of stops before the order.
    pub stops: u64,
    pub reply: oneshot::Sender<Result<(), LabError>>,
}

impl Owner {
    /// Refuses the order, or accepts it, reports the motion and makes it.
    pub(in crate::lab) async fn make_motion(
        &self,
        rig: &mut Rig,
        stage: &Stage,
        order: MotionOrder,
    ) {
        let MotionOrder {
            motion,
            number,
            who,
            stops,
            reply,
        } = order;
        // Read first: a later stop cancels the motion that starts with this count, and an earlier one shows in the owner's
        // count.
        let stops_of_stage = stage.stops();
        if self.access.stops() != stops {
            reply.send(Err(StageError::Stopped.into())).ok();
            return;
        }
        if reply.is_closed() {
            return;
        }
        if let Err(error) = motion.check(stage).await {
            rig.let_go_if_lost(&error);
            reply.send(Err(error.into())).ok();
            return;
        }
        self.access.allow_unasked_motion();
        self.context.begin(motion.activity(), &who);
        reply.send(Ok(())).ok();
        if let Some(start) = motion.start() {
            // Does not wait for the database: a motion that was requested must not begin much later.
            self.context.sink.report_by(&who, start);
        }
        let outcome = motion.make(stage, stops_of_stage).await;
        self.settled(rig, stage, &who, number, outcome).await;
    }

    async fn settled(
        &self,
        rig: &mut Rig,
        stage: &Stage,
        who: &Arc<str>,
        motion: Option<i64>,
        outcome: Result<(), StageError>,
    ) {
        let is_stopped = matches!(outcome, Err(StageError::Stopped));
        // A stopped axis has no position before it is at rest.
        let status = match is_stopped && stage.at_rest().await.is_err() {
            true => None,
            false => stage.status().await.ok(),
        };
        let failure = outcome
            .as_ref()
            .err()
            .map(|e| (crate::scan::visit::stage_code(e).to_owned(), e.to_string()));
        // At once, so that a client that sees the rig idle also sees the failure, and gets the rig as soon as it is back.
        self.context.occupation.send_modify(|now| {
            now.activity = None;
            now.failure = failure;
        });
        // After the rig is free, so that a caller that waited gets it.
        if let Some(id) = motion {
            self.context.motions.end(id, &outcome, status.as_ref());
        }
        if let Err(error) = &outcome {
            self.access.forbid_unasked_motion();
            rig.let_go_if_lost(error);
            if !is_stopped {
                let alarm = Event::Alarm {
                    code: crate::scan::visit::stage_code(error).into(),
                    message: error.to_string(),
                    scan_id: None,
                };
                self.context.sink.report_by(who, alarm);
            }
        }
        let at = |axis: Option<Angle>| axis.map_or(AxisEvent::UNKNOWN, AxisEvent::at);
        let event = Event::Rig {
            activity: RigActivity::Idle,
            theta_c: at(status.as_ref().map(|s| s.theta_c.position)),
            phi_s: at(status.as_ref().map(|s| s.phi_s.position)),
        };
        self.context.sink.report_by(who, event);
    }
}
