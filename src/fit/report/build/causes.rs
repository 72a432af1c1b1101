//! The known causes of a residual of an estimate: of the surface, the detector, the lamp, the index and single poses.

use super::contradictions::index;
use crate::fit::causes::bad_poses::{BadBlock, BadPoses, bad_block, bad_poses};
use crate::fit::causes::findings::{Code, Finding, sorted};
use crate::fit::causes::lamp_drift::Drift;
use crate::fit::causes::wedge;
use crate::fit::causes::wedge::Across;
use crate::fit::estimate::Estimate;
use crate::fit::problem::Quantity;
use crate::fit::report::{Parameter, Parameters};
use crate::fit::uncertainty::budget::{Budget, Uncertainty};
use crate::units::Angle;
use crate::wording::{counted, significant};

/// Share of χ² that bad poses explain at least, as every other cause: where they explain less, poses on a steep flank show the model
/// error.
pub(in crate::fit) const EXPLAINS: f64 = 0.5;

/// Returns all findings of an estimate: of the surface, the detector, the lamp, the index and single poses.
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
            advice: match curve.exponent == 1.0 {
                true => format!(
                    "The camera reads {:.1} % low at full scale; the signals are corrected. Measure each pose at two or more exposures, or stay below half of full scale.",
                    100.0 * curve.c
                ),
                false => format!(
                    "The camera counts light^{:.3}; the signals are corrected. Set its gamma to 1.",
                    curve.exponent
                ),
            },
        });
    }
    if let Some(drift) = drift {
        let lamp = &drift.lamp;
        let moved = e.values.folded().theta_r - lamp.theta_r_before;
        found.push(Finding {
            code: Code::LampDrift,
            explains: lamp.explains,
            change_of_theta_r_deg: set.lamp.map(|_| moved.to_degrees()),
            advice: drift.advice().to_owned(),
        });
    }
    // An investigation has tried them beside the properties of the surface.
    let open = !e.poses_tried;
    if let Some(poses) = bad_poses(e).filter(|poses| open && poses.explains > EXPLAINS) {
        found.push(of_poses(e, &poses));
    }
    if let Some(block) = bad_block(e).filter(|_| open) {
        found.push(of_block(e, &block));
    }
    found.extend(index(e));
    let is_known = found.iter().any(|f| f.code == Code::WedgeAcross);
    if let Some(across) = across.filter(|across| across.is_wedge() && !is_known) {
        found.push(Finding {
            code: Code::WedgeAcross,
            explains: 0.0,
            change_of_theta_r_deg: None,
            advice: across.message().unwrap_or_default(),
        });
    }
    sorted(found)
}

/// Describes single poses that disagree with the others.
pub(in crate::fit) fn of_poses(e: &Estimate<'_>, poses: &BadPoses) -> Finding {
    let frames = match e.problem.set().is_of_goniometer() {
        true => "",
        false => "the frames of ",
    };
    Finding {
        code: Code::BadPose,
        explains: poses.explains,
        change_of_theta_r_deg: None,
        advice: format!(
            "Check {frames}{}: {} robust standard deviations from the others.",
            named(e, &poses.observations),
            significant(poses.deviations)
        ),
    }
}

/// Describes a run of poses that disagrees with the others.
pub(in crate::fit) fn of_block(e: &Estimate<'_>, block: &BadBlock) -> Finding {
    let pose = match e.problem.set().is_of_goniometer() {
        true => "reading",
        false => "pose",
    };
    Finding {
        code: Code::BadBlock,
        explains: block.explains,
        change_of_theta_r_deg: None,
        advice: format!(
            "The {} starting at {} deviate by {} %, all in one direction. Find out what changed then, and measure them again.",
            counted(block.observations.len(), pose),
            named(e, &block.observations[..1]),
            significant(100.0 * block.share)
        ),
    }
}

/// Lists poses by their angles, and readings of a table by their rows.
fn named(e: &Estimate<'_>, observations: &[usize]) -> String {
    let all = &e.problem.set().observations;
    let each = observations.iter().map(|i| match all[*i].row {
        Some(row) => row.to_string(),
        None => {
            let pose = all[*i].pose;
            format!("θc {:.2}°, φs {:.2}°", pose.theta_c.deg(), pose.phi_s.deg())
        }
    });
    each.collect::<Vec<_>>().join("; ")
}

/// Divides the azimuth of a fit, if it determined both angles: by the fit if the wedge is in it, otherwise by what is stated
/// ([`wedge::across`]).
pub(super) fn across(e: &Estimate<'_>, u: &Uncertainty, parameters: &Parameters) -> Option<Across> {
    let set = e.problem.set();
    let angle = |p: &Parameter| p.value.filter(|_| p.identifiable).map(Angle::from_deg);
    let azimuth = &parameters.azimuth_offset_deg;
    let own = Budget {
        wedge: 0.0,
        ..azimuth.budget?
    };
    let theta_r = angle(&parameters.theta_r_deg)?;
    let azimuth = (angle(azimuth)?, Angle::from_deg(own.combined()));
    let column = |q| e.problem.column(q);
    if let (Some(i), Some(j)) = (column(Quantity::AzimuthOffset), column(Quantity::Wedge))
        && u.covariance.identifiable[j]
    {
        let tilt = Angle::from_rad(e.values.folded().wedge);
        let tilt = (tilt, Angle::from_rad(u.budgets[j].combined()));
        // Folding a negative θr changes the sign of the wedge.
        let common = u.covariance.matrix[(i, j)] * e.values.theta_r.signum();
        return Some(wedge::fitted(theta_r, azimuth, tilt, common));
    }
    wedge::across(
        theta_r,
        azimuth.0,
        azimuth.1,
        wedge::Stated {
            azimuth_zero: set.azimuth_zero_std,
            wedge: set.wedge_std,
        },
    )
}
