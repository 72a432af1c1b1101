//! Fits: all inputs when they begin, the report when they end.

use sqlx::FromRow;

use super::{PROGRAM, Page, PageRequest, Store, StoreError};
use crate::scan::event::{ShortValue, TaskState};
use crate::scan::{Event, RecordedEvent};

/// A fit to be begun.
#[derive(Debug, Clone, PartialEq)]
pub struct NewFit {
    /// Scan it is of.
    pub scan_id: i64,
    /// Variant asked for.
    pub variant: String,
    /// Region of the sample.
    pub region: Option<String>,
    /// JSON of all options: starts, seed, bounds.
    pub options: String,
}

/// How a fit ended.
#[derive(Debug, Clone, PartialEq)]
pub enum FitEnd {
    /// There is a report, whatever its status.
    Completed {
        /// Observations it was made of.
        set_id: i64,
        /// JSON as `fit --json` prints it.
        report: String,
        /// Chosen variant.
        variant: String,
        /// converged, at-bound, …
        status: String,
        /// Ridge angle in degrees, where the data can tell it.
        theta_r_deg: Option<ShortValue>,
    },
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

/// A fit as it is kept.
#[derive(Debug, Clone, PartialEq, FromRow)]
pub struct Fit {
    /// Its number.
    pub id: i64,
    /// Scan it is of.
    pub scan_id: i64,
    /// Sample of the scan.
    pub sample_id: i64,
    /// The sample's name.
    pub sample_name: String,
    /// Variant asked for.
    pub variant: String,
    /// Region of the sample.
    pub region: Option<String>,
    /// JSON of all options, and of what was asked for (`request`).
    pub options: String,
    /// Where it stands.
    #[sqlx(try_from = "String")]
    pub state: TaskState,
    /// Observations it was made of.
    pub set_id: Option<i64>,
    /// JSON as `fit --json` prints it.
    pub report: Option<String>,
    /// Why there is none.
    pub error_code: Option<String>,
    /// The same in words.
    pub error_detail: Option<String>,
    /// RFC 3339 UTC.
    pub created_at: String,
    /// RFC 3339 UTC.
    pub ended_at: Option<String>,
}

/// Which fits are wanted.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FitFilter {
    /// Of this sample.
    pub sample_id: Option<i64>,
    /// Of this scan.
    pub scan_id: Option<i64>,
    /// Chosen (or, while running, asked for).
    pub variant: Option<String>,
    /// Status of the report; `cancelled` finds those that a person ended, too, which have none.
    pub status: Option<String>,
    /// Begun at or after, RFC 3339 UTC.
    pub since: Option<String>,
    /// Ridge angle at least.
    pub theta_r_deg_min: Option<f64>,
    /// Ridge angle at most.
    pub theta_r_deg_max: Option<f64>,
}

const SELECT: &str =
    "SELECT f.id, f.scan_id, s.sample_id, p.name AS sample_name, f.variant, f.region, f.options,
       COALESCE(e.state, 'running') AS state, e.set_id, e.report, e.error_code, e.error_detail,
       f.created_at, e.at AS ended_at
     FROM fits f JOIN scans s ON s.id = f.scan_id JOIN samples p ON p.id = s.sample_id
     LEFT JOIN fit_ends e ON e.fit_id = f.id";

impl Store {
    /// Adds a fit that is about to run.
    ///
    /// # Errors
    /// What the database says.
    pub async fn begin_fit(&self, new: &NewFit) -> Result<(i64, RecordedEvent), StoreError> {
        let mut transaction = self.writing().await?;
        let id = sqlx::query(
            "INSERT INTO fits (scan_id, variant, region, options, program, created_at) VALUES (?, ?, ?, ?, ?, ?)",
        )
        .bind(new.scan_id)
        .bind(&new.variant)
        .bind(&new.region)
        .bind(&new.options)
        .bind(PROGRAM)
        .bind(self.wall_text())
        .execute(&mut *transaction)
        .await?
        .last_insert_rowid();
        let event = Event::Fit {
            fit_id: id,
            scan_id: new.scan_id,
            state: TaskState::Running,
            variant: new.variant.clone(),
            status: None,
            theta_r_deg: None,
        };
        let event = self.record_in(&mut transaction, event).await?;
        transaction.commit().await?;
        Ok((id, event))
    }

