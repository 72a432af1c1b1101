//! What a fit looks like when it is asked for, for the description alone: what is sent is the report that the fit
//! wrote, kept as text, with what the store adds. A test holds the two together.

#![expect(dead_code, reason = "these describe; nobody makes one")]

use serde_json::Value;
use utoipa::ToSchema;

use super::asked::{FitAsked, VariantAsked};
use super::words::{FitReferencePlane, FitStatus, FitVariantName, TaskState};

/// A fit: what was asked for and how it stands; from `status` on the report, once there is one.
#[derive(ToSchema)]
#[schema(as = Fit)]
pub struct FitAnswered {
    /// Its number.
    id: i64,
    /// Scan it is of.
    scan_id: i64,
    /// Sample of that scan.
    sample_id: i64,
    /// Name of the sample.
    sample_name: String,
    /// Where it stands.
    state: TaskState,
    /// What was asked for.
    request: FitAsked,
    /// RFC 3339 UTC.
    created_at: String,
    /// RFC 3339 UTC; null while it runs.
    ended_at: Option<String>,
    /// How far it has come, while it runs.
    progress: Option<WorkProgress>,
    /// What it was said to take.
    #[schema(value_type = Option<Object>)]
    forecast: Option<Value>,
    /// Why it has no report.
    error: Option<FitError>,
    /// The variant that the parameters hang on; the one asked for while there is no report.
    variant: VariantAsked,
    /// Region of interest, where the sample has several.
    region: Option<String>,
    /// How the fit ended.
    status: Option<FitStatus>,
    /// Observations fitted.
    n_observations: Option<u64>,
    /// Frames used, darks and flats included.
    n_frames_used: Option<u32>,
    /// The parameters.
    parameters: Option<FitParameters>,
    /// The plane that θr and the azimuth refer to.
    reference_plane: Option<FitReferencePlane>,
    /// What the azimuth says of a wedge across v and of the zero, where it is told.
    wedge_across: Option<FitAcross>,
    /// Root mean square residual, as a share of the largest observation.
    rms_residual: Option<f64>,
    /// The model's discrepancy at the peak, as a share of the largest observation.
    model_discrepancy: Option<f64>,
    /// χ² per degree of freedom, the model's discrepancy among the uncertainties.
    chi2_reduced: Option<f64>,
    /// The same with counting noise alone.
    chi2_reduced_without_model: Option<f64>,
    /// Frames left out.
    rejected_frames: Option<Vec<FrameRejected>>,
    /// Sentences for people, of what they have to look after.
    warnings: Option<Vec<String>>,
    /// Sentences of what is worth knowing and needs nothing done.
    notes: Option<Vec<String>>,
    /// What explains the residual that an ideal sawtooth, a steady lamp and a linear detector leave, most first.
    findings: Option<Vec<FitFinding>>,
    /// How the facets' slopes are distributed; null for the printed form.
    slope_distribution: Option<FitSlopes>,
    /// All variants fitted.
    variants: Option<Vec<FitVariant>>,
    /// What was left out, why, and what it may cost.
    left_out: Option<Vec<WorkLeftOut>>,
    /// What the ray tracer did, where it was asked.
    #[schema(value_type = Option<Object>)]
    tracer: Option<Value>,
    /// Observations beside the fit.
    fitted: Option<Vec<FittedPoint>>,
    /// What the starts did.
    starts: Option<FitStarts>,
    /// A descent to the reported minimum, step by step, where it was asked for.
    iterations: Option<Vec<FitIteration>>,
    /// Degrees of freedom of the two parts of every budget that come from scatter.
    freedom: Option<FitFreedom>,
    /// Seconds spent, by part.
    timing_s: Option<FitTiming>,
    /// Seconds that it took in all, to set beside the forecast.
    seconds: Option<f64>,
    /// Program and version.
    program: Option<String>,
}

/// How far work has come.
#[derive(ToSchema)]
pub struct WorkProgress {
    /// What is being done.
    stage: String,
    /// Share of this stage that is done, 0 to 1.
    fraction: f64,
    /// Seconds since it began.
    elapsed_s: f64,
    /// Seconds left, where that can be told.
    time_left_s: Option<f64>,
}

/// The facets' azimuth from the stage's zero, and what it may come from; degrees.
#[derive(ToSchema)]
pub struct FitAcross {
    /// The facets' azimuth from where the recorded φs and the stated zero have it.
    azimuth_deg: f64,
    /// Its standard uncertainty as the data have it.
    azimuth_std_deg: f64,
    /// Whether wedge and zero are told apart; else each is the whole azimuth, the one or the other.
    split: bool,
    /// Inclination of the sample across v, towards rising azimuth.
    wedge_deg: f64,
    /// Its standard uncertainty; null where it is not told from the zero.
    wedge_std_deg: Option<f64>,
    /// Error of the azimuth's zero: what to add to it.
    azimuth_zero_deg: f64,
    /// Its standard uncertainty; null where it is not told from the wedge.
    azimuth_zero_std_deg: Option<f64>,
}

/// A known trouble of sample, detector or lamp that a fit found.
#[derive(ToSchema)]
pub struct FitFinding {
    /// `tails`, `rounded-crests`, `translucent`, `wedge-across`, `non-linear`, `lamp-drift`, `index`, `bad-block` or `bad-pose`.
    code: String,
    /// Share of χ² that goes with it, 0 to 1.
    explains: f64,
    /// Ridge angle with it accounted for less the one without; null where that cannot be told.
    change_of_theta_r_deg: Option<f64>,
    /// What to do.
    advice: String,
}

