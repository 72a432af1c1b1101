//! Errors of the store, one variant per situation that a caller can distinguish.

use std::io;
use std::path::PathBuf;

use crate::frame::FrameError;
use crate::scan::ScanState;

/// Why an operation of the store failed.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// Another process has the folder.
    #[error(
        "the data folder {} is in use by another ridged ({holder}); stop it, or give another folder with --data",
        folder.display()
    )]
    InUse {
        /// The folder.
        folder: PathBuf,
        /// What the lock file says about the other process.
        holder: String,
    },
    /// There is no store in the folder.
    #[error(
        "there is no store in {}; `ridged serve`, `scan` or `import` creates one, --data names another folder",
        folder.display()
    )]
    Missing {
        /// The folder.
        folder: PathBuf,
    },
    /// SQLite accepts only UTF-8 paths.
    #[error(
        "the path of the data folder, {}, is not valid UTF-8, which the database needs; rename it, or give another \
         folder with --data",
        folder.display()
    )]
    FolderName {
        /// The folder.
        folder: PathBuf,
    },
    /// The folder or a file in it cannot be used.
    #[error("{what} ({}) cannot be used: {why}{}", path.display(), way_out(why))]
    File {
        /// The file or folder as a noun with its article.
        what: &'static str,
        /// Where it is.
        path: PathBuf,
        /// The I/O error.
        why: io::Error,
    },
    /// The data folder is not the one that was opened.
    #[error(
        "{what} ({}) {problem} while the daemon used it; nothing is written until it is back: mount it again, or restore a copy \
         of it and restart the daemon",
        path.display()
    )]
    FolderGone {
        /// The part of it that differs.
        what: &'static str,
        /// Its path.
        path: PathBuf,
        /// What happened to it.
        problem: String,
    },
    /// This handle only reads.
    #[error("the data folder was opened for reading only")]
    ReadOnly,
    /// Another program holds the lock of the database.
    #[error(
        "the database is locked by another program; end that program (`fuser` with the path of ridged.sqlite names it), \
         then try again; nothing was written"
    )]
    Locked,
    /// The disk does not answer.
    #[error(
        "the disk of the data folder does not answer (a network drive that is gone does that); bring it back, then try again; \
         nothing was written"
    )]
    NoAnswer,
    /// The disk fails.
    #[error(
        "the disk of the data folder fails ({detail}); find the fault (dmesg names it), check the file system and mount it again, \
         or restart the daemon on a copy of the folder, then try again; nothing that was committed is lost"
    )]
    DiskFailed {
        /// What the disk or the database says.
        detail: String,
    },
    /// The disk is full.
    #[error(
        "the disk is full: {detail}; free some space, then try again; nothing that was committed is lost"
    )]
    DiskFull {
        /// What could not be written.
        detail: String,
    },
    /// The database fails its integrity check.
    #[error(
        "the database is damaged ({detail}); nothing was changed: if the disk failed (dmesg names it), mount it again and restart \
         the daemon; if not, keep the folder as it is and restore a copy of it"
    )]
    Damaged {
        /// What the check found.
        detail: String,
    },
    /// There are frames but no database.
    #[error(
        "the database {} is missing or empty, but {} beside it holds frames; nothing was changed: restore the \
         database from a copy of the data folder, or move the folder of frames away to start an empty store",
        database.display(), frames.display()
    )]
    RowsMissing {
        /// The database that should be there.
        database: PathBuf,
        /// The folder of frames.
        frames: PathBuf,
    },
    /// The disk has no room for the database's log.
    #[error(
        "the disk is full: {} has {free_kb} kB free, and the database needs {needed_kb} kB for its log; free some \
         space, then start again; {what}; until then `ridged export --scan` and `ridged fit --scan` read the folder",
        folder.display()
    )]
    NoRoomToOpen {
        /// The data folder.
        folder: PathBuf,
        /// Free space, kB.
        free_kb: u64,
        /// Needed space, kB.
        needed_kb: u64,
        /// What may be deleted.
        what: String,
    },
    /// The folder cannot be written, and the database is incomplete without its log.
    #[error(
        "the data folder {} cannot be written, and its database was not closed properly (ridged.sqlite-wal holds \
         rows): open it once where it can be written, with any `ridged serve --data`, or read a copy of it",
        folder.display()
    )]
    UnreadLog {
        /// The data folder.
        folder: PathBuf,
    },
    /// The database was made by a newer program, or a migration failed.
    #[error("the database does not fit this program; use the ridged that made it or a newer one")]
    Migration(#[from] sqlx::migrate::MigrateError),
    /// The row does not exist.
    #[error("there is no {noun} {id}")]
    NotFound {
        /// Kind of the row.
        noun: &'static str,
        /// Number.
        id: i64,
    },
    /// The state table forbids the change.
    #[error("scan {scan_id} is {current}; it cannot become {asked}")]
    StateConflict {
        /// Number of the scan.
        scan_id: i64,
        /// State of the scan.
        current: ScanState,
        /// The requested state.
        asked: ScanState,
    },
    /// Another recipe or specification has this name.
    #[error(
        "{noun} `{name}` exists (number {id}, version {version}){}",
        if *archived { "; it is archived: restore it, or take another name" } else { "; change it there, or take another name" }
    )]
    NameTaken {
        /// Kind of the definition.
        noun: &'static str,
        /// The name.
        name: String,
        /// Number of the one that has it.
        id: i64,
        /// Its newest version.
        version: i64,
        /// Whether it is archived.
        archived: bool,
    },
    /// Another part has this name.
    #[error(
        "part {id} has the name `{name}`; rename that part first, or take another name: scans and orders find a part by its name"
    )]
    PartNameTaken {
        /// The name.
        name: String,
        /// Number of the part that has it.
        id: i64,
    },
    /// A change of a version that is no longer the newest one.
    #[error(
        "{noun} `{name}` has version {newest} by {who}, and the change replaces version {replaces}; read the newest version and \
         apply the change to it"
    )]
    VersionConflict {
        /// Kind of the definition.
        noun: &'static str,
        /// Its name.
        name: String,
        /// The version that the change replaces.
        replaces: i64,
        /// The newest version.
        newest: i64,
        /// Who saved the newest version.
        who: String,
    },
    /// The definition has no such version.
    #[error("{noun} `{name}` has no version {version}; expected 1 to {newest}")]
    NoVersion {
        /// Kind of the definition.
        noun: &'static str,
        /// Its name.
        name: String,
        /// The requested version.
        version: i64,
        /// The newest version.
        newest: i64,
    },
    /// Another order of the queue has this external id.
    #[error(
        "orders[{place}].external_id: `{external_id}` is the external id of order {order_id} ({part}, {state}); remove that order, or \
         give another id"
    )]
    ExternalIdTaken {
        /// Place of the order in the request.
        place: usize,
        /// The external id.
        external_id: String,
        /// The order that has it.
        order_id: i64,
        /// The part of that order.
        part: String,
        /// The state of that order.
        state: String,
    },
    /// The state of an order does not allow the change.
    #[error(
        "order {order_id} is {state}{}: this is not allowed in this state",
        match scan_id { Some(id) if *state == "running" => format!(" (scan {id} measures it; abort the scan first)"), _ => String::new() }
    )]
    OrderConflict {
        /// The order.
        order_id: i64,
        /// Its state.
        state: &'static str,
        /// Its newest scan.
        scan_id: Option<i64>,
    },
    /// A frame's file is missing or has changed.
    #[error("the file of frame {sha256} {problem}; restore it from a copy of the data folder")]
    FrameDamaged {
        /// Content hash and name of the file.
        sha256: String,
        /// What is wrong with it.
        problem: String,
    },
    /// The frame could not be encoded or decoded.
    #[error(transparent)]
    Frame(#[from] FrameError),
    /// An Idempotency-Key was sent with a different request.
    #[error("the Idempotency-Key was used for a different request; use a new key")]
    KeyReused,
    /// A row that this program cannot read.
    #[error("a row of {table} cannot be read: {detail}; was the database changed by hand?")]
    BadRow {
        /// Which table.
        table: &'static str,
        /// What is wrong.
        detail: String,
    },
    /// The database reported commits that it did not keep.
    #[error(
        "events {} to {written} were written but not kept, and what they reported may be lost; later writes are kept: \
         check what is missing",
        kept + 1
    )]
    NotKept {
        /// Number of the last event that readers see.
        kept: i64,
        /// Number of the last event that the writer saw.
        written: i64,
    },
    /// Any other database error.
    #[error("the database refused: {0}")]
    Database(sqlx::Error),
}

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        /// Primary result codes of SQLite (the low byte of the extended ones).
        const BUSY: i32 = 5;
        const LOCKED: i32 = 6;
        const READ_ONLY: i32 = 8;
        const IO_ERROR: i32 = 10;
        const CORRUPT: i32 = 11;
        const FULL: i32 = 13;
        const CANNOT_OPEN: i32 = 14;
        const NOT_A_DATABASE: i32 = 26;
        /// SQLite could not create the index of its log when it opened the database.
        const NO_ROOM_FOR_INDEX: i32 = 10 | (19 << 8);
        let code = error
            .as_database_error()
            .and_then(|e| e.code())
            .and_then(|code| code.parse::<i32>().ok());
        if code == Some(NO_ROOM_FOR_INDEX) {
            return StoreError::DiskFull {
                detail: "the index of the database's log could not be created".into(),
            };
        }
        match code.map(|code| code & 0xff) {
            Some(BUSY | LOCKED) => StoreError::Locked,
            Some(FULL) => StoreError::DiskFull {
                detail: "the database could not grow".into(),
            },
            Some(READ_ONLY | IO_ERROR | CANNOT_OPEN) => StoreError::DiskFailed {
                detail: error.to_string(),
            },
            Some(CORRUPT | NOT_A_DATABASE) => StoreError::Damaged {
                detail: error.to_string(),
            },
            _ => StoreError::Database(error),
        }
    }
}

