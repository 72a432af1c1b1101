//! Best amplitudes of shapes, and the bound on them.

use super::*;
use crate::fit::painted;
use crate::fit::search_setup::free_quantities;
use crate::geometry::{Cones, Pose, RigGeometry};
use crate::material::Material;
use crate::model::Variant;
use crate::observation::{Observation, ObservationSet, Prior};
use crate::units::Angle;

const TRUTH: Values = Values {
    theta_r: 0.3,
    alpha_u: 0.12,
    alpha_v: 0.07,
    rho_d: 0.4,
    scale: 3.0,
    background: 0.01,
    azimuth_offset: 0.1,
    tilt_offset: 0.03,
    eta: 1.54,
    ..Values::IDEAL
};

/// 40 poses, lit beside the tilt plane, computed from the truth.
fn exact() -> ObservationSet {
    let poses = (0..40).map(|k| (10 * (k % 5) - 20, 45 * (k / 5)));
    let mut set = ObservationSet::bare(
        RigGeometry::BESIDE,
        Material::exactly(1.54, 0.0),
        poses
            .map(|(tilt, turn)| {
                Observation::new(Pose::from_deg(f64::from(tilt), f64::from(turn)), 1.0, 0.01)
            })
            .collect(),
        Prior {
            mean: TRUTH.background,
            std: 1.0,
        },
    );
    let (free, _) = free_quantities(&set, Variant::Sawtooth);
    let signals = Problem::new(&set, Variant::Sawtooth, free, TRUTH).predicted(&TRUTH);
    for (o, s) in set.observations.iter_mut().zip(signals) {
        o.signal = s;
    }
    set
}

#[test]
fn a_shape_gets_the_amplitudes_that_the_signals_were_computed_with() {
    let set = exact();
    let (free, fixed) = free_quantities(&set, Variant::Sawtooth);
    let problem = Problem::new(&set, Variant::Sawtooth, free, fixed);
    let mut found = Values {
        scale: 40.0,
        rho_d: 0.9,
        background: -2.0,
        ..TRUTH
    };
    // Light from wall to wall is not linear in ρd, so it takes a few steps of Newton's method.
    for _ in 0..6 {
        found = settle(&problem, &found).1;
    }
    assert!((found.scale / TRUTH.scale - 1.0).abs() < 1e-6, "{found:?}");
    assert!((found.rho_d - TRUTH.rho_d).abs() < 1e-6, "{found:?}");
    assert!((found.background - TRUTH.background).abs() < 1e-6);
}

#[test]
fn amplitudes_stay_inside_their_bounds() {
    let mut set = exact();
    // Darker where the sample is brighter: no positive gain describes that.
    for o in &mut set.observations {
        o.signal = -o.signal;
    }
    set.background.std = 1e-6;
    let (free, fixed) = free_quantities(&set, Variant::Sawtooth);
    let problem = Problem::new(&set, Variant::Sawtooth, free, fixed);
    assert_eq!(settle(&problem, &TRUTH).0, f64::INFINITY);
}

/// Cost of flat facets without diffuse light, for the signals of rougher plastic at a few tilts under a point lamp.
fn cost_of(alpha: f64) -> f64 {
    // The lamp is 10° beside the camera: half vectors at 2.5° and more from the normal.
    let poses = [-2.5, 2.5, 7.5, 12.5].map(|theta_c| Pose {
        theta_c: Angle::from_deg(theta_c),
        phi_s: Angle::ZERO,
    });
    let flat = Values {
        theta_r: 0.0,
        ..painted::TRUTH
    };
    let mut set = painted::painted(poses.into_iter(), &flat, 1e-3, 1);
    set.rig.cones = Cones::of_lamp(Angle::ZERO);
    let shape = Values {
        alpha_u: alpha,
        alpha_v: alpha,
        rho_d: 0.0,
        ..flat
    };
    let free = vec![Quantity::Scale, Quantity::Background];
    let problem = Problem::new(&set, Variant::Sawtooth, free, shape);
    settle(&problem, &shape).0
}

#[test]
fn the_skirt_of_a_lobe_far_from_all_poses_cannot_explain_the_signal() {
    // e^-39 of the top of the lobe, which a real one may still have, and e^-119.
    assert!(cost_of(0.007).is_finite());
    assert_eq!(cost_of(0.004), f64::INFINITY);
}
