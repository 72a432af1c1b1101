//! Multistart over register lanes, its stopping rule, and the images of the best end.

use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use super::batched_lm;
use super::sobol_starts;
use super::{Late, Search, same, usable};
use crate::fit::least_squares::levenberg_marquardt::{Ending, Minimum, Settings};
use crate::fit::model_discrepancy::freedom;
use crate::fit::problem::{Problem, Values};
use crate::observation::ObservationSet;

/// Lanes that descend together.
const CHUNK: usize = 256;
/// Relative difference in cost below which the ends of rough descents count as one.
const NEAR_COST: f64 = 1e-4;
/// Maximum number of azimuth lines about which a surface is mirrored.
const LINES: usize = 3;
/// Descents along the valley of the best end.
const CREEPS: usize = 24;

impl Search<'_> {
    /// Descends from starts in the whole box after `tried` others. Each round doubles their number, until [`is_enough`]
    /// and enough of them have reached the best minimum, or until the most starts of the tuning. The search ends with
    /// fewer than `least` only if its time is over.
    pub(in crate::fit) fn multistart(&mut self, problem: &Problem<'_>, tried: u32, least: u32) {
        let most = self.tuning.most_starts as u32;
        let mut tried = tried;
        while tried < most && !self.started && !self.over() {
            let is_confirmed = self.at_minimum() as f64 >= self.tuning.reached;
            if tried >= least
                && is_confirmed
                && is_enough(f64::from(tried), self.near_minima(problem))
            {
                break;
            }
            let count = least.saturating_sub(tried).max(tried).max(1);
            self.round(problem, count);
            tried += count;
        }
    }

    /// Descends from a number of starts in the whole box and refines their different ends.
    pub(in crate::fit) fn round(&mut self, problem: &Problem<'_>, count: u32) {
        if self.started {
            return;
        }
        // Lanes have no derivatives by the index. The descents that refine their ends have them.
        let nominal = problem.with_nominal_index();
        let count = self.affordable(&nominal, count);
        let starts = sobol_starts::starts(&nominal, self.fallback, count, self.next_seed());
        self.descend_from(problem, &nominal, &starts, true);
    }

    /// Descends from starts on a problem without a free index and refines their different ends on `problem`. Each start
    /// counts once at its end. `limited`: none begins after the time limit.
    pub(super) fn descend_from(
        &mut self,
        problem: &Problem<'_>,
        nominal: &Problem<'_>,
        starts: &[Values],
        limited: bool,
    ) {
        let evaluations = self.tuning.evaluations as usize;
        let late = || limited && self.over();
        let ends = descend(nominal, starts, evaluations, &late, self.cancel);
        let most = self.tuning.refined as usize;
        self.refine(nominal, problem, ends, most, NEAR_COST);
    }

    /// Descends from the mirror images of the best end. A scan along few lines of azimuths is nearly its own mirror image
    /// about each of them, and a metal lit in the tilt plane is so at any number of azimuths.
    pub(in crate::fit) fn images(&mut self, problem: &Problem<'_>) {
        if self.started || self.over() {
            return;
        }
        let Some(best) = self.best() else {
            return;
        };
        let found = problem.unpack(&best.parameters).folded();
        let zero = problem.set().rig.azimuth_zero.rad() + problem.set().region_azimuth.rad();
        let ends: Vec<Minimum> = azimuth_lines(problem.set())
            .par_iter()
            .map(|line| {
                let image = Values {
                    azimuth_offset: -found.azimuth_offset - 2.0 * (zero + line),
                    ..found
                };
                problem.descend(&problem.pack(&image), &Settings::FINE, self.cancel)
            })
            .filter(usable)
            .collect();
        self.runs.extend(ends);
    }

    /// Continues the best end while it creeps along a valley, as it does where the data leave a surface undetermined.
    pub(in crate::fit) fn follow_valley(&mut self, problem: &Problem<'_>) {
        for _ in 0..CREEPS {
            let creeping = |m: &&Minimum| m.ending == Ending::MaxIterations;
            let Some(best) = self.best().filter(creeping) else {
                return;
            };
            if self.started || self.over() {
                return;
            }
            let deeper = problem.descend(&best.parameters, &Settings::FINE, self.cancel);
            if !usable(&deeper) || deeper.cost >= best.cost {
                return;
            }
            self.runs.push(deeper);
        }
    }

    /// Number of starts after which the rule ends the search if no further minimum appears.
    pub(in crate::fit) fn starts_expected(&self, problem: &Problem<'_>) -> f64 {
        let found = self.near_minima(problem);
        2.0 * found * found + 3.0 * found + 2.0
    }

    /// Reduces a number of starts to those for which there is time if they descend one by one.
    fn affordable(&self, problem: &Problem<'_>, starts: u32) -> u32 {
        match batched_lm::knows(problem) {
            true => starts,
            false => (f64::from(starts) / self.tuning.one_by_one) as u32,
        }
    }

    /// Number of different minima that are nearly as deep as the best, plus one for all others. If the weights allow for
    /// more than the scatter of the best, the scatter decides.
    fn near_minima(&self, problem: &Problem<'_>) -> f64 {
        let best = self.best().map_or(f64::INFINITY, |m| m.cost);
        let freedom = freedom(problem.residual_count(), problem.free().len());
        let rise = self.tuning.counted_rise * (best / freedom).min(1.0);
        let near = self.runs.iter().map(|m| m.cost);
        let mut near: Vec<f64> = near.filter(|cost| *cost <= best + rise).collect();
        near.sort_by(f64::total_cmp);
        near.dedup_by(|a, b| same(*a, *b));
        near.len() as f64 + 1.0
    }
}

