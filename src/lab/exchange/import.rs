//! Import of recorded series into the store.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::import_duplicates::ImportDuplicate;
use crate::frame::FrameKind;
use crate::lab::{Lab, LabError};
use crate::material::Material;
use crate::reduction::FrameReadError;
use crate::series::archive::{ArchiveError, unpack};
use crate::series::{FrameRow, Series, SeriesError};
use crate::store::frames::ImportedFrame;
use crate::store::samples::{AmbiguousPart, NewSample};
use crate::store::scans::NewScan;
use crate::store::{PageRequest, StoreError};

/// What has no room, in errors.
pub(in crate::lab) const SERIES: &str = "the series";

/// Options of an import.
#[derive(Debug, Clone, Default)]
pub struct ImportOptions {
    /// Leave out frames that cannot be read, instead of refusing the series.
    pub skip_unreadable: bool,
    /// Follow links out of the folder; only for a folder that the user names on the command line.
    pub follow_links: bool,
    /// Raised to cancel the import.
    pub cancel: Arc<AtomicBool>,
}

/// A series to import.
struct SeriesToImport {
    series: Arc<Series>,
    /// Sizes of the frames' files.
    bytes: Vec<u64>,
}

impl SeriesToImport {
    fn open(folder: &Path, own: bool) -> Result<SeriesToImport, LabError> {
        let series = match own {
            true => Series::open_own(folder)?,
            false => Series::open(folder)?,
        };
        let size_of = |file: &PathBuf| std::fs::metadata(file).map_or(0, |file| file.len());
        Ok(SeriesToImport {
            bytes: series.paths().iter().map(size_of).collect(),
            series: Arc::new(series),
        })
    }
}

/// Returns the name in an export of a frame that was not a PNG; it is unique in the list.
fn name_as_png(file: &str, rows: &[FrameRow]) -> String {
    let renamed = Path::new(file).with_extension("png");
    let same_but_ending = |row: &&FrameRow| Path::new(&row.file).with_extension("png") == renamed;
    match rows.iter().filter(same_but_ending).count() {
        1 => renamed.to_string_lossy().into_owned(),
        _ => format!("{file}.png"),
    }
}

/// Reads files on a thread for blocking work: a series may be on a slow disk.
async fn reading<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> T {
    tokio::task::spawn_blocking(work)
        .await
        .expect("reading a series does not panic")
}

/// The result of an import.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// The new scan.
    pub scan_id: i64,
    /// Its part.
    pub sample_id: i64,
    /// Frames kept.
    pub n_frames: usize,
    /// Frames left out, with the reason.
    pub skipped: Vec<String>,
    /// The newest earlier scan of the same series.
    pub same_as: Option<i64>,
    /// If there is none: the earlier scan of the same frames whose facts differ least.
    pub like: Option<ImportDuplicate>,
}

