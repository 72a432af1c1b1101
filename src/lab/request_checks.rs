//! Checks of requests, shared by all kinds of jobs.

use super::{Lab, LabError, StoredSeries};
use crate::reduction::FrameSource;

/// Largest limit of a time or an error.
const LIMIT_MAX: f64 = 1e9;

/// Refuses limits that are not greater than 0 or above [`LIMIT_MAX`], by name.
pub(super) fn positive<const N: usize>(limits: [(&str, Option<f64>); N]) -> Result<(), LabError> {
    let wrong = |x: &f64| !(*x > 0.0 && *x <= LIMIT_MAX);
    match limits.iter().find(|(_, x)| x.as_ref().is_some_and(wrong)) {
        Some((field, _)) => Err(invalid(*field, "must be greater than 0, and at most 1e9")),
        None => Ok(()),
    }
}

/// Refuses a share that is not between 0 and 1.
pub(super) fn share(field: &str, share: Option<f64>) -> Result<(), LabError> {
    match share {
        Some(x) if !(x > 0.0 && x < 1.0) => Err(invalid(
            field,
            "must be between 0 and 1: 0.01 is one per cent",
        )),
        _ => Ok(()),
    }
}

pub(super) fn invalid(field: impl Into<String>, problem: impl Into<String>) -> LabError {
    LabError::Invalid {
        field: field.into(),
        problem: problem.into(),
    }
}

/// Refuses a region that the part does not have, and a missing one where it has several.
pub(super) fn check_region(series: &StoredSeries, region: Option<&str>) -> Result<(), LabError> {
    let regions = Lab::regions(series.manifest());
    let problem = match region {
        Some(name) if regions.iter().any(|r| r == name) => return Ok(()),
        None if regions.is_empty() => return Ok(()),
        Some(name) if regions.is_empty() => {
            format!("there is no region {name:?}: this part has none; leave it out")
        }
        _ => format!("this part has regions; name one of {}", regions.join(", ")),
    };
    Err(invalid("region", problem))
}
