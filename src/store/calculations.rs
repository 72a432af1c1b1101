//! Maps, contrasts, verdicts and traces: all inputs when they begin, the result when they end.

use std::fs::{self, File};
use std::path::PathBuf;

use sqlx::FromRow;

use super::{PROGRAM, Page, PageRequest, Store, StoreError};
use crate::scan::event::{CalculationKind, TaskState};
use crate::scan::{Event, RecordedEvent};

/// How a calculation ended.
#[derive(Debug, Clone, PartialEq)]
pub enum CalculationEnd {
    /// There is a result: JSON as the command of that name prints it.
    Completed(String),
    /// There is none.
    Failed {
        /// Stable word.
        code: String,
        /// What happened and what to do.
        detail: String,
    },
    /// A person ended it.
    Cancelled,
}

/// A calculation as it is kept.
#[derive(Debug, Clone, PartialEq, FromRow)]
pub struct Calculation {
    /// Its number, one series for all kinds.
    pub id: i64,
    /// Scan it is of.
    pub scan_id: Option<i64>,
    /// JSON of what was asked for.
    pub request: String,
    /// Where it stands.
    #[sqlx(try_from = "String")]
    pub state: TaskState,
    /// JSON of the result.
    pub result: Option<String>,
    /// Why there is none.
    pub error_code: Option<String>,
    /// The same in words.
    pub error_detail: Option<String>,
    /// RFC 3339 UTC.
    pub created_at: String,
    /// RFC 3339 UTC.
    pub ended_at: Option<String>,
}

/// Which calculations of a kind are wanted.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CalculationFilter {
    /// Of any scan of this sample.
    pub sample_id: Option<i64>,
    /// Of this scan.
    pub scan_id: Option<i64>,
    /// In this state.
    pub state: Option<TaskState>,
    /// Begun at or after, RFC 3339 UTC.
    pub since: Option<String>,
}

const SELECT: &str = "SELECT c.id, c.scan_id, c.request, COALESCE(e.state, 'running') AS state,
       e.result, e.error_code, e.error_detail, c.created_at, e.at AS ended_at
     FROM calculations c LEFT JOIN calculation_ends e ON e.calculation_id = c.id
     LEFT JOIN scans s ON s.id = c.scan_id";

/// Name ending of a folder that is being filled.
const PART_SUFFIX: &str = "part";

impl Store {
    /// Adds a calculation that is about to run.
    ///
    /// # Errors
    /// What the database says.
    pub async fn begin_calculation(
        &self,
        kind: CalculationKind,
        scan_id: Option<i64>,
        request: &str,
    ) -> Result<(i64, RecordedEvent), StoreError> {
        let mut transaction = self.writing().await?;
        let id = sqlx::query(
            "INSERT INTO calculations (kind, scan_id, request, program, created_at) VALUES (?, ?, ?, ?, ?)",
        )
        .bind(kind.as_str())
        .bind(scan_id)
        .bind(request)
        .bind(PROGRAM)
        .bind(self.wall_text())
        .execute(&mut *transaction)
        .await?
        .last_insert_rowid();
        let event = Event::Calculation {
            kind,
            calculation_id: id,
            scan_id,
            state: TaskState::Running,
        };
        let event = self.record_in(&mut transaction, event).await?;
        transaction.commit().await?;
        Ok((id, event))
    }

    /// Adds how a calculation ended.
    ///
    /// # Errors
    /// What the database says; a calculation ends once.
    pub async fn end_calculation(
        &self,
        id: i64,
        end: &CalculationEnd,
    ) -> Result<RecordedEvent, StoreError> {
        match end {
            CalculationEnd::Completed(result) => {
                self.insert_end_of(id, TaskState::Completed, Some(result), None)
                    .await
            }
            CalculationEnd::Failed { code, detail } => {
                self.insert_end_of(id, TaskState::Failed, None, Some((code, detail)))
                    .await
            }
            CalculationEnd::Cancelled => {
                self.insert_end_of(id, TaskState::Cancelled, None, None)
                    .await
            }
        }
    }

