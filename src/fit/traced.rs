//! The variant `traced`: the closed form of the sawtooth, corrected by the ray tracer.
//!
//! The tracer costs a hundred thousand closed forms per pose and has no derivatives, so the solver does not call it.
//! Every observed pose is traced at the fitted parameters. The closed form is multiplied by the ratio traced/closed
//! (where it nearly vanishes, the difference is added) and fitted again, until the parameters stay. A pose keeps its
//! random numbers from pass to pass, so the passes converge to one point in spite of the noise of the tracer: each step is
//! a fraction c of the one before, and what lies ahead is c/(1 − c) of the last one ([`Run::shrinkage`]). The standard
//! uncertainty of that point is propagated from the standard errors of the radiances and is a line of the
//! budget. The number of paths is increased until that line is small compared with the others.
//!
//! Call [`estimate_traced`]. It has no clock: the watcher decides when to stop, and the results until then count.

mod accuracy;
mod task;
mod types;

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use super::FitOptions;
use super::estimate::Estimate;
use super::least_squares::levenberg_marquardt::Settings;
use super::model_discrepancy::misfit_scale;
use super::problem::{Quantity, Values};
use super::reweighting::{Weighing, WeightedFit};
use super::uncertainty::budget::uncertainty;
use crate::material::Material;
use crate::observation::ObservationSet;
use crate::trace::facets::scattering::{DiffuseBody, Roughness};
use crate::trace::pose_radiance::RidgedSurface;
use crate::trace::surfaces::surface_profile::SurfaceProfile;
use accuracy::{excess, length};
use task::{Outcome, Task};
pub use types::{Tracing, TracingEnd, TracingOptions, TracingProgress, Watch};

/// Maximum number of passes.
const PASSES_MAX: usize = 10;
/// First passes, with the given number of paths, before the required number is known.
const FIRST_PASSES: usize = 2;
/// Smallest ridge angle that is traced, rad: below it the width of the riser is lost in rounding.
const FLATTEST: f64 = 1e-4;

/// Continues from a `sawtooth` estimate with the corrections of the tracer, on the ideal sawtooth or on a given
/// profile, whose heights are scaled to the fitted ridge angle. Returns `None` if it was cancelled or stopped before
/// the first pass ended, or if a radiance is not finite.
#[must_use]
pub fn estimate_traced<'a>(
    sawtooth: &Estimate<'a>,
    fit_options: &FitOptions,
    profile: Option<&SurfaceProfile>,
    watch: Watch<'_>,
    cancel: &AtomicBool,
) -> Option<Estimate<'a>> {
    let options = &fit_options.tracer;
    let set = sawtooth.problem.set();
    let poses = set.observations.len() as u64;
    let metal = matches!(set.material, Material::Conductor { .. });
    let task = |polarised, done| Task {
        sawtooth,
        fit_options,
        profile,
        watch,
        cancel,
        polarised,
        paths: options.paths.max(1),
        pass: 0,
        done: Mutex::new(done),
        planned: if metal { 3 } else { 5 } * options.paths.max(1) * poses,
    };
    let first = Run {
        settled: WeightedFit {
            problem: sawtooth.problem.clone(),
            minimum: sawtooth.minimum.clone(),
            discrepancy: sawtooth.discrepancy,
        },
        reached: None,
        excess: 0.0,
        before: None,
        shrinkage: None,
        end: TracingEnd::MostPasses,
    };
    let mut run = first.clone();
    let mut main = task(true, 0);
    if !metal {
        // Renderers often omit polarisation for plastic, but real light is polarised. Tracing with the same random
        // numbers with and without polarisation shows which case applies.
        let briefly = TracingOptions {
            paths_max: options.paths,
            ..*options
        };
        run.go_on(&mut main, &briefly, FIRST_PASSES)?;
        let mut scalar = (task(false, main.done()), first);
        scalar.1.go_on(&mut scalar.0, &briefly, FIRST_PASSES)?;
        let misfit = |run: &Run<'_>| run.reached.as_ref().map(|e| e.chi2_reduced_without_model);
        if let (Some(with), Some(without)) = (misfit(&run), misfit(&scalar.1))
            && without < with
        {
            (main, run) = scalar;
        }
    }
    if !matches!(run.end, TracingEnd::Stopped | TracingEnd::Settled) {
        run.go_on(&mut main, options, PASSES_MAX)?;
    }
    let rivals = match (&run.reached, run.end) {
        (Some(best), end) if end != TracingEnd::Stopped => main.not_refuted(best),
        _ => sawtooth.rivals.clone(),
    };
    // What a shape leaves open is a limit, not a standard uncertainty.
    let open = profile.and_then(SurfaceProfile::alternative);
    let open = open.filter(|_| run.reached.is_some() && run.end != TracingEnd::Stopped);
    let moved = open.and_then(|other| run.moved_on(&mut main, other));
    let mut estimate = run.reached?;
    if let Some(done) = &mut estimate.traced {
        done.end = run.end;
        for (apart, moved) in done.apart.iter_mut().zip(moved.iter().flatten()) {
            *apart = apart.hypot(*moved);
        }
    }
    estimate.rivals = rivals;
    Some(estimate)
}

