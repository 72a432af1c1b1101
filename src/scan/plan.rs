//! A plan is data: it is checked, ordered, timed and sized before anything moves.
//!
//! [`PlanRequest`] is what a file or a request says; [`PlanRequest::resolve`] fills in the preset
//! and the defaults; [`Plan::check`] lists everything that is wrong; [`Plan::steps`] gives the
//! points in the order that costs the least motion. No hardware here.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use super::event::OperatorAction;
use crate::frame::FrameKind;
use crate::geometry::Pose;
use crate::units::Angle;

/// Most values in one list of angles or exposures.
pub const LIST_LENGTH_MAX: usize = 10_000;
/// Most frames in one plan.
pub const FRAMES_MAX: u64 = 1_000_000;
/// Longest exposure in seconds.
pub const EXPOSURE_S_MAX: f64 = 3600.0;
/// Shortest exposure in seconds.
pub const EXPOSURE_S_MIN: f64 = 1e-6;
/// Two angles closer than this are the same point.
const SAME_ANGLE_DEG: f64 = 1e-6;

/// A list of numbers, written out or as a grid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Values {
    /// One value after the other.
    List(Vec<f64>),
    /// From, to (inclusive) and step.
    Grid(Grid),
}

/// Evenly spaced values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// First value.
    pub from: f64,
    /// Last value, reached if the step meets it.
    pub to: f64,
    /// Distance between values; positive.
    pub step: f64,
}

impl Values {
    /// The values one by one; a grid that is senseless or beyond [`LIST_LENGTH_MAX`] is an error
    /// before memory is taken for it.
    fn expand(&self, field: &str, problems: &mut Vec<PlanProblem>) -> Vec<f64> {
        match self {
            Values::List(list) => list.clone(),
            Values::Grid(Grid { from, to, step }) => {
                if !(from.is_finite() && to.is_finite() && step.is_finite())
                    || *step <= 0.0
                    || to < from
                {
                    problems.push(PlanProblem::new(
                        field,
                        format!(
                            "a grid needs finite from ≤ to and a positive step, not {from}, {to}, {step}"
                        ),
                    ));
                    return Vec::new();
                }
                let count = ((to - from) / step + 1e-9).floor() + 1.0;
                if count > LIST_LENGTH_MAX as f64 {
                    problems.push(PlanProblem::new(
                        field,
                        format!(
                            "the grid has {count:.0} values; at most {LIST_LENGTH_MAX} are allowed"
                        ),
                    ));
                    return Vec::new();
                }
                (0..count as usize)
                    .map(|i| from + step * i as f64)
                    .collect()
            }
        }
    }
}

/// Named plans.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Preset {
    /// The paper's: θc −20…20 by 10, φs 0, 90, 180.
    Paper,
    /// 9 tilts (−20…20 by 5) × 12 azimuths (0…330 by 30).
    Full,
}

impl Preset {
    /// Tilts and azimuths of the preset, in degrees.
    #[must_use]
    pub fn angles_deg(self) -> (Vec<f64>, Vec<f64>) {
        match self {
            Preset::Paper => (
                (-2..=2).map(|i| f64::from(i) * 10.0).collect(),
                vec![0.0, 90.0, 180.0],
            ),
            Preset::Full => (
                (-4..=4).map(|i| f64::from(i) * 5.0).collect(),
                (0..12).map(|i| f64::from(i) * 30.0).collect(),
            ),
        }
    }
}

/// Dark frames of a request.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DarkRequest {
    /// Frames per exposure; 0 leaves the dark frames out.
    pub repeats: Option<u32>,
}

/// White-reference frames of a request.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlatRequest {
    /// Tilts; those of the sample if not given.
    pub theta_c_deg: Option<Values>,
    /// Exposures; the rig's for the white reference if not given.
    pub exposures_s: Option<Vec<f64>>,
    /// Frames per tilt and exposure; 0 leaves the white reference out.
    pub repeats: Option<u32>,
}

