//! The same data folder with another rig, other settings or the same series again: what is kept and what is reported.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use ridged::frame::FrameKind;
use ridged::lab::{LabError, RigParts, ScanRequest, StoredSeries};
use ridged::reduction::{FrameSource, reduce};
use ridged::scan::event::RigActivity;
use ridged::scan::plan::FlatRequest;
use ridged::scan::runner::ScanCommand;
use ridged::scan::{OperatorAction, PlanRequest, Rig, ScanState, StageLink};
use ridged::store::disk::RealDisk;

use crate::bench_in_a_box::{BenchInABox, small};

const HOUR: Duration = Duration::from_secs(3600);

async fn opened(folder: &Path, later: Duration, change: impl FnOnce(&mut RigParts)) -> BenchInABox {
    let changed = |mut parts| {
        change(&mut parts);
        parts
    };
    BenchInABox::open_as(folder, Arc::new(RealDisk), true, later, changed).await
}

/// Calibrations that a plan would use, and what people would have to do.
async fn estimated(bench: &BenchInABox, plan: PlanRequest) -> (Vec<i64>, Vec<OperatorAction>) {
    let request = ScanRequest::of(2, plan);
    let estimated = bench.lab.estimate(&request).await.unwrap();
    (estimated.calibration_ids, estimated.operator_steps)
}

/// Scans, and says which exposures the frames of a kind have that a reduction reads.
async fn scanned(bench: &BenchInABox, plan: PlanRequest) -> StoredSeries {
    let scan = bench.start(plan).await;
    let scan = bench.finish(scan.id).await;
    assert_eq!(scan.state, ScanState::Completed, "{:?}", scan.reason);
    StoredSeries::open(bench.lab.store(), scan.id)
        .await
        .unwrap()
}

fn exposures_s(series: &StoredSeries, kind: FrameKind) -> Vec<f64> {
    let rows = series.rows().iter().filter(|row| row.kind == kind);
    let mut all: Vec<f64> = rows.map(|row| row.exposure_s).collect();
    all.sort_by(f64::total_cmp);
    all
}