    async fn insert_end_of(
        &self,
        id: i64,
        state: TaskState,
        result: Option<&str>,
        error: Option<(&str, &str)>,
    ) -> Result<RecordedEvent, StoreError> {
        let mut transaction = self.writing().await?;
        let (kind, scan_id): (String, Option<i64>) =
            sqlx::query_as("SELECT kind, scan_id FROM calculations WHERE id = ?")
                .bind(id)
                .fetch_optional(&mut *transaction)
                .await?
                .ok_or(StoreError::NotFound {
                    noun: "calculation",
                    id,
                })?;
        let kind = CalculationKind::from_word(&kind)
            .ok_or_else(|| StoreError::bad_row("calculations", format!("kind `{kind}`")))?;
        sqlx::query(
            "INSERT INTO calculation_ends (calculation_id, state, result, error_code, error_detail, at)
             VALUES (?, ?, ?, ?, ?, ?)",
        )
        .bind(id)
        .bind(state.as_str())
        .bind(result)
        .bind(error.map(|e| e.0))
        .bind(error.map(|e| e.1))
        .bind(self.wall_text())
        .execute(&mut *transaction)
        .await?;
        let event = Event::Calculation {
            kind,
            calculation_id: id,
            scan_id,
            state,
        };
        let event = self.record_in(&mut transaction, event).await?;
        transaction.commit().await?;
        Ok(event)
    }

    /// Marks what a kill cut off and removes half-filled folders; nothing of them was ever told.
    pub(super) async fn interrupt_calculations(
        &self,
    ) -> Result<(Vec<i64>, Vec<RecordedEvent>), StoreError> {
        let ids: Vec<i64> = sqlx::query_scalar(
            "SELECT id FROM calculations WHERE id NOT IN (SELECT calculation_id FROM calculation_ends) ORDER BY id",
        )
        .fetch_all(self.writer())
        .await?;
        let mut events = Vec::new();
        for id in &ids {
            events.push(
                self.insert_end_of(*id, TaskState::Interrupted, None, None)
                    .await?,
            );
            for kind in [CalculationKind::Map, CalculationKind::Trace] {
                fs::remove_dir_all(self.part_folder(kind, *id)).ok();
            }
        }
        Ok((ids, events))
    }

    /// One calculation of a kind.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], also where the number is of another kind, or what the database says.
    pub async fn calculation(
        &self,
        kind: CalculationKind,
        id: i64,
    ) -> Result<Calculation, StoreError> {
        sqlx::query_as(sqlx::AssertSqlSafe(format!(
            "{SELECT} WHERE c.id = ? AND c.kind = ?"
        )))
        .bind(id)
        .bind(kind.as_str())
        .fetch_optional(self.readers())
        .await?
        .ok_or(StoreError::NotFound {
            noun: kind.as_str(),
            id,
        })
    }

    /// Calculations of a kind, newest first.
    ///
    /// # Errors
    /// What the database says.
    pub async fn calculations(
        &self,
        kind: CalculationKind,
        filter: &CalculationFilter,
        page: PageRequest,
    ) -> Result<Page<Calculation>, StoreError> {
        let rows: Vec<Calculation> = sqlx::query_as(sqlx::AssertSqlSafe(format!(
            "{SELECT} WHERE c.kind = ?1 AND (?2 IS NULL OR c.id < ?2) AND (?3 IS NULL OR c.scan_id = ?3)
               AND (?4 IS NULL OR COALESCE(e.state, 'running') = ?4)
               AND (?5 IS NULL OR s.sample_id = ?5) AND (?6 IS NULL OR c.created_at >= ?6)
             ORDER BY c.id DESC LIMIT ?7"
        )))
        .bind(kind.as_str())
        .bind(page.cursor)
        .bind(filter.scan_id)
        .bind(filter.state.map(TaskState::as_str))
        .bind(filter.sample_id)
        .bind(&filter.since)
        .bind(page.limit + 1)
        .fetch_all(self.readers())
        .await?;
        Ok(Page::cut(rows, page.limit, |c: &Calculation| c.id))
    }

    /// Folder of the files of a finished map or trace.
    #[must_use]
    pub fn files_folder(&self, kind: CalculationKind, id: i64) -> PathBuf {
        self.files_of(kind).join(id.to_string())
    }

