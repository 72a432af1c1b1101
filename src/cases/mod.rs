//! Named cases that checks, accuracy measurements and tests share: samples, painted observations, series in memory, and the
//! recorded series and reference tables that are part of the program.
//!
//! A case states its truth. None of them reads a file, and none knows what is expected of a computation.

mod memory;
mod painted;
mod recorded;
pub mod reference;
mod samples;

pub use memory::MemorySeries;
pub use painted::{PaintedError, PaintedScan, PaintedSigma, pose_grid};
pub use recorded::{
    PAPER_RIG_FULL, POLYMER_10, RECORDED_SERIES, RecordedSeries, RecordedTruth, STEEL_15,
};
pub use samples::{MIRROR, POLYMER, STEEL, SampleCase};
