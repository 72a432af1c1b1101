//! Checks of what is stored: the database, the frame files, and frames against the shots that they belong to.
//!
//! The daemon checks the database and the files' sizes at a start. This module repeats that for a folder in use, reads
//! every file if asked to, and compares rows that state the same fact twice.

use serde_json::Value;
use sqlx::FromRow;

use super::frames::sha256_hex;
use super::{Store, StoreError};

/// Degrees beyond the tolerance of an axis by which a position read back may differ from the plan's.
const SLACK_DEG: f64 = 1e-3;

/// A frame, or a visit to a point, that is not as its rows say.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Discrepancy {
    /// Scan it belongs to.
    pub scan_id: i64,
    /// What is wrong.
    pub problem: String,
}

/// What an audit found.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Audit {
    /// Frames looked at.
    pub frames: u64,
    /// Bytes read; zero unless the files were read.
    pub bytes_read: u64,
    /// Everything that is not as its rows say.
    pub discrepancies: Vec<Discrepancy>,
}

#[derive(FromRow)]
struct FrameRow {
    id: i64,
    scan_id: i64,
    sha256: String,
    bytes: i64,
}

#[derive(FromRow)]
struct Pair {
    id: i64,
    scan_id: i64,
    frame_theta_c_deg: f64,
    frame_phi_s_deg: f64,
    shot_theta_c_deg: f64,
    shot_phi_s_deg: f64,
    same_otherwise: bool,
}

#[derive(FromRow)]
struct ShotRow {
    scan_id: i64,
    plan_index: i64,
    asked_theta_c_deg: f64,
    asked_phi_s_deg: f64,
    theta_c_deg: f64,
    phi_s_deg: f64,
    settings: Option<String>,
}

/// Compares the frames with their shots; `f` is a frame and `s` its shot.
const PAIRS: &str =
    "SELECT f.id, f.scan_id, f.theta_c_deg AS frame_theta_c_deg, f.phi_s_deg AS frame_phi_s_deg,
       s.theta_c_deg AS shot_theta_c_deg, s.phi_s_deg AS shot_phi_s_deg,
       f.kind = s.kind AND f.accepted = s.accepted AND f.scan_id = s.scan_id AS same_otherwise
     FROM frames f JOIN shots s ON s.id = f.shot_id
     WHERE (f.theta_c_deg <> s.theta_c_deg OR f.phi_s_deg <> s.phi_s_deg OR f.kind <> s.kind
       OR f.accepted <> s.accepted OR f.scan_id <> s.scan_id)";

impl Store {
    /// Runs the database's own check and returns what it found; empty for a sound database.
    ///
    /// # Errors
    /// A database error.
    pub async fn check_database(&self) -> Result<Vec<String>, StoreError> {
        let mut found: Vec<String> = sqlx::query_scalar("PRAGMA integrity_check")
            .fetch_all(self.readers())
            .await?;
        found.retain(|line| line != "ok");
        Ok(found)
    }

