//! Recovery at a start after a kill; committed data are not touched.

use std::collections::HashMap;
use std::fs;
use std::io::ErrorKind;
use std::path::Path;

use super::frames::{relative_path, sha256_hex};
use super::{Store, StoreError};
use crate::job::JobId;
use crate::scan::{RecordedEvent, ScanState};

/// What a start found and did.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Recovery {
    /// Files that no row names, moved to `quarantine/`: half-written frames and frames without a commit.
    pub quarantined: Vec<String>,
    /// Frames that were in `quarantine/` although a row names them, moved back.
    pub restored: Vec<String>,
    /// Frames whose file is missing or has another size than the row says.
    pub damaged: Vec<String>,
    /// Scans that were running and are now marked interrupted.
    pub interrupted_scans: Vec<i64>,
    /// Jobs that were running and are now marked interrupted.
    pub interrupted_jobs: Vec<JobId>,
    /// The events of these changes.
    pub events: Vec<RecordedEvent>,
}

impl Store {
    pub(super) async fn recover(&self) -> Result<Recovery, StoreError> {
        let mut found = Recovery::default();
        let rows: Vec<(String, i64)> =
            sqlx::query_as("SELECT sha256, MAX(bytes) FROM frames GROUP BY sha256")
                .fetch_all(self.writer())
                .await?;
        let rows: HashMap<String, u64> = rows
            .into_iter()
            .map(|(sha256, bytes)| (sha256, bytes as u64))
            .collect();
        let mut present = HashMap::new();
        self.sweep(&rows, &mut present, &mut found)
            .map_err(|e| StoreError::file("the frame folder", self.folder().join("frames"), e))?;
        self.take_back(&rows, &mut present, &mut found)
            .map_err(|e| StoreError::file("the quarantine", self.folder().join("quarantine"), e))?;
        for (sha256, bytes) in &rows {
            if present.get(sha256) != Some(bytes) {
                found.damaged.push(sha256.clone());
            }
        }
        found.damaged.sort();

        let open: Vec<i64> = sqlx::query_scalar(
            "SELECT scan_id FROM scan_states WHERE id IN (SELECT MAX(id) FROM scan_states GROUP BY scan_id)
             AND state IN ('planned', 'waiting-for-operator', 'running', 'pausing', 'paused') ORDER BY scan_id",
        )
        .fetch_all(self.writer())
        .await?;
        for scan_id in open {
            let progress = self.last_progress(scan_id).await?;
            let reason = "the daemon ended during the scan";
            let event = self
                .change_state(
                    scan_id,
                    ScanState::Interrupted,
                    Some(reason),
                    None,
                    progress,
                )
                .await?;
            found.events.push(event);
            found.interrupted_scans.push(scan_id);
        }
        let (jobs, events) = self.interrupt_jobs().await?;
        found.interrupted_jobs = jobs;
        found.events.extend(events);
        Ok(found)
    }

    /// Lists every file below `frames/` and moves those that no row names to quarantine.
    fn sweep(
        &self,
        rows: &HashMap<String, u64>,
        present: &mut HashMap<String, u64>,
        found: &mut Recovery,
    ) -> std::io::Result<()> {
        for folder in fs::read_dir(self.folder().join("frames"))? {
            let folder = folder?.path();
            if !folder.is_dir() {
                continue;
            }
            let prefix = file_name(&folder);
            for file in fs::read_dir(&folder)? {
                let file = file?;
                let path = file.path();
                let name = file_name(&path);
                let sha256 = format!("{prefix}{}", name.strip_suffix(".png").unwrap_or(&name));
                if name.ends_with(".png") && rows.contains_key(&sha256) {
                    present.insert(sha256, file.metadata()?.len());
                } else {
                    let quarantine = self.folder().join("quarantine");
                    fs::create_dir_all(&quarantine)?;
                    fs::rename(&path, quarantine.join(format!("{prefix}{name}")))?;
                    found.quarantined.push(format!("{prefix}{name}"));
                }
            }
        }
        found.quarantined.sort();
        Ok(())
    }

