//! The variant `traced`: the closed form of the sawtooth corrected by the ray tracer.
//!
//! The tracer costs a hundred thousand closed forms a pose and has no derivatives, so the solver never
//! sees it. At the fitted parameters every observed pose is traced; the closed form is multiplied by
//! the ratio traced/closed (where it nearly vanishes, the difference is added) and fitted again, until
//! the parameters stay. A pose keeps its random numbers from pass to pass, so the passes settle at
//! one point however noisy the tracer is; that point's own standard uncertainty is propagated from
//! the standard errors of the radiances and is a line of the budget. Paths are multiplied until
//! that line is small against the others.
//!
//! The one function to call is [`estimate_traced`]. It knows no clock: whoever watches it says when
//! to stop, and what was reached by then counts.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::budget::{Uncertainty, uncertainty};
use super::estimate::Estimate;
use super::misfit::{LEAST_WEIGHT, ROUNDS, discrepancy_of, freedom, misfit_scale, peak};
use super::problem::{Problem, Quantity, Values};
use super::search::AMBIGUOUS_RISE;
use super::solver::{Minimum, Settings, minimise};
use super::{FitOptions, Loss};
use crate::material::Material;
use crate::observation::ObservationSet;
use crate::trace::facet::{Diffuse, Roughness};
use crate::trace::profile::Profile;
use crate::trace::ridged::{RadianceOptions, RidgedSurface};
use crate::trace::rng::{Purpose, Stream};
use crate::trace::tally;

/// How the tracer is to be used.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct TracingOptions {
    /// Paths per pose in the first passes.
    pub paths: u64,
    /// Paths per pose beyond which no pass goes.
    pub paths_max: u64,
    /// Stop once the tracer's standard error (root mean square over the poses, as a share of the
    /// largest radiance) is below this; without it, once the tracer's line of the budget is small.
    pub target_error: Option<f64>,
}

impl TracingOptions {
    /// To a stated error, if there is one: who names an error wants it, whatever it takes.
    #[must_use]
    pub fn to_error(target_error: Option<f64>) -> Self {
        let default = TracingOptions::default();
        TracingOptions {
            target_error,
            paths_max: if target_error.is_some() {
                1 << 24
            } else {
                default.paths_max
            },
            ..default
        }
    }
}

impl Default for TracingOptions {
    fn default() -> Self {
        TracingOptions {
            paths: 4096,
            paths_max: 1 << 16,
            target_error: None,
        }
    }
}

/// Where a tracing stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TracingProgress {
    /// Passes begun.
    pub pass: usize,
    /// Paths traced so far.
    pub done: u64,
    /// Paths that are foreseen; grows where more passes are needed.
    pub planned: u64,
}

/// What a tracing may be told from outside: it goes on as long as the answer is true.
pub type Watch<'w> = &'w (dyn Fn(TracingProgress) -> bool + Sync);

/// Why a tracing ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TracingEnd {
    /// The parameters stay, and the error is as small as was asked for.
    Settled,
    /// The parameters stay, but the largest number of paths left more error than was asked for.
    MostPaths,
    /// The parameters still moved after the last pass that is allowed.
    MostPasses,
    /// The watcher said so.
    Stopped,
}

/// What the tracer did for an estimate.
#[derive(Debug, Clone, PartialEq)]
pub struct Tracing {
    /// Standard error of the traced radiances in the signals' unit, one per observation.
    pub sigma: Vec<f64>,
    /// How far the `sawtooth` estimate with its integrated second bounce lies from this one in each
    /// free parameter (solver's units): two full models of one sample that should agree. Where a measured
    /// profile makes them different samples, how far its measurement may move the ridge angle, and what it leaves open all
    /// of them, instead.
    pub apart: Vec<f64>,
    /// How far the last pass moved each free parameter (solver's units).
    pub last_step: Vec<f64>,
    /// Passes.
    pub passes: usize,
    /// Paths per pose in the last pass.
    pub paths: u64,
    /// Root mean square standard error as a share of the largest traced radiance.
    pub error: f64,
    /// Whether polarisation was followed: always on metal, elsewhere where the data say so.
    pub polarised: bool,
    /// Why it ended.
    pub end: TracingEnd,
}

