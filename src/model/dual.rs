//! Forward-mode derivatives: a number that carries its partial derivatives.
//!
//! The closed forms are written once over [`Scalar`]; with `f64` they give a value, with [`Dual`] the exact gradient.
//! Tests compare the hand-written gradient of the inner loop with that of the same forms by the crate num-dual.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// The operations that the closed forms need of a number.
pub trait Scalar:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Mul<f64, Output = Self>
{
    /// Whether the number carries derivatives: if so, no term may be omitted for having the value 0.
    const CARRIES_DERIVATIVES: bool = true;
    /// A constant.
    fn constant(value: f64) -> Self;
    /// The value without derivatives.
    fn value(self) -> f64;
    /// Returns f(self) for a function whose value and first derivative at `self.value()` are given.
    fn map(self, value: f64, slope: f64) -> Self;
    /// Returns f(a, b, c) for a function of three numbers, from its value and partial derivatives.
    fn map3(value: f64, parts: [(Self, f64); 3]) -> Self;

    /// Square root.
    fn sqrt(self) -> Self {
        let r = self.value().sqrt();
        self.map(r, 0.5 / r)
    }
    /// Exponential.
    fn exp(self) -> Self {
        let e = self.value().exp();
        self.map(e, e)
    }
    /// Sine.
    fn sin(self) -> Self {
        let (s, c) = self.value().sin_cos();
        self.map(s, c)
    }
    /// Cosine.
    fn cos(self) -> Self {
        let (s, c) = self.value().sin_cos();
        self.map(c, -s)
    }
    /// Tangent.
    fn tan(self) -> Self {
        let t = self.value().tan();
        self.map(t, 1.0 + t * t)
    }
    /// Angle of the point (x, y), `y.atan2(x)`.
    fn atan2(self, x: Self) -> Self {
        let (yv, xv) = (self.value(), x.value());
        let r2 = xv * xv + yv * yv;
        let zero = Self::constant(0.0);
        Self::map3(yv.atan2(xv), [(self, xv / r2), (x, -yv / r2), (zero, 0.0)])
    }
    /// The larger of two; `other` if they are equal.
    fn larger(self, other: Self) -> Self {
        if self.value() > other.value() {
            self
        } else {
            other
        }
    }
    /// The smaller of two; `other` if they are equal.
    fn smaller(self, other: Self) -> Self {
        if self.value() < other.value() {
            self
        } else {
            other
        }
    }
}

impl Scalar for f64 {
    const CARRIES_DERIVATIVES: bool = false;
    fn constant(value: f64) -> Self {
        value
    }
    fn value(self) -> f64 {
        self
    }
    fn map(self, value: f64, _slope: f64) -> Self {
        value
    }
    fn map3(value: f64, _parts: [(Self, f64); 3]) -> Self {
        value
    }
}

/// A value with `N` partial derivatives. Its operations are always inlined, because a call copies whole numbers in and out; not in
/// a build with assertions, which takes longer to compile than its tests would gain.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dual<const N: usize> {
    /// The value.
    pub value: f64,
    /// Partial derivatives, in the order in which the variables were numbered.
    pub partials: [f64; N],
}

impl<const N: usize> Dual<N> {
    /// The `index`-th variable.
    #[must_use]
    #[cfg_attr(not(debug_assertions), inline(always))]
    pub fn variable(value: f64, index: usize) -> Self {
        let mut partials = [0.0; N];
        partials[index] = 1.0;
        Dual { value, partials }
    }
}

impl<const N: usize> Add for Dual<N> {
    type Output = Self;
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn add(mut self, other: Self) -> Self {
        self.value += other.value;
        for (a, b) in self.partials.iter_mut().zip(other.partials) {
            *a += b;
        }
        self
    }
}

impl<const N: usize> Sub for Dual<N> {
    type Output = Self;
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn sub(mut self, other: Self) -> Self {
        self.value -= other.value;
        for (a, b) in self.partials.iter_mut().zip(other.partials) {
            *a -= b;
        }
        self
    }
}

impl<const N: usize> Mul for Dual<N> {
    type Output = Self;
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn mul(mut self, other: Self) -> Self {
        for (a, b) in self.partials.iter_mut().zip(other.partials) {
            *a = *a * other.value + self.value * b;
        }
        self.value *= other.value;
        self
    }
}

impl<const N: usize> Div for Dual<N> {
    type Output = Self;
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn div(mut self, other: Self) -> Self {
        let inverse = 1.0 / other.value;
        let quotient = self.value * inverse;
        for (a, b) in self.partials.iter_mut().zip(other.partials) {
            *a = (*a - quotient * b) * inverse;
        }
        self.value /= other.value;
        self
    }
}

impl<const N: usize> Neg for Dual<N> {
    type Output = Self;
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn neg(self) -> Self {
        self * -1.0
    }
}

impl<const N: usize> Mul<f64> for Dual<N> {
    type Output = Self;
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn mul(mut self, factor: f64) -> Self {
        self.value *= factor;
        for a in &mut self.partials {
            *a *= factor;
        }
        self
    }
}

impl<const N: usize> Scalar for Dual<N> {
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn constant(value: f64) -> Self {
        Dual {
            value,
            partials: [0.0; N],
        }
    }
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn value(self) -> f64 {
        self.value
    }
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn map(mut self, value: f64, slope: f64) -> Self {
        self.value = value;
        for a in &mut self.partials {
            *a *= slope;
        }
        self
    }
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn map3(value: f64, parts: [(Self, f64); 3]) -> Self {
        let mut sum = Self::constant(value);
        for (part, slope) in parts {
            for (a, b) in sum.partials.iter_mut().zip(part.partials) {
                *a += slope * b;
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_quotients_and_angles_differentiate_by_the_rules_of_calculus() {
        let x = Dual::<2>::variable(0.7, 0);
        let y = Dual::<2>::variable(-1.3, 1);
        let f = (x * y + x / y).exp() * y.atan2(x).sin();
        let at = |x: f64, y: f64| (x * y + x / y).exp() * y.atan2(x).sin();
        let h = 1e-6;
        let dx = (at(0.7 + h, -1.3) - at(0.7 - h, -1.3)) / (2.0 * h);
        let dy = (at(0.7, -1.3 + h) - at(0.7, -1.3 - h)) / (2.0 * h);
        assert_eq!(f.value, at(0.7, -1.3));
        // Central differences are good to h² f''' and ε/h, both below 1e-9 here.
        assert!((f.partials[0] - dx).abs() < 1e-8);
        assert!((f.partials[1] - dy).abs() < 1e-8);
    }
}
