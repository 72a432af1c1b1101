//! The result of a fit, in the form that `fit --json`, the store and the HTTP interface share.
//!
//! A parameter that the data do not determine has null instead of numbers and a `note` with the reason. The parts of a
//! budget combine in quadrature to `std`; `expanded` = `coverage_factor` · `std`.

pub mod build;
pub(super) mod refusals;
pub mod text;

use serde::{Deserialize, Serialize};

use super::causes::findings::Finding;
pub use super::causes::wedge::{Across, ReferencePlane};
use super::convergence_trace::Iteration;
use super::traced::TracingEnd;
use super::uncertainty::budget::Budget;
use super::uncertainty::coverage::coverage_factor;
pub use crate::model::LeftOut;
use crate::observation::RejectedFrame;
use crate::trace::surfaces::ridge_map::RidgeFacts;

/// How a fit ended. Scripts compare the word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
#[schema(as = FitStatus)]
pub enum Status {
    /// At a minimum. All free parameters are determined and none is at a bound.
    Converged,
    /// At a minimum with a parameter at a bound; `warnings` names it.
    AtBound,
    /// At a minimum, but the data leave a direction undetermined; `warnings` names the parameters.
    RankDeficient,
    /// No start reached a minimum.
    Stalled,
    /// An observation, or the value of the model for it, is not finite.
    NotFinite,
    /// Fewer observations than free parameters plus one.
    TooFewObservations,
    /// Stopped by the user.
    Cancelled,
}

impl Status {
    /// All statuses.
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

/// Names of the variants in the JSON form.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
#[schema(as = FitVariantName)]
pub enum VariantName {
    /// The lobe as printed in the paper.
    Paper,
    /// The complete sawtooth.
    Sawtooth,
    /// The sawtooth, corrected by the ray tracer.
    Traced,
}

impl VariantName {
    /// All variants.
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

/// A parameter with its uncertainty.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = FitParameter)]
pub struct Parameter {
    /// Best value in the unit of the parameter (degrees in keys with `_deg`; roughness as the tangent of a slope).
    pub value: Option<f64>,
    /// Combined standard uncertainty, same unit.
    pub std: Option<f64>,
    /// Expanded uncertainty, same unit.
    pub expanded: Option<f64>,
    /// k, the expanded uncertainty divided by the standard uncertainty: 2, or Student's t for 95.45 % where the degrees of
    /// freedom are fewer than 50.
    pub coverage_factor: Option<f64>,
    /// Effective degrees of freedom (Welch–Satterthwaite); null if practically infinite.
    pub degrees_of_freedom: Option<f64>,
    /// Whether the data determine it.
    pub identifiable: bool,
    /// Parts of the standard uncertainty.
    #[schema(value_type = Option<std::collections::BTreeMap<String, f64>>)]
    pub budget: Option<Budget>,
    /// Profile-likelihood interval of the independent errors, on request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub profile: Option<Interval>,
    /// Bootstrap interval of the independent errors, on request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bootstrap: Option<Interval>,
    /// Why the value is null or fixed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub note: Option<String>,
}

impl Parameter {
    /// Makes a parameter that the data do not determine, with the reason.
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

    /// Makes a parameter with its budget.
    #[must_use]
    pub fn known(value: f64, budget: Budget, degrees_of_freedom: Option<f64>) -> Self {
        let std = budget.combined();
        let factor = coverage_factor(degrees_of_freedom);
        Parameter {
            value: Some(value),
            std: Some(std),
            expanded: Some(factor * std),
            coverage_factor: Some(factor),
            degrees_of_freedom,
            identifiable: true,
            budget: Some(budget),
            profile: None,
            bootstrap: None,
            note: None,
        }
    }
}

/// Ends of an interval at the coverage of the report; null for an open end.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = FitInterval)]
pub struct Interval {
    /// Lower end.
    pub lower: Option<f64>,
    /// Upper end.
    pub upper: Option<f64>,
}

impl Interval {
    /// The smallest interval that contains both.
    pub(super) fn with(self, other: Self) -> Self {
        Interval {
            lower: self.lower.zip(other.lower).map(|(a, b)| a.min(b)),
            upper: self.upper.zip(other.upper).map(|(a, b)| a.max(b)),
        }
    }
}

/// All parameters; angles in degrees.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = FitParameters)]
pub struct Parameters {
    /// Effective ridge angle.
    pub theta_r_deg: Parameter,
    /// Roughness along the ridges.
    pub alpha_u: Parameter,
    /// Roughness across the ridges.
    pub alpha_v: Parameter,
    /// Diffuse reflectance: in `paper` that of the printed lobe, otherwise the Lambertian equivalent of a flat piece.
    pub rho_d: Parameter,
    /// Gain g of the signals; 1 with a white reference.
    pub scale: Parameter,
    /// Stray light B, as a radiance if the scale is absolute.
    pub background: Parameter,
    /// Δφs, to be added to a recorded φs, degrees.
    pub azimuth_offset_deg: Parameter,
    /// Δθc, to be added to a recorded θc, degrees.
    pub tilt_offset_deg: Parameter,
    /// Share of the body's light that leaves evenly over the ridges, if fitted or stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub translucency: Option<Parameter>,
    /// Radius of the crests divided by the length of the facets, if fitted or stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crest_radius: Option<Parameter>,
    /// Share of the surface that is flat between the ridges, if fitted or stated. The other parameters are those of the ridges.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub land_share: Option<Parameter>,
}

impl Parameters {
    /// Names of the JSON form, in the order of the report.
    pub const NAMES: [&str; 11] = [
        "theta_r_deg",
        "alpha_u",
        "alpha_v",
        "rho_d",
        "scale",
        "background",
        "azimuth_offset_deg",
        "tilt_offset_deg",
        "translucency",
        "crest_radius",
        "land_share",
    ];

