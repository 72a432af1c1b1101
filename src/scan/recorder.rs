//! What a runner reports, and the [`Recorder`] that makes it durable.

use futures::future::BoxFuture;
use time::OffsetDateTime;

use super::event::{OperatorAction, Progress};
use super::plan::Shot;
use super::state::ScanState;
use crate::bench::Captured;
use crate::frame::FrameKind;
use crate::geometry::Pose;

/// A finished visit to a point, to be made durable.
#[derive(Debug)]
pub struct Visit {
    /// The point.
    pub shot: Shot,
    /// 0 for the first visit, then one more for each retake.
    pub attempt: u32,
    /// Position read back, in the turn the plan states.
    pub pose: Pose,
    /// Frames in the order taken.
    pub frames: Vec<TakenFrame>,
    /// Why it is rejected.
    pub rejected: Option<Rejected>,
    /// Why frames were discarded before these; `None` if none were.
    pub discarded: Option<String>,
    /// Start of the first exposure.
    pub taken_at: OffsetDateTime,
}

pub(super) const BLACK: &str =
    "black: no light in the longest exposure; check lamp, shutter and lens cap";

pub(super) fn unlit_message(percent: u32) -> String {
    format!(
        "{percent} % of the picture show no light in the longest exposure (scan.unlit_share_max); check the shutter, the lamp, and \
         what stands before the lens"
    )
}

/// Why the frames of a point are rejected.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Rejected {
    /// The sample shows no light. Accepted once the operator has confirmed it.
    #[error("{}", BLACK)]
    BlackSample,
    /// The sample saturates the camera over the whole plan. Accepted once the operator has confirmed it.
    #[error(
        "full: at {poses} of the plan's {of} poses, most of them or those furthest apart, most pixels are full in the \
         shortest exposure; check lamp and camera, or plan a new scan with shorter exposures (this scan does not repeat \
         accepted poses)"
    )]
    FullSample {
        /// How many so far.
        poses: usize,
        /// How many there are.
        of: usize,
    },
    /// A large part of the sample shows no light. Accepted once the operator has confirmed it.
    #[error("{}", unlit_message(*percent))]
    UnlitSample {
        /// Share of the picture, %.
        percent: u32,
    },
    /// The camera returned an image that it had returned before.
    #[error(
        "the camera returned the same image twice, bit for bit; check the camera and its capture program (for a camera \
         without noise set read_noise_electrons_rms = 0)"
    )]
    SameFrame,
    /// The stage moved or was pushed while the frames were taken.
    #[error("{0}")]
    Disturbed(String),
    /// Any other fault.
    #[error("{0}")]
    Otherwise(String),
}

/// A frame of a visit.
#[derive(Debug)]
pub struct TakenFrame {
    /// Frame and time.
    pub captured: Captured,
    /// Exposure time.
    pub exposure_s: f64,
    /// Place of the exposure in the shot's list.
    pub exposure_index: usize,
    /// Number of the repeat.
    pub repeat: u32,
}

/// A fault that is over.
#[derive(Debug, Clone, PartialEq)]
pub struct Recovery {
    /// Stable code of the fault, as of its alarm.
    pub code: String,
    /// What happened, and what ended it.
    pub message: String,
    /// Time from the fault to the first point that counts again.
    pub took_s: f64,
    /// Points of the plan that were taken again.
    pub points: Vec<u32>,
    /// Whether a person resumed the scan in between.
    pub attended: bool,
}

/// Why something could not be recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The disk is full.
    #[error("{0}")]
    DiskFull(String),
    /// Any other error.
    #[error("{0}")]
    Failed(String),
}

/// Makes durable what the runner reports.
pub trait Recorder: Send {
    /// The scan changed its state.
    fn state<'a>(
        &'a mut self,
        next: ScanState,
        reason: Option<&'a str>,
        operator: Option<OperatorAction>,
        progress: Progress,
    ) -> BoxFuture<'a, Result<(), RecordError>>;

    /// A point was visited; the pose is the current position of the stages.
    fn visit(&mut self, visit: Visit, progress: Progress)
    -> BoxFuture<'_, Result<(), RecordError>>;

    /// Accepted points no longer count, for this reason; they will be taken again.
    fn withdraw<'a>(
        &'a mut self,
        points: &'a [u32],
        why: &'a str,
    ) -> BoxFuture<'a, Result<(), RecordError>>;

    /// All points of one kind are durable. Every run that finds them so calls it again.
    fn phase_done(&mut self, kind: FrameKind) -> BoxFuture<'_, Result<(), RecordError>>;

    /// The scan continues after a fault.
    fn recovered(&mut self, recovery: Recovery) -> BoxFuture<'_, ()>;

    /// Raises an alarm for the operator.
    fn alarm<'a>(&'a mut self, code: &'a str, message: &'a str) -> BoxFuture<'a, ()>;

    /// Returns the bytes that may still be written.
    fn free_bytes(&self) -> BoxFuture<'_, Result<u64, RecordError>>;
}
