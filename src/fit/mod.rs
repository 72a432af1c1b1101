//! Fits the reflectance model to observations and says how sure the answer is.
//!
//! Assumptions, before any code: residuals are divided by their standard uncertainty; what all
//! observations share (white reference, angle zeros, lamp drift) is no part of that uncertainty and
//! is propagated apart; the closed forms are wrong by more than the counting noise, so the scatter
//! that they leave is a term of the uncertainty of its own.
//!
//! The one function to call is [`fit`]. Rooms within: [`least_squares`] what a problem is ·
//! [`solver`] bounded Levenberg–Marquardt · [`quantity`] what can be looked for · [`problem`] the
//! observation model, with what is `known` before · [`loss`] how residuals count · [`start`] where to begin and [`search`] how far
//! to look (`crew`: all starts at once, on the form of `lean` or on the `full` one; `candidates`: from where else;
//! `projection`: amplitudes solved for) · [`estimate`] one variant (`opening`: what it begins with) · [`thin`] of very many observations ·
//! `misfit` how far it misses and `settle` its weights · [`tier`] the costlier model as an offset · [`traced`] the ray tracer
//! in its place · [`covariance`] and [`budget`] how sure (`drift`: of the lamp; `blunders`: of single poses and runs of them, by what is `leftover`) · [`profile`] and [`intervals`] without the parabola · [`variants`] the choice · [`reporting`] the report ·
//! [`joint`] several scans · [`trail`] against time · [`outlook`] how long beforehand · [`report`] the answer's form. It knows neither frames nor files nor the clock.

use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};

use crate::observation::ObservationSet;
use crate::trace::profile::Profile;

pub mod blunders;
pub mod budget;
mod candidates;
pub mod covariance;
mod crew;
mod descent;
pub mod drift;
mod edges;
pub mod estimate;
pub mod findings;
mod full;
pub mod intervals;
pub mod joint;
mod known;
mod lean;
pub mod least_squares;
mod leftover;
pub mod loss;
mod misfit;
mod opening;
pub mod outlook;
pub mod problem;
pub mod profile;
mod projection;
pub mod quantity;
pub mod report;
pub mod reporting;
pub mod search;
mod settle;
pub mod shape;
pub mod solver;
pub mod start;
mod suspects;
pub mod text;
pub mod thin;
pub mod tier;
pub mod told;
pub mod traced;
pub mod trail;
mod trust_region;
pub mod variants;
pub mod wedge;

#[cfg(test)]
mod elsewhere_tests;
#[cfg(test)]
mod extreme_tests;
#[cfg(test)]
mod options_tests;
#[cfg(test)]
mod painted;

pub use loss::Loss;
pub use quantity::Quantity;
pub use report::FitReport;
use traced::{TracingOptions, Watch};
use trail::Time;

/// Which variant the report shall hang on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VariantChoice {
    /// As printed.
    Paper,
    /// The sawtooth in full.
    Sawtooth,
    /// The sawtooth corrected by the ray tracer.
    Traced,
    /// Paper where it is clearly better by QAIC, else sawtooth.
    #[default]
    Auto,
}

/// What a fit may be told.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FitOptions {
    /// Which variant the report shall hang on; all are fitted and listed.
    pub variant: VariantChoice,
    /// Starts of a search's first look, per variant.
    pub starts: usize,
    /// Whether a search ends with its first look, so that no more starts are tried than `starts`. Else it goes on where
    /// that look leaves a doubt.
    pub starts_alone: bool,
    /// Seed of the scrambled Sobol set that starts come from.
    pub seed: u32,
    /// Whether the model may be wrong: its misfit is then estimated from the scatter, weighs the
    /// observations and is part of every uncertainty. Without it the observations' own
    /// uncertainties are the whole truth, as they are for data that the model itself painted.
    pub misfit: bool,
    /// The most that the model may miss, as a share of s (see `misfit`), whatever the scatter says; none where that
    /// is for the scatter to say.
    pub misfit_most: Option<f64>,
    /// How residuals count.
    pub loss: Loss,
    /// What is known beforehand, beside the certificates of the series.
    pub told: Vec<Told>,
    /// Whether profile-likelihood intervals are wanted.
    pub profile: bool,
    /// Series drawn for bootstrap intervals; 0 for none.
    pub bootstrap: u32,
    /// Share of the peak that may be left out of the model where that saves time: the integrated second
    /// bounce, where it changes less. Without it nothing is.
    pub tolerance: Option<f64>,
    /// Whether the ray tracer is asked how wrong the variant is: the difference to `traced` then is
    /// the model's line of the budget.
    pub judge: bool,
    /// How the ray tracer works, where it is asked.
    pub tracer: TracingOptions,
}

/// What the user knows of a quantity before the fit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Told {
    /// Of what.
    pub quantity: Quantity,
    /// Its value in natural units: angles in radians, θr ≥ 0.
    pub value: f64,
    /// Its standard uncertainty; 0 holds it fixed.
    pub std: f64,
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
            told: Vec::new(),
            profile: false,
            bootstrap: 0,
            tolerance: None,
            judge: false,
            tracer: TracingOptions::default(),
        }
    }
}

/// Fits a set of observations. Whatever is wrong with them is a status of the report, never a panic;
/// `cancel` stops it within one evaluation of the model.
#[must_use]
pub fn fit(set: &ObservationSet, options: &FitOptions, cancel: &AtomicBool) -> FitReport {
    fit_watched(set, options, None, &|_| true, None, cancel)
}

/// [`fit`] with what the ray tracer may be told: a profile to trace on instead of the ideal sawtooth,
/// and a watcher that sees how it gets on and may end it early; and with a clock, where a descent is to be
/// retraced or the bootstrap to be cut short.
#[must_use]
pub fn fit_watched(
    set: &ObservationSet,
    options: &FitOptions,
    profile: Option<&Profile>,
    watch: Watch<'_>,
    time: Option<Time<'_>>,
    cancel: &AtomicBool,
) -> FitReport {
    let tracer = variants::Tracer {
        profile,
        watch,
        time,
    };
    variants::fit_with_tracer(set, options, Some(&tier::two_bounces), &tracer, cancel)
}
