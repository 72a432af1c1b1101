//! Why a job has no result: a stable code and a message.

use super::LabError;
use crate::analysis::AnalysisError;
use crate::map::MapError;
use crate::map::folder::FolderError;
use crate::reduction::ReductionError;

/// Why a job has no result.
pub(super) enum Failure {
    Cancelled,
    Because { code: &'static str, detail: String },
}

impl Failure {
    /// An error with a stable code.
    pub(super) fn because(code: &'static str, error: impl std::fmt::Display) -> Self {
        Failure::Because {
            code,
            detail: error.to_string(),
        }
    }

    pub(super) fn not_json(error: serde_json::Error) -> Self {
        Failure::because("internal", format_args!("the result is not JSON: {error}"))
    }
}

impl From<LabError> for Failure {
    fn from(error: LabError) -> Self {
        Failure::because(error.code(), error)
    }
}

impl From<ReductionError> for Failure {
    fn from(error: ReductionError) -> Self {
        match error {
            ReductionError::Cancelled => Failure::Cancelled,
            ReductionError::RegionNeeded { .. } => Failure::because("region-needed", error),
            ReductionError::UnknownRegion { .. } => Failure::because("region-unknown", error),
            error => Failure::because("no-observations", error),
        }
    }
}

impl From<AnalysisError> for Failure {
    fn from(error: AnalysisError) -> Self {
        match error {
            AnalysisError::Cancelled => Failure::Cancelled,
            AnalysisError::Reduction(error) => error.into(),
        }
    }
}

impl From<FolderError> for Failure {
    fn from(error: FolderError) -> Self {
        match error {
            FolderError::Map(MapError::Cancelled) => Failure::Cancelled,
            FolderError::Map(MapError::Reduction(error)) => error.into(),
            FolderError::Map(_) | FolderError::Late { .. } => Failure::because("no-map", error),
            FolderError::Write(_) => Failure::because("map-not-written", error),
        }
    }
}
