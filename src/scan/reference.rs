//! Reference poses: which pose a scan returns to, how often, and what that costs.
//!
//! A stage that slips and a lamp that drifts raise no flag, and last. So the scan returns to a pose where it was, and compares the
//! picture with the one taken there: where both agree, no point in between was taken after a slip. A pose of points that an earlier
//! check confirmed, or the first one, confirms all points since then. The scan returns to one where this takes a small share of the
//! time of the points that it confirms. Between such checks it returns to points of its last block, which confirms a part of them.
//! After the last point it returns to one that confirms all, however far it is, unless both axes have an encoder, which shows
//! slips at once. Pictures that hardly depend on an angle confirm points after a slip, too. So the axes are then homed, which mends a
//! slip, and the points that show one best are looked at again: what was as before the homing and is not after it was taken wrong.

use std::time::Duration;

use super::plan::{MoveTime, Step, TravelLimits};
use crate::bench::AxisName;
use crate::frame::FrameKind;
use crate::geometry::Pose;
use crate::units::Angle;

/// A slip that a check should show: a tenth of the usual distance of poses.
const SLIP_DEG: f64 = 1.0;
/// Largest slip that need not show at any point. On a sample whose pictures depend less on an angle it does little harm.
pub(super) const SLIP_LARGE: Angle = Angle::from_deg(10.0);
/// Weight of a pose whose picture does not depend on the angles: it still shows a change of the lamp.
const FLAT_WEIGHT: f64 = 0.05;
/// Angles that differ less are the same one.
const SAME_DEG: f64 = 0.01;
/// Points that are remembered at most, so that memory and time of a check do not grow with the scan.
pub const REMEMBERED_MAX: u32 = 300;
/// Longer ways are those that a forbidden region blocks.
const BLOCKED: Duration = Duration::from_secs(100_000);

/// Settings of the checks.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReferenceRules {
    /// Points between two checks; 0 for none.
    pub every: u32,
    /// Largest time of a check during the scan as a share of the time of the points that it confirms.
    pub time_share_max: f64,
    /// Largest change of level or pattern.
    pub change_max: f64,
}

/// A visited point: where, how long the way and its exposures took, and how bright it was.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Visited {
    pub target: Pose,
    pub predicted: Duration,
    pub exposure: Duration,
    /// Level of its picture per second of exposure; `None` where it cannot be compared.
    pub level: Option<f64>,
}

/// Which of the visited points the checks covered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct Covered {
    /// Points that are confirmed: the first ones.
    pub confirmed: usize,
    /// Points at the last check.
    pub checked: usize,
}

/// The way to a reference pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Detour {
    /// Which of the visited points.
    pub index: usize,
    /// Where to go for it: φs perhaps by another turn.
    pub target: Pose,
    /// Time that the way and the exposure add.
    pub takes: Duration,
}

/// What a look at a reference pose is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Aim {
    /// To find slips of both axes.
    Both,
    /// To find slips of one axis.
    Axis(AxisName),
    /// To confirm all points.
    Confirm,
    /// To look at this point once more, since the axes have been homed.
    Again(usize),
}

/// What the choice of a reference pose depends on.
pub(super) struct Ways<'a> {
    pub move_time: MoveTime<'a>,
    pub limits: &'a TravelLimits,
    /// The next point; `None` after the last one.
    pub next: Option<Pose>,
    /// Whether the encoders of both axes show slips, so that the last check need not confirm all points at any price.
    pub slips_show: bool,
}

impl Ways<'_> {
    /// Returns the quickest way from a pose to the place of a point and on to the next one, and what it takes longer than without
    /// it.
    pub fn detour(&self, from: Pose, index: usize, to: &Visited) -> Option<Detour> {
        let on_to_next = |from: Pose| match self.next {
            Some(next) => (self.move_time)(from, next),
            None => Duration::ZERO,
        };
        let turns = [0.0, -360.0, 360.0].map(Angle::from_deg);
        let detours = turns.into_iter().filter_map(|turn| {
            let phi_s = to.target.phi_s + turn;
            let theta_c = to.target.theta_c;
            let target = Pose { theta_c, phi_s };
            if !self.limits.reaches_phi_s(phi_s) {
                return None;
            }
            let there = (self.move_time)(from, target) + to.exposure;
            let takes = (there + on_to_next(target)).saturating_sub(on_to_next(from));
            (takes < BLOCKED).then_some(Detour {
                index,
                target,
                takes,
            })
        });
        detours.min_by_key(|detour| detour.takes)
    }
}

