//! The folders below which an import over HTTP may read.

use std::path::{Path, PathBuf};

/// Folders with everything below them, links resolved.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Roots(Vec<PathBuf>);

impl Roots {
    /// Takes a list of folders. A folder that does not exist is kept as it is written: it may be a disk that is mounted later.
    #[must_use]
    pub fn new(folders: impl IntoIterator<Item = PathBuf>) -> Roots {
        Roots(folders.into_iter().collect())
    }

    /// Returns the folder with all links resolved, if it is one of the roots or below one.
    ///
    /// # Errors
    /// Says that it is not below a root, and where to add one. A folder that does not exist gets the same answer, so that
    /// no client learns what exists elsewhere.
    pub fn admit(&self, folder: &Path) -> Result<PathBuf, String> {
        let resolved = folder.canonicalize().ok();
        let is_below = |root: &PathBuf, path: &Path| {
            let root = root.canonicalize().unwrap_or_else(|_| root.clone());
            path.starts_with(root)
        };
        let below = |path: &Path| self.0.iter().any(|root| is_below(root, path));
        match resolved {
            Some(path) if below(&path) => Ok(path),
            // A folder below a root that does not exist is reported as missing by the import itself.
            None if below(folder) && !has_parent_steps(folder) => Ok(folder.to_owned()),
            _ => Err(format!(
                "{} is not below a folder that imports may read: {}; add its folder to import.roots in the settings, \
                 or run `ridged import` as the daemon's user",
                folder.display(),
                match &self.0[..] {
                    [] => "the settings name none".to_owned(),
                    roots => roots
                        .iter()
                        .map(|root| root.display().to_string())
                        .collect::<Vec<_>>()
                        .join(", "),
                }
            )),
        }
    }
}

fn has_parent_steps(path: &Path) -> bool {
    path.components()
        .any(|part| part == std::path::Component::ParentDir)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_folders_below_a_root_are_admitted_whatever_links_and_steps_say() {
        let at = tempfile::tempdir().unwrap();
        let (inside, outside) = (at.path().join("home/series"), at.path().join("other"));
        std::fs::create_dir_all(&inside).unwrap();
        std::fs::create_dir_all(&outside).unwrap();
        std::os::unix::fs::symlink(&outside, at.path().join("home/link")).unwrap();
        std::os::unix::fs::symlink(&inside, outside.join("back")).unwrap();
        let roots = Roots::new([at.path().join("home")]);
        let resolved = inside.canonicalize().unwrap();
        assert_eq!(roots.admit(&inside), Ok(resolved.clone()));
        assert_eq!(roots.admit(&outside.join("back")), Ok(resolved));
        assert!(roots.admit(&at.path().join("home/missing")).is_ok());
        for refused in [
            outside.clone(),
            at.path().join("home/link"),
            at.path().join("home/../other"),
            at.path().join("home/../missing"),
            at.path().join("home-of-another"),
            "/etc".into(),
            "/missing".into(),
        ] {
            let error = roots.admit(&refused).unwrap_err();
            assert!(error.contains("import.roots"), "{error}");
        }
        assert!(Roots::default().admit(&inside).is_err());
    }
}
