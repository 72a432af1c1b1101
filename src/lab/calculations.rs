//! Maps, contrasts and verdicts of scans in the store, one at a time or many, each cancellable.

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, MutexGuard};

use serde::{Deserialize, Serialize};
use tokio::task::JoinHandle;

use super::fits::{check_region, reduction_code};
use super::{Lab, LabError, StoredSeries};
use crate::analysis::{self, AnalysisError, AnalysisOptions};
use crate::contrast;
use crate::fit::{FitOptions, VariantChoice};
use crate::judge::{Specification, VerdictReport};
use crate::map::folder::{FolderError, map_into};
use crate::map::{MapError, MapOptions};
use crate::reduction::{self, ReductionError};
use crate::scan::event::CalculationKind;
use crate::store::calculations::CalculationEnd;
use crate::store::{Store, StoreError};

/// A map that is asked for: every pixel of a scan fitted.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapRequest {
    /// Scan to map.
    pub scan_id: i64,
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
}

impl CalculationRequest {
    /// Of what kind it is.
    #[must_use]
    pub const fn kind(&self) -> CalculationKind {
        match self {
            CalculationRequest::Map(_) => CalculationKind::Map,
            CalculationRequest::Contrast(_) => CalculationKind::Contrast,
            CalculationRequest::Verdict(_) => CalculationKind::Verdict,
        }
    }

    const fn scan_id(&self) -> i64 {
        match self {
            CalculationRequest::Map(request) => request.scan_id,
            CalculationRequest::Contrast(request) => request.scan_id,
            CalculationRequest::Verdict(request) => request.scan_id,
        }
    }

    fn as_json(&self) -> Result<String, StoreError> {
        match self {
            CalculationRequest::Map(request) => serde_json::to_string(request),
            CalculationRequest::Contrast(request) => serde_json::to_string(request),
            CalculationRequest::Verdict(request) => serde_json::to_string(request),
        }
        .map_err(|e| StoreError::bad_row("calculations", e))
    }
}

/// A calculation that has not ended.
pub(super) struct UnderWay {
    cancel: Arc<AtomicBool>,
    task: JoinHandle<()>,
}

/// Why a calculation has no result.
enum Failure {
    Cancelled,
    Because { code: &'static str, detail: String },
}

impl Failure {
    fn internal(error: impl std::fmt::Display) -> Self {
        Failure::Because {
            code: "internal",
            detail: format!("the result is no JSON: {error}"),
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
            FolderError::Write(error) => Failure::Because {
                code: "map-not-written",
                detail: error.to_string(),
            },
        }
    }
}

/// What is to be done, checked and with all that it reads.
enum Work {
    Map(StoredSeries),
    Contrast(StoredSeries, Option<String>),
    Verdict(StoredSeries, Box<Specification>, AnalysisOptions),
}

impl Lab {
    /// Begins a map, contrast or verdict; returns its number. How it ends is told by an event.
    ///
    /// # Errors
    /// An unknown scan or region, a specification that makes no sense, or what the store says.
    pub async fn start_calculation(&self, request: &CalculationRequest) -> Result<i64, LabError> {
        // Read what is there now: the result is of this snapshot, whatever comes later.
        let series = StoredSeries::open(self.store(), request.scan_id()).await?;
        let work = match request {
            CalculationRequest::Map(_) => Work::Map(series),
            CalculationRequest::Contrast(request) => {
                check_region(&series, request.region.as_deref())?;
                Work::Contrast(series, request.region.clone())
            }
            CalculationRequest::Verdict(request) => {
                check_region(&series, request.region.as_deref())?;
                let specification =
                    Specification::from_json(&request.specification).map_err(|e| {
                        LabError::Invalid {
                            field: "specification".into(),
                            problem: e.to_string(),
                        }
                    })?;
                let options = AnalysisOptions {
                    region: request.region.clone(),
                    fit: FitOptions {
                        variant: request.variant,
                        ..FitOptions::default()
                    },
                    ..AnalysisOptions::default()
                };
                Work::Verdict(series, Box::new(specification), options)
            }
        };
        let (id, event) = self
            .store()
            .begin_calculation(request.kind(), Some(request.scan_id()), &request.as_json()?)
            .await?;
        self.tell(event);
        let cancel = Arc::new(AtomicBool::new(false));
        let (lab, flag) = (self.clone(), Arc::clone(&cancel));
        // Held while the work begins, so that it cannot end before it is known.
        let mut under_way = self.calculations();
        let task = tokio::spawn(async move {
            let store = lab.store().clone();
            let end = tokio::task::spawn_blocking(move || work.run(&store, id, &flag))
                .await
                .unwrap_or_else(|_| CalculationEnd::Failed {
                    code: "internal".into(),
                    detail: "something went wrong inside; the daemon's log has the details".into(),
                });
            match lab.store().end_calculation(id, &end).await {
                Ok(event) => lab.tell(event),
                Err(error) => {
                    tracing::error!(id, %error, "the end of calculation {id} could not be kept: {error}");
                }
            }
            lab.calculations().remove(&id);
        });
        under_way.insert(id, UnderWay { cancel, task });
        Ok(id)
    }