    /// Checks that the frames of a scan, and of the calibrations that it uses, state the pose of their shot: a changed row
    /// must not give a result.
    ///
    /// # Errors
    /// [`StoreError::BadRow`] names the first frame that does not, or a database error.
    pub(super) async fn check_poses(&self, scan_id: i64) -> Result<(), StoreError> {
        let pair: Option<Pair> = sqlx::query_as(sqlx::AssertSqlSafe(format!(
            "{PAIRS} AND (f.scan_id = ?1 OR EXISTS (SELECT 1 FROM scan_calibrations u
               JOIN calibrations c ON c.id = u.calibration_id
               WHERE u.scan_id = ?1 AND c.scan_id = f.scan_id AND c.kind = f.kind)) ORDER BY f.id LIMIT 1"
        )))
        .bind(scan_id)
        .fetch_optional(self.readers())
        .await?;
        match pair {
            None => Ok(()),
            Some(pair) => Err(StoreError::bad_row("frames", pair.problem())),
        }
    }

    /// Looks at every frame: its file and its rows. With `deep` each file is read and its hash compared; otherwise only its
    /// size is. `progress` gets the frames done and their number.
    ///
    /// # Errors
    /// A database error.
    pub async fn audit(
        &self,
        deep: bool,
        progress: impl Fn(u64, u64),
    ) -> Result<Audit, StoreError> {
        const PAGE: i64 = 500;
        let total: i64 = sqlx::query_scalar("SELECT COUNT(*) FROM frames")
            .fetch_one(self.readers())
            .await?;
        let mut audit = Audit::default();
        let mut last = 0;
        loop {
            let rows: Vec<FrameRow> = sqlx::query_as(
                "SELECT id, scan_id, sha256, bytes FROM frames WHERE id > ? ORDER BY id LIMIT ?",
            )
            .bind(last)
            .bind(PAGE)
            .fetch_all(self.readers())
            .await?;
            let Some(newest) = rows.last() else { break };
            last = newest.id;
            let store = self.clone();
            let looked = move || -> Vec<(u64, Option<Discrepancy>)> {
                rows.iter().map(|row| store.look_at(row, deep)).collect()
            };
            let looked = tokio::task::spawn_blocking(looked)
                .await
                .expect("reading a frame does not panic");
            for (bytes, problem) in looked {
                audit.frames += 1;
                audit.bytes_read += bytes;
                audit.discrepancies.extend(problem);
            }
            progress(audit.frames, total as u64);
        }
        let pairs: Vec<Pair> =
            sqlx::query_as(sqlx::AssertSqlSafe(format!("{PAIRS} ORDER BY f.id")))
                .fetch_all(self.readers())
                .await?;
        audit
            .discrepancies
            .extend(pairs.iter().map(|pair| Discrepancy {
                scan_id: pair.scan_id,
                problem: pair.problem(),
            }));
        audit
            .discrepancies
            .extend(self.shots_off_their_plan().await?);
        Ok(audit)
    }

    /// Returns the bytes read of a frame's file, and what is wrong with it.
    fn look_at(&self, row: &FrameRow, deep: bool) -> (u64, Option<Discrepancy>) {
        let path = self.frame_path(&row.sha256);
        let wrong = |problem: &str| {
            Some(Discrepancy {
                scan_id: row.scan_id,
                problem: format!("frame {}: {} {problem}", row.id, path.display()),
            })
        };
        if !deep {
            let size = std::fs::metadata(&path).map(|file| file.len());
            return match size {
                Ok(size) if size == row.bytes as u64 => (0, None),
                Ok(_) => (0, wrong("has another size than its row states")),
                Err(_) => (0, wrong("is missing or cannot be read")),
            };
        }
        match std::fs::read(&path) {
            Ok(content) if sha256_hex(&content) == row.sha256 => (content.len() as u64, None),
            Ok(content) => (content.len() as u64, wrong("has changed: its hash differs")),
            Err(_) => (0, wrong("is missing or cannot be read")),
        }
    }

    /// Returns the accepted shots whose position read back is not the one of the plan, within the axis's tolerance.
    async fn shots_off_their_plan(&self) -> Result<Vec<Discrepancy>, StoreError> {
        let shots: Vec<ShotRow> = sqlx::query_as(
            "SELECT s.scan_id, s.plan_index, s.asked_theta_c_deg, s.asked_phi_s_deg, s.theta_c_deg, s.phi_s_deg, r.settings
             FROM shots s JOIN scans c ON c.id = s.scan_id LEFT JOIN rigs r ON r.id = c.rig_id
             WHERE s.accepted = 1 AND s.asked_theta_c_deg IS NOT NULL AND s.asked_phi_s_deg IS NOT NULL ORDER BY s.id",
        )
        .fetch_all(self.readers())
        .await?;
        let off = shots.iter().filter_map(|shot| {
            let settings: Value = shot
                .settings
                .as_deref()
                .and_then(|text| serde_json::from_str(text).ok())
                .unwrap_or_default();
            // The largest tolerance that settings may state, where the row has none.
            let tolerance = |axis: &str| {
                let stated = settings["stages"][axis]["tolerance_deg"].as_f64();
                stated.unwrap_or(1.0) + SLACK_DEG
            };
            let tilt = (shot.theta_c_deg - shot.asked_theta_c_deg).abs();
            // The same azimuth in another turn is the same pose.
            let turn = (shot.phi_s_deg - shot.asked_phi_s_deg).rem_euclid(360.0);
            let turn = turn.min(360.0 - turn);
            let fits = tilt <= tolerance("theta_c") && turn <= tolerance("phi_s");
            (!fits).then(|| Discrepancy {
                scan_id: shot.scan_id,
                problem: format!(
                    "point {} was taken at θc {:.4}°, φs {:.4}°, but the plan asks for θc {:.4}°, φs {:.4}°",
                    shot.plan_index,
                    shot.theta_c_deg,
                    shot.phi_s_deg,
                    shot.asked_theta_c_deg,
                    shot.asked_phi_s_deg
                ),
            })
        });
        Ok(off.collect())
    }
}

