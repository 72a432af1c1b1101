//! Three-component vectors with the few products that hot loops need, fast even without
//! optimisation.

use std::ops::{Add, Mul, Sub};

/// A vector in the sample frame (u, v, n).
pub type V3 = [f64; 3];

/// A number, or a register of numbers.
pub trait Component: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> {}

impl<T: Copy + Add<Output = T> + Sub<Output = T> + Mul<Output = T>> Component for T {}

/// The macro-surface normal.
pub const UP: V3 = [0.0, 0.0, 1.0];

/// a · b.
#[inline(always)]
#[must_use]
pub fn dot<T: Component>(a: &[T; 3], b: &[T; 3]) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// a × b.
#[inline(always)]
#[must_use]
pub fn cross<T: Component>(a: &[T; 3], b: &[T; 3]) -> [T; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// a x + b y.
#[inline]
#[must_use]
pub fn combine(a: f64, x: &V3, b: f64, y: &V3) -> V3 {
    [
        a * x[0] + b * y[0],
        a * x[1] + b * y[1],
        a * x[2] + b * y[2],
    ]
}

/// a x.
#[inline]
#[must_use]
pub fn scaled(a: f64, x: &V3) -> V3 {
    [a * x[0], a * x[1], a * x[2]]
}

/// x normalised to length 1.
#[inline]
#[must_use]
pub fn unit(x: &V3) -> V3 {
    scaled(1.0 / dot(x, x).sqrt(), x)
}