impl Covered {
    /// Number of first points one of which confirms all: the confirmed ones, or the first one that can be compared.
    pub fn trusted(self, visited: &[Visited]) -> usize {
        let first = visited.iter().position(|point| point.level.is_some());
        let first = first.map_or(0, |first| first + 1);
        self.confirmed.max(first)
    }

    /// The picture at a point is as before.
    pub fn agreed(&mut self, index: usize, visited: &[Visited]) {
        if index < self.trusted(visited) {
            self.confirmed = visited.len();
        }
    }

    /// Returns the first point that does not count where the picture at a point has changed that was as before after
    /// `agreed_after` points.
    pub fn suspect_from(agreed_after: usize, visited: &[Visited]) -> usize {
        let first = visited.iter().position(|point| point.level.is_some());
        // A scan that has confirmed nothing may as well begin again.
        match agreed_after <= first.map_or(0, |first| first + 1) {
            true => 0,
            false => agreed_after,
        }
    }
}

impl ReferenceRules {
    /// Returns the way to the visited point that is best to compare: one that confirms many points, whose picture changes much
    /// with both angles, and which is near enough. After the last point, the way to one that confirms all may be longer.
    pub(super) fn choose(
        &self,
        visited: &[Visited],
        covered: Covered,
        ways: &Ways<'_>,
        aim: Aim,
    ) -> Option<Detour> {
        let last = visited.last()?;
        if let Aim::Again(index) = aim {
            return ways.detour(last.target, index, &visited[index]);
        }
        if covered.confirmed == visited.len() && !matches!(aim, Aim::Axis(_)) {
            return None;
        }
        let trusted = covered.trusted(visited);
        let spent = |from: usize| -> Duration {
            let since = visited[from.min(visited.len())..].iter();
            since.map(|point| point.predicted).sum()
        };
        let n = match aim {
            Aim::Confirm => trusted,
            Aim::Both | Aim::Axis(_) | Aim::Again(_) => visited.len(),
        };
        let comparable = visited[..n].iter().enumerate();
        let comparable = comparable.filter(|(i, point)| {
            let is_here = i + 1 == visited.len();
            point.level.is_some() && !is_here
        });
        let detours: Vec<Detour> = comparable
            .filter_map(|(i, point)| ways.detour(last.target, i, point))
            .collect();
        let confirms_all = |detour: &&Detour| detour.index < trusted;
        let all = spent(covered.confirmed).mul_f64(self.time_share_max);
        let (all, some) = match ways.next {
            // Once a scan.
            None if matches!(aim, Aim::Axis(_)) => (BLOCKED, BLOCKED),
            Some(_) => (all, spent(covered.checked).mul_f64(self.time_share_max)),
            None if ways.slips_show => (all, all),
            None => {
                let shortest = detours.iter().filter(confirms_all).map(|d| d.takes).min();
                (all.max(shortest.unwrap_or_default()), all)
            }
        };
        let open = visited.len().saturating_sub(covered.confirmed).max(1);
        let worth = |detour: &&Detour| {
            let i = detour.index;
            let confirms = match confirms_all(detour) {
                true => open,
                false => visited.len() - 1 - i,
            };
            confirms as f64 / open as f64 * self.weight(visited, i, aim)
        };
        let near = detours.iter().filter(|detour| match confirms_all(detour) {
            true => detour.takes <= all,
            false => detour.takes <= some,
        });
        let best = near.map(|detour| (worth(&detour), *detour));
        let best = best.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.takes.cmp(&a.1.takes)));
        best.map(|(_, detour)| detour)
    }

    /// Returns how well the picture at a point shows a slip, from 0 to 2.
    fn weight(&self, visited: &[Visited], index: usize, aim: Aim) -> f64 {
        let shown = AxisName::ALL.into_iter().filter(|axis| match aim {
            Aim::Axis(only) => *axis == only,
            Aim::Both | Aim::Confirm | Aim::Again(_) => true,
        });
        let weight: f64 = shown.map(|axis| self.shows(visited, index, axis)).sum();
        FLAT_WEIGHT.max(weight)
    }

    /// Returns how well the picture at a point shows a slip of an axis, from 0 to 1.
    fn shows(&self, visited: &[Visited], index: usize, axis: AxisName) -> f64 {
        let change = change_per_deg(visited, index, axis).unwrap_or_default() * SLIP_DEG;
        change / (change + self.change_max)
    }

    /// Whether another point shows a slip of an axis much better than each of these.
    pub(super) fn show_worse(&self, visited: &[Visited], these: &[usize], axis: AxisName) -> bool {
        let shows = |index| self.shows(visited, index, axis);
        let best = (0..visited.len()).map(shows).fold(0.0, f64::max);
        these.iter().all(|index| shows(*index) < 0.5 * best)
    }

    /// Returns the least slip of an axis that the picture at one of the points would show; `None` if they are at one angle only.
    pub(super) fn least_slip(&self, visited: &[Visited], axis: AxisName) -> Option<Angle> {
        let changes = (0..visited.len()).filter_map(|index| change_per_deg(visited, index, axis));
        let most = changes.max_by(f64::total_cmp)?;
        Some(Angle::from_deg(self.change_max / most))
    }

    /// Whether a check is due after this number of points; `more`: others follow.
    #[must_use]
    pub fn is_due(&self, points: usize, more: bool) -> bool {
        self.every > 0 && (points >= self.every as usize || !more)
    }

    /// Predicts the time that the checks of these steps take, from `start` on, with the homing after the last one. `slips_show`:
    /// both axes have an encoder.
    #[must_use]
    pub fn predicted(
        &self,
        steps: &[Step],
        start: Pose,
        limits: &TravelLimits,
        times: Times<'_>,
        slips_show: bool,
    ) -> Duration {
        let move_time = times.of_move;
        let shots: Vec<_> = steps
            .iter()
            .filter_map(|step| match step {
                Step::Shot(shot) => Some(shot),
                Step::Operator(_) => None,
            })
            .collect();
        let (mut at, mut total) = (start, Duration::ZERO);
        let mut visited: Vec<Visited> = Vec::new();
        let mut covered = Covered::default();
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
                level: Some(1.0),
            });
            forget(&mut visited, &mut covered);
            if self.is_due(visited.len() - covered.checked, i + 1 < shots.len()) {
                let ways = Ways {
                    move_time,
                    limits,
                    next: shots.get(i + 1).and_then(|next| next.target),
                    slips_show,
                };
                if let Some(detour) = self.choose(&visited, covered, &ways, Aim::Both) {
                    // The detour holds the way on to the next point.
                    total += detour.takes;
                    covered.agreed(detour.index, &visited);
                    if ways.next.is_none() && !slips_show {
                        total += times.homing_and_look(&detour, &visited);
                    }
                }
                covered.checked = visited.len();
            }
        }
        total
    }
}

