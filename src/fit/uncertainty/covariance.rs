//! Covariance of fitted parameters by singular values of the column-scaled derivatives.
//!
//! The residuals are divided by their standard uncertainty, so the covariance is (JᵀJ)⁻¹; that matrix is never formed.
//! Columns are first scaled to length 1, because a rank test on unscaled columns would depend on units. A direction
//! whose singular value is below the tolerance is a null direction. It has no finite variance, and every parameter that
//! takes part in it is reported as not identifiable.
//!
//! *Conditioning.* Singular values of the triangle are accurate to 1e-16 of the greatest, so at the tolerance of 1e-10
//! a variance keeps six digits. JᵀJ squares the condition number and would keep none. The rank test uses only ratios,
//! so units of data and parameters cancel.

use nalgebra::DMatrix;

use crate::fit::least_squares::householder;

/// Covariance with its rank test.
#[derive(Debug, Clone, PartialEq)]
pub struct Covariance {
    /// n × n; meaningful only where [`Covariance::identifiable`] is true for row and column.
    pub matrix: DMatrix<f64>,
    /// Whether the parameter takes part in no null direction.
    pub identifiable: Vec<bool>,
    /// Null directions, as unit vectors in units of the scaled parameters.
    pub null_directions: Vec<Vec<f64>>,
    /// Singular values of the column-scaled derivatives, largest first.
    pub singular_values: Vec<f64>,
    /// Observations minus fitted directions.
    pub degrees_of_freedom: usize,
    /// χ²/ν; 1 if ν = 0.
    pub chi2_reduced: f64,
}

/// Relative singular value below which a direction counts as null.
pub const RANK_TOLERANCE: f64 = 1e-10;

/// Smallest component with which a parameter takes part in a null direction.
const PART_IN_NULL_DIRECTION: f64 = 1e-3;

/// Computes the covariance from the column-major m × n derivatives and the m residuals. The standard uncertainties that
/// divide them count as given. If they are correct up to a factor only, multiply the matrix by [`Covariance::chi2_reduced`],
/// the square of the Birge ratio.
#[must_use]
pub fn covariance(jacobian: &[f64], m: usize, residuals: &[f64]) -> Covariance {
    let n = jacobian.len() / m.max(1);
    let lengths: Vec<f64> = (0..n)
        .map(|j| {
            let column = &jacobian[j * m..(j + 1) * m];
            column.iter().map(|v| v * v).sum::<f64>().sqrt()
        })
        .collect();
    // QR first: an SVD of the n × n triangle is as accurate, and its cost does not depend on m.
    let rows = m.max(n);
    let mut scaled = vec![0.0; rows * n];
    for j in 0..n {
        if lengths[j] > 0.0 {
            let column = &jacobian[j * m..(j + 1) * m];
            for (to, from) in scaled[j * rows..].iter_mut().zip(column) {
                *to = from / lengths[j];
            }
        }
    }
    householder(&mut scaled, rows, n, &mut vec![0.0; rows]);
    let triangle = DMatrix::from_fn(n, n, |i, j| if i <= j { scaled[i + j * rows] } else { 0.0 });
    let svd = triangle.svd(false, true);
    let v_t = svd.v_t.expect("asked for");
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by(|a, b| svd.singular_values[*b].total_cmp(&svd.singular_values[*a]));
    let greatest = order.first().map_or(0.0, |k| svd.singular_values[*k]);
    let mut matrix = DMatrix::zeros(n, n);
    let mut identifiable: Vec<bool> = lengths.iter().map(|l| *l > 0.0).collect();
    let mut null_directions = Vec::new();
    let mut rank = 0;
    for &k in &order {
        let s = svd.singular_values[k];
        let direction: Vec<f64> = v_t.row(k).iter().copied().collect();
        if s <= RANK_TOLERANCE * greatest {
            for (flag, part) in identifiable.iter_mut().zip(&direction) {
                *flag &= part.abs() < PART_IN_NULL_DIRECTION;
            }
            null_directions.push(direction);
            continue;
        }
        rank += 1;
        for a in 0..n {
            for b in 0..n {
                matrix[(a, b)] += direction[a] * direction[b] / (s * s);
            }
        }
    }
    let degrees_of_freedom = m.saturating_sub(rank);
    let chi2: f64 = residuals.iter().map(|r| r * r).sum();
    let chi2_reduced = if degrees_of_freedom > 0 {
        chi2 / degrees_of_freedom as f64
    } else {
        1.0
    };
    for a in 0..n {
        for b in 0..n {
            let lengths = lengths[a] * lengths[b];
            if lengths > 0.0 {
                matrix[(a, b)] *= 1.0 / lengths;
            }
        }
    }
    Covariance {
        matrix,
        identifiable,
        null_directions,
        singular_values: order.iter().map(|k| svd.singular_values[*k]).collect(),
        degrees_of_freedom,
        chi2_reduced,
    }
}

impl Covariance {
    /// Standard uncertainties; infinite for parameters in a null direction.
    #[must_use]
    pub fn standard_deviations(&self) -> Vec<f64> {
        self.identifiable
            .iter()
            .enumerate()
            .map(|(j, known)| {
                if *known {
                    self.matrix[(j, j)].sqrt()
                } else {
                    f64::INFINITY
                }
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_straight_line_has_the_textbook_variances() {
        // y = a + b x at x = 0..4, σ = 1: var b = 1/10, var a = 1/5 + 4/10.
        let jacobian = [1.0, 1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 2.0, 3.0, 4.0];
        let c = covariance(&jacobian, 5, &[0.0; 5]);
        assert!((c.matrix[(1, 1)] - 0.1).abs() < 1e-15);
        assert!((c.matrix[(0, 0)] - 0.6).abs() < 1e-15);
        assert!((c.matrix[(0, 1)] + 0.2).abs() < 1e-15);
        assert_eq!(c.degrees_of_freedom, 3);
    }

    #[test]
    fn only_parameters_of_a_null_direction_are_not_identifiable() {
        // Columns 0 and 2 are proportional; column 1 is independent.
        let jacobian = [1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 3.0, 3.0, 0.0];
        let c = covariance(&jacobian, 3, &[0.0; 3]);
        assert_eq!(c.identifiable, vec![false, true, false]);
        assert_eq!(c.null_directions.len(), 1);
        assert!(c.standard_deviations()[0].is_infinite());
        assert!(c.standard_deviations()[1].is_finite());
    }
}
