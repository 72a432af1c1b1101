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
mod recovery;
pub mod samples;
pub mod scans;

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use sqlx::Connection;
use sqlx::migrate::Migrator;
use sqlx::sqlite::{
    SqliteConnectOptions, SqliteConnection, SqliteJournalMode, SqlitePool, SqlitePoolOptions,
    SqliteSynchronous,
};
use time::OffsetDateTime;
use time::format_description::well_known::Rfc3339;

use crate::clock::Clock;
use disk::Disk;

pub use error::StoreError;
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

/// One page of a list.
#[derive(Debug, Clone, PartialEq)]
pub struct Page<T> {
    /// The rows.
    pub items: Vec<T>,
    /// Hand it back to get the rows after these; `None` at the end.
    pub next_cursor: Option<i64>,
    /// Rows between these that cannot be read.
    pub damaged: Vec<DamagedRow>,
}

/// A row that does not hold what this program wrote into it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct DamagedRow {
    /// Its number.
    pub id: i64,
    /// What is wrong with it.
    pub detail: String,
}

impl<T> Page<T> {
    /// Cuts `rows`, which were asked for with one more than `limit`, to a page.
    fn cut(mut rows: Vec<T>, limit: u32, id_of: impl Fn(&T) -> i64) -> Self {
        let more = rows.len() > limit as usize;
        rows.truncate(limit as usize);
        let next_cursor = if more { rows.last().map(id_of) } else { None };
        Page {
            items: rows,
            next_cursor,
            damaged: Vec::new(),
        }
    }

    /// The same of rows as the database has them: one that is damaged hides no other.
    fn read<R>(rows: Vec<R>, limit: u32, id_of: impl Fn(&R) -> i64) -> Self
    where
        T: TryFrom<R, Error = StoreError>,
    {
        let cut = Page::cut(rows, limit, &id_of);
        let mut page = Page {
            items: Vec::with_capacity(cut.items.len()),
            next_cursor: cut.next_cursor,
            damaged: Vec::new(),
        };
        for row in cut.items {
            let id = id_of(&row);
            match T::try_from(row) {
                Ok(item) => page.items.push(item),
                Err(error) => page.damaged.push(DamagedRow {
                    id,
                    detail: error.to_string(),
                }),
            }
        }
        page
    }
}

/// Which part of a list is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PageRequest {
    /// Rows at most.
    pub limit: u32,
    /// From the page before.
    pub cursor: Option<i64>,
}

impl Default for PageRequest {
    fn default() -> Self {
        PageRequest {
            limit: 100,
            cursor: None,
        }
    }
}

impl Store {
    /// Opens or makes the store in `folder` for writing, checks it, and puts right what a kill left
    /// behind: half frames go to quarantine, scans, fits and calculations that were running become interrupted.
    ///
    /// # Errors
    /// [`StoreError::InUse`] if another process has it, [`StoreError::Damaged`] if the database
    /// fails its check, [`StoreError::RowsMissing`] if there are frames and no database,
    /// [`StoreError::NoRoomToOpen`] on a full disk, else what the disk or the database says.
    pub async fn open(
        folder: &Path,
        disk: Arc<dyn Disk>,
        clock: Arc<dyn Clock>,
    ) -> Result<(Store, Recovery), StoreError> {
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
    if !is_out {
        tracing::warn!(
            "a write could neither be committed nor rolled back (a full disk does that); \
             the database is opened anew"
        );
    }
    Ok(is_out)
}

const DATABASE: &str = "ridged.sqlite";
/// The database's log and its index, and room for the rows of a start.
const ROOM_TO_OPEN_KB: u64 = 512;

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
pub(crate) mod tests {
    use super::*;
    use crate::clock::SteppedClock;
    use disk::RealDisk;

    pub(crate) async fn open(folder: &Path) -> Result<(Store, Recovery), StoreError> {
        Store::open(folder, Arc::new(RealDisk), Arc::new(SteppedClock::new())).await
    }

    /// Changes a row as nobody may who does not take the database's own guard away.
    pub(crate) async fn damage(store: &Store, table: &str, set: &str, id: i64) {
        let guards: Vec<(String, String)> = sqlx::query_as(
            "SELECT name, sql FROM sqlite_master WHERE type = 'trigger' AND tbl_name = ?",
        )
        .bind(table)
        .fetch_all(store.writer())
        .await
        .unwrap();
        let mut statements: Vec<String> = Vec::new();
        statements.extend(
            guards
                .iter()
                .map(|(name, _)| format!("DROP TRIGGER {name}")),
        );
        statements.push(format!("UPDATE {table} SET {set} WHERE id = {id}"));
        statements.extend(guards.into_iter().map(|(_, sql)| sql));
        for statement in statements {
            let done = sqlx::query(sqlx::AssertSqlSafe(statement));
            done.execute(store.writer()).await.unwrap();
        }
    }

