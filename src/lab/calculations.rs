//! Maps, contrasts and verdicts of scans in the store, and traces of scenes, one at a time or many, each
//! cancellable.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use super::failure::Failure;
use super::foretell::{Foretold, tell_analysis, with_cost};
use super::headway::{Headway, Progress};
use super::request_checks::{check_region, positive, share};
use super::tasks::{blocking, to_the_end};
use super::traces::{TraceRequest, TraceToDo};
use super::{Lab, LabError, StoredSeries};
use crate::accuracy::forecast::{of_analysis, of_reduction};
use crate::accuracy::map_forecast::of_map;
use crate::analysis::{self, AnalysisOptions};
use crate::contrast;
use crate::fit::traced::TracingOptions;
use crate::fit::{FitOptions, VariantChoice};
use crate::forecast::Forecast;
use crate::judge::{Specification, VerdictReport};
use crate::map::folder::map_into;
use crate::map::{self, MapOptions};
use crate::reduction::{self, FrameSource};
use crate::scan::event::CalculationKind;
use crate::store::calculations::CalculationEnd;
use crate::store::{Store, StoreError};
use crate::wording::objects;
use crate::wording::refusals::plain;

/// A map that is asked for: every pixel of a scan fitted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapRequest {
    /// Scan to map.
    pub scan_id: i64,
    /// Begin no further pixels after this time, s; those that were not reached have no value.
    #[serde(default)]
    pub max_seconds: Option<f64>,
    /// Share of the brightest radiance that may be left out of a pixel's physics.
    #[serde(default)]
    pub target_error: Option<f64>,
}

/// A contrast table that is asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ContrastRequest {
    /// Scan to look at.
    pub scan_id: i64,
    /// Region of a sample that has several.
    #[serde(default)]
    pub region: Option<String>,
}

/// A verdict that is asked for.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VerdictRequest {
    /// Scan to judge.
    pub scan_id: i64,
    /// What it shall conform to: name, limits by quantity, accepted risks.
    pub specification: serde_json::Value,
    /// Variant; the better one if not given.
    #[serde(default)]
    pub variant: VariantChoice,
    /// Region of a sample that has several.
    #[serde(default)]
    pub region: Option<String>,
    /// End the ray tracer after this time of fitting, s (see [`super::FitRequest`]).
    #[serde(default)]
    pub max_seconds: Option<f64>,
    /// End the ray tracer once its standard error, as a share of the largest radiance, is below this.
    #[serde(default)]
    pub target_error: Option<f64>,
    /// Share of the peak that may be left out of the model.
    #[serde(default)]
    pub tolerance: Option<f64>,
}

/// What can be asked for.
#[derive(Debug, Clone, PartialEq)]
pub enum CalculationRequest {
    /// Parameters per pixel.
    Map(MapRequest),
    /// The paper's contrast table.
    Contrast(ContrastRequest),
    /// A judgement against a specification.
    Verdict(VerdictRequest),
    /// Light through a scene.
    Trace(TraceRequest),
}

impl CalculationRequest {
    /// Of what kind it is.
    #[must_use]
    pub const fn kind(&self) -> CalculationKind {
        match self {
            CalculationRequest::Map(_) => CalculationKind::Map,
            CalculationRequest::Contrast(_) => CalculationKind::Contrast,
            CalculationRequest::Verdict(_) => CalculationKind::Verdict,
            CalculationRequest::Trace(_) => CalculationKind::Trace,
        }
    }

    /// The scan it is of; a trace is of a scene alone.
    const fn scan_id(&self) -> Option<i64> {
        match self {
            CalculationRequest::Map(request) => Some(request.scan_id),
            CalculationRequest::Contrast(request) => Some(request.scan_id),
            CalculationRequest::Verdict(request) => Some(request.scan_id),
            CalculationRequest::Trace(_) => None,
        }
    }

    fn as_json(&self) -> Result<String, StoreError> {
        match self {
            CalculationRequest::Map(request) => serde_json::to_string(request),
            CalculationRequest::Contrast(request) => serde_json::to_string(request),
            CalculationRequest::Verdict(request) => serde_json::to_string(request),
            CalculationRequest::Trace(request) => serde_json::to_string(request),
        }
        .map_err(|e| StoreError::bad_row("calculations", e))
    }
}

/// What is to be done, checked and with all that it reads.
enum Work {
    Map(StoredSeries, MapRequest),
    Contrast(StoredSeries, Option<String>),
    Verdict(StoredSeries, Box<(Specification, AnalysisOptions)>),
    Trace(Box<TraceToDo>),
}

