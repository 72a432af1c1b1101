//! One variant fitted to one set of observations: what is free, how far to search, and which of the ends counts.
//!
//! Call [`estimate`]. How far the model may miss, and so the weights, is `misfit`'s; that they fit what they are
//! computed from is `settle`'s.

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use super::covariance::{Scaling, covariance};
use super::edges;
use super::findings::Finding;
use super::misfit::{explained, freedom, lightened, loss_weights, peak};
use super::opening::{Opening, THOROUGH_ROUNDS};
use super::problem::{Problem, Quantity, Values};
use super::search::{
    AMBIGUOUS_RISE, Late, ONE_SURFACE, Search, StartReport, many_minima, same, usable,
};
use super::settle::{Settled, Weighing, with_tier};
use super::solver::{Ending, Minimum, Settings};
use super::start::distance;
use super::thin::{self, Thinned};
use super::traced::Tracing;
use super::{FitOptions, Loss, Told};
use crate::material::Material;
use crate::model::Variant;
use crate::observation::{ObservationSet, Prior};

/// Rise of the cost up to which the near minima of a search are weighed again.
const RIVAL_RISE: f64 = 25.0;
/// Edges of the closed form that are crossed one after the other.
const EDGES_CROSSED: usize = 8;
/// How often a search goes on from what its last steps came to.
const DEEPER_STILL: usize = 3;
/// How many times smaller a misfit is that makes another end of the search the better one.
const FAR_LESS: f64 = 4.0;

/// A fitted variant.
#[derive(Debug, Clone)]
pub struct Estimate<'a> {
    /// The problem with its final weights and corrections.
    pub problem: Problem<'a>,
    /// The minimum, in the solver's parameters.
    pub minimum: Minimum,
    /// All values, θr signed as the solver left it (see [`Values::folded`]).
    pub values: Values,
    /// Discrepancy d, as a share of s (see `misfit`).
    pub discrepancy: f64,
    /// Standard uncertainty of each observation that stands for the model's misfit, d·s.
    pub misfit: Vec<f64>,
    /// What the starts did.
    pub starts: StartReport,
    /// χ² per degree of freedom with counting noise alone.
    pub chi2_reduced_without_model: f64,
    /// Root mean square residual of the samples as a share of the largest signal.
    pub rms_residual: f64,
    /// Free parameters without those that only move within a stated uncertainty.
    pub fitted: usize,
    /// How far the costly tier moved each free parameter (solver's units); zero without it.
    pub tier_shift: Vec<f64>,
    /// Whether the data do not tell the tier from the closed form without it.
    pub tier_undecided: bool,
    /// Weight that the loss left each observation, 1 where it counts in full.
    pub loss_weights: Vec<f64>,
    /// Whether the scatter is what noise, or a small misfit of the model, accounts for. If not, no
    /// start may have found the lobe.
    pub explained: bool,
    /// Quantities that the user holds.
    pub held: Vec<Quantity>,
    /// Other minima that the data do not exclude at the coverage of the report.
    pub rivals: Vec<Minimum>,
    /// What the ray tracer did, where the estimate hangs on it.
    pub traced: Option<Tracing>,
    /// Where the tolerance allowed to leave the costly tier out: what it changes, as a share of the peak.
    pub tier_left_out: Option<f64>,
    /// Whether time was over before other explanations of the data had been looked for.
    pub cut_short: bool,
    /// What was done without, where there are very many observations.
    pub thinned: Option<Thinned>,
    /// What explains the residual that an ideal sawtooth leaves, most first.
    pub findings: Vec<Finding>,
    /// Whether the residual was such that what real samples have was asked for.
    pub investigated: bool,
}

impl Estimate<'_> {
    /// Whether the costly tier's corrections are in use.
    pub(super) fn takes_tier(&self) -> bool {
        self.tier_shift.iter().any(|s| *s != 0.0)
    }
}

/// What is free for a variant on a set, and the values of the rest.
#[must_use]
pub fn free_quantities(set: &ObservationSet, variant: Variant) -> (Vec<Quantity>, Values) {
    let absolute = set.white_reference.is_some();
    let metal = matches!(set.material, Material::Conductor { .. });
    let peak = peak(set);
    let (gain, background) = from_flats(set);
    let fixed = Values {
        theta_r: 0.0,
        alpha_u: 0.1,
        alpha_v: 0.1,
        rho_d: 0.0,
        scale: if absolute { gain } else { peak },
        background,
        azimuth_offset: 0.0,
        tilt_offset: 0.0,
        eta: set.material.index().0,
        k: set.material.index().1,
        real: crate::model::extended::Real::NONE,
    };
    let free = Quantity::ALL
        .into_iter()
        .filter(|q| match q {
            // Metal sends nothing back from below. Printed lobe and free gain are one number.
            Quantity::RhoD => !metal && (absolute || variant == Variant::Sawtooth),
            // The flats carry the gain; a reference without flats leaves it at 1.
            Quantity::Scale => !absolute || !set.flats.is_empty(),
            _ => true,
        })
        .collect();
    (free, fixed)
}

