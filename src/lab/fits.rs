//! Reductions and fits of scans in the store.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use futures::TryFutureExt;
use futures::future::BoxFuture;
use serde::{Deserialize, Serialize};

use super::attached::ShapeFile;
use super::curves::{FitCurves, curves_of};
use super::failure::reduction_code;
use super::foretell::{Foretold, tell_analysis, with_cost};
use super::headway::{Headway, Progress};
use super::once::OncePerKey;
use super::request_checks::{check_region, positive, share};
use super::tasks::{blocking, to_the_end};
use super::{Lab, LabError, StoredSeries};
use crate::accuracy::forecast::of_analysis;
use crate::analysis::{self, AnalysisError, AnalysisOptions, DRAWS, STARTS};
use crate::fit::told::{agree, held, known};
use crate::fit::traced::TracingOptions;
use crate::fit::{FitOptions, FitReport, Loss, Told, VariantChoice};
use crate::forecast::Forecast;
use crate::material::Material;
use crate::observation::ObservationSet;
use crate::reduction::{self, FrameSource};
use crate::scan::event::ShortValue;
use crate::store::StoreError;
use crate::store::fits::{FitEnd, NewFit};

/// A fit that is asked for.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FitRequest {
    /// Scan to fit.
    pub scan_id: i64,
    /// Variant; the better one if not given.
    #[serde(default)]
    pub variant: VariantChoice,
    /// Region of a sample that has several.
    #[serde(default)]
    pub region: Option<String>,
    /// Whether the ray tracer is asked how wrong the variant is (see [`FitOptions::judge`]).
    #[serde(default)]
    pub judge: bool,
    /// Whether a descent to the minimum is retraced, step by step.
    #[serde(default)]
    pub iterations: bool,
    /// End ray tracer and bootstrap after this time, s.
    #[serde(default)]
    pub max_seconds: Option<f64>,
    /// End the ray tracer once its standard error, as a share of the largest radiance, is below this.
    #[serde(default)]
    pub target_error: Option<f64>,
    /// Share of the peak that may be left out of the model (see [`FitOptions::tolerance`]).
    #[serde(default)]
    pub tolerance: Option<f64>,
    /// The sample's own shape, for the ray tracer; the ideal sawtooth if not given.
    #[serde(default)]
    pub shape: Option<ShapeFile>,
    /// How residuals count.
    #[serde(default)]
    pub loss: Loss,
    /// Parameters held at a value, by the names of the report (and eta, k).
    #[serde(default)]
    pub fix: BTreeMap<String, f64>,
    /// Parameters known within a standard uncertainty, by the same names.
    #[serde(default)]
    pub priors: BTreeMap<String, Prior>,
    /// Most starts of a search, per variant; if not given 8, and as many more as a doubt about these asks for.
    #[serde(default)]
    pub starts: Option<u32>,
    /// Whether profile-likelihood intervals are wanted.
    #[serde(default)]
    pub profile: bool,
    /// Series drawn for bootstrap intervals; none if not given.
    #[serde(default)]
    pub bootstrap: Option<u32>,
}

/// What is known of a parameter before the fit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Prior {
    /// Its value.
    pub value: f64,
    /// Its standard uncertainty.
    pub std: f64,
}

fn invalid(field: impl Into<String>, problem: impl Into<String>) -> LabError {
    LabError::Invalid {
        field: field.into(),
        problem: problem.into(),
    }
}

impl FitRequest {
    fn traces(&self) -> bool {
        self.judge || self.variant == VariantChoice::Traced
    }

    /// Refuses numbers that mean nothing, and limits that nothing is there to obey.
    fn check(&self) -> Result<(), LabError> {
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
        let tracer = "is for the ray tracer";
        let ask = "ask for variant traced, or judge";
        let idle = [
            ("shape", self.shape.is_some()),
            ("target_error", self.target_error.is_some()),
        ];
        match idle.iter().find(|(_, set)| *set && !self.traces()) {
            Some((field, _)) => Err(invalid(*field, format!("{tracer}: {ask}"))),
            None => Ok(()),
        }
    }

