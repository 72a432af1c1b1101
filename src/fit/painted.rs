//! Synthetic series computed from the closed forms, for tests of fits.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

use super::problem::{Problem, Quantity, Values};
use crate::geometry::{Pose, RigGeometry};
use crate::material::Material;
use crate::model::Variant;
use crate::observation::{Observation, ObservationSet, Prior, WhiteReference};

/// A typical plastic sample.
pub const TRUTH: Values = Values {
    theta_r: 0.17,
    alpha_u: 0.12,
    alpha_v: 0.15,
    rho_d: 0.3,
    eta: 1.54,
    ..Values::IDEAL
};

/// Plastic on an absolute scale, computed from `truth` with the closed form of the sawtooth. Every observation has the
/// noise `noise`, as a share of the brightest.
pub fn painted(
    poses: impl Iterator<Item = Pose>,
    truth: &Values,
    noise: f64,
    seed: u64,
) -> ObservationSet {
    painted_by(Variant::Sawtooth, poses, truth, noise, seed)
}

/// The same with any of the closed forms.
pub fn painted_by(
    variant: Variant,
    poses: impl Iterator<Item = Pose>,
    truth: &Values,
    noise: f64,
    seed: u64,
) -> ObservationSet {
    let mut set = ObservationSet {
        white_reference: Some(WhiteReference {
            reflectance: 0.99,
            reflectance_std: 0.005,
        }),
        ..ObservationSet::bare(
            RigGeometry::IN_PLANE,
            Material::exactly(1.54, 0.0),
            poses.map(|pose| Observation::new(pose, 0.0, 1.0)).collect(),
            Prior {
                mean: 0.0,
                std: 0.005,
            },
        )
    };
    let free = Quantity::ALL.to_vec();
    let mut problem = Problem::new(&set, variant, free, *truth);
    if truth.real != TRUTH.real {
        problem = problem.with_walls_of(truth);
    }
    let clean = problem.predicted(truth);
    let peak = clean.iter().copied().fold(0.0, f64::max);
    let mut draw = rand_pcg::Pcg64::seed_from_u64(seed);
    for (o, clean) in set.observations.iter_mut().zip(clean) {
        o.sigma = noise * peak;
        o.signal = clean + o.sigma * draw.sample::<f64, _>(StandardNormal);
    }
    set
}
