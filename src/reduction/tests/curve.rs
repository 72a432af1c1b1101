//! Cameras that are not linear, and clocks that are not right.

use super::super::calibrate;
use super::super::synthetic::Made;
use super::*;
use crate::fit;
use crate::series::FrameRow;

const TILTS: [f64; 4] = [-20.0, -5.0, 5.0, 20.0];
const AZIMUTHS: [f64; 5] = [0.0, 70.0, 140.0, 220.0, 290.0];

fn lobe(tilt: f64, azimuth: f64) -> f64 {
    0.03 + 0.35 * (-(tilt / 15.0).powi(2) + azimuth.to_radians().cos() - 1.0).exp()
}

/// Greatest relative deviation of the signals from the truth.
fn worst(set: &ObservationSet) -> f64 {
    let off = |o: &Observation| o.signal / lobe(o.pose.theta_c.deg(), o.pose.phi_s.deg()) - 1.0;
    set.observations
        .iter()
        .map(|o| off(o).abs())
        .fold(0.0, f64::max)
}

fn small() -> Made {
    Made {
        edge: 64,
        flicker: 3e-4,
        ..Made::default()
    }
}

#[test]
fn counts_of_a_bent_camera_become_those_of_a_straight_one_and_no_pose_is_lost() {
    let sixteen = small();
    let twelve = Made {
        saturation_dn: 4095,
        gain_dn: 0.4,
        read_electrons: 3.0,
        black_dn: 64.0,
        electrons_per_radiance_second: 3e5,
        ..small()
    };
    for (made, bend, exposures) in [
        (&sixteen, 0.06, &[0.02, 0.08][..]),
        (&sixteen, -0.05, &[0.02, 0.08]),
        (&sixteen, 0.1, &[0.01, 0.03, 0.08]),
        (&twelve, 0.02, &[0.02, 0.08]),
    ] {
        let made = Made {
            bend,
            ..made.clone()
        };
        let series = made.series(&TILTS, &AZIMUTHS, exposures, lobe);
        let set = reduced(&series, None);
        let reported = set.detector.expect("a curve");
        assert!((reported.c - bend).abs() < 0.002, "{bend}: {reported:?}");
        assert_eq!(set.observations.len(), 20, "{bend}: {:?}", set.warnings);
        assert!(worst(&set) < 2.5e-3, "{bend}: {}", worst(&set));
        let about: Vec<&String> = set
            .warnings
            .iter()
            .filter(|w| w.contains("linear"))
            .collect();
        assert_eq!(about.len(), 1, "{:?}", set.warnings);
        assert!(!set.warnings.iter().any(|w| w.contains("contradict")));
        assert!(set.observations.iter().any(|o| o.shared.detector != 0.0));
        // The map's door gives the same counts.
        let calibration = calibrate(&series, &AtomicBool::new(false)).unwrap();
        let long = exposures[exposures.len() - 1];
        let dn = series.manifest.camera.saturation_dn.unwrap() as u16 / 2;
        let bent = calibration.dark(long).linear_dn(0, dn) / f64::from(dn) - 1.0;
        assert!((bent / (0.5 * bend) - 1.0).abs() < 0.15, "{bend}: {bent}");
    }
}

#[test]
fn a_straight_camera_is_never_reported_as_bent_whatever_its_shutter_does() {
    for (shutter, stated) in [
        (0.0, None),
        (0.005, None),
        (0.005, Some(0.005)),
        (0.03, None),
    ] {
        let made = Made { shutter, ..small() };
        let mut series = made.series(&TILTS, &AZIMUTHS, &[0.02, 0.08], lobe);
        series.manifest.camera.exposure_rel_std = stated;
        let set = reduced(&series, None);
        assert_eq!(set.detector, None, "{shutter}");
        assert_eq!(set.observations.len(), 20);
        // The exposures agree among themselves; the data do not determine which of them the scale rests on.
        assert!(
            worst(&set) < 1.5e-3 + 0.6 * shutter,
            "{shutter}: {}",
            worst(&set)
        );
        assert_eq!(
            set.warnings.iter().any(|w| w.contains("shutter")),
            shutter > 0.0
        );
    }
}

