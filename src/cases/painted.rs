//! Observations that the closed form of `sawtooth` paints, so their truth is known.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

use super::samples::SampleCase;
use crate::geometry::{Pose, RigGeometry};
use crate::model::{Optics, Variant, radiance};
use crate::observation::{Observation, ObservationSet, Prior, WhiteReference};

/// Tilts from −20° to 20° (a single one at −20°) times azimuths over a full turn, azimuths within tilts.
#[must_use]
pub fn pose_grid(tilts: u32, azimuths: u32) -> Vec<Pose> {
    let tilt_deg = |n: u32| -20.0 + 40.0 * f64::from(n) / f64::from((tilts - 1).max(1));
    let azimuth_deg = |n: u32| 360.0 / f64::from(azimuths) * f64::from(n);
    (0..tilts)
        .flat_map(|t| (0..azimuths).map(move |a| Pose::from_deg(tilt_deg(t), azimuth_deg(a))))
        .collect()
}

/// What is added to the painted signals, relative to each.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PaintedError {
    /// Nothing.
    None,
    /// Normal noise of this standard deviation, from a seed.
    Noise(f64, u64),
    /// Up, down, up, … by this share: a model error that no parameter explains.
    Alternating(f64),
}

/// The standard uncertainty that the observations state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum PaintedSigma {
    /// A share of each signal without its error.
    Relative(f64),
    /// The same for all, in radiance.
    Absolute(f64),
}

/// A scan on an absolute scale, with a white reference.
#[derive(Debug, Clone, Copy)]
pub struct PaintedScan<'a> {
    /// Lamp and camera.
    pub rig: RigGeometry,
    /// The truth.
    pub sample: SampleCase,
    /// One observation each.
    pub poses: &'a [Pose],
    /// Error of the signals.
    pub error: PaintedError,
    /// Stated uncertainty.
    pub sigma: PaintedSigma,
}

impl PaintedScan<'_> {
    /// The observations. Stray light is zero with a prior of 10⁻⁴ of the brightest signal.
    #[must_use]
    pub fn observations(&self) -> ObservationSet {
        let SampleCase { material, surface } = self.sample;
        let optics = Optics::new(&self.rig, &material);
        let seed = match self.error {
            PaintedError::Noise(_, seed) => seed,
            _ => 0,
        };
        let mut random = rand_pcg::Pcg64::seed_from_u64(seed);
        let observations = self.poses.iter().enumerate().map(|(n, pose)| {
            let directions = self.rig.directions(*pose);
            let clean = radiance(Variant::Sawtooth, &directions, &surface, &optics);
            let error = match self.error {
                PaintedError::None => 0.0,
                PaintedError::Noise(std, _) => std * random.sample::<f64, _>(StandardNormal),
                PaintedError::Alternating(share) => share * if n % 2 == 0 { 1.0 } else { -1.0 },
            };
            let sigma = match self.sigma {
                PaintedSigma::Relative(share) => share * clean,
                PaintedSigma::Absolute(sigma) => sigma,
            };
            Observation::new(*pose, clean * (1.0 + error), sigma)
        });
        let observations: Vec<Observation> = observations.collect();
        let peak = observations.iter().map(|o| o.signal).fold(0.0, f64::max);
        let stray_light = Prior {
            mean: 0.0,
            std: 1e-4 * peak,
        };
        ObservationSet {
            white_reference: Some(WhiteReference {
                reflectance: 0.99,
                reflectance_std: 0.005,
            }),
            ..ObservationSet::bare(self.rig, material, observations, stray_light)
        }
    }
}
