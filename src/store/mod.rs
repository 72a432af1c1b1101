//! The store: SQLite beside content-addressed frame files, in one folder. A copy of the folder is a backup.
//!
//! [`Store::open`] locks the folder for one process, checks it and recovers from a kill. The order is always: make the
//! frame file durable, commit its row, send the event. So no row names a missing file. Rows are only added; triggers of
//! the database refuse changes and deletions. The store does not know hardware or HTTP and does not compute with its data.
//!
//! ```text
//! ridged-data/
//!   ridged.sqlite      the rows (with -wal and -shm beside it while open)
//!   frames/ab/cd….png  frames, named by the SHA-256 of the file
//!   maps/ID/           pictures and tables of a finished map
//!   traces/ID/         direction bins of a finished trace
//!   quarantine/        files that no row names, found at a start; restored when a row names them
//!   lock               names the process that writes; it and the folder are locked
//! ```

mod audit;
pub mod calibrations;
mod corrections;
pub mod definitions;
pub mod disk;
pub mod earlier;
mod error;
pub mod events;
pub mod frames;
mod holds;
pub mod idempotency;
pub mod jobs;
mod lock;
pub mod observations;
mod page;
mod place;
pub mod queue;
pub mod records;
mod recovery;
mod reductions;
pub mod results;
pub mod samples;
pub mod scans;
pub mod shots;
pub mod stages;
mod trouble;

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use sqlx::Connection;
use sqlx::migrate::Migrator;
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqlitePool, SqlitePoolOptions,
    SqliteSynchronous,
};
use tempfile::TempDir;
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use crate::clock::Clock;
use disk::Disk;
use lock::Lock;
use place::{Place, Writing};

pub use audit::{Audit, Discrepancy};
pub use error::StoreError;
pub use frames::sha256_hex;
pub use page::{DamagedRow, Page, PageRequest};
pub use recovery::Recovery;

static MIGRATIONS: Migrator = sqlx::migrate!("./migrations");

/// Name and version written into every reduction.
pub const PROGRAM: &str = concat!("ridged ", env!("CARGO_PKG_VERSION"));

/// A handle to the store; cheap to clone. The folder is unlocked when the last handle is dropped.
#[derive(Clone)]
pub struct Store {
    inner: Arc<Inner>,
}

struct Inner {
    folder: PathBuf,
    /// One connection: SQLite has one writer, and waiting for it here preserves the order of events.
    writer: SqlitePool,
    readers: SqlitePool,
    disk: Arc<dyn Disk>,
    clock: Arc<dyn Clock>,
    holds: Arc<holds::Holds>,
    /// The folder as it was opened; `None` for a reader.
    place: Option<Arc<Place>>,
    /// What reductions computed, of the scans that were reduced last.
    reductions: Mutex<reductions::Shared>,
    held: Mutex<Held>,
    /// What keeps writes waiting.
    trouble: trouble::Watch,
}

