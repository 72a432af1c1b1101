//! The lock of a data folder: one process at a time writes.
//!
//! The process locks the folder itself, which is there as long as it is in use, and the file `lock`, which names the process
//! and is the lock of earlier programs. Where the file is deleted, the folder stays locked.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Seek, Write};
use std::path::Path;

use super::StoreError;

/// Name of the file.
pub(super) const FILE: &str = "lock";

/// Locks a folder until it is dropped, or its process ends.
#[derive(Debug)]
pub(super) struct Lock {
    _folder: File,
    _file: File,
}

impl Lock {
    /// Locks a folder for this process.
    ///
    /// # Errors
    /// [`StoreError::InUse`] if another process has it, or an I/O error.
    pub fn take(folder: &Path) -> Result<Lock, StoreError> {
        let hold = |what: &'static str, path: &Path, file: &File| match file.try_lock() {
            Ok(()) => Ok(()),
            Err(TryLockError::WouldBlock) => Err(StoreError::InUse {
                folder: folder.into(),
                holder: holder(folder),
            }),
            Err(TryLockError::Error(e)) => Err(StoreError::file(what, path, e)),
        };
        let what = "the data folder";
        let opened = File::open(folder).map_err(|e| StoreError::file(what, folder, e))?;
        hold(what, folder, &opened)?;
        let (what, path) = ("the lock file", folder.join(FILE));
        let error = |e| StoreError::file(what, &path, e);
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(error)?;
        hold(what, &path, &file)?;
        // The operating system holds the lock; the text is for people.
        file.set_len(0).map_err(error)?;
        file.rewind().map_err(error)?;
        // On a full disk the text stays empty; the check for room reports it.
        writeln!(file, "process {}", std::process::id()).ok();
        Ok(Lock {
            _folder: opened,
            _file: file,
        })
    }

    /// Returns whether a process has locked a folder. Those who ask at the same time do not see each other.
    pub fn is_held(folder: &Path) -> bool {
        [folder.to_owned(), folder.join(FILE)]
            .iter()
            .filter_map(|path| File::open(path).ok())
            .any(|file| matches!(file.try_lock_shared(), Err(TryLockError::WouldBlock)))
    }
}

/// What the file says about the process that holds the folder.
fn holder(folder: &Path) -> String {
    let text = std::fs::read_to_string(folder.join(FILE)).unwrap_or_default();
    match text.trim() {
        "" => "its process is not known".to_owned(),
        text => text.to_owned(),
    }
}
