//! Products of the numbers of a direction over batches, for the errors of quantities computed from
//! several of them.
//!
//! A Stokes vector is a sum of Mueller elements of the same photons, and a degree of polarisation a
//! ratio of such sums: errors of single elements do not determine theirs. [`Products`] are recorded
//! only for some directions, because sixteen numbers have 136 of them.

use super::{FULL, TallyBatch};
use crate::trace::counting::fixed_point::{Text, Wide, Words};

/// Numbers of a direction whose products are recorded: a Mueller matrix, row by row.
pub const NUMBERS: usize = 16;
/// Their products, squares included.
const PAIRS: usize = NUMBERS * (NUMBERS + 1) / 2;

/// Index of a pair of numbers, the first no larger than the second.
const fn place(i: usize, j: usize) -> usize {
    i * (2 * NUMBERS - 1 - i) / 2 + j
}

/// Sums over batches, direction by direction.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Products(Vec<DirectionProducts>);

/// Bins that are combined into one direction.
#[derive(Debug, Clone, PartialEq)]
struct DirectionProducts {
    bins: Vec<usize>,
    /// Each product times [`FULL`] over its batch's photons; empty before light arrives.
    sums: Vec<Wide>,
    /// Number of batches with light.
    lit: u64,
}

impl Products {
    /// Makes empty products for directions above, given by their bins.
    pub fn new(directions: Vec<Vec<usize>>) -> Self {
        let mut all: Vec<DirectionProducts> = Vec::with_capacity(directions.len());
        for bins in directions {
            // Both sides of a plane may be in one bin.
            if all.iter().all(|d| d.bins != bins) {
                all.push(DirectionProducts {
                    bins,
                    sums: Vec::new(),
                    lit: 0,
                });
            }
        }
        Products(all)
    }

    /// Adds the counts of a batch; `per_photon` is [`FULL`] over its photons.
    pub fn count(&mut self, batch: &TallyBatch, per_photon: f64) {
        for direction in &mut self.0 {
            let lit = direction.bins.iter().filter(|bin| batch.hits[**bin] > 0);
            let mut numbers = [0.0; NUMBERS];
            let mut any = false;
            for bin in lit {
                any = true;
                let at = bin * batch.stride;
                for (sum, x) in numbers.iter_mut().zip(&batch.bins[at..at + NUMBERS]) {
                    *sum += x;
                }
            }
            if !any {
                continue;
            }
            direction.lit += 1;
            direction.sums.resize(PAIRS, Wide::default());
            let mut sums = direction.sums.iter_mut();
            for i in 0..NUMBERS {
                for (y, sum) in numbers[i..].iter().zip(sums.by_ref()) {
                    sum.add(numbers[i] * y * per_photon);
                }
            }
        }
    }

    /// Adds those of another part of the run; `None` if that recorded other directions.
    pub fn merged(mut self, other: &Products) -> Option<Self> {
        let same = self.0.len() == other.0.len()
            && self.0.iter().zip(&other.0).all(|(a, b)| a.bins == b.bins);
        if !same {
            return None;
        }
        for (a, b) in self.0.iter_mut().zip(&other.0) {
            if !b.sums.is_empty() {
                a.sums.resize(PAIRS, Wide::default());
            }
            a.lit += b.lit;
            for (a, b) in a.sums.iter_mut().zip(&b.sums) {
                a.join(b);
            }
        }
        Some(self)
    }

    /// Bins of every direction.
    pub fn directions(&self) -> Vec<Vec<usize>> {
        self.0.iter().map(|d| d.bins.clone()).collect()
    }

    fn of(&self, bins: &[usize]) -> Option<&DirectionProducts> {
        self.0.iter().find(|d| d.bins == bins)
    }

    /// Sums of a direction over their batches' photons, by [`place`], and the number of batches
    /// with light; `None` if it is not a recorded direction.
    pub fn sums(&self, bins: &[usize]) -> Option<(Vec<f64>, u64)> {
        let direction = self.of(bins)?;
        let mut values: Vec<f64> = direction.sums.iter().map(|x| x.value() / FULL).collect();
        values.resize(PAIRS, 0.0);
        Some((values, direction.lit))
    }

    /// The exact sums of the direction that begins with a bin, for a shard's file.
    pub fn exact(&self, first: usize) -> Option<String> {
        let direction = self.0.iter().find(|d| d.bins.first() == Some(&first))?;
        let lit = !direction.sums.is_empty();
        lit.then(|| Text::of(direction.lit).wide(direction.sums.iter()).finish())
    }

