//! Known causes of a residual in sample, detector and lamp, each with a stable code.

use serde::{Deserialize, Serialize};

use super::blunders::{bad_block, bad_poses};
use super::drift::Drift;
use super::estimate::Estimate;
use super::wedge::Across;
use crate::wording::{counted, significant};

/// A known cause. Scripts compare its code.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
#[schema(as = FitFindingCode)]
pub enum Code {
    /// The slope distribution of the facets has longer tails than Beckmann's.
    Tails,
    /// The crests of the ridges are rounded.
    RoundedCrests,
    /// Light that enters one facet leaves through others.
    Translucent,
    /// The sample is tilted across the lean of the facets, or the stated zero of the azimuth is wrong.
    WedgeAcross,
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

    /// The code as scripts compare it.
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

/// Returns all findings of an estimate: of the surface, the detector, the lamp and single poses.
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
                "The camera reads {:.1} % low at full scale; the signals are corrected. Measure each pose at two or more exposures, or stay below half of full scale.",
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
            advice:
                "Let the lamp warm up, or measure the white reference before and after the series."
                    .to_owned(),
        });
    }
    if let Some(poses) = bad_poses(e) {
        found.push(Finding {
            code: Code::BadPose,
            explains: poses.explains,
            change_of_theta_r_deg: None,
            advice: format!(
                "Check the frames of {}: {} robust standard deviations from the others.",
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
                "The {} starting at {} deviate by {} %, all in one direction. Find out what changed then, and measure them again.",
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
            advice: across.message().unwrap_or_default(),
        });
    }
    sorted(found)
}

/// Lists poses by their angles.
fn named(e: &Estimate<'_>, observations: &[usize]) -> String {
    let all = &e.problem.set().observations;
    let each = observations.iter().map(|i| {
        let pose = all[*i].pose;
        format!("θc {:.2}°, φs {:.2}°", pose.theta_c.deg(), pose.phi_s.deg())
    });
    each.collect::<Vec<_>>().join("; ")
}

/// Sorts findings by the share of χ² that they explain, largest first.
pub(super) fn sorted(mut findings: Vec<Finding>) -> Vec<Finding> {
    findings.sort_by(|a, b| b.explains.total_cmp(&a.explains));
    findings
}
