//! Settles a minimum: makes its weights consistent with the model error, and adds the higher order.
//!
//! Call [`with_higher_order`]. It does not search; the caller passes the ends of a search. The closed form may rank them
//! wrongly where its error is largest, on steep and rough ridges. A distant surface then fits the data better than the
//! closed form does at the true parameters, and the right one wins only with the second bounce integrated. If the best
//! end keeps a model error that the integrated form never has on ridges of one angle, the other ends are therefore
//! tried with the higher order, too.

use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use super::higher_order::HigherOrder;
use super::least_squares::minimum::{Ending, Minimum, Settings};
use super::least_squares::sum_of_squares;
use super::model_discrepancy::{LOUD, ROUNDS, discrepancy_of, discrepancy_of_few, lightened};
use super::multistart::starts::{SAME_SPOT, distance};
use super::multistart::{AMBIGUOUS_RISE, Search, determined};
use super::problem::{Problem, Values};
use super::{FitOptions, Loss};
use crate::material::Material;
use crate::model::Variant;

/// Discrepancy above which the fit with the higher order is doubted. Fits of traced ideal ridges up to 30° stay below it.
pub(super) const DOUBTFUL: f64 = 0.015;
/// Other ends that are then tried with the higher order.
pub(super) const TRIALS: usize = 6;
/// Observations in the lobe up to which only the final weights separate explanations of its shape.
const FEW_IN_LOBE: usize = 12;
/// Near ends of a search with the final weights that are tried with the higher order.
pub(super) const NEAR_TRIALS: usize = 3;
/// Model error of another end, relative to the best one's, up to which it is equally good if neither describes the
/// data. A model error is not independent from pose to pose, so χ² does not separate them.
const AS_GOOD: f64 = 1.25;
/// Model error of another end without the higher order, relative to the best one's, above which it is not tried with the higher order.
/// The second bounce changes a model error far less, and a fit of moulded ridges took twice the time without this limit.
const HOPELESS: f64 = 4.0;
/// Factor by which the model error of another end of a narrow lobe must be smaller; also that of the closed form
/// compared with the higher order. The light that the closed form omits exists, and the model error estimated from few poses
/// scatters.
const CLEARLY_LESS: f64 = 2.0;
/// Ratio of trimmed squares above which the end with the smaller sum is better.
const FAR_MORE: f64 = 4.0;
/// Maximum passes of higher order and refit.
const TIER_PASSES: usize = 5;
/// Difference of χ² below which the data do not separate the closed form from the higher order: three standard deviations.
const SEPARATED: f64 = 9.0;
/// Change of ridge angle (rad) and logarithm of roughness below which the passes end.
const TIER_STILL: f64 = 1e-4;

/// Trial steps of a descent from another end. Most ends are no better and creep along a valley, which shows early.
const LOOK: u64 = 100;

/// Inputs of the weights of the observations.
pub(super) struct Weighing<'s> {
    /// Standard uncertainties of the observations themselves.
    pub own: &'s [f64],
    /// Scale of the model error of each observation.
    pub scale: &'s [f64],
    /// Weights that a robust loss gave to the observations in an earlier fit, which then replace the loss.
    pub kept: Option<&'s [f64]>,
    /// Number of free parameters without those that only move within a stated uncertainty.
    pub fitted: usize,
    pub options: &'s FitOptions,
    pub cancel: &'s AtomicBool,
}

impl Weighing<'_> {
    /// Standard uncertainties of the observations at a discrepancy.
    pub(super) fn sigma(&self, discrepancy: f64) -> Vec<f64> {
        let sigma = sigma_at(self.own, self.scale, discrepancy);
        match self.kept {
            None => sigma,
            Some(weights) => lightened(&sigma, weights),
        }
    }

    /// Discrepancy that these residuals show.
    fn discrepancy(&self, residuals: &[f64]) -> f64 {
        let (own, scale) = (self.own, self.scale);
        let seen = match self.kept {
            None => discrepancy_of(residuals, own, scale, self.fitted, self.options.loss),
            Some(weights) => {
                let both = residuals.iter().zip(weights);
                let weighed: Vec<f64> = both.map(|(r, w)| r * w.sqrt()).collect();
                discrepancy_of(&weighed, own, scale, self.fitted, Loss::Linear)
            }
        };
        self.at_most(seen)
    }

    fn at_most(&self, discrepancy: f64) -> f64 {
        discrepancy.min(self.options.misfit_most.unwrap_or(f64::INFINITY))
    }
}

