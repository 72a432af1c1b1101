//! Radiance of a ridged surface for one pose of the rig, by path tracing: the reference for the
//! closed forms.
//!
//! The function to call is [`RidgedSurface::radiance`]. Paths start at the camera and are connected
//! to the lamp at every hit; by reciprocity this is the light that reaches the camera. Light that a
//! narrow lobe reflects from the lamp onto a diffuse wall would rarely be found that way, so it is
//! traced from the lamp; each path is counted by exactly one of the two methods. All orders of
//! scattering between facets and risers are included: Beckmann roughness below the profile (one
//! microfacet per hit, Smith's masking), and on dielectrics a Lambert body under the Fresnel
//! boundary. With polarisation, the lamp is unpolarised and the camera insensitive to polarisation;
//! each bounce polarises the light for the next ones.
//!
//! *Conditioning.* Contributions are positive and are summed by replicates, so there is no
//! cancellation: narrow lobes (α down to 1e-6) and grazing poses give noise, which the standard
//! error covers, not rounding errors.

mod path;
mod uniform_points;

use rayon::prelude::*;

use super::counting::tally::MonteCarloEstimate;
use super::facets::scattering::{DiffuseBody, Roughness};
use super::facets::tails::Tailed;
use super::photons::light::ScalarState;
use super::photons::stokes::StokesState;
use super::surfaces::surface_profile::SurfaceProfile;
use super::vec3::V3;
use crate::geometry::{Cones, Directions};
use crate::model::polarisation::{Boundary, Channel};
use crate::model::rough_boundary::RoughBoundary;
use path::{End, PathTask};
use uniform_points::UniformPoints;

/// A ridged sample as the tracer uses it.
#[derive(Debug, Clone)]
pub struct RidgedSurface {
    /// Its profile across the ridges.
    pub profile: SurfaceProfile,
    /// Roughness of the facets below the profile.
    pub roughness: Roughness,
    /// Refractive index, for light from air.
    pub boundary: Boundary,
    /// Diffuse light from the body.
    pub diffuse: Option<DiffuseBody>,
    /// Transmission of that light through the rough boundary, relative to Fresnel's transmittance.
    entrance: RoughBoundary,
    /// Points at which the light of a translucent body leaves.
    exits: UniformPoints,
    /// The slopes of the facets.
    slopes: Tailed,
    /// Real part of the index.
    index: f64,
}

/// Options of a traced radiance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RadianceOptions {
    /// Paths from the camera.
    pub paths: u64,
    /// Seed of all random numbers.
    pub seed: u64,
    /// The cones of lamp and lens, over which the radiance is averaged.
    pub cones: Cones,
    /// Whether polarisation is followed between bounces.
    pub polarised: bool,
}

/// Number of replicates, whose spread gives the standard error.
const BATCHES: u64 = 64;
impl RidgedSurface {
    /// Makes a sample with rough facets under a boundary of index n + ik, with or without diffuse
    /// light.
    #[must_use]
    pub fn new(
        profile: SurfaceProfile,
        roughness: Roughness,
        [n, k]: [f64; 2],
        diffuse: Option<DiffuseBody>,
    ) -> Self {
        let entrance = match diffuse {
            Some(_) => RoughBoundary::new(roughness.alpha_u, roughness.alpha_v, 0.0, n),
            None => RoughBoundary::smooth(),
        };
        RidgedSurface {
            exits: UniformPoints::over(&profile),
            slopes: Tailed {
                roughness,
                tail: 0.0,
            },
            index: n,
            profile,
            roughness,
            boundary: Boundary::new(1.0, n, k),
            diffuse: diffuse.map(|body| body.under(&entrance, n)),
            entrance,
        }
    }

    /// Returns the sample with a tail ι of its slopes ([`crate::model::extended::slopes`]); 0 is
    /// Beckmann.
    #[must_use]
    pub fn with_tail(mut self, tail: f64) -> Self {
        let n = self.index;
        self.slopes.tail = tail;
        if let Some(body) = &mut self.diffuse {
            let was = self.entrance.clone();
            let Roughness { alpha_u, alpha_v } = self.roughness;
            self.entrance = RoughBoundary::new(alpha_u, alpha_v, tail, n);
            let ratio = |cos: f64| was.transmittance(cos, n) / self.entrance.transmittance(cos, n);
            let [first, second] = body.cosines.map(ratio);
            body.strength *= first * second;
        }
        self
    }

