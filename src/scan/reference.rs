//! Reference poses: which pose a scan returns to, how often, and what that costs.
//!
//! A stage that slips and a lamp that drifts raise no flag. After every `every` points, and after the last one, the scan returns to
//! the earliest pose since the last check that it reaches within a share of the time that these points took, and compares the
//! picture with the one taken there. So the checks cost at most that share of the scan.

use std::time::Duration;

use super::plan::{MoveTime, Step};
use crate::frame::FrameKind;
use crate::geometry::Pose;

/// Settings of the checks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceRules {
    /// Points between two checks; 0 for none.
    pub every: u32,
    /// Largest time of a check as a share of the time of the points that it covers.
    pub time_share_max: f64,
    /// Largest change of level or pattern.
    pub change_max: f64,
}

/// A visited point: where, and how long the way and its exposures took.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Visited {
    pub target: Pose,
    pub predicted: Duration,
    pub exposure: Duration,
}

impl ReferenceRules {
    /// Returns which of the visited points to return to before the `next` one, and how long the detour takes; `None` if none
    /// is near enough. A way that a forbidden region blocks is predicted to take very long, so it is not chosen.
    pub(super) fn choose(
        &self,
        visited: &[Visited],
        next: Option<Pose>,
        move_time: MoveTime<'_>,
    ) -> Option<(usize, Duration)> {
        let (last, earlier) = visited.split_last()?;
        let spent: Duration = visited.iter().map(|point| point.predicted).sum();
        let allowed = spent.mul_f64(self.time_share_max);
        let on_to_next = |from: Pose| next.map_or(Duration::ZERO, |next| move_time(from, next));
        let straight = on_to_next(last.target);
        earlier.iter().enumerate().find_map(|(i, point)| {
            let there = move_time(last.target, point.target) + point.exposure;
            let detour = (there + on_to_next(point.target)).saturating_sub(straight);
            (detour <= allowed).then_some((i, detour))
        })
    }

    /// Whether a check is due after this number of points; `more`: others follow.
    #[must_use]
    pub fn is_due(&self, points: usize, more: bool) -> bool {
        self.every > 0 && (points >= self.every as usize || !more)
    }

    /// Predicts the time that the checks of these steps take, from `start` on.
    #[must_use]
    pub fn predicted(&self, steps: &[Step], start: Pose, move_time: MoveTime<'_>) -> Duration {
        let shots: Vec<_> = steps
            .iter()
            .filter_map(|step| match step {
                Step::Shot(shot) => Some(shot),
                Step::Operator(_) => None,
            })
            .collect();
        let (mut at, mut total) = (start, Duration::ZERO);
        let mut visited: Vec<Visited> = Vec::new();
        for (i, shot) in shots.iter().enumerate() {
            let Some(target) = shot.target else { continue };
            let way = move_time(at, target);
            at = target;
            if shot.kind != FrameKind::Sample {
                continue;
            }
            let exposures = Duration::try_from_secs_f64(shot.exposure_total_s());
            visited.push(Visited {
                target,
                predicted: way + exposures.unwrap_or_default(),
                exposure: shot.longest_exposure(),
            });
            if self.is_due(visited.len(), i + 1 < shots.len()) {
                let next = shots.get(i + 1).and_then(|next| next.target);
                let chosen = self.choose(&visited, next, move_time);
                // The detour holds the way on to the next point.
                total += chosen.map_or(Duration::ZERO, |(_, detour)| detour);
                visited.clear();
            }
        }
        total
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan::plan::{Preset, TravelLimits};
    use crate::scan::{PlanRequest, plan::PlanDefaults};
    use crate::units::Angle;

    fn rules(every: u32) -> ReferenceRules {
        ReferenceRules {
            every,
            time_share_max: 0.2,
            change_max: 0.02,
        }
    }

    fn move_time(from: Pose, to: Pose) -> Duration {
        let tilt = (to.theta_c - from.theta_c).abs().deg() / 20.0;
        let turn = (to.phi_s - from.phi_s).abs().deg() / 12.0;
        Duration::from_secs_f64(tilt.max(turn) + 0.1)
    }

    fn steps(preset: Preset) -> Vec<Step> {
        let defaults = PlanDefaults {
            exposures_s: vec![0.02, 0.06],
            flat_exposures_s: vec![0.02],
            dark_repeats: 1,
            flat_repeats: 1,
            reference_every: 20,
        };
        let plan = PlanRequest::preset(preset).resolve(&defaults).unwrap();
        let deg = Angle::from_deg;
        let limits = TravelLimits {
            theta_c: (deg(-60.0), deg(60.0)),
            phi_s: (deg(-10.0), deg(370.0)),
        };
        plan.steps(&limits, Pose::from_deg(0.0, 0.0), &move_time)
    }

    #[test]
    fn the_checks_cost_no_more_than_their_share() {
        for preset in [Preset::Paper, Preset::Full] {
            let steps = steps(preset);
            let start = Pose::from_deg(0.0, 0.0);
            let mut at = start;
            let mut scan_s = 0.0;
            for step in &steps {
                let Step::Shot(shot) = step else { continue };
                let target = shot.target.unwrap_or(at);
                scan_s += move_time(at, target).as_secs_f64() + shot.exposure_total_s();
                at = target;
            }
            let cost = rules(20).predicted(&steps, start, &move_time);
            let share = cost.as_secs_f64() / scan_s;
            assert!(share > 0.01 && share < 0.2, "{share}");
            assert_eq!(
                rules(0).predicted(&steps, start, &move_time),
                Duration::ZERO
            );
        }
    }

    #[test]
    fn the_earliest_pose_within_reach_is_chosen() {
        let at = |theta_c_deg: f64, phi_s_deg: f64| Visited {
            target: Pose::from_deg(theta_c_deg, phi_s_deg),
            predicted: Duration::from_secs(2),
            exposure: Duration::ZERO,
        };
        // Back to the first azimuth takes 30 s, to the first point of the second 2 s.
        let visited = [
            at(0.0, 0.0),
            at(20.0, 0.0),
            at(20.0, 360.0),
            at(0.0, 360.0),
            at(-10.0, 360.0),
        ];
        let chosen = |visited: &[Visited], next| rules(20).choose(visited, next, &move_time);
        assert_eq!(chosen(&visited, None).unwrap().0, 2);
        assert_eq!(chosen(&visited[..1], None), None);
        // A way on that is blocked rules a pose out.
        let next = Pose::from_deg(-10.0, 350.0);
        let blocked = |from: Pose, to: Pose| match from.theta_c.deg() > 10.0 && to == next {
            true => Duration::from_secs(1_000_000),
            false => move_time(from, to),
        };
        let around = rules(20).choose(&visited, Some(next), &blocked);
        assert_eq!(around.unwrap().0, 3);
    }
}