/// Predicts how long the stages take.
#[derive(Clone, Copy)]
pub struct Times<'a> {
    /// A move, settling included.
    pub of_move: MoveTime<'a>,
    /// Homing both axes from a pose, and where they are then.
    pub of_homing: &'a dyn Fn(Pose) -> (Duration, Pose),
}

impl Times<'_> {
    /// Predicts the homing of the axes after the last check, and another look at the same point.
    fn homing_and_look(&self, last: &Detour, visited: &[Visited]) -> Duration {
        let (homing, home) = (self.of_homing)(last.target);
        let back = (self.of_move)(home, last.target);
        // The zero of an axis may be in a forbidden region, and homing allowed there.
        let back = if back < BLOCKED { back } else { homing };
        homing + back + visited[last.index].exposure
    }
}

/// Forgets the oldest points; returns how many of them were not confirmed.
pub(super) fn forget<T>(visited: &mut Vec<T>, covered: &mut Covered) -> usize {
    let excess = visited.len().saturating_sub(REMEMBERED_MAX as usize);
    visited.drain(..excess);
    let unconfirmed = excess.saturating_sub(covered.confirmed);
    covered.confirmed = covered.confirmed.saturating_sub(excess);
    covered.checked = covered.checked.saturating_sub(excess);
    unconfirmed
}

