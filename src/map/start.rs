//! The start of a pixel's descent, without knowledge of the sample's layout.
//!
//! A few pixels spread over the map are compared with templates of every ridge angle, width and lean direction; the
//! best template of each quarter turn is the start of a descent. The results are grouped, and a few leaders represent
//! the groups. Every other pixel starts at the leader that fits it best or, if none does, at its own templates.

use super::kernel::{Geometry, Parameters, difference, single};
use crate::robust;

const THETA_R_DEG: [f64; 6] = [2.5, 6.0, 11.0, 18.0, 28.0, 42.0];
const ALPHA: [f64; 3] = [0.05, 0.12, 0.25];
const LEANS: usize = 16;
/// Starts per pixel: one per quarter turn.
pub(super) const QUARTERS: usize = 4;
/// Largest number of leaders with which every pixel is compared.
pub(super) const LEADERS_MAX: usize = 8;
/// Least share of the fits that makes a group large.
const LARGE: f64 = 0.05;
/// Largest differences of two fits with the same leader: rad, rad, logarithms.
const APART: [f64; 4] = [0.06, 0.4, 0.45, 0.45];

/// Single reflections over all observations for a grid of shapes.
pub(super) struct Templates {
    shapes: Vec<Parameters>,
    predicted: Vec<Vec<f64>>,
    /// Lambert's term, cos θi/π, for ρd = 1.
    lambert: Vec<f64>,
    amplitude: bool,
}

impl Templates {
    pub(super) fn new(geometry: &[Geometry], lamp: f64, amplitude: bool) -> Self {
        let mut shapes = Vec::new();
        for theta_r_deg in THETA_R_DEG {
            for alpha in ALPHA {
                for lean in 0..LEANS {
                    let psi = std::f64::consts::TAU * lean as f64 / LEANS as f64;
                    shapes.push([theta_r_deg.to_radians(), psi, alpha.ln(), alpha.ln(), 0.3]);
                }
            }
        }
        let predicted = shapes
            .iter()
            .map(|p| geometry.iter().map(|g| single(g, p, lamp).0).collect())
            .collect();
        Templates {
            shapes,
            predicted,
            lambert: lambert(geometry),
            amplitude,
        }
    }

    /// Returns the best start in each quarter turn, the best first. `signal` and `weight` (1/σ) are per observation.
    pub(super) fn starts(&self, signal: &[f64], weight: &[f64]) -> [Parameters; QUARTERS] {
        let mut best = [(f64::INFINITY, self.shapes[0]); QUARTERS];
        for (shape, predicted) in self.shapes.iter().zip(&self.predicted) {
            let fit = two_terms(signal, weight, predicted, &self.lambert, self.amplitude);
            let quarter = (shape[1] / std::f64::consts::TAU * QUARTERS as f64) as usize % QUARTERS;
            if fit.chi2 < best[quarter].0 {
                let mut start = *shape;
                start[4] = if self.amplitude {
                    fit.amplitude.clamp(0.05, 10.0)
                } else {
                    fit.diffuse.clamp(0.01, 0.9)
                };
                best[quarter] = (fit.chi2, start);
            }
        }
        best.sort_by(|a, b| a.0.total_cmp(&b.0));
        best.map(|(_, start)| start)
    }

    /// Returns the amplitude of the best template: the gain if there is no white reference.
    pub(super) fn amplitude_of(&self, signal: &[f64], weight: &[f64]) -> Option<f64> {
        self.predicted
            .iter()
            .map(|p| two_terms(signal, weight, p, &self.lambert, self.amplitude))
            .min_by(|a, b| a.chi2.total_cmp(&b.chi2))
            .map(|fit| fit.amplitude)
            .filter(|a| *a > 0.0)
    }
}

/// Returns Lambert's cos θi/π per observation.
pub(super) fn lambert(geometry: &[Geometry]) -> Vec<f64> {
    geometry
        .iter()
        .map(|g| g.incident()[2].max(0.0) / std::f64::consts::PI)
        .collect()
}

struct TwoTerms {
    chi2: f64,
    amplitude: f64,
    diffuse: f64,
}

