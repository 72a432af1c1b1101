//! The queue: orders in sequence, what became of them, and the state of the queue. The state of an order follows from its
//! newest scan, which the store writes together with the number of the order.

use sqlx::FromRow;
use sqlx::sqlite::SqliteConnection;

use super::definitions::DefinitionKind;
use super::{Page, PageRequest, Store, StoreError};
use crate::words::words;

words! {
    /// State of the queue.
    #[derive(utoipa::ToSchema)]
    pub enum QueueState {
        /// No order begins. A person starts the queue.
        Stopped = "stopped",
        /// Orders begin one after the other.
        Running = "running",
        /// The present order is finished, then the queue stops.
        Stopping = "stopping",
        /// No order begins, and the scan of the present one is paused. A person resumes the queue.
        Paused = "paused",
    }
}

words! {
    /// State of an order.
    #[derive(utoipa::ToSchema)]
    pub enum OrderState {
        /// It has its place in the sequence.
        Waiting = "waiting",
        /// Its scan has begun and has not ended.
        Running = "running",
        /// Its scan is completed.
        Done = "done",
        /// Its scan failed or was aborted, or could not start.
        Failed = "failed",
        /// It was removed.
        Removed = "removed",
    }
}

/// The state of the queue since a change.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct QueueNow {
    /// Whether orders begin.
    pub state: QueueState,
    /// Reason for it, if a person did not ask for it.
    pub reason: Option<String>,
    /// Who changed it.
    pub who: String,
    /// When it changed, RFC 3339 UTC; `None` before the first change.
    pub at: Option<String>,
}

/// An order to add.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct NewOrder {
    /// Sample of the part.
    pub sample_id: i64,
    /// Number of the recipe.
    pub recipe_id: i64,
    /// Number of the specification.
    pub specification_id: Option<i64>,
    /// Lot of the part.
    pub lot: Option<String>,
    /// Number of the part or order in another system.
    pub external_id: Option<String>,
    /// The person at the rig.
    pub operator_name: Option<String>,
    /// Free text.
    pub note: Option<String>,
}

/// A stored order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct QueueOrder {
    /// Number, from 1, never reused.
    pub id: i64,
    /// Place in the sequence; smaller begins earlier.
    pub position: i64,
    /// Sample of the part.
    pub sample_id: i64,
    /// The sample's name.
    pub sample_name: String,
    /// Number and name of the recipe.
    pub recipe: (i64, String),
    /// Number and name of the specification.
    pub specification: Option<(i64, String)>,
    /// Lot of the part.
    pub lot: Option<String>,
    /// Number of the part or order in another system.
    pub external_id: Option<String>,
    /// The person at the rig.
    pub operator_name: Option<String>,
    /// Free text.
    pub note: Option<String>,
    /// Waiting, running, or how it ended.
    pub state: OrderState,
    /// Why it failed or waits again.
    pub reason: Option<String>,
    /// Its newest scan.
    pub scan_id: Option<i64>,
    /// How often it failed so far.
    pub failures: i64,
    /// Who added it.
    pub who: String,
    /// When it was added, RFC 3339 UTC.
    pub created_at: String,
}

/// What is done with an order beside its scans.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum OrderChange {
    /// A waiting or failed order is taken out.
    Removed,
    /// It could not start.
    Failed,
    /// A failed order waits again.
    Retried,
}

impl OrderChange {
    const fn as_str(self) -> &'static str {
        match self {
            OrderChange::Removed => "removed",
            OrderChange::Failed => "failed",
            OrderChange::Retried => "retried",
        }
    }

    /// The states of an order that allow it.
    const fn from(self) -> &'static [OrderState] {
        match self {
            OrderChange::Removed => &[OrderState::Waiting, OrderState::Failed],
            OrderChange::Failed => &[OrderState::Waiting],
            OrderChange::Retried => &[OrderState::Failed],
        }
    }
}

#[derive(FromRow)]
struct OrderRow {
    id: i64,
    position: i64,
    sample_id: i64,
    sample_name: String,
    recipe_id: i64,
    recipe_name: String,
    specification_id: Option<i64>,
    specification_name: Option<String>,
    lot: Option<String>,
    external_id: Option<String>,
    operator_name: Option<String>,
    note: Option<String>,
    state: String,
    reason: Option<String>,
    scan_id: Option<i64>,
    failures: i64,
    who: String,
    created_at: String,
}