/// What a store keeps until it is closed.
enum Held {
    /// The folder, while this process writes.
    Lock(#[expect(dead_code, reason = "it is held")] Lock),
    /// The database that is read instead of that in the folder.
    Copy(#[expect(dead_code, reason = "it is held")] TempDir),
    /// Nothing: a reader, also beside a running daemon.
    Nothing,
}

impl std::fmt::Debug for Store {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Store({})", self.inner.folder.display())
    }
}

impl Store {
    /// Opens or creates the store in `folder` for writing, checks it, and recovers from a kill: half-written frames go to
    /// quarantine; running scans and jobs become interrupted.
    ///
    /// # Errors
    /// [`StoreError::FolderName`], [`StoreError::InUse`] if another process has it, [`StoreError::Damaged`] if the database
    /// fails its check, [`StoreError::RowsMissing`] if there are frames and no database,
    /// [`StoreError::NoRoomToOpen`] on a full disk, or an I/O or database error.
    pub async fn open(
        folder: &Path,
        disk: Arc<dyn Disk>,
        clock: Arc<dyn Clock>,
    ) -> Result<(Store, Recovery), StoreError> {
        check_name(folder)?;
        fs::create_dir_all(folder.join("frames"))
            .map_err(|e| StoreError::file("the data folder", folder, e))?;
        let lock = Lock::take(folder)?;
        check_room(folder, disk.as_ref())?;
        let has_frames = has_frames(folder)
            .map_err(|e| StoreError::file("the frame folder", folder.join("frames"), e))?;
        let rows_missing = || StoreError::RowsMissing {
            database: folder.join(DATABASE),
            frames: folder.join("frames"),
        };
        // Checked before SQLite creates one, which it also does in an empty file.
        if has_frames && !fs::metadata(folder.join(DATABASE)).is_ok_and(|file| file.len() > 0) {
            return Err(rows_missing());
        }
        let options = writing(folder);
        let store = Store::connect(folder, disk, clock, Held::Lock(lock), options).await?;
        let tables: i64 = sqlx::query_scalar("SELECT count(*) FROM sqlite_master")
            .fetch_one(&store.inner.writer)
            .await?;
        if has_frames && tables == 0 {
            store.close().await;
            return Err(rows_missing());
        }
        let check: Vec<String> = sqlx::query_scalar("PRAGMA integrity_check")
            .fetch_all(&store.inner.writer)
            .await?;
        if check != ["ok"] {
            return Err(StoreError::Damaged {
                detail: check.join("; "),
            });
        }
        MIGRATIONS.run(&store.inner.writer).await?;
        let recovery = store.recover().await?;
        // From here on all writes go through `writing`, which waits by itself in short attempts.
        let attempt_ms = LOCK_ATTEMPT.as_millis();
        let writer = &store.inner.writer;
        sqlx::query(sqlx::AssertSqlSafe(format!(
            "PRAGMA busy_timeout = {attempt_ms}"
        )))
        .execute(writer)
        .await?;
        let options = writing(folder).create_if_missing(false);
        writer.set_connect_options(options.busy_timeout(LOCK_ATTEMPT));
        Ok((store, recovery))
    }

    /// Opens an existing store for reading, also beside a running daemon, on a read-only disk and on a full disk.
    ///
    /// # Errors
    /// [`StoreError::Missing`] if there is no store, [`StoreError::UnreadLog`] if the folder cannot be written and the
    /// log has rows, or an I/O or database error.
    pub async fn open_for_reading(
        folder: &Path,
        disk: Arc<dyn Disk>,
        clock: Arc<dyn Clock>,
    ) -> Result<Store, StoreError> {
        check_name(folder)?;
        if !folder.join(DATABASE).is_file() {
            return Err(StoreError::Missing {
                folder: folder.into(),
            });
        }
        // A daemon has the log and its index open; without a daemon SQLite creates them.
        let is_held = Store::is_in_use(folder);
        if is_held || takes_files(folder) {
            let options = writing(folder).create_if_missing(false);
            let store = Store::connect(folder, disk, clock, Held::Nothing, options).await?;
            // The tables of an earlier program get the form that this one reads.
            if !is_held && !store.is_migrated().await {
                let _lock = Lock::take(folder)?;
                MIGRATIONS.run(&store.inner.writer).await?;
            }
            return Ok(store);
        }
        Store::open_unwritable(folder, disk, clock).await
    }

    /// Opens a store in a folder that takes no files. If an earlier program made the tables, a temporary copy of the database
    /// gets the form that this one reads.
    async fn open_unwritable(
        folder: &Path,
        disk: Arc<dyn Disk>,
        clock: Arc<dyn Clock>,
    ) -> Result<Store, StoreError> {
        let options = immutable(folder)?;
        let (of_disk, of_clock) = (Arc::clone(&disk), Arc::clone(&clock));
        let store = Store::connect(folder, of_disk, of_clock, Held::Nothing, options).await?;
        if store.is_migrated().await {
            return Ok(store);
        }
        store.close().await;
        let copy = copy_of_database(folder)?;
        let options = writing(copy.path()).create_if_missing(false);
        let store = Store::connect(folder, disk, clock, Held::Copy(copy), options).await?;
        MIGRATIONS.run(&store.inner.writer).await?;
        Ok(store)
    }

    async fn is_migrated(&self) -> bool {
        let done = sqlx::query_scalar("SELECT version FROM _sqlx_migrations WHERE success")
            .fetch_all(self.readers())
            .await;
        let done: Vec<i64> = done.unwrap_or_default();
        MIGRATIONS.iter().all(|step| done.contains(&step.version))
    }

