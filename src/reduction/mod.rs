//! Frames → observations with uncertainties, and a list of all frames that were left out.
//!
//! [`reduce`] reads every frame once. Dark frames give dark levels and hot pixels (`darks`), flats the response of the pixels
//! and their defects (`flats`). Each sample frame becomes sums over the pixels of each segment (`measure`, `levels`), which a
//! [`ReductionCache`] keeps: the next reduction of the same frames merges the sums and reads nothing. Exposures of one pose
//! determine the camera's curve (`detector`), which is applied to the sums (`scale`); then the frames of each pose are merged
//! (`merge`). Frames are read and dropped one by one on all cores, and the sums of a long series stay in the store, so memory
//! hardly grows with the series; only the dark and flat frames of one calibration are held, up to 256 MB.
//!
//! The signal is in units of radiance for a lamp irradiance of 1 on a surface facing it, under the
//! provisional assumption that the flats contain no stray light: signal = gain · (L + s), flat = gain ·
//! (ρ/π cos θi + s) with gain near 1. The fit determines the stray light s, the gain and the tilt's zero from
//! flats and samples together. This module knows no reflectance model.

mod cache;
mod calibration;
mod calibration_sums;
mod camera_calibration;
mod counted_reads;
mod darks;
mod detector;
mod flats;
mod levels;
mod load;
mod measure;
mod measured_series;
mod merge;
mod observation_set;
mod outcomes;
mod outlier_pixels;
mod pattern;
mod pose_means;
mod reduction_log;
mod refusals;
mod region;
mod register;
mod remembering;
mod scale;
mod sensor;
mod series_context;
mod shading;
mod shading_check;
mod viewing;

use std::sync::atomic::AtomicBool;

pub use self::cache::{CalibrationText, FrameText, ReductionCache, ReductionTexts, TextStore};
pub use self::camera_calibration::{CameraCalibration, DarkLevel, calibrate};
pub(crate) use self::counted_reads::CountedReads;
pub use self::refusals::ReductionError;
pub use self::remembering::Remembering;
pub use self::series_context::calibration_keys;
pub use crate::series::FrameReadError;

use self::load::{Calls, HeldFrames};
use self::measured_series::MeasuredSeries;
use self::merge::MergeContext;
use self::observation_set::PoseMeans;
use self::reduction_log::ReductionLog;
use self::region::Segments;
use self::series_context::SeriesContext;
use self::viewing::Viewing;
use crate::frame::{Frame, FrameKind};
use crate::geometry::Pose;
use crate::observation::ObservationSet;
use crate::series::{FrameRow, Manifest, Series};
use crate::wording::counted;

/// A source of frames: a recorded series, or a scan in the store.
///
/// [`read`](FrameSource::read) is called from several threads at once.
pub trait FrameSource: Sync {
    /// Rig, camera, references and nominal material.
    fn manifest(&self) -> &Manifest;
    /// The list of frames.
    fn rows(&self) -> &[FrameRow];
    /// Frame `index` of the list.
    ///
    /// # Errors
    /// [`FrameReadError`] if it cannot be read; the reduction then leaves it out.
    fn read(&self, index: usize) -> Result<Frame, FrameReadError>;

    /// Returns the number of a frame, which stays the same while frames are added to the list.
    fn frame_id(&self, index: usize) -> i64 {
        index as i64
    }

    /// Returns what earlier reductions computed of these frames. Without a cache every reduction reads all frames.
    fn reductions(&self) -> Option<&ReductionCache> {
        None
    }

    /// Returns whether more frames will come. Then the sample does not replace missing flats: each new frame would change
    /// the response that all others were measured with.
    fn is_growing(&self) -> bool {
        false
    }

    /// Returns the poses of the sample frames in the list.
    fn sample_poses(&self) -> Vec<Pose> {
        let samples = self
            .rows()
            .iter()
            .filter(|row| row.kind == FrameKind::Sample);
        samples.map(FrameRow::pose).collect()
    }
}

impl FrameSource for Series {
    fn manifest(&self) -> &Manifest {
        Series::manifest(self)
    }

    fn rows(&self) -> &[FrameRow] {
        Series::rows(self)
    }

    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        Series::read(self, index)
    }
}

/// Checks what [`reduce`] refuses before it reads a frame.
///
/// # Errors
/// [`ReductionError`].
pub fn check(source: &dyn FrameSource) -> Result<(), ReductionError> {
    Viewing::of(source.manifest())?;
    let of = |kind: FrameKind| source.rows().iter().filter(|row| row.kind == kind).count();
    if of(FrameKind::Sample) > 0 {
        return Ok(());
    }
    let why = match of(FrameKind::Dark) + of(FrameKind::Flat) {
        0 => "the list has no sample frame".to_owned(),
        calibration => format!(
            "the list has no sample frame, only {} (dark or white reference) for scans of a sample; fit one of those",
            counted(calibration, "calibration frame")
        ),
    };
    Err(ReductionError::NoObservations { why })
}

/// Reduces the frames of a series to observations of the sample, or of one `region` of it.
/// `cancel` is checked between frames.
///
/// # Errors
/// [`ReductionError`]. Frames that cannot be used are listed in `rejected_frames`.
pub fn reduce(
    source: &dyn FrameSource,
    region: Option<&str>,
    cancel: &AtomicBool,
) -> Result<ObservationSet, ReductionError> {
    check(source)?;
    let calls = Calls {
        source,
        cancel,
        held: &HeldFrames::default(),
    };
    let (segments, chosen) = Segments::of(source.manifest(), region)?;
    let series = SeriesContext::new(source)?;
    let own = ReductionCache::default();
    let mut kept = source.reductions().unwrap_or(&own).lock();
    let measured = MeasuredSeries::of(&calls, &series, &mut kept, region, segments)?;
    let mut log = ReductionLog::default();
    observation_set::warn_of_unread_times(source.rows(), &mut log);
    let frames = measured.frames(&calls, &series, &kept, &mut log)?;
    drop(kept);

    let far = series.viewing.is_far();
    if far && matches!(measured.segments, Segments::Whole) {
        let clean = frames.iter().filter(|frame| frame.is_clean());
        let levels = clean.filter_map(|frame| frame.levels.first());
        shading_check::warn(levels.clone().map(|level| level.slope), &mut log);
        shading_check::warn_of_parts(levels.map(levels::Level::unevenness), &mut log);
    }
    let context = MergeContext {
        rows: source.rows(),
        material: source.manifest().material(),
        scale: &measured.scale,
    };
    let (mut poses, lamp_scatter) = merge::merge(&context, frames, &mut log);
    // Patches of a near rig differ by their place, which makes them neither worn nor uncertain.
    if far {
        pose_means::leave_out_worn_patches(&measured.segments, chosen, &mut poses, &mut log);
    }
    pose_means::warn_of_lost_poses(&calls, &poses, &mut log);
    let means = PoseMeans {
        source,
        series: &series,
        measured: &measured,
        region,
        chosen,
        levels: pose_means::levels(source.rows(), &poses, far, &mut log),
        lamp_scatter,
    };
    means.observation_set(log)
}

#[cfg(test)]
mod extreme_tests;
#[cfg(test)]
mod synthetic;
#[cfg(test)]
mod tests;
