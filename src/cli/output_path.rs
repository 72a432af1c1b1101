//! Checks that outputs can be written, before the work that makes them.

use std::fs::{self, OpenOptions};
use std::path::Path;

use anyhow::{Context, anyhow};

use super::CliError;

/// Checks that a file can be created or overwritten, without changing it.
///
/// # Errors
/// Bad input, with the system's reason.
pub fn check_file(path: &Path) -> Result<(), CliError> {
    let new = !path.exists();
    let opened = OpenOptions::new().create(true).append(true).open(path);
    opened
        .and_then(|_| if new { fs::remove_file(path) } else { Ok(()) })
        .with_context(|| format!("cannot write {}", path.display()))
        .map_err(CliError::bad_input)
}

/// Checks that files can be written into a folder; creates it if it does not exist.
///
/// # Errors
/// Bad input for a file of that name, or with the system's reason.
pub fn check_folder(folder: &Path) -> Result<(), CliError> {
    if folder.is_file() {
        return Err(CliError::bad_input(anyhow!(
            "{} is a file, expected a folder",
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
    fn checks_leave_files_and_folders_unchanged() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.csv");
        check_file(&file).unwrap();
        assert!(!file.exists());
        fs::write(&file, "kept").unwrap();
        check_file(&file).unwrap();
        assert_eq!(fs::read_to_string(&file).unwrap(), "kept");
        let deep = folder.path().join("b/c");
        check_folder(&deep).unwrap();
        assert_eq!(fs::read_dir(&deep).unwrap().count(), 0);
    }

    #[test]
    fn an_output_that_cannot_be_written_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        fs::write(&file, "").unwrap();
        let refused = [
            check_file(&folder.path().join("none/a.csv")),
            check_file(folder.path()),
            check_folder(&file.join("below")),
        ];
        for answer in refused {
            let Err(CliError::BadInput(error)) = answer else {
                panic!("{answer:?}");
            };
            assert!(format!("{error:#}").contains("cannot write"), "{error:#}");
        }
        let Err(CliError::BadInput(error)) = check_folder(&file) else {
            panic!("a file is no folder");
        };
        assert!(error.to_string().contains("is a file"), "{error}");
    }
}
