//! Compares the lanes with the scalar problem.

use pulp::Scalar;

use super::*;
use crate::fit::least_squares::LeastSquares;
use crate::fit::least_squares::levenberg_marquardt::Settings;
use crate::fit::problem::Quantity;
use crate::fit::search_setup::free_quantities;
use crate::geometry::{Pose, RigGeometry};
use crate::material::Material;
use crate::model::Variant;
use crate::observation::{FlatObservation, Observation, ObservationSet, Prior, WhiteReference};
use crate::units::Angle;

fn set(metal: bool, beside: bool) -> ObservationSet {
    let observations = (0..60).map(|k| {
        Observation::new(
            Pose::from_deg(
                -20.0 + 10.0 * f64::from(k / 12),
                30.0 * f64::from(k % 12) + 7.0,
            ),
            0.1 + 0.01 * f64::from(k % 7),
            0.01 + 0.001 * f64::from(k % 5),
        )
    });
    ObservationSet {
        flats: (0..5)
            .map(|k| FlatObservation {
                theta_c: Angle::from_deg(-20.0 + 10.0 * f64::from(k)),
                signal: 0.3,
                sigma: 0.01,
                times_s: Vec::new(),
            })
            .collect(),
        white_reference: Some(WhiteReference {
            reflectance: 0.99,
            reflectance_std: 0.005,
        }),
        ..ObservationSet::bare(
            if beside {
                RigGeometry::BESIDE
            } else {
                RigGeometry::IN_PLANE
            },
            if metal {
                Material::exactly(2.9, 3.1)
            } else {
                Material::exactly(1.54, 0.0)
            },
            observations.collect(),
            Prior {
                mean: 0.001,
                std: 0.005,
            },
        )
    }
}

fn problem(set: &ObservationSet) -> Problem<'_> {
    let (free, fixed) = free_quantities(set, Variant::Sawtooth);
    Problem::new(set, Variant::Sawtooth, free, fixed)
}

/// Points on both sides of θr = 0.
fn points(problem: &Problem<'_>) -> Vec<Values> {
    let mut points = Vec::new();
    for (n, theta_r_deg) in [9.0f64, -14.0, 22.0, 3.0].into_iter().enumerate() {
        let mut v = problem.unpack(&vec![0.1; problem.free().len()]);
        v.theta_r = theta_r_deg.to_radians();
        v.alpha_u = 0.1 + 0.03 * n as f64;
        v.alpha_v = 0.2 - 0.03 * n as f64;
        v.rho_d = if problem.free().contains(&Quantity::RhoD) {
            0.3
        } else {
            0.0
        };
        v.scale = 0.9;
        v.background = 0.004;
        v.azimuth_offset = 0.4 * n as f64;
        v.tilt_offset = 0.02 * n as f64 - 0.03;
        points.push(v);
    }
    points
}

/// Radiance below which no pose sees a lobe.
const UNSEEN: f64 = 1e-6;
/// Evaluations of a lane.
const EVALUATIONS: usize = 60;
/// Possible contribution of e⁻⁶⁰ of a lobe to a sum.
const DARK: f64 = 1e-8;

/// Compares cost, gradient and normal matrix of a lane with those of the scalar problem.
fn assert_same(problem: &Problem<'_>, v: &Values, tolerance: f64) {
    let (n, m) = (problem.free().len(), problem.residual_count());
    let columns = columns(problem).expect("no index is free");
    let table = Table::new(problem, columns.clone());
    let (mut r, mut j) = (vec![0.0; m], vec![0.0; m * n]);
    LeastSquares::evaluate(&problem, &problem.pack(v), &mut r, &mut j);
    let state = State::new(&table, v, None);
    let mut sums = vec![0.0; 1 + N + PACKED];
    evaluate(Scalar::new(), &table, &[state], &mut sums);
    let mut gradient: [f64; N] = std::array::from_fn(|a| sums[1 + a]);
    let mut normal: [f64; PACKED] = std::array::from_fn(|k| sums[1 + N + k]);
    let cost = sums[0] + rest(&table, v, &mut gradient, &mut normal);
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
    let column = |k: usize| &j[k * m..(k + 1) * m];
    // A sum of products counts as the size of its largest terms; a lobe beyond e⁻⁶⁰ of its peak as zero.
    let close = |a: f64, b: f64, size: f64| (a - b).abs() <= tolerance * size.max(DARK);
    assert!(
        close(cost, dot(&r, &r), cost),
        "{v:?}: {cost} {}",
        dot(&r, &r)
    );
    for (k, c) in columns.iter().enumerate() {
        let size = (dot(column(k), column(k)) * dot(&r, &r)).sqrt();
        let found = gradient[*c];
        assert!(
            close(found, dot(column(k), &r), size),
            "{v:?} {:?}: {found} {}",
            problem.free()[k],
            dot(column(k), &r)
        );
        for (l, d) in columns.iter().enumerate() {
            let found = normal[packed(*c.max(d), *c.min(d))];
            let size = (dot(column(k), column(k)) * dot(column(l), column(l))).sqrt();
            assert!(close(found, dot(column(k), column(l)), size), "{v:?}");
        }
    }
}

