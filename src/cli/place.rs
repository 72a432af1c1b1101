//! Whether an answer can be written where it is wanted, asked before the work that it takes.

use std::fs::{self, OpenOptions};
use std::path::Path;

use anyhow::{Context, anyhow};

use super::CliError;

/// A file that can be made or written over. What is in it stays as it is.
///
/// # Errors
/// Bad input, with the system's reason, where it cannot.
pub fn for_file(path: &Path) -> Result<(), CliError> {
    let new = !path.exists();
    let opened = OpenOptions::new().create(true).append(true).open(path);
    opened
        .and_then(|_| if new { fs::remove_file(path) } else { Ok(()) })
        .with_context(|| format!("cannot write {}", path.display()))
        .map_err(CliError::bad_input)
}

/// A folder that takes files; it is made where it is not there.
///
/// # Errors
/// Bad input for a file in its place, and, with the system's reason, where it takes none.
pub fn for_files(folder: &Path) -> Result<(), CliError> {
    if folder.is_file() {
        return Err(CliError::bad_input(anyhow!(
            "{} is a file, and a folder is needed: name another one",
            folder.display()
        )));
    }
    let probe = folder.join(format!(".ridged-{}", std::process::id()));
    fs::create_dir_all(folder)
        .and_then(|()| fs::write(&probe, []))
        .and_then(|()| fs::remove_file(&probe))
        .with_context(|| format!("cannot write into {}", folder.display()))
        .map_err(CliError::bad_input)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn asking_leaves_files_and_folders_as_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.csv");
        for_file(&file).unwrap();
        assert!(!file.exists());
        fs::write(&file, "kept").unwrap();
        for_file(&file).unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), "kept");
        let deep = folder.path().join("b/c");
        for_files(&deep).unwrap();
        assert_eq!(fs::read_dir(&deep).unwrap().count(), 0);
    }

    #[test]
    fn what_cannot_be_written_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let refused = [
            for_file(&folder.path().join("none/a.csv")),
            for_file(folder.path()),
            for_files(&file.join("below")),
        ];
        for answer in refused {
            let Err(CliError::BadInput(error)) = answer else {
                panic!("{answer:?}");
            };
            assert!(format!("{error:#}").contains("cannot write"), "{error:#}");
        }
        let Err(CliError::BadInput(error)) = for_files(&file) else {
            panic!("a file is no folder");
        };
        assert!(error.to_string().contains("is a file"), "{error}");
    }
}
