//! Fits one variant to one set of observations.
//!
//! Call [`estimate`]. `pipeline` has the steps. A set of very many observations goes through them in part (see
//! [`super::subsample`]), and a stated value is kept from posing as a model error.

use std::sync::atomic::{AtomicBool, Ordering};

use super::FitOptions;
use super::constraints::priors;
use super::estimate::{Estimate, Subsample};
use super::higher_order::HigherOrder;
use super::least_squares::minimum::Minimum;
use super::model_discrepancy::misfit_scale;
use super::multistart::{AMBIGUOUS_RISE, Late};
use super::pipeline::{FAR_LESS, Reached, conclude, whole};
use super::problem::Problem;
use super::reweighting::{Weighing, WeightedFit};
use super::subsample::{everywhere, representative, subset};
use super::uncertainty::covariance::covariance;
use crate::model::Variant;
use crate::observation::ObservationSet;

/// Rounds of higher order and descent over all observations.
const PASSES_OVER_ALL: usize = 2;

/// Fits one variant. Returns `None` if no point could be evaluated.
#[must_use]
pub fn estimate<'a>(
    set: &'a ObservationSet,
    variant: Variant,
    options: &FitOptions,
    higher_order: Option<HigherOrder<'_>>,
    cancel: &AtomicBool,
) -> Option<Estimate<'a>> {
    estimate_until(set, variant, options, higher_order, &|| false, cancel)
}

/// Like [`estimate`]. Once `late` returns true, the search for other explanations of the data ends and the best result
/// so far is returned.
#[must_use]
pub fn estimate_until<'a>(
    set: &'a ObservationSet,
    variant: Variant,
    options: &FitOptions,
    higher_order: Option<HigherOrder<'_>>,
    late: Late<'_>,
    cancel: &AtomicBool,
) -> Option<Estimate<'a>> {
    let fitted = |options: &FitOptions| match representative(set) {
        Some(kept) => estimate_thinned(set, kept, variant, options, higher_order, late, cancel),
        None => whole(set, variant, options, higher_order, late, cancel),
    };
    let found = fitted(options)?;
    let stated = options.constraints.iter().any(|one| one.std > 0.0);
    let may = options.misfit && options.misfit_most.is_none() && found.discrepancy > 0.0;
    if !(stated && may) || late() {
        return Some(found);
    }
    // A statement that contradicts the data must not be taken for a model error, which would reduce the weight of the
    // data and hide the contradiction. The model error is therefore determined from the data only, if they determine a
    // surface.
    let alone = fitted(&FitOptions {
        constraints: options.held().copied().collect(),
        ..options.clone()
    });
    let bounded = alone
        .filter(|alone| FAR_LESS * alone.discrepancy < found.discrepancy && is_determined(alone))
        .and_then(|alone| {
            fitted(&FitOptions {
                misfit_most: Some(alone.discrepancy),
                ..options.clone()
            })
        });
    Some(bounded.unwrap_or(found))
}

/// Whether the data leave no direction undetermined.
fn is_determined(e: &Estimate<'_>) -> bool {
    let end = &e.minimum;
    let rows = end.residuals.len();
    covariance(&end.jacobian, rows, &end.residuals)
        .null_directions
        .is_empty()
}

/// Fits one variant to all observations, with the search on `kept` of them. Returns `None` if no point could be
/// evaluated.
fn estimate_thinned<'a>(
    set: &'a ObservationSet,
    kept: Vec<usize>,
    variant: Variant,
    options: &FitOptions,
    higher_order: Option<HigherOrder<'_>>,
    late: Late<'_>,
    cancel: &AtomicBool,
) -> Option<Estimate<'a>> {
    let few = subset(set, &kept);
    let found = whole(&few, variant, options, higher_order, late, cancel)?;
    let own = set.sigma();
    let scale = misfit_scale(set);
    let weighing = Weighing {
        own: &own,
        scale: &scale,
        kept: None,
        fitted: found.fitted,
        options,
        cancel,
    };
    let problem = Problem::new(set, variant, found.problem.free().to_vec(), found.values)
        .with_sigma(weighing.sigma(found.discrepancy))
        .with_flat_sigma(found.problem.flat_sigma().to_vec())
        .with_priors(&priors(&options.constraints))
        .with_loss(options.loss)
        .with_polarisation(found.problem.is_polarised());
    let higher_order = higher_order.filter(|_| found.takes_higher_order());
    let mut settled = WeightedFit {
        minimum: found.minimum.clone(),
        discrepancy: found.discrepancy,
        problem,
    };
    let mut interpolated = None;
    for _ in 0..PASSES_OVER_ALL {
        if let Some(higher_order) = higher_order {
            let values = settled.values();
            let everywhere = everywhere(&settled.problem, &values, higher_order, &kept, cancel)?;
            interpolated = everywhere.nodes.map(|n| (n, everywhere.error));
            settled.problem = settled.problem.with_correction(everywhere.offsets);
        }
        settled.settle(&weighing);
        if higher_order.is_none() || cancel.load(Ordering::Relaxed) {
            break;
        }
    }
    let mut rivals: Vec<Minimum> = found
        .rivals
        .iter()
        .map(|rival| settled.again(&rival.parameters, cancel))
        .collect();
    // A model error does not shrink with more poses; counting noise does.
    if settled.discrepancy == 0.0 {
        rivals.retain(|m| {
            let (cost, rise) = (settled.minimum.cost, m.cost - settled.minimum.cost);
            m.cost.is_finite() && rise < AMBIGUOUS_RISE && rise > 1e-6 * cost.max(1.0)
        });
    }
    let reached = Reached {
        cut_short: found.cut_short,
        settled,
        shift: found.higher_order_shift,
        undecided: found.higher_order_undecided,
        starts: found.starts,
        rivals,
        // The terms that may join need all observations at once.
        elsewhere: Vec::new(),
        higher_order_left_out: found.higher_order_left_out,
    };
    let mut all = conclude(reached, variant, &weighing);
    all.thinned = Some(Subsample { kept, interpolated });
    Some(all)
}
