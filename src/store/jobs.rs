//! Jobs: fits, maps, contrasts, verdicts and traces. A row holds all inputs when a job starts, a second row its end.

use std::fs::{self, File};
use std::path::PathBuf;

use sqlx::FromRow;

use super::{Page, PageRequest, Store, StoreError};
use crate::job::{JobId, JobKind, JobState};
use crate::scan::event::ShortValue;
use crate::scan::{Event, RecordedEvent};
use crate::version::BUILD;

/// A job to start.
#[derive(Debug, Clone, PartialEq)]
pub struct NewJob {
    /// Decides the form of `request` and of the result.
    pub kind: JobKind,
    /// Scan that it reads; only a trace has none.
    pub scan_id: Option<i64>,
    /// Requested variant of the model; none for kinds without one.
    pub variant: Option<String>,
    /// JSON of the request.
    pub request: String,
    /// JSON of all options with their defaults, where they differ from the request.
    pub options: Option<String>,
    /// Who started it: the name of a token, `local` or `daemon`.
    pub who: String,
}

/// How a job ended.
#[derive(Debug, Clone, PartialEq)]
pub enum JobEnd {
    /// There is a result, whatever its status.
    Completed {
        /// JSON as the command of that name prints it.
        result: String,
        /// What the rows of a fit are searched by.
        fit: Option<FitSummary>,
    },
    /// An error ended it.
    Failed {
        /// Stable word.
        code: String,
        /// Cause and remedy.
        detail: String,
    },
    /// A user cancelled it.
    Cancelled,
    /// The daemon ended while it ran.
    Interrupted,
}

/// The columns of a completed fit.
#[derive(Debug, Clone, PartialEq)]
pub struct FitSummary {
    /// Row of the fitted observations.
    pub set_id: i64,
    /// Chosen variant.
    pub variant: String,
    /// converged, at-bound, …
    pub status: String,
    /// Ridge angle in degrees, if it is identifiable.
    pub theta_r_deg: Option<ShortValue>,
}

/// A stored job.
#[derive(Debug, Clone, PartialEq, FromRow)]
pub struct Job {
    /// Decides the form of `request` and `result`.
    #[sqlx(try_from = "String")]
    pub kind: JobKind,
    /// Number within the kind.
    pub number: i64,
    /// Scan that it reads; only a trace has none.
    pub scan_id: Option<i64>,
    /// Sample of the scan.
    pub sample_id: Option<i64>,
    /// The sample's name.
    pub sample_name: Option<String>,
    /// JSON of the request.
    pub request: String,
    /// Running, or how it ended.
    #[sqlx(try_from = "String")]
    pub state: JobState,
    /// Observations of a fit.
    pub set_id: Option<i64>,
    /// JSON of the result; `None` without one.
    pub result: Option<String>,
    /// Stable word for the error that ended it.
    pub error_code: Option<String>,
    /// Cause and remedy.
    pub error_detail: Option<String>,
    /// Who started it: the name of a token, `local` or `daemon`.
    pub who: String,
    /// When it was accepted, RFC 3339 UTC.
    pub created_at: String,
    /// When it ended, RFC 3339 UTC; `None` while it runs.
    pub ended_at: Option<String>,
}

impl Job {
    /// Kind and number.
    #[must_use]
    pub const fn id(&self) -> JobId {
        JobId::new(self.kind, self.number)
    }
}

/// Selects jobs of a kind.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct JobFilter {
    /// Only jobs of scans of this sample.
    pub sample_id: Option<i64>,
    /// Only jobs that read this scan.
    pub scan_id: Option<i64>,
    /// Only jobs in this state now.
    pub state: Option<JobState>,
    /// Fits with this chosen variant (requested, while there is none).
    pub variant: Option<String>,
    /// Fits with this status; `cancelled` also selects fits in that state, which have no report.
    pub status: Option<String>,
    /// Started at or after, RFC 3339 UTC.
    pub since: Option<String>,
    /// Fits whose ridge angle is at least this, degrees.
    pub theta_r_deg_min: Option<f64>,
    /// Fits whose ridge angle is at most this, degrees.
    pub theta_r_deg_max: Option<f64>,
}