impl Lab {
    /// Imports a recorded series as a completed scan: PNG frames bit for bit, TIFF frames count for count. `progress` gets
    /// the number of imported frames and the total.
    ///
    /// # Errors
    /// [`LabError::Series`] for a folder that is not a series, [`LabError::NoRoomFor`] if it would use up the
    /// reserve, [`LabError::Frame`] for an unreadable frame, [`LabError::BrokenOff`]; then nothing is imported.
    pub async fn import(
        &self,
        folder: &Path,
        options: &ImportOptions,
        progress: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Imported, LabError> {
        let mut frames = Vec::new();
        let imported = self
            .import_into(&mut frames, folder, options, progress)
            .await;
        if imported.is_err() {
            let kept = frames.into_iter().map(|frame| frame.file).collect();
            if let Err(error) = self.store().discard(kept).await {
                tracing::warn!(%error, "files of a failed import stay until the next start: {error}");
            }
        }
        imported
    }

    /// Imports a zip archive with a recorded series, as [`Lab::import`] imports a folder.
    ///
    /// # Errors
    /// [`LabError::Archive`] for a file that is no archive of a series, and those of [`Lab::import`].
    pub async fn import_archive(
        &self,
        archive: &Path,
        options: &ImportOptions,
        progress: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Imported, LabError> {
        let place = self.upload_place()?;
        let imported = self
            .import_archive_at(place.path(), archive, options, progress)
            .await;
        reading(move || drop(place)).await;
        imported
    }

    async fn import_archive_at(
        &self,
        place: &Path,
        archive: &Path,
        options: &ImportOptions,
        progress: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Imported, LabError> {
        let free = self.store().free_bytes().await?;
        let room = free.saturating_sub(self.reserve_bytes());
        // A series without a name gets that of its folder.
        let name = archive.file_stem().unwrap_or_default();
        let (from, into) = (archive.to_owned(), place.join(name));
        let cancel = Arc::clone(&options.cancel);
        let folder = reading(move || unpack(&from, &into, room, &cancel)).await;
        let folder = folder.map_err(|error| match error {
            ArchiveError::Cancelled => LabError::BrokenOff,
            ArchiveError::NoRoom { needed, .. } => LabError::NoRoomFor {
                what: SERIES,
                needed_mb: needed.div_ceil(1_000_000),
                reserve_mb: self.reserve_bytes().div_ceil(1_000_000),
                free_mb: free / 1_000_000,
            },
            ArchiveError::Io { file, source } => StoreError::file("the file", file, source).into(),
            error => LabError::Archive(error),
        })?;
        // The content of an archive is untrusted.
        let options = ImportOptions {
            follow_links: false,
            ..options.clone()
        };
        self.import(&folder, &options, progress).await
    }

    /// Refuses what would use up the reserve.
    pub(in crate::lab) async fn check_room(
        &self,
        what: &'static str,
        needed: u64,
    ) -> Result<(), LabError> {
        let reserve = self.reserve_bytes();
        let free = self.store().free_bytes().await?;
        if free >= needed.saturating_add(reserve) {
            return Ok(());
        }
        Err(LabError::NoRoomFor {
            what,
            needed_mb: needed.div_ceil(1_000_000),
            reserve_mb: reserve.div_ceil(1_000_000),
            free_mb: free / 1_000_000,
        })
    }

    /// Imports a series; `frames` has the frames that were stored before an error.
    async fn import_into(
        &self,
        frames: &mut Vec<ImportedFrame>,
        folder: &Path,
        options: &ImportOptions,
        progress: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Imported, LabError> {
        let from = folder.to_owned();
        let own = options.follow_links;
        let given = reading(move || SeriesToImport::open(&from, own)).await?;
        self.check_room(SERIES, given.bytes.iter().sum()).await?;
        let series = &given.series;
        let skipped = self.keep_frames(frames, &given, options, progress).await?;
        if !frames.iter().any(|f| f.kind == FrameKind::Sample) {
            return Err(LabError::Series(SeriesError::Invalid {
                file: series.manifest().frames.clone(),
                line: None,
                key: "kind: ".into(),
                cause: format!(
                    "none of the {} frames has the kind sample, so nothing can be reduced",
                    frames.len()
                ),
                remedy: "give frames of the sample the kind `sample`".into(),
            }));
        }
        let name = match series.manifest().name.as_str() {
            "" => folder
                .file_name()
                .map_or("series".into(), |n| n.to_string_lossy().into_owned()),
            name => name.to_owned(),
        };
        let sample_id = self
            .sample_named(&name, series.manifest().material())
            .await?;
        let own_list = skipped.is_empty() && frames.iter().all(|f| f.original_sha256.is_none());
        let new = NewScan {
            sample_id,
            rig_id: None,
            name,
            plan: None,
            manifest: series.manifest_text().to_owned(),
            // The original list is stored only if it still matches: no lines left out, no file renamed.
            frames_csv: own_list.then(|| series.list_text().to_owned()),
            calibration_ids: vec![],
            purpose: Default::default(),
            who: self.who.to_string(),
        };
        let before = self.imported_before(series.manifest(), frames).await?;
        let (scan_id, event) = self.store().import_scan(&new, frames).await?;
        self.publish(event);
        Ok(Imported {
            scan_id,
            sample_id,
            n_frames: frames.len(),
            skipped,
            same_as: match &before {
                Some(before) if before.differences.is_empty() => Some(before.scan_id),
                _ => None,
            },
            like: before.filter(|before| !before.differences.is_empty()),
        })
    }

    /// Stores the frames of a series; returns why frames were skipped that cannot be read, if that is permitted.
    async fn keep_frames(
        &self,
        frames: &mut Vec<ImportedFrame>,
        given: &SeriesToImport,
        options: &ImportOptions,
        progress: &(dyn Fn(usize, usize) + Sync),
    ) -> Result<Vec<String>, LabError> {
        let series = &given.series;
        let saturation_dn = series.manifest().camera.full_count();
        let total = series.rows().len();
        let mut skipped = Vec::new();
        for (i, row) in series.rows().iter().enumerate() {
            if options.cancel.load(Ordering::Relaxed) {
                return Err(LabError::BrokenOff);
            }
            // Other tasks also write during a long import.
            self.check_room(SERIES, given.bytes[i]).await?;
            let source = Arc::clone(series);
            let kept = match reading(move || source.read_bytes(i)).await {
                Ok(file) => match self.store().keep_recorded(file, saturation_dn).await {
                    Err(StoreError::Frame(source)) => Err(FrameReadError::NotAFrame {
                        file: row.file.clone(),
                        source,
                    }),
                    other => Ok(other?),
                },
                Err(error) => Err(error),
            };
            match kept {
                Ok((file, original_sha256)) => frames.push(ImportedFrame {
                    file,
                    name: match original_sha256 {
                        Some(_) => name_as_png(&row.file, series.rows()),
                        None => row.file.clone(),
                    },
                    kind: row.kind,
                    theta_c_deg: row.theta_c_deg,
                    phi_s_deg: row.phi_s_deg,
                    exposure_s: row.exposure_s,
                    repeat: row.repeat,
                    timestamp: row.timestamp.clone(),
                    original_sha256,
                }),
                Err(reason) if options.skip_unreadable => skipped.push(reason.to_string()),
                Err(reason) => return Err(LabError::Frame { reason }),
            }
            progress(i + 1, total);
        }
        Ok(skipped)
    }

    /// Returns the sample of this name and material, or adds one. A series states the material of its part, so a part of the
    /// same name and another material is another part.
    async fn sample_named(&self, name: &str, material: Material) -> Result<i64, LabError> {
        let named = self.store().samples(Some(name), PageRequest::default());
        let same = named.await?.items.into_iter();
        let mut same: Vec<i64> = same
            .filter(|sample| sample.material == material)
            .map(|sample| sample.id)
            .collect();
        same.sort_unstable();
        match same[..] {
            [] => {}
            [one] => return Ok(one),
            _ => {
                let several = AmbiguousPart {
                    name: name.to_owned(),
                    ids: same,
                };
                return Err(LabError::Invalid {
                    field: "name".into(),
                    problem: format!(
                        "{several}, all of the material of this series; rename all but one of them (`ridged sample rename`), or \
                         give the series another name in its manifest"
                    ),
                });
            }
        }
        let new = NewSample {
            name: name.into(),
            material,
            note: Some("imported".into()),
            simulated: None,
        };
        Ok(self.store().add_sample(&new).await?.id)
    }
}
