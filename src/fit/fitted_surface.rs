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

/// Returns the deviations from an ideal sawtooth that a report states, others as 0; `None` if it states none.
#[must_use]
pub fn stated_deviations(report: &FitReport) -> Option<Real> {
    let p = &report.parameters;
    let distribution = report.slope_distribution.as_ref();
    let gamma = distribution.and_then(|slopes| slopes.shape);
    let value = |p: &Option<Parameter>| p.as_ref().and_then(|p| p.value);
    let stated = [
        value(&p.translucency),
        gamma.map(slopes::tail),
        value(&p.crest_radius),
        value(&p.land_share),
    ];
    let is_any = stated.iter().any(Option::is_some);
    is_any.then(|| Real::from_array(stated.map(|value| value.unwrap_or(0.0))))
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::fit::painted::{TRUTH, painted};
    use crate::fit::problem::Values;
    use crate::fit::{FitOptions, VariantChoice, fit};
    use crate::geometry::{Directions, Pose};

    #[test]
    fn the_lands_that_a_fit_finds_are_in_its_report_and_in_its_brdf() {
        let mut truth = Values {
            theta_r: 15f64.to_radians(),
            ..TRUTH
        };
        truth.real.land = 0.2;
        let poses =
            (0..56).map(|n| Pose::from_deg(7.0 * f64::from(n / 8) - 21.0, 45.0 * f64::from(n % 8)));
        let set = painted(poses, &truth, 2e-4, 5);
        let options = FitOptions {
            variant: VariantChoice::Sawtooth,
            ..FitOptions::default()
        };
        let report = fit(&set, &options, &AtomicBool::new(false));
        let land = report.parameters.land_share.as_ref().unwrap();
        let (value, expanded) = (land.value.unwrap(), land.expanded.unwrap());
        assert!(
            (value - 0.2).abs() < expanded && expanded < 0.05,
            "{land:?}"
        );

        let brdf = fitted_surface(&report, &set).unwrap();
        let optics = Optics::new(&set.rig, &set.material);
        let ideal = |theta_r: f64| {
            let surface = Surface {
                theta_r,
                alpha_u: truth.alpha_u,
                alpha_v: truth.alpha_v,
                rho_d: truth.rho_d,
                amplitude: 1.0,
            };
            SurfaceBrdf::new(Variant::Sawtooth, surface, None, &optics)
        };
        let (ridges, lands) = (ideal(truth.theta_r), ideal(0.0));
        // The mirror directions of the lands and of the facets, and one beside both.
        for mirrored_deg in [0.0, 15.0, 40.0] {
            let half = f64::to_radians(mirrored_deg);
            let (sin, cos) = (half - 0.1).sin_cos();
            let incident = nalgebra::Vector3::new(0.0, sin, cos);
            let (sin, cos) = (half + 0.1).sin_cos();
            let outgoing = nalgebra::Vector3::new(0.0, sin, cos);
            let directions = Directions { incident, outgoing };
            let of = |brdf: &SurfaceBrdf| brdf.value(&directions);
            let expected = 0.8 * of(&ridges) + 0.2 * of(&lands);
            let found = of(&brdf);
            assert!(
                (found / expected - 1.0).abs() < 0.02,
                "{mirrored_deg}: {found} {expected}"
            );
        }
    }
}
