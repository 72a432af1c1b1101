//! Shots: the visits to the points of a plan, committed with their frames.

use time::OffsetDateTime;

use super::frames::{COLUMNS, FrameRecord, ImportedFrame, KeptFile, insert_frame};
use super::{Store, StoreError, utc_text};
use crate::frame::{FrameKind, FrameTag};
use crate::geometry::Pose;
use crate::scan::event::{AxisEvent, RigActivity};
use crate::scan::{Event, Progress, RecordedEvent};

/// A visit to a point of the plan, to commit with its frames.
#[derive(Debug, Clone, PartialEq)]
pub struct NewShot {
    /// Scan it belongs to.
    pub scan_id: i64,
    /// Number of the point in the plan, from 0.
    pub plan_index: u32,
    /// 0 for the first visit, 1 more for each retake.
    pub attempt: u32,
    /// Kind of the frames.
    pub kind: FrameKind,
    /// Pose of the plan; `None` where any pose will do.
    pub asked: Option<Pose>,
    /// Position read back.
    pub pose: Pose,
    /// Reason for its rejection; `None` if it was accepted.
    pub rejected: Option<String>,
    /// Start of the first exposure.
    pub taken_at: OffsetDateTime,
}

/// A frame of a shot.
#[derive(Debug, Clone, PartialEq)]
pub struct NewFrame {
    /// Its durable file.
    pub file: KeptFile,
    /// File name in a series.
    pub name: String,
    /// Exposure time, s.
    pub exposure_s: f64,
    /// Number of the repeat, from 0.
    pub repeat: u32,
    /// Start of the exposure.
    pub taken_at: OffsetDateTime,
    /// What the camera's program states about it.
    pub tag: FrameTag,
}

