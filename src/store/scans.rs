//! Scans, their states and the rigs they were made with.

use sqlx::FromRow;
use sqlx::sqlite::SqliteConnection;

use super::definitions::{DefinitionRef, reference, referenced};
use super::earlier::{EARLIER_SAMPLES, EarlierSample};
use super::records::{ScanRecord, record_of, tag_in_list};
use super::{Page, PageRequest, Store, StoreError};
use crate::scan::{Event, OperatorAction, Plan, Progress, RecordedEvent, ScanState};
use crate::version::BUILD;

/// Where a scan comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = ScanOrigin)]
pub enum Origin {
    /// The rig of this daemon.
    Rig,
    /// An imported series.
    Import,
}

impl Origin {
    /// The word used in requests and the database.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Origin::Rig => "rig",
            Origin::Import => "import",
        }
    }
}

/// What a scan is made for; `None` where it is not stated.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ScanPurpose {
    /// Row of the recipe's version.
    pub recipe_version_id: Option<i64>,
    /// Row of the specification's version.
    pub specification_version_id: Option<i64>,
    /// The person at the rig.
    pub operator_name: Option<String>,
    /// Lot of the part.
    pub lot: Option<String>,
    /// Number of the part or order in another system.
    pub external_id: Option<String>,
    /// The order of the queue that it measures.
    pub order_id: Option<i64>,
}

/// A scan to add.
#[derive(Debug, Clone, PartialEq)]
pub struct NewScan {
    /// Row of the part that is measured.
    pub sample_id: i64,
    /// Row of the rig; `None` for an import.
    pub rig_id: Option<i64>,
    /// Name of the series in an export.
    pub name: String,
    /// The whole plan; `None` for an import.
    pub plan: Option<Plan>,
    /// `manifest.toml` as a reduction reads it.
    pub manifest: String,
    /// An import's `frames.csv`, byte for byte.
    pub frames_csv: Option<String>,
    /// Rows of the calibrations of other scans that this one uses.
    pub calibration_ids: Vec<i64>,
    /// What it is made for.
    pub purpose: ScanPurpose,
    /// Who started it: the name of a token, `local` or `daemon`.
    pub who: String,
}

/// A stored scan with its latest state.
#[derive(Debug, Clone, PartialEq)]
pub struct Scan {
    /// Number, from 1, never reused.
    pub id: i64,
    /// Row of the part that was measured.
    pub sample_id: i64,
    /// The sample's name.
    pub sample_name: String,
    /// Row of the rig; `None` for an import.
    pub rig_id: Option<i64>,
    /// Rig or import.
    pub origin: Origin,
    /// Name of the series in an export.
    pub name: String,
    /// The plan; `None` for an import.
    pub plan: Option<Plan>,
    /// State after its newest event.
    pub state: ScanState,
    /// Reason for this state, unless it is the plan's own course.
    pub reason: Option<String>,
    /// Step that the operator has to do.
    pub operator: Option<OperatorAction>,
    /// The version of the recipe that it was started with.
    pub recipe: Option<DefinitionRef>,
    /// The version of the specification that it is judged against.
    pub specification: Option<DefinitionRef>,
    /// The person at the rig.
    pub operator_name: Option<String>,
    /// Lot of the part.
    pub lot: Option<String>,
    /// Number of the part or order in another system.
    pub external_id: Option<String>,
    /// The order of the queue that it measures.
    pub order_id: Option<i64>,
    /// Who started it: the name of a token, `local` or `daemon`.
    pub who: String,
    /// When it was added, RFC 3339 UTC.
    pub created_at: String,
    /// Time of its first action, RFC 3339 UTC.
    pub started_at: Option<String>,
    /// Time of its present state, RFC 3339 UTC.
    pub state_at: String,
    /// Samples that it was assigned to, oldest first.
    pub earlier_samples: Vec<EarlierSample>,
    /// Tags, note and archived flag.
    pub record: ScanRecord,
}

impl Scan {
    /// Time of its end, if it has ended.
    #[must_use]
    pub fn ended_at(&self) -> Option<&str> {
        self.state.is_end().then_some(self.state_at.as_str())
    }
}

/// Selects scans.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ScanFilter {
    /// Only scans of this part.
    pub sample_id: Option<i64>,
    /// Only scans in this state now.
    pub state: Option<ScanState>,
    /// Only scans with this tag.
    pub tag: Option<String>,
    /// Only archived scans, or only those that are not.
    pub archived: Option<bool>,
}

