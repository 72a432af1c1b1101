//! What follows a scan without a request, and what is corrected afterwards.

use std::sync::Arc;
use std::time::Duration;

use ridged::job::JobKind;
use ridged::lab::{FitRequest, Lab, LabError};
use ridged::material::Material;
use ridged::scan::{PlanRequest, ScanState};
use ridged::store::PageRequest;
use ridged::store::disk::RealDisk;
use ridged::store::jobs::{Job, JobFilter};
use ridged::store::samples::NewSample;

use crate::bench_in_a_box::{BenchInABox, in_time, small};

/// A bench whose settings are the default: completed scans are fitted.
async fn bench(folder: &tempfile::TempDir) -> BenchInABox {
    let disk = Arc::new(RealDisk);
    let with_fits = |mut parts: ridged::lab::RigParts| {
        parts.settings.fit_at_end = true;
        parts
    };
    BenchInABox::open_as(folder.path(), disk, true, Duration::ZERO, with_fits).await
}

/// Poses of which a fit reports at once that they are too few.
fn few_poses() -> PlanRequest {
    small(&[0.0], &[0.0, 90.0, 180.0])
}

async fn fits(lab: &Lab) -> Vec<Job> {
    let (all, page) = (JobFilter::default(), PageRequest::default());
    let found = lab.store().jobs(JobKind::Fit, &all, page).await;
    found.unwrap().items
}

/// Waits for a number of fits in the store, and for their ends.
async fn until_fits(lab: &Lab, n: usize) -> Vec<Job> {
    let mut events = lab.events();
    let waiting = async {
        loop {
            let all = fits(lab).await;
            if all.len() >= n && all.iter().all(|fit| fit.ended_at.is_some()) {
                return all;
            }
            events.recv().await.unwrap();
        }
    };
    in_time(waiting).await
}

#[tokio::test(flavor = "multi_thread")]
async fn a_completed_scan_is_fitted_once_without_a_request() {
    let folder = tempfile::tempdir().unwrap();
    let bench = bench(&folder).await;
    // A scan for calibrations has no sample to fit.
    let only = PlanRequest {
        repeats: Some(0),
        ..few_poses()
    };
    let calibration = bench.start(only).await;
    bench.finish(calibration.id).await;
    let scan = bench.start(few_poses()).await;
    assert_eq!(bench.finish(scan.id).await.state, ScanState::Completed);
    let all = until_fits(&bench.lab, 1).await;
    assert_eq!(all.len(), 1);
    assert_eq!(all[0].scan_id, Some(scan.id));
    assert!(all[0].result.is_some(), "{:?}", all[0].error_detail);
    // A request adds a row of its own.
    let request = FitRequest {
        scan_id: scan.id,
        ..FitRequest::default()
    };
    bench.lab.start_job(request).await.unwrap();
    assert_eq!(until_fits(&bench.lab, 2).await.len(), 2);
    bench.end().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_of_the_wrong_sample_gets_the_material_of_the_right_one() {
    let folder = tempfile::tempdir().unwrap();
    let bench = bench(&folder).await;
    let lab = &bench.lab;
    let steel = Material::Conductor {
        eta: 2.9,
        k: 3.1,
        eta_std: 0.1,
        k_std: 0.1,
    };
    let new = NewSample {
        name: "steel".into(),
        material: steel,
        note: None,
        simulated: None,
    };
    let right = lab.add_sample(&new).await.unwrap();
    let scan = bench.start(few_poses()).await;
    // While the scan holds the rig, its sample is what lies there.
    let early = lab.assign_scan(scan.id, right.id).await;
    assert!(matches!(early, Err(LabError::NotNow { .. })), "{early:?}");
    bench.finish(scan.id).await;
    until_fits(lab, 1).await;
    let before = lab.observations(scan.id, None).await.unwrap().set.material;
    assert_ne!(before, steel);

    let assigned = lab.assign_scan(scan.id, right.id).await.unwrap();
    assert_eq!(assigned.sample_name, "steel");
    assert_eq!(assigned.earlier_samples[0].sample_id, scan.sample_id);
    let after = lab.observations(scan.id, None).await.unwrap().set.material;
    assert_eq!(after, steel);
    // The fit of the other material is no answer any more.
    let all = until_fits(lab, 2).await;
    assert_eq!(all[0].sample_id, Some(right.id));
    bench.end().await;
}
