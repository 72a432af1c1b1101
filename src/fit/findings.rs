//! What explains a residual: the known troubles of samples, detector and lamp, each with a stable code.

use serde::{Deserialize, Serialize};

use super::blunders::{bad_block, bad_poses};
use super::drift::Drift;
use super::estimate::Estimate;
use super::wedge::Across;
use crate::wording::{counted, significant};

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

/// All that is found of an estimate: what its surface has, and what its detector, its lamp and single poses did.
pub(super) fn all(
    e: &Estimate<'_>,
    drift: Option<&Drift>,
    across: Option<&Across>,
) -> Vec<Finding> {
    let mut found = e.findings.clone();
    let set = e.problem.set();
    if let Some(curve) = set.detector {
        found.push(Finding {
            code: Code::NonLinear,
            explains: curve.explains,
            change_of_theta_r_deg: None,
            advice: format!(
                "the camera's counts fall short by {:.1} % at full scale; the signals are corrected for it. Take two exposures or more                  of every pose, or stay below half of full scale",
                100.0 * curve.c
            ),
        });
    }
    if let Some(Drift { lamp, .. }) = drift {
        let moved = e.values.folded().theta_r - lamp.theta_r_before;
        found.push(Finding {
            code: Code::LampDrift,
            explains: lamp.explains,
            change_of_theta_r_deg: set.lamp.map(|_| moved.to_degrees()),
            advice: "let the lamp warm up, or take the white reference at both ends of the series"
                .to_owned(),
        });
    }
    if let Some(poses) = bad_poses(e) {
        found.push(Finding {
            code: Code::BadPose,
            explains: poses.explains,
            change_of_theta_r_deg: None,
            advice: format!(
                "look at the frames of {}: {} robust standard deviations from the rest",
                named(e, &poses.observations),
                significant(poses.deviations)
            ),
        });
    }
    if let Some(block) = bad_block(e) {
        found.push(Finding {
            code: Code::BadBlock,
            explains: block.explains,
            change_of_theta_r_deg: None,
            advice: format!(
                "the {} from {} on are {} % off, all one way: look for what happened then, and scan them again",
                counted(block.observations.len(), "pose"),
                named(e, &block.observations[..1]),
                significant(100.0 * block.share)
            ),
        });
    }
    if let Some(across) = across.filter(|across| across.is_wedge()) {
        found.push(Finding {
            code: Code::WedgeAcross,
            explains: 0.0,
            change_of_theta_r_deg: None,
            advice: across.told().unwrap_or_default(),
        });
    }
    sorted(found)
}

/// Poses by their angles.
fn named(e: &Estimate<'_>, observations: &[usize]) -> String {
    let all = &e.problem.set().observations;
    let each = observations.iter().map(|i| {
        let pose = all[*i].pose;
        format!("θc {:.2}°, φs {:.2}°", pose.theta_c.deg(), pose.phi_s.deg())
    });
    each.collect::<Vec<_>>().join("; ")
}

/// Most first.
pub(super) fn sorted(mut findings: Vec<Finding>) -> Vec<Finding> {
    findings.sort_by(|a, b| b.explains.total_cmp(&a.explains));
    findings
}