#[derive(FromRow)]
struct ScanRow {
    id: i64,
    sample_id: i64,
    sample_name: String,
    rig_id: Option<i64>,
    origin: String,
    name: String,
    plan: Option<String>,
    state: String,
    reason: Option<String>,
    operator: Option<String>,
    recipe: Option<String>,
    specification: Option<String>,
    operator_name: Option<String>,
    lot: Option<String>,
    external_id: Option<String>,
    order_id: Option<i64>,
    who: String,
    created_at: String,
    started_at: Option<String>,
    state_at: String,
    earlier_samples: String,
    tags: Option<String>,
    note: Option<String>,
    archived: bool,
}

impl TryFrom<ScanRow> for Scan {
    type Error = StoreError;

    fn try_from(row: ScanRow) -> Result<Scan, StoreError> {
        Ok(Scan {
            id: row.id,
            sample_id: row.sample_id,
            sample_name: row.sample_name,
            rig_id: row.rig_id,
            origin: match row.origin.as_str() {
                "import" => Origin::Import,
                _ => Origin::Rig,
            },
            name: row.name,
            plan: row
                .plan
                .as_deref()
                .map(serde_json::from_str)
                .transpose()
                .map_err(|e| StoreError::bad_row("scans", e))?,
            state: state_of(&row.state)?,
            reason: row.reason,
            operator: row.operator.as_deref().and_then(OperatorAction::from_word),
            recipe: referenced(row.recipe.as_deref(), "scans")?,
            specification: referenced(row.specification.as_deref(), "scans")?,
            operator_name: row.operator_name,
            lot: row.lot,
            external_id: row.external_id,
            order_id: row.order_id,
            who: row.who,
            created_at: row.created_at,
            started_at: row.started_at,
            state_at: row.state_at,
            earlier_samples: serde_json::from_str(&row.earlier_samples)
                .map_err(|e| StoreError::bad_row("scan_samples", e))?,
            record: record_of(row.tags.as_deref(), row.note, row.archived)?,
        })
    }
}

fn state_of(word: &str) -> Result<ScanState, StoreError> {
    ScanState::from_word(word)
        .ok_or_else(|| StoreError::bad_row("scan_states", format!("`{word}` is not a state")))
}

fn select() -> String {
    let recipe = reference("s.recipe_version_id");
    let specification = reference("s.specification_version_id");
    format!(
        "SELECT s.id, w.sample_id, p.name AS sample_name, s.rig_id, s.origin, s.name, s.plan,
           t.state, t.reason, t.operator, s.who, s.created_at, t.at AS state_at,
           (SELECT MIN(at) FROM scan_states WHERE scan_id = s.id AND state <> 'planned') AS started_at,
           {EARLIER_SAMPLES} AS earlier_samples,
           {recipe} AS recipe, {specification} AS specification, s.operator_name, s.lot, s.external_id, s.order_id,
           k.tags, k.note, COALESCE(k.archived, 0) AS archived
         FROM scans s
         JOIN scan_now w ON w.scan_id = s.id
         JOIN sample_now p ON p.sample_id = w.sample_id
         JOIN scan_states t ON t.id = (SELECT MAX(id) FROM scan_states WHERE scan_id = s.id)
         LEFT JOIN scan_records k ON k.id = (SELECT MAX(id) FROM scan_records WHERE scan_id = s.id)"
    )
}

impl Store {
    /// Returns the number of the rig with these settings (canonical JSON); adds a row for new settings.
    ///
    /// # Errors
    /// A database error.
    pub async fn rig(&self, settings: &str) -> Result<i64, StoreError> {
        let mut transaction = self.writing().await?;
        sqlx::query("INSERT OR IGNORE INTO rigs (settings, created_at) VALUES (?, ?)")
            .bind(settings)
            .bind(self.now_text())
            .execute(&mut *transaction)
            .await?;
        let id = sqlx::query_scalar("SELECT id FROM rigs WHERE settings = ?")
            .bind(settings)
            .fetch_one(&mut *transaction)
            .await?;
        transaction.commit().await?;
        Ok(id)
    }

    /// Returns the settings of a rig as they were passed to [`Store::rig`].
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn rig_settings(&self, id: i64) -> Result<String, StoreError> {
        sqlx::query_scalar("SELECT settings FROM rigs WHERE id = ?")
            .bind(id)
            .fetch_optional(self.readers())
            .await?
            .ok_or(StoreError::NotFound { noun: "rig", id })
    }

