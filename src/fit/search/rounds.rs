//! Rounds of a thorough search: unselected starts, children of known ends, other roughnesses, descents along valleys,
//! mirror images, and the rule that ends the search.

use std::f64::consts::PI;
use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use super::super::candidates;
use super::super::crew;
use super::super::estimate::few_directions;
use super::super::problem::{Problem, Values};
use super::super::projection::settle;
use super::super::solver::{Ending, Minimum, Settings, minimise};
use crate::observation::ObservationSet;

use super::{
    CALM, Effort, FINE, FOLLOWED, Late, OTHER_ROUGHNESSES, PATIENT, PROMISING_EVERY, REFINED,
    REFINED_THOROUGHLY, ROUGH, Search, many_minima, over_shapes, same, usable,
};

/// Settings of a descent along a valley.
const FOLLOW: Settings = Settings {
    cost_tolerance: 1e-12,
    ..Settings::DEFAULT
};
/// Maximum number of rounds.
const PERSISTENT_ROUNDS: usize = 24;

/// One in this many descents continues after all have come near.
const GOING_ON: usize = 6;
/// Starts of a round: from the whole box, from its rim, and children of known ends in each generation (later
/// generations are also children of earlier ones).
const PLAIN: u32 = 1536;
const RIM: u32 = 1536;
const CHILDREN: u32 = 1024;
const GENERATIONS: u32 = 2;
/// Divisor of the number of starts if they descend one by one instead of as lanes.
const ONE_BY_ONE: u32 = 16;
/// Starts of a first glance, half of them from the rim: for many directions, and for few.
const GLANCE: u32 = 128;
const GLANCE_OF_FEW: u32 = 2048;
/// Number of different ends that have children.
const PARENTS: usize = 24;
/// Lanes that descend together.
const CHUNK: usize = 256;
/// Evaluations after which one in `LANES_GOING_ON` lanes continues.
const EVALUATIONS_FIRST: usize = 20;
const LANES_GOING_ON: usize = 4;
/// Starts that descend to their ends, from the whole box and as many from its rim; how often rounds have them; how many
/// descend together; and their maximum number of evaluations.
const CREEPING: u32 = 64;
const CREEPING_EVERY: usize = 2;
const CHUNK_CREEPING: usize = 32;
const EVALUATIONS_CREEPING: usize = 400;
/// Number of different ends of unselected starts that are refined.
const PLAIN_REFINED: usize = 24;
/// Maximum number of ends of a round that are refined.
pub(in crate::fit) const REFINED_IN_ROUND: usize =
    PLAIN_REFINED + GENERATIONS as usize * REFINED_THOROUGHLY;

/// Counts the descents of a round. Those that continue to their ends, in one round of several, count by their
/// evaluations.
pub(in crate::fit) fn descended_in_round(problem: &Problem<'_>) -> u32 {
    let short =
        share(problem, PLAIN) + share(problem, RIM) + GENERATIONS * share(problem, CHILDREN);
    let short_ones = EVALUATIONS_FIRST + (crew::EVALUATIONS - EVALUATIONS_FIRST) / LANES_GOING_ON;
    let creeping = 2 * CREEPING * (EVALUATIONS_CREEPING / short_ones) as u32;
    match crew::knows(problem) {
        true => short + creeping / CREEPING_EVERY as u32,
        false => short,
    }
}

/// Reduces a number of starts to those for which there is time.
fn share(problem: &Problem<'_>, starts: u32) -> u32 {
    match crew::knows(problem) {
        true => starts,
        false => starts / ONE_BY_ONE,
    }
}

