//! Search for the microstructure of greatest contrast on a rig: [`optimise`].
//!
//! The mean of absolute contrasts has kinks and side maxima, so a grid finds the basin and golden sections refine it.
//! *Conditioning*: a maximum is flat, so its location is known only to the square root of the precision of its height
//! (half of the digits), and the sections end if two heights differ by rounding. Its height, and the bounds of the
//! plateau around it, which are crossings, keep the digits of the contrast.

use std::cell::Cell;

use crate::geometry::RigGeometry;

use super::contrast::{Pace, Prediction, Tier, predict_paced};
use super::{Optics, Surface};

/// The best ridge angle and the flatness of the optimum.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optimum {
    /// Ridge angle, degrees.
    pub theta_r_deg: f64,
    /// Roughness of both axes (the given one if it was not free).
    pub alpha: f64,
    /// Mean absolute contrast there.
    pub contrast: f64,
    /// Mean Michelson contrast there.
    pub michelson: f64,
    /// Ridge angles between which the contrast stays above 99 % of the best, degrees; `None` if the time limit passed.
    pub within_1_percent_deg: Option<[f64; 2]>,
    /// The same for 90 %.
    pub within_10_percent_deg: Option<[f64; 2]>,
    /// Whether the optimum is at a bound of the ridge angle; false if the time limit passed before it was known.
    pub at_theta_r_bound: bool,
    /// Whether the optimum is at a bound of the roughness; false if the time limit passed before it was known.
    pub at_alpha_bound: bool,
    /// Largest distance of the best ridge angle from the given one, degrees, provided that the grid separated the
    /// basins.
    pub theta_r_resolution_deg: f64,
    /// Error of the contrast by the quadrature's estimate, as a share of it; `None` for closed forms.
    pub error: Option<f64>,
    /// Tables that were computed.
    pub tables: u64,
    /// Whether the search ended before the time limit.
    pub complete: bool,
}

/// The range of [`optimise`].
#[derive(Debug, Clone, PartialEq)]
pub struct Search {
    /// Bounds of the ridge angle, degrees.
    pub theta_r_deg: [f64; 2],
    /// Bounds of the roughness (αu = αv); equal bounds hold it constant.
    pub alpha: [f64; 2],
    /// Tilts over which contrast is averaged, degrees.
    pub tilts_deg: Vec<f64>,
}

/// Points of the grids over the ridge angle and over the roughness.
const GRID: [u32; 2] = [80, 24];
/// Steps of the walk from the optimum to a bound.
const WALK: u32 = 400;
/// Share of the whole range at which golden sections end.
const END: f64 = 1e-7;

/// Estimates the number of tables that a search computes: the grids, sections down to [`END`] of two grid cells, and
/// a fifth of each walk.
#[must_use]
pub fn tables_of(search: &Search) -> u64 {
    let sections = |cells: u32| (f64::from(cells) * END / 2.0).ln() / 0.618_f64.ln() + 3.0;
    let line = |cells: u32| f64::from(cells) + 1.0 + sections(cells);
    let free = search.alpha[1] > search.alpha[0];
    let ridges = line(GRID[0]);
    let all = if free {
        ridges * (line(GRID[1]) + 1.0)
    } else {
        ridges
    };
    (all + 4.0 * (0.2 * f64::from(WALK) + 30.0)) as u64
}

