//! The covariance of a fit, against fits of series with one common error.

use std::sync::atomic::AtomicBool;

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use ridged::fit::one_variant::estimate;
use ridged::fit::problem::{Problem, Quantity, Values};
use ridged::fit::report::build::report_of;
use ridged::fit::report::{FitReport, VariantName};
use ridged::fit::{FitOptions, VariantChoice};
use ridged::geometry::{Pose, RigGeometry};
use ridged::material::Material;
use ridged::model::Variant;
use ridged::observation::{Observation, ObservationSet, Prior, WhiteReference};

const TRUTH: Values = Values {
    theta_r: 0.17,
    alpha_u: 0.12,
    alpha_v: 0.14,
    rho_d: 0.3,
    background: 0.002,
    azimuth_offset: 0.05,
    tilt_offset: -0.01,
    eta: 1.54,
    ..Values::IDEAL
};
/// As a share of the brightest observation.
const NOISE: f64 = 1e-4;
/// Relative standard uncertainty of the white reference: by far the largest error.
const REFERENCE_STD: f64 = 0.1;

/// 40 poses of a plastic sample.
fn series() -> ObservationSet {
    let pose = |k: i32| Pose::from_deg(-20.0 + 10.0 * f64::from(k / 8), 45.0 * f64::from(k % 8));
    let observations = (0..40)
        .map(|k| Observation::new(pose(k), 0.0, 1.0))
        .collect();
    let background = Prior {
        mean: 0.0,
        std: 0.005,
    };
    let material = Material::exactly(1.54, 0.0);
    let mut set = ObservationSet {
        white_reference: Some(WhiteReference {
            reflectance: 0.99,
            reflectance_std: 0.99 * REFERENCE_STD,
        }),
        ..ObservationSet::bare(RigGeometry::IN_PLANE, material, observations, background)
    };
    let free = Quantity::ALL.to_vec();
    let clean = Problem::new(&set, Variant::Sawtooth, free, TRUTH).predicted(&TRUTH);
    let peak = clean.iter().copied().fold(0.0, f64::max);
    let mut draw = rand_pcg::Pcg64::seed_from_u64(5);
    for (observation, clean) in set.observations.iter_mut().zip(clean) {
        observation.sigma = NOISE * peak;
        observation.signal = clean + NOISE * peak * draw.sample::<f64, _>(StandardNormal);
    }
    set
}

fn fitted(set: &ObservationSet) -> FitReport {
    let options = FitOptions {
        variant: VariantChoice::Sawtooth,
        starts: 3,
        misfit: false,
        ..FitOptions::default()
    };
    let never = AtomicBool::new(false);
    let found = estimate(set, Variant::Sawtooth, &options, None, &never).unwrap();
    report_of(&found, VariantName::Sawtooth)
}

fn value(report: &FitReport, name: &str) -> (f64, f64) {
    let all = report.parameters.named();
    let (_, parameter) = all.iter().find(|(known, _)| *known == name).unwrap();
    (parameter.value.unwrap(), parameter.std.unwrap())
}

#[test]
fn an_error_of_the_white_reference_moves_all_parameters_together() {
    let mut set = series();
    let report = fitted(&set);
    let covariance = report.covariance.as_ref().unwrap();
    // A brighter sample is what a darker reference looks like.
    let step = 0.01;
    for observation in &mut set.observations {
        observation.signal *= 1.0 + step;
    }
    let moved = fitted(&set);
    let names = &covariance.parameters;
    assert!(names.len() >= 6, "{names:?}");
    assert_eq!(covariance.units.len(), names.len());
    assert_eq!(
        (names[0].as_str(), covariance.units[0].as_str()),
        ("theta_r_deg", "deg")
    );
    let std = |i: usize| covariance.values[i][i].sqrt();
    let change =
        |name: &str| (value(&moved, name).0 - value(&report, name).0) * REFERENCE_STD / step;
    for (i, name) in names.iter().enumerate() {
        let own = value(&report, name).1;
        assert!(
            (std(i) / own - 1.0).abs() < 1e-12,
            "{name}: {} for {own}",
            std(i)
        );
        for (j, other) in names.iter().enumerate().take(i) {
            let (found, expected) = (covariance.values[i][j], change(name) * change(other));
            assert_eq!(found, covariance.values[j][i]);
            let size = std(i) * std(j);
            assert!(
                (found - expected).abs() < 0.15 * size,
                "{name}, {other}: correlation {:.3}, expected {:.3}",
                found / size,
                expected / size
            );
        }
    }
    // The parameters do depend on the reference.
    let at = |name: &str| names.iter().position(|known| known == name).unwrap();
    let (rho_d, alpha_u) = (at("rho_d"), at("alpha_u"));
    let correlation = covariance.values[rho_d][alpha_u] / (std(rho_d) * std(alpha_u));
    assert!(correlation.abs() > 0.5, "{correlation}");
}
