//! A store that is locked or goes away while the rig works: nothing is written elsewhere, and no command waits for it.

use std::fs;
use std::path::Path;
use std::sync::{Arc, Condvar, Mutex};
use std::time::{Duration, Instant};

use axum::body::Body;
use ridged::bench::AxisName::PhiS;
use ridged::clock::{Clock, ScaledClock};
use ridged::frame::FrameKind;
use ridged::lab::LabError;
use ridged::scan::event::RigActivity;
use ridged::scan::runner::ScanCommand;
use ridged::scan::{Event, RecordedEvent, ScanState};
use ridged::store::disk::{Disk, RealDisk};
use ridged::units::Angle;
use sqlx::{ConnectOptions, Connection, SqliteConnection};
use tokio::sync::broadcast::Receiver;

use crate::bench_in_a_box::{BenchInABox, in_time, small};
use crate::http::{is_problem, request, router_of, send};
use crate::stop::{disturbed_on, idle, next};

/// Holds the write lock of the database, as another program does.
async fn lock(folder: &Path) -> SqliteConnection {
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(folder.join("ridged.sqlite"));
    let mut connection = options.connect().await.unwrap();
    sqlx::query("BEGIN EXCLUSIVE")
        .execute(&mut connection)
        .await
        .unwrap();
    connection
}

