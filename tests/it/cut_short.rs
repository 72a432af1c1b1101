//! What is left when somebody goes away in the middle, or something cannot be written.

use std::io;
use std::path::Path;
use std::pin::pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::task::Poll;
use std::time::Duration;

use futures::FutureExt;
use ridged::bench::stage::AxisName;
use ridged::lab::{LabError, ScanRequest};
use ridged::scan::runner::ScanCommand;
use ridged::scan::{Event, PlanRequest, ScanState};
use ridged::sim::world::AxisFault;
use ridged::store::PageRequest;
use ridged::store::disk::{Disk, RealDisk};
use ridged::units::Angle;
use sqlx::{ConnectOptions, Connection};

use crate::bench_in_a_box::{BenchInABox, small};
use crate::stop::idle;

/// For what would never come where the claim does not hold; nothing waits so long where it does.
const NEVER: Duration = Duration::from_secs(60);

/// A client that goes away when its request has been polled a number of times; the answer if it came before.
pub async fn gone_after<T>(looks: u32, request: impl Future<Output = T>) -> Option<T> {
    let mut request = pin!(request);
    let mut looked = 0;
    std::future::poll_fn(move |context| {
        if looked == looks {
            return Poll::Ready(None);
        }
        looked += 1;
        request.as_mut().poll(context).map(Some)
    })
    .await
}

