//! Path-traced series of samples that deviate from an ideal sawtooth: the values are right, and the first finding is the
//! true deviation.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use ridged::fit::causes::findings::Code;
use ridged::fit::report::{FitReport, Parameter};
use ridged::fit::{FitOptions, VariantChoice, fit, fit_watched};
use ridged::observation::{ObservationSet, Prior};
use ridged::reduction::reduce;
use ridged::series::Series;
use ridged::trace::surfaces::surface_profile::SurfaceProfile;

fn observed(name: &str) -> ObservationSet {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/series2");
    let series = Series::open(&root.join(name)).unwrap();
    reduce(&series, None, &AtomicBool::new(false)).unwrap()
}

fn fitted(set: &ObservationSet) -> FitReport {
    let options = FitOptions {
        variant: VariantChoice::Sawtooth,
        ..FitOptions::default()
    };
    fit(set, &options, &AtomicBool::new(false))
}

/// Asserts that a parameter's true value is within its expanded uncertainty, and that this is below `most`.
fn holds(name: &str, found: &Parameter, truth: f64, most: f64) {
    let (value, expanded) = (found.value.unwrap(), found.expanded.unwrap());
    assert!(
        (value - truth).abs() < expanded && expanded < most,
        "{name}: {value} ± {expanded} for {truth}"
    );
}

fn first(report: &FitReport) -> Option<Code> {
    report.findings.first().map(|f| f.code)
}

#[test]
fn light_that_leaves_uniformly_over_the_ridges_is_found_and_the_index_is_not_suspected() {
    let mut set = observed("translucent-12");
    let report = fitted(&set);
    let p = &report.parameters;
    holds("theta_r_deg", &p.theta_r_deg, 12.0, 0.1);
    holds("alpha_u", &p.alpha_u, 0.15, 0.004);
    holds("alpha_v", &p.alpha_v, 0.15, 0.004);
    holds("rho_d", &p.rho_d, 0.66576, 0.02);
    let tau = p.translucency.as_ref().unwrap();
    holds("translucency", tau, 0.99, 0.15);
    assert!(tau.expanded.unwrap() >= 0.04);
    assert_eq!(first(&report), Some(Code::Translucent));
    assert!(report.findings[0].explains > 0.95);
    assert!(!report.findings.iter().any(|f| f.code == Code::Index));
    assert!(
        !report.warnings.iter().any(|w| w.contains("index")),
        "{:?}",
        report.warnings
    );
    // If the translucency is stated, it is in the fit from the start, with its uncertainty.
    set.translucency = Some(Prior {
        mean: 0.95,
        std: 0.05,
    });
    let report = fitted(&set);
    holds("theta_r_deg", &report.parameters.theta_r_deg, 12.0, 0.1);
    assert!(report.parameters.translucency.is_some());
    assert!(report.findings.is_empty(), "{:?}", report.findings);
}

#[test]
fn an_opaque_body_of_the_same_plastic_is_not_reported_as_translucent() {
    let report = fitted(&observed("opaque-12"));
    holds("theta_r_deg", &report.parameters.theta_r_deg, 12.0, 0.15);
    holds("rho_d", &report.parameters.rho_d, 0.66576, 0.02);
    assert!(report.parameters.translucency.is_none());
    assert!(report.findings.is_empty(), "{:?}", report.findings);
    let out = |what: &str| report.left_out.iter().any(|l| l.what.contains(what));
    assert!(out("translucency") && out("tails") && out("rounded crests"));
    let crests = report.left_out.iter();
    assert_eq!(crests.filter(|l| l.what.contains("crests")).count(), 1);
    assert!(out("burrs"));
}

#[test]
fn lobes_with_tails_are_fitted_by_student_s_t() {
    let report = fitted(&observed("ggx-13"));
    let p = &report.parameters;
    holds("theta_r_deg", &p.theta_r_deg, 13.0, 0.1);
    holds("alpha_u", &p.alpha_u, 0.09, 0.003);
    holds("alpha_v", &p.alpha_v, 0.09, 0.003);
    holds("rho_d", &p.rho_d, 0.27464, 0.01);
    let slopes = report.slope_distribution.as_ref().unwrap();
    assert_eq!(slopes.name, "student-t");
    assert!((slopes.shape.unwrap() - 2.0).abs() < 0.1, "{slopes:?}");
    // The half width of GGX is 0.773 α.
    assert!((slopes.alpha_half_width_u.unwrap() - 0.0696).abs() < 0.001);
    assert_eq!(first(&report), Some(Code::Tails));
}

#[test]
fn rounded_crests_are_found_to_first_order_and_a_profile_makes_the_angle_certain() {
    let set = observed("moulded-14");
    let report = fitted(&set);
    let p = &report.parameters;
    holds("theta_r_deg", &p.theta_r_deg, 13.927, 0.2);
    holds("alpha_u", &p.alpha_u, 0.09, 0.004);
    holds("alpha_v", &p.alpha_v, 0.09, 0.004);
    holds("rho_d", &p.rho_d, 0.29209, 0.01);
    let crest = p.crest_radius.as_ref().unwrap();
    holds("crest_radius", crest, 0.1, 0.05);
    assert!(crest.expanded.unwrap() >= 0.02);
    assert_eq!(first(&report), Some(Code::RoundedCrests));
    let profile = include_str!("../data/series2/moulded-14/profile.csv");
    let corners: Vec<(f64, f64)> = profile
        .lines()
        .filter_map(|line| {
            let (v, z) = line.split_once(',')?;
            Some((v.trim().parse().ok()?, z.trim().parse().ok()?))
        })
        .collect();
    let profile = SurfaceProfile::measured(&corners).unwrap();
    let options = FitOptions {
        variant: VariantChoice::Traced,
        ..FitOptions::default()
    };
    let never = AtomicBool::new(false);
    let report = fit_watched(&set, &options, Some(&profile), &|_| true, None, &never);
    // The budget does not include surfaces that the tracer excludes.
    holds("theta_r_deg", &report.parameters.theta_r_deg, 13.927, 0.08);
}