/// The closed form's share of its peak below which the difference is added instead of the ratio.
const VANISHING: f64 = 0.02;
/// The tracer's line of the budget is small where it is at most this share of the combined
/// uncertainty: it adds 3 % to it.
const SMALL_SHARE: f64 = 0.25;
/// A parameter stays where a pass moves it by less than this share of its combined uncertainty.
const STILL: f64 = 0.05;
/// Passes at most.
const PASSES_MAX: usize = 10;
/// First passes, at the given number of paths, before the number that is needed is known.
const FIRST_PASSES: usize = 2;
/// Other surfaces that are traced at most.
const RIVALS_TRACED: usize = 6;
/// Smallest ridge angle that is traced, rad: below it the riser has no width in the numbers.
const FLATTEST: f64 = 1e-4;

/// Fits on from a `sawtooth` estimate with the tracer's corrections, on the ideal sawtooth or on the
/// shape of a given profile (its heights scaled so that its effective ridge angle is the
/// fitted one). `None` where it was cancelled or stopped before the first pass was done, or where a
/// radiance is not a number.
#[must_use]
pub fn estimate_traced<'a>(
    sawtooth: &Estimate<'a>,
    fit_options: &FitOptions,
    profile: Option<&Profile>,
    watch: Watch<'_>,
    cancel: &AtomicBool,
) -> Option<Estimate<'a>> {
    let options = &fit_options.tracer;
    let set = sawtooth.problem.set();
    let poses = set.observations.len() as u64;
    let metal = matches!(set.material, Material::Conductor { .. });
    let task = |polarised, done| Task {
        sawtooth,
        seed: u64::from(fit_options.seed),
        misfit: fit_options.misfit,
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
        settled: Settled {
            problem: sawtooth.problem.clone(),
            minimum: sawtooth.minimum.clone(),
            discrepancy: sawtooth.discrepancy,
        },
        reached: None,
        end: TracingEnd::MostPasses,
    };
    let mut run = first.clone();
    let mut main = task(true, 0);
    if !metal {
        // Renderers often leave polarisation out where light meets plastic, nature never does. The
        // same random numbers with and without show which it was.
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
    // What a shape leaves open is a limit of what is not known.
    let open = profile.and_then(Profile::alternative);
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

/// What stands between an observation and the model beside the parameters.
struct Scatter {
    /// Independent standard uncertainties: the observations' own and the tracer's.
    own: Vec<f64>,
    /// Scale on which the model may miss an observation.
    scale: Vec<f64>,
    /// What a robust loss left each observation in the closed form's fit.
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

    fn sigma(&self, discrepancy: f64) -> Vec<f64> {
        let parts = self.own.iter().zip(&self.scale).zip(&self.weights);
        parts
            .map(|((o, s), w)| o.hypot(discrepancy * s) / w.max(LEAST_WEIGHT).sqrt())
            .collect()
    }
}

/// A problem, its minimum, and the discrepancy that its weights stand on.
#[derive(Debug, Clone)]
struct Settled<'a> {
    problem: Problem<'a>,
    minimum: Minimum,
    discrepancy: f64,
}

impl<'a> Settled<'a> {
    /// Rounds of discrepancy, weights and refit.
    fn settle(&mut self, scatter: &Scatter, task: &Task<'_, '_>) {
        let (bounds, fitted) = (self.problem.bounds(), task.sawtooth.fitted);
        for _ in 0..ROUNDS {
            let next = if task.misfit {
                let residuals: Vec<f64> = self
                    .residuals()
                    .iter()
                    .zip(&scatter.weights)
                    .map(|(r, w)| r * w.sqrt())
                    .collect();
                let (own, scale) = (&scatter.own, &scatter.scale);
                discrepancy_of(&residuals, own, scale, fitted, Loss::Linear)
            } else {
                0.0
            };
            let settled = (next - self.discrepancy).abs() <= 1e-3 * next;
            self.discrepancy = next;
            self.problem = self.problem.clone().with_sigma(scatter.sigma(next));
            let from = self.minimum.parameters.clone();
            let settings = Settings::default();
            self.minimum = minimise(&self.problem, &from, &bounds, &settings, task.cancel);
            if settled || task.cancel.load(Ordering::Relaxed) {
                break;
            }
        }
    }

