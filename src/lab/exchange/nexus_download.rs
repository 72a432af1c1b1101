//! A NeXus file that the daemon writes to send it: beside the store, without a name.

use std::fs::File;
use std::io::Read;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::nexus::NexusFile;
use crate::lab::tasks::{blocking, for_a_download};
use crate::lab::{Lab, LabError};

/// Bytes of a part of a file that is sent.
const PART_BYTES: u64 = 1 << 20;

/// A NeXus file that is sent part by part. It has no name, so it is gone when it is dropped.
#[derive(Debug)]
pub struct NexusDownload {
    file: File,
    bytes: u64,
}

impl NexusDownload {
    /// Size of the file.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Reads the next part; `None` at the end.
    ///
    /// # Errors
    /// The disk cannot be read.
    pub async fn next(mut self) -> Result<Option<(Vec<u8>, NexusDownload)>, LabError> {
        blocking(move || {
            let mut part = Vec::new();
            let read = (&mut self.file).take(PART_BYTES).read_to_end(&mut part);
            read.map_err(|error| {
                LabError::Export(format!("the NeXus file cannot be read: {error}"))
            })?;
            Ok((!part.is_empty()).then_some((part, self)))
        })
        .await?
    }
}

impl Lab {
    /// Writes a scan as a NeXus file beside the store, to be sent.
    ///
    /// # Errors
    /// As [`NexusFile::open`] and [`NexusFile::write`]; [`LabError::NoRoomFor`].
    pub async fn nexus_download(&self, scan_id: i64) -> Result<NexusDownload, LabError> {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        let nexus = NexusFile::open(self.store(), scan_id).await?;
        self.check_room("the NeXus file", nexus.bytes_max()).await?;
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let name = format!(".nexus-{}-{number}.part", std::process::id());
        let path = self.store().folder().join(name);
        for_a_download(move || {
            let mut opened = None;
            // The name goes at once: a daemon that is killed leaves nothing behind.
            let created = || {
                opened = Some(File::open(&path)?);
                std::fs::remove_file(&path)
            };
            nexus.write(&path, created, &AtomicBool::new(false))?;
            let unread = || LabError::Export("the NeXus file cannot be read back".to_owned());
            let file = opened.ok_or_else(unread)?;
            let bytes = file.metadata().map_err(|_| unread())?.len();
            Ok(NexusDownload { file, bytes })
        })
        .await?
    }
}
