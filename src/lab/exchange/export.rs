//! Export of stored scans as series.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::lab::{LabError, StoredSeries};
use crate::reduction::FrameSource;
use crate::series::{self, WriteError};
use crate::store::scans::Origin;
use crate::store::{Store, StoreError};

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
    if series.rows().is_empty() && !skipped.is_empty() {
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
        (series.manifest().frames.clone(), frames_csv),
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
        Ok(series.rows().len())
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
        false => Ok(series.read_png(i)?),
    };
    series::write(folder, series.manifest(), series.rows(), frame).map_err(
        |error| match error {
            WriteError::Frame(error) => error,
            WriteError::Io { file, source } => unwritten(&file, source),
            other => LabError::Export(other.to_string()),
        },
    )?;
    for (file, text) in texts {
        if let Some(text) = text {
            let path = folder.join(file);
            std::fs::write(&path, text).map_err(|e| unwritten(&path, e))?;
        }
    }
    Ok(())
}
