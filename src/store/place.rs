//! Whether the data folder is still the one that was opened.
//!
//! A folder that is deleted, unmounted or replaced takes files and rows without an error: SQLite writes to the file it
//! holds open, and a path leads to whatever is there now. So device and inode of the folder, of its frames, of the
//! database and of its log are compared with those at the opening, before anything is written and before each commit. A disk
//! that the system has made read-only after a fault is found there, too.

use std::fs;
use std::io::ErrorKind;
use std::ops::{Deref, DerefMut};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustix::fs::StatVfsMountFlags;
use sqlx::sqlite::SqliteConnection;
use sqlx::{Sqlite, Transaction};

use super::{DATABASE, LOG, StoreError};

/// Device and inode of the parts of a data folder.
#[derive(Debug)]
pub(super) struct Place {
    parts: [(&'static str, PathBuf, FileId); 4],
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct FileId {
    device: u64,
    inode: u64,
}

impl FileId {
    fn of(path: &Path) -> std::io::Result<FileId> {
        let found = fs::metadata(path)?;
        Ok(FileId {
            device: found.dev(),
            inode: found.ino(),
        })
    }
}

impl Place {
    /// Remembers the folder as it is now.
    ///
    /// # Errors
    /// An I/O error.
    pub fn of(folder: &Path) -> Result<Place, StoreError> {
        let part = |what: &'static str, path: PathBuf| match FileId::of(&path) {
            Ok(id) => Ok((what, path, id)),
            Err(error) => Err(StoreError::file(what, &path, error)),
        };
        Ok(Place {
            parts: [
                part("the data folder", folder.into())?,
                part("the frame folder", folder.join("frames"))?,
                part("the database", folder.join(DATABASE))?,
                part("the log of the database", folder.join(LOG))?,
            ],
        })
    }

    /// Compares the folder with the one that was opened.
    ///
    /// # Errors
    /// [`StoreError::FolderGone`] names the first part that is not there or is another one.
    pub fn check(&self) -> Result<(), StoreError> {
        for (what, path, opened) in &self.parts {
            let problem = match FileId::of(path) {
                Ok(now) if now == *opened => continue,
                Ok(now) if now.device != opened.device => {
                    "is on another disk than at the start (it was unmounted, or another disk was mounted over it)".into()
                }
                Ok(_) => "was replaced by another one".into(),
                Err(error) if error.kind() == ErrorKind::NotFound => {
                    "was deleted, moved or unmounted".into()
                }
                Err(error) => format!("cannot be reached ({error})"),
            };
            return Err(gone(what, path, problem));
        }
        let (what, folder, _) = &self.parts[0];
        match rustix::fs::statvfs(folder) {
            Ok(disk) if disk.f_flag.contains(StatVfsMountFlags::RDONLY) => {
                Err(gone(what, folder, "became read-only".into()))
            }
            // The next write reports what is wrong.
            _ => Ok(()),
        }
    }
}

fn gone(what: &'static str, path: &Path, problem: String) -> StoreError {
    StoreError::FolderGone {
        what,
        path: path.into(),
        problem,
    }
}

/// A transaction that writes: it commits only while the folder is the one that was opened.
pub(super) struct Writing {
    transaction: Transaction<'static, Sqlite>,
    place: Arc<Place>,
}

impl Writing {
    pub fn new(transaction: Transaction<'static, Sqlite>, place: Arc<Place>) -> Writing {
        Writing { transaction, place }
    }

    /// Commits.
    ///
    /// # Errors
    /// [`StoreError::FolderGone`]; then nothing is written. Or a database error.
    pub async fn commit(self) -> Result<(), StoreError> {
        let place = self.place;
        super::asked(move || place.check()).await?;
        Ok(self.transaction.commit().await?)
    }
}

impl Deref for Writing {
    type Target = SqliteConnection;

    fn deref(&self) -> &SqliteConnection {
        &self.transaction
    }
}

impl DerefMut for Writing {
    fn deref_mut(&mut self) -> &mut SqliteConnection {
        &mut self.transaction
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;
    use crate::scan::Event;
    use crate::store::Store;
    use crate::store::scans::tests::planned;
    use crate::store::shots::tests::commit;
    use crate::store::tests::open;

    fn alarm() -> Event {
        Event::Alarm {
            code: "a".into(),
            message: "look".into(),
            scan_id: None,
        }
    }

    async fn refuses_everything(store: &Store, words: &str) {
        let refused = store.record(alarm()).await.unwrap_err();
        assert!(
            matches!(refused, StoreError::FolderGone { .. }),
            "{refused}"
        );
        assert!(refused.to_string().contains(words), "{refused}");
        let frame = Frame::new(2, 2, vec![9, 8, 7, 6]).unwrap();
        store.keep_frame(frame, 65535).await.unwrap_err();
        store.free_bytes().await.unwrap_err();
        store.check_commits().await.unwrap_err();
    }

    #[tokio::test]
    async fn a_deleted_folder_is_named_and_not_made_again() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("data");
        let (store, _) = open(&folder).await.unwrap();
        let scan = planned(&store).await;
        commit(&store, scan.id, 0).await;
        fs::remove_dir_all(&folder).unwrap();
        refuses_everything(&store, "deleted").await;
        assert!(!folder.exists());
    }

    #[tokio::test]
    async fn a_replaced_folder_gets_neither_rows_nor_frames_and_the_first_one_is_used_again() {
        let parent = tempfile::tempdir().unwrap();
        let (folder, away) = (parent.path().join("data"), parent.path().join("away"));
        let (store, _) = open(&folder).await.unwrap();
        let scan = planned(&store).await;
        fs::rename(&folder, &away).unwrap();
        // What a mount over the folder looks like: the same names, other files.
        let (other, _) = open(&folder).await.unwrap();
        other.close().await;
        let before = fs::read(folder.join(DATABASE)).unwrap();
        refuses_everything(&store, "replaced").await;
        assert_eq!(fs::read(folder.join(DATABASE)).unwrap(), before);
        assert_eq!(fs::read_dir(folder.join("frames")).unwrap().count(), 0);
        fs::remove_dir_all(&folder).unwrap();
        fs::rename(&away, &folder).unwrap();
        store.record(alarm()).await.unwrap();
        commit(&store, scan.id, 0).await;
        store.check_commits().await.unwrap();
    }

    #[tokio::test]
    async fn a_log_that_is_moved_away_is_noticed() {
        let parent = tempfile::tempdir().unwrap();
        let (store, _) = open(parent.path()).await.unwrap();
        let (log, away) = (parent.path().join(LOG), parent.path().join("away"));
        fs::rename(&log, &away).unwrap();
        refuses_everything(&store, "the log of the database").await;
        fs::rename(&away, &log).unwrap();
        store.record(alarm()).await.unwrap();
    }

    #[tokio::test]
    async fn a_folder_that_goes_within_a_transaction_keeps_nothing_of_it() {
        let parent = tempfile::tempdir().unwrap();
        let folder = parent.path().join("data");
        let (store, _) = open(&folder).await.unwrap();
        let mut transaction = store.writing().await.unwrap();
        store.record_in(&mut transaction, alarm()).await.unwrap();
        let database = folder.join(DATABASE);
        fs::rename(&database, folder.join("moved.sqlite")).unwrap();
        let refused = transaction.commit().await.unwrap_err();
        assert!(refused.to_string().contains("the database"), "{refused}");
        fs::rename(folder.join("moved.sqlite"), &database).unwrap();
        assert_eq!(store.last_event_id().await.unwrap(), 0);
    }
}
