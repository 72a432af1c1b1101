//! Deviations of a sample from an ideal sawtooth, tried one by one if the closed form leaves a residual.
//!
//! Call [`investigated`]. If the residual exceeds that of the closed form on ideal ridges, or poses stand out, each suspect
//! (a translucent body, tails of the slopes, rounded crests, a tilt of the sample, a lamp beside its stated place,
//! another index) is freed separately, with one more descent from the existing minimum. A suspect explains the residual if χ²
//! falls below half. The best suspect joins the fit; so does one more if it halves χ² again and stays inside its range. The
//! index never joins, because it has a certificate.
//!
//! χ² counts each observation with its own uncertainty and the usual error of the closed form (0.07 % of the signal and
//! 0.04 % of the peak), not with the discrepancy of the fit that is examined.

mod list;
mod settled;
#[cfg(test)]
mod tests;

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use super::blunders::{bad_block, bad_poses};
use super::estimate::Estimate;
use super::findings::{Code, Finding, sorted};
use super::misfit::{lightened, peak};
use super::problem::{Problem, Quantity, Values};
use super::search::{ONE_SURFACE, usable};
use super::solver::{Minimum, Settings, minimise};
use super::start::distance;
use super::tier::Tier;
use super::{FitOptions, Loss};
use crate::material::Material;
use crate::model::Variant;
use list::{SUSPECTS, Suspect};

/// Model error of the closed form on traced ideal ridges (root mean square, relative to the peak).
const OWN_MISFIT: f64 = 1.5e-3;
/// Usual model error at the right surface, as a share of the signal and of the peak.
const MISSES: (f64, f64) = (7e-4, 4e-4);
/// Largest share of χ² that a reported suspect may leave.
const EXPLAINED: f64 = 0.5;
/// Ratio of χ² up to which two suspects cannot be distinguished.
const ALIKE: f64 = 2.0;
/// Maximum passes of walls, tier and refit, and the change of ridge angle (rad) below which they end.
const PASSES: usize = 4;
const STILL: f64 = 2e-5;
/// Number of other ends of the search that are tried with the terms that join.
const OTHERS: usize = 3;
/// Such a descent first goes on for so long; most end at another surface.
const BRIEF: Settings = Settings {
    max_iterations: 30,
    ..Settings::DEFAULT
};
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
}

/// Returns the estimate with the terms that explain its residual, and with its findings. `tier` is the integrated
/// second bounce.
pub(super) fn investigated<'a>(
    e: Estimate<'a>,
    options: &FitOptions,
    tier: Option<Tier<'_>>,
    cancel: &AtomicBool,
) -> Estimate<'a> {
    let stated = stated(&e, options);
    if !can_be_asked(&e) {
        return e;
    }
    // Poses are to blame for what no property of sample and rig explains.
    let stands_out = |e| bad_poses(e).is_some() || bad_block(e).is_some();
    let doubted = options.misfit && (misfit(&e) > OWN_MISFIT || stands_out(&e));
    if !doubted && stated.is_empty() {
        return e;
    }
    let inquiry = Inquiry {
        e: &e,
        options,
        tier,
        cancel,
        joined: &[],
    };
    inquiry.run(&stated, doubted).unwrap_or(e)
}

/// Investigates several scans of one sample. A term that joins the fit of one scan joins those of all.
pub(super) fn agreed<'a>(
    alone: Vec<Estimate<'a>>,
    options: &FitOptions,
    tier: Option<Tier<'_>>,
    cancel: &AtomicBool,
) -> Vec<Estimate<'a>> {
    let first: Vec<Estimate<'a>> = alone
        .par_iter()
        .map(|e| investigated(e.clone(), options, tier, cancel))
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
                tier,
                cancel,
                joined: &joined,
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

/// Model error as a share of the peak, root mean square.
fn misfit(e: &Estimate<'_>) -> f64 {
    let square: f64 = e.misfit.iter().map(|m| m * m).sum();
    (square / e.misfit.len().max(1) as f64).sqrt() / peak(e.problem.set())
}

struct Inquiry<'i, 'a> {
    e: &'i Estimate<'a>,
    options: &'i FitOptions,
    tier: Option<Tier<'i>>,
    cancel: &'i AtomicBool,
    /// Terms that join the fit in any case, with their starting values.
    joined: &'i [(Quantity, f64)],
}