    /// Model less observation.
    fn residuals(&self) -> Vec<f64> {
        let values = self.problem.unpack(&self.minimum.parameters);
        let predicted = self.problem.predicted(&values);
        let pairs = predicted.iter().zip(&self.problem.set().observations);
        pairs.map(|(p, o)| p - o.signal).collect()
    }

    /// What it amounts to, beside what the closed form's estimate knows.
    fn estimate(&self, scatter: &Scatter, sawtooth: &Estimate<'a>) -> Estimate<'a> {
        let residuals = self.residuals();
        let squares = |weight: &dyn Fn(usize) -> f64| -> f64 {
            let each = residuals.iter().enumerate();
            each.map(|(i, r)| scatter.weights[i] * (r * weight(i)).powi(2))
                .sum()
        };
        let count = residuals.len();
        let freedom = freedom(count, sawtooth.fitted);
        let peak = peak(self.problem.set());
        Estimate {
            chi2_reduced_without_model: squares(&|i| 1.0 / scatter.own[i]) / freedom,
            rms_residual: (squares(&|_| 1.0 / peak) / count.max(1) as f64).sqrt(),
            misfit: scatter.scale.iter().map(|s| self.discrepancy * s).collect(),
            discrepancy: self.discrepancy,
            values: self.problem.unpack(&self.minimum.parameters),
            tier_shift: vec![0.0; self.minimum.parameters.len()],
            tier_undecided: false,
            minimum: self.minimum.clone(),
            problem: self.problem.clone(),
            ..sawtooth.clone()
        }
    }
}

/// Where the passes have come to.
#[derive(Clone)]
struct Run<'a> {
    settled: Settled<'a>,
    reached: Option<Estimate<'a>>,
    end: TracingEnd,
}

impl<'a> Run<'a> {
    /// Passes until the parameters stay and the error is small, or until pass number `last`. `None`
    /// where it was cancelled or a radiance is not a number.
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
            settled.settle(&scatter, task);
            if task.cancel.load(Ordering::Relaxed) {
                return None;
            }
            let moved = settled.minimum.parameters.iter().zip(&before);
            let mut estimate = settled.estimate(&scatter, task.sawtooth);
            estimate.traced = Some(Tracing {
                sigma: traced.sigma,
                apart: match task.profile {
                    // The budget takes what lies apart as a limit, of which √⅓ is the standard uncertainty.
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
                last_step: moved.map(|(a, b)| a - b).collect(),
                passes: task.pass,
                paths: task.paths,
                error: traced.error,
                polarised: task.polarised,
                end: self.end,
            });
            let u = uncertainty(&estimate);
            let still = is_still(&estimate, &u);
            // By how much the error is too large.
            let excess = match options.target_error {
                Some(target) => traced.error / target,
                None => excess(&estimate, &u),
            };
            self.reached = Some(estimate);
            let most = task.paths >= options.paths_max;
            if still && (excess <= 1.0 || most) {
                self.end = if excess <= 1.0 {
                    TracingEnd::Settled
                } else {
                    TracingEnd::MostPaths
                };
                break;
            }
            if excess > 1.0 && !most && (still || task.pass >= FIRST_PASSES) {
                // The error falls with the root of the paths at least; a fifth more is sure to do.
                let needed = task.paths as f64 * 1.2 * excess * excess;
                let needed = if needed < options.paths_max as f64 {
                    needed as u64
                } else {
                    options.paths_max
                };
                task.paths = needed.max(2 * task.paths).min(options.paths_max);
            }
            let next = if task.pass < FIRST_PASSES { 2 } else { 1 };
            task.planned = task.planned.max(task.done() + next * task.paths * poses);
        }
        Some(())
    }
}

