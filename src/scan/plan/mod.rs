//! A plan is data: it is checked, ordered, timed and sized before anything moves.
//!
//! [`PlanRequest`] is what a file or a request says; [`PlanRequest::resolve`] fills in the preset
//! and the defaults; [`Plan::check`] lists everything that is wrong; [`Plan::steps`] gives the
//! points in the order that costs the least motion. No hardware here.

mod check;
mod order;

use serde::{Deserialize, Serialize};

use crate::limits::EXPOSURE_S;
use crate::wording::stated;
use crate::wording::toml_text::{self, Refused};

pub use check::{PlanError, PlanProblem, TravelLimits};
pub use order::{Estimate, MoveTime, Shot, Step, estimate};

/// Most values in one list of angles or exposures.
pub const LIST_LENGTH_MAX: usize = 10_000;
/// Most frames in one plan.
pub const FRAMES_MAX: u64 = 1_000_000;
/// Longest exposure in seconds.
pub const EXPOSURE_S_MAX: f64 = EXPOSURE_S.high;
/// Shortest exposure in seconds.
pub const EXPOSURE_S_MIN: f64 = EXPOSURE_S.low;

/// A list of numbers, written out or as a grid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(
    untagged,
    expecting = "a list of numbers, or an object of from, to and step, is expected"
)]
pub enum Values {
    /// One value after the other.
    List(Vec<f64>),
    /// From, to (inclusive) and step.
    Grid(Grid),
}

/// Largest angle of a plan, degrees: series record azimuths up to it.
pub const ANGLE_DEG_MAX: f64 = 1e6;

/// Evenly spaced values.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Grid {
    /// First value.
    #[schema(minimum = -1e6, maximum = 1e6)]
    pub from: f64,
    /// Last value, reached if the step meets it.
    #[schema(minimum = -1e6, maximum = 1e6)]
    pub to: f64,
    /// Distance between values; positive.
    #[schema(exclusive_minimum = 0, maximum = 1e6)]
    pub step: f64,
}

