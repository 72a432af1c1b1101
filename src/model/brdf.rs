//! The printed BRDF to the last digit, with a named error for every undefined case.
//!
//! Call [`evaluate`]. It takes the angles as given in a table and computes in double-double arithmetic, so the error
//! is about that of the final rounding: |f − exact| ≤ 2⁻⁵³ |f|, including grazing incidence, narrow lobes and indices
//! near 1. Fits use [`super::paper`], which is as exact as f64 allows and a hundred times faster.
//!
//! Traps: on the side that the facets lean to, G1/(ω·n) = 1/(cos θr ω·m), while the printed 1 − tan θr tan θp
//! cancels; h·v_m is a difference of nearly equal products if h is near m; cos and sin of the difference angle
//! are |ω_i ± ω_o|/2, not from arccos of a dot product.

use thiserror::Error;

use super::double_double::{ComplexDd, Dd};

/// One row: directions, surface, optics. Angles in rad; φ counts from u towards v.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Case {
    /// Angle of ω_i from n, rad.
    pub theta_i: f64,
    /// Azimuth of ω_i from u towards v, rad.
    pub phi_i: f64,
    /// Angle of ω_o from n, rad.
    pub theta_o: f64,
    /// Azimuth of ω_o from u towards v, rad.
    pub phi_o: f64,
    /// Ridge angle, rad.
    pub theta_r: f64,
    /// Beckmann roughness along the ridges, tangent of slope.
    pub alpha_u: f64,
    /// Beckmann roughness across the ridges, tangent of slope.
    pub alpha_v: f64,
    /// The lobe's ρd as printed, 0 to 1.
    pub rho_d: f64,
    /// Real part of the index, relative to the surroundings.
    pub eta: f64,
    /// Imaginary part of the index, relative to the surroundings.
    pub k: f64,
}

/// The BRDF and its factors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Evaluation {
    /// f, sr⁻¹ (Eq. 6).
    pub f: f64,
    /// D, sr⁻¹ (Eq. 3).
    pub d: f64,
    /// G = G1(ω_i) G1(ω_o) (Eqs. 1, 2).
    pub g: f64,
    /// F, unpolarised reflectance at the half vector.
    pub fresnel: f64,
}