/// Scatter between observations and model.
struct Scatter {
    /// Independent standard uncertainties of the observations and of the tracer.
    own: Vec<f64>,
    /// Scale of the model error of each observation.
    scale: Vec<f64>,
    /// Weights of the observations by a robust loss in the fit of the closed form.
    weights: Vec<f64>,
}

impl Scatter {
    fn new(sawtooth: &Estimate<'_>, tracer: &[f64]) -> Self {
        let set = sawtooth.problem.set();
        let both = set.observations.iter().zip(tracer);
        Scatter {
            own: both.map(|(o, tracer)| o.sigma.hypot(*tracer)).collect(),
            scale: misfit_scale(set),
            weights: sawtooth.loss_weights.clone(),
        }
    }

    fn weighing<'s>(&'s self, task: &'s Task<'_, '_>) -> Weighing<'s> {
        Weighing {
            own: &self.own,
            scale: &self.scale,
            kept: Some(&self.weights),
            fitted: task.sawtooth.fitted,
            options: task.fit_options,
            cancel: task.cancel,
        }
    }

    /// Builds the estimate from a settled minimum and from that of the closed form.
    fn estimate<'a>(&self, settled: &WeightedFit<'a>, sawtooth: &Estimate<'a>) -> Estimate<'a> {
        let estimate = Estimate {
            discrepancy: settled.discrepancy,
            values: settled.values(),
            higher_order_shift: vec![0.0; settled.minimum.parameters.len()],
            higher_order_undecided: false,
            minimum: settled.minimum.clone(),
            problem: settled.problem.clone(),
            ..sawtooth.clone()
        };
        estimate.with_statistics(&self.own)
    }
}

/// State of the passes.
#[derive(Clone)]
struct Run<'a> {
    settled: WeightedFit<'a>,
    reached: Option<Estimate<'a>>,
    /// Factor by which the error of the tracer was too large in the last pass.
    excess: f64,
    /// Paths and length of the step of the last pass.
    before: Option<(u64, f64)>,
    /// Largest ratio of the steps of two passes with the same paths.
    shrinkage: Option<f64>,
    end: TracingEnd,
}

