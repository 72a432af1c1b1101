//! How sure a fit is: the covariance of what it fitted, the budget of every source, and intervals without the linear
//! approximation.

pub mod budget;
pub mod covariance;
pub mod coverage;
pub mod intervals;
pub(super) mod parameter_covariance;
pub mod profile;
pub(super) mod unexplained;
