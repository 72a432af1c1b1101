//! Unpacks a zip archive with a recorded series. Every byte of it is untrusted.

use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use crate::archive;

/// What packing programs add.
const ASIDE: [&str; 2] = ["__MACOSX", ".DS_Store"];

/// Why an archive gives no folder of a series.
#[derive(Debug, thiserror::Error)]
pub enum ArchiveError {
    /// The archive is wrong.
    #[error("{name}: {cause}; {remedy}")]
    Invalid {
        /// Name of the archive.
        name: String,
        /// What is wrong.
        cause: String,
        /// What to do.
        remedy: &'static str,
    },
    /// The unpacked files need more space than there is.
    #[error(
        "the unpacked files of {name} have {needed} bytes, more than the {room} bytes that are free for them"
    )]
    NoRoom {
        /// Name of the archive.
        name: String,
        /// Bytes of the unpacked files, as far as they are known.
        needed: u64,
        /// Bytes that are free.
        room: u64,
    },
    /// A file cannot be read or written.
    #[error("{} cannot be unpacked: {source}", .file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// The caller cancelled it.
    #[error("the archive was not unpacked to the end")]
    Cancelled,
}

/// Unpacks an archive into a folder, at most `room` bytes, and returns the folder that contains manifest.toml.
///
/// # Errors
/// [`ArchiveError`]; files that were unpacked before it stay.
pub fn unpack(
    archive: &Path,
    into: &Path,
    room: u64,
    cancel: &AtomicBool,
) -> Result<PathBuf, ArchiveError> {
    let name = last_part(archive);
    let invalid = |cause: String, remedy| ArchiveError::Invalid {
        name: name.clone(),
        cause,
        remedy,
    };
    let not_read = |error: &dyn std::fmt::Display| {
        invalid(
            format!("this zip archive cannot be read: {error}"),
            "pack the folder of the series as .zip without a password, or import it as a folder",
        )
    };
    let file = File::open(archive).map_err(|source| ArchiveError::Io {
        file: archive.to_owned(),
        source,
    })?;
    let mut zip = archive::open(file).map_err(|error| not_read(&error))?;
    let mut folders = Vec::new();
    let mut left = room;
    for number in 0..zip.len() {
        if cancel.load(Ordering::Relaxed) {
            return Err(ArchiveError::Cancelled);
        }
        let mut member = zip.by_index(number).map_err(|error| not_read(&error))?;
        let Some(place) = archive::path_within(&member) else {
            let name = String::from_utf8_lossy(member.name_raw());
            return Err(invalid(
                format!(
                    "it contains {:?}, which is not a file within it",
                    start_of(&name)
                ),
                "pack the folder of the series itself, without links",
            ));
        };
        if member.is_dir()
            || place
                .iter()
                .any(|part| ASIDE.iter().any(|aside| part == *aside))
        {
            continue;
        }
        let no_room = |needed| ArchiveError::NoRoom {
            name: name.clone(),
            needed,
            room,
        };
        let stated = member.size();
        if stated > left {
            return Err(no_room((room - left).saturating_add(stated)));
        }
        let to = into.join(&place);
        let io = |source| ArchiveError::Io {
            file: to.clone(),
            source,
        };
        if let Some(folder) = to.parent() {
            std::fs::create_dir_all(folder).map_err(io)?;
        }
        let mut out = File::create_new(&to).map_err(|source| match source.kind() {
            io::ErrorKind::AlreadyExists => invalid(
                format!("it contains {:?} twice", start_of(&place.to_string_lossy())),
                "pack each file once",
            ),
            _ => io(source),
        })?;
        // The stated size may be wrong.
        let written = io::copy(&mut (&mut member).take(left.saturating_add(1)), &mut out);
        let written = written.map_err(|source| match source.kind() {
            // Errors of the member: its checksum, or bytes that cannot be unpacked.
            io::ErrorKind::InvalidData
            | io::ErrorKind::InvalidInput
            | io::ErrorKind::UnexpectedEof => invalid(
                format!(
                    "{:?} in it is damaged: {source}",
                    start_of(&place.to_string_lossy())
                ),
                "copy it again or pack it again",
            ),
            _ => io(source),
        })?;
        if written > left {
            return Err(no_room(room.saturating_add(1)));
        }
        left -= written;
        if to.file_name().is_some_and(|file| file == "manifest.toml") {
            folders.extend(to.parent().map(Path::to_owned));
        }
    }
    let depth = |folder: &PathBuf| folder.components().count();
    folders.sort_by_key(depth);
    match &folders[..] {
        [] => Err(invalid(
            "it contains no manifest.toml".to_owned(),
            "pack the folder with manifest.toml, frames.csv and the frames",
        )),
        [a, b, ..] if depth(a) == depth(b) => Err(invalid(
            format!(
                "it contains more than one series ({}, {})",
                last_part(a),
                last_part(b)
            ),
            "pack each series in an archive of its own",
        )),
        [folder, ..] => Ok(folder.clone()),
    }
}