/// Whether `found` minima after `tried` starts are probably all: the expectation of their number by Bayes' rule, with
/// every number and all sizes of their basins equally probable before, exceeds those found by less than a half
/// (Boender and Rinnooy Kan 1987).
fn is_enough(tried: f64, found: f64) -> bool {
    tried > found + 2.0 && found * (tried - 1.0) / (tried - found - 2.0) < found + 0.5
}

/// Runs descents that come near a minimum: as lanes, or one by one if lanes do not support the problem.
fn descend(
    problem: &Problem<'_>,
    starts: &[Values],
    evaluations: usize,
    late: Late<'_>,
    cancel: &AtomicBool,
) -> Vec<Minimum> {
    if batched_lm::knows(problem) {
        let begun = starts.par_chunks(CHUNK).filter(|_| !late());
        return begun
            .filter_map(|chunk| batched_lm::descend_together(problem, chunk, evaluations, cancel))
            .flatten_iter()
            .filter(usable)
            .collect();
    }
    let rough = Settings::ROUGH.within(40);
    let begun = starts.par_iter().filter(|_| !late());
    begun
        .map(|v| problem.descend(&problem.pack(v), &rough, cancel))
        .filter(usable)
        .collect()
}

/// Returns the lines through the axis on which the recorded azimuths lie, rad. A scan along one of them is its own
/// mirror image about the tilt plane. If there are many, no image is exact, and the line at 0 represents all.
fn azimuth_lines(set: &ObservationSet) -> Vec<f64> {
    let mut lines: Vec<f64> = Vec::new();
    for o in &set.observations {
        let line = o.pose.phi_s.rad().rem_euclid(PI);
        let beside = |other: &f64| {
            let apart = (line - other).rem_euclid(PI);
            apart.min(PI - apart) < 1e-3
        };
        if !lines.iter().any(beside) {
            lines.push(line);
        }
        if lines.len() > LINES {
            return vec![0.0];
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rule_asks_for_about_twice_the_square_of_the_minima_found() {
        let least = |found: f64| {
            (1..100_000)
                .map(f64::from)
                .find(|tried| is_enough(*tried, found))
        };
        // 2 w² + 3 w + 2, and the first number above it.
        assert_eq!(least(1.0), Some(8.0));
        assert_eq!(least(10.0), Some(233.0));
        assert_eq!(least(100.0), Some(20_303.0));
    }
}