impl Lab {
    /// Checks a request and opens what it reads.
    async fn work(&self, request: &CalculationRequest) -> Result<Work, LabError> {
        // Read what is there now: the result is of this snapshot, whatever comes later.
        let series = |scan_id: i64| StoredSeries::open(self.store(), scan_id);
        Ok(match request {
            CalculationRequest::Map(request) => {
                positive([
                    ("max_seconds", request.max_seconds),
                    ("target_error", request.target_error),
                ])?;

                share("target_error", request.target_error)?;
                Work::Map(series(request.scan_id).await?, request.clone())
            }
            CalculationRequest::Contrast(request) => {
                let series = series(request.scan_id).await?;
                check_region(&series, request.region.as_deref())?;
                Work::Contrast(series, request.region.clone())
            }
            CalculationRequest::Verdict(request) => {
                positive([
                    ("max_seconds", request.max_seconds),
                    ("target_error", request.target_error),
                ])?;
                share("tolerance", request.tolerance)?;
                let series = series(request.scan_id).await?;
                check_region(&series, request.region.as_deref())?;
                let specification = specified(&request.specification)?;
                let options = AnalysisOptions {
                    region: request.region.clone(),
                    fit: FitOptions {
                        variant: request.variant,
                        tolerance: request.tolerance,
                        tracer: TracingOptions::to_error(request.target_error),
                        ..FitOptions::default()
                    },
                    max_seconds: request.max_seconds,
                    ..AnalysisOptions::default()
                };
                Work::Verdict(series, Box::new((specification, options)))
            }
            CalculationRequest::Trace(request) => {
                let wanted = request.clone();
                let ready = blocking(move || wanted.prepare()).await??;
                Work::Trace(Box::new(ready))
            }
        })
    }

    /// Begins a map, contrast, verdict or trace; returns its number. How it ends is told by an event.
    ///
    /// # Errors
    /// An unknown scan or region, a specification or scene that makes no sense, or what the store says.
    pub async fn start_calculation(&self, request: &CalculationRequest) -> Result<i64, LabError> {
        let (lab, request) = (self.clone(), request.clone());
        // A row that says "running" has somebody who works.
        to_the_end(async move { lab.check_and_calculate(&request).await }).await
    }

    async fn check_and_calculate(&self, request: &CalculationRequest) -> Result<i64, LabError> {
        let work = self.work(request).await?;
        let (id, event) = self
            .store()
            .begin_calculation(request.kind(), request.scan_id(), &request.as_json()?)
            .await?;
        self.tell(event);
        let what = Foretold {
            of: request.kind().to_string(),
            number: id,
            scan_id: request.scan_id(),
        };
        let (lab, kind) = (self.clone(), request.kind());
        self.inner.calculations.begin(id, |flag, told| async move {
            let store = lab.store().clone();
            let broken_off = |error: LabError| CalculationEnd::Failed {
                code: error.code().into(),
                detail: error.to_string(),
            };
            let end = match lab.inner.turns.of(kind).mine(&told, &flag).await {
                None => CalculationEnd::Cancelled,
                Some(_turn) => {
                    let work = lab.foretell(what, work, Work::forecast, &told, &flag);
                    match work.await {
                        Ok(work) => blocking(move || work.run(&store, id, &told, &flag))
                            .await
                            .unwrap_or_else(broken_off),
                        Err(error) => broken_off(error),
                    }
                }
            };
            match lab.store().end_calculation(id, &end).await {
                Ok(event) => lab.tell(event),
                Err(error) => {
                    tracing::error!(id, %error, "the end of calculation {id} could not be kept: {error}");
                }
            }
            lab.inner.calculations.ended(id);
        });
        Ok(id)
    }

    /// How far a calculation has come; none where it has ended or cannot say yet.
    #[must_use]
    pub fn calculation_progress(&self, id: i64) -> Option<Progress> {
        self.inner.calculations.headway(id)?.now()
    }

    /// What a calculation that runs will take; none where it has ended or nobody knows yet.
    #[must_use]
    pub fn calculation_forecast(&self, id: i64) -> Option<Forecast> {
        self.inner.calculations.headway(id)?.forecast()
    }

    /// Asks a calculation to stop; it ends within a moment.
    ///
    /// # Errors
    /// An unknown one, or one that has ended.
    pub async fn cancel_calculation(&self, kind: CalculationKind, id: i64) -> Result<(), LabError> {
        let state = self.store().calculation(kind, id).await?.state;
        self.inner.calculations.cancel(id, &kind, state)
    }

    /// Path of a file of a finished map or trace.
    ///
    /// # Errors
    /// An unknown one, one without files, or a name that is none of them.
    pub async fn calculation_file(
        &self,
        kind: CalculationKind,
        id: i64,
        name: &str,
    ) -> Result<PathBuf, LabError> {
        let found = self.store().calculation(kind, id).await?;
        let Some(result) = &found.result else {
            return Err(LabError::NotThere {
                what: kind.to_string(),
                number: id,
                state: found.state,
                problem: "it has no files",
            });
        };
        let summary: serde_json::Value =
            serde_json::from_str(result).map_err(|e| StoreError::bad_row("calculation_ends", e))?;
        let names: Vec<&str> = summary["files"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(serde_json::Value::as_str)
            .collect();
        // Only names from the summary are looked for, so none can lead out of the folder.
        if !names.contains(&name) {
            return Err(LabError::Invalid {
                field: "name".into(),
                problem: format!("{kind} {id} has no such file; it has {}", names.join(", ")),
            });
        }
        Ok(self.store().files_folder(kind, id).join(name))
    }
}

impl Work {
    /// What it will take, from short runs of it.
    fn forecast(&self, cancel: &AtomicBool) -> Option<Forecast> {
        match self {
            Work::Map(series, request) => of_map(series, &map_options(request), cancel),
            Work::Contrast(series, region) => of_reduction(series, region.as_deref(), cancel),
            Work::Verdict(series, asked) => of_analysis(series, &asked.1, cancel),
            Work::Trace(to_do) => to_do.forecast(cancel),
        }
    }

