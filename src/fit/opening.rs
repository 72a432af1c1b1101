//! How the search of one variant begins, and how long it is to go on.
//!
//! Call [`Opening::new`], then [`Opening::search`], which has its quick look behind it; [`Opening::rounds`] says what is to
//! follow.

use std::sync::atomic::AtomicBool;

use super::estimate::{few_directions, free_quantities};
use super::known::certified;
use super::misfit::{LIKELY, RARE, SELDOM, chance, flat_sigma, freedom, misfit_scale};
use super::problem::{Problem, Quantity, Values};
use super::search::{Effort, Late, Search};
use super::settle::{Settled, Weighing, sigma_at};
use super::solver::Minimum;
use super::{FitOptions, Told};
use crate::model::Variant;
use crate::observation::{ObservationSet, Prior};

/// Discrepancy with which the starts are run, before the data have told it.
const FIRST_DISCREPANCY: f64 = 0.03;
/// χ² per observation at the first weights above which more starts are worth their time.
const SUSPICIOUS: f64 = 0.1;
/// χ² per observation at the first weights that no surface far from the right one comes to: a misfit of 0.3 %.
const WELL_MET: f64 = 0.01;
/// Rounds of a thorough search.
pub(super) const THOROUGH_ROUNDS: usize = 3;
/// The same where no end describes the data.
const PATIENT_ROUNDS: usize = 8;

/// What a search of one variant begins with.
pub(super) struct Opening<'a> {
    /// The problem with all that may move.
    pub problem: Problem<'a>,
    /// The same with the index at its nominal value and weights that forgive a few per cent of the peak.
    first: Problem<'a>,
    /// Values of what no start varies.
    pub fixed: Values,
    own: Vec<f64>,
    scale: Vec<f64>,
    fitted: usize,
}

impl<'a> Opening<'a> {
    pub(super) fn new(set: &'a ObservationSet, variant: Variant, options: &FitOptions) -> Self {
        let (free, fixed) = with_told(free_quantities(set, variant), &options.told);
        let priors: Vec<(Quantity, Prior)> = options
            .told
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
        // Flats at their full weight would drag a start about for the last digit of gain and tilt.
        let loose = set
            .flats
            .iter()
            .map(|f| f.sigma.hypot(FIRST_DISCREPANCY * f.signal));
        let first = Problem::new(set, variant, free, fixed)
            .with_sigma(sigma_at(&own, &scale, FIRST_DISCREPANCY))
            .with_flat_sigma(loose.collect())
            .with_priors(&priors)
            .with_loss(options.loss);
        // The starts leave the index at its nominal value; from here on it may move.
        let mut free = first.free().to_vec();
        let held = |q: &Quantity| {
            options
                .told
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

    /// A search that has had its quick look, and is to end once it is late.
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

    /// Whether the best end misses by so much, or poses look from so few directions, that another surface may do better: a
    /// broad lobe in the wrong place comes within a per cent of the peak to what steep ridges send back.
    fn may_be_elsewhere(&self, search: &Search<'_>) -> bool {
        let cost = search.best().map_or(f64::INFINITY, |m| m.cost);
        let (observations, _) = self.counts();
        few_directions(self.problem.set()) || cost > WELL_MET * observations
    }

    /// Thorough rounds that a search is to have in all, as far as its ends so far tell.
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
            // The full closed form misses real samples by far less than the first weights allow:
            // more than that says that no start found the lobe. The printed form often misses by
            // so much anyway.
            let explained = best.cost <= SUSPICIOUS * observations;
            (explained || self.problem.variant() == Variant::Paper) && search.confirmed(2)
        } else {
            // An end that is no minimum lies in a valley, and there may be a deeper one.
            let settled = best.ending.is_success() && search.confirmed(2);
            best.cost <= freedom * chance(freedom, LIKELY) && settled
        }
    }

    /// Whether the best end is one that noise, or a small misfit, allows: if not, there is a better one.
    fn plausible(&self, search: &Search<'_>, options: &FitOptions) -> bool {
        let cost = search.best().map_or(f64::INFINITY, |m| m.cost);
        let (observations, freedom) = self.counts();
        if options.misfit {
            self.problem.variant() == Variant::Paper || cost <= observations
        } else {
            cost <= freedom * chance(freedom, RARE)
        }
    }

    /// Cost of an end at the observations' own weights above which there may well be a deeper one.
    pub(super) fn likely(&self) -> f64 {
        let (_, freedom) = self.counts();
        freedom * chance(freedom, SELDOM)
    }

    /// Observations, and degrees of freedom.
    fn counts(&self) -> (f64, f64) {
        let observations = self.own.len();
        (observations as f64, freedom(observations, self.fitted))
    }

    /// The best end of a search with the weights that it is to be settled on.
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

/// Takes what the user holds fixed out of what is free.
fn with_told(
    (mut free, mut fixed): (Vec<Quantity>, Values),
    told: &[Told],
) -> (Vec<Quantity>, Values) {
    for t in told.iter().filter(|t| t.std == 0.0) {
        free.retain(|q| *q != t.quantity);
        fixed.set_natural(t.quantity, t.value);
    }
    (free, fixed)
}
