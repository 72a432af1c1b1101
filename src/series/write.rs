//! A series written to a folder: the export, and how a test makes one.

use std::io::Write;
use std::path::{Path, PathBuf};

use super::rows::path_problem;
use super::{FrameRow, Manifest};

/// Why a series was not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError<E: std::error::Error + 'static> {
    /// There is something in the folder already, and nothing is ever overwritten.
    #[error("{0} is not empty; give a new folder")]
    NotEmpty(PathBuf),
    /// A frame's name would lie outside the folder.
    #[error("a frame is named `{0}`, which cannot be a file of the series")]
    BadName(String),
    /// A file could not be written.
    #[error("{file} could not be written: {source}")]
    Io {
        /// The file.
        file: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The frame's bytes could not be had.
    #[error(transparent)]
    Frame(E),
}

/// Writes a series into `folder`, which is made and has to be empty: the manifest, the list of
/// frames as the manifest names it, and each frame's PNG bytes as `bytes_of(index of the row)`
/// gives them. The manifest is written last, so a folder that was left half done is no series.
///
/// # Errors
/// [`WriteError`]; what was written until then stays.
pub fn write<E: std::error::Error + 'static>(
    folder: &Path,
    manifest: &Manifest,
    rows: &[FrameRow],
    mut bytes_of: impl FnMut(usize) -> Result<Vec<u8>, E>,
) -> Result<(), WriteError<E>> {
    let io = |file: &Path| {
        let file = file.to_owned();
        move |source| WriteError::Io { file, source }
    };
    if let Some(name) = rows
        .iter()
        .map(|r| &r.file)
        .chain([&manifest.frames])
        .find(|name| path_problem(name).is_some())
    {
        return Err(WriteError::BadName(name.clone()));
    }
    std::fs::create_dir_all(folder).map_err(io(folder))?;
    if std::fs::read_dir(folder)
        .map_err(io(folder))?
        .next()
        .is_some()
    {
        return Err(WriteError::NotEmpty(folder.to_owned()));
    }
    for (index, row) in rows.iter().enumerate() {
        let path = folder.join(&row.file);
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent).map_err(io(parent))?;
        }
        let bytes = bytes_of(index).map_err(WriteError::Frame)?;
        put(&path, &bytes).map_err(io(&path))?;
    }
    let list = folder.join(&manifest.frames);
    put(&list, FrameRow::write_all(rows).as_bytes()).map_err(io(&list))?;
    let path = folder.join("manifest.toml");
    put(&path, manifest.to_toml().as_bytes()).map_err(io(&path))
}

fn put(path: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let mut file = std::fs::File::create_new(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::series::{FrameReadError, Series};

    #[test]
    fn a_series_comes_out_as_it_went_in_bit_for_bit() {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/checker");
        let series = Series::open(&source).unwrap();
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("a/b");
        let rows = &series.rows()[..9];
        write(&folder, series.manifest(), rows, |i| series.read_bytes(i)).unwrap();
        let copy = Series::open(&folder).unwrap();
        assert_eq!(copy.manifest(), series.manifest());
        assert_eq!(copy.rows(), rows);
        for i in 0..rows.len() {
            assert_eq!(copy.read_bytes(i).unwrap(), series.read_bytes(i).unwrap());
        }
        let again = write(&folder, series.manifest(), rows, |i| series.read_bytes(i));
        assert!(matches!(again, Err(WriteError::NotEmpty(_))));
    }

    #[test]
    fn a_frame_that_cannot_be_had_leaves_no_series_behind() {
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/checker");
        let series = Series::open(&source).unwrap();
        let place = tempfile::tempdir().unwrap();
        let missing = |_| {
            Err(FrameReadError::Missing {
                file: "x".to_owned(),
            })
        };
        assert!(write(place.path(), series.manifest(), series.rows(), missing).is_err());
        assert!(Series::open(place.path()).is_err());
    }
}