/// Changes the database as no program does, beside the store that is open.
pub async fn by_hand(folder: &Path, statement: &'static str) {
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(folder.join("ridged.sqlite"));
    let mut connection = options.connect().await.unwrap();
    sqlx::query(statement)
        .execute(&mut connection)
        .await
        .unwrap();
    connection.close().await.unwrap();
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_that_cannot_be_resumed_says_so_and_can_be_later() {
    let folder = tempfile::tempdir().unwrap();
    let bench = BenchInABox::open(folder.path(), Arc::new(RealDisk), false).await;
    let scan = bench.start(small(&[0.0], &[0.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    bench.end().await;

    let bench = BenchInABox::open(folder.path(), Arc::new(RealDisk), false).await;
    by_hand(
        folder.path(),
        "CREATE TRIGGER full BEFORE INSERT ON scan_states BEGIN SELECT RAISE(ABORT, 'full'); END",
    )
    .await;
    let resumed = tokio::time::timeout(NEVER, bench.lab.order(scan.id, ScanCommand::Resume)).await;
    let refused = resumed.expect("an answer comes").unwrap_err();
    assert_eq!(refused.code(), "store-failed", "{refused}");
    by_hand(folder.path(), "DROP TRIGGER full").await;
    let state = loop {
        match bench.lab.order(scan.id, ScanCommand::Resume).await {
            Ok(state) => break state,
            // The owner is about to have the rig back.
            Err(LabError::Busy { .. } | LabError::NotNow { .. }) => tokio::task::yield_now().await,
            Err(error) => panic!("{error}"),
        }
    };
    assert_eq!(state, ScanState::Running);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_whose_orders_could_not_be_written_takes_them_once_they_can() {
    for (order, state) in [
        (ScanCommand::Abort, ScanState::Aborted),
        (ScanCommand::Resume, ScanState::Running),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let bench = BenchInABox::open(folder.path(), Arc::new(RealDisk), false).await;
        let scan = bench.start(small(&[0.0], &[0.0])).await;
        bench.until(scan.id, ScanState::WaitingForOperator).await;
        bench.lab.order(scan.id, ScanCommand::Pause).await.unwrap();
        by_hand(
            folder.path(),
            "CREATE TRIGGER full BEFORE INSERT ON scan_states BEGIN SELECT RAISE(ABORT, 'full'); END",
        )
        .await;
        // The message is not that the scan cannot be aborted: it names what prevents the row from being written.
        for order in [order, ScanCommand::Abort, ScanCommand::Resume] {
            let answer = tokio::time::timeout(NEVER, bench.lab.order(scan.id, order)).await;
            let refused = answer.expect("an answer comes").unwrap_err();
            assert_eq!(refused.code(), "store-failed", "{refused}");
        }
        by_hand(folder.path(), "DROP TRIGGER full").await;
        assert_eq!(bench.lab.order(scan.id, order).await.unwrap(), state);
        bench.end().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_whose_client_went_away_is_planned_and_begun_all_the_same() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let request = ScanRequest::of(2, small(&[0.0], &[0.0]));
    let mut events = bench.lab.events();
    let asked = bench.lab.start_scan(&request).now_or_never();
    assert!(asked.is_none());
    let waits = async {
        loop {
            if let Event::Scan { state, .. } = &events.recv().await.unwrap().event
                && *state == ScanState::WaitingForOperator
            {
                return;
            }
        }
    };
    tokio::time::timeout(NEVER, waits).await.expect("it begins");
    let page = PageRequest::default();
    let scans = bench.lab.store().scans(Default::default(), page).await;
    assert_eq!(scans.unwrap().items.len(), 1);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn of_two_scans_begun_at_once_one_is_refused_and_leaves_no_row() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let request = ScanRequest::of(2, small(&[0.0], &[0.0]));
    let both = futures::join!(
        bench.lab.start_scan(&request),
        bench.lab.start_scan(&request)
    );
    let (begun, refused): (Vec<_>, Vec<_>) = [both.0, both.1]
        .into_iter()
        .partition(|begun| begun.is_ok());
    assert_eq!((begun.len(), refused.len()), (1, 1));
    let refused = refused.into_iter().next().unwrap().unwrap_err();
    assert_eq!(refused.code(), "busy", "{refused}");
    let page = PageRequest::default();
    let scans = bench.lab.store().scans(Default::default(), page).await;
    assert_eq!(scans.unwrap().items.len(), 1);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_that_another_program_writes_to_for_a_moment_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let bench = BenchInABox::open(folder.path(), Arc::new(RealDisk), false).await;
    let scan = bench.start(small(&[0.0], &[0.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    let options =
        sqlx::sqlite::SqliteConnectOptions::new().filename(folder.path().join("ridged.sqlite"));
    let mut other = options.connect().await.unwrap();
    sqlx::query("BEGIN IMMEDIATE")
        .execute(&mut other)
        .await
        .unwrap();
    let for_a_moment = async {
        tokio::time::sleep(Duration::from_millis(300)).await;
        sqlx::query("COMMIT").execute(&mut other).await.unwrap();
    };
    let (paused, ()) = futures::join!(bench.lab.order(scan.id, ScanCommand::Pause), for_a_moment);
    assert_eq!(paused.unwrap(), ScanState::Paused);
    other.close().await.unwrap();
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_axis_that_did_not_find_its_reference_says_why_until_it_moves_again() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let lab = &bench.lab;
    let mut events = lab.events();
    let mut home = async || {
        lab.home(AxisName::ThetaC).await.unwrap();
        idle(&mut events).await;
        lab.rig().await.unwrap()
    };
    bench.rig.world.arm(
        AxisName::ThetaC,
        Angle::from_deg(-40.0),
        AxisFault::ForeignStop,
    );
    let rig = home().await;
    let (code, why) = rig.failure.expect("it failed");
    assert_eq!(code, "stage-homing-failed", "{why}");
    assert!(!rig.axes[0].1.homed);
    let rig = home().await;
    assert_eq!(rig.failure, None);
    assert!(rig.axes[0].1.homed);
    bench.end().await;
}

/// A disk that counts how many write to it at the same time.
#[derive(Default)]
struct CountingDisk {
    now: AtomicUsize,
    most: AtomicUsize,
}

impl Disk for CountingDisk {
    fn write_durably(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        let now = self.now.fetch_add(1, Ordering::SeqCst) + 1;
        self.most.fetch_max(now, Ordering::SeqCst);
        // Time for all others who may.
        for _ in 0..200 {
            std::thread::yield_now();
        }
        let written = RealDisk.write_durably(path, bytes);
        self.now.fetch_sub(1, Ordering::SeqCst);
        written
    }

    fn free_bytes(&self, _: &Path) -> io::Result<u64> {
        Ok(10_000_000_000)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_point_of_many_frames_is_written_a_few_at_a_time() {
    let disk = Arc::new(CountingDisk::default());
    let bench = BenchInABox::with(Arc::clone(&disk) as Arc<dyn Disk>, true).await;
    let plan = PlanRequest {
        repeats: Some(12),
        ..small(&[0.0], &[0.0, 90.0])
    };
    let scan = bench.start(plan).await;
    assert_eq!(bench.finish(scan.id).await.state, ScanState::Completed);
    let most = disk.most.load(Ordering::SeqCst);
    assert!(most <= 2, "{most} frames at once");
    bench.end().await;
}
