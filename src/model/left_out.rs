//! The omissions of a result, in the one form that all results use.

use serde::{Deserialize, Serialize};

use super::{Variant, cone};
use crate::geometry::Cones;

/// [`LeftOut::what`] of polarisation, in fits and plans.
pub const POLARISATION: &str = "polarisation of light";

/// Something that a computation omits.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = WorkLeftOut)]
pub struct LeftOut {
    /// The omission.
    pub what: String,
    /// The reason.
    pub why: String,
    /// The error that it may cause, as a share of the result (of the peak, if that is a radiance); null if unknown.
    pub cost: Option<f64>,
}

impl LeftOut {
    /// An omission with its reason, and its cost if known.
    #[must_use]
    pub fn new(what: impl Into<String>, why: impl Into<String>, cost: Option<f64>) -> Self {
        LeftOut {
            what: what.into(),
            why: why.into(),
            cost,
        }
    }
}

/// Returns the omissions of every use of a closed form; `alpha` is the narrower roughness of its lobes.
#[must_use]
pub fn of_closed_form(variant: Variant, cones: &Cones, alpha: f64) -> Vec<LeftOut> {
    let mut list = vec![cone_average(cones, alpha)];
    list.extend(lens(cones));
    list.push(ideal_profile());
    list.push(match variant {
        Variant::Paper => printed_lobe(None),
        Variant::Sawtooth => third_bounce(),
    });
    list
}

/// The average over the cones of light, replaced by wider lobes.
#[must_use]
pub fn cone_average(cones: &Cones, alpha: f64) -> LeftOut {
    let points = cones.reach() <= 0.0;
    LeftOut::new(
        "average over the cones of lamp and lens",
        if points {
            "lamp and lens are points"
        } else {
            "replaced by a closed correction of the lobes' widths (α² + (Rl² + Rc²)/8)"
        },
        Some(cone::costs(cones, alpha).widened),
    )
}

/// The lens's cone, if the rig states none.
#[must_use]
pub fn lens(cones: &Cones) -> Option<LeftOut> {
    (cones.lens.rad() <= 0.0).then(|| {
        LeftOut::new(
            "the lens's cone",
            "neither lens_angular_radius_deg nor, for a table, detector_angular_radius_deg is stated, so the \
             lens counts as a point; this matters for lobes as narrow as its cone",
            None,
        )
    })
}

/// The deviations of real ridges from two straight slopes.
#[must_use]
pub fn ideal_profile() -> LeftOut {
    LeftOut::new(
        "rounded crests, burrs, draft of the risers",
        "the closed form is an ideal sawtooth with a right angle",
        None,
    )
}

/// The deviations that a sawtooth fit omits besides those of [`real_term`], which lists round crests by themselves;
/// `rounded` if the fit includes round crests.
#[must_use]
pub fn burrs_and_draft(rounded: bool) -> LeftOut {
    LeftOut::new(
        "burrs, draft of the risers",
        if rounded {
            "crests are round to first order; the data do not determine a draft of the risers, which is in the budget of θr"
        } else {
            "the risers of the closed form are at a right angle to the facets and have no burrs"
        },
        None,
    )
}

/// A term for real samples, by its name, that a fit omits because the residual (a share of the peak) does not need
/// it, or because it was tried (`asked`) and did not explain the residual.
#[must_use]
pub fn real_term(what: &str, rms_residual: f64, asked: bool) -> LeftOut {
    let why = if asked {
        "it was tried, and does not halve the residual of the fit"
    } else {
        "the residual of the fit is no larger than that of the closed form on ideal ridges"
    };
    LeftOut::new(what, why, Some(rms_residual))
}

/// The terms that the printed lobe lacks; `cost` if a fit has determined it.
#[must_use]
pub fn printed_lobe(cost: Option<f64>) -> LeftOut {
    LeftOut::new(
        "risers, diffuse walls and light that bounces twice",
        "the variant paper is the lobe as printed",
        cost,
    )
}

/// The polarisation, by the first reflection, of the light that reaches the second mirror.
#[must_use]
pub fn polarisation(why: impl Into<String>) -> LeftOut {
    LeftOut::new(POLARISATION, why, None)
}

/// The wedge of the sample on the turntable, if it is not stated.
#[must_use]
pub fn wedge() -> LeftOut {
    LeftOut::new(
        "wedge of the sample",
        "a mean plane inclined to the turntable turns with the ridges and adds to the ridge angle, degree for degree: frames \
         do not show it; state rig.sample_wedge_std_deg, or remount the sample at 180° and compare",
        None,
    )
}

/// The uncertainty of the angle between lamp and camera, if it is not stated.
#[must_use]
pub fn lamp_angle() -> LeftOut {
    LeftOut::new(
        "uncertainty of the angle between lamp and camera",
        "an error of the angle between lamp and camera moves every half vector by half of it and appears as tilt offset, \
         and as ridge angle or azimuth if the lamp is beside the tilt plane; state rig.theta_l_std_deg",
        None,
    )
}

/// A third specular reflection.
#[must_use]
pub fn third_bounce() -> LeftOut {
    LeftOut::new(
        "third bounce",
        "three specular reflections: a few thousandths of the second bounce's light; diffuse tails are included",
        Some(3e-4),
    )
}

/// Double reflections, if only the closed approximation is available; `cost` if it was compared with the integral.
#[must_use]
pub fn two_bounce_quadrature(cost: Option<f64>) -> LeftOut {
    LeftOut::new(
        "two-bounce quadrature",
        "light that bounces twice is taken from its closed approximation",
        cost,
    )
}
