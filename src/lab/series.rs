//! Scans as series: input of a reduction, import from a folder and export to one.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::import_duplicates::ImportDuplicate;
use super::{Lab, LabError};
use crate::frame::{Frame, FrameKind};
use crate::material::Material;
use crate::reduction::{FrameReadError, FrameSource};
use crate::scan::plan::{DarkPlan, FlatPlan};
use crate::scan::{Plan, ScanState};
use crate::series::{self, FrameRow, Manifest, Series, SeriesError, WriteError};
use crate::store::frames::{FrameRecord, ImportedFrame};
use crate::store::samples::NewSample;
use crate::store::scans::{NewScan, Origin};
use crate::store::{Store, StoreError};

/// A stored scan in the form of a recorded series, with the frames of its calibrations.
#[derive(Debug, Clone)]
pub struct StoredSeries {
    store: Store,
    manifest: Manifest,
    rows: Vec<FrameRow>,
    sha256: Vec<String>,
    /// Newest frame.
    pub last_frame_id: i64,
    /// Whether no frame was left out.
    is_whole: bool,
}

impl StoredSeries {
    /// Opens a scan of the store; frames are read on demand.
    ///
    /// # Errors
    /// An unknown scan, or a store error.
    pub async fn open(store: &Store, scan_id: i64) -> Result<StoredSeries, LabError> {
        let manifest = store.manifest(scan_id).await?;
        let manifest = Manifest::from_toml(&manifest, "manifest.toml")?;
        let imported = store.scan(scan_id).await?.origin == Origin::Import;
        let records = store.frames_for_reduction(scan_id).await?;
        let last_frame_id = records.iter().map(|r| r.id).max().unwrap_or(0);
        let mut rows = Vec::with_capacity(records.len());
        let mut sha256 = Vec::with_capacity(records.len());
        for record in records {
            rows.push(row(&record, imported));
            sha256.push(record.sha256);
        }
        Ok(StoredSeries {
            store: store.clone(),
            manifest,
            rows,
            sha256,
            last_frame_id,
            is_whole: true,
        })
    }

    /// Removes the frames whose files are missing or damaged, and returns which and why.
    fn without_unreadable(mut self, cancel: &AtomicBool) -> Result<(Self, Vec<String>), LabError> {
        let mut skipped = Vec::new();
        let frames = self.rows.drain(..).zip(self.sha256.drain(..));
        let (mut rows, mut sha256) = (Vec::new(), Vec::new());
        for (row, hash) in frames {
            if cancel.load(Ordering::Relaxed) {
                return Err(LabError::BrokenOff);
            }
            match self.store.read_png(&hash) {
                Ok(_) => {
                    rows.push(row);
                    sha256.push(hash);
                }
                Err(error @ StoreError::FrameDamaged { .. }) => {
                    skipped.push(format!("{}: {error}", row.file));
                }
                Err(error) => return Err(error.into()),
            }
        }
        self.is_whole = skipped.is_empty();
        (self.rows, self.sha256) = (rows, sha256);
        Ok((self, skipped))
    }
}

fn row(record: &FrameRecord, imported: bool) -> FrameRow {
    // Dark frames of a series have angles 0, 0; the store has the real ones.
    let (theta_c_deg, phi_s_deg) = match record.kind {
        FrameKind::Dark if !imported => (0.0, 0.0),
        _ => (record.theta_c_deg, record.phi_s_deg),
    };
    FrameRow {
        file: record.name.clone(),
        kind: record.kind,
        theta_c_deg,
        phi_s_deg,
        exposure_s: record.exposure_s,
        repeat: record.repeat,
        timestamp: record.timestamp.clone(),
    }
}

impl FrameSource for StoredSeries {
    fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    fn rows(&self) -> &[FrameRow] {
        &self.rows
    }

    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        let file = || self.rows[index].file.clone();
        let png =
            self.store
                .read_png(&self.sha256[index])
                .map_err(|source| FrameReadError::Store {
                    file: file(),
                    source: Box::new(source),
                })?;
        Frame::from_png(&png).map_err(|source| FrameReadError::NotAFrame {
            file: file(),
            source,
        })
    }
}

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
struct Given {
    series: Arc<Series>,
    /// Sizes of the frames' files.
    bytes: Vec<u64>,
}

