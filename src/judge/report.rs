//! A verdict with the fit that it is based on: the object of `judge --json`.

use serde::{Deserialize, Serialize};

use super::contrast::contrasts;
use super::decision::Verdict;
use super::judgement::{Judgement, in_demanded_plane, judge};
use super::quantity::{CONTRAST_MEAN, CONTRAST_MICHELSON_MEAN, parameters};
use super::specification::Specification;
use super::would_decide::{Basis, would_decide};
use crate::fit::report::{FitReport, LeftOut, ReferencePlane, Status, Timing, VariantName};
use crate::geometry::Pose;
use crate::observation::ObservationSet;

/// A judgement and the fit that it is based on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = VerdictResult)]
pub struct VerdictReport {
    /// The judgement.
    #[serde(flatten)]
    pub judgement: Judgement,
    /// Variant of the model.
    pub variant: VariantName,
    /// How the fit ended.
    pub status: Status,
    /// Region of the part.
    pub region: Option<String>,
    /// The plane to which θr and the azimuth refer.
    #[serde(default)]
    pub reference_plane: ReferencePlane,
    /// Tilts over which the contrasts are averaged, degrees; null where no contrast is limited.
    #[serde(default)]
    pub contrast_theta_c_deg: Option<Vec<f64>>,
    /// Effects that the fit omits, why, and their possible effect on the result.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// Seconds of reading, reducing and fitting.
    #[serde(default)]
    pub timing_s: Timing,
    /// Name and version of the program.
    pub program: String,
}

impl VerdictReport {
    /// Judges a fit and its observations. `planned` are the poses of all frames of the sample, including frames that could
    /// not be used.
    #[must_use]
    pub fn new(
        specification: &Specification,
        report: &FitReport,
        observations: &ObservationSet,
        planned: &[Pose],
    ) -> Self {
        let mut quantities = in_demanded_plane(
            specification.reference_plane,
            report.reference_plane,
            parameters(report),
        );
        let mut left_out = report.left_out.clone();
        let mut warnings = report.warnings.clone();
        let limited = [CONTRAST_MEAN, CONTRAST_MICHELSON_MEAN];
        let limited = limited
            .iter()
            .any(|q| specification.limits.contains_key(*q));
        let contrasts = limited.then(|| contrasts(observations, planned, report));
        let contrast_theta_c_deg = contrasts.map(|contrasts| {
            quantities.extend(contrasts.quantities);
            warnings.extend(contrasts.warnings);
            left_out.extend(contrasts.left_out);
            contrasts.theta_c_deg
        });
        let mut judgement = judge(specification, &quantities);
        if judgement.verdict == Verdict::CannotTell {
            warnings.extend(report.few_poses().cloned());
        }
        judgement.warnings.extend(warnings);
        let named = report.parameters.named();
        for item in &judgement.items {
            let parameter = named.iter().find(|(name, _)| *name == item.quantity);
            let basis = Basis {
                parameter: parameter.map(|(_, parameter)| *parameter),
                poses: report.n_observations,
                reference: observations.white_reference,
            };
            let limits = &specification.limits[&item.quantity];
            if let Some(found) = would_decide(item, limits, &specification.decision, &basis) {
                let quantity = item.quantity.clone();
                judgement.would_decide.insert(quantity, found);
            }
        }
        VerdictReport {
            judgement,
            contrast_theta_c_deg,
            variant: report.variant,
            status: report.status,
            region: report.region.clone(),
            reference_plane: report.reference_plane,
            left_out,
            timing_s: report.timing_s,
            program: report.program.clone(),
        }
    }

    /// Whether the judged values are those of this fit, up to rounding: a later fit of the scan may have others. An azimuth is
    /// judged on the turn of its limits, and an item without a value has nothing to compare.
    #[must_use]
    pub fn rests_on(&self, fit: &FitReport) -> bool {
        /// Share of the standard uncertainty.
        const ROUNDING: f64 = 0.01;
        let named = fit.parameters.named();
        self.judgement.items.iter().all(|item| {
            let fitted = named.iter().find(|(name, _)| *name == item.quantity);
            let (Some(judged), Some((_, fitted))) = (item.value, fitted) else {
                return true;
            };
            let is_same = |value: f64| (value - judged).abs() <= ROUNDING * item.std.unwrap_or(0.0);
            item.quantity == "azimuth_offset_deg" || fitted.value.is_some_and(is_same)
        })
    }
}
