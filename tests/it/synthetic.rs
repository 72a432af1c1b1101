//! Fits of random samples painted by the two-bounce quadrature, on rigs with offsets, stray light, a
//! white reference and an index that are off by what their certificates allow.

use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use ridged::fit::report::{FitReport, Status, VariantName};
use ridged::fit::{FitOptions, fit};
use ridged::geometry::{Cones, Pose, RigGeometry};
use ridged::material::Material;
use ridged::model::left_out::POLARISATION;
use ridged::model::prepared::OpticsTable;
use ridged::model::quadrature::Quadrature;
use ridged::model::{Optics, Surface};
use ridged::observation::{
    FlatObservation, Observation, ObservationSet, Prior, SharedErrors, WhiteReference,
};
use ridged::units::Angle;

/// A stream of random numbers.
struct Draw(rand_pcg::Pcg64);

impl Draw {
    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    fn normal(&mut self) -> f64 {
        self.0.sample(StandardNormal)
    }
}

struct Case {
    set: ObservationSet,
    truth: Vec<(&'static str, f64)>,
}

const REFLECTANCE: WhiteReference = WhiteReference {
    reflectance: 0.99,
    reflectance_std: 0.005,
};

/// A random sample on a random rig; `poses` are recorded angles.
fn case(seed: u64, poses: &[(f64, f64)]) -> Case {
    case_within(seed, poses, RigGeometry::IN_PLANE.cones, 0.04)
}

/// The same with cones of that breadth and lobes from `alpha` on.
fn case_within(seed: u64, poses: &[(f64, f64)], cones: Cones, alpha: f64) -> Case {
    painted(seed, poses, cones, alpha, true)
}

/// What a seed says of a sample before anything is computed of it; `draw` gives the rest.
struct Sample {
    draw: Draw,
    metal: bool,
    mount: RigGeometry,
    /// Nominal and actual.
    materials: (Material, Material),
    theta_r_deg: f64,
}

impl Sample {
    fn drawn(seed: u64) -> Self {
        let mut draw = Draw(rand_pcg::Pcg64::seed_from_u64(seed));
        let metal = draw.between(0.0, 1.0) < 0.4;
        let beside = draw.between(0.0, 1.0) < 0.3;
        let materials = materials(&mut draw, metal);
        Sample {
            metal,
            mount: if beside {
                RigGeometry::BESIDE
            } else {
                RigGeometry::IN_PLANE
            },
            materials,
            theta_r_deg: draw.between(2.0, 20.0),
            draw,
        }
    }
}

/// The same by nature, or by a renderer that knows no polarisation where light meets plastic.
fn painted(seed: u64, poses: &[(f64, f64)], cones: Cones, alpha: f64, polarised: bool) -> Case {
    let Sample {
        mut draw,
        metal,
        mount,
        materials: (nominal, actual),
        theta_r_deg,
    } = Sample::drawn(seed);
    let rig = RigGeometry { cones, ..mount };
    let surface = Surface {
        theta_r: theta_r_deg.to_radians(),
        alpha_u: alpha * 6f64.powf(draw.between(0.0, 1.0)),
        alpha_v: alpha * 6f64.powf(draw.between(0.0, 1.0)),
        rho_d: if metal { 0.0 } else { draw.between(0.05, 0.7) },
        amplitude: 1.0,
    };
    let azimuth_offset_deg = draw.between(-10.0, 10.0);
    let tilt_offset_deg = draw.between(-1.0, 1.0);
    let directions: Vec<_> = poses
        .iter()
        .map(|(t, p)| rig.directions(Pose::from_deg(t + tilt_offset_deg, p + azimuth_offset_deg)))
        .collect();
    let painter = Quadrature::new(&surface, &OpticsTable::new(&Optics::new(&rig, &actual)))
        .with_polarisation(polarised || metal);
    let radiances = painter.radiances(&directions, 1e-6);
    let peak = radiances.iter().map(|r| r.value).fold(0.0, f64::max);
    let stray_light = 0.02 * peak * draw.between(0.0, 1.0);
    // Signals are scaled as if the reference had its nominal reflectance.
    let white = REFLECTANCE.reflectance + REFLECTANCE.reflectance_std * draw.normal();
    let gain = REFLECTANCE.reflectance / white;
    let observations = poses
        .iter()
        .zip(&radiances)
        .map(|((t, p), l)| {
            // Half a thousandth of noise as path tracers leave it, then counting noise.
            let clean = gain * (l.value * (1.0 + 5e-4 * draw.normal()) + stray_light);
            let sigma = 1e-4 * clean + 1e-6 * peak;
            let signal = clean + sigma * draw.normal();
            Observation {
                pose: Pose::from_deg(*t, *p),
                signal,
                sigma,
                shared: SharedErrors {
                    white_reference: signal * REFLECTANCE.reflectance_std / REFLECTANCE.reflectance,
                    led_drift: signal * 1e-3,
                    detector: 0.0,
                    theta_c_zero: Angle::from_deg(0.02),
                    phi_s_zero: Angle::from_deg(0.02),
                },
                n_frames: 3,
                taken_s: None,
                row: None,
            }
        })
        .collect();
    let flats = (0..9)
        .map(|k| {
            let theta_c = Angle::from_deg(-20.0 + 5.0 * f64::from(k));
            let cosine = rig.cos_incidence(theta_c + Angle::from_deg(tilt_offset_deg));
            let clean = gain * (white / PI * cosine + stray_light);
            FlatObservation {
                theta_c,
                signal: clean * (1.0 + 1e-4 * draw.normal()),
                sigma: 1e-4 * clean,
                times_s: Vec::new(),
            }
        })
        .collect();
    let mut truth = vec![
        ("theta_r_deg", theta_r_deg),
        ("alpha_u", surface.alpha_u),
        ("alpha_v", surface.alpha_v),
        ("background", stray_light),
        ("azimuth_offset_deg", azimuth_offset_deg),
        ("tilt_offset_deg", tilt_offset_deg),
    ];
    if !metal {
        truth.push(("rho_d", surface.rho_d));
    }
    let set = ObservationSet {
        flats,
        white_reference: Some(REFLECTANCE),
        n_frames_used: 300,
        ..ObservationSet::bare(
            rig,
            nominal,
            observations,
            Prior {
                mean: 0.0,
                std: 0.02 * peak,
            },
        )
    };
    Case { set, truth }
}

/// The index as stated and as it is.
fn materials(draw: &mut Draw, metal: bool) -> (Material, Material) {
    if metal {
        let conductor = |eta: f64, k: f64| Material::Conductor {
            eta,
            k,
            eta_std: 0.02,
            k_std: 0.02,
        };
        let actual = conductor(2.9 + 0.02 * draw.normal(), 3.1 + 0.02 * draw.normal());
        (conductor(2.9, 3.1), actual)
    } else {
        let dielectric = |eta: f64| Material::Dielectric {
            eta,
            eta_std: 0.005,
        };
        (dielectric(1.54), dielectric(1.54 + 0.005 * draw.normal()))
    }
}

fn grid(tilts: u32, tilt_step: f64, turns: u32, turn_step: f64) -> Vec<(f64, f64)> {
    (0..tilts)
        .flat_map(|t| {
            let tilt = -20.0 + tilt_step * f64::from(t);
            (0..turns).map(move |p| (tilt, turn_step * f64::from(p)))
        })
        .collect()
}

fn fitted(set: &ObservationSet) -> FitReport {
    fit(set, &FitOptions::default(), &AtomicBool::new(false))
}

#[test]
fn expanded_uncertainties_cover_random_samples_and_stay_small() {
    let grids = [grid(9, 5.0, 12, 30.0), grid(5, 10.0, 8, 45.0)];
    let (mut inside, mut all) = (0, 0);
    let mut outside: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for seed in 0..16 {
        let case = case(seed, &grids[seed as usize % 2]);
        let report = fitted(&case.set);
        assert_eq!(report.status, Status::Converged, "case {seed}");
        assert_eq!(report.variant, VariantName::Sawtooth, "case {seed}");
        for (name, truth) in case.truth {
            let named = report.parameters.named();
            let found = named.into_iter().find(|(n, _)| *n == name);
            let p = found.expect("a parameter of that name").1;
            let value = p.value.expect("it is identifiable");
            let expanded = p.expanded.expect("it is identifiable");
            all += 1;
            if (value - truth).abs() <= expanded {
                inside += 1;
            } else {
                let z = (value - truth) / expanded * 2.0;
                outside.entry(name).or_default().push(z);
            }
            let limit = match name {
                "theta_r_deg" | "tilt_offset_deg" => 0.3,
                "azimuth_offset_deg" => 0.6,
                "alpha_u" | "alpha_v" => 0.04 * value,
                // Half a per cent of the reference acts on a small ρd as a whole.
                "rho_d" => 0.06 * value + 0.003,
                _ => f64::INFINITY,
            };
            assert!(
                expanded <= limit,
                "case {seed} {name}: {expanded} > {limit}"
            );
        }
    }
    // 95.45 % of 105 or so are expected within; 4 standard deviations of the count below that.
    let expected = 0.9545 * f64::from(all);
    let spread = (expected * 0.0455).sqrt();
    assert!(
        f64::from(inside) >= expected - 4.0 * spread,
        "{inside}/{all}: {outside:?}"
    );
    let far = outside.values().flatten().any(|z| z.abs() > 4.0);
    assert!(!far, "{outside:?}");
}

#[test]
fn lobes_narrower_than_the_cones_of_lamp_and_lens_are_reported_apart_from_them() {
    let cones = Cones {
        lamp: Angle::from_deg(2.0),
        lens: Angle::from_deg(5.0),
    };
    // αv = 0.035 behind cones that reach 0.061 as a slope.
    let case = case_within(1, &grid(17, 2.5, 16, 22.5), cones, 0.015);
    let report = fitted(&case.set);
    assert_eq!(report.status, Status::Converged);
    for (name, truth) in case.truth {
        let named = report.parameters.named();
        let found = named.into_iter().find(|(n, _)| *n == name);
        let p = found.expect("a parameter of that name").1;
        let (value, expanded) = (p.value.expect(name), p.expanded.expect(name));
        // Of seven parameters one may well lie beyond two standard uncertainties, none beyond three.
        assert!(
            (value - truth).abs() <= 1.5 * expanded,
            "{name}: {value} ± {expanded}, not {truth}"
        );
    }
    let left_out = |what: &str| report.left_out.iter().any(|l| l.what.contains(what));
    assert!(!left_out("cone"), "{:?}", report.left_out);
}

#[test]
fn too_few_poses_and_bad_numbers_are_statuses() {
    let few = case(1, &grid(2, 10.0, 3, 90.0)).set;
    let report = fitted(&few);
    assert_eq!(report.status, Status::TooFewObservations);
    assert!(
        report
            .parameters
            .named()
            .iter()
            .all(|(_, p)| p.value.is_none())
    );
    let mut broken = case(1, &grid(5, 10.0, 8, 45.0)).set;
    broken.observations[3].signal = f64::NAN;
    assert_eq!(fitted(&broken).status, Status::NotFinite);
}

#[test]
fn steep_plastic_is_read_right_whether_its_light_is_polarised_or_not() {
    let poses = grid(9, 5.0, 12, 30.0);
    let steep_plastic = (0..40).filter(|seed| {
        let sample = Sample::drawn(*seed);
        !sample.metal && sample.theta_r_deg >= 17.0
    });
    let mut read = 0;
    for seed in steep_plastic {
        for polarised in [true, false] {
            let case = painted(seed, &poses, RigGeometry::IN_PLANE.cones, 0.04, polarised);
            let truth = case.truth.iter().find(|(n, _)| *n == "theta_r_deg");
            let truth = truth.expect("each case has its angle").1;
            let report = fitted(&case.set);
            let p = &report.parameters.theta_r_deg;
            let (value, expanded) = (p.value.unwrap(), p.expanded.unwrap());
            assert!(
                (value - truth).abs() <= expanded,
                "case {seed}, {polarised}: {value} {truth}"
            );
            let without = report.left_out.iter().any(|l| l.what == POLARISATION);
            assert_eq!(without, !polarised, "case {seed}");
            read += 1;
        }
    }
    assert!(read >= 4, "{read}");
}

#[test]
fn a_cancelled_fit_says_so() {
    let set = case(2, &grid(5, 10.0, 8, 45.0)).set;
    let report = fit(&set, &FitOptions::default(), &AtomicBool::new(true));
    assert_eq!(report.status, Status::Cancelled);
}

#[test]
fn one_tilt_leaves_nothing_finite_that_it_cannot_determine() {
    // At the single tilt where the half vector is the normal, single reflection does not depend on
    // the azimuth: whatever comes out, no parameter may have a small uncertainty and be wrong.
    let poses: Vec<(f64, f64)> = (0..24).map(|p| (-5.0, 15.0 * f64::from(p))).collect();
    let case = case(3, &poses);
    let report = fitted(&case.set);
    for (name, truth) in case.truth {
        let named = report.parameters.named();
        let p = named
            .into_iter()
            .find(|(n, _)| *n == name)
            .expect("named")
            .1;
        if let (Some(value), Some(std)) = (p.value, p.std) {
            assert!(
                (value - truth).abs() <= 6.0 * std,
                "{name} {value} ± {std}, truth {truth}"
            );
        }
    }
}
