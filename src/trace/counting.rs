//! Light counted in bins of direction, with standard errors, and what is read from the bins.

pub mod bins;
pub(super) mod fixed_point;
pub mod grid;
pub mod plane;
pub mod polarisation_difference;
pub mod tally;
