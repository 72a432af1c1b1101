//! The folder, its lock, the triggers against changes, and commits that fail.

use super::*;
use crate::clock::SteppedClock;
use disk::RealDisk;

pub(crate) async fn open(folder: &Path) -> Result<(Store, Recovery), StoreError> {
    Store::open(folder, Arc::new(RealDisk), Arc::new(SteppedClock::new())).await
}

/// Changes a row after dropping the triggers that forbid it, and restores them.
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
    // A lock belongs to the open file, so opening twice behaves like two processes.
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
async fn a_store_that_closes_takes_no_write_while_a_reading_ends() {
    let folder = tempfile::tempdir().unwrap();
    let (store, _) = open(folder.path()).await.unwrap();
    let reading = store.readers().acquire().await.unwrap();
    let mut closing = std::pin::pin!(store.close());
    assert!(futures::poll!(&mut closing).is_pending());
    assert!(store.is_closed());
    assert!(store.writing().await.is_err());
    drop(reading);
    closing.await;
}

#[tokio::test]
async fn a_folder_stays_locked_without_its_lock_file() {
    let folder = tempfile::tempdir().unwrap();
    let (first, _) = open(folder.path()).await.unwrap();
    let file = folder.path().join("lock");
    fs::remove_file(&file).unwrap();
    assert!(Store::is_in_use(folder.path()));
    let refused = open(folder.path()).await.unwrap_err();
    assert!(matches!(refused, StoreError::InUse { .. }), "{refused}");
    assert!(!file.exists());
    first.close().await;
    assert!(!Store::is_in_use(folder.path()));
    // An earlier program locks only the file.
    let earlier = fs::File::create(&file).unwrap();
    earlier.lock().unwrap();
    assert!(Store::is_in_use(folder.path()));
    let refused = open(folder.path()).await.unwrap_err();
    assert!(matches!(refused, StoreError::InUse { .. }), "{refused}");
}

#[tokio::test]
async fn a_folder_name_that_is_not_utf_8_is_refused_before_anything_is_created() {
    use std::os::unix::ffi::OsStrExt;
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join(std::ffi::OsStr::from_bytes(b"d\xff"));
    let refused = open(&folder).await;
    let Err(StoreError::FolderName { .. }) = &refused else {
        panic!("{refused:?}");
    };
    assert!(!folder.exists());
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
        // Stored answers, SQLite's own tables and rows that are made of others may change.
        let may_change = ["idempotency_keys", "results"].contains(&table.as_str());
        if may_change || table.starts_with('_') || table.starts_with("sqlite_") {
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

/// Makes commits fail as on a full disk: SQLite rolls back by itself.
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
async fn rows_written_after_failed_commits_are_kept() {
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
    // A reopened connection has the same settings as the first.
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
async fn a_writer_whose_commits_are_invisible_is_reported_and_replaced() {
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
    // The writer counts as busy until the pool has it back.
    let mut check = store.check_commits().await;
    for _ in 0..1000 {
        if check.is_err() {
            break;
        }
        tokio::task::yield_now().await;
        check = store.check_commits().await;
    }
    let check = check.unwrap_err();
    assert!(
        matches!(
            check,
            StoreError::NotKept {
                kept: 1,
                written: 2
            }
        ),
        "{check}"
    );
    store.check_commits().await.unwrap();
    let event = store.record(alarm("kept")).await.unwrap();
    assert_eq!(store.last_event_id().await.unwrap(), event.id);
}

/// A disk with this many bytes left.
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
async fn a_start_on_a_full_disk_reports_what_can_be_deleted() {
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
async fn a_read_only_folder_can_be_read() {
    let folder = tempfile::tempdir().unwrap();
    let (store, _) = open(folder.path()).await.unwrap();
    let sample = samples::tests::polymer(&store).await;
    store.close().await;
    drop(store);
    // Permissions do not stop root, as in many containers: the proof is that nothing was written.
    let (disk, clock) = (Arc::new(RealDisk), Arc::new(SteppedClock::new()));
    let store = Store::open_unwritable(folder.path(), disk, clock)
        .await
        .unwrap();
    assert_eq!(store.sample(sample.id).await.unwrap(), sample);
    assert!(!folder.path().join("ridged.sqlite-wal").exists());
    assert!(!folder.path().join("ridged.sqlite-shm").exists());
    store.close().await;
    // Rows in a log that cannot be written back cause an error.
    fs::write(folder.path().join("ridged.sqlite-wal"), b"rows").unwrap();
    let refused = immutable(folder.path()).unwrap_err();
    assert!(matches!(refused, StoreError::UnreadLog { .. }), "{refused}");
}

#[tokio::test]
async fn a_read_only_folder_of_an_earlier_program_can_be_read() {
    let folder = tempfile::tempdir().unwrap();
    let database = folder.path().join(DATABASE);
    let options = SqliteConnectOptions::new()
        .filename(&database)
        .create_if_missing(true);
    let mut old = SqliteConnection::connect_with(&options).await.unwrap();
    let dump = include_str!("../../tests/data/store-0.1.0.sql");
    sqlx::raw_sql(dump).execute(&mut old).await.unwrap();
    old.close().await.unwrap();
    let before = fs::read(&database).unwrap();
    let (disk, clock) = (Arc::new(RealDisk), Arc::new(SteppedClock::new()));
    let store = Store::open_unwritable(folder.path(), disk, clock)
        .await
        .unwrap();
    let found = store.results(&results::ResultQuery::default()).await;
    assert!(!found.unwrap().rows.is_empty());
    // The folder is as it was, and nothing is written into it.
    let refused = store.record(alarm("not written")).await.unwrap_err();
    assert!(matches!(refused, StoreError::ReadOnly), "{refused}");
    store.close().await;
    assert!(fs::read(&database).unwrap() == before);
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
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