/// Returns the ridge angle (and roughness within its bounds) of greatest mean absolute contrast on a rig; if `pace`
/// stops the search, the best so far.
///
/// The roughness is scanned on a logarithmic grid and refined in the same way as the ridge angle.
#[must_use]
pub fn optimise(
    tier: Tier,
    rig: &RigGeometry,
    optics: &Optics,
    surface: &Surface,
    search: &Search,
    pace: &Pace<'_>,
) -> Optimum {
    let tables = Cell::new(0);
    let stopped = Cell::new(false);
    let go_on = || {
        if !stopped.get() && !(pace.go_on)() {
            stopped.set(true);
        }
        !stopped.get()
    };
    let table = |theta_r_deg: f64, alpha: f64| -> Prediction {
        let surface = Surface {
            alpha_u: alpha,
            alpha_v: alpha,
            ..*surface
        };
        tables.set(tables.get() + 1);
        let one = pace.to_the_end();
        let ridge = [theta_r_deg];
        predict_paced(tier, rig, optics, &surface, &ridge, &search.tilts_deg, &one)
    };
    let seen = Cell::new((f64::NEG_INFINITY, search.theta_r_deg[0], search.alpha[0]));
    let contrast = |theta_r_deg: f64, alpha: f64| {
        let contrast = table(theta_r_deg, alpha).table.mean_absolute();
        if contrast > seen.get().0 {
            seen.set((contrast, theta_r_deg, alpha));
        }
        contrast
    };
    let [low, high] = search.theta_r_deg;
    let best_ridge = |alpha: f64| maximum([low, high], GRID[0], &|t| contrast(t, alpha), &go_on);
    let [alpha_low, alpha_high] = search.alpha;
    let mut alpha = if alpha_high > alpha_low {
        let logs = [alpha_low.ln(), alpha_high.ln()];
        let over = |x: f64| contrast(best_ridge(x.exp()).0, x.exp());
        maximum(logs, GRID[1], &over, &go_on).0.exp()
    } else {
        alpha_low
    };
    let (mut theta_r_deg, resolution) = best_ridge(alpha);
    let searched = !stopped.get();
    if !searched {
        // The best of all points that were evaluated.
        (_, theta_r_deg, alpha) = seen.get();
    }
    let best = table(theta_r_deg, alpha);
    let peak = best.table.mean_absolute();
    let along = |theta_r_deg: f64| contrast(theta_r_deg, alpha);
    let edge = |to: f64, share: f64| edge(theta_r_deg, to, share * peak, &along, &go_on);
    let within = |share: f64| Some([edge(low, share)?, edge(high, share)?]);
    let n = best.table.by_phi_s.len().max(1) as f64;
    let near = |a: f64, b: f64| (a - b).abs() < 1e-4 * (1.0 + b.abs());
    let brightest = best.table.lines.iter().flat_map(|l| l.radiance);
    let brightest = brightest.fold(0.0, f64::max);
    Optimum {
        theta_r_deg,
        alpha,
        contrast: peak,
        michelson: best
            .table
            .by_phi_s
            .iter()
            .map(|m| m.contrast.michelson)
            .sum::<f64>()
            / n,
        within_1_percent_deg: within(0.99),
        within_10_percent_deg: within(0.9),
        at_theta_r_bound: searched && (near(theta_r_deg, low) || near(theta_r_deg, high)),
        at_alpha_bound: searched
            && alpha_high > alpha_low
            && (near(alpha, alpha_low) || near(alpha, alpha_high)),
        theta_r_resolution_deg: resolution,
        // A contrast is a difference of two radiances.
        error: best
            .error
            .map(|e| 2.0 * e * brightest / peak.max(f64::MIN_POSITIVE)),
        tables: tables.get(),
        complete: !stopped.get(),
    }
}

/// Returns the point between `from` and `to` beyond which `f` falls below `least`, or `to` if it does not; `None` if `go_on`
/// stops the walk. The walk ends at the first point below; a bisection follows.
fn edge(
    from: f64,
    to: f64,
    least: f64,
    f: &dyn Fn(f64) -> f64,
    go_on: &dyn Fn() -> bool,
) -> Option<f64> {
    let mut inside = from;
    for j in 1..=WALK {
        if !go_on() {
            return None;
        }
        let t = from + (to - from) * f64::from(j) / f64::from(WALK);
        if f(t) < least {
            let mut outside = t;
            for _ in 0..30 {
                let middle = 0.5 * (inside + outside);
                if f(middle) < least {
                    outside = middle;
                } else {
                    inside = middle;
                }
            }
            return Some(inside);
        }
        inside = t;
    }
    Some(to)
}