    /// Returns whether a process has the store in `folder` open for writing.
    #[must_use]
    pub fn is_in_use(folder: &Path) -> bool {
        Lock::is_held(folder)
    }

    async fn connect(
        folder: &Path,
        disk: Arc<dyn Disk>,
        clock: Arc<dyn Clock>,
        held: Held,
        options: SqliteConnectOptions,
    ) -> Result<Store, StoreError> {
        let writer = one_file_pool(1)
            .after_release(|connection, _| Box::pin(is_out_of_transactions(connection)))
            .connect_with(options.clone())
            .await?;
        let options = options.create_if_missing(false);
        writer.set_connect_options(options.clone());
        let readers = one_file_pool(4)
            .connect_with(options.pragma("query_only", "ON"))
            .await?;
        let place = match &held {
            Held::Lock(_) => Some(Arc::new(Place::of(folder)?)),
            Held::Copy(_) | Held::Nothing => None,
        };
        Ok(Store {
            inner: Arc::new(Inner {
                folder: folder.into(),
                writer,
                readers,
                disk,
                clock,
                holds: Arc::default(),
                place,
                reductions: Mutex::default(),
                trouble: trouble::Watch::default(),
                held: Mutex::new(held),
            }),
        })
    }

    /// Writes the log into the database file, closes it, and unlocks the folder.
    pub async fn close(&self) {
        // Both are closed from here on: what fails because a reading was refused must not be written as a failure.
        let (readers, writer) = (self.inner.readers.close(), self.inner.writer.close());
        readers.await;
        writer.await;
        // Remaining handles can no longer write, so another process may open the folder.
        let held = self.inner.held.lock();
        *held.unwrap_or_else(PoisonError::into_inner) = Held::Nothing;
    }

    /// Returns the folder of the store.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.inner.folder
    }

    /// Returns the bytes that may still be written.
    ///
    /// # Errors
    /// [`StoreError::FolderGone`], or an I/O error.
    pub async fn free_bytes(&self) -> Result<u64, StoreError> {
        let store = self.clone();
        asked(move || {
            store.check_folder()?;
            let Inner { disk, folder, .. } = &*store.inner;
            let free = disk.free_bytes(folder);
            free.map_err(|e| StoreError::file("the data folder", folder, e))
        })
        .await
    }

    /// Checks that the data folder is the one that was opened: nothing may be written into another one. Blocks while the
    /// disk does not answer.
    ///
    /// # Errors
    /// [`StoreError::FolderGone`] if it was deleted, unmounted or replaced.
    pub fn check_folder(&self) -> Result<(), StoreError> {
        match &self.inner.place {
            Some(place) => place.check(),
            None => Ok(()),
        }
    }

    /// As [`Store::check_folder`], without blocking the caller's thread.
    ///
    /// # Errors
    /// As [`Store::check_folder`].
    pub async fn find_folder(&self) -> Result<(), StoreError> {
        let store = self.clone();
        asked(move || store.check_folder()).await
    }

    /// Checks that the folder is the one that was opened and that a reader sees the newest event that the writer sees.
    /// Skips a busy writer.
    ///
    /// # Errors
    /// [`StoreError::FolderGone`], [`StoreError::NotKept`], or a database error.
    pub async fn check_commits(&self) -> Result<(), StoreError> {
        const NEWEST: &str = "SELECT COALESCE(MAX(id), 0) FROM events";
        self.find_folder().await?;
        let mut writer = self.writer().try_acquire();
        let written: i64 = match &mut writer {
            Some(writer) => sqlx::query_scalar(NEWEST).fetch_one(&mut **writer).await?,
            None => 0,
        };
        let kept: i64 = sqlx::query_scalar(NEWEST).fetch_one(self.readers()).await?;
        let Some(writer) = writer.filter(|_| written > kept) else {
            return Ok(());
        };
        tracing::error!("events {} to {written} were not kept", kept + 1);
        // A new connection commits again.
        writer.close().await?;
        Err(StoreError::NotKept { kept, written })
    }

    /// Returns whether [`Store::close`] was called.
    pub(crate) fn is_closed(&self) -> bool {
        self.inner.writer.is_closed()
    }

    /// Begins a transaction that has the write lock from its start. Without it, SQLite fails a transaction that first reads and
    /// then writes if another program writes in between, whatever the busy timeout.
    async fn writing(&self) -> Result<Writing, StoreError> {
        self.writing_within(LOCK_WAIT).await
    }