impl<'a> Inquiry<'_, 'a> {
    fn run(&self, stated: &[Quantity], doubted: bool) -> Option<Estimate<'a>> {
        let mut trial = self.base(stated)?;
        let before = trial.values().folded().theta_r;
        let mut findings = Vec::new();
        let mut joined: Vec<Quantity> = stated.to_vec();
        for _ in 0..if doubted { JOINING } else { 0 } {
            let ranked = self.ranked(&trial, &joined);
            let Some((best, first)) = ranked.first().cloned() else {
                break;
            };
            let ratio = |t: &Trial<'_>| t.minimum.cost / trial.minimum.cost;
            let least = ALIKE * ratio(&first);
            let alike = ranked[1..].iter().filter(|(_, other)| ratio(other) < least);
            let alike: Vec<Code> = alike.map(|(suspect, _)| suspect.code).collect();
            let joins = best.code != Code::Index;
            let first = match joins {
                true => self.or_elsewhere(first),
                false => first,
            };
            let explains = 1.0 - ratio(&first);
            findings.push(self.finding(best, &first, before, explains, &alike));
            if !joins {
                break;
            }
            joined.push(best.quantity);
            trial = first;
        }
        let mut settled = if joined.is_empty() {
            self.e.clone()
        } else {
            self.settled(trial, joined.len())?
        };
        settled.findings = sorted(findings);
        settled.investigated = doubted;
        Some(settled)
    }

    /// Standard uncertainties of the observations in the χ² of the suspects.
    fn sigma(&self) -> Vec<f64> {
        let set = self.e.problem.set();
        let floor = MISSES.1 * peak(set);
        let each = set.observations.iter();
        let sigma = each.map(|o| o.sigma.hypot(MISSES.0 * o.signal).hypot(floor));
        lightened(&sigma.collect::<Vec<f64>>(), &self.e.loss_weights)
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
        let problem = problem.with_factor(ones).with_sigma(self.sigma());
        let problem = problem.with_loss(Loss::Linear).with_fixed(values);
        let problem = problem.with_free(free).with_walls_of(&values);
        let problem = self.corrected(problem, &values)?;
        let start = problem.pack(&values);
        self.descended(problem, &start)
    }

    /// Returns the same problem with the correction of the tier at these values.
    fn corrected(&self, problem: Problem<'a>, values: &Values) -> Option<Problem<'a>> {
        let Some(tier) = self.tier else {
            return Some(problem);
        };
        let added = tier(&problem, values)?;
        Some(problem.with_correction(added))
    }

    fn descended(&self, problem: Problem<'a>, start: &[f64]) -> Option<Trial<'a>> {
        self.descended_by(&Settings::DEFAULT, problem, start)
    }

    fn descended_by(
        &self,
        settings: &Settings,
        problem: Problem<'a>,
        start: &[f64],
    ) -> Option<Trial<'a>> {
        let minimum = minimise(&problem, start, &problem.bounds(), settings, self.cancel);
        usable(&minimum).then_some(Trial { problem, minimum })
    }

    /// Lists the suspects that explain the residual of a fit, each free in addition to it, best first.
    fn ranked(&self, on: &Trial<'a>, joined: &[Quantity]) -> Vec<(Suspect, Trial<'a>)> {
        let body = has_body(self.e);
        // On a goniometer the lamp has no place beside the camera.
        let turns = !self.e.problem.set().is_of_goniometer();
        let may = |s: &&Suspect| {
            !joined.contains(&s.quantity)
                && (body || s.quantity != Quantity::Translucency)
                && (turns || s.quantity != Quantity::LampTurn)
                && !self.e.held.contains(&s.quantity)
        };
        let suspects: Vec<Suspect> = SUSPECTS.iter().filter(may).copied().collect();
        let tried: Vec<(Suspect, Trial<'a>)> = suspects
            .into_par_iter()
            .filter_map(|suspect| Some((suspect, self.freed(on, suspect)?)))
            .collect();
        let explains = |(suspect, trial): &(Suspect, Trial<'a>)| {
            let values = trial.values();
            let much = values.inner(suspect.quantity).abs();
            let there = match suspect.code {
                Code::Index => true,
                // A plane that is tilted imitates gentle ridges that lean the other way.
                Code::WedgeAcross if much > 0.5 * values.theta_r.abs() => false,
                _ => much > suspect.least,
            };
            there && trial.minimum.cost < EXPLAINED * on.minimum.cost
        };
        let mut ranked: Vec<_> = tried.into_iter().filter(explains).collect();
        ranked.sort_by(|a, b| a.1.minimum.cost.total_cmp(&b.1.minimum.cost));
        // If a term of the surface explains the residual at all, it is preferred to the index.
        if ranked.iter().any(|(s, _)| s.code != Code::Index) {
            ranked.retain(|(s, _)| s.code != Code::Index);
        }
        ranked
    }

    /// Frees a suspect in addition to a fit, with the walls at its own result.
    fn freed(&self, on: &Trial<'a>, suspect: Suspect) -> Option<Trial<'a>> {
        let here = on.values();
        let mut free = on.problem.free().to_vec();
        if !free.contains(&suspect.quantity) {
            free.push(suspect.quantity);
        }
        let mut problem = on.problem.clone().with_fixed(here).with_free(free);
        if suspect.code == Code::Index {
            problem = problem.without_priors(&[Quantity::Eta]);
            return self.descended(problem.clone(), &problem.pack(&here));
        }
        let ends = suspect.starts.iter().filter_map(|start| {
            let mut values = here;
            values.set_inner(suspect.quantity, *start);
            let from = problem.pack(&values);
            let near = self.descended(problem.clone().with_walls_of(&values), &from)?;
            let values = near.values();
            self.descended(
                near.problem.with_walls_of(&values),
                &near.minimum.parameters,
            )
        });
        ends.min_by(|a, b| a.minimum.cost.total_cmp(&b.minimum.cost))
    }

    /// Starts a trial again from the other ends of the search and beside it, and returns the best. Without the term that
    /// joins, the right surface may have been one of them.
    fn or_elsewhere(&self, found: Trial<'a>) -> Trial<'a> {
        let here = found.values();
        let moves = found.problem.free().contains(&Quantity::ThetaR);
        let beside = BESIDE.iter().filter(|_| moves).map(|factor| Values {
            theta_r: factor * here.theta_r,
            ..here
        });
        let ends = self.e.elsewhere.iter().take(OTHERS);
        let ends = ends.map(|end| self.with_terms_of(&here, &end.parameters));
        let starts: Vec<Values> = ends.chain(beside).collect();
        let others = starts.into_par_iter().filter_map(|there| {
            if distance(&there.folded(), &here.folded()) < ONE_SURFACE {
                return None;
            }
            let problem = found
                .problem
                .clone()
                .with_fixed(there)
                .with_walls_of(&there);
            let start = problem.pack(&there);
            let near = self.descended_by(&BRIEF, problem, &start)?;
            if near.minimum.cost > ALIKE * found.minimum.cost {
                return None;
            }
            let there = near.values();
            let problem = self.corrected(near.problem.with_walls_of(&there), &there)?;
            self.descended(problem, &near.minimum.parameters)
        });
        let others: Vec<Trial<'a>> = others.collect();
        let all = others.into_iter().chain(std::iter::once(found));
        all.min_by(|a, b| a.minimum.cost.total_cmp(&b.minimum.cost))
            .expect("one is there")
    }

    /// Returns the values at an end of the search, with the terms of `here`.
    fn with_terms_of(&self, here: &Values, end: &[f64]) -> Values {
        let mut there = self.e.problem.unpack(end);
        for q in Quantity::REAL {
            there.set_inner(q, here.inner(q));
        }
        there
    }

    /// Describes a suspect.
    fn finding(
        &self,
        suspect: Suspect,
        found: &Trial<'_>,
        before: f64,
        explains: f64,
        alike: &[Code],
    ) -> Finding {
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
            Code::RoundedCrests => format!(
                "The crests are rounded with a radius of {:.2} of the facet length; the fit includes this to first order. \
                 To reduce the uncertainty of θr, use a measured profile or height map (--variant traced --shape FILE).",
                values.real.crest
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
