//! What a sample may have that an ideal sawtooth has not, asked one by one where the closed form misses the data.
//!
//! The one function to call is [`investigated`]. Where the residual is above what the closed form itself misses on ideal ridges,
//! each suspect (a translucent body, tails of the slopes, rounded crests, another index) is freed alone, from the minimum that is
//! there: one more descent each. A suspect explains the residual where χ² falls below half; the best one joins the fit, and
//! another one on top of it where that halves χ² again and stays inside its range. The index is never taken over: it has a certificate.
//!
//! χ² counts each observation with its own uncertainty and with what the closed form misses anyway (0.07 % of the signal and
//! 0.04 % of the peak), not with the discrepancy of the fit that is in question.

use rayon::prelude::*;

use super::estimate::{Estimate, Tier};
use super::findings::{Code, Finding, sorted};
use super::misfit::{LEAST_WEIGHT, freedom, misfit_scale, peak};
use super::problem::{Problem, Quantity, Values};
use super::search::{AMBIGUOUS_RISE, ONE_SURFACE, usable};
use super::settle::{Settled, Weighing};
use super::solver::{Minimum, Settings, minimise};
use super::start::distance;
use super::{FitOptions, Loss};
use crate::material::Material;
use crate::model::Variant;
use std::sync::atomic::AtomicBool;

/// Misfit (root mean square over the peak) that the closed form itself leaves on ideal ridges, traced.
const OWN_MISFIT: f64 = 1.5e-3;
/// What it misses of a signal and of the peak at the right surface.
const MISSES: (f64, f64) = (7e-4, 4e-4);
/// Share of χ² that a suspect may leave to be named.
const EXPLAINED: f64 = 0.5;
/// Ratio of χ² up to which two suspects cannot be told apart.
const ALIKE: f64 = 2.0;
/// Passes of walls, tier and refit at most, and the change of ridge angle (rad) below which they stay.
const PASSES: usize = 4;
const STILL: f64 = 2e-5;
/// Terms that join a fit at most.
const JOINING: usize = 2;

/// One thing to suspect.
#[derive(Debug, Clone, Copy)]
struct Suspect {
    code: Code,
    quantity: Quantity,
    /// From where it is looked for.
    starts: &'static [f64],
    /// Below it the quantity is as good as not there.
    least: f64,
}

const SUSPECTS: [Suspect; 4] = [
    Suspect {
        code: Code::Translucent,
        quantity: Quantity::Translucency,
        starts: &[0.4],
        least: 0.04,
    },
    Suspect {
        code: Code::Tails,
        quantity: Quantity::Tail,
        starts: &[0.3],
        least: 0.02,
    },
    Suspect {
        code: Code::RoundedCrests,
        quantity: Quantity::CrestRadius,
        starts: &[0.04, 0.1],
        least: 0.01,
    },
    Suspect {
        code: Code::Index,
        quantity: Quantity::Eta,
        starts: &[],
        least: 0.0,
    },
];

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

/// The estimate with what explains its residual in it, and with its findings. `tier` is the integrated second bounce.
pub(super) fn investigated<'a>(
    e: Estimate<'a>,
    options: &FitOptions,
    tier: Option<Tier<'_>>,
    cancel: &AtomicBool,
) -> Estimate<'a> {
    let told = told(&e, options);
    if !can_be_asked(&e) {
        return e;
    }
    let doubted = options.misfit && misfit(&e) > OWN_MISFIT;
    if !doubted && told.is_empty() {
        return e;
    }
    let inquiry = Inquiry {
        e: &e,
        options,
        tier,
        cancel,
        joined: &[],
    };
    inquiry.run(&told, doubted).unwrap_or(e)
}

/// Estimates of several scans of one sample, each investigated; what joins the fit of one joins those of all.
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

/// Whether the form has the terms, and sees all observations at once.
fn can_be_asked(e: &Estimate<'_>) -> bool {
    e.problem.variant() == Variant::Sawtooth && e.thinned.is_none()
}

/// What is stated of the real terms.
fn told(e: &Estimate<'_>, options: &FitOptions) -> Vec<Quantity> {
    let body = has_body(e);
    let stated = options.told.iter().map(|t| t.quantity);
    let of_set = e.problem.set().translucency.map(|_| Quantity::Translucency);
    let real = |q: &Quantity| Quantity::REAL.contains(q) && (body || *q != Quantity::Translucency);
    let mut told: Vec<Quantity> = stated.chain(of_set).filter(real).collect();
    told.sort_unstable();
    told.dedup();
    told
}

/// Whether light comes back from below the surface.
fn has_body(e: &Estimate<'_>) -> bool {
    matches!(e.problem.set().material, Material::Dielectric { .. })
}

/// Misfit of the model as a share of the peak, root mean square.
fn misfit(e: &Estimate<'_>) -> f64 {
    let square: f64 = e.misfit.iter().map(|m| m * m).sum();
    (square / e.misfit.len().max(1) as f64).sqrt() / peak(e.problem.set())
}

