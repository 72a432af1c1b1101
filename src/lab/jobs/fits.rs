//! Fits: the model fitted to the observations of a scan.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use futures::TryFutureExt;
use futures::future::BoxFuture;
use serde::{Deserialize, Serialize};

use super::curves::{FitCurves, curves_of};
use super::progress::ProgressMeter;
use super::single_flight::SingleFlight;
use super::work::{Finished, FinishedFit, Work, report_analysis, word};
use crate::accuracy::forecast::of_analysis;
use crate::analysis::{self, AnalysisError, AnalysisOptions, DRAWS, STARTS};
use crate::fit::constraints::{agree, held, known};
use crate::fit::traced::TracingOptions;
use crate::fit::{Constraint, FitOptions, FitReport, Loss, VariantChoice};
use crate::forecast::Forecast;
use crate::heights::ridges::MeasuredShape;
use crate::job::{JobId, JobKind};
use crate::lab::exchange::uploads::ShapeFile;
use crate::lab::failure::Failure;
use crate::lab::request_checks::{check_region, invalid, positive, share};
use crate::lab::tasks::blocking;
use crate::lab::{Lab, LabError, StoredSeries};
use crate::material::Material;
use crate::observation::ObservationSet;
use crate::reduction::{self, FrameSource};
use crate::scan::event::ShortValue;
use crate::store::definitions::{DefinitionKind, Wanted};
use crate::store::{Store, StoreError};

/// A request for a fit.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FitRequest {
    /// Number of the scan to fit.
    #[schema(minimum = 1, maximum = 9_007_199_254_740_991_i64)]
    pub scan_id: i64,
    /// Variant of the model; auto if omitted.
    #[serde(default)]
    pub variant: VariantChoice,
    /// Region of a part with several regions.
    #[serde(default)]
    #[schema(max_length = 200)]
    pub region: Option<String>,
    /// Takes the difference to the variant traced as the model error of the budget (see [`FitOptions::judge`]).
    #[serde(default)]
    pub judge: bool,
    /// Adds one descent to the minimum to the report, step by step.
    #[serde(default)]
    pub iterations: bool,
    /// Ends search, ray tracer and bootstrap after this time, s.
    #[serde(default)]
    #[schema(exclusive_minimum = 0, maximum = 1e9)]
    pub max_seconds: Option<f64>,
    /// Ends the ray tracer once its standard error, as a share of the largest radiance, is below this.
    #[serde(default)]
    #[schema(exclusive_minimum = 0, maximum = 1e9)]
    pub target_error: Option<f64>,
    /// Share of the peak that the model may omit (see [`FitOptions::tolerance`]).
    #[serde(default)]
    #[schema(exclusive_minimum = 0, exclusive_maximum = 1)]
    pub tolerance: Option<f64>,
    /// Measured shape of the part for the ray tracer; the ideal sawtooth if omitted.
    #[serde(default)]
    pub shape: Option<ShapeFile>,
    /// Loss function of the residuals; linear if omitted.
    #[serde(default)]
    pub loss: Loss,
    /// Parameters fixed at a value, by the names of the report, and eta, k: `{"rho_d": 0.3}`.
    #[serde(default)]
    pub fix: BTreeMap<String, f64>,
    /// Priors of parameters, by the same names.
    #[serde(default)]
    pub priors: BTreeMap<String, Prior>,
    /// Largest number of starts of a search per variant; if omitted 8, and more where their results disagree.
    #[serde(default)]
    #[schema(minimum = 1, maximum = 1024)]
    pub starts: Option<u32>,
    /// Adds profile-likelihood intervals.
    #[serde(default)]
    pub profile: bool,
    /// Number of series drawn for bootstrap intervals; none if omitted.
    #[serde(default)]
    #[schema(minimum = 20, maximum = 100_000)]
    pub bootstrap: Option<u32>,
}

/// Prior knowledge of a parameter: a value and its standard uncertainty.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Prior {
    /// Value, in the unit of the parameter's name.
    #[schema(minimum = -1e30, maximum = 1e30)]
    pub value: f64,
    /// Standard uncertainty (k = 1), in the same unit.
    #[schema(exclusive_minimum = 0, maximum = 1e300)]
    pub std: f64,
}

impl FitRequest {
    fn traces(&self) -> bool {
        self.judge || self.variant == VariantChoice::Traced
    }

