//! Stokes vectors, Mueller matrices and smooth boundaries for polarised light, with the sign convention of the program.
//!
//! Call [`Boundary::new`] for a pair of media and [`Boundary::at`] for a hit; [`Channel::mueller`] is the Mueller
//! matrix in the frame of the hit. The ray tracer uses the same parts.
//!
//! The convention is that of NIST's SCATMECH: exp(−iωt), N = n + ik, Stokes vector
//! (I, Q = I_s − I_p, U = I_(s+p) − I_(s−p), V = I_left − I_right), and in the frame of a hit with
//! normal m
//!
//! ```text
//! s = m × k / |m × k|, the same for the incident, reflected and refracted beam;   p = k × s of each beam
//! r_s = (c − q)/(c + q),  r_p = (N² c − q)/(N² c + q),  q² = N² − 1 + c²,  Im q ≥ 0   (N relative, c = cos θ)
//! ```
//!
//! so that r_p = −r_s at normal incidence and m23 = +Im(r_s r_p*). Other programs (Mitsuba 3) have the opposite sign
//! of V: D M D, D = diag(1, 1, 1, −1).
//!
//! A boundary acts on s and p separately, so on I ± Q by two powers and on U, V by one complex number z = r_s r_p*: a
//! [`Channel`].
//!
//! *Conditioning.* Amplitudes and powers are those of [`super::fresnel`], without the cancellation at an index
//! near 1. The refracted power is not 1 − R but a product of its own, and R + T = 1 to rounding from grazing to normal.
//! The number z = r_s r_p* is a product. The refracted cosine is the root of a sum (k = 0) and 0 beyond the critical
//! angle. At that angle it has half of the digits, because the angle of refraction is ill-conditioned there.

mod absorbing;
mod lanes;

use nalgebra::{Complex, Matrix4, Vector4};

pub use absorbing::{excess, slant};

use super::fresnel::{refracted, refracted_squared, sin_squared};
use absorbing::Media;

/// A Stokes vector (I, Q, U, V) in its beam's frame (s, p).
pub type Stokes = Vector4<f64>;

/// A Mueller matrix from one beam's frame to another's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mueller(pub Matrix4<f64>);

impl Mueller {
    /// The matrix that leaves every beam unchanged.
    #[must_use]
    pub fn identity() -> Self {
        Mueller(Matrix4::identity())
    }

    /// Turns the frame of a beam by `angle_rad`: s' = cos s + sin p.
    #[must_use]
    pub fn rotation(angle_rad: f64) -> Self {
        let (s, c) = (2.0 * angle_rad).sin_cos();
        #[rustfmt::skip]
        let rows = Matrix4::new(
            1.0, 0.0, 0.0, 0.0,
            0.0,   c,   s, 0.0,
            0.0,  -s,   c, 0.0,
            0.0, 0.0, 0.0, 1.0,
        );
        Mueller(rows)
    }

    /// Returns the matrix of the reversed path, with each beam in the frame (z × k, k × s) of its own direction: O Mᵀ
    /// O, O = diag(1, 1, −1, 1).
    #[must_use]
    pub fn reversed_path(&self) -> Self {
        let mut m = self.0.transpose();
        for i in [0, 1, 3] {
            m[(i, 2)] = -m[(i, 2)];
            m[(2, i)] = -m[(2, i)];
        }
        Mueller(m)
    }

    /// Returns the smallest eigenvalue of the coherency matrix (Cloude) over its trace. A sum of physical processes
    /// has none below 0; the matrix of pure depolarisation reaches 1/4.
    ///
    /// Cloude 1986: H = ¼ Σ m_ij σ_i ⊗ σ_j*; its trace is m00.
    #[must_use]
    pub fn smallest_cloude_share(&self) -> f64 {
        let (o, l, i) = (
            Complex::new(0.0, 0.0),
            Complex::new(1.0, 0.0),
            Complex::new(0.0, 1.0),
        );
        // Pauli matrices in the order of I, Q, U, V for (s, p); V = −2 Im(E_s E_p*).
        let sigma = [
            [[l, o], [o, l]],
            [[l, o], [o, -l]],
            [[o, l], [l, o]],
            [[o, -i], [i, o]],
        ];
        let trace = self.0[(0, 0)];
        let mut h = Matrix4::<Complex<f64>>::zeros();
        for (a, sa) in sigma.iter().enumerate() {
            for (b, sb) in sigma.iter().enumerate() {
                let weight = Complex::new(0.25 * self.0[(a, b)] / trace, 0.0);
                for row in 0..4 {
                    for column in 0..4 {
                        h[(row, column)] +=
                            weight * sa[row / 2][column / 2] * sb[row % 2][column % 2].conj();
                    }
                }
            }
        }
        // The eigenvalue solver's reflections take squares, which lose all digits if they underflow.
        let flushed = |x: f64| if x.abs() < 1e-100 { 0.0 } else { x };
        h.apply(|x| *x = Complex::new(flushed(x.re), flushed(x.im)));
        h.symmetric_eigenvalues().min()
    }
}