impl Values {
    /// The values one by one; a grid that is senseless or beyond [`LIST_LENGTH_MAX`] is an error
    /// before memory is taken for it.
    fn expand(&self, field: &str, problems: &mut Vec<PlanProblem>) -> Vec<f64> {
        match self {
            Values::List(list) => list.clone(),
            Values::Grid(Grid { from, to, step }) => {
                let is_within = from.abs().max(to.abs()) <= ANGLE_DEG_MAX;
                if !(is_within && *step > 0.0 && *step <= ANGLE_DEG_MAX && from <= to) {
                    problems.push(PlanProblem::new(
                        field,
                        format!(
                            "a grid needs from ≤ to and a positive step, all within ±{ANGLE_DEG_MAX}, not {}, {}, {}",
                            stated(*from),
                            stated(*to),
                            stated(*step)
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
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

/// A pose that a plan states.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PlanPose {
    /// Camera tilt θc, degrees.
    #[schema(minimum = -1e6, maximum = 1e6)]
    pub theta_c_deg: f64,
    /// Sample azimuth φs, degrees.
    #[schema(minimum = -1e6, maximum = 1e6)]
    pub phi_s_deg: f64,
}

/// Dark frames of a request.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct DarkRequest {
    /// Frames per exposure; 0 leaves the dark frames out.
    #[schema(minimum = 0, maximum = 1_000_000)]
    pub repeats: Option<u32>,
}

/// White-reference frames of a request.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct FlatRequest {
    /// Tilts; those of the sample if not given.
    pub theta_c_deg: Option<Values>,
    /// Exposures; the rig's for the white reference if not given.
    #[schema(max_items = 10_000)]
    pub exposures_s: Option<Vec<f64>>,
    /// Frames per tilt and exposure; 0 leaves the white reference out.
    #[schema(minimum = 0, maximum = 1_000_000)]
    pub repeats: Option<u32>,
}

/// A plan as a file or a request states it: everything may be left out that a preset or the rig's
/// settings know. Unknown keys are errors.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(deny_unknown_fields)]
pub struct PlanRequest {
    /// A named plan, `paper` or `full`, whose angles apply where none are given.
    pub preset: Option<Preset>,
    /// Camera tilts θc, degrees.
    pub theta_c_deg: Option<Values>,
    /// Sample azimuths φs, degrees.
    pub phi_s_deg: Option<Values>,
    /// Poses of the sample one by one, visited in this order, instead of tilts and azimuths.
    #[schema(min_items = 1, max_items = 10_000)]
    pub poses: Option<Vec<PlanPose>>,
    /// Exposure times of the sample, s; the rig's if omitted.
    #[schema(max_items = 10_000)]
    pub exposures_s: Option<Vec<f64>>,
    /// Frames per pose and exposure; 1 if omitted. 0 takes new dark and white-reference frames only, for later scans.
    #[schema(minimum = 0, maximum = 1_000_000)]
    pub repeats: Option<u32>,
    /// Dark frames.
    #[serde(default)]
    pub dark: DarkRequest,
    /// White-reference frames.
    #[serde(default)]
    pub flat: FlatRequest,
    /// Whether valid calibration frames replace their operator steps; true if omitted and the plan has a sample.
    pub reuse_calibrations: Option<bool>,
    /// Points of the sample between two checks of a reference pose; 0 for none. Default: the rig's settings.
    #[schema(minimum = 0, maximum = 4_294_967_295_i64)]
    pub reference_every: Option<u32>,
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
    /// Points between two checks of a reference pose; 0 for none.
    pub reference_every: u32,
}

/// A whole plan, nothing left open.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct Plan {
    /// Camera tilts, degrees; where the plan states poses, each tilt among them once.
    pub theta_c_deg: Vec<f64>,
    /// Sample azimuths, degrees; where the plan states poses, each azimuth among them once.
    pub phi_s_deg: Vec<f64>,
    /// Poses of the sample in the order of the visits; empty where each tilt is visited at each azimuth.
    #[serde(default)]
    pub poses: Vec<PlanPose>,
    /// Exposures of the sample.
    pub exposures_s: Vec<f64>,
    /// Frames per pose and exposure; 0 for none of the sample.
    pub repeats: u32,
    /// Dark frames, taken at every exposure used.
    pub dark: DarkPlan,
    /// White-reference frames.
    pub flat: FlatPlan,
    /// Whether valid calibration frames save their operator steps.
    pub reuse_calibrations: bool,
    /// Points of the sample between two checks of a reference pose; 0 for none.
    #[serde(default)]
    pub reference_every: u32,
}

/// Dark frames of a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct DarkPlan {
    /// Frames per exposure; 0 for none.
    pub repeats: u32,
}

/// White-reference frames of a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct FlatPlan {
    /// Tilts.
    pub theta_c_deg: Vec<f64>,
    /// Exposures.
    pub exposures_s: Vec<f64>,
    /// Frames per tilt and exposure; 0 for none.
    pub repeats: u32,
}

impl PlanRequest {
    /// Reads a plan file.
    ///
    /// # Errors
    /// The first thing that is wrong with it: line, key and what is allowed.
    pub fn from_toml(text: &str) -> Result<Self, Refused> {
        toml_text::read(text)
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
        let repeats = self.repeats.unwrap_or(1);
        let flat_repeats = self.flat.repeats.unwrap_or(defaults.flat_repeats);
        let of_the_sample = repeats > 0;
        let of_tilts = of_the_sample || (flat_repeats > 0 && self.flat.theta_c_deg.is_none());
        let (preset_theta, preset_phi) = match &self.poses {
            Some(poses) => {
                if self.preset.is_some() || self.theta_c_deg.is_some() || self.phi_s_deg.is_some() {
                    problems.push(PlanProblem::new(
                        "plan.poses",
                        "replace preset, theta_c_deg and phi_s_deg: leave these out, or the poses",
                    ));
                }
                if poses.is_empty() {
                    problems.push(PlanProblem::new(
                        "plan.poses",
                        "is empty; give at least one pose",
                    ));
                }
                (
                    Some(each_once(poses, |pose| pose.theta_c_deg)),
                    Some(each_once(poses, |pose| pose.phi_s_deg)),
                )
            }
            None => preset.unzip(),
        };
        let mut angles = |given: &Option<Values>,
                          preset: Option<Vec<f64>>,
                          needed: bool,
                          field: &str| match (given, preset) {
            (Some(values), _) => values.expand(field, &mut problems),
            (None, Some(values)) => values,
            (None, None) if !needed => Vec::new(),
            (None, None) => {
                problems.push(PlanProblem::new(
                    field,
                    "missing: give a list, a grid {from, to, step}, a preset (paper, full), or poses",
                ));
                Vec::new()
            }
        };
        let theta_c_deg = angles(
            &self.theta_c_deg,
            preset_theta,
            of_tilts,
            "plan.theta_c_deg",
        );
        let phi_s_deg = angles(&self.phi_s_deg, preset_phi, of_the_sample, "plan.phi_s_deg");
        let flat_theta_c_deg = angles(
            &self.flat.theta_c_deg,
            Some(theta_c_deg.clone()),
            true,
            "plan.flat.theta_c_deg",
        );
        if !of_the_sample && self.reuse_calibrations == Some(true) {
            problems.push(PlanProblem::new(
                "plan.reuse_calibrations",
                "must not be true where repeats is 0: such frames are taken to be new",
            ));
        }
        if !problems.is_empty() {
            return Err(PlanError { problems });
        }
        Ok(Plan {
            theta_c_deg,
            phi_s_deg,
            poses: self.poses.clone().unwrap_or_default(),
            exposures_s: self
                .exposures_s
                .clone()
                .unwrap_or_else(|| defaults.exposures_s.clone()),
            repeats,
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
                repeats: flat_repeats,
            },
            reuse_calibrations: self.reuse_calibrations.unwrap_or(of_the_sample),
            reference_every: self.reference_every.unwrap_or(defaults.reference_every),
        })
    }
}

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