    /// Folder in which those files are made.
    #[must_use]
    pub fn part_folder(&self, kind: CalculationKind, id: i64) -> PathBuf {
        self.files_folder(kind, id).with_extension(PART_SUFFIX)
    }

    fn files_of(&self, kind: CalculationKind) -> PathBuf {
        self.folder().join(format!("{kind}s"))
    }

    /// Makes the files of a calculation durable under their final name; call before the end is committed.
    ///
    /// # Errors
    /// What the disk says.
    pub fn keep_files(&self, kind: CalculationKind, id: i64) -> Result<(), StoreError> {
        let (part, folder) = (self.part_folder(kind, id), self.files_folder(kind, id));
        let error = |e| StoreError::file("the files of a calculation", &folder, e);
        for entry in fs::read_dir(&part).map_err(error)? {
            let path = entry.map_err(error)?.path();
            File::open(path).and_then(|f| f.sync_all()).map_err(error)?;
        }
        File::open(&part)
            .and_then(|f| f.sync_all())
            .map_err(error)?;
        fs::rename(&part, &folder).map_err(error)?;
        File::open(self.files_of(kind))
            .and_then(|f| f.sync_all())
            .map_err(error)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::scans::tests::planned;
    use crate::store::tests::open;

    #[tokio::test]
    async fn a_calculation_is_of_one_kind_and_ends_once() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let (id, event) = store
            .begin_calculation(CalculationKind::Contrast, Some(scan.id), "{}")
            .await
            .unwrap();
        assert_eq!(event.event.scan_id(), Some(scan.id));
        let end = CalculationEnd::Completed("{\"mode\":\"measured\"}".into());
        store.end_calculation(id, &end).await.unwrap();
        assert!(
            store
                .end_calculation(id, &CalculationEnd::Cancelled)
                .await
                .is_err()
        );
        let kept = store
            .calculation(CalculationKind::Contrast, id)
            .await
            .unwrap();
        assert_eq!(kept.state, TaskState::Completed);
        assert!(store.calculation(CalculationKind::Map, id).await.is_err());
        let found = async |kind, state: TaskState| {
            let filter = CalculationFilter {
                state: Some(state),
                ..CalculationFilter::default()
            };
            let page = PageRequest::default();
            store
                .calculations(kind, &filter, page)
                .await
                .unwrap()
                .items
                .len()
        };
        assert_eq!(
            found(CalculationKind::Contrast, TaskState::Completed).await,
            1
        );
        assert_eq!(
            found(CalculationKind::Contrast, TaskState::Running).await,
            0
        );
        assert_eq!(found(CalculationKind::Map, TaskState::Completed).await, 0);
        let of = async |sample_id, since: &str| {
            let filter = CalculationFilter {
                sample_id: Some(sample_id),
                since: Some(since.into()),
                ..CalculationFilter::default()
            };
            let page = PageRequest::default();
            let kind = CalculationKind::Contrast;
            let found = store.calculations(kind, &filter, page).await.unwrap();
            found.items.len()
        };
        assert_eq!(of(scan.sample_id, &kept.created_at).await, 1);
        assert_eq!(of(scan.sample_id + 1, &kept.created_at).await, 0);
        assert_eq!(of(scan.sample_id, "9999-01-01T00:00:00Z").await, 0);
    }

    #[tokio::test]
    async fn a_map_cut_off_is_interrupted_and_leaves_no_half_folder() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let (id, _) = store
            .begin_calculation(CalculationKind::Map, Some(scan.id), "{}")
            .await
            .unwrap();
        let part = store.part_folder(CalculationKind::Map, id);
        fs::create_dir_all(&part).unwrap();
        fs::write(part.join("theta_r.tif"), b"half").unwrap();
        store.close().await;
        drop(store);
        let (store, found) = open(folder.path()).await.unwrap();
        assert_eq!(found.interrupted_calculations, [id]);
        assert!(!part.exists());
        let kept = store.calculation(CalculationKind::Map, id).await.unwrap();
        assert_eq!(kept.state, TaskState::Interrupted);
    }
}
