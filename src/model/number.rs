//! The operations that a term of the model needs of a number, for values, derivatives and registers.
//!
//! A term that is written over [`Number`] runs on `f64`, on dual numbers ([`super::dual`]) and on a register of
//! surfaces ([`super::lanes`]). Branches are selections between two numbers, so that the lanes of a register may take
//! different ones. Constants are made from an existing number by [`Number::like`], since the type of a register
//! depends on the machine.

use std::ops::{Add, Div, Mul, Neg, Sub};

use pulp::Simd;

use super::fresnel;
use super::lanes::{Lane, Mask, WIDEST};

/// A number of the model.
pub trait Number:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// The result of a comparison, which selects between two numbers.
    type Choice: Copy;

    /// Returns a constant of the same kind.
    fn like(self, value: f64) -> Self;
    /// Whether this is below the other.
    fn below(self, other: Self) -> Self::Choice;
    /// Returns `yes` or `no`, as `choice` selects.
    fn choose(choice: Self::Choice, yes: Self, no: Self) -> Self;
    /// Returns f(self) for a function that returns value and slope.
    fn map(self, f: impl Fn(f64) -> (f64, f64)) -> Self;
    /// Returns f(self, other) for a function that returns the value and the slopes with respect to both.
    fn map2(self, other: Self, f: impl Fn(f64, f64) -> (f64, f64, f64)) -> Self;
    /// Returns the reflectances R_s, R_p of a smooth wall at this cosine of incidence, for the index η + ik.
    fn mirrored(self, eta: Self, k: Self) -> (Self, Self);

    /// Multiplies by a constant.
    #[inline(always)]
    fn times(self, factor: f64) -> Self {
        self * self.like(factor)
    }
    /// The larger of two.
    #[inline(always)]
    fn larger(self, other: Self) -> Self {
        Self::choose(other.below(self), self, other)
    }
    /// The smaller of two.
    #[inline(always)]
    fn smaller(self, other: Self) -> Self {
        Self::choose(self.below(other), self, other)
    }
    /// The number if it is positive, else 0.
    #[inline(always)]
    fn positive(self) -> Self {
        self.larger(self.like(0.0))
    }
    /// Square root.
    fn root(self) -> Self {
        self.map(|x| {
            let r = x.sqrt();
            (r, 0.5 / r)
        })
    }
    /// Exponential.
    fn exponential(self) -> Self {
        self.map(|x| {
            let e = x.exp();
            (e, e)
        })
    }
    /// Angle of the point (x, self).
    fn angle(self, x: Self) -> Self {
        self.map2(x, |y, x| {
            let r2 = x * x + y * y;
            (y.atan2(x), x / r2, -y / r2)
        })
    }
    /// Sine and cosine.
    fn sine_cosine(self) -> (Self, Self) {
        let sine = self.map(f64::sin_cos);
        let cosine = self.map(|x| (x.cos(), -x.sin()));
        (sine, cosine)
    }
}

impl Number for f64 {
    type Choice = bool;

    #[inline(always)]
    fn like(self, value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn below(self, other: Self) -> bool {
        self < other
    }
    #[inline(always)]
    fn choose(choice: bool, yes: Self, no: Self) -> Self {
        if choice { yes } else { no }
    }
    #[inline(always)]
    fn map(self, f: impl Fn(f64) -> (f64, f64)) -> Self {
        f(self).0
    }
    #[inline(always)]
    fn map2(self, other: Self, f: impl Fn(f64, f64) -> (f64, f64, f64)) -> Self {
        f(self, other).0
    }
    fn mirrored(self, eta: Self, k: Self) -> (Self, Self) {
        fresnel::reflectances(self, eta, k)
    }
}

impl<S: Simd> Number for Lane<S> {
    type Choice = Mask<S>;

    #[inline(always)]
    fn like(self, value: f64) -> Self {
        Lane::splat(self.0, value)
    }
    #[inline(always)]
    fn below(self, other: Self) -> Mask<S> {
        self.less(other)
    }
    #[inline(always)]
    fn choose(choice: Mask<S>, yes: Self, no: Self) -> Self {
        choice.select(yes, no)
    }
    #[inline(always)]
    fn larger(self, other: Self) -> Self {
        self.max(other)
    }
    #[inline(always)]
    fn smaller(self, other: Self) -> Self {
        self.min(other)
    }
    #[inline(always)]
    fn root(self) -> Self {
        self.sqrt()
    }
    #[inline(always)]
    fn map(self, f: impl Fn(f64) -> (f64, f64)) -> Self {
        self.map2(self, |x, _| {
            let (value, slope) = f(x);
            (value, slope, 0.0)
        })
    }
    /// Evaluates the lanes one by one: the terms that use it are not in an inner loop.
    #[inline(always)]
    fn map2(self, other: Self, f: impl Fn(f64, f64) -> (f64, f64, f64)) -> Self {
        let (mut a, mut b) = ([0.0; WIDEST], [0.0; WIDEST]);
        self.store(&mut a[..Lane::<S>::WIDTH], 0);
        other.store(&mut b[..Lane::<S>::WIDTH], 0);
        for (a, b) in a.iter_mut().zip(b) {
            *a = f(*a, b).0;
        }
        Lane::load(self.0, &a[..Lane::<S>::WIDTH], 0)
    }
    #[inline(always)]
    fn mirrored(self, eta: Self, k: Self) -> (Self, Self) {
        let (mut n, mut absorbs) = ([0.0; WIDEST], [0.0; WIDEST]);
        eta.store(&mut n[..Lane::<S>::WIDTH], 0);
        k.store(&mut absorbs[..Lane::<S>::WIDTH], 0);
        // All lanes have the same index.
        let (n, absorbs) = (n[0], absorbs[0]);
        let s = self.map(|cos| (fresnel::reflectances(cos, n, absorbs).0, 0.0));
        let p = self.map(|cos| (fresnel::reflectances(cos, n, absorbs).1, 0.0));
        (s, p)
    }
}
