//! Counts light in bins and energies, with standard errors that hold for any sampling.
//!
//! A [`TallyBatch`] counts the photons of one independent replicate. The spread of the batches'
//! sums per photon is the standard error, so stratified starts, splitting and roulette need no
//! theory of their own. [`Totals`] adds up batches in fixed-point integers, whose sum does not
//! depend on the order: threads, shards and stops give the same bits.
//!
//! *Conditioning.* Sums are integers, exact to 2⁻⁸² of a photon, those of squares in 192 bits. A
//! variance is a difference of two sums of squares and is meaningless below 4 ε of them; this is
//! its floor, so an exact result has the error of rounding instead of 0.

mod analytic_part;
mod batch;
mod energies;
mod products;
mod text;

use super::fixed_point::{Resting, Wide, from_fixed, to_fixed};
use super::grid::DirectionGrid;
use crate::trace::photons::paired::{DIFFERENCE, SCALAR};
use crate::trace::surfaces::height_field::Side;
pub use analytic_part::AnalyticPart;
pub use batch::TallyBatch;
pub use energies::{Energies, ORDERS};
use products::{Counted, Products};
pub use products::{ElementCovariance, NUMBERS};

/// Photons of a full batch. Squares of a bin are divided by their batch's photons and stored in
/// units of this, because batches differ in size and that difference is not noise.
const FULL: f64 = (1u64 << 20) as f64;
/// Squared brightness below which, after subtracting the noise, only rounding is left: differences
/// of thousands of bins, each to about 1e-16.
const ROUNDING: f64 = 1e-10;
/// A difference below this fraction of the light is rounding.
const NO_DIFFERENCE: f64 = 1e-12;

/// Sums over any number of batches; adding is exact, so the order does not matter.
#[derive(Debug, Clone, PartialEq)]
pub struct Totals {
    grid: DirectionGrid,
    stride: usize,
    /// Per bin: `stride` sums,
    bins: Vec<i128>,
    /// and as many sums of squares, each times [`FULL`] over its batch's photons.
    squares: Vec<Resting>,
    hits: Vec<u64>,
    /// Per bin, for layers followed in both modes: the number of batches in which polarisation made
    /// a difference.
    differing: Option<Vec<u32>>,
    /// Products of the numbers of some directions.
    products: Option<Products>,
    /// Per bin: the analytic part times the photons,
    known: Vec<i128>,
    /// and whether there is any.
    lit: Vec<bool>,
    energy_sums: Energies<i128>,
    energy_squares: Energies<Wide>,
    /// Sums of each energy times the total energy of the batch.
    energy_products: Energies<Wide>,
    energy_known: Energies<i128>,
    batches: u64,
    photons: u64,
}

/// A mean and its standard error.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize, utoipa::ToSchema)]
pub struct MonteCarloEstimate {
    /// The mean.
    pub value: f64,
    /// Its standard error, from the spread of the batches.
    pub std: f64,
}

impl Totals {
    /// Makes empty totals; `elements` is 16 with polarisation, 1 without.
    #[must_use]
    pub fn new(grid: DirectionGrid, elements: usize) -> Self {
        let bins = 2 * grid.per_side();
        Totals {
            grid,
            stride: elements,
            bins: vec![0; bins * elements],
            squares: vec![[0; 3]; bins * elements],
            hits: vec![0; bins],
            differing: None,
            lit: vec![false; bins],
            products: None,
            known: vec![0; bins * elements],
            energy_sums: Energies::filled(0),
            energy_squares: Energies::filled(Wide::default()),
            energy_products: Energies::filled(Wide::default()),
            energy_known: Energies::filled(0),
            batches: 0,
            photons: 0,
        }
    }

    /// Records the products that [`Totals::covariance`] needs, for directions above that consist of
    /// some bins each. Ignored if the numbers are not a Mueller matrix.
    #[must_use]
    pub fn with_directions(mut self, directions: Option<Vec<Vec<usize>>>) -> Self {
        let kept = directions.filter(|_| self.stride >= NUMBERS);
        self.products = kept.map(Products::new);
        self
    }

    /// The directions passed to [`Totals::with_directions`].
    #[must_use]
    pub fn directions(&self) -> Option<Vec<Vec<usize>>> {
        self.products.as_ref().map(Products::directions)
    }