    /// Returns the names of the JSON form with their parameters, in the order of the report.
    #[must_use]
    pub fn named(&self) -> Vec<(&'static str, &Parameter)> {
        let all = [
            Some(&self.theta_r_deg),
            Some(&self.alpha_u),
            Some(&self.alpha_v),
            Some(&self.rho_d),
            Some(&self.scale),
            Some(&self.background),
            Some(&self.azimuth_offset_deg),
            Some(&self.tilt_offset_deg),
            self.translucency.as_ref(),
            self.crest_radius.as_ref(),
            self.land_share.as_ref(),
        ];
        let named = Self::NAMES.into_iter().zip(all);
        named.filter_map(|(name, p)| Some((name, p?))).collect()
    }
}

/// Covariance of the parameters that the data determine (k = 1).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = FitCovariance)]
pub struct ParameterCovariance {
    /// Names of the parameters, in the order of rows and columns. Fixed and held parameters are not in the list.
    pub parameters: Vec<String>,
    /// Units of their values: `deg`, `1`, `1/sr`, or `arbitrary` without a white reference.
    pub units: Vec<String>,
    /// The matrix, row by row, in the product of the two units. The diagonal has the squares of `std`. The rest has what
    /// the errors that rows share or scatter (counting, references, angles, drift, detector, priors) have in common; wedge,
    /// shape and the error of the closed form count as independent between parameters.
    pub values: Vec<Vec<f64>>,
}

/// Slope distribution of the facets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = FitSlopes)]
pub struct SlopeDistribution {
    /// `beckmann` or `student-t`.
    pub name: String,
    /// γ of Student's t (GGX is 2); null for Beckmann.
    pub shape: Option<f64>,
    /// Beckmann roughness with the same half width along the ridges, comparable between distributions.
    pub alpha_half_width_u: Option<f64>,
    /// The same across the ridges.
    pub alpha_half_width_v: Option<f64>,
}

/// One variant in the comparison.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = FitVariant)]
pub struct VariantSummary {
    /// Which variant.
    pub variant: VariantName,
    /// How its fit ended.
    pub status: Status,
    /// Root mean square residual, as a share of the largest observation.
    pub rms_residual: f64,
    /// χ² per degree of freedom with counting noise only.
    pub chi2_reduced_without_model: f64,
    /// Quasi-Akaike criterion; ĉ is taken from the variant that fits the data best. Only differences are meaningful.
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

/// Durations in seconds; filled in by the caller that has a clock.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = FitTiming)]
pub struct Timing {
    /// Reading frames.
    pub read: f64,
    /// Reducing frames.
    pub reduce: f64,
    /// Fitting.
    pub fit: f64,
}

/// What the ray tracer did for a fit.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = FitTracer)]
pub struct TracerReport {
    /// Passes of tracing and fitting.
    pub passes: usize,
    /// Paths per pose in the last pass, from the camera and as many from the lamp.
    pub paths_per_pose: u64,
    /// Root mean square standard error of the radiances, as a share of the largest.
    pub error: f64,
    /// Whether polarisation was followed from bounce to bounce.
    pub polarised: bool,
    /// Why it ended.
    pub end: TracingEnd,
    /// Effective ridge angle of the given profile before it was scaled to the fitted one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub profile_theta_r_deg: Option<f64>,
    /// Whether that profile was reversed so that its facets lean to +v.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub profile_turned: bool,
    /// Facts about the height map that the profile comes from.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub height_map: Option<RidgeFacts>,
}

/// An observation with the value that the fit expects; angles as recorded.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = FittedPoint)]
pub struct FittedObservation {
    /// Camera tilt as recorded.
    pub theta_c_deg: f64,
    /// Sample rotation as recorded.
    pub phi_s_deg: f64,
    /// Observed signal.
    pub signal: f64,
    /// Its standard uncertainty.
    pub sigma: f64,
    /// Value of the fitted model.
    pub fitted: f64,
}

/// Outcomes of the starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = FitStarts)]
pub struct Starts {
    /// Starts tried.
    pub tried: usize,
    /// Starts that ended at the reported minimum.
    pub at_minimum: usize,
    /// Starts that converged to a worse minimum.
    pub elsewhere: usize,
    /// Starts that did not converge.
    pub not_converged: usize,
}

/// Degrees of freedom of a budget's parts. The other parts count as exactly known.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = FitFreedom)]
pub struct Freedom {
    /// Of `counting`: residuals minus fitted directions.
    pub counting: f64,
    /// Of `model`: groups of poses left out in turn, minus one.
    pub model: f64,
}

/// Words of the note on poses that are too few to show the model error.
pub(super) const FEW_POSES: &str = "hardly constrain the model error";

impl FitReport {
    /// Returns the note that the poses are too few to show the model error. It is a warning where the uncertainty is not
    /// small enough: more azimuths or tilts reduce it.
    #[must_use]
    pub fn few_poses(&self) -> Option<&String> {
        self.notes.iter().find(|note| note.contains(FEW_POSES))
    }

