//! The answer of a fit, in the form that `fit --json`, the store and the HTTP interface share.
//!
//! A parameter that the data cannot tell has null for its numbers and a `note` with the reason. A
//! budget's parts combine in quadrature to `std`; `expanded` = `coverage_factor` · `std`.

use serde::{Deserialize, Serialize};

use super::budget::Budget;
use super::findings::Finding;
use super::intervals::Interval;
use super::traced::TracingEnd;
use super::trail::Iteration;
pub use super::wedge::{Across, ReferencePlane};
pub use crate::model::LeftOut;
use crate::observation::RejectedFrame;
use crate::trace::ridge_map::RidgeFacts;

/// How a fit ended, as a word that scripts compare.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Status {
    /// At a minimum, all free parameters determined, none at its bound.
    Converged,
    /// At a minimum with a parameter held by its bound; `warnings` names it.
    AtBound,
    /// At a minimum, but the data leave a direction open; `warnings` names the parameters.
    RankDeficient,
    /// No start reached a minimum.
    Stalled,
    /// An observation or the model's value for it is not a finite number.
    NotFinite,
    /// Fewer observations than free parameters and one.
    TooFewObservations,
    /// Stopped by the user.
    Cancelled,
}

impl Status {
    /// All of them.
    pub const ALL: [Status; 7] = [
        Status::Converged,
        Status::AtBound,
        Status::RankDeficient,
        Status::Stalled,
        Status::NotFinite,
        Status::TooFewObservations,
        Status::Cancelled,
    ];
}

/// The names that the forms use for the variants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VariantName {
    /// As printed.
    Paper,
    /// The sawtooth in full.
    Sawtooth,
    /// The sawtooth corrected by the ray tracer.
    Traced,
}

impl VariantName {
    /// All of them.
    pub const ALL: [VariantName; 3] = [
        VariantName::Paper,
        VariantName::Sawtooth,
        VariantName::Traced,
    ];
}

impl std::fmt::Display for VariantName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            VariantName::Paper => "paper",
            VariantName::Sawtooth => "sawtooth",
            VariantName::Traced => "traced",
        })
    }
}

/// One parameter with its uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Best value, in the parameter's unit (degrees in keys with `_deg`; roughness as tangent of slope).
    pub value: Option<f64>,
    /// Standard uncertainty with everything known in it, same unit.
    pub std: Option<f64>,
    /// Expanded uncertainty, same unit.
    pub expanded: Option<f64>,
    /// Expanded over standard uncertainty.
    pub coverage_factor: Option<f64>,
    /// Effective degrees of freedom (Welch–Satterthwaite); null where practically infinite.
    pub degrees_of_freedom: Option<f64>,
    /// Whether the data can tell it.
    pub identifiable: bool,
    /// Parts of the standard uncertainty.
    pub budget: Option<Budget>,
    /// Profile-likelihood interval of the independent errors, on request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub profile: Option<Interval>,
    /// Bootstrap interval of the independent errors, on request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bootstrap: Option<Interval>,
    /// Why it is null or fixed, for the user.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

impl Parameter {
    /// A parameter that the data cannot tell, with the reason.
    #[must_use]
    pub fn unknown(note: impl Into<String>) -> Self {
        Parameter {
            value: None,
            std: None,
            expanded: None,
            coverage_factor: None,
            degrees_of_freedom: None,
            identifiable: false,
            budget: None,
            profile: None,
            bootstrap: None,
            note: Some(note.into()),
        }
    }

    /// A parameter with its budget.
    #[must_use]
    pub fn known(value: f64, budget: Budget, degrees_of_freedom: Option<f64>) -> Self {
        let std = budget.combined();
        Parameter {
            value: Some(value),
            std: Some(std),
            expanded: Some(COVERAGE_FACTOR * std),
            coverage_factor: Some(COVERAGE_FACTOR),
            degrees_of_freedom,
            identifiable: true,
            budget: Some(budget),
            profile: None,
            bootstrap: None,
            note: None,
        }
    }
}

