//! Fits the reflectance model to observations and says how sure the answer is.
//!
//! Assumptions, before any code: residuals are divided by their standard uncertainty; what all
//! observations share (white reference, angle zeros, lamp drift) is no part of that uncertainty and
//! is propagated apart; the closed forms are wrong by more than the counting noise, so the scatter
//! that they leave is a term of the uncertainty of its own.
//!
//! The one function to call is [`fit`]. Rooms within: [`least_squares`] what a problem is ·
//! [`solver`] bounded Levenberg–Marquardt · [`problem`] the observation model · [`start`] where to
//! begin · [`estimate`] one variant · [`tier`] the dearer model as an offset · [`covariance`] and [`budget`] how sure · [`variants`] the choice ·
//! [`report`] the answer's form. It knows neither frames nor files nor the clock.

use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use crate::observation::ObservationSet;

pub mod budget;
pub mod covariance;
mod descent;
pub mod estimate;
pub mod least_squares;
pub mod problem;
pub mod report;
pub mod solver;
pub mod start;
pub mod text;
pub mod tier;
mod trust_region;
pub mod variants;

pub use report::FitReport;

/// Which variant the report shall hang on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VariantChoice {
    /// As printed.
    Paper,
    /// The sawtooth in full.
    Sawtooth,
    /// The better one.
    #[default]
    Auto,
}

/// What a fit may be told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct FitOptions {
    /// Which variant the report shall hang on; all are fitted and listed.
    pub variant: VariantChoice,
    /// Starts per variant.
    pub starts: usize,
    /// Seed of the scrambled Sobol set that starts come from.
    pub seed: u32,
}

impl Default for FitOptions {
    fn default() -> Self {
        FitOptions {
            variant: VariantChoice::Auto,
            starts: 8,
            seed: 1,
        }
    }
}

/// Fits a set of observations. Whatever is wrong with them is a status of the report, never a panic;
/// `cancel` stops it within one evaluation of the model.
#[must_use]
pub fn fit(set: &ObservationSet, options: &FitOptions, cancel: &AtomicBool) -> FitReport {
    variants::fit_with_tier(set, options, Some(&tier::two_bounces), cancel)
}
