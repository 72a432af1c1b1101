//! The solver applied to synthetic pixels with known parameters.

use super::kernel::single;
use super::*;
use crate::geometry::{Pose, RigGeometry};
use crate::map::signals::view::telecentric;
use crate::model::fresnel;

fn solve(job: &Job<'_>) -> Vec<PixelFit> {
    solve_on(Arch::new(), job)
}

/// Pixels with the kernel's own radiances and a Lambert term, and no costly terms.
pub(in crate::map) struct Synthetic {
    pub(in crate::map) geometry: Vec<Geometry>,
    pub(in crate::map) basis: Vec<f64>,
    pub(in crate::map) lamp: f64,
    pub(in crate::map) truth: Vec<Parameters>,
    pub(in crate::map) noise: f64,
}

/// Returns a deterministic standard normal deviate for (pixel, observation).
fn normal_deviate(pixel: usize, observation: usize) -> f64 {
    // Sum of twelve uniforms from a counter-based generator; good to 6σ, which is enough here.
    let mut sum = -6.0;
    for k in 0..12_u64 {
        let mut x = (pixel as u64) << 32 | (observation as u64) << 8 | k;
        for _ in 0..2 {
            x = (x ^ (x >> 31)).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            x = (x ^ (x >> 29)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        }
        sum += (x >> 11) as f64 / (1_u64 << 53) as f64;
    }
    sum
}

impl Synthetic {
    pub(in crate::map) fn new(pixels: usize, noise: f64) -> Self {
        let rig = RigGeometry::IN_PLANE;
        let f = fresnel::reflectance(rig.theta_l.rad().mul_add(0.5, 0.0).cos(), 1.54, 0.0);
        let mut geometry = Vec::new();
        let mut basis = Vec::new();
        for tilt in 0..9 {
            for turn in 0..12 {
                let pose = Pose::from_deg(-20.0 + 5.0 * f64::from(tilt), 30.0 * f64::from(turn));
                let g = telecentric(&rig, pose, f);
                basis.push(g.incident()[2] / std::f64::consts::PI);
                geometry.push(g);
            }
        }
        let truth = (0..pixels)
            .map(|i| {
                let x = i as f64;
                [
                    0.17 + 0.05 * (0.37 * x).sin(),
                    3.0 * (0.11 * x).sin(),
                    0.12_f64.ln() + 0.3 * (0.71 * x).sin(),
                    0.14_f64.ln() + 0.3 * (0.53 * x).cos(),
                    0.35 + 0.1 * (0.23 * x).sin(),
                ]
            })
            .collect();
        Synthetic {
            geometry,
            basis,
            lamp: rig.cones.widening(),
            truth,
            noise,
        }
    }

    pub(in crate::map) fn job(&self) -> Job<'_> {
        Job {
            observations: self.geometry.len(),
            lamp: self.lamp,
            amplitude: false,
            geometry: &self.geometry,
            own_geometry: false,
            refreshes: 0,
            way: Way::Whole,
            pixels: self,
        }
    }
}

impl Pixels for Synthetic {
    fn count(&self) -> usize {
        self.truth.len()
    }

    fn load(
        &self,
        pixel: usize,
        signal: &mut [f64],
        weight: &mut [f64],
        _: &mut [Geometry],
    ) -> Parameters {
        let p = &self.truth[pixel];
        for (j, g) in self.geometry.iter().enumerate() {
            let sigma = self.noise.max(1e-6);
            signal[j] = single(g, p, self.lamp).0
                + p[4] * self.basis[j]
                + self.noise * normal_deviate(pixel, j);
            weight[j] = 1.0 / sigma;
        }
        [p[0] + 0.05, p[1] + 0.3, p[2] + 0.3, p[3] - 0.3, p[4] * 0.7]
    }

    fn costly(&self, _: &Parameters, _: Way, _: &mut Met, offset: &mut [f64], basis: &mut [f64]) {
        offset.fill(0.0);
        basis.copy_from_slice(&self.basis);
    }
}

#[test]
fn exact_data_return_the_parameters() {
    let pixels = Synthetic::new(40, 0.0);
    for (fit, truth) in solve(&pixels.job()).iter().zip(&pixels.truth) {
        assert_eq!(fit.end, End::Converged);
        // σ = 1e-6 of a signal of 0.1: the last step is below 1e-3 σ.
        for k in 0..FREE {
            assert!((fit.p[k] - truth[k]).abs() < 1e-6, "{k}: {fit:?} {truth:?}");
        }
    }
}

/// Pixels away from the centre of a near field: lamp and camera are a tenth of a radian to a side, and diffuse light is
/// proportional to the facets' own cosines.
struct Beside {
    centre: Synthetic,
    own: Vec<Geometry>,
}

impl Pixels for Beside {
    fn count(&self) -> usize {
        self.centre.count()
    }

