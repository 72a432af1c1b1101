//! What explains a residual: the known troubles of samples, detector and lamp, each with a stable code.

use serde::{Deserialize, Serialize};

/// A known trouble. Scripts compare the words.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Code {
    /// The facets' lobe has longer tails than Beckmann's.
    Tails,
    /// The crests of the ridges are round.
    RoundedCrests,
    /// Light that enters one facet leaves others.
    Translucent,
    /// The sample is inclined across the facets' lean, or the azimuth's zero is not what was stated.
    WedgeAcross,
    /// The detector's counts are not proportional to the light.
    NonLinear,
    /// The lamp's light changed while the poses were taken.
    LampDrift,
    /// The index of refraction is not what was stated.
    Index,
    /// A run of poses in time that does not fit the others.
    BadBlock,
    /// One pose that does not fit the others.
    BadPose,
}

impl Code {
    /// All of them.
    pub const ALL: [Code; 9] = [
        Code::Tails,
        Code::RoundedCrests,
        Code::Translucent,
        Code::WedgeAcross,
        Code::NonLinear,
        Code::LampDrift,
        Code::Index,
        Code::BadBlock,
        Code::BadPose,
    ];

    /// The word that scripts compare.
    #[must_use]
    pub const fn word(self) -> &'static str {
        match self {
            Code::Tails => "tails",
            Code::RoundedCrests => "rounded-crests",
            Code::Translucent => "translucent",
            Code::WedgeAcross => "wedge-across",
            Code::NonLinear => "non-linear",
            Code::LampDrift => "lamp-drift",
            Code::Index => "index",
            Code::BadBlock => "bad-block",
            Code::BadPose => "bad-pose",
        }
    }
}

/// A trouble that was found.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// Which.
    pub code: Code,
    /// Share of χ² that goes with it, 0 to 1.
    pub explains: f64,
    /// Ridge angle with it accounted for, less the one without, degrees; none where it cannot be told.
    pub change_of_theta_r_deg: Option<f64>,
    /// What to do, for a person.
    pub advice: String,
}

/// Most first.
pub(super) fn sorted(mut findings: Vec<Finding>) -> Vec<Finding> {
    findings.sort_by(|a, b| b.explains.total_cmp(&a.explains));
    findings
}
