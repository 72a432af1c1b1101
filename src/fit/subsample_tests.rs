use super::blocks::{BLOCK, Blocks};
use super::everywhere::SMOOTH;
use std::sync::atomic::AtomicBool;

use super::*;
use crate::fit::least_squares::LeastSquares;
use crate::fit::least_squares::levenberg_marquardt::Settings;
use crate::fit::model_discrepancy::peak;
use crate::fit::problem::{Problem, Values};
use crate::fit::search_setup::free_quantities;
use crate::geometry::RigGeometry;
use crate::material::Material;
use crate::model::{Optics, Surface, Variant, radiance};
use crate::observation::{Prior, WhiteReference};

/// A grid of `tilts` × `turns` poses, each `repeats` times, with a pseudo-random scatter of 1e-3.
fn grid(tilts: usize, turns: usize, repeats: usize, alpha: f64) -> ObservationSet {
    let rig = RigGeometry::IN_PLANE;
    let material = Material::exactly(1.5, 0.0);
    let surface = Surface {
        theta_r: 0.2,
        alpha_u: alpha,
        alpha_v: alpha,
        rho_d: 0.3,
        amplitude: 1.0,
    };
    let optics = Optics::new(&rig, &material);
    let mut observations = Vec::new();
    for repeat in 0..repeats {
        for t in 0..tilts {
            for p in 0..turns {
                let tilt = -20.0 + 40.0 * t as f64 / (tilts - 1) as f64;
                let pose = Pose::from_deg(tilt, 360.0 / turns as f64 * p as f64);
                let clean = if repeat == 0 {
                    radiance(Variant::Sawtooth, &rig.directions(pose), &surface, &optics)
                } else {
                    let first: &Observation = &observations[t * turns + p];
                    first.signal
                };
                let wave = (1.7 * (observations.len() as f64)).sin() * 1.4;
                observations.push(Observation::new(
                    pose,
                    clean * (1.0 + 1e-3 * wave),
                    1e-3 * clean * (1.0 + 0.2 * repeat as f64),
                ));
            }
        }
    }
    ObservationSet {
        white_reference: Some(WhiteReference {
            reflectance: 0.99,
            reflectance_std: 0.005,
        }),
        ..ObservationSet::bare(
            rig,
            material,
            observations,
            Prior {
                mean: 0.0,
                std: 1e-4,
            },
        )
    }
}

fn at_truth(set: &ObservationSet) -> (Problem<'_>, Vec<f64>) {
    let (free, mut values) = free_quantities(set, Variant::Sawtooth);
    (values.theta_r, values.alpha_u, values.alpha_v) = (0.19, 0.12, 0.11);
    values.rho_d = 0.25;
    let problem = Problem::new(set, Variant::Sawtooth, free, values);
    let x = problem.pack(&values);
    (problem, x)
}

/// JᵀJ, Jᵀr and rᵀr.
fn products(m: usize, j: &[f64], r: &[f64]) -> Vec<f64> {
    let columns: Vec<&[f64]> = j.chunks(m).chain(std::iter::once(r)).collect();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum();
    let pairs = columns
        .iter()
        .flat_map(|a| columns.iter().map(move |b| (*a, *b)));
    pairs.map(|(a, b)| dot(a, b)).collect()
}

#[test]
fn the_triangle_of_all_blocks_has_the_products_of_the_whole() {
    let set = grid(50, 90, 1, 0.1);
    let (problem, x) = at_truth(&set);
    let (m, n) = (problem.residual_count(), problem.free().len());
    assert!(set.observations.len() > 2 * BLOCK);
    let (mut r, mut j) = (vec![0.0; m], vec![0.0; m * n]);
    (&problem).evaluate(&x, &mut r, &mut j);
    let (mut r_few, mut j_few) = (vec![0.0; n + 1], vec![0.0; (n + 1) * n]);
    Blocks(&problem).evaluate(&x, &mut r_few, &mut j_few);
    let (whole, few) = (products(m, &j, &r), products(n + 1, &j_few, &r_few));
    for (i, (a, b)) in whole.iter().zip(&few).enumerate() {
        let diagonal = |k: usize| whole[k * (n + 2)].sqrt();
        let size = diagonal(i / (n + 1)) * diagonal(i % (n + 1));
        // Sums of m terms in another order.
        assert!(
            (a - b).abs() <= f64::EPSILON * m as f64 * size,
            "{i}: {a} {b}"
        );
    }
}

