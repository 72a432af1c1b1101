//! The tokens of a data folder: `tokens.json`, readable by the daemon's user only. It has the fingerprints of the tokens,
//! never the tokens.
//!
//! The command line changes it, also beside a running daemon, and the daemon reads it again when it has changed: a revoked
//! token is refused from the next request on.

use std::fs::{self, File, OpenOptions};
use std::io::{ErrorKind, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use serde::{Deserialize, Serialize};

use super::{DAEMON, Fingerprint, LOCAL, Role, Secret};

/// Name of the file in the data folder.
pub const TOKENS_FILE: &str = "tokens.json";
/// Longest name of a token.
const NAME_MAX: usize = 64;

/// A token as it is stored.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TokenRow {
    /// Name of its holder: a person or a script.
    pub name: String,
    /// What it may do.
    pub role: Role,
    /// Its SHA-256, hexadecimal.
    pub sha256: String,
    /// When it was made, RFC 3339 in UTC.
    pub created_at: String,
    /// When it was revoked; none while it is valid. Its name stays taken, since events and scans have it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub revoked_at: Option<String>,
}

#[derive(Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Content {
    tokens: Vec<TokenRow>,
}

/// Who holds a valid token.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TokenHolder {
    /// Name of the token.
    pub name: String,
    /// Its role.
    pub role: Role,
}

/// Why the tokens cannot be read or changed.
#[derive(Debug, thiserror::Error)]
pub enum TokenFileError {
    /// The file cannot be read or written.
    #[error("cannot {action} {}: {source}", path.display())]
    File {
        /// What was attempted.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The file is damaged.
    #[error(
        "{} is not a file of tokens ({detail}); restore it from a copy, or move it away and create the tokens again",
        path.display()
    )]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        detail: String,
    },
    /// The name cannot be used.
    #[error(
        "`{name}` is not a valid name of a token: expected 1 to {NAME_MAX} letters, digits, dots, dashes and underscores, and \
         neither `local` nor `daemon`"
    )]
    Name {
        /// What was given.
        name: String,
    },
    /// The name is taken.
    #[error(
        "there is a token `{name}` already, valid or revoked: events and scans name it; choose another name"
    )]
    Taken {
        /// What was given.
        name: String,
    },
    /// No valid token has this name.
    #[error("there is no valid token `{name}`; `ridged token list` shows all of them")]
    Unknown {
        /// What was given.
        name: String,
    },
}

/// When and which file was read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Stamp {
    inode: u64,
    modified: (i64, i64),
    bytes: u64,
}

impl Stamp {
    fn of(path: &Path) -> std::io::Result<Stamp> {
        let file = fs::metadata(path)?;
        Ok(Stamp {
            inode: file.ino(),
            modified: (file.mtime(), file.mtime_nsec()),
            bytes: file.len(),
        })
    }
}

/// The tokens of a data folder.
#[derive(Debug)]
pub struct TokenFile {
    path: PathBuf,
    /// What was read last.
    read: Mutex<Option<(Stamp, Arc<Vec<TokenRow>>)>>,
}

impl TokenFile {
    /// Returns the tokens of a data folder. Nothing is read yet.
    #[must_use]
    pub fn of_folder(folder: &Path) -> TokenFile {
        TokenFile {
            path: folder.join(TOKENS_FILE),
            read: Mutex::default(),
        }
    }

    fn file_error(&self, action: &'static str) -> impl FnOnce(std::io::Error) -> TokenFileError {
        let path = self.path.clone();
        move |source| TokenFileError::File {
            action,
            path,
            source,
        }
    }

    /// Returns all tokens, revoked ones included; reads the file if it has changed.
    ///
    /// # Errors
    /// The file cannot be read or is damaged. A missing file has the tokens that were read last.
    pub fn rows(&self) -> Result<Arc<Vec<TokenRow>>, TokenFileError> {
        let stamp = match Stamp::of(&self.path) {
            Ok(stamp) => stamp,
            // A data folder that went away revokes nothing: the holder of a token must still be able to stop the rig.
            Err(error) if error.kind() == ErrorKind::NotFound => {
                let read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
                let last = read.as_ref().map(|(_, rows)| Arc::clone(rows));
                return Ok(last.unwrap_or_default());
            }
            Err(error) => return Err(self.file_error("read")(error)),
        };
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((then, rows)) = read.as_ref()
            && *then == stamp
        {
            return Ok(Arc::clone(rows));
        }
        let rows = Arc::new(self.load()?);
        *read = Some((stamp, Arc::clone(&rows)));
        Ok(rows)
    }

