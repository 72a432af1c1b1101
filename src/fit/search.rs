//! Searches from many starts for the few minima that count.
//!
//! There are three kinds of search. [`Search::quick`] runs a few starts with broad weights and the lean form and
//! refines the different ends, which is enough if the poses see the lobe. If that leaves a doubt, [`Search::glance`]
//! descends from very many starts with the full form, vectorised in lanes. [`Search::thorough`] is for the cases that
//! remain unexplained (narrow lobes that few poses meet, steep ridges, tilts that are wrong by many degrees). It takes
//! candidates from the whole box and judges them. It descends from some of them first on a logarithmic scale, on which
//! a lobe is a paraboloid at any distance from its top, and then with the final weights.

mod rounds;

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

pub(super) use self::rounds::{REFINED_IN_ROUND, descend, descended_in_round};
use super::FitOptions;
use super::candidates::{self, Wanted};
use super::covariance::{Scaling, covariance};
use super::crew::{self, End, descend_together};
use super::problem::{Problem, Values};
use super::projection::Projected;
use super::quantity::Quantity;
use super::settle::Settled;
use super::solver::{Ending, Minimum, Settings, minimise};
use super::start::{distance, starts};
use crate::model::lanes::WIDEST;

/// Relative difference in cost below which two ends are the same minimum.
const SAME: f64 = 1e-6;
/// Number of different ends of the first round that are refined.
pub(super) const REFINED: usize = 4;
/// Relative difference in cost between neighbouring ends that lead to the same minimum.
const NEAR: f64 = 1e-4;
/// Evaluations of a lane that continues from the end of another one.
const EVALUATIONS_ON: usize = 240;
/// Distance above which ends count as different surfaces (see [`distance`]).
const APART: f64 = 0.3;
/// Distance below which two rough ends lead to the same minimum (see [`distance`]).
const SAME_SPOT: f64 = 0.05;
/// Smallest distance between two surfaces that a report distinguishes: 0.05°, 0.7 % of α (see [`distance`]).
pub(super) const ONE_SURFACE: f64 = 0.01;
/// Number of different ends of a thorough round that are refined.
pub(super) const REFINED_THOROUGHLY: usize = 12;
/// Number of ends whose valleys are followed.
pub(super) const FOLLOWED: usize = 4;
/// Number of other roughnesses tried for an end.
pub(super) const OTHER_ROUGHNESSES: usize = 3;
/// Settings of a descent that only has to come near a minimum; `FINE` is for descents to full accuracy.
pub(super) const ROUGH: Settings = Settings {
    polish_steps: 0,
    cost_tolerance: 1e-5,
    max_iterations: 40,
    ..Settings::DEFAULT
};
/// The same from a distant start.
const PATIENT: Settings = Settings {
    max_iterations: 200,
    ..ROUGH
};
pub(super) const FINE: Settings = Settings {
    polish_steps: 20,
    max_iterations: 400,
    ..Settings::DEFAULT
};
/// Number of successive rounds without a deeper minimum after which the search ends.
pub(super) const CALM: usize = 5;
/// One in this many of those rounds also tries promising starts.
pub(super) const PROMISING_EVERY: usize = 4;
/// Standard uncertainty of an angle (rad) or a ln α above which the surface counts as undetermined.
const OPEN: f64 = 0.1;
/// Effective number of observations up to which one observation alone determines the place of a lobe.
const ONE_OBSERVATION: f64 = 1.5;
/// Signals are faint if a constant fits them with a χ² below this.
const FAINT: f64 = 400.0;
/// Rise of the cost up to which a minimum is as good as the best one: the square of the coverage factor of the report.
pub(super) const AMBIGUOUS_RISE: f64 = 4.0;
/// Number of near minima that are kept.
pub(super) const RIVALS: usize = 8;

/// Extent of a thorough round.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Effort {
    /// Promising shapes whose roughnesses are scanned.
    pub scanned: usize,
    /// Candidates that are descended: smallest number, largest number, and in `worth` the number of residuals that they
    /// have together in between.
    pub descended: (usize, usize),
    pub worth: usize,
    /// Different ends whose roughnesses are scanned again.
    pub rescanned: usize,
}

impl Effort {
    /// Noise alone separates the minima, so the deepest of many counts.
    pub(super) const NOISE: Self = Effort {
        scanned: 48,
        descended: (32, 256),
        worth: 6000,
        rescanned: 4,
    };
    /// The model error exceeds the differences between near minima.
    pub(super) const MISFIT: Self = Effort {
        scanned: 12,
        descended: (24, 24),
        worth: 0,
        rescanned: 1,
    };