impl Search<'_> {
    /// Descends from shapes in the whole box and on its rim without judging them first. If noise creates the minima,
    /// the cost of a start says little about the end of its descent.
    fn anywhere(&mut self, problem: &Problem<'_>, [plain, rim]: [u32; 2], refined: usize) {
        let starts = self.starts(problem, [share(problem, plain), share(problem, rim)]);
        let ends = descend(problem, &starts, &|| self.over(), self.cancel);
        self.refine(problem, ends, refined, 1e-4);
    }

    fn starts(&mut self, problem: &Problem<'_>, [plain, rim]: [u32; 2]) -> Vec<Values> {
        let mut starts = candidates::plain(problem, self.fallback, plain, self.next_seed());
        let rim = candidates::rim(problem, self.fallback, rim, self.next_seed());
        starts.extend(rim);
        starts
    }

    /// Runs a first search from unselected starts if lanes make it cheap, with more starts if few directions allow near
    /// minima.
    pub(in crate::fit) fn glance(&mut self, problem: &Problem<'_>) {
        if self.started || !crew::knows(problem) || self.over() {
            return;
        }
        let starts = match few_directions(problem.set()) {
            true => GLANCE_OF_FEW,
            false => GLANCE,
        };
        self.anywhere(problem, [starts / 2; 2], REFINED);
    }

    /// Runs fewer descents from unselected starts, each to its end. Some minima lie at the end of valleys along which
    /// gain and roughness compensate each other over powers of ten; a short descent does not show that it leads there.
    fn creep(&mut self, problem: &Problem<'_>) {
        if !crew::knows(problem) {
            return;
        }
        let starts = self.starts(problem, [CREEPING; 2]);
        let (chunk, evaluations) = (CHUNK_CREEPING, EVALUATIONS_CREEPING);
        let late = || self.over();
        let ends = as_lanes(problem, &starts, chunk, evaluations, &late, self.cancel);
        self.refine(problem, ends, PLAIN_REFINED, 1e-4);
    }

    /// Descends from children of the different ends so far (a memetic search: Moscato 1989). Most minima that no start
    /// reaches by chance share some of their shape with others that many starts reach.
    fn breed(&mut self, problem: &Problem<'_>) {
        let Some(best) = self.best() else {
            return;
        };
        let mut parents = vec![best.clone()];
        parents.extend(self.distinct(problem, &best.parameters, PARENTS - 1));
        let surfaces: Vec<Values> = parents
            .iter()
            .map(|m| problem.unpack(&m.parameters).folded())
            .collect();
        let children = share(problem, CHILDREN);
        let children = candidates::bred(&surfaces, children, self.next_seed());
        let settled: Vec<Values> = children
            .par_iter()
            .map(|v| settle(problem, v))
            .filter(|(cost, _)| cost.is_finite())
            .map(|(_, v)| v)
            .collect();
        let ends = descend(problem, &settled, &|| self.over(), self.cancel);
        self.refine(problem, ends, REFINED_THOROUGHLY, 1e-4);
    }

    /// Tries other roughnesses for the different ends, because a lobe that few poses meet has several.
    pub(in crate::fit) fn rescan(&mut self, problem: &Problem<'_>) {
        if self.started {
            return;
        }
        let Some(best) = self.best() else {
            return;
        };
        let mut ends = vec![best.clone()];
        ends.extend(self.distinct(problem, &best.parameters, self.effort.rescanned - 1));
        let starts: Vec<Values> = ends
            .par_iter()
            .flat_map_iter(|m| {
                let end = problem.unpack(&m.parameters).folded();
                candidates::rougher(problem, &end, OTHER_ROUGHNESSES)
            })
            .collect();
        let cancel = self.cancel;
        let ends: Vec<Minimum> = starts
            .par_iter()
            .filter(|_| !self.over())
            .map(|v| over_shapes(problem, v, &ROUGH, cancel))
            .filter(usable)
            .collect();
        self.refine(problem, ends, REFINED, 1e-4);
    }

    /// Follows the valleys of the best ends to their minimum. Where gain and shape compensate each other, the problem
    /// itself creeps; over shapes only, the gain is no obstacle.
    pub(in crate::fit) fn follow(&mut self, problem: &Problem<'_>) {
        if self.started {
            return;
        }
        let Some(best) = self.best() else {
            return;
        };
        let mut ends = vec![best.clone()];
        ends.extend(self.distinct(problem, &best.parameters, FOLLOWED - 1));
        if self.effort == Effort::MISFIT {
            ends.retain(|m| !m.ending.is_success());
        }
        ends.retain(|m| !self.followed.contains(&m.cost));
        self.followed.extend(ends.iter().map(|m| m.cost));
        let cancel = self.cancel;
        let bounds = problem.bounds();
        let ends: Vec<Minimum> = ends
            .par_iter()
            .filter(|_| !self.over())
            .map(|m| over_shapes(problem, &problem.unpack(&m.parameters), &FOLLOW, cancel))
            .filter(usable)
            .map(|m| minimise(problem, &m.parameters, &bounds, &FINE, cancel))
            .filter(usable)
            .collect();
        self.runs.extend(ends);
    }

    /// Runs further rounds while the data leave the surface undetermined, or the best end costs more than `likely`.
    /// There are many minima then, and the search continues until [`CALM`] successive rounds find none deeper.
    pub(in crate::fit) fn persist(&mut self, problem: &Problem<'_>, likely: f64) {
        if self.started {
            return;
        }
        self.glance(problem);
        let mut calm = 0;
        for round in 0..PERSISTENT_ROUNDS {
            let Some(before) = self.best() else {
                return;
            };
            let open = before.cost > likely
                || many_minima(problem, before)
                || self.rivalled(problem, before);
            // A minimum that only one start reached does not show that none is deeper.
            let alone = !self.confirmed(2);
            let patience = if alone { 2 * CALM } else { CALM };
            if calm >= patience || !(open || alone) || self.over() {
                return;
            }
            let before = before.cost;
            self.anywhere(problem, [PLAIN, RIM], PLAIN_REFINED);
            for _ in 0..GENERATIONS {
                self.breed(problem);
            }
            if round % CREEPING_EVERY == 0 {
                self.creep(problem);
            }
            if round % PROMISING_EVERY == 1 {
                self.thorough(problem);
                self.rescan(problem);
            }
            self.follow(problem);
            let deeper = self.best().is_some_and(|m| !same(before, m.cost));
            calm = if deeper { 0 } else { calm + 1 };
        }
    }

    /// Descends from the images of the best end under the near symmetries of few azimuths: mirrored and quarter-turned
    /// azimuths, αu and αv exchanged with a quarter turn, and facets and risers exchanged with half a turn.
    pub(in crate::fit) fn images(&mut self, problem: &Problem<'_>) {
        self.descend_images(problem, 1..16);
    }

    /// Descends from the mirrored azimuth only, for a search whose first round was enough; a lobe on one side of the
    /// tilt plane nearly allows it. If noise alone separates minima, all images are tried.
    pub(in crate::fit) fn mirror_image(&mut self, problem: &Problem<'_>) {
        let most = if self.effort == Effort::NOISE { 16 } else { 2 };
        self.descend_images(problem, 1..most);
    }

    /// Bit 0 of an image: mirrored; bit 1: exchanged; higher bits: quarter turns. Images are mirrored about every line
    /// of azimuths if there are few.
    fn descend_images(&mut self, problem: &Problem<'_>, images: std::ops::Range<u8>) {
        if self.started {
            return;
        }
        let Some(best) = self.best() else {
            return;
        };
        let found = problem.unpack(&best.parameters).folded();
        let zero = problem.set().rig.azimuth_zero.rad() + problem.set().region_azimuth.rad();
        let lines = azimuth_lines(problem.set());
        let bounds = problem.bounds();
        let fine = Settings {
            polish_steps: 20,
            max_iterations: 200,
            ..Settings::default()
        };
        let image = |image: u8, line: f64| {
            let (mirrored, exchanged, quarters) = (image & 1 == 1, image & 2 == 2, image >> 2);
            let mut v = found;
            if exchanged {
                v.theta_r = 0.5 * PI - v.theta_r;
                v.azimuth_offset += PI;
            }
            if mirrored {
                v.azimuth_offset = -v.azimuth_offset - 2.0 * (zero + line);
            }
            v.azimuth_offset += f64::from(quarters) * 0.5 * PI;
            if quarters & 1 == 1 {
                std::mem::swap(&mut v.alpha_u, &mut v.alpha_v);
            }
            problem.pack(&v)
        };
        let starts: Vec<Vec<f64>> = images
            .flat_map(|k| {
                let lines = if k & 1 == 1 { &lines[..] } else { &[0.0] };
                lines.iter().map(move |line| (k, *line))
            })
            .map(|(k, line)| image(k, line))
            .collect();
        let cancel = self.cancel;
        let ends: Vec<Minimum> = starts
            .par_iter()
            .map(|x| minimise(problem, x, &bounds, &fine, cancel))
            .collect();
        self.runs.extend(ends.into_iter().filter(usable));
    }
}