fn last_part(path: &Path) -> String {
    let last = path.file_name().unwrap_or(path.as_os_str());
    last.to_string_lossy().into_owned()
}

/// The start of a name of any length, for a message.
fn start_of(name: &str) -> String {
    const LENGTH_MAX: usize = 80;
    match name.chars().count() > LENGTH_MAX {
        true => name.chars().take(LENGTH_MAX).chain(['…']).collect(),
        false => name.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use zip::write::SimpleFileOptions;

    use super::*;

    /// Packs files, unpacks them with so much room, and returns the folder below the place or the error.
    fn unpacked(members: &[(&str, &str)], room: u64) -> Result<PathBuf, String> {
        let place = tempfile::tempdir().unwrap();
        let archive = place.path().join("part.zip");
        let mut zip = zip::ZipWriter::new(File::create(&archive).unwrap());
        for (name, content) in members {
            let options = SimpleFileOptions::default();
            match content.strip_prefix("link to ") {
                Some(target) => zip.add_symlink(*name, target, options).unwrap(),
                None => {
                    zip.start_file(*name, options).unwrap();
                    zip.write_all(content.as_bytes()).unwrap();
                }
            }
        }
        zip.finish().unwrap();
        let into = place.path().join("unpacked");
        let found = unpack(&archive, &into, room, &AtomicBool::new(false));
        let found = found.map_err(|error| error.to_string())?;
        assert!(found.join("manifest.toml").is_file());
        Ok(found.strip_prefix(&into).unwrap().to_owned())
    }

    #[test]
    fn a_series_is_found_at_the_top_or_in_its_folder() {
        let whole = [("manifest.toml", "a"), ("frames/1.png", "b")];
        assert_eq!(unpacked(&whole, 100).unwrap(), PathBuf::new());
        let in_folder = [
            ("__MACOSX/part/manifest.toml", "x"),
            ("part/manifest.toml", "a"),
            ("part/.DS_Store", "x"),
            ("part/frames/manifest.toml", "deeper"),
        ];
        assert_eq!(unpacked(&in_folder, 100).unwrap(), PathBuf::from("part"));
        let of_windows = [("part\\manifest.toml", "a"), ("part\\frames\\1.png", "b")];
        assert_eq!(unpacked(&of_windows, 100).unwrap(), PathBuf::from("part"));
    }

    #[test]
    fn what_is_wrong_is_named_with_what_to_do() {
        let refused = |members: &[(&str, &str)], words: &str| {
            let error = unpacked(members, 100).unwrap_err();
            assert!(
                error.contains(words) && error.starts_with("part.zip"),
                "{error}"
            );
        };
        refused(&[("frames.csv", "a")], "no manifest.toml");
        refused(
            &[("a/manifest.toml", "a"), ("b/manifest.toml", "a")],
            "more than one series (a, b)",
        );
        refused(&[("../manifest.toml", "a")], "\"../manifest.toml\"");
        let twice = [("manifest.toml", "a"), ("1.png", "a"), ("\\1.png", "b")];
        refused(&twice[..], "not a file within it");
        let twice = [("f/1.png", "a"), ("f\\1.png", "b")];
        refused(&twice, "\"f/1.png\" twice");
        refused(&[("manifest.toml", "link to /etc/passwd")], "without links");
    }

    #[test]
    fn a_damaged_member_is_named_and_is_no_fault_of_the_disk() {
        use zip::CompressionMethod::{Deflated, Stored};

        let place = tempfile::tempdir().unwrap();
        let archive = place.path().join("part.zip");
        let frame: Vec<u8> = (0..5000_u32).map(|n| (n * n % 251) as u8).collect();
        for method in [Stored, Deflated] {
            let mut zip = zip::ZipWriter::new(io::Cursor::new(Vec::new()));
            let options = SimpleFileOptions::default().compression_method(method);
            for (name, content) in [("manifest.toml", &b"a"[..]), ("frames/1.png", &frame[..])] {
                zip.start_file(name, options).unwrap();
                zip.write_all(content).unwrap();
            }
            let mut bytes = zip.finish().unwrap().into_inner();
            let middle = bytes.len() / 2;
            bytes[middle] ^= 1;
            std::fs::write(&archive, bytes).unwrap();
            let into = tempfile::tempdir().unwrap();
            let error = unpack(&archive, into.path(), 10_000, &AtomicBool::new(false)).unwrap_err();
            assert!(matches!(error, ArchiveError::Invalid { .. }), "{error:?}");
            let text = error.to_string();
            assert!(
                text.starts_with("part.zip: \"frames/1.png\" in it is damaged")
                    && text.ends_with("copy it again or pack it again"),
                "{text}"
            );
        }
    }

    #[test]
    fn no_more_is_unpacked_than_there_is_room() {
        let large = "0".repeat(10_000_000);
        let members = [("manifest.toml", "a"), ("frames/1.png", &large)];
        let error = unpacked(&members, 1_000_000).unwrap_err();
        assert!(error.contains("10000001 bytes"), "{error}");
        assert!(unpacked(&members, 10_000_001).is_ok());
    }
}
