//! Searches for the deepest minimum: a multistart with a Bayesian stopping rule.
//!
//! [`Search::quick`] descends from a few starts that the bright spot suggests, which finds the lobe if the poses see
//! it. [`Search::multistart`] confirms it: starts of a Sobol sequence in the whole box descend as lanes of registers.
//! Ends beside each other lead to the same minimum (single linkage; Rinnooy Kan and Timmer 1987), and the different ones
//! are refined. Rounds follow until no further minimum is expected (Boender and Rinnooy Kan 1987) and several starts
//! have reached the best one.
//! [`Search::images`] adds the mirror images of the best end, and [`Search::follow_valley`] continues it along a valley.
//!
//! If a model error blurs the minima, the rounds begin with the starts of the bright spot, and the rule alone decides. If
//! noise alone separates them, the first round is large ([`Tuning::first_round`]).

pub(super) mod batched_lm;
pub(super) mod lane_form;
mod rounds;
pub(super) mod sobol_starts;
pub mod starts;
pub mod tuning;
pub(super) mod variable_projection;

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use super::estimate::StartReport;
use super::least_squares::minimum::{Ending, Minimum, Settings};
use super::problem::{Problem, Values};
use super::quantity::Quantity;
use super::uncertainty::covariance::covariance;
use starts::{APART, ONE_SURFACE, SAME_SPOT, distance, starts};
use tuning::Tuning;

/// Relative difference in cost below which two ends are the same minimum.
const SAME_COST: f64 = 1e-6;
/// Number of different ends that are carried over to another problem.
const REFINED: usize = 5;
/// Standard uncertainty of an angle (rad) or a ln α above which the surface counts as undetermined.
const OPEN: f64 = 0.1;
/// Rise of the cost up to which a minimum is as good as the best one: the square of the coverage factor of the report.
pub(super) const AMBIGUOUS_RISE: f64 = 4.0;
/// Number of near minima that are kept.
pub(super) const RIVALS: usize = 8;

/// Returns the best minimum from given starts and their outcomes; `None` if no start has a finite cost.
#[must_use]
pub fn from_starts(
    problem: &Problem<'_>,
    starts: &[Values],
    cancel: &AtomicBool,
) -> Option<(Minimum, StartReport)> {
    let mut search = Search::new(starts.first()?, 0, Tuning::DEFAULT, cancel);
    search.descend_from(problem, problem, starts, false);
    let report = search.report();
    search.best().cloned().map(|best| (best, report))
}

/// Whether the caller's time limit has passed.
pub type Late<'l> = &'l (dyn Fn() -> bool + Sync);

/// A search in progress. All ends belong to the same problem.
pub(super) struct Search<'p> {
    fallback: &'p Values,
    cancel: &'p AtomicBool,
    seed: u32,
    tuning: Tuning,
    runs: Vec<Minimum>,
    late: Late<'p>,
    /// Whether the time limit ended some of the search.
    cut_short: AtomicBool,
    /// Whether no more starts are allowed.
    started: bool,
}

impl<'p> Search<'p> {
    pub(super) fn new(
        fallback: &'p Values,
        seed: u32,
        tuning: Tuning,
        cancel: &'p AtomicBool,
    ) -> Self {
        Search {
            fallback,
            cancel,
            seed,
            tuning,
            runs: Vec::new(),
            late: &|| false,
            cut_short: AtomicBool::new(false),
            started: false,
        }
    }

    /// Ends the supply of starts: the search then only uses the ends that it has.
    pub(super) fn has_all_starts(&mut self) {
        self.started = true;
    }

    /// Sets the time limit. What was found until then counts.
    pub(super) fn until(mut self, late: Late<'p>) -> Self {
        self.late = late;
        self
    }

    fn next_seed(&mut self) -> u32 {
        let seed = self.seed;
        self.seed = seed.wrapping_add(1);
        seed
    }

    /// Descends from `count` starts that the bright spot suggests and refines their different ends, whatever the time limit.
    pub(super) fn quick(&mut self, problem: &Problem<'_>, count: usize) {
        let nominal = problem.with_nominal_index();
        let found = starts(&nominal, self.fallback, count, self.next_seed());
        self.descend_from(problem, &nominal, &found, false);
    }