impl std::ops::Mul for Mueller {
    type Output = Mueller;
    fn mul(self, first: Mueller) -> Mueller {
        Mueller(self.0 * first.0)
    }
}

/// The action of a boundary on a beam in the frame of the hit: powers of s and p, and the complex factor of the product
/// E_s E_p*.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Channel<T = f64> {
    /// Power factor of s.
    pub s: T,
    /// Power factor of p.
    pub p: T,
    /// Re(r_s r_p*), or of t_s t_p* times the flux factor.
    pub re: T,
    /// Im(r_s r_p*).
    pub im: T,
}

impl Channel {
    /// No light.
    pub const NONE: Channel = Channel {
        s: 0.0,
        p: 0.0,
        re: 0.0,
        im: 0.0,
    };

    /// Returns the power factor of unpolarised light.
    #[must_use]
    pub fn unpolarised(&self) -> f64 {
        0.5 * (self.s + self.p)
    }

    /// Returns the Mueller matrix in the frame of the hit.
    #[must_use]
    pub fn mueller(&self) -> Mueller {
        let (a, b) = (0.5 * (self.s + self.p), 0.5 * (self.s - self.p));
        #[rustfmt::skip]
        let rows = Matrix4::new(
              a,   b,      0.0,     0.0,
              b,   a,      0.0,     0.0,
            0.0, 0.0,  self.re, self.im,
            0.0, 0.0, -self.im, self.re,
        );
        Mueller(rows)
    }
}

/// A smooth boundary, for light from one side.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Boundary {
    /// Relative index N = N_beyond / n_here.
    relative: Complex<f64>,
    /// N².
    squared: Complex<f64>,
    /// N² − 1, formed without cancellation.
    lift: Complex<f64>,
    /// Whether both media are transparent.
    transparent: bool,
    /// The media, if one of them is an absorbing layer.
    absorbing: Option<Media>,
}

/// The reflected and refracted parts at a hit on a [`Boundary`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Split<T = f64> {
    /// The reflected part.
    pub reflected: Channel<T>,
    /// The refracted part; [`Channel::NONE`] under total reflection and into a metal.
    pub refracted: Channel<T>,
    /// Cosine of the angle of refraction; 0 under total reflection and into a metal.
    pub cos_refracted: T,
    /// Sine of the angle of refraction over that of incidence, if light is refracted.
    pub ratio: T,
}

impl<T> Split<T> {
    /// Returns all ten numbers in the order of the fields, to lay them out in lanes.
    #[inline(always)]
    fn numbers(self) -> [T; 10] {
        let (r, t) = (self.reflected, self.refracted);
        [
            r.s,
            r.p,
            r.re,
            r.im,
            t.s,
            t.p,
            t.re,
            t.im,
            self.cos_refracted,
            self.ratio,
        ]
    }
}

impl Boundary {
    /// A boundary from a medium of real index `here` to one of index `n + ik`, exp(−iωt), k ≥ 0.
    #[must_use]
    pub fn new(here: f64, n: f64, k: f64) -> Self {
        let (rn, rk) = (n / here, k / here);
        Boundary {
            relative: Complex::new(rn, rk),
            squared: Complex::new(rn * rn - rk * rk, 2.0 * rn * rk),
            lift: Complex::new(
                (n - here) * (n + here) / (here * here) - rk * rk,
                2.0 * rn * rk,
            ),
            transparent: k == 0.0,
            absorbing: None,
        }
    }

    /// As [`Self::new`], for media either of which may be an absorbing layer: from `here`, the medium of the light, to
    /// `beyond`. Light continues in a transparent `beyond`; in an absorbing one only if it `enters`, otherwise `beyond`
    /// is a metal.
    #[must_use]
    pub fn between(here: Complex<f64>, beyond: Complex<f64>, enters: bool) -> Self {
        let plain = Boundary::new(here.re, beyond.re, beyond.im);
        let enters = enters || beyond.im == 0.0;
        if here.im == 0.0 && (beyond.im == 0.0 || !enters) {
            return plain;
        }
        Boundary {
            transparent: false,
            absorbing: Some(Media::new(here, beyond, enters)),
            ..plain
        }
    }

    /// Whether it loses no power: all light that is not reflected is refracted.
    #[must_use]
    pub fn is_transparent(&self) -> bool {
        self.transparent
    }

