//! Files that may have been meant by a name that is not there.

use std::cmp::Reverse;
use std::path::Path;

/// Most names that a message lists.
const NAMES_MAX: usize = 5;

/// Returns the names of the files of the same kind beside a missing one, most similar first, as words for the end of a
/// message; empty where there are none.
pub(super) fn instead_of(missing: &Path) -> String {
    let folder = match missing.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let wanted = missing.file_name().unwrap_or_default().to_string_lossy();
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut names: Vec<String> = files
        .map(|file| file.path())
        .filter(|path| path.is_file() && path.extension() == missing.extension())
        .filter_map(|path| Some(path.file_name()?.to_str()?.to_owned()))
        .collect();
    let begins_alike = |name: &str| {
        let pairs = name.chars().zip(wanted.chars());
        pairs.take_while(|(a, b)| a == b).count()
    };
    names.sort();
    names.sort_by_key(|name| Reverse(begins_alike(name)));
    let others = names.len().saturating_sub(NAMES_MAX);
    names.truncate(NAMES_MAX);
    match (names.is_empty(), others) {
        (true, _) => String::new(),
        (false, 0) => format!("; {} has {}", folder.display(), names.join(", ")),
        (false, n) => format!(
            "; {} has {} and {n} more",
            folder.display(),
            names.join(", ")
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn similar_files_of_the_same_kind_come_first() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["glass-over-gold.toml", "steel.toml", "glass.csv"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let words = instead_of(&folder.path().join("glass.toml"));
        assert!(
            words.ends_with(" has glass-over-gold.toml, steel.toml"),
            "{words}"
        );
        assert_eq!(instead_of(&folder.path().join("none/glass.toml")), "");
    }
}
