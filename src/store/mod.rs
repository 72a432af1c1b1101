//! Keeps everything: SQLite beside content-addressed frame files, in one folder that is its own
//! backup when copied.
//!
//! [`Store::open`] takes the folder for one process, checks it, and puts right what a kill left
//! behind. The order is always: frame file durable, then its row committed, then the event told;
//! no row points to a file that could be missing. Rows are added, never changed or deleted (the
//! database itself refuses it). The store knows no hardware, no HTTP, and does no arithmetic on
//! what it keeps.
//!
//! ```text
//! ridged-data/
//!   ridged.sqlite      the rows (with -wal and -shm beside it while open)
//!   frames/ab/cd….png  frames, named by the SHA-256 of the file
//!   maps/ID/           pictures and tables of a finished map
//!   traces/ID/         direction bins of a finished trace
//!   quarantine/        files that no row names, found at a start; taken back when a row does
//!   lock               held by the process that writes
//! ```

pub mod calculations;
pub mod calibrations;
pub mod disk;
mod error;
pub mod events;
pub mod fits;
pub mod frames;
mod holds;
pub mod idempotency;
pub mod observations;
mod page;
mod recovery;
pub mod samples;
pub mod scans;

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use sqlx::migrate::Migrator;
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqlitePool, SqlitePoolOptions,
    SqliteSynchronous,
};
use sqlx::{Connection, Sqlite, Transaction};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use crate::clock::Clock;
use disk::Disk;

pub use error::StoreError;
pub use page::{DamagedRow, Page, PageRequest};
pub use recovery::Recovery;

static MIGRATIONS: Migrator = sqlx::migrate!("./migrations");

/// Name and version written into every scan, reduction and fit.
pub const PROGRAM: &str = concat!("ridged ", env!("CARGO_PKG_VERSION"));

/// A handle to the store; cheap to clone. The folder is free again when the last one is gone.
#[derive(Clone)]
pub struct Store {
    inner: Arc<Inner>,
}

struct Inner {
    folder: PathBuf,
    /// One connection: SQLite has one writer, and waiting for it here keeps the order of events.
    writer: SqlitePool,
    readers: SqlitePool,
    disk: Arc<dyn Disk>,
    clock: Arc<dyn Clock>,
    holds: Arc<holds::Holds>,
    /// Held while this process writes; `None` for a reader beside a running daemon.
    lock: Mutex<Option<File>>,
}

impl std::fmt::Debug for Store {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Store({})", self.inner.folder.display())
    }
}

impl Store {
    /// Opens or makes the store in `folder` for writing, checks it, and puts right what a kill left
    /// behind: half frames go to quarantine, scans, fits and calculations that were running become interrupted.
    ///
    /// # Errors
    /// [`StoreError::FolderName`], [`StoreError::InUse`] if another process has it, [`StoreError::Damaged`] if the database
    /// fails its check, [`StoreError::RowsMissing`] if there are frames and no database,
    /// [`StoreError::NoRoomToOpen`] on a full disk, else what the disk or the database says.
    pub async fn open(
        folder: &Path,
        disk: Arc<dyn Disk>,
        clock: Arc<dyn Clock>,
    ) -> Result<(Store, Recovery), StoreError> {
        check_name(folder)?;
        fs::create_dir_all(folder.join("frames"))
            .map_err(|e| StoreError::file("the data folder", folder, e))?;
        let lock = take_lock(folder)?;
        check_room(folder, disk.as_ref())?;
        let has_frames = has_frames(folder)
            .map_err(|e| StoreError::file("the frame folder", folder.join("frames"), e))?;
        let rows_missing = || StoreError::RowsMissing {
            database: folder.join(DATABASE),
            frames: folder.join("frames"),
        };
        // Before a new one is made in its place: SQLite makes one of an empty file too.
        if has_frames && !fs::metadata(folder.join(DATABASE)).is_ok_and(|file| file.len() > 0) {
            return Err(rows_missing());
        }
        let options = writing(folder);
        let store = Store::connect(folder, disk, clock, Some(lock), options).await?;
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
        Ok((store, recovery))
    }

