//! A map from frames to files in one call, with the seconds of each step.

use std::io;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use super::summary::{Summary, Timing, summary};
use super::write::{WriteError, write};
use super::{Map, MapError, MapOptions, Progress, Stage, map_until};
use crate::reduction::FrameSource;

/// Name of the summary among the files.
pub const SUMMARY: &str = "summary.json";

/// The reason why no files were written.
#[derive(Debug, thiserror::Error)]
pub enum FolderError {
    /// The map failed.
    #[error(transparent)]
    Map(#[from] MapError),
    /// The steps before the first pixel took all the time allowed.
    #[error(
        "the limit of {limit_s} s passed before a pixel was fitted: reading frames and determining what all pixels share took {spent_s:.1} s; allow at least {least_s} s"
    )]
    Late {
        /// Seconds allowed.
        limit_s: f64,
        /// Seconds spent before the first pixel.
        spent_s: f64,
        /// Seconds spent, with a margin for pixels.
        least_s: f64,
    },
    /// The files cannot be written.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// Maps a series and writes all files of the map and its summary into `folder`, which is created if missing. After
/// `options.max_seconds` no further tile is started, and the pixels fitted until then are written. If cancelled before
/// the last file is written, the folder is unchanged; if cancelled later, the map is complete and no error is returned.
/// `progress` may be called from several threads at once.
///
/// # Errors
/// [`FolderError`].
pub fn map_into(
    source: &dyn FrameSource,
    options: &MapOptions,
    folder: &Path,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Summary, FolderError> {
    let stages = StageTimes::start();
    let late = || {
        let spent = stages.started.elapsed().as_secs_f64();
        options.max_seconds.is_some_and(|limit| spent >= limit)
    };
    let mapped = map_until(
        source,
        options,
        &late,
        &|p| {
            stages.note(p.stage);
            progress(p);
        },
        cancel,
    )
    .map_err(|error| match (error, options.max_seconds) {
        (MapError::Late, Some(limit_s)) => {
            let spent_s = stages.started.elapsed().as_secs_f64();
            let least_s = (1.2 * spent_s).ceil();
            FolderError::Late {
                limit_s,
                spent_s,
                least_s,
            }
        }
        (error, _) => error.into(),
    })?;
    write_into(&mapped, stages.timing(), folder, cancel)
}

/// Writes all files of a map and its summary into `folder`, as [`map_into`] does; `timing` has the seconds of the steps before.
///
/// # Errors
/// [`FolderError`].
pub fn write_into(
    mapped: &Map,
    mut timing: Timing,
    folder: &Path,
    cancel: &AtomicBool,
) -> Result<Summary, FolderError> {
    let started = Instant::now();
    let not_written = |error| match error {
        WriteError::Cancelled => FolderError::Map(MapError::Cancelled),
        error => error.into(),
    };
    let drafts = write(mapped, folder, cancel).map_err(not_written)?;
    let mut files = drafts.names();
    files.push(SUMMARY.to_owned());
    timing.write = started.elapsed().as_secs_f64();
    let summary = summary(mapped, timing, files);
    let failed = |source: io::Error| WriteError::File {
        file: SUMMARY.to_owned(),
        source,
    };
    let mut json = serde_json::to_string_pretty(&summary).map_err(|e| failed(e.into()))?;
    json.push('\n');
    let put = |path: &Path| std::fs::write(path, json).map_err(failed);
    drafts.file(SUMMARY, cancel, put).map_err(not_written)?;
    // From here on the map is complete, even if it is cancelled.
    drafts.keep(SUMMARY)?;
    Ok(summary)
}

/// Start times of the stages.
pub(super) struct StageTimes {
    started: Instant,
    began: Mutex<Vec<(Stage, Instant)>>,
}

impl StageTimes {
    pub(super) fn start() -> Self {
        StageTimes {
            started: Instant::now(),
            began: Mutex::new(Vec::new()),
        }
    }

    pub(super) fn note(&self, stage: Stage) {
        let mut began = self.began.lock().expect("no holder of this lock panics");
        if !began.iter().any(|(known, _)| *known == stage) {
            began.push((stage, Instant::now()));
        }
    }

    /// Returns the seconds per step until now; a stage ends when the next begins.
    pub(super) fn timing(&self) -> Timing {
        let now = Instant::now();
        let began = self.began.lock().expect("no holder of this lock panics");
        let at = |stage: Stage| {
            began
                .iter()
                .find(|(known, _)| *known == stage)
                .map_or(now, |(_, time)| *time)
        };
        let (settling, fitting) = (at(Stage::Settling), at(Stage::Fitting));
        // A map that fails before has no such step.
        let averaging = at(Stage::Averaging).min(settling);
        Timing {
            read: (averaging - self.started).as_secs_f64(),
            mean: (settling - averaging).as_secs_f64(),
            settle: (fitting - settling).as_secs_f64(),
            fit: (now - fitting).as_secs_f64(),
            write: 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::Ordering;

    use super::*;
    use crate::series::Series;

    #[test]
    fn a_map_cancelled_after_its_last_pixel_leaves_no_files() {
        let series = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/checker");
        let series = Series::open(&series).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let cancel = AtomicBool::new(false);
        let report = |p: Progress| {
            if p.stage == Stage::Fitting && p.done == p.total {
                cancel.store(true, Ordering::Relaxed);
            }
        };
        let options = MapOptions {
            scratch: folder.path().to_owned(),
            ..MapOptions::default()
        };
        let outcome = map_into(&series, &options, folder.path(), &report, &cancel);
        assert!(matches!(
            outcome,
            Err(FolderError::Map(MapError::Cancelled))
        ));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn a_folder_holds_complete_maps_only_and_their_summary_explains_the_flags() {
        let series = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/checker");
        let series = Series::open(&series).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let options = MapOptions {
            scratch: folder.path().to_owned(),
            ..MapOptions::default()
        };
        let into = |cancel: &AtomicBool, report: &(dyn Fn(Progress) + Sync)| {
            map_into(&series, &options, folder.path(), report, cancel)
        };
        let summary = into(&AtomicBool::new(false), &|_| {}).unwrap();
        let there = || {
            let files = std::fs::read_dir(folder.path()).unwrap();
            let mut names: Vec<String> = files
                .map(|file| file.unwrap().file_name().into_string().unwrap())
                .collect();
            names.sort_unstable();
            names
        };
        let mut named = summary.files.clone();
        named.sort_unstable();
        assert_eq!(there(), named);
        assert_eq!(summary.flag_bits["not_identifiable"], 4);
        // Directions are in (−180°, 180°], as everywhere.
        let path = folder.path().join("lean_azimuth_deg.tif");
        let file = io::BufReader::new(std::fs::File::open(path).unwrap());
        let mut decoder = tiff::decoder::Decoder::new(file).unwrap();
        let tiff::decoder::DecodingResult::F32(leans) = decoder.read_image().unwrap() else {
            panic!("expected f32 values");
        };
        let leans = leans.into_iter().filter(|x| x.is_finite());
        assert!(leans.clone().count() > 100);
        assert!(leans.clone().all(|x| x > -180.0 && x <= 180.0));
        // A second map, cancelled when all pixels are fitted, leaves the first one unchanged.
        let cancel = AtomicBool::new(false);
        let report = |p: Progress| {
            if p.stage == Stage::Fitting && p.done == p.total {
                cancel.store(true, Ordering::Relaxed);
            }
        };
        assert!(into(&cancel, &report).is_err());
        assert_eq!(there(), named);
    }
}