/// Standard uncertainties of observations at a discrepancy.
pub(super) fn sigma_at(own: &[f64], scale: &[f64], discrepancy: f64) -> Vec<f64> {
    let both = own.iter().zip(scale);
    both.map(|(o, s)| o.hypot(discrepancy * s)).collect()
}

/// A problem, its minimum, and the discrepancy of its weights.
#[derive(Debug, Clone)]
pub(super) struct WeightedFit<'a> {
    pub problem: Problem<'a>,
    pub minimum: Minimum,
    pub discrepancy: f64,
}

impl WeightedFit<'_> {
    /// All values at the minimum, with the sign of θr as the solver left it.
    pub(super) fn values(&self) -> Values {
        self.problem.unpack(&self.minimum.parameters)
    }

    /// Whether the data leave the surface undetermined here.
    fn open(&self) -> bool {
        !determined(&self.problem, &self.minimum)
    }

    /// Whether so few poses meet the lobe that its shape has more than one explanation.
    fn narrow(&self) -> bool {
        self.in_lobe() <= FEW_IN_LOBE
    }

    /// Whether ridges of one angle never have such a model error.
    fn is_loud(&self) -> bool {
        self.discrepancy > LOUD && self.problem.variant() == Variant::Sawtooth
    }

    /// Whether other surfaces have to be compared with the higher order.
    pub(super) fn has_rivals(&self) -> bool {
        self.narrow() || self.is_loud()
    }

    /// Whether a surface with a much smaller model error is worth looking for.
    pub(super) fn doubted(&self) -> bool {
        self.discrepancy != 0.0 && (self.open() || self.has_rivals())
    }

    /// Number of observations where the facets' lobe exceeds a twentieth of its top.
    fn in_lobe(&self) -> usize {
        let problem = &self.problem;
        let values = self.values();
        let (ready, cones) = (problem.ready(&values), problem.set().rig.cones.widening());
        let (s, c) = values.theta_r.abs().sin_cos();
        let inside = |i: &usize| {
            let d = problem.directions(*i, &ready);
            let h = d.incident + d.outgoing;
            let m = h.y * s + h.z * c;
            let (x, y) = (h.x / m, (h.y * c - h.z * s) / m);
            let along = x * x / (values.alpha_u * values.alpha_u + cones);
            m > 0.0 && along + y * y / (values.alpha_v * values.alpha_v + cones) < 3.0
        };
        (0..problem.set().observations.len()).filter(inside).count()
    }

    /// Runs rounds of discrepancy, weights and refit, and goes to the end of the last one.
    pub(super) fn settle(&mut self, weighing: &Weighing<'_>) {
        self.settle_near(weighing);
        self.minimum = self.again(&self.minimum.parameters, weighing.cancel);
    }

    /// The rounds, whose descents only come near. More digits change no weight, and on a kink of the model they cost hundreds of
    /// steps.
    pub(super) fn settle_near(&mut self, weighing: &Weighing<'_>) {
        self.settle_by(&Settings::NEAR, weighing);
    }

    /// Starts from another end and continues until the model error there is known.
    pub(super) fn settle_from(&mut self, start: &[f64], weighing: &Weighing<'_>) {
        let settings = Settings::NEAR.within(LOOK);
        self.minimum = self.problem.descend(start, &settings, weighing.cancel);
        self.settle_by(&settings, weighing);
    }

    fn settle_by(&mut self, settings: &Settings, weighing: &Weighing<'_>) {
        self.rounds(settings, weighing);
        if weighing.options.misfit {
            self.allow_for_few_poses(settings, weighing);
        }
    }

    /// The rounds alone, for a model whose usual error is not that of the closed form.
    pub(super) fn rounds(&mut self, settings: &Settings, weighing: &Weighing<'_>) {
        for round in 0..ROUNDS {
            let next = match weighing.options.misfit {
                true => weighing.discrepancy(&self.residuals()),
                false => 0.0,
            };
            let settled = (next - self.discrepancy).abs() <= 1e-3 * next;
            self.discrepancy = next;
            self.problem = self.problem.clone().with_sigma(weighing.sigma(next));
            // The first round always descends, because the model may have changed and the weights not.
            if round > 0 && settled || weighing.cancel.load(Ordering::Relaxed) {
                break;
            }
            let from = &self.minimum.parameters;
            self.minimum = self.problem.descend(from, settings, weighing.cancel);
        }
    }

    /// Increases the discrepancy if there are too few poses to determine it.
    fn allow_for_few_poses(&mut self, settings: &Settings, weighing: &Weighing<'_>) {
        let (own, scale, loss) = (weighing.own, weighing.scale, weighing.options.loss);
        let (found, residuals) = (self.discrepancy, self.residuals());
        let few = discrepancy_of_few(found, &residuals, own, scale, weighing.fitted, loss);
        let to_go_by = weighing.at_most(few);
        if to_go_by > found {
            self.discrepancy = to_go_by;
            self.problem = self.problem.clone().with_sigma(weighing.sigma(to_go_by));
            let from = &self.minimum.parameters;
            self.minimum = self.problem.descend(from, settings, weighing.cancel);
        }
    }

    /// Returns the minimum reached from a start.
    pub(super) fn again(&self, start: &[f64], cancel: &AtomicBool) -> Minimum {
        self.problem.descend(start, &Settings::DEFAULT, cancel)
    }

    /// Model minus observation.
    pub(super) fn residuals(&self) -> Vec<f64> {
        self.problem.signal_residuals(&self.values())
    }

    /// χ² of flats and priors.
    fn beside_the_sample(&self) -> f64 {
        let residuals = &self.minimum.residuals;
        let samples = self.problem.set().observations.len();
        sum_of_squares(residuals.get(samples..).unwrap_or_default())
    }

    /// χ² for a linear loss, otherwise the loss itself.
    fn misses(&self, weighing: &Weighing<'_>) -> f64 {
        let pairs = self.residuals().into_iter().zip(weighing.own);
        let loss = weighing.options.loss;
        pairs.map(|(r, o)| loss.bent(r / o).0.powi(2)).sum()
    }

    /// The same with the corrections of the higher order at its own values; `None` if the higher order has no result.
    fn corrected(&self, higher_order: HigherOrder<'_>, weighing: &Weighing<'_>) -> Option<Self> {
        let mut costly = self.clone();
        for pass in 0..TIER_PASSES {
            let values = costly.values();
            let Some(correction) = higher_order(&costly.problem, &values) else {
                if pass == 0 {
                    return None;
                }
                break;
            };
            costly.problem = costly.problem.with_correction(correction);
            costly.settle_near(weighing);
            let now = costly.values();
            let moved = [
                now.theta_r - values.theta_r,
                (now.alpha_u / values.alpha_u).ln(),
                (now.alpha_v / values.alpha_v).ln(),
            ];
            if moved.iter().all(|m| m.abs() < TIER_STILL) || weighing.cancel.load(Ordering::Relaxed)
            {
                break;
            }
        }
        costly.minimum = costly.again(&costly.minimum.parameters, weighing.cancel);
        Some(costly)
    }

    /// Whether noise explains the difference from `other`.
    fn alike(&self, other: &Self, weighing: &Weighing<'_>) -> bool {
        (self.misses(weighing) - other.misses(weighing)).abs() < SEPARATED
    }

    /// Whether this describes most observations better than `other` under a robust loss.
    ///
    /// A surface that fits half of the observations and misses the others cannot come close to more of them than half
    /// plus the free parameters. If one sum of that many smallest squares is far smaller, it decides (least trimmed
    /// squares, Rousseeuw 1984). Otherwise the loss itself decides, with the larger model error of the two.
    pub(super) fn of_more_observations(&self, other: &Self, weighing: &Weighing<'_>) -> bool {
        let count = self.problem.set().observations.len();
        let most = (count + self.problem.free().len()).div_ceil(2);
        let residuals = |s: &Self, discrepancy: f64| -> Vec<f64> {
            let rows = s.residuals().into_iter();
            let weighed = rows.zip(weighing.sigma(discrepancy));
            weighed.map(|(r, s)| r / s).collect()
        };
        let trimmed = |s: &Self| -> f64 {
            let least = self.discrepancy.min(other.discrepancy);
            let mut squares: Vec<f64> = residuals(s, least).iter().map(|r| r * r).collect();
            squares.sort_by(f64::total_cmp);
            squares.iter().take(most).sum()
        };
        let lost = |s: &Self| -> f64 {
            let largest = self.discrepancy.max(other.discrepancy);
            let bent = residuals(s, largest).into_iter();
            bent.map(|r| weighing.options.loss.bent(r).0.powi(2)).sum()
        };
        let (mine, its) = (trimmed(self), trimmed(other));
        if mine > FAR_MORE * its || its > FAR_MORE * mine {
            mine < its
        } else {
            lost(self) < lost(other)
        }
    }

    /// Whether this describes the data so much better than `other` that few poses cannot explain it by chance.
    fn far_better_than(&self, other: &Self, weighing: &Weighing<'_>) -> bool {
        CLEARLY_LESS * self.discrepancy < other.discrepancy
            || self.discrepancy == 0.0 && self.better_than(other, weighing)
    }

    /// Whether this describes the data better than `other`.
    fn better_than(&self, other: &Self, weighing: &Weighing<'_>) -> bool {
        if weighing.options.loss != Loss::Linear {
            self.of_more_observations(other, weighing)
        } else if self.discrepancy == 0.0 && other.discrepancy == 0.0 {
            self.misses(weighing) <= other.misses(weighing)
        } else {
            self.discrepancy < other.discrepancy
        }
    }
}

