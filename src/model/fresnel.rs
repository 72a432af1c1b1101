//! Fresnel reflection at a smooth boundary of index N = n + ik.
//!
//! Call [`reflectance`] (unpolarised value), [`Reflectances::at`] (R_s, R_p and their derivatives) or [`amplitudes`].
//! All take the cosine of the angle of incidence, so that grazing incidence loses no digits, and an index relative to
//! the medium of incidence. Convention exp(−iωt), N = n + ik with k ≥ 0.
//!
//! With q² = N² − 1 + c² (c = cos θ, Im q ≥ 0) the amplitudes r_s = (c − q)/(c + q) and r_p = (N²c − q)/(N²c + q) are
//! differences of nearly equal numbers if N is near 1. In the product form they are not:
//!
//! ```text
//! r_s = −(N² − 1) / (c + q)²        r_p = (N² − 1) ((N² + 1) c² − 1) / (N² c + q)²
//! ```
//!
//! and N² − 1 = (n − 1)(n + 1) − k² + 2ink is exact to rounding. These forms give 0 for N = 1, 1 at grazing, and R =
//! 1 to rounding for total internal reflection. Their roundings add up to a few units in the last place of R. If R is
//! above ½, it is computed as 1 − T from the transmitted share, with T_s = 4c Re q/|c + q|² and T_p = 4c Re(N²
//! q*)/|N² c + q|², whose roundings decrease with T. The sign of r_p is that of the electric field's component along
//! p (r_p = −r_s at normal incidence).
//!
//! Polarisation states are in [`super::polarisation`].

use nalgebra::Complex;

/// Returns the amplitude reflection coefficients (r_s, r_p) at cos θ = `cos` for the relative index `eta + i k`.
#[must_use]
pub fn amplitudes(cos: f64, eta: f64, k: f64) -> (Complex<f64>, Complex<f64>) {
    let parts = Parts::new(cos, eta, k);
    (parts.r_s, parts.r_p)
}

/// Returns the unpolarised reflectance (R_s + R_p)/2 at cos θ = `cos` for the relative index `eta + i k`.
#[must_use]
pub fn reflectance(cos: f64, eta: f64, k: f64) -> f64 {
    let (r_s, r_p) = reflectances(cos, eta, k);
    0.5 * (r_s + r_p)
}

/// Returns 1 − [`reflectance`], with all its digits if next to nothing enters.
#[must_use]
pub fn transmittance(cos: f64, eta: f64, k: f64) -> f64 {
    let (t_s, t_p) = transmittances(cos, eta, k);
    let t = 0.5 * (t_s + t_p);
    // An index whose square overflows transmits nothing.
    if t.is_nan() {
        1.0 - reflectance(cos, eta, k)
    } else {
        t
    }
}

/// Returns the transmitted shares (1 − R_s, 1 − R_p) without a difference of nearly equal numbers.
fn transmittances(cos: f64, eta: f64, k: f64) -> (f64, f64) {
    let lift = (eta - 1.0) * (eta + 1.0);
    if k == 0.0 {
        let n2 = eta * eta;
        let q2 = refracted_squared(cos, n2, lift);
        if q2 <= 0.0 {
            return if lift == 0.0 { (1.0, 1.0) } else { (0.0, 0.0) };
        }
        let q = q2.sqrt();
        let (sum_s, sum_p) = (cos + q, n2 * cos + q);
        let flux = 4.0 * cos * q;
        return (flux / (sum_s * sum_s), flux * n2 / (sum_p * sum_p));
    }
    let n = Complex::new(eta, k);
    let n2 = n * n;
    let q = refracted(cos, n2, Complex::new(lift - k * k, 2.0 * eta * k));
    let (sum_s, sum_p) = (q + cos, n2 * cos + q);
    let share = |flux: f64, sum: Complex<f64>| (4.0 * cos * flux / sum.norm_sqr()).max(0.0);
    (share(q.re, sum_s), share((n2 * q.conj()).re, sum_p))
}

