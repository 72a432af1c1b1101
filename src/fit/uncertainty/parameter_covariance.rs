//! The covariance of the reported parameters, in their units.
//!
//! On the diagonal are the squares of the standard uncertainties, every line of the budget included. Beside it is what the
//! errors that are propagated through the derivatives have in common. The other lines (wedge, shape, the error of the closed
//! form itself) count as independent between parameters.

use super::budget::Uncertainty;
use crate::fit::problem::{Quantity, Values};
use crate::fit::report::{ParameterCovariance, Parameters};

/// Name of a parameter in the report, and the unit of its value.
fn named(quantity: Quantity, is_absolute: bool) -> Option<(&'static str, &'static str)> {
    let of_signal = if is_absolute { "1/sr" } else { "arbitrary" };
    Some(match quantity {
        Quantity::ThetaR => ("theta_r_deg", "deg"),
        Quantity::AlphaU => ("alpha_u", "1"),
        Quantity::AlphaV => ("alpha_v", "1"),
        Quantity::RhoD => ("rho_d", "1"),
        Quantity::Scale => ("scale", "arbitrary"),
        Quantity::Background => ("background", of_signal),
        Quantity::AzimuthOffset => ("azimuth_offset_deg", "deg"),
        Quantity::TiltOffset => ("tilt_offset_deg", "deg"),
        Quantity::Translucency => ("translucency", "1"),
        Quantity::CrestRadius => ("crest_radius", "1"),
        Quantity::Land => ("land_share", "1"),
        Quantity::Eta | Quantity::K | Quantity::Tail | Quantity::Wedge | Quantity::LampTurn => {
            return None;
        }
    })
}

/// Returns the change of the reported value per unit of the solver; θr is reported without its sign.
pub(in crate::fit) fn per_solver_unit(
    quantity: Quantity,
    values: &Values,
    is_absolute: bool,
) -> f64 {
    match quantity {
        Quantity::ThetaR => 1f64.to_degrees().copysign(values.theta_r),
        Quantity::AzimuthOffset | Quantity::TiltOffset | Quantity::Wedge | Quantity::LampTurn => {
            1f64.to_degrees()
        }
        Quantity::AlphaU => values.alpha_u,
        Quantity::AlphaV => values.alpha_v,
        Quantity::Background if is_absolute => 1.0 / values.scale,
        _ => 1.0,
    }
}

/// Returns the covariance of the free parameters that the report states with an uncertainty.
pub(in crate::fit) fn of(
    free: &[Quantity],
    u: &Uncertainty,
    values: &Values,
    parameters: &Parameters,
    is_absolute: bool,
) -> ParameterCovariance {
    let listed = parameters.named();
    let reported: Vec<(usize, &str, &str, f64, f64)> = free
        .iter()
        .enumerate()
        .filter_map(|(column, quantity)| {
            let (name, unit) = named(*quantity, is_absolute)?;
            let (_, parameter) = listed.iter().find(|(known, _)| *known == name)?;
            let factor = per_solver_unit(*quantity, values, is_absolute);
            Some((column, name, unit, factor, parameter.std?))
        })
        .collect();
    // Each pair is read in one order, so that the matrix is symmetric to the last digit.
    let value =
        |a: &(usize, &str, &str, f64, f64), b: &(usize, &str, &str, f64, f64)| match a.0 == b.0 {
            true => a.4 * a.4,
            false => u.propagated[(a.0.min(b.0), a.0.max(b.0))] * (a.3 * b.3),
        };
    ParameterCovariance {
        parameters: reported
            .iter()
            .map(|(_, name, ..)| (*name).to_owned())
            .collect(),
        units: reported
            .iter()
            .map(|(_, _, unit, ..)| (*unit).to_owned())
            .collect(),
        values: reported
            .iter()
            .map(|a| reported.iter().map(|b| value(a, b)).collect())
            .collect(),
    }
}
