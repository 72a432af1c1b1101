//! The observation model: its directions, its symmetry, its derivatives.

use super::*;
use crate::fit::least_squares::LeastSquares;
use crate::geometry::{Pose, RigGeometry};
use crate::model::radiance_gradient;
use crate::observation::{Observation, View};
use crate::units::Angle;

fn set() -> ObservationSet {
    let poses = [(-20.0, 0.0), (3.0, 40.0), (15.0, 200.0), (0.0, 330.0)];
    ObservationSet {
        region_azimuth: Angle::from_deg(90.0),
        ..ObservationSet::bare(
            RigGeometry {
                light_azimuth: Angle::from_deg(70.0),
                azimuth_zero: Angle::from_deg(33.0),
                ..RigGeometry::IN_PLANE
            },
            Material::Dielectric {
                eta: 1.54,
                eta_std: 0.005,
            },
            poses
                .iter()
                .map(|(t, p)| Observation::new(Pose::from_deg(*t, *p), 0.1, 0.01))
                .collect(),
            Prior {
                mean: 0.0,
                std: 0.01,
            },
        )
    }
}

const VALUES: Values = Values {
    theta_r: 0.17,
    alpha_u: 0.12,
    alpha_v: 0.1,
    rho_d: 0.3,
    scale: 1.1,
    background: 0.002,
    azimuth_offset: 0.05,
    tilt_offset: -0.01,
    eta: 1.55,
    ..Values::IDEAL
};

#[test]
fn offsets_by_angle_sums_give_the_directions_of_the_rig() {
    let set = set();
    let p = Problem::new(&set, Variant::Sawtooth, Quantity::ALL.to_vec(), VALUES);
    let ready = p.ready(&VALUES);
    for (i, o) in set.observations.iter().enumerate() {
        let pose = Pose {
            theta_c: o.pose.theta_c + Angle::from_rad(VALUES.tilt_offset),
            phi_s: o.pose.phi_s + Angle::from_rad(VALUES.azimuth_offset) + set.region_azimuth,
        };
        let expected = set.rig.directions(pose);
        let found = p.directions(i, &ready);
        assert!((found.incident - expected.incident).norm() < 1e-15);
        assert!((found.outgoing - expected.outgoing).norm() < 1e-15);
        let surface = VALUES.surface();
        let material = Material::Dielectric {
            eta: VALUES.eta,
            eta_std: 0.005,
        };
        let by_model = radiance_gradient(Variant::Sawtooth, &set.rig, pose, &surface, &material);
        let g = p.gradient(i, &ready);
        assert!((g.value - by_model.value).abs() < 1e-13 * by_model.value);
        assert!((g.phi_s - by_model.phi_s).abs() < 1e-11 * by_model.value);
    }
}

#[test]
fn views_with_the_directions_of_the_rig_only_change_the_weight() {
    let far = set();
    let mut near = set();
    near.views = far
        .observations
        .iter()
        .map(|o| {
            let directions = far.rig.rig_directions(o.pose.theta_c);
            let view = |weight| View { directions, weight };
            vec![view(0.3), view(0.9)]
        })
        .collect();
    let a = Problem::new(&far, Variant::Sawtooth, Quantity::ALL.to_vec(), VALUES);
    let b = Problem::new(&near, Variant::Sawtooth, Quantity::ALL.to_vec(), VALUES);
    let ready = a.ready(&VALUES);
    for i in 0..far.observations.len() {
        let (f, n) = (a.gradient(i, &ready), b.gradient(i, &ready));
        for (f, n) in [
            (f.value, n.value),
            (f.theta_c, n.theta_c),
            (f.phi_s, n.phi_s),
            (f.alpha_v, n.alpha_v),
        ] {
            // Views are summed with the digits of a register.
            assert!((1.2 * f - n).abs() < 1e-6 * f.abs().max(1e-3), "{f} {n}");
        }
    }
}

#[test]
fn a_negative_ridge_angle_is_the_same_surface_rotated_by_180_degrees() {
    let set = set();
    let p = Problem::new(&set, Variant::Sawtooth, Quantity::ALL.to_vec(), VALUES);
    let values = Values {
        wedge: 0.02,
        ..VALUES
    };
    let mut turned = values;
    turned.theta_r = -turned.theta_r;
    turned.azimuth_offset += PI;
    turned.wedge = -turned.wedge;
    let (a, b) = (p.predicted(&values), p.predicted(&turned));
    assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-12));
    let back = turned.folded();
    assert!((back.theta_r - VALUES.theta_r).abs() < 1e-15);
    assert!((back.azimuth_offset - VALUES.azimuth_offset).abs() < 1e-12);
}

#[test]
fn the_jacobian_is_the_slope_of_the_residuals() {
    let set = set();
    let mut all = Quantity::ALL.to_vec();
    all.extend([Quantity::Eta, Quantity::Wedge, Quantity::LampTurn]);
    let n = all.len();
    for (variant, extended) in [
        (Variant::Paper, false),
        (Variant::Sawtooth, false),
        (Variant::Sawtooth, true),
    ] {
        for sign in [1.0, -1.0] {
            let mut values = VALUES;
            values.theta_r *= sign;
            values.wedge = 0.02;
            values.lamp_turn = -0.05;
            let mut p = Problem::new(&set, variant, all.clone(), values);
            if extended {
                p = p.with_walls_of(&values);
            }
            let x = p.pack(&values);
            let m = p.residual_count();
            let (mut r, mut j) = (vec![0.0; m], vec![0.0; m * n]);
            (&p).evaluate(&x, &mut r, &mut j);
            for k in 0..n {
                let at = |h: f64| {
                    let mut moved = x.clone();
                    moved[k] += h;
                    let (mut r, mut j) = (vec![0.0; m], vec![0.0; m * n]);
                    (&p).evaluate(&moved, &mut r, &mut j);
                    r
                };
                // Fourth-order differences: truncation h⁴, rounding 1e-16/h.
                let h = 1e-4;
                let (a, b, c, d) = (at(-2.0 * h), at(-h), at(h), at(2.0 * h));
                for i in 0..m {
                    let slope = (a[i] - 8.0 * b[i] + 8.0 * c[i] - d[i]) / (12.0 * h);
                    let found = j[i + k * m];
                    let size = 1.0 + found.abs();
                    assert!(
                        (slope - found).abs() < 1e-6 * size,
                        "{i} {k}: {slope} {found}"
                    );
                }
            }
        }
    }
}