    /// Records what [`Totals::differing`] needs, for light followed in both modes through layers.
    #[must_use]
    pub fn of_layers(mut self, layered: bool) -> Self {
        let bins = self.hits.len();
        self.differing = (layered && self.stride > DIFFERENCE).then(|| vec![0; bins]);
        self
    }

    /// Number of batches in which light above reached a bin with a different brightness with
    /// polarisation than without; `None` if not recorded.
    #[must_use]
    pub fn differing(&self, bin: usize) -> Option<u32> {
        self.differing.as_ref().map(|all| all[bin])
    }

    /// Adds the analytic part per photon, for `photons` of the counted photons.
    pub fn include(&mut self, known: &AnalyticPart, photons: u64) {
        if photons == 0 {
            return;
        }
        let photons = i128::from(photons);
        for (bin, _) in known.lit.iter().enumerate().filter(|(_, lit)| **lit) {
            self.lit[bin] = true;
            let all = &known.bins[bin * known.stride..][..known.stride];
            let totals = &mut self.known[bin * self.stride..][..self.stride];
            for (total, x) in totals.iter_mut().zip(all) {
                *total += x * photons;
            }
        }
        for (total, x) in self.energy_known.all_mut().zip(known.energies.all()) {
            *total += x * photons;
        }
    }

    /// Adds a batch of `photons` launched photons and clears it.
    pub fn take(&mut self, batch: &mut TallyBatch, photons: u64) {
        self.count(batch, photons);
        batch.clear();
    }

    /// Adds a batch that continues. Totals of one element count only m00, whatever the batch
    /// contains.
    pub fn count(&mut self, batch: &TallyBatch, photons: u64) {
        let n = self.stride;
        let per_photon = FULL / photons.max(1) as f64;
        for &bin in &batch.touched {
            let bin = bin as usize;
            self.hits[bin] += u64::from(batch.hits[bin]);
            let range = bin * n..(bin + 1) * n;
            let sums = self.bins[range.clone()].iter_mut();
            let values = &batch.bins[bin * batch.stride..(bin + 1) * batch.stride];
            if let Some(differing) = &mut self.differing
                && values[DIFFERENCE].abs() > NO_DIFFERENCE * values[SCALAR].abs()
            {
                differing[bin] += 1;
            }
            for ((sum, square), x) in sums.zip(&mut self.squares[range]).zip(values) {
                *sum += to_fixed(*x);
                let mut wide = Wide::of(*square);
                wide.add(x * x * per_photon);
                *square = wide.resting();
            }
        }
        if let Some(products) = &mut self.products {
            products.count(batch, per_photon);
        }
        let all = batch.energies.total();
        let sums = self.energy_sums.all_mut();
        let squares = self.energy_squares.all_mut();
        let products = self.energy_products.all_mut();
        for (((sum, square), product), x) in
            sums.zip(squares).zip(products).zip(batch.energies.all())
        {
            *sum += to_fixed(*x);
            square.add(x * x);
            product.add(x * all);
        }
        self.batches += 1;
        self.photons += photons;
    }

    /// Adds the totals of another shard of the same run.
    ///
    /// # Errors
    /// The bins differ.
    pub fn merge(&mut self, other: &Totals) -> Result<(), DifferentRuns> {
        if self.grid != other.grid || self.stride != other.stride {
            return Err(DifferentRuns);
        }
        // Most of many bins are empty and are skipped.
        for bin in 0..other.hits.len() {
            let numbers = bin * self.stride..(bin + 1) * self.stride;
            if other.hits[bin] > 0 {
                self.hits[bin] += other.hits[bin];
                for i in numbers.clone() {
                    self.bins[i] += other.bins[i];
                    let mut square = Wide::of(self.squares[i]);
                    square.join(&Wide::of(other.squares[i]));
                    self.squares[i] = square.resting();
                }
            }
            if other.lit[bin] {
                self.lit[bin] = true;
                for i in numbers {
                    self.known[i] += other.known[i];
                }
            }
        }
        if let (Some(own), Some(other)) = (&mut self.differing, &other.differing) {
            for (own, other) in own.iter_mut().zip(other) {
                *own += other;
            }
        }
        if self.batches == 0 {
            self.products.clone_from(&other.products);
        } else if other.batches > 0 {
            // Products of one part do not describe the whole.
            let products = self.products.take().zip(other.products.as_ref());
            self.products = products.and_then(|(own, other)| own.merged(other));
        }
        self.energy_known.add(&other.energy_known);
        self.energy_sums.add(&other.energy_sums);
        self.energy_squares.join(&other.energy_squares);
        self.energy_products.join(&other.energy_products);
        self.batches += other.batches;
        self.photons += other.photons;
        Ok(())
    }