    #[tokio::test]
    async fn a_second_process_is_refused_until_the_first_is_gone() {
        let folder = tempfile::tempdir().unwrap();
        assert!(!Store::is_in_use(folder.path()));
        let (first, _) = open(folder.path()).await.unwrap();
        assert!(Store::is_in_use(folder.path()));
        // A lock belongs to the open file, so a second opening stands for a second process.
        let second = open(folder.path()).await;
        assert!(
            matches!(second, Err(StoreError::InUse { .. })),
            "{second:?}"
        );
        first.close().await;
        drop(first);
        assert!(!Store::is_in_use(folder.path()));
        open(folder.path()).await.unwrap();
    }

    #[tokio::test]
    async fn every_table_of_records_refuses_changes_and_deletions() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let of = |kind: &'static str| {
            sqlx::query_as::<_, (String, String)>(
                "SELECT tbl_name, sql FROM sqlite_master WHERE type = ? AND sql IS NOT NULL",
            )
            .bind(kind)
            .fetch_all(store.readers())
        };
        let triggers = of("trigger").await.unwrap();
        let tables = of("table").await.unwrap();
        assert!(tables.len() > 10, "{tables:?}");
        for (table, _) in tables {
            // Answers to repeated requests and the database's own books are no records.
            if table == "idempotency_keys" || table.starts_with('_') || table.starts_with("sqlite_")
            {
                continue;
            }
            for change in ["BEFORE UPDATE", "BEFORE DELETE"] {
                let refuses = |(on, sql): &(String, String)| {
                    *on == table && sql.contains(change) && sql.contains("RAISE(ABORT")
                };
                assert!(triggers.iter().any(refuses), "{change} on {table}");
            }
        }
    }

    #[tokio::test]
    async fn a_damaged_database_is_refused_and_left_as_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        store.close().await;
        drop(store);
        let path = folder.path().join(DATABASE);
        let mut bytes = fs::read(&path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle..middle + 4096].fill(0x5a);
        fs::write(&path, &bytes).unwrap();
        let refused = open(folder.path()).await;
        assert!(
            matches!(refused, Err(StoreError::Damaged { .. })),
            "{refused:?}"
        );
        assert_eq!(fs::read(&path).unwrap(), bytes);
    }

    /// Has commits refused the way a full disk has them refused: SQLite rolls back by itself.
    async fn refuse_commits(store: &Store) {
        let mut connection = store.writer().acquire().await.unwrap();
        let mut handle = connection.lock_handle().await.unwrap();
        handle.set_commit_hook(|| false);
    }

    async fn accept_commits(store: &Store) {
        let mut connection = store.writer().acquire().await.unwrap();
        connection.lock_handle().await.unwrap().remove_commit_hook();
    }

    fn alarm(code: &str) -> crate::scan::Event {
        crate::scan::Event::Alarm {
            code: code.into(),
            message: String::new(),
            scan_id: None,
        }
    }

    #[tokio::test]
    async fn what_is_written_after_failed_commits_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        for _ in 0..3 {
            refuse_commits(&store).await;
            store.record(alarm("lost")).await.unwrap_err();
        }
        accept_commits(&store).await;
        let event = store.record(alarm("kept")).await.unwrap();
        let sample = samples::tests::polymer(&store).await;
        store.check_commits().await.unwrap();
        // A connection that was opened anew is set as the first one was.
        let mut writer = store.writer().acquire().await.unwrap();
        for (pragma, wanted) in [
            ("PRAGMA synchronous", "2"),
            ("PRAGMA foreign_keys", "1"),
            ("PRAGMA journal_mode", "wal"),
        ] {
            use sqlx::{Row, TypeInfo, ValueRef};
            let row = sqlx::query(pragma).fetch_one(&mut *writer).await.unwrap();
            let is_text = row.try_get_raw(0).unwrap().type_info().name() == "TEXT";
            let is = match is_text {
                true => row.get::<String, _>(0),
                false => row.get::<i64, _>(0).to_string(),
            };
            assert_eq!(is, wanted, "{pragma}");
        }
        drop(writer);
        assert!(matches!(
            open(folder.path()).await,
            Err(StoreError::InUse { .. })
        ));
        store.close().await;
        drop(store);
        let (store, _) = open(folder.path()).await.unwrap();
        assert_eq!(store.events_after(0, 10).await.unwrap(), [event]);
        assert_eq!(store.sample(sample.id).await.unwrap(), sample);
    }

    #[tokio::test]
    async fn a_writer_whose_commits_nobody_sees_is_told_and_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        store.record(alarm("kept")).await.unwrap();
        store.check_commits().await.unwrap();
        for statement in [
            "BEGIN",
            "INSERT INTO events (at, kind, body) VALUES ('', 'alarm', '{}')",
        ] {
            let done = sqlx::query(statement).execute(store.writer()).await;
            done.unwrap();
        }
        // Until the pool has the writer back it counts as at work.
        let mut told = store.check_commits().await;
        for _ in 0..1000 {
            if told.is_err() {
                break;
            }
            tokio::task::yield_now().await;
            told = store.check_commits().await;
        }
        let told = told.unwrap_err();
        assert!(
            matches!(
                told,
                StoreError::NotKept {
                    kept: 1,
                    written: 2
                }
            ),
            "{told}"
        );
        store.check_commits().await.unwrap();
        let event = store.record(alarm("kept")).await.unwrap();
        assert_eq!(store.last_event_id().await.unwrap(), event.id);
    }

    /// A disk with so many bytes left.
    struct Left(u64);

    impl Disk for Left {
        fn write_durably(&self, path: &Path, bytes: &[u8]) -> std::io::Result<()> {
            RealDisk.write_durably(path, bytes)
        }

        fn free_bytes(&self, _: &Path) -> std::io::Result<u64> {
            Ok(self.0)
        }
    }

    #[tokio::test]
    async fn a_full_disk_is_told_at_the_start_with_what_may_go() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir_all(folder.path().join("quarantine")).unwrap();
        fs::write(folder.path().join("quarantine/a.png"), [0; 200_000]).unwrap();
        let clock = Arc::new(SteppedClock::new());
        let refused = Store::open(folder.path(), Arc::new(Left(0)), clock.clone()).await;
        let refused = refused.unwrap_err().to_string();
        assert!(refused.contains("needs 512 kB"), "{refused}");
        assert!(refused.contains("quarantine holds 0.2 MB"), "{refused}");
        let enough = Arc::new(Left(1 << 20));
        Store::open(folder.path(), enough, clock).await.unwrap();
    }

    #[tokio::test]
    async fn a_folder_that_cannot_be_written_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let sample = samples::tests::polymer(&store).await;
        store.close().await;
        drop(store);
        // Who may do everything, as in many containers, is not kept out by permissions: what tells
        // is that nothing was written.
        let options = immutable(folder.path()).unwrap();
        let (disk, clock) = (Arc::new(RealDisk), Arc::new(SteppedClock::new()));
        let store = Store::connect(folder.path(), disk.clone(), clock.clone(), None, options)
            .await
            .unwrap();
        assert_eq!(store.sample(sample.id).await.unwrap(), sample);
        assert!(!folder.path().join("ridged.sqlite-wal").exists());
        assert!(!folder.path().join("ridged.sqlite-shm").exists());
        store.close().await;
        // Rows in a log that nobody can write back are not passed over in silence.
        fs::write(folder.path().join("ridged.sqlite-wal"), b"rows").unwrap();
        let refused = immutable(folder.path()).unwrap_err();
        assert!(matches!(refused, StoreError::UnreadLog { .. }), "{refused}");
    }

    #[tokio::test]
    async fn measured_rows_cannot_be_changed_or_deleted() {
        let folder = tempfile::tempdir().unwrap();
        let (store, _) = open(folder.path()).await.unwrap();
        let sample = samples::tests::polymer(&store).await;
        for sql in ["UPDATE samples SET name = 'other'", "DELETE FROM samples"] {
            let refused = sqlx::query(sql).execute(store.writer()).await;
            assert!(refused.is_err(), "{sql}");
        }
        assert_eq!(store.sample(sample.id).await.unwrap(), sample);
    }

    #[test]
    fn times_are_utc_with_milliseconds() {
        let at = time::macros::datetime!(2026-03-02 09:00:01.77 +2);
        assert_eq!(utc_text(at), "2026-03-02T07:00:01.770Z");
        assert_eq!(utc_of("2026-03-02T07:00:01.770Z"), Some(at));
    }
}
