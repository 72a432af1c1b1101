//! Descents with suspects freed.

use rayon::prelude::*;

use super::list::{SUSPECTS, Suspect};
use super::{ALIKE, BESIDE, BRIEF, EXPLAINED, Inquiry, OTHERS, TURNED, Trial, has_body};
use crate::fit::causes::downweighting::without_shape;
use crate::fit::causes::findings::{Code, ObservationCause};
use crate::fit::multistart::starts::{ONE_SURFACE, distance};
use crate::fit::problem::{Quantity, THETA_R_MAX, Values};

/// A suspect, the fit with it free, and the suspects that cannot be distinguished from it.
#[derive(Clone)]
pub(super) struct Step<'a> {
    pub(super) suspect: Suspect,
    pub(super) trial: Trial<'a>,
    pub(super) alike: Vec<Code>,
}

/// What explains the residual of a fit.
pub(super) enum Next<'a> {
    /// Terms; empty if nothing explains it.
    Terms(Vec<Step<'a>>),
    /// A cause in the observations.
    ObservationCause(Box<ObservationCause>),
}

impl<'a> Inquiry<'_, 'a> {
    /// Returns what explains the residual of a fit best, by χ² per degree of freedom: a suspect of the surface or a cause in
    /// the observations, or two that do so only together. If nothing does, the index may.
    pub(super) fn next(&self, on: &Trial<'a>, joined: &[Quantity], is_first: bool) -> Next<'a> {
        let most = EXPLAINED * on.minimum.cost;
        let (index, real): (Vec<_>, Vec<_>) = self
            .tried(on, joined)
            .into_iter()
            .partition(|step| step.suspect.code == Code::Index);
        let explains = |step: &Step<'a>| step.trial.minimum.cost < most;
        // Beside a term of the surface, as two suspects together, a cause in the observations must quarter χ²: what the terms
        // themselves miss is large at few poses, too.
        let share = if is_first {
            EXPLAINED
        } else {
            EXPLAINED * EXPLAINED
        };
        let limit = share * self.left(on.minimum.cost, joined.len());
        let cause = self.observation_cause(on, joined.len());
        let mut cause = cause.filter(|cause| cause.left < limit);
        let mut steps = best(real.iter().filter(|s| explains(s)).cloned().collect());
        if steps.is_empty() && is_first {
            steps = best(self.elsewhere(on, joined, most));
        }
        if steps.is_empty() {
            if cause.is_none() && is_first {
                let after = real.iter().take(OTHERS);
                let after =
                    after.filter_map(|step| self.observation_cause(&step.trial, joined.len() + 1));
                let after = after.filter(|cause| cause.left < EXPLAINED * limit);
                cause = after.min_by(|a, b| a.left.total_cmp(&b.left));
            }
            if is_first {
                steps = self.pair(&real, joined, EXPLAINED * most);
            }
        }
        let by_terms = steps.last().map_or(f64::INFINITY, |last| {
            self.left(last.trial.minimum.cost, joined.len() + steps.len())
        });
        match cause {
            Some(cause) if cause.left < by_terms && (!cause.is_open || steps.is_empty()) => {
                Next::ObservationCause(Box::new(cause))
            }
            _ if steps.is_empty() => {
                Next::Terms(best(index.into_iter().filter(explains).collect()))
            }
            _ => Next::Terms(steps),
        }
    }

    /// Frees each suspect in addition to a fit and lists those that are there, best first.
    fn tried(&self, on: &Trial<'a>, joined: &[Quantity]) -> Vec<Step<'a>> {
        let body = has_body(self.e);
        // On a goniometer the lamp has no place beside the camera.
        let turns = !self.e.problem.set().is_of_goniometer();
        let flats = !self.e.problem.set().flats.is_empty();
        let may = |s: &&Suspect| {
            !joined.contains(&s.quantity)
                && (body || s.quantity != Quantity::Translucency)
                && (turns || s.quantity != Quantity::LampTurn)
                && (flats || s.code != Code::WhiteReference)
                && !self.e.held.contains(&s.quantity)
        };
        let suspects: Vec<Suspect> = SUSPECTS.iter().filter(may).copied().collect();
        let tried = suspects.into_par_iter().filter_map(|suspect| {
            let trial = self.freed(on, suspect)?;
            Some(Step {
                suspect,
                trial,
                alike: Vec::new(),
            })
        });
        let is_there = |step: &Step<'a>| {
            let values = step.trial.values();
            let much = values.inner(step.suspect.quantity).abs();
            match step.suspect.code {
                Code::Index | Code::WhiteReference => true,
                // A plane that is tilted imitates gentle ridges that lean the other way.
                Code::WedgeAcross if much > 0.5 * values.theta_r.abs() => false,
                // Beside a flat surface, any ridges explain what little light is left.
                Code::FlatLands if !self.sees_facets(&values) => false,
                _ => much > step.suspect.least,
            }
        };
        let mut there: Vec<Step<'a>> = tried.filter(is_there).collect();
        by_cost(&mut there);
        there
    }

    /// Whether a pose comes near the lobe of the facets: its half vector leans as far as their normal, or nearly so.
    fn sees_facets(&self, values: &Values) -> bool {
        let set = self.e.problem.set();
        let leans = (0..set.observations.len()).map(|i| {
            let rig = set.rig_directions(i);
            let h = rig.incident + rig.outgoing;
            h.x.hypot(h.y).atan2(h.z)
        });
        let reached = leans.fold(0.0, f64::max);
        values.theta_r.abs() < reached + 2.0 * values.alpha_u.max(values.alpha_v)
    }

    /// Lists the suspects that explain the residual of a fit from other ends of the search: without the term, another
    /// surface may have described the data better than the right one. The second bounce joins at the end, because it
    /// takes longest.
    fn elsewhere(&self, on: &Trial<'a>, joined: &[Quantity], most: f64) -> Vec<Step<'a>> {
        let here = on.values();
        let count = self.e.problem.set().observations.len();
        let high = TURNED * self.e.minimum.cost;
        let ends = self.e.elsewhere.iter().filter(|end| end.cost < high);
        let ends = ends.take(OTHERS);
        let ends = ends.map(|end| self.with_terms_of(&here, &end.parameters));
        // The light of a term may have been taken for that of risers.
        let exchanged = [here.exchanged()].into_iter();
        let exchanged = exchanged.filter(|there| there.theta_r < THETA_R_MAX);
        let ends = ends.chain(exchanged).filter_map(|there| {
            let problem = on.problem.clone().with_fixed(there).with_walls_of(&there);
            let problem = problem.with_correction(vec![0.0; count]);
            let start = problem.pack(&there);
            self.descended_by(&BRIEF, problem, &start)
        });
        let without_index = with(joined, Quantity::Eta);
        let tried = ends.flat_map(|end| self.tried(&end, &without_index));
        let explaining = tried.filter(|step| step.trial.minimum.cost < most);
        let corrected = explaining.filter_map(|step| {
            let there = step.trial.values();
            let problem = self.corrected(step.trial.problem, &there)?;
            let trial = self.descended(problem, &step.trial.minimum.parameters)?;
            Some(Step { trial, ..step })
        });
        corrected
            .filter(|step| step.trial.minimum.cost < most)
            .collect()
    }

    /// Returns the best two suspects that explain the residual together, from those tried alone; none if they leave more
    /// than `most`.
    fn pair(&self, alone: &[Step<'a>], joined: &[Quantity], most: f64) -> Vec<Step<'a>> {
        let pairs = alone.iter().take(OTHERS).filter_map(|first| {
            let settled = with(&with(joined, first.suspect.quantity), Quantity::Eta);
            let second = self.tried(&first.trial, &settled).into_iter().next()?;
            (second.trial.minimum.cost < most).then(|| vec![first.clone(), second])
        });
        pairs
            .min_by(|a, b| a[1].trial.minimum.cost.total_cmp(&b[1].trial.minimum.cost))
            .unwrap_or_default()
    }

    /// Frees a suspect in addition to a fit, with the walls at its own result.
    fn freed(&self, on: &Trial<'a>, suspect: Suspect) -> Option<Trial<'a>> {
        let here = on.values();
        let mut free = on.problem.free().to_vec();
        if !free.contains(&suspect.quantity) {
            free.push(suspect.quantity);
        }
        let mut problem = on.problem.clone().with_fixed(here).with_free(free);
        if suspect.starts.is_empty() {
            problem = match suspect.code {
                Code::WhiteReference => problem.with_flat_sigma(without_shape(on.problem.set())),
                _ => problem.without_priors(&[Quantity::Eta]),
            };
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
    pub(super) fn or_elsewhere(&self, found: Trial<'a>) -> Trial<'a> {
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
    pub(super) fn with_terms_of(&self, here: &Values, end: &[f64]) -> Values {
        let mut there = self.e.problem.unpack(end);
        for q in Quantity::REAL {
            there.set_inner(q, here.inner(q));
        }
        there
    }
}

/// Returns a list with one more quantity.
fn with(joined: &[Quantity], q: Quantity) -> Vec<Quantity> {
    joined.iter().copied().chain([q]).collect()
}

/// Sorts steps, lowest cost first.
fn by_cost(steps: &mut [Step<'_>]) {
    steps.sort_by(|a, b| a.trial.minimum.cost.total_cmp(&b.trial.minimum.cost));
}

/// Returns the best step with the codes of those that cannot be distinguished from it; empty if there is none.
fn best(mut steps: Vec<Step<'_>>) -> Vec<Step<'_>> {
    by_cost(&mut steps);
    let Some(mut best) = steps.first().cloned() else {
        return Vec::new();
    };
    let least = ALIKE * best.trial.minimum.cost;
    for other in &steps[1..] {
        let code = other.suspect.code;
        let is_new = code != best.suspect.code && !best.alike.contains(&code);
        if is_new && other.trial.minimum.cost < least {
            best.alike.push(code);
        }
    }
    vec![best]
}
