//! The operations that the hand-written derivatives need of a number besides those of [`Number`].
//!
//! [`super::form`] is written once over [`Register`] and runs on `f64`, with all digits, and on a [`Lane`], whose numbers
//! are surfaces of a search or views of one observation, with the digits that [`super::lanes`] states.

use std::f64::consts::FRAC_1_SQRT_2;

use pulp::Simd;

use super::fresnel::{Boundary, Reflectances, Slopes, dielectric_slopes};
use super::lanes::{self, Lane, Mask};
use super::number::Number;

/// A number, or several side by side, for the derivatives by hand.
pub(crate) trait Register: Number {
    /// Least divisor. Smaller ones are those of quotients that are not selected.
    const TINY: f64;

    /// Returns self · factor + term.
    fn fused(self, factor: Self, term: Self) -> Self;
    /// Whether a choice is true anywhere.
    fn any(choice: Self::Choice) -> bool;
    /// Whether both choices are true.
    fn both(one: Self::Choice, other: Self::Choice) -> Self::Choice;
    /// Returns e^−self for self ≥ 0.
    fn falling(self) -> Self;
    /// Returns the angle of the point (x, self) for two numbers ≥ 0.
    fn quadrant_angle(self, x: Self) -> Self;
    /// Returns the share of the normal distribution below self, and its density there.
    fn normal_share(self) -> (Self, Self);
    /// Returns the unpolarised reflectance of index η + ik at this cosine of incidence, which is above 0.
    fn reflectance(self, eta: f64, k: f64) -> Slopes<Self>;
    /// Returns the wall at this cosine of incidence; a wall that is not `seen` reflects all.
    fn wall(self, seen: Self::Choice, eta: f64, k: f64) -> Boundary<Self>;

    /// Returns 1/self for a divisor ≥ 0.
    #[inline(always)]
    fn per(self) -> Self {
        self.like(1.0) / self.larger(self.like(Self::TINY))
    }
}

impl Register for f64 {
    const TINY: f64 = f64::MIN_POSITIVE;

    #[inline(always)]
    fn fused(self, factor: f64, term: f64) -> f64 {
        self * factor + term
    }
    #[inline(always)]
    fn any(choice: bool) -> bool {
        choice
    }
    #[inline(always)]
    fn both(one: bool, other: bool) -> bool {
        one && other
    }
    #[inline(always)]
    fn falling(self) -> f64 {
        (-self).exp()
    }
    #[inline(always)]
    fn quadrant_angle(self, x: f64) -> f64 {
        self.atan2(x)
    }
    #[inline(always)]
    fn normal_share(self) -> (f64, f64) {
        let density = (-0.5 * self * self).exp() * lanes::FRAC_1_SQRT_TAU;
        (0.5 * libm::erfc(-self * FRAC_1_SQRT_2), density)
    }
    #[inline(always)]
    fn reflectance(self, eta: f64, k: f64) -> Slopes {
        if k == 0.0 {
            dielectric_slopes(self, eta)
        } else {
            Reflectances::at(self, eta, k).unpolarised()
        }
    }
    #[inline(always)]
    fn wall(self, seen: bool, eta: f64, k: f64) -> Boundary<f64> {
        let all = Slopes {
            value: 1.0,
            cos: 0.0,
            eta: 0.0,
            k: 0.0,
        };
        if !seen {
            return Boundary {
                f: all,
                parts: (k != 0.0).then_some([all; 2]),
            };
        }
        if k == 0.0 {
            return Boundary {
                f: dielectric_slopes(self, eta),
                parts: None,
            };
        }
        let parts = Reflectances::at(self, eta, k);
        Boundary {
            f: parts.unpolarised(),
            parts: Some([parts.s, parts.p]),
        }
    }
}

impl<S: Simd> Register for Lane<S> {
    const TINY: f64 = 1e-9;

    #[inline(always)]
    fn fused(self, factor: Self, term: Self) -> Self {
        self.mul_add(factor, term)
    }
    #[inline(always)]
    fn any(choice: Mask<S>) -> bool {
        choice.any()
    }
    #[inline(always)]
    fn both(one: Mask<S>, other: Mask<S>) -> Mask<S> {
        one.and(other)
    }
    #[inline(always)]
    fn falling(self) -> Self {
        self.exp_neg()
    }
    #[inline(always)]
    fn quadrant_angle(self, x: Self) -> Self {
        self.angle_to(x)
    }
    #[inline(always)]
    fn normal_share(self) -> (Self, Self) {
        Lane::normal_share(self)
    }
    #[inline(always)]
    fn reflectance(self, eta: f64, k: f64) -> Slopes<Self> {
        lanes::fresnel::wall(self, eta, k).f
    }
    #[inline(always)]
    fn wall(self, seen: Mask<S>, eta: f64, k: f64) -> Boundary<Self> {
        let (one, zero) = (self.like(1.0), self.like(0.0));
        let boundary = lanes::fresnel::wall(self.larger(self.like(Self::TINY)), eta, k);
        macro_rules! seen {
            ($of:expr) => {
                Slopes {
                    value: seen.select($of.value, one),
                    cos: seen.select($of.cos, zero),
                    eta: seen.select($of.eta, zero),
                    k: seen.select($of.k, zero),
                }
            };
        }
        let parts = match boundary.parts {
            Some([s, p]) => Some([seen!(s), seen!(p)]),
            None => None,
        };
        Boundary {
            f: seen!(boundary.f),
            parts,
        }
    }
}
