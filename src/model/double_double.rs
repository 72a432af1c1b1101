//! Numbers of about 32 digits as unevaluated sums of two doubles.
//!
//! The cancellations of the printed BRDF (half vectors near the pitch normal, masking at grazing incidence, Fresnel
//! near index 1) leave sixteen digits here. Algorithms: Dekker 1971, Knuth's two-sum, and the reductions of Hida, Li
//! and Bailey 2001 for the elementary functions.

use std::ops::{Add, Div, Mul, Neg, Sub};

/// hi + lo with |lo| ≤ ½ ulp(hi).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dd {
    /// Leading part: the value rounded to a double.
    pub hi: f64,
    /// The value less `hi`.
    pub lo: f64,
}

fn two_sum(a: f64, b: f64) -> Dd {
    let hi = a + b;
    let bb = hi - a;
    Dd {
        hi,
        lo: (a - (hi - bb)) + (b - bb),
    }
}

fn quick_two_sum(a: f64, b: f64) -> Dd {
    let hi = a + b;
    Dd {
        hi,
        lo: b - (hi - a),
    }
}

fn two_product(a: f64, b: f64) -> Dd {
    let hi = a * b;
    Dd {
        hi,
        lo: a.mul_add(b, -hi),
    }
}

/// π/2 in four doubles, leading first.
const HALF_PI: [f64; 4] = [
    std::f64::consts::FRAC_PI_2,
    6.123_233_995_736_766e-17,
    -1.497_384_904_859_17e-33,
    4.320_574_262_296_449e-50,
];
const LN_2: Dd = Dd {
    hi: std::f64::consts::LN_2,
    lo: 2.319_046_813_846_299_6e-17,
};
/// Above this, in rad, an angle's own rounding exceeds the gain of the reduction.
const LARGEST_REDUCED: f64 = 1e5;

impl Dd {
    /// 0.
    pub const ZERO: Dd = Dd { hi: 0.0, lo: 0.0 };
    /// 1.
    pub const ONE: Dd = Dd { hi: 1.0, lo: 0.0 };
    /// π.
    pub const PI: Dd = Dd {
        hi: std::f64::consts::PI,
        lo: 1.224_646_799_147_353_2e-16,
    };

    /// Returns the square root of a non-negative number.
    #[must_use]
    pub fn sqrt(self) -> Dd {
        if self.hi <= 0.0 {
            return Dd::ZERO;
        }
        let root = self.hi.sqrt();
        let rest = self - two_product(root, root);
        quick_two_sum(root, rest.hi / (2.0 * root))
    }

    /// Returns e^self as (mantissa near 1, power of two), so that neither end of the range is lost.
    #[must_use]
    pub fn exp_scaled(self) -> (Dd, i64) {
        let k = (self.hi / LN_2.hi).round();
        let r = (self - LN_2 * Dd::from(k)) * (1.0 / 512.0);
        // e^r − 1 by Taylor, then (1 + x)² − 1 = x² + 2x nine times, which keeps the small digits.
        let mut term = r;
        let mut sum = r;
        for n in 2..12 {
            term = term * r / Dd::from(f64::from(n));
            sum = sum + term;
        }
        for _ in 0..9 {
            sum = sum * sum + sum * 2.0;
        }
        (sum + Dd::ONE, k as i64)
    }

    /// Returns sine and cosine of an angle in radians; to the last bits below 1e5, beyond it as exact as doubles
    /// allow (the angle's own last bit dominates there).
    #[must_use]
    pub fn sin_cos(angle: f64) -> (Dd, Dd) {
        if angle.abs() > LARGEST_REDUCED {
            let (s, c) = angle.sin_cos();
            return (Dd::from(s), Dd::from(c));
        }
        let k = (angle / HALF_PI[0]).round();
        let mut r = Dd::from(angle);
        for part in HALF_PI {
            r = r - two_product(k, part);
        }
        let r2 = r * r;
        let series = |first: Dd, start: u32| {
            let mut term = first;
            let mut sum = first;
            let mut n = start;
            while n < 34 && term.hi.abs() > sum.hi.abs() * 1e-35 {
                term = -(term * r2) / Dd::from(f64::from((n + 1) * (n + 2)));
                sum = sum + term;
                n += 2;
            }
            sum
        };
        let (s, c) = (series(r, 1), series(Dd::ONE, 0));
        match (k as i64).rem_euclid(4) {
            0 => (s, c),
            1 => (c, -s),
            2 => (-s, -c),
            _ => (-c, s),
        }
    }

    /// Whether both parts are finite.
    #[must_use]
    pub fn is_finite(self) -> bool {
        self.hi.is_finite() && self.lo.is_finite()
    }
}

impl From<f64> for Dd {
    fn from(value: f64) -> Self {
        Dd { hi: value, lo: 0.0 }
    }
}

impl Add for Dd {
    type Output = Dd;
    fn add(self, other: Dd) -> Dd {
        let s = two_sum(self.hi, other.hi);
        let t = two_sum(self.lo, other.lo);
        let s = quick_two_sum(s.hi, s.lo + t.hi);
        quick_two_sum(s.hi, s.lo + t.lo)
    }
}