    /// Whether light cannot continue beyond at any angle.
    #[must_use]
    pub fn is_metal(&self) -> bool {
        !self.transparent && self.absorbing.is_none_or(|media| !media.enters())
    }

    /// Returns the shares (s, p) of the power that are not reflected at cos θ = `cos`: 1 − R without the cancellation
    /// for R near 1 (4 c Re q/|c + q|² and 4 c Re(N² q*)/|N² c + q|²).
    #[must_use]
    pub fn kept(&self, cos: f64) -> (f64, f64) {
        let q = refracted(cos, self.squared, self.lift);
        if self.transparent && q.re == 0.0 {
            return (0.0, 0.0);
        }
        let (sum_s, sum_p) = (q + cos, self.squared * cos + q);
        let s = 4.0 * cos * q.re / sum_s.norm_sqr();
        let p = 4.0 * cos * (self.squared * q.conj()).re / sum_p.norm_sqr();
        (s, p)
    }

    /// Returns reflection and refraction at cos θ = `cos` in (0, 1]; reflected and refracted powers add up to 1 on a
    /// transparent boundary.
    #[must_use]
    #[inline]
    pub fn at(&self, cos: f64) -> Split {
        if self.transparent {
            let n = self.relative.re;
            let n2 = self.squared.re;
            let q2 = refracted_squared(cos, n2, self.lift.re);
            if q2 <= 0.0 {
                return Split {
                    reflected: self.total(cos, q2),
                    refracted: Channel::NONE,
                    cos_refracted: 0.0,
                    ratio: 1.0 / n,
                };
            }
            let q = q2.sqrt();
            let (sum_s, sum_p) = (cos + q, n2 * cos + q);
            // The products keep the digits that c − q and N²c − q lose for N near 1.
            let r_s = -self.lift.re / (sum_s * sum_s);
            let r_p = self.lift.re * (n2 * cos * cos - sin_squared(cos)) / (sum_p * sum_p);
            let (t_s, t_p) = (2.0 * cos / sum_s, 2.0 * n * cos / sum_p);
            let flux = q / cos;
            return Split {
                reflected: Channel {
                    s: r_s * r_s,
                    p: r_p * r_p,
                    re: r_s * r_p,
                    im: 0.0,
                },
                refracted: Channel {
                    s: flux * t_s * t_s,
                    p: flux * t_p * t_p,
                    re: flux * t_s * t_p,
                    im: 0.0,
                },
                cos_refracted: q / n,
                ratio: 1.0 / n,
            };
        }
        if let Some(media) = &self.absorbing {
            return media.at(cos);
        }
        let q = refracted(cos, self.squared, self.lift);
        let over_s = inverse(q + cos);
        let over_p = inverse(self.squared * cos + q);
        let brewster = self.squared * (cos * cos) - sin_squared(cos);
        let r_s = -self.lift * over_s * over_s;
        let r_p = self.lift * over_p * (brewster * over_p);
        let z = r_s * r_p.conj();
        Split {
            reflected: Channel {
                s: r_s.norm_sqr().min(1.0),
                p: r_p.norm_sqr().min(1.0),
                re: z.re,
                im: z.im,
            },
            refracted: Channel::NONE,
            cos_refracted: 0.0,
            ratio: 1.0 / self.relative.re,
        }
    }

    /// Total reflection: both amplitudes have modulus 1; only their phases differ.
    fn total(&self, cos: f64, q2: f64) -> Channel {
        let q = (-q2).sqrt();
        let n2c = self.squared.re * cos;
        // r_s = (c − iq)/(c + iq) and r_p = (N²c − iq)/(N²c + iq), so z = r_s r_p* has the modulus 1.
        let z = (Complex::new(cos, -q) * Complex::new(n2c, q))
            / (Complex::new(cos, q) * Complex::new(n2c, -q));
        Channel {
            s: 1.0,
            p: 1.0,
            re: z.re,
            im: z.im,
        }
    }
}

