//! [`Boundary::at`] for a register of hits at once.
//!
//! The same operations in the same order, none of them fused, give the same bits for any register. Branches of single
//! hits are selections between lanes, so a lane's unused side may be infinite or NaN.

use nalgebra::Complex;
use pulp::Simd;

use super::{Boundary, Channel, Split};
use crate::model::fresnel::RARE;
use crate::model::lanes::{Lane, WIDEST};

/// A complex number per lane.
#[derive(Clone, Copy)]
struct Pair<S: Simd> {
    re: Lane<S>,
    im: Lane<S>,
}

impl<S: Simd> Pair<S> {
    #[inline(always)]
    fn splat(simd: S, z: Complex<f64>) -> Self {
        Pair {
            re: Lane::splat(simd, z.re),
            im: Lane::splat(simd, z.im),
        }
    }

    #[inline(always)]
    fn plus(self, real: Lane<S>) -> Self {
        Pair {
            re: self.re + real,
            im: self.im,
        }
    }

    #[inline(always)]
    fn scaled(self, by: Lane<S>) -> Self {
        Pair {
            re: self.re * by,
            im: self.im * by,
        }
    }

    #[inline(always)]
    fn times(self, other: Self) -> Self {
        Pair {
            re: self.re * other.re - self.im * other.im,
            im: self.re * other.im + self.im * other.re,
        }
    }

    #[inline(always)]
    fn conj(self) -> Self {
        Pair {
            re: self.re,
            im: -self.im,
        }
    }

    #[inline(always)]
    fn norm_sqr(self) -> Lane<S> {
        self.re * self.re + self.im * self.im
    }

    #[inline(always)]
    fn inverse(self, one: Lane<S>) -> Self {
        self.conj().scaled(one / self.norm_sqr())
    }

    #[inline(always)]
    fn over(self, other: Self) -> Self {
        let square = other.norm_sqr();
        Pair {
            re: (self.re * other.re + self.im * other.im) / square,
            im: (self.im * other.re - self.re * other.im) / square,
        }
    }

    #[inline(always)]
    fn principal_sqrt(self, zero: Lane<S>, half: Lane<S>) -> Self {
        let modulus = self.norm_sqr().sqrt();
        let behind = self.re.less(zero);
        let turned = behind.select(-self.re, self.re);
        let large = (half * (modulus + turned)).sqrt();
        let small = half * self.im / large;
        let some = zero.less(modulus);
        Pair {
            re: some.select(behind.select(small, large), zero),
            im: some.select(behind.select(large, small), zero),
        }
    }
}

impl Boundary {
    /// Returns reflection and refraction at each of some cosines in (0, 1].
    #[inline(always)]
    pub(crate) fn at_each<S: Simd>(&self, simd: S, cos: Lane<S>) -> Split<Lane<S>> {
        if self.transparent {
            self.divides(simd, cos)
        } else if self.absorbing.is_some() {
            self.each_alone(simd, cos)
        } else {
            self.reflects(simd, cos)
        }
    }

    /// Evaluates the lanes one by one: absorbing layers are rare, and their many roots gain little in a register.
    fn each_alone<S: Simd>(&self, simd: S, cos: Lane<S>) -> Split<Lane<S>> {
        let mut rooms = [[0.0; WIDEST]; 10];
        cos.store(&mut rooms[0], 0);
        for lane in 0..Lane::<S>::WIDTH {
            let split = self.at(rooms[0][lane]);
            for (room, x) in rooms.iter_mut().zip(split.numbers()) {
                room[lane] = x;
            }
        }
        let row = |n: usize| Lane::load(simd, &rooms[n], 0);
        let channel = |n: usize| Channel {
            s: row(n),
            p: row(n + 1),
            re: row(n + 2),
            im: row(n + 3),
        };
        Split {
            reflected: channel(0),
            refracted: channel(4),
            cos_refracted: row(8),
            ratio: row(9),
        }
    }

    #[inline(always)]
    fn divides<S: Simd>(&self, simd: S, cos: Lane<S>) -> Split<Lane<S>> {
        macro_rules! k {
            ($x:expr) => {
                Lane::splat(simd, $x)
            };
        }
        let (zero, one) = (k!(0.0), k!(1.0));
        let (n, n2, lift) = (self.relative.re, self.squared.re, self.lift.re);
        let sin_squared = (one - cos) * (one + cos);
        let q2 = if n2 < RARE {
            k!(n2) - sin_squared
        } else {
            k!(lift) + cos * cos
        };
        let passes = zero.less(q2);
        let q = passes.select(q2, one).sqrt();
        let (sum_s, sum_p) = (cos + q, k!(n2) * cos + q);
        let r_s = k!(-lift) / (sum_s * sum_s);
        let r_p = k!(lift) * (k!(n2) * cos * cos - sin_squared) / (sum_p * sum_p);
        let (t_s, t_p) = (k!(2.0) * cos / sum_s, k!(2.0 * n) * cos / sum_p);
        let flux = q / cos;
        let mut reflected = Channel {
            s: r_s * r_s,
            p: r_p * r_p,
            re: r_s * r_p,
            im: zero,
        };
        if lift < 0.0 {
            let q = passes.select(zero, -q2).sqrt();
            let n2c = k!(n2) * cos;
            let (above, below) = (Pair { re: cos, im: -q }, Pair { re: cos, im: q });
            let (beside, beneath) = (Pair { re: n2c, im: q }, Pair { re: n2c, im: -q });
            let z = above.times(beside).over(below.times(beneath));
            reflected = Channel {
                s: passes.select(reflected.s, one),
                p: passes.select(reflected.p, one),
                re: passes.select(reflected.re, z.re),
                im: passes.select(zero, z.im),
            };
        }
        Split {
            reflected,
            refracted: Channel {
                s: passes.select(flux * t_s * t_s, zero),
                p: passes.select(flux * t_p * t_p, zero),
                re: passes.select(flux * t_s * t_p, zero),
                im: zero,
            },
            cos_refracted: passes.select(q / k!(n), zero),
            ratio: k!(1.0 / n),
        }
    }