/// Result of the higher order for the ends of a search.
pub(super) struct Corrected<'a> {
    pub settled: WeightedFit<'a>,
    /// Change of each free parameter by the higher order (units of the solver); zero if it is not in use.
    pub shift: Vec<f64>,
    /// Whether the data do not separate it from the closed form.
    pub undecided: bool,
    /// Whether the answer is now an end other than the search's best.
    pub elsewhere: bool,
    /// Other ends that describe the data equally well.
    pub rivals: Vec<Minimum>,
}

/// Chooses light with or without polarisation. The first reflection polarises light, and the second depends on it. Many
/// renderers omit this for plastic. If the data show that, the closed form and its correction without polarisation are
/// returned. Renderers include it for metals.
fn as_light_is<'a>(
    closed: WeightedFit<'a>,
    higher_order: HigherOrder<'_>,
    weighing: &Weighing<'_>,
) -> (WeightedFit<'a>, Option<WeightedFit<'a>>) {
    if !matches!(closed.problem.set().material, Material::Dielectric { .. }) {
        let costly = closed.corrected(higher_order, weighing);
        return (closed, costly);
    }
    let mut scalar = closed.clone();
    scalar.problem = scalar.problem.with_polarisation(false);
    let (with, without) = rayon::join(
        || closed.corrected(higher_order, weighing),
        || scalar.corrected(higher_order, weighing),
    );
    match (with, without) {
        (Some(with), Some(without))
            if without.better_than(&with, weighing) && !with.better_than(&without, weighing) =>
        {
            (scalar, Some(without))
        }
        (with, _) => (closed, with),
    }
}