    /// The direction bins.
    #[must_use]
    pub fn grid(&self) -> DirectionGrid {
        self.grid
    }

    /// Numbers per bin: 16 with polarisation, 1 without.
    #[must_use]
    pub fn elements(&self) -> usize {
        self.stride
    }

    /// Photons launched.
    #[must_use]
    pub fn photons(&self) -> u64 {
        self.photons
    }

    /// Number of independent replicates.
    #[must_use]
    pub fn batches(&self) -> u64 {
        self.batches
    }

    /// Whether no light ended in a bin.
    #[must_use]
    pub fn is_empty(&self, side: Side, bin: usize) -> bool {
        let index = self.index(side, bin);
        self.hits[index] == 0 && !self.is_lit(index)
    }

    /// Whether the analytic part of a bin is not zero.
    fn is_lit(&self, index: usize) -> bool {
        self.lit[index] && self.known[index * self.stride] != 0
    }

    /// Number of sampled contributions to a bin.
    #[must_use]
    pub fn hits(&self, side: Side, bin: usize) -> u64 {
        self.hits[self.index(side, bin)]
    }

    fn index(&self, side: Side, bin: usize) -> usize {
        match side {
            Side::Above => bin,
            Side::Below => bin + self.grid.per_side(),
        }
    }

    fn estimate(&self, sum: i128, square: Wide, known: i128, norm: f64) -> MonteCarloEstimate {
        let (s, q) = (from_fixed(sum), square.value() / FULL);
        let (b, photons) = (self.batches as f64, self.photons as f64);
        // Variance of the sum of B independent batches of n of all N photons: N/(B−1) (Σ x²/n − (Σ
        // x)²/N). Both terms are rounded to an f64, so their difference is meaningless below that:
        // a result that is exact except for rounding (at Brewster's angle, m22) has an error of
        // 4e-9 of itself, not 0.
        let variance = if self.batches > 1 {
            let left = (q - s * s / photons) * photons / (b - 1.0);
            left.max(4.0 * f64::EPSILON * s * s / b)
        } else {
            f64::NAN
        };
        MonteCarloEstimate {
            value: from_fixed(sum + known) / norm,
            std: variance.sqrt() / norm,
        }
    }

    /// Element `i` (row by row) of the Mueller BRDF (above) or BTDF (below) of a bin, sr⁻¹.
    #[must_use]
    pub fn element(&self, side: Side, bin: usize, i: usize) -> MonteCarloEstimate {
        let at = self.index(side, bin) * self.stride + i;
        let norm = self.grid.projected_solid_angle(bin) * self.photons as f64;
        let square = Wide::of(self.squares[at]);
        self.estimate(self.bins[at], square, self.known[at], norm)
    }

    /// Covariance of the elements of the mean Mueller matrix of bins above; `None` if they are not
    /// one of the [`Totals::with_directions`].
    #[must_use]
    pub fn covariance(&self, bins: &[usize]) -> Option<ElementCovariance> {
        let (products, lit) = self.products.as_ref()?.sums(bins)?;
        let first = *bins.first()?;
        let sums: [f64; NUMBERS] = std::array::from_fn(|i| {
            let sum = bins.iter().map(|bin| self.bins[bin * self.stride + i]);
            from_fixed(sum.sum())
        });
        // The bins of a direction are in one row, so they have equal size.
        let solid_angle = self.grid.projected_solid_angle(first);
        let norm = bins.len() as f64 * solid_angle * self.photons as f64;
        let counted = Counted {
            batches: self.batches,
            photons: self.photons,
            lit,
        };
        Some(ElementCovariance::new(&products, &sums, counted, norm))
    }

    /// Root mean square error of m00 divided by its own root mean square, both over the reflected
    /// bins and weighted by the bins' projected solid angles: the relative error of a bin of
    /// typical brightness. `None` if no light was reflected, or not more than its own noise.
    ///
    /// Sums of squares are used because a variance estimated from few photons is correct on average
    /// and a standard error is not: a bin hit once has an estimated error of 100 % whatever the
    /// truth, so a mean of relative errors is too small, and decreases too slowly, while many bins
    /// are almost empty. The squared brightness has its own noise subtracted for the same reason;
    /// if only rounding remains, the result is unknown.
    #[must_use]
    pub fn relative_error(&self) -> Option<f64> {
        self.relative_error_with(None)
    }

