//! What a request for a scan looks like, for the description alone: what reads it is `scan`'s own
//! [`PlanRequest`], which knows no HTTP. A test holds the two together.
//!
//! [`PlanRequest`]: crate::scan::PlanRequest

#![expect(dead_code, reason = "these describe; nobody makes one")]

use utoipa::ToSchema;

/// A scan that is asked for.
#[derive(ToSchema)]
#[schema(as = ScanRequest)]
#[serde(deny_unknown_fields)]
pub struct ScanAsked {
    /// Number of the sample to scan.
    sample_id: i64,
    /// Poses, exposures and repeats of the scan.
    plan: PlanAsked,
}

/// A plan: angles, or a preset that has them; the rig's settings know the rest.
#[derive(ToSchema)]
#[schema(as = PlanRequest)]
#[serde(deny_unknown_fields)]
pub struct PlanAsked {
    /// A named plan whose angles count where none are given: `paper` or `full`.
    preset: Option<PresetAsked>,
    /// Camera tilts θc, degrees.
    theta_c_deg: Option<ValuesAsked>,
    /// Sample azimuths φs, degrees.
    phi_s_deg: Option<ValuesAsked>,
    /// Exposure times of the sample, s; the rig's if not given.
    exposures_s: Option<Vec<f64>>,
    /// Frames per pose and exposure; 1 if not given.
    repeats: Option<u32>,
    /// Dark frames.
    #[schema(required = false)]
    dark: DarkAsked,
    /// White-reference frames.
    #[schema(required = false)]
    flat: FlatAsked,
    /// Whether valid calibration frames save their operator steps; true if not given.
    reuse_calibrations: Option<bool>,
}

/// A plan that has a name.
#[derive(ToSchema)]
#[schema(as = Preset)]
#[serde(rename_all = "lowercase")]
pub enum PresetAsked {
    /// θc −20 to 20 by 10, φs 0, 90 and 180.
    Paper,
    /// Nine tilts, twelve azimuths.
    Full,
}

/// A list of numbers, written out or as a grid.
#[derive(ToSchema)]
#[schema(as = Values)]
#[serde(untagged)]
pub enum ValuesAsked {
    /// One value after the other.
    List(Vec<f64>),
    /// From, to (inclusive) and step.
    Grid(GridAsked),
}

/// Evenly spaced values.
#[derive(ToSchema)]
#[schema(as = Grid)]
#[serde(deny_unknown_fields)]
pub struct GridAsked {
    /// First value, degrees.
    from: f64,
    /// Last value, degrees; included if the steps reach it.
    to: f64,
    /// Distance between values, degrees; above 0.
    step: f64,
}

/// Dark frames of a plan.
#[derive(ToSchema)]
#[schema(as = DarkRequest)]
#[serde(deny_unknown_fields)]
pub struct DarkAsked {
    /// Frames per exposure; 0 leaves the dark frames out.
    repeats: Option<u32>,
}

/// White-reference frames of a plan.
#[derive(ToSchema)]
#[schema(as = FlatRequest)]
#[serde(deny_unknown_fields)]
pub struct FlatAsked {
    /// Camera tilts, degrees; those of the sample if not given.
    theta_c_deg: Option<ValuesAsked>,
    /// Exposure times, s; the rig's for the white reference if not given.
    exposures_s: Option<Vec<f64>>,
    /// Frames per tilt and exposure; 0 leaves the white reference out.
    repeats: Option<u32>,
}