/// Returns the power reflectances (R_s, R_p), each within [0, 1].
#[must_use]
pub fn reflectances(cos: f64, eta: f64, k: f64) -> (f64, f64) {
    let lift = (eta - 1.0) * (eta + 1.0);
    if k == 0.0 {
        let n2 = eta * eta;
        let q2 = refracted_squared(cos, n2, lift);
        if q2 <= 0.0 {
            return if lift == 0.0 { (0.0, 0.0) } else { (1.0, 1.0) };
        }
        let q = q2.sqrt();
        let sum_s = cos + q;
        let sum_p = n2 * cos + q;
        let r_s = lift / (sum_s * sum_s);
        let r_p = lift * (n2 * cos * cos - sin_squared(cos)) / (sum_p * sum_p);
        return settled(r_s * r_s, r_p * r_p, cos, eta, k);
    }
    let parts = Parts::new(cos, eta, k);
    settled(parts.r_s.norm_sqr(), parts.r_p.norm_sqr(), cos, eta, k)
}

/// Computes reflectances above ½ from the transmitted share; returns 1 for an index so large that its square overflows.
fn settled(r_s: f64, r_p: f64, cos: f64, eta: f64, k: f64) -> (f64, f64) {
    let (r_s, r_p) = (r_s.min(1.0), r_p.min(1.0));
    if r_s <= 0.5 && r_p <= 0.5 {
        return (r_s, r_p);
    }
    let (t_s, t_p) = transmittances(cos, eta, k);
    // If T is NaN, R is kept.
    let better = |r: f64, t: f64| if r > 0.5 && t < 1.0 { 1.0 - t } else { r };
    (better(r_s, t_s), better(r_p, t_p))
}

/// Returns sin² θ without the cancellation of 1 − cos².
#[inline]
pub(super) fn sin_squared(cos: f64) -> f64 {
    (1.0 - cos) * (1.0 + cos)
}

/// The N² from which q² is formed as (N² − 1) + cos², which keeps its digits for N near 1 at grazing; below it, q² is
/// formed as N² − sin², which keeps them for N ≪ 1 near the critical angle.
pub(super) const RARE: f64 = 0.5;

/// Returns q² = N² − sin² θ for a real relative index; `lift` is N² − 1.
#[inline]
pub(super) fn refracted_squared(cos: f64, n2: f64, lift: f64) -> f64 {
    if n2 < RARE {
        n2 - sin_squared(cos)
    } else {
        lift + cos * cos
    }
}

/// Returns q, the root of N² − sin² θ with Im q ≥ 0, for a complex relative index; `lift` is N² − 1.
#[inline]
pub(super) fn refracted(cos: f64, n2: Complex<f64>, lift: Complex<f64>) -> Complex<f64> {
    principal_sqrt(if n2.re.abs() < RARE {
        n2 - sin_squared(cos)
    } else {
        lift + cos * cos
    })
}

struct Parts {
    n: Complex<f64>,
    lift: Complex<f64>,
    q: Complex<f64>,
    /// 1/(q (c + q)²) and 1/(q (N²c + q)²); 0 if q is 0.
    per_s: Complex<f64>,
    per_p: Complex<f64>,
    r_s: Complex<f64>,
    r_p: Complex<f64>,
}

impl Parts {
    #[inline]
    fn new(cos: f64, eta: f64, k: f64) -> Self {
        let n = Complex::new(eta, k);
        let n2 = n * n;
        let lift = Complex::new((eta - 1.0) * (eta + 1.0) - k * k, 2.0 * eta * k);
        let q = refracted(cos, n2, lift);
        let (sum_s, sum_p) = (q + cos, n2 * cos + q);
        let zero = Complex::new(0.0, 0.0);
        let brewster = n2 * (cos * cos) - sin_squared(cos);
        if q == zero {
            // The critical angle, or matched media: reflectances 1 and 0.
            let matched = lift == zero;
            return Parts {
                n,
                lift,
                q,
                per_s: zero,
                per_p: zero,
                r_s: if matched {
                    zero
                } else {
                    -lift / (sum_s * sum_s)
                },
                r_p: if matched {
                    zero
                } else {
                    lift * brewster / (sum_p * sum_p)
                },
            };
        }
        let per_s = inverse(q * sum_s * sum_s);
        let per_p = inverse(q * sum_p * sum_p);
        Parts {
            n,
            lift,
            q,
            per_s,
            per_p,
            r_s: -lift * q * per_s,
            r_p: lift * brewster * q * per_p,
        }
    }
}

