//! Scans of one sample computed from the closed form, each mounted separately.

use std::sync::atomic::AtomicBool;

use super::*;
use crate::fit::Constraint;
use crate::fit::higher_order::two_bounces;
use crate::fit::one_variant::estimate;
use crate::fit::painted::{TRUTH, painted};
use crate::fit::problem::Problem;
use crate::fit::report::Parameter;
use crate::fit::report::Status;
use crate::fit::uncertainty::budget::uncertainty;
use crate::geometry::Pose;
use crate::material::Material;

/// A scan of the sample mounted with these zeros; five tilts at every azimuth.
fn scan(seed: u64, azimuths: &[f64], zeros_deg: [f64; 2]) -> ObservationSet {
    let poses = azimuths
        .iter()
        .flat_map(|azimuth| (0..5).map(move |k| (*azimuth, -20.0 + 10.0 * f64::from(k))))
        .map(|(azimuth, tilt)| Pose::from_deg(tilt, azimuth));
    let truth = Values {
        azimuth_offset: zeros_deg[0].to_radians(),
        tilt_offset: zeros_deg[1].to_radians(),
        ..TRUTH
    };
    painted(poses, &truth, 2e-3, seed)
}

fn options() -> FitOptions {
    FitOptions {
        variant: VariantChoice::Sawtooth,
        starts: 3,
        misfit: false,
        ..FitOptions::default()
    }
}

fn joined(sets: &[ObservationSet], options: &FitOptions) -> Result<JointReport, JointError> {
    let names = ["first", "second", "third"];
    let scans: Vec<Scan<'_>> = names
        .iter()
        .zip(sets)
        .map(|(name, set)| Scan { name, set })
        .collect();
    fit_joint(
        &scans,
        options,
        &|_, _| None,
        &|| false,
        &AtomicBool::new(false),
    )
}

fn known(parameter: &Parameter) -> (f64, f64) {
    let both = parameter.value.zip(parameter.std);
    both.unwrap_or_else(|| panic!("{:?}", parameter.note))
}

#[test]
fn three_mountings_give_one_surface_and_separate_zeros() {
    let zeros = [[2.0, -0.5], [-6.0, 1.0], [9.0, 0.3]];
    let turns: [&[f64]; 3] = [
        &[0.0, 90.0, 180.0, 270.0],
        &[0.0, 60.0, 120.0],
        &[15.0, 105.0, 195.0],
    ];
    let sets: Vec<ObservationSet> = (0..3)
        .map(|k| scan(11 + k as u64, turns[k], zeros[k]))
        .collect();
    let joint = joined(&sets, &options()).expect("three scans of one sample");
    assert_eq!(joint.report.status, Status::Converged);
    let (theta, std) = known(&joint.report.parameters.theta_r_deg);
    // Four standard uncertainties: exceeded by one seed in 16,000.
    assert!((theta - TRUTH.theta_r.to_degrees()).abs() < 4.0 * std);
    for (scan, zeros) in joint.scans.iter().zip(zeros) {
        let own = &scan.report.parameters;
        let alone = scan.theta_r_alone_std.expect("each is known alone");
        // Never less certain than any single scan.
        assert!(std < alone, "{std} {alone}");
        assert_eq!(own.theta_r_deg, joint.report.parameters.theta_r_deg);
        for (found, zero) in [
            (&own.azimuth_offset_deg, zeros[0]),
            (&own.tilt_offset_deg, zeros[1]),
        ] {
            let (value, std) = known(found);
            assert!((value - zero).abs() < 4.0 * std, "{value} {zero} {std}");
        }
    }
    // 4, 3 and 3 azimuths of five tilts.
    assert_eq!(joint.report.n_observations, 50);
    assert_eq!(joint.report.parameters.tilt_offset_deg.value, None);
    let text = crate::fit::report::text::joint(&joint, &crate::fit::report::text::Form::PLAIN);
    // The values that each scan has for itself are reported with their uncertainty, not as undetermined.
    assert!(!text.contains("not determined"), "{text}");
    let row = text
        .lines()
        .find(|line| line.trim_start().starts_with("second"));
    let row = row.expect("a row for each scan");
    assert_eq!(row.matches(" ± ").count(), 3, "{row}");
}

