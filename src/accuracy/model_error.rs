//! Errors of the closed forms, measured with the tracer.
//!
//! [`SurfaceComparison::of`] traces one surface at the poses of the full scan. It compares the closed form at the true
//! parameters pose by pose, then fits the variants to the traced radiances and compares the results with the truth.

use std::f64::consts::PI;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::full_scan;
use crate::fit::{FitOptions, VariantChoice, fit};
use crate::geometry::{Directions, RigGeometry};
use crate::material::Material;
use crate::model::prepared::{OpticsTable, Prepared};
use crate::model::quadrature::Quadrature;
use crate::model::{Optics, Surface, Variant};
use crate::observation::{FlatObservation, Observation, ObservationSet, Prior, WhiteReference};
use crate::trace::counting::tally::MonteCarloEstimate;
use crate::trace::facets::scattering::{DiffuseBody, Roughness};
use crate::trace::pose_radiance::{RadianceOptions, RidgedSurface};
use crate::trace::rng::{Purpose, RandomStream};
use crate::trace::surfaces::surface_profile::{ProfileError, SurfaceProfile};
use crate::trace::surfaces::worn_ridges::WornRidges;

/// The samples' materials: name, n, k.
pub const MATERIALS: [(&str, f64, f64); 2] = [("plastic", 1.54, 0.0), ("steel", 2.9, 3.1)];

/// Errors of one variant's fit of one surface.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct FittedErrors {
    /// Root mean square residual of the fit, as a share of the peak.
    pub rms: f64,
    /// Fitted less true ridge angle, degrees.
    pub theta_r_deg: f64,
    /// Fitted over true roughness, less 1: along and across the ridges.
    pub alpha: [f64; 2],
    /// Fitted over true diffuse reflectance, less 1; not for metal nor for the printed lobe.
    pub rho_d: Option<f64>,
}

/// Errors of the forms for one surface.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct SurfaceErrors {
    /// Index into [`MATERIALS`].
    pub material: usize,
    /// True ridge angle.
    pub theta_r_deg: f64,
    /// True roughness along and across the ridges.
    pub alpha: f64,
    /// Closed form of the sawtooth at the true parameters less the traced radiance, as a share of the peak, by pose
    /// (azimuths within tilts).
    pub closed: Vec<f64>,
    /// The same with two bounces integrated.
    pub quadrature: Vec<f64>,
    /// Paths per radiance that were traced.
    pub paths: u64,
    /// Root mean square standard error of the tracer, as a share of the peak.
    pub noise: f64,
    /// Fits of the variants paper and sawtooth; `None` where a fit returned no number.
    pub fitted: [Option<FittedErrors>; 2],
}

/// A surface to trace and fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ErrorSurface {
    /// Index into [`MATERIALS`].
    pub material: usize,
    /// Ridge angle.
    pub theta_r_deg: f64,
    /// Roughness along and across the ridges.
    pub alpha: f64,
}

impl ErrorSurface {
    /// Its name in a list of missing surfaces.
    #[must_use]
    pub fn name(&self) -> String {
        let (material, ..) = MATERIALS[self.material];
        format!("{material} of {}° and α {}", self.theta_r_deg, self.alpha)
    }
}

/// A surface, prepared for tracing and comparison.
pub struct SurfaceComparison {
    wanted: ErrorSurface,
    truth: Surface,
    material: Material,
    profile: SurfaceProfile,
}

impl SurfaceComparison {
    const RIG: RigGeometry = RigGeometry::IN_PLANE;

    /// Prepares a surface; `rho_d` is the diffuse reflectance of plastic.
    ///
    /// # Errors
    /// [`ProfileError`] where ridges of that angle have no profile.
    pub fn of(wanted: ErrorSurface, rho_d: f64) -> Result<SurfaceComparison, ProfileError> {
        let (_, eta, k) = MATERIALS[wanted.material];
        let rho_d = if k > 0.0 { 0.0 } else { rho_d };
        let (alpha_u, alpha_v) = (wanted.alpha, wanted.alpha);
        let truth = Surface {
            theta_r: wanted.theta_r_deg.to_radians(),
            alpha_u,
            alpha_v,
            rho_d,
            amplitude: 1.0,
        };
        Ok(SurfaceComparison {
            wanted,
            truth,
            material: material_of(eta, k),
            profile: WornRidges::ideal(truth.theta_r, 1.0).profile()?,
        })
    }

    /// The surface.
    #[must_use]
    pub fn wanted(&self) -> ErrorSurface {
        self.wanted
    }