/// Returns 1/z with a single division.
fn inverse(z: Complex<f64>) -> Complex<f64> {
    let scale = 1.0 / z.norm_sqr();
    Complex::new(z.re * scale, -z.im * scale)
}

/// Returns the root with non-negative real and imaginary part of a number whose imaginary part is ≥ 0. The larger of
/// the two parts is computed from the modulus, the smaller from the product, so that neither cancels.
pub(super) fn principal_sqrt(z: Complex<f64>) -> Complex<f64> {
    let modulus = z.norm_sqr().sqrt();
    if modulus == 0.0 {
        return Complex::new(0.0, 0.0);
    }
    if z.re >= 0.0 {
        let a = (0.5 * (modulus + z.re)).sqrt();
        Complex::new(a, 0.5 * z.im / a)
    } else {
        let b = (0.5 * (modulus - z.re)).sqrt();
        Complex::new(0.5 * z.im / b, b)
    }
}

/// A reflectance with its derivatives with respect to the cosine of the angle of incidence and to the index.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slopes<N = f64> {
    /// The reflectance, within [0, 1].
    pub value: N,
    /// ∂/∂ cos θ.
    pub cos: N,
    /// ∂/∂ n.
    pub eta: N,
    /// ∂/∂ k.
    pub k: N,
}

/// What a smooth wall reflects of light from one direction.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Boundary<R> {
    /// The unpolarised reflectance.
    pub(super) f: Slopes<R>,
    /// R_s and R_p of a metal; `None` for a dielectric, whose terms use the unpolarised one.
    pub(super) parts: Option<[Slopes<R>; 2]>,
}

/// R_s and R_p with their first derivatives.
///
/// At the critical angle (q = 0) the derivatives are infinite; 0 is returned there, as on the side of total reflection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reflectances {
    /// Electric field perpendicular to the plane of incidence.
    pub s: Slopes,
    /// Electric field in the plane of incidence.
    pub p: Slopes,
}

impl Reflectances {
    /// Evaluates at cos θ = `cos` for the relative index `eta + i k`.
    ///
    /// Derivation: dq/dc = c/q and dq/dN = N/q give
    /// ∂r_s/∂c = 2(N² − 1)/(q (c + q)²), ∂r_s/∂N = −2cN/(q (c + q)²),
    /// ∂r_p/∂c = 2N²(N² − 1)/(q (N²c + q)²), ∂r_p/∂N = 2cN(2q² − N²)/(q (N²c + q)²);
    /// dR = 2 Re(r* dr), dN = dn + i dk.
    #[must_use]
    pub fn at(cos: f64, eta: f64, k: f64) -> Self {
        let flat = |value: f64| Slopes {
            value,
            cos: 0.0,
            eta: 0.0,
            k: 0.0,
        };
        let z = Parts::new(cos, eta, k);
        let (r_s, r_p) = reflectances(cos, eta, k);
        if z.q == Complex::new(0.0, 0.0) {
            return Reflectances {
                s: flat(r_s),
                p: flat(r_p),
            };
        }
        let slopes = |value: f64, r: Complex<f64>, dc: Complex<f64>, dn: Complex<f64>| {
            let r = r.conj();
            let dn = r * dn;
            Slopes {
                value,
                cos: 2.0 * (r * dc).re,
                eta: 2.0 * dn.re,
                k: -2.0 * dn.im,
            }
        };
        let (ws, wp) = (z.per_s, z.per_p);
        let n2 = z.n * z.n;
        Reflectances {
            s: slopes(r_s, z.r_s, z.lift * ws * 2.0, -z.n * ws * (2.0 * cos)),
            p: slopes(
                r_p,
                z.r_p,
                n2 * z.lift * wp * 2.0,
                z.n * (z.q * z.q * 2.0 - n2) * wp * (2.0 * cos),
            ),
        }
    }

