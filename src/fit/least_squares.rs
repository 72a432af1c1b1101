//! The interface between solver and problem, and the small dense algebra that both use.
//!
//! Matrices are column-major slices: entry (i, j) of an m × n matrix is `a[i + j * m]`.
//!
//! *Conditioning.* Householder reflections are stable column by column for any column lengths; the sign of α is
//! opposite to that of the leading entry, so its subtraction adds. Columns outside 1e±140 are first scaled to about 1
//! by a power of two, because their squares would leave the range of doubles and invalidate the reflection. A pivot
//! that is 0 or not finite makes the solution fail. The caller, who knows the scales, has to judge small pivots.

pub(super) mod descent;
pub(crate) mod lane_steps;
pub mod levenberg_marquardt;
pub mod minimum;
pub(super) mod trust_region;

/// A nonlinear least-squares problem: minimise the sum of squared residuals.
pub trait LeastSquares {
    /// Number of parameters n.
    fn n_parameters(&self) -> usize;

    /// Number of residuals m.
    fn n_residuals(&self) -> usize;

    /// Writes the m residuals at `parameters` and, if requested, the exact derivatives ∂residual i/∂parameter j as a
    /// column-major m × n matrix. Residuals are divided by their standard uncertainty. An entry that is not finite
    /// rejects the point.
    fn evaluate(&self, parameters: &[f64], residuals: &mut [f64], jacobian: &mut [f64]);
}

/// Euclidean norm.
#[must_use]
pub fn norm(values: &[f64]) -> f64 {
    sum_of_squares(values).sqrt()
}

/// Sum of squares.
#[must_use]
pub fn sum_of_squares(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum()
}

/// Computes a Householder QR in place: the upper triangle of the m × n matrix `a` (m ≥ n) becomes R, `rhs` becomes Qᵀ
/// rhs. The part below the diagonal is overwritten with scratch values.
pub fn householder(a: &mut [f64], m: usize, n: usize, rhs: &mut [f64]) {
    debug_assert!(a.len() == m * n && rhs.len() == m && m >= n);
    for k in 0..n {
        let (head, tail) = a.split_at_mut((k + 1) * m);
        let column = &mut head[k * m + k..];
        let unit = unit_of(column);
        if unit != 1.0 {
            column.iter_mut().for_each(|v| *v *= unit);
        }
        let length = norm(column);
        if length == 0.0 || !length.is_finite() {
            continue;
        }
        let alpha = if column[0] > 0.0 { -length } else { length };
        column[0] -= alpha;
        // H = I − v vᵀ/β with β = vᵀv/2 = −alpha · v0
        let beta = -alpha * column[0];
        for j in 0..n - k - 1 {
            let other = &mut tail[j * m + k..(j + 1) * m];
            reflect(column, beta, other);
        }
        reflect(column, beta, &mut rhs[k..]);
        column[0] = alpha / unit;
    }
}

/// Returns the power of two that scales a column to about 1 if its squares would leave the range of doubles. A
/// reflection does not depend on the length of its vector, but one of lost digits is invalid.
fn unit_of(column: &[f64]) -> f64 {
    let largest = column.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    if (1e-140..1e140).contains(&largest) || largest == 0.0 || !largest.is_finite() {
        1.0
    } else {
        2f64.powi(-(largest.log2() as i32).clamp(-1000, 1000))
    }
}

fn reflect(v: &[f64], beta: f64, target: &mut [f64]) {
    let dot: f64 = v.iter().zip(target.iter()).map(|(a, b)| a * b).sum();
    let factor = dot / beta;
    for (t, a) in target.iter_mut().zip(v) {
        *t -= factor * a;
    }
}

/// Solves R x = b for the upper triangle of an m × n matrix; returns `false` if R is singular.
pub fn solve_upper(r: &[f64], m: usize, n: usize, b: &mut [f64]) -> bool {
    for j in (0..n).rev() {
        let pivot = r[j + j * m];
        if pivot == 0.0 || !pivot.is_finite() {
            return false;
        }
        b[j] /= pivot;
        for i in 0..j {
            b[i] -= r[i + j * m] * b[j];
        }
    }
    b[..n].iter().all(|v| v.is_finite())
}

/// Solves Rᵀ x = b for the upper triangle of an m × n matrix; returns `false` if R is singular.
pub fn solve_upper_transposed(r: &[f64], m: usize, n: usize, b: &mut [f64]) -> bool {
    for j in 0..n {
        let pivot = r[j + j * m];
        if pivot == 0.0 || !pivot.is_finite() {
            return false;
        }
        for i in 0..j {
            b[j] -= r[i + j * m] * b[i];
        }
        b[j] /= pivot;
    }
    b[..n].iter().all(|v| v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_overdetermined_system_is_solved_in_the_least_squares_sense() {
        // Line through (0,1), (1,3), (2,5), (3,7.4). By hand: n=4, Σx=6, Σxx=14, Σy=16.4, Σxy=35.2 → slope =
        // (4·35.2−6·16.4)/20 = 2.12, intercept = 0.92.
        let mut a = vec![1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 2.0, 3.0];
        let mut y = vec![1.0, 3.0, 5.0, 7.4];
        householder(&mut a, 4, 2, &mut y);
        assert!(solve_upper(&a, 4, 2, &mut y));
        assert!((y[0] - 0.92).abs() < 1e-14 && (y[1] - 2.12).abs() < 1e-14);
    }

    #[test]
    fn a_singular_triangle_has_no_solution() {
        let r = vec![1.0, 0.0, 2.0, 0.0];
        assert!(!solve_upper(&r, 2, 2, &mut [1.0, 1.0]));
        assert!(!solve_upper_transposed(&r, 2, 2, &mut [1.0, 1.0]));
    }
}
