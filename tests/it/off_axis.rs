//! Near rigs whose rotation axis is beside the centre of tilt, with inclined samples: a path-traced series, and the
//! simulated rig with the same errors.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use serde_json::Value;

use ridged::clock::{Clock, SteppedClock};
use ridged::fit::report::{FitReport, Parameter, ReferencePlane};
use ridged::fit::{FitOptions, VariantChoice, fit};
use ridged::lab::{FitRequest, Lab, ScanRequest};
use ridged::reduction::reduce;
use ridged::series::Series;
use ridged::sim::rig::{Construction, SimulatedRig, Simulation};
use ridged::store::disk::RealDisk;
use ridged::units::Angle;

use crate::bench_in_a_box::{in_time, small};

fn sawtooth() -> FitOptions {
    FitOptions {
        variant: VariantChoice::Sawtooth,
        ..FitOptions::default()
    }
}

/// Asserts that a parameter's true value is within two standard uncertainties, and that these are below `twice_most`.
fn holds(name: &str, found: &Parameter, truth: f64, twice_most: f64) {
    let (value, twice) = (found.value.unwrap(), 2.0 * found.std.unwrap());
    assert!(
        (value - truth).abs() < twice && twice < twice_most,
        "{name}: {value} ± {twice} for {truth}"
    );
}

#[test]
fn with_an_axis_beside_the_centre_of_tilt_and_a_wobble_the_angles_to_the_turntable_are_right() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series2/near-off-axis");
    let series = Series::open(&folder).unwrap();
    let mut set = reduce(&series, None, &AtomicBool::new(false)).unwrap();
    assert_eq!(set.observations.len(), 12, "{:?}", set.rejected_frames);
    // As if the direction of the sample's edge had been measured.
    set.azimuth_zero_std = Some(Angle::from_deg(0.1));
    let report = fit(&set, &sawtooth(), &AtomicBool::new(false));
    let p = &report.parameters;
    // The ridge angle to the sample's plane is 9.0°; the wobble is 0.2° towards 200° from v.
    holds("theta_r_deg", &p.theta_r_deg, 8.812, 0.1);
    holds("tilt_offset_deg", &p.tilt_offset_deg, 0.0, 0.1);
    holds("azimuth_offset_deg", &p.azimuth_offset_deg, -0.441, 0.4);
    holds("alpha_u", &p.alpha_u, 0.12, 0.004);
    holds("alpha_v", &p.alpha_v, 0.12, 0.004);
    holds("rho_d", &p.rho_d, 0.33725, 0.01);
    assert!(report.rms_residual.unwrap() < 5e-4, "{report:?}");
    assert_eq!(report.reference_plane, ReferencePlane::Turntable);
    // The wobble has a component of 0.2° · sin 200° across v, which the azimuth determines if its zero is known.
    let across = report.wedge_across.unwrap();
    let std = across.wedge_std_deg.unwrap();
    let off = (across.wedge_deg + 0.0684).abs();
    assert!(off < 2.0 * std && std < 0.05, "{across:?}");
}

#[tokio::test]
async fn a_simulated_rig_with_the_same_errors_is_measured_right() {
    let construction = Construction {
        camera_distance_mm: Some(300.0),
        light_distance_mm: Some(250.0),
        axis_offset_px: Some([-8.0, 6.0]),
        tilt_centre_offset_px: Some([5.0, -4.0]),
        wedge_deg: Some(0.3),
        wedge_azimuth_deg: Some(160.0),
    };
    let simulation = Simulation {
        azimuth_offset: Angle::from_deg(3.0),
        tilt_offset: Angle::from_deg(-0.2),
        construction,
        ..Simulation::default()
    };
    let clock: Arc<dyn Clock> = Arc::new(SteppedClock::new());
    let folder = tempfile::tempdir().unwrap();
    let (rig, parts) = SimulatedRig::with_clock(simulation, clock).unwrap();
    let (lab, _) = Lab::open(
        folder.path(),
        Arc::new(RealDisk),
        Arc::clone(&rig.clock),
        Some(parts),
    )
    .await
    .unwrap();
    rig.add_samples(&lab).await.unwrap();
    let hands = rig.operate(&lab, true);
    // The second sample is the traced polymer.
    let plan = small(&[-10.0, 0.0, 10.0], &[0.0, 90.0, 180.0, 270.0]);
    let request = ScanRequest::of(2, plan);
    let scan = lab.start_scan(&request).await.unwrap();
    in_time(lab.wait_for_scan(scan.id, 0, |_| false))
        .await
        .unwrap();
    let request = FitRequest {
        scan_id: scan.id,
        variant: VariantChoice::Sawtooth,
        ..FitRequest::default()
    };
    let id = lab.start_job(request).await.unwrap();
    let mut events = lab.events();
    let waiting = async {
        loop {
            let fit = lab.store().job(id).await.unwrap();
            if let Some(report) = fit.result {
                break report;
            }
            assert!(fit.error_detail.is_none(), "{:?}", fit.error_detail);
            events.recv().await.ok();
        }
    };
    let report = in_time(waiting).await;
    lab.shut_down().await;
    hands.abort();
    let reported: Value = serde_json::from_str(&report).unwrap();
    assert_eq!(reported["reference_plane"], "turntable");
    let report: FitReport = serde_json::from_str(&report).unwrap();
    let (steeper, turned) = construction.wedge_on(Angle::from_deg(10.0));
    let p = &report.parameters;
    holds("theta_r_deg", &p.theta_r_deg, 10.0 + steeper.deg(), 0.3);
    holds("tilt_offset_deg", &p.tilt_offset_deg, -0.2, 0.2);
    holds(
        "azimuth_offset_deg",
        &p.azimuth_offset_deg,
        3.0 + turned.deg(),
        0.6,
    );
    holds("alpha_v", &p.alpha_v, 0.12, 0.01);
    assert!(
        report.rms_residual.unwrap() < 3e-3,
        "{:?}",
        report.rms_residual
    );
}
