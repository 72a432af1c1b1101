//! Calibrations: dark and white-reference frames that more than one scan may use.

use sqlx::FromRow;

use super::{Page, PageRequest, Store, StoreError};
use crate::frame::FrameKind;

/// A calibration to add once its frames are committed.
#[derive(Debug, Clone, PartialEq)]
pub struct NewCalibration {
    /// Dark or flat.
    pub kind: FrameKind,
    /// Scan that took the frames.
    pub scan_id: i64,
    /// Rig and camera settings they are valid for.
    pub rig_id: i64,
    /// Exposure times, s.
    pub exposures_s: Vec<f64>,
    /// Camera tilts, degrees; empty for dark frames.
    pub theta_c_deg: Vec<f64>,
    /// Number of frames: exposures × tilts (1 for dark frames) × repeats.
    pub n_frames: u32,
}

/// A stored calibration.
#[derive(Debug, Clone, PartialEq)]
pub struct Calibration {
    /// Number.
    pub id: i64,
    /// What its frames show, dark or flat.
    pub kind: FrameKind,
    /// Scan that took the frames.
    pub scan_id: i64,
    /// Rig and camera settings they are valid for.
    pub rig_id: i64,
    /// Exposure times, s, ascending.
    pub exposures_s: Vec<f64>,
    /// Camera tilts, degrees, ascending; empty for dark frames.
    pub theta_c_deg: Vec<f64>,
    /// Number of frames: exposures × tilts (1 for dark frames) × repeats.
    pub n_frames: u32,
    /// When it was added, RFC 3339 UTC.
    pub created_at: String,
}

#[derive(FromRow)]
struct CalibrationRow {
    id: i64,
    #[sqlx(try_from = "String")]
    kind: FrameKind,
    scan_id: i64,
    rig_id: i64,
    exposures_s: String,
    theta_c_deg: String,
    n_frames: u32,
    created_at: String,
}

impl TryFrom<CalibrationRow> for Calibration {
    type Error = StoreError;

    fn try_from(row: CalibrationRow) -> Result<Self, StoreError> {
        let list = |text: &str| {
            serde_json::from_str(text).map_err(|e| StoreError::bad_row("calibrations", e))
        };
        Ok(Calibration {
            id: row.id,
            scan_id: row.scan_id,
            rig_id: row.rig_id,
            exposures_s: list(&row.exposures_s)?,
            theta_c_deg: list(&row.theta_c_deg)?,
            kind: row.kind,
            n_frames: row.n_frames,
            created_at: row.created_at,
        })
    }
}

/// Selects calibrations.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CalibrationFilter {
    /// Taken or used by this scan.
    pub scan_id: Option<i64>,
    /// Dark or flat.
    pub kind: Option<FrameKind>,
    /// Made at or after, RFC 3339 UTC.
    pub since: Option<String>,
}

impl Store {
    /// Adds a calibration and links it to its scan. A scan has one of each kind; adding it again has no effect. The
    /// calibration is dated by its oldest frame, because a resumed scan may add it days later.
    ///
    /// # Errors
    /// A database error.
    pub async fn add_calibration(&self, new: &NewCalibration) -> Result<i64, StoreError> {
        let list = |values: &[f64]| {
            let mut values = values.to_vec();
            values.sort_by(f64::total_cmp);
            serde_json::to_string(&values).map_err(|e| StoreError::bad_row("calibrations", e))
        };
        let mut transaction = self.writing().await?;
        let kept: Option<i64> =
            sqlx::query_scalar("SELECT id FROM calibrations WHERE scan_id = ? AND kind = ?")
                .bind(new.scan_id)
                .bind(new.kind.as_str())
                .fetch_optional(&mut *transaction)
                .await?;
        if let Some(id) = kept {
            return Ok(id);
        }
        let oldest: Option<String> = sqlx::query_scalar(
            "SELECT MIN(taken_at) FROM shots WHERE scan_id = ? AND kind = ? AND accepted = 1",
        )
        .bind(new.scan_id)
        .bind(new.kind.as_str())
        .fetch_one(&mut *transaction)
        .await?;
        let id = sqlx::query(
            "INSERT INTO calibrations (kind, scan_id, rig_id, exposures_s, theta_c_deg, n_frames, created_at)
             VALUES (?, ?, ?, ?, ?, ?, ?)",
        )
        .bind(new.kind.as_str())
        .bind(new.scan_id)
        .bind(new.rig_id)
        .bind(list(&new.exposures_s)?)
        .bind(list(&new.theta_c_deg)?)
        .bind(new.n_frames)
        .bind(oldest.unwrap_or_else(|| self.now_text()))
        .execute(&mut *transaction)
        .await?
        .last_insert_rowid();
        sqlx::query("INSERT INTO scan_calibrations (scan_id, calibration_id) VALUES (?, ?)")
            .bind(new.scan_id)
            .bind(id)
            .execute(&mut *transaction)
            .await?;
        transaction.commit().await?;
        Ok(id)
    }

