//! What reductions computed of the frames: stored as rows, and shared in memory by all readers of a scan.

use std::sync::{Arc, PoisonError};

use super::{PROGRAM, Store, StoreError};
use crate::reduction::{CalibrationText, FrameText, ReductionCache, ReductionTexts};

/// Scans whose sums stay in memory: one that runs, and one that is looked at.
const SCANS: usize = 2;

/// Sums of the scans that were reduced last, the newest first.
pub(super) type Shared = Vec<(i64, Arc<ReductionCache>)>;

impl Store {
    /// Returns the sums of a scan's frames, shared by all readers of the scan; `keys` are those of its calibration.
    ///
    /// # Errors
    /// What the database says.
    pub async fn reductions(
        &self,
        scan_id: i64,
        keys: &[String],
    ) -> Result<Arc<ReductionCache>, StoreError> {
        if let Some(cache) = self.shared_reductions(scan_id, None) {
            return Ok(cache);
        }
        let cache = ReductionCache::to_be_stored();
        cache.restore(self.reduction_texts(scan_id, keys).await?);
        let cache = self.shared_reductions(scan_id, Some(Arc::new(cache)));
        Ok(cache.unwrap_or_default())
    }

    /// The cache of a scan, or else `new`, brought to the front.
    fn shared_reductions(
        &self,
        scan_id: i64,
        new: Option<Arc<ReductionCache>>,
    ) -> Option<Arc<ReductionCache>> {
        let mut shared = self
            .inner
            .reductions
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let known = shared.iter().position(|(id, _)| *id == scan_id);
        let cache = match known {
            Some(at) => shared.remove(at).1,
            None => new?,
        };
        shared.insert(0, (scan_id, Arc::clone(&cache)));
        shared.truncate(SCANS);
        Some(cache)
    }

    async fn reduction_texts(
        &self,
        scan_id: i64,
        keys: &[String],
    ) -> Result<ReductionTexts, StoreError> {
        // A folder of an older program that is opened for reading only lacks the tables.
        let tables: i64 = sqlx::query_scalar(
            "SELECT COUNT(*) FROM sqlite_master WHERE type = 'table' AND name IN ('calibration_sums', 'frame_sums')",
        )
        .fetch_one(self.readers())
        .await?;
        if tables < 2 {
            return Ok(ReductionTexts::default());
        }
        let keys =
            serde_json::to_string(keys).map_err(|e| StoreError::bad_row("calibration_sums", e))?;
        let calibrations: Vec<(String, String)> = sqlx::query_as(
            "SELECT key, body FROM calibration_sums WHERE key IN (SELECT value FROM json_each(?1)) OR id IN
               (SELECT calibration_id FROM frame_sums s JOIN frames f ON f.id = s.frame_id WHERE f.scan_id = ?2)",
        )
        .bind(keys)
        .bind(scan_id)
        .fetch_all(self.readers())
        .await?;
        let frames: Vec<(String, i64, String, String)> = sqlx::query_as(
            "SELECT c.key, s.frame_id, s.part, s.body FROM frame_sums s
               JOIN frames f ON f.id = s.frame_id JOIN calibration_sums c ON c.id = s.calibration_id
             WHERE f.scan_id = ?",
        )
        .bind(scan_id)
        .fetch_all(self.readers())
        .await?;
        Ok(ReductionTexts {
            calibrations: calibrations
                .into_iter()
                .map(|(key, body)| CalibrationText {
                    key,
                    dark_frames: Vec::new(),
                    flat_frames: Vec::new(),
                    body,
                })
                .collect(),
            frames: frames
                .into_iter()
                .map(|(calibration, frame_id, part, body)| FrameText {
                    calibration,
                    frame_id,
                    part,
                    body,
                })
                .collect(),
        })
    }

    /// Stores the sums that were computed since the last call, of all scans. What cannot be stored is computed again after
    /// a restart.
    ///
    /// # Errors
    /// What the database says.
    pub async fn store_reductions(&self) -> Result<(), StoreError> {
        let caches: Vec<Arc<ReductionCache>> = {
            let shared = self
                .inner
                .reductions
                .lock()
                .unwrap_or_else(PoisonError::into_inner);
            shared.iter().map(|(_, cache)| Arc::clone(cache)).collect()
        };
        for cache in caches {
            let new = cache.take_new();
            if !new.is_empty() {
                self.add_reductions(&new).await?;
            }
        }
        Ok(())
    }

