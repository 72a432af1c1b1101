//! A tilt of the sample across the ridges and a lamp beside its stated place, painted by the closed form.

use std::sync::atomic::AtomicBool;

use crate::fit::findings::Code;
use crate::fit::one_variant::estimate;
use crate::fit::painted::{TRUTH, painted};
use crate::fit::problem::Values;
use crate::fit::{FitOptions, VariantChoice, fit};
use crate::geometry::Pose;
use crate::model::Variant;
use crate::observation::ObservationSet;
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
fn a_tilt_across_the_ridges_is_fitted_and_told_from_the_azimuth_s_zero() {
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