    /// Returns calibrations, newest first.
    ///
    /// # Errors
    /// A database error; a row that cannot be read is listed beside the others.
    pub async fn calibrations(
        &self,
        filter: &CalibrationFilter,
        page: PageRequest,
    ) -> Result<Page<Calibration>, StoreError> {
        let rows = sqlx::query_as::<_, CalibrationRow>(
            "SELECT * FROM calibrations WHERE (?1 IS NULL OR id < ?1) AND (?2 IS NULL OR kind = ?2)
               AND (?3 IS NULL OR id IN (SELECT calibration_id FROM scan_calibrations WHERE scan_id = ?3))
               AND (?4 IS NULL OR created_at >= ?4)
             ORDER BY id DESC LIMIT ?5",
        )
        .bind(page.cursor)
        .bind(filter.kind.map(FrameKind::as_str))
        .bind(filter.scan_id)
        .bind(&filter.since)
        .bind(page.limit + 1)
        .fetch_all(self.readers())
        .await?;
        Ok(Page::read(rows, page.limit, |row: &CalibrationRow| row.id))
    }

    /// Returns one calibration.
    ///
    /// # Errors
    /// [`StoreError::NotFound`], or a database error.
    pub async fn calibration(&self, id: i64) -> Result<Calibration, StoreError> {
        sqlx::query_as::<_, CalibrationRow>("SELECT * FROM calibrations WHERE id = ?")
            .bind(id)
            .fetch_optional(self.readers())
            .await?
            .ok_or(StoreError::NotFound {
                noun: "calibration",
                id,
            })?
            .try_into()
    }

    /// Returns the calibrations of a kind for a rig that were made between `since` and `until` (RFC 3339 UTC) and have
    /// all these exposures and tilts, newest first.
    ///
    /// # Errors
    /// A database error.
    pub async fn usable_calibrations(
        &self,
        kind: FrameKind,
        rig_id: i64,
        exposures_s: &[f64],
        theta_c_deg: &[f64],
        since: &str,
        until: &str,
    ) -> Result<Vec<Calibration>, StoreError> {
        let rows = sqlx::query_as::<_, CalibrationRow>(
            "SELECT * FROM calibrations WHERE kind = ? AND rig_id = ? AND created_at BETWEEN ? AND ? ORDER BY id DESC",
        )
        .bind(kind.as_str())
        .bind(rig_id)
        .bind(since)
        .bind(until)
        .fetch_all(self.readers())
        .await?;
        let has = |have: &[f64], want: &[f64]| {
            want.iter()
                .all(|w| have.iter().any(|h| (h - w).abs() < 1e-9))
        };
        let mut usable = Vec::new();
        for row in rows {
            let calibration = Calibration::try_from(row)?;
            if has(&calibration.exposures_s, exposures_s)
                && has(&calibration.theta_c_deg, theta_c_deg)
            {
                usable.push(calibration);
            }
        }
        Ok(usable)
    }

    /// Returns the age of the references as the time when they were taken, at or before `until` (both RFC 3339 UTC): of the newest
    /// dark frames and the newest white-reference frames, the time of the older ones. A kind without frames does not count.
    ///
    /// # Errors
    /// A database error.
    pub async fn references_taken(&self, until: &str) -> Result<Option<String>, StoreError> {
        let taken = sqlx::query_scalar(
            "SELECT MIN(newest) FROM (SELECT MAX(created_at) AS newest FROM calibrations WHERE created_at <= ? GROUP BY kind)",
        )
        .bind(until)
        .fetch_one(self.readers())
        .await?;
        Ok(taken)
    }

