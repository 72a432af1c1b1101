//! What reductions computed of the frames: stored as rows, and shared by all readers of a scan.

use std::sync::{Arc, PoisonError, Weak};

use futures::TryStreamExt;
use tokio::runtime::Handle;

use super::{Inner, PROGRAM, Store, StoreError};
use crate::reduction::{FrameText, ReductionCache, ReductionTexts, TextStore};

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
        let cache = match self.inner.place {
            Some(_) => ReductionCache::stored_in(Arc::new(Texts {
                store: Arc::downgrade(&self.inner),
                runtime: Handle::current(),
            })),
            // A reader stores nothing, and may be closed before its series is reduced.
            None => ReductionCache::default(),
        };
        self.restore_reductions(scan_id, keys, &cache).await?;
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

    async fn restore_reductions(
        &self,
        scan_id: i64,
        keys: &[String],
        cache: &ReductionCache,
    ) -> Result<(), StoreError> {
        // A folder of an older program that is opened for reading only lacks the tables.
        let tables: i64 = sqlx::query_scalar(
            "SELECT COUNT(*) FROM sqlite_master WHERE type = 'table' AND name IN ('calibration_sums', 'frame_sums')",
        )
        .fetch_one(self.readers())
        .await?;
        if tables < 2 {
            return Ok(());
        }
        for (key, body) in self.calibration_bodies(scan_id, keys).await? {
            cache.restore_calibration(&key, &body);
        }
        // One by one: together they may be larger than all that stays in memory.
        let mut frames = sqlx::query_as::<_, (String, i64, String, String)>(
            "SELECT c.key, s.frame_id, s.part, s.body FROM frame_sums s
               JOIN frames f ON f.id = s.frame_id JOIN calibration_sums c ON c.id = s.calibration_id
             WHERE f.scan_id = ?",
        )
        .bind(scan_id)
        .fetch(self.readers());
        while let Some((calibration, frame_id, part, body)) = frames.try_next().await? {
            cache.restore_frame(&FrameText {
                calibration,
                frame_id,
                part,
                body,
            });
        }
        Ok(())
    }

    /// Bodies of calibrations by key: those of these keys, and those that the frames of the scan were measured with.
    async fn calibration_bodies(
        &self,
        scan_id: i64,
        keys: &[String],
    ) -> Result<Vec<(String, String)>, StoreError> {
        let keys =
            serde_json::to_string(keys).map_err(|e| StoreError::bad_row("calibration_sums", e))?;
        let bodies = sqlx::query_as(
            "SELECT key, body FROM calibration_sums WHERE key IN (SELECT value FROM json_each(?1)) OR id IN
               (SELECT calibration_id FROM frame_sums s JOIN frames f ON f.id = s.frame_id WHERE f.scan_id = ?2)",
        )
        .bind(keys)
        .bind(scan_id)
        .fetch_all(self.readers())
        .await?;
        Ok(bodies)
    }

    async fn reduction_bodies(
        &self,
        calibration: &str,
        part: &str,
        frame_ids: &[i64],
    ) -> Result<Vec<(i64, String)>, StoreError> {
        let ids =
            serde_json::to_string(frame_ids).map_err(|e| StoreError::bad_row("frame_sums", e))?;
        let bodies = sqlx::query_as(
            "SELECT frame_id, body FROM frame_sums
             WHERE calibration_id = (SELECT id FROM calibration_sums WHERE key = ?) AND part = ?
               AND frame_id IN (SELECT value FROM json_each(?))",
        )
        .bind(calibration)
        .bind(part)
        .bind(ids)
        .fetch_all(self.readers())
        .await?;
        Ok(bodies)
    }

    /// Adds texts, and returns for each frame's whether it was added.
    async fn add_reductions(&self, new: &ReductionTexts) -> Result<Vec<bool>, StoreError> {
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
        let mut added = Vec::with_capacity(new.frames.len());
        for text in &new.frames {
            let done = sqlx::query(
                "INSERT OR IGNORE INTO frame_sums (calibration_id, frame_id, part, body)
                 SELECT id, ?, ?, ? FROM calibration_sums WHERE key = ?",
            )
            .bind(text.frame_id)
            .bind(&text.part)
            .bind(&text.body)
            .bind(&text.calibration)
            .execute(&mut *transaction)
            .await?;
            added.push(done.rows_affected() == 1);
        }
        transaction.commit().await?;
        Ok(added)
    }
}

/// The rows as a cache uses them, from a thread that may wait. Once the store is dropped there are none.
#[derive(Debug)]
struct Texts {
    store: Weak<Inner>,
    runtime: Handle,
}

impl Texts {
    fn store(&self) -> Result<Store, String> {
        let inner = self.store.upgrade().ok_or("the database is closed")?;
        Ok(Store { inner })
    }
}

impl TextStore for Texts {
    fn add(&self, texts: &ReductionTexts) -> Result<Vec<bool>, String> {
        let store = self.store()?;
        let added = self.runtime.block_on(store.add_reductions(texts));
        added.map_err(|error| error.to_string())
    }

    fn bodies(
        &self,
        calibration: &str,
        part: &str,
        frame_ids: &[i64],
    ) -> Result<Vec<(i64, String)>, String> {
        let store = self.store()?;
        let bodies = store.reduction_bodies(calibration, part, frame_ids);
        self.runtime
            .block_on(bodies)
            .map_err(|error| error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::SteppedClock;
    use crate::reduction::CalibrationText;
    use crate::store::disk::RealDisk;
    use crate::store::scans::tests::planned;
    use crate::store::shots::tests::commit;
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

    async fn sums_of(store: &Store, texts: &ReductionTexts) -> Vec<String> {
        let ids: Vec<i64> = texts.frames.iter().map(|text| text.frame_id).collect();
        let bodies = store.reduction_bodies("abc", "sums", &ids).await.unwrap();
        bodies.into_iter().map(|(_, body)| body).collect()
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
        assert_eq!(store.add_reductions(&new).await.unwrap(), [true]);
        // Rows that are there stay as they are.
        assert_eq!(store.add_reductions(&new).await.unwrap(), [false]);
        assert_eq!(sums_of(&store, &new).await, ["[]"]);
        let calibration = [("abc".to_owned(), "{}".to_owned())];
        let found = store.calibration_bodies(scan, &[]).await.unwrap();
        assert_eq!(found, calibration);
        // Another scan with the same darks and flats finds the calibration.
        let found = store.calibration_bodies(99, &["abc".into()]).await.unwrap();
        assert_eq!(found, calibration);
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
        reader.reductions(scan, &[]).await.unwrap();
        reader.close().await;
        let (store, _) = open(folder.path()).await.unwrap();
        let new = texts(frame_id(&store, scan).await);
        store.add_reductions(&new).await.unwrap();
        assert_eq!(sums_of(&store, &new).await, ["[]"]);
    }
}