impl Store {
    /// Commits a visit to a point in one transaction: shot, frames and their events.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`], or a database error.
    pub async fn commit_shot(
        &self,
        shot: &NewShot,
        frames: &[NewFrame],
        progress: Progress,
    ) -> Result<Vec<RecordedEvent>, StoreError> {
        let mut transaction = self.writing().await?;
        let accepted = shot.rejected.is_none();
        let shot_id = sqlx::query(
            "INSERT INTO shots (scan_id, plan_index, attempt, kind, asked_theta_c_deg, asked_phi_s_deg,
               theta_c_deg, phi_s_deg, accepted, reason, taken_at) VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
        )
        .bind(shot.scan_id)
        .bind(shot.plan_index)
        .bind(shot.attempt)
        .bind(shot.kind.as_str())
        .bind(shot.asked.map(|pose| pose.theta_c.deg()))
        .bind(shot.asked.map(|pose| pose.phi_s.deg()))
        .bind(shot.pose.theta_c.deg())
        .bind(shot.pose.phi_s.deg())
        .bind(accepted)
        .bind(&shot.rejected)
        .bind(utc_text(shot.taken_at))
        .execute(&mut *transaction)
        .await?
        .last_insert_rowid();
        let mut events = Vec::with_capacity(frames.len() + 1);
        let arrived = Event::Rig {
            activity: RigActivity::Scanning,
            theta_c: AxisEvent::at(shot.pose.theta_c),
            phi_s: AxisEvent::at(shot.pose.phi_s),
        };
        let arrived = self.record_of_scan(&mut transaction, shot.scan_id, arrived);
        events.push(arrived.await?);
        for frame in frames {
            let (theta_c_deg, phi_s_deg) = (shot.pose.theta_c.deg(), shot.pose.phi_s.deg());
            let id = insert_frame(
                &mut transaction,
                shot.scan_id,
                Some(shot_id),
                &ImportedFrame {
                    file: frame.file.clone(),
                    name: frame.name.clone(),
                    kind: shot.kind,
                    theta_c_deg,
                    phi_s_deg,
                    exposure_s: frame.exposure_s,
                    repeat: frame.repeat,
                    timestamp: utc_text(frame.taken_at),
                    original_sha256: None,
                },
                shot.rejected.as_deref(),
            )
            .await?;
            if !frame.tag.is_empty() {
                let tag = serde_json::to_string(&frame.tag)
                    .map_err(|e| StoreError::bad_row("frame_tags", e))?;
                sqlx::query("INSERT INTO frame_tags (frame_id, tag) VALUES (?, ?)")
                    .bind(id)
                    .bind(tag)
                    .execute(&mut *transaction)
                    .await?;
            }
            let event = Event::Frame {
                scan_id: shot.scan_id,
                frame_id: id,
                kind: shot.kind,
                theta_c_deg,
                phi_s_deg,
                exposure_s: frame.exposure_s,
                repeat: frame.repeat,
                mean_dn: frame.file.mean_dn,
                max_dn: frame.file.max_dn,
                saturated_px: frame.file.saturated_px,
                accepted,
                reason: shot.rejected.clone(),
                progress,
            };
            events.push(self.record_in(&mut transaction, event).await?);
        }
        transaction.commit().await?;
        Ok(events)
    }

    /// Marks accepted points of a scan as not counting, for this reason.
    ///
    /// # Errors
    /// A database error.
    pub async fn withdraw_shots(
        &self,
        scan_id: i64,
        points: &[u32],
        why: &str,
    ) -> Result<(), StoreError> {
        let mut transaction = self.writing().await?;
        for point in points {
            for statement in [
                "UPDATE frames SET accepted = 0, reason = ?3 WHERE accepted = 1 AND shot_id IN
                   (SELECT id FROM shots WHERE scan_id = ?1 AND plan_index = ?2)",
                "UPDATE shots SET accepted = 0, reason = ?3 WHERE accepted = 1 AND scan_id = ?1 AND plan_index = ?2",
            ] {
                sqlx::query(statement)
                    .bind(scan_id)
                    .bind(point)
                    .bind(why)
                    .execute(&mut *transaction)
                    .await?;
            }
        }
        transaction.commit().await?;
        Ok(())
    }

    /// Returns the newest accepted points of the sample of a scan, newest first.
    ///
    /// # Errors
    /// A database error.
    pub async fn newest_sample_shots(
        &self,
        scan_id: i64,
        limit: u32,
    ) -> Result<Vec<(u32, i64)>, StoreError> {
        Ok(sqlx::query_as(
            "SELECT plan_index, id FROM shots WHERE scan_id = ? AND accepted = 1 AND kind = 'sample'
             ORDER BY id DESC LIMIT ?",
        )
        .bind(scan_id)
        .bind(limit)
        .fetch_all(self.readers())
        .await?)
    }

    /// Returns the frames of a shot, in the order taken.
    ///
    /// # Errors
    /// A database error.
    pub async fn frames_of_shot(&self, shot_id: i64) -> Result<Vec<FrameRecord>, StoreError> {
        Ok(sqlx::query_as(sqlx::AssertSqlSafe(format!(
            "SELECT {COLUMNS} FROM frames WHERE shot_id = ? ORDER BY id"
        )))
        .bind(shot_id)
        .fetch_all(self.readers())
        .await?)
    }

    /// Returns the plan indices that have an accepted shot.
    ///
    /// # Errors
    /// A database error.
    pub async fn shots_done(&self, scan_id: i64) -> Result<Vec<u32>, StoreError> {
        Ok(sqlx::query_scalar(
            "SELECT DISTINCT plan_index FROM shots WHERE scan_id = ? AND accepted = 1 ORDER BY plan_index",
        )
        .bind(scan_id)
        .fetch_all(self.readers())
        .await?)
    }

    /// Returns the plan indices whose accepted shot of the sample is saturated: most pixels of its first frame of the
    /// shortest exposure.
    ///
    /// # Errors
    /// A database error.
    pub async fn shots_full(&self, scan_id: i64) -> Result<Vec<u32>, StoreError> {
        Ok(sqlx::query_scalar(
            "SELECT DISTINCT s.plan_index FROM shots s JOIN frames f ON f.shot_id = s.id
             WHERE s.scan_id = ? AND s.accepted = 1 AND s.kind = 'sample' AND f.repeat = 0
               AND f.exposure_s = (SELECT MIN(exposure_s) FROM frames WHERE shot_id = s.id)
               AND 2 * f.saturated_px > f.width_px * f.height_px
             ORDER BY s.plan_index",
        )
        .bind(scan_id)
        .fetch_all(self.readers())
        .await?)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::store::frames::tests::frame;
    use crate::store::scans::tests::planned;
    use crate::store::tests::open;

    pub(crate) async fn commit(store: &Store, scan_id: i64, plan_index: u32) -> String {
        let file = store.keep_frame(frame(), 65535).await.unwrap();
        let sha256 = file.sha256.clone();
        let at = time::macros::datetime!(2026-01-01 00:00 UTC);
        let shot = NewShot {
            scan_id,
            plan_index,
            attempt: 0,
            kind: FrameKind::Sample,
            asked: Some(Pose::from_deg(10.0, 20.0)),
            pose: Pose::from_deg(10.001, 20.0),
            rejected: None,
            taken_at: at,
        };
        let frames = [NewFrame {
            file,
            name: format!("frames/{plan_index}.png"),
            exposure_s: 0.1,
            repeat: 0,
            taken_at: at,
            tag: FrameTag::default(),
        }];
        let events = store
            .commit_shot(&shot, &frames, Progress::default())
            .await
            .unwrap();
        assert_eq!(events.len(), 2);
        sha256
    }

    #[tokio::test]
    async fn a_point_can_be_withdrawn_with_a_reason_and_not_changed_otherwise() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        for point in [0, 1, 2] {
            commit(&store, scan.id, point).await;
        }
        store
            .withdraw_shots(scan.id, &[0, 2], "the picture changed")
            .await
            .unwrap();
        assert_eq!(store.shots_done(scan.id).await.unwrap(), [1]);
        assert_eq!(store.frames_for_reduction(scan.id).await.unwrap().len(), 1);
        assert_eq!(store.frames_rejected(scan.id).await.unwrap(), 2);
        let newest = store.newest_sample_shots(scan.id, 10).await.unwrap();
        let [(1, shot_id)] = newest[..] else {
            panic!("{newest:?}");
        };
        assert_eq!(store.frames_of_shot(shot_id).await.unwrap().len(), 1);
        // Taken again, it counts again.
        commit(&store, scan.id, 0).await;
        assert_eq!(store.shots_done(scan.id).await.unwrap(), [0, 1]);
        let mut writer = store.writing().await.unwrap();
        for refused in [
            "UPDATE frames SET accepted = 1",
            "UPDATE shots SET accepted = 1",
            "UPDATE frames SET accepted = 0",
            "UPDATE frames SET accepted = 0, reason = 'x', exposure_s = 5.0",
            "UPDATE shots SET accepted = 0, reason = 'x', theta_c_deg = 0.0",
        ] {
            let changed = sqlx::query(refused).execute(&mut *writer).await;
            let error = changed.unwrap_err().to_string();
            assert!(error.contains("never changed"), "{refused}: {error}");
        }
    }

    #[tokio::test]
    async fn what_the_camera_states_is_kept_with_its_frame() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        commit(&store, scan.id, 0).await;
        assert_eq!(store.frames_are_timed(scan.id).await.unwrap(), Some(false));
        let at = time::macros::datetime!(2026-01-01 00:00 UTC);
        let tag = FrameTag {
            counter: Some(7),
            exposure_start: Some(at),
            serial: Some("A".into()),
            ..FrameTag::default()
        };
        let shot = NewShot {
            scan_id: scan.id,
            plan_index: 1,
            attempt: 0,
            kind: FrameKind::Sample,
            asked: None,
            pose: Pose::from_deg(0.0, 0.0),
            rejected: None,
            taken_at: at,
        };
        let frame = NewFrame {
            file: store.keep_frame(frame(), 65535).await.unwrap(),
            name: "frames/1.png".into(),
            exposure_s: 0.1,
            repeat: 0,
            taken_at: at,
            tag: tag.clone(),
        };
        store
            .commit_shot(&shot, &[frame], Progress::default())
            .await
            .unwrap();
        let tags = store.tags_of_scan(scan.id, 0, i64::MAX).await.unwrap();
        assert_eq!(tags.into_values().collect::<Vec<_>>(), [tag]);
        assert_eq!(store.frames_are_timed(scan.id).await.unwrap(), Some(true));
    }
}
