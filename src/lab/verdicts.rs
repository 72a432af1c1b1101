//! Verdicts: a scan judged against a specification.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use super::failure::Failure;
use super::fits::FitRequest;
use super::job_progress::ProgressMeter;
use super::job_work::{Finished, Work, report_analysis};
use super::request_checks::check_region;
use super::{LabError, StoredSeries};
use crate::accuracy::forecast::of_analysis;
use crate::analysis::{self, AnalysisOptions};
use crate::fit::VariantChoice;
use crate::forecast::Forecast;
use crate::judge::{Specification, VerdictReport};
use crate::reduction::FrameSource;
use crate::store::Store;
use crate::wording::json;

/// A request for a verdict.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct VerdictRequest {
    /// Scan to judge.
    pub scan_id: i64,
    /// The specification: name, limits by quantity, accepted risks.
    #[schema(value_type = Object)]
    pub specification: serde_json::Value,
    /// Variant that the verdict rests on; by default the better one.
    #[serde(default)]
    pub variant: VariantChoice,
    /// Region of a sample that has several.
    #[serde(default)]
    pub region: Option<String>,
    /// Time limit of the fit, s (see [`FitRequest`]).
    #[serde(default)]
    pub max_seconds: Option<f64>,
    /// Stop the ray tracer once its standard error, as a share of the largest radiance, is below this.
    #[serde(default)]
    pub target_error: Option<f64>,
    /// Largest share of the peak that the model may neglect.
    #[serde(default)]
    pub tolerance: Option<f64>,
}

impl VerdictRequest {
    /// The fit that the verdict rests on.
    fn fit(&self) -> FitRequest {
        FitRequest {
            scan_id: self.scan_id,
            variant: self.variant,
            region: self.region.clone(),
            max_seconds: self.max_seconds,
            target_error: self.target_error,
            tolerance: self.tolerance,
            ..FitRequest::default()
        }
    }

    pub(super) async fn prepare(&self, store: &Store) -> Result<VerdictWork, LabError> {
        let fit = self.fit();
        fit.check_values()?;
        let series = StoredSeries::open(store, self.scan_id).await?;
        check_region(&series, self.region.as_deref())?;
        Ok(VerdictWork {
            specification: specified(&self.specification)?,
            options: fit.options(&series.manifest().material(), None)?,
            series,
        })
    }
}

/// A checked verdict.
pub(super) struct VerdictWork {
    series: StoredSeries,
    specification: Specification,
    options: AnalysisOptions,
}

impl Work for VerdictWork {
    fn forecast(&self, cancel: &AtomicBool) -> Option<Forecast> {
        of_analysis(&self.series, &self.options, cancel)
    }

    fn run(
        &self,
        _: &Path,
        progress: &ProgressMeter,
        cancel: &AtomicBool,
    ) -> Result<Finished, Failure> {
        let report = |p| report_analysis(progress, p);
        let analysed = analysis::analyse(&self.series, &self.options, &report, cancel)?;
        Finished::new(&VerdictReport::new(
            &self.specification,
            &analysed.report,
            &analysed.observations,
            &self.series.sample_poses(),
        ))
    }
}

/// Parses a specification; an error names the part that is wrong.
fn specified(value: &serde_json::Value) -> Result<Specification, LabError> {
    let invalid = |field: String, problem: String| LabError::Invalid { field, problem };
    json::from_value::<Specification>(value).map_err(|refusal| {
        invalid(
            refusal.path_below("specification"),
            refusal.message("field"),
        )
    })?;
    // Its errors begin with the name of the file, which is the field here.
    Specification::from_json(value).map_err(|error| {
        let error = error.to_string();
        let problem = error.strip_prefix("specification: ").unwrap_or(&error);
        invalid("specification".into(), problem.to_owned())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_specification_names_what_it_limits() {
        let limits = |limits| json!({"name": "part 7", "limits": {"theta_r_deg": limits}});
        specified(&limits(json!({"lower": 9.5, "upper": 10.5}))).unwrap();
        for (value, field) in [
            (
                limits(json!([9.5, 10.5])),
                "specification.limits.theta_r_deg: ",
            ),
            (
                json!(["part 7", {}, {"theta_r_deg": {"lower": 1}}]),
                "specification: ",
            ),
        ] {
            let refused = specified(&value).unwrap_err().to_string();
            assert!(refused.starts_with(field), "{refused}");
        }
    }
}
