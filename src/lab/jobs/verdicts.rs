//! Verdicts: a scan judged against a specification.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use super::fits::FitRequest;
use super::progress::ProgressMeter;
use super::work::{Finished, Work, report_analysis};
use crate::accuracy::forecast::of_analysis;
use crate::analysis::{self, AnalysisOptions};
use crate::fit::{FitReport, VariantChoice};
use crate::forecast::Forecast;
use crate::job::{JobId, JobKind};
use crate::judge::{Specification, VerdictReport};
use crate::lab::definitions::{NameOrId, find};
use crate::lab::failure::Failure;
use crate::lab::request_checks::{check_region, invalid};
use crate::lab::specifications::specified;
use crate::lab::{LabError, StoredSeries};
use crate::observation::ObservationSet;
use crate::reduction::FrameSource;
use crate::store::definitions::DefinitionKind;
use crate::store::{Store, StoreError};

/// A specification, or the name or number of a stored one. For the description: a refusal names the wrong key of a content.
#[derive(utoipa::ToSchema)]
#[serde(untagged)]
#[expect(dead_code, reason = "it describes the field of a request")]
enum StatedSpecification {
    /// Name, limits by quantity, accepted risks.
    Content(Specification),
    /// Name or number of a stored one.
    Stored(NameOrId),
}

/// A request for a verdict.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct VerdictRequest {
    /// Scan to judge.
    #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    pub scan_id: i64,
    /// The specification: name, limits by quantity, accepted risks; or the name or number of a stored one.
    #[schema(value_type = StatedSpecification)]
    pub specification: serde_json::Value,
    /// Completed fit of the scan that the verdict rests on, instead of a new one. It states variant, region and options.
    #[serde(default)]
    #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    pub fit_id: Option<i64>,
    /// Variant that the verdict rests on; by default the better one.
    #[serde(default)]
    pub variant: VariantChoice,
    /// Region of a part that has several.
    #[serde(default)]
    #[schema(max_length = 200)]
    pub region: Option<String>,
    /// Time limit of the fit, s (see [`FitRequest`]).
    #[serde(default)]
    #[schema(exclusive_minimum = 0, maximum = 1e9)]
    pub max_seconds: Option<f64>,
    /// Stop the ray tracer once its standard error, as a share of the largest radiance, is below this.
    #[serde(default)]
    #[schema(exclusive_minimum = 0, maximum = 1e9)]
    pub target_error: Option<f64>,
    /// Largest share of the peak that the model may neglect.
    #[serde(default)]
    #[schema(exclusive_minimum = 0, exclusive_maximum = 1)]
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

    pub(in crate::lab) async fn prepare(&self, store: &Store) -> Result<VerdictWork, LabError> {
        let fit = self.fit();
        fit.check_values()?;
        let series = StoredSeries::open(store, self.scan_id).await?;
        let specification = specified(&self.specification)?;
        let basis = match self.fit_id {
            Some(fit_id) => self.basis(store, fit_id).await?,
            None => {
                check_region(&series, self.region.as_deref())?;
                let options = fit.options(&series.manifest().material(), None)?;
                Basis::Options(Box::new(options))
            }
        };
        Ok(VerdictWork {
            specification,
            basis,
            series,
        })
    }

    /// Returns the request with the content of the stored specification that it names.
    pub(in crate::lab) async fn with_content(mut self, store: &Store) -> Result<Self, LabError> {
        let wanted = match &self.specification {
            serde_json::Value::String(name) => NameOrId::Name(name.clone()),
            serde_json::Value::Number(id) => match id.as_i64() {
                Some(id) => NameOrId::Id(id),
                None => return Ok(self),
            },
            _ => return Ok(self),
        };
        let kind = DefinitionKind::Specification;
        self.specification = find(store, kind, &wanted, "specification").await?.content;
        Ok(self)
    }

    /// Reads the fit that the verdict rests on.
    async fn basis(&self, store: &Store, fit_id: i64) -> Result<Basis, LabError> {
        let stated = VerdictRequest {
            scan_id: self.scan_id,
            specification: self.specification.clone(),
            fit_id: self.fit_id,
            ..VerdictRequest::default()
        };
        if *self != stated {
            let problem = "states variant, region and options of the fit: leave these out";
            return Err(invalid("fit_id", problem));
        }
        let id = JobId::new(JobKind::Fit, fit_id);
        let fit = store.job(id).await?;
        if fit.scan_id != Some(self.scan_id) {
            let problem = format!("fit {fit_id} is not of scan {}", self.scan_id);
            return Err(invalid("fit_id", problem));
        }
        let (Some(report), Some(set_id)) = (&fit.result, fit.set_id) else {
            return Err(LabError::JobConflict {
                id,
                state: fit.state,
                problem: "it has no report to judge",
            });
        };
        let report: FitReport =
            serde_json::from_str(report).map_err(|e| StoreError::bad_row("job_ends", e))?;
        let observations = store.observations(set_id).await?;
        Ok(Basis::Fit(Box::new((report, observations))))
    }
}

/// What a verdict rests on.
enum Basis {
    /// A new fit.
    Options(Box<AnalysisOptions>),
    /// A completed fit with its observations.
    Fit(Box<(FitReport, ObservationSet)>),
}

/// A checked verdict.
pub(in crate::lab) struct VerdictWork {
    series: StoredSeries,
    specification: Specification,
    basis: Basis,
}

impl Work for VerdictWork {
    fn forecast(&self, cancel: &AtomicBool) -> Option<Forecast> {
        match &self.basis {
            Basis::Options(options) => of_analysis(&self.series, options, cancel),
            Basis::Fit(_) => None,
        }
    }

    fn run(
        &self,
        _: &Path,
        progress: &ProgressMeter,
        cancel: &AtomicBool,
    ) -> Result<Finished, Failure> {
        let verdict = |report: &FitReport, observations: &ObservationSet| {
            let planned = self.series.sample_poses();
            VerdictReport::new(&self.specification, report, observations, &planned)
        };
        Finished::new(&match &self.basis {
            Basis::Fit(fit) => verdict(&fit.0, &fit.1),
            Basis::Options(options) => {
                let report = |p| report_analysis(progress, p);
                let analysed = analysis::analyse(&self.series, options, &report, cancel)?;
                verdict(&analysed.report, &analysed.observations)
            }
        })
    }
}
