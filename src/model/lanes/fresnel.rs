//! Fresnel reflectance of a register of angles with its slopes, for one index.
//!
//! *Conditioning.* These are the plain quotients: ten digits are enough for a start. [`crate::model::fresnel`]
//! returns all digits.

use pulp::Simd;

use super::Lane;
use crate::model::fresnel::{Boundary, Slopes};

/// q² below which light is totally reflected.
const TINY: f64 = 1e-12;

/// Evaluates at cos θ = `cos` > 0 for the index `eta + i k`.
#[inline(always)]
pub(in crate::model) fn wall<S: Simd>(cos: Lane<S>, eta: f64, k: f64) -> Boundary<Lane<S>> {
    if k == 0.0 {
        Boundary {
            f: dielectric(cos, eta),
            parts: None,
        }
    } else {
        let [s, p] = metal(cos, eta, k);
        let half = Lane::splat(cos.0, 0.5);
        let f = Slopes {
            value: half * (s.value + p.value),
            cos: half * (s.cos + p.cos),
            eta: half * (s.eta + p.eta),
            k: half * (s.k + p.k),
        };
        Boundary {
            f,
            parts: Some([s, p]),
        }
    }
}

/// The unpolarised reflectance for a real index; the slopes are those of [`crate::model::fresnel::dielectric_slopes`].
#[inline(always)]
fn dielectric<S: Simd>(cos: Lane<S>, eta: f64) -> Slopes<Lane<S>> {
    macro_rules! k {
        ($x:expr) => {
            Lane::splat(cos.0, $x)
        };
    }
    let (one, half, zero) = (k!(1.0), k!(0.5), k!(0.0));
    let n2 = k!(eta * eta);
    let lift = k!((eta - 1.0) * (eta + 1.0));
    let q2 = cos.mul_add(cos, lift);
    let enters = k!(TINY).less(q2);
    let q2 = q2.max(k!(TINY));
    let q = q2.sqrt();
    let (sum_s, sum_p) = (cos + q, n2.mul_add(cos, q));
    let per_all = one / (q * sum_s * sum_p);
    let (per_s, per_p) = (per_all * q * sum_p, per_all * q * sum_s);
    let per_q = k!(2.0) * per_all * sum_s * sum_p;
    let (s2, p2) = (per_s * per_s, per_p * per_p);
    let r_s = lift * s2;
    let r_p = lift * (n2 * cos * cos - (one - cos) * (one + cos)) * p2;
    macro_rules! entering {
        ($enters:expr, $not:expr) => {
            enters.select($enters, $not)
        };
    }
    Slopes {
        value: entering!(half * r_s.mul_add(r_s, r_p * r_p), one),
        cos: entering!(per_q * (n2 * lift * p2 * r_p - r_s * r_s), zero),
        eta: entering!(
            per_q * cos * k!(eta) * (r_s * s2 + r_p * (q2 + q2 - n2) * p2),
            zero
        ),
        k: zero,
    }
}

/// R_s and R_p for a complex index.
#[inline(always)]
fn metal<S: Simd>(cos: Lane<S>, eta: f64, k: f64) -> [Slopes<Lane<S>>; 2] {
    macro_rules! k {
        ($x:expr) => {
            Lane::splat(cos.0, $x)
        };
    }
    let (zero, one, two, half) = (k!(0.0), k!(1.0), k!(2.0), k!(0.5));
    let (n2, im) = (k!(eta * eta - k * k), k!(2.0 * eta * k));
    // q = a + i b, the root of N² − sin² θ; dq = cos/q dcos = N/q dN.
    let re = n2 - one + cos * cos;
    let larger = (half * ((re * re + im * im).sqrt() + re.abs()))
        .max(k!(TINY))
        .sqrt();
    let smaller = im / (two * larger);
    let positive = zero.less(re);
    let (a, b) = (
        positive.select(larger, smaller),
        positive.select(smaller, larger),
    );
    let per_q2 = one / (a * a + b * b);
    let (q_re, q_im) = (a * per_q2, -(b * per_q2));
    let by_cos = (cos * q_re, cos * q_im);
    let by_eta = (k!(eta) * q_re - k!(k) * q_im, k!(eta) * q_im + k!(k) * q_re);
    // dN = i dk.
    let by_k = (-by_eta.1, by_eta.0);
    // |x − q|²/|x + q|² for x = cos and N² cos.
    macro_rules! reflectance {
        ($x:expr, $by_cos:expr, $by_eta:expr, $by_k:expr) => {{
            let (mx, my, px, py) = ($x.0 - a, $x.1 - b, $x.0 + a, $x.1 + b);
            let per = one / (px * px + py * py);
            let value = (mx * mx + my * my) * per;
            macro_rules! slope {
                ($dx:expr, $dq:expr) => {{
                    let up = mx * ($dx.0 - $dq.0) + my * ($dx.1 - $dq.1);
                    let down = px * ($dx.0 + $dq.0) + py * ($dx.1 + $dq.1);
                    two * per * (up - value * down)
                }};
            }
            Slopes {
                value,
                cos: slope!($by_cos, by_cos),
                eta: slope!($by_eta, by_eta),
                k: slope!($by_k, by_k),
            }
        }};
    }
    let none = (zero, zero);
    let twice = (two * cos * k!(eta), two * cos * k!(k));
    [
        reflectance!((cos, zero), (one, zero), none, none),
        reflectance!((n2 * cos, im * cos), (n2, im), twice, (-twice.1, twice.0)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::fresnel::{Reflectances, dielectric_slopes};
    use pulp::Scalar;

    fn agree(found: &Slopes<Lane<Scalar>>, expected: &Slopes, place: &str) {
        let found = [found.value, found.cos, found.eta, found.k].map(|x| x.1);
        let expected = [expected.value, expected.cos, expected.eta, expected.k];
        for (a, b) in found.into_iter().zip(expected) {
            assert!((a - b).abs() < 1e-10 * (1.0 + b.abs()), "{place}: {a} {b}");
        }
    }

    #[test]
    fn walls_agree_with_the_scalar_form() {
        for (eta, k) in [(1.54, 0.0), (0.7, 0.0), (2.9, 3.1), (0.05, 3.3), (1.2, 0.4)] {
            for step in 1..=50 {
                let cos = 0.02 * f64::from(step);
                let place = format!("{eta} {k} {cos}");
                let wall = wall(Lane::splat(Scalar::new(), cos), eta, k);
                let exact = Reflectances::at(cos, eta, k);
                match wall.parts {
                    Some([s, p]) => {
                        agree(&s, &exact.s, &place);
                        agree(&p, &exact.p, &place);
                        agree(&wall.f, &exact.unpolarised(), &place);
                    }
                    None => {
                        // The slope to k under total reflection is not needed: a dielectric has no k.
                        let k = 0.0;
                        agree(
                            &wall.f,
                            &Slopes {
                                k,
                                ..dielectric_slopes(cos, eta)
                            },
                            &place,
                        );
                    }
                }
            }
        }
    }
}