/// Estimates how much the level at a point changes with an angle, as a share per degree, from the nearest points on either side,
/// however far they are: the mean over a long way is less than the steepest change on it. `None` if all points are at one angle.
fn change_per_deg(visited: &[Visited], index: usize, axis: AxisName) -> Option<f64> {
    let here = visited[index];
    let here_level = here.level?;
    let mut sides: [Option<(f64, f64)>; 2] = [None, None];
    for other in visited {
        let Some(level) = other.level else { continue };
        let theta_c = (other.target.theta_c - here.target.theta_c).deg();
        let phi_s = (other.target.phi_s - here.target.phi_s).deg();
        let (along, across) = match axis {
            AxisName::ThetaC => (theta_c, phi_s),
            AxisName::PhiS => (phi_s, theta_c),
        };
        let is_neighbour = across.abs() < SAME_DEG && along.abs() >= SAME_DEG;
        let side = &mut sides[usize::from(along > 0.0)];
        if is_neighbour && side.is_none_or(|(nearest, _)| along.abs() < nearest) {
            *side = Some((along.abs(), level));
        }
    }
    // Over both sides, so that the top of a lobe, which shows no small slip, counts as flat.
    let (from, to, over_deg) = match sides {
        [None, None] => return None,
        [Some((way, level)), None] | [None, Some((way, level))] => (here_level, level, way),
        [Some((below, from)), Some((above, to))] => (from, to, below + above),
    };
    let scale = from.abs().max(to.abs()).max(f64::MIN_POSITIVE);
    Some((to - from).abs() / scale / over_deg)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::AxisName::{PhiS, ThetaC};
    use crate::scan::plan::Preset;
    use crate::scan::{PlanRequest, plan::PlanDefaults};

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
            let home = Pose::from_deg(-60.0, -10.0);
            let homing = Duration::from_secs(30);
            let times = Times {
                of_move: &move_time,
                of_homing: &|_| (homing, home),
            };
            let cost = rules(20).predicted(&steps, start, &limits(), times, true);
            let share = cost.as_secs_f64() / scan_s;
            assert!(share > 0.01 && share < 0.2, "{share}");
            assert_eq!(
                rules(0).predicted(&steps, start, &limits(), times, true),
                Duration::ZERO
            );
            // Without encoders the axes are homed after the last point, and the stages return to a pose.
            let without = rules(20).predicted(&steps, start, &limits(), times, false);
            let from_home = Pose::from_deg(60.0, 370.0);
            let back = move_time(home, from_home) + Duration::from_secs_f64(0.06);
            assert!(without > cost + homing, "{without:?} {cost:?}");
            let most = cost + homing + back + move_time(start, from_home);
            assert!(without < most, "{without:?} {most:?}");
        }
    }

    fn limits() -> TravelLimits {
        let deg = Angle::from_deg;
        TravelLimits {
            theta_c: (deg(-60.0), deg(60.0)),
            phi_s: (deg(-10.0), deg(370.0)),
        }
    }

    fn at(theta_c_deg: f64, phi_s_deg: f64, level: f64) -> Visited {
        Visited {
            target: Pose::from_deg(theta_c_deg, phi_s_deg),
            predicted: Duration::from_secs(2),
            exposure: Duration::ZERO,
            level: Some(level),
        }
    }

    fn ways(next: Option<Pose>, slips_show: bool) -> Ways<'static> {
        Ways {
            move_time: &move_time,
            limits: Box::leak(Box::new(limits())),
            next,
            slips_show,
        }
    }

    #[test]
    fn a_pose_is_near_that_confirms_many_points_and_shows_a_slip() {
        // Two azimuths; the first is 30 s away.
        let far = [
            at(0.0, 0.0, 1.0),
            at(20.0, 0.0, 1.0),
            at(20.0, 300.0, 1.0),
            at(0.0, 300.0, 1.0),
            at(-10.0, 300.0, 1.0),
        ];
        let next = Some(Pose::from_deg(-20.0, 300.0));
        let chosen = |visited: &[Visited], covered, ways: &Ways<'_>| {
            rules(20).choose(visited, covered, ways, Aim::Both)
        };
        let none = Covered::default();
        let within_reach = chosen(&far, none, &ways(next, false)).unwrap();
        assert_eq!(within_reach.index, 3);
        assert_eq!(chosen(&far[..1], none, &ways(next, false)), None);
        // After the last point the first one is worth its way, unless the encoders show slips. By another turn it is near.
        let last = chosen(&far, none, &ways(None, false)).unwrap();
        assert_eq!((last.index, last.target.phi_s.deg()), (0, 360.0));
        assert_eq!(chosen(&far, none, &ways(None, true)).unwrap().index, 2);
        // A confirmed pose confirms all points since then, so it may cost more.
        let confirmed = Covered {
            confirmed: 3,
            checked: 3,
        };
        let linked = chosen(&far, confirmed, &ways(None, false)).unwrap();
        assert_eq!(linked.index, 2);
        // Of poses that confirm as much, the one on the flank of the lobe.
        let lobe = [
            at(20.0, 0.0, 1.0),
            at(15.0, 0.0, 1.05),
            at(10.0, 0.0, 2.0),
            at(5.0, 0.0, 3.0),
            at(0.0, 0.0, 2.0),
            at(-5.0, 0.0, 1.0),
        ];
        let confirmed = Covered {
            confirmed: 5,
            checked: 5,
        };
        let far_too = ReferenceRules {
            time_share_max: 10.0,
            ..rules(20)
        };
        let on_flank = far_too.choose(&lobe, confirmed, &ways(None, false), Aim::Both);
        assert_eq!(on_flank.unwrap().index, 4);
        let on_flank = far_too.choose(
            &lobe[..4],
            Covered::default(),
            &ways(None, false),
            Aim::Both,
        );
        assert_eq!(on_flank.unwrap().index, 1);
        assert!(far_too.show_worse(&lobe, &[3], ThetaC));
        assert!(
            !far_too.show_worse(&lobe, &[4], ThetaC) && !far_too.show_worse(&lobe, &[3, 4], ThetaC)
        );
        assert!(!far_too.show_worse(&lobe, &[3], PhiS), "no point shows it");
        // On the flanks the level doubles over 10°, so 0.1° change it by the limit of 2 %.
        let least = |axis| far_too.least_slip(&lobe, axis).map(|slip| slip.deg());
        assert!(
            (0.1..0.5).contains(&least(ThetaC).unwrap()),
            "{:?}",
            least(ThetaC)
        );
        assert_eq!(least(PhiS), None, "it has one angle");
        let even = [at(0.0, 0.0, 1.0), at(0.0, 30.0, 1.001), at(0.0, 60.0, 1.0)];
        assert!(far_too.least_slip(&even, PhiS).unwrap() > SLIP_LARGE);
        // Also where the two azimuths are opposite to each other.
        let opposite = [at(0.0, 0.0, 1.0), at(0.0, 180.0, 1.001)];
        assert!(far_too.least_slip(&opposite, PhiS).unwrap() > SLIP_LARGE);
        // A way on that a forbidden region blocks rules a pose out.
        let blocked = |from: Pose, to: Pose| match from.theta_c.deg() > -5.0 && Some(to) == next {
            true => 10 * BLOCKED,
            false => move_time(from, to),
        };
        let around = Ways {
            move_time: &blocked,
            ..ways(next, false)
        };
        assert_eq!(chosen(&far, none, &around), None);
    }

    #[test]
    fn points_are_confirmed_by_one_that_was_confirmed_before_them() {
        let visited: Vec<Visited> = (0..6).map(|i| at(f64::from(i), 0.0, 1.0)).collect();
        let mut covered = Covered::default();
        // Only what came after it is like the picture at a pose that nothing confirms.
        covered.agreed(3, &visited[..5]);
        assert_eq!(covered.confirmed, 0);
        assert_eq!(Covered::suspect_from(4, &visited), 4);
        assert_eq!(Covered::suspect_from(1, &visited), 0);
        covered.agreed(0, &visited[..5]);
        assert_eq!(covered.confirmed, 5);
        covered.agreed(4, &visited);
        assert_eq!(covered.confirmed, 6);
        // The first point that shows light is where a scan begins.
        let dark = Visited {
            level: None,
            ..visited[0]
        };
        let begun_dark = [dark, visited[1], visited[2]];
        assert_eq!(Covered::default().trusted(&begun_dark), 2);
        let mut many = vec![(); REMEMBERED_MAX as usize + 7];
        let mut covered = Covered {
            confirmed: 5,
            checked: 20,
        };
        assert_eq!(forget(&mut many, &mut covered), 2);
        assert_eq!((many.len(), covered.checked), (REMEMBERED_MAX as usize, 13));
    }
}
