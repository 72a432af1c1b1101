//! The camera's noise and its full count, from the manifest.
//!
//! A count is black + gain · (photo-electrons + dark electrons + read noise), rounded and clipped.
//! Electrons are Poisson distributed, so the variance of a count above black is gain · count.

use crate::robust;
use crate::series::Manifest;

/// Variance of rounding to whole counts.
const ROUNDING_DN2: f64 = 1.0 / 12.0;

/// The camera as the manifest describes it.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sensor {
    pub(super) width: usize,
    pub(super) height: usize,
    /// Counts per electron.
    pub(super) gain_dn: f64,
    /// Standard deviation of one read, in counts.
    pub(super) read_dn: f64,
    /// Count without light, used without dark frames.
    pub(super) black_dn: f64,
    /// A pixel at this count or above is full.
    pub(super) saturation_dn: f64,
    /// Bits of the converter, where they are stated.
    pub(super) bit_depth: Option<u32>,
    /// Largest count that they allow, or that a file can contain.
    pub(super) count_max: u16,
}

impl Sensor {
    pub(super) fn new(manifest: &Manifest) -> Self {
        let camera = &manifest.camera;
        Sensor {
            width: camera.width_px as usize,
            height: camera.height_px as usize,
            gain_dn: camera.gain_dn_per_electron,
            read_dn: camera.gain_dn_per_electron * camera.read_noise_electrons_rms.unwrap_or(0.0),
            black_dn: camera.black_level_dn.unwrap_or(0.0),
            saturation_dn: manifest.saturation_dn(),
            bit_depth: camera.bit_depth,
            count_max: camera.count_max().map_or(u16::MAX, |most| most as u16),
        }
    }

    pub(super) fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// Variance of one count whose expectation is `above_black_dn` above the black level.
    pub(super) fn variance_dn2(&self, above_black_dn: f64) -> f64 {
        self.gain_dn * above_black_dn.max(0.0) + self.read_dn * self.read_dn + ROUNDING_DN2
    }

    /// Returns whether a count is saturated.
    pub(super) fn is_full(&self, dn: u16) -> bool {
        f64::from(dn) >= self.saturation_dn
    }
}

/// Median of some numbers, whose order changes; 0 of none.
pub(super) fn median(values: &mut [f64]) -> f64 {
    robust::median(values).unwrap_or(0.0)
}

/// Median and robust standard deviation of some numbers, whose order changes; 0 of none.
pub(super) fn robust_spread(values: &mut [f64]) -> (f64, f64) {
    robust::spread(values).unwrap_or((0.0, 0.0))
}