    /// Traces it with `paths` per radiance and compares. Also returns the seconds of fits and integrals. `None` where
    /// `end` was raised.
    #[must_use]
    pub fn run(&self, paths: u64, seed: u64, end: &AtomicBool) -> Option<(SurfaceErrors, f64)> {
        let go_on = || (!end.load(Ordering::Relaxed)).then_some(());
        let directions: Vec<Directions> = full_scan()
            .poses()
            .map(|pose| Self::RIG.directions(pose))
            .collect();
        let radiances = self.trace(&directions, paths, seed, &go_on)?;
        let all_traced = Instant::now();
        let peak = radiances.iter().map(|r| r.value).fold(0.0, f64::max);
        let table = OpticsTable::new(&Optics::new(&Self::RIG, &self.material));
        let closed = Prepared::new(Variant::Sawtooth, &self.truth, &table);
        let integrated = Quadrature::new(&self.truth, &table).radiances(&directions, 1e-5 * peak);
        go_on()?;
        let against = |value: &dyn Fn(usize) -> f64| -> Vec<f64> {
            let all = radiances.iter().enumerate();
            all.map(|(n, r)| (value(n) - r.value) / peak).collect()
        };
        let square: f64 = radiances.iter().map(|r| (r.std / peak).powi(2)).sum();
        let set = self.observations(&radiances, peak);
        let fitted = [VariantChoice::Paper, VariantChoice::Sawtooth]
            .map(|variant| self.fitted_errors(&set, variant, end));
        // A cancelled fit has no result.
        go_on()?;
        let cell = SurfaceErrors {
            material: self.wanted.material,
            theta_r_deg: self.wanted.theta_r_deg,
            alpha: self.wanted.alpha,
            closed: against(&|n| closed.partials(&directions[n]).value),
            quadrature: against(&|n| integrated[n].value),
            paths,
            noise: (square / radiances.len() as f64).sqrt(),
            fitted,
        };
        Some((cell, all_traced.elapsed().as_secs_f64()))
    }

    fn trace(
        &self,
        directions: &[Directions],
        paths: u64,
        seed: u64,
        go_on: &(dyn Fn() -> Option<()> + Sync),
    ) -> Option<Vec<MonteCarloEstimate>> {
        let Surface {
            alpha_u,
            alpha_v,
            rho_d,
            ..
        } = self.truth;
        let (eta, k) = self.material.index();
        let cos_l = Self::RIG.theta_l.rad().cos();
        let surface = RidgedSurface::new(
            self.profile.clone(),
            Roughness { alpha_u, alpha_v },
            [eta, k],
            (rho_d > 0.0).then(|| DiffuseBody::new(rho_d, eta, 1.0, cos_l)),
        );
        let one = |(n, d): (usize, &Directions)| {
            let options = RadianceOptions {
                paths,
                seed: RandomStream::new(seed, Purpose::Batch, n as u64).bits(),
                cones: Self::RIG.cones,
                polarised: true,
            };
            go_on().map(|()| surface.radiance(d, &options))
        };
        directions.par_iter().enumerate().map(one).collect()
    }

    /// Fits `variant` and compares it with the truth; `None` where the fit returned no number.
    fn fitted_errors(
        &self,
        set: &ObservationSet,
        variant: VariantChoice,
        end: &AtomicBool,
    ) -> Option<FittedErrors> {
        let options = FitOptions {
            variant,
            ..FitOptions::default()
        };
        let report = fit(set, &options, end);
        let (p, alpha) = (&report.parameters, self.wanted.alpha);
        let rho_d = p.rho_d.value.filter(|_| variant != VariantChoice::Paper);
        Some(FittedErrors {
            rms: report.rms_residual?,
            theta_r_deg: p.theta_r_deg.value? - self.wanted.theta_r_deg,
            alpha: [
                p.alpha_u.value? / alpha - 1.0,
                p.alpha_v.value? / alpha - 1.0,
            ],
            rho_d: rho_d.map(|r| r / self.truth.rho_d - 1.0),
        })
    }

    /// The traced radiances as observations with an ideal white reference.
    fn observations(&self, radiances: &[MonteCarloEstimate], peak: f64) -> ObservationSet {
        let scan = full_scan();
        let observations = scan.poses().zip(radiances);
        let flats = scan.tilts().map(|theta_c| {
            let signal = Self::RIG.cos_incidence(theta_c) / PI;
            FlatObservation {
                theta_c,
                signal,
                sigma: 1e-4 * signal,
                times_s: Vec::new(),
            }
        });
        ObservationSet {
            flats: flats.collect(),
            white_reference: Some(WhiteReference {
                reflectance: 1.0,
                reflectance_std: 0.0,
            }),
            n_frames_used: 0,
            ..ObservationSet::bare(
                Self::RIG,
                self.material,
                observations
                    .map(|(pose, r)| Observation::new(pose, r.value, r.std.max(1e-6 * peak)))
                    .collect(),
                Prior {
                    mean: 0.0,
                    std: 1e-4 * peak,
                },
            )
        }
    }
}

fn material_of(eta: f64, k: f64) -> Material {
    if k > 0.0 {
        Material::Conductor {
            eta,
            k,
            eta_std: 0.0,
            k_std: 0.0,
        }
    } else {
        Material::Dielectric { eta, eta_std: 0.0 }
    }
}

/// Root mean square and the pose of the largest deviation.
#[must_use]
pub fn summary(deviations: &[f64]) -> (f64, usize) {
    let square: f64 = deviations.iter().map(|d| d * d).sum();
    let worst = (0..deviations.len())
        .max_by(|a, b| deviations[*a].abs().total_cmp(&deviations[*b].abs()))
        .unwrap_or(0);
    ((square / deviations.len().max(1) as f64).sqrt(), worst)
}
