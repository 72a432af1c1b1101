//! Lamps with a known drift, on series computed from the closed form and on path-traced ones.

use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

use super::*;
use crate::fit::causes::findings::Code;
use crate::fit::higher_order::HigherOrder;
use crate::fit::one_variant::estimate;
use crate::fit::painted::{TRUTH, painted};
use crate::fit::problem::{Quantity, Values};
use crate::fit::uncertainty::budget::uncertainty;
use crate::fit::{FitOptions, VariantChoice, fit, higher_order};
use crate::geometry::Pose;
use crate::material::Material;
use crate::model::Variant;
use crate::model::extended::Real;
use crate::observation::{FlatObservation, Observation};
use crate::series::Series;

/// Noise of a series, as a share of its brightest signal.
const NOISE: f64 = 1e-3;

/// Five tilts at eight azimuths, one pose per minute, with a lamp that changes by `per_hour`.
fn series(per_hour: f64, noise: f64, seed: u64) -> ObservationSet {
    let truth = Values {
        azimuth_offset: 0.05,
        ..TRUTH
    };
    timed(&truth, 8, per_hour, noise, seed)
}

/// The same of any surface, at any number of azimuths.
fn timed(truth: &Values, azimuths: u32, per_hour: f64, noise: f64, seed: u64) -> ObservationSet {
    let turn_deg = 360.0 / f64::from(azimuths);
    let tilt_deg = |k: u32| f64::from(k % 5) * 10.0 - 20.0;
    let poses = (0..5 * azimuths).map(|k| Pose::from_deg(tilt_deg(k), f64::from(k / 5) * turn_deg));
    let mut set = painted(poses, truth, noise, seed);
    for (k, o) in set.observations.iter_mut().enumerate() {
        let taken_s = 60.0 * (k as f64 + 1.0);
        o.taken_s = Some(taken_s);
        o.signal *= 1.0 + per_hour * taken_s / SECONDS_PER_HOUR;
        o.shared.led_drift = 0.0005 * o.signal;
    }
    set
}

fn fitted_to<'a>(set: &'a ObservationSet, higher_order: Option<HigherOrder<'_>>) -> Estimate<'a> {
    let options = FitOptions {
        variant: VariantChoice::Sawtooth,
        starts: 3,
        starts_alone: true,
        ..FitOptions::default()
    };
    let never = AtomicBool::new(false);
    estimate(set, Variant::Sawtooth, &options, higher_order, &never).expect("it has a minimum")
}

#[test]
fn a_fading_lamp_is_reported_and_corrected_and_the_budget_has_its_uncertainty() {
    let set = series(-0.1, NOISE, 7);
    let before = fitted_to(&set, None);
    let found = drift(&before).expect("6.5 % over the series");
    let lamp = found.lamp;
    assert!(
        (lamp.change_over_series + 0.065).abs() < 4.0 * lamp.change_std,
        "{lamp:?}"
    );
    assert!(
        lamp.f > 100.0 && lamp.explains > 0.9 && lamp.t < -10.0,
        "{lamp:?}"
    );
    assert!(found.message().contains("fell by"), "{}", found.message());
    let steady = without(&set, lamp).expect("it has times");
    for estimate in [&before, &fitted_to(&steady, None)] {
        let u = uncertainty(estimate);
        for (k, q) in estimate.problem.free().iter().enumerate() {
            let truth = match q {
                Quantity::ThetaR => TRUTH.theta_r,
                Quantity::AzimuthOffset => 0.05,
                Quantity::TiltOffset => 0.0,
                Quantity::RhoD => TRUTH.rho_d,
                _ => continue,
            };
            let off = estimate.values.folded().inner(*q) - truth;
            let std = u.budgets[k].combined();
            assert!(off.abs() < 2.0 * std, "{q:?} {off} {:?}", u.budgets[k]);
        }
    }
    // After the correction the residuals show no drift, but it is still reported.
    let after = fitted_to(&steady, None);
    assert_eq!(drift(&after).expect("it was corrected").lamp, lamp);
    let left = fitted(&after).expect("it has times");
    assert!(
        left.change_over_series.abs() < 0.1 * lamp.change_over_series.abs(),
        "{left:?}"
    );
    assert!(after.rms_residual < before.rms_residual);
}

/// The relative noise is that of 10⁸ electrons, as of the mean of a region of a camera.
#[test]
fn a_drift_of_three_thousandths_is_reported_and_none_is_not() {
    let minutes = 39.0;
    for seed in 0..4 {
        let set = series(-0.003 * 60.0 / minutes, 1e-4, seed);
        let lamp = drift(&fitted_to(&set, None))
            .unwrap_or_else(|| panic!("seed {seed} shows no drift"))
            .lamp;
        let off = lamp.change_over_series + 0.003;
        assert!(
            off.abs() < 0.001 && off.abs() < 4.0 * lamp.change_std,
            "{seed}: {lamp:?}"
        );
        let steady = series(0.0, 1e-4, seed);
        assert_eq!(drift(&fitted_to(&steady, None)), None, "seed {seed}");
    }
}

