//! What an answer does without: the one form in which every result says it.

use serde::{Deserialize, Serialize};

use super::{Variant, cone};
use crate::geometry::Cones;

/// [`LeftOut::what`] of polarisation, in fits and plans alike.
pub const POLARISATION: &str = "polarisation of light";

/// Something that a computation leaves out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LeftOut {
    /// What.
    pub what: String,
    /// Why.
    pub why: String,
    /// What it may cost: a share of the quantity asked for (of the peak, where that is a radiance); null
    /// where nobody knows.
    pub cost: Option<f64>,
}

impl LeftOut {
    /// In words, with its cost where it is known.
    #[must_use]
    pub fn new(what: impl Into<String>, why: impl Into<String>, cost: Option<f64>) -> Self {
        LeftOut {
            what: what.into(),
            why: why.into(),
            cost,
        }
    }
}

/// What every use of a closed form does without, whatever is done with its radiances; `alpha` is the
/// narrower roughness of its lobes.
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

/// The lens's cone, where the rig states none.
#[must_use]
pub fn lens(cones: &Cones) -> Option<LeftOut> {
    (cones.lens.rad() <= 0.0).then(|| {
        LeftOut::new(
            "the lens's cone",
            "the rig states no lens_angular_radius_deg, so the lens counts as a point; that matters for \
             lobes as narrow as its cone",
            None,
        )
    })
}

/// What real ridges have beside their two slopes.
#[must_use]
pub fn ideal_profile() -> LeftOut {
    LeftOut::new(
        "rounded crests, burrs, draft of the risers",
        "the closed form is an ideal sawtooth with a right angle",
        None,
    )
}

/// The same where the crests are round.
#[must_use]
pub fn burrs_and_draft() -> LeftOut {
    LeftOut::new(
        "burrs, draft of the risers",
        "crests are round to first order; a draft of the riser cannot be told from the data and is in the budget of θr",
        None,
    )
}

/// What a fit leaves out of what real samples have, by its name, where the residual (a share of the peak) needs none of it, or where
/// it was asked for and did not explain the residual.
#[must_use]
pub fn real_term(what: &str, rms_residual: f64, asked: bool) -> LeftOut {
    let why = if asked {
        "it was tried, and does not halve what the fit leaves"
    } else {
        "the fit leaves no more than the closed form does on ideal ridges, so nothing asks for it"
    };
    LeftOut::new(what, why, Some(rms_residual))
}

/// What the printed lobe has not; `cost` where a fit has told it.
#[must_use]
pub fn printed_lobe(cost: Option<f64>) -> LeftOut {
    LeftOut::new(
        "risers, diffuse walls and light that bounces twice",
        "the variant paper is the lobe as printed",
        cost,
    )
}

/// What the first mirror does to the light that the second one sees.
#[must_use]
pub fn polarisation(why: impl Into<String>) -> LeftOut {
    LeftOut::new(POLARISATION, why, None)
}

/// How the sample lies on the turntable, where nobody states it.
#[must_use]
pub fn wedge() -> LeftOut {
    LeftOut::new(
        "wedge of the sample",
        "a mean plane inclined to the turntable turns with the ridges and reads as ridge angle, degree for degree: frames \
         cannot show it; state rig.sample_wedge_std_deg, or remount the sample at 180° and compare",
        None,
    )
}

/// How well the angle between lamp and camera is known, where nobody states it.
#[must_use]
pub fn lamp_angle() -> LeftOut {
    LeftOut::new(
        "uncertainty of theta_l",
        "an error of the angle between lamp and camera moves every half vector by half of it and reads as tilt offset, \
         and as ridge angle or azimuth where the lamp is beside the tilt plane; state rig.theta_l_std_deg",
        None,
    )
}

/// Light that is reflected a third time.
#[must_use]
pub fn third_bounce() -> LeftOut {
    LeftOut::new(
        "third bounce",
        "three specular reflections: a few thousandths of the second bounce's light; diffuse tails are included",
        Some(3e-4),
    )
}

/// Light that bounces twice where only its closed approximation is at hand; `cost` where the integral was compared.
#[must_use]
pub fn two_bounce_quadrature(cost: Option<f64>) -> LeftOut {
    LeftOut::new(
        "two-bounce quadrature",
        "light that bounces twice is taken from its closed approximation",
        cost,
    )
}
