//! The steps of the fit of one variant on all observations of a set: search, weights, edges, higher order, estimate.
//!
//! `model_discrepancy` determines the model error and with it the weights; `reweighting` makes the weights consistent with the fit that
//! they are computed from.

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use super::causes::missing_lobe::no_lobe;
use super::discontinuities;
use super::estimate::{Estimate, StartReport};
use super::higher_order::{HigherOrder, dispensable};
use super::least_squares::minimum::{Ending, Minimum, Settings};
use super::model_discrepancy::{explained, freedom, lightened, loss_weights};
use super::multistart::starts::{ONE_SURFACE, distance};
use super::multistart::{AMBIGUOUS_RISE, Late, Search, same, usable};
use super::reweighting::{Weighing, WeightedFit, with_higher_order};
use super::search_setup::Opening;
use super::{FitOptions, Loss};
use crate::model::Variant;
use crate::observation::ObservationSet;

/// Rise of the cost up to which the near minima of a search are compared again with the final weights.
const RIVAL_RISE: f64 = 25.0;
/// Number of edges of the closed form that are crossed one after the other.
const EDGES_CROSSED: usize = 8;
/// How often a surface with a much smaller model error is looked for.
const LESS_MISFIT: usize = 3;
/// Factor by which the model error of another end must be smaller for that end to be better.
pub(super) const FAR_LESS: f64 = 4.0;

/// Fits one variant with every step on all observations, until `late` or `cancel` end it. Returns `None` if no point could
/// be evaluated.
pub(super) fn whole<'a>(
    set: &'a ObservationSet,
    variant: Variant,
    options: &FitOptions,
    higher_order: Option<HigherOrder<'_>>,
    late: Late<'_>,
    cancel: &AtomicBool,
) -> Option<Estimate<'a>> {
    let opening = Opening::new(set, variant, options);
    let weighing = opening.weighing(options, cancel);
    let mut search = looked_for(&opening, options, late, cancel);
    let mut settled = opening.settling(search.best()?.clone(), options);
    settled.settle(&weighing);
    if options.misfit {
        settled = with_less_misfit(settled, &mut search, &weighing);
    }
    if options.loss != Loss::Linear {
        settled = of_most_observations(settled, variant, &weighing, late);
    }
    let starts = search.report();
    let candidates = search.rivals(&settled.problem, &settled.minimum, RIVAL_RISE);
    let elsewhere = search.rivals(&settled.problem, &settled.minimum, f64::INFINITY);
    let mut others: Vec<Minimum> = Vec::new();
    if options.misfit && higher_order.is_some() && settled.has_rivals() && !search.over() {
        others = search.look_again(&settled.problem, &settled.minimum);
    }
    let (mut rivals, better) = compared_again(&mut settled, &candidates, &search, &weighing);
    let before_edges = beyond_edges(&mut settled, &search, &weighing);
    let weights_moved = better || !before_edges.is_empty();
    rivals.extend(before_edges);
    if weights_moved {
        for rival in &mut rivals {
            *rival = settled.again(&rival.parameters, cancel);
        }
    }
    let surface = |m: &Minimum| settled.problem.unpack(&m.parameters).folded();
    let here = surface(&settled.minimum);
    rivals.retain(|m| {
        let rise = m.cost - settled.minimum.cost;
        m.cost.is_finite() && rise < AMBIGUOUS_RISE && distance(&surface(m), &here) > ONE_SURFACE
    });
    let mut shift = vec![0.0; settled.minimum.parameters.len()];
    let mut undecided = false;
    let higher_order_left_out = higher_order.and_then(|higher_order| {
        let values = settled.values();
        dispensable(&settled.problem, &values, higher_order, options)
    });
    if let Some(higher_order) = higher_order.filter(|_| higher_order_left_out.is_none()) {
        let found = with_higher_order(settled, higher_order, &search, &others, &weighing);
        settled = found.settled;
        (shift, undecided) = (found.shift, found.undecided);
        if found.elsewhere {
            rivals.clear();
        }
        rivals.extend(found.rivals);
    }
    let reached = Reached {
        cut_short: search.is_cut_short(),
        settled,
        shift,
        undecided,
        starts,
        rivals,
        elsewhere,
        higher_order_left_out,
    };
    Some(conclude(reached, variant, &weighing))
}