#[test]
fn a_steady_lamp_and_frames_without_times_are_not_reported_to_drift() {
    for seed in 0..20 {
        let set = series(0.0, NOISE, seed);
        assert_eq!(drift(&fitted_to(&set, None)), None, "seed {seed}");
    }
    let mut set = series(-0.1, NOISE, 7);
    set.observations[3].taken_s = None;
    assert_eq!(drift(&fitted_to(&set, None)), None);
}

/// The tilts follow each other in time, so a curve in time explains a part of what a wrong certificate leaves.
#[test]
fn a_wrong_scale_is_not_taken_for_a_drift_and_a_large_drift_is_reported() {
    let tilts = (-4..=4).map(|k| 5.0 * f64::from(k));
    let poses =
        tilts.flat_map(|tilt| (0..12).map(move |k| Pose::from_deg(tilt, f64::from(30 * k))));
    let mut set = painted(poses, &TRUTH, NOISE, 3);
    set.material = Material::Dielectric {
        eta: 1.54,
        eta_std: 0.005,
    };
    for (k, o) in set.observations.iter_mut().enumerate() {
        o.taken_s = Some(2.5 * (k as f64 + 1.0));
        (o.signal, o.sigma) = (0.7 * o.signal, 0.7 * o.sigma);
    }
    let estimate = fitted_to(&set, None);
    let apparent = fitted(&estimate).expect("it has a trend");
    assert!(estimate.discrepancy > LOUD, "{}", estimate.discrepancy);
    assert!(
        apparent.chance < CHANCE && apparent.explains < EXPLAINS_LOUD,
        "{apparent:?}"
    );
    assert_eq!(drift(&estimate), None);
    for change in [-0.16, 0.16] {
        let drifting = series(change * 60.0 / 39.0, NOISE, 1);
        let lamp = drift(&fitted_to(&drifting, None)).map(|found| found.lamp);
        let found = lamp.expect("it drifts").change_over_series;
        assert!((found / change - 1.0).abs() < 0.4, "{change} {found}");
    }
}

/// Poses tilt by tilt: the time imitates the tilt.
#[test]
fn what_follows_the_tilt_is_not_corrected_as_a_drift_of_the_lamp() {
    let poses = || {
        (0..84).map(|n| Pose::from_deg(5.0 * f64::from(n / 12) - 15.0, f64::from(30 * (n % 12))))
    };
    let timed = |share: &dyn Fn(usize) -> f64| {
        let mut set = painted(poses(), &TRUTH, 2e-4, 3);
        for (k, o) in set.observations.iter_mut().enumerate() {
            o.taken_s = Some(30.0 * (k as f64 + 1.0));
            o.signal *= 1.0 + share(k);
        }
        set
    };
    // A step per tilt: what a lamp cannot do.
    let follows = timed(&|k| 0.01 * (k / 12) as f64 / 6.0);
    let estimate = fitted_to(&follows, None);
    assert_eq!(to_correct(&estimate), None, "{:?}", drift(&estimate));
    let drifts = timed(&|k| 0.01 * k as f64 / 84.0);
    let lamp = to_correct(&fitted_to(&drifts, None)).expect("1 % over the series");
    let off = lamp.change_over_series - 0.01;
    assert!(off.abs() < 4.0 * lamp.change_std, "{lamp:?}");
}

/// With 20 poses the residual of the ideal sawtooth has few degrees of freedom and may look like a trend.
#[test]
fn tails_that_few_poses_see_are_not_taken_for_a_drift() {
    let tailed = Values {
        azimuth_offset: 0.05,
        real: Real {
            tail: 0.25,
            ..Real::NONE
        },
        ..TRUTH
    };
    for seed in 0..4 {
        let set = timed(&tailed, 4, 0.0, NOISE, seed);
        let report = fit(&set, &FitOptions::default(), &AtomicBool::new(false));
        let codes: Vec<Code> = report.findings.iter().map(|f| f.code).collect();
        assert_eq!(codes.first(), Some(&Code::Tails), "seed {seed}");
        assert!(!codes.contains(&Code::LampDrift), "seed {seed}");
    }
}

fn recorded() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series2/lamp-drifts-14")
}

fn reduced() -> ObservationSet {
    let series = Series::open(&recorded()).expect("it is in the repository");
    crate::reduction::reduce(&series, None, &AtomicBool::new(false)).expect("it has frames")
}

/// Time per white reference frame or pose, s.
const STEP_S: f64 = 15.5;
const FLATS: usize = 7;