    /// Transmission of the boundary along a direction in the facet's frame: that of a smooth
    /// boundary, and the factor of the rough one.
    fn passing(&self, w: &V3) -> (Channel, f64) {
        let smooth = self.boundary.at(w[2].clamp(1e-12, 1.0)).refracted;
        let share = smooth.unpolarised().max(f64::MIN_POSITIVE);
        let more = self.entrance.excess(w[0], w[1], w[2]) / share;
        (smooth, 1.0 + more)
    }

    /// Radiance towards `directions.outgoing` for irradiance 1 on a surface facing the lamp, in
    /// sr⁻¹, with its standard error; 0 if lamp or camera is below the surface.
    #[must_use]
    pub fn radiance(
        &self,
        directions: &Directions,
        options: &RadianceOptions,
    ) -> MonteCarloEstimate {
        let incident: V3 = directions.incident.into();
        let outgoing: V3 = directions.outgoing.into();
        if incident[2] <= 0.0 || outgoing[2] <= 0.0 {
            return MonteCarloEstimate {
                value: 0.0,
                std: 0.0,
            };
        }
        let paths = options.paths.div_ceil(BATCHES).max(1);
        let means: Vec<f64> = (0..BATCHES)
            .into_par_iter()
            .map(|batch| {
                let from = |start: End| {
                    let task = PathTask {
                        surface: self,
                        start,
                        incident,
                        outgoing,
                        options,
                    };
                    if options.polarised {
                        task.batch::<StokesState>(batch, paths)
                    } else {
                        task.batch::<ScalarState>(batch, paths)
                    }
                };
                let camera = from(End::Camera);
                if self.diffuse.is_none() {
                    return camera;
                }
                camera + from(End::Lamp)
            })
            .collect();
        let n = BATCHES as f64;
        let mean = means.iter().sum::<f64>() / n;
        let spread: f64 = means.iter().map(|m| (m - mean).powi(2)).sum();
        MonteCarloEstimate {
            value: mean,
            std: (spread / (n * (n - 1.0))).sqrt(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Pose, RigGeometry};

    struct Sample {
        series: &'static str,
        theta_r_deg: f64,
        alpha: (f64, f64),
        index: (f64, f64),
        rho_d: Option<f64>,
        rig: RigGeometry,
        polarised: bool,
        /// Compare every n-th row.
        every: usize,
    }

    fn surface(sample: &Sample) -> RidgedSurface {
        let cos_l = sample.rig.theta_l.rad().cos();
        RidgedSurface::new(
            SurfaceProfile::sawtooth(sample.theta_r_deg.to_radians(), 100.0, 0.0).unwrap(),
            Roughness {
                alpha_u: sample.alpha.0,
                alpha_v: sample.alpha.1,
            },
            sample.index.into(),
            sample
                .rho_d
                .map(|rho| DiffuseBody::new(rho, sample.index.0, 1.0, cos_l)),
        )
    }

    /// Deviations from the series' noise-free radiances, in units of both standard errors combined
    /// with 3e-4 of the peak (the series' finite number of phases).
    fn deviations(sample: &Sample) -> Vec<f64> {
        let path = format!("tests/data/series/{}/radiance.csv", sample.series);
        let mut reader = csv::Reader::from_path(path).unwrap();
        let rows: Vec<[f64; 4]> = reader
            .records()
            .map(|r| {
                let r = r.unwrap();
                [0, 1, 3, 4].map(|i| r[i].parse().unwrap())
            })
            .collect();
        let peak = rows.iter().map(|r| r[2]).fold(0.0, f64::max);
        let surface = surface(sample);
        rows.iter()
            .step_by(sample.every)
            .enumerate()
            .map(|(n, row)| {
                let options = RadianceOptions {
                    paths: 10_000,
                    seed: n as u64,
                    cones: sample.rig.cones,
                    polarised: sample.polarised,
                };
                let directions = sample.rig.directions(Pose::from_deg(row[0], row[1]));
                let found = surface.radiance(&directions, &options);
                let sigma = found.std.hypot(row[3]).hypot(3e-4 * peak);
                (found.value - row[2]) / sigma
            })
            .collect()
    }

    fn check(sample: &Sample) {
        let z = deviations(sample);
        let worst = z.iter().fold(0.0f64, |w, z| w.max(z.abs()));
        assert!(z.len() > 8 && worst < 4.5, "{}: {worst}", sample.series);
    }

    #[test]
    fn plastic_ridges_agree_with_an_independent_path_tracer() {
        check(&Sample {
            series: "polymer-10",
            theta_r_deg: 10.0,
            alpha: (0.12, 0.12),
            index: (1.54, 0.0),
            rho_d: Some(0.33725),
            rig: RigGeometry::IN_PLANE,
            polarised: false,
            every: 9,
        });
        check(&Sample {
            series: "paper-rig-full",
            theta_r_deg: 5.0,
            alpha: (0.05, 0.05),
            index: (1.54, 0.0),
            rho_d: Some(0.34395),
            rig: RigGeometry::BESIDE,
            polarised: false,
            every: 11,
        });
    }

    #[test]
    fn steel_ridges_agree_too_but_not_without_polarisation() {
        check(&Sample {
            series: "steel-15",
            theta_r_deg: 15.0,
            alpha: (0.06, 0.18),
            index: (2.9, 3.1),
            rho_d: None,
            rig: RigGeometry::IN_PLANE,
            polarised: true,
            every: 9,
        });
    }

    #[test]
    fn translucent_bodies_tails_and_crests_agree_with_the_closed_form() {
        use crate::model::extended::{Real, Terms, Walls, partials};
        use crate::model::prepared::OpticsTable;
        use crate::model::{Optics, Surface};
        let rig = RigGeometry {
            cones: Cones::of_lamp(crate::units::Angle::from_deg(1.0)),
            ..RigGeometry::IN_PLANE
        };
        let optics = Optics {
            eta: 1.54,
            k: 0.0,
            theta_l: rig.theta_l.rad(),
            cones: rig.cones,
        };
        let ideal = Real::NONE;
        let cases = [
            (
                12.0,
                0.15,
                0.66,
                Real {
                    translucency: 1.0,
                    ..ideal
                },
            ),
            (
                12.0,
                0.15,
                0.66,
                Real {
                    translucency: 0.4,
                    ..ideal
                },
            ),
            (13.0, 0.09, 0.27, Real { tail: 1.0, ..ideal }),
            (13.0, 0.09, 0.27, Real { tail: 0.5, ..ideal }),
            (
                14.0,
                0.09,
                0.29,
                Real {
                    crest: 0.05,
                    ..ideal
                },
            ),
        ];
        for (theta_r_deg, alpha, rho_d, real) in cases {
            let surface = Surface {
                theta_r: f64::to_radians(theta_r_deg),
                alpha_u: alpha,
                alpha_v: alpha,
                rho_d,
                amplitude: 1.0,
            };
            let walls = Walls::new(&surface, &real, &OpticsTable::new(&optics));
            let body = DiffuseBody::new(rho_d, 1.54, 1.0, optics.theta_l.cos());
            let traced = RidgedSurface::new(
                SurfaceProfile::rounded(surface.theta_r, 1.0, [real.crest, 0.0]).unwrap(),
                Roughness {
                    alpha_u: alpha,
                    alpha_v: alpha,
                },
                [1.54, 0.0],
                Some(body.with_translucency(real.translucency)),
            )
            .with_tail(real.tail);
            let poses = [-18.0, -6.0, 6.0, 18.0]
                .into_iter()
                .flat_map(|tilt| [0.0, 60.0, 180.0].map(|turn| Pose::from_deg(tilt, turn)));
            let found: Vec<(f64, MonteCarloEstimate)> = poses
                .enumerate()
                .map(|(n, pose)| {
                    let directions = rig.directions(pose);
                    let terms = Terms::of(&real, &optics, &Real::default());
                    let closed = partials(&directions, &surface, &real, terms, &optics, &walls);
                    let options = RadianceOptions {
                        paths: 1 << 14,
                        seed: n as u64,
                        cones: rig.cones,
                        polarised: false,
                    };
                    (closed.value, traced.radiance(&directions, &options))
                })
                .collect();
            let peak = found.iter().map(|(closed, _)| *closed).fold(0.0, f64::max);
            for (closed, traced) in found {
                // In addition to the noise, the terms that the closed form omits: double
                // reflections and the second order of a crest.
                let allowed = 4.0 * traced.std + 0.006 * peak;
                assert!(
                    (closed - traced.value).abs() < allowed,
                    "{real:?}: {closed} {traced:?} {peak}"
                );
            }
        }
    }
}
