//! A source of frames that reports each frame that is read.

use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering};
use std::time::Instant;

use super::{FrameSource, ReductionCache};
use crate::frame::Frame;
use crate::series::{FrameReadError, FrameRow, Manifest};

/// A source that counts and times the frames that are read, for progress and the duration of a reduction.
pub(crate) struct CountedReads<'a> {
    source: &'a dyn FrameSource,
    report: &'a (dyn Fn(usize, usize) + Sync),
    reads: AtomicUsize,
    nanoseconds: AtomicU64,
}

impl<'a> CountedReads<'a> {
    /// Wraps a source. `report` is called after each frame with the number of frames read and the length of the list.
    pub(crate) fn new(
        source: &'a dyn FrameSource,
        report: &'a (dyn Fn(usize, usize) + Sync),
    ) -> Self {
        CountedReads {
            source,
            report,
            reads: AtomicUsize::new(0),
            nanoseconds: AtomicU64::new(0),
        }
    }

    /// Returns the time spent reading, s, summed over all threads.
    pub(crate) fn summed_s(&self) -> f64 {
        self.nanoseconds.load(Ordering::Relaxed) as f64 * 1e-9
    }
}

impl FrameSource for CountedReads<'_> {
    fn manifest(&self) -> &Manifest {
        self.source.manifest()
    }

    fn rows(&self) -> &[FrameRow] {
        self.source.rows()
    }

    fn frame_id(&self, index: usize) -> i64 {
        self.source.frame_id(index)
    }

    fn reductions(&self) -> Option<&ReductionCache> {
        self.source.reductions()
    }

    fn is_growing(&self) -> bool {
        self.source.is_growing()
    }

    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        let started = Instant::now();
        let frame = self.source.read(index);
        let spent = u64::try_from(started.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.nanoseconds.fetch_add(spent, Ordering::Relaxed);
        let done = self.reads.fetch_add(1, Ordering::Relaxed) + 1;
        (self.report)(done, self.rows().len());
        frame
    }
}
