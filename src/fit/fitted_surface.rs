//! The BRDF of a fitted surface: the closed form at the parameters of a report.

use super::report::{FitReport, Parameter, Status, VariantName};
use crate::model::domain::{self, OutOfDomain};
use crate::model::extended::{Real, slopes};
use crate::model::surface_brdf::SurfaceBrdf;
use crate::model::{Optics, Surface, Variant};
use crate::observation::ObservationSet;

/// Why a fit has no BRDF.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoSurface {
    /// The fit has no result.
    #[error("the fit has no result; its status and warnings state the cause")]
    NoResult,
    /// A parameter has no value.
    #[error(
        "the fit does not determine {name}; fit again with a fixed value for it, or scan more poses and a white reference"
    )]
    Undetermined {
        /// Name of the parameter.
        name: &'static str,
    },
    /// The closed form is not defined there.
    #[error(transparent)]
    OutOfDomain(#[from] OutOfDomain),
}

/// Returns the closed form at the fitted parameters and the nominal index, in the frame of the ridges. The offsets of the
/// stages, the gain and the stray light are not properties of the surface; what the fit adds to the closed form at its poses
/// is left out.
///
/// # Errors
/// A fit without a result, a parameter that it does not determine, or a surface without a closed form.
pub fn fitted_surface(report: &FitReport, set: &ObservationSet) -> Result<SurfaceBrdf, NoSurface> {
    if !matches!(
        report.status,
        Status::Converged | Status::AtBound | Status::RankDeficient
    ) {
        return Err(NoSurface::NoResult);
    }
    let p = &report.parameters;
    let known = |name: &'static str, parameter: &Parameter| {
        parameter.value.ok_or(NoSurface::Undetermined { name })
    };
    let optics = Optics::new(&set.rig, &set.material);
    let surface = Surface {
        theta_r: known("theta_r_deg", &p.theta_r_deg)?.to_radians(),
        alpha_u: known("alpha_u", &p.alpha_u)?,
        alpha_v: known("alpha_v", &p.alpha_v)?,
        // A metal returns no diffuse light.
        rho_d: match optics.k > 0.0 {
            true => 0.0,
            false => known("rho_d", &p.rho_d)?.max(0.0),
        },
        amplitude: 1.0,
    };
    domain::check(&surface, &optics)?;
    let variant = match report.variant {
        VariantName::Paper => Variant::Paper,
        VariantName::Sawtooth | VariantName::Traced => Variant::Sawtooth,
    };
    Ok(SurfaceBrdf::new(
        variant,
        surface,
        stated_deviations(report),
        &optics,
    ))
}

/// Returns the deviations from an ideal sawtooth that a report states, others as 0; `None` if it states none. A report has no
/// parameter for the lands: its angle, roughness and reflectance are those of the ridges between them.
#[must_use]
pub fn stated_deviations(report: &FitReport) -> Option<Real> {
    let p = &report.parameters;
    let distribution = report.slope_distribution.as_ref();
    let gamma = distribution.and_then(|slopes| slopes.shape);
    let value = |p: &Option<Parameter>| p.as_ref().and_then(|p| p.value);
    let (translucency, crest) = (value(&p.translucency), value(&p.crest_radius));
    if gamma.is_none() && translucency.is_none() && crest.is_none() {
        return None;
    }
    Some(Real {
        translucency: translucency.unwrap_or(0.0),
        tail: gamma.map_or(0.0, slopes::tail),
        crest: crest.unwrap_or(0.0),
        land: 0.0,
    })
}
