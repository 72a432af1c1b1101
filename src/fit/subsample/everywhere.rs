//! The higher order at every observation: integrated on a grid of poses and interpolated.

use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use super::{ALL, key, subset};
use crate::fit::higher_order::HigherOrder;
use crate::fit::model_discrepancy::peak;
use crate::fit::problem::{Problem, Values};
use crate::geometry::Pose;
use crate::observation::{Observation, ObservationSet};
use crate::units::Angle;

/// Nodes per axis of the first and of the finest grid on which a higher order is integrated.
const NODES: (usize, usize) = (32, 128);
/// Poses between the nodes at which the interpolation is checked.
const CHECKED: usize = 128;
/// Error of the interpolation (root mean square, as a share of the peak) that needs no finer grid.
pub(super) const SMOOTH: f64 = 1e-4;

/// A higher order at every observation.
pub(in crate::fit) struct Everywhere {
    pub(in crate::fit) offsets: Vec<f64>,
    /// Nodes of the grid; `None` if every pose was integrated.
    pub(in crate::fit) nodes: Option<usize>,
    /// Error of the interpolation, root mean square as a share of the peak.
    pub(in crate::fit) error: f64,
}

/// Evaluates the higher order at every pose: by integration if there are few poses, otherwise by interpolation between the
/// nodes of a grid. Returns `None` if the higher order has no result or the fit was cancelled.
pub(in crate::fit) fn everywhere(
    problem: &Problem<'_>,
    values: &Values,
    higher_order: HigherOrder<'_>,
    kept: &[usize],
    cancel: &AtomicBool,
) -> Option<Everywhere> {
    let set = problem.set();
    // Individual directions of an observation are not a function of the pose.
    if set.is_of_goniometer() {
        return Some(Everywhere {
            offsets: higher_order(problem, values)?,
            nodes: None,
            error: 0.0,
        });
    }
    let at = |poses: &[Pose]| -> Option<Vec<f64>> {
        let model = set.observations.first()?;
        let posed = poses.iter().map(|pose| Observation {
            pose: *pose,
            ..*model
        });
        let few = ObservationSet {
            observations: posed.collect(),
            ..subset(set, &[])
        };
        let free = problem.free().to_vec();
        let posed = Problem::new(&few, problem.variant(), free, *values)
            .with_polarisation(problem.is_polarised());
        higher_order(&posed, values)
    };
    let mut places: HashMap<(u64, u64), usize> = HashMap::new();
    let mut poses: Vec<Pose> = Vec::new();
    for o in &set.observations {
        if poses.len() > ALL {
            break;
        }
        places.entry(key(o.pose)).or_insert_with(|| {
            poses.push(o.pose);
            poses.len() - 1
        });
    }
    if poses.len() <= ALL {
        let each = at(&poses)?;
        let offsets = set.observations.iter().map(|o| each[places[&key(o.pose)]]);
        return Some(Everywhere {
            offsets: offsets.collect(),
            nodes: None,
            error: 0.0,
        });
    }
    let step = kept.len().div_ceil(CHECKED).max(1);
    let checked: Vec<Pose> = kept
        .iter()
        .step_by(step)
        .map(|i| set.observations[*i].pose)
        .collect();
    let exact = at(&checked)?;
    // Offsets are radiances, without gain and stray light; so is the peak.
    let top = peak(set) / values.scale.abs().max(f64::MIN_POSITIVE);
    let tilts = Axis::over(set.observations.iter().map(|o| o.pose.theta_c.rad()));
    let turns = Axis::over(set.observations.iter().map(|o| o.pose.phi_s.rad()));
    let mut count = NODES.0;
    loop {
        let (tilts, turns) = (tilts.nodes(count), turns.nodes(count));
        let nodes: Vec<Pose> = tilts
            .iter()
            .flat_map(|t| {
                turns.iter().map(|p| Pose {
                    theta_c: Angle::from_rad(*t),
                    phi_s: Angle::from_rad(*p),
                })
            })
            .collect();
        let integrated = at(&nodes)?;
        let between = |pose: &Pose| -> f64 {
            let (i, u) = place(&tilts, pose.theta_c.rad());
            let (j, v) = place(&turns, pose.phi_s.rad());
            let node = |i: usize, j: usize| {
                let (i, j) = (i.min(tilts.len() - 1), j.min(turns.len() - 1));
                integrated[i * turns.len() + j]
            };
            (1.0 - u) * ((1.0 - v) * node(i, j) + v * node(i, j + 1))
                + u * ((1.0 - v) * node(i + 1, j) + v * node(i + 1, j + 1))
        };
        let squares = checked
            .iter()
            .zip(&exact)
            .map(|(pose, e)| ((between(pose) - e) / top).powi(2));
        let error = (squares.sum::<f64>() / checked.len() as f64).sqrt();
        if cancel.load(Ordering::Relaxed) {
            return None;
        }
        if error <= SMOOTH || count >= NODES.1 {
            let offsets = set.observations.par_iter().map(|o| between(&o.pose));
            return Some(Everywhere {
                offsets: offsets.collect(),
                nodes: Some(nodes.len()),
                error,
            });
        }
        count *= 2;
    }
}

/// Range of the poses along one angle.
struct Axis {
    least: f64,
    most: f64,
    /// The angles themselves, ascending, if there are few.
    few: Option<Vec<f64>>,
}

impl Axis {
    fn over(angles: impl Iterator<Item = f64>) -> Self {
        let mut axis = Axis {
            least: f64::INFINITY,
            most: f64::NEG_INFINITY,
            few: Some(Vec::new()),
        };
        for a in angles {
            axis.least = axis.least.min(a);
            axis.most = axis.most.max(a);
            if let Some(few) = &mut axis.few
                && let Err(place) = few.binary_search_by(|b| b.total_cmp(&a))
            {
                few.insert(place, a);
                if few.len() > NODES.0 {
                    axis.few = None;
                }
            }
        }
        axis
    }

    /// Returns about `count` nodes: the angles themselves if they are fewer, otherwise equidistant ones.
    fn nodes(&self, count: usize) -> Vec<f64> {
        self.few.clone().unwrap_or_else(|| {
            let last = (count - 1) as f64;
            let share = |n: usize| self.least + (self.most - self.least) * n as f64 / last;
            (0..count).map(share).collect()
        })
    }
}

/// Returns the node before an angle, and the share of the distance to the next.
fn place(nodes: &[f64], angle: f64) -> (usize, f64) {
    let after = nodes.partition_point(|n| *n <= angle);
    let before = after.saturating_sub(1);
    match nodes.get(before + 1) {
        Some(next) => {
            let width = next - nodes[before];
            (before, ((angle - nodes[before]) / width).clamp(0.0, 1.0))
        }
        None => (before, 0.0),
    }
}