impl TryFrom<OrderRow> for QueueOrder {
    type Error = StoreError;

    fn try_from(row: OrderRow) -> Result<QueueOrder, StoreError> {
        let state = OrderState::from_word(&row.state);
        Ok(QueueOrder {
            id: row.id,
            position: row.position,
            sample_id: row.sample_id,
            sample_name: row.sample_name,
            recipe: (row.recipe_id, row.recipe_name),
            specification: row.specification_id.zip(row.specification_name),
            lot: row.lot,
            external_id: row.external_id,
            operator_name: row.operator_name,
            note: row.note,
            state: state.ok_or_else(|| StoreError::bad_row("queue_orders", &row.state))?,
            reason: row.reason,
            scan_id: row.scan_id,
            failures: row.failures,
            who: row.who,
            created_at: row.created_at,
        })
    }
}

/// Orders with their states. A scan counts from its row on, so a restart finds each order that has begun.
const SELECT: &str = "SELECT * FROM (
    SELECT o.id, o.position, o.sample_id, p.name AS sample_name, r.number AS recipe_id, r.name AS recipe_name,
      f.number AS specification_id, f.name AS specification_name, o.lot, o.external_id, o.operator_name, o.note,
      CASE WHEN c.change IN ('removed', 'failed') THEN c.change
        WHEN s.id IS NULL OR (c.change = 'retried' AND c.scan_id = s.id) THEN 'waiting'
        WHEN t.state = 'completed' THEN 'done'
        WHEN t.state IN ('aborted', 'failed') THEN 'failed'
        ELSE 'running' END AS state,
      CASE WHEN s.id IS NULL OR c.scan_id = s.id THEN COALESCE(c.reason, t.reason) ELSE t.reason END AS reason,
      s.id AS scan_id,
      (SELECT COUNT(*) FROM queue_changes g WHERE g.order_id = o.id AND g.change = 'failed')
        + (SELECT COUNT(*) FROM scans b WHERE b.order_id = o.id AND (SELECT u.state FROM scan_states u WHERE u.scan_id = b.id
             ORDER BY u.id DESC LIMIT 1) IN ('aborted', 'failed')) AS failures,
      o.who, o.created_at
    FROM queue_orders o
    JOIN sample_now p ON p.sample_id = o.sample_id
    JOIN definitions r ON r.id = o.recipe_id
    LEFT JOIN definitions f ON f.id = o.specification_id
    LEFT JOIN queue_changes c ON c.id = (SELECT MAX(id) FROM queue_changes WHERE order_id = o.id)
    LEFT JOIN scans s ON s.id = (SELECT MAX(id) FROM scans WHERE order_id = o.id)
    LEFT JOIN scan_states t ON t.id = (SELECT MAX(id) FROM scan_states WHERE scan_id = s.id))";

impl Store {
    /// Returns the state of the queue.
    ///
    /// # Errors
    /// A database error.
    pub async fn queue(&self) -> Result<QueueNow, StoreError> {
        let row: Option<(String, Option<String>, String, String)> = sqlx::query_as(
            "SELECT state, reason, who, at FROM queue_states ORDER BY id DESC LIMIT 1",
        )
        .fetch_optional(self.readers())
        .await?;
        let Some((state, reason, who, at)) = row else {
            return Ok(QueueNow {
                state: QueueState::Stopped,
                reason: None,
                who: String::new(),
                at: None,
            });
        };
        let state = QueueState::from_word(&state)
            .ok_or_else(|| StoreError::bad_row("queue_states", &state))?;
        Ok(QueueNow {
            state,
            reason,
            who,
            at: Some(at),
        })
    }

    /// Changes the state of the queue.
    ///
    /// # Errors
    /// A database error.
    pub async fn set_queue(
        &self,
        state: QueueState,
        reason: Option<&str>,
        who: &str,
    ) -> Result<(), StoreError> {
        let mut transaction = self.writing().await?;
        sqlx::query("INSERT INTO queue_states (state, reason, who, at) VALUES (?, ?, ?, ?)")
            .bind(state.as_str())
            .bind(reason)
            .bind(who)
            .bind(self.now_text())
            .execute(&mut *transaction)
            .await?;
        transaction.commit().await?;
        Ok(())
    }