/// A plan as a file or a request states it: everything may be left out that a preset or the rig's
/// settings know. Unknown keys are errors.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanRequest {
    /// A named plan whose angles count where none are given.
    pub preset: Option<Preset>,
    /// Camera tilts.
    pub theta_c_deg: Option<Values>,
    /// Sample azimuths.
    pub phi_s_deg: Option<Values>,
    /// Exposures of the sample; the rig's if not given.
    pub exposures_s: Option<Vec<f64>>,
    /// Frames per pose and exposure; 1 if not given.
    pub repeats: Option<u32>,
    /// Dark frames.
    #[serde(default)]
    pub dark: DarkRequest,
    /// White-reference frames.
    #[serde(default)]
    pub flat: FlatRequest,
    /// Whether valid calibration frames save their operator steps; true if not given.
    pub reuse_calibrations: Option<bool>,
}

/// What a rig's settings say where a request says nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanDefaults {
    /// Exposures of the sample.
    pub exposures_s: Vec<f64>,
    /// Exposures of the white reference, which is brighter.
    pub flat_exposures_s: Vec<f64>,
    /// Dark frames per exposure.
    pub dark_repeats: u32,
    /// White-reference frames per tilt and exposure.
    pub flat_repeats: u32,
}

/// A whole plan, nothing left open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Camera tilts.
    pub theta_c_deg: Vec<f64>,
    /// Sample azimuths.
    pub phi_s_deg: Vec<f64>,
    /// Exposures of the sample.
    pub exposures_s: Vec<f64>,
    /// Frames per pose and exposure.
    pub repeats: u32,
    /// Dark frames, taken at every exposure used.
    pub dark: DarkPlan,
    /// White-reference frames.
    pub flat: FlatPlan,
    /// Whether valid calibration frames save their operator steps.
    pub reuse_calibrations: bool,
}

/// Dark frames of a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DarkPlan {
    /// Frames per exposure; 0 for none.
    pub repeats: u32,
}

/// White-reference frames of a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FlatPlan {
    /// Tilts.
    pub theta_c_deg: Vec<f64>,
    /// Exposures.
    pub exposures_s: Vec<f64>,
    /// Frames per tilt and exposure; 0 for none.
    pub repeats: u32,
}

/// One thing that is wrong with a plan.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlanProblem {
    /// Where, e.g. `plan.theta_c_deg[2]`.
    pub field: String,
    /// What, with the allowed values.
    pub message: String,
}

impl PlanProblem {
    fn new(field: impl Into<String>, message: impl Into<String>) -> Self {
        PlanProblem {
            field: field.into(),
            message: message.into(),
        }
    }
}

/// Everything that is wrong with a plan.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the plan cannot run: {}", list(.problems))]
pub struct PlanError {
    /// All problems found; never empty.
    pub problems: Vec<PlanProblem>,
}

fn list(problems: &[PlanProblem]) -> String {
    const SHOWN: usize = 5;
    let mut text = problems
        .iter()
        .take(SHOWN)
        .map(|p| format!("{}: {}", p.field, p.message))
        .collect::<Vec<_>>()
        .join("; ");
    if problems.len() > SHOWN {
        text.push_str(&format!("; and {} more", problems.len() - SHOWN));
    }
    text
}

/// Where the axes may go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TravelLimits {
    /// Least and greatest camera tilt.
    pub theta_c: (Angle, Angle),
    /// Least and greatest sample azimuth.
    pub phi_s: (Angle, Angle),
}

impl TravelLimits {
    /// φs as the stage can reach it: the given turn if within the limits, else another turn of the
    /// same direction; `None` if there is none.
    #[must_use]
    pub fn reachable_phi_s(&self, phi_s: Angle) -> Option<Angle> {
        [0.0, -360.0, 360.0]
            .into_iter()
            .map(|turn| phi_s + Angle::from_deg(turn))
            .find(|angle| within(*angle, self.phi_s))
    }
}

fn within(angle: Angle, (min, max): (Angle, Angle)) -> bool {
    // A stage's limit is inclusive; degrees written in a file must not miss it by rounding.
    let slack = Angle::from_deg(1e-9);
    angle >= min - slack && angle <= max + slack
}