impl<'a> Run<'a> {
    /// Runs passes until the parameters stay and the error is small, or until pass number `last`. Returns `None` if it
    /// was cancelled or a radiance is not finite.
    fn go_on(
        &mut self,
        task: &mut Task<'_, 'a>,
        options: &TracingOptions,
        last: usize,
    ) -> Option<()> {
        let set = task.sawtooth.problem.set();
        let poses = set.observations.len() as u64;
        self.end = TracingEnd::MostPasses;
        while task.pass < last {
            task.raise_paths(self.excess, options);
            task.pass += 1;
            let before = self.settled.minimum.parameters.clone();
            let values = self.settled.problem.unpack(&before);
            let traced = match task.trace(&self.settled.problem, &values) {
                Outcome::Traced(traced) => traced,
                Outcome::Stopped => {
                    self.end = TracingEnd::Stopped;
                    break;
                }
                Outcome::NotFinite => return None,
            };
            let scatter = Scatter::new(task.sawtooth, &traced.sigma);
            let settled = &mut self.settled;
            let problem = settled.problem.clone().with_factor(traced.factor);
            settled.problem = problem.with_correction(traced.added);
            settled.rounds(&Settings::NEAR, &scatter.weighing(task));
            settled.minimum = settled.again(&settled.minimum.parameters, task.cancel);
            if task.cancel.load(Ordering::Relaxed) {
                return None;
            }
            let moved = settled.minimum.parameters.iter().zip(&before);
            let mut estimate = scatter.estimate(settled, task.sawtooth);
            estimate.traced = Some(Tracing {
                sigma: traced.sigma,
                apart: match task.profile {
                    // The budget treats `apart` as a limit, whose standard uncertainty is √⅓ of it.
                    Some(profile) => {
                        let off = |q: &Quantity| match q {
                            Quantity::ThetaR => 3f64.sqrt() * profile.lobe_error(),
                            _ => 0.0,
                        };
                        settled.problem.free().iter().map(off).collect()
                    }
                    None => settled
                        .minimum
                        .parameters
                        .iter()
                        .zip(&task.sawtooth.minimum.parameters)
                        .map(|(a, b)| a - b)
                        .collect(),
                },
                ahead: moved.map(|(a, b)| a - b).collect(),
                passes: task.pass,
                paths: task.paths,
                error: traced.error,
                polarised: task.polarised,
                end: self.end,
            });
            let ahead = self.share_ahead(length(&estimate, &uncertainty(&estimate)), task.paths);
            for step in estimate.traced.iter_mut().flat_map(|t| &mut t.ahead) {
                *step *= ahead;
            }
            let u = uncertainty(&estimate);
            let still = length(&estimate, &u) <= 1.0;
            self.excess = match options.target_error {
                Some(target) => traced.error / target,
                None => excess(&estimate, &u),
            };
            self.reached = Some(estimate);
            if still && (self.excess <= 1.0 || task.paths >= options.paths_max) {
                self.end = if self.excess <= 1.0 {
                    TracingEnd::Settled
                } else {
                    TracingEnd::MostPaths
                };
                break;
            }
            let next = if task.pass < FIRST_PASSES { 2 } else { 1 };
            task.planned = task.planned.max(task.done() + next * task.paths * poses);
        }
        Some(())
    }

    /// Returns the share of a step that further passes would add, from the steps so far.
    fn share_ahead(&mut self, step: f64, paths: u64) -> f64 {
        if let Some((same, before)) = self.before.replace((paths, step))
            && same == paths
            && before > 0.0
        {
            let ratio = step / before;
            self.shrinkage = Some(self.shrinkage.map_or(ratio, |largest| largest.max(ratio)));
        }
        // Steps that shrink by less than half may belong to no sequence.
        self.shrinkage
            .map_or(1.0, |c| (c / (1.0 - c.min(0.5))).min(1.0))
    }
}

impl<'a> Run<'a> {
    /// Returns the change of each free parameter (units of the solver) if the sample has another shape, from one more
    /// pass with it; `None` if it was stopped.
    fn moved_on<'t>(&self, task: &mut Task<'t, 'a>, other: &'t SurfaceProfile) -> Option<Vec<f64>> {
        task.profile = Some(other);
        let WeightedFit {
            problem, minimum, ..
        } = &self.settled;
        let at = &minimum.parameters;
        let Outcome::Traced(traced) = task.trace(problem, &problem.unpack(at)) else {
            return None;
        };
        let there = problem.clone().with_factor(traced.factor);
        let there = there.with_correction(traced.added);
        let moved = there.descend(at, &Settings::DEFAULT, task.cancel);
        let steps = moved.parameters.iter().zip(at);
        Some(steps.map(|(a, b)| a - b).collect())
    }
}

/// Builds the sample of the tracer for given values; `None` if a profile cannot have that angle.
#[must_use]
pub fn ridged_surface(
    set: &ObservationSet,
    values: &Values,
    profile: Option<&SurfaceProfile>,
) -> Option<RidgedSurface> {
    let theta_r = values.theta_r.abs().max(FLATTEST);
    let cos_l = set.rig.theta_l.rad().cos();
    let dielectric = matches!(set.material, Material::Dielectric { .. });
    let body = DiffuseBody::new(values.rho_d, values.eta, 1.0, cos_l)
        .with_translucency(values.real.translucency);
    let profile = match profile {
        Some(profile) => profile.with_ridge_angle(theta_r)?,
        None => SurfaceProfile::rounded(theta_r, 1.0, [values.real.crest, 0.0]).ok()?,
    };
    let roughness = Roughness {
        alpha_u: values.alpha_u,
        alpha_v: values.alpha_v,
    };
    let body = (dielectric && values.rho_d > 0.0).then_some(body);
    let surface = RidgedSurface::new(profile, roughness, [values.eta, values.k], body);
    Some(match values.real.tail {
        0.0 => surface,
        tail => surface.with_tail(tail),
    })
}

#[cfg(test)]
#[path = "traced_tests.rs"]
mod tests;