impl Given {
    fn open(folder: &Path, own: bool) -> Result<Given, LabError> {
        let series = match own {
            true => Series::open_own(folder)?,
            false => Series::open(folder)?,
        };
        let size_of = |file: &PathBuf| std::fs::metadata(file).map_or(0, |file| file.len());
        Ok(Given {
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
    /// Its sample.
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
    /// [`LabError::Series`] for a folder that is not a series, [`LabError::NoRoomToImport`] if it would use up the
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

    /// Refuses an import that would use up the reserve.
    fn check_room(&self, needed: u64) -> Result<(), LabError> {
        let reserve = self.reserve_bytes();
        let free = self.store().free_bytes()?;
        if free >= needed.saturating_add(reserve) {
            return Ok(());
        }
        Err(LabError::NoRoomToImport {
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
        let given = reading(move || Given::open(&from, own)).await?;
        self.check_room(given.bytes.iter().sum())?;
        let series = &given.series;
        let saturation_dn = series.manifest().camera.full_count();
        let total = series.rows().len();
        let mut skipped = Vec::new();
        for (i, row) in series.rows().iter().enumerate() {
            if options.cancel.load(Ordering::Relaxed) {
                return Err(LabError::BrokenOff);
            }
            // Other tasks also write during a long import.
            self.check_room(given.bytes[i])?;
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

    /// Returns the newest sample of this name and material, or adds one.
    async fn sample_named(&self, name: &str, material: Material) -> Result<i64, LabError> {
        let store = self.store();
        let same = store.newest_sample(Some(name), |s| s.material == material);
        if let Some(sample) = same.await? {
            return Ok(sample.id);
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

/// The result of an export.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Exported {
    /// Frames written.
    pub n_frames: usize,
    /// Frames left out, each with the reason.
    pub skipped: Vec<String>,
}

/// Exports a stored scan as a series into a new or empty folder and returns the number of frames. An imported series is
/// written byte for byte as it was. A new folder appears complete or not at all.
///
/// # Errors
/// An unknown scan, a damaged frame, a folder that is not empty, [`LabError::BrokenOff`] once `cancel` is raised, or an
/// I/O error; then nothing of it stays.
pub async fn export(
    store: &Store,
    scan_id: i64,
    folder: &Path,
    cancel: Arc<AtomicBool>,
) -> Result<usize, LabError> {
    let series = StoredSeries::open(store, scan_id).await?;
    write_export(store, scan_id, series, folder, cancel).await
}

/// Does the same without the damaged and missing frames; the list of frames is then rewritten.
///
/// # Errors
/// As [`export`]; [`LabError::Export`] where no frame is left.
pub async fn export_readable(
    store: &Store,
    scan_id: i64,
    folder: &Path,
    cancel: Arc<AtomicBool>,
) -> Result<Exported, LabError> {
    let series = StoredSeries::open(store, scan_id).await?;
    let stop = Arc::clone(&cancel);
    let looked = move || series.without_unreadable(&stop);
    let (series, skipped) = tokio::task::spawn_blocking(looked)
        .await
        .expect("reading frames does not panic")?;
    if series.rows.is_empty() && !skipped.is_empty() {
        let first = &skipped[0];
        return Err(LabError::Export(format!(
            "no frame of scan {scan_id} can be read, so there is nothing to write: {first}"
        )));
    }
    let n_frames = write_export(store, scan_id, series, folder, cancel).await?;
    Ok(Exported { n_frames, skipped })
}

async fn write_export(
    store: &Store,
    scan_id: i64,
    series: StoredSeries,
    folder: &Path,
    cancel: Arc<AtomicBool>,
) -> Result<usize, LabError> {
    // The original list would name the frames that are left out.
    let frames_csv = match series.is_whole {
        true => store.frames_csv(scan_id).await?,
        false => None,
    };
    let manifest = match store.scan(scan_id).await?.origin {
        Origin::Import => Some(store.manifest(scan_id).await?),
        Origin::Rig => None,
    };
    // The original texts, including comments.
    let texts = [
        (series.manifest.frames.clone(), frames_csv),
        ("manifest.toml".to_owned(), manifest),
    ];
    let folder = folder.to_owned();
    let written = move || {
        let place = Place::for_folder(&folder)?;
        if let Err(error) = write_whole(&series, texts, place.path(), &cancel) {
            place.clear();
            return Err(error);
        }
        place.finish(&folder)?;
        Ok(series.rows.len())
    };
    tokio::task::spawn_blocking(written)
        .await
        .expect("writing an export does not panic")
}

fn unwritten(file: &Path, error: std::io::Error) -> LabError {
    LabError::Store(StoreError::file("the export", file, error))
}

/// The folder in which an export is written.
enum Place {
    /// Beside the requested folder; renamed to it at the end.
    Beside(PathBuf),
    /// The existing empty folder: it may be a mount point, which cannot be replaced.
    Inside(PathBuf),
}

impl Place {
    fn for_folder(folder: &Path) -> Result<Place, LabError> {
        match std::fs::read_dir(folder) {
            Ok(mut files) => match files.next() {
                None => return Ok(Place::Inside(folder.into())),
                Some(_) => {
                    let taken = WriteError::<StoreError>::NotEmpty(folder.into());
                    return Err(LabError::Export(taken.to_string()));
                }
            },
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
            Err(error) => return Err(unwritten(folder, error)),
        }
        let mut name = std::ffi::OsString::from(".");
        name.push(folder.file_name().unwrap_or("export".as_ref()));
        name.push(format!("-{}.part", std::process::id()));
        let beside = folder.with_file_name(name);
        std::fs::create_dir_all(&beside).map_err(|e| unwritten(&beside, e))?;
        Ok(Place::Beside(beside))
    }

    fn path(&self) -> &Path {
        match self {
            Place::Beside(path) | Place::Inside(path) => path,
        }
    }

    fn finish(self, folder: &Path) -> Result<(), LabError> {
        let Place::Beside(beside) = &self else {
            return Ok(());
        };
        let moved = std::fs::rename(beside, folder).map_err(|e| unwritten(folder, e));
        if moved.is_err() {
            self.clear();
        }
        moved
    }

    /// Best effort: the next export refuses a folder that is not empty.
    fn clear(self) {
        match self {
            Place::Beside(path) => drop(std::fs::remove_dir_all(path)),
            Place::Inside(path) => {
                for file in std::fs::read_dir(path).into_iter().flatten().flatten() {
                    let file = file.path();
                    let removed = match file.is_dir() {
                        true => std::fs::remove_dir_all(file),
                        false => std::fs::remove_file(file),
                    };
                    removed.ok();
                }
            }
        }
    }
}

fn write_whole(
    series: &StoredSeries,
    texts: [(String, Option<String>); 2],
    folder: &Path,
    cancel: &AtomicBool,
) -> Result<(), LabError> {
    let frame = |i: usize| match cancel.load(Ordering::Relaxed) {
        true => Err(LabError::BrokenOff),
        false => Ok(series.store.read_png(&series.sha256[i])?),
    };
    series::write(folder, &series.manifest, &series.rows, frame).map_err(|error| match error {
        WriteError::Frame(error) => error,
        WriteError::Io { file, source } => unwritten(&file, source),
        other => LabError::Export(other.to_string()),
    })?;
    for (file, text) in texts {
        if let Some(text) = text {
            let path = folder.join(file);
            std::fs::write(&path, text).map_err(|e| unwritten(&path, e))?;
        }
    }
    Ok(())
}

impl Lab {
    /// Returns the poses, exposures and repeats of an imported series as a plan.
    ///
    /// # Errors
    /// A store error.
    pub async fn plan_of_import(&self, scan_id: i64) -> Result<Plan, LabError> {
        let frames = self.store().frames_for_reduction(scan_id).await?;
        let values = |kind: FrameKind, of: &dyn Fn(&FrameRecord) -> f64| {
            let mut all: Vec<f64> = frames.iter().filter(|f| f.kind == kind).map(of).collect();
            all.sort_by(f64::total_cmp);
            // Recorded positions of the same pose differ slightly.
            all.dedup_by(|a, b| (*a - *b).abs() < 0.005);
            all
        };
        let repeats = |kind: FrameKind| {
            let last = frames
                .iter()
                .filter(|f| f.kind == kind)
                .map(|f| f.repeat + 1);
            last.max().unwrap_or(0)
        };
        let exposures = |kind: FrameKind| {
            let mut all: Vec<f64> = frames
                .iter()
                .filter(|f| f.kind == kind)
                .map(|f| f.exposure_s)
                .collect();
            all.sort_by(f64::total_cmp);
            all.dedup();
            all
        };
        Ok(Plan {
            theta_c_deg: values(FrameKind::Sample, &|f| f.theta_c_deg),
            phi_s_deg: values(FrameKind::Sample, &|f| f.phi_s_deg),
            exposures_s: exposures(FrameKind::Sample),
            repeats: repeats(FrameKind::Sample),
            dark: DarkPlan {
                repeats: repeats(FrameKind::Dark),
            },
            flat: FlatPlan {
                theta_c_deg: values(FrameKind::Flat, &|f| f.theta_c_deg),
                exposures_s: exposures(FrameKind::Flat),
                repeats: repeats(FrameKind::Flat),
            },
            reuse_calibrations: false,
        })
    }

    /// Returns the manifest of a scan.
    ///
    /// # Errors
    /// An unknown scan, or a store error.
    pub async fn manifest(&self, scan_id: i64) -> Result<Manifest, LabError> {
        let text = self.store().manifest(scan_id).await?;
        Ok(Manifest::from_toml(&text, "manifest.toml")?)
    }

    /// Returns the regions of a sample with patches; empty for any other sample.
    #[must_use]
    pub fn regions(manifest: &Manifest) -> Vec<String> {
        let Some(layout) = &manifest.sample.layout else {
            return Vec::new();
        };
        let patches = (0..layout.patches_x)
            .flat_map(|i| (0..layout.patches_y).map(move |j| format!("patch-{i}-{j}")));
        ["even".to_owned(), "odd".to_owned()]
            .into_iter()
            .chain(patches)
            .collect()
    }

    /// Returns whether a scan in this state may get more frames.
    pub(super) fn more_frames_may_come(state: ScanState) -> bool {
        !state.is_end() && state != ScanState::Interrupted
    }
}
