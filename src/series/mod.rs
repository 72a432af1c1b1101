//! A recorded series (`gonio-series-1`): a folder with `manifest.toml`, `frames.csv` and frames of
//! 16-bit grey, PNG or TIFF.
//!
//! [`Series::open`] reads and checks the two text files. Frames are read one by one, so a series of any length needs the memory
//! of one frame. [`write()`] makes such a folder and keeps the frames bit for bit. This module does not interpret counts; the
//! reduction does.

pub mod archive;
mod check;
mod imaging;
mod keys;
mod manifest;
mod names;
mod rows;
mod text;
mod values;
mod write;

pub use check::TABLE_SCHEMA;
pub use imaging::misaimed;
pub use manifest::{
    CameraFacts, Contradiction, DarkFacts, FlatFacts, INDEX_STD, LayoutFacts, Manifest, Notes,
    RigFacts, SCHEMA, SampleFacts, SampleKind,
};
pub use rows::FrameRow;
pub use write::{WriteError, write};

use std::io::Read;
use std::path::{Path, PathBuf};

use crate::frame::{Frame, FrameError};
use crate::wording::encoding::text_of;
use crate::wording::sheet::decoded;

/// Largest size of a frame list or manifest, bytes.
const TEXT_BYTES_MAX: u64 = 64 << 20;

