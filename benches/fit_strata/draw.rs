//! Random synthetic series of the two strata, painted by the closed forms' plain evaluation.

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use ridged::geometry::{Cones, Pose, RigGeometry};
use ridged::material::Material;
use ridged::model::{Optics, Surface, Variant, radiance};
use ridged::observation::{Observation, ObservationSet, Prior, WhiteReference};
use ridged::units::Angle;

/// How hard the series are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stratum {
    /// What a lab meets.
    Ordinary,
    /// α from 1e-4 to 1, αu/αv up to 1000, θr to 60°, offsets to 10°, peak over σ from 3 on, few
    /// azimuths.
    Stiff,
    /// 15 poses: five tilts at 0°, 90° and 180°.
    Paper,
}

/// A stream of random numbers.
pub struct Draw(rand_pcg::Pcg64);

impl Draw {
    pub fn new(seed: u64) -> Self {
        Draw(rand_pcg::Pcg64::seed_from_u64(seed))
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    pub fn log_between(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    pub fn chance(&mut self, share: f64) -> bool {
        self.0.random::<f64>() < share
    }

    pub fn normal(&mut self) -> f64 {
        self.0.sample(StandardNormal)
    }
}

/// What a series was painted with.
#[derive(Debug, Clone, Copy)]
pub struct Truth {
    pub surface: Surface,
    /// Factor on all radiances; 1 where the scale is absolute.
    pub scale: f64,
    pub background: f64,
    pub azimuth_offset: f64,
    pub tilt_offset: f64,
}

/// One series with its truth.
pub struct Case {
    pub variant: Variant,
    pub set: ObservationSet,
    pub truth: Truth,
}

impl Stratum {
    /// A surface and offsets as this stratum draws them.
    pub fn surface(self, draw: &mut Draw, metal: bool) -> (Surface, f64, f64) {
        let degree = 1f64.to_radians();
        let (theta_r, alpha_u, alpha_v, azimuth, tilt);
        match self {
            Stratum::Ordinary | Stratum::Paper => {
                theta_r = draw.between(2.0, 25.0) * degree;
                alpha_u = draw.log_between(0.04, 0.3);
                alpha_v = draw.log_between(0.04, 0.3);
                azimuth = draw.between(-10.0, 10.0) * degree;
                tilt = draw.between(-2.0, 2.0) * degree;
            }
            Stratum::Stiff => {
                theta_r = draw.between(0.0, 60.0) * degree;
                let first = draw.log_between(1e-4, 1.0);
                let least = (first / 1000.0).max(1e-4);
                let second = draw.log_between(least, (first * 1000.0).min(1.0));
                let swap = draw.chance(0.5);
                alpha_u = if swap { first } else { second };
                alpha_v = if swap { second } else { first };
                azimuth = draw.between(-10.0, 10.0) * degree;
                tilt = draw.between(-10.0, 10.0) * degree;
            }
        }
        let rho_d = if metal { 0.0 } else { draw.between(0.05, 0.8) };
        let surface = Surface {
            theta_r,
            alpha_u,
            alpha_v,
            rho_d,
            amplitude: 1.0,
        };
        (surface, azimuth, tilt)
    }

    fn poses(self, draw: &mut Draw) -> Vec<Pose> {
        let (tilts, step, azimuths): (i32, f64, Vec<f64>) = match self {
            Stratum::Paper => (5, 10.0, vec![0.0, 90.0, 180.0]),
            Stratum::Ordinary if draw.chance(0.3) => (5, 10.0, vec![0.0, 90.0, 180.0]),
            Stratum::Ordinary if draw.chance(0.5) => {
                (5, 10.0, (0..8).map(|k| 45.0 * f64::from(k)).collect())
            }
            Stratum::Ordinary => (9, 5.0, (0..12).map(|k| 30.0 * f64::from(k)).collect()),
            Stratum::Stiff => {
                let half = 3 + (draw.between(0.0, 6.0) as i32);
                let count = 2 + (draw.between(0.0, 3.0) as usize);
                let turn = draw.between(20.0, 120.0);
                let azimuths = (0..count).map(|k| turn * k as f64).collect();
                (2 * half + 1, draw.between(3.0, 8.0), azimuths)
            }
        };
        let first = -step * f64::from(tilts - 1) / 2.0;
        (0..tilts)
            .flat_map(|t| {
                let tilt = first + step * f64::from(t);
                azimuths
                    .iter()
                    .map(move |p| Pose::from_deg(tilt, *p))
                    .collect::<Vec<_>>()
            })
            .collect()
    }
}

/// The true pose where a recorded one is off by zeros of tilt and azimuth, rad.
pub fn displaced(pose: Pose, tilt_offset: f64, azimuth_offset: f64) -> Pose {
    Pose {
        theta_c: pose.theta_c + Angle::from_rad(tilt_offset),
        phi_s: pose.phi_s + Angle::from_rad(azimuth_offset),
    }
}

/// Radiance of a surface at a recorded pose, offsets added.
pub fn painted(variant: Variant, set: &ObservationSet, pose: Pose, truth: &Truth) -> f64 {
    let pose = displaced(pose, truth.tilt_offset, truth.azimuth_offset);
    let optics = Optics::new(&set.rig, &set.material);
    let directions = set.rig.directions(pose);
    truth.scale * radiance(variant, &directions, &truth.surface, &optics) + truth.background
}

/// One series; draws again until some light comes back.
pub fn case(stratum: Stratum, seed: u64) -> Case {
    let mut draw = Draw::new(seed);
    loop {
        let metal = draw.chance(0.4);
        let variant = if draw.chance(0.3) {
            Variant::Paper
        } else {
            Variant::Sawtooth
        };
        let beside = draw.chance(0.3);
        let mount = if beside {
            RigGeometry::BESIDE
        } else {
            RigGeometry::IN_PLANE
        };
        let point = stratum == Stratum::Stiff && draw.chance(0.5);
        let rig = RigGeometry {
            cones: Cones::of_lamp(Angle::from_deg(if point { 0.0 } else { 1.0 })),
            ..mount
        };
        let material = if metal {
            Material::exactly(2.9, 3.1)
        } else {
            Material::exactly(1.54, 0.0)
        };
        let absolute = draw.chance(0.5);
        let (surface, azimuth_offset, tilt_offset) = stratum.surface(&mut draw, metal);
        let mut truth = Truth {
            surface,
            scale: if absolute {
                1.0
            } else {
                draw.log_between(0.1, 10.0)
            },
            background: 0.0,
            azimuth_offset,
            tilt_offset,
        };
        let poses = stratum.poses(&mut draw);
        let mut set = ObservationSet {
            white_reference: absolute.then_some(WhiteReference {
                reflectance: 0.99,
                reflectance_std: 0.0,
            }),
            n_frames_used: 100,
            ..ObservationSet::bare(
                rig,
                material,
                Vec::new(),
                Prior {
                    mean: 0.0,
                    std: 1.0,
                },
            )
        };
        let clean: Vec<f64> = poses
            .iter()
            .map(|p| painted(variant, &set, *p, &truth))
            .collect();
        let peak = clean.iter().copied().fold(0.0, f64::max);
        // Less light than this no camera sees.
        if !(peak > 1e-6 * truth.scale && peak.is_finite()) {
            continue;
        }
        let snr = match stratum {
            Stratum::Ordinary | Stratum::Paper => draw.log_between(100.0, 1e4),
            Stratum::Stiff => draw.log_between(3.0, 1e5),
        };
        // Half constant, half growing with the signal as shot noise does.
        let shot = draw.chance(0.5);
        set.background.std = 0.02 * peak;
        truth.background = set.background.std * draw.normal();
        for (pose, clean) in poses.iter().zip(&clean) {
            let share = if shot {
                (0.01 + 0.99 * clean / peak).sqrt()
            } else {
                1.0
            };
            let sigma = peak / snr * share;
            let signal = clean + truth.background + sigma * draw.normal();
            set.observations
                .push(Observation::new(*pose, signal, sigma));
        }
        return Case {
            variant,
            set,
            truth,
        };
    }
}
