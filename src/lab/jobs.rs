//! Jobs: starts, reports, cancels and ends fits, maps, contrasts, verdicts and traces, all in the same way.
//!
//! [`Lab::start_job`] checks a [`JobRequest`], opens what it reads, writes its row and spawns a task. The task waits for a
//! slot of its kind, publishes a forecast, runs the [`Work`] on a thread of its own and writes how it ended. A kind adds a
//! request, a [`Work`] and a variant of [`JobRequest`].

pub(super) mod chosen_fit;
pub(super) mod contrasts;
pub(super) mod cost_estimate;
pub(super) mod curves;
pub(super) mod fits;
pub(super) mod maps;
pub(super) mod progress;
pub(super) mod running;
pub(super) mod single_flight;
pub(super) mod slots;
pub(super) mod trace_result;
pub(super) mod traces;
pub(super) mod verdicts;
pub(super) mod work;

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{SystemTime, UNIX_EPOCH};

use serde::Serialize;

use super::failure::Failure;
use super::tasks::{blocking, to_the_end};
use super::{Lab, LabError};
use crate::forecast::Forecast;
use crate::job::{JobId, JobKind, JobState};
use crate::store::jobs::{FitSummary, JobEnd, NewJob};
use crate::store::{Store, StoreError};
use contrasts::ContrastRequest;
use cost_estimate::{ForecastSubject, with_cost};
use fits::FitRequest;
use maps::MapRequest;
use progress::{JobProgress, ProgressMeter};
use traces::TraceRequest;
use verdicts::VerdictRequest;
use work::{Finished, FinishedFit, Work, word};

/// Most bytes of a request without the contents of its files.
const REQUEST_BYTES_MAX: usize = 256 << 10;

/// A request for a job of any kind.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(untagged)]
pub enum JobRequest {
    /// Parameters of a surface.
    Fit(FitRequest),
    /// Parameters per pixel.
    Map(MapRequest),
    /// The contrast table.
    Contrast(ContrastRequest),
    /// Conformity to a specification.
    Verdict(VerdictRequest),
    /// Light through a scene.
    Trace(TraceRequest),
}

impl JobRequest {
    const fn kind(&self) -> JobKind {
        match self {
            JobRequest::Fit(_) => JobKind::Fit,
            JobRequest::Map(_) => JobKind::Map,
            JobRequest::Contrast(_) => JobKind::Contrast,
            JobRequest::Verdict(_) => JobKind::Verdict,
            JobRequest::Trace(_) => JobKind::Trace,
        }
    }

    /// The scan that the job reads; a trace reads only its scene.
    const fn scan_id(&self) -> Option<i64> {
        match self {
            JobRequest::Fit(request) => Some(request.scan_id),
            JobRequest::Map(request) => Some(request.scan_id),
            JobRequest::Contrast(request) => Some(request.scan_id),
            JobRequest::Verdict(request) => Some(request.scan_id),
            JobRequest::Trace(_) => None,
        }
    }

    fn variant(&self) -> Option<String> {
        match self {
            JobRequest::Fit(request) => Some(word(&request.variant)),
            JobRequest::Verdict(request) => Some(word(&request.variant)),
            JobRequest::Map(_) | JobRequest::Contrast(_) | JobRequest::Trace(_) => None,
        }
    }

    /// Checks the request and opens what it reads now: the result belongs to this snapshot of the scan.
    async fn prepare(&self, store: &Store) -> Result<Box<dyn Work>, LabError> {
        Ok(match self {
            JobRequest::Fit(request) => Box::new(request.prepare(store).await?),
            JobRequest::Map(request) => Box::new(request.prepare(store).await?),
            JobRequest::Contrast(request) => Box::new(request.prepare(store).await?),
            JobRequest::Verdict(request) => Box::new(request.prepare(store).await?),
            JobRequest::Trace(request) => Box::new(request.prepare().await?),
        })
    }
}

macro_rules! from_requests {
    ($($kind:ident($request:ident)),*) => {$(
        impl From<$request> for JobRequest {
            fn from(request: $request) -> Self {
                JobRequest::$kind(request)
            }
        }
    )*};
}

from_requests!(
    Fit(FitRequest),
    Map(MapRequest),
    Contrast(ContrastRequest),
    Verdict(VerdictRequest),
    Trace(TraceRequest)
);