/// Returns the best end with the higher order, or without it if the higher order clearly makes it worse (a sample computed from the
/// closed form itself). If noise hides the change by the higher order, the higher order stays, because the light exists. The ends `found`
/// are tried, too: for a lobe that few poses meet, or a model error that ridges never have.
pub(super) fn with_higher_order<'a>(
    closed: WeightedFit<'a>,
    higher_order: HigherOrder<'_>,
    search: &Search<'_>,
    found: &[Minimum],
    weighing: &Weighing<'_>,
) -> Corrected<'a> {
    let (closed, costly) = as_light_is(closed, higher_order, weighing);
    let mut best = closed_or_corrected(&closed, costly, weighing);
    let doubtful = best.settled.discrepancy > DOUBTFUL;
    let mut trials: Vec<Minimum> = found.iter().take(NEAR_TRIALS).cloned().collect();
    if doubtful {
        trials.extend(search.distinct(&closed.problem, &closed.minimum.parameters, TRIALS));
    } else if best.settled.discrepancy == 0.0 {
        trials.clear();
    }
    if !trials.is_empty() && search.over() {
        trials.clear();
    }
    let most = HOPELESS * closed.discrepancy.max(best.settled.discrepancy);
    let different = different(&closed, &trials, most, weighing);
    // Each trial is independent, so that no processor waits for the descents of another.
    let tried: Vec<Option<(WeightedFit<'a>, WeightedFit<'a>)>> = different
        .into_par_iter()
        .map(|trial| {
            let costly = trial.corrected(higher_order, weighing)?;
            (costly.minimum.ending != Ending::NotFinite).then_some((trial, costly))
        })
        .collect();
    if weighing.cancel.load(Ordering::Relaxed) {
        return best;
    }
    let mut others: Vec<WeightedFit<'a>> = Vec::new();
    for (trial, costly) in tried.into_iter().flatten() {
        // Some surface always fits the few poses of a narrow lobe too well.
        let clearly = doubtful || CLEARLY_LESS * costly.discrepancy < best.settled.discrepancy;
        if clearly && costly.better_than(&best.settled, weighing) {
            best.shift = shift(&trial, &costly);
            best.undecided = false;
            best.elsewhere = true;
            others.push(std::mem::replace(&mut best.settled, costly));
        } else {
            others.push(costly);
        }
    }
    if best.settled.discrepancy > 0.0 {
        best.rivals = as_good(&best.settled, others);
    }
    best
}

