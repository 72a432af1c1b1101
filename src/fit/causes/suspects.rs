//! Deviations of a sample from an ideal sawtooth, tried one by one if the closed form leaves a residual.
//!
//! Call [`investigated`]. χ² counts each observation with its own uncertainty and the usual error of the closed form (0.07 %
//! of the signal and 0.04 % of the peak), not with the discrepancy of the fit that is examined. If it is unusually large for
//! its degrees of freedom, or poses stand out, each suspect (a translucent body, tails of the slopes, rounded crests, flat
//! lands between the ridges, a tilt of the sample, a lamp beside its stated place, a white reference that is not Lambertian,
//! another index) is freed separately, with one more descent from the existing minimum. A suspect explains the residual if
//! χ² falls below half. The best suspect joins the fit; so does one more if χ² is still too large, if it halves χ² again and
//! stays inside its range. If no suspect explains the residual alone, other ends of the search are tried, and then two
//! suspects together, which must quarter χ². The index never joins, because it has a certificate.

mod in_observations;
mod list;
mod settled;
#[cfg(test)]
mod tests;
mod tried;

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use super::bad_poses::{bad_block, bad_poses};
use super::downweighting::white_reference;
use super::findings::{Code, Finding, sorted};
use crate::fit::estimate::Estimate;
use crate::fit::higher_order::HigherOrder;
use crate::fit::least_squares::levenberg_marquardt::{Minimum, Settings};
use crate::fit::model_discrepancy::{freedom, lightened, usual_errors};
use crate::fit::multistart::usable;
use crate::fit::problem::{Problem, Quantity, Values};
use crate::fit::{FitOptions, Loss};
use crate::material::Material;
use crate::model::Variant;
pub(in crate::fit) use in_observations::OBSERVATION_CAUSES;
use tried::{Next, Step};

/// Largest share of χ² that a reported suspect may leave.
const EXPLAINED: f64 = 0.5;
/// Ratio of χ² up to which two suspects cannot be distinguished.
const ALIKE: f64 = 2.0;
/// Cost of another end of the search, relative to that of the minimum, up to which a term may turn the order.
const TURNED: f64 = 10.0;
/// Maximum passes of walls, higher order and refit, and the change of ridge angle (rad) below which they end.
const TERM_PASSES: usize = 4;
const TERM_STILL: f64 = 2e-5;
/// Number of other ends of the search that are tried with a term, and of terms that are tried with a second one.
const OTHERS: usize = 3;
/// Such a descent first goes on for so long; most end at another surface.
const BRIEF: Settings = Settings::NEAR.within(30);
/// Factors of θr of two more starts with the terms that join.
const BESIDE: [f64; 2] = [0.85, 1.0 / 0.85];
/// Maximum number of terms that join a fit.
const JOINING: usize = 2;

/// A problem with a suspect free, at its minimum.
#[derive(Clone)]
struct Trial<'a> {
    problem: Problem<'a>,
    minimum: Minimum,
}

impl Trial<'_> {
    fn values(&self) -> Values {
        self.problem.unpack(&self.minimum.parameters)
    }

    /// Whether the residuals ask for an explanation, with `fitted` parameters.
    fn is_unexplained(&self, fitted: usize) -> bool {
        let count = self.problem.set().observations.len();
        let rows = &self.minimum.residuals[..count];
        is_large(rows.iter().map(|r| r * r).sum(), freedom(count, fitted))
    }
}

/// Returns the estimate with the terms that explain its residual, and with its findings. `higher_order` is the integrated
/// second bounce. Causes in the observations are tried but for those that are `excluded`; if one explains more, the estimate is
/// returned as it was, with it.
pub(in crate::fit) fn investigated<'a>(
    e: Estimate<'a>,
    options: &FitOptions,
    higher_order: Option<HigherOrder<'_>>,
    excluded: &[Code],
    cancel: &AtomicBool,
) -> Estimate<'a> {
    let stated = stated(&e, options);
    if !can_be_asked(&e) {
        return e;
    }
    // Poses are to blame for what no property of sample and rig explains.
    let stands_out = |e| bad_poses(e).is_some() || bad_block(e).is_some();
    let doubted = options.misfit && (is_unexplained(&e) || stands_out(&e));
    if !doubted && stated.is_empty() {
        return e;
    }
    let inquiry = Inquiry {
        e: &e,
        options,
        higher_order,
        cancel,
        joined: &[],
        excluded,
    };
    inquiry.run(&stated, doubted).unwrap_or(e)
}

