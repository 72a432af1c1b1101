//! The shared quantities that the pixels determine.
//!
//! The tilt offset Δθc comes from the pixels: each eliminates its own five parameters (the Schur complement of its normal
//! equations), and the sum of the remainders determines the shared offset. A second quantity comes from the pixels in the
//! same way if they determine it better than the references: the gain if there is no white reference (a dielectric's
//! Fresnel peak is known), and s on a metal, which has no diffuse light, with the value from the flats as its prior.

use super::{Globals, TILT_PRIOR_RAD};
use crate::map::kernel::{FREE, Parameters, packed, single};
use crate::map::run::Run;
use crate::map::solve::PixelFit;
use crate::robust;
use crate::units::Angle;

/// A tilt offset with a larger standard uncertainty is not applied.
const TILT_STD_MAX_RAD: f64 = 0.02;

/// The quantity, besides the tilt offset, that the pixels determine.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::map) enum Second {
    /// None.
    Nothing,
    /// The gain.
    Gain,
    /// The stray light, with a prior from the references.
    Stray {
        /// Mean, radiance.
        prior: f64,
        /// Standard uncertainty.
        prior_std: f64,
    },
}

impl Globals {
    /// Takes one Gauss–Newton step of the tilt offset, and of the second quantity, from fitted pixels. `birge` is their
    /// usual χ² per degree of freedom. Returns the step in Δθc (rad) and that of the second quantity: in ln gain, or in
    /// standard uncertainties of the stray light's prior.
    #[expect(
        clippy::needless_range_loop,
        reason = "matrix indices are the notation"
    )]
    pub(in crate::map) fn step(
        &mut self,
        run: &Run<'_>,
        fits: &[(usize, PixelFit)],
        birge: f64,
        second: Second,
    ) -> [f64; 2] {
        let mut normal = [[0.0; 2]; 2];
        let mut gradient = [0.0; 2];
        normal[0][0] = birge * TILT_PRIOR_RAD.powi(-2);
        gradient[0] = -normal[0][0] * self.tilt_offset.rad();
        for (pixel, fit) in fits {
            let Some(covariance) = &fit.covariance else {
                continue;
            };
            let pulls = Pulls::of(run, *pixel, &fit.p, second);
            for a in 0..2 {
                gradient[a] += pulls.residual[a] - pulls.through(covariance, a, None);
                for b in 0..2 {
                    normal[a][b] += pulls.own[a][b] - pulls.through(covariance, a, Some(b));
                }
            }
        }
        match second {
            Second::Nothing => {
                normal[1] = [0.0, 1.0];
                normal[0][1] = 0.0;
                gradient[1] = 0.0;
            }
            Second::Gain => {}
            Second::Stray { prior, prior_std } => {
                let weight = birge * prior_std.powi(-2);
                normal[1][1] += weight;
                gradient[1] += weight * (prior - self.stray);
            }
        }
        let determinant = normal[0][0] * normal[1][1] - normal[0][1] * normal[1][0];
        let step = [
            (gradient[0] * normal[1][1] - gradient[1] * normal[0][1]) / determinant,
            (gradient[1] * normal[0][0] - gradient[0] * normal[1][0]) / determinant,
        ];
        let tilt_std = (birge * normal[1][1] / determinant).max(0.0).sqrt();
        self.tilt_offset_std = Angle::from_rad(tilt_std);
        // An offset that the pixels do not determine (all at one azimuth, for example) stays at zero.
        let tilt = if tilt_std > TILT_STD_MAX_RAD {
            self.tilt_offset = Angle::ZERO;
            0.0
        } else {
            step[0].clamp(-0.05, 0.05)
        };
        self.tilt_offset += Angle::from_rad(tilt);
        let second_std = (birge * normal[0][0] / determinant).max(0.0).sqrt();
        let second_step = match second {
            Second::Nothing => 0.0,
            Second::Gain => {
                self.gain *= step[1].clamp(-0.3, 0.3).exp();
                self.gain_relative_std = second_std;
                step[1]
            }
            Second::Stray { prior_std, .. } => {
                self.stray += step[1];
                self.stray_std = second_std;
                step[1] / prior_std
            }
        };
        [tilt, second_step]
    }
}

/// One pixel's weighted sums over its observations for Δθc and the second shared quantity (the gain if there is none).
struct Pulls {
    /// Σ tᵀt
    own: [[f64; 2]; 2],
    /// Σ tᵀ · residual
    residual: [f64; 2],
    /// Σ Jᵀ t per parameter.
    cross: [[f64; 2]; FREE],
    /// Σ Jᵀ · residual.
    rest: [f64; FREE],
}

/// One observation of a pixel at given parameters.
pub(in crate::map) struct Row {
    pub weight: f64,
    /// Observed less expected radiance; the observed one is the signal over the gain, less stray light.
    pub residual: f64,
    /// Expected radiance.
    pub full: f64,
    /// Derivatives of the expected radiance.
    pub derivatives: Parameters,
}