    fn load(
        &self,
        pixel: usize,
        signal: &mut [f64],
        weight: &mut [f64],
        geometry: &mut [Geometry],
    ) -> Parameters {
        let start = self.centre.load(pixel, signal, weight, &mut []);
        let p = &self.centre.truth[pixel];
        // L = ρd/π · i_m o_m/o_n, by dot products with the facet's normal.
        let normal = [p[0].sin() * p[1].cos(), p[0].sin() * p[1].sin(), p[0].cos()];
        let dot = |w: [f64; 3]| w.iter().zip(&normal).map(|(a, b)| a * b).sum::<f64>();
        for (j, g) in self.own.iter().enumerate() {
            let centre = &self.centre.geometry[j];
            let at = |g: &Geometry| dot(g.incident()) * dot(g.outgoing()) / g.outgoing()[2];
            signal[j] =
                single(g, p, self.centre.lamp).0 + p[4] * self.centre.basis[j] * at(g) / at(centre);
        }
        geometry.copy_from_slice(&self.own);
        start
    }

    fn costly(
        &self,
        p: &Parameters,
        way: Way,
        met: &mut Met,
        offset: &mut [f64],
        basis: &mut [f64],
    ) {
        self.centre.costly(p, way, met, offset, basis);
    }
}

#[test]
fn pixels_with_their_own_directions_return_the_parameters() {
    let centre = Synthetic::new(20, 0.0);
    let aside = |w: [f64; 3]| {
        let w = [w[0] - 0.1, w[1] + 0.07, w[2]];
        let norm = w.iter().map(|x| x * x).sum::<f64>().sqrt();
        w.map(|x| x / norm)
    };
    let own = centre
        .geometry
        .iter()
        .map(|g| Geometry::new(aside(g.incident()), aside(g.outgoing()), 0.045))
        .collect();
    let pixels = Beside { centre, own };
    let job = Job {
        own_geometry: true,
        // The factor on the diffuse light is that of the last recomputation.
        refreshes: 3,
        pixels: &pixels,
        ..pixels.centre.job()
    };
    for (fit, truth) in solve(&job).iter().zip(&pixels.centre.truth) {
        assert_eq!(fit.end, End::Converged);
        for k in 0..FREE {
            // The factor was computed within about one standard deviation of the minimum, at σ = 1e-6.
            assert!((fit.p[k] - truth[k]).abs() < 2e-5, "{k}: {fit:?} {truth:?}");
        }
    }
}

#[test]
fn every_instruction_set_gives_the_same_fit() {
    let pixels = Synthetic::new(30, 1e-3);
    let wide = solve(&pixels.job());
    let narrow = Descent(&pixels.job()).with_simd(pulp::Scalar::new());
    for (a, b) in wide.iter().zip(&narrow) {
        for k in 0..FREE {
            let std = a.covariance.unwrap()[packed(k, k)].sqrt();
            // Both end within 1e-3·√(1 + χ²) ≈ 0.01 σ of the minimum.
            assert!((a.p[k] - b.p[k]).abs() < 0.02 * std, "{k}: {a:?} {b:?}");
        }
    }
}

#[test]
fn stated_standard_deviations_agree_with_repeated_noise() {
    let pixels = Synthetic::new(1500, 2e-3);
    let fits = solve(&pixels.job());
    for k in 0..FREE {
        let mean_square: f64 = fits
            .iter()
            .zip(&pixels.truth)
            .map(|(fit, truth)| {
                let std = fit.covariance.unwrap()[packed(k, k)].sqrt();
                ((fit.p[k] - truth[k]) / std).powi(2)
            })
            .sum::<f64>()
            / fits.len() as f64;
        // χ² of 1500 degrees of freedom, over 1500: 1 ± 4 · √(2/1500); the second order adds 2 %.
        assert!(
            (mean_square - 1.0).abs() < 4.0 * (2.0_f64 / 1500.0).sqrt() + 0.02,
            "{k}: {mean_square}"
        );
    }
    let chi2: f64 = fits.iter().map(|f| f.chi2).sum::<f64>() / fits.len() as f64;
    assert!((chi2 / (108.0 - 5.0) - 1.0).abs() < 0.02, "{chi2}");
}

#[test]
fn masked_observations_have_no_effect_and_too_few_are_reported() {
    struct Masked(Synthetic, usize);
    impl Pixels for Masked {
        fn count(&self) -> usize {
            self.0.count()
        }
        fn load(&self, i: usize, y: &mut [f64], w: &mut [f64], g: &mut [Geometry]) -> Parameters {
            let start = self.0.load(i, y, w, g);
            for j in 0..y.len() {
                if j % self.1 != 0 {
                    (y[j], w[j]) = (1e6, 0.0);
                }
            }
            start
        }
        fn costly(
            &self,
            p: &Parameters,
            way: Way,
            met: &mut Met,
            offset: &mut [f64],
            basis: &mut [f64],
        ) {
            self.0.costly(p, way, met, offset, basis);
        }
    }
    let masked = Masked(Synthetic::new(9, 0.0), 5);
    let job = Job {
        pixels: &masked,
        ..masked.0.job()
    };
    for (fit, truth) in solve(&job).iter().zip(&masked.0.truth) {
        assert_eq!(fit.n_used, 22);
        assert!((fit.p[0] - truth[0]).abs() < 1e-5, "{fit:?}");
    }
    let starved = Masked(Synthetic::new(9, 0.0), 25);
    let job = Job {
        pixels: &starved,
        ..starved.0.job()
    };
    assert!(
        solve(&job)
            .iter()
            .all(|f| f.end == End::TooFew && f.n_used == 5)
    );
}