/// Gain and stray light that the flats and the prior on stray light give at a tilt zero of 0, or
/// 1 and the prior's mean without flats.
fn from_flats(set: &ObservationSet) -> (f64, f64) {
    let prior = set.background;
    let Some(white) = set.white_reference.filter(|_| !set.flats.is_empty()) else {
        return (1.0, prior.mean);
    };
    // Normal equations of two unknowns.
    let weight = 1.0 / (prior.std * prior.std);
    let (mut aa, mut ab, mut bb) = (0.0, 0.0, weight);
    let (mut ay, mut by) = (0.0, weight * prior.mean);
    for flat in &set.flats {
        let a = white.reflectance / std::f64::consts::PI * set.rig.cos_incidence(flat.theta_c);
        let w = 1.0 / (flat.sigma * flat.sigma);
        aa += w * a * a;
        ab += w * a;
        bb += w;
        ay += w * a * flat.signal;
        by += w * flat.signal;
    }
    let determinant = aa * bb - ab * ab;
    let gain = (ay * bb - by * ab) / determinant;
    let background = (aa * by - ab * ay) / determinant;
    if gain.is_finite() && background.is_finite() && gain > 0.0 {
        (gain, background)
    } else {
        (1.0, prior.mean)
    }
}

/// A costlier tier of the model: radiances to add to the closed form's at given values, one per
/// observation; `None` where it has nothing to say.
pub type Tier<'t> = &'t (dyn Fn(&Problem<'_>, &Values) -> Option<Vec<f64>> + Sync);

/// Fits one variant. `None` where nothing could be evaluated at all.
#[must_use]
pub fn estimate<'a>(
    set: &'a ObservationSet,
    variant: Variant,
    options: &FitOptions,
    tier: Option<Tier<'_>>,
    cancel: &AtomicBool,
) -> Option<Estimate<'a>> {
    estimate_until(set, variant, options, tier, &|| false, cancel)
}