#[test]
fn merged_repeats_have_the_same_minimum_and_keep_their_scatter() {
    let set = grid(12, 12, 30, 0.1);
    let merged = merged(&set, Loss::Linear).unwrap();
    assert_eq!(merged.set.observations.len(), 144);
    assert_eq!(merged.within.1, (30 - 1) as f64 * 144.0);
    let never = AtomicBool::new(false);
    let found = [&set, &merged.set].map(|set| {
        let (problem, x) = at_truth(set);
        problem.descend(&x, &Settings::DEFAULT, &never)
    });
    for (a, b) in found[0].parameters.iter().zip(&found[1].parameters) {
        assert!((a - b).abs() < 1e-9 * a.abs().max(1e-3), "{a} {b}");
    }
    // χ² splits into the parts between poses and within poses.
    let split = found[1].cost + merged.within.0;
    assert!((found[0].cost - split).abs() < 1e-9 * split);
    assert!(super::merged(&set, Loss::Tukey).is_none());
}

#[test]
fn representative_observations_cover_every_neighbourhood_and_a_narrow_lobe() {
    let set = grid(73, 72, 1, 0.004);
    let kept = representative(&set).unwrap();
    assert!(kept.len() <= 2 * SPREAD + 128 && kept.windows(2).all(|k| k[0] < k[1]));
    assert_eq!(Some(&kept), representative(&set).as_ref());
    let brightest = (0..set.observations.len())
        .max_by(|a, b| {
            let signal = |i: &usize| set.observations[*i].signal;
            signal(a).total_cmp(&signal(b))
        })
        .unwrap();
    assert!(kept.contains(&brightest));
    let few = subset(&set, &kept);
    for tilt in 0..8 {
        for turn in 0..8 {
            let inside = few.observations.iter().filter(|o| {
                let (t, p) = (o.pose.theta_c.deg(), o.pose.phi_s.deg());
                let (low, left) = (-20.0 + 5.0 * f64::from(tilt), 45.0 * f64::from(turn));
                (low..low + 5.01).contains(&t) && (left..left + 45.0).contains(&p)
            });
            assert!(inside.count() >= 8, "{tilt} {turn}");
        }
    }
    assert!(representative(&subset(&set, &kept)).is_none());
}

#[test]
fn the_reported_interpolation_error_of_a_higher_order_is_right() {
    let set = grid(73, 72, 1, 0.1);
    let (problem, x) = at_truth(&set);
    let values = problem.unpack(&x);
    let smooth = |pose: Pose| {
        let (t, p) = (pose.theta_c.rad(), pose.phi_s.rad());
        0.01 * (8.0 * t).cos() * (1.0 + (2.0 * p).sin())
    };
    let higher_order = |problem: &Problem<'_>, _: &Values| -> Option<Vec<f64>> {
        let observations = &problem.set().observations;
        Some(observations.iter().map(|o| smooth(o.pose)).collect())
    };
    let kept = representative(&set).unwrap();
    let never = AtomicBool::new(false);
    let found = everywhere(&problem, &values, &higher_order, &kept, &never).unwrap();
    let top = peak(&set);
    let squares = set.observations.iter().zip(&found.offsets);
    let squares = squares.map(|(o, f)| ((smooth(o.pose) - f) / top).powi(2));
    let error = (squares.sum::<f64>() / set.observations.len() as f64).sqrt();
    // Estimated from 128 poses.
    assert!(found.nodes.is_some() && error < 1.5 * found.error && error > 0.5 * found.error);
    assert!(found.error <= SMOOTH);
}
