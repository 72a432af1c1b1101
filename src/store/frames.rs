//! Frames: first the file, durable and named by its content; then the row.

mod files;

use std::collections::BTreeMap;

use sqlx::FromRow;
use sqlx::sqlite::SqliteConnection;

use super::scans::{NewScan, Origin};
use super::{Page, PageRequest, Store, StoreError};
use crate::frame::{FrameKind, FrameTag};
use crate::scan::{Event, Progress, RecordedEvent, ScanState};
pub(super) use files::relative_path;
pub use files::{KeptFile, sha256_hex};

/// A frame of a recorded series.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportedFrame {
    /// Its durable file.
    pub file: KeptFile,
    /// File name in the series.
    pub name: String,
    /// What it shows.
    pub kind: FrameKind,
    /// Camera tilt as recorded, degrees.
    pub theta_c_deg: f64,
    /// Sample azimuth as recorded, degrees.
    pub phi_s_deg: f64,
    /// Exposure time, s.
    pub exposure_s: f64,
    /// Number of the repeat, as recorded.
    pub repeat: u32,
    /// Start of the exposure as recorded, in any form.
    pub timestamp: String,
    /// Content hash of the imported file, where it is not the stored PNG.
    pub original_sha256: Option<String>,
}

/// A stored frame.
#[derive(Debug, Clone, PartialEq, FromRow)]
pub struct FrameRecord {
    /// Number, from 1, never reused.
    pub id: i64,
    /// Scan it belongs to.
    pub scan_id: i64,
    /// File name in a series.
    pub name: String,
    /// What it shows.
    #[sqlx(try_from = "String")]
    pub kind: FrameKind,
    /// Camera tilt read back, degrees.
    pub theta_c_deg: f64,
    /// Sample azimuth read back, degrees.
    pub phi_s_deg: f64,
    /// Exposure time, s.
    pub exposure_s: f64,
    /// Number of the repeat, from 0.
    pub repeat: u32,
    /// Start of the exposure, RFC 3339 UTC; of an import, as recorded.
    pub timestamp: String,
    /// SHA-256 of the file, in hexadecimal; also its name.
    pub sha256: String,
    /// Size of the file, bytes.
    pub bytes: i64,
    /// Width of the image.
    pub width_px: u32,
    /// Height of the image.
    pub height_px: u32,
    /// Mean of all counts, DN.
    pub mean_dn: f64,
    /// Largest count, DN.
    pub max_dn: u16,
    /// Pixels at or above the saturation level.
    pub saturated_px: u32,
    /// Whether it was accepted.
    pub accepted: bool,
    /// Reason for its rejection.
    pub reason: Option<String>,
    /// Content hash of the imported file, where it is not the stored PNG.
    pub original_sha256: Option<String>,
}

pub(super) const COLUMNS: &str =
    "id, scan_id, name, kind, theta_c_deg, phi_s_deg, exposure_s, repeat, timestamp,
    sha256, bytes, width_px, height_px, mean_dn, max_dn, saturated_px, accepted, reason,
    original_sha256";

impl Store {
    /// Returns what the camera's program stated about frames `first` to `last` of a scan, by the number of the frame. A store
    /// that an older program wrote has nothing of it.
    ///
    /// # Errors
    /// A database error, or a row that cannot be read.
    pub async fn tags_of_scan(
        &self,
        scan_id: i64,
        first: i64,
        last: i64,
    ) -> Result<BTreeMap<i64, FrameTag>, StoreError> {
        let known: bool = sqlx::query_scalar(
            "SELECT EXISTS (SELECT 1 FROM sqlite_master WHERE type = 'table' AND name = 'frame_tags')",
        )
        .fetch_one(self.readers())
        .await?;
        if !known {
            return Ok(BTreeMap::new());
        }
        let rows: Vec<(i64, String)> = sqlx::query_as(
            "SELECT t.frame_id, t.tag FROM frame_tags t JOIN frames f ON f.id = t.frame_id
             WHERE f.scan_id = ? AND t.frame_id BETWEEN ? AND ?",
        )
        .bind(scan_id)
        .bind(first)
        .bind(last)
        .fetch_all(self.readers())
        .await?;
        rows.into_iter()
            .map(|(id, tag)| {
                let tag = serde_json::from_str(&tag);
                Ok((id, tag.map_err(|e| StoreError::bad_row("frame_tags", e))?))
            })
            .collect()
    }

    /// Returns whether the camera's program states when the frames of a scan's sample are exposed; `None` before the first
    /// frame.
    ///
    /// # Errors
    /// As [`Store::tags_of_scan`].
    pub async fn frames_are_timed(&self, scan_id: i64) -> Result<Option<bool>, StoreError> {
        let newest: Option<i64> = sqlx::query_scalar(
            "SELECT id FROM frames WHERE scan_id = ? AND kind = 'sample' AND accepted = 1 ORDER BY id DESC LIMIT 1",
        )
        .bind(scan_id)
        .fetch_optional(self.readers())
        .await?;
        let Some(newest) = newest else {
            return Ok(None);
        };
        let tags = self.tags_of_scan(scan_id, newest, newest).await?;
        let timed = tags
            .get(&newest)
            .is_some_and(|tag| tag.exposure_start.is_some());
        Ok(Some(timed))
    }

