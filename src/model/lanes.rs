//! Several pixels, or several starts, in one register: a number type over `pulp`'s run-time chosen vector width.
//!
//! One [`Lane`] is 8 doubles with AVX-512, 4 with AVX2, 1 elsewhere. Everything here is inlined
//! into the function that `pulp` compiles once per instruction set; that is what makes the choice
//! at run time free.

use std::ops::{Add, Div, Mul, Neg, Sub};

use pulp::Simd;

/// One number per pixel.
#[derive(Clone, Copy)]
pub(crate) struct Lane<S: Simd>(pub S, pub S::f64s);

/// One yes or no per pixel.
#[derive(Clone, Copy)]
pub(crate) struct Mask<S: Simd>(S, S::m64s);

impl<S: Simd> Lane<S> {
    /// Pixels per register.
    pub(crate) const WIDTH: usize = S::F64_LANES;

    #[inline(always)]
    pub(crate) fn splat(simd: S, x: f64) -> Self {
        Lane(simd, simd.splat_f64s(x))
    }

    /// Lanes `at * WIDTH ..` of a slice.
    #[inline(always)]
    pub(crate) fn load(simd: S, from: &[f64], at: usize) -> Self {
        Lane(simd, S::as_simd_f64s(from).0[at])
    }

    #[inline(always)]
    pub(crate) fn store(self, to: &mut [f64], at: usize) {
        S::as_mut_simd_f64s(to).0[at] = self.1;
    }

    /// self · a + b, fused where the machine can.
    #[inline(always)]
    pub(crate) fn mul_add(self, a: Self, b: Self) -> Self {
        Lane(self.0, self.0.mul_add_e_f64s(self.1, a.1, b.1))
    }

    #[inline(always)]
    pub(crate) fn sqrt(self) -> Self {
        Lane(self.0, self.0.sqrt_f64s(self.1))
    }

    #[inline(always)]
    pub(crate) fn abs(self) -> Self {
        Lane(self.0, self.0.abs_f64s(self.1))
    }

    #[inline(always)]
    pub(crate) fn max(self, other: Self) -> Self {
        Lane(self.0, self.0.max_f64s(self.1, other.1))
    }

    #[inline(always)]
    pub(crate) fn min(self, other: Self) -> Self {
        Lane(self.0, self.0.min_f64s(self.1, other.1))
    }

    #[inline(always)]
    pub(crate) fn less(self, other: Self) -> Mask<S> {
        Mask(self.0, self.0.less_than_f64s(self.1, other.1))
    }

    /// e^−q for q ≥ 0 to 4e-11 of its value; q above 60 counts as 60 (10⁻²⁶).
    ///
    /// (e^(−q/128))^128 by seven squarings: `pulp` has no shift of 64-bit lanes to build 2^k with.
    #[inline(always)]
    pub(crate) fn exp_neg(self) -> Self {
        // Taylor about the middle of [0, 60/128]: |d| ≤ 0.234, 0.234¹⁰/10! = 1.4e-13 (× 128).
        let d = Self::splat(self.0, CENTRE)
            - self.min(Self::splat(self.0, 60.0)) * Self::splat(self.0, 1.0 / 128.0);
        let mut e = Self::splat(self.0, EXP_CENTRE / 362_880.0);
        for factorial in [40_320.0, 5_040.0, 720.0, 120.0, 24.0, 6.0, 2.0, 1.0, 1.0] {
            e = e.mul_add(d, Self::splat(self.0, EXP_CENTRE / factorial));
        }
        for _ in 0..7 {
            e = e * e;
        }
        e
    }

    /// e^x for |x| ≤ 1 by its series; 1/17! = 3e-15 is left out.
    #[inline(always)]
    pub(crate) fn exp_small(self) -> Self {
        let mut e = Self::splat(self.0, 1.0);
        for n in (1..=16).rev() {
            e = (e * self).mul_add(
                Self::splat(self.0, 1.0 / f64::from(n)),
                Self::splat(self.0, 1.0),
            );
        }
        e
    }

    /// sin x and cos x for |x| ≤ 0.7 by their series; 0.7¹⁴/14! = 8e-14 is left out.
    #[inline(always)]
    pub(crate) fn sin_cos_small(self) -> (Self, Self) {
        let minus = -(self * self);
        let (mut sin, mut cos) = (Self::splat(self.0, 1.0), Self::splat(self.0, 1.0));
        for n in (1..=6).rev() {
            let n = f64::from(n);
            sin = (sin * minus).mul_add(
                Self::splat(self.0, 1.0 / (2.0 * n * (2.0 * n + 1.0))),
                Self::splat(self.0, 1.0),
            );
            cos = (cos * minus).mul_add(
                Self::splat(self.0, 1.0 / (2.0 * n * (2.0 * n - 1.0))),
                Self::splat(self.0, 1.0),
            );
        }
        (sin * self, cos)
    }
}

const CENTRE: f64 = 30.0 / 128.0;
/// e^(−30/128)
const EXP_CENTRE: f64 = 0.791_065_110_850_296;

impl<S: Simd> Mask<S> {
    #[inline(always)]
    pub(crate) fn select(self, yes: Lane<S>, no: Lane<S>) -> Lane<S> {
        Lane(self.0, self.0.select_f64s(self.1, yes.1, no.1))
    }

    #[inline(always)]
    pub(crate) fn and(self, other: Self) -> Self {
        Mask(self.0, self.0.and_m64s(self.1, other.1))
    }
}

macro_rules! operator {
    ($trait:ident, $method:ident, $simd:ident) => {
        impl<S: Simd> $trait for Lane<S> {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                Lane(self.0, self.0.$simd(self.1, other.1))
            }
        }
    };
}
operator!(Add, add, add_f64s);
operator!(Sub, sub, sub_f64s);
operator!(Mul, mul, mul_f64s);
operator!(Div, div, div_f64s);

impl<S: Simd> Neg for Lane<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Lane(self.0, self.0.neg_f64s(self.1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulp::Scalar;

    fn lane(x: f64) -> Lane<Scalar> {
        Lane::splat(Scalar::new(), x)
    }

    #[test]
    fn the_exponential_keeps_ten_digits_over_its_range() {
        assert!((EXP_CENTRE - (-CENTRE).exp()).abs() < 1e-16);
        for i in 0..6000 {
            let q = f64::from(i) * 0.01;
            let ratio = lane(q).exp_neg().1 / (-q).exp();
            assert!((ratio - 1.0).abs() < 4e-11, "{q}: {ratio}");
        }
        assert!(lane(1e300).exp_neg().1 < 1e-25);
    }

    #[test]
    fn the_small_series_are_exact_to_rounding() {
        for i in -100..=100 {
            let x = f64::from(i) * 0.007;
            let (sin, cos) = lane(x).sin_cos_small();
            assert!((sin.1 - x.sin()).abs() < 1e-13 && (cos.1 - x.cos()).abs() < 1e-13);
            let x = f64::from(i) * 0.01;
            assert!((lane(x).exp_small().1 / x.exp() - 1.0).abs() < 2e-14);
        }
    }
}