    fn run(self, store: &Store, id: i64, told: &Headway, cancel: &AtomicBool) -> CalculationEnd {
        told.tell("preparing", 0, 1);
        let result = match self {
            Work::Map(series, request) => kept(store, CalculationKind::Map, id, |part| {
                map_of(&series, &request, part, told, cancel)
            }),
            Work::Contrast(series, region) => contrast_of(&series, region.as_deref(), cancel),
            Work::Verdict(series, asked) => verdict_of(&series, &asked.0, &asked.1, told, cancel),
            Work::Trace(to_do) => kept(store, CalculationKind::Trace, id, |part| {
                to_do.run(part, told, cancel)
            }),
        };
        let result = result.and_then(|r| with_cost(&r, told).map_err(Failure::internal));
        match result {
            Ok(result) => CalculationEnd::Completed(result),
            Err(Failure::Cancelled) => CalculationEnd::Cancelled,
            Err(Failure::Because { code, detail }) => CalculationEnd::Failed {
                code: code.into(),
                detail,
            },
        }
    }
}

/// A request's specification, each part of it by its name.
fn specified(value: &serde_json::Value) -> Result<Specification, LabError> {
    let invalid = |field: String, problem: &str| LabError::Invalid {
        field,
        problem: plain(problem.trim_start_matches("specification: ")),
    };
    let field = |path: String| match path.as_str() {
        "." => "specification".to_owned(),
        path => format!("specification.{path}"),
    };
    // First by itself, so that a value of another kind is told with its place.
    serde_path_to_error::deserialize::<_, Specification>(value)
        .map_err(|e| invalid(field(e.path().to_string()), &e.inner().to_string()))?;
    let specification = Specification::from_json(value)
        .map_err(|e| invalid("specification".into(), &e.to_string()))?;
    objects::check::<Specification>(value).map_err(|refusal| {
        let path = refusal.path().to_string();
        invalid(field(path), &refusal.into_inner().to_string())
    })?;
    Ok(specification)
}

/// Work that leaves files: made in a folder that is kept once all is done, and removed otherwise.
fn kept(
    store: &Store,
    kind: CalculationKind,
    id: i64,
    work: impl FnOnce(&Path) -> Result<String, Failure>,
) -> Result<String, Failure> {
    let not_written = |error: StoreError| Failure::Because {
        code: match kind {
            CalculationKind::Trace => "trace-not-written",
            _ => "map-not-written",
        },
        detail: error.to_string(),
    };
    let part = store.part_folder(kind, id);
    let made = std::fs::create_dir_all(&part)
        .map_err(|e| not_written(StoreError::file("a calculation", &part, e)))
        .and_then(|()| work(&part))
        .and_then(|result| {
            store.keep_files(kind, id).map_err(not_written)?;
            Ok(result)
        });
    if made.is_err() {
        // Best effort: what cannot be removed now names no calculation and does no harm.
        std::fs::remove_dir_all(&part).ok();
    }
    made
}

fn map_options(request: &MapRequest) -> MapOptions {
    MapOptions {
        max_seconds: request.max_seconds,
        target_error: request.target_error,
        ..MapOptions::default()
    }
}

fn map_of(
    series: &StoredSeries,
    request: &MapRequest,
    part: &Path,
    told: &Headway,
    cancel: &AtomicBool,
) -> Result<String, Failure> {
    let options = MapOptions {
        scratch: part.to_owned(),
        ..map_options(request)
    };
    let tell = |p: map::Progress| told.tell(p.stage.words(), p.done as u64, p.total as u64);
    let summary = map_into(series, &options, part, &tell, cancel)?;
    serde_json::to_string(&summary).map_err(Failure::internal)
}

fn contrast_of(
    series: &StoredSeries,
    region: Option<&str>,
    cancel: &AtomicBool,
) -> Result<String, Failure> {
    let set = reduction::reduce(series, region, cancel)?;
    let (_, report) = contrast::measure(&set).map_err(|error| Failure::Because {
        code: "no-contrast",
        detail: error.to_string(),
    })?;
    serde_json::to_string(&report).map_err(Failure::internal)
}

fn verdict_of(
    series: &StoredSeries,
    specification: &Specification,
    options: &AnalysisOptions,
    told: &Headway,
    cancel: &AtomicBool,
) -> Result<String, Failure> {
    let analysed = analysis::analyse(series, options, &|p| tell_analysis(told, p), cancel)?;
    let verdict = VerdictReport::new(
        specification,
        &analysed.report,
        &analysed.observations,
        &series.sample_poses(),
    );
    serde_json::to_string(&verdict).map_err(Failure::internal)
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