#[tokio::test(flavor = "multi_thread")]
async fn frames_of_another_white_reference_are_not_reused_and_its_dark_frames_are() {
    let folder = tempfile::tempdir().unwrap();
    let plan = || small(&[0.0, 10.0], &[0.0, 30.0]);
    let bench = opened(folder.path(), Duration::ZERO, |_| {}).await;
    let first = scanned(&bench, plan()).await;
    let (both, steps) = estimated(&bench, plan()).await;
    assert_eq!((both.len(), steps), (2, vec![OperatorAction::PlaceSample]));
    bench.end().await;

    // Another plate lies there since: what the camera sees without light is the same.
    let other = |parts: &mut RigParts| parts.settings.flat.reflectance = Some(0.5);
    let bench = opened(folder.path(), HOUR, other).await;
    let (dark, steps) = estimated(&bench, plan()).await;
    assert_eq!(dark, both[..1]);
    let place = [
        OperatorAction::PlaceWhiteReference,
        OperatorAction::PlaceSample,
    ];
    assert_eq!(steps, place);
    let second = scanned(&bench, plan()).await;
    assert_eq!(
        second.manifest().flat.as_ref().unwrap().reflectance,
        Some(0.5)
    );
    for kind in [FrameKind::Dark, FrameKind::Flat] {
        assert_eq!(
            exposures_s(&second, kind),
            exposures_s(&first, kind),
            "{kind:?}"
        );
    }
    let file = |series: &StoredSeries| {
        let rows = series.rows().iter();
        let mut flats: Vec<_> = rows
            .filter(|r| r.kind == FrameKind::Flat)
            .cloned()
            .collect();
        flats.sort_by(|a, b| a.file.cmp(&b.file));
        flats
    };
    assert_ne!(file(&second), file(&first));
    let (own, steps) = estimated(&bench, plan()).await;
    assert_eq!((own.len(), steps), (2, vec![OperatorAction::PlaceSample]));
    assert_ne!(own, both);
    bench.end().await;

    // The first plate is back: its frames count again, though newer ones of the other are there.
    let bench = opened(folder.path(), 2 * HOUR, |_| {}).await;
    assert_eq!(estimated(&bench, plan()).await.0, both);
    // Another uncertainty on its certificate is another certificate.
    bench.end().await;
    let other = |parts: &mut RigParts| parts.settings.flat.reflectance_std = Some(0.1);
    let bench = opened(folder.path(), 2 * HOUR, other).await;
    assert_eq!(estimated(&bench, plan()).await.0, both[..1]);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn reused_flats_bring_the_dark_frames_of_their_exposures() {
    let plan = |exposure_s: f64| PlanRequest {
        exposures_s: Some(vec![exposure_s]),
        flat: FlatRequest {
            exposures_s: Some(vec![0.06]),
            ..FlatRequest::default()
        },
        ..small(&[0.0, 10.0], &[0.0, 30.0])
    };
    let folder = tempfile::tempdir().unwrap();
    let bench = opened(folder.path(), Duration::ZERO, |_| {}).await;
    let first = scanned(&bench, plan(0.02)).await;
    assert_eq!(exposures_s(&first, FrameKind::Dark), [0.02, 0.06]);
    let (both, _) = estimated(&bench, plan(0.02)).await;

    // Its own dark frames are those of the sample; the white reference's were taken with it.
    let (ids, steps) = estimated(&bench, plan(0.1)).await;
    assert_eq!(ids, both);
    assert_eq!(
        steps,
        [OperatorAction::CapLens, OperatorAction::PlaceSample]
    );
    let second = scanned(&bench, plan(0.1)).await;
    assert_eq!(exposures_s(&second, FrameKind::Dark), [0.02, 0.06, 0.1]);
    assert_eq!(exposures_s(&second, FrameKind::Flat), [0.06; 2]);
    let reduce = || reduce(&second, None, &AtomicBool::new(false));
    let reduced = tokio::task::block_in_place(reduce).unwrap();
    assert_eq!(reduced.observations.len(), 4);
    let about_dark = |w: &&String| w.contains("dark");
    assert_eq!(reduced.warnings.iter().find(about_dark), None);
    bench.end().await;

    // The dark frames are too old: the white reference is taken again, with its own dark frames.
    let old = |parts: &mut RigParts| parts.settings.dark_valid = HOUR / 2;
    let bench = opened(folder.path(), HOUR, old).await;
    let (ids, steps) = estimated(&bench, plan(0.1)).await;
    assert_eq!((ids, steps.len()), (vec![], 3));
    // Where the sample's own dark frames are those of the flats, the flats count on.
    let (ids, steps) = estimated(&bench, plan(0.06)).await;
    assert_eq!(ids, both[1..]);
    assert_eq!(
        steps,
        [OperatorAction::CapLens, OperatorAction::PlaceSample]
    );
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_of_other_settings_is_not_resumed_and_they_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let disk = Arc::new(RealDisk);
    let bench = BenchInABox::open(folder.path(), disk, false).await;
    let scan = bench.start(small(&[0.0], &[0.0])).await;
    bench.until(scan.id, ScanState::WaitingForOperator).await;
    bench.end().await;
    let gain = |parts: &mut RigParts| parts.settings.camera.gain_dn_per_electron = 0.25;
    let bench = opened(folder.path(), HOUR, gain).await;
    let refused = bench
        .lab
        .order(scan.id, ScanCommand::Resume)
        .await
        .unwrap_err();
    assert!(
        matches!(refused, LabError::NotOfThisRig { .. }),
        "{refused}"
    );
    let words = refused.to_string();
    for part in [
        "scan 1 cannot be resumed",
        "camera.gain_dn_per_electron was 2.0 and is 0.25",
        "restore them",
    ] {
        assert!(words.contains(part), "{part} is not in: {words}");
    }
    assert_eq!(
        words.matches("; ").count(),
        1,
        "only that one is another: {words}"
    );
    bench.end().await;
    // With the settings as they were it goes on.
    let bench = opened(folder.path(), HOUR, |_| {}).await;
    bench.lab.order(scan.id, ScanCommand::Resume).await.unwrap();
    assert_eq!(bench.finish(scan.id).await.state, ScanState::Completed);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_rig_without_a_link_is_not_said_to_be_idle() {
    let folder = tempfile::tempdir().unwrap();
    let disk = Arc::new(RealDisk);
    let unplugged = |parts: RigParts| {
        let RigParts { rig, settings } = parts;
        let port = "/dev/serial/by-id/nothing".parse().unwrap();
        let link = StageLink {
            port,
            ..rig.link().clone()
        };
        RigParts {
            rig: Rig::new(link, rig.camera),
            settings,
        }
    };
    let bench = BenchInABox::open_as(folder.path(), disk, false, Duration::ZERO, unplugged).await;
    let rig = bench.lab.rig().await.unwrap();
    assert_eq!(
        (rig.connected, rig.activity),
        (false, RigActivity::NotConnected)
    );
    bench.end().await;
    let bench = BenchInABox::new().await;
    assert_eq!(bench.lab.rig().await.unwrap().activity, RigActivity::Idle);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_series_of_the_same_frames_and_other_facts_is_kept_and_what_differs_is_reported() {
    let recorded = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series/checker");
    let copy = tempfile::tempdir().unwrap();
    std::fs::create_dir(copy.path().join("frames")).unwrap();
    for file in std::fs::read_dir(recorded.join("frames")).unwrap() {
        let file = file.unwrap();
        std::fs::copy(
            file.path(),
            copy.path().join("frames").join(file.file_name()),
        )
        .unwrap();
    }
    let manifest = std::fs::read_to_string(recorded.join("manifest.toml")).unwrap();
    let list = std::fs::read_to_string(recorded.join("frames.csv")).unwrap();
    let bench = BenchInABox::new().await;
    let import = async |manifest: &str, list: &str| {
        std::fs::write(copy.path().join("manifest.toml"), manifest).unwrap();
        std::fs::write(copy.path().join("frames.csv"), list).unwrap();
        let imported = bench
            .lab
            .import(copy.path(), &Default::default(), &|_, _| {})
            .await;
        imported.unwrap()
    };
    let first = import(&manifest, &list).await;
    assert_eq!((first.same_as, first.like), (None, None));
    // A comment is no fact.
    let again = import(&format!("# of May\n{manifest}"), &list).await;
    assert_eq!((again.same_as, again.like), (Some(first.scan_id), None));
    // The angle of the lamp was put right.
    let other = manifest.replacen("theta_l_deg = 10.0", "theta_l_deg = 12.5", 1);
    let third = import(&other, &list).await;
    let like = third.like.unwrap();
    assert_eq!((third.same_as, like.scan_id), (None, again.scan_id));
    assert_eq!(like.differences, ["rig.theta_l_deg was 10.0 and is 12.5"]);
    // So was the exposure of one frame.
    let line = list.lines().find(|line| line.contains(",sample,")).unwrap();
    let mut fields: Vec<&str> = line.split(',').collect();
    fields[4] = "0.5";
    let fourth = import(&manifest, &list.replacen(line, &fields.join(","), 1)).await;
    let like = fourth.like.unwrap();
    assert_eq!(like.differences.len(), 1, "{:?}", like.differences);
    let words = &like.differences[0];
    assert!(
        words.starts_with("exposure_s of 1 frame, first ") && words.ends_with(" and is 0.5"),
        "{words}"
    );
    bench.end().await;
}
