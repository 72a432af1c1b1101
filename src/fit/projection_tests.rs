//! Best amplitudes of shapes, and the bound on them.

use super::*;
use crate::fit::estimate::free_quantities;
use crate::geometry::{Pose, RigGeometry};
use crate::material::Material;
use crate::model::Variant;
use crate::observation::{Observation, ObservationSet, Prior};

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
    k: 0.0,
    real: crate::model::extended::Real::NONE,
};

/// 40 poses, lit beside the tilt plane, computed from the truth.
fn painted() -> ObservationSet {
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
    let set = painted();
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
    let mut set = painted();
    // Darker where the sample is brighter: no positive gain describes that.
    for o in &mut set.observations {
        o.signal = -o.signal;
    }
    set.background.std = 1e-6;
    let (free, fixed) = free_quantities(&set, Variant::Sawtooth);
    let problem = Problem::new(&set, Variant::Sawtooth, free, fixed);
    assert_eq!(settle(&problem, &TRUTH).0, f64::INFINITY);
}