    /// Returns the hashes of the newest frames that a scan took, newest first, also of shots that were rejected.
    ///
    /// # Errors
    /// A database error.
    pub async fn newest_frames(&self, scan_id: i64, limit: u32) -> Result<Vec<String>, StoreError> {
        Ok(sqlx::query_scalar(
            "SELECT sha256 FROM frames WHERE scan_id = ? ORDER BY id DESC LIMIT ?",
        )
        .bind(scan_id)
        .bind(limit)
        .fetch_all(self.readers())
        .await?)
    }

    /// Commits a recorded series as a completed scan. Its files must already be durable.
    ///
    /// # Errors
    /// A database error.
    pub async fn import_scan(
        &self,
        new: &NewScan,
        frames: &[ImportedFrame],
    ) -> Result<(i64, RecordedEvent), StoreError> {
        let mut transaction = self.writing().await?;
        let scan_id = self
            .insert_scan(&mut transaction, new, Origin::Import, ScanState::Completed)
            .await?;
        for frame in frames {
            insert_frame(&mut transaction, scan_id, None, frame, None).await?;
        }
        let count = frames.len() as u32;
        let event = Event::Scan {
            scan_id,
            previous: ScanState::Planned,
            state: ScanState::Completed,
            reason: Some("imported".into()),
            operator: None,
            progress: Progress {
                frames_done: count,
                frames_total: count,
                fraction: 1.0,
                ..Progress::default()
            },
        };
        let event = self.record_in(&mut transaction, event).await?;
        transaction.commit().await?;
        Ok((scan_id, event))
    }

    /// Returns one frame.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn frame(&self, id: i64) -> Result<FrameRecord, StoreError> {
        sqlx::query_as(sqlx::AssertSqlSafe(format!(
            "SELECT {COLUMNS} FROM frames WHERE id = ?"
        )))
        .bind(id)
        .fetch_optional(self.readers())
        .await?
        .ok_or(StoreError::NotFound { noun: "frame", id })
    }

    /// Returns the last frame taken of a scan, accepted or not.
    ///
    /// # Errors
    /// A database error.
    pub async fn newest_frame(&self, scan_id: i64) -> Result<Option<FrameRecord>, StoreError> {
        Ok(sqlx::query_as(sqlx::AssertSqlSafe(format!(
            "SELECT {COLUMNS} FROM frames WHERE scan_id = ? ORDER BY id DESC LIMIT 1"
        )))
        .bind(scan_id)
        .fetch_optional(self.readers())
        .await?)
    }

    /// Returns the frames of a scan in the order taken, optionally of one kind.
    ///
    /// # Errors
    /// A database error.
    pub async fn frames_of_scan(
        &self,
        scan_id: i64,
        kind: Option<FrameKind>,
        page: PageRequest,
    ) -> Result<Page<FrameRecord>, StoreError> {
        let rows: Vec<FrameRecord> = sqlx::query_as(sqlx::AssertSqlSafe(format!(
            "SELECT {COLUMNS} FROM frames WHERE scan_id = ?1 AND (?2 IS NULL OR id > ?2)
               AND (?3 IS NULL OR kind = ?3) ORDER BY id LIMIT ?4"
        )))
        .bind(scan_id)
        .bind(page.cursor)
        .bind(kind.map(FrameKind::as_str))
        .bind(page.limit + 1)
        .fetch_all(self.readers())
        .await?;
        Ok(Page::cut(rows, page.limit, |row: &FrameRecord| row.id))
    }

    /// Returns every accepted frame that a reduction of the scan reads: its own in the order taken, then those of the
    /// calibrations that it uses.
    ///
    /// # Errors
    /// [`StoreError::BadRow`] if a frame states another pose than its shot, or a database error.
    pub async fn frames_for_reduction(&self, scan_id: i64) -> Result<Vec<FrameRecord>, StoreError> {
        self.check_poses(scan_id).await?;
        Ok(sqlx::query_as(sqlx::AssertSqlSafe(format!(
            "SELECT {COLUMNS} FROM frames f WHERE accepted = 1 AND (scan_id = ?1 OR EXISTS (
               SELECT 1 FROM scan_calibrations u JOIN calibrations c ON c.id = u.calibration_id
               WHERE u.scan_id = ?1 AND c.scan_id = f.scan_id AND c.kind = f.kind))
             ORDER BY scan_id <> ?1, id"
        )))
        .bind(scan_id)
        .fetch_all(self.readers())
        .await?)
    }

    /// Returns the SHA-256 of the accepted white-reference frames of a scan and of the calibrations that it uses, ascending.
    ///
    /// # Errors
    /// A database error.
    pub async fn flats_of_scan(&self, scan_id: i64) -> Result<Vec<String>, StoreError> {
        Ok(sqlx::query_scalar(
            "SELECT DISTINCT sha256 FROM frames f WHERE accepted = 1 AND kind = ?2 AND (scan_id = ?1 OR EXISTS (
               SELECT 1 FROM scan_calibrations u JOIN calibrations c ON c.id = u.calibration_id
               WHERE u.scan_id = ?1 AND c.scan_id = f.scan_id AND c.kind = f.kind))
             ORDER BY sha256",
        )
        .bind(scan_id)
        .bind(FrameKind::Flat.as_str())
        .fetch_all(self.readers())
        .await?)
    }

    /// Returns the imported scans that have a frame, newest first.
    ///
    /// # Errors
    /// A database error.
    pub async fn imports_with(&self, sha256: &str) -> Result<Vec<i64>, StoreError> {
        Ok(sqlx::query_scalar(
            "SELECT DISTINCT f.scan_id FROM frames f JOIN scans s ON s.id = f.scan_id
             WHERE f.sha256 = ? AND s.origin = 'import' ORDER BY f.scan_id DESC",
        )
        .bind(sha256)
        .fetch_all(self.readers())
        .await?)
    }

    /// Returns the number of frames of rejected visits.
    ///
    /// # Errors
    /// A database error.
    pub async fn frames_rejected(&self, scan_id: i64) -> Result<u32, StoreError> {
        Ok(
            sqlx::query_scalar("SELECT COUNT(*) FROM frames WHERE scan_id = ? AND accepted = 0")
                .bind(scan_id)
                .fetch_one(self.readers())
                .await?,
        )
    }
}

