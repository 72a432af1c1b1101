//! Forward-mode derivatives: a number that carries its partial derivatives.
//!
//! The closed forms are written once over [`Number`]; with `f64` they give a value, with [`Dual`] the exact gradient.
//! Tests compare the hand-written gradient of the inner loop with that of the same forms by the crate num-dual.

use std::array;
use std::ops::{Add, Div, Mul, Neg, Sub};

use super::fresnel::{Reflectances, Slopes};
use super::number::Number;

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
        self.times(-1.0)
    }
}

impl<const N: usize> Number for Dual<N> {
    type Choice = bool;

    #[cfg_attr(not(debug_assertions), inline(always))]
    fn like(self, value: f64) -> Self {
        Dual {
            value,
            partials: [0.0; N],
        }
    }
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn below(self, other: Self) -> bool {
        self.value < other.value
    }
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn choose(choice: bool, yes: Self, no: Self) -> Self {
        if choice { yes } else { no }
    }
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn map(mut self, f: impl Fn(f64) -> (f64, f64)) -> Self {
        let (value, slope) = f(self.value);
        self.value = value;
        for a in &mut self.partials {
            *a *= slope;
        }
        self
    }
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn map2(self, other: Self, f: impl Fn(f64, f64) -> (f64, f64, f64)) -> Self {
        let (value, first, second) = f(self.value, other.value);
        Dual {
            value,
            partials: array::from_fn(|j| first * self.partials[j] + second * other.partials[j]),
        }
    }
    fn mirrored(self, eta: Self, k: Self) -> (Self, Self) {
        let r = Reflectances::at(self.value, eta.value, k.value);
        let lift = |x: Slopes| Dual {
            value: x.value,
            partials: array::from_fn(|j| {
                x.cos * self.partials[j] + x.eta * eta.partials[j] + x.k * k.partials[j]
            }),
        };
        (lift(r.s), lift(r.p))
    }
    #[cfg_attr(not(debug_assertions), inline(always))]
    fn times(mut self, factor: f64) -> Self {
        self.value *= factor;
        for a in &mut self.partials {
            *a *= factor;
        }
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_quotients_and_angles_differentiate_by_the_rules_of_calculus() {
        let x = Dual::<2>::variable(0.7, 0);
        let y = Dual::<2>::variable(-1.3, 1);
        let f = (x * y + x / y).exponential() * y.angle(x).sine_cosine().0;
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