    /// Refuses values out of range.
    pub(in crate::lab) fn check_values(&self) -> Result<(), LabError> {
        positive([
            ("max_seconds", self.max_seconds),
            ("target_error", self.target_error),
        ])?;
        share("tolerance", self.tolerance)?;
        let counts = [
            ("starts", self.starts, STARTS),
            ("bootstrap", self.bootstrap, DRAWS),
        ];
        for (field, count, range) in counts {
            if count.is_some_and(|n| !range.contains(&i64::from(n))) {
                let problem = format!("must be {} to {}", range.start(), range.end());
                return Err(invalid(field, problem));
            }
        }
        Ok(())
    }

    /// Refuses options of the ray tracer where it is not used.
    pub(in crate::lab) fn check_tracer(&self) -> Result<(), LabError> {
        let idle = [
            ("shape", self.shape.is_some()),
            ("target_error", self.target_error.is_some()),
        ];
        match idle.iter().find(|(_, set)| *set && !self.traces()) {
            Some((field, _)) => Err(invalid(
                *field,
                "applies only to the ray tracer: set variant to traced, or judge to true",
            )),
            None => Ok(()),
        }
    }

    /// The fixed values and priors, checked against each other and the sample's material.
    fn constraints(&self, material: &Material) -> Result<Vec<Constraint>, LabError> {
        let mut all = Vec::new();
        for (name, value) in &self.fix {
            let fixed = held(name, *value);
            all.push(fixed.map_err(|e| invalid(format!("fix.{name}"), e.to_string()))?);
        }
        for (name, prior) in &self.priors {
            let prior = known(name, prior.value, prior.std);
            all.push(prior.map_err(|e| invalid(format!("priors.{name}"), e.to_string()))?);
        }
        agree(&all, material).map_err(|e| {
            let field = match self.fix.is_empty() {
                true => "priors",
                false => "fix",
            };
            invalid(field, e.to_string())
        })?;
        Ok(all)
    }

    /// All options of the analysis of a sample, with their defaults.
    pub(in crate::lab) fn options(
        &self,
        material: &Material,
        shape: Option<MeasuredShape>,
    ) -> Result<AnalysisOptions, LabError> {
        let standard = FitOptions::default();
        Ok(AnalysisOptions {
            height_map: shape.as_ref().and_then(|shape| shape.facts),
            shape_notes: shape.iter().flat_map(|shape| shape.notes.clone()).collect(),
            profile: shape.map(|shape| shape.profile),
            region: self.region.clone(),
            fit: FitOptions {
                variant: self.variant,
                starts: self.starts.map_or(standard.starts, |n| n as usize),
                starts_alone: self.starts.is_some(),
                loss: self.loss,
                constraints: self.constraints(material)?,
                profile: self.profile,
                bootstrap: self.bootstrap.unwrap_or(0),
                judge: self.judge,
                tolerance: self.tolerance,
                tracer: TracingOptions::to_error(self.target_error),
                ..standard
            },
            iterations: self.iterations,
            max_seconds: self.max_seconds,
        })
    }

    pub(in crate::lab) async fn prepare(&self, store: &Store) -> Result<FitWork, LabError> {
        self.check_values()?;
        self.check_tracer()?;
        let series = StoredSeries::open(store, self.scan_id).await?;
        check_region(&series, self.region.as_deref())?;
        let shape = match self.shape.clone() {
            Some(shape) => Some(blocking(move || shape.read()).await??),
            None => None,
        };
        Ok(FitWork {
            options: self.options(&series.manifest().material(), shape)?,
            target_deg: target_of(store, self.scan_id).await?,
            request: self.clone(),
            series,
        })
    }
}

/// Returns the expanded uncertainty of θr that the recipe of a scan asks for, degrees.
async fn target_of(store: &Store, scan_id: i64) -> Result<Option<f64>, LabError> {
    let Some(used) = store.scan(scan_id).await?.recipe else {
        return Ok(None);
    };
    let version = Wanted::Version(used.version);
    let recipe = store
        .definition(DefinitionKind::Recipe, used.id, version)
        .await?;
    Ok(recipe.content["target_expanded_deg"].as_f64())
}

/// The options of a fit as they are stored.
#[derive(Serialize)]
struct StoredOptions<'a> {
    #[serde(flatten)]
    options: &'a FitOptions,
    #[serde(skip_serializing_if = "Option::is_none")]
    shape: Option<&'a ShapeFile>,
}

/// A checked fit.
pub(in crate::lab) struct FitWork {
    request: FitRequest,
    series: StoredSeries,
    options: AnalysisOptions,
    /// Expanded uncertainty of θr that is asked for, degrees.
    target_deg: Option<f64>,
}

