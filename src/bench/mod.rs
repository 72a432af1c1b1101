//! Real devices: what a stage and a camera are to the rest of the program.
//!
//! [`stage::Stage`] moves the two axes and proves where they stand; whatever implements [`Camera`]
//! turns a [`CaptureRequest`] into a frame. From the bytes up: `wire` (a protocol, pure) · `port`
//! (bytes, and the seam for faults) · `line` (the one thread that owns a port) · `stage` (limits,
//! homing, arrival); a camera's `program` beside them. Knows no scan, no store and no simulation.

pub mod line;
pub mod port;
mod program;
pub mod stage;
pub mod watched_folder;
pub mod wire;

use std::fmt;
use std::str::FromStr;
use std::time::Duration;

use futures::future::BoxFuture;
use serde::{Deserialize, Serialize};

use crate::frame::{Frame, FrameKind};
use crate::geometry::Pose;

/// The two axes of a rig, by the names that people, files and requests use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AxisName {
    /// Tilt of the camera, θc.
    ThetaC,
    /// Rotation of the sample, φs.
    PhiS,
}

impl AxisName {
    /// Both axes.
    pub const ALL: [AxisName; 2] = [AxisName::ThetaC, AxisName::PhiS];

    /// `theta_c` or `phi_s`.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            AxisName::ThetaC => "theta_c",
            AxisName::PhiS => "phi_s",
        }
    }
}

impl fmt::Display for AxisName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// A name that is neither `theta_c` nor `phi_s`.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no axis is called {0:?}; the axes are theta_c and phi_s")]
pub struct UnknownAxis(pub String);

impl FromStr for AxisName {
    type Err = UnknownAxis;

    fn from_str(name: &str) -> Result<Self, UnknownAxis> {
        AxisName::ALL
            .into_iter()
            .find(|axis| axis.as_str() == name)
            .ok_or_else(|| UnknownAxis(name.to_owned()))
    }
}

/// What a camera is asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptureRequest {
    /// What the frame will show.
    pub kind: FrameKind,
    /// Position read back from the stages.
    pub pose: Pose,
    /// Exposure time.
    pub exposure_s: f64,
    /// Number of the repeat, from 0.
    pub repeat: u32,
}

/// A frame with what the camera knows about its making.
#[derive(Debug, Clone, PartialEq)]
pub struct Captured {
    /// The counts.
    pub frame: Frame,
    /// When the exposure began, on the injected clock's monotonic time.
    pub started_at: Duration,
    /// The same moment as a UTC label.
    pub started_utc: time::OffsetDateTime,
}

/// Anything that turns a request into a frame.
pub trait Camera: Send {
    /// One line for people and logs: make, model, serial number.
    fn describe(&self) -> String;

    /// Takes one frame. The future may be dropped to cancel; the next capture must still work.
    fn capture<'a>(
        &'a mut self,
        request: &'a CaptureRequest,
    ) -> BoxFuture<'a, Result<Captured, CameraError>>;
}

/// Why there is no frame.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// Nothing came in time.
    #[error("no frame came within {waited_s:.1} s: {hint}")]
    TimedOut {
        /// How long was waited.
        waited_s: f64,
        /// What to look at.
        hint: String,
    },
    /// A file or buffer came that is no frame.
    #[error("what the camera delivered is not a frame: {0}")]
    NotAFrame(#[from] crate::frame::FrameError),
    /// The camera's program or device failed.
    #[error("the camera failed: {0}")]
    Failed(String),
}
