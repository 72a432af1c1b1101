//! Edges at which the closed form is discontinuous.
//!
//! When the camera sees, or the lamp lights, a rough wall edge-on, its light disappears at once: the mirror light of
//! its slopes does not fade with the cosine (`docs/explanation/sawtooth.md`, (a)). χ² has a step there, at which a descent ends
//! although a deeper minimum may begin right behind it. Few fits come near one, because a wide lobe has to be seen
//! along a wall.
//!
//! Call [`beyond`] with a minimum: it returns starting points behind the edges that are within reach. If the deepest
//! point is on an edge itself, [`cleared`] moves the answer off it.

use nalgebra::{DMatrix, DVector};

use super::least_squares::levenberg_marquardt::Minimum;
use super::least_squares::{LeastSquares, sum_of_squares};
use super::problem::{Problem, Quantity, Ready};

/// Maximum number of edges behind which a descent starts.
const EDGES_MAX: usize = 8;
/// Change of a residual, in standard deviations, below which a jump is ignored.
const JUMP_MIN: f64 = 0.05;
/// Cosines of lamp and camera to facet, riser and pitch.
const WALLS: usize = 6;
/// Step of the differences (rad).
const STEP: f64 = 1e-6;
/// Share of the diagonal that is added to the normal matrix: null directions have a small cost instead of none.
const DAMPING: f64 = 1e-9;

/// Cosine to a wall below which a point is on its edge: ten thousand roundings of a direction.
const CLEAR: f64 = 1e-12;
/// Accepted relative rise of χ² when a point is moved off an edge.
const CLEARED_FOR: f64 = 1e-7;
/// Singular value below which no parameter turns a wall.
const NO_SLOPE: f64 = 1e-6;

/// Returns points just behind the edges near a minimum. The rise of the cost on the way must not exceed the squared
/// residual of an observation there.
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
    let turns: Vec<(usize, [Ready; 2])> = turning(problem)
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

/// Moves a minimum off the edges on which it lies, each to its present side. On an edge the last bit of an angle
/// decides over a whole residual, so a program that adds the angles in another order would not reproduce the cost.
pub(super) fn cleared(problem: &Problem<'_>, at: Minimum) -> Minimum {
    let (rows, columns) = (problem.residual_count(), problem.free().len());
    if at.residuals.len() != rows || !at.cost.is_finite() {
        return at;
    }
    let ready = |x: &[f64]| problem.ready(&problem.unpack(x));
    let cosines = |x: &[f64]| -> Vec<f64> {
        let ready = ready(x);
        (0..problem.set().observations.len())
            .flat_map(|index| problem.wall_cosines(index, &ready))
            .collect()
    };
    let here = cosines(&at.parameters);
    let on: Vec<usize> = (0..here.len()).filter(|k| here[*k].abs() < CLEAR).collect();
    if on.is_empty() {
        return at;
    }
    let mut slopes = DMatrix::zeros(on.len(), columns);
    for (k, _) in turning(problem) {
        let beside = |step: f64| {
            let mut x = at.parameters.clone();
            x[k] += step;
            cosines(&x)
        };
        let (less, more) = (beside(-STEP), beside(STEP));
        for (row, edge) in on.iter().enumerate() {
            slopes[(row, k)] = (more[*edge] - less[*edge]) / (2.0 * STEP);
        }
    }
    // Edge-on counts as facing away.
    let side = |cosine: f64| if cosine > 0.0 { 1.0 } else { -1.0 };
    let away = DVector::from_iterator(
        on.len(),
        on.iter().map(|k| side(here[*k]) * 2.0 * CLEAR - here[*k]),
    );
    let Ok(step) = slopes.svd(true, true).solve(&away, NO_SLOPE) else {
        return at;
    };
    let mut parameters: Vec<f64> = at
        .parameters
        .iter()
        .zip(&step)
        .map(|(x, s)| x + s)
        .collect();
    problem.bounds().clamp(&mut parameters);
    let there = cosines(&parameters);
    let kept = on.iter().all(|k| there[*k] * side(here[*k]) >= CLEAR);
    let (mut residuals, mut jacobian) = (vec![0.0; rows], vec![0.0; rows * columns]);
    LeastSquares::evaluate(&problem, &parameters, &mut residuals, &mut jacobian);
    let cost = sum_of_squares(&residuals);
    if kept && cost <= at.cost + CLEARED_FOR * at.cost.max(1.0) {
        Minimum {
            parameters,
            residuals,
            jacobian,
            cost,
            ..at
        }
    } else {
        at
    }
}

/// Free quantities that turn walls, with their positions.
fn turning<'p>(problem: &'p Problem<'_>) -> impl Iterator<Item = (usize, &'p Quantity)> {
    let all = problem.free().iter().enumerate();
    all.filter(|(_, quantity)| turns_walls(**quantity))
}

fn turns_walls(quantity: Quantity) -> bool {
    matches!(
        quantity,
        Quantity::ThetaR | Quantity::AzimuthOffset | Quantity::TiltOffset | Quantity::Wedge
    )
}

