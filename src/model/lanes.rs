//! Several pixels, or several starts, in one register: a number type over `pulp`'s vector width, chosen at run time.
//!
//! One [`Lane`] is 8 doubles with AVX-512, 4 with AVX2, 1 elsewhere. Everything is inlined into the function that
//! `pulp` compiles once per instruction set, so the choice at run time has no cost.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, LOG2_E};
use std::ops::{Add, Div, Mul, Neg, Sub};

use pulp::Simd;
use pulp::bytemuck::cast;

pub(super) mod fresnel;

/// Largest number of lanes of any register.
pub(crate) const WIDEST: usize = 8;

/// One number per pixel.
#[derive(Clone, Copy)]
pub struct Lane<S: Simd>(pub S, pub S::f64s);

/// One boolean per pixel.
#[derive(Clone, Copy)]
pub struct Mask<S: Simd>(S, S::m64s);

impl<S: Simd> Lane<S> {
    /// Pixels per register.
    pub(crate) const WIDTH: usize = S::F64_LANES;

    #[inline(always)]
    pub(crate) fn splat(simd: S, x: f64) -> Self {
        Lane(simd, simd.splat_f64s(x))
    }

    /// Loads lanes `at * WIDTH ..` of a slice.
    #[inline(always)]
    pub(crate) fn load(simd: S, from: &[f64], at: usize) -> Self {
        Lane(simd, S::as_simd_f64s(from).0[at])
    }

    #[inline(always)]
    pub(crate) fn store(self, to: &mut [f64], at: usize) {
        S::as_mut_simd_f64s(to).0[at] = self.1;
    }

    /// Returns self · a + b, fused if the machine supports it.
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

    /// Returns e^−q for 0 ≤ q with a relative error of (1 + q) 4e-16; q above 60 counts as 60 (10⁻²⁶).
    ///
    /// e^−q = 2^k 2^f with |f| ≤ 1/2. Adding [`ROUND`] leaves k in the high half of the number's bits (with 1023, the
    /// exponent bias of a double, already added) and the fraction in the low half.
    #[inline(always)]
    pub(crate) fn exp_neg(self) -> Self {
        // Macros, not closures: what is not inlined is not compiled for the machine's instructions.
        let simd = self.0;
        macro_rules! k {
            ($x:expr) => {
                simd.splat_f64s($x)
            };
        }
        let q = simd.min_f64s(self.1, k!(60.0));
        let shifted = simd.mul_add_e_f64s(q, k!(-LOG2_E), k!(ROUND + 0.5));
        let whole = simd.and_f64s(shifted, k!(f64::from_bits(0xFFFF_FFFF_0000_0000)));
        let f = simd.mul_add_e_f64s(q, k!(-LOG2_E), simd.sub_f64s(k!(ROUND), whole));
        // Estrin's scheme has half the depth of Horner's.
        macro_rules! pair {
            ($n:expr) => {
                simd.mul_add_e_f64s(f, k!(EXP2[$n + 1]), k!(EXP2[$n]))
            };
        }
        let f2 = simd.mul_f64s(f, f);
        let f4 = simd.mul_f64s(f2, f2);
        let low = simd.mul_add_e_f64s(f2, pair!(2), pair!(0));
        let high = simd.mul_add_e_f64s(f2, pair!(6), pair!(4));
        let last = simd.mul_add_e_f64s(f2, k!(EXP2[10]), pair!(8));
        let high = simd.mul_add_e_f64s(f4, last, high);
        let power = simd.mul_add_e_f64s(f4, high, low);
        Lane(simd, simd.mul_f64s(power, two_to(simd, whole)))
    }

    /// Returns e^x for |x| ≤ 1 by its series; the omitted term is 1/17! = 3e-15.
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

    /// Returns atan2(self, x) of two numbers ≥ 0, to 3e-9.
    #[inline(always)]
    pub(crate) fn angle_to(self, x: Self) -> Self {
        macro_rules! k {
            ($x:expr) => {
                Self::splat(self.0, $x)
            };
        }
        let steep = x.less(self);
        let tan = self.min(x) / self.max(x).max(k!(f64::MIN_POSITIVE));
        // Above 22.5°, measured from 45°.
        let wide = k!(FRAC_PI_8_TAN).less(tan);
        let t = wide.select((tan - k!(1.0)) / (tan + k!(1.0)), tan);
        let minus = -(t * t);
        let mut series = k!(1.0 / 17.0);
        for n in (0..8).rev() {
            series = series.mul_add(minus, k!(1.0 / (2.0 * f64::from(n) + 1.0)));
        }
        let angle = wide.select(series.mul_add(t, k!(FRAC_PI_4)), series * t);
        steep.select(k!(FRAC_PI_2) - angle, angle)
    }

    /// Returns the share of the normal distribution below `self`, to 2e-7 (Abramowitz and Stegun 1964, 26.2.17), and
    /// its density there.
    #[inline(always)]
    pub(crate) fn normal_share(self) -> (Self, Self) {
        macro_rules! k {
            ($x:expr) => {
                Self::splat(self.0, $x)
            };
        }
        let bell = (k!(0.5) * self * self).exp_neg() * k!(FRAC_1_SQRT_TAU);
        let t = k!(1.0) / self.abs().mul_add(k!(0.231_641_9), k!(1.0));
        let mut series = k!(1.330_274_429);
        for c in [-1.821_255_978, 1.781_477_937, -0.356_563_782, 0.319_381_530] {
            series = series.mul_add(t, k!(c));
        }
        let beyond = bell * series * t;
        let below = self.less(k!(0.0)).select(beyond, k!(1.0) - beyond);
        (below, bell)
    }