/// What a person does about an I/O error; empty where the error alone is all that is known.
fn way_out(error: &io::Error) -> &'static str {
    match error.kind() {
        io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem => {
            "; give the user of this program write access there, or choose another data folder (--data)"
        }
        _ => "",
    }
}

impl StoreError {
    /// Converts an I/O error on a file of the store; a full disk becomes [`StoreError::DiskFull`].
    pub(crate) fn file(what: &'static str, path: impl Into<PathBuf>, source: io::Error) -> Self {
        let path = path.into();
        match source.kind() {
            io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => StoreError::DiskFull {
                detail: format!("{what} {} could not be written", path.display()),
            },
            _ => StoreError::File {
                what,
                path,
                why: source,
            },
        }
    }

    pub(crate) fn bad_row(table: &'static str, detail: impl ToString) -> Self {
        StoreError::BadRow {
            table,
            detail: detail.to_string(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_without_write_access_is_named_with_the_way_out() {
        for (kind, helps) in [
            (io::ErrorKind::PermissionDenied, true),
            (io::ErrorKind::ReadOnlyFilesystem, true),
            (io::ErrorKind::NotADirectory, false),
        ] {
            let error = StoreError::file("the lock file", "/lab/data/lock", kind.into());
            let message = error.to_string();
            assert!(message.starts_with("the lock file (/lab/data/lock) cannot be used: "));
            assert_eq!(message.contains("write access"), helps, "{message}");
        }
    }
}