/// Returns the first point along a path at which an observation is behind an edge, if its radiance has jumped.
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
    // The path is straight, but the edge is not.
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
    use crate::fit::least_squares::levenberg_marquardt::{Ending, Settings};
    use crate::fit::one_variant::estimate;
    use crate::fit::painted::{TRUTH, painted};
    use crate::fit::problem::Values;
    use crate::fit::search_setup::free_quantities;
    use crate::geometry::{Cones, Pose, RigGeometry};
    use crate::material::Material;
    use crate::model::{Variant, radiance};
    use crate::observation::{Observation, ObservationSet, Prior};
    use crate::units::Angle;

    /// Steel, with one pose that sees a wall nearly edge-on, wide lobes and noise of 1.6 % of the peak.
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
        // The best of 256 descents from around the truth has 33.14; before the edge none is below 42.
        let cost = fitted.minimum.cost;
        assert!(cost < 34.0, "{cost}");
    }

    /// χ² of the samples by the plain closed form, with the offsets added to the recorded angles.
    fn plainly(problem: &Problem<'_>, x: &[f64]) -> f64 {
        let (set, v) = (problem.set(), problem.unpack(x));
        let optics = crate::model::Optics::new(&set.rig, &set.material);
        let residuals = set.observations.iter().map(|o| {
            let pose = Pose {
                theta_c: o.pose.theta_c + Angle::from_rad(v.tilt_offset),
                phi_s: o.pose.phi_s + Angle::from_rad(v.azimuth_offset),
            };
            let seen = set.rig.directions(pose);
            let radiance = radiance(problem.variant(), &seen, &v.surface(), &optics);
            (v.scale * radiance + v.background - o.signal) / o.sigma
        });
        residuals.map(|r| r * r).sum()
    }

    #[test]
    fn a_minimum_on_an_edge_moves_off_it_to_its_own_side() {
        let set = series();
        let (free, fixed) = free_quantities(&set, Variant::Sawtooth);
        let problem = Problem::new(&set, Variant::Sawtooth, free, fixed);
        let rough = Values {
            theta_r: 0.7,
            alpha_u: 0.5,
            alpha_v: 0.8,
            scale: 1.0,
            azimuth_offset: 0.1,
            ..fixed
        };
        let tilted = |tilt_offset: f64| {
            problem.pack(&Values {
                tilt_offset,
                ..rough
            })
        };
        let cosines = |tilt: f64| -> Vec<f64> {
            let ready = problem.ready(&problem.unpack(&tilted(tilt)));
            let all = 0..problem.set().observations.len();
            all.flat_map(|index| problem.wall_cosines(index, &ready))
                .collect()
        };
        let mut jumps = 0;
        let (low, high) = (cosines(-0.2), cosines(0.2));
        for wall in (0..low.len()).filter(|k| low[*k] * high[*k] < 0.0) {
            // Narrows to the two adjacent numbers between which the wall comes into view.
            let (mut one, mut other) = (-0.2_f64, 0.2_f64);
            while one.next_up() < other {
                let middle = 0.5 * (one + other);
                let middle = if middle > one && middle < other {
                    middle
                } else {
                    one.next_up()
                };
                match (cosines(middle)[wall] > 0.0) == (low[wall] > 0.0) {
                    true => one = middle,
                    false => other = middle,
                }
            }
            let at = |tilt: f64| {
                let parameters = tilted(tilt);
                let (rows, columns) = (problem.residual_count(), parameters.len());
                let (mut residuals, mut jacobian) = (vec![0.0; rows], vec![0.0; rows * columns]);
                LeastSquares::evaluate(&&problem, &parameters, &mut residuals, &mut jacobian);
                Minimum {
                    cost: sum_of_squares(&residuals),
                    parameters,
                    residuals,
                    jacobian,
                    ending: Ending::Stalled,
                    at_bound: Vec::new(),
                    evaluations: 1,
                }
            };
            let sides = [one, other].map(at);
            let jump = (sides[0].cost - sides[1].cost).abs();
            jumps += usize::from(jump > 1.0);
            for side in sides {
                let prior = side.residuals.last().unwrap().powi(2);
                let before = side.cost;
                let after = cleared(&problem, side);
                assert!((after.cost - before).abs() < 1e-6 * before);
                let said = plainly(&problem, &after.parameters) + prior;
                assert!(
                    (said - before).abs() < 1e-6 * before,
                    "{said} {before} {jump}"
                );
            }
        }
        assert!(jumps > 3, "{jumps}");
    }

    #[test]
    fn without_an_edge_on_wall_no_starts_are_returned() {
        let tilts = [-20.0, -10.0, 0.0, 10.0, 20.0];
        let grid = tilts
            .iter()
            .flat_map(|t| [0.0, 90.0, 180.0, 270.0].map(|phi_s| Pose::from_deg(*t, phi_s)));
        let set = painted(grid, &TRUTH, 1e-3, 3);
        let (free, fixed) = free_quantities(&set, Variant::Sawtooth);
        let problem = Problem::new(&set, Variant::Sawtooth, free, fixed);
        let never = AtomicBool::new(false);
        let end = problem.descend(&problem.pack(&TRUTH), &Settings::DEFAULT, &never);
        assert_eq!(beyond(&problem, &end), Vec::<Vec<f64>>::new());
    }
}
