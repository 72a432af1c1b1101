//! How sure a fit is, source by source.
//!
//! Around the minimum the estimate is linear in the data: δx = −K δr, K the pseudo-inverse of the
//! weighted derivatives. Every source of error is a change of the residuals and goes through K:
//!
//! - *counting*: the observations' own uncertainties, independent;
//! - *reference*: the white reference's certificate, one number for all;
//! - *angles*: the zeros of the stages beyond the offsets that the fit solves for;
//! - *material*: the nominal index;
//! - *drift*: the lamp between white reference and sample;
//! - *background*: what the prior leaves open of the stray light;
//! - *model*: what the closed form misses. Its errors are smooth over the poses, so the scatter of
//!   the residuals taken as independent would understate them: whole tilts and whole azimuths are
//!   left out in turn (a grouped jackknife, which keeps the correlation within a group); both, the
//!   independent part and a share of what the dearer tier changed combine in quadrature.
//!
//! Shared sources are not fitted: data that the model misses by more than their noise would pull
//! them away from their certificates.

use nalgebra::DMatrix;

use super::covariance::{Covariance, Scaling, covariance};
use super::estimate::Estimate;
use super::least_squares::{householder, solve_upper};
use super::problem::{Problem, Quantity, Values};
use crate::material::Material;

/// Standard uncertainties by source, in the unit of the parameter. They combine in quadrature.
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Budget {
    /// Counting noise of sample and flats.
    pub counting: f64,
    /// The white reference's certificate.
    pub reference: f64,
    /// Zeros of the stages.
    pub angles: f64,
    /// Index of refraction.
    pub material: f64,
    /// Lamp drift.
    pub drift: f64,
    /// Prior on the stray light.
    pub background: f64,
    /// What the model misses.
    pub model: f64,
}

impl Budget {
    /// Combined standard uncertainty.
    #[must_use]
    pub fn combined(&self) -> f64 {
        self.parts().iter().map(|p| p * p).sum::<f64>().sqrt()
    }

    /// The same in another unit.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Budget {
        let f = factor.abs();
        Budget {
            counting: self.counting * f,
            reference: self.reference * f,
            angles: self.angles * f,
            material: self.material * f,
            drift: self.drift * f,
            background: self.background * f,
            model: self.model * f,
        }
    }

    fn parts(&self) -> [f64; 7] {
        [
            self.counting,
            self.reference,
            self.angles,
            self.material,
            self.drift,
            self.background,
            self.model,
        ]
    }
}

/// What is known about the uncertainty of a fit's free parameters.
#[derive(Debug, Clone)]
pub struct Uncertainty {
    /// One budget per free parameter, in the solver's units.
    pub budgets: Vec<Budget>,
    /// Rank test and statistical covariance, weights as fitted.
    pub covariance: Covariance,
    /// Degrees of freedom of the model's part (groups less one).
    pub model_freedom: f64,
}

/// Share of the tier's shift that counts as standard uncertainty: the two-bounce quadrature leaves a
/// third bounce and the diffuse tail out, which is a fraction of what it adds.
const SHARE_OF_TIER_SHIFT: f64 = 0.3;

/// The uncertainty of a fit, source by source.
#[must_use]
pub fn uncertainty(estimate: &Estimate<'_>) -> Uncertainty {
    let problem = &estimate.problem;
    let set = problem.set();
    let m = problem.residual_count();
    let n = problem.free().len();
    let samples = set.observations.len();
    let jacobian = &estimate.minimum.jacobian;
    let covariance = covariance(jacobian, m, &estimate.minimum.residuals, Scaling::Absolute);
    let k = pseudo_inverse(jacobian, &covariance, m, n);
    let sources = Sources::new(problem, &estimate.values);
    let through = |change: &[f64], j: usize| -> f64 { (0..m).map(|i| k[(j, i)] * change[i]).sum() };
    let (by_group, model_freedom) = left_out(estimate, m, n);
    let budgets = (0..n)
        .map(|j| {
            let counting: f64 = (0..m - 1)
                .map(|i| {
                    let share = if i < samples {
                        set.observations[i].sigma / problem.sigma()[i]
                    } else {
                        1.0
                    };
                    (k[(j, i)] * share).powi(2)
                })
                .sum();
            let independent: f64 = (0..samples)
                .map(|i| (k[(j, i)] * estimate.misfit[i] / problem.sigma()[i]).powi(2))
                .sum();
            let tier = SHARE_OF_TIER_SHIFT * estimate.tier_shift[j];
            let model = independent + by_group[j] * by_group[j] + tier * tier;
            Budget {
                counting: counting.sqrt(),
                reference: through(&sources.reference, j).abs(),
                angles: through(&sources.tilt_zero, j).hypot(through(&sources.azimuth_zero, j)),
                material: through(&sources.eta, j).hypot(through(&sources.k, j)),
                drift: through(&sources.drift, j).abs(),
                background: k[(j, m - 1)].abs(),
                model: model.sqrt(),
            }
        })
        .collect();
    Uncertainty {
        budgets,
        covariance,
        model_freedom,
    }
}

/// By how much one standard uncertainty of each shared source changes the weighted residuals.
struct Sources {
    reference: Vec<f64>,
    drift: Vec<f64>,
    tilt_zero: Vec<f64>,
    azimuth_zero: Vec<f64>,
    eta: Vec<f64>,
    k: Vec<f64>,
}