const SELECT: &str =
    "SELECT j.kind, j.number, j.scan_id, s.sample_id, p.name AS sample_name, j.request,
       COALESCE(e.state, 'running') AS state, e.set_id, e.result, e.error_code, e.error_detail,
       j.who, j.created_at, e.at AS ended_at
     FROM jobs j LEFT JOIN job_ends e ON e.job_id = j.id
     LEFT JOIN scan_now s ON s.scan_id = j.scan_id LEFT JOIN sample_now p ON p.sample_id = s.sample_id";

/// Extension of a folder that is being filled.
const PART_SUFFIX: &str = "part";

/// What the event of a job needs of its row.
#[derive(FromRow)]
struct Started {
    id: i64,
    scan_id: Option<i64>,
    variant: Option<String>,
}

impl Store {
    /// Adds a job that is about to run; its number is the next one of its kind.
    ///
    /// # Errors
    /// A database error.
    pub async fn start_job(&self, new: &NewJob) -> Result<(JobId, RecordedEvent), StoreError> {
        let mut transaction = self.writing().await?;
        // Rows are never deleted, so no number is used twice.
        let number = sqlx::query_scalar(
            "INSERT INTO jobs (kind, number, scan_id, variant, request, options, program, created_at, who)
             VALUES (?1, (SELECT COALESCE(MAX(number), 0) + 1 FROM jobs WHERE kind = ?1), ?2, ?3, ?4, ?5, ?6, ?7, ?8)
             RETURNING number",
        )
        .bind(new.kind.as_str())
        .bind(new.scan_id)
        .bind(&new.variant)
        .bind(&new.request)
        .bind(&new.options)
        .bind(BUILD)
        .bind(self.now_text())
        .bind(&new.who)
        .fetch_one(&mut *transaction)
        .await?;
        let id = JobId::new(new.kind, number);
        let event = event(
            id,
            new.scan_id,
            JobState::Running,
            new.variant.clone(),
            None,
        );
        let event = self.record_in(&mut transaction, event).await?;
        transaction.commit().await?;
        Ok((id, event))
    }

    /// Adds the end of a job. A job ends once.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error, also if it has ended.
    pub async fn end_job(&self, id: JobId, end: &JobEnd) -> Result<RecordedEvent, StoreError> {
        let (state, result, fit, error) = match end {
            JobEnd::Completed { result, fit } => {
                (JobState::Completed, Some(result), fit.as_ref(), None)
            }
            JobEnd::Failed { code, detail } => (JobState::Failed, None, None, Some((code, detail))),
            JobEnd::Cancelled => (JobState::Cancelled, None, None, None),
            JobEnd::Interrupted => (JobState::Interrupted, None, None, None),
        };
        let mut transaction = self.writing().await?;
        let started: Started =
            sqlx::query_as("SELECT id, scan_id, variant FROM jobs WHERE kind = ? AND number = ?")
                .bind(id.kind.as_str())
                .bind(id.number)
                .fetch_optional(&mut *transaction)
                .await?
                .ok_or_else(|| not_found(id))?;
        sqlx::query(
            "INSERT INTO job_ends (job_id, state, set_id, result, variant, status, theta_r_deg, error_code, error_detail, at)
             VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        )
        .bind(started.id)
        .bind(state.as_str())
        .bind(fit.map(|fit| fit.set_id))
        .bind(result)
        .bind(fit.map(|fit| &fit.variant))
        .bind(fit.map(|fit| &fit.status))
        .bind(fit.and_then(|fit| fit.theta_r_deg).map(|angle| angle.value))
        .bind(error.map(|(code, _)| code))
        .bind(error.map(|(_, detail)| detail))
        .bind(self.now_text())
        .execute(&mut *transaction)
        .await?;
        let event = event(id, started.scan_id, state, started.variant, fit);
        let event = self.record_in(&mut transaction, event).await?;
        transaction.commit().await?;
        Ok(event)
    }

