//! What a runner tells, and who makes it durable: a finished visit to a point, and the [`Recorder`].

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
    /// 0, then one more for each retake.
    pub attempt: u32,
    /// Position read back, in the turn the plan states.
    pub pose: Pose,
    /// Frames in the order taken, with exposure and number of the repeat.
    pub frames: Vec<TakenFrame>,
    /// Why it does not count.
    pub rejected: Option<Rejected>,
    /// When the first exposure began.
    pub taken_at: OffsetDateTime,
}

pub(super) const BLACK: &str =
    "black: no light in the longest exposure; look at lamp, shutter and lens cap";

/// Why the frames of a point do not count.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Rejected {
    /// The sample shows no light. It may be so, once somebody has looked.
    #[error("{}", BLACK)]
    BlackSample,
    /// The sample fills the camera over the whole plan. It may be so, once somebody has looked.
    #[error(
        "full: at {poses} of the plan's {of} poses, most of them or those furthest apart, most pixels are full in the \
         shortest exposure; look at lamp and camera, or plan a new scan of shorter exposures (this one takes no pose \
         again that it has)"
    )]
    FullSample {
        /// How many so far.
        poses: usize,
        /// How many there are.
        of: usize,
    },
    /// The camera gave a picture that it had given before.
    #[error(
        "the same picture as before, bit for bit: the camera takes no new ones; look at it and its program (for a \
         camera that has no noise, read_noise_electrons_rms = 0 says so)"
    )]
    SameFrame,
    /// Anything else, in words.
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

/// Why something could not be recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// There is no room for it.
    #[error("{0}")]
    DiskFull(String),
    /// Anything else.
    #[error("{0}")]
    Failed(String),
}

/// Who makes durable what the runner tells.
pub trait Recorder: Send {
    /// The scan changed its state.
    fn state<'a>(
        &'a mut self,
        next: ScanState,
        reason: Option<&'a str>,
        operator: Option<OperatorAction>,
        progress: Progress,
    ) -> BoxFuture<'a, Result<(), RecordError>>;

    /// A point was visited; the pose is where the stages stand now.
    fn visit(&mut self, visit: Visit, progress: Progress)
    -> BoxFuture<'_, Result<(), RecordError>>;

    /// All points of one kind are durable; told again by every run that finds them so.
    fn phase_done(&mut self, kind: FrameKind) -> BoxFuture<'_, Result<(), RecordError>>;

    /// A person should look.
    fn alarm<'a>(&'a mut self, code: &'a str, message: &'a str) -> BoxFuture<'a, ()>;

    /// Bytes that may still be written.
    fn free_bytes(&self) -> Result<u64, RecordError>;
}
