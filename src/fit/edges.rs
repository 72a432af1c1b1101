//! Beyond the edges at which the closed form jumps.
//!
//! A rough wall that the camera sees, or the lamp lights, edge-on goes out all at once: what its slopes mirror does not
//! fade with the cosine (`docs/sawtooth.md`, (a)). χ² has a step there, at which a descent ends although a deeper minimum
//! may begin right behind it. Few fits come near one: a wide lobe has to be seen along a wall.
//!
//! Call [`beyond`] with a minimum; it gives places to descend from, behind the edges that are within reach.

use nalgebra::{DMatrix, DVector};

use super::problem::{Problem, Quantity, Ready};
use super::solver::Minimum;

/// Edges behind which a descent is begun.
const EDGES_MAX: usize = 8;
/// Change of a residual, in standard deviations, below which a jump is none.
const JUMP_MIN: f64 = 0.05;
/// Cosines of lamp and camera to facet, riser and pitch.
const WALLS: usize = 6;
/// Step of the differences (rad).
const STEP: f64 = 1e-6;
/// Share of the normal matrix's diagonal that is added to it: null directions cost little, not nothing.
const DAMPING: f64 = 1e-9;

/// Places just behind the edges that a minimum is near: an observation there may pay for the way with its whole
/// residual.
pub(super) fn beyond(problem: &Problem<'_>, at: &Minimum) -> Vec<Vec<f64>> {
    let (rows, columns) = (problem.residual_count(), problem.free().len());
    if at.residuals.len() != rows || at.jacobian.len() != rows * columns {
        return Vec::new();
    }
    let jacobian = DMatrix::from_column_slice(rows, columns, &at.jacobian);
    let mut normal = jacobian.transpose() * jacobian;
    for k in 0..columns {
        let damped = normal[(k, k)] * (1.0 + DAMPING);
        normal[(k, k)] = if damped > 0.0 { damped } else { 1.0 };
    }
    let Some(normal) = normal.cholesky() else {
        return Vec::new();
    };
    let x = &at.parameters;
    let ready = |x: &[f64]| problem.ready(&problem.unpack(x));
    let here = ready(x);
    let turns: Vec<(usize, [Ready; 2])> = problem
        .free()
        .iter()
        .enumerate()
        .filter(|(_, quantity)| turns_walls(**quantity))
        .map(|(k, _)| {
            let moved = |step: f64| {
                let mut x = x.clone();
                x[k] += step;
                ready(&x)
            };
            (k, [moved(-STEP), moved(STEP)])
        })
        .collect();
    let mut found: Vec<(f64, Vec<f64>)> = Vec::new();
    for index in 0..problem.set().observations.len() {
        let pays = at.residuals[index].powi(2);
        let now = problem.wall_cosines(index, &here);
        let moved: Vec<(usize, [f64; WALLS], [f64; WALLS])> = turns
            .iter()
            .map(|(k, [less, more])| {
                let of = |ready| problem.wall_cosines(index, ready);
                (*k, of(less), of(more))
            })
            .collect();
        for wall in 0..WALLS {
            let mut slope = DVector::zeros(columns);
            for (k, less, more) in &moved {
                slope[*k] = (more[wall] - less[wall]) / (2.0 * STEP);
            }
            let way = normal.solve(&slope);
            let reach = slope.dot(&way);
            let costs = now[wall] * now[wall] / reach;
            if costs.is_nan() || costs >= pays {
                continue;
            }
            let to_edge = way * (-now[wall] / reach);
            if let Some(start) = behind(problem, index, wall, x, &to_edge) {
                found.push((costs, start));
            }
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.truncate(EDGES_MAX);
    found.into_iter().map(|(_, start)| start).collect()
}

fn turns_walls(quantity: Quantity) -> bool {
    matches!(
        quantity,
        Quantity::ThetaR | Quantity::AzimuthOffset | Quantity::TiltOffset
    )
}

/// The first place along a way at which an observation has an edge behind it, and its radiance has jumped.
fn behind(
    problem: &Problem<'_>,
    index: usize,
    wall: usize,
    from: &[f64],
    way: &DVector<f64>,
) -> Option<Vec<f64>> {
    let bounds = problem.bounds();
    let at = |share: f64| -> Vec<f64> {
        let moved = from.iter().zip(way.iter()).map(|(x, w)| x + share * w);
        let held = moved.zip(bounds.lower.iter().zip(&bounds.upper));
        held.map(|(x, (low, high))| x.clamp(*low, *high)).collect()
    };
    let seen = |x: &[f64]| {
        let values = problem.unpack(x);
        let ready = problem.ready(&values);
        let side = problem.wall_cosines(index, &ready)[wall] > 0.0;
        (side, values.scale * problem.gradient(index, &ready).value)
    };
    let (side, _) = seen(from);
    // The way is straight, the edge is not.
    let shares = [1.0 + 1e-6, 1.0 + 1e-4, 1.01, 1.1];
    let share = shares.into_iter().find(|s| seen(&at(*s)).0 != side)?;
    let before = [1.0 - 1e-6, 1.0 - 1e-4, 0.99, 0.9]
        .into_iter()
        .find(|s| seen(&at(*s)).0 == side)?;
    let jump = (seen(&at(share)).1 - seen(&at(before)).1) / problem.sigma()[index];
    (jump.abs() > JUMP_MIN).then(|| at(share))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::fit::FitOptions;
    use crate::fit::estimate::{estimate, free_quantities};
    use crate::fit::painted::{TRUTH, painted};
    use crate::fit::solver::{Settings, minimise};
    use crate::geometry::{Cones, Pose, RigGeometry};
    use crate::material::Material;
    use crate::model::Variant;
    use crate::observation::{Observation, ObservationSet, Prior};
    use crate::units::Angle;

    /// Steel of which one pose sees a wall nearly edge-on, in wide lobes and noise of 1.6 % of the peak.
    fn series() -> ObservationSet {
        let text = include_str!("../../tests/data/behind_an_edge.csv");
        let rows = text.lines().skip(1).map(|row| {
            let mut numbers = row.split(',').map(|n| n.parse::<f64>().unwrap());
            let mut next = || numbers.next().unwrap();
            let pose = Pose {
                theta_c: Angle::from_rad(next()),
                phi_s: Angle::from_rad(next()),
            };
            Observation::new(pose, next(), 0.004_978_262_761_319_444)
        });
        let background = Prior {
            mean: 0.0,
            std: 0.006_110_175_363_611_002,
        };
        let rig = RigGeometry {
            cones: Cones::of_lamp(Angle::from_deg(1.0)),
            ..RigGeometry::IN_PLANE
        };
        let steel = Material::exactly(2.9, 3.1);
        ObservationSet {
            n_frames_used: 100,
            ..ObservationSet::bare(rig, steel, rows.collect(), background)
        }
    }

    #[test]
    fn a_deeper_minimum_behind_the_edge_of_a_wall_is_found() {
        let (set, cancel) = (series(), AtomicBool::new(false));
        let options = FitOptions {
            misfit: false,
            ..Default::default()
        };
        let fitted = estimate(&set, Variant::Sawtooth, &options, None, &cancel).unwrap();
        // The best of 256 descents from around the truth has 33.14; before the edge none gets below 42.
        let cost = fitted.minimum.cost;
        assert!(cost < 34.0, "{cost}");
    }

    #[test]
    fn where_no_wall_is_seen_edge_on_nothing_is_looked_for() {
        let tilts = [-20.0, -10.0, 0.0, 10.0, 20.0];
        let grid = tilts
            .iter()
            .flat_map(|t| [0.0, 90.0, 180.0, 270.0].map(|phi_s| Pose::from_deg(*t, phi_s)));
        let set = painted(grid, &TRUTH, 1e-3, 3);
        let (free, fixed) = free_quantities(&set, Variant::Sawtooth);
        let problem = Problem::new(&set, Variant::Sawtooth, free, fixed);
        let (bounds, cancel) = (problem.bounds(), AtomicBool::new(false));
        let start = problem.pack(&TRUTH);
        let end = minimise(&problem, &start, &bounds, &Settings::default(), &cancel);
        assert_eq!(beyond(&problem, &end), Vec::<Vec<f64>>::new());
    }
}
