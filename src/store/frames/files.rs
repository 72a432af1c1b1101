//! Frame files: named by their content, durable before a row names them, checked when they are read.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

use crate::frame::{FileKind, Frame};
use crate::store::holds::Hold;
use crate::store::{Store, StoreError};
use crate::wording::hex;

/// A durable frame file that no row names yet.
#[derive(Debug, Clone, PartialEq)]
pub struct KeptFile {
    /// Content hash, in hex; the file's name.
    pub sha256: String,
    /// Size of the file.
    pub bytes: u64,
    /// Width of the image.
    pub width_px: u32,
    /// Height of the image.
    pub height_px: u32,
    /// Mean count.
    pub mean_dn: f64,
    /// Largest count.
    pub max_dn: u16,
    /// Pixels at or above the saturation level.
    pub saturated_px: u32,
    hold: Hold,
}

/// Returns the SHA-256 of `bytes` in hex.
#[must_use]
pub fn sha256_hex(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// Returns the path of a content hash's file, relative to the store's folder.
pub(in crate::store) fn relative_path(sha256: &str) -> PathBuf {
    let (folder, name) = sha256.split_at(sha256.len().min(2));
    Path::new("frames").join(folder).join(format!("{name}.png"))
}

impl Store {
    /// Makes a frame durable and returns what its row needs. Encodes and writes on a thread for blocking work.
    ///
    /// # Errors
    /// [`StoreError::DiskFull`], [`StoreError::FolderGone`], [`StoreError::Frame`] or [`StoreError::File`].
    pub async fn keep_frame(
        &self,
        frame: Frame,
        saturation_dn: u16,
    ) -> Result<KeptFile, StoreError> {
        let store = self.clone();
        blocking(move || {
            let png = frame.to_png()?;
            store.keep_file(&png, &frame, saturation_dn)
        })
        .await
    }

    /// Checks a recorded frame and makes it durable: a PNG byte for byte, a TIFF as the PNG of the same counts. Also
    /// returns the content hash of a TIFF.
    ///
    /// # Errors
    /// [`StoreError::Frame`] if it is not a 16-bit grey image, [`StoreError::DiskFull`] or [`StoreError::File`].
    pub async fn keep_recorded(
        &self,
        file: Vec<u8>,
        saturation_dn: u16,
    ) -> Result<(KeptFile, Option<String>), StoreError> {
        let store = self.clone();
        blocking(move || {
            let frame = Frame::read(&file)?;
            let (png, original) = match FileKind::of(&file) {
                FileKind::Png => (file, None),
                _ => (frame.to_png()?, Some(sha256_hex(&file))),
            };
            Ok((store.keep_file(&png, &frame, saturation_dn)?, original))
        })
        .await
    }

    fn keep_file(
        &self,
        png: &[u8],
        frame: &Frame,
        saturation_dn: u16,
    ) -> Result<KeptFile, StoreError> {
        let sha256 = sha256_hex(png);
        let path = self.folder().join(relative_path(&sha256));
        let hold = self.inner.holds.take(&sha256);
        self.check_folder()?;
        // A file of this name has this content, unless the disk lost some of it: then it is written again.
        if std::fs::read(&path).is_ok_and(|kept| kept == png) {
            tracing::debug!(sha256, "frame {sha256} is already stored");
        } else {
            self.inner
                .disk
                .write_durably(&path, png)
                .map_err(|e| StoreError::file("the frame file", &path, e))?;
            if let Err(gone) = self.check_folder() {
                // It went between the two checks: the file is in a folder that is not the store's.
                std::fs::remove_file(&path).ok();
                return Err(gone);
            }
        }
        let pixels = frame.pixels_dn();
        let sum: u64 = pixels.iter().map(|dn| u64::from(*dn)).sum();
        Ok(KeptFile {
            sha256,
            bytes: png.len() as u64,
            width_px: frame.width_px(),
            height_px: frame.height_px(),
            mean_dn: sum as f64 / pixels.len() as f64,
            max_dn: pixels.iter().copied().max().unwrap_or(0),
            saturated_px: pixels.iter().filter(|dn| **dn >= saturation_dn).count() as u32,
            hold,
        })
    }

    /// Deletes files that will get no row, unless another row names them or another writer is about to. The next start
    /// moves files that could not be deleted to quarantine.
    ///
    /// # Errors
    /// A database error; then nothing is deleted.
    pub async fn discard(&self, kept: Vec<KeptFile>) -> Result<(), StoreError> {
        let mut own: HashMap<&str, usize> = HashMap::new();
        for file in &kept {
            *own.entry(&file.sha256).or_default() += 1;
        }
        own.retain(|sha256, count| self.inner.holds.watch(sha256, *count));
        for sha256 in own.into_keys() {
            let named: Option<i64> =
                sqlx::query_scalar("SELECT id FROM frames WHERE sha256 = ? LIMIT 1")
                    .bind(sha256)
                    .fetch_optional(self.readers())
                    .await?;
            if named.is_none() {
                let path = self.folder().join(relative_path(sha256));
                self.inner
                    .holds
                    .if_untouched(sha256, || drop(std::fs::remove_file(path)));
            }
        }
        Ok(())
    }

    /// Returns the absolute path of a frame's file.
    #[must_use]
    pub fn frame_path(&self, sha256: &str) -> PathBuf {
        let path = self.folder().join(relative_path(sha256));
        std::path::absolute(&path).unwrap_or(path)
    }

    /// Reads a frame file and checks its hash. Blocks.
    ///
    /// # Errors
    /// [`StoreError::FrameDamaged`] if the file is missing or has changed.
    pub fn read_png(&self, sha256: &str) -> Result<Vec<u8>, StoreError> {
        let path = self.folder().join(relative_path(sha256));
        let damaged = |problem: String| StoreError::FrameDamaged {
            sha256: sha256.into(),
            problem,
        };
        let bytes = std::fs::read(&path).map_err(|e| damaged(format!("cannot be read ({e})")))?;
        if sha256_hex(&bytes) != sha256 {
            return Err(damaged("has changed (its hash differs)".into()));
        }
        Ok(bytes)
    }
}

async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, StoreError> + Send + 'static,
) -> Result<T, StoreError> {
    tokio::task::spawn_blocking(work)
        .await
        .expect("keeping a frame does not panic")
}
