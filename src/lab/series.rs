//! Scans as series: what a reduction reads, what comes in from a folder and goes out to one.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use super::again::Alike;
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

/// A scan of the store in the form of a recorded series, its calibrations among its frames.
#[derive(Debug, Clone)]
pub struct StoredSeries {
    store: Store,
    manifest: Manifest,
    rows: Vec<FrameRow>,
    sha256: Vec<String>,
    /// Newest frame in it.
    pub last_frame_id: i64,
    /// Whether no frame was left out.
    is_whole: bool,
}

impl StoredSeries {
    /// Reads what the store knows of a scan; frames are read when they are asked for.
    ///
    /// # Errors
    /// An unknown scan, or what the store says.
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

    /// Leaves out the frames whose files are missing or damaged, and says which and why.
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
    // The form says that dark frames carry 0, 0; where the stages stood is in the store.
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

/// How to import.
#[derive(Debug, Clone, Default)]
pub struct ImportOptions {
    /// Leave out frames that cannot be read, instead of refusing the series.
    pub skip_unreadable: bool,
    /// Follow links out of the folder: it is the user's own, and no stranger names it.
    pub follow_links: bool,
    /// Raised to break it off.
    pub cancel: Arc<AtomicBool>,
}

/// A series that is to be imported.
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

/// The name in an export of a frame that was no PNG; no other line of the list has it.
fn name_as_png(file: &str, rows: &[FrameRow]) -> String {
    let renamed = Path::new(file).with_extension("png");
    let same_but_ending = |row: &&FrameRow| Path::new(&row.file).with_extension("png") == renamed;
    match rows.iter().filter(same_but_ending).count() {
        1 => renamed.to_string_lossy().into_owned(),
        _ => format!("{file}.png"),
    }
}

/// Reads files where nobody else waits for them: the disk of a series may be a slow one.
async fn reading<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> T {
    tokio::task::spawn_blocking(work)
        .await
        .expect("reading a series does not panic")
}

/// What an import did.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// The scan it became.
    pub scan_id: i64,
    /// The sample it is of.
    pub sample_id: i64,
    /// Frames kept.
    pub n_frames: usize,
    /// Frames left out, with the reason.
    pub skipped: Vec<String>,
    /// The newest scan that holds the same series already.
    pub same_as: Option<i64>,
    /// Where none does: the one that holds the same frames and differs least, and what the series says otherwise of them.
    pub like: Option<Alike>,
}

impl Lab {
    /// Takes a recorded series into the store as a completed scan: PNG frames bit for bit, TIFF frames count for count.
    /// `progress` is told how many of how many frames are in.
    ///
    /// # Errors
    /// [`LabError::Series`] for a folder that is none, [`LabError::NoRoomToImport`] where it would
    /// use up the reserve, [`LabError::Frame`] for a frame that cannot be read,
    /// [`LabError::BrokenOff`]; then nothing is imported, and no file of it stays.
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

    /// What goes in has to leave the reserve free.
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

    /// The same; `frames` are those that were kept until it failed.
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
            // Others write too while a long series comes in.
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
                    "none of the {} frames shows the sample, so nothing can be reduced",
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
            // A list with lines left out, or of files that have other names now, is not the series' own any more.
            frames_csv: own_list.then(|| series.list_text().to_owned()),
            calibration_ids: vec![],
        };
        let before = self.imported_before(series.manifest(), frames).await?;
        let (scan_id, event) = self.store().import_scan(&new, frames).await?;
        self.tell(event);
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

    /// The newest sample of this name and material, or a new one.
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

/// What an export wrote.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Exported {
    /// Frames written.
    pub n_frames: usize,
    /// Frames left out, each with the reason.
    pub skipped: Vec<String>,
}

/// Writes a scan of the store as a series into a new or empty folder; an imported series comes out as
/// it came in, byte for byte. Returns the number of frames. A new folder appears whole or not at all.
///
/// # Errors
/// An unknown scan, a damaged frame, a folder that is not empty, [`LabError::BrokenOff`] once `cancel`
/// is raised, or what the disk says; then nothing of it stays.
pub async fn export(
    store: &Store,
    scan_id: i64,
    folder: &Path,
    cancel: Arc<AtomicBool>,
) -> Result<usize, LabError> {
    let series = StoredSeries::open(store, scan_id).await?;
    write_export(store, scan_id, series, folder, cancel).await
}

/// The same, less the frames that are damaged or missing; the list of frames is then written anew.
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
    // A list that names what is left out is not the series' own any more.
    let frames_csv = match series.is_whole {
        true => store.frames_csv(scan_id).await?,
        false => None,
    };
    let manifest = match store.scan(scan_id).await?.origin {
        Origin::Import => Some(store.manifest(scan_id).await?),
        Origin::Rig => None,
    };
    // The series' own texts, comments and all.
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

/// Where an export grows.
enum Place {
    /// Beside the folder that is asked for, to become it at the end.
    Beside(PathBuf),
    /// In the empty folder that is there already: it may be a disk of its own, which takes no other's place.
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

    /// Best effort: what stays is seen by the next export, which takes no folder with something in it.
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
    /// The poses, exposures and repeats that an imported series has, in the form of a plan.
    ///
    /// # Errors
    /// What the store says.
    pub async fn plan_of_import(&self, scan_id: i64) -> Result<Plan, LabError> {
        let frames = self.store().frames_for_reduction(scan_id).await?;
        let values = |kind: FrameKind, of: &dyn Fn(&FrameRecord) -> f64| {
            let mut all: Vec<f64> = frames.iter().filter(|f| f.kind == kind).map(of).collect();
            all.sort_by(f64::total_cmp);
            // A recorded stage never stands twice at the very same angle.
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

    /// What the manifest of a scan says.
    ///
    /// # Errors
    /// An unknown scan, or what the store says.
    pub async fn manifest(&self, scan_id: i64) -> Result<Manifest, LabError> {
        let text = self.store().manifest(scan_id).await?;
        Ok(Manifest::from_toml(&text, "manifest.toml")?)
    }

    /// Names of the regions of a sample with patches; empty for any other.
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

    /// Whether more frames of the scan may come.
    pub(super) fn more_frames_may_come(state: ScanState) -> bool {
        !state.is_end() && state != ScanState::Interrupted
    }
}