    fn load(&self) -> Result<Vec<TokenRow>, TokenFileError> {
        let text = fs::read_to_string(&self.path).map_err(self.file_error("read"))?;
        let content: Content =
            serde_json::from_str(&text).map_err(|error| TokenFileError::Damaged {
                path: self.path.clone(),
                detail: error.to_string(),
            })?;
        Ok(content.tokens)
    }

    /// Returns the number of valid tokens.
    ///
    /// # Errors
    /// As [`TokenFile::rows`].
    pub fn count_valid(&self) -> Result<usize, TokenFileError> {
        let rows = self.rows()?;
        Ok(rows.iter().filter(|row| row.revoked_at.is_none()).count())
    }

    fn valid(&self, is_it: impl Fn(&TokenRow) -> bool) -> Option<TokenHolder> {
        let rows = match self.rows() {
            Ok(rows) => rows,
            Err(error) => {
                tracing::error!(%error, "no token is accepted: {error}");
                return None;
            }
        };
        let found = rows
            .iter()
            .find(|row| row.revoked_at.is_none() && is_it(row))?;
        Some(TokenHolder {
            name: found.name.clone(),
            role: found.role,
        })
    }

    /// Returns the holder of a token that a client presents; none if it is not valid, or if the file cannot be read.
    #[must_use]
    pub fn holder(&self, presented: &str) -> Option<TokenHolder> {
        let sha256 = Fingerprint::of(presented).hex();
        self.valid(|row| row.sha256 == sha256)
    }

    /// Returns the holder of the valid token of this name.
    #[must_use]
    pub fn named(&self, name: &str) -> Option<TokenHolder> {
        self.valid(|row| row.name == name)
    }