    /// Effort at the beginning of a search.
    pub(super) fn first(options: &FitOptions) -> Self {
        if options.misfit {
            Effort::MISFIT
        } else {
            Effort::NOISE
        }
    }

    pub(super) fn starts(self, residuals: usize) -> usize {
        (self.worth / residuals.max(1)).clamp(self.descended.0, self.descended.1)
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

/// Returns the best minimum from given starts and their outcomes; `None` if no start has a finite cost.
#[must_use]
pub fn from_starts(
    problem: &Problem<'_>,
    starts: &[Values],
    cancel: &AtomicBool,
) -> Option<(Minimum, StartReport)> {
    let mut search = Search::new(starts.first()?, 0, Effort::MISFIT, cancel);
    search.descend(problem, &problem.clone().with_lean(true), starts);
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
    effort: Effort,
    runs: Vec<Minimum>,
    /// Whether the next thorough round searches around the best end.
    around_best: bool,
    late: Late<'p>,
    /// Whether the time limit ended some of the search.
    cut_short: AtomicBool,
    /// Ends of rough descents and the minima that they led to.
    known: Vec<Known>,
    /// Costs of the ends whose valleys were followed.
    followed: Vec<f64>,
    /// Whether no more starts are allowed.
    started: bool,
}

/// The end of a rough descent, and the minimum that it led to.
struct Known {
    cost: f64,
    surface: Values,
    minimum: Minimum,
}

impl Known {
    /// Whether another rough end leads to the same minimum.
    fn is_end_of(&self, (cost, surface, _): &(f64, Values, Minimum)) -> bool {
        let minimum = self.minimum.cost;
        let there = (cost - minimum).abs() <= SAME * minimum.max(1.0);
        let beside = || {
            *cost >= minimum
                && *cost <= self.cost + NEAR * self.cost.max(1.0)
                && distance(surface, &self.surface) < SAME_SPOT
        };
        there || beside()
    }
}

impl<'p> Search<'p> {
    pub(super) fn new(
        fallback: &'p Values,
        seed: u32,
        effort: Effort,
        cancel: &'p AtomicBool,
    ) -> Self {
        Search {
            fallback,
            cancel,
            seed,
            effort,
            runs: Vec::new(),
            around_best: false,
            late: &|| false,
            cut_short: AtomicBool::new(false),
            known: Vec::new(),
            followed: Vec::new(),
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

    /// Runs `count` starts with the lean form and refines the different ends on `problem`. Each start counts once at
    /// its end.
    pub(super) fn quick(&mut self, problem: &Problem<'_>, count: usize) {
        let lean = problem.clone().with_lean(true);
        let found = starts(&lean, self.fallback, count, self.next_seed());
        self.descend(problem, &lean, &found);
    }

    /// Descends from given starts with the lean form and refines the different ends on `problem`.
    fn descend(&mut self, problem: &Problem<'_>, lean: &Problem<'_>, starts: &[Values]) {
        let rough = Settings {
            polish_steps: 0,
            cost_tolerance: 1e-6,
            max_iterations: 60,
            ..Settings::default()
        };
        let bounds = problem.bounds();
        let cancel = self.cancel;
        let mut ends: Vec<Minimum> = match descend_together(problem, starts, cancel) {
            Some(ends) => {
                // The minimum of the lean form is not a minimum of the full one.
                let rough = |end| End {
                    settled: false,
                    ..end
                };
                ends.into_iter().map(rough).map(Minimum::from).collect()
            }
            None => starts
                .par_iter()
                .map(|v| minimise(lean, &lean.pack(v), &bounds, &rough, cancel))
                .collect(),
        };
        ends.retain(usable);
        self.refine(problem, ends, REFINED, 1e-3);
    }

    /// Adds the ends of rough descents. The `most` different ones among those that could still win are refined; `near`
    /// is the relative difference in cost that separates two ends.
    fn refine(&mut self, problem: &Problem<'_>, mut ends: Vec<Minimum>, most: usize, near: f64) {
        ends.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let surface = |m: &Minimum| problem.unpack(&m.parameters).folded();
        let mut different: Vec<(f64, Values, Minimum)> = Vec::new();
        let mut leads_to: Vec<Option<usize>> = Vec::new();
        for end in &ends {
            let here = surface(end);
            let known = different.iter().position(|(cost, other, _)| {
                end.cost <= cost * (1.0 + near) + near || distance(&here, other) < SAME_SPOT
            });
            leads_to.push(known.or_else(|| {
                (different.len() < most).then(|| {
                    different.push((end.cost, here, end.clone()));
                    different.len() - 1
                })
            }));
        }
        self.go_on(problem, &mut different);
        let mut in_full = vec![false; different.len()];
        for (mut end, to) in ends.into_iter().zip(leads_to) {
            if let Some(k) = to {
                let minimum = &different[k].2;
                self.runs
                    .push(match std::mem::replace(&mut in_full[k], true) {
                        true => in_short(minimum),
                        false => minimum.clone(),
                    });
            } else {
                end.ending = Ending::MaxIterations;
                end.cost = f64::INFINITY;
                self.runs.push(end);
            }
        }
    }

    /// Continues rough descents to their minima. Ends that reached a known minimum before are looked up. If there are
    /// many others, they first continue as lanes; those that remain unsettled, or are as deep as the best, are refined
    /// one by one.
    fn go_on(&mut self, problem: &Problem<'_>, ends: &mut [(f64, Values, Minimum)]) {
        let mut unknown: Vec<&mut (f64, Values, Minimum)> = Vec::new();
        for end in ends {
            match self.known.iter().find(|known| known.is_end_of(end)) {
                Some(known) => end.2 = known.minimum.clone(),
                None => unknown.push(end),
            }
        }
        let (bounds, cancel) = (problem.bounds(), self.cancel);
        let mut open: Vec<&mut Minimum> = unknown
            .iter_mut()
            .map(|(_, _, m)| m)
            .filter(|m| m.ending == Ending::MaxIterations)
            .collect();
        if open.len() > REFINED && crew::knows(problem) {
            open.par_chunks_mut(WIDEST).for_each(|some| {
                let from: Vec<Values> =
                    some.iter().map(|m| problem.unpack(&m.parameters)).collect();
                let on = crew::descend_in_full(problem, &from, EVALUATIONS_ON, cancel);
                let on = on.unwrap_or_default();
                // Fewer only if the search is cancelled.
                for (m, end) in some.iter_mut().zip(on) {
                    if end.cost <= m.cost {
                        **m = Minimum::from(end);
                    }
                }
            });
        }
        let fine = |m: &mut Minimum| {
            if !self.over() {
                *m = minimise(problem, &m.parameters, &bounds, &FINE, cancel);
            }
        };
        let by_lane =
            |m: &Minimum| m.ending == Ending::ConvergedByGradient && m.residuals.is_empty();
        each(&mut unknown, &|m| {
            if !by_lane(m) {
                fine(m);
            }
        });
        // The deepest end of a lane is checked again: with extreme gains, rounding can create a false minimum.
        let costs = unknown.iter().filter(|(_, _, m)| !by_lane(m));
        let costs = costs
            .map(|(_, _, m)| m.cost)
            .filter(|cost| cost.is_finite());
        let best = costs.chain(self.best().map(|m| m.cost));
        let best = best.fold(f64::INFINITY, f64::min);
        each(&mut unknown, &|m| {
            if by_lane(m) && same(m.cost, best) {
                fine(m);
            }
        });
        // A descent to an infinite cost would match every end in relative terms.
        let found = unknown.into_iter().filter(|(_, _, m)| usable(m));
        let known = found.map(|(cost, surface, m)| Known {
            cost: *cost,
            surface: *surface,
            minimum: in_short(m),
        });
        self.known.extend(known);
    }

    /// Runs a round of candidates: from the whole box and, in alternate rounds, from around the best end.
    pub(super) fn thorough(&mut self, problem: &Problem<'_>) {
        if self.started {
            return;
        }
        let logarithmic = problem.clone().with_logarithmic(true);
        let centre = self.best().filter(|_| self.around_best);
        let centre = centre.map(|m| problem.unpack(&m.parameters));
        self.around_best = !self.around_best;
        // Few poses leave many minima and are cheap.
        let wanted = Wanted {
            scanned: self.effort.scanned,
            starts: self.effort.starts(problem.residual_count()),
            seed: self.next_seed(),
        };
        // The full form judges, because the lean one lacks most of the light of steep ridges.
        let starts = candidates::starts(problem, self.fallback, centre.as_ref(), wanted);
        let bounds = problem.bounds();
        let cancel = self.cancel;
        let ends: Vec<Minimum> = starts
            .par_iter()
            .enumerate()
            .filter(|_| !self.over())
            .map(|(k, v)| {
                // Every third start descends on the logarithmic scale first.
                let x = problem.pack(v);
                if k % 3 == 0 {
                    let x = minimise(&logarithmic, &x, &bounds, &ROUGH, cancel).parameters;
                    over_shapes(problem, &problem.unpack(&x), &ROUGH, cancel)
                } else {
                    over_shapes(problem, v, &ROUGH, cancel)
                }
            })
            .filter(usable)
            .collect();
        self.refine(problem, ends, REFINED_THOROUGHLY, 1e-4);
    }

    /// Tries more candidates from now on.
    pub(super) fn look_hard(&mut self) {
        self.effort = Effort::NOISE;
    }

    /// Continues from an end without model error: from now on noise alone separates minima.
    pub(super) fn noise_alone(&mut self, settled: &Settled<'_>) {
        self.look_hard();
        self.carry_over(&settled.problem, &settled.problem);
        self.runs.push(settled.minimum.clone());
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

    /// Whether another surface is nearly as good as the best: if there are two, there may be a third.
    pub(super) fn rivalled(&self, problem: &Problem<'_>, best: &Minimum) -> bool {
        let surface = |m: &Minimum| problem.unpack(&m.parameters).folded();
        let here = surface(best);
        let rivals = self.rivals(problem, best, AMBIGUOUS_RISE);
        rivals.iter().any(|m| distance(&surface(m), &here) > APART)
    }

    /// Searches around an end with other weights and returns the different ends, best first.
    pub(super) fn look_again(&mut self, problem: &Problem<'_>, around: &Minimum) -> Vec<Minimum> {
        if self.started {
            return Vec::new();
        }
        let before = std::mem::replace(&mut self.runs, vec![around.clone()]);
        self.forget();
        self.around_best = true;
        self.thorough(problem);
        let found = self.distinct(problem, &around.parameters, RIVALS);
        self.runs = before;
        self.forget();
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

    /// Discards known ends, because weights or ends change from now on.
    fn forget(&mut self) {
        self.known.clear();
        self.followed.clear();
    }

    /// Refines all different ends on a problem with other weights or more free parameters; their counts stay.
    pub(super) fn carry_over(&mut self, from: &Problem<'_>, to: &Problem<'_>) {
        let fine = Settings {
            polish_steps: 20,
            max_iterations: 400,
            ..Settings::default()
        };
        let bounds = to.bounds();
        self.forget();
        let mut runs = std::mem::take(&mut self.runs);
        runs.sort_by(|a, b| a.cost.total_cmp(&b.cost));
        let mut different: Vec<&Minimum> = Vec::new();
        let mut leads_to: Vec<Option<usize>> = Vec::new();
        for run in &runs {
            let known = different.iter().position(|m| same(run.cost, m.cost));
            leads_to.push(known.or_else(|| {
                (run.cost.is_finite() && different.len() <= REFINED).then(|| {
                    different.push(run);
                    different.len() - 1
                })
            }));
        }
        // After the time limit only the best of them is refined.
        let ends: Vec<Option<Minimum>> = different
            .par_iter()
            .enumerate()
            .map(|(k, run)| {
                let x = to.pack(&from.unpack(&run.parameters));
                (k == 0 || !self.over()).then(|| minimise(to, &x, &bounds, &fine, self.cancel))
            })
            .collect();
        for (run, to) in runs.iter().zip(leads_to) {
            let end = to.and_then(|k| ends[k].clone());
            self.runs.push(end.unwrap_or_else(|| Minimum {
                cost: f64::INFINITY,
                ending: Ending::MaxIterations,
                ..run.clone()
            }));
        }
    }

    /// Best end so far.
    pub(super) fn best(&self) -> Option<&Minimum> {
        self.runs
            .iter()
            .filter(|m| usable(m))
            .min_by(|a, b| a.cost.total_cmp(&b.cost))
    }

    /// Whether at least `times` starts reached the best end.
    pub(super) fn confirmed(&self, times: usize) -> bool {
        self.report().at_minimum >= times
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

    /// Summarises the outcomes of the starts.
    pub(super) fn report(&self) -> StartReport {
        let best = self.best().map_or(f64::INFINITY, |m| m.cost);
        let at_minimum = self.runs.iter().filter(|m| same(m.cost, best)).count();
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

/// Applies a function to each of the ends, in parallel if there are several.
fn each(ends: &mut [&mut (f64, Values, Minimum)], what: &(dyn Fn(&mut Minimum) + Sync)) {
    match ends {
        [(_, _, only)] => what(only),
        several => several.par_iter_mut().for_each(|(_, _, m)| what(m)),
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

impl From<End> for Minimum {
    fn from(end: End) -> Self {
        Minimum {
            parameters: end.parameters,
            residuals: Vec::new(),
            jacobian: Vec::new(),
            cost: end.cost,
            ending: match end.settled {
                true => Ending::ConvergedByGradient,
                false => Ending::MaxIterations,
            },
            at_bound: Vec::new(),
            evaluations: 0,
        }
    }
}

/// Descends over shapes only, with the amplitudes projected out.
pub(super) fn over_shapes(
    problem: &Problem<'_>,
    start: &Values,
    settings: &Settings,
    cancel: &AtomicBool,
) -> Minimum {
    let shapes = Projected::new(problem, start);
    let x = shapes.shape(&problem.pack(start));
    let mut end = minimise(&shapes, &x, &shapes.bounds(), settings, cancel);
    if usable(&end) {
        end.parameters = shapes.whole(&end.parameters);
    }
    end
}

/// Whether there may be deeper minima far from an end without model error: the data do not determine the surface there,
/// the signals hardly exceed their noise, or only one pose meets the lobe.
pub(super) fn many_minima(problem: &Problem<'_>, end: &Minimum) -> bool {
    !determined(problem, end) || faint(problem) || met_once(problem, end)
}

/// Whether one observation alone determines the place of the lobe: then another narrow lobe may meet it elsewhere.
fn met_once(problem: &Problem<'_>, end: &Minimum) -> bool {
    let (free, rows) = (problem.free(), problem.residual_count());
    if end.jacobian.len() != rows * free.len() {
        return false;
    }
    let of_the_lobe = [
        Quantity::ThetaR,
        Quantity::TiltOffset,
        Quantity::AzimuthOffset,
    ];
    let columns = end.jacobian.chunks_exact(rows.max(1)).zip(free);
    columns
        .filter(|(_, quantity)| of_the_lobe.contains(quantity))
        .any(|(slopes, _)| hangs_on_one(slopes))
}

/// Whether one of the slopes outweighs all others: the equivalent number of equal slopes, (Σ s²)²/Σ s⁴, is close to 1.
fn hangs_on_one(slopes: &[f64]) -> bool {
    let squares = slopes.iter().map(|slope| slope * slope);
    let (sum, of_squares) = squares.fold((0.0, 0.0), |(s, q), x| (s + x, q + x * x));
    sum * sum < ONE_OBSERVATION * of_squares
}

/// Whether the signals differ so little that noise creates minima as deep as light does.
fn faint(problem: &Problem<'_>) -> bool {
    let signals = problem.set().observations.iter().map(|o| o.signal);
    let weighed = signals
        .zip(problem.sigma())
        .map(|(x, s)| (x, 1.0 / (s * s)));
    let (weight, sum) = weighed
        .clone()
        .fold((0.0, 0.0), |(w, t), (x, v)| (w + v, t + v * x));
    let mean = sum / weight;
    weighed
        .map(|(x, v)| v * (x - mean) * (x - mean))
        .sum::<f64>()
        < FAINT
}

/// Whether the data determine the surface near an end.
pub(super) fn determined(problem: &Problem<'_>, end: &Minimum) -> bool {
    let rows = problem.residual_count();
    if end.jacobian.len() != rows * problem.free().len() {
        return false;
    }
    let known = covariance(&end.jacobian, rows, &end.residuals, Scaling::Absolute);
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

/// Whether a cost equals that of the best end, or is lower.
pub(super) fn same(cost: f64, best: f64) -> bool {
    cost <= best + SAME * best.max(1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lobe_depends_on_one_observation_if_its_slope_outweighs_all_others() {
        assert!(hangs_on_one(&[0.0, -30.0, 4.0, 2.0, 1.0]));
        assert!(!hangs_on_one(&[0.0, -30.0, 20.0, 2.0, 1.0]));
        assert!(!hangs_on_one(&[1.0; 5]));
        // No observation determines the place; that is another case.
        assert!(!hangs_on_one(&[0.0; 5]));
        assert!(!hangs_on_one(&[f64::NAN; 5]));
    }
}
