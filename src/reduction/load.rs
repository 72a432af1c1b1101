//! How the reduction asks for frames: the source, the cancel flag, and the checks that every frame
//! has to pass.

use std::sync::atomic::{AtomicBool, Ordering};

use super::journal::Rejection;
use super::sensor::Sensor;
use super::{FrameSource, ReductionError};
use crate::frame::{Frame, FrameKind};
use crate::series::FrameReadError;

/// What every step of the reduction is handed.
#[derive(Clone, Copy)]
pub(super) struct Calls<'a> {
    pub(super) source: &'a dyn FrameSource,
    pub(super) cancel: &'a AtomicBool,
}

impl Calls<'_> {
    pub(super) fn check_cancel(&self) -> Result<(), ReductionError> {
        if self.cancel.load(Ordering::Relaxed) {
            Err(ReductionError::Cancelled)
        } else {
            Ok(())
        }
    }

    /// Indices of the frames of one kind.
    pub(super) fn rows_of(&self, kind: FrameKind) -> Vec<usize> {
        let rows = self.source.rows().iter().enumerate();
        rows.filter(|(_, row)| row.kind == kind)
            .map(|(index, _)| index)
            .collect()
    }
}

/// Frame `index`, if it can be read and has the size that the manifest states.
pub(super) fn load(calls: &Calls<'_>, index: usize, sensor: &Sensor) -> Result<Frame, Rejection> {
    let frame = calls.source.read(index).map_err(|error| {
        let reason = match error {
            FrameReadError::Missing { .. } => "missing",
            _ => "unreadable",
        };
        Rejection::new(reason, error.to_string())
    })?;
    let (width, height) = (frame.width_px() as usize, frame.height_px() as usize);
    if (width, height) != (sensor.width, sensor.height) {
        return Err(Rejection::new(
            "wrong size",
            format!(
                "{width} × {height} pixels instead of {} × {}",
                sensor.width, sensor.height
            ),
        ));
    }
    Ok(frame)
}
