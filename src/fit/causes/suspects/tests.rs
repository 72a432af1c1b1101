//! A tilt of the sample across the ridges, a lamp beside its stated place, a white reference that is not Lambertian, tails
//! of the slopes at few poses, flat lands, two causes at once, a wrong one of few poses and another index, painted by the closed
//! form.

use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use crate::fit::causes::findings::Code;
use crate::fit::one_variant::estimate;
use crate::fit::painted::{TRUTH, painted};
use crate::fit::problem::Values;
use crate::fit::{FitOptions, VariantChoice, fit};
use crate::geometry::Pose;
use crate::material::Material;
use crate::model::Variant;
use crate::observation::{FlatObservation, ObservationSet};
use crate::units::Angle;

fn tilted(wedge_deg: f64, azimuth_deg: f64, alpha_v: f64) -> ObservationSet {
    let poses =
        (0..84).map(|n| Pose::from_deg(5.0 * f64::from(n / 12) - 15.0, 30.0 * f64::from(n % 12)));
    let truth = Values {
        wedge: wedge_deg.to_radians(),
        azimuth_offset: azimuth_deg.to_radians(),
        alpha_u: 0.12,
        alpha_v,
        ..TRUTH
    };
    painted(poses, &truth, 1e-3, 5)
}

#[test]
fn a_tilt_across_the_ridges_is_fitted_apart_from_the_azimuth_s_zero() {
    let options = FitOptions {
        variant: VariantChoice::Sawtooth,
        ..FitOptions::default()
    };
    for (wedge, zero) in [(0.6, 1.0), (-1.2, 0.0)] {
        let mut set = tilted(wedge, zero, 0.08);
        set.wedge_std = Some(Angle::from_deg(0.05));
        let report = fit(&set, &options, &AtomicBool::new(false));
        let codes: Vec<Code> = report.findings.iter().map(|f| f.code).collect();
        assert_eq!(codes, [Code::WedgeAcross], "{:?}", report.findings);
        let across = report.wedge_across.unwrap();
        let near = |found: f64, std: Option<f64>, truth: f64| {
            let std = std.unwrap();
            assert!((found - truth).abs() < 2.5 * std && std < 0.2, "{across:?}");
        };
        near(across.wedge_deg, across.wedge_std_deg, wedge);
        near(across.azimuth_zero_deg, across.azimuth_zero_std_deg, zero);
        let slope = TRUTH.theta_r.tan();
        assert!((across.azimuth_deg - zero - wedge / slope).abs() < 0.1);
        let theta_r = &report.parameters.theta_r_deg;
        let away = theta_r.value.unwrap() - TRUTH.theta_r.to_degrees();
        let own = theta_r.budget.unwrap().model;
        assert!(away.abs() < 0.02 && own < 0.02, "{away} {own}");
        let warned = |text: &str| report.warnings.iter().any(|w| w.contains(text));
        assert!(
            warned("rig.sample_wedge_std_deg states 0.05°"),
            "{:?}",
            report.warnings
        );
    }
}

#[test]
fn a_lamp_beside_its_stated_place_is_fitted() {
    let poses =
        (0..84).map(|n| Pose::from_deg(5.0 * f64::from(n / 12) - 15.0, 30.0 * f64::from(n % 12)));
    let truth = Values {
        lamp_turn: 2f64.to_radians(),
        ..TRUTH
    };
    let set = painted(poses, &truth, 1e-3, 5);
    let options = FitOptions {
        variant: VariantChoice::Sawtooth,
        ..FitOptions::default()
    };
    let report = fit(&set, &options, &AtomicBool::new(false));
    let codes: Vec<Code> = report.findings.iter().map(|f| f.code).collect();
    assert_eq!(codes, [Code::LampAzimuth], "{:?}", report.findings);
    let advice = &report.findings[0].advice;
    assert!(advice.contains("rig.light_azimuth_deg to 2.0"), "{advice}");
    let theta_r = &report.parameters.theta_r_deg;
    let away = theta_r.value.unwrap() - TRUTH.theta_r.to_degrees();
    let (u, own) = (theta_r.expanded.unwrap(), theta_r.budget.unwrap().model);
    assert!(away.abs() < 0.05 && u < 0.05, "{away} {u} {own}");
}

/// Flats at seven tilts of a white reference whose radiance falls by `falls` over 30° of its inclination to the lamp.
fn with_flats(mut set: ObservationSet, falls: f64) -> ObservationSet {
    let flats = (-3..=3).map(|n| {
        let theta_c = Angle::from_deg(5.0 * f64::from(n));
        let away = (theta_c + set.rig.theta_l).deg() / 30.0;
        let lambertian = 0.99 / PI * set.rig.cos_incidence(theta_c);
        FlatObservation {
            theta_c,
            signal: lambertian * (1.0 - falls * away * away),
            sigma: 1e-4 * lambertian,
            times_s: Vec::new(),
        }
    });
    set.flats = flats.collect();
    set
}

#[test]
fn a_white_reference_that_is_not_lambertian_is_named() {
    let plain = painted(poses(7, 5.0, 12), &TRUTH, 2e-4, 5);
    for falls in [0.015, -0.015] {
        let set = with_flats(plain.clone(), falls);
        let (_, _, codes) = found(&set, &TRUTH);
        assert_eq!(codes.first(), Some(&Code::WhiteReference), "{codes:?}");
    }
}

#[test]
fn to_first_order_a_tilt_across_the_ridges_turns_the_azimuth() {
    let set = tilted(0.2, 0.5, 0.12);
    let options = FitOptions::default();
    let plain = estimate(
        &set,
        Variant::Sawtooth,
        &options,
        None,
        &AtomicBool::new(false),
    )
    .unwrap();
    let turned = plain.values.folded().azimuth_offset.to_degrees();
    assert!(
        (turned - 0.5 - 0.2 / TRUTH.theta_r.tan()).abs() < 0.1,
        "{turned}"
    );
}