    async fn add_reductions(&self, new: &ReductionTexts) -> Result<(), StoreError> {
        let list = |frames: &[i64]| {
            serde_json::to_string(frames).map_err(|e| StoreError::bad_row("calibration_sums", e))
        };
        let mut transaction = self.writing().await?;
        for text in &new.calibrations {
            sqlx::query(
                "INSERT OR IGNORE INTO calibration_sums (key, dark_frames, flat_frames, body, program, created_at)
                 VALUES (?, ?, ?, ?, ?, ?)",
            )
            .bind(&text.key)
            .bind(list(&text.dark_frames)?)
            .bind(list(&text.flat_frames)?)
            .bind(&text.body)
            .bind(PROGRAM)
            .bind(self.now_text())
            .execute(&mut *transaction)
            .await?;
        }
        for text in &new.frames {
            sqlx::query(
                "INSERT OR IGNORE INTO frame_sums (calibration_id, frame_id, part, body)
                 SELECT id, ?, ?, ? FROM calibration_sums WHERE key = ?",
            )
            .bind(text.frame_id)
            .bind(&text.part)
            .bind(&text.body)
            .bind(&text.calibration)
            .execute(&mut *transaction)
            .await?;
        }
        transaction.commit().await?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::SteppedClock;
    use crate::store::disk::RealDisk;
    use crate::store::frames::tests::commit;
    use crate::store::scans::tests::planned;
    use crate::store::tests::open;

    fn texts(frame_id: i64) -> ReductionTexts {
        ReductionTexts {
            calibrations: vec![CalibrationText {
                key: "abc".into(),
                dark_frames: vec![1],
                flat_frames: vec![2, 3],
                body: "{}".into(),
            }],
            frames: vec![FrameText {
                calibration: "abc".into(),
                frame_id,
                part: "sums".into(),
                body: "[]".into(),
            }],
        }
    }

    async fn frame_id(store: &Store, scan_id: i64) -> i64 {
        store.frames_for_reduction(scan_id).await.unwrap()[0].id
    }

    #[tokio::test]
    async fn sums_are_found_by_the_scan_and_by_the_key_and_are_never_changed() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await.id;
        commit(&store, scan, 0).await;
        let new = texts(frame_id(&store, scan).await);
        store.add_reductions(&new).await.unwrap();
        // Rows that are there stay as they are.
        store.add_reductions(&new).await.unwrap();
        let found = store.reduction_texts(scan, &[]).await.unwrap();
        assert_eq!(found.frames, new.frames);
        assert_eq!(found.calibrations.len(), 1);
        // Another scan with the same darks and flats finds the calibration.
        let found = store.reduction_texts(99, &["abc".into()]).await.unwrap();
        assert_eq!((found.calibrations.len(), found.frames.len()), (1, 0));
        for change in [
            "UPDATE calibration_sums SET body = ''",
            "DELETE FROM calibration_sums",
            "UPDATE frame_sums SET body = ''",
            "DELETE FROM frame_sums",
        ] {
            let refused = sqlx::query(change).execute(store.writer()).await;
            assert!(refused.is_err(), "{change}");
        }
    }

    #[tokio::test]
    async fn a_folder_of_the_program_before_opens_and_takes_sums() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await.id;
        commit(&store, scan, 0).await;
        // The database as it was before these tables came.
        for statement in [
            "DROP TABLE frame_sums",
            "DROP TABLE calibration_sums",
            "DELETE FROM _sqlx_migrations WHERE description = 'reductions'",
        ] {
            let done = sqlx::query(statement)
                .execute(store.writer())
                .await
                .unwrap();
            assert!(!statement.starts_with("DELETE") || done.rows_affected() == 1);
        }
        store.close().await;
        // Opened for reading only it stays as it is.
        let clock = Arc::new(SteppedClock::new());
        let reader = Store::open_for_reading(folder.path(), Arc::new(RealDisk), clock).await;
        let reader = reader.unwrap();
        let found = reader.reduction_texts(scan, &[]).await.unwrap();
        assert!(found.is_empty());
        reader.close().await;
        let (store, _) = open(folder.path()).await.unwrap();
        let new = texts(frame_id(&store, scan).await);
        store.add_reductions(&new).await.unwrap();
        let found = store.reduction_texts(scan, &[]).await.unwrap();
        assert_eq!(found.frames, new.frames);
    }
}
