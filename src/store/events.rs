//! Events: numbered when they are committed, sent to listeners afterwards.

use sqlx::FromRow;
use sqlx::sqlite::SqliteConnection;

use super::{Page, PageRequest, Store, StoreError, utc_of, utc_text};
use crate::access::DAEMON;
use crate::scan::{Event, Progress, RecordedEvent};

#[derive(FromRow)]
struct EventRow {
    id: i64,
    at: String,
    body: String,
    who: Option<String>,
}

impl TryFrom<EventRow> for RecordedEvent {
    type Error = StoreError;

    fn try_from(row: EventRow) -> Result<Self, StoreError> {
        Ok(RecordedEvent {
            id: row.id,
            at: utc_of(&row.at).ok_or_else(|| StoreError::bad_row("events", &row.at))?,
            event: serde_json::from_str(&row.body).map_err(|e| StoreError::bad_row("events", e))?,
            who: row.who,
        })
    }
}

impl Store {
    /// Commits one event in a transaction of its own. It is of the caller that started its scan or job, else of the daemon.
    ///
    /// # Errors
    /// A database error.
    pub async fn record(&self, event: Event) -> Result<RecordedEvent, StoreError> {
        let mut transaction = self.writing().await?;
        let recorded = self.record_in(&mut transaction, event).await?;
        transaction.commit().await?;
        Ok(recorded)
    }

    /// Commits one event that `who` caused.
    ///
    /// # Errors
    /// A database error.
    pub async fn record_by(&self, who: &str, event: Event) -> Result<RecordedEvent, StoreError> {
        let mut transaction = self.writing().await?;
        let recorded = self
            .insert(&mut transaction, event, Some(who), None)
            .await?;
        transaction.commit().await?;
        Ok(recorded)
    }

    /// Adds an event to the transaction of the change that it reports.
    pub(super) async fn record_in(
        &self,
        transaction: &mut SqliteConnection,
        event: Event,
    ) -> Result<RecordedEvent, StoreError> {
        self.insert(transaction, event, None, None).await
    }

    /// The same for an event that a scan causes and does not name.
    pub(super) async fn record_of_scan(
        &self,
        transaction: &mut SqliteConnection,
        scan_id: i64,
        event: Event,
    ) -> Result<RecordedEvent, StoreError> {
        self.insert(transaction, event, None, Some(scan_id)).await
    }