    /// Asks a calculation to stop; it ends within a moment.
    ///
    /// # Errors
    /// An unknown one, or one that has ended.
    pub async fn cancel_calculation(&self, kind: CalculationKind, id: i64) -> Result<(), LabError> {
        let state = self.store().calculation(kind, id).await?.state;
        let flag = self
            .calculations()
            .get(&id)
            .map(|work| Arc::clone(&work.cancel));
        match flag {
            Some(flag) => {
                flag.store(true, Ordering::Relaxed);
                Ok(())
            }
            None => Err(LabError::Invalid {
                field: "id".into(),
                problem: format!("{kind} {id} is {state}: there is nothing to cancel"),
            }),
        }
    }

    /// Cancels all and waits until each has said how it ended.
    pub(super) async fn cancel_all_calculations(&self) {
        let under_way: Vec<UnderWay> = self.calculations().drain().map(|(_, work)| work).collect();
        for work in &under_way {
            work.cancel.store(true, Ordering::Relaxed);
        }
        for work in under_way {
            work.task.await.ok();
        }
    }

    fn calculations(&self) -> MutexGuard<'_, HashMap<i64, UnderWay>> {
        self.inner
            .calculations
            .lock()
            .expect("no holder of this lock panics")
    }

    /// Path of a file of a finished map.
    ///
    /// # Errors
    /// An unknown map, one without files, or a name that is none of them.
    pub async fn map_file(&self, id: i64, name: &str) -> Result<PathBuf, LabError> {
        let map = self.store().calculation(CalculationKind::Map, id).await?;
        let Some(result) = &map.result else {
            return Err(LabError::Invalid {
                field: "id".into(),
                problem: format!("map {id} is {} and has no files", map.state),
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
                problem: format!("map {id} has no such file; it has {}", names.join(", ")),
            });
        }
        Ok(self.store().map_folder(id).join(name))
    }
}

impl Work {
    fn run(self, store: &Store, id: i64, cancel: &AtomicBool) -> CalculationEnd {
        let result = match self {
            Work::Map(series) => map_of(&series, store, id, cancel),
            Work::Contrast(series, region) => contrast_of(&series, region.as_deref(), cancel),
            Work::Verdict(series, specification, options) => {
                verdict_of(&series, &specification, &options, cancel)
            }
        };
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

fn map_of(
    series: &StoredSeries,
    store: &Store,
    id: i64,
    cancel: &AtomicBool,
) -> Result<String, Failure> {
    let not_written = |error: StoreError| Failure::Because {
        code: "map-not-written",
        detail: error.to_string(),
    };
    let part = store.part_of_map(id);
    let options = MapOptions {
        scratch: part.clone(),
        ..MapOptions::default()
    };
    let made = std::fs::create_dir_all(&part)
        .map_err(|e| not_written(StoreError::file("the map", &part, e)))
        .and_then(|()| Ok(map_into(series, &options, &part, &|_| {}, cancel)?))
        .and_then(|summary| {
            store.keep_map(id).map_err(not_written)?;
            serde_json::to_string(&summary).map_err(Failure::internal)
        });
    if made.is_err() {
        // Best effort: what cannot be removed now names no map and does no harm.
        std::fs::remove_dir_all(&part).ok();
    }
    made
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
    cancel: &AtomicBool,
) -> Result<String, Failure> {
    let analysed = analysis::analyse(series, options, &|_| {}, cancel)?;
    let verdict = VerdictReport::new(specification, &analysed.report, &analysed.observations);
    serde_json::to_string(&verdict).map_err(Failure::internal)
}