/// How the facets' slopes are distributed.
#[derive(ToSchema)]
pub struct FitSlopes {
    /// `beckmann` or `student-t`.
    name: String,
    /// γ of Student's t (GGX is 2); null for Beckmann.
    shape: Option<f64>,
    /// The Beckmann roughness of the same half width along the ridges.
    alpha_half_width_u: Option<f64>,
    /// The same across the ridges.
    alpha_half_width_v: Option<f64>,
}

/// Why a fit has no report.
#[derive(ToSchema)]
pub struct FitError {
    /// Stable word.
    code: String,
    /// Cause and remedy.
    detail: String,
}

/// The parameters of a fit.
#[derive(ToSchema)]
pub struct FitParameters {
    /// Effective ridge angle.
    theta_r_deg: FitParameter,
    /// Roughness along the ridges.
    alpha_u: FitParameter,
    /// Roughness across the ridges.
    alpha_v: FitParameter,
    /// Diffuse reflectance: `paper` as printed, else the Lambertian equivalent of a flat piece.
    rho_d: FitParameter,
    /// Gain of the signals; 1 with a white reference.
    scale: FitParameter,
    /// Stray light, in radiance where the scale is absolute.
    background: FitParameter,
    /// To add to a recorded φs.
    azimuth_offset_deg: FitParameter,
    /// To add to a recorded θc.
    tilt_offset_deg: FitParameter,
    /// Share of the body's light that leaves evenly over the ridges; absent where it is not fitted.
    translucency: Option<FitParameter>,
    /// Radius of the crests over the facets' length; absent where it is not fitted.
    crest_radius: Option<FitParameter>,
}

/// One parameter with its uncertainty; null throughout where the data cannot tell it.
#[derive(ToSchema)]
pub struct FitParameter {
    /// Best value.
    value: Option<f64>,
    /// Standard uncertainty with everything known in it.
    std: Option<f64>,
    /// Expanded uncertainty.
    expanded: Option<f64>,
    /// Expanded over standard uncertainty.
    coverage_factor: Option<f64>,
    /// Effective degrees of freedom; null where practically infinite.
    degrees_of_freedom: Option<f64>,
    /// Whether the data can tell it.
    identifiable: bool,
    /// Parts of the standard uncertainty by name; they combine to it.
    budget: Option<std::collections::BTreeMap<String, f64>>,
    /// Profile-likelihood interval, where it was asked for.
    profile: Option<FitInterval>,
    /// Bootstrap interval, where it was asked for.
    bootstrap: Option<FitInterval>,
    /// Why it is null or fixed.
    note: Option<String>,
}

/// An interval; an end that is not there is open.
#[derive(ToSchema)]
pub struct FitInterval {
    /// Lower end.
    lower: Option<f64>,
    /// Upper end.
    upper: Option<f64>,
}

/// A frame that was left out.
#[derive(ToSchema)]
pub struct FrameRejected {
    /// File name as recorded.
    file: String,
    /// Stable word or short phrase.
    reason: String,
    /// What was seen; may be empty.
    detail: String,
}

/// A variant beside the others.
#[derive(ToSchema)]
pub struct FitVariant {
    /// Which.
    variant: FitVariantName,
    /// How its fit ended.
    status: FitStatus,
    /// Root mean square residual, as a share of the largest observation.
    rms_residual: f64,
    /// χ² per degree of freedom with counting noise alone.
    chi2_reduced_without_model: f64,
    /// Quasi-Akaike criterion; only differences count.
    qaic: f64,
    /// Ridge angle.
    theta_r_deg: Option<f64>,
    /// Roughness along the ridges.
    alpha_u: Option<f64>,
    /// Roughness across the ridges.
    alpha_v: Option<f64>,
    /// Diffuse reflectance.
    rho_d: Option<f64>,
}

/// What was left out.
#[derive(ToSchema)]
pub struct WorkLeftOut {
    /// What.
    what: String,
    /// Why.
    why: String,
    /// What it may cost, as a share of the peak; null where nobody knows.
    cost: Option<f64>,
}

/// An observation beside what the fit expects of it; recorded angles.
#[derive(ToSchema)]
pub struct FittedPoint {
    /// Camera tilt as recorded.
    theta_c_deg: f64,
    /// Sample azimuth as recorded.
    phi_s_deg: f64,
    /// Observed signal.
    signal: f64,
    /// Its own standard uncertainty.
    sigma: f64,
    /// What the fitted model expects.
    fitted: f64,
}

/// What the starts did.
#[derive(ToSchema)]
pub struct FitStarts {
    /// Starts tried.
    tried: u64,
    /// Ended at the reported minimum.
    at_minimum: u64,
    /// Converged to a worse minimum.
    elsewhere: u64,
    /// Did not converge.
    not_converged: u64,
}

/// A step of a descent.
#[derive(ToSchema)]
pub struct FitIteration {
    /// Time since the first one.
    seconds: f64,
    /// Sum of squared weighted residuals.
    cost: f64,
    /// Largest cosine between the residuals and a parameter's derivatives.
    gradient: f64,
    /// Largest step of a parameter, in its standard uncertainty.
    step: f64,
    /// Largest distance of a parameter from where the descent ended, in its standard uncertainty.
    error: f64,
    /// Whether the cost is no higher than at all points before.
    accepted: bool,
}

/// Degrees of freedom of a budget's parts.
#[derive(ToSchema)]
pub struct FitFreedom {
    /// Of `counting`.
    counting: f64,
    /// Of `model`.
    model: f64,
}

/// Seconds spent.
#[derive(ToSchema)]
pub struct FitTiming {
    /// Reading frames.
    read: f64,
    /// Reducing them.
    reduce: f64,
    /// Fitting.
    fit: f64,
}
