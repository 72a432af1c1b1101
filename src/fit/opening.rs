//! Begins the search of one variant and decides how long it continues.
//!
//! Call [`Opening::new`], then [`Opening::search`], which runs the first round; [`Opening::rounds`] returns the number
//! of rounds to follow.

use std::sync::atomic::AtomicBool;

use super::estimate::{few_directions, free_quantities};
use super::known::certified;
use super::misfit::{LIKELY, RARE, SELDOM, chance, flat_sigma, freedom, misfit_scale};
use super::problem::{Problem, Quantity, Values};
use super::search::{Effort, Late, Search};
use super::settle::{Settled, Weighing, sigma_at};
use super::solver::Minimum;
use super::{Constraint, FitOptions};
use crate::model::Variant;
use crate::observation::{ObservationSet, Prior};

/// Discrepancy for the starts, before it is estimated from the data.
const FIRST_DISCREPANCY: f64 = 0.03;
/// χ² per observation with the first weights above which more starts are worth their time.
const SUSPICIOUS: f64 = 0.1;
/// χ² per observation with the first weights that no surface far from the right one reaches: a model error of 0.3 %.
const WELL_MET: f64 = 0.01;
/// Rounds of a thorough search.
pub(super) const THOROUGH_ROUNDS: usize = 3;
/// The same if no end describes the data.
const PATIENT_ROUNDS: usize = 8;

/// Initial state of the search of one variant.
pub(super) struct Opening<'a> {
    /// The problem with all free quantities.
    pub problem: Problem<'a>,
    /// The same with the nominal index and weights that allow errors of a few per cent of the peak.
    first: Problem<'a>,
    /// Values that no start varies.
    pub fixed: Values,
    own: Vec<f64>,
    scale: Vec<f64>,
    fitted: usize,
}

impl<'a> Opening<'a> {
    pub(super) fn new(set: &'a ObservationSet, variant: Variant, options: &FitOptions) -> Self {
        let (free, fixed) = without_held(free_quantities(set, variant), &options.constraints);
        let priors: Vec<(Quantity, Prior)> = options
            .constraints
            .iter()
            .filter(|t| t.std > 0.0)
            .map(|t| {
                let (mean, std) = (t.value, t.std);
                (t.quantity, Prior { mean, std })
            })
            .collect();
        let scale = misfit_scale(set);
        let own: Vec<f64> = set.observations.iter().map(|o| o.sigma).collect();
        let fitted = free.len();
        // With their full weight the flats would slow the starts down for the last digit of gain and tilt.
        let loose = set
            .flats
            .iter()
            .map(|f| f.sigma.hypot(FIRST_DISCREPANCY * f.signal));
        let first = Problem::new(set, variant, free, fixed)
            .with_sigma(sigma_at(&own, &scale, FIRST_DISCREPANCY))
            .with_flat_sigma(loose.collect())
            .with_priors(&priors)
            .with_loss(options.loss);
        // The starts use the nominal index; from here on it is free.
        let mut free = first.free().to_vec();
        let held = |q: &Quantity| {
            options
                .constraints
                .iter()
                .any(|t| t.quantity == *q && t.std == 0.0)
        };
        free.extend(certified(set).into_iter().filter(|q| !held(q)));
        let mut problem = first
            .clone()
            .with_free(free)
            .with_flat_sigma(flat_sigma(set));
        if !options.misfit {
            problem = problem.with_sigma(own.clone());
        }
        Opening {
            problem,
            first,
            fixed,
            own,
            scale,
            fitted,
        }
    }

    pub(super) fn weighing<'s>(
        &'s self,
        options: &'s FitOptions,
        cancel: &'s AtomicBool,
    ) -> Weighing<'s> {
        Weighing {
            own: &self.own,
            scale: &self.scale,
            fitted: self.fitted,
            options,
            cancel,
        }
    }

    /// Returns a search after its first round, with a time limit.
    pub(super) fn search<'s>(
        &'s self,
        options: &FitOptions,
        late: Late<'s>,
        cancel: &'s AtomicBool,
    ) -> Search<'s> {
        let effort = Effort::first(options);
        let mut search = Search::new(&self.fixed, options.seed, effort, cancel).until(late);
        search.quick(&self.first, options.starts);
        if options.starts_alone {
            search.has_all_starts();
        }
        if options.misfit && self.may_be_elsewhere(&search) {
            search.glance(&self.first);
        }
        search.carry_over(&self.first, &self.problem);
        search
    }

    /// Whether another surface may fit better: the best end leaves large residuals, or the poses have few directions. A
    /// broad lobe in the wrong place describes the light of steep ridges to within one per cent of the peak.
    fn may_be_elsewhere(&self, search: &Search<'_>) -> bool {
        let cost = search.best().map_or(f64::INFINITY, |m| m.cost);
        let (observations, _) = self.counts();
        few_directions(self.problem.set()) || cost > WELL_MET * observations
    }

    /// Total number of thorough rounds, judged from the ends so far.
    pub(super) fn rounds(&self, search: &Search<'_>, options: &FitOptions) -> usize {
        if options.starts_alone || self.enough(search, options) {
            0
        } else if self.plausible(search, options) {
            THOROUGH_ROUNDS
        } else {
            PATIENT_ROUNDS
        }
    }

    fn enough(&self, search: &Search<'_>, options: &FitOptions) -> bool {
        let Some(best) = search.best() else {
            return false;
        };
        let (observations, freedom) = self.counts();
        if options.misfit {
            // The complete closed form describes real samples far better than the first weights require. If it does
            // not, no start found the lobe. The printed lobe often leaves as much in any case.
            let explained = best.cost <= SUSPICIOUS * observations;
            (explained || self.problem.variant() == Variant::Paper) && search.confirmed(2)
        } else {
            // An end that is not a minimum lies in a valley, where there may be a deeper one.
            let settled = best.ending.is_success() && search.confirmed(2);
            best.cost <= freedom * chance(freedom, LIKELY) && settled
        }
    }

    /// Whether noise, or a small model error, explains the best end. Otherwise there is a better one.
    fn plausible(&self, search: &Search<'_>, options: &FitOptions) -> bool {
        let cost = search.best().map_or(f64::INFINITY, |m| m.cost);
        let (observations, freedom) = self.counts();
        if options.misfit {
            self.problem.variant() == Variant::Paper || cost <= observations
        } else {
            cost <= freedom * chance(freedom, RARE)
        }
    }

    /// Cost of an end with the observations' own weights above which a deeper one is likely.
    pub(super) fn likely(&self) -> f64 {
        let (_, freedom) = self.counts();
        freedom * chance(freedom, SELDOM)
    }

    /// Number of observations and degrees of freedom.
    fn counts(&self) -> (f64, f64) {
        let observations = self.own.len();
        (observations as f64, freedom(observations, self.fitted))
    }

    /// Combines the best end of a search with the weights to settle it with.
    pub(super) fn settling(&self, best: Minimum, options: &FitOptions) -> Settled<'a> {
        Settled {
            minimum: best,
            problem: self.problem.clone(),
            discrepancy: if options.misfit {
                FIRST_DISCREPANCY
            } else {
                0.0
            },
        }
    }
}

/// Removes the quantities that the user holds from the free ones.
fn without_held(
    (mut free, mut fixed): (Vec<Quantity>, Values),
    stated: &[Constraint],
) -> (Vec<Quantity>, Values) {
    for t in stated.iter().filter(|t| t.std == 0.0) {
        free.retain(|q| *q != t.quantity);
        fixed.set_natural(t.quantity, t.value);
    }
    (free, fixed)
}
