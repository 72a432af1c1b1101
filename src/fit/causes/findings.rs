//! Known causes of a residual in sample, detector and lamp, each with a stable code.

use serde::{Deserialize, Serialize};

use crate::observation::ObservationSet;

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

    /// Whether both are one kind of cause: single poses and runs of them are.
    pub(in crate::fit) fn is_like(self, other: Code) -> bool {
        let of_poses = |code: Code| matches!(code, Code::BadPose | Code::BadBlock);
        self == other || (of_poses(self) && of_poses(other))
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

/// A cause in the observations.
#[derive(Debug, Clone)]
pub(in crate::fit) struct ObservationCause {
    /// The observations as they are without it, or with less weight for those that are wrong.
    pub set: ObservationSet,
    /// What names it; none of a drift, which the set itself names.
    pub finding: Option<Finding>,
    /// χ² per degree of freedom that it leaves.
    pub left: f64,
    /// Whether a property of the surface at the angles of the poses may be the cause as well.
    pub is_open: bool,
}

/// Sorts findings by the share of χ² that they explain, largest first.
pub(in crate::fit) fn sorted(mut findings: Vec<Finding>) -> Vec<Finding> {
    findings.sort_by(|a, b| b.explains.total_cmp(&a.explains));
    findings
}
