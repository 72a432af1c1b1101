//! What the daemon computes on request: the kinds of jobs, their states and their numbers.
//!
//! The events, the store, the lab and the HTTP interface share these types.

use std::fmt;

use serde::{Deserialize, Serialize};

/// The kind of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum JobKind {
    /// The model fitted to a scan.
    Fit,
    /// The model fitted to every pixel of a scan.
    Map,
    /// The contrast table of a scan.
    Contrast,
    /// A scan judged against a specification.
    Verdict,
    /// Light traced through a scene by Monte Carlo.
    Trace,
}

impl JobKind {
    /// All kinds.
    pub const ALL: [JobKind; 5] = [
        JobKind::Fit,
        JobKind::Map,
        JobKind::Contrast,
        JobKind::Verdict,
        JobKind::Trace,
    ];

    /// The word used in events and the database.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            JobKind::Fit => "fit",
            JobKind::Map => "map",
            JobKind::Contrast => "contrast",
            JobKind::Verdict => "verdict",
            JobKind::Trace => "trace",
        }
    }

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
        let kind = Self::ALL.into_iter().find(|kind| kind.as_str() == word);
        kind.ok_or_else(|| format!("`{word}` is not a kind of job"))
    }
}

impl fmt::Display for JobKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
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

/// The state of a job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = TaskState)]
pub enum JobState {
    /// Accepted, and waiting for a slot or running.
    Running,
    /// There is a result, whatever its status.
    Completed,
    /// An error ended it.
    Failed,
    /// A user cancelled it.
    Cancelled,
    /// The daemon ended while the job ran.
    Interrupted,
}

impl JobState {
    /// All states.
    pub const ALL: [JobState; 5] = [
        JobState::Running,
        JobState::Completed,
        JobState::Failed,
        JobState::Cancelled,
        JobState::Interrupted,
    ];

    /// The word used in requests and the database.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            JobState::Running => "running",
            JobState::Completed => "completed",
            JobState::Failed => "failed",
            JobState::Cancelled => "cancelled",
            JobState::Interrupted => "interrupted",
        }
    }

    /// The state that a word names.
    #[must_use]
    pub fn from_word(word: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|state| state.as_str() == word)
    }
}

impl TryFrom<String> for JobState {
    type Error = String;

    fn try_from(word: String) -> Result<Self, String> {
        JobState::from_word(&word).ok_or_else(|| format!("`{word}` is not a state of a job"))
    }
}

impl fmt::Display for JobState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}
