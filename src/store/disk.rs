//! The one seam between the store and a disk, so that tests can fill it or break it.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;

/// What the store asks of a disk for its frame files.
pub trait Disk: Send + Sync + 'static {
    /// Writes `bytes` to `path` so that after success the whole file survives a power cut, and
    /// after a failure or a kill `path` does not exist. Folders are made as needed.
    ///
    /// # Errors
    /// What the operating system says; a full disk is [`io::ErrorKind::StorageFull`].
    fn write_durably(&self, path: &Path, bytes: &[u8]) -> io::Result<()>;

    /// Bytes that this process may still write below `folder`.
    ///
    /// # Errors
    /// What the operating system says.
    fn free_bytes(&self, folder: &Path) -> io::Result<u64>;
}

/// The operating system's own disk.
#[derive(Debug, Clone, Copy, Default)]
pub struct RealDisk;

/// Name ending of a file that is being written; one that is left over is a half frame.
pub const PART_SUFFIX: &str = "part";

impl Disk for RealDisk {
    fn write_durably(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let folder = path
            .parent()
            .ok_or_else(|| io::Error::other("a frame's path has a folder"))?;
        if !folder.is_dir() {
            fs::create_dir_all(folder)?;
            if let Some(above) = folder.parent() {
                File::open(above)?.sync_all()?;
            }
        }
        let part = path.with_extension(PART_SUFFIX);
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
            // Best effort: what cannot be removed now is quarantined at the next start.
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
        assert!(!path.with_extension(PART_SUFFIX).exists());
    }

    #[test]
    fn free_space_is_known() {
        let folder = tempfile::tempdir().unwrap();
        assert!(RealDisk.free_bytes(folder.path()).unwrap() > 0);
    }
}
