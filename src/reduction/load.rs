//! How the reduction asks for frames: the source, the cancel flag, and the checks that every frame
//! has to pass.

mod byte_order;

use std::sync::atomic::{AtomicBool, Ordering};

use self::byte_order::ByteOrder;
use super::journal::{Journal, Rejection};
use super::sensor::Sensor;
use super::{FrameSource, ReductionError};
use crate::frame::{Frame, FrameKind};
use crate::series::FrameReadError;
use crate::wording::significant;

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
/// Reason of a frame whose bytes stand the wrong way round.
const SWAPPED: &str = "bytes swapped";
/// Frames that are looked at again before counts are called impossible.
const LOOKED_AT: usize = 16;

/// Refuses a series of which most frames of one kind hold counts that the stated converter cannot give, or counts with their
/// bytes swapped: then the counts lie otherwise in their files than is assumed, or the bits are wrong, and the other frames
/// are not to be trusted either.
pub(super) fn refuse_impossible(
    calls: &Calls<'_>,
    kind: FrameKind,
    journal: &Journal,
) -> Result<(), ReductionError> {
    let rows = calls.source.rows();
    let rejected_for = |reason| {
        let rejected = journal.rejected_for(reason);
        let of_kind = rejected.filter(|(index, _)| rows[*index].kind == kind);
        of_kind.collect::<Vec<_>>()
    };
    let of = calls.rows_of(kind);
    if !rejected_for(SWAPPED).is_empty() {
        refuse_swapped(calls, kind, &of)?;
    }
    let impossible: Vec<(usize, &Rejection)> = rejected_for(IMPOSSIBLE);
    match impossible.first() {
        Some((index, rejection)) if impossible.len() * 2 > of.len() => {
            // Dark frames do not tell the order of their bytes; brighter ones do.
            let rows = [FrameKind::Flat, FrameKind::Sample].map(|kind| (kind, calls.rows_of(kind)));
            for (kind, of) in &rows {
                let some = of.iter().step_by(of.len().div_ceil(LOOKED_AT).max(1));
                refuse_swapped(calls, *kind, &some.copied().collect::<Vec<_>>())?;
            }
            Err(ReductionError::ImpossibleCounts {
                kind: kind.as_str(),
                frames: impossible.len(),
                of: of.len(),
                first: calls.source.rows()[*index].file.clone(),
                detail: rejection.detail.clone(),
            })
        }
        _ => Ok(()),
    }
}

fn told(stands: f64, swapped: f64) -> String {
    format!(
        "neighbouring pixels differ by {} counts, and by {} once swapped",
        significant(stands),
        significant(swapped)
    )
}

/// Refuses frames of which more show swapped bytes than the right order.
fn refuse_swapped(
    calls: &Calls<'_>,
    kind: FrameKind,
    frames: &[usize],
) -> Result<(), ReductionError> {
    let (mut right, mut swapped, mut first) = (0, 0, None);
    for index in frames {
        calls.check_cancel()?;
        let Ok(frame) = calls.source.read(*index) else {
            continue;
        };
        match ByteOrder::of(&frame) {
            ByteOrder::Right => right += 1,
            ByteOrder::Unknown => {}
            ByteOrder::Swapped { stands, swapped: s } => {
                swapped += 1;
                first.get_or_insert((*index, stands, s));
            }
        }
    }
    match first {
        Some((index, stands, once)) if swapped > right => Err(ReductionError::ImpossibleCounts {
            kind: kind.as_str(),
            frames: swapped,
            of: frames.len(),
            first: calls.source.rows()[index].file.clone(),
            detail: format!(
                "the two bytes of each count are swapped ({}): write the frames anew in the byte order of their format, \
                 most significant byte first in a PNG, as the header states in a TIFF",
                told(stands, once)
            ),
        }),
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
    if let ByteOrder::Swapped { stands, swapped } = ByteOrder::of(&frame) {
        return Err(Rejection::new(SWAPPED, told(stands, swapped)));
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