    /// Marks the jobs that a kill cut off as interrupted and removes their unfinished folders.
    pub(super) async fn interrupt_jobs(
        &self,
    ) -> Result<(Vec<JobId>, Vec<RecordedEvent>), StoreError> {
        let rows: Vec<(String, i64)> = sqlx::query_as(
            "SELECT kind, number FROM jobs WHERE id NOT IN (SELECT job_id FROM job_ends) ORDER BY id",
        )
        .fetch_all(self.writer())
        .await?;
        let (mut ids, mut events) = (Vec::new(), Vec::new());
        for (kind, number) in rows {
            let kind = JobKind::try_from(kind).map_err(|e| StoreError::bad_row("jobs", e))?;
            let id = JobId::new(kind, number);
            events.push(self.end_job(id, &JobEnd::Interrupted).await?);
            fs::remove_dir_all(self.part_folder(id)).ok();
            ids.push(id);
        }
        Ok((ids, events))
    }

    /// Returns one job.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], also where the number belongs to another kind.
    pub async fn job(&self, id: JobId) -> Result<Job, StoreError> {
        sqlx::query_as(sqlx::AssertSqlSafe(format!(
            "{SELECT} WHERE j.kind = ? AND j.number = ?"
        )))
        .bind(id.kind.as_str())
        .bind(id.number)
        .fetch_optional(self.readers())
        .await?
        .ok_or_else(|| not_found(id))
    }

    /// Returns the program that started a job, with its commit where it is known.
    ///
    /// # Errors
    /// As [`Store::job`].
    pub async fn program_of_job(&self, id: JobId) -> Result<String, StoreError> {
        sqlx::query_scalar("SELECT program FROM jobs WHERE kind = ? AND number = ?")
            .bind(id.kind.as_str())
            .bind(id.number)
            .fetch_optional(self.readers())
            .await?
            .ok_or_else(|| not_found(id))
    }

    /// Returns jobs of a kind, newest first.
    ///
    /// # Errors
    /// A database error.
    pub async fn jobs(
        &self,
        kind: JobKind,
        filter: &JobFilter,
        page: PageRequest,
    ) -> Result<Page<Job>, StoreError> {
        let rows: Vec<Job> = sqlx::query_as(sqlx::AssertSqlSafe(format!(
            "{SELECT} WHERE j.kind = ?1 AND (?2 IS NULL OR j.number < ?2)
               AND (?3 IS NULL OR s.sample_id = ?3) AND (?4 IS NULL OR j.scan_id = ?4)
               AND (?5 IS NULL OR COALESCE(e.state, 'running') = ?5)
               AND (?6 IS NULL OR COALESCE(e.variant, j.variant) = ?6)
               AND (?7 IS NULL OR e.status = ?7 OR (?7 = 'cancelled' AND e.state = ?7))
               AND (?8 IS NULL OR j.created_at >= ?8)
               AND (?9 IS NULL OR e.theta_r_deg >= ?9) AND (?10 IS NULL OR e.theta_r_deg <= ?10)
             ORDER BY j.number DESC LIMIT ?11"
        )))
        .bind(kind.as_str())
        .bind(page.cursor)
        .bind(filter.sample_id)
        .bind(filter.scan_id)
        .bind(filter.state.map(JobState::as_str))
        .bind(&filter.variant)
        .bind(&filter.status)
        .bind(&filter.since)
        .bind(filter.theta_r_deg_min)
        .bind(filter.theta_r_deg_max)
        .bind(page.limit + 1)
        .fetch_all(self.readers())
        .await?;
        Ok(Page::cut(rows, page.limit, |job: &Job| job.number))
    }

    /// Returns the folder of a finished job's files.
    #[must_use]
    pub fn files_folder(&self, id: JobId) -> PathBuf {
        self.folder()
            .join(id.kind.plural())
            .join(id.number.to_string())
    }

