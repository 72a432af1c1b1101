//! Whole scans over the pseudo-terminal: motion, frames, store, events, fit; then what disturbs them.

use std::io;
use std::path::Path;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::time::Duration;

use ridged::analysis;
use ridged::bench::AxisName;
use ridged::job::JobState;
use ridged::lab::{
    FitRequest, ImportOptions, LabError, ScanRequest, StoredSeries, export, export_readable,
};
use ridged::reduction::FrameSource;
use ridged::scan::event::RigActivity;
use ridged::scan::plan::Preset;
use ridged::scan::runner::ScanCommand;
use ridged::scan::{Event, OperatorAction, PlanRequest, ScanState};
use ridged::sim::world::AxisFault;
use ridged::store::PageRequest;
use ridged::store::disk::{Disk, RealDisk};
use ridged::units::Angle;

use crate::bench_in_a_box::{BenchInABox, in_time, small};

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_is_planned_run_kept_reported_and_fitted() {
    // A rig on a pseudo-terminal, a store in an empty folder, and hands that do what is asked.
    let bench = BenchInABox::new().await;
    let lab = &bench.lab;

    // The paper's plan: 15 poses at two exposures, dark frames, the white reference at five tilts.
    let request = ScanRequest::of(2, PlanRequest::preset(Preset::Paper));
    let estimated = lab.estimate(&request).await.unwrap();
    assert_eq!(estimated.estimate.n_frames, 15 * 2 + 5 * 2 + 2 * 4);
    assert_eq!(
        estimated.operator_steps,
        [
            OperatorAction::CapLens,
            OperatorAction::PlaceWhiteReference,
            OperatorAction::PlaceSample
        ]
    );

    // It runs to its end.
    let scan = lab.start_scan(&request).await.unwrap();
    assert_eq!(scan.state, ScanState::Planned);
    let scan = bench.finish(scan.id).await;
    assert_eq!(scan.state, ScanState::Completed, "{:?}", scan.reason);

    // Every frame is there, at the position read back: near the one asked for, never exactly it.
    let series = StoredSeries::open(lab.store(), scan.id).await.unwrap();
    assert_eq!(series.rows().len(), 48);
    for (i, row) in series.rows().iter().enumerate() {
        series.read(i).unwrap();
        let near_a_tilt = (row.theta_c_deg / 10.0 - (row.theta_c_deg / 10.0).round()).abs() < 1e-3;
        assert!(near_a_tilt, "{} at θc {}", row.file, row.theta_c_deg);
    }

    // The story has every state and every frame, in order and numbered without gaps.
    let story = lab.store().events_after(0, 10_000).await.unwrap();
    assert!(story.windows(2).all(|w| w[1].id == w[0].id + 1));
    let states: Vec<ScanState> = story
        .iter()
        .filter_map(|e| match &e.event {
            Event::Scan { state, .. } => Some(*state),
            _ => None,
        })
        .collect();
    assert_eq!(
        states,
        [
            ScanState::Planned,
            ScanState::Running,
            ScanState::WaitingForOperator,
            ScanState::Running,
            ScanState::WaitingForOperator,
            ScanState::Running,
            ScanState::WaitingForOperator,
            ScanState::Running,
            ScanState::Completed
        ]
    );
    let frames = story.iter().filter(|e| e.event.kind() == "frame").count();
    assert_eq!(frames, 48);

    // The fit finds the sample's ridge angle within what it says of itself.
    let id = lab
        .start_job(FitRequest {
            scan_id: scan.id,
            variant: ridged::fit::VariantChoice::Auto,
            ..FitRequest::default()
        })
        .await
        .unwrap();
    let mut events = lab.events();
    let waiting = async {
        loop {
            let fit = lab.store().job(id).await.unwrap();
            if fit.state != JobState::Running {
                break fit;
            }
            events.recv().await.unwrap();
        }
    };
    let fit = in_time(waiting).await;
    assert_eq!(fit.state, JobState::Completed, "{:?}", fit.error_detail);
    let report = fit.result.unwrap();
    // The OpenAPI document also has the fields that the lab adds to a report.
    let whole: serde_json::Value = serde_json::from_str(&report).unwrap();
    let described = crate::http::document::described("Fit");
    for name in whole.as_object().unwrap().keys() {
        assert!(described.contains(name), "Fit has no {name}");
    }
    let report: ridged::fit::FitReport = serde_json::from_str(&report).unwrap();
    let theta_r = &report.parameters.theta_r_deg;
    let (value, expanded) = (theta_r.value.unwrap(), theta_r.expanded.unwrap());
    assert!(
        (value - 10.0).abs() <= expanded,
        "θr = {value} ± {expanded} (true: 10)"
    );

    // The observations it was made of are kept, and drawn they lie on their curve.
    let curves = lab.curves(id.number, 10.0).await.unwrap();
    assert_eq!(curves.observations.len(), 15);
    assert_eq!(curves.curves.len(), 5);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_is_fitted_while_it_runs_and_its_uncertainty_falls() {
    // The disk takes a frame when the test lets it. So the scan stands still, whatever the machine does, until the fit
    // that runs along has come that far: after a third and near the end of the 30 poses. With fewer than two tilts
    // the ridge angle is hardly known; from half of them on, what the model misses is most of its uncertainty.
    const LOOKS_AT: [usize; 2] = [10, 28];
    let disk = Arc::new(PatientDisk::default());
    let bench = BenchInABox::with(Arc::clone(&disk) as Arc<dyn Disk>, true).await;
    let lab = &bench.lab;
    let mut events = lab.events();
    let tilts = [-20.0, -10.0, 0.0, 10.0, 20.0];
    let azimuths = [0.0, 60.0, 120.0, 180.0, 240.0, 300.0];
    disk.let_in(1);
    let scan = bench.start(small(&tilts, &azimuths)).await;
    let mut fitted_at: Vec<(usize, f64, f64)> = Vec::new();
    let mut poses = 0;
    while fitted_at.len() < LOOKS_AT.len() {
        let looks_at = LOOKS_AT[fitted_at.len()];
        match &in_time(events.recv()).await.unwrap().event {
            Event::Frame { kind, .. } => {
                poses += usize::from(*kind == ridged::frame::FrameKind::Sample);
                disk.let_in(usize::from(poses < looks_at));
            }
            Event::Uncertainty { certainty, .. } if certainty.n_observations >= looks_at => {
                let theta_r = &certainty.parameters["theta_r_deg"];
                fitted_at.push((certainty.n_observations, certainty.elapsed_s, theta_r.std));
                disk.let_in(1);
            }
            Event::Scan { state, .. } => assert!(!state.is_end(), "{state}: {fitted_at:?}"),
            _ => {}
        }
    }
    disk.let_in(1000);
    lab.order(scan.id, ScanCommand::Abort).await.ok();
    bench.finish(scan.id).await;
    let [(few, early_s, wide), (many, late_s, narrow)] = fitted_at[..] else {
        panic!("{fitted_at:?}");
    };
    assert!(few < many && early_s < late_s, "{fitted_at:?}");
    assert!(narrow < wide, "{fitted_at:?}");
    // It is kept, in order.
    let page = PageRequest::default();
    let kept = lab.store().scan_events(scan.id, &["uncertainty"], page);
    let kept = kept.await.unwrap().items;
    assert!(kept.len() >= 2 && kept.windows(2).all(|w| w[0].id < w[1].id));
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_second_scan_uses_the_first_ones_darks_and_white_reference() {
    let bench = BenchInABox::new().await;
    let first = bench.start(small(&[0.0, 10.0], &[0.0])).await;
    assert_eq!(bench.finish(first.id).await.state, ScanState::Completed);
    let request = ScanRequest::of(2, small(&[0.0, 10.0], &[0.0, 90.0]));
    let estimated = bench.lab.estimate(&request).await.unwrap();
    assert_eq!(estimated.operator_steps, [OperatorAction::PlaceSample]);
    let second = bench.lab.start_scan(&request).await.unwrap();
    assert_eq!(bench.finish(second.id).await.state, ScanState::Completed);
    let series = StoredSeries::open(bench.lab.store(), second.id)
        .await
        .unwrap();
    // Four of its own, one dark and two white-reference frames of the first scan.
    assert_eq!(series.rows().len(), 4 + 1 + 2);
    let reduced = bench.lab.observations(second.id, None).await.unwrap();
    assert!(reduced.complete && reduced.set.white_reference.is_some());
    assert_eq!(reduced.set.observations.len(), 4);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn calibrations_from_the_future_are_taken_again() {
    let folder = tempfile::tempdir().unwrap();
    let disk = Arc::new(RealDisk);
    let bench = BenchInABox::open(folder.path(), disk.clone(), true).await;
    // This clock ran ahead by two hours; the next one begins where it began.
    bench.rig.clock.sleep(Duration::from_secs(7200)).await;
    let first = bench.start(small(&[0.0], &[0.0])).await;
    assert_eq!(bench.finish(first.id).await.state, ScanState::Completed);
    bench.end().await;
    let bench = BenchInABox::open(folder.path(), disk, true).await;
    let request = ScanRequest::of(2, small(&[0.0], &[0.0]));
    let steps = bench.lab.estimate(&request).await.unwrap().operator_steps;
    assert_eq!(steps.len(), 3);
    let page = PageRequest::default();
    let all = Default::default();
    let kept = bench.lab.store().calibrations(&all, page).await;
    for kept in kept.unwrap().items {
        let (_, valid) = bench
            .lab
            .calibration_valid_until(kept.kind, &kept.created_at)
            .unwrap();
        assert!(!valid, "{}", kept.created_at);
    }
    bench.rig.clock.sleep(Duration::from_secs(7800)).await;
    let steps = bench.lab.estimate(&request).await.unwrap().operator_steps;
    assert_eq!(steps, [OperatorAction::PlaceSample]);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_that_was_stopped_while_it_waited_says_so() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let scan = bench.start(small(&[0.0], &[0.0])).await;
    for (order, reason) in [
        (ScanCommand::Stop, Some("stopped; resume to continue")),
        (ScanCommand::Pause, None),
    ] {
        bench.until(scan.id, ScanState::WaitingForOperator).await;
        bench.lab.order(scan.id, order).await.unwrap();
        let paused = bench.lab.store().scan(scan.id).await.unwrap();
        assert_eq!(paused.state, ScanState::Paused);
        assert_eq!(paused.reason.as_deref(), reason);
        bench.lab.order(scan.id, ScanCommand::Resume).await.unwrap();
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_order_that_comes_twice_neither_does_a_step_nor_undoes_a_stop() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let lab = &bench.lab;
    let scan = bench.start(small(&[0.0], &[0.0])).await;
    let order = |order| lab.order(scan.id, order);
    for _ in 0..5 {
        bench.until(scan.id, ScanState::WaitingForOperator).await;
        order(ScanCommand::Pause).await.unwrap();
        let (one, other) = tokio::join!(order(ScanCommand::Resume), order(ScanCommand::Resume));
        assert!(one.is_ok() != other.is_ok(), "{one:?} {other:?}");
    }
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    bench.rig.world.cap_lens(true);
    let (one, stopped, other) = tokio::join!(
        order(ScanCommand::Continue),
        order(ScanCommand::Stop),
        order(ScanCommand::Continue),
    );
    assert!(stopped.is_ok(), "{stopped:?}");
    assert!(!(one.is_ok() && other.is_ok()), "{one:?} {other:?}");
    bench.until(scan.id, ScanState::Paused).await;
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_simulated_operator_who_comes_late_does_the_step_that_a_scan_waits_for() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let scan = bench.start(small(&[0.0], &[0.0, 90.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    let hands = bench.rig.operate(&bench.lab, true);
    assert_eq!(bench.finish(scan.id).await.state, ScanState::Completed);
    hands.abort();
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_waits_for_its_operator_pauses_and_goes_on() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let lab = &bench.lab;
    let scan = bench.start(small(&[0.0], &[0.0, 90.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    // No other client gets the rig meanwhile, but any client may stop it.
    let refused = lab.move_axis(AxisName::ThetaC, Angle::ZERO).await;
    assert!(matches!(refused, Err(LabError::Busy { .. })), "{refused:?}");
    assert!(lab.order(scan.id, ScanCommand::Resume).await.is_err());
    assert_eq!(
        lab.order(scan.id, ScanCommand::Pause).await.unwrap(),
        ScanState::Paused
    );
    // Somebody comes to the rig; the step is asked for once more.
    let hands = bench.rig.operate(lab, true);
    lab.order(scan.id, ScanCommand::Resume).await.unwrap();
    assert_eq!(bench.finish(scan.id).await.state, ScanState::Completed);
    hands.abort();
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_was_put_right_is_homed_and_the_scan_goes_on() {
    for (fault, code) in [
        (AxisFault::Stall, "stalled"),
        (AxisFault::LimitSensor, "limit sensor"),
        (AxisFault::EmergencyStop, "emergency stop"),
    ] {
        let bench = BenchInABox::new().await;
        bench
            .rig
            .world
            .arm(AxisName::ThetaC, Angle::from_deg(5.0), fault);
        let scan = bench.start(small(&[0.0, 10.0], &[0.0, 90.0])).await;
        bench.until(scan.id, ScanState::Paused).await;
        let reason = bench.lab.store().scan(scan.id).await.unwrap().reason;
        let reason = reason.unwrap();
        assert!(
            reason.contains(code) && reason.contains("the scan homes the axis first"),
            "{reason}"
        );
        bench.lab.order(scan.id, ScanCommand::Resume).await.unwrap();
        let goes_on = bench.until(scan.id, ScanState::Completed);
        tokio::time::timeout(Duration::from_secs(60), goes_on)
            .await
            .expect("it does not pause again");
        bench.end().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn an_aborted_scan_gives_the_rig_back() {
    let bench = BenchInABox::with(Arc::new(RealDisk), false).await;
    let scan = bench.start(small(&[0.0], &[0.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    let state = bench.lab.order(scan.id, ScanCommand::Abort).await.unwrap();
    assert_eq!(state, ScanState::Aborted);
    assert!(bench.lab.order(scan.id, ScanCommand::Resume).await.is_err());
    // The rig is free at once: a client acts on the report of the end.
    let next = bench.start(small(&[0.0], &[0.0])).await;
    bench.until(next.id, ScanState::WaitingForOperator).await;
    bench.end().await;
}

/// Orders that are given at once when something says that the rig is free.
#[tokio::test(flavor = "multi_thread")]
async fn an_order_that_is_given_as_the_rig_says_idle_is_taken() {
    let bench = BenchInABox::new().await;
    let lab = &bench.lab;
    let idle = async || {
        while lab.rig().await.unwrap().activity != RigActivity::Idle {
            tokio::task::yield_now().await;
        }
    };
    lab.home(AxisName::ThetaC).await.unwrap();
    idle().await;
    let target = |k: usize| Angle::from_deg([-20.0, 20.0][k % 2]);
    // By the rig's state.
    for k in 0..40 {
        let moved = lab.move_axis(AxisName::ThetaC, target(k)).await;
        moved.unwrap_or_else(|error| panic!("order {k}: {error}"));
        idle().await;
    }
    // By its event. A motion is reported behind its end: once all reports so far are there, none is taken for a later one.
    let activity = |event: &Event| match event {
        Event::Rig { activity, .. } => Some(*activity),
        _ => None,
    };
    loop {
        let reported = lab.store().events_after(0, 1000).await.unwrap();
        let reported: Vec<_> = reported.iter().filter_map(|e| activity(&e.event)).collect();
        let moves = reported.iter().filter(|a| **a == RigActivity::Moving);
        if moves.count() == 40 && reported.last() == Some(&RigActivity::Idle) {
            break;
        }
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    let mut events = lab.events();
    for k in 0..40 {
        let moved = lab.move_axis(AxisName::ThetaC, target(k)).await;
        moved.unwrap_or_else(|error| panic!("order {k}: {error}"));
        // The end of the previous motion may be reported only now.
        let mut begun = false;
        loop {
            match &in_time(events.recv()).await.unwrap().event {
                Event::Rig { activity, .. } if *activity == RigActivity::Moving => begun = true,
                Event::Rig { activity, .. } if begun && *activity == RigActivity::Idle => break,
                _ => {}
            }
        }
    }
    // By the answer to an order that comes to nothing.
    for k in 0..40 {
        let outside = lab.move_axis(AxisName::ThetaC, Angle::from_deg(80.0)).await;
        assert_eq!(outside.unwrap_err().code(), "outside-limits");
        let unparked = lab.unpark(AxisName::ThetaC).await;
        unparked.unwrap_or_else(|error| panic!("order {k}: {error}"));
    }
    // By the event that a scan has come to its end.
    for _ in 0..3 {
        let scan = bench.start(small(&[0.0], &[0.0])).await;
        let scan = bench.finish(scan.id).await;
        assert_eq!(scan.state, ScanState::Completed, "{:?}", scan.reason);
    }
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_daemon_that_ends_leaves_the_scan_to_be_resumed() {
    let folder = tempfile::tempdir().unwrap();
    let bench = BenchInABox::open(folder.path(), Arc::new(RealDisk), true).await;
    let plan = PlanRequest {
        reuse_calibrations: Some(false),
        ..small(&[0.0, 5.0, 10.0], &[0.0, 90.0, 180.0])
    };
    let scan = bench.start(plan).await;
    // Let it take a few points, then end the daemon.
    let few = bench.lab.wait_for_scan(
        scan.id,
        0,
        |e| matches!(&e.event, Event::Frame { progress, .. } if progress.frames_done >= 7),
    );
    few.await.unwrap();
    bench.end().await;

    let bench = BenchInABox::open(folder.path(), Arc::new(RealDisk), true).await;
    let scan = bench.lab.store().scan(scan.id).await.unwrap();
    assert_eq!(scan.state, ScanState::Interrupted);
    let spent_s = async || {
        let progress = bench.lab.store().last_progress(scan.id).await;
        progress.unwrap().elapsed_s
    };
    let before_s = spent_s().await;
    assert!(before_s > 0.0);
    let kept = bench.lab.store().shots_done(scan.id).await.unwrap().len();
    assert!(kept >= 7, "{kept} points are kept");
    bench.lab.order(scan.id, ScanCommand::Resume).await.unwrap();
    assert_eq!(bench.finish(scan.id).await.state, ScanState::Completed);
    // Its time goes on from where it was.
    let reported = bench.lab.store().events_after(0, 1000).await.unwrap();
    let elapsed = reported.iter().filter_map(|e| match &e.event {
        Event::Frame { progress, .. } | Event::Scan { progress, .. } => Some(progress.elapsed_s),
        _ => None,
    });
    assert!(elapsed.is_sorted());
    assert!(spent_s().await > before_s);
    // One dark, three white-reference and nine sample points: each once.
    assert_eq!(
        bench.lab.store().shots_done(scan.id).await.unwrap().len(),
        13
    );
    let all = PageRequest {
        limit: 1000,
        cursor: None,
    };
    let frames = bench.lab.store().frames_of_scan(scan.id, None, all).await;
    assert_eq!(frames.unwrap().items.len(), 13);
    bench.end().await;
}

/// A disk that writes a file when it is let in.
#[derive(Default)]
struct PatientDisk {
    let_in: Mutex<usize>,
    more: Condvar,
}

impl PatientDisk {
    fn let_in(&self, files: usize) {
        *self.let_in.lock().unwrap() += files;
        self.more.notify_all();
    }
}

impl Disk for PatientDisk {
    fn write_durably(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        // A test that has failed is not waited for.
        let patience = Duration::from_secs(300);
        let none = |let_in: &mut usize| *let_in == 0;
        let guard = self.let_in.lock().unwrap();
        let (mut let_in, late) = self.more.wait_timeout_while(guard, patience, none).unwrap();
        if late.timed_out() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        *let_in -= 1;
        drop(let_in);
        RealDisk.write_durably(path, bytes)
    }

    fn free_bytes(&self, folder: &Path) -> io::Result<u64> {
        RealDisk.free_bytes(folder)
    }
}

/// A disk with room for a number of files.
struct SmallDisk {
    files_left: AtomicI64,
}

impl Disk for SmallDisk {
    fn write_durably(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        if self.files_left.fetch_sub(1, Ordering::Relaxed) <= 0 {
            return Err(io::ErrorKind::StorageFull.into());
        }
        RealDisk.write_durably(path, bytes)
    }

    fn free_bytes(&self, _: &Path) -> io::Result<u64> {
        Ok(10_000_000_000)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_pauses_the_scan_and_loses_nothing() {
    let disk = Arc::new(SmallDisk {
        files_left: AtomicI64::new(4),
    });
    let bench = BenchInABox::with(Arc::clone(&disk) as Arc<dyn Disk>, true).await;
    let scan = bench.start(small(&[0.0, 10.0], &[0.0, 90.0])).await;
    bench.until(scan.id, ScanState::Paused).await;
    let paused = bench.lab.store().scan(scan.id).await.unwrap();
    let reason = paused.reason.unwrap();
    assert!(reason.contains("disk is full"), "{reason}");
    assert_eq!(
        bench.lab.store().shots_done(scan.id).await.unwrap().len(),
        4
    );
    let story = bench.lab.store().events_after(0, 1000).await.unwrap();
    assert!(
        story
            .iter()
            .any(|e| matches!(&e.event, Event::Alarm { code, .. } if code == "disk-full"))
    );
    // With room again, it continues with the lost point.
    disk.files_left.store(1000, Ordering::Relaxed);
    bench.lab.order(scan.id, ScanCommand::Resume).await.unwrap();
    assert_eq!(bench.finish(scan.id).await.state, ScanState::Completed);
    assert_eq!(
        bench.lab.store().shots_done(scan.id).await.unwrap().len(),
        7
    );
    bench.end().await;
}

/// A disk that says how little room it has.
struct FullDisk;

impl Disk for FullDisk {
    fn write_durably(&self, _: &Path, _: &[u8]) -> io::Result<()> {
        Err(io::ErrorKind::StorageFull.into())
    }

    fn free_bytes(&self, _: &Path) -> io::Result<u64> {
        Ok(1_000_000)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_that_will_not_fit_is_refused_before_anything_moves() {
    let bench = BenchInABox::with(Arc::new(FullDisk), true).await;
    let request = ScanRequest::of(2, PlanRequest::preset(Preset::Full));
    let refused = bench.lab.start_scan(&request).await;
    assert!(
        matches!(refused, Err(LabError::NoRoom { .. })),
        "{refused:?}"
    );
    let scans = bench
        .lab
        .store()
        .scans(Default::default(), PageRequest::default());
    assert!(scans.await.unwrap().items.is_empty());
    bench.end().await;
}

/// Every file below a folder.
fn files_below(folder: &Path) -> Vec<std::path::PathBuf> {
    let mut files = Vec::new();
    for file in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        match file.path() {
            path if path.is_dir() => files.extend(files_below(&path)),
            path => files.push(path),
        }
    }
    files
}

#[tokio::test(flavor = "multi_thread")]
async fn an_import_leaves_the_reserve_alone_and_nothing_behind_where_it_fails() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/polymer-10");
    let folder = tempfile::tempdir().unwrap();
    let disk = Arc::new(SmallDisk {
        files_left: AtomicI64::new(10_000),
    });
    let bench = BenchInABox::open(folder.path(), Arc::clone(&disk) as Arc<dyn Disk>, false).await;
    let lab = &bench.lab;
    let import = async |options: ImportOptions, stop_at: usize| {
        let cancel = Arc::clone(&options.cancel);
        let progress = move |done: usize, _: usize| {
            if done == stop_at {
                cancel.store(true, Ordering::Relaxed);
            }
        };
        lab.import(&source, &options, &progress).await
    };
    let frames = folder.path().join("frames");
    // The disk says 10 GB.
    lab.keep_free(9_999_900_000);
    let refused = import(Default::default(), 0).await.unwrap_err();
    assert!(matches!(refused, LabError::NoRoomFor { .. }), "{refused}");
    lab.keep_free(1_000_000);
    // The disk is full in the middle, and somebody breaks it off.
    disk.files_left.store(7, Ordering::Relaxed);
    let full = import(Default::default(), 0).await.unwrap_err();
    assert!(full.to_string().contains("disk is full"), "{full}");
    assert_eq!(files_below(&frames), Vec::<std::path::PathBuf>::new());
    disk.files_left.store(10_000, Ordering::Relaxed);
    let broken = import(Default::default(), 5).await.unwrap_err();
    assert!(matches!(broken, LabError::BrokenOff), "{broken}");
    assert_eq!(files_below(&frames), Vec::<std::path::PathBuf>::new());
    // A file that a row names stays, even if a later write of the same content fails.
    import(Default::default(), 0).await.unwrap();
    let all = files_below(&frames).len();
    assert!(all > 200, "{all}");
    import(Default::default(), 5).await.unwrap_err();
    assert_eq!(files_below(&frames).len(), all);
    // An export that is broken off leaves no folder that the next one would refuse.
    let out = tempfile::tempdir().unwrap();
    for folder in [out.path().join("new"), out.path().join("there")] {
        if folder.ends_with("there") {
            std::fs::create_dir(&folder).unwrap();
        }
        let raised = Arc::new(std::sync::atomic::AtomicBool::new(true));
        let broken = export(lab.store(), 1, &folder, raised).await.unwrap_err();
        assert!(matches!(broken, LabError::BrokenOff), "{broken}");
        assert_eq!(files_below(out.path()), Vec::<std::path::PathBuf>::new());
        export(lab.store(), 1, &folder, Default::default())
            .await
            .unwrap();
        assert_eq!(files_below(out.path()).len(), 2 + 210);
        std::fs::remove_dir_all(&folder).unwrap();
    }
    assert_eq!(std::fs::read_dir(out.path()).unwrap().count(), 0);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recorded_series_comes_out_as_it_went_in() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/polymer-10");
    let folder = tempfile::tempdir().unwrap();
    let bench = BenchInABox::new().await;
    let imported = bench
        .lab
        .import(&source, &Default::default(), &|_, _| {})
        .await
        .unwrap();
    let out = folder.path().join("out");
    export(
        bench.lab.store(),
        imported.scan_id,
        &out,
        Default::default(),
    )
    .await
    .unwrap();
    let mut files = vec!["manifest.toml".to_owned(), "frames.csv".to_owned()];
    let series = StoredSeries::open(bench.lab.store(), imported.scan_id)
        .await
        .unwrap();
    files.extend(series.rows().iter().map(|row| row.file.clone()));
    assert_eq!(files.len(), 2 + 210);
    for file in files {
        let (went_in, came_out) = (source.join(&file), out.join(&file));
        assert!(
            std::fs::read(went_in).unwrap() == std::fs::read(came_out).unwrap(),
            "{file} differs"
        );
    }
    // One damaged frame keeps the others from coming out no longer, where somebody says so.
    let damaged = files_below(&bench.lab.store().folder().join("frames")).remove(0);
    std::fs::write(&damaged, b"no frame").unwrap();
    let store = bench.lab.store();
    let rest = folder.path().join("rest");
    let refused = export(store, imported.scan_id, &rest, Default::default()).await;
    let refused = refused.unwrap_err().to_string();
    assert!(refused.contains("hash differs"), "{refused}");
    let written = export_readable(store, imported.scan_id, &rest, Default::default()).await;
    let written = written.unwrap();
    assert_eq!((written.n_frames, written.skipped.len()), (209, 1));
    let rest = ridged::series::Series::open(&rest).unwrap();
    assert_eq!(rest.rows().len(), 209);
    let left_out = series.rows().iter().find(|row| !rest.rows().contains(row));
    assert!(written.skipped[0].starts_with(&left_out.unwrap().file));
    std::fs::copy(out.join(&left_out.unwrap().file), &damaged).unwrap();
    // And it is reduced to the same observations as from its folder.
    let direct = ridged::series::Series::open(&source).unwrap();
    let options = analysis::AnalysisOptions::default();
    let cancel = std::sync::atomic::AtomicBool::new(false);
    let region = options.region.as_deref();
    let one = ridged::reduction::reduce(&direct, region, &cancel).unwrap();
    let reduce = || ridged::reduction::reduce(&series, region, &cancel);
    let two = tokio::task::block_in_place(reduce).unwrap();
    assert_eq!(one.observations, two.observations);
    bench.end().await;
}