/// Investigates several scans of one sample. A term that joins the fit of one scan joins those of all.
pub(in crate::fit) fn agreed<'a>(
    alone: Vec<Estimate<'a>>,
    options: &FitOptions,
    higher_order: Option<HigherOrder<'_>>,
    cancel: &AtomicBool,
) -> Vec<Estimate<'a>> {
    let first: Vec<Estimate<'a>> = alone
        .par_iter()
        .map(|e| {
            investigated(
                e.clone(),
                options,
                higher_order,
                &OBSERVATION_CAUSES,
                cancel,
            )
        })
        .collect();
    let real = |e: &Estimate<'_>, q: Quantity| {
        let there = e.problem.is_extended() && e.problem.free().contains(&q);
        there.then(|| (q, e.values.inner(q)))
    };
    let joined: Vec<(Quantity, f64)> = Quantity::REAL
        .into_iter()
        .filter_map(|q| first.iter().find_map(|e| real(e, q)))
        .collect();
    if joined.is_empty() {
        return first;
    }
    let all = |e: &Estimate<'_>| joined.iter().all(|(q, _)| real(e, *q).is_some());
    let pairs = alone.into_par_iter().zip(first);
    pairs
        .map(|(ideal, found)| {
            if all(&found) || !can_be_asked(&ideal) {
                return found;
            }
            let inquiry = Inquiry {
                e: &ideal,
                options,
                higher_order,
                cancel,
                joined: &joined,
                excluded: &OBSERVATION_CAUSES,
            };
            let quantities: Vec<Quantity> = joined.iter().map(|(q, _)| *q).collect();
            let forced = inquiry.run(&quantities, false).unwrap_or(found.clone());
            Estimate {
                findings: found.findings,
                ..forced
            }
        })
        .collect()
}

/// Whether the form has the terms and uses all observations at once.
fn can_be_asked(e: &Estimate<'_>) -> bool {
    e.problem.variant() == Variant::Sawtooth && e.thinned.is_none()
}

/// Lists the real terms for which values are stated.
fn stated(e: &Estimate<'_>, options: &FitOptions) -> Vec<Quantity> {
    let body = has_body(e);
    let by_user = options.constraints.iter().map(|t| t.quantity);
    let of_set = e.problem.set().translucency.map(|_| Quantity::Translucency);
    let real = |q: &Quantity| Quantity::REAL.contains(q) && (body || *q != Quantity::Translucency);
    let mut stated: Vec<Quantity> = by_user.chain(of_set).filter(real).collect();
    stated.sort_unstable();
    stated.dedup();
    stated
}

/// Whether light returns from below the surface.
fn has_body(e: &Estimate<'_>) -> bool {
    matches!(e.problem.set().material, Material::Dielectric { .. })
}

/// Whether the residuals of an estimate exceed noise and the usual error of the closed form.
fn is_unexplained(e: &Estimate<'_>) -> bool {
    let set = e.problem.set();
    let sigma = usual(e);
    let residuals = e.problem.signal_residuals(&e.values).into_iter();
    let chi2 = residuals.zip(&sigma).map(|(r, s)| (r / s).powi(2)).sum();
    is_large(chi2, freedom(set.observations.len(), e.fitted))
}

/// Whether χ² exceeds its degrees of freedom by more than two of its standard deviations.
fn is_large(chi2: f64, freedom: f64) -> bool {
    chi2 > freedom + 2.0 * (2.0 * freedom).sqrt()
}

/// Standard uncertainties of the observations in the χ² of the suspects.
fn usual(e: &Estimate<'_>) -> Vec<f64> {
    let set = e.problem.set();
    let each = set.observations.iter().zip(usual_errors(set));
    let sigma = each.map(|(o, error)| o.sigma.hypot(error));
    lightened(&sigma.collect::<Vec<f64>>(), &e.loss_weights)
}

struct Inquiry<'i, 'a> {
    e: &'i Estimate<'a>,
    options: &'i FitOptions,
    higher_order: Option<HigherOrder<'i>>,
    cancel: &'i AtomicBool,
    /// Terms that join the fit in any case, with their starting values.
    joined: &'i [(Quantity, f64)],
    /// Causes in the observations that are not tried.
    excluded: &'i [Code],
}