/// Change of the parameters from one fit to another.
fn shift(from: &WeightedFit<'_>, to: &WeightedFit<'_>) -> Vec<f64> {
    let pairs = to.minimum.parameters.iter().zip(&from.minimum.parameters);
    pairs.map(|(a, b)| a - b).collect()
}

/// Chooses between the closed form and the fit `costly` with the higher order.
fn closed_or_corrected<'a>(
    closed: &WeightedFit<'a>,
    costly: Option<WeightedFit<'a>>,
    weighing: &Weighing<'_>,
) -> Corrected<'a> {
    let mut best = Corrected {
        shift: vec![0.0; closed.minimum.parameters.len()],
        settled: closed.clone(),
        undecided: false,
        elsewhere: false,
        rivals: Vec::new(),
    };
    if let Some(costly) = costly {
        // Model error and χ² are two criteria; either is enough to keep light that exists.
        let better = costly.better_than(closed, weighing)
            || costly.misses(weighing) < closed.misses(weighing);
        let far_worse = closed.far_better_than(&costly, weighing);
        let undecided = costly.alike(closed, weighing) || !(better || far_worse);
        if undecided || better && !far_worse {
            best.shift = shift(closed, &costly);
            best.undecided = undecided;
            best.settled = costly;
        }
    }
    best
}

/// Settles other ends, and returns the fits of different surfaces with a model error of up to `most`.
fn different<'a>(
    closed: &WeightedFit<'a>,
    ends: &[Minimum],
    most: f64,
    weighing: &Weighing<'_>,
) -> Vec<WeightedFit<'a>> {
    let settled = ends.par_iter().map(|end| {
        let mut trial = closed.clone();
        trial.settle_from(&end.parameters, weighing);
        trial
    });
    let settled: Vec<WeightedFit<'a>> = settled.collect();
    let mut surfaces = vec![closed.values().folded()];
    let mut different = Vec::new();
    for trial in settled.into_iter().filter(|t| t.discrepancy <= most) {
        let here = trial.values().folded();
        if surfaces
            .iter()
            .all(|other| distance(other, &here) > SAME_SPOT)
        {
            surfaces.push(here);
            different.push(trial);
        }
    }
    different
}

/// Returns the minima of other surfaces that describe the data as well as `best`, with its model error.
fn as_good(best: &WeightedFit<'_>, others: Vec<WeightedFit<'_>>) -> Vec<Minimum> {
    // A model error is no excuse for missing the flats or the priors.
    let known = best.beside_the_sample();
    let surface = |m: &Minimum| best.problem.unpack(&m.parameters).folded();
    let here = surface(&best.minimum);
    others
        .into_iter()
        .filter(|o| o.discrepancy <= AS_GOOD * best.discrepancy)
        .filter(|o| o.beside_the_sample() <= known + AMBIGUOUS_RISE)
        .map(|o| o.minimum)
        .filter(|m| m.ending.is_success() && distance(&here, &surface(m)) > SAME_SPOT)
        .collect()
}
