//! From frames to an answer in one call: read, reduce, fit, with the seconds each took.
//!
//! The one function to call is [`analyse`]; command line and daemon both do. It does not know where
//! frames come from ([`FrameSource`]) and prints nothing: progress is told to a callback.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::time::Instant;

use crate::fit::traced::TracingProgress;
use crate::fit::{self, FitOptions, FitReport};
use crate::frame::Frame;
use crate::observation::ObservationSet;
use crate::reduction::{FrameReadError, FrameSource, ReductionError, reduce};
use crate::series::{FrameRow, Manifest};
use crate::trace::profile::Profile;

/// What an analysis may be told.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AnalysisOptions {
    /// Region of a sample that has several.
    pub region: Option<String>,
    /// Variant, starts, seed.
    pub fit: FitOptions,
    /// The sample's own shape, for the ray tracer; the ideal sawtooth if not given.
    pub profile: Option<Profile>,
    /// The ray tracer ends after so many seconds; what it reached by then counts.
    pub max_seconds: Option<f64>,
}

/// Where an analysis stands. Frames may be read more than once, so `done` may pass `total`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// Frames are read and reduced.
    Reducing {
        /// Frames read.
        done: usize,
        /// Frames in the series.
        total: usize,
    },
    /// The model is being fitted.
    Fitting,
    /// The ray tracer is at work.
    Tracing {
        /// Paths traced.
        done: u64,
        /// Paths that are foreseen.
        total: u64,
    },
}

/// Why there is no report.
#[derive(Debug, thiserror::Error)]
pub enum AnalysisError {
    /// The frames give no observations.
    #[error(transparent)]
    Reduction(#[from] ReductionError),
    /// The cancel flag was raised.
    #[error("the analysis was cancelled")]
    Cancelled,
}

/// A report and the observations that it rests on.
#[derive(Debug, Clone, PartialEq)]
pub struct Analysis {
    /// What was fitted.
    pub observations: ObservationSet,
    /// The answer.
    pub report: FitReport,
}

/// Reads, reduces and fits; `progress` may be called from several threads at once.
///
/// # Errors
/// [`AnalysisError`]. A fit that fails is no error: the report's status says so.
pub fn analyse(
    source: &dyn FrameSource,
    options: &AnalysisOptions,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Analysis, AnalysisError> {
    let started = Instant::now();
    let timed = Timed {
        source,
        progress,
        reads: AtomicUsize::new(0),
        nanoseconds: AtomicU64::new(0),
    };
    let observations = match reduce(&timed, options.region.as_deref(), cancel) {
        Err(ReductionError::Cancelled) => return Err(AnalysisError::Cancelled),
        other => other?,
    };
    let reduced_s = started.elapsed().as_secs_f64();
    // Several threads read at once: their sum, shared out, is the part of the time that went there.
    let threads = rayon::current_num_threads().max(1) as f64;
    let summed_s = timed.nanoseconds.load(Ordering::Relaxed) as f64 * 1e-9;
    let read_s = (summed_s / threads).min(reduced_s);
    progress(Progress::Fitting);
    let fitting = Instant::now();
    let watch = |p: TracingProgress| {
        progress(Progress::Tracing {
            done: p.done,
            total: p.planned,
        });
        let spent = fitting.elapsed().as_secs_f64();
        options.max_seconds.is_none_or(|limit| spent < limit)
    };
    let profile = options.profile.as_ref();
    let mut report = fit::fit_watched(&observations, &options.fit, profile, &watch, cancel);
    if cancel.load(Ordering::Relaxed) {
        return Err(AnalysisError::Cancelled);
    }
    report.timing_s = fit::report::Timing {
        read: read_s,
        reduce: reduced_s - read_s,
        fit: fitting.elapsed().as_secs_f64(),
    };
    Ok(Analysis {
        observations,
        report,
    })
}

/// Counts and times what the reduction reads.
struct Timed<'a> {
    source: &'a dyn FrameSource,
    progress: &'a (dyn Fn(Progress) + Sync),
    reads: AtomicUsize,
    nanoseconds: AtomicU64,
}

impl FrameSource for Timed<'_> {
    fn manifest(&self) -> &Manifest {
        self.source.manifest()
    }

    fn rows(&self) -> &[FrameRow] {
        self.source.rows()
    }

    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        let started = Instant::now();
        let frame = self.source.read(index);
        let spent = u64::try_from(started.elapsed().as_nanos()).unwrap_or(u64::MAX);
        self.nanoseconds.fetch_add(spent, Ordering::Relaxed);
        let done = self.reads.fetch_add(1, Ordering::Relaxed) + 1;
        let total = self.source.rows().len();
        (self.progress)(Progress::Reducing { done, total });
        frame
    }
}
