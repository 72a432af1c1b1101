//! The solver's iterations: error of the parameters against seconds, on data whose truth is exact.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use super::Point;
use crate::fit::problem::{Problem, Quantity, Values};
use crate::fit::solver::{Settings, minimise};
use crate::geometry::{Pose, RigGeometry};
use crate::material::Material;
use crate::model::{Optics, Variant, radiance};
use crate::observation::{Observation, ObservationSet, Prior, SharedErrors, WhiteReference};
use crate::units::Angle;

/// Trial steps after which the error is looked at.
const STEPS: [u64; 16] = [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 20, 30];

pub(super) fn measure(cancel: &AtomicBool, points: &mut Vec<Point>) {
    for (name, misfit) in [("zero residual", 0.0), ("5 % misfit", 0.05)] {
        iterations(name, misfit, cancel, points);
    }
}

fn truth() -> Values {
    Values {
        theta_r: 12f64.to_radians(),
        alpha_u: 0.08,
        alpha_v: 0.11,
        rho_d: 0.3,
        scale: 1.0,
        background: 0.0,
        azimuth_offset: 0.0,
        tilt_offset: 0.0,
        eta: 1.5,
        k: 0.0,
    }
}

fn iterations(name: &str, misfit: f64, cancel: &AtomicBool, points: &mut Vec<Point>) {
    let truth = truth();
    let rig = RigGeometry::IN_PLANE;
    let material = Material::Dielectric {
        eta: truth.eta,
        eta_std: 0.0,
    };
    let optics = Optics::new(&rig, &material);
    let mut observations = Vec::new();
    for t in 0..9 {
        for p in 0..12 {
            let pose = Pose::from_deg(-20.0 + 5.0 * f64::from(t), 30.0 * f64::from(p));
            let clean = radiance(
                Variant::Sawtooth,
                &rig.directions(pose),
                &truth.surface(),
                &optics,
            );
            // A misfit that no parameter explains: up, down, up, ….
            let sign = if (t + p) % 2 == 0 { 1.0 } else { -1.0 };
            observations.push(Observation {
                pose,
                signal: clean * (1.0 + misfit * sign),
                sigma: 1e-3,
                shared: SharedErrors::default(),
                n_frames: 1,
            });
        }
    }
    let set = ObservationSet {
        rig,
        material,
        observations,
        views: Vec::new(),
        flats: Vec::new(),
        white_reference: Some(WhiteReference {
            reflectance: 0.99,
            reflectance_std: 0.005,
        }),
        background: Prior {
            mean: 0.0,
            std: 1e-3,
        },
        region: None,
        region_azimuth: Angle::ZERO,
        n_frames_used: 108,
        rejected_frames: Vec::new(),
        warnings: Vec::new(),
    };
    let free = vec![
        Quantity::ThetaR,
        Quantity::AlphaU,
        Quantity::AlphaV,
        Quantity::RhoD,
        Quantity::AzimuthOffset,
        Quantity::TiltOffset,
    ];
    let problem = Problem::new(&set, Variant::Sawtooth, free, truth);
    let start = Values {
        theta_r: 0.9 * truth.theta_r,
        alpha_u: 0.15,
        alpha_v: 0.15,
        rho_d: 0.2,
        azimuth_offset: 0.05,
        tilt_offset: 0.01,
        ..truth
    };
    let descend = |settings: &Settings, from: &Values| {
        minimise(
            &problem,
            &problem.pack(from),
            &problem.bounds(),
            settings,
            cancel,
        )
    };
    // With a misfit the minimum is not the truth: it is where a descent from the truth itself ends.
    let (goal, reference) = if misfit == 0.0 {
        (problem.pack(&truth), "truth that was put in")
    } else {
        let other = descend(
            &Settings {
                polish_steps: 200,
                ..Settings::default()
            },
            &truth,
        );
        (other.parameters, "minimum reached from the truth")
    };
    for polish_steps in [0, 60] {
        for steps in STEPS {
            let settings = Settings {
                max_iterations: steps,
                polish_steps,
                ..Settings::default()
            };
            let repeats = 20;
            let started = Instant::now();
            let mut found = descend(&settings, &start);
            for _ in 1..repeats {
                found = descend(&settings, &start);
            }
            let seconds = started.elapsed().as_secs_f64() / f64::from(repeats);
            let off = found
                .parameters
                .iter()
                .zip(&goal)
                .map(|(a, b)| (a - b).abs());
            let error = off.fold(0.0, f64::max).max(f64::EPSILON / 4.0);
            points.push(Point {
                scene: format!("fit, {name}"),
                method: if polish_steps == 0 {
                    "Levenberg–Marquardt"
                } else {
                    "with Gauss–Newton polish"
                }
                .to_owned(),
                seconds,
                error,
                quantity: "largest error of a parameter (rad, ln α, ρd)".to_owned(),
                reference: reference.to_owned(),
            });
        }
    }
}
