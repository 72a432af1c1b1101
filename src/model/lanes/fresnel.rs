//! Fresnel reflectance of a register of angles with its slope, for one index.
//!
//! *Conditioning.* These are the plain quotients: ten digits are enough for a start. [`crate::model::fresnel`]
//! returns all digits.

use pulp::Simd;

use super::Lane;

/// R_s and R_p of a wall, and their slopes with respect to the cosine of the angle of incidence.
#[derive(Clone, Copy)]
pub(super) struct Wall<S: Simd> {
    pub(super) s: Lane<S>,
    pub(super) p: Lane<S>,
    pub(super) to_s: Lane<S>,
    pub(super) to_p: Lane<S>,
}

impl<S: Simd> Wall<S> {
    /// Returns the unpolarised reflectance.
    #[inline(always)]
    pub(super) fn f(&self, simd: S) -> Lane<S> {
        Lane::splat(simd, 0.5) * (self.s + self.p)
    }

    #[inline(always)]
    pub(super) fn slope(&self, simd: S) -> Lane<S> {
        Lane::splat(simd, 0.5) * (self.to_s + self.to_p)
    }
}

/// Evaluates at cos θ = `cos` > 0 for the index `eta + i k`.
#[inline(always)]
pub(super) fn wall<S: Simd>(simd: S, cos: Lane<S>, eta: f64, k: f64) -> Wall<S> {
    macro_rules! k {
        ($x:expr) => {
            Lane::splat(simd, $x)
        };
    }
    let (one, two, half) = (k!(1.0), k!(2.0), k!(0.5));
    let (n2, im) = (k!(eta * eta - k * k), k!(2.0 * eta * k));
    // q = a + i b, the root of N² − sin² θ; dq = cos/q dcos.
    let re = n2 - one + cos * cos;
    let tiny = k!(1e-12);
    let larger = (half * ((re * re + im * im).sqrt() + re.abs()))
        .max(tiny)
        .sqrt();
    let smaller = im / (two * larger);
    let positive = k!(0.0).less(re);
    let (a, b) = (
        positive.select(larger, smaller),
        positive.select(smaller, larger),
    );
    let per_q2 = cos / (a * a + b * b);
    let (to_a, to_b) = (a * per_q2, -(b * per_q2));
    // |x − q|²/|x + q|² for x = cos and N² cos.
    macro_rules! reflectance {
        ($x:expr, $y:expr, $to_x:expr, $to_y:expr) => {{
            let (mx, my, px, py) = ($x - a, $y - b, $x + a, $y + b);
            let per = one / (px * px + py * py);
            let r = (mx * mx + my * my) * per;
            let up = mx * ($to_x - to_a) + my * ($to_y - to_b);
            let down = px * ($to_x + to_a) + py * ($to_y + to_b);
            (r, two * per * (up - r * down))
        }};
    }
    let zero = k!(0.0);
    let (s, to_s) = reflectance!(cos, zero, one, zero);
    let (p, to_p) = reflectance!(n2 * cos, im * cos, n2, im);
    Wall { s, p, to_s, to_p }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::fresnel::Reflectances;
    use pulp::Scalar;

    #[test]
    fn walls_agree_with_the_scalar_form() {
        for (eta, k) in [(1.54, 0.0), (2.9, 3.1), (0.05, 3.3), (1.2, 0.4)] {
            for step in 1..=50 {
                let cos = 0.02 * f64::from(step);
                let wall = wall(Scalar::new(), Lane::splat(Scalar::new(), cos), eta, k);
                let r = Reflectances::at(cos, eta, k);
                let found = [wall.s.1, wall.p.1, wall.to_s.1, wall.to_p.1];
                let expected = [r.s.value, r.p.value, r.s.cos, r.p.cos];
                for (a, b) in found.into_iter().zip(expected) {
                    assert!(
                        (a - b).abs() < 1e-10 * (1.0 + b.abs()),
                        "{eta} {k} {cos}: {a} {b}"
                    );
                }
            }
        }
    }
}
