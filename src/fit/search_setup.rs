//! Begins the search of one variant: its free quantities, its weights and its first starts.
//!
//! Call [`Opening::new`], then [`Opening::search`], which descends from the starts that the bright spot suggests.

use std::sync::atomic::AtomicBool;

use super::FitOptions;
use super::constraints::priors;
use super::known::{certified, gain_and_stray_light};
use super::least_squares::minimum::Minimum;
use super::model_discrepancy::{flat_sigma, misfit_scale, peak};
use super::multistart::{Late, Search};
use super::problem::{Problem, Quantity, Values};
use super::reweighting::{Weighing, WeightedFit, sigma_at};
use crate::material::Material;
use crate::model::Variant;
use crate::observation::ObservationSet;
use crate::units::Angle;

/// Discrepancy for the starts, before it is estimated from the data.
const FIRST_DISCREPANCY: f64 = 0.03;
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
        let (free, fixed) = without_held(free_quantities(set, variant), options);
        let scale = misfit_scale(set);
        let own = set.sigma();
        let fitted = free.len();
        // With their full weight the flats would slow the starts down for the last digit of gain and tilt.
        let loose = set
            .flats
            .iter()
            .map(|f| f.sigma.hypot(FIRST_DISCREPANCY * f.signal));
        let first = Problem::new(set, variant, free, fixed)
            .with_sigma(sigma_at(&own, &scale, FIRST_DISCREPANCY))
            .with_flat_sigma(loose.collect())
            .with_priors(&priors(&options.constraints))
            .with_loss(options.loss);
        // The starts use the nominal index; from here on it is free.
        let mut free = first.free().to_vec();
        let held = |q: &Quantity| options.held().any(|stated| stated.quantity == *q);
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
            kept: None,
            fitted: self.fitted,
            options,
            cancel,
        }
    }

    /// Returns the cost of the best end of the first starts, with weights that allow errors of a few per cent.
    pub(super) fn first_cost(&self, options: &FitOptions, cancel: &AtomicBool) -> Option<f64> {
        let mut search = Search::new(&self.fixed, options.seed, options.tuning, cancel);
        search.quick(&self.first, options.starts);
        search.best().map(|end| end.cost)
    }

    /// Returns a search after its first starts, with a time limit.
    pub(super) fn search<'s>(
        &'s self,
        options: &FitOptions,
        late: Late<'s>,
        cancel: &'s AtomicBool,
    ) -> Search<'s> {
        let (seed, tuning) = (options.seed, options.tuning);
        let mut search = Search::new(&self.fixed, seed, tuning, cancel).until(late);
        search.quick(&self.first, options.starts);
        if options.starts_alone {
            search.has_all_starts();
        }
        search.carry_over(&self.first, &self.problem);
        search
    }

    /// Continues a search over the whole box. A model error blurs near minima; the starts of the bright spot count then.
    /// Noise alone can make hundreds of minima.
    pub(super) fn extend(&self, search: &mut Search<'_>, options: &FitOptions) {
        match options.misfit {
            true => search.multistart(&self.problem, options.starts as u32, 0),
            false => search.multistart(&self.problem, 0, options.tuning.first_round as u32),
        }
    }

    /// Combines the best end of a search with the weights to settle it with.
    pub(super) fn settling(&self, best: Minimum, options: &FitOptions) -> WeightedFit<'a> {
        WeightedFit {
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
    options: &FitOptions,
) -> (Vec<Quantity>, Values) {
    for stated in options.held() {
        free.retain(|q| *q != stated.quantity);
        fixed.set_natural(stated.quantity, stated.value);
    }
    (free, fixed)
}

/// Returns the free quantities of a variant on a set, and the values of the others.
#[must_use]
pub fn free_quantities(set: &ObservationSet, variant: Variant) -> (Vec<Quantity>, Values) {
    let absolute = set.white_reference.is_some();
    let metal = matches!(set.material, Material::Conductor { .. });
    let peak = peak(set);
    // The flats at a tilt zero of 0; without flats, 1 and the mean of the prior.
    let (flats, rig) = (&set.flats, &set.rig);
    let white = set.white_reference.filter(|_| !flats.is_empty());
    let by_flats = white
        .and_then(|white| gain_and_stray_light(&white, flats, rig, Angle::ZERO, set.background));
    let (gain, background) = by_flats.map_or((1.0, set.background.mean), |[gain, stray]| {
        (gain.0, stray.0)
    });
    let fixed = Values {
        alpha_u: 0.1,
        alpha_v: 0.1,
        scale: if absolute { gain } else { peak },
        background,
        eta: set.material.index().0,
        k: set.material.index().1,
        ..Values::IDEAL
    };
    let free = Quantity::ALL
        .into_iter()
        .filter(|q| match q {
            // A metal returns no light from below. In the printed lobe, ρd and a free gain are one number.
            Quantity::RhoD => !metal && (absolute || variant == Variant::Sawtooth),
            // The flats determine the gain; a reference without flats fixes it at 1.
            Quantity::Scale => !absolute || !set.flats.is_empty(),
            _ => true,
        })
        .collect();
    (free, fixed)
}