impl Work for FitWork {
    fn options(&self) -> Result<Option<String>, serde_json::Error> {
        let stored = StoredOptions {
            options: &self.options.fit,
            shape: self.request.shape.as_ref(),
        };
        serde_json::to_string(&stored).map(Some)
    }

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
        let mut analysed = analysis::analyse(&self.series, &self.options, &report, cancel)?;
        if let Some(target_deg) = self.target_deg {
            analysed.report.hold_against(target_deg);
        }
        Ok(Finished::new(&analysed.report)?.with_fit(FinishedFit {
            scan_id: self.request.scan_id,
            last_frame_id: self.series.last_frame_id,
            observations: analysed.observations,
            variant: analysed.report.variant.to_string(),
            status: word(&analysed.report.status),
            theta_r_deg: short(&analysed.report),
        }))
    }
}

fn short(report: &FitReport) -> Option<ShortValue> {
    let theta_r = &report.parameters.theta_r_deg;
    Some(ShortValue {
        value: theta_r.value?,
        expanded: theta_r.expanded?,
    })
}

/// Observations of a scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Reduced {
    /// The observations and everything else that a fit reads.
    pub set: ObservationSet,
    /// Whether the scan is over.
    pub complete: bool,
}

/// Reductions in progress, by scan, region and newest frame.
pub(in crate::lab) type Reductions =
    SingleFlight<(i64, Option<String>, i64), Result<Arc<ObservationSet>, Arc<LabError>>>;

impl Lab {
    /// Returns the observations of a scan or of one of its regions, reduced now or earlier. While the scan runs they are a
    /// snapshot of the committed frames.
    ///
    /// # Errors
    /// An unknown scan, [`LabError::Analysis`] if its frames give none, or a store error.
    pub async fn observations(
        &self,
        scan_id: i64,
        region: Option<&str>,
    ) -> Result<Reduced, LabError> {
        let state = self.store().scan(scan_id).await?.state;
        let complete = !Lab::more_frames_may_come(state);
        let series = StoredSeries::open(self.store(), scan_id).await?;
        let last_frame_id = series.last_frame_id;
        let known = self
            .store()
            .current_observations(scan_id, region, last_frame_id)
            .await?;
        if let Some(set_id) = known {
            let set = self.store().observations(set_id).await?;
            // The scan may have been assigned to a sample of another material since.
            if set.material == series.manifest().material() {
                return Ok(Reduced { set, complete });
            }
        }
        let name = region.map(str::to_owned);
        let store = self.store().clone();
        // Concurrent requests read every frame once; a closed page stops the reduction.
        let reduce = |cancel: Arc<AtomicBool>| async move {
            let set = blocking(move || reduction::reduce(&series, name.as_deref(), &cancel))
                .await?
                .map_err(AnalysisError::Reduction)?;
            if complete {
                store.add_observations(scan_id, last_frame_id, &set).await?;
            }
            Ok(Arc::new(set))
        };
        let key = (scan_id, region.map(str::to_owned), last_frame_id);
        let reduced = self.inner.reductions.run(key, |cancel| {
            let reduced: BoxFuture<'static, Result<_, LabError>> = Box::pin(reduce(cancel));
            reduced.map_err(Arc::new)
        });
        let set = Arc::unwrap_or_clone(reduced.await.map_err(LabError::Shared)?);
        Ok(Reduced { set, complete })
    }

    /// Returns a completed fit with its observations, and curves in steps of `step_deg` of φs.
    ///
    /// # Errors
    /// An unknown fit, or one without a report.
    pub async fn curves(&self, fit_id: i64, step_deg: f64) -> Result<FitCurves, LabError> {
        if !(0.1..=90.0).contains(&step_deg) {
            return Err(LabError::Invalid {
                field: "step_deg".into(),
                problem: "must be 0.1 to 90".into(),
            });
        }
        let id = JobId::new(JobKind::Fit, fit_id);
        let fit = self.store().job(id).await?;
        let (Some(report), Some(set_id)) = (&fit.result, fit.set_id) else {
            return Err(LabError::JobConflict {
                id,
                state: fit.state,
                problem: "it has no report to draw",
            });
        };
        let report: FitReport =
            serde_json::from_str(report).map_err(|e| StoreError::bad_row("job_ends", e))?;
        let set = self.store().observations(set_id).await?;
        blocking(move || curves_of(&report, &set, step_deg)).await
    }
}