impl Sources {
    fn new(problem: &Problem<'_>, values: &Values) -> Self {
        let set = problem.set();
        let m = problem.residual_count();
        let samples = set.observations.len();
        let zero = vec![0.0; m];
        let mut s = Sources {
            reference: zero.clone(),
            drift: zero.clone(),
            tilt_zero: zero.clone(),
            azimuth_zero: zero.clone(),
            eta: zero.clone(),
            k: zero,
        };
        let (eta_std, k_std) = match set.material {
            Material::Dielectric { eta_std, .. } => (eta_std, 0.0),
            Material::Conductor { eta_std, k_std, .. } => (eta_std, k_std),
        };
        let ready = problem.ready(values);
        for (i, o) in set.observations.iter().enumerate() {
            let g = problem.gradient(i, &ready);
            let weight = 1.0 / problem.sigma()[i];
            // With flats in the fit the certificate acts through them; see below.
            if set.flats.is_empty() {
                s.reference[i] = o.shared.white_reference * weight;
            }
            s.drift[i] = o.shared.led_drift * weight;
            let scaled = values.scale * weight;
            s.tilt_zero[i] = scaled * g.theta_c * o.shared.theta_c_zero.rad();
            s.azimuth_zero[i] = scaled * g.phi_s * o.shared.phi_s_zero.rad();
            s.eta[i] = scaled * g.eta * eta_std;
            s.k[i] = scaled * g.k * k_std;
        }
        if let Some(white) = set.white_reference {
            let tilt_zero = set.observations.first();
            let tilt_zero = tilt_zero.map_or(0.0, |o| o.shared.theta_c_zero.rad());
            for index in 0..set.flats.len() {
                let (cosine, slope) = problem.flat_cosine(index, values);
                let scaled = values.scale / std::f64::consts::PI / problem.flat_sigma()[index];
                s.reference[samples + index] = scaled * cosine * white.reflectance_std;
                s.tilt_zero[samples + index] = scaled * white.reflectance * slope * tilt_zero;
            }
        }
        s
    }
}

/// n × m pseudo-inverse of the derivatives, null directions left out.
fn pseudo_inverse(jacobian: &[f64], covariance: &Covariance, m: usize, n: usize) -> DMatrix<f64> {
    let j = DMatrix::from_column_slice(m, n, jacobian);
    &covariance.matrix * j.transpose()
}

/// Standard uncertainty of each free parameter from leaving out whole tilts and whole azimuths, both
/// in quadrature, with the lesser degrees of freedom.
fn left_out(estimate: &Estimate<'_>, m: usize, n: usize) -> (Vec<f64>, f64) {
    let set = estimate.problem.set();
    let tenth = |deg: f64| (deg * 10.0).round() as i64;
    let tilts: Vec<i64> = set
        .observations
        .iter()
        .map(|o| tenth(o.pose.theta_c.deg()))
        .collect();
    let azimuths: Vec<i64> = set
        .observations
        .iter()
        .map(|o| tenth(o.pose.phi_s.deg()).rem_euclid(3600))
        .collect();
    let mut largest = vec![0.0_f64; n];
    let mut freedom = f64::INFINITY;
    for labels in [tilts, azimuths] {
        let mut names = labels.clone();
        names.sort_unstable();
        names.dedup();
        let groups = names.len() as f64;
        if groups < 3.0 {
            continue;
        }
        let mut sums = vec![0.0; n];
        let mut solved = 0.0;
        for name in &names {
            let keep: Vec<usize> = (0..m)
                .filter(|&i| labels.get(i).is_none_or(|label| label != name))
                .collect();
            if let Some(step) = step_without(estimate, &keep, m, n) {
                for (sum, p) in sums.iter_mut().zip(&step) {
                    *sum += p * p;
                }
                solved += 1.0;
            }
        }
        if solved < 3.0 {
            continue;
        }
        for (all, sum) in largest.iter_mut().zip(&sums) {
            *all = all.hypot(((groups - 1.0) / solved * sum).sqrt());
        }
        freedom = freedom.min(solved - 1.0);
    }
    (largest, freedom)
}

/// One Gauss–Newton step on the kept rows alone, from the minimum of all.
fn step_without(estimate: &Estimate<'_>, keep: &[usize], m: usize, n: usize) -> Option<Vec<f64>> {
    let rows = keep.len();
    if rows <= n {
        return None;
    }
    let jacobian = &estimate.minimum.jacobian;
    let mut a: Vec<f64> = Vec::with_capacity(rows * n);
    for j in 0..n {
        a.extend(keep.iter().map(|&i| jacobian[i + j * m]));
    }
    let mut b: Vec<f64> = keep
        .iter()
        .map(|&i| -estimate.minimum.residuals[i])
        .collect();
    householder(&mut a, rows, n, &mut b);
    solve_upper(&a, rows, n, &mut b).then(|| b[..n].to_vec())
}

/// The free parameters that a null direction ties together, by name; largest part first.
#[must_use]
pub fn tied(free: &[Quantity], direction: &[f64]) -> Vec<Quantity> {
    let mut parts: Vec<(f64, Quantity)> = direction
        .iter()
        .map(|p| p.abs())
        .zip(free.iter().copied())
        .filter(|(p, _)| *p >= 0.05)
        .collect();
    parts.sort_by(|a, b| b.0.total_cmp(&a.0));
    parts.into_iter().map(|(_, q)| q).collect()
}
