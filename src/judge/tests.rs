//! Tests of the decision rule against values of the normal and of Student's distribution.

use super::decision::decide;
use super::judgement::in_demanded_plane;
use super::*;
use crate::fit::painted::{TRUTH, painted};
use crate::fit::report::ReferencePlane;
use crate::fit::{FitOptions, FitReport, fit};
use crate::geometry::Pose;
use crate::material::Material;
use crate::observation::ObservationSet;
use crate::wording::toml_text;

fn measured(value: f64, std: f64) -> MeasuredValue {
    MeasuredValue {
        value,
        std,
        coverage_factor: 2.0,
        degrees_of_freedom: None,
        may_cost: 0.0,
    }
}

fn specification(text: &str) -> Specification {
    toml_text::read(text).unwrap()
}

fn verdict_of(text: &str, value: f64, std: f64) -> JudgedItem {
    let quantity = JudgedQuantity {
        name: "theta_r_deg".to_owned(),
        measured: Ok(measured(value, std)),
    };
    judge(&specification(text), &[quantity]).items.remove(0)
}

const ONE_SIDED: &str = "name = \"s\"\n[limits]\ntheta_r_deg = { upper = 10.5 }\n[decision]\nmax_false_accept_risk = 0.05\nmax_false_reject_risk = 0.05\n";

#[test]
fn limits_closer_than_their_guard_bands_have_no_acceptance_interval() {
    let both = ONE_SIDED.replace("{ upper", "{ lower = 10.2, upper");
    let item = verdict_of(&both, 10.35, 0.1);
    assert_eq!(item.verdict, Verdict::CannotTell);
    assert_eq!((item.acceptance_lower, item.acceptance_upper), (None, None));
    assert!(
        item.reason.contains("no value between them would pass"),
        "{}",
        item.reason
    );
    let item = verdict_of(&both, 10.35, 0.05);
    assert!(item.acceptance_lower < item.acceptance_upper);
}

#[test]
fn the_acceptance_limit_is_where_pass_begins() {
    // One-sided 95 %: g = 1.644854 u.
    let item = verdict_of(ONE_SIDED, 10.0, 0.1);
    assert!((item.guard_band.unwrap() - 0.164_485_362_695).abs() < 1e-9);
    let limit = item.acceptance_upper.unwrap();
    assert_eq!(
        verdict_of(ONE_SIDED, limit - 1e-6, 0.1).verdict,
        Verdict::Pass
    );
    assert_eq!(
        verdict_of(ONE_SIDED, limit + 1e-6, 0.1).verdict,
        Verdict::CannotTell
    );
    assert_eq!(
        verdict_of(ONE_SIDED, 10.5, 0.1).verdict,
        Verdict::CannotTell
    );
    let fails = 10.5 + item.guard_band.unwrap();
    assert_eq!(
        verdict_of(ONE_SIDED, fails - 1e-6, 0.1).verdict,
        Verdict::CannotTell
    );
    assert_eq!(
        verdict_of(ONE_SIDED, fails + 1e-6, 0.1).verdict,
        Verdict::Fail
    );
}

#[test]
fn between_two_limits_the_acceptance_interval_is_where_values_pass() {
    let text = "name = \"s\"\n[limits]\ntheta_r_deg = { lower = 9.8, upper = 10.2 }\n";
    let verdict = |value, std| verdict_of(text, value, std).verdict;
    for std in [0.01, 0.05, 0.08, 0.088] {
        let item = verdict_of(text, 10.0, std);
        let (low, high) = (
            item.acceptance_lower.unwrap(),
            item.acceptance_upper.unwrap(),
        );
        assert!((low - 9.8 - item.guard_band.unwrap()).abs() < 1e-12);
        assert_eq!(verdict(low + 1e-7, std), Verdict::Pass, "{std}");
        assert_eq!(verdict(low - 1e-7, std), Verdict::CannotTell, "{std}");
        assert_eq!(verdict(high - 1e-7, std), Verdict::Pass, "{std}");
        assert_eq!(verdict(high + 1e-7, std), Verdict::CannotTell, "{std}");
    }
    // One-sided guard bands would leave the middle, where the risk is 3.6 %, more than the 2.5 % allowed.
    let item = verdict_of(text, 10.0, 0.2 / 2.1);
    assert_eq!(item.verdict, Verdict::CannotTell);
    assert_eq!((item.acceptance_lower, item.acceptance_upper), (None, None));
    assert!(
        item.reason
            .ends_with("these limits; no value between them would pass")
    );
}