#[test]
fn a_lane_has_the_cost_gradient_and_normal_matrix_of_the_scalar_problem() {
    for (metal, beside) in [(false, false), (true, true), (false, true), (true, false)] {
        let set = set(metal, beside);
        for variant in [Variant::Sawtooth, Variant::Paper] {
            let (free, fixed) = free_quantities(&set, variant);
            let problem = Problem::new(&set, variant, free, fixed);
            // From a nearly flat surface to walls that reflect each other's light, smooth and rough, on both sides of
            // θr = 0.
            let mut lit = 0;
            for k in 0..400u32 {
                let at = |dimension| f64::from(sobol_burley::sample(k, dimension, 5));
                let v = Values {
                    theta_r: 2.0 * (at(0) - 0.5) * 65f64.to_radians(),
                    alpha_u: 0.01f64.powf(at(1)),
                    alpha_v: 0.01f64.powf(at(2)),
                    rho_d: if metal { 0.0 } else { at(3) },
                    scale: 0.3 + at(4),
                    background: 0.01 * at(5),
                    azimuth_offset: 6.0 * (at(6) - 0.5),
                    tilt_offset: 0.5 * (at(7) - 0.5),
                    ..fixed
                };
                // A lobe that no pose sees is rounded to e⁻⁶⁰ of its peak.
                let seen = problem.predicted(&v).into_iter();
                if seen.map(|l| l - v.background).fold(0.0, f64::max) < UNSEEN {
                    continue;
                }
                lit += 1;
                match variant {
                    Variant::Sawtooth => {
                        assert_same(&problem, &v, 2e-6);
                    }
                    Variant::Paper => {
                        assert_same(&problem, &v, 1e-8);
                    }
                }
            }
            assert!(lit > 150, "{variant:?} {metal}: {lit}");
        }
    }
}

#[test]
fn lanes_end_where_the_scalar_descent_ends() {
    let never = AtomicBool::new(false);
    for metal in [false, true] {
        let mut set = set(metal, false);
        let blank = problem(&set);
        let truth = points(&blank)[0];
        let painted = blank.predicted(&truth);
        drop(blank);
        for (o, clean) in set.observations.iter_mut().zip(&painted) {
            o.signal = *clean;
        }
        let problem = problem(&set);
        let starts: Vec<Values> = [-0.03, 0.0, 0.02, 0.04, 0.05]
            .into_iter()
            .map(|away| {
                let mut v = truth;
                v.theta_r += away;
                v.alpha_v *= 1.2;
                v
            })
            .collect();
        let ends =
            descend_together(&problem, &starts, EVALUATIONS, &never).expect("a plain problem");
        let x = problem.pack(&truth);
        let scalar = problem.descend(&x, &Settings::DEFAULT, &never);
        assert_eq!(ends.len(), starts.len());
        for end in ends {
            assert!(
                end.cost <= scalar.cost * (1.0 + 1e-6),
                "{} {}",
                end.cost,
                scalar.cost
            );
        }
    }
}

#[test]
fn the_end_of_a_lane_does_not_depend_on_its_neighbours_and_settled_means_a_minimum() {
    let never = AtomicBool::new(false);
    let mut set = set(false, false);
    let blank = problem(&set);
    let painted = blank.predicted(&points(&blank)[0]);
    drop(blank);
    for (k, (o, clean)) in set.observations.iter_mut().zip(&painted).enumerate() {
        o.signal = clean + 0.005 * ((k % 5) as f64 - 2.0);
    }
    let problem = problem(&set);
    // More starts than lanes, and not a multiple of them.
    let starts: Vec<Values> = (0..21)
        .map(|k| {
            let mut v = points(&problem)[0];
            v.theta_r += 0.02 * f64::from(k % 7);
            v.alpha_u *= 1.0 + 0.2 * f64::from(k / 7);
            v
        })
        .collect();
    let down = |starts: &[Values], evaluations| {
        descend_together(&problem, starts, evaluations, &never).expect("a plain problem")
    };
    let together = down(&starts, 400);
    for (start, end) in starts.iter().zip(&together) {
        assert_eq!(&down(std::slice::from_ref(start), 400)[0], end);
    }
    assert!(together.iter().any(|end| end.ending.is_success()));
    for end in together.iter().filter(|end| end.ending.is_success()) {
        let fine = problem.descend(&end.parameters, &Settings::DEFAULT, &never);
        assert!(
            end.cost - fine.cost <= 1e-6 * end.cost,
            "{end:?} {:?} {} {:?}",
            fine.parameters,
            fine.cost,
            fine.ending
        );
    }
    // After a few steps nothing is settled, and the cost still falls.
    let soon = down(&starts, 3);
    assert!(soon.iter().all(|end| !end.ending.is_success()));
    let falls = soon.iter().zip(&together).all(|(a, b)| b.cost <= a.cost);
    assert!(falls);
}

#[test]
fn problems_that_lanes_do_not_support_are_left_to_the_scalar_solver() {
    let set = set(false, false);
    let never = AtomicBool::new(false);
    let plain = problem(&set);
    let start = points(&plain);
    let corrected = plain.clone().with_correction(vec![1e-3; 60]);
    assert_eq!(
        descend_together(&corrected, &start, EVALUATIONS, &never),
        None
    );
    let mut free = plain.free().to_vec();
    free.push(Quantity::Eta);
    assert_eq!(
        descend_together(&plain.clone().with_free(free), &start, EVALUATIONS, &never),
        None
    );
    let (free, fixed) = free_quantities(&set, Variant::Paper);
    let paper = Problem::new(&set, Variant::Paper, free, fixed);
    assert!(descend_together(&paper, &start, EVALUATIONS, &never).is_some());
}