    async fn insert(
        &self,
        transaction: &mut SqliteConnection,
        event: Event,
        who: Option<&str>,
        of_scan: Option<i64>,
    ) -> Result<RecordedEvent, StoreError> {
        let at = self.inner.clock.utc();
        let body = serde_json::to_string(&event).map_err(|e| StoreError::bad_row("events", e))?;
        let (job_kind, job_number) = event.job_number().unzip();
        let (id, who) = sqlx::query_as(
            "INSERT INTO events (at, kind, scan_id, body, who) VALUES (?1, ?2, ?3, ?4, COALESCE(?5,
               (SELECT who FROM jobs WHERE kind = ?6 AND number = ?7), (SELECT who FROM scans WHERE id = COALESCE(?3, ?9)), ?8))
             RETURNING id, who",
        )
        .bind(utc_text(at))
        .bind(event.kind())
        .bind(event.scan_id())
        .bind(body)
        .bind(who)
        .bind(job_kind)
        .bind(job_number)
        .bind(DAEMON)
        .bind(of_scan)
        .fetch_one(&mut *transaction)
        .await?;
        Ok(RecordedEvent { id, at, event, who })
    }

    /// Returns events with numbers above `after`, oldest first, at most `limit`.
    ///
    /// # Errors
    /// A database error.
    pub async fn events_after(
        &self,
        after: i64,
        limit: u32,
    ) -> Result<Vec<RecordedEvent>, StoreError> {
        sqlx::query_as::<_, EventRow>(
            "SELECT id, at, body, who FROM events WHERE id > ? ORDER BY id LIMIT ?",
        )
        .bind(after)
        .bind(limit)
        .fetch_all(self.readers())
        .await?
        .into_iter()
        .map(RecordedEvent::try_from)
        .collect()
    }

    /// Returns the progress in a scan's newest event; all zero before the first.
    ///
    /// # Errors
    /// A database error.
    pub async fn last_progress(&self, scan_id: i64) -> Result<Progress, StoreError> {
        let body: Option<String> = sqlx::query_scalar(
            "SELECT body FROM events WHERE scan_id = ? AND kind IN ('scan', 'frame') ORDER BY id DESC LIMIT 1",
        )
        .bind(scan_id)
        .fetch_optional(self.readers())
        .await?;
        let Some(body) = body else {
            return Ok(Progress::default());
        };
        match serde_json::from_str(&body).map_err(|e| StoreError::bad_row("events", e))? {
            Event::Scan { progress, .. } | Event::Frame { progress, .. } => Ok(progress),
            Event::Rig { .. }
            | Event::Fit { .. }
            | Event::Uncertainty { .. }
            | Event::Calculation { .. }
            | Event::Forecast { .. }
            | Event::Recovered { .. }
            | Event::Order { .. }
            | Event::Alarm { .. } => Ok(Progress::default()),
        }
    }

    /// Returns the events of a scan that are of these kinds, oldest first.
    ///
    /// # Errors
    /// A database error.
    pub async fn scan_events(
        &self,
        scan_id: i64,
        kinds: &[&str],
        page: PageRequest,
    ) -> Result<Page<RecordedEvent>, StoreError> {
        let rows = sqlx::query_as::<_, EventRow>(
            "SELECT id, at, body, who FROM events
             WHERE scan_id = ? AND kind IN (SELECT value FROM json_each(?)) AND id > ? ORDER BY id LIMIT ?",
        )
        .bind(scan_id)
        .bind(serde_json::json!(kinds).to_string())
        .bind(page.cursor.unwrap_or(0))
        .bind(page.limit + 1)
        .fetch_all(self.readers())
        .await?;
        Ok(Page::read(rows, page.limit, |row: &EventRow| row.id))
    }

    /// Returns the number of the newest event; 0 if there is none.
    ///
    /// # Errors
    /// A database error.
    pub async fn last_event_id(&self) -> Result<i64, StoreError> {
        Ok(
            sqlx::query_scalar("SELECT COALESCE(MAX(id), 0) FROM events")
                .fetch_one(self.readers())
                .await?,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::JobKind;
    use crate::store::jobs::{JobEnd, NewJob};
    use crate::store::scans::tests::planned;
    use crate::store::tests::open;

    fn alarm(code: &str) -> Event {
        Event::Alarm {
            code: code.into(),
            message: "look".into(),
            scan_id: None,
        }
    }

    #[tokio::test]
    async fn a_listener_that_reconnects_gets_what_it_missed_once() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let first = store.record(alarm("a")).await.unwrap();
        store.record(alarm("b")).await.unwrap();
        store.record(alarm("c")).await.unwrap();
        let missed = store.events_after(first.id, 10).await.unwrap();
        let events: Vec<Event> = missed.into_iter().map(|e| e.event).collect();
        assert_eq!(events, [alarm("b"), alarm("c")]);
    }

    #[tokio::test]
    async fn events_of_a_scan_are_listed_by_kind_and_page() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan_id = planned(&store).await.id;
        for (code, of) in [("a", Some(scan_id)), ("b", None), ("c", Some(scan_id))] {
            let event = Event::Alarm {
                code: code.into(),
                message: "look".into(),
                scan_id: of,
            };
            store.record(event).await.unwrap();
        }
        let listed = async |kinds: &[&str], cursor| {
            let page = PageRequest { limit: 1, cursor };
            store.scan_events(scan_id, kinds, page).await.unwrap()
        };
        let first = listed(&["alarm", "recovered"], None).await;
        assert_eq!(first.next_cursor, Some(first.items[0].id));
        let last = listed(&["alarm"], first.next_cursor).await;
        assert_eq!((last.items.len(), last.next_cursor), (1, None));
        assert!(matches!(&last.items[0].event, Event::Alarm { code, .. } if code == "c"));
        assert_eq!(listed(&["recovered"], None).await.items, []);
    }

    #[tokio::test]
    async fn an_event_is_of_the_caller_that_caused_it_or_started_its_scan_or_job() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let who = async |event| store.record(event).await.unwrap().who.unwrap();
        let of_scan = Event::Alarm {
            code: "a".into(),
            message: "look".into(),
            scan_id: Some(scan.id),
        };
        assert_eq!(who(of_scan).await, scan.who);
        assert_eq!(who(alarm("a")).await, DAEMON);
        let new = NewJob {
            kind: JobKind::Map,
            scan_id: Some(scan.id),
            variant: None,
            request: "{}".into(),
            options: None,
            who: "anna".into(),
        };
        let (id, started) = store.start_job(&new).await.unwrap();
        assert_eq!(started.who.as_deref(), Some("anna"));
        let ended = store.end_job(id, &JobEnd::Cancelled).await.unwrap();
        assert_eq!(ended.who.as_deref(), Some("anna"));
        let by = store.record_by("bert", alarm("b")).await.unwrap();
        assert_eq!(by.who.as_deref(), Some("bert"));
        let read = store.events_after(by.id - 1, 1).await.unwrap();
        assert_eq!(read[0].who, by.who);
    }
}
