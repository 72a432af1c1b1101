//! What requests for scans and fits look like, for the description alone: what reads them is `scan`'s own
//! [`PlanRequest`] and `lab`'s own [`FitRequest`], which know no HTTP. A test holds them together.
//!
//! [`PlanRequest`]: crate::scan::PlanRequest
//! [`FitRequest`]: crate::lab::FitRequest

#![expect(dead_code, reason = "these describe; nobody makes one")]

use std::collections::BTreeMap;

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
    /// Frames per pose and exposure; 1 if not given. 0: dark and white-reference frames alone, new ones, for scans to come.
    repeats: Option<u32>,
    /// Dark frames.
    #[schema(required = false)]
    dark: DarkAsked,
    /// White-reference frames.
    #[schema(required = false)]
    flat: FlatAsked,
    /// Whether valid calibration frames save their operator steps; true if not given and there is a sample.
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

/// A fit that is asked for.
#[derive(ToSchema)]
#[schema(as = FitRequest)]
#[serde(deny_unknown_fields)]
pub struct FitAsked {
    /// Scan to fit.
    scan_id: i64,
    /// Variant; auto if not given.
    #[schema(required = false)]
    variant: VariantAsked,
    /// Region of a sample that has several.
    region: Option<String>,
    /// True: the difference to traced is the model line of the budget.
    #[schema(required = false)]
    judge: bool,
    /// True: the report has a descent step by step.
    #[schema(required = false)]
    iterations: bool,
    /// End search, ray tracer and bootstrap after this time, s.
    max_seconds: Option<f64>,
    /// End the ray tracer once its standard error, as a share of the largest radiance, is below this.
    target_error: Option<f64>,
    /// Share of the peak that may be left out of the model.
    tolerance: Option<f64>,
    /// The sample measured, for traced or judge; the ideal sawtooth if not given.
    shape: Option<ShapeAsked>,
    /// How residuals count; linear if not given.
    #[schema(required = false)]
    loss: LossAsked,
    /// Parameters held, by the names of the report, and eta, k: {"rho_d": 0.3}.
    #[schema(required = false)]
    fix: BTreeMap<String, f64>,
    /// Parameters known within a standard uncertainty, by the same names.
    #[schema(required = false)]
    priors: BTreeMap<String, PriorAsked>,
    /// Most starts of a search, per variant; if not given 8, and as many more as a doubt about these asks for.
    #[schema(minimum = 1, maximum = 1024)]
    starts: Option<u32>,
    /// True: profile-likelihood intervals.
    #[schema(required = false)]
    profile: bool,
    /// Series drawn for bootstrap intervals; none if not given.
    #[schema(minimum = 20, maximum = 100_000)]
    bootstrap: Option<u32>,
}

/// Which variant the report shall hang on.
#[derive(ToSchema)]
#[schema(as = VariantChoice)]
#[serde(rename_all = "lowercase")]
pub enum VariantAsked {
    /// As printed.
    Paper,
    /// The sawtooth in full.
    Sawtooth,
    /// The sawtooth corrected by the ray tracer.
    Traced,
    /// The better one of paper and sawtooth.
    Auto,
}

/// How residuals count.
#[derive(ToSchema)]
#[schema(as = Loss)]
#[serde(rename_all = "lowercase")]
pub enum LossAsked {
    /// Least squares.
    Linear,
    /// Linear beyond 1.345 standard uncertainties.
    Huber,
    /// Not at all beyond 4.685 standard uncertainties.
    Tukey,
}

/// A parameter known within a standard uncertainty.
#[derive(ToSchema)]
#[schema(as = Prior)]
#[serde(deny_unknown_fields)]
pub struct PriorAsked {
    /// Its value.
    value: f64,
    /// Its standard uncertainty.
    std: f64,
}

/// The sample's own shape, measured: a profile or a height map.
#[derive(ToSchema)]
#[schema(as = ShapeFile)]
#[serde(deny_unknown_fields)]
pub struct ShapeAsked {
    /// Its name: the ending tells how the heights are written (csv, png, tif, x3p, sdf).
    name: String,
    /// What is in it, base64.
    content: String,
    /// Spacing of samples, µm, where the file does not say it.
    pitch_um: Option<PitchAsked>,
    /// Micrometres per unit of the heights, where the file does not say it.
    height_unit_um: Option<f64>,
}

/// One number for both axes, or one for each.
#[derive(ToSchema)]
#[schema(as = Pitch)]
#[serde(untagged)]
pub enum PitchAsked {
    /// Along rows and columns.
    Both(f64),
    /// Along the rows, along the columns.
    Each([f64; 2]),
}
