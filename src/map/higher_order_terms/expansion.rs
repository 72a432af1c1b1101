//! The first-order expansion of the costly terms about the centre of a cell.

use crate::map::solve::kernel::{FREE, Parameters};

/// One cell's first-order expansion, stored compactly and contiguously: there are many cells, and the time to fetch them from
/// memory dominates. Single precision is 6e-8 of an offset.
pub(super) struct Cell {
    pub(super) centre: Parameters,
    /// Offset, B, and the offset's slopes per parameter, concatenated; each has one element per observation.
    pub(super) numbers: Vec<f32>,
}

/// Evaluates a cell's expansion at a distance from its centre. It is a type and not a closure: a closure of this size
/// is not inlined, and what is not inlined is not compiled for the wider instructions.
pub(super) struct Expanded<'a> {
    pub(super) numbers: &'a [f32],
    pub(super) away: [f32; FREE],
    pub(super) offset: &'a mut [f64],
    pub(super) basis: &'a mut [f64],
}

impl pulp::WithSimd for Expanded<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) {
        let n = self.offset.len();
        let (own, slopes) = self.numbers.split_at(2 * n);
        let (offset, basis) = own.split_at(n);
        for (to, b) in self.basis.iter_mut().zip(basis) {
            *to = f64::from(*b);
        }
        let [a, b, c, d, e] = self.away;
        let (s0, rest) = slopes.split_at(n);
        let (s1, rest) = rest.split_at(n);
        let (s2, rest) = rest.split_at(n);
        let (s3, s4) = rest.split_at(n);
        for j in 0..n {
            let sum = offset[j] + (a * s0[j] + b * s1[j]) + (c * s2[j] + d * s3[j]) + e * s4[j];
            self.offset[j] = f64::from(sum);
        }
    }
}
