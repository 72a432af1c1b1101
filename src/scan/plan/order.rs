//! The order that saves motion, and what it costs.

use std::time::Duration;

use serde::Serialize;

use super::{Plan, PlanPose, TravelLimits};
use crate::frame::FrameKind;
use crate::geometry::Pose;
use crate::scan::event::OperatorAction;
use crate::units::Angle;

/// One point: a pose with all its exposures and repeats, committed as a whole.
#[derive(Debug, Clone, PartialEq)]
pub struct Shot {
    /// Place in the plan, from 0, calibrations first; independent of the order.
    pub index: u32,
    /// What the frames show.
    pub kind: FrameKind,
    /// Pose as the plan states it; `None` where it does not matter (dark frames).
    pub pose: Option<Pose>,
    /// Where to send the stages for it: the same pose, φs perhaps by another turn.
    pub target: Option<Pose>,
    /// Exposures, in the order taken.
    pub exposures_s: Vec<f64>,
    /// Frames per exposure.
    pub repeats: u32,
}

impl Shot {
    /// Frames of the point.
    #[must_use]
    pub fn n_frames(&self) -> u32 {
        self.exposures_s.len() as u32 * self.repeats
    }

    /// Longest exposure.
    #[must_use]
    pub fn longest_exposure(&self) -> Duration {
        let longest_s = self.exposures_s.iter().copied().fold(0.0, f64::max);
        Duration::try_from_secs_f64(longest_s).unwrap_or_default()
    }

    /// Time with the shutter open.
    #[must_use]
    pub fn exposure_total_s(&self) -> f64 {
        self.exposures_s.iter().sum::<f64>() * f64::from(self.repeats)
    }
}

/// A step of a scan.
#[derive(Debug, Clone, PartialEq)]
pub enum Step {
    /// A person acts, then says `continue`.
    Operator(OperatorAction),
    /// The rig moves and takes frames.
    Shot(Shot),
}

/// What a plan will cost.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Estimate {
    /// Points.
    pub n_shots: u32,
    /// Frames.
    pub n_frames: u32,
    /// Time for motion, settling and exposure; people not counted.
    pub duration_s: f64,
    /// Most disk space the frames can take.
    pub disk_bytes: u64,
}

/// Predicts how long a move takes, settling included.
pub type MoveTime<'a> = &'a dyn Fn(Pose, Pose) -> Duration;

impl Plan {
    /// The steps in order: dark frames, white reference, sample; `start` is where the stages stand.
    /// The plan must have passed [`Plan::check`].
    ///
    /// Poses that the plan states one by one keep their order. Of the orders tried (either axis outside, there and back or always the same way) the one
    /// that `move_time` finds quickest is taken, so a stage's speeds and backlash decide. The index
    /// of a shot does not depend on the order, so that a resumed scan knows what it has.
    #[must_use]
    pub fn steps(&self, limits: &TravelLimits, start: Pose, move_time: MoveTime<'_>) -> Vec<Step> {
        let mut steps = Vec::new();
        if self.dark.repeats > 0 {
            steps.push(Step::Operator(OperatorAction::CapLens));
            steps.push(Step::Shot(Shot {
                index: 0,
                kind: FrameKind::Dark,
                pose: None,
                target: None,
                exposures_s: self.all_exposures_s(),
                repeats: self.dark.repeats,
            }));
        }
        let mut at = start;
        if self.flat.repeats > 0 {
            steps.push(Step::Operator(OperatorAction::PlaceWhiteReference));
            // The white reference looks the same from every azimuth: φs stays where it is needed next.
            let first = self.phi_s_deg.iter().copied().min_by(f64::total_cmp);
            let phi_s = first.unwrap_or_else(|| {
                let here = limits.reachable_phi_s(start.phi_s);
                here.unwrap_or(limits.phi_s.0).deg()
            });
            let order = quickest_order(&self.flat.theta_c_deg, &[phi_s], limits, at, move_time);
            for visit in order {
                at = visit.target;
                steps.push(Step::Shot(Shot {
                    index: 1 + visit.place,
                    kind: FrameKind::Flat,
                    pose: Some(visit.pose),
                    target: Some(visit.target),
                    exposures_s: self.flat.exposures_s.clone(),
                    repeats: self.flat.repeats,
                }));
            }
        }
        if self.repeats == 0 {
            return steps;
        }
        steps.push(Step::Operator(OperatorAction::PlaceSample));
        let first = 1 + self.flat.theta_c_deg.len() as u32;
        let visits = match self.poses.is_empty() {
            true => quickest_order(&self.theta_c_deg, &self.phi_s_deg, limits, at, move_time),
            false => in_the_stated_order(&self.poses, limits),
        };
        for visit in visits {
            steps.push(Step::Shot(Shot {
                index: first + visit.place,
                kind: FrameKind::Sample,
                pose: Some(visit.pose),
                target: Some(visit.target),
                exposures_s: self.exposures_s.clone(),
                repeats: self.repeats,
            }));
        }
        steps
    }
}