    /// Returns the folder that a running job fills.
    #[must_use]
    pub fn part_folder(&self, id: JobId) -> PathBuf {
        self.files_folder(id).with_extension(PART_SUFFIX)
    }

    /// Makes the files of a job durable under their final name. Call this before the end is committed.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`], [`StoreError::FolderGone`] or [`StoreError::File`].
    pub fn keep_files(&self, id: JobId) -> Result<(), StoreError> {
        self.check_folder()?;
        let (part, folder) = (self.part_folder(id), self.files_folder(id));
        let error = |e| StoreError::file("the folder of a job's files", &folder, e);
        for entry in fs::read_dir(&part).map_err(error)? {
            let path = entry.map_err(error)?.path();
            File::open(path).and_then(|f| f.sync_all()).map_err(error)?;
        }
        File::open(&part)
            .and_then(|f| f.sync_all())
            .map_err(error)?;
        fs::rename(&part, &folder).map_err(error)?;
        File::open(self.folder().join(id.kind.plural()))
            .and_then(|f| f.sync_all())
            .map_err(error)
    }
}

fn not_found(id: JobId) -> StoreError {
    StoreError::NotFound {
        noun: id.kind.as_str(),
        id: id.number,
    }
}

/// The event of a job's new state.
fn event(
    id: JobId,
    scan_id: Option<i64>,
    state: JobState,
    requested_variant: Option<String>,
    fit: Option<&FitSummary>,
) -> Event {
    match id.kind {
        JobKind::Fit => Event::Fit {
            fit_id: id.number,
            scan_id,
            state,
            variant: fit.map_or(requested_variant, |fit| Some(fit.variant.clone())),
            status: fit.map(|fit| fit.status.clone()),
            theta_r_deg: fit.and_then(|fit| fit.theta_r_deg),
        },
        kind => Event::Calculation {
            kind,
            calculation_id: id.number,
            scan_id,
            state,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::scans::tests::planned;
    use crate::store::tests::open;

    fn new(kind: JobKind, scan_id: i64) -> NewJob {
        NewJob {
            kind,
            scan_id: (kind != JobKind::Trace).then_some(scan_id),
            variant: (kind == JobKind::Fit).then(|| "auto".into()),
            request: "{}".into(),
            options: None,
            who: "local".into(),
        }
    }

    async fn started(store: &Store, kind: JobKind, scan_id: i64) -> JobId {
        store.start_job(&new(kind, scan_id)).await.unwrap().0
    }

    async fn numbers(store: &Store, kind: JobKind, filter: JobFilter) -> Vec<i64> {
        let page = store.jobs(kind, &filter, PageRequest::default()).await;
        page.unwrap().items.iter().map(|job| job.number).collect()
    }

    #[tokio::test]
    async fn a_job_of_each_kind_has_its_own_numbers_and_ends_once() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        for kind in JobKind::ALL {
            let (id, event) = store.start_job(&new(kind, scan.id)).await.unwrap();
            assert_eq!(id, JobId::new(kind, 1));
            assert_eq!(event.event.job(), Some((id, JobState::Running)));
            let scan_id = (kind != JobKind::Trace).then_some(scan.id);
            assert_eq!(event.event.scan_id(), scan_id);
            assert_eq!(started(&store, kind, scan.id).await.number, 2);
            let end = JobEnd::Completed {
                result: "{\"mode\":\"measured\"}".into(),
                fit: None,
            };
            store.end_job(id, &end).await.unwrap();
            assert!(store.end_job(id, &JobEnd::Cancelled).await.is_err());
            let kept = store.job(id).await.unwrap();
            assert_eq!((kept.id(), kept.state), (id, JobState::Completed));
            let sample_id = scan_id.map(|_| scan.sample_id);
            assert_eq!((kept.scan_id, kept.sample_id), (scan_id, sample_id));
            let missing = store.job(JobId::new(kind, 3)).await.unwrap_err();
            assert_eq!(missing.to_string(), format!("there is no {kind} 3"));
            let in_state = |state| JobFilter {
                state: Some(state),
                ..JobFilter::default()
            };
            assert_eq!(
                numbers(&store, kind, in_state(JobState::Completed)).await,
                [1]
            );
            assert_eq!(
                numbers(&store, kind, in_state(JobState::Running)).await,
                [2]
            );
        }
    }

    #[tokio::test]
    async fn jobs_are_found_by_sample_time_and_page() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let kind = JobKind::Contrast;
        for _ in 0..3 {
            started(&store, kind, scan.id).await;
        }
        started(&store, JobKind::Map, scan.id).await;
        let of = |sample_id, since: &str| JobFilter {
            sample_id: Some(sample_id),
            since: Some(since.into()),
            ..JobFilter::default()
        };
        let created_at = store.job(JobId::new(kind, 1)).await.unwrap().created_at;
        let found = async |filter| numbers(&store, kind, filter).await.len();
        assert_eq!(found(of(scan.sample_id, &created_at)).await, 3);
        assert_eq!(found(of(scan.sample_id + 1, &created_at)).await, 0);
        assert_eq!(found(of(scan.sample_id, "9999-01-01T00:00:00Z")).await, 0);
        let page = PageRequest {
            cursor: Some(3),
            limit: 1,
        };
        let second = store.jobs(kind, &JobFilter::default(), page).await.unwrap();
        assert_eq!(second.items[0].number, 2);
        assert_eq!(second.next_cursor, Some(2));
    }

    #[tokio::test]
    async fn a_fit_is_found_by_its_angle_its_variant_and_its_status() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let id = started(&store, JobKind::Fit, scan.id).await;
        let end = JobEnd::Completed {
            result: "{}".into(),
            fit: Some(FitSummary {
                set_id: store.add_empty_set(scan.id).await,
                variant: "sawtooth".into(),
                status: "converged".into(),
                theta_r_deg: Some(ShortValue {
                    value: 10.0,
                    expanded: 0.1,
                }),
            }),
        };
        store.end_job(id, &end).await.unwrap();
        let cancelled = started(&store, JobKind::Fit, scan.id).await;
        store.end_job(cancelled, &JobEnd::Cancelled).await.unwrap();
        let found = async |filter| numbers(&store, JobKind::Fit, filter).await;
        let between = |min, max| JobFilter {
            theta_r_deg_min: Some(min),
            theta_r_deg_max: Some(max),
            ..JobFilter::default()
        };
        assert_eq!(found(between(9.0, 11.0)).await, [id.number]);
        assert_eq!(found(between(11.0, 12.0)).await, [0_i64; 0]);
        let of = |variant: &str| JobFilter {
            variant: Some(variant.into()),
            ..JobFilter::default()
        };
        assert_eq!(found(of("sawtooth")).await, [id.number]);
        assert_eq!(found(of("auto")).await, [cancelled.number]);
        let with = |status: &str| JobFilter {
            status: Some(status.into()),
            ..JobFilter::default()
        };
        assert_eq!(found(with("cancelled")).await, [cancelled.number]);
        assert_eq!(found(with("converged")).await, [id.number]);
    }

    #[tokio::test]
    async fn a_restart_interrupts_running_jobs_and_removes_unfinished_folders() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let fit = started(&store, JobKind::Fit, scan.id).await;
        let map = started(&store, JobKind::Map, scan.id).await;
        let part = store.part_folder(map);
        fs::create_dir_all(&part).unwrap();
        fs::write(part.join("theta_r.tif"), b"half").unwrap();
        store.close().await;
        drop(store);
        let (store, found) = open(folder.path()).await.unwrap();
        assert_eq!(found.interrupted_jobs, [fit, map]);
        assert!(!part.exists());
        for id in [fit, map] {
            assert_eq!(store.job(id).await.unwrap().state, JobState::Interrupted);
        }
    }
}
