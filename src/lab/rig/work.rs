//! Work for the owner of the rig.

use std::sync::Arc;

use tokio::sync::oneshot;

use super::axis_motion::AxisMotion;
use super::preview_work::PreviewWork;
use crate::bench::stage::AxisName;
use crate::lab::LabError;
use crate::lab::scans::scan_run::ScanWork;

/// Work for the owner.
pub(in crate::lab) enum Work {
    /// Connect the stages if they are not connected.
    Connect,
    /// Move, home or jog.
    Motion {
        /// The motion.
        motion: AxisMotion,
        /// Its number, if the caller can wait for it.
        number: Option<i64>,
    },
    /// Unpark an axis. Nothing moves.
    Unpark {
        /// The axis.
        axis: AxisName,
    },
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
}

/// Work and its reply, which is sent when the work starts, not when it is done.
pub(in crate::lab) struct Request {
    pub work: Work,
    /// The caller.
    pub who: Arc<str>,
    /// Number of stops before the request.
    pub stops: u64,
    pub reply: oneshot::Sender<Result<(), LabError>>,
}