/// The reason why a row has no result as an f64.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
pub enum Refusal {
    /// An input is NaN or infinite.
    #[error("{0} is not a finite number")]
    NotFinite(&'static str),
    /// A direction is at or below the horizon.
    #[error("{0} is not within ±π/2: the direction is not above the surface")]
    BelowHorizon(&'static str),
    /// The ridge angle is 90° or more.
    #[error("theta_r is not within ±π/2")]
    RidgeTooSteep,
    /// A roughness is zero (a delta function) or negative.
    #[error("{0} is not positive: a perfectly smooth surface has no finite BRDF")]
    RoughnessNotPositive(&'static str),
    /// A reflectance or an index is negative.
    #[error("{0} is negative")]
    Negative(&'static str),
    /// The index is zero.
    #[error("eta and k are both zero: there is no such index")]
    IndexZero,
    /// A result exceeds the largest double.
    #[error("{0} exceeds the largest double")]
    Overflow(&'static str),
}

impl Case {
    fn check(&self) -> Result<(), Refusal> {
        let named = [
            ("theta_i", self.theta_i),
            ("phi_i", self.phi_i),
            ("theta_o", self.theta_o),
            ("phi_o", self.phi_o),
            ("theta_r", self.theta_r),
            ("alpha_u", self.alpha_u),
            ("alpha_v", self.alpha_v),
            ("rho_d", self.rho_d),
            ("eta", self.eta),
            ("k", self.k),
        ];
        for (name, value) in named {
            if !value.is_finite() {
                return Err(Refusal::NotFinite(name));
            }
        }
        // The double nearest π/2 is below π/2, the next one above it.
        let right_angle = std::f64::consts::FRAC_PI_2;
        for (name, theta) in [("theta_i", self.theta_i), ("theta_o", self.theta_o)] {
            if theta.abs() > right_angle {
                return Err(Refusal::BelowHorizon(name));
            }
        }
        if self.theta_r.abs() > right_angle {
            return Err(Refusal::RidgeTooSteep);
        }
        for (name, alpha) in [("alpha_u", self.alpha_u), ("alpha_v", self.alpha_v)] {
            if alpha <= 0.0 {
                return Err(Refusal::RoughnessNotPositive(name));
            }
        }
        for (name, value) in [("rho_d", self.rho_d), ("eta", self.eta), ("k", self.k)] {
            if value < 0.0 {
                return Err(Refusal::Negative(name));
            }
        }
        if self.eta == 0.0 && self.k == 0.0 {
            return Err(Refusal::IndexZero);
        }
        Ok(())
    }
}

/// Evaluates Eqs. 1–6 with masking to the pitch normal. A value below the smallest double rounds to 0.
///
/// # Errors
/// [`Refusal`] names the invalid input or the result out of range.
pub fn evaluate(case: &Case) -> Result<Evaluation, Refusal> {
    case.check()?;
    let direction = |theta: f64, phi: f64| {
        let (st, ct) = Dd::sin_cos(theta);
        let (sp, cp) = Dd::sin_cos(phi);
        [st * cp, st * sp, ct]
    };
    let i = direction(case.theta_i, case.phi_i);
    let o = direction(case.theta_o, case.phi_o);
    let (sin, cos) = Dd::sin_cos(case.theta_r);

    let (g_i, per_cos_i) = masking(i, sin, cos);
    let (g_o, per_cos_o) = masking(o, sin, cos);
    let g = g_i * g_o;

    let sum = [i[0] + o[0], i[1] + o[1], i[2] + o[2]];
    let difference = [i[0] - o[0], i[1] - o[1], i[2] - o[2]];
    let norm2 = |w: [Dd; 3]| w[0] * w[0] + w[1] * w[1] + w[2] * w[2];
    let h2 = norm2(sum);
    let fresnel = reflectance(
        h2.sqrt() * 0.5,
        norm2(difference).sqrt() * 0.5,
        case.eta,
        case.k,
    );

    let h_m = sum[1] * sin + sum[2] * cos;
    let h_e = sum[1] * cos - sum[2] * sin;
    let density = density(sum[0], h_e, h_m, h2, case.alpha_u, case.alpha_v);
    let through = Dd::ONE - fresnel;
    let bracket = Scaled::from(fresnel)
        + Scaled::from(through * through) * Scaled::from(case.rho_d) / Scaled::from(Dd::PI);
    let f =
        density * Scaled::from(per_cos_i) * Scaled::from(per_cos_o) * bracket * Scaled::from(0.25);

    let finite = |name: &'static str, x: Scaled| {
        let value = x.to_f64();
        if value.is_finite() {
            Ok(value)
        } else {
            Err(Refusal::Overflow(name))
        }
    };
    // A fully masked lobe is invisible, whatever its height.
    let f = if g.hi <= 0.0 { 0.0 } else { finite("f", f)? };
    Ok(Evaluation {
        f,
        d: finite("d", density)?,
        g: g.hi,
        fresnel: fresnel.hi,
    })
}

/// Returns G1(ω) and G1(ω)/(ω·n).
fn masking(w: [Dd; 3], sin: Dd, cos: Dd) -> (Dd, Dd) {
    let m = w[1] * sin + w[2] * cos;
    if m.hi <= 0.0 {
        return (Dd::ZERO, Dd::ZERO);
    }
    let e = w[1] * cos - w[2] * sin;
    if e.hi * sin.hi.signum() > 0.0 && sin.hi != 0.0 {
        let per_cos = Dd::ONE / (cos * m);
        return (w[2] * per_cos, per_cos);
    }
    let open = Dd::ONE + sin * e / (cos * m);
    if open.hi <= 0.0 {
        return (Dd::ZERO, Dd::ZERO);
    }
    (open, open / w[2])
}

/// Returns D for the half vector (x along u_m, y along v_m, z along m; squared length `h2`).
fn density(x: Dd, y: Dd, z: Dd, h2: Dd, alpha_u: f64, alpha_v: f64) -> Scaled {
    if z.hi <= 0.0 {
        return Scaled::ZERO;
    }
    let slope_u = Scaled::from(x / z) / Scaled::from(alpha_u);
    let slope_v = Scaled::from(y / z) / Scaled::from(alpha_v);
    // No other factor in f can bring e^(−10⁸) back into the range of doubles.
    let (Some(a), Some(b)) = (slope_u.below(1e4), slope_v.below(1e4)) else {
        return Scaled::ZERO;
    };
    let (mantissa, exponent) = (-(a * a + b * b)).exp_scaled();
    let cos2 = z * z / h2;
    let peak = Scaled { mantissa, exponent } / Scaled::from(Dd::PI * cos2 * cos2);
    peak / Scaled::from(alpha_u) / Scaled::from(alpha_v)
}

/// Returns the unpolarised reflectance from cosine and sine of the angle of incidence.
fn reflectance(cos: Dd, sin: Dd, eta: f64, k: f64) -> Dd {
    let size = eta.max(k);
    let real = ComplexDd::real;
    let (r_s, r_p) = if size >= 4.0 {
        // Inverse index M = 1/N, scaled so that N² does not overflow.
        let (a, b) = (Dd::from(eta) / Dd::from(size), Dd::from(k) / Dd::from(size));
        let n2 = a * a + b * b;
        let inverse = ComplexDd::new(a / n2 / Dd::from(size), -(b / n2 / Dd::from(size)));
        let bent = inverse.scale(sin);
        let w = (real(Dd::ONE) - bent * bent).sqrt();
        let cm = inverse.scale(cos);
        let mw = inverse * w;
        ((cm - w) / (cm + w), (real(cos) - mw) / (real(cos) + mw))
    } else if size >= 0.1 {
        let n = ComplexDd::new(Dd::from(eta), Dd::from(k));
        let one = real(Dd::ONE);
        let lift = (n - one) * (n + one);
        if lift == real(Dd::ZERO) {
            return Dd::ZERO;
        }
        let n2 = n * n;
        let q = (lift + real(cos * cos)).sqrt();
        let sum_s = real(cos) + q;
        let sum_p = n2.scale(cos) + q;
        let brewster = (n2 + one).scale(cos * cos) - one;
        (lift / (sum_s * sum_s), lift * brewster / (sum_p * sum_p))
    } else {
        let ratio = sin.hi / size;
        if ratio > 1e20 {
            return Dd::ONE;
        }
        // N = size (a + ib), s/N = (s/size)/(a + ib).
        let n = ComplexDd::new(Dd::from(eta), Dd::from(k));
        let unit = ComplexDd::new(Dd::from(eta) / Dd::from(size), Dd::from(k) / Dd::from(size));
        let bent = real(sin / Dd::from(size)) / unit;
        let w = (real(Dd::ONE) - bent * bent).sqrt();
        // The decaying branch: Im(N w) ≥ 0.
        let nw = n * w;
        let (w, nw) = if nw.im.hi < 0.0 {
            (w.scale(Dd::from(-1.0)), nw.scale(Dd::from(-1.0)))
        } else {
            (w, nw)
        };
        let nc = n.scale(cos);
        ((real(cos) - nw) / (real(cos) + nw), (nc - w) / (nc + w))
    };
    let mean = (r_s.norm_sqr() + r_p.norm_sqr()) * 0.5;
    if mean.hi > 1.0 { Dd::ONE } else { mean }
}

/// A double-double with a separate power of two, so that products of extreme factors stay in range.
#[derive(Debug, Clone, Copy)]
struct Scaled {
    mantissa: Dd,
    exponent: i64,
}

/// Returns 2^e for any e, within the range of doubles.
fn power_of_two(e: i64) -> f64 {
    2f64.powi(e.clamp(-1100, 1100) as i32)
}

impl Scaled {
    const ZERO: Scaled = Scaled {
        mantissa: Dd::ZERO,
        exponent: 0,
    };

    fn normalised(mantissa: Dd, exponent: i64) -> Scaled {
        if mantissa.hi == 0.0 {
            return Scaled::ZERO;
        }
        // Subnormals are first scaled into the normal range, where the exponent field is valid.
        let (mantissa, exponent) = if mantissa.hi.abs() < f64::MIN_POSITIVE {
            let up = power_of_two(200);
            (
                Dd {
                    hi: mantissa.hi * up,
                    lo: mantissa.lo * up,
                },
                exponent - 200,
            )
        } else {
            (mantissa, exponent)
        };
        let shift = ((mantissa.hi.to_bits() >> 52) & 0x7ff) as i64 - 1023;
        // In two steps: 2^−shift itself may not be a normal double.
        let (a, b) = (
            power_of_two(-(shift / 2)),
            power_of_two(-(shift - shift / 2)),
        );
        Scaled {
            mantissa: Dd {
                hi: mantissa.hi * a * b,
                lo: mantissa.lo * a * b,
            },
            exponent: exponent + shift,
        }
    }

    fn to_f64(self) -> f64 {
        if self.mantissa.hi == 0.0 || self.exponent < -1100 {
            return 0.0;
        }
        if self.exponent > 1100 {
            return f64::INFINITY;
        }
        // |mantissa| is in [1, 2): one multiplication rounds once, also into the subnormals.
        let half = self.exponent / 2;
        if self.exponent >= -1000 {
            self.mantissa.hi * power_of_two(half) * power_of_two(self.exponent - half)
        } else {
            (self.mantissa.hi * power_of_two(-1000)) * power_of_two(self.exponent + 1000)
        }
    }

    /// Returns the plain number if its modulus is below `limit`.
    fn below(self, limit: f64) -> Option<Dd> {
        let value = self.to_f64();
        if value.abs() >= limit {
            return None;
        }
        if self.exponent < -1000 {
            return Some(Dd::ZERO);
        }
        let scale = power_of_two(self.exponent);
        Some(Dd {
            hi: self.mantissa.hi * scale,
            lo: self.mantissa.lo * scale,
        })
    }
}

impl From<Dd> for Scaled {
    fn from(value: Dd) -> Self {
        Scaled::normalised(value, 0)
    }
}

impl From<f64> for Scaled {
    fn from(value: f64) -> Self {
        Scaled::normalised(Dd::from(value), 0)
    }
}

impl std::ops::Mul for Scaled {
    type Output = Scaled;
    fn mul(self, other: Scaled) -> Scaled {
        Scaled::normalised(
            self.mantissa * other.mantissa,
            self.exponent + other.exponent,
        )
    }
}

impl std::ops::Div for Scaled {
    type Output = Scaled;
    fn div(self, other: Scaled) -> Scaled {
        Scaled::normalised(
            self.mantissa / other.mantissa,
            self.exponent - other.exponent,
        )
    }
}

impl std::ops::Add for Scaled {
    type Output = Scaled;
    fn add(self, other: Scaled) -> Scaled {
        let (large, small) = if self.mantissa.hi == 0.0 {
            return other;
        } else if other.mantissa.hi == 0.0 {
            return self;
        } else if self.exponent >= other.exponent {
            (self, other)
        } else {
            (other, self)
        };
        let gap = small.exponent - large.exponent;
        if gap < -300 {
            return large;
        }
        let scale = power_of_two(gap);
        let aligned = Dd {
            hi: small.mantissa.hi * scale,
            lo: small.mantissa.lo * scale,
        };
        Scaled::normalised(large.mantissa + aligned, large.exponent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cases::reference::{PRINTED_BRDF, ReferenceTable};

    #[test]
    fn every_reference_case_is_exact_to_its_last_digit() {
        let table = ReferenceTable::read(PRINTED_BRDF);
        assert_eq!(table.rows().count(), 3000);
        for row in table.rows() {
            let (name, case) = (row.text("case"), row.case());
            let [f, d, g, fresnel, cond] =
                ["f", "d", "g", "fresnel", "cond"].map(|column| row.number(column));
            let e = evaluate(&case).unwrap();
            // The requirement is 4 · 2⁻⁵³ (1 + cond); the form needs only one rounding of the result.
            let bound = 0.5 * f64::EPSILON * (1.0 + cond) * f;
            assert!(
                (e.f - f).abs() <= bound,
                "{name} {case:?}: {} against {f}",
                e.f
            );
            for (ours, theirs) in [(e.f, f), (e.d, d), (e.g, g), (e.fresnel, fresnel)] {
                assert!(
                    // At index 1 exactly F is 0; there the table contains the rounding of its 60 digits.
                    (ours - theirs).abs() <= f64::EPSILON * theirs.abs() + 1e-60,
                    "{name} {case:?}: {ours} against {theirs}"
                );
            }
        }
    }

    #[test]
    fn no_finite_input_makes_a_nan_and_every_error_is_named() {
        let extremes = [
            0.0,
            -0.0,
            1.0,
            -1.0,
            0.5,
            1e-3,
            1.5,
            std::f64::consts::FRAC_PI_2,
            std::f64::consts::FRAC_PI_2 + 1e-14,
            5e-324,
            1e-310,
            2.2e-308,
            1e-300,
            1e-160,
            1e-16,
            1e16,
            1e100,
            1e160,
            1e300,
            f64::MAX,
            -1e300,
            3.0,
            1.0 + f64::EPSILON,
            1.0 - f64::EPSILON,
        ];
        // A linear congruential generator picks the fields, so every draw is repeatable.
        let mut state: u64 = 12345;
        let mut next = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize
        };
        let base = Case {
            theta_i: 0.4,
            phi_i: 1.0,
            theta_o: 0.7,
            phi_o: -2.0,
            theta_r: 0.2,
            alpha_u: 0.1,
            alpha_v: 0.2,
            rho_d: 0.3,
            eta: 1.5,
            k: 0.0,
        };
        let (mut answered, mut refused) = (0, 0);
        for _ in 0..60_000 {
            let mut c = base;
            for _ in 0..1 + next() % 6 {
                let value = extremes[next() % extremes.len()];
                match next() % 10 {
                    0 => c.theta_i = value,
                    1 => c.phi_i = value,
                    2 => c.theta_o = value,
                    3 => c.phi_o = value,
                    4 => c.theta_r = value,
                    5 => c.alpha_u = value,
                    6 => c.alpha_v = value,
                    7 => c.rho_d = value,
                    8 => c.eta = value,
                    _ => c.k = value,
                }
            }
            match evaluate(&c) {
                Ok(e) => {
                    answered += 1;
                    assert!(
                        e.f.is_finite() && e.f >= 0.0 && e.d.is_finite() && e.d >= 0.0,
                        "{c:?} {e:?}"
                    );
                    assert!((0.0..=1.0).contains(&e.g), "{c:?} {e:?}");
                    assert!((0.0..=1.0).contains(&e.fresnel), "{c:?} {e:?}");
                }
                Err(_) => refused += 1,
            }
        }
        assert!(answered > 5000 && refused > 5000, "{answered} {refused}");
    }

    #[test]
    fn inputs_that_are_not_finite_are_refused_by_the_name_of_the_column() {
        let table = ReferenceTable::read(PRINTED_BRDF);
        let mut case = table.rows().next().unwrap().case();
        case.eta = f64::NAN;
        assert_eq!(evaluate(&case), Err(Refusal::NotFinite("eta")));
        case.eta = 1.5;
        case.alpha_v = f64::INFINITY;
        assert_eq!(evaluate(&case), Err(Refusal::NotFinite("alpha_v")));
        case.alpha_v = 0.0;
        assert_eq!(
            evaluate(&case),
            Err(Refusal::RoughnessNotPositive("alpha_v"))
        );
    }

    #[test]
    fn a_tall_lobe_is_refused_and_a_faint_one_is_zero() {
        let case = Case {
            theta_i: 0.0,
            phi_i: 0.0,
            theta_o: 0.0,
            phi_o: 0.0,
            theta_r: 0.0,
            alpha_u: 1e-200,
            alpha_v: 1e-200,
            rho_d: 0.0,
            eta: 1.5,
            k: 0.0,
        };
        assert_eq!(evaluate(&case), Err(Refusal::Overflow("f")));
        let off = Case {
            theta_o: 1e-3,
            ..case
        };
        assert_eq!(evaluate(&off).unwrap().f, 0.0);
    }
}
