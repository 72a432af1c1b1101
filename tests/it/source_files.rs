//! Files of the repository, for the tests that read sources and documents.

use std::path::{Path, PathBuf};

/// Returns the files of `place` (a file or a folder, relative to the repository) with one of these extensions, sorted.
pub fn files(place: &str, extensions: &[&str]) -> Vec<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let (mut found, mut ahead) = (Vec::new(), vec![root.join(place)]);
    while let Some(path) = ahead.pop() {
        if path.is_dir() {
            let entries = std::fs::read_dir(&path).expect("the folder is readable");
            ahead.extend(entries.map(|entry| entry.expect("an entry is readable").path()));
        } else if path
            .extension()
            .is_some_and(|e| extensions.iter().any(|x| e == *x))
        {
            found.push(path);
        }
    }
    assert!(!found.is_empty(), "{place} has files to read");
    found.sort();
    found
}