    /// As [`Store::writing`], but waits no longer than this for another program's lock. Each attempt is short, so that a caller
    /// can give up and the daemon can end.
    async fn writing_within(&self, wait: Duration) -> Result<Writing, StoreError> {
        let inner = &self.inner;
        let Some(place) = &inner.place else {
            return Err(StoreError::ReadOnly);
        };
        let began = Instant::now();
        self.find_folder().await?;
        loop {
            let error = match self.writer().begin_with("BEGIN IMMEDIATE").await {
                Ok(transaction) => {
                    inner.trouble.lock_is_free();
                    return Ok(Writing::new(transaction, Arc::clone(place)));
                }
                // The writers before this one wait for the lock.
                Err(sqlx::Error::PoolTimedOut) => StoreError::Locked,
                Err(error) => error.into(),
            };
            if !matches!(error, StoreError::Locked) {
                return Err(error);
            }
            let now = Instant::now();
            inner.trouble.lock_is_held(now);
            // Another attempt would end after that time.
            if inner.trouble.waits_are_over(now) || now - began + LOCK_ATTEMPT > wait {
                return Err(error);
            }
        }
    }

    fn writer(&self) -> &SqlitePool {
        &self.inner.writer
    }

    fn readers(&self) -> &SqlitePool {
        &self.inner.readers
    }

    fn now_text(&self) -> String {
        utc_text(self.inner.clock.utc())
    }
}

/// How long a write waits for a lock that another program holds.
const LOCK_WAIT: Duration = Duration::from_secs(10);
/// How long SQLite waits for such a lock at a time. Nothing can end this wait early.
const LOCK_ATTEMPT: Duration = Duration::from_millis(200);

/// Asks the file system on a thread for blocking work: a disk that hangs must not block the threads that serve the stop.
async fn asked<T: Send + 'static>(
    ask: impl FnOnce() -> Result<T, StoreError> + Send + 'static,
) -> Result<T, StoreError> {
    match tokio::task::spawn_blocking(ask).await {
        Ok(answer) => answer,
        Err(ended) => match ended.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            // The runtime drops the work when the process ends.
            Err(_) => Err(sqlx::Error::PoolClosed.into()),
        },
    }
}

/// Options of a pool that opens its connections at once and keeps them: one opened later would open the file that is at
/// the path then.
fn one_file_pool(connections: u32) -> SqlitePoolOptions {
    SqlitePoolOptions::new()
        .min_connections(connections)
        .max_connections(connections)
        .idle_timeout(None)
        .max_lifetime(None)
}

/// Returns whether a connection may be used again; if not, the pool closes it and opens another.
///
/// SQLite itself rolls back a COMMIT that fails on a full disk. The ROLLBACK after it then fails, sqlx still counts the
/// transaction as open and turns the next one into a savepoint. When that fails too, SQLite keeps the savepoint: all
/// later commits on this connection are inside it and are never written.
async fn is_out_of_transactions(connection: &mut SqliteConnection) -> Result<bool, sqlx::Error> {
    // A pending rollback is done once this is answered.
    connection.ping().await?;
    let is_out = !connection.is_in_transaction();
    if !is_out && may_warn() {
        tracing::warn!(
            "a write could neither be committed nor rolled back (a full disk does that); \
             the database is reopened"
        );
    }
    Ok(is_out)
}

/// Returns whether a minute has passed since the last warning: on a full disk this happens several times a second.
fn may_warn() -> bool {
    const QUIET: Duration = Duration::from_secs(60);
    static WARNED: Mutex<Option<Instant>> = Mutex::new(None);
    let mut warned = WARNED.lock().expect("no holder of this lock panics");
    let may_warn = warned.is_none_or(|at| at.elapsed() > QUIET);
    if may_warn {
        *warned = Some(Instant::now());
    }
    may_warn
}

/// File of the database in a data folder.
pub const DATABASE: &str = "ridged.sqlite";
/// Its write-ahead log: rows that are not in the database's file yet.
const LOG: &str = "ridged.sqlite-wal";
/// Space that a start needs: the database's log, its index, and some rows.
pub const ROOM_TO_OPEN_KB: u64 = 512;