/// Half of the path-traced radiances in a random order of poses, with the noise of the camera and a lamp that changes by
/// `change` from the first white reference frame to the last pose, half of it in the first third.
fn in_another_order(like: &ObservationSet, change: f64, seed: u64) -> ObservationSet {
    let mut draw = rand_pcg::Pcg64::seed_from_u64(seed);
    let mut reader = csv::Reader::from_path(recorded().join("radiance.csv")).expect("a table");
    let rows = reader.records().map(|row| row.expect("a row"));
    let rows = rows.map(|row| [0, 1, 3].map(|k: usize| row[k].parse::<f64>().expect("a number")));
    let mut rows: Vec<[f64; 3]> = rows
        .filter(|[tilt, ..]| tilt.rem_euclid(14.0) != 0.0)
        .collect();
    for k in (1..rows.len()).rev() {
        rows.swap(k, draw.random_range(0..=k));
    }
    let steps = (FLATS + rows.len() - 1) as f64;
    // u + u² = 1 gives half of the change in the first third.
    let u = 0.5 * (5.0_f64.sqrt() - 1.0);
    let light =
        |step: usize| 1.0 + change * (1.0 - u.powf(3.0 * step as f64 / steps)) / (1.0 - u.powi(3));
    let white = (0..FLATS).map(light).sum::<f64>() / FLATS as f64;
    let mut noisy = |value: f64| value * (1.0 + 3.5e-4 * draw.sample::<f64, _>(StandardNormal));
    let middle = 0.5 * (FLATS - 1) as f64;
    let reference = like.white_reference.expect("it has one");
    let flats = (0..FLATS).map(|k| {
        let theta_c = crate::units::Angle::from_deg(7.0 * k as f64 - 21.0);
        let due = reference.reflectance / std::f64::consts::PI * like.rig.cos_incidence(theta_c);
        FlatObservation {
            theta_c,
            signal: noisy(due * light(k) / white),
            sigma: 3.5e-4 * due,
            times_s: vec![STEP_S * (k as f64 - middle)],
        }
    });
    let flats = flats.collect();
    let shared = like.observations[0].shared;
    let observations = rows.iter().enumerate().map(|(k, [tilt, turn, radiance])| {
        let signal = noisy(radiance * light(FLATS + k) / white);
        let mut o = Observation::new(Pose::from_deg(*tilt, *turn), signal, 3.5e-4 * signal);
        o.shared = shared;
        o.shared.white_reference = signal * reference.reflectance_std / reference.reflectance;
        o.shared.led_drift = 1e-3 * signal;
        o.taken_s = Some(STEP_S * ((FLATS + k) as f64 - middle));
        o
    });
    ObservationSet {
        observations: observations.collect(),
        flats,
        warnings: Vec::new(),
        ..like.clone()
    }
}

#[test]
fn a_drift_of_one_and_a_half_per_cent_is_reported_in_any_order_of_the_poses_and_none_is_not() {
    let like = reduced();
    for seed in 1..4 {
        let set = in_another_order(&like, -0.015, seed);
        let found = drift(&fitted_to(&set, Some(&higher_order::two_bounces)));
        let lamp = found
            .unwrap_or_else(|| panic!("order {seed} shows no drift"))
            .lamp;
        // Expected from the first pose to the last: 0.0104 of the light during the white reference frames.
        let off = lamp.change_over_series + 0.0104;
        assert!(
            off.abs() < 0.004 && off.abs() < 4.0 * lamp.change_std,
            "{seed}: {lamp:?}"
        );
    }
    for seed in 11..13 {
        let set = in_another_order(&like, 0.0, seed);
        let found = drift(&fitted_to(&set, Some(&higher_order::two_bounces)));
        assert_eq!(found, None, "order {seed}");
    }
}

#[test]
fn the_flats_are_corrected_too() {
    let set = in_another_order(&reduced(), -0.05, 1);
    let lamp = fitted(&fitted_to(&set, Some(&higher_order::two_bounces))).expect("it has times");
    let steady = without(&set, lamp).expect("it has times");
    // Each flat against a Lambertian surface under the same light.
    let spread = |set: &ObservationSet| {
        let levels = set
            .flats
            .iter()
            .map(|flat| flat.signal / set.rig.cos_incidence(flat.theta_c));
        let (least, most) = levels.fold((f64::INFINITY, 0.0_f64), |(least, most), level| {
            (least.min(level), most.max(level))
        });
        most / least - 1.0
    };
    assert!(spread(&set) > 5e-3, "{}", spread(&set));
    assert!(spread(&steady) < 0.4 * spread(&set), "{}", spread(&steady));
}

#[test]
fn the_recorded_lamp_drift_is_reported_and_angle_and_reflectance_are_within_their_uncertainties() {
    let set = reduced();
    let options = FitOptions {
        starts_alone: true,
        ..FitOptions::default()
    };
    let report = fit(&set, &options, &AtomicBool::new(false));
    assert!(
        report
            .warnings
            .iter()
            .any(|w| w.contains("The lamp drifts")),
        "{:?}",
        report.warnings
    );
    let p = &report.parameters;
    for (parameter, truth, most) in [(&p.theta_r_deg, 14.0, 0.3), (&p.rho_d, 0.38823, 0.012)] {
        let (value, u) = (
            parameter.value.expect("determined"),
            parameter.expanded.expect("determined"),
        );
        assert!(
            (value - truth).abs() <= u && u < most,
            "{value} ± {u} for {truth}"
        );
        assert!(parameter.budget.expect("determined").drift > 0.0);
    }
}