#[inline]
fn inverse(z: Complex<f64>) -> Complex<f64> {
    z.conj() * (1.0 / z.norm_sqr())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tiny_element_does_not_make_a_physical_matrix_unphysical() {
        let gold = Boundary::new(1.0, 0.35, 2.7).at(0.8).reflected.mueller();
        for angle in [0.0, 5e-324, 1e-310, 1e-160, 1e-12] {
            let turned = Mueller::rotation(angle) * gold;
            assert!(turned.smallest_cloude_share() > -1e-15, "{angle:e}");
        }
    }

    #[test]
    fn brewster_s_angle_reflects_no_p() {
        let theta = 1.5f64.atan();
        let split = Boundary::new(1.0, 1.5, 0.0).at(theta.cos());
        assert!((theta.to_degrees() - 56.310).abs() < 5e-4);
        assert!(split.reflected.p < 1e-30, "{}", split.reflected.p);
        assert!((split.reflected.unpolarised() - 0.073_964_5).abs() < 5e-8);
    }

    #[test]
    fn a_transparent_boundary_loses_nothing_and_is_the_same_from_behind() {
        for n in [1.0001, 1.3, 1.5, 2.4, 20.0] {
            let (down, up) = (Boundary::new(1.0, n, 0.0), Boundary::new(n, 1.0, 0.0));
            for i in 0..=90 {
                let cos = (f64::from(i) * 0.999_99).to_radians().cos();
                let there = down.at(cos);
                let sum_s = there.reflected.s + there.refracted.s;
                let sum_p = there.reflected.p + there.refracted.p;
                assert!((sum_s - 1.0).abs() < 1e-13 && (sum_p - 1.0).abs() < 1e-13);
                let back = up.at(there.cos_refracted);
                // The cosine of refraction has a rounding error that N² and 1/cos magnify.
                let tolerance = 1e-14 * n * n / cos;
                assert!((back.reflected.s - there.reflected.s).abs() < tolerance);
                assert!((back.reflected.p - there.reflected.p).abs() < tolerance);
                assert!((back.refracted.re - there.refracted.re).abs() < tolerance);
            }
        }
    }

    #[test]
    fn total_reflection_keeps_the_power_and_turns_the_phase_as_in_fresnel_s_rhomb() {
        // Born & Wolf: glass 1.51 at 54°37' gives a phase difference of 45°.
        let boundary = Boundary::new(1.51, 1.0, 0.0);
        let split = boundary.at((54.0f64 + 37.0 / 60.0).to_radians().cos());
        let phase = split.reflected.im.atan2(split.reflected.re).to_degrees();
        assert!((phase.abs() - 45.0).abs() < 0.02, "{phase}");
        assert!((split.reflected.re.hypot(split.reflected.im) - 1.0).abs() < 1e-14);
        assert_eq!(split.refracted, Channel::NONE);
    }

    #[test]
    fn a_metal_s_powers_agree_with_the_second_paper_s_equations() {
        // Wang et al. 2017, first equations, signs restored; n0 = 1.
        let (n, k) = (0.3504f64, 2.7141f64);
        for degrees in [0.0f64, 20.0, 45.0, 70.0, 85.0] {
            let theta = degrees.to_radians();
            let (sin, cos) = theta.sin_cos();
            let inner = n * n - k * k - sin * sin;
            let square = (inner * inner + 4.0 * n * n * k * k).sqrt();
            let (a2, b2) = (0.5 * (square + inner), 0.5 * (square - inner));
            let a = a2.sqrt();
            let fs = ((cos - a).powi(2) + b2) / ((cos + a).powi(2) + b2);
            let st = sin * theta.tan();
            let fp = fs * ((a - st).powi(2) + b2) / ((a + st).powi(2) + b2);
            let r = Boundary::new(1.0, n, k).at(cos).reflected;
            assert!((r.s - fs).abs() < 1e-14 && (r.p - fp).abs() < 1e-14);
            assert!((r.re.hypot(r.im) - (fs * fp).sqrt()).abs() < 1e-14);
            let b = b2.sqrt();
            let delta_s = (2.0 * b * cos).atan2(cos * cos - a2 - b2);
            let delta_p = (2.0 * cos * ((n * n - k * k) * b - 2.0 * n * k * a))
                .atan2((n * n + k * k).powi(2) * cos * cos - a2 - b2);
            let m23 = (fs * fp).sqrt() * (delta_p - delta_s).sin();
            assert!((r.im - m23).abs() < 1e-13, "{degrees}: {} {m23}", r.im);
        }
    }

    #[test]
    fn reflections_are_physical_and_a_constructed_impossible_matrix_is_not() {
        for cos in [0.05, 0.3, 0.8, 1.0] {
            for boundary in [
                Boundary::new(1.0, 1.5, 0.0),
                Boundary::new(1.5, 1.0, 0.0),
                Boundary::new(1.0, 0.18, 3.4),
            ] {
                let m = Mueller::rotation(0.3)
                    * boundary.at(cos).reflected.mueller()
                    * Mueller::rotation(-1.1);
                assert!(m.smallest_cloude_share() > -1e-14);
            }
        }
        let impossible = Mueller(Matrix4::from_diagonal(&Vector4::new(1.0, 1.0, 1.0, -1.0)));
        assert!(impossible.smallest_cloude_share() < -0.4);
        let depolariser = Mueller(Matrix4::from_diagonal(&Vector4::new(1.0, 0.0, 0.0, 0.0)));
        assert!((depolariser.smallest_cloude_share() - 0.25).abs() < 1e-14);
    }
}