    /// Returns the program that ran a scan or imported it, with its commit where it is known.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn program_of_scan(&self, id: i64) -> Result<String, StoreError> {
        sqlx::query_scalar("SELECT program FROM scans WHERE id = ?")
            .bind(id)
            .fetch_optional(self.readers())
            .await?
            .ok_or(StoreError::NotFound { noun: "scan", id })
    }

    /// Adds a scan in state planned.
    ///
    /// # Errors
    /// A database error.
    pub async fn add_scan(&self, new: &NewScan) -> Result<(Scan, RecordedEvent), StoreError> {
        let mut transaction = self.writing().await?;
        let id = self
            .insert_scan(&mut transaction, new, Origin::Rig, ScanState::Planned)
            .await?;
        let event = self
            .record_in(
                &mut transaction,
                Event::Scan {
                    scan_id: id,
                    previous: ScanState::Planned,
                    state: ScanState::Planned,
                    reason: None,
                    operator: None,
                    progress: Progress::default(),
                },
            )
            .await?;
        transaction.commit().await?;
        Ok((self.scan(id).await?, event))
    }

    pub(super) async fn insert_scan(
        &self,
        transaction: &mut SqliteConnection,
        new: &NewScan,
        origin: Origin,
        state: ScanState,
    ) -> Result<i64, StoreError> {
        let plan = new
            .plan
            .as_ref()
            .map(serde_json::to_string)
            .transpose()
            .map_err(|e| StoreError::bad_row("scans", e))?;
        let id = sqlx::query(
            "INSERT INTO scans (sample_id, rig_id, origin, name, plan, manifest, frames_csv, program, created_at, who,
               recipe_version_id, specification_version_id, operator_name, lot, external_id, order_id)
             VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        )
        .bind(new.sample_id)
        .bind(new.rig_id)
        .bind(origin.as_str())
        .bind(&new.name)
        .bind(plan)
        .bind(&new.manifest)
        .bind(&new.frames_csv)
        .bind(BUILD)
        .bind(self.now_text())
        .bind(&new.who)
        .bind(new.purpose.recipe_version_id)
        .bind(new.purpose.specification_version_id)
        .bind(&new.purpose.operator_name)
        .bind(&new.purpose.lot)
        .bind(&new.purpose.external_id)
        .bind(new.purpose.order_id)
        .execute(&mut *transaction)
        .await?
        .last_insert_rowid();
        self.insert_state(transaction, id, state, None, None)
            .await?;
        for calibration in &new.calibration_ids {
            sqlx::query("INSERT INTO scan_calibrations (scan_id, calibration_id) VALUES (?, ?)")
                .bind(id)
                .bind(calibration)
                .execute(&mut *transaction)
                .await?;
        }
        Ok(id)
    }

    async fn insert_state(
        &self,
        transaction: &mut SqliteConnection,
        scan_id: i64,
        state: ScanState,
        reason: Option<&str>,
        operator: Option<OperatorAction>,
    ) -> Result<(), StoreError> {
        sqlx::query(
            "INSERT INTO scan_states (scan_id, state, reason, operator, at) VALUES (?, ?, ?, ?, ?)",
        )
        .bind(scan_id)
        .bind(state.as_str())
        .bind(reason)
        .bind(operator.map(OperatorAction::as_str))
        .bind(self.now_text())
        .execute(&mut *transaction)
        .await?;
        Ok(())
    }

    /// Moves a scan to its next state, if the state table permits it.
    ///
    /// # Errors
    /// [`StoreError::StateConflict`], [`StoreError::NotFound`], or a database error.
    pub async fn change_state(
        &self,
        scan_id: i64,
        next: ScanState,
        reason: Option<&str>,
        operator: Option<OperatorAction>,
        progress: Progress,
    ) -> Result<RecordedEvent, StoreError> {
        let mut transaction = self.writing().await?;
        let current: String = sqlx::query_scalar(
            "SELECT state FROM scan_states WHERE scan_id = ? ORDER BY id DESC LIMIT 1",
        )
        .bind(scan_id)
        .fetch_optional(&mut *transaction)
        .await?
        .ok_or(StoreError::NotFound {
            noun: "scan",
            id: scan_id,
        })?;
        let previous = state_of(&current)?;
        if !previous.may_become(next) {
            return Err(StoreError::StateConflict {
                scan_id,
                current: previous,
                asked: next,
            });
        }
        self.insert_state(&mut transaction, scan_id, next, reason, operator)
            .await?;
        let event = self
            .record_in(
                &mut transaction,
                Event::Scan {
                    scan_id,
                    previous,
                    state: next,
                    reason: reason.map(Into::into),
                    operator,
                    progress,
                },
            )
            .await?;
        transaction.commit().await?;
        Ok(event)
    }

    /// Returns one scan.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn scan(&self, id: i64) -> Result<Scan, StoreError> {
        let select = select();
        sqlx::query_as::<_, ScanRow>(sqlx::AssertSqlSafe(format!("{select} WHERE s.id = ?")))
            .bind(id)
            .fetch_optional(self.readers())
            .await?
            .ok_or(StoreError::NotFound { noun: "scan", id })?
            .try_into()
    }

    /// Returns scans, newest first.
    ///
    /// # Errors
    /// A database error; a row that cannot be read is listed beside the others.
    pub async fn scans(
        &self,
        filter: ScanFilter,
        page: PageRequest,
    ) -> Result<Page<Scan>, StoreError> {
        let select = select();
        let rows = sqlx::query_as::<_, ScanRow>(sqlx::AssertSqlSafe(format!(
            "{select} WHERE (?1 IS NULL OR s.id < ?1) AND (?2 IS NULL OR w.sample_id = ?2)
               AND (?3 IS NULL OR t.state = ?3) AND (?4 IS NULL OR instr(k.tags, ?4))
               AND (?5 IS NULL OR COALESCE(k.archived, 0) = ?5) ORDER BY s.id DESC LIMIT ?6"
        )))
        .bind(page.cursor)
        .bind(filter.sample_id)
        .bind(filter.state.map(ScanState::as_str))
        .bind(filter.tag.as_deref().map(tag_in_list))
        .bind(filter.archived)
        .bind(page.limit + 1)
        .fetch_all(self.readers())
        .await?;
        Ok(Page::read(rows, page.limit, |row: &ScanRow| row.id))
    }

    /// Returns the sample of the newest scan that a rig made of one; none before the first.
    ///
    /// # Errors
    /// A database error.
    pub async fn last_scanned_sample(&self) -> Result<Option<i64>, StoreError> {
        Ok(sqlx::query_scalar(
            "SELECT w.sample_id FROM scans s JOIN scan_now w ON w.scan_id = s.id
             WHERE s.origin = 'rig' AND json_extract(s.plan, '$.repeats') > 0 ORDER BY s.id DESC LIMIT 1",
        )
        .fetch_optional(self.readers())
        .await?)
    }

    /// Returns the `manifest.toml` of a scan, as a reduction reads it.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn manifest(&self, scan_id: i64) -> Result<String, StoreError> {
        sqlx::query_scalar("SELECT manifest FROM scan_now WHERE scan_id = ?")
            .bind(scan_id)
            .fetch_optional(self.readers())
            .await?
            .ok_or(StoreError::NotFound {
                noun: "scan",
                id: scan_id,
            })
    }

    /// Returns the `frames.csv` of an imported series, byte for byte; `None` for a scan of a rig.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn frames_csv(&self, scan_id: i64) -> Result<Option<String>, StoreError> {
        sqlx::query_scalar("SELECT frames_csv FROM scans WHERE id = ?")
            .bind(scan_id)
            .fetch_optional(self.readers())
            .await?
            .ok_or(StoreError::NotFound {
                noun: "scan",
                id: scan_id,
            })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::store::samples::tests::polymer;
    use crate::store::tests::open;

    pub(crate) async fn planned(store: &Store) -> Scan {
        let sample_id = polymer(store).await.id;
        let new = NewScan {
            sample_id,
            rig_id: Some(store.rig("{}").await.unwrap()),
            name: "scan".into(),
            plan: None,
            manifest: "schema = \"gonio-series-1\"".into(),
            frames_csv: None,
            calibration_ids: vec![],
            purpose: ScanPurpose::default(),
            who: "anna".into(),
        };
        store.add_scan(&new).await.unwrap().0
    }

    #[tokio::test]
    async fn a_forbidden_state_is_refused_without_an_event() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let last = store.last_event_id().await.unwrap();
        let refused = store
            .change_state(
                scan.id,
                ScanState::Completed,
                None,
                None,
                Progress::default(),
            )
            .await;
        assert!(matches!(refused, Err(StoreError::StateConflict { .. })));
        assert_eq!(store.last_event_id().await.unwrap(), last);
        assert_eq!(store.scan(scan.id).await.unwrap().state, ScanState::Planned);
    }

    #[tokio::test]
    async fn the_latest_state_counts_and_the_filter_finds_it() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        planned(&store).await;
        store
            .change_state(
                scan.id,
                ScanState::WaitingForOperator,
                None,
                Some(OperatorAction::CapLens),
                Progress::default(),
            )
            .await
            .unwrap();
        let waiting = ScanFilter {
            state: Some(ScanState::WaitingForOperator),
            ..ScanFilter::default()
        };
        let found = store.scans(waiting, PageRequest::default()).await.unwrap();
        assert_eq!(found.items.len(), 1);
        assert_eq!(found.items[0].operator, Some(OperatorAction::CapLens));
        assert!(found.items[0].started_at.is_some());
    }

    #[tokio::test]
    async fn the_same_rig_is_one_row_and_a_changed_rig_another() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let first = store.rig("{\"a\":1}").await.unwrap();
        assert_eq!(store.rig("{\"a\":1}").await.unwrap(), first);
        assert_ne!(store.rig("{\"a\":2}").await.unwrap(), first);
    }
}