    /// Returns sin x and cos x for |x| ≤ 0.7 by their series; the omitted term is 0.7¹⁴/14! = 8e-14.
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

/// Numbers that start on a cache line, so that no load or store of a register touches two.
#[derive(Debug, Clone)]
pub(crate) struct Numbers {
    all: Vec<f64>,
    skipped: usize,
}

/// Bytes of a cache line.
const LINE: usize = 64;

impl Numbers {
    /// `count` zeros.
    pub(crate) fn zeros(count: usize) -> Self {
        let spare = LINE / size_of::<f64>();
        let all = vec![0.0; count + spare];
        // If the offset is unknown, unaligned access is slower but correct.
        let skipped = all.as_ptr().align_offset(LINE).min(spare);
        Numbers { all, skipped }
    }
}

impl std::ops::Deref for Numbers {
    type Target = [f64];
    #[inline(always)]
    fn deref(&self) -> &[f64] {
        &self.all[self.skipped..]
    }
}

impl std::ops::DerefMut for Numbers {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [f64] {
        &mut self.all[self.skipped..]
    }
}

/// tan 22.5°.
const FRAC_PI_8_TAN: f64 = 0.414_213_562_373_095_03;
/// 1/√(2π).
pub(super) const FRAC_1_SQRT_TAU: f64 = 0.398_942_280_401_432_7;
/// 1.5 · 2²⁰ + 1023: numbers of this size have their units in the lowest bit of the high half.
const ROUND: f64 = 1_572_864.0 + 1023.0;
/// Coefficients of 2^f on |f| ≤ 1/2 with a relative error of 3e-16: interpolated at the zeros of Chebyshev's T₁₁.
#[expect(
    clippy::approx_constant,
    reason = "the best polynomial's coefficient is near ln 2, not ln 2"
)]
const EXP2: [f64; 11] = [
    1.0,
    0.693_147_180_559_95,
    0.240_226_506_959_100_97,
    0.055_504_108_664_447_72,
    0.009_618_129_107_606_942,
    0.001_333_355_823_016_468_6,
    0.000_154_035_304_417_031_52,
    1.525_265_726_035_917_6e-5,
    1.321_544_259_840_131e-6,
    1.020_869_028_004_064_1e-7,
    7.072_584_479_589_179e-9,
];

/// Returns 2^(w − [`ROUND`]) for whole numbers w, whose bits are shifted to the exponent of a double.
#[inline(always)]
fn two_to<S: Simd>(simd: S, whole: S::f64s) -> S::f64s {
    if S::IS_SCALAR {
        let bits: u64 = cast(whole);
        cast(bits << 20)
    } else {
        // The low halves are zero, so the halves may be shifted separately.
        let halves: S::u32s = cast(whole);
        cast(simd.wrapping_dyn_shl_u32s(halves, simd.splat_u32s(20)))
    }
}

impl<S: Simd> Mask<S> {
    #[inline(always)]
    pub(crate) fn select(self, yes: Lane<S>, no: Lane<S>) -> Lane<S> {
        Lane(self.0, self.0.select_f64s(self.1, yes.1, no.1))
    }

    /// Whether it is true in any lane.
    #[inline(always)]
    pub(crate) fn any(self) -> bool {
        self.0.first_true_m64s(self.1) < S::F64_LANES
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
    fn the_exponential_is_exact_to_the_rounding_of_its_argument() {
        for i in 0..60_000 {
            let q = f64::from(i) * 0.001;
            let ratio = lane(q).exp_neg().1 / (-q).exp();
            assert!((ratio - 1.0).abs() < (1.0 + q) * 4e-16, "{q}: {ratio}");
        }
        assert!(lane(1e300).exp_neg().1 < 1e-25);
        assert!(lane(f64::INFINITY).exp_neg().1 < 1e-25);
    }

    struct Exponentials<'a>(&'a [f64], &'a mut [f64]);

    impl pulp::WithSimd for Exponentials<'_> {
        type Output = ();
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            for at in 0..self.0.len() / S::F64_LANES {
                Lane::load(simd, self.0, at).exp_neg().store(self.1, at);
            }
        }
    }

    #[test]
    fn every_width_has_the_same_exponential() {
        let q: Vec<f64> = (0..640).map(|i| f64::from(i) * 0.1).collect();
        let mut wide = vec![0.0; q.len()];
        pulp::Arch::new().dispatch(Exponentials(&q, &mut wide));
        for (q, wide) in q.iter().zip(wide) {
            let narrow = lane(*q).exp_neg().1;
            // The widths differ in whether products are rounded before they are added.
            assert!((wide / narrow - 1.0).abs() < 3e-14, "{q}");
        }
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

    #[test]
    fn angles_and_shares_of_the_normal_distribution_are_exact_to_the_stated_digits() {
        for step in 0..=900 {
            let (y, x) = (0.1 * f64::from(step)).to_radians().sin_cos();
            let x = x.max(0.0);
            let angle = lane(3.0 * y).angle_to(lane(3.0 * x)).1;
            assert!((angle - y.atan2(x)).abs() < 3e-9, "{step}");
            let z = 0.01 * f64::from(step - 450);
            let (share, density) = lane(z).normal_share();
            let exact = 0.5 * libm::erfc(-z * std::f64::consts::FRAC_1_SQRT_2);
            assert!((share.1 - exact).abs() < 2e-7, "{z}");
            let bell = (-0.5 * z * z).exp() / std::f64::consts::TAU.sqrt();
            assert!((density.1 - bell).abs() < 1e-15, "{z}");
        }
        assert_eq!(lane(0.0).angle_to(lane(0.0)).1, 0.0);
    }
}
