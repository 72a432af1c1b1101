//! The counts of one independent replicate, bin by bin; hot code, cleared and reused.

use super::energies::{Energies, ORDERS};
use crate::trace::counting::grid::{BinFinder, DirectionGrid};
use crate::trace::photons::light::PhotonState;
use crate::trace::surfaces::height_field::Side;
use crate::trace::vec3::V3;

/// Work between two calls of the stop callback: about a millisecond.
const ASKED: u64 = 1 << 16;

/// The counts of the photons of one replicate.
#[derive(Debug)]
pub struct TallyBatch {
    /// Work of its photons: cells crossed, and other work in the same unit.
    pub work: u64,
    asked_at: u64,
    /// Its photons were stopped on their way: the counts are invalid.
    pub given_up: bool,
    finder: BinFinder,
    pub(super) stride: usize,
    pub(super) bins: Vec<f64>,
    pub(super) hits: Vec<u32>,
    pub(super) touched: Vec<u32>,
    pub(super) energies: Energies<f64>,
}

impl TallyBatch {
    /// Makes an empty batch for light of kind `L`.
    #[must_use]
    pub fn new<L: PhotonState>(grid: DirectionGrid) -> Self {
        let bins = 2 * grid.per_side();
        TallyBatch {
            work: 0,
            asked_at: ASKED,
            given_up: false,
            finder: grid.finder(),
            stride: L::ELEMENTS,
            bins: vec![0.0; bins * L::ELEMENTS],
            hits: vec![0; bins],
            touched: Vec::new(),
            energies: Energies::filled(0.0),
        }
    }

    /// Counts light that leaves along `k` on a side after `interactions` (≥ 1), already in the
    /// frame of exit.
    #[inline]
    pub fn exit<L: PhotonState>(
        &mut self,
        light: &L,
        power: f64,
        side: Side,
        k: &V3,
        interactions: u32,
    ) {
        self.count(light, power, self.finder.bin(side, k), side, interactions);
    }

    /// The same for a known bin.
    #[inline(always)]
    pub fn count<L: PhotonState>(
        &mut self,
        light: &L,
        power: f64,
        bin: usize,
        side: Side,
        interactions: u32,
    ) {
        light.add_to(self.slot::<L>(bin));
        self.book(power, side, interactions);
    }

    /// The same for light after one interaction with given numbers.
    #[inline(always)]
    pub(in crate::trace) fn count_numbers<L: PhotonState>(
        &mut self,
        numbers: impl Iterator<Item = f64>,
        power: f64,
        bin: usize,
        side: Side,
    ) {
        for (sum, x) in self.slot::<L>(bin).iter_mut().zip(numbers) {
            *sum += x;
        }
        self.book(power, side, 1);
    }

    /// The numbers of a bin that is being counted.
    #[inline(always)]
    fn slot<L: PhotonState>(&mut self, bin: usize) -> &mut [f64] {
        if self.hits[bin] == 0 {
            self.touched.push(bin as u32);
        }
        self.hits[bin] += 1;
        &mut self.bins[bin * L::ELEMENTS..(bin + 1) * L::ELEMENTS]
    }

    #[inline(always)]
    fn book(&mut self, power: f64, side: Side, interactions: u32) {
        let order = (interactions as usize).clamp(1, ORDERS) - 1;
        match side {
            Side::Above => {
                self.energies.reflected[order] += power;
                self.energies.reflected_all += power;
            }
            Side::Below => {
                self.energies.transmitted[order] += power;
                self.energies.transmitted_all += power;
            }
        }
    }

    /// Counts power absorbed by a metal or a layer.
    #[inline]
    pub fn absorb(&mut self, power: f64) {
        self.energies.absorbed += power;
    }

    /// Whether the stop callback is due; the next time is the same amount of work later.
    #[inline(always)]
    pub fn take_due(&mut self) -> bool {
        let due = self.work >= self.asked_at;
        if due {
            self.asked_at = self.work + ASKED;
        }
        due
    }

    /// Adds the counts of another batch with the same bins, and clears that.
    pub fn take(&mut self, other: &mut TallyBatch) {
        for &bin in &other.touched {
            let at = bin as usize;
            if self.hits[at] == 0 {
                self.touched.push(bin);
            }
            self.hits[at] += other.hits[at];
            let range = at * self.stride..(at + 1) * self.stride;
            for (sum, x) in self.bins[range.clone()].iter_mut().zip(&other.bins[range]) {
                *sum += x;
            }
        }
        for (sum, x) in self.energies.all_mut().zip(other.energies.all()) {
            *sum += x;
        }
        other.clear();
    }

    /// Clears it for its next use.
    pub fn clear(&mut self) {
        (self.work, self.asked_at, self.given_up) = (0, ASKED, false);
        for bin in self.touched.drain(..) {
            let bin = bin as usize;
            self.hits[bin] = 0;
            self.bins[bin * self.stride..(bin + 1) * self.stride].fill(0.0);
        }
        self.energies = Energies::filled(0.0);
    }

    /// Counts power that was given up.
    #[inline]
    pub fn truncate(&mut self, power: f64) {
        self.energies.truncated += power;
    }
}
