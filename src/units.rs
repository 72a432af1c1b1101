//! Angles are a type, because stages use degrees and the mathematics uses radians.
//!
//! All other quantities are an `f64` whose name ends in its unit (`exposure_s`, `pixel_um`).

use std::fmt;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

/// A plane angle, stored in radians and accessed by the name of the unit.
#[derive(Debug, Clone, Copy, PartialEq, PartialOrd, Default)]
pub struct Angle {
    rad: f64,
}

impl Angle {
    /// The zero angle.
    pub const ZERO: Angle = Angle { rad: 0.0 };

    /// Makes an angle from degrees.
    #[must_use]
    pub const fn from_deg(deg: f64) -> Self {
        Angle {
            rad: deg * (std::f64::consts::PI / 180.0),
        }
    }

    /// Makes an angle from radians.
    #[must_use]
    pub const fn from_rad(rad: f64) -> Self {
        Angle { rad }
    }

    /// The angle in degrees.
    #[must_use]
    pub fn deg(self) -> f64 {
        self.rad.to_degrees()
    }

    /// The angle in degrees for tables and reports: rounded to a nanodegree, so that the rounding
    /// error of the conversion does not appear (−20 instead of −20.000000000000004).
    #[must_use]
    pub fn deg_for_tables(self) -> f64 {
        (self.deg() * 1e9).round() / 1e9
    }

    /// The angle in radians.
    #[must_use]
    pub const fn rad(self) -> f64 {
        self.rad
    }

    /// Sine and cosine, in that order.
    #[must_use]
    pub fn sin_cos(self) -> (f64, f64) {
        self.rad.sin_cos()
    }

    /// Magnitude of the angle.
    #[must_use]
    pub fn abs(self) -> Self {
        Angle {
            rad: self.rad.abs(),
        }
    }

    /// Whether the angle is a finite number.
    #[must_use]
    pub fn is_finite(self) -> bool {
        self.rad.is_finite()
    }

    /// The same direction in (−180°, 180°].
    #[must_use]
    pub fn wrapped(self) -> Self {
        let turn = std::f64::consts::TAU;
        let r = self.rad.rem_euclid(turn);
        Angle {
            rad: if r > std::f64::consts::PI {
                r - turn
            } else {
                r
            },
        }
    }
}

impl fmt::Display for Angle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        /// Beyond this, decimals would be a row of digits that mean nothing.
        const PLAIN_MAX_DEG: f64 = 1e9;
        let (precision, deg) = (f.precision().unwrap_or(3), self.deg());
        match deg.abs() < PLAIN_MAX_DEG {
            true => write!(f, "{deg:.precision$}°"),
            false => {
                // The conversion from radians leaves digits that were not stated.
                let rounded = format!("{deg:.9e}").parse().unwrap_or(deg);
                write!(f, "{rounded:e}°")
            }
        }
    }
}

impl Add for Angle {
    type Output = Angle;
    fn add(self, other: Angle) -> Angle {
        Angle {
            rad: self.rad + other.rad,
        }
    }
}

impl AddAssign for Angle {
    fn add_assign(&mut self, other: Angle) {
        self.rad += other.rad;
    }
}

impl Sub for Angle {
    type Output = Angle;
    fn sub(self, other: Angle) -> Angle {
        Angle {
            rad: self.rad - other.rad,
        }
    }
}

impl Neg for Angle {
    type Output = Angle;
    fn neg(self) -> Angle {
        Angle { rad: -self.rad }
    }
}

impl Mul<f64> for Angle {
    type Output = Angle;
    fn mul(self, factor: f64) -> Angle {
        Angle {
            rad: self.rad * factor,
        }
    }
}

impl Div<f64> for Angle {
    type Output = Angle;
    fn div(self, divisor: f64) -> Angle {
        Angle {
            rad: self.rad / divisor,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_show_the_exact_degrees() {
        for deg in [-20.0, 0.1, 330.0, 7.25] {
            assert_eq!(Angle::from_deg(deg).deg_for_tables(), deg);
        }
    }

    #[test]
    fn wrapping_includes_the_upper_end_and_excludes_the_lower() {
        assert!((Angle::from_deg(180.0).wrapped().deg() - 180.0).abs() < 1e-12);
        assert!((Angle::from_deg(-180.0).wrapped().deg() - 180.0).abs() < 1e-12);
        assert!((Angle::from_deg(359.0).wrapped().deg() + 1.0).abs() < 1e-12);
        assert!((Angle::from_deg(-541.0).wrapped().deg() - 179.0).abs() < 1e-12);
    }
}
