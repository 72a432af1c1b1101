//! What can be judged: named quantities with their uncertainties.

use crate::fit::report::{FitReport, Parameters, Status};
use crate::fit::uncertainty::coverage::COVERAGE_FACTOR;

/// Mean absolute contrast, in radiance for a lamp irradiance of 1.
pub const CONTRAST_MEAN: &str = "contrast_mean";
/// Mean Michelson contrast.
pub const CONTRAST_MICHELSON_MEAN: &str = "contrast_michelson_mean";

/// Quantities that may have limits: the parameters of a fit, then the contrasts.
pub const QUANTITIES: [&str; 13] = {
    let mut all = [CONTRAST_MICHELSON_MEAN; 13];
    let mut n = 0;
    while n < Parameters::NAMES.len() {
        all[n] = Parameters::NAMES[n];
        n += 1;
    }
    all[n] = CONTRAST_MEAN;
    all
};

/// Quantities that depend on how the sample lies on the turntable.
pub(super) const PLANE_DEPENDENT: [&str; 2] = ["theta_r_deg", "azimuth_offset_deg"];

/// A measured number, or the reason why there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct JudgedQuantity {
    /// Name, as in the specification.
    pub name: String,
    /// Value with its uncertainty.
    pub measured: Result<MeasuredValue, String>,
}

/// A value with its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredValue {
    /// Best estimate.
    pub value: f64,
    /// Combined standard uncertainty.
    pub std: f64,
    /// Ratio of expanded to standard uncertainty, for the report.
    pub coverage_factor: f64,
    /// Effective degrees of freedom; `None` where practically infinite.
    pub degrees_of_freedom: Option<f64>,
    /// Largest error that the uncertainty does not include, in the unit of the value.
    pub may_cost: f64,
}

/// The parameters of a fit, under the names that a specification uses; those of real samples also where the fit leaves them
/// out.
#[must_use]
pub fn parameters(report: &FitReport) -> Vec<JudgedQuantity> {
    let failed = match report.status {
        Status::Converged | Status::AtBound | Status::RankDeficient => false,
        Status::Stalled | Status::NotFinite | Status::TooFewObservations | Status::Cancelled => {
            true
        }
    };
    let named = report.parameters.named();
    let fitted = |name: &&str| named.iter().any(|(fitted, _)| fitted == name);
    let left_out: Vec<JudgedQuantity> = Parameters::NAMES
        .into_iter()
        .filter(|name| !fitted(name))
        .map(|name| JudgedQuantity {
            name: name.to_owned(),
            measured: Err("the fit leaves it out; `left_out` of the fit says why".to_owned()),
        })
        .collect();
    named
        .into_iter()
        .map(|(name, parameter)| {
            let measured = match (parameter.value, parameter.std) {
                _ if failed => Err("the fit has no result; see its status and warnings".to_owned()),
                (Some(value), Some(std)) if parameter.identifiable => Ok(MeasuredValue {
                    value,
                    std,
                    coverage_factor: parameter.coverage_factor.unwrap_or(COVERAGE_FACTOR),
                    degrees_of_freedom: parameter.degrees_of_freedom,
                    may_cost: 0.0,
                }),
                _ => Err(parameter.note.as_ref().map_or_else(
                    || "the data cannot determine it on this rig".to_owned(),
                    |note| format!("the data cannot determine it: {note}"),
                )),
            };
            JudgedQuantity {
                name: name.to_owned(),
                measured,
            }
        })
        .chain(left_out)
        .collect()
}