#[tokio::test(flavor = "multi_thread")]
async fn neither_a_stop_nor_a_motion_waits_for_a_locked_database() {
    let clock: Arc<dyn Clock> = Arc::new(ScaledClock::new(10.0));
    let (lab, rig, folder) = disturbed_on(clock, |_| {}).await;
    let mut events = lab.events();
    lab.home(PhiS).await.unwrap();
    idle(&mut events).await;
    let router = router_of(&lab);
    let locked = lock(folder.path()).await;

    let began = Instant::now();
    lab.move_axis(PhiS, Angle::from_deg(350.0)).await.unwrap();
    while !rig.world.is_moving() {
        assert!(began.elapsed() < Duration::from_secs(5), "it never moved");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let stop = request("POST", "/api/v1/rig/stop").body(Body::empty());
    let asked = Instant::now();
    let answer = send(&router, stop.unwrap()).await;
    let took = asked.elapsed();
    assert_eq!(answer.status, 200, "{}", answer.body);
    assert!(took < Duration::from_secs(1), "answered after {took:?}");
    assert!(!rig.world.is_moving());

    // What was reported meanwhile follows.
    locked.close().await.unwrap();
    let stopped = |event: &Event| {
        matches!(
            event,
            Event::Rig {
                activity: RigActivity::Stopped,
                ..
            }
        )
    };
    let stop = next(&mut events, stopped).await;
    let kept = lab.store().events_after(0, 1000).await.unwrap();
    let is_kept = |event: &RecordedEvent| event.id == stop.id && event.event == stop.event;
    assert!(kept.iter().any(is_kept), "{kept:?}");
    lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_abort_stops_the_stages_before_it_waits_for_a_locked_database() {
    let clock: Arc<dyn Clock> = Arc::new(ScaledClock::new(10.0));
    let (lab, rig, folder) = disturbed_on(clock, |_| {}).await;
    rig.add_samples(&lab).await.unwrap();
    let plan = small(&[-55.0, 55.0], &[0.0]);
    let request = ridged::lab::ScanRequest::of(2, plan);
    let mut events = lab.events();
    let scan = lab.start_scan(&request).await.unwrap();
    let hands = rig.operate(&lab, true);
    next(&mut events, |event| matches!(event, Event::Frame { .. })).await;
    let moves = async {
        while !rig.world.is_moving() {
            tokio::task::yield_now().await;
        }
    };
    in_time(moves).await;
    let locked = lock(folder.path()).await;
    let its_lab = lab.clone();
    let aborting = tokio::spawn(async move { its_lab.order(scan.id, ScanCommand::Abort).await });
    let asked = Instant::now();
    while rig.world.is_moving() {
        assert!(asked.elapsed() < Duration::from_secs(5), "it moves on");
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    locked.close().await.unwrap();
    assert_eq!(aborting.await.unwrap().unwrap(), ScanState::Aborted);
    hands.abort();
    lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_state_of_a_scan_waits_for_a_database_that_is_locked_for_long() {
    let folder = tempfile::tempdir().unwrap();
    let (bench, scan_id, mut events) = with_a_frame(folder.path()).await;
    let locked = lock(folder.path()).await;
    bench.lab.stop().await.unwrap();
    let is_alarm =
        |event: &Event| matches!(event, Event::Alarm { code, .. } if code == "store-locked");
    next(&mut events, is_alarm).await;
    locked.close().await.unwrap();
    bench.until(scan_id, ScanState::Paused).await;
    bench.lab.shut_down().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_is_answered_within_a_second_while_the_database_is_locked() {
    let folder = tempfile::tempdir().unwrap();
    let (bench, scan_id, mut events) = with_a_frame(folder.path()).await;
    let router = router_of(&bench.lab);
    bench.lab.order(scan_id, ScanCommand::Pause).await.unwrap();
    bench.until(scan_id, ScanState::Paused).await;
    let plan = r#"{"sample_id": 2, "plan": {"theta_c_deg": [0], "phi_s_deg": [0]}}"#;
    let in_a_second = async |path: &str, body: &'static str| {
        let order = request("POST", path).header("content-type", "application/json");
        let asked = Instant::now();
        let answer = send(&router, order.body(Body::from(body)).unwrap()).await;
        let took = asked.elapsed();
        assert!(took < Duration::from_millis(1500), "{path}: {took:?}");
        answer
    };
    let locked = lock(folder.path()).await;
    let of_scan = |order: &str| format!("/api/v1/scans/{scan_id}/{order}");
    // What would move the stages later, when no person expects it, is refused.
    for (path, body) in [(of_scan("resume"), ""), ("/api/v1/scans".into(), plan)] {
        let refused = in_a_second(&path, body).await;
        is_problem(&refused, 503, "store-locked");
        assert!(refused.detail().contains("fuser"), "{}", refused.body);
    }
    let lease = in_a_second("/api/v1/lease", r#"{"name": "night"}"#).await;
    assert_eq!(lease.status, 201, "{}", lease.body);
    bench.lab.stop().await.unwrap();
    // What stops them is taken, and recorded once the lock ends.
    let begun = Instant::now();
    let aborting = bench.lab.order(scan_id, ScanCommand::Abort).await;
    assert!(begun.elapsed() < Duration::from_millis(1500));
    let LabError::WaitsForDatabase { asked: "abort", .. } = aborting.unwrap_err() else {
        panic!("the order is carried out later");
    };
    locked.close().await.unwrap();
    bench.until(scan_id, ScanState::Aborted).await;
    while let Ok(event) = events.try_recv() {
        let running = matches!(
            event.event,
            Event::Scan {
                state: ScanState::Running,
                ..
            }
        );
        assert!(!running, "{event:?}");
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_ends_within_seconds_while_the_database_is_locked() {
    let folder = tempfile::tempdir().unwrap();
    let (bench, scan_id, _) = with_a_frame(folder.path()).await;
    let frames = bench.lab.store().newest_frames(scan_id, 100).await.unwrap();
    let locked = lock(folder.path()).await;
    let asked = Instant::now();
    bench.lab.shut_down().await;
    assert!(
        asked.elapsed() < Duration::from_secs(8),
        "{:?}",
        asked.elapsed()
    );
    locked.close().await.unwrap();
    drop(bench);
    let bench = BenchInABox::open(folder.path(), Arc::new(RealDisk), false).await;
    bench.until(scan_id, ScanState::Interrupted).await;
    let kept = bench.lab.store().newest_frames(scan_id, 100).await.unwrap();
    assert_eq!(kept, frames);
    bench.end().await;
}

/// A scan whose first frame is durable, and the events from then on.
async fn with_a_frame(folder: &Path) -> (BenchInABox, i64, Receiver<Arc<RecordedEvent>>) {
    let bench = BenchInABox::open(folder, Arc::new(RealDisk), false).await;
    let mut events = bench.lab.events();
    let scan = bench.start(small(&[-10.0, 0.0, 10.0], &[0.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    bench.rig.world.cap_lens(true);
    let go_on = bench.lab.order(scan.id, ScanCommand::Continue);
    go_on.await.unwrap();
    next(&mut events, |event| matches!(event, Event::Frame { .. })).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    (bench, scan.id, events)
}

/// A disk that takes no change and answers no question while it is silent.
#[derive(Default)]
struct SilentDisk {
    silent: Mutex<bool>,
    ended: Condvar,
}

impl SilentDisk {
    fn be_silent(&self, silent: bool) {
        *self.silent.lock().unwrap() = silent;
        self.ended.notify_all();
    }

    fn wait(&self) {
        let silent = self.silent.lock().unwrap();
        drop(self.ended.wait_while(silent, |silent| *silent).unwrap());
    }
}

impl Disk for SilentDisk {
    fn write_durably(&self, path: &Path, bytes: &[u8]) -> std::io::Result<()> {
        self.wait();
        RealDisk.write_durably(path, bytes)
    }

    fn free_bytes(&self, folder: &Path) -> std::io::Result<u64> {
        self.wait();
        RealDisk.free_bytes(folder)
    }

    fn ask(&self, file: &Path) {
        self.wait();
        RealDisk.ask(file);
    }
}

/// Lets a disk answer again, also where its test fails.
struct Answers(Arc<SilentDisk>);

impl Drop for Answers {
    fn drop(&mut self) {
        self.0.be_silent(false);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_on_a_disk_that_does_not_answer_waits_says_so_and_continues() {
    let folder = tempfile::tempdir().unwrap();
    let disk = Arc::new(SilentDisk::default());
    let _answers = Answers(Arc::clone(&disk));
    let bench = BenchInABox::open(folder.path(), Arc::clone(&disk) as _, true).await;
    let mut events = bench.lab.events();
    let tilts_deg = [-40.0, -30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0, 40.0];
    let scan = bench.start(small(&tilts_deg, &[0.0, 60.0])).await;
    // After the last step of the operator.
    let of_sample = |event: &Event| {
        matches!(
            event,
            Event::Frame {
                kind: FrameKind::Sample,
                ..
            }
        )
    };
    next(&mut events, of_sample).await;
    disk.be_silent(true);
    let is_alarm = |event: &Event| matches!(event, Event::Alarm { code, scan_id: Some(_), .. } if code == "disk-silent");
    let alarm = next(&mut events, is_alarm).await;
    assert!(!alarm.is_recorded(), "it is sent before the disk takes it");
    // A person sees where the rig is and why; what needs the disk is refused in time.
    let router = router_of(&bench.lab);
    let in_a_second = async |method: &str, path: &str, body: &'static str| {
        let asked = request(method, path).header("content-type", "application/json");
        let begun = Instant::now();
        let answer = send(&router, asked.body(Body::from(body)).unwrap()).await;
        let took = begun.elapsed();
        assert!(took < Duration::from_millis(1500), "{path}: {took:?}");
        answer
    };
    let rig = in_a_second("GET", "/api/v1/rig", "").await;
    assert_eq!((rig.status, &rig.body["scan_id"]), (200, &scan.id.into()));
    assert!(
        rig.body["axes"]["phi_s"]["position_deg"].is_number(),
        "{}",
        rig.body
    );
    let why = rig.body["scan_reason"].as_str().unwrap();
    assert!(
        why.contains("does not answer") && why.contains("continues by itself"),
        "{why}"
    );
    let part = r#"{"name": "a", "metal": {"name": "Cr"}}"#;
    let refused = in_a_second("POST", "/api/v1/samples", part).await;
    is_problem(&refused, 503, "disk-silent");
    let resume = format!("/api/v1/scans/{}/resume", scan.id);
    is_problem(&in_a_second("POST", &resume, "").await, 503, "disk-silent");
    let lease = in_a_second("POST", "/api/v1/lease", r#"{"name": "night"}"#).await;
    assert_eq!(lease.status, 201, "{}", lease.body);
    assert_eq!(in_a_second("GET", "/readyz", "").await.status, 503);
    bench.lab.check_folder().await.unwrap_err();

    disk.be_silent(false);
    let is_over =
        |event: &Event| matches!(event, Event::Recovered { code, .. } if code == "disk-silent");
    assert!(next(&mut events, is_over).await.is_recorded());
    bench.until(scan.id, ScanState::Completed).await;
    assert_eq!(
        in_a_second("POST", "/api/v1/samples", part).await.status,
        201
    );
    bench.end().await;
}

async fn is_gone(bench: &BenchInABox, scan_id: i64, alarm: &RecordedEvent) {
    let mut events = bench.lab.events();
    assert!(!alarm.is_recorded());
    let Event::Alarm { code, message, .. } = &alarm.event else {
        panic!("{alarm:?}");
    };
    assert_eq!(code, "data-folder-gone");
    assert!(message.contains("while the daemon used it"), "{message}");
    let scan = bench.lab.store().scan(scan_id).await.unwrap();
    let scan = bench.lab.with_unrecorded_end(scan);
    assert_eq!(scan.state, ScanState::Interrupted);
    assert!(scan.reason.unwrap().contains("while the daemon used it"));
    assert!(!bench.rig.world.is_moving());
    let router = router_of(&bench.lab);
    let ready = request("GET", "/readyz").body(Body::empty()).unwrap();
    let ready = send(&router, ready).await;
    assert_eq!((ready.status, &ready.body["store"]), (503, &false.into()));
    let problem = ready.body["problem"].as_str().unwrap();
    assert!(problem.contains("the daemon used it"), "{problem}");
    // The first look raises the alarm, once.
    bench.lab.check_folder().await.unwrap_err();
    bench.lab.check_folder().await.unwrap_err();
    let mut alarms = 0;
    while let Ok(event) = events.try_recv() {
        alarms += usize::from(matches!(&event.event, Event::Alarm { scan_id: None, .. }));
    }
    assert_eq!(alarms, 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_whose_folder_is_deleted_ends_with_the_cause_and_makes_no_other_folder() {
    let parent = tempfile::tempdir().unwrap();
    let folder = parent.path().join("data");
    let (bench, scan_id, mut events) = with_a_frame(&folder).await;
    fs::remove_dir_all(&folder).unwrap();
    // The scan cannot record that it continues.
    let refused = bench.lab.order(scan_id, ScanCommand::Continue).await;
    assert_eq!(refused.unwrap_err().code(), "data-folder-gone");
    let alarm = next(
        &mut events,
        |event| matches!(event, Event::Alarm { scan_id, .. } if scan_id.is_some()),
    );
    let alarm = alarm.await;
    is_gone(&bench, scan_id, &alarm).await;
    bench.end().await;
    assert!(!folder.exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_whose_folder_is_replaced_writes_nothing_there_and_resumes_in_the_first() {
    let parent = tempfile::tempdir().unwrap();
    let (folder, away) = (parent.path().join("data"), parent.path().join("away"));
    let (bench, scan_id, mut events) = with_a_frame(&folder).await;
    fs::rename(&folder, &away).unwrap();
    fs::create_dir_all(folder.join("frames")).unwrap();
    fs::write(folder.join("ridged.sqlite"), b"").unwrap();
    bench.lab.order(scan_id, ScanCommand::Continue).await.ok();
    let alarm = next(
        &mut events,
        |event| matches!(event, Event::Alarm { scan_id, .. } if scan_id.is_some()),
    );
    let alarm = alarm.await;
    is_gone(&bench, scan_id, &alarm).await;
    assert_eq!(fs::read(folder.join("ridged.sqlite")).unwrap(), b"");
    assert_eq!(fs::read_dir(folder.join("frames")).unwrap().count(), 0);

    // The first one comes back, as a disk that is mounted again.
    fs::remove_dir_all(&folder).unwrap();
    fs::rename(&away, &folder).unwrap();
    let hands = bench.rig.operate(&bench.lab, true);
    bench.until(scan_id, ScanState::Interrupted).await;
    bench.lab.order(scan_id, ScanCommand::Resume).await.unwrap();
    bench.until(scan_id, ScanState::Completed).await;
    hands.abort();
    bench.end().await;
}

#[test]
fn every_write_of_the_store_goes_through_the_check_of_the_folder() {
    let store = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/store");
    let mut read = 0;
    for entry in fs::read_dir(store).unwrap() {
        let path = entry.unwrap().path();
        let is_test = path.ends_with("tests.rs");
        if is_test || path.extension().is_none_or(|e| e != "rs") {
            continue;
        }
        let source = fs::read_to_string(&path).unwrap();
        let source = source.split("#[cfg(test)]").next().unwrap();
        // `Store::writing` begins every transaction that writes.
        let direct = source.contains(".execute(self.writer())");
        assert!(!direct, "{}: write with Store::writing", path.display());
        read += 1;
    }
    assert!(read > 10);
}
