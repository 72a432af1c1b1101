//! A motion that is not part of a scan: refused, or accepted, reported and made.

use std::sync::Arc;

use tokio::sync::oneshot;

use super::Owner;
use crate::bench::stage::{Stage, StageError};
use crate::lab::LabError;
use crate::lab::rig::axis_motion::AxisMotion;
use crate::scan::event::{AxisEvent, RigActivity};
use crate::scan::{Event, Rig};
use crate::units::Angle;

/// A motion that a caller ordered.
pub(super) struct MotionOrder {
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
    pub(super) async fn make_motion(&self, rig: &mut Rig, stage: &Stage, order: MotionOrder) {
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