/// Returns the observations of a pixel at its parameters; masked ones have weight 0.
pub(in crate::map) fn rows_of(
    run: &Run<'_>,
    pixel: usize,
    p: &Parameters,
) -> impl Iterator<Item = Row> {
    let n = run.batch.observations;
    let (mut signal, mut weight) = (vec![0.0; n], vec![0.0; n]);
    run.read(pixel, &mut signal, &mut weight);
    run.bring_to_centre(pixel, p, None, &mut signal);
    let (mut offset, mut basis) = (vec![0.0; n], vec![0.0; n]);
    run.costly.write(p, &mut offset, &mut basis);
    let (lamp, amplitude) = (run.costly.lamp(), run.costly.is_amplitude());
    let geometry = run.geometry_of(pixel);
    if !run.view.shares_directions() {
        let centres = run.costly.geometry();
        for ((basis, own), centre) in basis.iter_mut().zip(geometry.iter()).zip(centres) {
            *basis *= own.facing_beside(centre, p);
        }
    }
    (0..n).map(move |j| {
        if weight[j] <= 0.0 {
            return Row {
                weight: 0.0,
                residual: 0.0,
                full: 0.0,
                derivatives: [0.0; FREE],
            };
        }
        let (a, s) = single(&geometry[j], p, lamp);
        let full = run.costly.light(p, a, offset[j], basis[j]);
        let (first, last) = match amplitude {
            true => (p[4], a),
            false => (1.0, basis[j]),
        };
        Row {
            weight: weight[j],
            residual: signal[j] - full,
            full,
            derivatives: [first * s[0], first * s[1], first * s[2], first * s[3], last],
        }
    })
}

impl Pulls {
    #[expect(
        clippy::needless_range_loop,
        reason = "matrix indices are the notation"
    )]
    fn of(run: &Run<'_>, pixel: usize, p: &Parameters, second: Second) -> Pulls {
        let cell = run.costly.cell(p);
        let mut pulls = Pulls {
            own: [[0.0; 2]; 2],
            residual: [0.0; 2],
            cross: [[0.0; 2]; FREE],
            rest: [0.0; FREE],
        };
        for (j, row) in rows_of(run, pixel, p).enumerate() {
            let w = row.weight;
            if w <= 0.0 {
                continue;
            }
            let (full, derivatives) = (row.full, row.derivatives);
            // ∂/∂ ln gain, or ∂/∂s, of gain (L + s), in radiance.
            let by_second = match second {
                Second::Stray { .. } => 1.0,
                Second::Gain | Second::Nothing => full + run.globals.stray,
            };
            let t = [w * cell.tilt[j], w * by_second];
            let residual = w * row.residual;
            for x in 0..2 {
                pulls.residual[x] += t[x] * residual;
                for y in 0..2 {
                    pulls.own[x][y] += t[x] * t[y];
                }
            }
            for k in 0..FREE {
                pulls.rest[k] += w * derivatives[k] * residual;
                for x in 0..2 {
                    pulls.cross[k][x] += w * derivatives[k] * t[x];
                }
            }
        }
        pulls
    }

    /// Returns tᵀ J C Jᵀ t for two shared unknowns, or tᵀ J C Jᵀ residual.
    fn through(&self, covariance: &[f64], a: usize, b: Option<usize>) -> f64 {
        let mut sum = 0.0;
        for i in 0..FREE {
            for j in 0..FREE {
                let right = b.map_or(self.rest[j], |b| self.cross[j][b]);
                sum += self.cross[i][a] * covariance[packed(i.max(j), i.min(j))] * right;
            }
        }
        sum
    }
}

/// Returns the shift of a pixel's parameters by one standard uncertainty of each shared quantity:
/// [gain, stray, tilt][parameter].
fn shared_effects(run: &Run<'_>, pixel: usize, fit: &PixelFit) -> Option<[[f64; FREE]; 3]> {
    let covariance = fit.covariance.as_ref()?;
    let pulls = Pulls::of(run, pixel, &fit.p, Second::Gain);
    let mut stray = [0.0; FREE];
    for row in rows_of(run, pixel, &fit.p) {
        for (stray, d) in stray.iter_mut().zip(&row.derivatives) {
            *stray += row.weight * row.weight * d;
        }
    }
    let moved = |pull: [f64; FREE], std: f64| -> [f64; FREE] {
        std::array::from_fn(|i| {
            let sum: f64 = (0..FREE)
                .map(|j| covariance[packed(i.max(j), i.min(j))] * pull[j])
                .sum();
            sum * std
        })
    };
    let globals = run.globals;
    Some([
        moved(
            std::array::from_fn(|k| pulls.cross[k][1]),
            globals.gain_relative_std,
        ),
        moved(stray, globals.stray_std),
        moved(
            std::array::from_fn(|k| pulls.cross[k][0]),
            globals.tilt_offset_std.rad(),
        ),
    ])
}

/// Returns the median effect of the shared quantities on the parameters of pixels, all combined.
pub(in crate::map) fn shared_std(run: &Run<'_>, good: &[(usize, PixelFit)]) -> Option<Parameters> {
    let every = good.len().div_ceil(200).max(1);
    let effects: Vec<Parameters> = good
        .iter()
        .step_by(every)
        .filter_map(|(index, fit)| {
            let parts = shared_effects(run, *index, fit)?;
            Some(std::array::from_fn(|k| {
                parts.iter().map(|p| p[k] * p[k]).sum::<f64>().sqrt()
            }))
        })
        .collect();
    let mut medians = [0.0; FREE];
    for (k, m) in medians.iter_mut().enumerate() {
        *m = robust::median_of_finite(effects.iter().map(|e| e[k]))?;
    }
    Some(medians)
}
