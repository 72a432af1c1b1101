//! Why a calculation has no result: its code and its words.

use crate::analysis::AnalysisError;
use crate::map::MapError;
use crate::map::folder::FolderError;
use crate::reduction::ReductionError;

/// Why a calculation has no result.
pub(super) enum Failure {
    Cancelled,
    Because { code: &'static str, detail: String },
}

impl Failure {
    pub(super) fn internal(error: impl std::fmt::Display) -> Self {
        Failure::Because {
            code: "internal",
            detail: format!("the result is not JSON: {error}"),
        }
    }
}

impl From<ReductionError> for Failure {
    fn from(error: ReductionError) -> Self {
        match error {
            ReductionError::Cancelled => Failure::Cancelled,
            error => Failure::Because {
                code: reduction_code(&error),
                detail: error.to_string(),
            },
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
            FolderError::Map(error) => Failure::Because {
                code: "no-map",
                detail: error.to_string(),
            },
            FolderError::Late { .. } => Failure::Because {
                code: "no-map",
                detail: error.to_string(),
            },
            FolderError::Write(error) => Failure::Because {
                code: "map-not-written",
                detail: error.to_string(),
            },
        }
    }
}

/// Stable word for why frames give no observations.
#[must_use]
pub(super) fn reduction_code(error: &ReductionError) -> &'static str {
    match error {
        ReductionError::RegionNeeded { .. } => "region-needed",
        ReductionError::UnknownRegion { .. } => "region-unknown",
        _ => "no-observations",
    }
}
