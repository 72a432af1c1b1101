//! Motions of one or both axes that are not part of a scan: moves, homing and jogs.

use std::sync::{Arc, Mutex};

use tokio::sync::watch;

use crate::bench::stage::{AxisName, JogOrder, Stage, StageError};
use crate::geometry::Pose;
use crate::scan::Event;
use crate::scan::event::{AxisEvent, RigActivity};
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
    pub(super) fn activity(&self) -> RigActivity {
        match self {
            AxisMotion::Home { .. } | AxisMotion::HomeBoth => RigActivity::Homing,
            AxisMotion::Move { .. } | AxisMotion::MoveBoth { .. } | AxisMotion::Jog(_) => {
                RigActivity::Moving
            }
        }
    }

    /// Returns the event that reports the start. The start of a jog is no event: it moves only while it is renewed.
    pub(super) fn start(&self) -> Option<Event> {
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
    pub(super) async fn check(&self, stage: &Stage) -> Result<(), StageError> {
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
    pub(super) async fn make(self, stage: &Stage, stops: u64) -> Result<(), StageError> {
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