    /// Adds a token, and returns it: it is not stored and cannot be shown again.
    ///
    /// # Errors
    /// [`TokenFileError::Name`], [`TokenFileError::Taken`], or the file cannot be changed.
    pub fn create(&self, name: &str, role: Role, at: &str) -> Result<Secret, TokenFileError> {
        let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '.' | '-' | '_');
        if name.is_empty()
            || name.len() > NAME_MAX
            || !name.chars().all(plain)
            || [LOCAL, DAEMON].contains(&name)
        {
            return Err(TokenFileError::Name { name: name.into() });
        }
        let secret = Secret::random().map_err(self.file_error("make a token for"))?;
        self.change(|rows| {
            if rows.iter().any(|row| row.name == name) {
                return Err(TokenFileError::Taken { name: name.into() });
            }
            rows.push(TokenRow {
                name: name.into(),
                role,
                sha256: secret.fingerprint().hex(),
                created_at: at.into(),
                revoked_at: None,
            });
            Ok(())
        })?;
        Ok(secret)
    }

    /// Revokes the token of this name. A running daemon refuses it from the next request on.
    ///
    /// # Errors
    /// [`TokenFileError::Unknown`], or the file cannot be changed.
    pub fn revoke(&self, name: &str, at: &str) -> Result<(), TokenFileError> {
        self.change(|rows| {
            let mut valid = rows.iter_mut().filter(|row| row.revoked_at.is_none());
            let row = valid.find(|row| row.name == name);
            let row = row.ok_or_else(|| TokenFileError::Unknown { name: name.into() })?;
            row.revoked_at = Some(at.into());
            Ok(())
        })
    }

    /// Changes the rows and replaces the file, while no other process changes it.
    fn change(
        &self,
        change: impl FnOnce(&mut Vec<TokenRow>) -> Result<(), TokenFileError>,
    ) -> Result<(), TokenFileError> {
        let folder = self.path.parent().unwrap_or(Path::new("."));
        fs::create_dir_all(folder).map_err(self.file_error("make the folder of"))?;
        // Not the folder: a running daemon holds the lock of its data folder.
        let lock = OpenOptions::new()
            .write(true)
            .create(true)
            .truncate(false)
            .mode(0o600)
            .open(self.path.with_extension("json.lock"))
            .map_err(self.file_error("lock"))?;
        lock.lock().map_err(self.file_error("lock"))?;
        let mut tokens = match self.path.exists() {
            true => self.load()?,
            false => Vec::new(),
        };
        change(&mut tokens)?;
        let text = serde_json::to_string_pretty(&Content { tokens }).map_err(|error| {
            TokenFileError::Damaged {
                path: self.path.clone(),
                detail: error.to_string(),
            }
        })?;
        let part = self.path.with_extension("json.part");
        let written = (|| {
            let mut file = OpenOptions::new()
                .write(true)
                .create(true)
                .truncate(true)
                .mode(0o600)
                .open(&part)?;
            file.write_all(text.as_bytes())?;
            file.write_all(b"\n")?;
            file.sync_all()?;
            fs::rename(&part, &self.path)?;
            File::open(folder)?.sync_all()
        })();
        written.map_err(self.file_error("write"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    const AT: &str = "2026-01-01T00:00:00Z";

    #[test]
    fn a_token_is_valid_until_it_is_revoked_also_for_a_reader_that_is_open() {
        let folder = tempfile::tempdir().unwrap();
        let (daemon, command) = (
            TokenFile::of_folder(folder.path()),
            TokenFile::of_folder(folder.path()),
        );
        assert_eq!(daemon.count_valid().unwrap(), 0);
        let secret = command.create("anna", Role::Operator, AT).unwrap();
        let holder = daemon.holder(secret.reveal()).unwrap();
        assert_eq!(
            (holder.name.as_str(), holder.role),
            ("anna", Role::Operator)
        );
        assert_eq!(daemon.named("anna"), Some(holder));
        assert_eq!(daemon.holder("ridged_anna"), None);
        command.revoke("anna", AT).unwrap();
        assert_eq!(daemon.holder(secret.reveal()), None);
        assert_eq!(daemon.count_valid().unwrap(), 0);
        assert!(matches!(
            command.create("anna", Role::Viewer, AT),
            Err(TokenFileError::Taken { .. })
        ));
        assert!(matches!(
            command.revoke("anna", AT),
            Err(TokenFileError::Unknown { .. })
        ));
    }

    #[test]
    fn a_token_still_stops_the_rig_when_the_data_folder_is_gone() {
        let folder = tempfile::tempdir().unwrap();
        let tokens = TokenFile::of_folder(folder.path());
        let secret = tokens.create("anna", Role::Operator, AT).unwrap();
        assert_eq!(tokens.count_valid().unwrap(), 1);
        fs::remove_dir_all(folder.path()).unwrap();
        assert!(tokens.holder(secret.reveal()).is_some());
        assert!(tokens.holder("ridged_other").is_none());
    }

    #[test]
    fn the_file_has_no_token_and_only_its_owner_reads_it() {
        let folder = tempfile::tempdir().unwrap();
        let tokens = TokenFile::of_folder(folder.path());
        let secret = tokens.create("anna", Role::Admin, AT).unwrap();
        let path = folder.path().join(TOKENS_FILE);
        let text = fs::read_to_string(&path).unwrap();
        assert!(!text.contains(secret.reveal()) && text.contains(&secret.fingerprint().hex()));
        let mode = fs::metadata(&path).unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }

    #[test]
    fn names_that_mislead_and_damaged_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let tokens = TokenFile::of_folder(folder.path());
        for name in [
            "",
            "local",
            "daemon",
            "a b",
            "a/b",
            "anna\n",
            &"a".repeat(65),
        ] {
            let refused = tokens.create(name, Role::Viewer, AT).unwrap_err();
            assert!(matches!(refused, TokenFileError::Name { .. }), "{refused}");
        }
        let secret = tokens.create("anna", Role::Viewer, AT).unwrap();
        fs::write(folder.path().join(TOKENS_FILE), "{\"tokens\": [").unwrap();
        assert_eq!(tokens.holder(secret.reveal()), None);
        assert!(tokens.create("bert", Role::Viewer, AT).is_err());
    }
}