    /// Reads the text of [`Products::exact`].
    pub fn set_exact(&mut self, first: usize, text: &str) -> Option<()> {
        let mut directions = self.0.iter_mut();
        let direction = directions.find(|d| d.bins.first() == Some(&first))?;
        let (lit, mut words) = Words::of(text)?;
        (direction.lit, direction.sums) = (lit, words.wide(PAIRS)?);
        words.end()
    }
}

/// The samples behind the sums.
#[derive(Debug, Clone, Copy)]
pub(super) struct Counted {
    pub batches: u64,
    pub photons: u64,
    /// Number of batches with light in the direction.
    pub lit: u64,
}

/// Covariance of the numbers of a direction, sr⁻².
#[derive(Debug, Clone, PartialEq)]
pub struct ElementCovariance {
    pairs: Vec<f64>,
    /// Independent replicates with light; `None` if not counted.
    pub replicates: Option<u64>,
    /// A variance below `floor` times the square of these sizes is rounding.
    sizes: [f64; NUMBERS],
    floor: f64,
}

impl ElementCovariance {
    /// Makes it from the sums over batches: `products` over their batches' photons, and sums in
    /// photons; `norm` converts to sr⁻¹.
    pub(super) fn new(
        products: &[f64],
        sums: &[f64; NUMBERS],
        counted: Counted,
        norm: f64,
    ) -> Self {
        let (batches, photons) = (counted.batches as f64, counted.photons as f64);
        let scale = photons / (batches - 1.0) / (norm * norm);
        let mut pairs = Vec::with_capacity(PAIRS);
        for i in 0..NUMBERS {
            for j in i..NUMBERS {
                pairs.push((products[place(i, j)] - sums[i] * sums[j] / photons) * scale);
            }
        }
        ElementCovariance {
            pairs,
            replicates: Some(counted.lit),
            sizes: sums.map(|s| s.abs() / norm),
            floor: 4.0 * f64::EPSILON / batches,
        }
    }

    /// Makes it for independent numbers with these standard errors.
    #[must_use]
    pub fn independent(std: &[f64]) -> Self {
        let mut pairs = vec![0.0; PAIRS];
        for (i, std) in std.iter().take(NUMBERS).enumerate() {
            pairs[place(i, i)] = std * std;
        }
        ElementCovariance {
            pairs,
            replicates: None,
            sizes: [0.0; NUMBERS],
            floor: 0.0,
        }
    }

    /// Standard error of the sum of the numbers times these weights.
    #[must_use]
    pub fn std(&self, weights: &[f64; NUMBERS]) -> f64 {
        let (mut variance, mut size) = (0.0, 0.0);
        let mut pairs = self.pairs.iter();
        for (i, w) in weights.iter().enumerate() {
            size += w.abs() * self.sizes[i];
            for (j, pair) in (i..NUMBERS).zip(pairs.by_ref()) {
                let twice = if i == j { 1.0 } else { 2.0 };
                variance += twice * w * weights[j] * pair;
            }
        }
        // NaN if there is only one replicate.
        if variance.is_nan() {
            return variance;
        }
        variance.max(self.floor * size * size).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pair_has_its_own_index() {
        let mut next = 0;
        for i in 0..NUMBERS {
            for j in i..NUMBERS {
                assert_eq!(place(i, j), next);
                next += 1;
            }
        }
        assert_eq!(next, PAIRS);
    }

    #[test]
    fn the_common_part_of_two_numbers_cancels_in_their_difference() {
        // Two replicates: the first two numbers differ only by a constant.
        let batches = [[3.0, 1.0], [5.0, 3.0]];
        let mut numbers = [0.0; NUMBERS];
        let mut products = vec![0.0; PAIRS];
        for [a, b] in batches {
            numbers[0] += a;
            numbers[1] += b;
            products[place(0, 0)] += a * a;
            products[place(0, 1)] += a * b;
            products[place(1, 1)] += b * b;
        }
        let counted = Counted {
            batches: 2,
            photons: 2,
            lit: 2,
        };
        let covariance = ElementCovariance::new(&products, &numbers, counted, 1.0);
        let std = |a, b| {
            let mut weights = [0.0; NUMBERS];
            (weights[0], weights[1]) = (a, b);
            covariance.std(&weights)
        };
        assert!((std(1.0, 0.0) - 2.0).abs() < 1e-12);
        assert!((std(1.0, 1.0) - 4.0).abs() < 1e-12);
        // Only rounding.
        assert!(std(1.0, -1.0) < 1e-6);
        let apart = ElementCovariance::independent(&[2.0, 2.0]);
        let mut weights = [0.0; NUMBERS];
        (weights[0], weights[1]) = (1.0, -1.0);
        assert!((apart.std(&weights) - 8f64.sqrt()).abs() < 1e-12);
    }
}