    /// Continues the different ones of some ends on `from` to their minima on `to`, and counts every end at the minimum of
    /// the one that it resembles: at the same spot, or at its cost, to a relative difference `near`. Only the `most` deepest
    /// of the different ones could still win. After the time limit only the best of them is continued.
    fn refine(
        &mut self,
        from: &Problem<'_>,
        to: &Problem<'_>,
        mut ends: Vec<Minimum>,
        most: usize,
        near: f64,
    ) {
        for end in &mut ends {
            end.parameters = to.pack(&from.unpack(&end.parameters));
        }
        ends.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let mut different: Vec<(&Minimum, Values)> = Vec::new();
        let mut leads_to: Vec<Option<usize>> = Vec::new();
        for end in &ends {
            let here = to.unpack(&end.parameters).folded();
            let known = different.iter().position(|(other, there)| {
                end.cost <= other.cost * (1.0 + near) + near || distance(&here, there) < SAME_SPOT
            });
            let new = || {
                (different.len() < most).then(|| {
                    different.push((end, here));
                    different.len() - 1
                })
            };
            leads_to.push(match end.cost.is_finite() {
                true => known.or_else(new),
                false => None,
            });
        }
        let minimum = |(k, (end, _)): (usize, &(&Minimum, Values))| {
            // What is known already is not repeated.
            let is_there = |m: &&Minimum| m.ending.is_success() && is_at(end.cost, m.cost);
            match self.runs.iter().find(is_there) {
                Some(known) => Some(in_short(known)),
                None if k > 0 && self.over() => None,
                None => Some(to.descend(&end.parameters, &Settings::FINE, self.cancel)),
            }
        };
        let minima = different.par_iter().enumerate().map(minimum);
        let mut minima: Vec<Option<Minimum>> = minima.collect();
        for (end, to) in ends.into_iter().zip(leads_to) {
            let found = to.and_then(|k| {
                let others = minima[k].as_ref().map(in_short);
                std::mem::replace(&mut minima[k], others)
            });
            self.runs.push(found.unwrap_or(Minimum {
                cost: f64::INFINITY,
                ending: Ending::MaxIterations,
                ..end
            }));
        }
    }

    /// Returns different ends within `rise` of the best cost, without the best one. Two surfaces may have the same cost
    /// to the last digit (mirror images on a symmetric scan). If the data leave the surface undetermined, ends of equal
    /// cost belong to one valley; this is decided `at` a minimum with its weights.
    pub(super) fn rivals(&self, problem: &Problem<'_>, at: &Minimum, rise: f64) -> Vec<Minimum> {
        let Some(best) = self.best() else {
            return Vec::new();
        };
        let twins = determined(problem, at);
        let surface = |m: &Minimum| problem.unpack(&m.parameters).folded();
        let mut near: Vec<&Minimum> = self
            .runs
            .iter()
            .filter(|m| usable(m) && m.cost <= best.cost + rise)
            .collect();
        near.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let mut known = vec![(best.cost, surface(best))];
        let mut chosen: Vec<Minimum> = Vec::new();
        for m in near {
            if chosen.len() == RIVALS {
                break;
            }
            let here = surface(m);
            let is_known = |(cost, other): &(f64, Values)| {
                same(m.cost, *cost) && (!twins || distance(&here, other) < ONE_SURFACE)
            };
            if !known.iter().any(is_known) {
                known.push((m.cost, here));
                chosen.push(m.clone());
            }
        }
        chosen
    }

    /// Continues from a settled end with its weights and returns the best end; `None` if no more starts are allowed.
    pub(super) fn continue_with(
        &mut self,
        problem: &Problem<'_>,
        settled: &Minimum,
    ) -> Option<Minimum> {
        if self.started || self.over() {
            return None;
        }
        self.carry_over(problem, problem);
        self.runs.push(settled.clone());
        self.multistart(problem, 0, self.tuning.first_round as u32);
        self.images(problem);
        self.follow_valley(problem);
        self.best().cloned()
    }

    /// Searches with other weights and returns the different ends, best first.
    pub(super) fn look_again(&mut self, problem: &Problem<'_>, around: &Minimum) -> Vec<Minimum> {
        if self.started {
            return Vec::new();
        }
        let before = std::mem::replace(&mut self.runs, vec![around.clone()]);
        self.multistart(problem, 0, self.tuning.first_round as u32);
        let found = self.distinct(problem, &around.parameters, RIVALS);
        self.runs = before;
        found
    }