impl Lab {
    /// Starts a job and returns its id; events report its forecast and its end.
    ///
    /// # Errors
    /// [`LabError::Invalid`] for a request that cannot be computed, or [`LabError::Store`], also for an unknown scan.
    pub async fn start_job(&self, request: impl Into<JobRequest>) -> Result<JobId, LabError> {
        let (lab, request) = (self.clone(), request.into());
        // A row in state running must have a task, also where the client disconnects in between.
        to_the_end(async move { lab.prepare_and_start(request).await }).await
    }

    async fn prepare_and_start(&self, request: JobRequest) -> Result<JobId, LabError> {
        let request = match request {
            // The row states the limits, whatever becomes of the stored specification.
            JobRequest::Verdict(verdict) => verdict.with_content(self.store()).await?.into(),
            other => other,
        };
        let not_json = |e| StoreError::bad_row("jobs", e);
        let text = serde_json::to_string(&request).map_err(not_json)?;
        if text.len() > REQUEST_BYTES_MAX {
            return Err(LabError::Invalid {
                field: "body".into(),
                problem: format!(
                    "without its files it has {} bytes, expected at most {REQUEST_BYTES_MAX}: it is stored, and lists return \
                     it; shorten its texts",
                    text.len()
                ),
            });
        }
        let work = request.prepare(self.store()).await?;
        let new = NewJob {
            kind: request.kind(),
            scan_id: request.scan_id(),
            variant: request.variant(),
            request: text,
            options: work.options().map_err(not_json)?,
            who: self.who.to_string(),
        };
        let (id, event) = self.store().start_job(&new).await?;
        self.publish(event);
        let lab = self.clone();
        self.inner.jobs.start(id, |cancel, progress| async move {
            let end = match lab.run_job(id, new.scan_id, work, &progress, &cancel).await {
                Ok(end) => end,
                Err(Failure::Cancelled) => lab.inner.jobs.end_of_cancelled(),
                Err(Failure::Because { code, detail }) => JobEnd::Failed {
                    code: code.into(),
                    detail,
                },
            };
            match lab.store().end_job(id, &end).await {
                Ok(event) => lab.publish(event),
                Err(error) => {
                    tracing::error!(%id, %error, "the end of {id} could not be stored: {error}");
                }
            }
            lab.inner.jobs.ended(id);
        });
        Ok(id)
    }

    async fn run_job(
        &self,
        id: JobId,
        scan_id: Option<i64>,
        work: Box<dyn Work>,
        progress: &Arc<ProgressMeter>,
        cancel: &Arc<AtomicBool>,
    ) -> Result<JobEnd, Failure> {
        let slots = self.inner.slots.of(id.kind);
        let _slot = slots.acquire(progress, cancel).await;
        let _slot = _slot.ok_or(Failure::Cancelled)?;
        let subject = ForecastSubject {
            of: id.kind.to_string(),
            number: id.number,
            scan_id,
        };
        let work = self
            .publish_forecast(subject, work, progress, cancel)
            .await?;
        let (store, meter, flag) = (
            self.store().clone(),
            Arc::clone(progress),
            Arc::clone(cancel),
        );
        let Finished { json, fit } = blocking(move || {
            meter.report("preparing", 0, 1);
            with_files(&store, id, |folder| work.run(folder, &meter, &flag))
        })
        .await??;
        let fit = match fit {
            Some(fit) => Some(self.keep_observations(fit).await?),
            None => None,
        };
        Ok(JobEnd::Completed {
            result: with_cost(&json, progress).map_err(Failure::not_json)?,
            fit,
        })
    }

    async fn keep_observations(&self, fit: FinishedFit) -> Result<FitSummary, LabError> {
        let set_id = self
            .store()
            .add_observations(fit.scan_id, fit.last_frame_id, &fit.observations)
            .await?;
        Ok(FitSummary {
            set_id,
            variant: fit.variant,
            status: fit.status,
            theta_r_deg: fit.theta_r_deg,
        })
    }

    /// Returns the progress and the forecast of a running job; none where it has not reported yet, or was removed at its end.
    #[must_use]
    pub fn job_progress(&self, id: JobId) -> (Option<JobProgress>, Option<Forecast>) {
        match self.inner.jobs.progress(id) {
            Some(progress) => (progress.now(), progress.forecast()),
            None => (None, None),
        }
    }