/// Maximum number of azimuth lines about which a surface is mirrored.
const LINES: usize = 3;

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

/// Runs descents that come near a minimum: as lanes, of which the deepest continue after some steps, or one by one if
/// lanes do not support the problem.
pub(in crate::fit) fn descend(
    problem: &Problem<'_>,
    starts: &[Values],
    late: Late<'_>,
    cancel: &AtomicBool,
) -> Vec<Minimum> {
    if !crew::knows(problem) {
        return patiently(problem, starts, late, cancel);
    }
    let down = |starts: &[Values], evaluations: usize| {
        as_lanes(problem, starts, CHUNK, evaluations, late, cancel)
    };
    let mut ends = down(starts, EVALUATIONS_FIRST);
    ends.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let unsettled = |m: &&Minimum| m.ending == Ending::MaxIterations;
    let deepest = ends[..ends.len().div_ceil(LANES_GOING_ON)].iter();
    let on: Vec<Values> = deepest
        .filter(unsettled)
        .map(|m| problem.unpack(&m.parameters))
        .collect();
    ends.retain(|m| !unsettled(&m));
    ends.extend(down(&on, crew::EVALUATIONS - EVALUATIONS_FIRST));
    ends
}

/// Runs descents as lanes; each processor takes `chunk` starts at a time.
fn as_lanes(
    problem: &Problem<'_>,
    starts: &[Values],
    chunk: usize,
    evaluations: usize,
    late: Late<'_>,
    cancel: &AtomicBool,
) -> Vec<Minimum> {
    let begun = starts.par_chunks(chunk).filter(|_| !late());
    begun
        .filter_map(|chunk| crew::descend_in_full(problem, chunk, evaluations, cancel))
        .flatten_iter()
        .map(Minimum::from)
        .filter(usable)
        .collect()
}

/// Runs descents that come near a minimum, of which the deepest continue: the deepest end is among them early.
fn patiently(
    problem: &Problem<'_>,
    starts: &[Values],
    late: Late<'_>,
    cancel: &AtomicBool,
) -> Vec<Minimum> {
    let bounds = problem.bounds();
    let down = |x: &[f64], settings| minimise(problem, x, &bounds, settings, cancel);
    let mut ends: Vec<Minimum> = starts
        .par_iter()
        .filter(|_| !late())
        .map(|v| down(&problem.pack(v), &ROUGH))
        .filter(usable)
        .collect();
    ends.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let going_on = ends.len().div_ceil(GOING_ON);
    ends[..going_on]
        .par_iter_mut()
        .filter(|m| m.ending == Ending::MaxIterations && !late())
        .for_each(|m| *m = down(&m.parameters, &PATIENT));
    ends.retain(usable);
    ends
}
