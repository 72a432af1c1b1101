//! Real devices: the stage and the camera as the rest of the program uses them.
//!
//! [`stage::Stage`] moves the two axes and verifies their positions; an implementation of
//! [`Camera`] turns a [`CaptureRequest`] into a frame. From the bytes up: `wire` (pure codec of a
//! protocol) · `port` (bytes; the place where tests inject faults) · `line` (the thread that owns a
//! port) · `stage` (limits, homing, arrival). The camera is `watched_folder`: `capture_program` runs its program, `side_file` reads
//! what the program states. `watched_value` reads numbers that suspend a scan. Knows no scan, no store and no simulation.

mod capture_program;
pub mod line;
pub mod port;
mod side_file;
pub mod stage;
pub mod watched_folder;
pub mod watched_value;
pub mod wire;

use std::str::FromStr;
use std::time::Duration;

use futures::future::BoxFuture;

use crate::frame::{Frame, FrameKind, FrameTag, TagError};
use crate::geometry::Pose;
use crate::words::words;

words! {
    /// The two axes of a rig, by the names used in files, requests and messages.
    #[derive(PartialOrd, Ord)]
    pub enum AxisName {
        /// Tilt of the camera, θc.
        ThetaC = "theta_c",
        /// Rotation of the sample, φs.
        PhiS = "phi_s",
    }
}

/// A name that is neither `theta_c` nor `phi_s`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown axis {0:?}: the axes are theta_c and phi_s")]
pub struct UnknownAxis(pub String);

impl FromStr for AxisName {
    type Err = UnknownAxis;

    fn from_str(name: &str) -> Result<Self, UnknownAxis> {
        AxisName::from_word(name).ok_or_else(|| UnknownAxis(name.to_owned()))
    }
}

/// The frame that a camera should take.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureRequest {
    /// Kind of the frame.
    pub kind: FrameKind,
    /// Position read back from the stage.
    pub pose: Pose,
    /// Exposure time.
    pub exposure_s: f64,
    /// Index of the repeat, from 0.
    pub repeat: u32,
}

/// A frame with its time stamps.
#[derive(Debug, Clone, PartialEq)]
pub struct Captured {
    /// The counts.
    pub frame: Frame,
    /// Start of the exposure, in the injected clock's monotonic time.
    pub started_at: Duration,
    /// Start of the exposure in UTC.
    pub started_utc: time::OffsetDateTime,
    /// What the camera's program states about the frame.
    pub tag: FrameTag,
}

/// A device that takes frames. `lab::assembly` makes the one of the settings, a [`watched_folder::WatchedFolder`]; `sim::rig`
/// makes the simulated one.
pub trait Camera: Send {
    /// One line for the user and the log: make, model, serial number.
    fn describe(&self) -> String;

    /// Takes one frame. The future may be dropped to cancel; the next capture must still work.
    fn capture<'a>(
        &'a mut self,
        request: &'a CaptureRequest,
    ) -> BoxFuture<'a, Result<Captured, CameraError>>;
}

/// Why the camera returned no frame.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// No frame came within the time limit.
    #[error("no frame came within {waited_s:.1} s: {hint}")]
    TimedOut {
        /// Time waited, in seconds.
        waited_s: f64,
        /// What to check.
        hint: String,
    },
    /// The camera delivered a file or buffer that is not a frame.
    #[error("the camera's output is not a frame: {0}")]
    NotAFrame(#[from] crate::frame::FrameError),
    /// The camera's program states something about the frame that cannot be read.
    #[error("{0}")]
    BadTag(#[from] TagError),
    /// The camera's program or device failed.
    #[error("the camera failed: {0}")]
    Failed(String),
}
