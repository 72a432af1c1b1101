//! A fitted variant: what the search, the settling and the corrections leave to the budget and the report.

use super::causes::findings::{Finding, ObservationCause};
use super::least_squares::minimum::Minimum;
use super::model_discrepancy::{freedom, misfit_scale, peak};
use super::problem::{Problem, Quantity, Values};
use super::traced::Tracing;
use crate::observation::ObservationSet;

/// A fitted variant.
#[derive(Debug, Clone)]
pub struct Estimate<'a> {
    /// The problem with its final weights and corrections.
    pub problem: Problem<'a>,
    /// The minimum, in the parameters of the solver.
    pub minimum: Minimum,
    /// All values, with the sign of θr as the solver left it (see [`Values::folded`]).
    pub values: Values,
    /// Model discrepancy d, as a share of s (see `model_discrepancy`).
    pub discrepancy: f64,
    /// Standard uncertainty of each observation by the model error, d·s.
    pub misfit: Vec<f64>,
    /// Outcomes of the starts.
    pub starts: StartReport,
    /// χ² per degree of freedom with counting noise only.
    pub chi2_reduced_without_model: f64,
    /// Root mean square residual of the samples as a share of the largest signal.
    pub rms_residual: f64,
    /// Number of free parameters without those that only move within a stated uncertainty.
    pub fitted: usize,
    /// Change of each free parameter by the higher order (units of the solver); zero without it.
    pub higher_order_shift: Vec<f64>,
    /// Whether the data cannot distinguish the higher order from the closed form without it.
    pub higher_order_undecided: bool,
    /// Weight of each observation by the loss, 1 if it counts in full.
    pub loss_weights: Vec<f64>,
    /// Whether noise, or a small model error, accounts for the scatter. Otherwise possibly no start found the lobe.
    pub explained: bool,
    /// Quantities that the user holds.
    pub held: Vec<Quantity>,
    /// Other minima that the data do not exclude at the coverage of the report.
    pub rivals: Vec<Minimum>,
    /// Other ends of the search at any cost, best first: a term that joins the fit may prefer one of them.
    pub elsewhere: Vec<Minimum>,
    /// A surface without a lobe, if the data do not exclude it: light of the body alone.
    pub no_lobe: Option<Minimum>,
    /// What the ray tracer did, if the estimate depends on it.
    pub traced: Option<Tracing>,
    /// If the tolerance allowed leaving out the higher order: its effect, as a share of the peak.
    pub higher_order_left_out: Option<f64>,
    /// Whether the time limit ended the search for other explanations of the data.
    pub cut_short: bool,
    /// What was left out because there are very many observations.
    pub thinned: Option<Subsample>,
    /// What explains the residual that an ideal sawtooth leaves, largest share first.
    pub findings: Vec<Finding>,
    /// Whether wrong poses were tried beside those terms.
    pub(super) poses_tried: bool,
    /// The cause in the observations that explains the residual better than any property of the surface.
    pub(super) observation_cause: Option<Box<ObservationCause>>,
    /// Whether the residual was large enough to try the terms of real samples.
    pub investigated: bool,
}

impl Estimate<'_> {
    /// Whether the corrections of the higher order are in use.
    pub(super) fn takes_higher_order(&self) -> bool {
        self.higher_order_shift.iter().any(|s| *s != 0.0)
    }

    /// Changes of the weighted residuals of the observations by the stated standard uncertainties of both stages.
    pub(super) fn by_stages(&self) -> Vec<f64> {
        let (problem, values) = (&self.problem, &self.values);
        let ready = problem.ready(values);
        let observations = problem.set().observations.iter().enumerate();
        let each = observations.map(|(i, o)| {
            let g = problem.corrected(i, &ready);
            let by_tilt = g.theta_c * o.shared.theta_c_zero.rad();
            let by_turn = g.phi_s * o.shared.phi_s_zero.rad();
            values.scale / problem.sigma()[i] * by_tilt.hypot(by_turn)
        });
        each.collect()
    }

    /// Computes χ² without the model error, the RMS residual and the model error from the other fields. `own` are the
    /// independent standard uncertainties of the observations, in the unit of the signals.
    pub(super) fn with_statistics(mut self, own: &[f64]) -> Self {
        let set = self.problem.set();
        let residuals = self.problem.signal_residuals(&self.values);
        let squares = |weight: &dyn Fn(usize) -> f64| -> f64 {
            let each = residuals.iter().zip(&self.loss_weights).enumerate();
            each.map(|(i, (r, w))| w * (r * weight(i)).powi(2)).sum()
        };
        let (count, peak) = (residuals.len(), peak(set));
        self.chi2_reduced_without_model = squares(&|i| 1.0 / own[i]) / freedom(count, self.fitted);
        self.rms_residual = (squares(&|_| 1.0 / peak) / count.max(1) as f64).sqrt();
        let scale = misfit_scale(set).into_iter();
        self.misfit = scale.map(|s| self.discrepancy * s).collect();
        self
    }

    /// The observations with views that sum a lobe as narrow as the fitted one right; `None` if they have them, or none finer.
    pub(super) fn with_finer_views(&self) -> Option<ObservationSet> {
        let set = self.problem.set();
        let alpha = self.values.alpha_u.min(self.values.alpha_v);
        set.with_finer_views(alpha.hypot(set.rig.cones.widening().sqrt()))
    }
}

/// Outcomes of a run over several starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct StartReport {
    /// Starts tried.
    pub tried: usize,
    /// Starts that ended at the best minimum.
    pub at_minimum: usize,
    /// Starts that converged to other minima.
    pub elsewhere: usize,
    /// Starts that did not converge.
    pub not_converged: usize,
}

/// What a fit of very many observations left out.
#[derive(Debug, Clone, PartialEq)]
pub struct Subsample {
    /// Indices of the observations that the search used.
    pub kept: Vec<usize>,
    /// Number of poses at which the higher order was integrated, and the error of the interpolation (root mean square
    /// over poses in between, as a share of the peak). `None` if no higher order is in use or it was integrated at every pose.
    pub interpolated: Option<(usize, f64)>,
}
