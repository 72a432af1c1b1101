//! What can go wrong in the store, as situations that a caller can tell apart.

use std::io;
use std::path::PathBuf;

use crate::frame::FrameError;
use crate::scan::ScanState;

/// Why the store could not do what was asked.
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
        "there is no store in {}; `ridged serve`, `scan` or `import` makes one, --data names another folder",
        folder.display()
    )]
    Missing {
        /// The folder.
        folder: PathBuf,
    },
    /// SQLite takes names in UTF-8 alone.
    #[error(
        "the path of the data folder, {}, is not valid UTF-8, and the database takes no other; rename it, or give \
         another folder with --data",
        folder.display()
    )]
    FolderName {
        /// The folder.
        folder: PathBuf,
    },
    /// The folder or a file in it cannot be used.
    #[error("{what} ({}) cannot be used: {why}", path.display())]
    File {
        /// What it is.
        what: &'static str,
        /// Where it is.
        path: PathBuf,
        /// What the operating system says.
        why: io::Error,
    },
    /// No space is left.
    #[error(
        "the disk is full: {detail}; free some space, then go on; nothing that was committed is lost"
    )]
    DiskFull {
        /// What was to be written.
        detail: String,
    },
    /// The database does not pass its own check.
    #[error(
        "the database is damaged ({detail}); nothing was changed: keep the folder as it is and restore a copy of it"
    )]
    Damaged {
        /// What the check found.
        detail: String,
    },
    /// There are frames and no rows that name them.
    #[error(
        "the database {} is missing or empty, but {} beside it holds frames; nothing was changed: restore the \
         database from a copy of the data folder, or move the folder of frames away to begin anew",
        database.display(), frames.display()
    )]
    RowsMissing {
        /// The database that should be there.
        database: PathBuf,
        /// The folder of frames.
        frames: PathBuf,
    },
    /// The disk is too full for the database's log.
    #[error(
        "the disk is full: {} has {free_kb} kB free, and the database needs {needed_kb} kB for its log; free some \
         space, then start again; {what}; until then `ridged export --scan` and `ridged fit --scan` read the folder",
        folder.display()
    )]
    NoRoomToOpen {
        /// The data folder.
        folder: PathBuf,
        /// What is there.
        free_kb: u64,
        /// What is needed.
        needed_kb: u64,
        /// What may be deleted.
        what: String,
    },
    /// The folder cannot be written, and the database is not whole without it.
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
    /// There is no such row.
    #[error("there is no {noun} {id}")]
    NotFound {
        /// What was looked for.
        noun: &'static str,
        /// Its number.
        id: i64,
    },
    /// The state table does not permit it.
    #[error("scan {scan_id} is {current}; it cannot become {asked}")]
    StateConflict {
        /// Which scan.
        scan_id: i64,
        /// Where it stands.
        current: ScanState,
        /// What was asked.
        asked: ScanState,
    },
    /// A frame's file is not what was kept.
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
    /// The same Idempotency-Key came with a different request.
    #[error("the Idempotency-Key was used for a different request; take a new key")]
    KeyReused,
    /// A row does not hold what this program wrote into it.
    #[error("a row of {table} cannot be read: {detail}; was the database changed by hand?")]
    BadRow {
        /// Which table.
        table: &'static str,
        /// What is wrong.
        detail: String,
    },
    /// The database told of commits that it did not keep.
    #[error(
        "events {} to {written} were written and not kept, and what was told with them may be lost; what is \
         written from now on is kept again: see what is missing",
        kept + 1
    )]
    NotKept {
        /// Number of the last event that readers see.
        kept: i64,
        /// Number of the last event that the writer saw.
        written: i64,
    },
    /// Anything else the database says.
    #[error("the database refused: {0}")]
    Database(sqlx::Error),
}

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        /// Primary result codes of SQLite (the low byte of the extended ones).
        const CORRUPT: i32 = 11;
        const FULL: i32 = 13;
        const NOT_A_DATABASE: i32 = 26;
        /// The index of the log, made anew when the database is opened, found no room.
        const NO_ROOM_FOR_INDEX: i32 = 10 | (19 << 8);
        let code = error
            .as_database_error()
            .and_then(|e| e.code())
            .and_then(|code| code.parse::<i32>().ok());
        if code == Some(NO_ROOM_FOR_INDEX) {
            return StoreError::DiskFull {
                detail: "the index of the database's log could not be made".into(),
            };
        }
        match code.map(|code| code & 0xff) {
            Some(FULL) => StoreError::DiskFull {
                detail: "the database could not grow".into(),
            },
            Some(CORRUPT | NOT_A_DATABASE) => StoreError::Damaged {
                detail: error.to_string(),
            },
            _ => StoreError::Database(error),
        }
    }
}

impl StoreError {
    /// An I/O error on a file of the store; a full disk keeps its own name.
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