/// Compares near minima of a search once more: the weights of the starts may rank them wrongly, the final weights decide.
/// Returns the minima that are not the settled one, and whether one of them took its place and the weights moved.
fn compared_again(
    settled: &mut WeightedFit<'_>,
    candidates: &[Minimum],
    search: &Search<'_>,
    weighing: &Weighing<'_>,
) -> (Vec<Minimum>, bool) {
    let (mut others, mut better) = (Vec::new(), false);
    for other in candidates {
        if search.over() {
            break;
        }
        let again = settled.again(&other.parameters, weighing.cancel);
        if again.cost < settled.minimum.cost && again.ending != Ending::NotFinite {
            others.push(std::mem::replace(&mut settled.minimum, again));
            settled.settle(weighing);
            better = true;
        } else {
            others.push(again);
        }
    }
    (others, better)
}

/// Crosses edges of the closed form while a deeper minimum is behind them. Returns the minima that were left.
fn beyond_edges(
    settled: &mut WeightedFit<'_>,
    search: &Search<'_>,
    weighing: &Weighing<'_>,
) -> Vec<Minimum> {
    let mut left = Vec::new();
    for _ in 0..EDGES_CROSSED {
        if search.over() {
            break;
        }
        let behind = discontinuities::beyond(&settled.problem, &settled.minimum);
        let ends = behind.par_iter().map(|x| settled.again(x, weighing.cancel));
        let deepest = ends.filter(usable).min_by(|a, b| a.cost.total_cmp(&b.cost));
        let Some(deeper) = deepest.filter(|m| !same(settled.minimum.cost, m.cost)) else {
            break;
        };
        left.push(std::mem::replace(&mut settled.minimum, deeper));
        settled.settle(weighing);
    }
    left
}

/// Runs a search to its end.
fn looked_for<'s>(
    opening: &'s Opening<'_>,
    options: &FitOptions,
    late: Late<'s>,
    cancel: &'s AtomicBool,
) -> Search<'s> {
    let mut search = opening.search(options, late, cancel);
    opening.extend(&mut search, options);
    search.images(&opening.problem);
    search.follow_valley(&opening.problem);
    search
}

/// Chooses between the end under a robust loss and the end of a descent from the fit without one: the end that
/// describes most observations better. A robust loss can ignore whole groups of observations, so a surface that fits
/// half of them and misses the others by far is also a minimum.
fn of_most_observations<'a>(
    settled: WeightedFit<'a>,
    variant: Variant,
    weighing: &Weighing<'_>,
    late: Late<'_>,
) -> WeightedFit<'a> {
    let set = settled.problem.set();
    let plain = FitOptions {
        loss: Loss::Linear,
        ..weighing.options.clone()
    };
    let opening = Opening::new(set, variant, &plain);
    let mut search = looked_for(&opening, &plain, late, weighing.cancel);
    let Some(best) = search.best() else {
        return settled;
    };
    let mut guide = opening.settling(best.clone(), &plain);
    let without_loss = opening.weighing(&plain, weighing.cancel);
    guide.settle(&without_loss);
    if plain.misfit {
        guide = with_less_misfit(guide, &mut search, &without_loss);
    }
    let mut other = settled.clone();
    other.problem = other.problem.with_sigma(weighing.sigma(guide.discrepancy));
    other.settle_from(&guide.minimum.parameters, weighing);
    match usable(&other.minimum) && other.of_more_observations(&settled, weighing) {
        true => other,
        false => settled,
    }
}

