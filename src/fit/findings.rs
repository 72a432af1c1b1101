//! Known causes of a residual in sample, detector and lamp, each with a stable code.

use serde::{Deserialize, Serialize};

/// A known cause. Scripts compare its code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
#[schema(as = FitFindingCode)]
pub enum Code {
    /// The slope distribution of the facets has longer tails than Beckmann's.
    Tails,
    /// The crests of the ridges are rounded.
    RoundedCrests,
    /// A part of the surface is flat between the ridges.
    FlatLands,
    /// Light that enters one facet leaves through others.
    Translucent,
    /// The sample is tilted across the lean of the facets, or the stated zero of the azimuth is wrong.
    WedgeAcross,
    /// The lamp stands at another azimuth about the camera's axis than stated.
    LampAzimuth,
    /// The white reference depends on the tilt otherwise than a Lambertian surface at the stated angles.
    WhiteReference,
    /// The counts of the detector are not proportional to the light.
    NonLinear,
    /// The lamp changed while the poses were measured.
    LampDrift,
    /// The refractive index differs from the stated one.
    Index,
    /// A run of consecutive poses disagrees with the others.
    BadBlock,
    /// A single pose disagrees with the others.
    BadPose,
}

impl Code {
    /// All codes.
    pub const ALL: [Code; 12] = [
        Code::Tails,
        Code::RoundedCrests,
        Code::FlatLands,
        Code::Translucent,
        Code::WedgeAcross,
        Code::LampAzimuth,
        Code::WhiteReference,
        Code::NonLinear,
        Code::LampDrift,
        Code::Index,
        Code::BadBlock,
        Code::BadPose,
    ];

    /// The code as scripts compare it.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Code::Tails => "tails",
            Code::RoundedCrests => "rounded-crests",
            Code::FlatLands => "flat-lands",
            Code::Translucent => "translucent",
            Code::WedgeAcross => "wedge-across",
            Code::LampAzimuth => "lamp-azimuth",
            Code::WhiteReference => "white-reference",
            Code::NonLinear => "non-linear",
            Code::LampDrift => "lamp-drift",
            Code::Index => "index",
            Code::BadBlock => "bad-block",
            Code::BadPose => "bad-pose",
        }
    }
}

/// A cause that was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, utoipa::ToSchema)]
#[schema(as = FitFinding)]
pub struct Finding {
    /// Which one.
    pub code: Code,
    /// Share of χ² that it explains, 0 to 1.
    pub explains: f64,
    /// Change of the ridge angle in degrees when the cause is accounted for; none if it cannot be determined.
    pub change_of_theta_r_deg: Option<f64>,
    /// What the user should do.
    pub advice: String,
}

/// Sorts findings by the share of χ² that they explain, largest first.
pub(super) fn sorted(mut findings: Vec<Finding>) -> Vec<Finding> {
    findings.sort_by(|a, b| b.explains.total_cmp(&a.explains));
    findings
}
