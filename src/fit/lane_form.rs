//! What a form of the model offers to vectorised descents.

use pulp::Simd;

use super::lean::{N, ROW, Row};
use crate::model::lanes::Lane;

/// A form of the model for a register of surfaces.
pub(super) trait Form: Copy + Sync {
    /// Number of values that describe a surface, up to [`MOST`].
    const SHAPE: usize;
    /// Writes them for a surface, from its values by [`COLUMNS`].
    fn shape(&self, x: &[f64; N], to: &mut [f64; MOST]);
    /// Evaluates one observation of one surface per lane.
    fn row<S: Simd>(&self, simd: S, pose: &[Lane<S>; ROW], shape: &[Lane<S>; MOST]) -> Row<S>;
}

/// Largest number of values that describe a surface.
pub(super) const MOST: usize = 32;