#[test]
fn a_curve_is_reported_from_a_series_with_bad_frames() {
    let made = Made {
        bend: 0.06,
        ..small()
    };
    let mut series = made.series(&TILTS, &AZIMUTHS, &[0.02, 0.08], lobe);
    let black = |pixels: &mut Vec<u16>| pixels.fill(200);
    series.edit("sample_-20_70_0.08", black);
    series.edit("sample_5_140_0.02", |pixels| {
        for dn in pixels {
            *dn = 200 + ((f64::from(*dn) - 200.0) * 0.8).max(0.0) as u16;
        }
    });
    let broken = series.index_of("sample_5_220_0.08");
    series.frames[broken] = None;
    let copied = series.frames[series.index_of("sample_20_0_0.02")].clone();
    let copy = series.index_of("sample_20_290_0.08");
    series.frames[copy] = copied;
    let set = reduced(&series, None);
    let reported = set.detector.expect("a curve");
    assert!((reported.c - 0.06).abs() < 0.002, "{reported:?}");
    assert!(
        worst(&set) < 2.5e-3,
        "{} {:?}",
        worst(&set),
        set.rejected_frames
    );
}

#[test]
fn poses_whose_exposures_nothing_reconciles_are_reported_in_one_sentence() {
    let made = small();
    let mut series = made.series(&TILTS, &AZIMUTHS, &[0.02, 0.08], lobe);
    // Every long frame by another factor: no curve and no shutter does that.
    let mut factor = 0.55;
    let long = |row: &&FrameRow| row.kind == FrameKind::Sample && row.exposure_s == 0.08;
    let files: Vec<String> = series
        .rows
        .iter()
        .filter(long)
        .map(|r| r.file.clone())
        .collect();
    for file in files {
        factor = 0.5 + (factor * 7.3) % 0.4;
        series.edit(&file, |pixels| {
            for dn in pixels {
                *dn = 200 + ((f64::from(*dn) - 200.0) * factor).max(0.0) as u16;
            }
        });
    }
    let outcome = reduce(&series, None, &AtomicBool::new(false));
    let warnings = outcome.map(|set| set.warnings).unwrap_or_default();
    let about = warnings.iter().filter(|w| w.contains("contradict")).count();
    assert!(about <= 1, "{warnings:?}");
}

/// Path-traced plastic seen by a camera that is 6 % short at full scale.
#[test]
fn the_recorded_bent_camera_is_reported_and_its_signals_are_right() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series2/not-linear-9");
    let set = reduced(&Series::open(&path).unwrap(), None);
    let reported = set.detector.expect("a curve");
    assert!((reported.c - 0.06).abs() < 0.002, "{reported:?}");
    assert_eq!(set.observations.len(), 24, "{:?}", set.warnings);
    assert!(set.warnings.len() <= 3, "{:?}", set.warnings);
    let mut reader = csv::Reader::from_path(path.join("radiance.csv")).unwrap();
    let truth: Truth = (reader.records().map(Result::unwrap))
        .map(|r| {
            let f = |i: usize| r[i].parse::<f64>().unwrap();
            ((f(0) as i64, f(1) as i64), f(3))
        })
        .collect();
    let off = |o: &Observation| o.signal / truth[&key(o)] - 1.0;
    let off: Vec<f64> = set.observations.iter().map(off).collect();
    // The stages' errors of 0.01° are in it.
    assert!(rms(&off) < 1.5e-3, "{} {off:?}", rms(&off));
    let report = fit::fit(&set, &fit::FitOptions::default(), &AtomicBool::new(false));
    let p = &report.parameters;
    for (parameter, truth, most) in [(&p.theta_r_deg, 9.0, 0.3), (&p.rho_d, 0.23992, 0.01)] {
        let (value, u) = (parameter.value.unwrap(), parameter.expanded.unwrap());
        assert!(
            (value - truth).abs() <= u && u < most,
            "{value} ± {u} for {truth}"
        );
        assert!(parameter.budget.unwrap().detector > 0.0);
    }
}
