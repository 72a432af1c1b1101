//! Work for the owner of the rig.

use std::sync::{Arc, Mutex};

use tokio::sync::{oneshot, watch};

use super::LabError;
use super::preview_work::PreviewWork;
use super::scan_run::ScanWork;
use crate::bench::stage::{AxisName, JogOrder};
use crate::geometry::Pose;
use crate::units::Angle;

/// Work for the owner.
pub(super) enum Work {
    /// Connect the stages if they are not connected.
    Connect,
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
    /// Unpark an axis. Nothing moves.
    Unpark {
        /// The axis.
        axis: AxisName,
    },
    /// Jog one axis.
    Jog(JogWork),
    /// Take frames that are not stored.
    Preview(Box<PreviewWork>),
    /// Run a scan.
    Scan(Box<ScanWork>),
    /// Park both axes; replied to when they are parked.
    Park,
    /// End the task.
    End,
}

impl Work {
    /// Returns whether a preview in progress ends for this work.
    pub fn comes_before_a_preview(&self) -> bool {
        !matches!(self, Work::Connect | Work::Preview(_))
    }

    /// Returns whether the work is a single motion; a stop ends such work.
    pub fn is_a_motion(&self) -> bool {
        matches!(
            self,
            Work::Move { .. }
                | Work::MoveBoth { .. }
                | Work::Home { .. }
                | Work::HomeBoth
                | Work::Jog(_)
        )
    }
}

/// Work and its reply, which is sent when the work starts, not when it is done.
pub(super) struct Request {
    pub work: Work,
    /// Number of the motion, if the caller can wait for it.
    pub motion: Option<i64>,
    /// The caller.
    pub who: Arc<str>,
    /// Number of stops before the request.
    pub stops: u64,
    pub reply: oneshot::Sender<Result<(), LabError>>,
}

/// What the owner of the rig needs to jog.
#[derive(Debug)]
pub(super) struct JogWork {
    pub axis: AxisName,
    pub order: watch::Receiver<JogOrder>,
    pub at_end: Arc<Mutex<Option<String>>>,
}

impl JogWork {
    pub fn at_end(&self, why: Option<String>) {
        *self.at_end.lock().expect("no holder of this lock panics") = why;
    }
}
