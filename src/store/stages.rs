//! Which controllers a rig and its scans have, as JSON that the lab writes and reads.

use sqlx::FromRow;

use super::{Store, StoreError};

/// The controllers of a rig.
#[derive(Debug, Clone, PartialEq, Eq, FromRow)]
pub struct RigStages {
    /// Number of the row.
    pub id: i64,
    /// Rig that they belong to.
    pub rig_id: i64,
    /// JSON of their identity.
    pub identity: String,
}

/// Why a rig has these controllers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StagesOrigin {
    /// They answered at the rig's first connection.
    FirstConnection,
    /// A person accepted them.
    Accepted,
}

impl StagesOrigin {
    const fn as_str(self) -> &'static str {
        match self {
            StagesOrigin::FirstConnection => "first-connection",
            StagesOrigin::Accepted => "accepted",
        }
    }
}

impl Store {
    /// Returns the controllers of a rig; none before its first connection.
    ///
    /// # Errors
    /// A database error.
    pub async fn rig_stages(&self, rig_id: i64) -> Result<Option<RigStages>, StoreError> {
        Ok(sqlx::query_as(
            "SELECT id, rig_id, identity FROM rig_stages WHERE rig_id = ? ORDER BY id DESC LIMIT 1",
        )
        .bind(rig_id)
        .fetch_optional(self.readers())
        .await?)
    }

    /// Returns the controllers that a rig of this store got last, whichever rig it is.
    ///
    /// # Errors
    /// A database error.
    pub async fn newest_stages(&self) -> Result<Option<RigStages>, StoreError> {
        Ok(
            sqlx::query_as("SELECT id, rig_id, identity FROM rig_stages ORDER BY id DESC LIMIT 1")
                .fetch_optional(self.readers())
                .await?,
        )
    }

    /// Returns the controllers that a scan had, the last ones first. A store that an older program wrote has none of them.
    ///
    /// # Errors
    /// A database error.
    pub async fn stages_of_scan(&self, scan_id: i64) -> Result<Vec<RigStages>, StoreError> {
        let known: bool = sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'scan_stages')",
        )
        .fetch_one(self.readers())
        .await?;
        if !known {
            return Ok(Vec::new());
        }
        Ok(sqlx::query_as(
            "SELECT r.id, r.rig_id, r.identity FROM scan_stages s JOIN rig_stages r ON r.id = s.stages_id
             WHERE s.scan_id = ? ORDER BY s.id DESC",
        )
        .bind(scan_id)
        .fetch_all(self.readers())
        .await?)
    }

    /// Adds the controllers of a rig and returns their number.
    ///
    /// # Errors
    /// A database error.
    pub async fn add_rig_stages(
        &self,
        rig_id: i64,
        identity: &str,
        origin: StagesOrigin,
    ) -> Result<i64, StoreError> {
        let mut transaction = self.writing().await?;
        let id = sqlx::query(
            "INSERT INTO rig_stages (rig_id, identity, origin, created_at) VALUES (?, ?, ?, ?)",
        )
        .bind(rig_id)
        .bind(identity)
        .bind(origin.as_str())
        .bind(self.now_text())
        .execute(&mut *transaction)
        .await?
        .last_insert_rowid();
        transaction.commit().await?;
        Ok(id)
    }

    /// Notes the controllers with which a scan begins or continues. Returns those it had before, if
    /// they are others; without effect if they are the same.
    ///
    /// # Errors
    /// A database error.
    pub async fn note_scan_stages(
        &self,
        scan_id: i64,
        stages_id: i64,
    ) -> Result<Option<RigStages>, StoreError> {
        let mut transaction = self.writing().await?;
        let before: Option<RigStages> = sqlx::query_as(
            "SELECT r.id, r.rig_id, r.identity FROM scan_stages s JOIN rig_stages r ON r.id = s.stages_id
             WHERE s.scan_id = ? ORDER BY s.id DESC LIMIT 1",
        )
        .bind(scan_id)
        .fetch_optional(&mut *transaction)
        .await?;
        if before.as_ref().is_some_and(|b| b.id == stages_id) {
            return Ok(None);
        }
        sqlx::query("INSERT INTO scan_stages (scan_id, stages_id, created_at) VALUES (?, ?, ?)")
            .bind(scan_id)
            .bind(stages_id)
            .bind(self.now_text())
            .execute(&mut *transaction)
            .await?;
        transaction.commit().await?;
        Ok(before)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::scans::tests::planned;
    use crate::store::tests::open;

    #[tokio::test]
    async fn the_newest_controllers_of_a_rig_count_and_a_scan_keeps_its_own() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let rig_id = scan.rig_id.unwrap();
        assert_eq!(store.rig_stages(rig_id).await.unwrap(), None);
        let add = async |identity, origin| {
            let id = store.add_rig_stages(rig_id, identity, origin).await;
            id.unwrap()
        };
        let first = add("{\"a\":1}", StagesOrigin::FirstConnection).await;
        assert_eq!(store.note_scan_stages(scan.id, first).await.unwrap(), None);
        assert_eq!(store.note_scan_stages(scan.id, first).await.unwrap(), None);
        let second = add("{\"a\":2}", StagesOrigin::Accepted).await;
        let newest = store.rig_stages(rig_id).await.unwrap().unwrap();
        assert_eq!((newest.id, newest.identity.as_str()), (second, "{\"a\":2}"));
        let before = store.note_scan_stages(scan.id, second).await.unwrap();
        assert_eq!(before.unwrap().id, first);
        assert_eq!(store.newest_stages().await.unwrap().unwrap().id, second);
    }
}
