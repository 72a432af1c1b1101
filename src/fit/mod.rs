//! Fits the reflectance model to observations and says how sure the answer is.
//!
//! Assumptions, before any code: residuals are divided by their standard uncertainty; what all
//! observations share (white reference, angle zeros, lamp drift) is no part of that uncertainty and
//! is propagated apart; the closed forms are wrong by more than the counting noise, so the scatter
//! that they leave is a term of the uncertainty of its own.
//!
//! Rooms within: [`least_squares`] what a problem is · [`solver`] bounded Levenberg–Marquardt ·
//! [`covariance`] rank test and variances. It knows neither frames nor files nor the clock.

pub mod covariance;
mod descent;
pub mod least_squares;
pub mod solver;
mod trust_region;