    #[inline(always)]
    fn reflects<S: Simd>(&self, simd: S, cos: Lane<S>) -> Split<Lane<S>> {
        let (zero, one, half) = (
            Lane::splat(simd, 0.0),
            Lane::splat(simd, 1.0),
            Lane::splat(simd, 0.5),
        );
        let (squared, lift) = (
            Pair::splat(simd, self.squared),
            Pair::splat(simd, self.lift),
        );
        let sin_squared = (one - cos) * (one + cos);
        let q = if self.squared.re.abs() < RARE {
            squared.plus(-sin_squared)
        } else {
            lift.plus(cos * cos)
        };
        let q = q.principal_sqrt(zero, half);
        let over_s = q.plus(cos).inverse(one);
        let over_p = {
            let turned = squared.scaled(cos);
            Pair {
                re: turned.re + q.re,
                im: turned.im + q.im,
            }
        };
        let over_p = over_p.inverse(one);
        let brewster = squared.scaled(cos * cos).plus(-sin_squared);
        let less = Pair {
            re: -lift.re,
            im: -lift.im,
        };
        let r_s = less.times(over_s).times(over_s);
        let r_p = lift.times(over_p).times(brewster.times(over_p));
        let z = r_s.times(r_p.conj());
        Split {
            reflected: Channel {
                s: r_s.norm_sqr().min(one),
                p: r_p.norm_sqr().min(one),
                re: z.re,
                im: z.im,
            },
            refracted: Channel {
                s: zero,
                p: zero,
                re: zero,
                im: zero,
            },
            cos_refracted: zero,
            ratio: Lane::splat(simd, 1.0 / self.relative.re),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pulp::{Arch, WithSimd};

    struct All<'a>(&'a Boundary, &'a [f64]);

    impl WithSimd for All<'_> {
        type Output = Vec<[f64; 10]>;
        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let width = Lane::<S>::WIDTH;
            let mut room = vec![0.0; 10 * width];
            let mut all = Vec::new();
            for at in 0..self.1.len() / width {
                let split = self.0.at_each(simd, Lane::load(simd, self.1, at));
                for (n, lane) in split.numbers().into_iter().enumerate() {
                    lane.store(&mut room, n);
                }
                all.extend((0..width).map(|l| std::array::from_fn(|n| room[n * width + l])));
            }
            all
        }
    }

    #[test]
    fn every_lane_has_the_bits_of_a_single_hit() {
        let mut cosines: Vec<f64> = (1..=800).map(|n| f64::from(n) / 800.0).collect();
        cosines.extend([
            1e-12,
            1e-9,
            1e-5,
            0.745_355_992_499_929_9,
            1.0,
            1.0,
            0.5,
            0.5,
        ]);
        let real = |n: f64| Complex::new(n, 0.0);
        let layer = Complex::new(1.3, 0.01);
        let plain = [
            (1.0, 1.5, 0.0),
            (1.5, 1.0, 0.0),
            (2.4, 1.0, 0.0),
            (1.0, 1.0, 0.0),
            (1.0, 1.0 + 1e-9, 0.0),
            (1.0, 0.18, 3.4),
            (1.0, 2.9, 3.1),
            (1.0, 0.3, 1e-3),
            (1.5, 0.05, 0.2),
        ];
        let plain = plain.map(|(here, n, k)| Boundary::new(here, n, k));
        let absorbing = [
            Boundary::between(real(1.5), layer, true),
            Boundary::between(layer, real(1.0), true),
            Boundary::between(layer, Complex::new(0.35, 2.7), false),
        ];
        for boundary in plain.into_iter().chain(absorbing) {
            let found = Arch::new().dispatch(All(&boundary, &cosines));
            assert_eq!(found.len(), cosines.len());
            for (cos, found) in cosines.iter().zip(found) {
                let expected = boundary.at(*cos).numbers();
                assert_eq!(found, expected, "{boundary:?} at {cos}");
            }
        }
    }
}