#[test]
fn a_scan_joined_with_itself_has_its_noise_reduced_by_the_root_of_two() {
    let set = scan(21, &[0.0, 90.0, 180.0, 270.0], [3.0, 0.5]);
    let joint = joined(&[set.clone(), set], &options()).expect("two scans");
    let (theta, _) = known(&joint.report.parameters.theta_r_deg);
    let alone = joint.scans[0].theta_r_alone_deg.expect("known");
    assert!((theta - alone).abs() < 1e-6, "{theta} {alone}");
    let counting = |p: &Parameter| p.budget.map_or(f64::NAN, |b| b.counting);
    let both = counting(&joint.report.parameters.theta_r_deg);
    let set = scan(21, &[0.0, 90.0, 180.0, 270.0], [3.0, 0.5]);
    let one = estimate(
        &set,
        Variant::Sawtooth,
        &options(),
        None,
        &AtomicBool::new(false),
    );
    let one = one
        .map(|e| uncertainty(&e).budgets[0])
        .expect("it has a minimum");
    let ratio = one.counting.to_degrees() / both;
    // Exact except for the prior on the stray light, which each scan has for itself.
    assert!((ratio - 2f64.sqrt()).abs() < 1e-6, "{ratio}");
    // The same certificate in both: averaging does not reduce it.
    let reference = |p: &Parameter| p.budget.map_or(f64::NAN, |b| b.reference);
    let shared = reference(&joint.report.parameters.theta_r_deg);
    assert!((shared / one.reference.to_degrees() - 1.0).abs() < 1e-6);
}

#[test]
fn a_scan_of_few_poses_leaves_a_good_one_its_certainty() {
    let turns: Vec<f64> = (0..12).map(|k| 30.0 * f64::from(k)).collect();
    let with_second_bounce = |seed: u64, azimuths: &[f64], tilts: &[f64]| {
        let mut set = scan(seed, azimuths, [0.0, 0.0]);
        set.observations
            .retain(|o| tilts.iter().any(|t| (o.pose.theta_c.deg() - t).abs() < 0.1));
        let problem = Problem::new(&set, Variant::Sawtooth, Vec::new(), TRUTH);
        let added = two_bounces(&problem, &TRUTH).expect("it is integrated");
        for (o, more) in set.observations.iter_mut().zip(added) {
            o.signal += TRUTH.scale * more;
        }
        set
    };
    let good = with_second_bounce(51, &turns, &[-20.0, -10.0, 0.0, 10.0, 20.0]);
    let options = FitOptions {
        misfit: true,
        ..options()
    };
    for seed in 52..55 {
        let weak = with_second_bounce(seed, &turns[..4], &[-10.0, 10.0]);
        let scans = [&good, &weak].map(|set| Scan { name: "scan", set });
        let (never, cancel) = (|| false, AtomicBool::new(false));
        let joint = fit_joint(&scans, &options, &two_bounces, &never, &cancel);
        let joint = joint.expect("two scans");
        let (_, std) = known(&joint.report.parameters.theta_r_deg);
        let alone = |scan: usize| joint.scans[scan].theta_r_alone_std.unwrap_or(f64::INFINITY);
        assert!(alone(1) > 3.0 * alone(0), "{} {}", alone(1), alone(0));
        assert!(std < 1.2 * alone(0), "{seed} {std} {}", alone(0));
    }
}

#[test]
fn scans_of_two_samples_are_reported_and_widen_the_model_line() {
    let turns = [0.0, 90.0, 180.0, 270.0];
    let (mut one, mut other) = (scan(31, &turns, [0.0, 0.0]), scan(32, &turns, [0.0, 0.0]));
    // A common increase that the prior excludes as stray light is a brighter surface.
    for o in &mut other.observations {
        o.signal += 0.01;
    }
    one.background.std = 1e-5;
    other.background.std = 1e-5;
    let joint = joined(&[one, other], &options()).expect("two scans");
    let warnings = &joint.report.warnings;
    assert!(
        warnings.iter().any(|w| w.contains("disagree on ρd")),
        "{warnings:?}"
    );
    let (rho_d, std) = known(&joint.report.parameters.rho_d);
    assert!((rho_d - 0.3).abs() < 2.0 * std, "{rho_d} {std}");
}

#[test]
fn held_values_apply_to_all_scans_and_invalid_requests_are_refused_by_name() {
    let turns = [0.0, 90.0, 180.0, 270.0];
    let sets = [scan(41, &turns, [0.0, 0.0]), scan(42, &turns, [4.0, 0.0])];
    let held = FitOptions {
        constraints: vec![Constraint {
            quantity: Quantity::AlphaU,
            value: 0.12,
            std: 0.0,
        }],
        ..options()
    };
    let joint = joined(&sets, &held).expect("two scans");
    assert_eq!(joint.report.parameters.alpha_u.value, Some(0.12));
    assert_eq!(joint.report.parameters.alpha_u.std, None);

    assert_eq!(joined(&sets[..1], &options()), Err(JointError::TooFew));
    let mut glass = sets.clone();
    glass[1].material = Material::exactly(1.5, 0.0);
    let refused = joined(&glass, &options()).expect_err("two materials");
    assert_eq!(
        refused.to_string(),
        "first and second state different materials; join only scans of one part"
    );
    let traced = FitOptions {
        variant: VariantChoice::Traced,
        ..options()
    };
    assert_eq!(
        joined(&sets, &traced),
        Err(JointError::OneScanOnly("the variant traced"))
    );
    let mut few = sets.clone();
    few[1].observations.truncate(5);
    assert!(
        matches!(joined(&few, &options()), Err(JointError::NoFit(name, _)) if name == "second")
    );
}