    /// The same including the analytic part for these photons, before it is [`Totals::include`]d.
    #[must_use]
    pub fn relative_error_with(&self, known: Option<(&AnalyticPart, u64)>) -> Option<f64> {
        let n = self.stride;
        let (mut noise, mut signal) = (0.0, 0.0);
        for bin in 0..self.grid.per_side() {
            let further = known.filter(|(k, _)| k.lit[bin]);
            if self.hits[bin] == 0 && !self.lit[bin] && further.is_none() {
                continue;
            }
            let further = further.map_or(0, |(k, photons)| k.bins[bin * n] * i128::from(photons));
            let known = self.known[bin * n] + further;
            let (sum, square) = (self.bins[bin * n], Wide::of(self.squares[bin * n]));
            // Fractions of the light: the weights cancel the conversion to a BRDF.
            let e = self.estimate(sum, square, known, self.photons as f64);
            let variance = e.std * e.std;
            noise += variance;
            signal += e.value * e.value - variance;
        }
        (signal > ROUNDING * noise).then(|| (noise / signal).sqrt())
    }
}

/// Two totals have different bins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the shards have different direction bins or differ in polarisation")]
pub struct DifferentRuns;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::photons::light::{PhotonState, Polarised, ScalarState};
    use crate::trace::rng::{Purpose, RandomStream};
    use crate::trace::vec3::unit;

    const GRID: DirectionGrid = DirectionGrid::polar(45, 180);

    #[test]
    fn the_order_of_batches_does_not_matter_and_totals_round_trip_as_text() {
        let batch = |seed: u64| {
            let mut batch = TallyBatch::new::<ScalarState>(GRID);
            let mut random = RandomStream::new(seed, Purpose::Photon, 0);
            for _ in 0..1500 {
                let k = unit(&[random.uniform() - 0.5, random.uniform() - 0.5, 0.3]);
                let mut light = ScalarState::launch(&k);
                light.scale(random.uniform());
                batch.exit(&light, light.weight(), Side::Above, &k, 1);
            }
            batch
        };
        let sum = |order: [u64; 4]| {
            let mut totals = Totals::new(GRID, 1);
            for seed in order {
                totals.take(&mut batch(seed), 1500);
            }
            totals
        };
        let totals = sum([0, 1, 2, 3]);
        assert_eq!(totals, sum([3, 1, 0, 2]));
        let mut back = Totals::new(GRID, 1);
        back.set_exact_energies(&totals.exact_energies()).unwrap();
        for bin in 0..GRID.per_side() {
            if let Some(text) = totals.exact_bin(Side::Above, bin) {
                back.set_exact_bin(Side::Above, bin, &text).unwrap();
            }
        }
        assert_eq!(back, totals);
        assert!(back.set_exact_bin(Side::Above, 0, "nonsense").is_none());
    }

    #[test]
    fn batches_that_differ_only_in_size_have_no_noise() {
        let k = unit(&[0.1, 0.1, 1.0]);
        // As 65 and 1000 photons are divided into 64 batches.
        for (few, larger) in [(1u32, 1), (15, 40)] {
            let mut totals = Totals::new(GRID, 1);
            for n in 0..64 {
                let photons = if n < larger { few + 1 } else { few };
                let mut batch = TallyBatch::new::<ScalarState>(GRID);
                for _ in 0..photons {
                    batch.exit(&ScalarState::launch(&k), 1.0, Side::Above, &k, 1);
                }
                totals.take(&mut batch, u64::from(photons));
            }
            let estimated = totals.relative_error().unwrap();
            assert!(estimated < 1e-7, "{few}: {estimated}");
        }
        // One photon in four returns, in batches of one and of two: the error is that of counting.
        let mut totals = Totals::new(GRID, 1);
        let mut random = RandomStream::new(5, Purpose::Photon, 0);
        for n in 0..40_000u64 {
            let mut batch = TallyBatch::new::<ScalarState>(GRID);
            for _ in 0..=n % 2 {
                if random.uniform() < 0.25 {
                    batch.exit(&ScalarState::launch(&k), 1.0, Side::Above, &k, 1);
                }
            }
            totals.take(&mut batch, 1 + n % 2);
        }
        let expected = (0.75f64 / 0.25 / 60_000.0).sqrt();
        let estimated = totals.relative_error().unwrap();
        // A variance of 40,000 such batches is known to 1 %.
        assert!(
            (estimated / expected - 1.0).abs() < 0.03,
            "{estimated} {expected}"
        );
    }

    #[test]
    fn a_few_photons_in_separate_bins_have_no_error() {
        // Each bin is hit once: its square equals its noise, and only rounding remains.
        for seed in 0..20 {
            let mut totals = Totals::new(GRID, 1);
            let mut random = RandomStream::new(seed, Purpose::Photon, 0);
            for n in 0..16 {
                let mut batch = TallyBatch::new::<ScalarState>(GRID);
                let phi = 0.39 * f64::from(n);
                let k = unit(&[phi.cos(), phi.sin(), 1.0]);
                let mut light = ScalarState::launch(&k);
                light.scale(random.uniform());
                batch.exit(&light, light.weight(), Side::Above, &k, 1);
                totals.take(&mut batch, 1);
            }
            assert_eq!(totals.relative_error(), None);
        }
    }

    #[test]
    fn millions_of_dark_bins_take_almost_no_time() {
        let grid = DirectionGrid::polar(1440, 1440);
        let k = unit(&[0.1, 0.1, 1.0]);
        let seconds = || {
            let started = std::time::Instant::now();
            let mut batch = TallyBatch::new::<Polarised>(grid);
            let light = Polarised::launch(&[0.0, 1.0, 0.0]);
            batch.exit(&light, 1.0, Side::Above, &k, 1);
            let mut known = AnalyticPart::new(grid, Polarised::ELEMENTS);
            known.take(&mut batch);
            let mut totals = Totals::new(grid, Polarised::ELEMENTS);
            for _ in 0..4 {
                batch.exit(&light, 1.0, Side::Above, &k, 1);
                totals.take(&mut batch, 1);
            }
            let further = totals.relative_error_with(Some((&known, 4)));
            totals.include(&known, 4);
            assert_eq!(totals.relative_error(), further);
            let mut both = Totals::new(grid, Polarised::ELEMENTS);
            both.merge(&totals).unwrap();
            assert_eq!(both.photons(), 4);
            started.elapsed().as_secs_f64()
        };
        // Writing all of their numbers once takes seconds. The minimum of several runs removes the
        // load of the machine.
        let least = (0..3).map(|_| seconds()).fold(f64::INFINITY, f64::min);
        assert!(least < 0.5, "{least} s");
    }

    #[test]
    fn errors_hold_over_any_number_of_full_batches() {
        // Batches of alternately a million and a thousand photons more, all reflected into one bin:
        // their squares exceed 128 bits in units of 2^-82 from 32 batches on.
        let k = unit(&[0.1, 0.1, 1.0]);
        let large = f64::from(1u32 << 20);
        let batch = |photons: f64| {
            let mut batch = TallyBatch::new::<ScalarState>(GRID);
            let mut light = ScalarState::launch(&k);
            light.scale(photons);
            batch.exit(&light, photons, Side::Above, &k, 1);
            batch.absorb(2.0 * large - photons);
            batch
        };
        let mut totals = Totals::new(GRID, 1);
        for n in 0..2000 {
            let photons = large + if n % 2 == 0 { 1000.0 } else { -1000.0 };
            totals.take(&mut batch(photons), 2 << 20);
        }
        let mut twice = totals.clone();
        twice.merge(&totals).unwrap();
        for (totals, batches) in [(&totals, 2000.0), (&twice, 4000.0)] {
            // Standard deviation of a batch's fraction, divided by the root of the number of
            // batches.
            let expected = 1000.0 / (2.0 * large) / f64::sqrt(batches - 1.0);
            let reflected = totals.energies().reflected_all;
            assert!((reflected.value - 0.5).abs() < 1e-12);
            assert!(
                (reflected.std / expected - 1.0).abs() < 1e-3,
                "{reflected:?}"
            );
            let estimated = totals.relative_error().unwrap();
            assert!(
                (estimated / (2.0 * expected) - 1.0).abs() < 1e-3,
                "{estimated}"
            );
        }
    }
}