impl PlanRequest {
    /// Reads a plan file.
    ///
    /// # Errors
    /// The TOML reader's message with line, column and the keys that are allowed.
    pub fn from_toml(text: &str) -> Result<Self, toml::de::Error> {
        toml::from_str(text)
    }

    /// A request that only names a preset.
    #[must_use]
    pub fn preset(preset: Preset) -> Self {
        PlanRequest {
            preset: Some(preset),
            ..PlanRequest::default()
        }
    }

    /// Fills in preset and defaults. The result still has to be checked.
    ///
    /// # Errors
    /// [`PlanError`] for angles that are missing or grids that make no sense.
    pub fn resolve(&self, defaults: &PlanDefaults) -> Result<Plan, PlanError> {
        let mut problems = Vec::new();
        let preset = self.preset.map(Preset::angles_deg);
        let mut angles =
            |given: &Option<Values>, preset: Option<Vec<f64>>, field: &str| match (given, preset) {
                (Some(values), _) => values.expand(field, &mut problems),
                (None, Some(values)) => values,
                (None, None) => {
                    problems.push(PlanProblem::new(
                        field,
                        "missing: give a list, a grid {from, to, step}, or a preset (paper, full)",
                    ));
                    Vec::new()
                }
            };
        let (preset_theta, preset_phi) = preset.unzip();
        let theta_c_deg = angles(&self.theta_c_deg, preset_theta, "plan.theta_c_deg");
        let phi_s_deg = angles(&self.phi_s_deg, preset_phi, "plan.phi_s_deg");
        let flat_theta_c_deg = angles(
            &self.flat.theta_c_deg,
            Some(theta_c_deg.clone()),
            "plan.flat.theta_c_deg",
        );
        if !problems.is_empty() {
            return Err(PlanError { problems });
        }
        Ok(Plan {
            theta_c_deg,
            phi_s_deg,
            exposures_s: self
                .exposures_s
                .clone()
                .unwrap_or_else(|| defaults.exposures_s.clone()),
            repeats: self.repeats.unwrap_or(1),
            dark: DarkPlan {
                repeats: self.dark.repeats.unwrap_or(defaults.dark_repeats),
            },
            flat: FlatPlan {
                theta_c_deg: flat_theta_c_deg,
                exposures_s: self
                    .flat
                    .exposures_s
                    .clone()
                    .unwrap_or_else(|| defaults.flat_exposures_s.clone()),
                repeats: self.flat.repeats.unwrap_or(defaults.flat_repeats),
            },
            reuse_calibrations: self.reuse_calibrations.unwrap_or(true),
        })
    }
}

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
    /// Every exposure used, each once, ascending: what dark frames are needed at.
    #[must_use]
    pub fn all_exposures_s(&self) -> Vec<f64> {
        let mut all = self.exposures_s.clone();
        if self.flat.repeats > 0 {
            all.extend(&self.flat.exposures_s);
        }
        all.sort_by(f64::total_cmp);
        all.dedup();
        all
    }

    /// Lists everything that is wrong with the plan.
    ///
    /// # Errors
    /// [`PlanError`] with one entry per problem.
    pub fn check(&self, limits: &TravelLimits) -> Result<(), PlanError> {
        let mut problems = Vec::new();
        check_list("plan.theta_c_deg", &self.theta_c_deg, &mut problems);
        check_list("plan.phi_s_deg", &self.phi_s_deg, &mut problems);
        check_tilts("plan.theta_c_deg", &self.theta_c_deg, limits, &mut problems);
        for (i, deg) in self.phi_s_deg.iter().enumerate() {
            if deg.is_finite() && limits.reachable_phi_s(Angle::from_deg(*deg)).is_none() {
                problems.push(PlanProblem::new(
                    format!("plan.phi_s_deg[{i}]"),
                    format!(
                        "{deg}° is outside the travel of phi_s, {:.3} to {:.3}, on every turn",
                        limits.phi_s.0, limits.phi_s.1
                    ),
                ));
            }
        }
        check_exposures("plan.exposures_s", &self.exposures_s, &mut problems);
        if self.repeats == 0 {
            problems.push(PlanProblem::new("plan.repeats", "must be at least 1"));
        }
        if self.flat.repeats > 0 {
            check_list(
                "plan.flat.theta_c_deg",
                &self.flat.theta_c_deg,
                &mut problems,
            );
            check_tilts(
                "plan.flat.theta_c_deg",
                &self.flat.theta_c_deg,
                limits,
                &mut problems,
            );
            check_exposures(
                "plan.flat.exposures_s",
                &self.flat.exposures_s,
                &mut problems,
            );
        }
        let frames = self.n_frames();
        if frames > FRAMES_MAX {
            problems.push(PlanProblem::new(
                "plan",
                format!("{frames} frames are more than the {FRAMES_MAX} that one scan may have"),
            ));
        }
        if problems.is_empty() {
            Ok(())
        } else {
            Err(PlanError { problems })
        }
    }

    /// Frames of the whole plan, all calibrations included.
    #[must_use]
    pub fn n_frames(&self) -> u64 {
        let product = |factors: [u64; 4]| factors.into_iter().fold(1u64, u64::saturating_mul);
        let sample = product([
            self.theta_c_deg.len() as u64,
            self.phi_s_deg.len() as u64,
            self.exposures_s.len() as u64,
            u64::from(self.repeats),
        ]);
        let flat = product([
            self.flat.theta_c_deg.len() as u64,
            self.flat.exposures_s.len() as u64,
            u64::from(self.flat.repeats),
            1,
        ]);
        let dark = product([
            self.all_exposures_s().len() as u64,
            u64::from(self.dark.repeats),
            1,
            1,
        ]);
        sample.saturating_add(flat).saturating_add(dark)
    }

    /// The steps in order: dark frames, white reference, sample; `start` is where the stages stand.
    /// The plan must have passed [`Plan::check`].
    ///
    /// Of the orders tried (either axis outside, there and back or always the same way) the one
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
            let phi_s = self.phi_s_deg.iter().copied().fold(f64::INFINITY, f64::min);
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
        steps.push(Step::Operator(OperatorAction::PlaceSample));
        let first = 1 + self.flat.theta_c_deg.len() as u32;
        for visit in quickest_order(&self.theta_c_deg, &self.phi_s_deg, limits, at, move_time) {
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
    /// Place in the lists: tilt × number of azimuths + azimuth.
    place: u32,
    /// As the plan states it.
    pose: Pose,
    /// Where the stages go for it.
    target: Pose,
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
        .map(|(place, deg)| {
            let asked = Angle::from_deg(deg);
            let target = match limits.reachable_phi_s(asked) {
                Some(angle) if angle != asked => angle.deg(),
                _ => deg,
            };
            (place, deg, target)
        })
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

fn check_list(field: &str, values: &[f64], problems: &mut Vec<PlanProblem>) {
    if values.is_empty() {
        problems.push(PlanProblem::new(field, "is empty; give at least one value"));
    }
    if values.len() > LIST_LENGTH_MAX {
        problems.push(PlanProblem::new(
            field,
            format!(
                "has {} values; at most {LIST_LENGTH_MAX} are allowed",
                values.len()
            ),
        ));
        return;
    }
    let mut order: Vec<usize> = (0..values.len())
        .filter(|i| values[*i].is_finite())
        .collect();
    for (i, value) in values.iter().enumerate() {
        if !value.is_finite() {
            problems.push(PlanProblem::new(
                format!("{field}[{i}]"),
                format!("{value} is not a finite number"),
            ));
        }
    }
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    for pair in order.windows(2) {
        let (first, second) = (pair[0].min(pair[1]), pair[0].max(pair[1]));
        if (values[first] - values[second]).abs() < SAME_ANGLE_DEG {
            problems.push(PlanProblem::new(
                format!("{field}[{second}]"),
                format!("{} is there twice; use repeats instead", values[second]),
            ));
        }
    }
}

fn check_tilts(
    field: &str,
    values: &[f64],
    limits: &TravelLimits,
    problems: &mut Vec<PlanProblem>,
) {
    for (i, deg) in values.iter().enumerate().take(LIST_LENGTH_MAX) {
        if deg.is_finite() && !within(Angle::from_deg(*deg), limits.theta_c) {
            problems.push(PlanProblem::new(
                format!("{field}[{i}]"),
                format!(
                    "{deg}° is outside the travel of theta_c, {:.3} to {:.3}",
                    limits.theta_c.0, limits.theta_c.1
                ),
            ));
        }
    }
}

fn check_exposures(field: &str, values: &[f64], problems: &mut Vec<PlanProblem>) {
    if values.is_empty() {
        problems.push(PlanProblem::new(
            field,
            "is empty; give at least one exposure",
        ));
    }
    if values.len() > 100 {
        problems.push(PlanProblem::new(field, "has more than 100 exposures"));
        return;
    }
    for (i, value) in values.iter().enumerate() {
        if !(EXPOSURE_S_MIN..=EXPOSURE_S_MAX).contains(value) {
            problems.push(PlanProblem::new(
                format!("{field}[{i}]"),
                format!("{value} s is not between {EXPOSURE_S_MIN} and {EXPOSURE_S_MAX} s"),
            ));
        } else if values[..i].contains(value) {
            problems.push(PlanProblem::new(
                format!("{field}[{i}]"),
                format!("{value} s is there twice; use repeats instead"),
            ));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> TravelLimits {
        TravelLimits {
            theta_c: (Angle::from_deg(-60.0), Angle::from_deg(60.0)),
            phi_s: (Angle::from_deg(-10.0), Angle::from_deg(345.0)),
        }
    }

    fn defaults() -> PlanDefaults {
        PlanDefaults {
            exposures_s: vec![0.02, 0.06, 0.18],
            flat_exposures_s: vec![0.02, 0.06],
            dark_repeats: 4,
            flat_repeats: 1,
        }
    }

    fn paper() -> Plan {
        PlanRequest::preset(Preset::Paper)
            .resolve(&defaults())
            .unwrap()
    }

    /// Both axes at once, at 10 °/s and 30 °/s.
    fn move_time(from: Pose, to: Pose) -> Duration {
        let theta = (to.theta_c - from.theta_c).abs().deg() / 10.0;
        let phi = (to.phi_s - from.phi_s).abs().deg() / 30.0;
        Duration::from_secs_f64(theta.max(phi))
    }

    fn shots(steps: &[Step]) -> Vec<&Shot> {
        steps
            .iter()
            .filter_map(|step| match step {
                Step::Shot(shot) => Some(shot),
                Step::Operator(_) => None,
            })
            .collect()
    }

    #[test]
    fn the_full_preset_has_the_frames_of_the_recorded_series() {
        let plan = PlanRequest::preset(Preset::Full)
            .resolve(&defaults())
            .unwrap();
        plan.check(&limits()).unwrap();
        // 108 poses × 3 exposures, 9 tilts × 2 exposures, 3 exposures × 4 repeats
        assert_eq!(plan.n_frames(), 324 + 18 + 12);
        let steps = plan.steps(&limits(), Pose::from_deg(0.0, 0.0), &move_time);
        let total = estimate(&steps, Pose::from_deg(0.0, 0.0), &move_time, 1000);
        assert_eq!(u64::from(total.n_frames), plan.n_frames());
        assert_eq!(total.disk_bytes, 354_000);
    }

    #[test]
    fn the_order_visits_every_pose_once_and_beats_the_order_of_the_lists() {
        let plan = paper();
        let start = Pose::from_deg(0.0, 0.0);
        let steps = plan.steps(&limits(), start, &move_time);
        let sample: Vec<Pose> = shots(&steps)
            .into_iter()
            .filter(|shot| shot.kind == FrameKind::Sample)
            .filter_map(|shot| shot.pose)
            .collect();
        let mut naive = Vec::new();
        for theta in &plan.theta_c_deg {
            for phi in &plan.phi_s_deg {
                let pose = Pose::from_deg(*theta, *phi);
                assert_eq!(sample.iter().filter(|p| **p == pose).count(), 1);
                naive.push(pose);
            }
        }
        let cost = |poses: &[Pose]| {
            poses
                .windows(2)
                .map(|w| move_time(w[0], w[1]))
                .sum::<Duration>()
        };
        assert!(cost(&sample) < cost(&naive));
        // Serpentine over 5 tilts (1 s apart) inside 3 azimuths (3 s apart): 3·4·1 + 2·3.
        assert!((cost(&sample).as_secs_f64() - 18.0).abs() < 1e-6);
    }

    #[test]
    fn an_azimuth_beyond_the_travel_is_reached_by_another_turn() {
        let request = PlanRequest {
            theta_c_deg: Some(Values::List(vec![0.0])),
            phi_s_deg: Some(Values::List(vec![0.0, 355.0])),
            ..PlanRequest::default()
        };
        let plan = request.resolve(&defaults()).unwrap();
        plan.check(&limits()).unwrap();
        let steps = plan.steps(&limits(), Pose::from_deg(0.0, 0.0), &move_time);
        let shot = shots(&steps)
            .into_iter()
            .find(|shot| shot.pose == Some(Pose::from_deg(0.0, 355.0)))
            .unwrap();
        assert!((shot.target.unwrap().phi_s.deg() + 5.0).abs() < 1e-9);
    }

    #[test]
    fn a_points_index_does_not_depend_on_where_the_stages_stand() {
        let index = |start: Pose| {
            let steps = paper().steps(&limits(), start, &move_time);
            let mut all: Vec<(u32, f64, f64)> = shots(&steps)
                .into_iter()
                .filter_map(|s| s.pose.map(|p| (s.index, p.theta_c.deg(), p.phi_s.deg())))
                .collect();
            all.sort_by_key(|a| a.0);
            all
        };
        let here = index(Pose::from_deg(-20.0, 0.0));
        assert_eq!(here, index(Pose::from_deg(20.0, 180.0)));
        assert!(here.windows(2).all(|w| w[0].0 < w[1].0));
    }

    #[test]
    fn everything_wrong_is_named_at_once() {
        let mut plan = paper();
        plan.theta_c_deg = vec![f64::NAN, 75.0, 10.0, 10.0];
        plan.phi_s_deg = vec![];
        plan.exposures_s = vec![-1.0, 0.1, 0.1];
        plan.repeats = 0;
        let error = plan.check(&limits()).unwrap_err();
        let fields: Vec<&str> = error.problems.iter().map(|p| p.field.as_str()).collect();
        for field in [
            "plan.theta_c_deg[0]",
            "plan.theta_c_deg[1]",
            "plan.theta_c_deg[3]",
            "plan.phi_s_deg",
            "plan.exposures_s[0]",
            "plan.exposures_s[2]",
            "plan.repeats",
        ] {
            assert!(fields.contains(&field), "{field} is not in {fields:?}");
        }
    }

    #[test]
    fn a_thousand_million_points_are_refused_before_they_take_memory() {
        let request = PlanRequest {
            theta_c_deg: Some(Values::Grid(Grid {
                from: -20.0,
                to: 20.0,
                step: 4e-8,
            })),
            phi_s_deg: Some(Values::List(vec![0.0])),
            ..PlanRequest::default()
        };
        let error = request.resolve(&defaults()).unwrap_err();
        assert_eq!(error.problems[0].field, "plan.theta_c_deg");
        let mut plan = paper();
        plan.repeats = u32::MAX;
        assert!(plan.check(&limits()).is_err());
    }

    #[test]
    fn a_plan_file_with_an_unknown_key_is_refused_by_its_name() {
        let error = PlanRequest::from_toml("preset = \"paper\"\nexposure_s = [1.0]").unwrap_err();
        assert!(error.to_string().contains("exposure_s"), "{error}");
        assert!(error.to_string().contains("exposures_s"), "{error}");
    }

    #[test]
    fn a_grid_reaches_its_last_value() {
        let text = "theta_c_deg = {from = -20, to = 20, step = 5}\nphi_s_deg = [0.0]";
        let plan = PlanRequest::from_toml(text)
            .unwrap()
            .resolve(&defaults())
            .unwrap();
        assert_eq!(plan.theta_c_deg.len(), 9);
        assert_eq!(plan.theta_c_deg[8], 20.0);
    }
}