impl<'a> Run<'a> {
    /// How far each free parameter moves (solver's units) where the sample has another shape, by one more pass there;
    /// `None` where it was stopped.
    fn moved_on<'t>(&self, task: &mut Task<'t, 'a>, other: &'t Profile) -> Option<Vec<f64>> {
        task.profile = Some(other);
        let Settled {
            problem, minimum, ..
        } = &self.settled;
        let at = &minimum.parameters;
        let Outcome::Traced(traced) = task.trace(problem, &problem.unpack(at)) else {
            return None;
        };
        let there = problem.clone().with_factor(traced.factor);
        let there = there.with_correction(traced.added);
        let settings = Settings::default();
        let moved = minimise(&there, at, &there.bounds(), &settings, task.cancel);
        let steps = moved.parameters.iter().zip(at);
        Some(steps.map(|(a, b)| a - b).collect())
    }
}

/// Deviation that is of no use to anybody to go below, in the solver's units; `None` for what is no
/// result of its own.
fn useless(quantity: Quantity, values: &Values) -> Option<f64> {
    match quantity {
        Quantity::ThetaR | Quantity::AzimuthOffset | Quantity::TiltOffset => {
            Some(0.008f64.to_radians())
        }
        Quantity::AlphaU | Quantity::AlphaV => Some(0.002),
        Quantity::RhoD => Some(0.002 * values.rho_d),
        Quantity::Translucency | Quantity::Tail => Some(0.005),
        Quantity::CrestRadius => Some(0.002),
        Quantity::Scale | Quantity::Background | Quantity::Eta | Quantity::K => None,
    }
}

/// Whether the last pass moved no parameter by more than a small share of its uncertainty.
fn is_still(estimate: &Estimate<'_>, u: &Uncertainty) -> bool {
    let steps = estimate.traced.iter().flat_map(|t| &t.last_step);
    let free = estimate.problem.free();
    steps.zip(&u.budgets).zip(free).all(|((step, budget), q)| {
        useless(*q, &estimate.values)
            .is_none_or(|useless| step.abs() <= useless.max(STILL * budget.combined()))
    })
}

/// The tracer's line over what it may be, in the worst parameter's budget.
fn excess(estimate: &Estimate<'_>, u: &Uncertainty) -> f64 {
    let free = estimate.problem.free();
    let over = u.budgets.iter().zip(free).filter_map(|(budget, q)| {
        let useless = useless(*q, &estimate.values)?;
        Some(budget.tracer / useless.max(SMALL_SHARE * budget.combined()))
    });
    over.filter(|x| x.is_finite()).fold(0.0, f64::max)
}

struct Task<'a, 's> {
    sawtooth: &'a Estimate<'s>,
    seed: u64,
    misfit: bool,
    profile: Option<&'a Profile>,
    watch: Watch<'a>,
    cancel: &'a AtomicBool,
    polarised: bool,
    paths: u64,
    pass: usize,
    done: Mutex<u64>,
    planned: u64,
}

struct Traced {
    factor: Vec<f64>,
    added: Vec<f64>,
    sigma: Vec<f64>,
    error: f64,
}

enum Outcome {
    Traced(Traced),
    Stopped,
    NotFinite,
}

impl Task<'_, '_> {
    /// Of the other surfaces that the closed form does not tell from its best one: those that the tracer does not either, each
    /// traced at its own place.
    fn not_refuted(&mut self, best: &Estimate<'_>) -> Vec<Minimum> {
        let sawtooth = self.sawtooth;
        let rivals = &sawtooth.rivals[..sawtooth.rivals.len().min(RIVALS_TRACED)];
        let poses = sawtooth.problem.set().observations.len() as u64;
        self.planned = self.done() + rivals.len() as u64 * self.paths * poses;
        let freedom = freedom(poses as usize, sawtooth.fitted);
        let dispersion = best.chi2_reduced_without_model.max(1.0);
        let stands = |rival: &Minimum| {
            let values = sawtooth.problem.unpack(&rival.parameters);
            let Outcome::Traced(traced) = self.trace(&sawtooth.problem, &values) else {
                return Some(rival.clone());
            };
            let scatter = Scatter::new(sawtooth, &traced.sigma);
            let problem = sawtooth.problem.clone().with_factor(traced.factor);
            let mut there = Settled {
                problem: problem.with_correction(traced.added),
                minimum: rival.clone(),
                discrepancy: best.discrepancy,
            };
            there.settle(&scatter, self);
            let chi2 = there
                .estimate(&scatter, sawtooth)
                .chi2_reduced_without_model;
            let rise = (chi2 - best.chi2_reduced_without_model) * freedom / dispersion;
            (rise < AMBIGUOUS_RISE).then_some(there.minimum)
        };
        rivals.iter().filter_map(stands).collect()
    }

