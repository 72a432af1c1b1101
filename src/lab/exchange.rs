//! Series that come in and results that go out: imports, uploads, exports.

pub(super) mod export;
pub(super) mod exports;
pub(super) mod hdf5_group;
pub(super) mod import;
pub(super) mod import_duplicates;
pub(super) mod nexus;
pub(super) mod nexus_download;
pub(super) mod received;
pub(super) mod uploads;
