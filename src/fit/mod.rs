//! Fits the reflectance model to observations and reports the result with its uncertainty. Call [`fit`].
//!
//! Assumptions:
//!
//! - Residuals are divided by their standard uncertainty.
//! - Errors that all observations share (white reference, angle zeros, lamp drift) are not part of that uncertainty.
//!   They are propagated separately.
//! - The model error of the closed forms exceeds the counting noise. The scatter that it leaves is a separate term of
//!   the uncertainty.
//!
//! A fit of one variant uses these modules in this order. [`one_variant`] is the function to call, `pipeline` has the steps:
//!
//! 1. [`problem`]: residuals of samples, flats and priors by the free quantities ([`quantity`]), with [`constraints`], `known`
//!    errors and [`loss`].
//! 2. [`search_setup`]: free quantities, weights and first starts, on a [`subsample`] of very many observations.
//! 3. [`multistart`]: descents from all starts at once until the stopping rule ends them.
//! 4. `model_discrepancy`, `reweighting`, [`higher_order`]: the model error, weights that allow for it, and the integrated second
//!    bounce as a fixed offset. `discontinuities`: minima at edges of the closed form. [`traced`]: the ray tracer instead of the
//!    second bounce.
//! 5. [`estimate`]: the fitted variant.
//!
//! Around it:
//!
//! - [`least_squares`]: the solver, which knows no reflectance.
//! - [`causes`]: why data and model disagree: sample, detector, lamp, rig, single poses.
//! - [`uncertainty`]: covariance, budget, intervals.
//! - `fitting`: the fits of all variants, repeated where a cause changes the observations. [`model_selection`]: the choice between
//!   the variants. [`joint`]: several scans of one part.
//! - [`report`]: the result as JSON and text. [`fitted_surface`]: its BRDF.
//! - [`convergence_trace`] and [`cost_estimate`]: progress against time, and the forecast of the duration.
//!
//! This module reads no frames and no files. Time limits use the caller's clock ([`convergence_trace::Time`]).

use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use crate::observation::ObservationSet;
use crate::trace::surfaces::surface_profile::SurfaceProfile;

pub mod causes;
pub mod constraints;
pub mod convergence_trace;
pub mod cost_estimate;
mod discontinuities;
pub mod estimate;
pub mod fitted_surface;
mod fitting;
pub mod higher_order;
pub mod joint;
pub(crate) mod known;
pub mod least_squares;
pub mod loss;
mod model_discrepancy;
pub mod model_selection;
pub mod multistart;
pub mod one_variant;
mod pipeline;
pub mod problem;
pub mod quantity;
pub mod report;
mod reweighting;
pub mod search_setup;
pub mod subsample;
pub mod traced;
pub mod uncertainty;

#[cfg(test)]
mod elsewhere_tests;
#[cfg(test)]
mod extreme_tests;
#[cfg(test)]
mod near_tests;
#[cfg(test)]
mod options_tests;
#[cfg(test)]
pub(crate) mod painted;

use convergence_trace::Time;
pub use loss::Loss;
use multistart::tuning::Tuning;
pub use quantity::Quantity;
pub use report::FitReport;
use traced::{TracingOptions, Watch};

/// Variant that the report is based on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum VariantChoice {
    /// The lobe as printed in the paper.
    Paper,
    /// The complete sawtooth.
    Sawtooth,
    /// The sawtooth, corrected by the ray tracer.
    Traced,
    /// `paper` if it is clearly better by QAIC, otherwise `sawtooth`.
    #[default]
    Auto,
}

/// Options of a fit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FitOptions {
    /// Variant that the report is based on. All variants are fitted and listed.
    pub variant: VariantChoice,
    /// Starts of the first round of a search, per variant.
    pub starts: usize,
    /// Whether a search ends after `starts` starts. Otherwise the stopping rule of [`multistart`] ends it.
    pub starts_alone: bool,
    /// Seed of the scrambled Sobol sequence of the starts.
    pub seed: u32,
    /// Whether to allow for a model error. If so, it is estimated from the scatter, enters the weights and is part of every
    /// uncertainty. If not, the uncertainties of the observations count as complete, as for data computed from the model.
    pub misfit: bool,
    /// Upper limit of the model error as a share of s (see `model_discrepancy`). Without a limit the scatter decides.
    pub misfit_most: Option<f64>,
    /// How residuals count.
    pub loss: Loss,
    /// Values that the user states, in addition to the certificates of the series.
    pub constraints: Vec<Constraint>,
    /// Whether to compute profile-likelihood intervals.
    pub profile: bool,
    /// Number of resampled series for bootstrap intervals; 0 for none.
    pub bootstrap: u32,
    /// Share of the peak below which the integrated second bounce may be left out to save time. If omitted, nothing is
    /// left out.
    pub tolerance: Option<f64>,
    /// Whether to estimate the model error with the ray tracer. The difference to `traced` is then the line `model` of
    /// the budget.
    pub judge: bool,
    /// Settings of the ray tracer, where it is used.
    pub tracer: TracingOptions,
    /// Constants of the search; only a bench changes them.
    #[serde(skip)]
    pub tuning: Tuning,
}

/// A value that the user states before the fit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Constraint {
    /// The quantity.
    pub quantity: Quantity,
    /// Its value in natural units: angles in radians, θr ≥ 0.
    pub value: f64,
    /// Its standard uncertainty in the same unit; 0 holds the value fixed.
    pub std: f64,
}

impl FitOptions {
    /// The constraints that hold a quantity at its value.
    pub(crate) fn held(&self) -> impl Iterator<Item = &Constraint> {
        self.constraints.iter().filter(|stated| stated.std == 0.0)
    }
}

impl Default for FitOptions {
    fn default() -> Self {
        FitOptions {
            variant: VariantChoice::Auto,
            starts: 8,
            starts_alone: false,
            seed: 1,
            misfit: true,
            misfit_most: None,
            loss: Loss::Linear,
            constraints: Vec::new(),
            profile: false,
            bootstrap: 0,
            tolerance: None,
            judge: false,
            tracer: TracingOptions::default(),
            tuning: Tuning::DEFAULT,
        }
    }
}

/// Fits a set of observations. A defect of the data gives a status of the report, never a panic. `cancel` stops the fit
/// within one evaluation of the model.
#[must_use]
pub fn fit(set: &ObservationSet, options: &FitOptions, cancel: &AtomicBool) -> FitReport {
    fit_watched(set, options, None, &|_| true, None, cancel)
}

/// Like [`fit`], with a profile to trace instead of the ideal sawtooth, a watcher that follows the ray tracer and may
/// end it early, and a clock. The clock is needed to retrace a descent and to limit the time of the bootstrap.
#[must_use]
pub fn fit_watched(
    set: &ObservationSet,
    options: &FitOptions,
    profile: Option<&SurfaceProfile>,
    watch: Watch<'_>,
    time: Option<Time<'_>>,
    cancel: &AtomicBool,
) -> FitReport {
    let tracer = model_selection::Tracer {
        profile,
        watch,
        time,
    };
    model_selection::fit_with_tracer(
        set,
        options,
        Some(&higher_order::two_bounces),
        &tracer,
        cancel,
    )
}