    /// Paths so far.
    fn done(&self) -> u64 {
        *self.done.lock().expect("no holder of this lock panics")
    }

    /// Traces every pose at `values` and compares with the closed form there.
    fn trace(&self, problem: &Problem<'_>, values: &Values) -> Outcome {
        let set = problem.set();
        let count = set.observations.len();
        let ready = problem.ready(values);
        let Some(surface) = ridged_surface(set, values, self.profile) else {
            return Outcome::NotFinite;
        };
        let stopped = AtomicBool::new(false);
        let found: Vec<Option<tally::Estimate>> = (0..count)
            .into_par_iter()
            .map(|i| {
                if stopped.load(Ordering::Relaxed) || self.cancel.load(Ordering::Relaxed) {
                    return None;
                }
                let options = RadianceOptions {
                    paths: self.paths,
                    seed: Stream::new(self.seed, Purpose::Batch, i as u64).bits(),
                    cones: set.rig.cones,
                    polarised: self.polarised,
                };
                let radiance = surface.radiance(&problem.directions(i, &ready).0, &options);
                let mut done = self.done.lock().expect("no holder of this lock panics");
                *done += self.paths;
                let goes_on = (self.watch)(TracingProgress {
                    pass: self.pass,
                    done: *done,
                    planned: self.planned.max(*done),
                });
                drop(done);
                if !goes_on {
                    stopped.store(true, Ordering::Relaxed);
                }
                Some(radiance)
            })
            .collect();
        let Some(found) = found.into_iter().collect::<Option<Vec<_>>>() else {
            return Outcome::Stopped;
        };
        // Of a near rig both are taken at the centre of its views: the ratio is smooth over them.
        let closed: Vec<f64> = (0..count).map(|i| problem.at_centre(i, &ready)).collect();
        let brightest = closed.iter().copied().fold(0.0, f64::max);
        let mut traced = Traced {
            factor: vec![1.0; count],
            added: vec![0.0; count],
            sigma: vec![0.0; count],
            error: 0.0,
        };
        let mut largest = 0.0f64;
        for (i, (t, c)) in found.iter().zip(&closed).enumerate() {
            if !(t.value.is_finite() && t.std.is_finite() && c.is_finite()) {
                return Outcome::NotFinite;
            }
            if *c > VANISHING * brightest {
                traced.factor[i] = t.value / c;
                let averaged = problem.gradient(i, &ready).value;
                traced.sigma[i] = values.scale * averaged * t.std / c;
            } else {
                traced.added[i] = t.value - c;
                traced.sigma[i] = values.scale * t.std;
            }
            largest = largest.max(t.value);
            traced.error += t.std * t.std;
        }
        traced.error = (traced.error / count.max(1) as f64).sqrt() / largest.max(f64::MIN_POSITIVE);
        Outcome::Traced(traced)
    }
}

/// The sample that the tracer sees for given values; `None` where a profile cannot have that angle.
#[must_use]
pub fn ridged_surface(
    set: &ObservationSet,
    values: &Values,
    profile: Option<&Profile>,
) -> Option<RidgedSurface> {
    let theta_r = values.theta_r.abs().max(FLATTEST);
    let cos_l = set.rig.theta_l.rad().cos();
    let dielectric = matches!(set.material, Material::Dielectric { .. });
    let body = Diffuse::new(values.rho_d, values.eta, 1.0, cos_l)
        .with_translucency(values.real.translucency);
    let profile = match profile {
        Some(profile) => profile.with_ridge_angle(theta_r)?,
        None => Profile::rounded(theta_r, 1.0, [values.real.crest, 0.0]).ok()?,
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
