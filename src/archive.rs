//! Opens zip archives whose content is untrusted.

use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Component, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use zip::ZipArchive;
use zip::read::ZipFile;

/// Most bytes that are read to find the table of contents and to read it: enough for 65,535 files.
const CONTENTS_BYTES_MAX: u64 = 16 << 20;
/// Where the end of the table of contents may be: its record, and a comment of any length.
const END_BYTES_MAX: u64 = 22 + 65_535;
/// Marks the end of a table of contents, and the place of its large form (PKWARE APPNOTE 4.3.16 and 4.3.15).
const END: &[u8] = b"PK\x05\x06";
const LARGE_FORM: &[u8] = b"PK\x06\x07";
/// Bytes of the record with the place of the large form, which is just before the end.
const LARGE_FORM_BYTES: u64 = 20;

/// A reader that gives a limited number of bytes; what is read twice counts twice.
#[derive(Debug)]
pub struct Bounded<R> {
    inner: R,
    left: Arc<AtomicU64>,
}

impl<R: Read> Read for Bounded<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let left = self.left.load(Ordering::Relaxed);
        if left == 0 {
            return Err(io::Error::other("its table of contents is too large"));
        }
        let most = usize::try_from(left).map_or(buffer.len(), |left| left.min(buffer.len()));
        let read = self.inner.read(&mut buffer[..most])?;
        self.left.store(left - read as u64, Ordering::Relaxed);
        Ok(read)
    }
}

impl<R: Seek> Seek for Bounded<R> {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.inner.seek(to)
    }
}

/// Opens an archive with at most 65,535 files and 4 GB. The large form of the table of contents is refused: it may state a
/// file for every 46 bytes of the archive, and memory would be taken for all of them at once.
///
/// # Errors
/// What is wrong with the archive.
pub fn open<R: Read + Seek>(mut reader: R) -> Result<ZipArchive<Bounded<R>>, String> {
    let wrong = |error: io::Error| error.to_string();
    let length = reader.seek(SeekFrom::End(0)).map_err(wrong)?;
    let tail_begins = length.saturating_sub(END_BYTES_MAX + LARGE_FORM_BYTES);
    reader.seek(SeekFrom::Start(tail_begins)).map_err(wrong)?;
    let mut tail = Vec::new();
    (&mut reader)
        .take(END_BYTES_MAX + LARGE_FORM_BYTES)
        .read_to_end(&mut tail)
        .map_err(wrong)?;
    let before = LARGE_FORM_BYTES as usize;
    let is_large = (before..tail.len())
        .any(|at| tail[at..].starts_with(END) && tail[at - before..].starts_with(LARGE_FORM));
    if is_large {
        return Err("it has more than 65,535 files or 4 GB".to_owned());
    }
    let left = Arc::new(AtomicU64::new(CONTENTS_BYTES_MAX));
    let bounded = Bounded {
        inner: reader,
        left: Arc::clone(&left),
    };
    let archive = ZipArchive::new(bounded).map_err(|error| error.to_string())?;
    left.store(u64::MAX, Ordering::Relaxed);
    Ok(archive)
}

/// Returns the path of a file below the folder it is unpacked to; `None` for links and for paths that lead elsewhere.
#[must_use]
pub fn path_within<R: Read>(member: &ZipFile<'_, R>) -> Option<PathBuf> {
    let name = member.name().ok()?;
    // Some programs on Windows write backslashes.
    let path = PathBuf::from(name.replace('\\', "/"));
    let is_below = path
        .components()
        .all(|part| matches!(part, Component::Normal(_)));
    let is_named = !name.contains('\0') && path.components().next().is_some();
    (is_below && is_named && !member.is_symlink()).then_some(path)
}

#[cfg(test)]
mod tests {
    use std::io::{Cursor, Write};

    use zip::write::SimpleFileOptions;

    use super::*;

    fn packed(members: &[(&str, &str)]) -> Vec<u8> {
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        for (name, content) in members {
            zip.start_file(*name, SimpleFileOptions::default()).unwrap();
            zip.write_all(content.as_bytes()).unwrap();
        }
        zip.finish().unwrap().into_inner()
    }

    #[test]
    fn paths_that_lead_out_of_the_folder_are_not_within() {
        let within = |name: &str| {
            let mut archive = open(Cursor::new(packed(&[(name, "a")]))).unwrap();
            let member = archive.by_index(0).unwrap();
            path_within(&member).map(|path| path.display().to_string())
        };
        assert_eq!(within("a/b.png").as_deref(), Some("a/b.png"));
        assert_eq!(within("a\\b.png").as_deref(), Some("a/b.png"));
        for name in ["../a", "a/../../b", "/etc/passwd", "..\\a", "a/..", ".."] {
            assert_eq!(within(name), None, "{name}");
        }
    }

    #[test]
    fn a_table_of_contents_that_states_a_million_million_files_takes_no_memory() {
        let mut bytes = b"PK\x06\x06".to_vec();
        bytes.extend(44u64.to_le_bytes());
        bytes.extend([45, 0, 45, 0]);
        bytes.extend([0; 8]);
        let files = 1u64 << 40;
        bytes.extend(files.to_le_bytes());
        bytes.extend(files.to_le_bytes());
        bytes.extend((files * 46).to_le_bytes());
        bytes.extend((files * 2).to_le_bytes());
        bytes.extend(LARGE_FORM);
        bytes.extend([0; 4]);
        bytes.extend(0u64.to_le_bytes());
        bytes.extend([1, 0, 0, 0]);
        bytes.extend(END);
        bytes.extend([0; 4]);
        bytes.extend([255; 12]);
        bytes.extend([0; 2]);
        let error = open(Cursor::new(bytes)).unwrap_err();
        assert!(error.contains("65,535 files"), "{error}");
    }

    #[test]
    fn a_table_of_contents_that_is_too_large_is_refused() {
        let long = "n".repeat(60_000);
        let names: Vec<String> = (0..300).map(|n| format!("{n}{long}")).collect();
        let members: Vec<(&str, &str)> = names.iter().map(|name| (name.as_str(), "")).collect();
        let error = open(Cursor::new(packed(&members))).unwrap_err();
        assert!(error.contains("too large"), "{error}");
        assert!(open(Cursor::new(packed(&members[..3]))).is_ok());
        assert!(open(Cursor::new(b"no archive")).is_err());
    }
}
