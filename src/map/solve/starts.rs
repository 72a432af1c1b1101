//! The starts of a pixel's descent, without knowledge of the sample's layout.
//!
//! A pixel is compared with the radiances of some surfaces, and the one that fits it best after a common factor is its start.
//! The mean of each cluster of pixels is compared with every ridge angle, width and lean direction, quarter turn by quarter
//! turn. The surfaces found are the leaders: every other pixel starts at one of them or, if none fits it, as a mean does.

use super::kernel::{Geometry, Parameters};

const THETA_R_DEG: [f64; 6] = [2.5, 6.0, 11.0, 18.0, 28.0, 42.0];
const ALPHA: [f64; 3] = [0.05, 0.12, 0.25];
/// Diffuse reflectances, which set the lobe's share of the light; on metal, the amplitude.
const RHO_D: [f64; 2] = [0.1, 0.4];
const AMPLITUDE: [f64; 1] = [1.0];
const LEANS: usize = 16;
/// Starts per pixel: one per quarter turn.
pub(in crate::map) const QUARTERS: usize = 4;
/// Largest number of leaders with which every pixel is compared.
pub(in crate::map) const LEADERS_MAX: usize = 8;

/// A few points of parameter space with their radiances over all observations.
#[derive(Debug, Clone, Default)]
pub(in crate::map) struct Starts {
    pub(in crate::map) points: Vec<Parameters>,
    predicted: Vec<Vec<f64>>,
}

impl Starts {
    /// Takes points; `full` returns the radiances of each.
    pub(in crate::map) fn new(
        points: Vec<Parameters>,
        full: impl Fn(&Parameters) -> Vec<f64>,
    ) -> Starts {
        Starts {
            predicted: points.iter().map(full).collect(),
            points,
        }
    }

    /// Returns a grid of shapes for every quarter turn.
    pub(in crate::map) fn quarters(
        amplitude: bool,
        full: impl Fn(&Parameters) -> Vec<f64>,
    ) -> Vec<Starts> {
        let fifths = if amplitude { &AMPLITUDE[..] } else { &RHO_D };
        let lean = |n: usize| std::f64::consts::TAU * n as f64 / LEANS as f64;
        let of_quarter = |quarter: usize| {
            let mut shapes = Vec::new();
            for psi in (0..LEANS / QUARTERS).map(|n| lean(quarter * LEANS / QUARTERS + n)) {
                for theta_r_deg in THETA_R_DEG {
                    for alpha in ALPHA.map(f64::ln) {
                        let shape =
                            |fifth| [f64::to_radians(theta_r_deg), psi, alpha, alpha, fifth];
                        shapes.extend(fifths.iter().map(|fifth| shape(*fifth)));
                    }
                }
            }
            Starts::new(shapes, &full)
        };
        (0..QUARTERS).map(of_quarter).collect()
    }

    /// Returns a matte surface, which explains a pixel without a lobe.
    pub(in crate::map) fn matte(geometry: &[Geometry]) -> Starts {
        let lambert = geometry.iter().map(|g| g.incident()[2].max(0.0));
        Starts::new(vec![Parameters::default()], |_| lambert.clone().collect())
    }

    /// Returns the best point with its χ² after a common factor is fitted. `signal` and `weight` (1/σ) are per observation.
    pub(in crate::map) fn best(&self, signal: &[f64], weight: &[f64]) -> Option<(Parameters, f64)> {
        let mut best: Option<(Parameters, f64)> = None;
        let seen: Vec<f64> = signal.iter().zip(weight).map(|(y, w)| y * w).collect();
        let (_, yy) = dots(&seen, &seen);
        let mut expected = vec![0.0; seen.len()];
        for (p, predicted) in self.points.iter().zip(&self.predicted) {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_start_is_the_point_whose_radiances_are_proportional_to_the_signal() {
        let full = |p: &Parameters| (0..7).map(|j| (p[1] + 0.3 * f64::from(j)).cos()).collect();
        let quarters = Starts::quarters(false, full);
        assert_eq!(quarters.len(), QUARTERS);
        let quarter = &quarters[1];
        assert_eq!(quarter.points.len(), 4 * 6 * 3 * 2);
        let due = quarter.points[80];
        let signal: Vec<f64> = full(&due).iter().map(|x: &f64| 0.7 * x).collect();
        let mut weight = vec![1.0; 7];
        let (found, chi2) = quarter.best(&signal, &weight).unwrap();
        assert!(found[1] == due[1] && chi2.abs() < 1e-12, "{found:?} {chi2}");
        // A masked observation has no weight.
        let mut spoilt = signal;
        (spoilt[2], weight[2]) = (1e3, 0.0);
        assert_eq!(quarter.best(&spoilt, &weight).unwrap().0[1], due[1]);
        assert!(Starts::default().best(&spoilt, &weight).is_none());
    }
}
