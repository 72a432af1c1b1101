//! Files that clients send: received part by part into the data folder, and deleted once they are used.

use std::path::{Path, PathBuf};

use tempfile::TempDir;
use tokio::fs::File;
use tokio::io::AsyncWriteExt;

use super::import::SERIES;
use crate::lab::{Lab, LabError};
use crate::store::{Store, StoreError};

/// Folder of received files in the data folder.
const UPLOADS: &str = "uploads";
/// Bytes between two checks of the free space.
const CHECKED_EVERY_BYTES: u64 = 16 << 20;

/// A file that a client sends. It is deleted when it is dropped, or at the next start.
pub struct ReceivedFile {
    lab: Lab,
    file: File,
    path: PathBuf,
    place: TempDir,
    /// Bytes that the last check of the free space allows.
    allowed: u64,
}

impl Lab {
    /// Makes a folder for received files.
    pub(in crate::lab) fn upload_place(&self) -> Result<TempDir, StoreError> {
        let uploads = self.store().folder().join(UPLOADS);
        std::fs::create_dir_all(&uploads)
            .and_then(|()| tempfile::tempdir_in(&uploads))
            .map_err(|source| StoreError::file("the folder", uploads, source))
    }

    /// Begins to receive a file of this plain name.
    ///
    /// # Errors
    /// A file that cannot be made.
    pub async fn receive(&self, name: &str) -> Result<ReceivedFile, LabError> {
        let place = self.upload_place()?;
        let path = place.path().join(name);
        let file = File::create_new(&path).await;
        Ok(ReceivedFile {
            file: file.map_err(|source| StoreError::file("the file", &path, source))?,
            lab: self.clone(),
            path,
            place,
            allowed: 0,
        })
    }
}

impl ReceivedFile {
    /// Adds a part. The reserve of the disk stays free.
    ///
    /// # Errors
    /// [`LabError::NoRoomFor`], or a file that cannot be written.
    pub async fn add(&mut self, part: &[u8]) -> Result<(), LabError> {
        let bytes = part.len() as u64;
        if bytes > self.allowed {
            self.allowed = bytes + CHECKED_EVERY_BYTES;
            self.lab.check_room(SERIES, self.allowed).await?;
        }
        self.allowed -= bytes;
        let written = self.file.write_all(part).await;
        written.map_err(|source| self.failed(source))
    }

    /// Ends the file.
    ///
    /// # Errors
    /// A file that cannot be written.
    pub async fn end(&mut self) -> Result<(), LabError> {
        let flushed = self.file.flush().await;
        flushed.map_err(|source| self.failed(source))
    }

    fn failed(&self, source: std::io::Error) -> LabError {
        StoreError::file("the file", &self.path, source).into()
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Deletes it.
    pub async fn discard(self) {
        tokio::task::spawn_blocking(move || drop(self.place))
            .await
            .ok();
    }
}

/// Deletes what a process that was killed left.
pub(in crate::lab) async fn discard_all(store: &Store) {
    let uploads = store.folder().join(UPLOADS);
    let deleted = tokio::task::spawn_blocking(move || match std::fs::remove_dir_all(&uploads) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            tracing::warn!(%error, "{} cannot be deleted: {error}", uploads.display());
        }
        _ => {}
    });
    deleted.await.ok();
}
