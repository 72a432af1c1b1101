//! Finds the files of a list where the file system spells their names differently.
//!
//! macOS decomposes letters with accents (NFD), lists compose them (NFC), and Windows ignores the case of letters. A file with
//! the exact name always counts; otherwise the only file that differs in nothing else counts.

use std::collections::HashMap;
use std::ffi::OsString;
use std::path::{Component, Path, PathBuf};

use unicode_normalization::UnicodeNormalization;

/// Returns the form of a name that is compared.
fn key(name: &str) -> String {
    name.to_lowercase().nfc().collect()
}

/// The names in a folder by their keys, without the keys that several names have.
type Listing = HashMap<String, Option<OsString>>;

fn listing(folder: &Path) -> Listing {
    let mut names = Listing::new();
    for name in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let name = name.file_name();
        let Some(key) = name.to_str().map(key) else {
            continue;
        };
        names
            .entry(key)
            .and_modify(|other| *other = None)
            .or_insert(Some(name));
    }
    names
}

/// Where in `folder` the listed files are. One that is not there has the path that its name gives.
pub(super) fn paths<'f>(folder: &Path, files: impl Iterator<Item = &'f str>) -> Vec<PathBuf> {
    let mut known: HashMap<PathBuf, Listing> = HashMap::new();
    let path = |file: &str| {
        let listed = folder.join(file);
        if listed.symlink_metadata().is_ok() {
            return listed;
        }
        let mut path = folder.to_owned();
        for part in Path::new(file).components() {
            let Component::Normal(name) = part else {
                continue;
            };
            let next = path.join(name);
            if next.symlink_metadata().is_ok() {
                path = next;
                continue;
            }
            let names = known
                .entry(path.clone())
                .or_insert_with_key(|folder| listing(folder));
            match name.to_str().and_then(|name| names.get(&key(name))) {
                Some(Some(other)) => path.push(other),
                _ => return listed,
            }
        }
        path
    };
    files.map(path).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_found_in_the_other_form_of_unicode_and_in_capitals_unless_two_have_it() {
        let folder = tempfile::tempdir().unwrap();
        let decomposed = folder.path().join("Fru\u{308}hling");
        std::fs::create_dir(&decomposed).unwrap();
        for name in [
            "u\u{308}.png",
            "B.PNG",
            "two.png",
            "Two.png",
            "c.png",
            "C.png",
        ] {
            std::fs::write(decomposed.join(name), name).unwrap();
        }
        let listed = ["\u{fc}.png", "b.png", "TWO.png", "c.png", "none.png"];
        let files = listed.map(|name| format!("Fr\u{fc}hling/{name}"));
        let found = paths(folder.path(), files.iter().map(String::as_str));
        let read: Vec<_> = found
            .iter()
            .map(|p| std::fs::read_to_string(p).ok())
            .collect();
        let some = |name: &str| Some(name.to_owned());
        assert_eq!(
            read,
            [
                some("u\u{308}.png"),
                some("B.PNG"),
                None,
                some("c.png"),
                None
            ]
        );
        assert_eq!(found[4], folder.path().join(&files[4]));
    }
}
