//! One tracing: every pose at given values, and the surfaces that it does not exclude.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use super::{
    FIRST_PASSES, Scatter, TracingOptions, TracingProgress, Watch, WeightedFit, ridged_surface,
};
use crate::fit::FitOptions;
use crate::fit::estimate::Estimate;
use crate::fit::least_squares::levenberg_marquardt::{Minimum, Settings};
use crate::fit::model_discrepancy::freedom;
use crate::fit::multistart::AMBIGUOUS_RISE;
use crate::fit::problem::{Problem, Values};
use crate::trace::counting::tally;
use crate::trace::pose_radiance::RadianceOptions;
use crate::trace::rng::{Purpose, RandomStream};
use crate::trace::surfaces::surface_profile::SurfaceProfile;

/// Share of the peak below which the difference to the closed form is added instead of the ratio.
const VANISHING: f64 = 0.02;
/// Maximum number of other surfaces that are traced.
const RIVALS_TRACED: usize = 6;

pub(super) struct Task<'a, 's> {
    pub(super) sawtooth: &'a Estimate<'s>,
    pub(super) fit_options: &'a FitOptions,
    pub(super) profile: Option<&'a SurfaceProfile>,
    pub(super) watch: Watch<'a>,
    pub(super) cancel: &'a AtomicBool,
    pub(super) polarised: bool,
    pub(super) paths: u64,
    pub(super) pass: usize,
    pub(super) done: Mutex<u64>,
    pub(super) planned: u64,
}

pub(super) struct Traced {
    pub(super) factor: Vec<f64>,
    pub(super) added: Vec<f64>,
    pub(super) sigma: Vec<f64>,
    pub(super) error: f64,
}

pub(super) enum Outcome {
    Traced(Traced),
    Stopped,
    NotFinite,
}

impl Task<'_, '_> {
    /// Returns the other surfaces that neither the closed form nor the tracer excludes, each traced at its own
    /// parameters.
    pub(super) fn not_refuted(&mut self, best: &Estimate<'_>) -> Vec<Minimum> {
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
            let mut there = WeightedFit {
                problem: problem.with_correction(traced.added),
                minimum: rival.clone(),
                discrepancy: best.discrepancy,
            };
            there.rounds(&Settings::NEAR, &scatter.weighing(self));
            let chi2 = scatter
                .estimate(&there, sawtooth)
                .chi2_reduced_without_model;
            let rise = (chi2 - best.chi2_reduced_without_model) * freedom / dispersion;
            (rise < AMBIGUOUS_RISE).then_some(there.minimum)
        };
        rivals.iter().filter_map(stands).collect()
    }

    /// Increases the number of paths after the first passes if the error was `excess` times too large.
    pub(super) fn raise_paths(&mut self, excess: f64, options: &TracingOptions) {
        let most = options.paths_max;
        if excess > 1.0 && self.paths < most && self.pass >= FIRST_PASSES {
            // The error falls at least with the square root of the paths; a fifth more paths are certain to suffice.
            let needed = (self.paths as f64 * 1.2 * excess * excess).min(most as f64) as u64;
            self.paths = needed.max(2 * self.paths).min(most);
        }
    }

    /// Paths so far.
    pub(super) fn done(&self) -> u64 {
        *self.done.lock().expect("no holder of this lock panics")
    }

    /// Traces every pose at `values` and compares it with the closed form there.
    pub(super) fn trace(&self, problem: &Problem<'_>, values: &Values) -> Outcome {
        let set = problem.set();
        let count = set.observations.len();
        let ready = problem.ready(values);
        let Some(surface) = ridged_surface(set, values, self.profile) else {
            return Outcome::NotFinite;
        };
        let stopped = AtomicBool::new(false);
        let found: Vec<Option<tally::MonteCarloEstimate>> = (0..count)
            .into_par_iter()
            .map(|i| {
                if stopped.load(Ordering::Relaxed) || self.cancel.load(Ordering::Relaxed) {
                    return None;
                }
                let options = RadianceOptions {
                    paths: self.paths,
                    seed: RandomStream::new(
                        u64::from(self.fit_options.seed),
                        Purpose::Batch,
                        i as u64,
                    )
                    .bits(),
                    cones: set.rig.cones,
                    polarised: self.polarised,
                };
                let radiance = surface.radiance(&problem.directions(i, &ready), &options);
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
        // For a near rig both are taken at the centre of its views, because the ratio is smooth over them.
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