    /// Turns that note into a warning where the expanded uncertainty of θr exceeds `target_deg`.
    pub fn hold_against(&mut self, target_deg: f64) {
        let is_reached = self
            .parameters
            .theta_r_deg
            .expanded
            .is_some_and(|expanded| expanded <= target_deg);
        if !is_reached {
            let (few, rest) = std::mem::take(&mut self.notes)
                .into_iter()
                .partition(|note| note.contains(FEW_POSES));
            self.notes = rest;
            self.warnings.extend::<Vec<String>>(few);
        }
    }
}

/// The complete result.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
pub struct FitReport {
    /// Variant that the parameters belong to.
    pub variant: VariantName,
    /// How the fit ended.
    pub status: Status,
    /// Number of observations fitted.
    pub n_observations: usize,
    /// Frames used, including darks and flats.
    pub n_frames_used: u32,
    /// Region of interest, if the sample has several.
    pub region: Option<String>,
    /// The parameters.
    pub parameters: Parameters,
    /// Covariance of the parameters; none if the fit has no result, and for the common surface of several scans.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covariance: Option<ParameterCovariance>,
    /// The plane that θr and the azimuth refer to.
    #[serde(default)]
    pub reference_plane: ReferencePlane,
    /// Wedge across v, or error of the zero, from the fitted azimuth, if it can be determined; none for the common
    /// surface of several scans, each of which has its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wedge_across: Option<Across>,
    /// Root mean square residual, as a share of the largest observation. Like the next three, none if the fit has no
    /// result.
    pub rms_residual: Option<f64>,
    /// Model error at the peak, as a share of the largest observation.
    pub model_discrepancy: Option<f64>,
    /// χ² per degree of freedom with the model error among the uncertainties.
    pub chi2_reduced: Option<f64>,
    /// The same with counting noise only.
    pub chi2_reduced_without_model: Option<f64>,
    /// Rejected frames.
    pub rejected_frames: Vec<RejectedFrame>,
    /// Sentences on what the user has to check or change.
    pub warnings: Vec<String>,
    /// Sentences worth knowing that need no action.
    #[serde(default)]
    pub notes: Vec<String>,
    /// What explains the residual that an ideal sawtooth, a steady lamp and a linear detector leave, largest share
    /// first.
    #[serde(default)]
    pub findings: Vec<Finding>,
    /// Slope distribution of the facets; none for `paper`.
    #[serde(default)]
    pub slope_distribution: Option<SlopeDistribution>,
    /// All variants fitted.
    pub variants: Vec<VariantSummary>,
    /// What the fit leaves out, why, and its possible effect.
    pub left_out: Vec<LeftOut>,
    /// What the ray tracer did, if it was used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tracer: Option<TracerReport>,
    /// Observations with their fitted values.
    #[serde(default)]
    pub fitted: Vec<FittedObservation>,
    /// Outcomes of the starts.
    #[serde(default)]
    pub starts: Starts,
    /// One descent to the reported minimum, step by step, on request.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub iterations: Vec<Iteration>,
    /// Degrees of freedom of the two parts of every budget that come from scatter.
    #[serde(default)]
    pub freedom: Freedom,
    /// Durations in seconds.
    pub timing_s: Timing,
    /// Program and version.
    pub program: String,
    /// The same with the commit of the build; empty in fits of programs that did not state it.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub build: String,
}
