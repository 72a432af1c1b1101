//! What can be wrong with a plan, all of it at once.

use std::collections::HashMap;

use serde::{Deserialize, Serialize};

use super::{
    ANGLE_DEG_MAX, EXPOSURE_S_MAX, EXPOSURE_S_MIN, FRAMES_MAX, LIST_LENGTH_MAX, Plan, PlanPose,
};
use crate::units::Angle;
use crate::wording::stated;

/// Two angles closer than this are the same point.
const SAME_ANGLE_DEG: f64 = 1e-6;

/// Memory that the frames of one point may take.
const POINT_BYTES_MAX: u64 = 4_000_000_000;

/// One thing that is wrong with a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PlanProblem {
    /// Where, e.g. `plan.theta_c_deg[2]`.
    pub field: String,
    /// What, with the allowed values.
    pub message: String,
    /// The value, the least and the greatest allowed one, where it is out of this range; in the unit of the field.
    pub out_of_range: Option<[f64; 3]>,
}

impl PlanProblem {
    /// A problem without a range.
    pub fn new(field: impl Into<String>, message: impl Into<String>) -> Self {
        PlanProblem {
            field: field.into(),
            message: message.into(),
            out_of_range: None,
        }
    }

    fn out_of_range(mut self, value: f64, (lower, upper): (f64, f64)) -> Self {
        self.out_of_range = Some([value, lower, upper]);
        self
    }
}

/// Everything that is wrong with a plan.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
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
            .find(|angle| self.reaches_phi_s(*angle))
    }

    /// Whether φs is within the limits.
    #[must_use]
    pub fn reaches_phi_s(&self, phi_s: Angle) -> bool {
        within(phi_s, self.phi_s)
    }
}

fn within(angle: Angle, (min, max): (Angle, Angle)) -> bool {
    // A stage's limit is inclusive; degrees written in a file must not miss it by rounding.
    let slack = Angle::from_deg(1e-9);
    angle >= min - slack && angle <= max + slack
}

impl Plan {
    /// Lists everything that is wrong with the plan.
    ///
    /// # Errors
    /// [`PlanError`] with one entry per problem.
    pub fn check(&self, limits: &TravelLimits) -> Result<(), PlanError> {
        let mut problems = Vec::new();
        match self.poses.is_empty() {
            true => self.check_grid(limits, &mut problems),
            false => check_poses(&self.poses, limits, &mut problems),
        }
        check_exposures("plan.exposures_s", &self.exposures_s, &mut problems);
        if self.repeats == 0 && self.dark.repeats == 0 && self.flat.repeats == 0 {
            problems.push(PlanProblem::new(
                "plan.repeats",
                "must be at least 1 where neither dark frames nor a white reference are taken",
            ));
        }
        if self.flat.repeats > 0 {
            // Tilts that were taken over from the sample are judged there.
            let taken_over = self.flat.theta_c_deg.len() == self.theta_c_deg.len()
                && std::iter::zip(&self.flat.theta_c_deg, &self.theta_c_deg)
                    .all(|(flat, sample)| flat.to_bits() == sample.to_bits());
            if !taken_over {
                let field = "plan.flat.theta_c_deg";
                check_list(field, &self.flat.theta_c_deg, &mut problems);
                check_tilts(field, &self.flat.theta_c_deg, limits, &mut problems);
            }
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
        none_of(problems)
    }

    fn check_grid(&self, limits: &TravelLimits, problems: &mut Vec<PlanProblem>) {
        // Without a sample only what is stated has to make sense.
        for (field, values) in [
            ("plan.theta_c_deg", &self.theta_c_deg),
            ("plan.phi_s_deg", &self.phi_s_deg),
        ] {
            if self.repeats > 0 || !values.is_empty() {
                check_list(field, values, problems);
            }
        }
        check_tilts("plan.theta_c_deg", &self.theta_c_deg, limits, problems);
        for (i, deg) in self.phi_s_deg.iter().enumerate() {
            check_azimuth(|| format!("plan.phi_s_deg[{i}]"), *deg, limits, problems);
        }
    }

    /// Lists the points that have more frames than memory should hold: a point counts as a whole, and until its last
    /// frame is taken none is written. `frame_bytes` is what one takes.
    ///
    /// # Errors
    /// [`PlanError`] with one entry per kind of frame.
    pub fn check_points(&self, frame_bytes: u64) -> Result<(), PlanError> {
        let most = (POINT_BYTES_MAX / frame_bytes.max(1)).max(1);
        let points = [
            ("plan.repeats", self.exposures_s.len(), self.repeats),
            (
                "plan.dark.repeats",
                self.all_exposures_s().len(),
                self.dark.repeats,
            ),
            (
                "plan.flat.repeats",
                self.flat.exposures_s.len(),
                self.flat.repeats,
            ),
        ];
        let too_many = points.into_iter().filter_map(|(field, exposures, repeats)| {
            let frames = exposures as u64 * u64::from(repeats);
            (frames > most).then(|| {
                PlanProblem::new(
                    field,
                    format!(
                        "{exposures} exposures × {repeats} repeats are {frames} frames at one point, which is kept as a \
                         whole; of this camera's, at most {most} ({} GB) are allowed: repeat less, or scan several times",
                        POINT_BYTES_MAX / 1_000_000_000
                    ),
                )
            })
        });
        none_of(too_many.collect())
    }
}

fn none_of(problems: Vec<PlanProblem>) -> Result<(), PlanError> {
    if problems.is_empty() {
        Ok(())
    } else {
        Err(PlanError { problems })
    }
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
                format!(
                    "{} is given twice; use repeats instead",
                    stated(values[second])
                ),
            ));
        }
    }
}