    /// Returns up to `count` ends of surfaces other than that at `known`, best first, at any cost.
    pub(super) fn distinct(
        &self,
        problem: &Problem<'_>,
        known: &[f64],
        count: usize,
    ) -> Vec<Minimum> {
        let mut ends: Vec<&Minimum> = self.runs.iter().filter(|m| usable(m)).collect();
        ends.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let surface = |x: &[f64]| problem.unpack(x).folded();
        let mut seen = vec![surface(known)];
        let mut chosen = Vec::new();
        for end in ends {
            let here = surface(&end.parameters);
            if chosen.len() < count && seen.iter().all(|s| distance(s, &here) > APART) {
                seen.push(here);
                chosen.push(end.clone());
            }
        }
        chosen
    }

    /// Refines the different ends on a problem with other weights or more free parameters; their counts stay.
    pub(super) fn carry_over(&mut self, from: &Problem<'_>, to: &Problem<'_>) {
        let runs = std::mem::take(&mut self.runs);
        self.refine(from, to, runs, REFINED, SAME_COST);
    }

    /// Best end so far.
    pub(super) fn best(&self) -> Option<&Minimum> {
        self.runs
            .iter()
            .filter(|m| usable(m))
            .min_by(|a, b| a.cost.total_cmp(&b.cost))
    }

    /// Whether the next step must not begin: cancelled, or after the time limit, which is recorded.
    pub(super) fn over(&self) -> bool {
        let late = (self.late)();
        if late {
            self.cut_short.store(true, Ordering::Relaxed);
        }
        late || self.cancel.load(Ordering::Relaxed)
    }

    /// Whether the time limit ended some of the search.
    pub(super) fn is_cut_short(&self) -> bool {
        self.cut_short.load(Ordering::Relaxed)
    }

    /// Number of starts that have reached the best minimum.
    fn at_minimum(&self) -> usize {
        let best = self.best().map_or(f64::INFINITY, |m| m.cost);
        self.runs.iter().filter(|m| same(m.cost, best)).count()
    }

    /// Summarises the outcomes of the starts.
    pub(super) fn report(&self) -> StartReport {
        let best = self.best().map_or(f64::INFINITY, |m| m.cost);
        let at_minimum = self.at_minimum();
        let elsewhere = self
            .runs
            .iter()
            .filter(|m| !same(m.cost, best) && m.ending.is_success())
            .count();
        StartReport {
            tried: self.runs.len(),
            at_minimum,
            elsewhere,
            not_converged: self.runs.len() - at_minimum - elsewhere,
        }
    }
}

/// The end of another start at a minimum whose residuals and derivatives are stored already.
fn in_short(m: &Minimum) -> Minimum {
    Minimum {
        residuals: Vec::new(),
        jacobian: Vec::new(),
        parameters: m.parameters.clone(),
        at_bound: m.at_bound.clone(),
        ..*m
    }
}

/// Whether the data determine the surface near an end.
pub(super) fn determined(problem: &Problem<'_>, end: &Minimum) -> bool {
    let rows = problem.residual_count();
    if end.jacobian.len() != rows * problem.free().len() {
        return false;
    }
    let known = covariance(&end.jacobian, rows, &end.residuals);
    let std = known.standard_deviations();
    problem.free().iter().zip(std).all(|(quantity, std)| {
        let counts = matches!(
            quantity,
            Quantity::ThetaR
                | Quantity::AlphaU
                | Quantity::AlphaV
                | Quantity::AzimuthOffset
                | Quantity::TiltOffset
        );
        !counts || std < OPEN
    })
}

pub(super) fn usable(m: &Minimum) -> bool {
    m.cost.is_finite() && m.ending != Ending::NotFinite
}

/// Whether two costs are those of one minimum.
fn is_at(cost: f64, minimum: f64) -> bool {
    (cost - minimum).abs() <= SAME_COST * minimum.max(1.0)
}

/// Whether a cost equals that of the best end, or is lower.
pub(super) fn same(cost: f64, best: f64) -> bool {
    cost <= best + SAME_COST * best.max(1.0)
}
