//! Where frames come from: a recorded series, or a scan in the store.

use super::cache::ReductionCache;
use crate::frame::{Frame, FrameKind};
use crate::geometry::Pose;
use crate::series::{FrameReadError, FrameRow, Manifest, Series};

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