/// Returns the maximum of `f` within [low, high], and its largest error: the best of `n` + 1 grid points, refined. If
/// `go_on` returns false, returns the best so far, at least the first point.
fn maximum(
    [low, high]: [f64; 2],
    n: u32,
    f: &dyn Fn(f64) -> f64,
    go_on: &dyn Fn() -> bool,
) -> (f64, f64) {
    if high <= low {
        return (low, 0.0);
    }
    let at = |j: u32| low + (high - low) * f64::from(j) / f64::from(n);
    let mut best = (0, f(low));
    for j in 1..=n {
        if !go_on() {
            return (at(best.0), high - low);
        }
        let value = f(at(j));
        if value > best.1 {
            best = (j, value);
        }
    }
    let (mut a, mut b) = (at(best.0.saturating_sub(1)), at((best.0 + 1).min(n)));
    let golden = 0.5 * (5f64.sqrt() - 1.0);
    let (mut x, mut y) = (b - golden * (b - a), a + golden * (b - a));
    let (mut fx, mut fy) = (f(x), f(y));
    while b - a > END * (high - low) && go_on() {
        if fx > fy {
            (b, y, fy) = (y, x, fx);
            x = b - golden * (b - a);
            fx = f(x);
        } else {
            (a, x, fx) = (x, y, fy);
            y = a + golden * (b - a);
            fy = f(y);
        }
    }
    let middle = 0.5 * (a + b);
    // A bound may be better than any point inside.
    let place = if best.1 > f(middle) {
        at(best.0)
    } else {
        middle
    };
    (place, 0.5 * (b - a))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Variant;
    use crate::model::contrast::fixture::{optics, plastic};
    use crate::model::contrast::{PAPER_RIDGES_DEG, PAPER_TILTS_DEG, predict};

    fn search() -> Search {
        Search {
            theta_r_deg: [1.0, 30.0],
            alpha: [0.05, 0.05],
            tilts_deg: PAPER_TILTS_DEG.to_vec(),
        }
    }

    #[test]
    fn the_optimum_is_better_than_its_neighbours_and_its_plateau_is_correct() {
        let search = search();
        let tier = Tier::Closed(Variant::Sawtooth);
        let o = optimise(
            tier,
            &RigGeometry::BESIDE,
            &optics(),
            &plastic(0.05),
            &search,
            &Pace::UNHURRIED,
        );
        let at = |ridge: f64| {
            predict(
                tier,
                &RigGeometry::BESIDE,
                &optics(),
                &plastic(0.05),
                &[ridge],
                &PAPER_TILTS_DEG,
            )
            .mean_absolute()
        };
        assert!((at(o.theta_r_deg) - o.contrast).abs() < 1e-12);
        for ridge in PAPER_RIDGES_DEG {
            assert!(at(ridge) <= o.contrast);
        }
        let [a, b] = o.within_1_percent_deg.unwrap();
        assert!(a < o.theta_r_deg && o.theta_r_deg < b);
        assert!(
            (at(a) / o.contrast - 0.99).abs() < 1e-4 && (at(b) / o.contrast - 0.99).abs() < 1e-4
        );
        assert!(!o.at_theta_r_bound && !o.at_alpha_bound);
        assert!(o.complete && o.error.is_none() && o.theta_r_resolution_deg < 1e-5);
        let foreseen = tables_of(&search) as f64 / o.tables as f64;
        assert!((0.5..2.0).contains(&foreseen), "{foreseen}");
    }

    #[test]
    fn a_stopped_search_returns_the_best_so_far_and_is_marked_incomplete() {
        let asked = std::sync::atomic::AtomicU32::new(0);
        let go_on = || asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) < 40;
        let pace = Pace {
            go_on: &go_on,
            ..Pace::UNHURRIED
        };
        let tier = Tier::Closed(Variant::Sawtooth);
        let o = optimise(
            tier,
            &RigGeometry::BESIDE,
            &optics(),
            &plastic(0.05),
            &search(),
            &pace,
        );
        assert!(!o.complete && o.within_1_percent_deg.is_none());
        assert!(o.contrast > 0.0 && o.theta_r_resolution_deg > 10.0, "{o:?}");
        assert!(o.tables < 60);
    }

    #[test]
    fn a_stopped_search_over_the_roughness_too_returns_the_best_of_all_points() {
        let asked = std::sync::atomic::AtomicU32::new(0);
        // In the middle of the third line of ridge angles.
        let go_on = || asked.fetch_add(1, std::sync::atomic::Ordering::Relaxed) < 260;
        let pace = Pace {
            go_on: &go_on,
            ..Pace::UNHURRIED
        };
        let search = Search {
            alpha: [0.04, 0.2],
            ..search()
        };
        let (tier, rig) = (Tier::Closed(Variant::Sawtooth), RigGeometry::BESIDE);
        let run = |search: &Search, pace: &Pace<'_>| {
            optimise(tier, &rig, &optics(), &plastic(0.05), search, pace)
        };
        let stopped = run(&search, &pace);
        let first_line = Search {
            alpha: [0.04, 0.04],
            ..search
        };
        let first = run(&first_line, &Pace::UNHURRIED);
        assert!(!stopped.complete && !stopped.at_theta_r_bound && !stopped.at_alpha_bound);
        // The two searches round their roughnesses differently.
        let best = first.contrast * (1.0 - 1e-12);
        assert!(stopped.contrast >= best, "{stopped:?} {first:?}");
    }
}