impl<'a> Inquiry<'_, 'a> {
    fn run(&self, stated: &[Quantity], doubted: bool) -> Option<Estimate<'a>> {
        let mut trial = self.base(stated)?;
        let before = trial.values().folded().theta_r;
        let mut findings = Vec::new();
        let mut joined: Vec<Quantity> = stated.to_vec();
        let mut tried = false;
        while doubted
            && joined.len() < stated.len() + JOINING
            && trial.is_unexplained(self.e.fitted + joined.len())
        {
            tried = true;
            let mut steps = match self.next(&trial, &joined, joined.len() == stated.len()) {
                Next::Terms(steps) => steps,
                Next::ObservationCause(cause) => {
                    return Some(Estimate {
                        observation_cause: Some(cause),
                        ..self.e.clone()
                    });
                }
            };
            let Some(last) = steps.pop() else {
                break;
            };
            let is_index = last.suspect.code == Code::Index;
            steps.push(match is_index {
                true => last,
                false => Step {
                    trial: self.or_elsewhere(last.trial),
                    ..last
                },
            });
            for step in steps {
                let explains = 1.0 - step.trial.minimum.cost / trial.minimum.cost;
                findings.push(self.finding(&step, before, explains));
                if !is_index {
                    joined.push(step.suspect.quantity);
                    trial = step.trial;
                }
            }
            if is_index {
                break;
            }
        }
        let mut settled = if joined.is_empty() {
            self.e.clone()
        } else {
            self.settled(trial, joined.len())?
        };
        settled.findings = sorted(findings);
        settled.investigated = tried;
        settled.poses_tried = tried && !self.excluded.contains(&Code::BadPose);
        Some(settled)
    }

    /// Returns the problem with rough walls and the stated real terms, at its minimum.
    fn base(&self, stated: &[Quantity]) -> Option<Trial<'a>> {
        let e = self.e;
        let mut values = e.values;
        let mut free = e.problem.free().to_vec();
        for q in stated {
            let user = self
                .options
                .constraints
                .iter()
                .rev()
                .find(|t| t.quantity == *q);
            let (mean, std) = match (user, e.problem.set().translucency) {
                (Some(user), _) => (user.value, user.std),
                (None, Some(prior)) if *q == Quantity::Translucency => (prior.mean, prior.std),
                _ => match self.joined.iter().find(|(joined, _)| joined == q) {
                    Some((_, start)) => (*start, f64::INFINITY),
                    None => continue,
                },
            };
            values.set_inner(*q, mean);
            if std > 0.0 && !free.contains(q) {
                free.push(*q);
            }
        }
        let ones = vec![1.0; e.problem.set().observations.len()];
        let problem = e.problem.clone();
        let problem = problem.with_factor(ones).with_sigma(usual(e));
        let problem = problem.with_loss(Loss::Linear).with_fixed(values);
        let problem = problem.with_free(free).with_walls_of(&values);
        let problem = self.corrected(problem, &values)?;
        let start = problem.pack(&values);
        self.descended(problem, &start)
    }

    /// Returns the same problem with the correction of the higher order at these values.
    fn corrected(&self, problem: Problem<'a>, values: &Values) -> Option<Problem<'a>> {
        let Some(higher_order) = self.higher_order else {
            return Some(problem);
        };
        let added = higher_order(&problem, values)?;
        Some(problem.with_correction(added))
    }

    /// Descends near to the minimum: suspects are compared by factors of χ².
    fn descended(&self, problem: Problem<'a>, start: &[f64]) -> Option<Trial<'a>> {
        self.descended_by(&Settings::NEAR, problem, start)
    }

    fn descended_by(
        &self,
        settings: &Settings,
        problem: Problem<'a>,
        start: &[f64],
    ) -> Option<Trial<'a>> {
        let minimum = problem.descend(start, settings, self.cancel);
        usable(&minimum).then_some(Trial { problem, minimum })
    }

    /// Describes a suspect.
    fn finding(&self, step: &Step<'_>, before: f64, explains: f64) -> Finding {
        let Step {
            suspect,
            trial: found,
            alike,
        } = step;
        let values = found.values().folded();
        let mut advice = match suspect.code {
            Code::Translucent => format!(
                "{:.0} % of the light that enters the plastic leaves evenly over the ridges; the fit includes this. If \
                 the value is known for this material, set sample.translucency with its uncertainty.",
                100.0 * values.real.translucency
            ),
            Code::Tails => {
                "The slope distribution of the facets has longer tails than Beckmann's; the fit uses Student's t. Compare \
                 roughness by the half width (slope_distribution), not by α."
                    .to_owned()
            }
            Code::WedgeAcross => format!(
                "The sample is tilted by {:.2}° across the ridges; the fit includes this. A tilt along the other direction \
                 shifts θr degree for degree, and no frame shows it: level the sample, or turn it by 180° on the table and \
                 average.",
                values.wedge.to_degrees().abs()
            ),
            Code::LampAzimuth => format!(
                "The lamp is turned by {:.1}° about the camera's axis from its stated place; the fit includes this. Align the \
                 lamp, or set rig.light_azimuth_deg to {:.1}.",
                values.lamp_turn.to_degrees(),
                self.e.problem.set().rig.light_azimuth.deg() + values.lamp_turn.to_degrees()
            ),
            Code::WhiteReference => white_reference(),
            Code::RoundedCrests => format!(
                "The crests are rounded with a radius of {:.2} of the facet length; the fit includes this to first order. \
                 To reduce the uncertainty of θr, use a measured profile or height map (--variant traced --shape FILE).",
                values.real.crest
            ),
            Code::FlatLands => format!(
                "{:.1} % of the surface is flat between the ridges; the fit includes this. θr, roughness and ρd are those of \
                 the ridges.",
                100.0 * values.real.land
            ),
            _ => format!(
                "The data give an index of {:.3}, but {:.3} is stated. Check the material and the certificate of the \
                 white reference.",
                values.eta,
                self.e.problem.set().material.index().0
            ),
        };
        if !alike.is_empty() {
            let others: Vec<&str> = alike.iter().map(|code| code.word()).collect();
            advice += &format!(
                " These data cannot distinguish it from: {}.",
                others.join(", ")
            );
        }
        Finding {
            code: suspect.code,
            explains,
            change_of_theta_r_deg: Some((values.theta_r - before).to_degrees()),
            advice,
        }
    }
}
