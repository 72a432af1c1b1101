//! The analytic part of a result: light whose path is known without sampling.

use super::TallyBatch;
use super::energies::Energies;
use crate::trace::counting::fixed_point::to_fixed;
use crate::trace::counting::grid::DirectionGrid;

/// Light whose path is known without sampling, per launched photon.
#[derive(Debug, Clone, PartialEq)]
pub struct AnalyticPart {
    pub(super) stride: usize,
    pub(super) bins: Vec<i128>,
    /// The bins that have any.
    pub(super) lit: Vec<bool>,
    pub(super) energies: Energies<i128>,
}

impl AnalyticPart {
    /// Makes an empty part.
    #[must_use]
    pub fn new(grid: DirectionGrid, elements: usize) -> Self {
        AnalyticPart {
            stride: elements,
            bins: vec![0; 2 * grid.per_side() * elements],
            lit: vec![false; 2 * grid.per_side()],
            energies: Energies::filled(0),
        }
    }

    /// Adds the counts of a batch and clears it. The order does not matter.
    pub fn take(&mut self, batch: &mut TallyBatch) {
        for &bin in &batch.touched {
            let bin = bin as usize;
            self.lit[bin] = true;
            let range = bin * self.stride..(bin + 1) * self.stride;
            for (known, x) in self.bins[range.clone()].iter_mut().zip(&batch.bins[range]) {
                *known += to_fixed(*x);
            }
        }
        for (known, x) in self.energies.all_mut().zip(batch.energies.all()) {
            *known += to_fixed(*x);
        }
        batch.clear();
    }
}