    /// Returns the numbers of the calibrations that a scan uses, including its own.
    ///
    /// # Errors
    /// A database error.
    pub async fn calibrations_of_scan(&self, scan_id: i64) -> Result<Vec<i64>, StoreError> {
        Ok(sqlx::query_scalar(
            "SELECT calibration_id FROM scan_calibrations WHERE scan_id = ? ORDER BY calibration_id",
        )
        .bind(scan_id)
        .fetch_all(self.readers())
        .await?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::scan::Progress;
    use crate::store::scans::tests::planned;
    use crate::store::shots::NewShot;
    use crate::store::tests::open;

    #[tokio::test]
    async fn a_calibration_is_added_once_and_is_as_old_as_its_frames() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let days = [11, 10, 12]
            .map(|day| time::macros::datetime!(2025-01-01 00:00 UTC) + time::Duration::days(day));
        for (plan_index, taken_at) in (1..).zip(days) {
            let shot = NewShot {
                scan_id: scan.id,
                plan_index,
                attempt: 0,
                kind: FrameKind::Flat,
                asked: None,
                pose: Pose::from_deg(0.0, 0.0),
                rejected: (plan_index == 3).then(|| "black".into()),
                taken_at,
            };
            store
                .commit_shot(&shot, &[], Progress::default())
                .await
                .unwrap();
        }
        let new = NewCalibration {
            kind: FrameKind::Flat,
            scan_id: scan.id,
            rig_id: scan.rig_id.unwrap(),
            exposures_s: vec![0.02],
            theta_c_deg: vec![0.0, 10.0],
            n_frames: 2,
        };
        let id = store.add_calibration(&new).await.unwrap();
        assert_eq!(store.add_calibration(&new).await.unwrap(), id);
        assert_eq!(store.calibrations_of_scan(scan.id).await.unwrap(), [id]);
        let kept = store.calibration(id).await.unwrap();
        assert_eq!(kept.created_at, crate::store::utc_text(days[1]));

        // The references are as old as the older of the newest frames of each kind.
        let taken = async |until: &str| store.references_taken(until).await.unwrap();
        let future = "2100-01-01T00:00:00.000Z";
        assert_eq!(taken(future).await.as_ref(), Some(&kept.created_at));
        let dark = NewCalibration {
            kind: FrameKind::Dark,
            theta_c_deg: Vec::new(),
            ..new
        };
        let dark = store.add_calibration(&dark).await.unwrap();
        let dark = store.calibration(dark).await.unwrap();
        assert!(dark.created_at > kept.created_at);
        assert_eq!(taken(future).await.as_ref(), Some(&kept.created_at));
        assert_eq!(taken("2000-01-01T00:00:00.000Z").await, None);
    }

    #[tokio::test]
    async fn a_calibration_counts_for_its_rig_exposures_and_age_only() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let rig_id = scan.rig_id.unwrap();
        store
            .add_calibration(&NewCalibration {
                kind: FrameKind::Flat,
                scan_id: scan.id,
                rig_id,
                exposures_s: vec![0.06, 0.02],
                theta_c_deg: vec![-10.0, 0.0, 10.0],
                n_frames: 6,
            })
            .await
            .unwrap();
        let past = "2000-01-01T00:00:00.000Z";
        let finds_until = async |rig_id, exposures: &[f64], tilts: &[f64], since, until| {
            let usable = store
                .usable_calibrations(FrameKind::Flat, rig_id, exposures, tilts, since, until)
                .await
                .unwrap();
            !usable.is_empty()
        };
        let finds = async |rig_id, exposures: &[f64], tilts: &[f64], since| {
            let until = "2100-01-02T00:00:00.000Z";
            finds_until(rig_id, exposures, tilts, since, until).await
        };
        // A date in the future comes from a wrong clock.
        assert!(!finds_until(rig_id, &[0.02], &[0.0], past, past).await);
        assert!(finds(rig_id, &[0.02], &[0.0, 10.0], past).await);
        assert!(!finds(rig_id + 1, &[0.02], &[0.0], past).await);
        assert!(!finds(rig_id, &[0.18], &[0.0], past).await);
        assert!(!finds(rig_id, &[0.02], &[20.0], past).await);
        assert!(!finds(rig_id, &[0.02], &[0.0], "2100-01-01T00:00:00.000Z").await);
        let ids = store.calibrations_of_scan(scan.id).await.unwrap();
        assert_eq!(ids.len(), 1);
        assert_eq!(store.calibration(ids[0]).await.unwrap().n_frames, 6);
        assert!(store.calibration(ids[0] + 1).await.is_err());
        let listed = async |scan_id, kind, since: &str| {
            let filter = CalibrationFilter {
                scan_id: Some(scan_id),
                kind: Some(kind),
                since: Some(since.into()),
            };
            let page = PageRequest::default();
            store.calibrations(&filter, page).await.unwrap().items.len()
        };
        assert_eq!(listed(scan.id, FrameKind::Flat, past).await, 1);
        assert_eq!(listed(scan.id, FrameKind::Dark, past).await, 0);
        assert_eq!(listed(scan.id + 1, FrameKind::Flat, past).await, 0);
        let future = "2100-01-01T00:00:00.000Z";
        assert_eq!(listed(scan.id, FrameKind::Flat, future).await, 0);
    }
}