impl Pair {
    fn problem(&self) -> String {
        if !self.same_otherwise {
            return format!(
                "frame {} has another kind, scan or acceptance than its shot",
                self.id
            );
        }
        format!(
            "frame {} states θc {:.4}°, φs {:.4}°, but the position read back at its shot is θc {:.4}°, φs {:.4}°",
            self.id,
            self.frame_theta_c_deg,
            self.frame_phi_s_deg,
            self.shot_theta_c_deg,
            self.shot_phi_s_deg
        )
    }
}

#[cfg(test)]
mod tests {
    use crate::store::scans::tests::planned;
    use crate::store::shots::tests::commit;
    use crate::store::tests::{damage, open};

    #[tokio::test]
    async fn a_sound_store_has_nothing_to_report() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        commit(&store, scan.id, 0).await;
        commit(&store, scan.id, 1).await;
        assert!(store.check_database().await.unwrap().is_empty());
        let seen = std::cell::Cell::new((0, 0));
        let audit = store.audit(true, |done, of| seen.set((done, of)));
        let audit = audit.await.unwrap();
        assert_eq!(audit.discrepancies, []);
        assert_eq!((audit.frames, seen.get()), (2, (2, 2)));
        assert!(audit.bytes_read > 0);
    }

    #[tokio::test]
    async fn changed_files_and_changed_rows_are_found_each_by_its_frame() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let sha256 = commit(&store, scan.id, 0).await;
        let path = store.frame_path(&sha256);
        let mut content = std::fs::read(&path).unwrap();
        content[60] ^= 1;
        std::fs::write(&path, &content).unwrap();
        let shallow = store.audit(false, |_, _| ()).await.unwrap();
        assert_eq!(shallow.discrepancies, []);
        let deep = store.audit(true, |_, _| ()).await.unwrap();
        assert_eq!(deep.discrepancies.len(), 1);
        assert!(deep.discrepancies[0].problem.contains("its hash differs"));
        content[60] ^= 1;
        std::fs::write(&path, &content).unwrap();

        // One bit of an angle, which a fit must not read either.
        damage(&store, "frames", "theta_c_deg = 8.0", 1).await;
        let audit = store.audit(false, |_, _| ()).await.unwrap();
        assert_eq!(audit.discrepancies.len(), 1);
        let problem = &audit.discrepancies[0].problem;
        assert!(
            problem.contains("frame 1 states θc 8.0000°") && problem.contains("10.0010°"),
            "{problem}"
        );
        let refused = store.frames_for_reduction(scan.id).await.unwrap_err();
        assert!(refused.to_string().contains("frame 1 states"), "{refused}");

        // Both rows changed alike: the plan's own pose is left.
        damage(&store, "shots", "theta_c_deg = 8.0", 1).await;
        let audit = store.audit(false, |_, _| ()).await.unwrap();
        let problem = &audit.discrepancies[0].problem;
        assert!(
            problem.contains("the plan asks for θc 10.0000°"),
            "{problem}"
        );
    }

    #[tokio::test]
    async fn a_missing_file_is_found_without_reading_the_others() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let sha256 = commit(&store, scan.id, 0).await;
        std::fs::remove_file(store.frame_path(&sha256)).unwrap();
        let audit = store.audit(false, |_, _| ()).await.unwrap();
        assert!(audit.discrepancies[0].problem.contains("is missing"));
    }
}