impl Neg for Dd {
    type Output = Dd;
    fn neg(self) -> Dd {
        Dd {
            hi: -self.hi,
            lo: -self.lo,
        }
    }
}

impl Sub for Dd {
    type Output = Dd;
    fn sub(self, other: Dd) -> Dd {
        self + -other
    }
}

impl Mul for Dd {
    type Output = Dd;
    fn mul(self, other: Dd) -> Dd {
        let p = two_product(self.hi, other.hi);
        quick_two_sum(p.hi, p.lo + (self.hi * other.lo + self.lo * other.hi))
    }
}

impl Mul<f64> for Dd {
    type Output = Dd;
    fn mul(self, factor: f64) -> Dd {
        self * Dd::from(factor)
    }
}

impl Div for Dd {
    type Output = Dd;
    fn div(self, other: Dd) -> Dd {
        let q1 = self.hi / other.hi;
        let r = self - other * q1;
        let q2 = r.hi / other.hi;
        let r = r - other * q2;
        let q3 = r.hi / other.hi;
        quick_two_sum(q1, q2) + Dd::from(q3)
    }
}

/// A complex number of 32 digits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ComplexDd {
    /// Real part.
    pub re: Dd,
    /// Imaginary part.
    pub im: Dd,
}

impl ComplexDd {
    /// re + i im.
    #[must_use]
    pub fn new(re: Dd, im: Dd) -> Self {
        ComplexDd { re, im }
    }

    /// A real number.
    #[must_use]
    pub fn real(re: Dd) -> Self {
        ComplexDd { re, im: Dd::ZERO }
    }

    /// |z|².
    #[must_use]
    pub fn norm_sqr(self) -> Dd {
        self.re * self.re + self.im * self.im
    }

    /// z times a real number.
    #[must_use]
    pub fn scale(self, factor: Dd) -> Self {
        ComplexDd::new(self.re * factor, self.im * factor)
    }

    /// Returns the root with non-negative real part; for a negative real number, i√|z|.
    #[must_use]
    pub fn sqrt(self) -> Self {
        let modulus = self.norm_sqr().sqrt();
        if modulus.hi == 0.0 {
            return ComplexDd::real(Dd::ZERO);
        }
        if self.re.hi >= 0.0 {
            let a = ((modulus + self.re) * 0.5).sqrt();
            ComplexDd::new(a, self.im * 0.5 / a)
        } else {
            let b = ((modulus - self.re) * 0.5).sqrt();
            let b = if self.im.hi < 0.0 { -b } else { b };
            ComplexDd::new(self.im * 0.5 / b, b)
        }
    }
}

impl Add for ComplexDd {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        ComplexDd::new(self.re + other.re, self.im + other.im)
    }
}

impl Sub for ComplexDd {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        ComplexDd::new(self.re - other.re, self.im - other.im)
    }
}

impl Mul for ComplexDd {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        ComplexDd::new(
            self.re * other.re - self.im * other.im,
            self.re * other.im + self.im * other.re,
        )
    }
}

impl Div for ComplexDd {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let n = other.norm_sqr();
        let conj = ComplexDd::new(other.re, -other.im);
        let p = self * conj;
        ComplexDd::new(p.re / n, p.im / n)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: Dd, hi: f64, lo: f64, tolerance: f64) {
        let d = a - Dd { hi, lo };
        assert!(
            d.hi.abs() <= tolerance * hi.abs(),
            "{a:?} against {hi} + {lo}: {d:?}"
        );
    }

    #[test]
    fn sine_squared_plus_cosine_squared_is_one_to_thirty_digits() {
        for k in 0..200 {
            let angle = -7.0 + 0.0713 * f64::from(k);
            let (s, c) = Dd::sin_cos(angle);
            close(s * s + c * c, 1.0, 0.0, 1e-30);
            assert!((s.hi - angle.sin()).abs() <= 1e-15 && (c.hi - angle.cos()).abs() <= 1e-15);
        }
    }

    #[test]
    fn the_cosine_of_the_double_nearest_a_right_angle_is_its_distance_from_it() {
        let (_, c) = Dd::sin_cos(std::f64::consts::FRAC_PI_2);
        close(c, HALF_PI[1], HALF_PI[2], 1e-30);
    }

    #[test]
    fn e_and_square_root_of_two_have_their_known_digits() {
        let (m, k) = Dd::ONE.exp_scaled();
        let e = m * 2f64.powi(k as i32);
        close(e, std::f64::consts::E, 1.445_646_891_729_250_2e-16, 1e-30);
        close(
            Dd::from(2.0).sqrt(),
            std::f64::consts::SQRT_2,
            -9.667_293_313_452_913e-17,
            1e-31,
        );
    }

    #[test]
    fn a_complex_root_squared_is_the_number() {
        for (re, im) in [
            (1.5, 0.0),
            (-2.0, 0.0),
            (-1e-12, 3.0),
            (0.3, -4.0),
            (-5.0, -1e-9),
        ] {
            let z = ComplexDd::new(Dd::from(re), Dd::from(im));
            let r = z.sqrt();
            let d = r * r - z;
            assert!(d.norm_sqr().hi.sqrt() < 1e-30 * (re.abs() + im.abs()));
            assert!(r.re.hi >= 0.0);
        }
    }
}