/// Poses of five tilts or more, 10° or 7° apart, at equal steps of azimuth.
fn poses(tilts: i32, step_deg: f64, azimuths: i32) -> impl Iterator<Item = Pose> {
    (0..tilts * azimuths).map(move |n| {
        let tilt = step_deg * f64::from(n / azimuths - tilts / 2);
        Pose::from_deg(tilt, 360.0 / f64::from(azimuths) * f64::from(n % azimuths))
    })
}

fn surface(theta_r_deg: f64, alpha: f64, rho_d: f64, tail: f64, crest: f64) -> Values {
    let mut truth = Values {
        theta_r: theta_r_deg.to_radians(),
        alpha_u: alpha,
        alpha_v: alpha,
        rho_d,
        ..TRUTH
    };
    truth.real.tail = tail;
    truth.real.crest = crest;
    truth
}

/// θr in standard uncertainties from the truth, U(θr) in degrees, and the codes of the findings.
fn found(set: &ObservationSet, truth: &Values) -> (f64, f64, Vec<Code>) {
    let options = FitOptions {
        variant: VariantChoice::Sawtooth,
        ..FitOptions::default()
    };
    let report = fit(set, &options, &AtomicBool::new(false));
    let theta_r = &report.parameters.theta_r_deg;
    let away = theta_r.value.unwrap() - truth.theta_r.to_degrees();
    let codes = report.findings.iter().map(|f| f.code).collect();
    (
        away / theta_r.std.unwrap(),
        theta_r.expanded.unwrap(),
        codes,
    )
}

#[test]
fn tails_are_found_at_few_poses_where_another_surface_fits_better_without_them() {
    for (truth, azimuths) in [
        (surface(15.06, 0.083, 0.56, 0.5, 0.0), 3),
        (surface(12.03, 0.1, 0.62, 0.6, 0.0), 4),
        (surface(8.3, 0.07, 0.19, 0.8, 0.0), 4),
    ] {
        let set = painted(poses(5, 10.0, azimuths), &truth, 2e-4, 5);
        let (away, u, codes) = found(&set, &truth);
        assert_eq!(codes, [Code::Tails], "{truth:?}");
        assert!(away.abs() < 2.5 && u < 0.5, "{truth:?}: {away} {u}");
    }
}

#[test]
fn flat_lands_between_the_ridges_are_found() {
    for (theta_r_deg, alpha, land) in [(12.0, 0.1, 0.09), (15.0, 0.12, 0.2), (20.0, 0.08, 0.04)] {
        let mut truth = surface(theta_r_deg, alpha, 0.4, 0.0, 0.0);
        truth.real.land = land;
        let set = painted(poses(7, 7.0, 8), &truth, 2e-4, 5);
        let (away, u, codes) = found(&set, &truth);
        assert_eq!(codes.first(), Some(&Code::FlatLands), "{truth:?}");
        assert!(away.abs() < 2.5 && u < 0.5, "{truth:?}: {away} {u}");
    }
}

#[test]
fn flat_lands_of_a_metal_are_found_where_ridges_that_lean_the_other_way_fit_better_without_them() {
    let mut truth = Values {
        alpha_v: 0.14,
        eta: 2.9,
        k: 3.1,
        ..surface(20.0, 0.08, 0.0, 0.0, 0.0)
    };
    for land in [0.1, 0.15, 0.25] {
        truth.real.land = land;
        let mut set = painted(poses(7, 7.0, 8), &truth, 2e-4, 5);
        set.material = Material::exactly(2.9, 3.1);
        let (away, u, codes) = found(&set, &truth);
        assert_eq!(codes.first(), Some(&Code::FlatLands), "{land} {away} {u}");
        assert!(away.abs() < 2.5 && u < 0.5, "{land}: {away} {u}");
    }
}

#[test]
fn two_causes_that_explain_little_alone_are_found_together() {
    let truth = surface(13.15, 0.169, 0.669, 0.67, 0.073);
    let set = painted(poses(7, 7.0, 8), &truth, 2e-4, 5);
    let (away, u, mut codes) = found(&set, &truth);
    codes.sort_by_key(|code| code.word());
    assert_eq!(codes, [Code::RoundedCrests, Code::Tails]);
    assert!(away.abs() < 2.5 && u < 0.5, "{away} {u}");
}

#[test]
fn a_wrong_pose_is_found_among_few() {
    let truth = surface(14.0, 0.12, 0.35, 0.0, 0.0);
    for pose in [4, 7, 10] {
        let mut set = painted(poses(5, 10.0, 3), &truth, 2e-4, 5);
        set.observations[pose].signal *= 0.92;
        let (away, _, codes) = found(&set, &truth);
        assert_eq!(codes, [Code::BadPose], "{pose}");
        assert!(away.abs() < 2.5, "{pose} {away}");
    }
}

#[test]
fn an_index_that_the_data_contradict_is_a_finding() {
    let truth = Values { eta: 1.6, ..TRUTH };
    let mut set = painted(poses(7, 7.0, 8), &truth, 2e-4, 5);
    set.material = Material::Dielectric {
        eta: 1.54,
        eta_std: 0.005,
    };
    let (away, u, codes) = found(&set, &truth);
    assert_eq!(codes, [Code::Index]);
    assert!(away.abs() < 2.5 && u < 0.5, "{away} {u}");
    set.material = Material::Dielectric {
        eta: 1.6,
        eta_std: 0.005,
    };
    assert_eq!(found(&set, &truth).2, []);
}