fn check_name(folder: &Path) -> Result<(), StoreError> {
    match folder.to_str() {
        Some(_) => Ok(()),
        None => Err(StoreError::FolderName {
            folder: folder.into(),
        }),
    }
}

fn writing(folder: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new()
        .filename(folder.join(DATABASE))
        .create_if_missing(true)
        .journal_mode(SqliteJournalMode::Wal)
        // FULL: a commit survives a power cut, not only a kill.
        .synchronous(SqliteSynchronous::Full)
        .foreign_keys(true)
        .busy_timeout(LOCK_WAIT)
}

/// Options for a complete database file that no process writes.
fn immutable(folder: &Path) -> Result<SqliteConnectOptions, StoreError> {
    let log = folder.join(LOG);
    if fs::metadata(log).is_ok_and(|log| log.len() > 0) {
        return Err(StoreError::UnreadLog {
            folder: folder.into(),
        });
    }
    Ok(SqliteConnectOptions::new()
        .filename(folder.join(DATABASE))
        .read_only(true)
        .immutable(true))
}

/// Copies the database of a folder into a temporary one.
fn copy_of_database(folder: &Path) -> Result<TempDir, StoreError> {
    let at = std::env::temp_dir();
    let error = |e| StoreError::file("the folder for a copy of the database", &at, e);
    let copy = tempfile::tempdir().map_err(error)?;
    // Read and written, since a copy would be read-only like its original.
    let database = fs::File::open(folder.join(DATABASE));
    let database = database.map_err(|e| StoreError::file("the database", folder, e));
    let mut file = fs::File::create(copy.path().join(DATABASE)).map_err(error)?;
    std::io::copy(&mut database?, &mut file).map_err(error)?;
    Ok(copy)
}

/// Returns whether a file of the size of SQLite's log index can be written into a folder.
fn takes_files(folder: &Path) -> bool {
    let probe = folder.join(format!(".ridged-{}", std::process::id()));
    let written = fs::write(&probe, [0; 1 << 16]).is_ok();
    fs::remove_file(&probe).ok();
    written
}

/// Checks the free space first, because SQLite only reports "disk I/O error".
fn check_room(folder: &Path, disk: &dyn Disk) -> Result<(), StoreError> {
    let free = disk
        .free_bytes(folder)
        .map_err(|e| StoreError::file("the data folder", folder, e))?;
    if free >= ROOM_TO_OPEN_KB * 1024 {
        return Ok(());
    }
    let quarantine = folder.join("quarantine");
    let idle: u64 = fs::read_dir(&quarantine)
        .into_iter()
        .flatten()
        .filter_map(|file| Some(file.ok()?.metadata().ok()?.len()))
        .sum();
    let what = match idle {
        0 => "no file in the folder can be deleted".to_owned(),
        bytes => format!(
            "{} holds {:.1} MB that no row names and can be moved away",
            quarantine.display(),
            bytes as f64 / 1e6
        ),
    };
    Err(StoreError::NoRoomToOpen {
        folder: folder.into(),
        free_kb: free / 1024,
        needed_kb: ROOM_TO_OPEN_KB,
        what,
    })
}

/// Returns whether `frames/` has any frame.
fn has_frames(folder: &Path) -> std::io::Result<bool> {
    for folder in fs::read_dir(folder.join("frames"))? {
        let folder = folder?.path();
        if !folder.is_dir() {
            continue;
        }
        for file in fs::read_dir(folder)? {
            if file?.path().extension().is_some_and(|e| e == "png") {
                return Ok(true);
            }
        }
    }
    Ok(false)
}

/// Formats a time as RFC 3339 UTC with milliseconds, as everywhere in the store.
#[must_use]
pub fn utc_text(at: OffsetDateTime) -> String {
    let at = at.to_offset(time::UtcOffset::UTC);
    let (year, month, day) = at.to_calendar_date();
    let (hour, minute, second, milli) = at.to_hms_milli();
    format!(
        "{year:04}-{:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{milli:03}Z",
        u8::from(month)
    )
}

/// Parses what [`utc_text`] wrote.
pub(crate) fn utc_of(text: &str) -> Option<OffsetDateTime> {
    OffsetDateTime::parse(text, &Rfc3339).ok()
}

#[cfg(test)]
pub(crate) mod tests;