#[test]
fn two_limits_give_the_probability_between_them() {
    let text = "name = \"s\"\n[limits]\ntheta_r_deg = { lower = 9.8, upper = 10.2 }\n";
    // ±2 u about the value: 95.449974 %.
    let item = verdict_of(text, 10.0, 0.1);
    assert!((item.conformance_probability.unwrap() - 0.954_499_736_1).abs() < 1e-9);
    assert_eq!(item.verdict, Verdict::CannotTell);
    assert_eq!(verdict_of(text, 10.0, 0.05).verdict, Verdict::Pass);
    // An uncertainty wider than the tolerance can never pass, and does not fail either.
    assert_eq!(verdict_of(text, 10.0, 1.0).verdict, Verdict::CannotTell);
    // This holds even where little of the distribution lies between the limits. A value outside them may fail.
    let wide = verdict_of(text, 10.1, 20.0);
    assert!(wide.conformance_probability.unwrap() < 0.01, "{wide:?}");
    assert_eq!(wide.verdict, Verdict::CannotTell);
    assert_eq!(verdict_of(text, 10.3, 20.0).verdict, Verdict::Fail);
    assert_eq!(verdict_of(text, 11.0, 0.1).verdict, Verdict::Fail);
}

#[test]
fn few_degrees_of_freedom_widen_the_guard_band() {
    let few = MeasuredValue {
        degrees_of_freedom: Some(4.0),
        ..measured(10.0, 0.1)
    };
    let spec = specification(ONE_SIDED);
    let item = decide(
        "theta_r_deg",
        &spec.limits["theta_r_deg"],
        &few,
        &spec.decision,
    );
    // t(0.95; 4) = 2.131847.
    assert!((item.guard_band.unwrap() - 0.213_184_7).abs() < 1e-6);
}

#[test]
fn an_error_outside_the_uncertainty_leaves_a_limit_open_only_within_its_reach() {
    let spec = specification(ONE_SIDED);
    let with = |value, may_cost| {
        let m = MeasuredValue {
            may_cost,
            ..measured(value, 0.1)
        };
        decide(
            "theta_r_deg",
            &spec.limits["theta_r_deg"],
            &m,
            &spec.decision,
        )
    };
    assert_eq!(with(10.0, 0.3).verdict, Verdict::Pass);
    assert_eq!(with(12.0, 0.3).verdict, Verdict::Fail);
    let open = with(10.0, 0.4);
    assert_eq!(open.verdict, Verdict::CannotTell);
    assert_eq!(open.conformance_probability, None);
    assert!(open.reason.contains("by 0.40"), "{}", open.reason);
}

#[test]
fn without_uncertainty_the_value_decides() {
    assert_eq!(verdict_of(ONE_SIDED, 10.5, 0.0).verdict, Verdict::Pass);
    assert_eq!(
        verdict_of(ONE_SIDED, 10.500_001, 0.0).verdict,
        Verdict::Fail
    );
}

#[test]
fn angles_to_the_plane_of_the_sample_need_a_stated_wedge() {
    let text = "name = \"s\"\nreference_plane = \"sample\"\n[limits]\ntheta_r_deg = { upper = 10.5 }\nalpha_u = { upper = 10.5 }\n";
    let spec = specification(text);
    let quantities = || {
        ["theta_r_deg", "alpha_u"].map(|name| JudgedQuantity {
            name: name.to_owned(),
            measured: Ok(measured(10.0, 0.01)),
        })
    };
    let verdict = |demanded, plane| {
        let quantities = in_demanded_plane(demanded, plane, quantities().to_vec());
        judge(&spec, &quantities)
    };
    let (turntable, sample) = (ReferencePlane::Turntable, ReferencePlane::Sample);
    let open = verdict(spec.reference_plane, turntable);
    assert_eq!(open.verdict, Verdict::CannotTell);
    // Roughness does not depend on the plane.
    assert_eq!(open.items[0].verdict, Verdict::Pass);
    let reason = &open.items[1].reason;
    assert!(reason.contains("sample_wedge_std_deg"), "{reason}");
    for (demanded, plane) in [
        (spec.reference_plane, sample),
        (None, turntable),
        (Some(turntable), turntable),
        (Some(turntable), sample),
    ] {
        assert_eq!(verdict(demanded, plane).verdict, Verdict::Pass);
    }
}

#[test]
fn one_failure_fails_the_whole_and_an_unknown_leaves_it_open() {
    let text = "name = \"s\"\n[limits]\ntheta_r_deg = { upper = 10.5 }\nrho_d = { lower = 0.1 }\n";
    let theta = |value| JudgedQuantity {
        name: "theta_r_deg".to_owned(),
        measured: Ok(measured(value, 0.01)),
    };
    let rho = JudgedQuantity {
        name: "rho_d".to_owned(),
        measured: Err("k is free".to_owned()),
    };
    let spec = specification(text);
    let open = judge(&spec, &[theta(10.0), rho.clone()]);
    assert_eq!(open.verdict, Verdict::CannotTell);
    assert_eq!(open.conformance_probability_min, None);
    assert_eq!(open.items[0].quantity, "rho_d");
    assert!(open.items[0].reason.contains("k is free"));
    assert_eq!(judge(&spec, &[theta(12.0), rho]).verdict, Verdict::Fail);
    assert!(
        judge(&spec, &[theta(10.0)]).items[0]
            .reason
            .contains("not measured")
    );
}

