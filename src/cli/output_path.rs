//! Outputs: whether they can be written, checked before the work that makes them, and files that appear whole.

use std::fs::{self, OpenOptions, Permissions};
use std::io::Write as _;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

use anyhow::{Context, anyhow};

use super::{CliError, kept_part};

/// Checks that a file can be created or overwritten, without changing it. One that holds a stopped run or a shard is not
/// overwritten.
///
/// # Errors
/// Bad input, with the system's reason or the ways out.
pub fn check_file(path: &Path) -> Result<(), CliError> {
    kept_part::none_in(path)?;
    check_writable(path)
}

/// Checks that a file can be created or overwritten, whatever it holds, without changing it.
///
/// # Errors
/// Bad input, with the system's reason.
pub fn check_writable(path: &Path) -> Result<(), CliError> {
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

/// Permissions of a new file, before the user's mask.
const PERMISSIONS: u32 = 0o666;

/// Writes a file that appears whole or not at all: under a temporary name of its own in the same folder, then renamed. Two
/// processes that write the same file do not disturb each other.
///
/// # Errors
/// No result, with the system's reason.
pub fn write_whole(path: &Path, content: &[u8]) -> Result<(), CliError> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    let mut prefix = std::ffi::OsString::from(".");
    prefix.push(path.file_name().unwrap_or_default());
    let written = tempfile::Builder::new()
        .prefix(&prefix)
        .suffix(".part")
        .permissions(Permissions::from_mode(PERMISSIONS))
        .tempfile_in(folder.unwrap_or(Path::new(".")))
        .and_then(|mut file| {
            file.write_all(content)?;
            file.as_file().sync_all()?;
            file.persist(path).map_err(|error| error.error)
        });
    written
        .with_context(|| format!("cannot write {}", path.display()))
        .map_err(CliError::no_result)?;
    Ok(())
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
    fn a_whole_file_replaces_another_and_leaves_no_temporary_one() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.shard");
        for text in ["first", "second"] {
            write_whole(&file, text.as_bytes()).unwrap();
            assert_eq!(fs::read_to_string(&file).unwrap(), text);
        }
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        // Others of a lab may read it, unless the user's mask forbids it.
        let plain = folder.path().join("plain");
        fs::write(&plain, "").unwrap();
        let mode = |path: &Path| path.metadata().unwrap().permissions().mode();
        assert_eq!(mode(&file), mode(&plain));
        let refused = write_whole(&folder.path().join("none/a"), b"");
        assert!(matches!(refused, Err(CliError::NoResult(_))));
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
