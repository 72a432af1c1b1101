//! The damped step of Levenberg–Marquardt inside a trust region (Moré 1978), on the small triangle from a QR of the
//! derivatives.

use super::{householder, norm, solve_upper, solve_upper_transposed, sum_of_squares};

/// Result of a QR of the free columns.
#[derive(Debug, Clone, Copy)]
pub(in crate::fit) struct Triangle<'a> {
    /// R in the upper triangle of a column-major matrix with m rows.
    pub(in crate::fit) r: &'a [f64],
    /// Rows of that matrix.
    pub(in crate::fit) m: usize,
    /// Qᵀ(−residuals), one entry per column.
    pub(in crate::fit) qtb: &'a [f64],
}

/// Working memory of the n × n system of a damped step: finds μ with ‖D p(μ)‖ within 10 % of the trust radius.
#[derive(Debug)]
pub(in crate::fit) struct SmallSystem {
    stacked: Vec<f64>,
    rhs: Vec<f64>,
}

impl SmallSystem {
    pub(in crate::fit) fn new(n: usize) -> Self {
        SmallSystem {
            stacked: vec![0.0; 2 * n * n],
            rhs: vec![0.0; 2 * n],
        }
    }

    /// Returns step and μ that keep ‖D step‖ within the radius, D = diag(scale); `damping` is a first guess of μ.
    /// Returns `None` if the system cannot be solved.
    pub(in crate::fit) fn solve(
        &mut self,
        triangle: Triangle<'_>,
        scale: &[f64],
        radius: f64,
        damping: f64,
    ) -> Option<(Vec<f64>, f64)> {
        let Triangle { r, m, qtb } = triangle;
        let n = qtb.len();
        let scaled_norm = |p: &[f64]| -> f64 {
            p.iter()
                .zip(scale)
                .map(|(p, d)| (p * d) * (p * d))
                .sum::<f64>()
                .sqrt()
        };
        let mut step = qtb.to_vec();
        let regular = solve_upper(r, m, n, &mut step);
        let mut lower = 0.0_f64;
        if regular {
            let length = scaled_norm(&step);
            if length <= 1.1 * radius {
                return Some((step, 0.0));
            }
            let mut w: Vec<f64> = (0..n)
                .map(|j| scale[j] * scale[j] * step[j] / length)
                .collect();
            if solve_upper_transposed(r, m, n, &mut w) {
                lower = (length - radius) / radius / sum_of_squares(&w);
            }
        }
        let gradient: Vec<f64> = (0..n)
            .map(|j| (0..=j).map(|i| r[i + j * m] * qtb[i]).sum::<f64>() / scale[j])
            .collect();
        let steepest = norm(&gradient);
        if !(steepest / radius).is_finite() || radius <= 0.0 {
            return None;
        }
        if steepest == 0.0 {
            return Some((vec![0.0; n], 0.0));
        }
        let mut upper = steepest / radius;
        // Rounding can reverse the bounds of μ, or make the lower one infinite.
        lower = if lower.is_finite() {
            lower.min(upper)
        } else {
            0.0
        };
        let mut mu = if damping.is_finite() { damping } else { upper };
        mu = mu.clamp(lower, upper);
        if mu == 0.0 {
            mu = (steepest / radius * 1e-3).max((lower * upper).sqrt());
        }
        for _ in 0..12 {
            if mu == 0.0 {
                mu = f64::MIN_POSITIVE.max(1e-3 * upper);
            }
            let rows = 2 * n;
            self.stacked[..rows * n].iter_mut().for_each(|v| *v = 0.0);
            for j in 0..n {
                for i in 0..=j {
                    self.stacked[i + j * rows] = r[i + j * m];
                }
                self.stacked[n + j + j * rows] = mu.sqrt() * scale[j];
            }
            self.rhs[..rows].iter_mut().for_each(|v| *v = 0.0);
            self.rhs[..n].copy_from_slice(qtb);
            householder(
                &mut self.stacked[..rows * n],
                rows,
                n,
                &mut self.rhs[..rows],
            );
            step.copy_from_slice(&self.rhs[..n]);
            if !solve_upper(&self.stacked[..rows * n], rows, n, &mut step) {
                return None;
            }
            let length = scaled_norm(&step);
            let excess = length - radius;
            if excess.abs() <= 0.1 * radius {
                break;
            }
            let mut w: Vec<f64> = (0..n)
                .map(|j| scale[j] * scale[j] * step[j] / length)
                .collect();
            if length == 0.0 || !solve_upper_transposed(&self.stacked[..rows * n], rows, n, &mut w)
            {
                break;
            }
            let correction = excess / radius / sum_of_squares(&w);
            if excess > 0.0 {
                lower = lower.max(mu);
            } else {
                upper = upper.min(mu);
            }
            mu = (mu + correction).max(lower);
            if mu > upper {
                mu = 0.5 * (lower + upper);
            }
        }
        Some((step, mu))
    }
}