/// The same; once it is late no other explanations of the data are looked for, and the best so far is the answer.
#[must_use]
pub fn estimate_until<'a>(
    set: &'a ObservationSet,
    variant: Variant,
    options: &FitOptions,
    tier: Option<Tier<'_>>,
    late: Late<'_>,
    cancel: &AtomicBool,
) -> Option<Estimate<'a>> {
    let fitted = |options: &FitOptions| match thin::representative(set) {
        Some(kept) => thin::estimate(set, kept, variant, options, tier, late, cancel),
        None => whole(set, variant, options, tier, late, cancel),
    };
    let found = fitted(options)?;
    let stated = options.told.iter().any(|told| told.std > 0.0);
    let may = options.misfit && options.misfit_most.is_none() && found.discrepancy > 0.0;
    if !(stated && may) || late() {
        return Some(found);
    }
    // A statement that the data deny must not pass for a misfit of the model, which would take their weight away (and
    // hide that they deny it): how far the model misses is for the data alone to say, where they determine a surface.
    let held = |told: &&Told| told.std == 0.0;
    let alone = fitted(&FitOptions {
        told: options.told.iter().filter(held).copied().collect(),
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

/// Whether the data leave no direction open.
fn is_determined(e: &Estimate<'_>) -> bool {
    let end = &e.minimum;
    let rows = end.residuals.len();
    covariance(&end.jacobian, rows, &end.residuals, Scaling::Absolute)
        .null_directions
        .is_empty()
}

/// Something known beforehand that the data deny.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Denial {
    /// Of what.
    pub quantity: Quantity,
    /// What was known.
    pub prior: Prior,
    /// Whether the user stated it; else it is a certificate's or what a rig is like.
    pub told: bool,
    /// Between what was known and what the data say, in standard deviations of that difference.
    pub deviations: f64,
    /// Share that what was known has in the fitted value.
    pub leverage: f64,
}

/// Standard deviations between what was known and what the data say from which on that is told.
const DENIED: f64 = 4.0;
/// Share of what is known of a parameter that its prior is taken to have at most: more would magnify rounding.
const LEVERAGE_MAX: f64 = 0.9996;

/// What was known beforehand and the data deny. A residual r = (x − prior)/σ of leverage h, which the fit itself has
/// pulled, is r/√(1 − h) standard deviations of the difference between data and prior.
pub(super) fn denials(e: &Estimate<'_>) -> Vec<Denial> {
    let (problem, end) = (&e.problem, &e.minimum);
    let rows = end.residuals.len();
    let first = rows.saturating_sub(problem.priors().len());
    let free = problem.free();
    if rows != problem.residual_count() || free.len() * rows != end.jacobian.len() {
        return Vec::new();
    }
    let covariance = covariance(&end.jacobian, rows, &end.residuals, Scaling::Absolute).matrix;
    let priors = problem.priors().iter().zip(first..);
    priors
        .filter_map(|((quantity, prior), row)| {
            let j = free.iter().position(|free| free == quantity)?;
            let slope = end.jacobian[row + j * rows];
            let leverage = (slope * slope * covariance[(j, j)]).clamp(0.0, LEVERAGE_MAX);
            let deviations = end.residuals[row].abs() / (1.0 - leverage).sqrt();
            (deviations > DENIED).then(|| Denial {
                quantity: *quantity,
                prior: *prior,
                told: problem.told().iter().any(|(told, _)| told == quantity),
                deviations,
                leverage,
            })
        })
        .collect()
}

/// The same with every step on all observations.
pub(super) fn whole<'a>(
    set: &'a ObservationSet,
    variant: Variant,
    options: &FitOptions,
    tier: Option<Tier<'_>>,
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
    let mut narrow: Vec<Minimum> = Vec::new();
    if options.misfit && tier.is_some() && settled.narrow() && !search.over() {
        narrow = search.look_again(&settled.problem, &settled.minimum);
    }
    // The weights of the starts may rank near minima wrongly; the final ones decide.
    let mut rivals: Vec<Minimum> = Vec::new();
    let mut weights_moved = false;
    for other in &candidates {
        if search.over() {
            break;
        }
        let again = settled.again(&other.parameters, cancel);
        if again.cost < settled.minimum.cost && again.ending != Ending::NotFinite {
            rivals.push(std::mem::replace(&mut settled.minimum, again));
            settled.settle(&weighing);
            weights_moved = true;
        } else {
            rivals.push(again);
        }
    }
    for _ in 0..EDGES_CROSSED {
        if search.over() {
            break;
        }
        let behind = edges::beyond(&settled.problem, &settled.minimum);
        let ends = behind.par_iter().map(|x| settled.again(x, cancel));
        let deepest = ends.filter(usable).min_by(|a, b| a.cost.total_cmp(&b.cost));
        let Some(deeper) = deepest.filter(|m| !same(settled.minimum.cost, m.cost)) else {
            break;
        };
        rivals.push(std::mem::replace(&mut settled.minimum, deeper));
        settled.settle(&weighing);
        weights_moved = true;
    }
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
    let tier_left_out = tier.and_then(|tier| thin::dispensable(&settled, tier, options));
    if let Some(tier) = tier.filter(|_| tier_left_out.is_none()) {
        let found = with_tier(settled, tier, &search, &narrow, &weighing);
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
        tier_left_out,
    };
    Some(conclude(reached, variant, &weighing))
}

/// A search to its end.
fn looked_for<'s>(
    opening: &'s Opening<'_>,
    options: &FitOptions,
    late: Late<'s>,
    cancel: &'s AtomicBool,
) -> Search<'s> {
    let mut search = opening.search(options, late, cancel);
    let problem = &opening.problem;
    let mut rounds = 0;
    if few_directions(problem.set()) && !search.over() {
        search.thorough(problem);
        search.rescan(problem);
        search.images(problem);
        rounds += 1;
    }
    if opening.rounds(&search, options) == 0 && !search.over() {
        search.mirror_image(problem);
    }
    while rounds < opening.rounds(&search, options) && !search.over() {
        search.thorough(problem);
        search.rescan(problem);
        // A metal lit in the tilt plane is nearly its own mirror image at any number of azimuths.
        search.images(problem);
        rounds += 1;
    }
    if options.misfit {
        search.follow(problem);
        return search;
    }
    for _ in 0..DEEPER_STILL {
        let cost = |search: &Search<'_>| search.best().map_or(f64::INFINITY, |m| m.cost);
        let before = cost(&search);
        if search.over() {
            break;
        }
        search.persist(problem, opening.likely());
        // What is found late has images, too, and what they lead to is looked around again.
        if !same(before, cost(&search)) && !search.over() {
            search.images(problem);
        }
        search.follow(problem);
        if same(before, cost(&search)) {
            break;
        }
    }
    search
}