/// Expanded over standard uncertainty: 95.45 % for a normal distribution.
pub const COVERAGE_FACTOR: f64 = 2.0;
/// That share.
pub const COVERAGE: f64 = 0.9545;

/// All parameters; angles in degrees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameters {
    /// Effective ridge angle.
    pub theta_r_deg: Parameter,
    /// Roughness along the ridges.
    pub alpha_u: Parameter,
    /// Roughness across the ridges.
    pub alpha_v: Parameter,
    /// Diffuse reflectance: `paper` as printed, else the Lambertian equivalent of a flat piece.
    pub rho_d: Parameter,
    /// Gain g of the signals; 1 with a white reference.
    pub scale: Parameter,
    /// Stray light B, in radiance where the scale is absolute.
    pub background: Parameter,
    /// Δφs: what to add to a recorded φs, degrees.
    pub azimuth_offset_deg: Parameter,
    /// Δθc: what to add to a recorded θc, degrees.
    pub tilt_offset_deg: Parameter,
    /// Share of a body's light that leaves evenly over the ridges, where it is fitted or stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub translucency: Option<Parameter>,
    /// Radius of the crests over the facets' length, where it is fitted or stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crest_radius: Option<Parameter>,
}

impl Parameters {
    /// Names as in the JSON form with their parameters, in the report's order.
    #[must_use]
    pub fn named(&self) -> Vec<(&'static str, &Parameter)> {
        let always = [
            ("theta_r_deg", &self.theta_r_deg),
            ("alpha_u", &self.alpha_u),
            ("alpha_v", &self.alpha_v),
            ("rho_d", &self.rho_d),
            ("scale", &self.scale),
            ("background", &self.background),
            ("azimuth_offset_deg", &self.azimuth_offset_deg),
            ("tilt_offset_deg", &self.tilt_offset_deg),
        ];
        let sometimes = [
            ("translucency", &self.translucency),
            ("crest_radius", &self.crest_radius),
        ];
        let sometimes = sometimes
            .into_iter()
            .filter_map(|(name, p)| p.as_ref().map(|p| (name, p)));
        always.into_iter().chain(sometimes).collect()
    }
}

/// How the facets' slopes are distributed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SlopeDistribution {
    /// `beckmann` or `student-t`.
    pub name: String,
    /// γ of Student's t (GGX is 2); null for Beckmann.
    pub shape: Option<f64>,
    /// The Beckmann roughness of the same half width along the ridges, comparable between distributions.
    pub alpha_half_width_u: Option<f64>,
    /// The same across the ridges.
    pub alpha_half_width_v: Option<f64>,
}

/// One variant in the comparison.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VariantSummary {
    /// Which.
    pub variant: VariantName,
    /// How its fit ended.
    pub status: Status,
    /// Root mean square residual, as a share of the largest observation.
    pub rms_residual: f64,
    /// χ² per degree of freedom with counting noise alone.
    pub chi2_reduced_without_model: f64,
    /// Quasi-Akaike criterion, ĉ from the variant that explains the data best; only differences count.
    pub qaic: f64,
    /// Ridge angle.
    pub theta_r_deg: Option<f64>,
    /// Roughness along the ridges.
    pub alpha_u: Option<f64>,
    /// Roughness across the ridges.
    pub alpha_v: Option<f64>,
    /// Diffuse reflectance.
    pub rho_d: Option<f64>,
}

/// Seconds spent; filled in by whoever holds a clock.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Timing {
    /// Reading frames.
    pub read: f64,
    /// Reducing them.
    pub reduce: f64,
    /// Fitting.
    pub fit: f64,
}