    /// Adds how a fit ended.
    ///
    /// # Errors
    /// What the database says; a fit ends once.
    pub async fn end_fit(&self, fit_id: i64, end: &FitEnd) -> Result<RecordedEvent, StoreError> {
        match end {
            FitEnd::Completed {
                set_id,
                report,
                variant,
                status,
                theta_r_deg,
            } => {
                let row = EndRow {
                    set_id: Some(*set_id),
                    report: Some(report),
                    variant: Some(variant),
                    status: Some(status),
                    theta_r_deg: *theta_r_deg,
                    ..EndRow::of(TaskState::Completed)
                };
                self.insert_end(fit_id, row).await
            }
            FitEnd::Failed { code, detail } => {
                let row = EndRow {
                    error: Some((code, detail)),
                    ..EndRow::of(TaskState::Failed)
                };
                self.insert_end(fit_id, row).await
            }
            FitEnd::Cancelled => {
                self.insert_end(fit_id, EndRow::of(TaskState::Cancelled))
                    .await
            }
        }
    }

    pub(super) async fn interrupt_fit(&self, fit_id: i64) -> Result<RecordedEvent, StoreError> {
        self.insert_end(fit_id, EndRow::of(TaskState::Interrupted))
            .await
    }

    async fn insert_end(&self, fit_id: i64, row: EndRow<'_>) -> Result<RecordedEvent, StoreError> {
        let mut transaction = self.writing().await?;
        let (scan_id, asked): (i64, String) =
            sqlx::query_as("SELECT scan_id, variant FROM fits WHERE id = ?")
                .bind(fit_id)
                .fetch_optional(&mut *transaction)
                .await?
                .ok_or(StoreError::NotFound {
                    noun: "fit",
                    id: fit_id,
                })?;
        sqlx::query(
            "INSERT INTO fit_ends (fit_id, state, set_id, report, variant, status, theta_r_deg, error_code, error_detail, at)
             VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        )
        .bind(fit_id)
        .bind(row.state.as_str())
        .bind(row.set_id)
        .bind(row.report)
        .bind(row.variant)
        .bind(row.status)
        .bind(row.theta_r_deg.map(|v| v.value))
        .bind(row.error.map(|e| e.0))
        .bind(row.error.map(|e| e.1))
        .bind(self.wall_text())
        .execute(&mut *transaction)
        .await?;
        let event = Event::Fit {
            fit_id,
            scan_id,
            state: row.state,
            variant: row.variant.unwrap_or(&asked).into(),
            status: row.status.map(Into::into),
            theta_r_deg: row.theta_r_deg,
        };
        let event = self.record_in(&mut transaction, event).await?;
        transaction.commit().await?;
        Ok(event)
    }

    pub(super) async fn open_fits(&self) -> Result<Vec<i64>, StoreError> {
        Ok(sqlx::query_scalar(
            "SELECT id FROM fits WHERE id NOT IN (SELECT fit_id FROM fit_ends) ORDER BY id",
        )
        .fetch_all(self.readers())
        .await?)
    }

    /// One fit.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or what the database says.
    pub async fn fit(&self, id: i64) -> Result<Fit, StoreError> {
        sqlx::query_as(sqlx::AssertSqlSafe(format!("{SELECT} WHERE f.id = ?")))
            .bind(id)
            .fetch_optional(self.readers())
            .await?
            .ok_or(StoreError::NotFound { noun: "fit", id })
    }

