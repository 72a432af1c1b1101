//! What one frame shows about focus, saturation and exposure, before a scan.
//!
//! [`figures::Figures::of`] reads a frame; [`exposures::ExposureSearch`] turns such figures into exposures for a scan, and
//! names the next frame to take where the frames so far do not suffice. Pure functions: the lab takes the frames.

pub mod defects;
pub mod exposures;
pub mod figures;

use serde::{Deserialize, Serialize};

/// What the counts of a camera mean.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CountScale {
    /// Count at which a pixel is full.
    pub full_dn: u16,
    /// Count without light.
    pub black_dn: f64,
    /// Counts per electron.
    pub gain_dn_per_electron: f64,
    /// Read noise, DN.
    pub read_noise_dn: f64,
}

impl CountScale {
    /// Returns the variance of a count, DN².
    fn variance_dn2(&self, dn: f64) -> f64 {
        let shot = self.gain_dn_per_electron * (dn - self.black_dn).max(0.0);
        self.read_noise_dn.powi(2) + shot + 1.0 / 12.0
    }
}

/// A rectangle of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = AreaBody)]
pub struct Area {
    /// First column, from 0.
    #[schema(minimum = 0, maximum = 65_535)]
    pub left_px: u32,
    /// First row, from 0.
    #[schema(minimum = 0, maximum = 65_535)]
    pub top_px: u32,
    /// Columns.
    #[schema(minimum = 1, maximum = 65_535)]
    pub width_px: u32,
    /// Rows.
    #[schema(minimum = 1, maximum = 65_535)]
    pub height_px: u32,
}
