//! The inverse of a pixel's 5 × 5 normal matrix, with a rank test.
//!
//! *Conditioning.* Normal equations square the condition number of the derivatives, so columns are scaled to length 1
//! first. A pivot below 1e-9 fails the test. What passes has a scaled Jacobian with a condition below 3e4, and
//! variances with six correct digits, as many as a map in float32 stores. Units do not affect the test.

use nalgebra::SMatrix;

use super::kernel::{FREE, PACKED, packed};

/// Pivot of the column-scaled normal matrix below which the data do not determine the parameters.
const PIVOT_MIN: f64 = 1e-9;

/// Inverts a packed normal matrix; `None` if a pivot of its column-scaled form is too small.
pub(in crate::map) fn invert(normal: &[f64; PACKED]) -> Option<[f64; PACKED]> {
    let at = |i: usize, j: usize| normal[packed(i.max(j), i.min(j))];
    let scale: [f64; FREE] = std::array::from_fn(|i| at(i, i).sqrt());
    if scale.iter().any(|s| !(s.is_finite() && *s > 0.0)) {
        return None;
    }
    let scaled = |i, j| at(i, j) / (scale[i] * scale[j]);
    let factor = SMatrix::<f64, FREE, FREE>::from_fn(scaled).cholesky()?;
    let pivots = factor.l_dirty().diagonal();
    if pivots.iter().any(|l| l * l <= PIVOT_MIN) {
        return None;
    }
    let (inverse, mut packed_inverse) = (factor.inverse(), [0.0; PACKED]);
    for i in 0..FREE {
        for j in 0..=i {
            packed_inverse[packed(i, j)] = inverse[(i, j)] / (scale[i] * scale[j]);
        }
    }
    Some(packed_inverse)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_times_the_matrix_is_one_and_a_singular_matrix_has_none() {
        // JᵀJ of seven rows whose columns differ by five orders of magnitude.
        let mut normal = [0.0; PACKED];
        for row in 0..7 {
            let j: [f64; FREE] = std::array::from_fn(|k| {
                (1.7 * (row * (k + 1)) as f64 + 0.3 * k as f64).sin() * 10_f64.powi(k as i32 - 2)
            });
            for a in 0..FREE {
                for b in 0..=a {
                    normal[packed(a, b)] += j[a] * j[b];
                }
            }
        }
        let full = |m: &[f64; PACKED], i: usize, j: usize| m[packed(i.max(j), i.min(j))];
        let inverse = invert(&normal).unwrap();
        for i in 0..FREE {
            for j in 0..FREE {
                let x: f64 = (0..FREE)
                    .map(|m| full(&normal, i, m) * full(&inverse, m, j))
                    .sum();
                let tolerance = 1e-9 * 10_f64.powi(j as i32 - i as i32).max(1.0);
                assert!((x - f64::from(i == j)).abs() < tolerance);
            }
        }
        assert!(invert(&[1.0; PACKED]).is_none());
        assert!(invert(&[0.0; PACKED]).is_none());
        assert!(invert(&[f64::NAN; PACKED]).is_none());
    }
}
