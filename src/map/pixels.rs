//! Fits pixels without frames, for the benchmark and for callers with per-pixel observations of their own.
//!
//! Call [`PixelFitter::new`] for a rig, a material and poses, then [`PixelFitter::fit`] for any number of pixels.
//! Camera and lamp are far, the gain is 1 and there is no stray light.

use super::calibration::globals::Globals;
use super::double_reflection::Integrated;
use super::higher_order_terms::Costly;
use super::run::{Batch, Run};
use super::signals::view::View;
use super::solve::End;
use super::solve::kernel::{FREE, packed};
use crate::geometry::{Pose, RigGeometry};
use crate::material::Material;

/// Which vector instructions to use.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Instructions {
    /// The widest that the machine has: 8 pixels at once with AVX-512, 4 with AVX2.
    Widest,
    /// AVX2 with FMA; the widest if the machine has no AVX2.
    Avx2,
    /// One pixel at a time.
    Scalar,
}

impl Instructions {
    fn arch(self) -> pulp::Arch {
        match self {
            Instructions::Widest => pulp::Arch::new(),
            Instructions::Scalar => pulp::Arch::Scalar,
            #[cfg(target_arch = "x86_64")]
            Instructions::Avx2 => {
                pulp::x86::V3::try_new().map_or_else(pulp::Arch::new, pulp::Arch::V3)
            }
            #[cfg(not(target_arch = "x86_64"))]
            Instructions::Avx2 => pulp::Arch::new(),
        }
    }
}

/// One pixel's parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelParameters {
    /// θr and ψ in rad, ln αu, ln αv, and ρd (dielectrics) or amplitude (conductors).
    pub values: [f64; FREE],
    /// Standard deviations for the given σ; `None` if the data do not determine the parameters.
    pub std: Option<[f64; FREE]>,
    /// Weighted sum of squared residuals.
    pub chi2: f64,
    /// Whether the descent ended at a minimum.
    pub converged: bool,
    /// Evaluations of all observations; an evaluation of a subset counts as its share.
    pub evaluations: f32,
}

/// Fits pixels imaged at the same poses.
pub struct PixelFitter {
    view: View,
    costly: Costly,
    globals: Globals,
}

impl PixelFitter {
    /// Takes the true poses of a rig.
    #[must_use]
    pub fn new(rig: RigGeometry, material: Material, poses: Vec<Pose>) -> Self {
        let view = View::far(rig, &material);
        let geometry = poses.iter().map(|p| view.central(*p)).collect();
        PixelFitter {
            costly: Costly::new(rig, material, poses, geometry, Integrated::default()),
            view,
            globals: Globals {
                stray_std: 0.0,
                ..Globals::first(0.0)
            },
        }
    }

    /// Returns the radiances of the full closed form at a pixel's parameters, one per pose.
    #[must_use]
    pub fn radiances(&self, values: &[f64; FREE]) -> Vec<f64> {
        self.costly.full(values)
    }

    /// Returns the difference between integrated and closed-form double reflections at a pixel's parameters, one
    /// radiance per pose. This is the most expensive step before a map's fit.
    #[must_use]
    pub fn lacking(&self, values: &[f64; FREE]) -> Vec<f64> {
        self.costly.lacking(values, true)
    }

    /// Fits pixels from `starts`, one each. `signal` and `sigma` are `[pixel][pose]`; σ = 0 masks. The costly terms are
    /// recomputed `refreshes` times within a descent, and once more after the part of the descent that uses a subset of
    /// the observations.
    ///
    /// # Panics
    /// If the slices do not have poses × starts elements.
    #[must_use]
    pub fn fit(
        &self,
        signal: Vec<f32>,
        sigma: Vec<f32>,
        starts: &[[f64; FREE]],
        refreshes: u8,
        instructions: Instructions,
    ) -> Vec<PixelParameters> {
        let batch = Batch::of_slices(self.costly.poses().len(), signal, sigma);
        assert_eq!(batch.pixels.len(), starts.len(), "every pixel has a start");
        let run = Run {
            batch: &batch,
            globals: &self.globals,
            costly: &self.costly,
            view: &self.view,
            beside: None,
        };
        run.fit_on(instructions.arch(), &batch.pixels, starts, refreshes)
            .iter()
            .map(|fit| PixelParameters {
                values: fit.p,
                std: fit
                    .covariance
                    .map(|c| std::array::from_fn(|k| c[packed(k, k)].sqrt())),
                chi2: fit.chi2,
                converged: fit.end == End::Converged,
                evaluations: fit.evaluations,
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fitter(material: Material, tilts: u32, azimuths: u32) -> PixelFitter {
        let poses = (0..tilts)
            .flat_map(|t| (0..azimuths).map(move |a| (t, a)))
            .map(|(t, a)| {
                Pose::from_deg(
                    -20.0 + 40.0 * f64::from(t) / f64::from(tilts - 1),
                    360.0 * f64::from(a) / f64::from(azimuths),
                )
            })
            .collect();
        PixelFitter::new(RigGeometry::IN_PLANE, material, poses)
    }

    /// The kernel computes only a part of the closed form; with the costly terms recomputed, the fit must end at the
    /// parameters of the full form.
    #[test]
    fn the_fit_ends_at_the_minimum_of_the_full_closed_form() {
        let plastic = Material::Dielectric {
            eta: 1.54,
            eta_std: 0.0,
        };
        // With the larger numbers of poses the descent begins with a subset of the observations.
        for (material, truth, tilts, azimuths) in [
            (plastic, [0.1745, 0.4, -2.12, -2.0, 0.34], 5, 8),
            (plastic, [0.33, 4.0, -1.6, -1.9, 0.5], 5, 8),
            (plastic, [0.1745, 0.4, -2.12, -2.0, 0.34], 9, 12),
            (plastic, [0.33, 4.0, -1.6, -1.9, 0.5], 9, 12),
        ] {
            let fitter = fitter(material, tilts, azimuths);
            assert_eq!(
                fitter.costly.few().is_empty(),
                tilts * azimuths < 72,
                "{tilts} {azimuths}"
            );
            let exact: Vec<f64> = fitter.radiances(&truth);
            let peak = exact.iter().copied().fold(0.0, f64::max);
            let signal: Vec<f32> = exact.iter().map(|x| *x as f32).collect();
            let sigma = vec![(3e-3 * peak) as f32; signal.len()];
            let start = [
                truth[0] + 0.03,
                truth[1] - 0.1,
                truth[2] + 0.1,
                truth[3] - 0.1,
                truth[4] * 0.9,
            ];
            let error = |refreshes: u8| {
                let fit = fitter.fit(
                    signal.clone(),
                    sigma.clone(),
                    &[start],
                    refreshes,
                    Instructions::Widest,
                )[0];
                assert!(fit.converged, "{fit:?}");
                let std = fit.std.unwrap();
                (0..FREE)
                    .map(|k| ((fit.values[k] - truth[k]) / std[k]).abs())
                    .fold(0.0, f64::max)
            };
            // 3e-3 of the peak is the photon noise of 10⁵ electrons. The error of the cells' expansion and of the last
            // recomputation stays below half of a pixel's standard deviation at that noise.
            let (with, without) = (error(3), error(0));
            assert!(with < 0.5, "{material:?}: {with} {without}");
            // After a descent with a subset the terms are recomputed in any case.
            let shown = !fitter.costly.few().is_empty();
            assert!(shown || with < without, "{material:?}: {with} {without}");
        }
    }
}
