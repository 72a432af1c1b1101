//! A source of frames that are read once, however often they are reduced.

use super::{FrameSource, ReductionCache};
use crate::frame::Frame;
use crate::series::{FrameReadError, FrameRow, Manifest};

/// A source whose reductions are kept in memory while it lives: a forecast and the fit after it read each frame
/// once.
#[derive(Debug, Default)]
pub struct Remembering<S> {
    source: S,
    cache: ReductionCache,
}

impl<S: FrameSource> Remembering<S> {
    /// Wraps a source.
    pub fn new(source: S) -> Self {
        Remembering {
            source,
            cache: ReductionCache::default(),
        }
    }
}

impl<S: FrameSource> FrameSource for Remembering<S> {
    fn manifest(&self) -> &Manifest {
        self.source.manifest()
    }

    fn rows(&self) -> &[FrameRow] {
        self.source.rows()
    }

    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        self.source.read(index)
    }

    fn frame_id(&self, index: usize) -> i64 {
        self.source.frame_id(index)
    }

    fn reductions(&self) -> Option<&ReductionCache> {
        Some(&self.cache)
    }

    fn is_growing(&self) -> bool {
        self.source.is_growing()
    }
}