    /// Asks a job to stop; a fit ends within one evaluation of the model.
    ///
    /// # Errors
    /// [`LabError::JobConflict`] if it has ended; [`LabError::Store`] for an unknown job.
    pub async fn cancel_job(&self, id: JobId) -> Result<(), LabError> {
        let state = self.store().job(id).await?.state;
        // Between its last row and its removal from the running jobs it has ended, too.
        if state == JobState::Running && self.inner.jobs.cancel(id) {
            return Ok(());
        }
        Err(LabError::JobConflict {
            id,
            state,
            problem: "there is nothing to cancel",
        })
    }

    /// Finds a file of a finished map or trace.
    ///
    /// # Errors
    /// [`LabError::JobConflict`] for a job without files, [`LabError::Invalid`] for a name that it does not list, or
    /// [`LabError::Store`].
    pub async fn find_job_file(&self, id: JobId, name: &str) -> Result<JobFile, LabError> {
        let job = self.store().job(id).await?;
        let Some(result) = &job.result else {
            return Err(LabError::JobConflict {
                id,
                state: job.state,
                problem: "it has no files",
            });
        };
        let summary: serde_json::Value =
            serde_json::from_str(result).map_err(|e| StoreError::bad_row("job_ends", e))?;
        let names: Vec<&str> = summary["files"]
            .as_array()
            .into_iter()
            .flatten()
            .filter_map(serde_json::Value::as_str)
            .collect();
        // Only listed names are opened, so that no name leads out of the folder.
        if !names.contains(&name) {
            return Err(LabError::Invalid {
                field: "name".into(),
                problem: format!("{id} has no such file; it has {}", names.join(", ")),
            });
        }
        let path = self.store().files_folder(id).join(name);
        let of_file = |e| StoreError::file("a file of a job", &path, e);
        let found = tokio::fs::metadata(&path).await.map_err(of_file)?;
        let written = found.modified().map_err(of_file)?;
        Ok(JobFile {
            bytes: found.len(),
            written,
            path,
        })
    }
}

/// A file of a job that was found, but not read.
#[derive(Debug)]
pub struct JobFile {
    path: PathBuf,
    written: SystemTime,
    /// Its size.
    pub bytes: u64,
}

impl JobFile {
    /// Returns a text that differs from that of every other content, also of another data folder: a file is written once, so
    /// size and time name its content without reading it.
    #[must_use]
    pub fn tag(&self) -> String {
        let since_1970 = self.written.duration_since(UNIX_EPOCH);
        let since_1970 = since_1970.unwrap_or_default().as_nanos();
        format!("{:x}-{since_1970:x}", self.bytes)
    }

    /// Reads it.
    ///
    /// # Errors
    /// An I/O error.
    pub async fn read(self) -> Result<Vec<u8>, LabError> {
        let bytes = tokio::fs::read(&self.path).await;
        Ok(bytes.map_err(|e| StoreError::file("a file of a job", &self.path, e))?)
    }
}

/// Runs work that may leave files. They are written into a temporary folder, which gets its final name when all is done
/// and is removed if the work fails.
fn with_files(
    store: &Store,
    id: JobId,
    work: impl FnOnce(&Path) -> Result<Finished, Failure>,
) -> Result<Finished, Failure> {
    let code = match id.kind {
        JobKind::Map => "map-not-written",
        JobKind::Trace => "trace-not-written",
        JobKind::Fit | JobKind::Contrast | JobKind::Verdict => return work(Path::new("")),
    };
    let part = store.part_folder(id);
    let made = store
        .check_folder()
        .and_then(|()| {
            std::fs::create_dir_all(&part)
                .map_err(|e| StoreError::file("the folder of a job's files", &part, e))
        })
        .map_err(|e| Failure::because(code, e))
        .and_then(|()| work(&part))
        .and_then(|finished| {
            store
                .keep_files(id)
                .map_err(|e| Failure::because(code, e))?;
            Ok(finished)
        });
    if made.is_err() {
        // A folder that cannot be removed now belongs to no finished job and does no harm.
        std::fs::remove_dir_all(&part).ok();
    }
    made
}