/// Of the end under a robust loss and the one that its descent comes to from the fit without: the one that describes most
/// observations better. A robust loss forgives whole groups of observations, so a surface that passes through half of them
/// and misses the rest by far is a minimum too.
fn of_most_observations<'a>(
    settled: Settled<'a>,
    variant: Variant,
    weighing: &Weighing<'_>,
    late: Late<'_>,
) -> Settled<'a> {
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

/// A surface that describes the data with no misfit, or far less of it, if there is one.
///
/// The weights of the first search forgive every end a few per cent of the peak. Where few poses meet the
/// lobe that is enough for surfaces far from the true one, so ends are looked for that need less. Once noise
/// alone explains the data, and they leave the surface open, the deepest of the many minima counts.
fn with_less_misfit<'a>(
    mut settled: Settled<'a>,
    search: &mut Search<'_>,
    weighing: &Weighing<'_>,
) -> Settled<'a> {
    let cancel = weighing.cancel;
    for _ in 0..THOROUGH_ROUNDS {
        if !settled.doubted() || search.over() {
            break;
        }
        if settled.open() {
            search.look_hard();
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
            // Most are no better, and creep along a valley: that is seen long before their last digit.
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
        && many_minima(&settled.problem, &settled.minimum)
        && !search.over()
    {
        search.noise_alone(&settled);
        // Without a misfit no cost is suspicious.
        search.persist(&settled.problem, f64::INFINITY);
        settled.minimum = search.best().cloned().unwrap_or(settled.minimum);
    }
    settled
}

/// Where a search and the descents after it have come to.
pub(super) struct Reached<'a> {
    /// Whether time was over before the search was.
    pub cut_short: bool,
    pub settled: Settled<'a>,
    pub shift: Vec<f64>,
    pub undecided: bool,
    pub starts: StartReport,
    pub rivals: Vec<Minimum>,
    pub tier_left_out: Option<f64>,
}

/// The estimate at a settled minimum.
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
        tier_left_out,
    } = reached;
    let Weighing {
        own,
        scale,
        fitted,
        options,
        cancel,
    } = *weighing;
    let Settled {
        mut problem,
        mut minimum,
        discrepancy,
    } = settled;
    let set = problem.set();
    minimum = edges::cleared(&problem, minimum);
    let values = problem.unpack(&minimum.parameters);
    let predicted = problem.predicted(&values);
    let loss_weights = loss_weights(&problem, &values, options.loss);
    if options.loss != Loss::Linear {
        // The same point as the minimum of least squares, in which form the budget reads it.
        let sigma = lightened(&problem, &loss_weights);
        problem = problem.with_loss(Loss::Linear).with_sigma(sigma);
        let bounds = problem.bounds();
        let settings = Settings::default();
        minimum = thin::minimise(&problem, &minimum.parameters, &bounds, &settings, cancel);
    }
    let squares = |weight: &dyn Fn(usize) -> f64| -> f64 {
        let pairs = predicted.iter().zip(&set.observations).enumerate();
        pairs
            .map(|(i, (p, o))| loss_weights[i] * ((p - o.signal) * weight(i)).powi(2))
            .sum()
    };
    let count = set.observations.len();
    let freedom = freedom(count, fitted);
    let explained = explained(variant, options, discrepancy, minimum.cost, freedom);
    let peak = peak(set);
    Estimate {
        chi2_reduced_without_model: squares(&|i| 1.0 / own[i]) / freedom,
        rms_residual: (squares(&|_| 1.0 / peak) / count as f64).sqrt(),
        misfit: scale.iter().map(|s| discrepancy * s).collect(),
        discrepancy,
        fitted,
        starts,
        values,
        minimum,
        problem,
        tier_shift: shift,
        tier_undecided: undecided,
        loss_weights,
        explained,
        held: options
            .told
            .iter()
            .filter(|t| t.std == 0.0)
            .map(|t| t.quantity)
            .collect(),
        rivals,
        traced: None,
        tier_left_out,
        cut_short,
        thinned: None,
        findings: Vec::new(),
        investigated: false,
    }
}

/// Whether the poses are so few, or their azimuths, that near symmetries make near minima.
pub(super) fn few_directions(set: &ObservationSet) -> bool {
    let mut azimuths: Vec<i64> = set
        .observations
        .iter()
        .map(|o| ((o.pose.phi_s.deg() * 10.0).round() as i64).rem_euclid(3600))
        .collect();
    azimuths.sort_unstable();
    azimuths.dedup();
    azimuths.len() <= 4 || set.observations.len() <= 24
}