/// A noise-free plastic part of an index that is known to 0.05, on a grid of poses.
fn measured_on(
    tilts: i32,
    tilt_step: f64,
    azimuths: i32,
    azimuth_step: f64,
) -> (ObservationSet, FitReport) {
    let poses = (-tilts..=tilts).flat_map(|i| {
        (0..azimuths)
            .map(move |j| Pose::from_deg(f64::from(i) * tilt_step, f64::from(j) * azimuth_step))
    });
    let mut set = painted(poses, &TRUTH, 1e-3, 7);
    set.material = Material::Dielectric {
        eta: 1.54,
        eta_std: 0.05,
    };
    let never = std::sync::atomic::AtomicBool::new(false);
    let report = fit(&set, &FitOptions::default(), &never);
    (set, report)
}

fn limited(upper: f64, (set, report): &(ObservationSet, FitReport)) -> VerdictReport {
    let text = format!("name = \"s\"\n[limits]\nalpha_u = {{ upper = {upper} }}\n");
    VerdictReport::new(&specification(&text), report, set, &[])
}

#[test]
fn a_grid_that_cannot_decide_does_not_exclude_that_a_larger_one_does() {
    let quick = measured_on(2, 10.0, 3, 90.0);
    let full = measured_on(4, 5.0, 12, 30.0);
    let of_full = &full.1.parameters.alpha_u;
    // Just inside the acceptance limit of the full grid.
    let upper = of_full.value.unwrap() + 2.2 * of_full.std.unwrap();
    assert_eq!(limited(upper, &full).judgement.verdict, Verdict::Pass);
    let quick = limited(upper, &quick).judgement;
    assert_eq!(quick.verdict, Verdict::CannotTell);
    let message = &quick.would_decide["alpha_u"].message;
    assert!(!message.contains("No number"), "{message}");
    let is_open = message.contains("One of these suffices")
        || message.contains("a grid of more azimuths and tilts may")
        || message.contains("No single change of this grid");
    assert!(is_open, "{message}");
}

#[test]
fn too_few_poses_are_a_warning_only_where_the_uncertainty_is_too_large() {
    let mut quick = measured_on(2, 10.0, 3, 90.0);
    let note = "15 observations for 8 free parameters hardly constrain the model error.";
    quick.1.notes = vec![note.to_owned()];
    quick.1.warnings.clear();
    let value = quick.1.parameters.alpha_u.value.unwrap();
    let warnings = |upper| limited(upper, &quick).judgement.warnings;
    assert_eq!(warnings(1.0), [""; 0]);
    assert_eq!(warnings(value), [note]);

    let expanded = quick.1.parameters.theta_r_deg.expanded.unwrap();
    let mut report = quick.1.clone();
    report.hold_against(2.0 * expanded);
    assert_eq!((report.warnings.len(), report.notes.len()), (0, 1));
    report.hold_against(0.5 * expanded);
    assert_eq!(
        (&report.warnings[..], report.notes.len()),
        (&[note.to_owned()][..], 0)
    );
}

#[test]
fn what_a_fit_leaves_out_cannot_be_judged_and_what_it_includes_can() {
    let poses = (0..15).map(|k| {
        Pose::from_deg(
            f64::from(k % 5) * 10.0 - 20.0,
            f64::from(k / 5) * 90.0 + 10.0,
        )
    });
    let set = painted(poses, &TRUTH, 1e-3, 4);
    let translucent = ObservationSet {
        translucency: Some(crate::observation::Prior {
            mean: 0.1,
            std: 0.02,
        }),
        ..set.clone()
    };
    let limits = specification("name = \"s\"\n[limits]\ntranslucency = { upper = 0.3 }\n");
    let options = FitOptions {
        variant: crate::fit::VariantChoice::Sawtooth,
        ..FitOptions::default()
    };
    let never = std::sync::atomic::AtomicBool::new(false);
    let [without, with] = [&set, &translucent].map(|set| {
        let report = fit(set, &options, &never);
        judge(&limits, &parameters(&report)).items.remove(0)
    });
    assert_eq!(without.verdict, Verdict::CannotTell);
    assert!(without.reason.contains("`left_out`"), "{}", without.reason);
    assert_eq!(with.verdict, Verdict::Pass);
}

#[test]
fn a_verdict_rests_on_the_fit_whose_values_it_judged() {
    let limits = specification(
        "name = \"s\"\n[limits]\ntheta_r_deg = { upper = 30.0 }\ncontrast_mean = { lower = 0.0 }\n",
    );
    let (set, report) = measured_on(2, 10.0, 3, 90.0);
    let verdict = VerdictReport::new(&limits, &report, &set, &[]);
    assert!(verdict.rests_on(&report));
    let std = report.parameters.theta_r_deg.std.unwrap();
    let moved = |by: f64| {
        let mut other = report.clone();
        other.parameters.theta_r_deg.value = report.parameters.theta_r_deg.value.map(|v| v + by);
        other
    };
    assert!(verdict.rests_on(&moved(0.005 * std)));
    assert!(!verdict.rests_on(&moved(0.5 * std)));
    let mut none = report.clone();
    none.parameters.theta_r_deg.value = None;
    assert!(!verdict.rests_on(&none));
}
