//! Refuses outputs that would overwrite inputs.

use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use anyhow::anyhow;

use crate::cli::CliError;
use crate::series::Series;

/// Refuses an output file that is one of a series' own files.
///
/// # Errors
/// Bad input, with the name of that file.
pub fn no_file_of_series(out: &Path, series: &Series) -> Result<(), CliError> {
    match files(series).iter().find(|file| same_file(file, out)) {
        Some(file) => Err(CliError::bad_input(anyhow!(
            "{} is a file of the series, {}: choose another name",
            out.display(),
            file.display()
        ))),
        None => Ok(()),
    }
}

/// Refuses an output file that is an input.
///
/// # Errors
/// Bad input, with the name of that file.
pub fn not_the_input(out: &Path, input: &Path) -> Result<(), CliError> {
    match same_file(out, input) {
        true => Err(CliError::bad_input(anyhow!(
            "{} is an input: choose another name for the output",
            out.display()
        ))),
        false => Ok(()),
    }
}

/// Refuses an output folder that contains frames of a series, or is within such a folder. The folder of the series itself
/// counts only where frames are beside its manifest, and folders in it do not count.
///
/// # Errors
/// Bad input, with the name of that folder.
pub fn no_folder_of_frames(out: &Path, series: &Series) -> Result<(), CliError> {
    let out_there = there(out);
    let mut folders: Vec<PathBuf> = series
        .paths()
        .iter()
        .filter_map(|file| file.parent().map(Path::to_owned))
        .collect();
    folders.dedup();
    for folder in folders {
        let folder = there(&folder);
        let taken = match folder == series.folder() {
            true => out_there == folder,
            false => out_there.starts_with(&folder),
        };
        if taken {
            return Err(CliError::bad_input(anyhow!(
                "{} contains frames of the series: choose another folder",
                out.display()
            )));
        }
    }
    Ok(())
}

/// The files that a series is read from.
fn files(series: &Series) -> Vec<PathBuf> {
    let names = ["manifest.toml", series.manifest().frames.as_str()];
    let texts = names.map(|name| series.folder().join(name));
    texts.into_iter().chain(series.paths().to_vec()).collect()
}

/// Returns the absolute path without links, as far as it exists.
fn there(path: &Path) -> PathBuf {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    for above in path.ancestors() {
        if let (Ok(whole), Ok(rest)) = (above.canonicalize(), path.strip_prefix(above)) {
            return match rest.as_os_str().is_empty() {
                true => whole,
                false => whole.join(rest),
            };
        }
    }
    path
}

/// Whether two paths lead to the same file.
pub fn same_file(a: &Path, b: &Path) -> bool {
    let identity = |path: &Path| path.metadata().map(|m| (m.dev(), m.ino()));
    matches!((identity(a), identity(b)), (Ok(a), Ok(b)) if a == b)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Copies a series' text files, with one frame of another name.
    fn copied() -> (tempfile::TempDir, Series) {
        let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/polymer-10");
        let folder = tempfile::tempdir().unwrap();
        for name in ["manifest.toml", "frames.csv"] {
            std::fs::copy(from.join(name), folder.path().join(name)).unwrap();
        }
        std::fs::create_dir(folder.path().join("frames")).unwrap();
        let series = Series::open(folder.path()).unwrap();
        let first = folder.path().join(&series.rows()[0].file);
        std::fs::write(first, "a frame").unwrap();
        (folder, series)
    }

    fn refused(answer: Result<(), CliError>) -> bool {
        match answer {
            Ok(()) => false,
            Err(CliError::BadInput(_)) => true,
            Err(other) => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_file_of_the_series_is_refused_as_output() {
        let (folder, series) = copied();
        let frame = series.rows()[0].file.clone();
        let link = folder.path().join("link.svg");
        std::os::unix::fs::symlink(folder.path().join("frames.csv"), &link).unwrap();
        for name in ["manifest.toml", "frames.csv", &frame, "link.svg"] {
            let out = folder.path().join(name);
            assert!(refused(no_file_of_series(&out, &series)), "{name}");
        }
        for name in ["contrast.svg", "frames/contrast.svg"] {
            let out = folder.path().join(name);
            assert!(!refused(no_file_of_series(&out, &series)), "{name}");
        }
    }

    #[test]
    fn a_folder_of_frames_is_refused_for_a_map() {
        let (folder, series) = copied();
        for (name, wanted) in [
            ("frames", true),
            ("frames/map", true),
            ("frames/../frames", true),
            ("map", false),
            ("framesmap", false),
            (".", false),
        ] {
            let out = folder.path().join(name);
            assert_eq!(
                refused(no_folder_of_frames(&out, &series)),
                wanted,
                "{name}"
            );
        }
        // With frames beside the manifest, its folder is refused; a folder in it is not.
        let list = folder.path().join("frames.csv");
        let text = std::fs::read_to_string(&list).unwrap();
        std::fs::write(&list, text.replace("frames/", "")).unwrap();
        let series = Series::open(folder.path()).unwrap();
        assert!(refused(no_folder_of_frames(folder.path(), &series)));
        assert!(!refused(no_folder_of_frames(
            &folder.path().join("map"),
            &series
        )));
    }
}
