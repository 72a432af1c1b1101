//! The only interface between the store and a disk, so that tests can fill the disk or make it fail.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::SystemTime;

/// The disk operations that the store needs for its frame files.
pub trait Disk: Send + Sync + 'static {
    /// Writes `bytes` to `path`. After success the whole file survives a power cut; after a failure or a kill `path`
    /// does not exist. Creates the folder of `path` if it is missing, but none above it.
    ///
    /// # Errors
    /// An I/O error; a full disk is [`io::ErrorKind::StorageFull`].
    fn write_durably(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;

    /// Returns the bytes that this process may still write below `folder`.
    ///
    /// # Errors
    /// An I/O error.
    fn free_bytes(&self, folder: &Path) -> io::Result<u64>;

    /// Changes the time of a file: returns as soon as the disk has answered, whatever it says.
    fn ask(&self, file: &Path) {
        if let Ok(file) = File::open(file) {
            file.set_modified(SystemTime::now()).ok();
        }
    }
}

/// The operating system's own disk.
#[derive(Debug, Clone, Copy, Default)]
pub struct RealDisk;

/// Extension of a file that is being written; a leftover file is half a frame.
pub const PART_SUFFIX: &str = "part";

/// Returns a temporary name that no other write of this process uses: two frames of the same content (a stuck camera)
/// may be written to the same `path` at the same time.
fn part_of(path: &Path) -> PathBuf {
    static WRITES: AtomicU64 = AtomicU64::new(0);
    let number = WRITES.fetch_add(1, Ordering::Relaxed);
    path.with_extension(format!("{number}.{PART_SUFFIX}"))
}

/// Creates `folder` durably if it is missing. Concurrent callers wait until it exists.
fn make_folder(folder: &Path) -> io::Result<()> {
    static MAKING: Mutex<()> = Mutex::new(());
    let _alone = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
    if folder.is_dir() {
        return Ok(());
    }
    // Only this folder: a missing one above it means that the data folder is gone.
    fs::create_dir(folder)?;
    match folder.parent() {
        Some(above) => File::open(above)?.sync_all(),
        None => Ok(()),
    }
}

impl Disk for RealDisk {
    fn write_durably(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let folder = path
            .parent()
            .ok_or_else(|| io::Error::other("a frame's path has a folder"))?;
        make_folder(folder)?;
        let part = part_of(path);
        let written = (|| {
            let mut file = OpenOptions::new()
                .write(true)
                .create(true)
                .truncate(true)
                .open(&part)?;
            file.write_all(bytes)?;
            file.sync_all()?;
            fs::rename(&part, path)?;
            File::open(folder)?.sync_all()
        })();
        if written.is_err() {
            // Best effort: the next start moves a leftover file to quarantine.
            fs::remove_file(&part).ok();
        }
        written
    }

    fn free_bytes(&self, folder: &Path) -> io::Result<u64> {
        let stat = rustix::fs::statvfs(folder)?;
        Ok(stat.f_bavail.saturating_mul(stat.f_frsize))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_written_file_is_whole_and_leaves_no_part_behind() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ab/cd.png");
        RealDisk.write_durably(&path, b"counts").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"counts");
        let left = fs::read_dir(folder.path().join("ab")).unwrap().count();
        assert_eq!(left, 1);
    }

    #[test]
    fn the_same_content_may_be_written_many_times_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("ab/cd.png");
        let bytes = vec![7; 1 << 16];
        std::thread::scope(|scope| {
            let writers: Vec<_> = (0..8)
                .map(|_| {
                    scope.spawn(|| (0..20).try_for_each(|_| RealDisk.write_durably(&path, &bytes)))
                })
                .collect();
            for writer in writers {
                writer.join().unwrap().unwrap();
            }
        });
        assert_eq!(fs::read(&path).unwrap(), bytes);
        assert_eq!(fs::read_dir(folder.path().join("ab")).unwrap().count(), 1);
    }

    #[test]
    fn free_space_is_known() {
        let folder = tempfile::tempdir().unwrap();
        assert!(RealDisk.free_bytes(folder.path()).unwrap() > 0);
    }
}