/// Looks for a surface with no model error, or a much smaller one.
///
/// The weights of the first search allow every end an error of a few per cent of the peak. If few poses meet the lobe,
/// surfaces far from the true one pass, and the first starts may all end at one whose model error ridges never have. So this
/// looks for ends that need less. Once noise alone explains the data, the search continues with its weights.
fn with_less_misfit<'a>(
    mut settled: WeightedFit<'a>,
    search: &mut Search<'_>,
    weighing: &Weighing<'_>,
) -> WeightedFit<'a> {
    let cancel = weighing.cancel;
    for _ in 0..LESS_MISFIT {
        if !settled.doubted() || search.over() {
            break;
        }
        let less = settled.discrepancy / FAR_LESS;
        let mut demanding = settled.clone();
        demanding.problem = demanding.problem.with_sigma(weighing.sigma(less));
        demanding.minimum = demanding.again(&settled.minimum.parameters, cancel);
        let ends = search.look_again(&demanding.problem, &demanding.minimum);
        let better = ends.into_par_iter().find_map_first(|end| {
            if search.over() {
                return None;
            }
            let mut other = settled.clone();
            other.settle_from(&end.parameters, weighing);
            if other.discrepancy >= less {
                return None;
            }
            other.settle(weighing);
            (other.minimum.ending != Ending::NotFinite && other.discrepancy < less).then_some(other)
        });
        match better {
            Some(other) => settled = other,
            None => break,
        }
    }
    if settled.discrepancy == 0.0
        && let Some(best) = search.continue_with(&settled.problem, &settled.minimum)
    {
        settled.minimum = best;
    }
    settled
}

/// State after a search and its descents.
pub(super) struct Reached<'a> {
    /// Whether the time limit ended the search.
    pub cut_short: bool,
    pub settled: WeightedFit<'a>,
    pub shift: Vec<f64>,
    pub undecided: bool,
    pub starts: StartReport,
    pub rivals: Vec<Minimum>,
    pub elsewhere: Vec<Minimum>,
    pub higher_order_left_out: Option<f64>,
}

/// Builds the estimate at a settled minimum.
pub(super) fn conclude<'a>(
    reached: Reached<'a>,
    variant: Variant,
    weighing: &Weighing<'_>,
) -> Estimate<'a> {
    let Reached {
        cut_short,
        settled,
        shift,
        undecided,
        starts,
        rivals,
        elsewhere,
        higher_order_left_out,
    } = reached;
    let no_lobe = no_lobe(&settled.problem, &settled.minimum, weighing.cancel);
    let Weighing {
        own,
        fitted,
        options,
        cancel,
        ..
    } = *weighing;
    let WeightedFit {
        mut problem,
        mut minimum,
        discrepancy,
    } = settled;
    minimum = discontinuities::cleared(&problem, minimum);
    let values = problem.unpack(&minimum.parameters);
    let loss_weights = loss_weights(&problem, &values, options.loss);
    if options.loss != Loss::Linear {
        // The same point as the minimum of least squares, which is the form that the budget uses.
        let sigma = lightened(problem.sigma(), &loss_weights);
        problem = problem.with_loss(Loss::Linear).with_sigma(sigma);
        minimum = problem.descend(&minimum.parameters, &Settings::DEFAULT, cancel);
    }
    let freedom = freedom(problem.set().observations.len(), fitted);
    let explained = explained(variant, options, discrepancy, minimum.cost, freedom);
    let estimate = Estimate {
        chi2_reduced_without_model: f64::NAN,
        rms_residual: f64::NAN,
        misfit: Vec::new(),
        discrepancy,
        fitted,
        starts,
        values,
        minimum,
        problem,
        higher_order_shift: shift,
        higher_order_undecided: undecided,
        loss_weights,
        explained,
        held: options.held().map(|stated| stated.quantity).collect(),
        rivals,
        elsewhere,
        no_lobe,
        traced: None,
        higher_order_left_out,
        cut_short,
        thinned: None,
        findings: Vec::new(),
        poses_tried: false,
        observation_cause: None,
        investigated: false,
    };
    estimate.with_statistics(own)
}