    /// (R_s + R_p)/2 with its derivatives.
    #[must_use]
    pub fn unpolarised(&self) -> Slopes {
        Slopes {
            value: 0.5 * (self.s.value + self.p.value),
            cos: 0.5 * (self.s.cos + self.p.cos),
            eta: 0.5 * (self.s.eta + self.p.eta),
            k: 0.5 * (self.s.k + self.p.k),
        }
    }
}

/// Returns the unpolarised reflectance of a dielectric with its derivatives: [`Reflectances::at`] for k = 0 in real
/// arithmetic. ∂R/∂k is 0, since R is even in k, except under total reflection.
#[must_use]
pub fn dielectric_slopes(cos: f64, eta: f64) -> Slopes {
    let lift = (eta - 1.0) * (eta + 1.0);
    let n2 = eta * eta;
    let q2 = refracted_squared(cos, n2, lift);
    if q2 <= 0.0 {
        // Under total reflection the least absorption lowers R: ∂R/∂k < 0.
        return Reflectances::at(cos, eta, 0.0).unpolarised();
    }
    let q = q2.sqrt();
    // One division in place of three, since this is the innermost loop.
    let (sum_s, sum_p) = (cos + q, n2 * cos + q);
    let per_all = 1.0 / (q * sum_s * sum_p);
    let per_s = per_all * q * sum_p;
    let per_p = per_all * q * sum_s;
    let per_q = 2.0 * per_all * sum_s * sum_p;
    let (s2, p2) = (per_s * per_s, per_p * per_p);
    let r_s = lift * s2;
    let r_p = lift * (n2 * cos * cos - sin_squared(cos)) * p2;
    Slopes {
        value: (0.5 * (r_s * r_s + r_p * r_p)).min(1.0),
        cos: per_q * (n2 * lift * p2 * r_p - r_s * r_s),
        eta: per_q * cos * eta * (r_s * s2 + r_p * (2.0 * q2 - n2) * p2),
        k: 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const INDICES: [(f64, f64); 9] = [
        (1.0, 0.0),
        (1.0 + 1e-12, 0.0),
        (1.54, 0.0),
        (2.5, 0.0),
        (0.65, 0.0),
        (2.9, 3.1),
        (0.15, 3.5),
        (10.0, 30.0),
        (1.0, 1e-9),
    ];

    #[test]
    fn normal_incidence_is_the_squared_ratio_of_index_differences() {
        for (eta, k) in INDICES {
            let expected = ((eta - 1.0).powi(2) + k * k) / ((eta + 1.0).powi(2) + k * k);
            for r in [reflectances(1.0, eta, k).0, reflectances(1.0, eta, k).1] {
                assert!(
                    (r - expected).abs() <= 8.0 * f64::EPSILON * expected,
                    "{eta} {k}: {r} {expected}"
                );
            }
        }
    }

    #[test]
    fn grazing_incidence_reflects_everything_unless_the_index_is_one() {
        for (eta, k) in INDICES {
            let (s, p) = reflectances(0.0, eta, k);
            let expected = if eta == 1.0 && k == 0.0 { 0.0 } else { 1.0 };
            assert!(
                (s - expected).abs() < 1e-14 && (p - expected).abs() < 1e-14,
                "{eta} {k}"
            );
        }
    }

    #[test]
    fn brewsters_angle_transmits_all_of_p() {
        let eta: f64 = 1.5;
        let cos = (1.0 / (1.0 + eta * eta)).sqrt();
        let (s, p) = reflectances(cos, eta, 0.0);
        assert!(p < 1e-31, "{p}");
        // There ½ R_s is ½ ((η² − 1)/(η² + 1))², 0.0739645 for 1.5.
        assert!((0.5 * s - 0.073_964_497_041_420_12).abs() < 1e-16);
    }

    #[test]
    fn total_internal_reflection_is_total() {
        let eta: f64 = 1.0 / 1.5;
        let critical = (1.0 - eta * eta).sqrt();
        for cos in [0.0, 0.3, critical * 0.999_999] {
            assert_eq!(reflectances(cos, eta, 0.0), (1.0, 1.0));
            let (r_s, r_p) = amplitudes(cos, eta, 0.0);
            assert!((r_s.norm() - 1.0).abs() < 1e-14 && (r_p.norm() - 1.0).abs() < 1e-14);
        }
        assert!(reflectances(critical * 1.001, eta, 0.0).0 < 1.0);
    }

    #[test]
    fn an_index_barely_above_one_keeps_its_digits() {
        let eps = 1.0 / f64::from(1u32 << 30);
        // To leading order r_s = −ε/(2c²) and r_p = ε (2c² − 1)/(2c²).
        for cos in [1.0, 0.6, 0.05] {
            let (s, p) = reflectances(cos, 1.0 + eps, 0.0);
            let s0 = (eps / (2.0 * cos * cos)).powi(2);
            let p0 = (eps * (2.0 * cos * cos - 1.0) / (2.0 * cos * cos)).powi(2);
            let next_order = 4.0 * eps / (cos * cos);
            assert!((s - s0).abs() <= next_order * s0, "{cos}");
            assert!((p - p0).abs() <= next_order * s0, "{cos}");
        }
    }

    #[test]
    fn the_derivatives_agree_with_num_dual_on_the_textbook_form() {
        use num_dual::{DualNum, DualSVec64};
        type D = DualSVec64<3>;
        // Textbook real form (Wang et al. 2017, Eqs. 2–3): a, b of n cos θt = a + ib.
        let textbook = |c: D, n: D, k: D| {
            let s2 = -(c * c) + 1.0;
            let d = n * n - k * k - s2;
            let root = (d * d + n * n * k * k * 4.0).sqrt();
            let a = ((root + d) * 0.5).sqrt();
            let b = n * k / a;
            let rs = ((c - a).powi(2) + b * b) / ((c + a).powi(2) + b * b);
            let st = s2 / c;
            let rp = rs * ((a - st).powi(2) + b * b) / ((a + st).powi(2) + b * b);
            (rs, rp)
        };
        for (eta, k) in [
            (1.54, 0.0),
            (2.5, 0.0),
            (2.9, 3.1),
            (0.15, 3.5),
            (10.0, 30.0),
        ] {
            for cos in [0.999, 0.8, 0.5, 0.2, 0.05] {
                let var = |x: f64, i: usize| {
                    D::new(
                        x,
                        num_dual::Derivative::derivative_generic(
                            nalgebra::Const::<3>,
                            nalgebra::Const::<1>,
                            i,
                        ),
                    )
                };
                let (s, p) = textbook(var(cos, 0), var(eta, 1), var(k, 2));
                let ours = Reflectances::at(cos, eta, k);
                for (theirs, mine) in [(s, ours.s), (p, ours.p)] {
                    let e = theirs
                        .eps
                        .unwrap_generic(nalgebra::Const::<3>, nalgebra::Const::<1>);
                    assert!((theirs.re - mine.value).abs() < 1e-13);
                    for (a, b) in [(e[0], mine.cos), (e[1], mine.eta), (e[2], mine.k)] {
                        assert!(
                            (a - b).abs() < 1e-11 * (1.0 + a.abs()),
                            "{eta} {k} {cos}: {a} {b}"
                        );
                    }
                }
            }
        }
    }
}
