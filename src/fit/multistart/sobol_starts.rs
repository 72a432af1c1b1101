//! Starts of a multistart: shapes of a scrambled Sobol sequence over the whole box, with the gain that is right on
//! average.
//!
//! Half of them are shapes of a sample that is mounted nearly as it should be ([`plain`]), half come from the rim of the
//! box ([`rim`]). If noise creates the minima, the cost of a start says little about the end of its descent, so no start
//! is judged before.

use std::f64::consts::PI;

use sobol_burley::sample;

use crate::fit::problem::{
    ALPHA_MAX, ALPHA_MIN, Problem, Quantity, THETA_R_MAX, TILT_OFFSET_MAX, Values,
};

/// Steepest ridges and largest offsets of the mounted samples (rad).
const STEEPEST: f64 = 62.0 * PI / 180.0;
const MOUNTED: f64 = 11.0 * PI / 180.0;
/// Smoothest of the facets that are rough along both axes; and the range of the azimuth for the others (rad).
const RIM_SMOOTHEST: f64 = 0.1;
const RIM_TURN: f64 = 30.0 * PI / 180.0;

/// Returns `count` starts, half of them from the rim of the box; reproducible for a seed.
pub(in crate::fit) fn starts(
    problem: &Problem<'_>,
    fallback: &Values,
    count: u32,
    seed: u32,
) -> Vec<Values> {
    let mut starts = plain(problem, fallback, count.div_ceil(2), seed);
    starts.extend(rim(problem, fallback, count / 2, !seed));
    starts
}

/// Returns shapes of samples that are mounted within 11° of the nominal position, one in six at any azimuth.
fn plain(problem: &Problem<'_>, fallback: &Values, count: u32, seed: u32) -> Vec<Values> {
    let ranges = |k: u32| Ranges {
        steepest: STEEPEST,
        turn: if k.is_multiple_of(6) { PI } else { MOUNTED },
        tilt: MOUNTED,
        alpha: (ALPHA_MIN, 1.0),
    };
    drawn(problem, fallback, count, seed, ranges)
}

/// Returns shapes from the rim of the box: the steepest and roughest facets that a fit considers, and the largest
/// offsets. The minima of a lobe so broad that it fills the rig are there.
fn rim(problem: &Problem<'_>, fallback: &Values, count: u32, seed: u32) -> Vec<Values> {
    // Halves of a Sobol sequence are uniform in all dimensions; every second point is not.
    let ranges = |k: u32| {
        let (smoothest, turn) = match k < count / 2 {
            true => (RIM_SMOOTHEST, PI),
            false => (ALPHA_MIN, RIM_TURN),
        };
        Ranges {
            steepest: THETA_R_MAX,
            turn,
            tilt: TILT_OFFSET_MAX,
            alpha: (smoothest, ALPHA_MAX),
        }
    };
    drawn(problem, fallback, count, seed, ranges)
}

/// Ranges of a shape: the angles from 0 or to both sides (rad), both roughnesses by their logarithms.
struct Ranges {
    steepest: f64,
    turn: f64,
    tilt: f64,
    alpha: (f64, f64),
}

/// Returns `count` shapes of a scrambled Sobol sequence, shape `k` within `ranges(k)`.
fn drawn(
    problem: &Problem<'_>,
    fallback: &Values,
    count: u32,
    seed: u32,
    ranges: impl Fn(u32) -> Ranges,
) -> Vec<Values> {
    let evened = Evened::new(problem, fallback);
    let shape = |k: u32| {
        let at = |dimension| f64::from(sample(k, dimension, seed));
        let within = ranges(k);
        let (smoothest, roughest) = within.alpha;
        let alpha = |share: f64| smoothest * (roughest / smoothest).powf(share);
        let v = Values {
            theta_r: at(0) * within.steepest,
            azimuth_offset: both_ways(at(1)) * within.turn,
            tilt_offset: both_ways(at(2)) * within.tilt,
            alpha_u: alpha(at(3)),
            alpha_v: alpha(at(4)),
            ..*fallback
        };
        // What the user holds stays.
        let v = problem.unpack(&problem.pack(&v));
        evened.with_amplitudes(v, at(5))
    };
    (0..count).map(shape).collect()
}

/// Maps 0 … 1 to −1 … 1.
fn both_ways(share: f64) -> f64 {
    2.0 * share - 1.0
}

/// Sets amplitudes of shapes that are right on average.
struct Evened<'p, 'a> {
    problem: &'p Problem<'a>,
    background: f64,
    signal: f64,
}

impl<'p, 'a> Evened<'p, 'a> {
    fn new(problem: &'p Problem<'a>, fallback: &Values) -> Self {
        let signal = problem.set().observations.iter().map(|o| o.signal).sum();
        let evened = Evened {
            problem,
            background: fallback.background,
            signal: 0.0,
        };
        let signal = evened.over(signal);
        Evened { signal, ..evened }
    }

    /// Subtracts the stray light, which no gain multiplies.
    fn over(&self, sum: f64) -> f64 {
        sum - self.background * self.problem.set().observations.len() as f64
    }

    fn with_amplitudes(&self, mut v: Values, share: f64) -> Values {
        let free = |quantity| self.problem.free().contains(&quantity);
        if free(Quantity::RhoD) {
            v.rho_d = 0.8 * share;
        }
        if free(Quantity::Scale) {
            let factor = self.signal / self.over(self.problem.predicted(&v).iter().sum());
            if factor.is_finite() && factor > 0.0 {
                v.scale *= factor;
            }
        }
        v
    }
}

#[cfg(test)]
#[path = "sobol_starts_tests.rs"]
mod tests;
