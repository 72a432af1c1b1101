//! Intervals without the linear approximation: profile likelihood and parametric bootstrap.
//!
//! *Profile*: a parameter is moved away from its best value and all others are fitted again until the cost has risen by
//! the square of the coverage factor (Venzon and Moolgavkar 1988). The interval follows curved valleys and is open
//! where no value can be excluded. *Bootstrap*: series are drawn from the fitted model with the uncertainties of the
//! observations, and fitted. Both cover only the independent errors (counting and scatter of the model), not the shared
//! sources of the budget.
//!
//! Calls: [`profile`] and [`bootstrap`]. Values are in the units of the solver.

use std::sync::atomic::{AtomicBool, Ordering};

use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rayon::prelude::*;

use crate::fit::least_squares::levenberg_marquardt::{Bounds, Minimum, Settings};
use crate::fit::problem::Problem;
use crate::fit::subsample::minimise;

/// An interval whose ends may be open.
#[derive(Debug, Clone, PartialEq)]
pub struct Profile {
    /// Lower end; `None` if no value down to the bound of the parameter is excluded.
    pub lower: Option<f64>,
    /// Upper end.
    pub upper: Option<f64>,
    /// A point found on the way with a lower cost than the assumed minimum.
    pub better: Option<Minimum>,
}

/// Refits per side before an end counts as open.
const REFITS: u32 = 24;
/// Relative tolerance for √(rise).
const CLOSE: f64 = 2e-3;

/// Finds the interval of free parameter `j` within which the refitted cost is less than `rise` above that of `minimum`.
/// `guess` is a first estimate of its half width.
#[must_use]
pub fn profile(
    problem: &Problem<'_>,
    minimum: &Minimum,
    j: usize,
    guess: f64,
    rise: f64,
    cancel: &AtomicBool,
) -> Profile {
    let bounds = problem.bounds();
    let mut better: Option<Minimum> = None;
    let mut side = |sign: f64| -> Option<f64> {
        let limit = if sign < 0.0 {
            bounds.lower[j]
        } else {
            bounds.upper[j]
        };
        let best = minimum.parameters[j];
        let mut along = Walk {
            problem,
            bounds: &bounds,
            j,
            last: minimum.parameters.clone(),
            cancel,
        };
        let target = rise.sqrt();
        let (mut inside, mut depth) = (best, 0.0);
        let mut outside: Option<(f64, f64)> = None;
        let mut step = guess.abs();
        if !(step.is_finite() && step > 0.0) {
            step = 1e-2 * best.abs().max(1e-2);
        }
        for _ in 0..REFITS {
            let x = match outside {
                None => (inside + sign * step).clamp(bounds.lower[j], bounds.upper[j]),
                // √rise grows nearly in proportion to the distance; the ends are avoided.
                Some((far, high)) => {
                    let share = ((target - depth) / (high - depth)).clamp(0.1, 0.9);
                    inside + share * (far - inside)
                }
            };
            let refitted = along.to(x);
            let gain = refitted.cost - minimum.cost;
            if gain < -1e-6 * minimum.cost.max(1.0)
                && better.as_ref().is_none_or(|b| refitted.cost < b.cost)
            {
                better = Some(refitted.clone());
            }
            let height = gain.max(0.0).sqrt();
            if (height - target).abs() <= CLOSE * target {
                return Some(x);
            }
            // Both ends of a step: a discontinuity of the model within rounding.
            if let Some((far, _)) = outside
                && (far - inside).abs() <= 1e-12 * far.abs()
            {
                return Some(x);
            }
            if height < target && refitted.cost.is_finite() {
                let slope = (height - depth) / (x - inside).abs();
                along.last = refitted.parameters;
                (inside, depth) = (x, height);
                if outside.is_none() {
                    if x == limit {
                        return None;
                    }
                    let reach = (target - height) / slope * 1.02;
                    step = if reach.is_finite() {
                        reach.clamp(0.2 * step, 4.0 * step)
                    } else {
                        4.0 * step
                    };
                }
            } else {
                let height = if refitted.cost.is_finite() {
                    height
                } else {
                    2.0 * target
                };
                outside = Some((x, height));
            }
            if cancel.load(Ordering::Relaxed) {
                return None;
            }
        }
        // The target was never passed: open. Between two values the outer one is safe.
        outside.map(|(far, _)| far)
    };
    let (lower, upper) = (side(-1.0), side(1.0));
    Profile {
        lower,
        upper,
        better,
    }
}

/// Refits with one parameter held, each from the end of the last one.
struct Walk<'p> {
    problem: &'p Problem<'p>,
    bounds: &'p Bounds,
    j: usize,
    last: Vec<f64>,
    cancel: &'p AtomicBool,
}

impl Walk<'_> {
    fn to(&mut self, x: f64) -> Minimum {
        let mut bounds = self.bounds.clone();
        // Held by its bounds, so that its prior, if any, still counts.
        bounds.lower[self.j] = x;
        bounds.upper[self.j] = x;
        let mut start = self.last.clone();
        start[self.j] = x;
        minimise(self.problem, &start, &bounds, &Settings::REFIT, self.cancel)
    }
}

/// Returns the parameters of `count` series drawn from the model at `minimum`, one row per refit that reached a
/// minimum. Reproducible for a seed while `enough` returns false.
#[must_use]
pub fn bootstrap(
    problem: &Problem<'_>,
    minimum: &Minimum,
    count: u32,
    seed: u32,
    enough: &(dyn Fn() -> bool + Sync),
    cancel: &AtomicBool,
) -> Vec<Vec<f64>> {
    let values = problem.unpack(&minimum.parameters);
    let predicted = problem.predicted(&values);
    (0..count)
        .into_par_iter()
        .filter_map(|k| {
            if cancel.load(Ordering::Relaxed) || enough() {
                return None;
            }
            let stream = (u64::from(seed) << 32) | u64::from(k);
            let mut draw = rand_pcg::Pcg64::seed_from_u64(stream);
            let mut normal = || -> f64 { draw.sample(StandardNormal) };
            let mut set = problem.set().clone();
            for ((o, p), s) in set
                .observations
                .iter_mut()
                .zip(&predicted)
                .zip(problem.sigma())
            {
                o.signal = p + s * normal();
            }
            for (index, s) in problem.flat_sigma().iter().enumerate() {
                set.flats[index].signal = problem.flat_signal(index, &values) + s * normal();
            }
            let drawn = problem.drawn(&set, &values, &mut normal);
            let m = drawn.descend(&minimum.parameters, &Settings::REFIT, cancel);
            m.ending.is_success().then_some(m.parameters)
        })
        .collect()
}

/// Returns the ends of the central `coverage` share of a sample, by linear interpolation between order statistics;
/// `None` for fewer than 20 values.
#[must_use]
pub fn central(mut sample: Vec<f64>, coverage: f64) -> Option<(f64, f64)> {
    if sample.len() < 20 {
        return None;
    }
    sample.sort_by(f64::total_cmp);
    let at = |share: f64| {
        let place = share * (sample.len() - 1) as f64;
        let below = place.floor() as usize;
        let above = (below + 1).min(sample.len() - 1);
        sample[below] + (place - below as f64) * (sample[above] - sample[below])
    };
    let tail = 0.5 * (1.0 - coverage);
    Some((at(tail), at(1.0 - tail)))
}