pub(super) async fn insert_frame(
    transaction: &mut SqliteConnection,
    scan_id: i64,
    shot_id: Option<i64>,
    frame: &ImportedFrame,
    rejected: Option<&str>,
) -> Result<i64, StoreError> {
    Ok(sqlx::query(
        "INSERT INTO frames (scan_id, shot_id, name, kind, theta_c_deg, phi_s_deg, exposure_s, repeat,
           timestamp, sha256, bytes, width_px, height_px, mean_dn, max_dn, saturated_px, accepted, reason,
           original_sha256) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
    )
    .bind(scan_id)
    .bind(shot_id)
    .bind(&frame.name)
    .bind(frame.kind.as_str())
    .bind(frame.theta_c_deg)
    .bind(frame.phi_s_deg)
    .bind(frame.exposure_s)
    .bind(frame.repeat)
    .bind(&frame.timestamp)
    .bind(&frame.file.sha256)
    .bind(frame.file.bytes as i64)
    .bind(frame.file.width_px)
    .bind(frame.file.height_px)
    .bind(frame.file.mean_dn)
    .bind(frame.file.max_dn)
    .bind(frame.file.saturated_px)
    .bind(rejected.is_none())
    .bind(rejected)
    .bind(&frame.original_sha256)
    .execute(&mut *transaction)
    .await?
    .last_insert_rowid())
}

#[cfg(test)]
pub(crate) mod tests {
    use std::path::Path;

    use super::*;
    use crate::frame::Frame;
    use crate::store::disk::{Disk, RealDisk};
    use crate::store::scans::tests::planned;
    use crate::store::shots::tests::commit;
    use crate::store::tests::open;
    use std::sync::Arc;

    pub(crate) fn frame() -> Frame {
        Frame::new(2, 2, vec![1, 2, 3, 65535]).unwrap()
    }

    #[tokio::test]
    async fn a_committed_frame_keeps_the_position_read_back_and_its_counts() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let sha256 = commit(&store, scan.id, 0).await;
        let rows = store.frames_for_reduction(scan.id).await.unwrap();
        assert_eq!(rows.len(), 1);
        assert!((rows[0].theta_c_deg - 10.001).abs() < 1e-12);
        assert_eq!(rows[0].saturated_px, 1);
        let kept = Frame::from_png(&store.read_png(&sha256).unwrap()).unwrap();
        assert_eq!(kept, frame());
        assert_eq!(store.shots_done(scan.id).await.unwrap(), [0]);
    }

    #[tokio::test]
    async fn a_corrupted_file_is_detected_when_it_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let sha256 = commit(&store, scan.id, 0).await;
        let path = folder.path().join(relative_path(&sha256));
        let mut bytes = std::fs::read(&path).unwrap();
        bytes[40] ^= 1;
        std::fs::write(&path, bytes).unwrap();
        assert!(matches!(
            store.read_png(&sha256),
            Err(StoreError::FrameDamaged { .. })
        ));
    }

    struct FullDisk;

    impl Disk for FullDisk {
        fn write_durably(&self, _: &Path, _: &[u8]) -> std::io::Result<()> {
            Err(std::io::ErrorKind::StorageFull.into())
        }
        fn free_bytes(&self, folder: &Path) -> std::io::Result<u64> {
            RealDisk.free_bytes(folder)
        }
    }

    #[tokio::test]
    async fn a_full_disk_has_its_own_error() {
        let folder = tempfile::tempdir().unwrap();
        let clock = Arc::new(crate::clock::SteppedClock::new());
        let (store, _) = Store::open(folder.path(), Arc::new(FullDisk), clock)
            .await
            .unwrap();
        let refused = store.keep_frame(frame(), 65535).await;
        assert!(
            matches!(refused, Err(StoreError::DiskFull { .. })),
            "{refused:?}"
        );
    }
}
