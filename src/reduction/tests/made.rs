//! Made frames whose truth is known: defects, noise, black poses, a near rig.

use super::super::synthetic::Made;
use super::*;
use crate::geometry;
use crate::series::SampleKind;

/// A lobe over a floor, as bright as 0.4.
fn lobe(tilt: f64, azimuth: f64) -> f64 {
    0.05 + 0.35 * (-(tilt / 15.0).powi(2) + azimuth.to_radians().cos() - 1.0).exp()
}

const TILTS: [f64; 5] = [-20.0, -10.0, 0.0, 10.0, 20.0];
const AZIMUTHS: [f64; 6] = [0.0, 60.0, 120.0, 180.0, 240.0, 300.0];

/// Deviation of gain · (L + s) from the signals, the gain being what the flats' stray light does to
/// the provisional unit, in standard uncertainties of the samples and the reference together.
fn made_deviations(made: &Made, set: &ObservationSet) -> Vec<f64> {
    let white = set.white_reference.unwrap();
    let (mut with, mut without) = (0.0, 0.0);
    for flat in &set.flats {
        let due = white.reflectance / std::f64::consts::PI * set.rig.cos_incidence(flat.theta_c);
        with += flat.signal * due;
        without += (due + made.stray) * due;
    }
    let gain = with / without;
    set.observations
        .iter()
        .map(|o| {
            let due = lobe(o.pose.theta_c.deg(), o.pose.phi_s.deg()) + made.stray;
            (o.signal - gain * due) / o.sigma.hypot(1e-4 * due)
        })
        .collect()
}

#[test]
fn defects_pattern_and_stray_light_leave_the_signal_right() {
    for made in [
        Made::default(),
        Made {
            stray: 0.02,
            seed: 2,
            ..Made::default()
        },
        Made {
            hot: 0.004,
            dead: 0.004,
            prnu: 0.03,
            dsnu_dn: 8.0,
            seed: 3,
            ..Made::default()
        },
        Made {
            saturation_dn: 4095,
            gain_dn: 0.4,
            read_electrons: 3.0,
            black_dn: 64.0,
            electrons_per_radiance_second: 3e5,
            hot: 0.002,
            dead: 0.002,
            vignetting: 0.15,
            seed: 4,
            ..Made::default()
        },
    ] {
        let series = made.series(&TILTS, &AZIMUTHS, &[0.02, 0.06], lobe);
        let set = reduced(&series, None);
        assert_eq!(set.observations.len(), 30);
        let z = made_deviations(&made, &set);
        let worst = z.iter().fold(0.0_f64, |a, z| a.max(z.abs()));
        assert!(worst < 5.0, "{worst}: {z:?}");
        assert!(rms(&z) < 1.6, "{}", rms(&z));
        assert!(
            set.rejected_frames
                .iter()
                .all(|r| r.reason.contains("saturated"))
        );
    }
}

#[test]
fn clipping_in_the_only_exposure_does_not_darken_the_mean() {
    // The brightest poses lie at 60,000 to 66,000 DN: noise and the centre of the field clip.
    let made = Made {
        vignetting: 0.1,
        ..Made::default()
    };
    for exposure in [0.064, 0.0655, 0.068] {
        let series = made.series(&TILTS, &AZIMUTHS, &[exposure], lobe);
        let set = reduced(&series, None);
        let z = made_deviations(&made, &set);
        let worst = z.iter().fold(0.0_f64, |a, z| a.max(z.abs()));
        assert!(worst < 5.0, "{exposure} s: {worst}");
    }
}

#[test]
fn a_wrong_noise_figure_is_noticed_in_the_repeats() {
    let made = Made {
        read_electrons: 6.0,
        ..Made::default()
    };
    let mut series = made.series(&TILTS[..3], &AZIMUTHS, &[0.02], lobe);
    series.manifest.camera.read_noise_electrons_rms = Some(2.0);
    let set = reduced(&series, None);
    assert!(
        set.warnings.iter().any(|w| w.contains("scatter")),
        "{:?}",
        set.warnings
    );
}

#[test]
fn shot_noise_of_dark_current_is_no_wrong_read_noise() {
    let made = Made {
        dark_electrons_s: 3000.0,
        ..Made::default()
    };
    let series = made.series(&TILTS[..3], &AZIMUTHS, &[0.02, 0.06], lobe);
    let set = reduced(&series, None);
    let reported = |w: &String| w.contains("scatter");
    assert!(!set.warnings.iter().any(reported), "{:?}", set.warnings);
    // The other fault is reported, with its share.
    let made = Made {
        read_electrons: 12.0,
        ..made
    };
    let mut series = made.series(&TILTS[..3], &AZIMUTHS, &[0.02, 0.06], lobe);
    series.manifest.camera.read_noise_electrons_rms = Some(2.0);
    let set = reduced(&series, None);
    let warning = set
        .warnings
        .iter()
        .find(|w| reported(w))
        .expect("a warning");
    assert!(
        warning.contains("of 0.02 s") && warning.contains("grows with the exposure"),
        "{warning}"
    );
}