    /// Moves frames back from quarantine if a row names them. A start with an older copy of the database quarantines the
    /// frames of the newer one; a start with the newer one brings them back.
    fn take_back(
        &self,
        rows: &HashMap<String, u64>,
        present: &mut HashMap<String, u64>,
        found: &mut Recovery,
    ) -> std::io::Result<()> {
        let quarantine = self.folder().join("quarantine");
        if !quarantine.is_dir() {
            return Ok(());
        }
        for (sha256, bytes) in rows {
            if present.get(sha256) == Some(bytes) {
                continue;
            }
            let away = quarantine.join(format!("{sha256}.png"));
            let content = match fs::read(&away) {
                Ok(content) => content,
                Err(error) if error.kind() == ErrorKind::NotFound => continue,
                Err(error) => return Err(error),
            };
            if sha256_hex(&content) != *sha256 {
                continue;
            }
            let home = self.folder().join(relative_path(sha256));
            let folder = home.parent().unwrap_or(self.folder());
            fs::create_dir_all(folder)?;
            fs::rename(&away, &home)?;
            fs::File::open(folder)?.sync_all()?;
            present.insert(sha256.clone(), content.len() as u64);
            found.restored.push(sha256.clone());
        }
        found.restored.sort();
        Ok(())
    }
}

fn file_name(path: &Path) -> String {
    path.file_name()
        .map(|name| name.to_string_lossy().into_owned())
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;
    use crate::scan::Progress;
    use crate::store::scans::tests::planned;
    use crate::store::shots::tests::commit;
    use crate::store::tests::open;

    #[tokio::test]
    async fn a_kill_loses_nothing_committed_and_leaves_nothing_half_written() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        store
            .change_state(scan.id, ScanState::Running, None, None, Progress::default())
            .await
            .unwrap();
        let committed = commit(&store, scan.id, 0).await;
        // A frame without a row, and a half-written one.
        let orphan = store
            .keep_frame(Frame::new(1, 1, vec![7]).unwrap(), 65535)
            .await
            .unwrap();
        fs::write(
            folder
                .path()
                .join("frames")
                .join(&committed[..2])
                .join("half.part"),
            b"x",
        )
        .unwrap();
        store.close().await;
        drop(store);

        let (store, found) = open(folder.path()).await.unwrap();
        assert_eq!(found.interrupted_scans, [scan.id]);
        assert_eq!(found.quarantined.len(), 2);
        assert!(
            found
                .quarantined
                .contains(&format!("{}.png", orphan.sha256))
        );
        assert_eq!(found.damaged, Vec::<String>::new());
        assert_eq!(
            store.scan(scan.id).await.unwrap().state,
            ScanState::Interrupted
        );
        store.read_png(&committed).unwrap();
        let events = store.events_after(0, 100).await.unwrap();
        assert_eq!(events.last(), found.events.last());
    }

    #[tokio::test]
    async fn frames_without_a_database_are_left_where_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let sha256 = commit(&store, scan.id, 0).await;
        store.close().await;
        drop(store);
        let database = folder.path().join("ridged.sqlite");
        let copy = folder.path().join("copy.sqlite");
        fs::rename(&database, &copy).unwrap();
        for made in [false, true] {
            if made {
                fs::write(&database, b"").unwrap();
            }
            let refused = open(folder.path()).await.unwrap_err();
            assert!(
                matches!(refused, StoreError::RowsMissing { .. }),
                "{refused}"
            );
            assert!(refused.to_string().contains("restore"), "{refused}");
            assert_eq!(database.exists(), made);
            assert!(folder.path().join(relative_path(&sha256)).is_file());
        }
        // The remedy that the message names.
        fs::rename(&copy, &database).unwrap();
        let (_, found) = open(folder.path()).await.unwrap();
        assert_eq!((found.damaged.len(), found.quarantined.len()), (0, 0));
    }

    #[tokio::test]
    async fn a_frame_comes_back_from_quarantine_with_the_row_that_names_it() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        store.close().await;
        drop(store);
        let database = folder.path().join("ridged.sqlite");
        let older = fs::read(&database).unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let sha256 = commit(&store, scan.id, 0).await;
        store.close().await;
        drop(store);
        let newer = fs::read(&database).unwrap();
        // An older copy of the database does not know the frame; the newer one does.
        fs::write(&database, older).unwrap();
        let (store, found) = open(folder.path()).await.unwrap();
        assert_eq!(found.quarantined, [format!("{sha256}.png")]);
        store.close().await;
        drop(store);
        fs::write(&database, newer).unwrap();
        let (store, found) = open(folder.path()).await.unwrap();
        assert_eq!(found.restored, std::slice::from_ref(&sha256));
        assert_eq!(found.damaged, Vec::<String>::new());
        store.read_png(&sha256).unwrap();
    }

    #[tokio::test]
    async fn a_frame_without_its_file_is_reported() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let scan = planned(&store).await;
        let sha256 = commit(&store, scan.id, 0).await;
        store.close().await;
        drop(store);
        fs::remove_dir_all(folder.path().join("frames").join(&sha256[..2])).unwrap();
        let (_, found) = open(folder.path()).await.unwrap();
        assert_eq!(found.damaged, [sha256]);
    }
}
