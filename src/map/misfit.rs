//! The model error that all pixels share, and its effect on their parameters.
//!
//! A pixel's own uncertainty is due to its noise, which averages out over many pixels; the model error is the same in
//! all of them. So the residuals of similar pixels are averaged, which leaves mainly the model error. A jackknife
//! over whole tilts and azimuths then estimates its effect on such a pixel, as in the budget of `fit`. Call
//! [`shared_misfit`].

use super::globals::step::rows_of;
use super::kernel::{FREE, Parameters, difference};
use super::run::Run;
use super::solve::PixelFit;
use crate::jackknife::{self, ByGroups};

/// Number of pixels used, and of those around which similar ones are gathered.
const LOOKED_AT: usize = 1000;
const CENTRES: usize = 16;
/// Largest differences of pixels that count as one surface: ridge angle and lean in rad, logarithms of roughness, and
/// the diffuse reflectance or the relative amplitude.
const ALIKE: Parameters = [0.05, 0.15, 0.3, 0.3, 0.2];
/// Fewer pixels do not determine the model error.
const FEW: usize = 16;

/// Returns the standard uncertainty due to the model error in every pixel of the most common surface, in the units of a
/// pixel's covariance; `None` if few pixels are similar or the poses have fewer than three tilts and azimuths.
pub(super) fn shared_misfit(run: &Run<'_>, good: &[(usize, PixelFit)]) -> Option<Parameters> {
    let few: Vec<&(usize, PixelFit)> = good
        .iter()
        .step_by(good.len().div_ceil(LOOKED_AT).max(1))
        .collect();
    let around = |centre: &Parameters| -> Vec<&(usize, PixelFit)> {
        let like = few.iter().filter(|(_, fit)| alike(&fit.p, centre, run));
        like.copied().collect()
    };
    let centres = few.iter().step_by(few.len().div_ceil(CENTRES).max(1));
    let usual = centres
        .map(|(_, fit)| around(&fit.p))
        .max_by_key(Vec::len)
        .filter(|members| members.len() >= FEW)?;
    let n = run.batch.observations;
    let (mut missed, mut weights) = (vec![0.0; n], vec![0.0; n]);
    let mut jacobian = vec![0.0; n * FREE];
    for (pixel, fit) in &usual {
        for (j, row) in rows_of(run, *pixel, &fit.p).enumerate() {
            let weight = row.weight * row.weight;
            weights[j] += weight;
            missed[j] -= weight * row.residual;
            for (k, d) in row.derivatives.iter().enumerate() {
                jacobian[j + k * n] += weight * d;
            }
        }
    }
    // Means over the pixels, with the weight of one pixel: the shift of the mean pixel.
    let mut residuals = vec![0.0; n];
    for j in 0..n {
        if weights[j] > 0.0 {
            let weight = (weights[j] / usual.len() as f64).sqrt();
            residuals[j] = weight * missed[j] / weights[j];
            for k in 0..FREE {
                jacobian[j + k * n] *= weight / weights[j];
            }
        }
    }
    let axes = jackknife::axes(run.poses.iter().copied());
    let ByGroups { std, freedom, .. } = jackknife::by_groups(&axes, &jacobian, &residuals);
    freedom.is_finite().then(|| std::array::from_fn(|k| std[k]))
}

fn alike(a: &Parameters, b: &Parameters, run: &Run<'_>) -> bool {
    let mut most = ALIKE;
    if run.costly.is_amplitude() {
        most[4] *= b[4].abs();
    }
    let apart = difference(a, b);
    apart.iter().zip(most).all(|(d, most)| d.abs() <= most)
}