#[test]
fn a_pose_without_light_amid_bright_ones_is_black_and_a_dark_sample_is_not() {
    let made = Made::default();
    let off = |tilt: f64, azimuth: f64| {
        if (tilt, azimuth) == (0.0, 120.0) {
            0.0
        } else {
            lobe(tilt, azimuth)
        }
    };
    let set = reduced(&made.series(&TILTS, &AZIMUTHS, &[0.02], off), None);
    assert_eq!(set.observations.len(), 29);
    assert_eq!(set.rejected_frames.len(), 1);
    assert_eq!(set.rejected_frames[0].reason, "black");
    assert!(set.warnings.iter().any(|w| w.contains("no observation")));
    // A metal sends light where its facets mirror it, and nowhere else.
    let mut metal = made.series(&TILTS, &AZIMUTHS, &[0.02], off);
    metal.manifest.sample.kind = SampleKind::Conductor;
    (metal.manifest.sample.eta, metal.manifest.sample.k) = (Some(2.9), Some(3.1));
    let set = reduced(&metal, None);
    assert_eq!((set.observations.len(), set.rejected_frames.len()), (30, 0));
    assert!(
        set.warnings
            .iter()
            .any(|w| w.contains("a metal may be dark"))
    );
    let narrow = |tilt: f64, azimuth: f64| {
        if tilt == 0.0 {
            lobe(tilt, azimuth)
        } else {
            0.0
        }
    };
    let set = reduced(&made.series(&TILTS, &AZIMUTHS, &[0.02], narrow), None);
    assert_eq!(set.observations.len(), 30);
}

#[test]
fn a_near_rig_sees_what_its_views_average_to() {
    // A lobe of 5° about a facet normal that leans 8° to +x at φs = 0 and turns with the sample; the
    // field of 51 mm spans ±5° from the camera.
    let glint = |azimuth: f64, d: &geometry::Directions| {
        let half = (d.incident + d.outgoing).normalize();
        let (s, c) = azimuth.to_radians().sin_cos();
        let lean = 8f64.to_radians().tan();
        let (x, y) = (half.x / half.z - lean * c, half.y / half.z - lean * s);
        0.1 * d.incident.z + 0.2 * (-(x * x + y * y) / 0.01).exp()
    };
    let made = Made {
        near_mm: Some((300.0, 250.0)),
        ..Made::default()
    };
    let series = made.series_of(&TILTS, &AZIMUTHS, &[0.02, 0.06], |_, azimuth, d| {
        glint(azimuth, d)
    });
    let set = reduced(&series, None);
    assert_eq!(set.observations.len(), 30);
    assert_eq!(set.views.len(), 30);
    let (mut centre_off, mut squares) = (0.0_f64, 0.0);
    for (o, views) in set.observations.iter().zip(&set.views) {
        let azimuth = o.pose.phi_s.deg();
        let due: f64 = views
            .iter()
            .map(|v| v.weight * glint(azimuth, &v.directions))
            .sum();
        let off = (o.signal - due) / o.sigma.hypot(3e-4 * due);
        assert!(off.abs() < 5.0, "{o:?}: {due}");
        squares += ((o.signal - due) / o.sigma).powi(2);
        let centre = glint(azimuth, &set.rig.rig_directions(o.pose.theta_c));
        centre_off = centre_off.max((centre / o.signal - 1.0).abs());
    }
    // The slope of the lobe over the field is no noise: uncertainties are not padded by it.
    let rms = (squares / set.observations.len() as f64).sqrt();
    assert!(rms > 0.5, "{rms}");
    // Without the views the same numbers would be wrong by far more.
    assert!(centre_off > 0.05, "{centre_off}");
    let white = set.white_reference.unwrap();
    for flat in &set.flats {
        let due = white.reflectance / std::f64::consts::PI * set.rig.cos_incidence(flat.theta_c);
        assert!((flat.signal / due - 1.0).abs() < 5e-4, "{flat:?} {due}");
    }
}

#[test]
fn a_series_of_nothing_but_black_frames_gives_no_observation() {
    let made = Made::default();
    let series = made.series(&TILTS[..2], &AZIMUTHS[..2], &[0.02], |_, _| 0.0);
    let mut bare = series.clone();
    for (frame, row) in bare.frames.iter_mut().zip(&bare.rows) {
        if row.kind == FrameKind::Sample {
            *frame = None;
        }
    }
    let said = reduce(&bare, None, &AtomicBool::new(false)).unwrap_err();
    assert!(
        matches!(said, ReductionError::NoObservations { .. }),
        "{said}"
    );
}

#[test]
fn a_series_of_calibration_alone_says_so() {
    let made = Made::default();
    let mut series = made.series(&TILTS[..2], &AZIMUTHS[..2], &[0.02], |_, _| 0.0);
    let calibration = series
        .rows
        .iter()
        .filter(|r| r.kind != FrameKind::Sample)
        .count();
    let kept = |kind| kind != FrameKind::Sample;
    let rows = std::mem::take(&mut series.rows);
    let frames = std::mem::take(&mut series.frames);
    (series.rows, series.frames) = rows
        .into_iter()
        .zip(frames)
        .filter(|(r, _)| kept(r.kind))
        .unzip();
    let said = reduce(&series, None, &AtomicBool::new(false))
        .unwrap_err()
        .to_string();
    assert!(
        said.contains(&format!("only {calibration} calibration frames")),
        "{said}"
    );
}