/// Checks poses that are stated one by one.
fn check_poses(poses: &[PlanPose], limits: &TravelLimits, problems: &mut Vec<PlanProblem>) {
    if poses.len() > LIST_LENGTH_MAX {
        problems.push(PlanProblem::new(
            "plan.poses",
            format!(
                "has {} poses; at most {LIST_LENGTH_MAX} are allowed",
                poses.len()
            ),
        ));
        return;
    }
    let mut first_at = HashMap::new();
    for (i, pose) in poses.iter().enumerate() {
        let field = |axis: &str| format!("plan.poses[{i}].{axis}_deg");
        for (axis, deg) in [("theta_c", pose.theta_c_deg), ("phi_s", pose.phi_s_deg)] {
            if !deg.is_finite() {
                let problem = format!("{deg} is not a finite number");
                problems.push(PlanProblem::new(field(axis), problem));
            }
        }
        check_tilt(|| field("theta_c"), pose.theta_c_deg, limits, problems);
        check_azimuth(|| field("phi_s"), pose.phi_s_deg, limits, problems);
        let angles_deg = [pose.theta_c_deg, pose.phi_s_deg];
        if !angles_deg.into_iter().all(f64::is_finite) {
            continue;
        }
        let place = angles_deg.map(|deg| (deg / SAME_ANGLE_DEG).round() as i64);
        if let Some(first) = first_at.insert(place, i) {
            let problem = format!("is the same as plan.poses[{first}]; use repeats instead");
            problems.push(PlanProblem::new(format!("plan.poses[{i}]"), problem));
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
        check_tilt(|| format!("{field}[{i}]"), *deg, limits, problems);
    }
}

fn check_tilt(
    field: impl Fn() -> String,
    deg: f64,
    limits: &TravelLimits,
    problems: &mut Vec<PlanProblem>,
) {
    if deg.is_finite() && !within(Angle::from_deg(deg), limits.theta_c) {
        let (lower, upper) = limits.theta_c;
        let problem = format!(
            "{}° is outside the travel of theta_c, {lower:.3} to {upper:.3}",
            stated(deg)
        );
        let range = (lower.deg_for_tables(), upper.deg_for_tables());
        problems.push(PlanProblem::new(field(), problem).out_of_range(deg, range));
    }
}

fn check_azimuth(
    field: impl Fn() -> String,
    deg: f64,
    limits: &TravelLimits,
    problems: &mut Vec<PlanProblem>,
) {
    let is_reached =
        deg.abs() <= ANGLE_DEG_MAX && limits.reachable_phi_s(Angle::from_deg(deg)).is_some();
    if deg.is_finite() && !is_reached {
        let (lower, upper) = limits.phi_s;
        let problem = format!(
            "{}° is outside the travel of phi_s, {lower:.3} to {upper:.3}, on every turn",
            stated(deg)
        );
        let range = (lower.deg_for_tables(), upper.deg_for_tables());
        problems.push(PlanProblem::new(field(), problem).out_of_range(deg, range));
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
            let problem = PlanProblem::new(
                format!("{field}[{i}]"),
                format!(
                    "{} s is outside {EXPOSURE_S_MIN} to {EXPOSURE_S_MAX} s",
                    stated(*value)
                ),
            );
            problems.push(problem.out_of_range(*value, (EXPOSURE_S_MIN, EXPOSURE_S_MAX)));
        } else if values[..i].contains(value) {
            problems.push(PlanProblem::new(
                format!("{field}[{i}]"),
                format!("{value} s is given twice; use repeats instead"),
            ));
        }
    }
}
