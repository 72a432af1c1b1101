//! How the reduction asks for frames: the source, the cancel flag, and the checks that every frame
//! has to pass.

use std::sync::atomic::{AtomicBool, Ordering};

use super::journal::{Journal, Rejection};
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

/// Reason of a frame whose counts are more than the stated converter gives.
const IMPOSSIBLE: &str = "impossible counts";

/// Refuses a series of which most frames of one kind hold counts that the stated converter cannot give: then the counts lie
/// otherwise in their files than is assumed, or the bits are wrong, and the other frames are not to be trusted either.
pub(super) fn refuse_impossible(
    calls: &Calls<'_>,
    kind: FrameKind,
    journal: &Journal,
) -> Result<(), ReductionError> {
    let rows = calls.source.rows();
    let of = calls.rows_of(kind).len();
    let impossible: Vec<(usize, &Rejection)> = journal
        .rejected_for(IMPOSSIBLE)
        .filter(|(index, _)| rows[*index].kind == kind)
        .collect();
    match impossible.first() {
        Some((index, rejection)) if impossible.len() * 2 > of => {
            Err(ReductionError::ImpossibleCounts {
                kind: kind.as_str(),
                frames: impossible.len(),
                of,
                first: rows[*index].file.clone(),
                detail: rejection.detail.clone(),
            })
        }
        _ => Ok(()),
    }
}

/// Frame `index`, if it can be read, has the size that the manifest states, and no count that the converter cannot give.
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
    possible(&frame, sensor)?;
    Ok(frame)
}

/// Left-aligned counts would pass for full pixels.
fn possible(frame: &Frame, sensor: &Sensor) -> Result<(), Rejection> {
    let (above, highest) = frame
        .pixels_dn()
        .iter()
        .filter(|dn| **dn > sensor.count_max)
        .fold((0_usize, 0), |(n, high), dn| (n + 1, high.max(*dn)));
    match sensor.bit_depth {
        Some(bits) if above > 0 => Err(Rejection::new(
            IMPOSSIBLE,
            format!(
                "{above} of {} pixels count above {} (up to {highest}), the most that camera.bit_depth = {bits} allows: \
                 right-align the counts, or correct bit_depth",
                frame.pixels_dn().len(),
                sensor.count_max
            ),
        )),
        _ => Ok(()),
    }
}