/// Fits signal = a · predicted + d · lambert by least squares with a, d ≥ 0; d = 0 for metal.
fn two_terms(
    signal: &[f64],
    weight: &[f64],
    predicted: &[f64],
    lambert: &[f64],
    metal: bool,
) -> TwoTerms {
    let (mut pp, mut pl, mut ll, mut py, mut ly, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (((y, w), p), l) in signal.iter().zip(weight).zip(predicted).zip(lambert) {
        let w2 = w * w;
        pp += w2 * p * p;
        pl += w2 * p * l;
        ll += w2 * l * l;
        py += w2 * p * y;
        ly += w2 * l * y;
        yy += w2 * y * y;
    }
    let determinant = pp * ll - pl * pl;
    let (mut a, mut d) = if !metal && determinant > 1e-12 * pp * ll {
        (
            (py * ll - ly * pl) / determinant,
            (ly * pp - py * pl) / determinant,
        )
    } else {
        (py / pp.max(1e-300), 0.0)
    };
    if d < 0.0 {
        (a, d) = (py / pp.max(1e-300), 0.0);
    }
    if a < 0.0 {
        (a, d) = (0.0, if metal { 0.0 } else { ly / ll.max(1e-300) });
    }
    TwoTerms {
        chi2: yy - a * (2.0 * py - a * pp) - d * (2.0 * ly - d * ll) + 2.0 * a * d * pl,
        amplitude: a,
        diffuse: d,
    }
}

/// Returns Σ a b and Σ a a, with four partial sums each: a single one would wait for its last addition.
fn dots(a: &[f64], b: &[f64]) -> (f64, f64) {
    let (mut ab, mut aa) = ([0.0; 4], [0.0; 4]);
    let (mut left, mut right) = (a.chunks_exact(4), b.chunks_exact(4));
    for (a, b) in (&mut left).zip(&mut right) {
        for k in 0..4 {
            ab[k] += a[k] * b[k];
            aa[k] += a[k] * a[k];
        }
    }
    for (a, b) in left.remainder().iter().zip(right.remainder()) {
        ab[0] += a * b;
        aa[0] += a * a;
    }
    (ab.iter().sum(), aa.iter().sum())
}

/// Returns χ² of the best Lambert surface, which is that of a pixel without any lobe.
pub(super) fn lambert_chi2(signal: &[f64], weight: &[f64], lambert: &[f64]) -> f64 {
    let weighted = |x: &[f64]| -> Vec<f64> { x.iter().zip(weight).map(|(x, w)| x * w).collect() };
    let (l, y) = (weighted(lambert), weighted(signal));
    let ((ly, ll), (_, yy)) = (dots(&l, &y), dots(&y, &l));
    yy - ly * ly / ll.max(1e-300)
}

/// A few points of parameter space, each a good start for a group of pixels.
#[derive(Debug, Clone, Default)]
pub(super) struct Leaders {
    pub(super) points: Vec<Parameters>,
    /// Whether a leader's group is too large to be accidental.
    large: Vec<bool>,
    /// Full radiances per leader and observation.
    predicted: Vec<Vec<f64>>,
}

impl Leaders {
    /// Groups fits; the largest groups get leaders.
    pub(super) fn gather(fits: &[Parameters]) -> Leaders {
        let mut groups: Vec<(Parameters, usize)> = Vec::new();
        for p in fits {
            match groups.iter_mut().find(|(leader, _)| near(leader, p)) {
                Some((_, n)) => *n += 1,
                None => groups.push((*p, 1)),
            }
        }
        groups.sort_by_key(|(_, n)| std::cmp::Reverse(*n));
        groups.truncate(LEADERS_MAX);
        let large = |(_, n): &(Parameters, usize)| *n as f64 >= LARGE * fits.len() as f64;
        Leaders {
            large: groups.iter().map(large).collect(),
            points: groups.into_iter().map(|(p, _)| p).collect(),
            predicted: Vec::new(),
        }
    }

    /// Returns the centre of each leader's group.
    pub(super) fn centres(&self, fits: &[Parameters]) -> Vec<Parameters> {
        let centre = |leader: &Parameters| {
            std::array::from_fn(|k| {
                let group = fits.iter().filter(|p| near(leader, p));
                let offsets = group.map(|p| difference(p, leader)[k]);
                leader[k] + robust::median_of_finite(offsets).unwrap_or(0.0)
            })
        };
        self.points.iter().map(centre).collect()
    }

    /// Computes the radiances of each leader.
    pub(super) fn predict(&mut self, full: impl Fn(&Parameters) -> Vec<f64>) {
        self.predicted = self.points.iter().map(full).collect();
    }

    /// Whether the leader of a large group is near this fit.
    pub(super) fn many_like(&self, p: &Parameters) -> bool {
        let mut leaders = self.points.iter().zip(&self.large);
        leaders.any(|(leader, large)| *large && near(leader, p))
    }

    /// Returns the leader that fits best, with its χ² after a common factor is fitted.
    pub(super) fn best(&self, signal: &[f64], weight: &[f64]) -> Option<(Parameters, f64)> {
        self.best_of(signal, weight, |_| true)
    }

    /// As [`Self::best`], among the leaders that `asked` accepts.
    pub(super) fn best_of(
        &self,
        signal: &[f64],
        weight: &[f64],
        asked: impl Fn(&Parameters) -> bool,
    ) -> Option<(Parameters, f64)> {
        let mut best: Option<(Parameters, f64)> = None;
        let seen: Vec<f64> = signal.iter().zip(weight).map(|(y, w)| y * w).collect();
        let (_, yy) = dots(&seen, &seen);
        let mut expected = vec![0.0; seen.len()];
        let leaders = self.points.iter().zip(&self.predicted);
        for (p, predicted) in leaders.filter(|(p, _)| asked(p)) {
            for ((x, m), w) in expected.iter_mut().zip(predicted).zip(weight) {
                *x = m * w;
            }
            let (py, pp) = dots(&expected, &seen);
            let chi2 = yy - py * py / pp.max(1e-300);
            if best.is_none_or(|(_, c)| chi2 < c) {
                best = Some((*p, chi2));
            }
        }
        best
    }
}

/// Whether two fits have the same leader.
pub(super) fn near(a: &Parameters, b: &Parameters) -> bool {
    let apart = difference(a, b);
    apart.iter().zip(APART).all(|(d, most)| d.abs() < most)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaders_are_the_largest_groups_and_azimuth_wraps() {
        let mut fits = Vec::new();
        for i in 0..30 {
            let wobble = 0.002 * f64::from(i % 5);
            fits.push([
                0.17 + wobble,
                0.01 - 0.02 * f64::from(i % 2),
                -2.1,
                -2.1,
                0.3,
            ]);
        }
        for _ in 0..10 {
            fits.push([0.17, 1.57, -2.1, -2.1, 0.3]);
        }
        fits.push([0.5, 3.0, -1.0, -1.0, 0.3]);
        fits.push([0.17, 6.27, -2.1, -2.1, 0.3]);
        let leaders = Leaders::gather(&fits);
        assert_eq!(leaders.points.len(), 3);
        assert!(leaders.points[0][1].abs() < 0.1);
        assert!((leaders.points[1][1] - 1.57).abs() < 1e-12);
    }

    #[test]
    fn the_two_terms_of_a_sum_are_found_and_are_not_negative() {
        let predicted = [1.0, 2.0, 5.0, 0.5];
        let lambert = [0.3, 0.31, 0.29, 0.28];
        let signal: Vec<f64> = predicted
            .iter()
            .zip(&lambert)
            .map(|(p, l)| 0.7 * p + 0.2 * l)
            .collect();
        let fit = two_terms(&signal, &[1.0; 4], &predicted, &lambert, false);
        assert!((fit.amplitude - 0.7).abs() < 1e-9 && (fit.diffuse - 0.2).abs() < 1e-8);
        assert!(fit.chi2.abs() < 1e-9);
        let falling: Vec<f64> = predicted.iter().map(|p| 10.0 - p).collect();
        assert!(two_terms(&falling, &[1.0; 4], &predicted, &lambert, false).amplitude >= 0.0);
    }
}