/// What `steps` cost from `start` on, with frames of `frame_bytes_max` each.
#[must_use]
pub fn estimate(
    steps: &[Step],
    start: Pose,
    move_time: MoveTime<'_>,
    frame_bytes_max: u64,
) -> Estimate {
    let mut at = start;
    let mut total = Estimate {
        n_shots: 0,
        n_frames: 0,
        duration_s: 0.0,
        disk_bytes: 0,
    };
    for step in steps {
        if let Step::Shot(shot) = step {
            total.n_shots += 1;
            total.n_frames += shot.n_frames();
            total.duration_s += shot.exposure_total_s();
            if let Some(target) = shot.target {
                total.duration_s += move_time(at, target).as_secs_f64();
                at = target;
            }
        }
    }
    total.disk_bytes = u64::from(total.n_frames) * frame_bytes_max;
    total
}

/// A pose to visit.
#[derive(Clone, Copy)]
struct Visit {
    /// Place in the lists: tilt × number of azimuths + azimuth; or in the list of poses.
    place: u32,
    /// As the plan states it.
    pose: Pose,
    /// Where the stages go for it.
    target: Pose,
}

/// The poses that a plan states, in its order.
fn in_the_stated_order(poses: &[PlanPose], limits: &TravelLimits) -> Vec<Visit> {
    let visit = |(place, pose): (u32, &PlanPose)| Visit {
        place,
        pose: Pose::from_deg(pose.theta_c_deg, pose.phi_s_deg),
        target: Pose::from_deg(
            pose.theta_c_deg,
            reachable_phi_s_deg(pose.phi_s_deg, limits),
        ),
    };
    (0..).zip(poses).map(visit).collect()
}

/// φs where the stage goes for it: as stated, or by another turn.
fn reachable_phi_s_deg(phi_s_deg: f64, limits: &TravelLimits) -> f64 {
    let asked = Angle::from_deg(phi_s_deg);
    match limits.reachable_phi_s(asked) {
        Some(angle) if angle != asked => angle.deg(),
        _ => phi_s_deg,
    }
}

/// All pairs of the two lists, ordered.
fn quickest_order(
    theta_c_deg: &[f64],
    phi_s_deg: &[f64],
    limits: &TravelLimits,
    start: Pose,
    move_time: MoveTime<'_>,
) -> Vec<Visit> {
    let mut thetas: Vec<(u32, f64)> = (0..).zip(theta_c_deg.iter().copied()).collect();
    thetas.sort_by(|a, b| a.1.total_cmp(&b.1));
    // Sorted by where the stage goes, so that a turn taken the other way does not cross the travel.
    let mut phis: Vec<(u32, f64, f64)> = (0..)
        .zip(phi_s_deg.iter().copied())
        .map(|(place, deg)| (place, deg, reachable_phi_s_deg(deg, limits)))
        .collect();
    phis.sort_by(|a, b| a.2.total_cmp(&b.2));
    let visit = |theta: (u32, f64), phi: (u32, f64, f64)| Visit {
        place: theta.0 * phis.len() as u32 + phi.0,
        pose: Pose::from_deg(theta.1, phi.1),
        target: Pose::from_deg(theta.1, phi.2),
    };
    let mut best: Option<(Duration, Vec<Visit>)> = None;
    for theta_outside in [true, false] {
        for serpentine in [true, false] {
            for (reverse_outer, reverse_inner) in
                [(false, false), (true, false), (false, true), (true, true)]
            {
                let (n_outer, n_inner) = if theta_outside {
                    (thetas.len(), phis.len())
                } else {
                    (phis.len(), thetas.len())
                };
                let mut order = Vec::with_capacity(n_outer * n_inner);
                for i in 0..n_outer {
                    let backwards = reverse_inner ^ (serpentine && i % 2 == 1);
                    for j in 0..n_inner {
                        let i = if reverse_outer { n_outer - 1 - i } else { i };
                        let j = if backwards { n_inner - 1 - j } else { j };
                        order.push(if theta_outside {
                            visit(thetas[i], phis[j])
                        } else {
                            visit(thetas[j], phis[i])
                        });
                    }
                }
                let mut at = start;
                let mut cost = Duration::ZERO;
                for visit in &order {
                    cost += move_time(at, visit.target);
                    at = visit.target;
                }
                if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                    best = Some((cost, order));
                }
            }
        }
    }
    best.map(|(_, order)| order).unwrap_or_default()
}