    /// Fits, newest first.
    ///
    /// # Errors
    /// What the database says.
    pub async fn fits(
        &self,
        filter: &FitFilter,
        page: PageRequest,
    ) -> Result<Page<Fit>, StoreError> {
        let rows: Vec<Fit> = sqlx::query_as(sqlx::AssertSqlSafe(format!(
            "{SELECT} WHERE (?1 IS NULL OR f.id < ?1) AND (?2 IS NULL OR s.sample_id = ?2)
               AND (?3 IS NULL OR f.scan_id = ?3) AND (?4 IS NULL OR COALESCE(e.variant, f.variant) = ?4)
               AND (?5 IS NULL OR e.status = ?5 OR (?5 = 'cancelled' AND e.state = ?5)) AND (?6 IS NULL OR f.created_at >= ?6)
               AND (?7 IS NULL OR e.theta_r_deg >= ?7) AND (?8 IS NULL OR e.theta_r_deg <= ?8)
             ORDER BY f.id DESC LIMIT ?9"
        )))
        .bind(page.cursor)
        .bind(filter.sample_id)
        .bind(filter.scan_id)
        .bind(&filter.variant)
        .bind(&filter.status)
        .bind(&filter.since)
        .bind(filter.theta_r_deg_min)
        .bind(filter.theta_r_deg_max)
        .bind(page.limit + 1)
        .fetch_all(self.readers())
        .await?;
        Ok(Page::cut(rows, page.limit, |fit: &Fit| fit.id))
    }
}

struct EndRow<'a> {
    state: TaskState,
    set_id: Option<i64>,
    report: Option<&'a str>,
    variant: Option<&'a str>,
    status: Option<&'a str>,
    theta_r_deg: Option<ShortValue>,
    error: Option<(&'a str, &'a str)>,
}

impl EndRow<'_> {
    /// One that says nothing but the state.
    fn of(state: TaskState) -> Self {
        EndRow {
            state,
            set_id: None,
            report: None,
            variant: None,
            status: None,
            theta_r_deg: None,
            error: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::scans::tests::planned;
    use crate::store::tests::open;

    async fn begun(store: &Store, scan_id: i64) -> i64 {
        let new = NewFit {
            scan_id,
            variant: "auto".into(),
            region: None,
            options: "{}".into(),
        };
        store.begin_fit(&new).await.unwrap().0
    }

    #[tokio::test]
    async fn a_fit_ends_once_and_is_found_by_its_angle() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let set_id = store.add_empty_set(scan.id).await;
        let id = begun(&store, scan.id).await;
        assert_eq!(store.fit(id).await.unwrap().state, TaskState::Running);
        let end = FitEnd::Completed {
            set_id,
            report: "{}".into(),
            variant: "sawtooth".into(),
            status: "converged".into(),
            theta_r_deg: Some(ShortValue {
                value: 10.0,
                expanded: 0.1,
            }),
        };
        store.end_fit(id, &end).await.unwrap();
        assert!(store.end_fit(id, &FitEnd::Cancelled).await.is_err());
        let found = async |min, max| {
            let filter = FitFilter {
                theta_r_deg_min: Some(min),
                theta_r_deg_max: Some(max),
                variant: Some("sawtooth".into()),
                ..FitFilter::default()
            };
            let page = store.fits(&filter, PageRequest::default()).await.unwrap();
            page.items.len()
        };
        assert_eq!(found(9.0, 11.0).await, 1);
        assert_eq!(found(11.0, 12.0).await, 0);
        let ended = begun(&store, scan.id).await;
        store.end_fit(ended, &FitEnd::Cancelled).await.unwrap();
        let with = async |status: &str| {
            let filter = FitFilter {
                status: Some(status.into()),
                ..FitFilter::default()
            };
            let page = store.fits(&filter, PageRequest::default()).await.unwrap();
            page.items.iter().map(|fit| fit.id).collect::<Vec<_>>()
        };
        assert_eq!(with("cancelled").await, [ended]);
        assert_eq!(with("converged").await, [id]);
    }

    #[tokio::test]
    async fn a_fit_under_way_is_interrupted_by_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let id = begun(&store, scan.id).await;
        store.close().await;
        drop(store);
        let (store, found) = open(folder.path()).await.unwrap();
        assert_eq!(found.interrupted_fits, [id]);
        assert_eq!(store.fit(id).await.unwrap().state, TaskState::Interrupted);
    }
}
