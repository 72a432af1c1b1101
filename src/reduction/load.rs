//! Loads frames: the source, the cancel flag, and the checks that every frame must pass.

mod byte_order;
mod clipped;

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use self::byte_order::ByteOrder;
use self::clipped::clipped;
use super::reduction_log::{ReductionLog, Rejection};
use super::sensor::Sensor;
use super::{FrameSource, ReductionError};
use crate::frame::{Frame, FrameKind};
use crate::series::FrameReadError;
use crate::wording::significant;

/// Bytes of decoded frames that one calibration holds: its dark and flat frames are looked at several times. Frames beyond
/// that are decoded again.
const HELD_BYTES: usize = 256 << 20;

/// Decoded frames that are needed more than once.
#[derive(Debug, Default)]
pub(super) struct HeldFrames(Mutex<HashMap<usize, Arc<Frame>>>);

impl HeldFrames {
    fn all(&self) -> MutexGuard<'_, HashMap<usize, Arc<Frame>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn get(&self, index: usize) -> Option<Arc<Frame>> {
        self.all().get(&index).cloned()
    }

    fn hold(&self, index: usize, frame: &Arc<Frame>) {
        let mut all = self.all();
        // All frames of a series have one size.
        let bytes = size_of_val(frame.pixels_dn());
        if (all.len() + 1).saturating_mul(bytes) <= HELD_BYTES {
            all.insert(index, Arc::clone(frame));
        }
    }

    /// Lets all frames go.
    pub(super) fn clear(&self) {
        self.all().clear();
    }
}

/// The source of frames, the cancel flag and the held frames.
#[derive(Clone, Copy)]
pub(super) struct Calls<'a> {
    pub(super) source: &'a dyn FrameSource,
    pub(super) cancel: &'a AtomicBool,
    pub(super) held: &'a HeldFrames,
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

/// Reason of a frame with counts above the range of the stated converter.
const IMPOSSIBLE: &str = "impossible counts";
/// Reasons of frames whose files cannot be read now and may be readable later.
const MISSING: &str = "missing";
const UNREADABLE: &str = "unreadable";
/// Reason of a frame with swapped bytes.
const SWAPPED: &str = "bytes swapped";
/// Frames that are checked for swapped bytes before counts are called impossible.
const LOOKED_AT: usize = 16;

/// Refuses a series if most frames of one kind contain counts that the stated converter cannot give, or swapped bytes: then
/// the format of the files or the stated bits are wrong, and the other frames cannot be trusted either.
pub(super) fn refuse_impossible(
    calls: &Calls<'_>,
    kind: FrameKind,
    log: &ReductionLog,
) -> Result<(), ReductionError> {
    let rows = calls.source.rows();
    let rejected_for = |reason| {
        let rejected = log.rejected_for(reason);
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
            // The order of the bytes shows in bright frames only.
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

fn differences(stands: f64, swapped: f64) -> String {
    format!(
        "neighbouring pixels differ by {} counts, and by {} once swapped",
        significant(stands),
        significant(swapped)
    )
}

/// Refuses frames if more of them have swapped bytes than the correct order.
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
                "the two bytes of each count are swapped ({}): write the frames again in the byte order of their format, \
                 most significant byte first in a PNG, as stated in the header of a TIFF",
                differences(stands, once)
            ),
        }),
        _ => Ok(()),
    }
}

/// Loads frame `index` and holds it for the next call. The frame must be readable, have the size that the manifest states,
/// and contain no count that the converter cannot give.
pub(super) fn load(
    calls: &Calls<'_>,
    index: usize,
    sensor: &Sensor,
) -> Result<Arc<Frame>, Rejection> {
    let frame = load_once(calls, index, sensor)?;
    calls.held.hold(index, &frame);
    Ok(frame)
}

/// Loads a frame that is not needed again.
pub(super) fn load_once(
    calls: &Calls<'_>,
    index: usize,
    sensor: &Sensor,
) -> Result<Arc<Frame>, Rejection> {
    match calls.held.get(index) {
        Some(frame) => Ok(frame),
        None => read(calls.source, index, sensor).map(Arc::new),
    }
}

fn read(source: &dyn FrameSource, index: usize, sensor: &Sensor) -> Result<Frame, Rejection> {
    let frame = source.read(index).map_err(|error| {
        let reason = match error {
            FrameReadError::Missing { .. } => MISSING,
            _ => UNREADABLE,
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
        return Err(Rejection::new(SWAPPED, differences(stands, swapped)));
    }
    possible(&frame, sensor)?;
    clipped(&frame, sensor)?;
    Ok(frame)
}

/// Returns whether a frame is left out for its counts, and not because its file could not be read.
pub(super) fn is_of_counts(rejection: &Rejection) -> bool {
    rejection.reason != MISSING && rejection.reason != UNREADABLE
}

/// Refuses counts above the range of the converter. Left-aligned counts would look like full pixels.
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
