//! Energies by the light's end, and their fractions of the launched light with standard errors.
//!
//! *Conditioning.* Regression slopes of an energy on the total energy are used only if the total
//! scatters between batches by more than 3e-5 of itself.

use super::{MonteCarloEstimate, Totals};
use crate::trace::counting::fixed_point::{Wide, from_fixed, to_fixed};

/// Energies are distinguished up to this number of interactions; the last element means "or more".
pub const ORDERS: usize = 16;

/// Least number of batches for a regression slope: with 16 its own noise adds 3 % to a standard
/// error.
const BATCHES_FOR_SLOPE: u64 = 16;

/// Fractions of the power by the light's end.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Energies<T> {
    /// Reflected after 1, 2, … interactions.
    pub reflected: [T; ORDERS],
    /// Transmitted after 1, 2, … interactions.
    pub transmitted: [T; ORDERS],
    /// All reflected light.
    pub reflected_all: T,
    /// All transmitted light.
    pub transmitted_all: T,
    /// Absorbed.
    pub absorbed: T,
    /// Given up: too many interactions, or an almost horizontal ray.
    pub truncated: T,
}

impl<T: Copy + std::ops::Add<Output = T>> Energies<T> {
    /// All light, whatever its end.
    pub(super) fn total(&self) -> T {
        self.reflected_all + self.transmitted_all + self.absorbed + self.truncated
    }
}

impl<T: Copy> Energies<T> {
    pub(super) fn filled(x: T) -> Self {
        Energies {
            reflected: [x; ORDERS],
            transmitted: [x; ORDERS],
            reflected_all: x,
            transmitted_all: x,
            absorbed: x,
            truncated: x,
        }
    }

    pub(super) fn all(&self) -> impl Iterator<Item = &T> {
        self.reflected.iter().chain(&self.transmitted).chain([
            &self.reflected_all,
            &self.transmitted_all,
            &self.absorbed,
            &self.truncated,
        ])
    }

    /// Replaces its numbers by these, in the order of [`Energies::all`].
    pub(super) fn set(&mut self, numbers: &[T]) {
        for (own, x) in self.all_mut().zip(numbers) {
            *own = *x;
        }
    }

    pub(super) fn all_mut(&mut self) -> impl Iterator<Item = &mut T> {
        self.reflected
            .iter_mut()
            .chain(&mut self.transmitted)
            .chain([
                &mut self.reflected_all,
                &mut self.transmitted_all,
                &mut self.absorbed,
                &mut self.truncated,
            ])
    }
}

impl Energies<i128> {
    /// Adds another's sums.
    pub(super) fn add(&mut self, other: &Self) {
        for (a, b) in self.all_mut().zip(other.all()) {
            *a += b;
        }
    }
}

impl Energies<Wide> {
    /// Adds another's sums.
    pub(super) fn join(&mut self, other: &Self) {
        for (a, b) in self.all_mut().zip(other.all()) {
            a.join(b);
        }
    }
}

impl Totals {
    /// Energies as fractions of all launched light; they sum to 1.
    ///
    /// If photons have weights other than 1 (polarised lamp, roulette, branches drawn more often
    /// than their probability), the count of a batch equals the number of its photons only on
    /// average. The deviation is known for every batch, and its correlated part is subtracted from
    /// each fraction: x − β (a − n) with a the counted energy and n the photons. Fractions of a
    /// have β = x/a. If draws make most of the noise, β = cov(x, a)/var(a) over the batches keeps
    /// the exact value of a contribution that is equal for every photon (the first reflection off a
    /// plane), which a division by a spoils. Both choices of β sum to 1, so the fractions do too,
    /// and the standard error is that of the remainder.
    #[must_use]
    pub fn energies(&self) -> Energies<MonteCarloEstimate> {
        let e = &self.energy_sums;
        let launched = self.photons as f64;
        let counted = e.total() + self.energy_known.total();
        let excess = from_fixed(counted - to_fixed(1.0) * i128::from(self.photons));
        let (a, b) = (from_fixed(e.total()), self.batches as f64);
        let with_all = |sum: f64, product: f64| product - sum * a / b;
        fn ends<T: Copy>(e: &Energies<T>, value: impl Fn(T) -> f64) -> [f64; 4] {
            [e.reflected_all, e.transmitted_all, e.absorbed, e.truncated].map(value)
        }
        let of = |e: &Energies<i128>| ends(e, from_fixed);
        let wide = |e: &Energies<Wide>| ends(e, |x| x.value());
        // As the sum of its parts, so that the slopes sum to 1 to the last digit.
        let parts = of(e).into_iter().zip(wide(&self.energy_products));
        let var_a: f64 = parts.map(|(s, p)| with_all(s, p)).sum();
        let variance = |s: f64, q: f64, p: f64, slope: f64| {
            let cov = with_all(s, p);
            let left = (q - s * s / b - slope * (2.0 * cov - slope * var_a)) * b / (b - 1.0);
            // The rounding floor is that of the terms, not of their difference.
            left.max(4.0 * f64::EPSILON * s * s / b)
        };
        let counted = from_fixed(counted);
        let shares = of(e).into_iter().zip(of(&self.energy_known));
        let shares = shares.map(|(s, k)| (s + k) / counted);
        let slopes = of(e).into_iter().zip(wide(&self.energy_products));
        let slopes = slopes.map(|(s, p)| with_all(s, p) / var_a);
        let scatter = |slopes: &mut dyn Iterator<Item = f64>| -> f64 {
            let squares = wide(&self.energy_squares)
                .into_iter()
                .zip(wide(&self.energy_products));
            let all = of(e).into_iter().zip(squares).zip(slopes);
            all.map(|((s, (q, p)), slope)| variance(s, q, p, slope))
                .sum()
        };
        // Few batches give no slope, and neither do batches that count their photons almost exactly
        // (three roundings of 1e-16 in a difference that needs six digits). If slopes bring little,
        // they are not worth a negative fraction.
        let has_slopes = self.batches >= BATCHES_FOR_SLOPE
            && var_a > 1e-9 * a * a / b
            && scatter(&mut { slopes }) < 0.5 * scatter(&mut { shares });
        let mut out = Energies::filled(MonteCarloEstimate {
            value: 0.0,
            std: 0.0,
        });
        let sums = e.all().zip(self.energy_squares.all());
        let sums = sums
            .zip(self.energy_products.all())
            .zip(self.energy_known.all());
        for (o, (((s, q), p), k)) in out.all_mut().zip(sums) {
            let sum = from_fixed(s + k);
            let (s, q, p) = (from_fixed(*s), q.value(), p.value());
            let (slope, value) = if has_slopes {
                let slope = with_all(s, p) / var_a;
                (slope, ((sum - slope * excess) / launched).max(0.0))
            } else {
                (sum / counted, sum / counted)
            };
            *o = MonteCarloEstimate {
                value,
                std: if self.batches > 1 {
                    variance(s, q, p, slope).sqrt() / launched
                } else {
                    f64::NAN
                },
            };
        }
        out
    }
}
