//! A disk with the faults of a plan.

use std::io;
use std::path::Path;
use std::sync::Arc;

use super::injector::{DiskFault, FaultInjector};
use crate::store::disk::Disk;

/// A disk that fills up or fails as a plan says.
pub struct FaultyDisk {
    disk: Arc<dyn Disk>,
    plan: Arc<FaultInjector>,
}

impl FaultyDisk {
    /// Adds the faults of a plan to a disk.
    #[must_use]
    pub fn new(disk: Arc<dyn Disk>, plan: Arc<FaultInjector>) -> Self {
        FaultyDisk { disk, plan }
    }
}

impl Disk for FaultyDisk {
    fn write_durably(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        match self.plan.of_write() {
            Some(DiskFault::Full) => Err(io::ErrorKind::StorageFull.into()),
            Some(DiskFault::Error) => Err(io::Error::other("an I/O error of the plan of faults")),
            None => self.disk.write_durably(path, bytes),
        }
    }

    fn free_bytes(&self, folder: &Path) -> io::Result<u64> {
        match self.plan.disk_is_full() {
            true => Ok(0),
            false => self.disk.free_bytes(folder),
        }
    }
}