struct Inquiry<'i, 'a> {
    e: &'i Estimate<'a>,
    options: &'i FitOptions,
    tier: Option<Tier<'i>>,
    cancel: &'i AtomicBool,
    /// What joins the fit whatever the data say, and from where it starts.
    joined: &'i [(Quantity, f64)],
}

impl<'a> Inquiry<'_, 'a> {
    fn run(&self, told: &[Quantity], doubted: bool) -> Option<Estimate<'a>> {
        let mut trial = self.base(told)?;
        let before = trial.values().folded().theta_r;
        let mut findings = Vec::new();
        let mut joined: Vec<Quantity> = told.to_vec();
        for _ in 0..if doubted { JOINING } else { 0 } {
            let ranked = self.ranked(&trial, &joined);
            let Some((best, first)) = ranked.first().cloned() else {
                break;
            };
            let ratio = |t: &Trial<'_>| t.minimum.cost / trial.minimum.cost;
            let explains = ratio(&first);
            let alike = ranked[1..]
                .iter()
                .filter(|(_, other)| ratio(other) < ALIKE * explains);
            let alike: Vec<Code> = alike.map(|(suspect, _)| suspect.code).collect();
            findings.push(self.finding(best, &first, before, 1.0 - explains, &alike));
            if best.code == Code::Index {
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

    /// Standard uncertainties of the observations in χ² of the suspects.
    fn sigma(&self) -> Vec<f64> {
        let set = self.e.problem.set();
        let floor = MISSES.1 * peak(set);
        let each = set.observations.iter().zip(&self.e.loss_weights);
        each.map(|(o, w)| {
            let sigma = o.sigma.hypot(MISSES.0 * o.signal).hypot(floor);
            sigma / w.max(LEAST_WEIGHT).sqrt()
        })
        .collect()
    }

    /// The problem with rough walls and what is stated of the real terms, at its minimum.
    fn base(&self, told: &[Quantity]) -> Option<Trial<'a>> {
        let e = self.e;
        let mut values = e.values;
        let mut free = e.problem.free().to_vec();
        for q in told {
            let user = self.options.told.iter().rev().find(|t| t.quantity == *q);
            let (mean, std) = match (user, e.problem.set().translucency) {
                (Some(told), _) => (told.value, told.std),
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

    /// The same problem with the tier's correction at these values.
    fn corrected(&self, problem: Problem<'a>, values: &Values) -> Option<Problem<'a>> {
        let Some(tier) = self.tier else {
            return Some(problem);
        };
        let added = tier(&problem, values)?;
        Some(problem.with_correction(added))
    }

    fn descended(&self, problem: Problem<'a>, start: &[f64]) -> Option<Trial<'a>> {
        let settings = Settings::default();
        let minimum = minimise(&problem, start, &problem.bounds(), &settings, self.cancel);
        usable(&minimum).then_some(Trial { problem, minimum })
    }

    /// Suspects that explain what a fit leaves, each free on top of it, most first.
    fn ranked(&self, on: &Trial<'a>, joined: &[Quantity]) -> Vec<(Suspect, Trial<'a>)> {
        let body = has_body(self.e);
        let may = |s: &&Suspect| {
            !joined.contains(&s.quantity)
                && (body || s.quantity != Quantity::Translucency)
                && !self.e.held.contains(&s.quantity)
        };
        let suspects: Vec<Suspect> = SUSPECTS.iter().filter(may).copied().collect();
        let tried: Vec<(Suspect, Trial<'a>)> = suspects
            .into_par_iter()
            .filter_map(|suspect| Some((suspect, self.freed(on, suspect)?)))
            .collect();
        let explains = |(suspect, trial): &(Suspect, Trial<'a>)| {
            let there = match suspect.code {
                Code::Index => true,
                _ => trial.values().inner(suspect.quantity) > suspect.least,
            };
            there && trial.minimum.cost < EXPLAINED * on.minimum.cost
        };
        let mut ranked: Vec<_> = tried.into_iter().filter(explains).collect();
        ranked.sort_by(|a, b| a.1.minimum.cost.total_cmp(&b.1.minimum.cost));
        // What the index explains a term of the surface explains better, if it does at all.
        if ranked.iter().any(|(s, _)| s.code != Code::Index) {
            ranked.retain(|(s, _)| s.code != Code::Index);
        }
        ranked
    }

    /// A suspect free on top of a fit, the walls those of what it comes to.
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

    /// What is told of a suspect.
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
                "{:.0} % of the light that enters the plastic leaves evenly over the ridges; the fit accounts for it. State \
                 sample.translucency with its uncertainty if it is known of this material",
                100.0 * values.real.translucency
            ),
            Code::Tails => {
                "the facets' lobe has longer tails than Beckmann's; the fit accounts for it by Student's t slopes: compare \
                 roughness by the half width (slope_distribution), not by α"
                    .to_owned()
            }
            Code::RoundedCrests => format!(
                "the crests are round, by a radius of {:.2} of the facets' length, to first order; a measured profile or \
                 height map (--variant traced --shape FILE) makes θr surer",
                values.real.crest
            ),
            _ => format!(
                "the data want an index of {:.3} where {:.3} was stated: check the material and the white reference's \
                 certificate",
                values.eta,
                self.e.problem.set().material.index().0
            ),
        };
        if !alike.is_empty() {
            let others: Vec<&str> = alike.iter().map(|code| code.word()).collect();
            advice += &format!("; these data do not tell it from: {}", others.join(", "));
        }
        Finding {
            code: suspect.code,
            explains,
            change_of_theta_r_deg: Some((values.theta_r - before).to_degrees()),
            advice,
        }
    }

    /// The fit with all that joined, weights, walls and tier at its own values.
    fn settled(&self, trial: Trial<'a>, joined: usize) -> Option<Estimate<'a>> {
        let e = self.e;
        let set = e.problem.set();
        let fitted = e.fitted + joined;
        let own: Vec<f64> = set
            .observations
            .iter()
            .zip(&e.loss_weights)
            .map(|(o, w)| o.sigma / w.max(LEAST_WEIGHT).sqrt())
            .collect();
        let scale = misfit_scale(set);
        let linear = FitOptions {
            loss: Loss::Linear,
            ..self.options.clone()
        };
        let weighing = Weighing {
            own: &own,
            scale: &scale,
            fitted,
            options: &linear,
            cancel: self.cancel,
        };
        let mut settled = Settled {
            problem: trial.problem,
            minimum: trial.minimum,
            discrepancy: e.discrepancy,
        };
        for _ in 0..PASSES {
            let before = settled.problem.unpack(&settled.minimum.parameters);
            let problem = settled.problem.clone().with_walls_of(&before);
            settled.problem = self.corrected(problem, &before)?;
            settled.settle(&weighing);
            let now = settled.problem.unpack(&settled.minimum.parameters);
            if (now.theta_r - before.theta_r).abs() < STILL {
                break;
            }
        }
        if !usable(&settled.minimum) {
            return None;
        }
        Some(self.estimate(settled, &weighing))
    }

    fn estimate(&self, settled: Settled<'a>, weighing: &Weighing<'_>) -> Estimate<'a> {
        let e = self.e;
        let Settled {
            problem,
            minimum,
            discrepancy,
        } = settled;
        let set = problem.set();
        let values = problem.unpack(&minimum.parameters);
        let predicted = problem.predicted(&values);
        let residuals = predicted.iter().zip(&set.observations);
        let residuals: Vec<f64> = residuals.map(|(p, o)| p - o.signal).collect();
        let count = residuals.len();
        let squares = |weight: &dyn Fn(usize) -> f64| -> f64 {
            let each = residuals.iter().enumerate();
            each.map(|(i, r)| e.loss_weights[i] * (r * weight(i)).powi(2))
                .sum()
        };
        let descend = |problem: &Problem<'a>, start: &[f64]| {
            let bounds = problem.bounds();
            minimise(problem, start, &bounds, &Settings::default(), self.cancel)
        };
        // How far the tier moves each parameter.
        let closed = problem.clone().with_correction(vec![0.0; count]);
        let closed = descend(&closed, &minimum.parameters);
        let shift = minimum.parameters.iter().zip(&closed.parameters);
        let tier_shift = match usable(&closed) {
            true => shift.map(|(a, b)| a - b).collect(),
            false => vec![0.0; minimum.parameters.len()],
        };
        // Other surfaces are judged by the form that is reported.
        let here = values.folded();
        let rivals = e.rivals.par_iter().map(|rival| {
            let mut there = e.problem.unpack(&rival.parameters);
            there.real = values.real;
            descend(&problem, &problem.pack(&there))
        });
        let rivals: Vec<Minimum> = rivals.collect();
        let rivals = rivals.into_iter().filter(|m| {
            let there = problem.unpack(&m.parameters).folded();
            let near = m.cost - minimum.cost < AMBIGUOUS_RISE;
            usable(m) && near && distance(&there, &here) > ONE_SURFACE
        });
        Estimate {
            rivals: rivals.collect(),
            chi2_reduced_without_model: squares(&|i| 1.0 / set.observations[i].sigma)
                / freedom(count, weighing.fitted),
            rms_residual: (squares(&|_| 1.0 / peak(set)) / count.max(1) as f64).sqrt(),
            misfit: weighing.scale.iter().map(|s| discrepancy * s).collect(),
            discrepancy,
            fitted: weighing.fitted,
            values,
            tier_shift,
            tier_undecided: false,
            explained: true,
            minimum,
            problem,
            ..e.clone()
        }
    }
}
