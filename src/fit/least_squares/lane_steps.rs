//! Levenberg–Marquardt steps in register lanes: the normal equations from blocks of rows, and the damped step.
//!
//! `batched_lm` descends with them from many starts, the map (`map::solve`) for many pixels. All is inlined into the function that
//! is compiled for the machine's instructions; matrix indices are the notation, and iterators with closures are not inlined.
//!
//! *Conditioning.* The condition of the normal equations is the square of that of the derivatives. The factors of a step
//! depend on the damping and on a floor of 1e-14 of the diagonal, so a step is finite for any data. Marquardt's damping is a
//! multiple of the diagonal, so units do not matter.

use pulp::Simd;

use crate::model::lanes::{Lane, WIDEST};

/// Number of rows that are computed before they are summed: the registers cannot hold both at once.
pub(crate) const BLOCK: usize = 12;

/// Returns the index of packed element (i, j ≤ i) of a symmetric matrix.
pub(crate) const fn packed(i: usize, j: usize) -> usize {
    i * (i + 1) / 2 + j
}

/// The slopes and residuals of some rows: `[row][slope, …, residual][lane]`. Its alignment also aligns the stack frame, so
/// that spilled registers do not cross cache lines either.
#[repr(align(64))]
pub(crate) struct Block<const COLUMNS: usize>([[[f64; WIDEST]; COLUMNS]; BLOCK]);

impl<const COLUMNS: usize> Block<COLUMNS> {
    #[inline(always)]
    pub(crate) fn new() -> Self {
        Block([[[0.0; WIDEST]; COLUMNS]; BLOCK])
    }

    #[inline(always)]
    pub(crate) fn put<S: Simd>(&mut self, row: usize, column: usize, x: Lane<S>) {
        let numbers = self.0.as_flattened_mut().as_flattened_mut();
        x.store(numbers, row * COLUMNS + column);
    }

    /// Adds the products of all pairs of columns of the first `rows` rows to packed `sums`. The residual is the last column,
    /// so the last row of the sums is the gradient and the cost.
    #[inline(always)]
    pub(crate) fn add<S: Simd, const SUMS: usize>(
        &self,
        simd: S,
        rows: usize,
        sums: &mut [Lane<S>; SUMS],
    ) {
        let numbers = self.0.as_flattened().as_flattened();
        // In passes, each with about as many sums as there are registers.
        macro_rules! add {
            ($from:expr, $to:expr) => {
                for i in 0..rows {
                    for a in $from..$to {
                        let x = Lane::load(simd, numbers, i * COLUMNS + a);
                        for b in 0..=a {
                            let y = Lane::load(simd, numbers, i * COLUMNS + b);
                            sums[packed(a, b)] = x.mul_add(y, sums[packed(a, b)]);
                        }
                    }
                }
            };
        }
        add!(0, 4);
        add!(4, 6);
        if COLUMNS > 6 {
            add!(6, 8);
            add!(8, COLUMNS);
        }
    }
}

/// Solves (H + λ diag H) δ = g for each lane by Cholesky's factors; `normal` is H, packed. Parameters whose `free` is 0, not
/// 1, have no step.
#[inline(always)]
pub(crate) fn damped<S: Simd, const N: usize, const PACKED: usize>(
    simd: S,
    normal: &[Lane<S>; PACKED],
    gradient: &[Lane<S>; N],
    free: &[Lane<S>; N],
    lambda: Lane<S>,
) -> [Lane<S>; N] {
    macro_rules! k {
        ($x:expr) => {
            Lane::splat(simd, $x)
        };
    }
    let (zero, one) = (k!(0.0), k!(1.0));
    let mut l = [zero; PACKED];
    let mut inverse = [zero; N];
    let mut d = *gradient;
    for i in 0..N {
        for j in 0..i {
            let mut x = normal[packed(i, j)] * (free[i] * free[j]);
            for m in 0..j {
                x = x - l[packed(i, m)] * l[packed(j, m)];
            }
            l[packed(i, j)] = x * inverse[j];
        }
        let diagonal = normal[packed(i, i)];
        let floor = diagonal * k!(1e-14) + k!(1e-100);
        let mut x = diagonal * (one + lambda);
        for m in 0..i {
            x = x - l[packed(i, m)] * l[packed(i, m)];
        }
        inverse[i] = one / x.max(floor).sqrt();
        d[i] = d[i] * free[i];
        for j in 0..i {
            d[i] = d[i] - l[packed(i, j)] * d[j];
        }
        d[i] = d[i] * inverse[i];
    }
    for i in (0..N).rev() {
        for j in i + 1..N {
            d[i] = d[i] - l[packed(j, i)] * d[j];
        }
        d[i] = d[i] * inverse[i];
    }
    d
}