    /// Whether the plan takes dark and white-reference frames only.
    #[must_use]
    pub const fn is_calibration(&self) -> bool {
        self.repeats == 0
    }

    /// Poses θc, φs of the sample, degrees, ascending.
    #[must_use]
    pub fn sample_poses_deg(&self) -> Vec<[f64; 2]> {
        let stated = self.poses.iter();
        let mut poses: Vec<[f64; 2]> = stated
            .map(|pose| [pose.theta_c_deg, pose.phi_s_deg])
            .collect();
        if poses.is_empty() {
            let at = |theta_c| self.phi_s_deg.iter().map(move |phi_s| [theta_c, *phi_s]);
            poses = self.theta_c_deg.iter().copied().flat_map(at).collect();
        }
        poses.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        poses
    }

    /// Number of poses of the sample.
    #[must_use]
    pub fn n_poses(&self) -> u64 {
        match self.poses.len() as u64 {
            0 => (self.theta_c_deg.len() as u64).saturating_mul(self.phi_s_deg.len() as u64),
            stated => stated,
        }
    }

    /// Frames of the whole plan, all calibrations included.
    #[must_use]
    pub fn n_frames(&self) -> u64 {
        let product = |factors: [u64; 3]| factors.into_iter().fold(1u64, u64::saturating_mul);
        let sample = product([
            self.n_poses(),
            self.exposures_s.len() as u64,
            u64::from(self.repeats),
        ]);
        let flat = product([
            self.flat.theta_c_deg.len() as u64,
            self.flat.exposures_s.len() as u64,
            u64::from(self.flat.repeats),
        ]);
        let dark = product([
            self.all_exposures_s().len() as u64,
            u64::from(self.dark.repeats),
            1,
        ]);
        sample.saturating_add(flat).saturating_add(dark)
    }
}

/// An angle of the poses, each value once, ascending.
fn each_once(poses: &[PlanPose], angle_deg: impl Fn(&PlanPose) -> f64) -> Vec<f64> {
    let mut all: Vec<f64> = poses.iter().map(angle_deg).collect();
    all.sort_by(f64::total_cmp);
    all.dedup();
    all
}

#[cfg(test)]
mod tests;