/// What the ray tracer did for a fit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TracerReport {
    /// Passes of tracing and fitting.
    pub passes: usize,
    /// Paths per pose in the last pass, from the camera and as many from the lamp.
    pub paths_per_pose: u64,
    /// Root mean square standard error of the radiances as a share of the largest.
    pub error: f64,
    /// Whether polarisation was followed from bounce to bounce.
    pub polarised: bool,
    /// Why it ended.
    pub end: TracingEnd,
    /// Effective ridge angle of the given profile before it was scaled to the fitted one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub profile_theta_r_deg: Option<f64>,
    /// Whether that profile was turned round, so that its facets lean to the side of +v.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub profile_turned: bool,
    /// What that profile was made of, where it comes from a height map.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height_map: Option<RidgeFacts>,
}

/// An observation beside what the fit expects of it; recorded angles.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FittedObservation {
    /// Camera tilt as recorded.
    pub theta_c_deg: f64,
    /// Sample rotation as recorded.
    pub phi_s_deg: f64,
    /// Observed signal.
    pub signal: f64,
    /// Its own standard uncertainty.
    pub sigma: f64,
    /// What the fitted model expects.
    pub fitted: f64,
}

/// What the starts did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Starts {
    /// Starts tried.
    pub tried: usize,
    /// Ended at the reported minimum.
    pub at_minimum: usize,
    /// Converged to a worse minimum.
    pub elsewhere: usize,
    /// Did not converge.
    pub not_converged: usize,
}

/// Degrees of freedom of a budget's parts; the other parts count as exactly known.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Freedom {
    /// Of `counting`: residuals less fitted directions.
    pub counting: f64,
    /// Of `model`: groups of poses left out in turn, less one.
    pub model: f64,
}

/// The whole answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FitReport {
    /// The variant that the parameters depend on.
    pub variant: VariantName,
    /// How it ended.
    pub status: Status,
    /// Observations fitted.
    pub n_observations: usize,
    /// Frames used, darks and flats included.
    pub n_frames_used: u32,
    /// Region of interest, where the sample has several.
    pub region: Option<String>,
    /// The parameters.
    pub parameters: Parameters,
    /// The plane that θr and the azimuth refer to.
    #[serde(default)]
    pub reference_plane: ReferencePlane,
    /// What the azimuth says of a wedge across v and of the zero, where it is told; none for a common surface of several
    /// scans, each of which lies in its own way.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wedge_across: Option<Across>,
    /// Root mean square residual, as a share of the largest observation; like the next three, none where
    /// there is no answer that could leave one.
    pub rms_residual: Option<f64>,
    /// The model's discrepancy at the peak, as a share of the largest observation.
    pub model_discrepancy: Option<f64>,
    /// χ² per degree of freedom, the model's discrepancy among the uncertainties.
    pub chi2_reduced: Option<f64>,
    /// The same with counting noise alone.
    pub chi2_reduced_without_model: Option<f64>,
    /// Frames left out.
    pub rejected_frames: Vec<RejectedFrame>,
    /// Sentences for the user, of what a person has to look after.
    pub warnings: Vec<String>,
    /// Sentences of what is worth knowing and needs nothing done.
    #[serde(default)]
    pub notes: Vec<String>,
    /// What explains the residual that an ideal sawtooth, a steady lamp and a linear detector leave, most first.
    #[serde(default)]
    pub findings: Vec<Finding>,
    /// How the facets' slopes are distributed; none for the printed form.
    #[serde(default)]
    pub slope_distribution: Option<SlopeDistribution>,
    /// All variants fitted.
    pub variants: Vec<VariantSummary>,
    /// What was left out, why, and what it may cost.
    pub left_out: Vec<LeftOut>,
    /// What the ray tracer did, where it was asked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tracer: Option<TracerReport>,
    /// Observations beside the fit.
    #[serde(default)]
    pub fitted: Vec<FittedObservation>,
    /// What the starts did.
    #[serde(default)]
    pub starts: Starts,
    /// A descent to the reported minimum, step by step, on request.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub iterations: Vec<Iteration>,
    /// Degrees of freedom of the two parts of every budget that come from scatter.
    #[serde(default)]
    pub freedom: Freedom,
    /// Seconds spent.
    pub timing_s: Timing,
    /// Program and version.
    pub program: String,
}
