//! Totals as text and back, exact to the last bit, for the file of a shard.

use super::Totals;
use crate::trace::counting::fixed_point::{Text, Wide, Words};
use crate::trace::surfaces::height_field::Side;

impl Totals {
    /// The exact sums of a bin as hexadecimal numbers, for a shard's file; `None` for an empty bin.
    #[must_use]
    pub fn exact_bin(&self, side: Side, bin: usize) -> Option<String> {
        let index = self.index(side, bin);
        if self.is_empty(side, bin) {
            return None;
        }
        let range = index * self.stride..(index + 1) * self.stride;
        let wide: Vec<Wide> = self.squares[range.clone()]
            .iter()
            .map(|w| Wide::of(*w))
            .collect();
        let text = Text::of(self.hits[index])
            .sums(self.bins[range.clone()].iter())
            .wide(&wide)
            .sums(self.known[range].iter());
        Some(text.finish())
    }

    /// The exact products of the direction that begins with a bin above, in the same form.
    #[must_use]
    pub fn exact_direction(&self, first: usize) -> Option<String> {
        self.products.as_ref()?.exact(first)
    }

    /// Reads the text of [`Totals::exact_direction`].
    pub fn set_exact_direction(&mut self, first: usize, text: &str) -> Option<()> {
        self.products.as_mut()?.set_exact(first, text)
    }

    /// The exact sums of the energies, in the same form.
    #[must_use]
    pub fn exact_energies(&self) -> String {
        let batches = i128::from(self.batches);
        Text::of(self.photons)
            .sums(std::iter::once(&batches).chain(self.energy_sums.all()))
            .wide(self.energy_squares.all())
            .wide(self.energy_products.all())
            .sums(self.energy_known.all())
            .finish()
    }

    /// Reads the text of [`Totals::exact_bin`].
    pub fn set_exact_bin(&mut self, side: Side, bin: usize, text: &str) -> Option<()> {
        let (hits, mut words) = Words::of(text)?;
        let (index, n) = (self.index(side, bin), self.stride);
        let (sums, squares, known) = (words.sums(n)?, words.wide(n)?, words.sums(n)?);
        words.end()?;
        if bin >= self.grid.per_side() {
            return None;
        }
        let range = index * n..(index + 1) * n;
        self.bins[range.clone()].copy_from_slice(&sums);
        for (resting, sum) in self.squares[range.clone()].iter_mut().zip(squares) {
            *resting = sum.resting();
        }
        self.lit[index] = known.iter().any(|x| *x != 0);
        self.known[range].copy_from_slice(&known);
        self.hits[index] = hits;
        Some(())
    }

    /// Reads the text of [`Totals::exact_energies`].
    pub fn set_exact_energies(&mut self, text: &str) -> Option<()> {
        let (photons, mut words) = Words::of(text)?;
        let count = self.energy_sums.all().count();
        let batches = u64::try_from(words.sums(1)?[0]).ok()?;
        let (sums, squares) = (words.sums(count)?, words.wide(count)?);
        let (products, known) = (words.wide(count)?, words.sums(count)?);
        words.end()?;
        (self.photons, self.batches) = (photons, batches);
        self.energy_sums.set(&sums);
        self.energy_squares.set(&squares);
        self.energy_products.set(&products);
        self.energy_known.set(&known);
        Some(())
    }
}