    /// Adds orders at the end of the sequence: all of them or none.
    ///
    /// # Errors
    /// [`StoreError::ExternalIdTaken`] with the place of the order in the list, or a database error.
    pub async fn add_orders(
        &self,
        new: &[NewOrder],
        who: &str,
    ) -> Result<Vec<QueueOrder>, StoreError> {
        let mut transaction = self.writing().await?;
        let last: Option<i64> = sqlx::query_scalar("SELECT MAX(position) FROM queue_orders")
            .fetch_one(&mut *transaction)
            .await?;
        let mut ids = Vec::with_capacity(new.len());
        for (place, order) in new.iter().enumerate() {
            if let Some(external_id) = &order.external_id {
                self.free_external_id(&mut transaction, external_id, place)
                    .await?;
            }
            let position = last.unwrap_or(0) + place as i64 + 1;
            let id = sqlx::query(
                "INSERT INTO queue_orders (position, sample_id, recipe_id, specification_id, lot, external_id, operator_name,
                   note, who, created_at)
                 VALUES (?, ?, (SELECT id FROM definitions WHERE kind = ? AND number = ?),
                   (SELECT id FROM definitions WHERE kind = ? AND number = ?), ?, ?, ?, ?, ?, ?)",
            )
            .bind(position)
            .bind(order.sample_id)
            .bind(DefinitionKind::Recipe.as_str())
            .bind(order.recipe_id)
            .bind(DefinitionKind::Specification.as_str())
            .bind(order.specification_id)
            .bind(&order.lot)
            .bind(&order.external_id)
            .bind(&order.operator_name)
            .bind(&order.note)
            .bind(who)
            .bind(self.now_text())
            .execute(&mut *transaction)
            .await?
            .last_insert_rowid();
            ids.push(id);
        }
        transaction.commit().await?;
        let mut added = Vec::with_capacity(ids.len());
        for id in ids {
            added.push(self.queue_order(id).await?);
        }
        Ok(added)
    }

    /// Refuses an external id that another order has.
    ///
    /// # Errors
    /// [`StoreError::ExternalIdTaken`], or a database error.
    pub async fn check_external_id(
        &self,
        external_id: &str,
        place: usize,
    ) -> Result<(), StoreError> {
        let mut reader = self.readers().acquire().await?;
        self.free_external_id(&mut reader, external_id, place).await
    }

    /// Returns the number of orders by state.
    ///
    /// # Errors
    /// A database error.
    pub async fn order_counts(&self) -> Result<Vec<(OrderState, i64)>, StoreError> {
        let sql = format!("SELECT state, COUNT(*) FROM ({SELECT}) GROUP BY state");
        let rows: Vec<(String, i64)> = sqlx::query_as(sqlx::AssertSqlSafe(sql))
            .fetch_all(self.readers())
            .await?;
        let counts = rows.into_iter().map(|(word, n)| {
            let state = OrderState::from_word(&word);
            Ok((
                state.ok_or_else(|| StoreError::bad_row("queue_orders", &word))?,
                n,
            ))
        });
        counts.collect()
    }

    async fn free_external_id(
        &self,
        transaction: &mut SqliteConnection,
        external_id: &str,
        place: usize,
    ) -> Result<(), StoreError> {
        let taken: Option<OrderRow> = sqlx::query_as(sqlx::AssertSqlSafe(format!(
            "{SELECT} WHERE external_id = ? AND state <> 'removed' LIMIT 1"
        )))
        .bind(external_id)
        .fetch_optional(transaction)
        .await?;
        match taken {
            None => Ok(()),
            Some(row) => Err(StoreError::ExternalIdTaken {
                place,
                external_id: external_id.to_owned(),
                order_id: row.id,
                part: row.sample_name,
                state: row.state,
            }),
        }
    }

    /// Returns one order.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn queue_order(&self, id: i64) -> Result<QueueOrder, StoreError> {
        let sql = format!("{SELECT} WHERE id = ?");
        sqlx::query_as::<_, OrderRow>(sqlx::AssertSqlSafe(sql))
            .bind(id)
            .fetch_optional(self.readers())
            .await?
            .ok_or(StoreError::NotFound { noun: "order", id })?
            .try_into()
    }

    /// Returns orders in sequence, from the position after `page.cursor` on.
    ///
    /// # Errors
    /// A database error; a row that cannot be read is listed beside the others.
    pub async fn queue_orders(
        &self,
        states: &[OrderState],
        page: PageRequest,
    ) -> Result<Page<QueueOrder>, StoreError> {
        let words: Vec<&str> = states.iter().map(|state| state.as_str()).collect();
        let sql = format!(
            "{SELECT} WHERE (?1 = '' OR instr(?1, ',' || state || ',') > 0) AND (?2 IS NULL OR position > ?2)
             ORDER BY position LIMIT ?3"
        );
        let of_states = match words.is_empty() {
            true => String::new(),
            false => format!(",{},", words.join(",")),
        };
        let rows = sqlx::query_as::<_, OrderRow>(sqlx::AssertSqlSafe(sql))
            .bind(of_states)
            .bind(page.cursor)
            .bind(page.limit + 1)
            .fetch_all(self.readers())
            .await?;
        Ok(Page::read(rows, page.limit, |row: &OrderRow| row.position))
    }

    /// Changes an order beside its scans.
    ///
    /// # Errors
    /// [`StoreError::OrderConflict`] if its state does not allow it, [`StoreError::NotFound`], or a database error.
    pub async fn change_order(
        &self,
        id: i64,
        change: OrderChange,
        reason: Option<&str>,
        who: &str,
    ) -> Result<QueueOrder, StoreError> {
        let mut transaction = self.writing().await?;
        let order = self.order_in(&mut transaction, id).await?;
        if !change.from().contains(&order.state) {
            return Err(StoreError::OrderConflict {
                order_id: id,
                state: order.state.as_str(),
                scan_id: order.scan_id,
            });
        }
        sqlx::query(
            "INSERT INTO queue_changes (order_id, change, scan_id, reason, who, at) VALUES (?, ?, ?, ?, ?, ?)",
        )
        .bind(id)
        .bind(change.as_str())
        .bind(order.scan_id)
        .bind(reason)
        .bind(who)
        .bind(self.now_text())
        .execute(&mut *transaction)
        .await?;
        transaction.commit().await?;
        self.queue_order(id).await
    }

    async fn order_in(
        &self,
        transaction: &mut SqliteConnection,
        id: i64,
    ) -> Result<QueueOrder, StoreError> {
        let sql = format!("{SELECT} WHERE id = ?");
        sqlx::query_as::<_, OrderRow>(sqlx::AssertSqlSafe(sql))
            .bind(id)
            .fetch_optional(transaction)
            .await?
            .ok_or(StoreError::NotFound { noun: "order", id })?
            .try_into()
    }

    /// Moves a waiting order to a place among the waiting ones, from 1; beyond the last one, to the end.
    ///
    /// # Errors
    /// [`StoreError::OrderConflict`] if it does not wait, [`StoreError::NotFound`], or a database error.
    pub async fn place_order(&self, id: i64, to: usize) -> Result<QueueOrder, StoreError> {
        let mut transaction = self.writing().await?;
        let order = self.order_in(&mut transaction, id).await?;
        if order.state != OrderState::Waiting {
            return Err(StoreError::OrderConflict {
                order_id: id,
                state: order.state.as_str(),
                scan_id: order.scan_id,
            });
        }
        let mut waiting: Vec<(i64, i64)> = sqlx::query_as(sqlx::AssertSqlSafe(format!(
            "SELECT id, position FROM ({SELECT}) WHERE state = 'waiting' AND id <> ? ORDER BY position"
        )))
        .bind(id)
        .fetch_all(&mut *transaction)
        .await?;
        let place = to.saturating_sub(1).min(waiting.len());
        waiting.insert(place, (id, order.position));
        // New positions at the end of all orders: in sequence, and none is used twice on the way.
        let last: i64 = sqlx::query_scalar("SELECT MAX(position) FROM queue_orders")
            .fetch_one(&mut *transaction)
            .await?;
        for (n, (id, _)) in waiting.iter().enumerate() {
            sqlx::query("UPDATE queue_orders SET position = ? WHERE id = ?")
                .bind(last + n as i64 + 1)
                .bind(id)
                .execute(&mut *transaction)
                .await?;
        }
        transaction.commit().await?;
        self.queue_order(id).await
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::{Progress, ScanState};
    use crate::store::samples::tests::polymer;
    use crate::store::scans::{NewScan, ScanPurpose};
    use crate::store::tests::open;

    /// Adds a recipe and three orders, the first of them with an external id.
    async fn three(store: &Store) -> Vec<QueueOrder> {
        let (kind, content) = (DefinitionKind::Recipe, serde_json::json!({}));
        let recipe = store.add_definition(kind, "PX", &content, "anna").await;
        let recipe_id = recipe.unwrap().id;
        let sample_id = polymer(store).await.id;
        let order = |external_id: Option<&str>| NewOrder {
            sample_id,
            recipe_id,
            specification_id: None,
            lot: None,
            external_id: external_id.map(str::to_owned),
            operator_name: None,
            note: None,
        };
        let new = [order(Some("A-1")), order(None), order(None)];
        store.add_orders(&new, "anna").await.unwrap()
    }

    /// Adds a scan of an order, and moves it through states.
    async fn scanned(store: &Store, order: &QueueOrder, states: &[ScanState]) {
        let new = NewScan {
            sample_id: order.sample_id,
            rig_id: Some(store.rig("{}").await.unwrap()),
            name: "scan".into(),
            plan: None,
            manifest: String::new(),
            frames_csv: None,
            calibration_ids: vec![],
            purpose: ScanPurpose {
                order_id: Some(order.id),
                ..ScanPurpose::default()
            },
            who: "anna".into(),
        };
        let (scan, _) = store.add_scan(&new).await.unwrap();
        for state in states {
            let progress = Progress::default();
            let changed = store.change_state(scan.id, *state, Some("why"), None, progress);
            changed.await.unwrap();
        }
    }

    async fn sequence(store: &Store, state: OrderState) -> Vec<i64> {
        let found = store.queue_orders(&[state], PageRequest::default()).await;
        found.unwrap().items.iter().map(|o| o.id).collect()
    }

    #[tokio::test]
    async fn the_state_of_an_order_follows_from_its_scan() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let orders = three(&store).await;
        let state = async |n: usize| store.queue_order(orders[n].id).await.unwrap().state;
        assert_eq!(state(0).await, OrderState::Waiting);
        scanned(&store, &orders[0], &[ScanState::Running]).await;
        assert_eq!(state(0).await, OrderState::Running);
        let removed = store
            .change_order(1, OrderChange::Removed, None, "anna")
            .await;
        assert!(matches!(
            removed,
            Err(StoreError::OrderConflict {
                scan_id: Some(1),
                ..
            })
        ));
        scanned(
            &store,
            &orders[1],
            &[ScanState::Running, ScanState::Completed],
        )
        .await;
        assert_eq!(state(1).await, OrderState::Done);
        scanned(&store, &orders[2], &[ScanState::Failed]).await;
        let failed = store.queue_order(3).await.unwrap();
        assert_eq!((failed.state, failed.failures), (OrderState::Failed, 1));
        assert_eq!(failed.reason.as_deref(), Some("why"));
        let again = store
            .change_order(3, OrderChange::Retried, None, "anna")
            .await;
        assert_eq!(again.unwrap().state, OrderState::Waiting);
        // A new scan counts, not the earlier failure.
        scanned(
            &store,
            &orders[2],
            &[ScanState::Running, ScanState::Completed],
        )
        .await;
        assert_eq!(state(2).await, OrderState::Done);
    }

    #[tokio::test]
    async fn orders_are_moved_among_those_that_wait_and_an_external_id_is_unique() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let orders = three(&store).await;
        store.place_order(3, 1).await.unwrap();
        assert_eq!(sequence(&store, OrderState::Waiting).await, [3, 1, 2]);
        store.place_order(3, 99).await.unwrap();
        assert_eq!(sequence(&store, OrderState::Waiting).await, [1, 2, 3]);
        let taken = store.check_external_id("A-1", 4).await.unwrap_err();
        let says = taken.to_string();
        assert!(
            says.contains("orders[4].external_id: `A-1` is the external id of order 1"),
            "{says}"
        );
        store
            .change_order(1, OrderChange::Removed, None, "anna")
            .await
            .unwrap();
        store.check_external_id("A-1", 0).await.unwrap();
        assert_eq!(sequence(&store, OrderState::Removed).await, [orders[0].id]);
        assert_eq!(store.queue().await.unwrap().state, QueueState::Stopped);
        store
            .set_queue(QueueState::Running, None, "anna")
            .await
            .unwrap();
        assert_eq!(store.queue().await.unwrap().state, QueueState::Running);
    }
}
