//! What the daemon computes on request: the kinds of jobs, their states and their numbers.
//!
//! The events, the store, the lab and the HTTP interface share these types.

use std::fmt;

use crate::words::words;

words! {
    /// The kind of a job.
    #[derive(utoipa::ToSchema)]
    pub enum JobKind {
        /// The model fitted to a scan.
        Fit = "fit",
        /// The model fitted to every pixel of a scan.
        Map = "map",
        /// The contrast table of a scan.
        Contrast = "contrast",
        /// A scan judged against a specification.
        Verdict = "verdict",
        /// Light traced through a scene by Monte Carlo.
        Trace = "trace",
    }
}

impl JobKind {
    /// The plural used in paths and folder names.
    #[must_use]
    pub const fn plural(self) -> &'static str {
        match self {
            JobKind::Fit => "fits",
            JobKind::Map => "maps",
            JobKind::Contrast => "contrasts",
            JobKind::Verdict => "verdicts",
            JobKind::Trace => "traces",
        }
    }
}

impl TryFrom<String> for JobKind {
    type Error = String;

    fn try_from(word: String) -> Result<Self, String> {
        JobKind::from_word(&word).ok_or_else(|| format!("`{word}` is not a kind of job"))
    }
}

/// A job's name: its kind and its number within the kind. `/fits/7` is fit 7.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct JobId {
    /// Kind.
    pub kind: JobKind,
    /// Number within the kind, from 1.
    pub number: i64,
}

impl JobId {
    /// The job of a kind and number.
    #[must_use]
    pub const fn new(kind: JobKind, number: i64) -> Self {
        JobId { kind, number }
    }
}

impl fmt::Display for JobId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.kind, self.number)
    }
}

words! {
    /// The state of a job.
    #[derive(utoipa::ToSchema)]
    #[schema(as = TaskState)]
    pub enum JobState {
        /// Accepted, and waiting for a slot or running.
        Running = "running",
        /// There is a result, whatever its status.
        Completed = "completed",
        /// An error ended it.
        Failed = "failed",
        /// A user cancelled it.
        Cancelled = "cancelled",
        /// The daemon ended while the job ran.
        Interrupted = "interrupted",
    }
}

impl TryFrom<String> for JobState {
    type Error = String;

    fn try_from(word: String) -> Result<Self, String> {
        JobState::from_word(&word).ok_or_else(|| format!("`{word}` is not a state of a job"))
    }
}