    /// What is known beforehand of a sample's parameters.
    fn told(&self, material: &Material) -> Result<Vec<Told>, LabError> {
        let mut all = Vec::new();
        for (name, value) in &self.fix {
            let told = held(name, *value);
            all.push(told.map_err(|e| invalid(format!("fix.{name}"), e.to_string()))?);
        }
        for (name, prior) in &self.priors {
            let told = known(name, prior.value, prior.std);
            all.push(told.map_err(|e| invalid(format!("priors.{name}"), e.to_string()))?);
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
}

/// What the store keeps of a request.
#[derive(Serialize)]
struct Kept<'a> {
    #[serde(flatten)]
    options: &'a FitOptions,
    #[serde(skip_serializing_if = "Option::is_none")]
    shape: Option<&'a ShapeFile>,
    request: &'a FitRequest,
}

/// Observations of a scan.
#[derive(Debug, Clone, PartialEq)]
pub struct Reduced {
    /// The observations and all that a fit reads.
    pub set: ObservationSet,
    /// Whether the scan is over.
    pub complete: bool,
}

/// Reductions under way, by scan, region and the newest frame that each knows of.
pub(super) type Reductions =
    OncePerKey<(i64, Option<String>, i64), Result<Arc<ObservationSet>, Arc<LabError>>>;

impl Lab {
    /// Observations of a scan (or of one region of it), reduced now or earlier. While the scan runs
    /// they are a snapshot of what is committed.
    ///
    /// # Errors
    /// An unknown scan, [`LabError::Analysis`] if its frames give none, or what the store says.
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
            return Ok(Reduced { set, complete });
        }
        let name = region.map(str::to_owned);
        let store = self.store().clone();
        // A page that is looked at twice reads every frame once, and one that was closed reads no further.
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
        let reduced = self.inner.reductions.ask(key, |cancel| {
            let reduced: BoxFuture<'static, Result<_, LabError>> = Box::pin(reduce(cancel));
            reduced.map_err(Arc::new)
        });
        let set = Arc::unwrap_or_clone(reduced.await.map_err(LabError::Shared)?);
        Ok(Reduced { set, complete })
    }

    /// Begins a fit; returns its number. How it ends is told by an event.
    ///
    /// # Errors
    /// An unknown scan or region, or what the store says.
    pub async fn start_fit(&self, request: &FitRequest) -> Result<i64, LabError> {
        let (lab, request) = (self.clone(), request.clone());
        // A row that says "running" has somebody who works.
        to_the_end(async move { lab.check_and_fit(&request).await }).await
    }

    async fn check_and_fit(&self, request: &FitRequest) -> Result<i64, LabError> {
        request.check()?;
        // Read what is there now: the fit is of this snapshot, whatever comes later.
        let series = StoredSeries::open(self.store(), request.scan_id).await?;
        check_region(&series, request.region.as_deref())?;
        let told = request.told(&series.manifest().material())?;
        let shape = match request.shape.clone() {
            Some(shape) => Some(blocking(move || shape.read()).await??),
            None => None,
        };
        let standard = FitOptions::default();
        let options = AnalysisOptions {
            height_map: shape.as_ref().and_then(|shape| shape.facts),
            shape_notes: shape.iter().flat_map(|shape| shape.notes.clone()).collect(),
            profile: shape.map(|shape| shape.profile),
            region: request.region.clone(),
            fit: FitOptions {
                variant: request.variant,
                starts: request.starts.map_or(standard.starts, |n| n as usize),
                starts_alone: request.starts.is_some(),
                loss: request.loss,
                told,
                profile: request.profile,
                bootstrap: request.bootstrap.unwrap_or(0),
                judge: request.judge,
                tolerance: request.tolerance,
                tracer: TracingOptions::to_error(request.target_error),
                ..standard
            },
            iterations: request.iterations,
            max_seconds: request.max_seconds,
        };
        let new = NewFit {
            scan_id: request.scan_id,
            variant: word(&request.variant),
            region: request.region.clone(),
            options: serde_json::to_string(&Kept {
                options: &options.fit,
                shape: request.shape.as_ref(),
                request,
            })
            .map_err(|e| StoreError::bad_row("fits", e))?,
        };
        let (fit_id, event) = self.store().begin_fit(&new).await?;
        self.tell(event);
        let lab = self.clone();
        let scan_id = request.scan_id;
        self.inner.fits.begin(fit_id, |flag, told| async move {
            let what = Foretold {
                of: "fit".into(),
                number: fit_id,
                scan_id: Some(scan_id),
            };
            let make = |(series, options): &(StoredSeries, AnalysisOptions),
                        cancel: &AtomicBool| {
                of_analysis(series, options, cancel)
            };
            let work = (series, options);
            let end = match lab.inner.turns.fits.mine(&told, &flag).await {
                None => FitEnd::Cancelled,
                Some(_turn) => match lab.foretell(what, work, make, &told, &flag).await {
                    Ok((series, options)) => {
                        lab.fit_to_its_end(scan_id, series, options, &told, &flag)
                            .await
                    }
                    Err(error) => broken_off(&error),
                },
            };
            match lab.store().end_fit(fit_id, &end).await {
                Ok(event) => lab.tell(event),
                Err(error) => {
                    tracing::error!(fit_id, %error, "the end of fit {fit_id} could not be kept: {error}");
                }
            }
            lab.inner.fits.ended(fit_id);
        });
        Ok(fit_id)
    }

    /// How far a fit has come, and what it was said to take; none where it has ended or cannot say yet.
    #[must_use]
    pub fn fit_progress(&self, fit_id: i64) -> (Option<Progress>, Option<Forecast>) {
        match self.inner.fits.headway(fit_id) {
            Some(headway) => (headway.now(), headway.forecast()),
            None => (None, None),
        }
    }

    async fn fit_to_its_end(
        &self,
        scan_id: i64,
        series: StoredSeries,
        options: AnalysisOptions,
        headway: &Arc<Headway>,
        cancel: &Arc<AtomicBool>,
    ) -> FitEnd {
        let last_frame_id = series.last_frame_id;
        let (flag, told) = (Arc::clone(cancel), Arc::clone(headway));
        let analysed = blocking(move || {
            analysis::analyse(&series, &options, &|p| tell_analysis(&told, p), &flag)
        })
        .await;
        let analysed = match analysed {
            Ok(Ok(analysed)) => analysed,
            Err(error) => return broken_off(&error),
            Ok(Err(AnalysisError::Cancelled)) => return FitEnd::Cancelled,
            Ok(Err(AnalysisError::Reduction(error))) => {
                return FitEnd::Failed {
                    code: reduction_code(&error).into(),
                    detail: error.to_string(),
                };
            }
        };
        let kept = self
            .store()
            .add_observations(scan_id, last_frame_id, &analysed.observations)
            .await;
        let report =
            serde_json::to_string(&analysed.report).and_then(|text| with_cost(&text, headway));
        match (kept, report) {
            (Ok(set_id), Ok(report)) => FitEnd::Completed {
                set_id,
                report,
                variant: analysed.report.variant.to_string(),
                status: word(&analysed.report.status),
                theta_r_deg: short(&analysed.report),
            },
            (Err(error), _) => FitEnd::Failed {
                code: LabError::from(error).code().into(),
                detail: "the observations could not be kept".into(),
            },
            (_, Err(error)) => FitEnd::Failed {
                code: "internal".into(),
                detail: format!("the report is not JSON: {error}"),
            },
        }
    }

    /// Asks a fit to stop; it ends within one evaluation of the model.
    ///
    /// # Errors
    /// An unknown fit, or one that has ended.
    pub async fn cancel_fit(&self, fit_id: i64) -> Result<(), LabError> {
        let state = self.store().fit(fit_id).await?.state;
        self.inner.fits.cancel(fit_id, &"fit", state)
    }

    /// A completed fit beside its observations, with curves every `step_deg` of φs.
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
        let fit = self.store().fit(fit_id).await?;
        let (Some(report), Some(set_id)) = (&fit.report, fit.set_id) else {
            return Err(LabError::NotThere {
                what: "fit".into(),
                number: fit_id,
                state: fit.state,
                problem: "it has no report to draw",
            });
        };
        let report: FitReport =
            serde_json::from_str(report).map_err(|e| StoreError::bad_row("fit_ends", e))?;
        let set = self.store().observations(set_id).await?;
        blocking(move || curves_of(&report, &set, step_deg)).await
    }
}

fn broken_off(error: &LabError) -> FitEnd {
    FitEnd::Failed {
        code: error.code().into(),
        detail: error.to_string(),
    }
}

fn short(report: &FitReport) -> Option<ShortValue> {
    let theta_r = &report.parameters.theta_r_deg;
    Some(ShortValue {
        value: theta_r.value?,
        expanded: theta_r.expanded?,
    })
}

/// The word that serde writes for a unit variant.
pub(super) fn word<T: Serialize>(value: &T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => word,
        _ => String::new(),
    }
}