    /// Opens an existing store for reading only, also beside a running daemon, and where nothing can
    /// be written: a copy on a read-only disk, a full disk.
    ///
    /// # Errors
    /// [`StoreError::Missing`] if there is none, [`StoreError::UnreadLog`] where nothing can be
    /// written and rows wait in the log, else what the disk or the database says.
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
        // Beside a daemon the log and its index are there to be read; without one SQLite makes them.
        if Store::is_in_use(folder) || takes_files(folder) {
            let options = writing(folder).create_if_missing(false);
            return Store::connect(folder, disk, clock, None, options).await;
        }
        let options = immutable(folder)?;
        Store::connect(folder, disk, clock, None, options).await
    }

    /// Whether a process has the store in `folder` open for writing now.
    #[must_use]
    pub fn is_in_use(folder: &Path) -> bool {
        File::open(folder.join("lock"))
            .is_ok_and(|lock| matches!(lock.try_lock(), Err(TryLockError::WouldBlock)))
    }

    async fn connect(
        folder: &Path,
        disk: Arc<dyn Disk>,
        clock: Arc<dyn Clock>,
        lock: Option<File>,
        options: SqliteConnectOptions,
    ) -> Result<Store, StoreError> {
        let writer = SqlitePoolOptions::new()
            .max_connections(1)
            .after_release(|connection, _| Box::pin(is_out_of_transactions(connection)))
            .connect_with(options.clone())
            .await?;
        let readers = SqlitePoolOptions::new()
            .max_connections(4)
            .connect_with(options.create_if_missing(false).pragma("query_only", "ON"))
            .await?;
        Ok(Store {
            inner: Arc::new(Inner {
                folder: folder.into(),
                writer,
                readers,
                disk,
                clock,
                holds: Arc::default(),
                lock: Mutex::new(lock),
            }),
        })
    }

    /// Writes what is still in the log into the database file, closes it, and lets others open it.
    pub async fn close(&self) {
        self.inner.readers.close().await;
        self.inner.writer.close().await;
        // Nothing can be written any more, whoever still has a handle: the next one may open.
        let lock = self
            .inner
            .lock
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .take();
        drop(lock);
    }

    /// The folder of the store.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.inner.folder
    }

    /// Bytes that may still be written.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn free_bytes(&self) -> Result<u64, StoreError> {
        self.inner
            .disk
            .free_bytes(&self.inner.folder)
            .map_err(|e| StoreError::file("the data folder", &self.inner.folder, e))
    }

    /// Whether what is written can be read: a reader finds the newest event that the writer sees. A writer that is
    /// at work is left alone.
    ///
    /// # Errors
    /// [`StoreError::NotKept`] if it cannot, else what the database says.
    pub async fn check_commits(&self) -> Result<(), StoreError> {
        const NEWEST: &str = "SELECT COALESCE(MAX(id), 0) FROM events";
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
        // What is written from now on is.
        writer.close().await?;
        Err(StoreError::NotKept { kept, written })
    }

    /// Whether [`Store::close`] was called.
    pub(crate) fn is_closed(&self) -> bool {
        self.inner.writer.is_closed()
    }

    /// A transaction that is the only writer from its beginning. One that reads first and writes then is refused at once
    /// where another program writes in between, however long it is ready to wait.
    async fn writing(&self) -> Result<Transaction<'static, Sqlite>, StoreError> {
        Ok(self.writer().begin_with("BEGIN IMMEDIATE").await?)
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

    /// The same for what is not the rig's: samples and calculations.
    fn wall_text(&self) -> String {
        utc_text(self.inner.clock.wall())
    }
}

/// Whether a connection may be used again; if not, the pool closes it and opens another.
///
/// A COMMIT that fails on a full disk is rolled back by SQLite itself. The ROLLBACK after it fails then, sqlx goes on
/// counting the transaction as open, and makes a savepoint of the next one. When that fails too, SQLite keeps the
/// savepoint: whatever is committed on the connection from then on lies within it and is never written.
async fn is_out_of_transactions(connection: &mut SqliteConnection) -> Result<bool, sqlx::Error> {
    // A rollback that waits its turn has had it once this is answered.
    connection.ping().await?;
    let is_out = !connection.is_in_transaction();
    if !is_out && told_again() {
        tracing::warn!(
            "a write could neither be committed nor rolled back (a full disk does that); \
             the database is opened anew"
        );
    }
    Ok(is_out)
}

/// Whether a minute has passed since this was told: on a full disk it happens several times a second.
fn told_again() -> bool {
    const QUIET: Duration = Duration::from_secs(60);
    static TOLD: Mutex<Option<Instant>> = Mutex::new(None);
    let mut told = TOLD.lock().expect("no holder of this lock panics");
    let again = told.is_none_or(|at| at.elapsed() > QUIET);
    if again {
        *told = Some(Instant::now());
    }
    again
}

const DATABASE: &str = "ridged.sqlite";
/// The database's log and its index, and room for the rows of a start.
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
        // FULL: a committed point survives a power cut, not only a kill.
        .synchronous(SqliteSynchronous::Full)
        .foreign_keys(true)
        .busy_timeout(Duration::from_secs(10))
}

/// For a file that nobody writes and that is all there is.
fn immutable(folder: &Path) -> Result<SqliteConnectOptions, StoreError> {
    let log = folder.join(format!("{DATABASE}-wal"));
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

/// Whether files of the size of SQLite's index of its log can be written into a folder.
fn takes_files(folder: &Path) -> bool {
    let probe = folder.join(format!(".ridged-{}", std::process::id()));
    let written = fs::write(&probe, [0; 1 << 16]).is_ok();
    fs::remove_file(&probe).ok();
    written
}

/// Asked first, because SQLite says no more than "disk I/O error".
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
        0 => "nothing in the folder can be spared".to_owned(),
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

/// Whether there is any frame below `frames/`.
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

fn take_lock(folder: &Path) -> Result<File, StoreError> {
    let path = folder.join("lock");
    let error = |e| StoreError::file("the lock file", &path, e);
    let mut lock = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(&path)
        .map_err(error)?;
    match lock.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => {
            let mut holder = String::new();
            lock.read_to_string(&mut holder).ok();
            return Err(StoreError::InUse {
                folder: folder.into(),
                holder: holder.trim().to_owned(),
            });
        }
        Err(TryLockError::Error(e)) => return Err(error(e)),
    }
    // The lock is the operating system's; the text only tells people who has it.
    lock.set_len(0).map_err(error)?;
    lock.rewind().map_err(error)?;
    // On a full disk it stays empty; what is wrong there is told by who needs the room.
    writeln!(lock, "process {}", std::process::id()).ok();
    Ok(lock)
}

/// RFC 3339 UTC with milliseconds, as everywhere in the store.
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

/// Reads what [`utc_text`] wrote.
pub(crate) fn utc_of(text: &str) -> Option<OffsetDateTime> {
    OffsetDateTime::parse(text, &Rfc3339).ok()
}

#[cfg(test)]
pub(crate) mod tests;