/// Why a folder is not a series. The text names file, place, cause and remedy.
#[derive(Debug, thiserror::Error)]
pub enum SeriesError {
    /// There is no such folder, or it is a file.
    #[error("{folder} is not a folder; give the folder that contains manifest.toml and frames.csv")]
    NoFolder {
        /// The path that was given.
        folder: String,
    },
    /// A file that every series has is missing.
    #[error("{folder} has no {file}, so it is not a recorded series; {remedy}")]
    MissingFile {
        /// The folder.
        folder: String,
        /// Name of the file that is missing.
        file: String,
        /// What to do.
        remedy: String,
    },
    /// A file cannot be read.
    #[error("{file} cannot be read: {source}; check its permissions")]
    Unreadable {
        /// The file.
        file: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A text file says something that it may not.
    #[error("{file}{}: {key}{cause}; {remedy}", .line.map(|l| format!(" line {l}")).unwrap_or_default())]
    Invalid {
        /// The file.
        file: String,
        /// Line, from 1, where one is known.
        line: Option<usize>,
        /// Key or column with a colon and a space, or empty.
        key: String,
        /// What is wrong.
        cause: String,
        /// What to do.
        remedy: String,
    },
}

/// Why one frame of a series cannot be had.
#[derive(Debug, thiserror::Error)]
pub enum FrameReadError {
    /// The list names a file that is not there.
    #[error("{file} is in the list of frames but not in the folder; restore it or drop its line")]
    Missing {
        /// File as recorded.
        file: String,
    },
    /// The file is there and cannot be read.
    #[error("{file} cannot be read: {source}")]
    Unreadable {
        /// File as recorded.
        file: String,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The bytes are no frame.
    #[error("{file}: {source}")]
    NotAFrame {
        /// File as recorded.
        file: String,
        /// What is wrong with the bytes.
        source: FrameError,
    },
    /// A link leads out of the series' folder.
    #[error(
        "{file} is a link out of the folder of its series, which a daemon does not follow; copy the file into the folder"
    )]
    Outside {
        /// File as recorded.
        file: String,
    },
    /// Whatever else keeps the frames failed.
    #[error("{file}: {source}")]
    Store {
        /// File as recorded.
        file: String,
        /// The keeper's reason.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

/// A recorded series that was opened: its manifest and its list of frames, both checked.
#[derive(Debug, Clone)]
pub struct Series {
    folder: PathBuf,
    manifest: Manifest,
    rows: Vec<FrameRow>,
    /// The frames' files, in the order of the list.
    paths: Vec<PathBuf>,
    manifest_text: String,
    list_text: String,
    follows_links: bool,
}

impl Series {
    /// Opens the series in `folder`: reads and checks `manifest.toml` and the list of frames. The
    /// frames themselves are not touched, and none is read through a link that leads out of the folder.
    ///
    /// # Errors
    /// [`SeriesError`] names file, line, key, cause and remedy.
    pub fn open(folder: &Path) -> Result<Self, SeriesError> {
        Series::opened(folder, false)
    }

    /// The same of a folder of the user's own, whose links are followed wherever they lead.
    ///
    /// # Errors
    /// As [`Series::open`].
    pub fn open_own(folder: &Path) -> Result<Self, SeriesError> {
        Series::opened(folder, true)
    }

    fn opened(folder: &Path, follows_links: bool) -> Result<Self, SeriesError> {
        if !folder.is_dir() {
            return Err(SeriesError::NoFolder {
                folder: folder.display().to_string(),
            });
        }
        let folder = folder
            .canonicalize()
            .map_err(|source| SeriesError::Unreadable {
                file: folder.display().to_string(),
                source,
            })?;
        let manifest_text = read_text(
            &folder,
            "manifest.toml",
            "docs/reference/series.md lists its keys",
        )?;
        let manifest = Manifest::from_outside(&manifest_text, "manifest.toml")?;
        let list_text = read_list(
            &folder,
            &manifest.frames,
            "it lists the frames, one line each",
        )?;
        let rows = FrameRow::read_all(&list_text, &manifest.frames)?;
        let paths = names::paths(&folder, rows.iter().map(|row| row.file.as_str()));
        Ok(Series {
            folder,
            manifest,
            rows,
            paths,
            manifest_text,
            list_text,
            follows_links,
        })
    }

    /// The folder, as an absolute path.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// What the manifest says.
    #[must_use]
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// The list of frames, in the order of the file.
    #[must_use]
    pub fn rows(&self) -> &[FrameRow] {
        &self.rows
    }

    /// The manifest's text.
    #[must_use]
    pub fn manifest_text(&self) -> &str {
        &self.manifest_text
    }

    /// The text of the list of frames.
    #[must_use]
    pub fn list_text(&self) -> &str {
        &self.list_text
    }

    /// The frames' files, in the order of the list.
    #[must_use]
    pub fn paths(&self) -> &[PathBuf] {
        &self.paths
    }

    /// Bytes of frame `index`'s file.
    ///
    /// # Errors
    /// [`FrameReadError`] if the file is missing, unreadable or a link out of the folder.
    ///
    /// # Panics
    /// If `index` is not below `rows().len()`.
    pub fn read_bytes(&self, index: usize) -> Result<Vec<u8>, FrameReadError> {
        let file = &self.rows[index].file;
        let unreadable = |source: std::io::Error| match source.kind() {
            std::io::ErrorKind::NotFound => FrameReadError::Missing { file: file.clone() },
            _ => FrameReadError::Unreadable {
                file: file.clone(),
                source,
            },
        };
        // The list was checked for `..`; a link could still lead elsewhere.
        let path = self.paths[index].canonicalize().map_err(unreadable)?;
        if !self.follows_links && !path.starts_with(&self.folder) {
            return Err(FrameReadError::Outside { file: file.clone() });
        }
        of_a_file(&path)
            .and_then(|()| std::fs::read(&path))
            .map_err(unreadable)
    }

    /// Frame `index`, decoded.
    ///
    /// # Errors
    /// [`FrameReadError`] if the file cannot be read or is no 16-bit grey PNG or TIFF.
    ///
    /// # Panics
    /// If `index` is not below `rows().len()`.
    pub fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        let bytes = self.read_bytes(index)?;
        Frame::read(&bytes).map_err(|source| FrameReadError::NotAFrame {
            file: self.rows[index].file.clone(),
            source,
        })
    }
}

/// Refuses a pipe or a device, at which a read would wait for ever.
fn of_a_file(path: &Path) -> std::io::Result<()> {
    match std::fs::metadata(path)?.is_file() {
        true => Ok(()),
        false => Err(std::io::Error::other("it is no regular file")),
    }
}

fn read_text(folder: &Path, file: &str, remedy: &str) -> Result<String, SeriesError> {
    decoded(content_of(folder, file, remedy)?).map_err(|(line, byte)| SeriesError::Invalid {
        file: file.to_owned(),
        line: Some(line),
        key: String::new(),
        cause: format!("the byte 0x{byte:02X} is no UTF-8 text"),
        remedy: "save the file as UTF-8".to_owned(),
    })
}

/// Reads a table as spreadsheets save it, in any of their encodings.
fn read_list(folder: &Path, file: &str, remedy: &str) -> Result<String, SeriesError> {
    let content = content_of(folder, file, remedy)?;
    let text = text_of(&content).map_err(|cause| SeriesError::Invalid {
        file: file.to_owned(),
        line: None,
        key: String::new(),
        cause,
        remedy: "docs/reference/series.md describes the list".to_owned(),
    })?;
    Ok(text.into_owned())
}

fn content_of(folder: &Path, file: &str, remedy: &str) -> Result<Vec<u8>, SeriesError> {
    let path = folder.join(file);
    let unreadable = |source: std::io::Error| match source.kind() {
        std::io::ErrorKind::NotFound => SeriesError::MissingFile {
            folder: folder.display().to_string(),
            file: file.to_owned(),
            remedy: remedy.to_owned(),
        },
        _ => SeriesError::Unreadable {
            file: path.display().to_string(),
            source,
        },
    };
    let mut bytes = Vec::new();
    of_a_file(&path)
        .and_then(|()| std::fs::File::open(&path))
        .and_then(|f| f.take(TEXT_BYTES_MAX).read_to_end(&mut bytes))
        .map_err(unreadable)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::FrameKind;

    fn recorded(name: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR"))
            .join("tests/data/series")
            .join(name)
    }

    #[test]
    fn a_series_of_a_pipe_is_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("manifest.toml");
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.unwrap().success());
        let refused = Series::open(folder.path()).unwrap_err();
        let mut words = refused.to_string();
        let mut source = std::error::Error::source(&refused);
        while let Some(cause) = source {
            words += &cause.to_string();
            source = cause.source();
        }
        assert!(words.contains("no regular file"), "{words}");
    }

    #[test]
    fn every_recorded_series_opens_and_each_frame_has_the_manifests_size() {
        for (name, frames) in [
            ("polymer-10", 210),
            ("steel-15", 354),
            ("checker", 31),
            ("paper-rig-full", 57),
        ] {
            let series = Series::open(&recorded(name)).unwrap();
            assert_eq!(series.rows().len(), frames, "{name}");
            assert_eq!(series.manifest().name, name);
            for kind in [FrameKind::Dark, FrameKind::Flat, FrameKind::Sample] {
                let index = series.rows().iter().position(|r| r.kind == kind).unwrap();
                let frame = series.read(index).unwrap();
                assert_eq!(frame.width_px(), series.manifest().camera.width_px);
            }
        }
    }

    #[test]
    fn a_folder_without_a_manifest_says_so() {
        let empty = tempfile::tempdir().unwrap();
        let said = Series::open(empty.path()).unwrap_err().to_string();
        assert!(said.contains("manifest.toml"), "{said}");
        let said = Series::open(&empty.path().join("nowhere"))
            .unwrap_err()
            .to_string();
        assert!(said.contains("is not a folder"), "{said}");
    }

    #[test]
    fn a_link_out_of_the_folder_is_followed_in_a_folder_of_the_users_own_alone() {
        let place = tempfile::tempdir().unwrap();
        let outside = place.path().join("secret.png");
        std::fs::write(&outside, b"x").unwrap();
        let folder = place.path().join("series");
        std::fs::create_dir(&folder).unwrap();
        std::fs::copy(
            recorded("checker").join("manifest.toml"),
            folder.join("manifest.toml"),
        )
        .unwrap();
        std::fs::write(
            folder.join("frames.csv"),
            "file,kind,theta_c_deg,phi_s_deg,exposure_s\na.png,dark,0,0,0.04\nb.png,dark,0,0,0.04\n",
        )
        .unwrap();
        std::os::unix::fs::symlink(&outside, folder.join("a.png")).unwrap();
        let own = Series::open_own(&folder).unwrap();
        assert_eq!(own.read_bytes(0).unwrap(), b"x");
        let series = Series::open(&folder).unwrap();
        assert!(matches!(
            series.read_bytes(0),
            Err(FrameReadError::Outside { .. })
        ));
        assert!(matches!(
            series.read_bytes(1),
            Err(FrameReadError::Missing { .. })
        ));
    }
}
