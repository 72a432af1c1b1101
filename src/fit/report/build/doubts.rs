//! Messages about an end that is in doubt: not explained, not reached, ambiguous, or without a lobe.

use super::status::promised;
use crate::fit::causes::findings::Finding;
use crate::fit::estimate::Estimate;
use crate::fit::least_squares::levenberg_marquardt::Minimum;
use crate::fit::multistart::starts::{APART, distance};
use crate::fit::problem::Values;
use crate::fit::report::Status;
use crate::fit::uncertainty::budget::Uncertainty;
use crate::wording::{percent, significant};

/// Share of χ² from which a finding is the cause of a residual.
const MOST: f64 = 0.5;

/// Says what to do about residuals that exceed noise and model error: follow the finding that explains most of them, if
/// there is one.
pub(super) fn unexplained(findings: &[Finding], is_near: bool) -> String {
    let cause = findings
        .iter()
        .max_by(|a, b| a.explains.total_cmp(&b.explains));
    match cause.filter(|finding| finding.explains > MOST) {
        Some(finding) => format!(
            "The residuals exceed noise and model error. The finding `{}` explains {} of them: {}",
            finding.code.word(),
            percent(finding.explains),
            finding.advice
        ),
        None if is_near => "The residuals exceed noise and model error. Check the keys of the near rig: \
                            rig.tilt_centre_px, camera.principal_point_px, rig.camera_distance_mm and \
                            rig.light_distance_mm; then measure more poses around the bright spot."
            .to_owned(),
        None => "The residuals exceed noise and model error; possibly no start found the lobe. Check the residuals, and \
                 measure more poses around the bright spot or allow more starts."
            .to_owned(),
    }
}

/// Explains why a fit stalled.
pub(super) fn unfinished(e: &Estimate<'_>, u: &Uncertainty, status: Status) -> Option<String> {
    let left = promised(&e.minimum, u);
    (status == Status::Stalled && e.explained).then(|| {
        let left = match left.is_finite() {
            true => format!("one more step would lower χ² by {}", significant(left)),
            false => "at an unknown distance".to_owned(),
        };
        format!(
            "The descent stopped beside the minimum ({left}), as it can where the edge of a shadow falls on a pose. The \
             values are near the best ones. Measure other poses, or allow more starts."
        )
    })
}

/// Describes a surface without a lobe that the data do not exclude.
pub(super) fn darkness(e: &Estimate<'_>, dark: &Minimum) -> String {
    format!(
        "These poses may show no lobe: without one, χ² is higher by only {:.2}, which chance explains. θr, then {:.2}°, \
         comes from the light of the body, and nothing gives αu and αv. Measure more poses around the bright spot; if \
         there is none, the surface is matte.",
        (dark.cost - e.minimum.cost).max(0.0),
        e.problem
            .unpack(&dark.parameters)
            .folded()
            .theta_r
            .to_degrees()
    )
}

/// Describes the minima that the data do not exclude, one for each group beside each other.
pub(super) fn ambiguous(e: &Estimate<'_>) -> Vec<String> {
    let mut named: Vec<Values> = Vec::new();
    let mut messages = Vec::new();
    for rival in &e.rivals {
        let there = e.problem.unpack(&rival.parameters).folded();
        if named.iter().all(|other| distance(other, &there) > APART) {
            messages.push(ambiguity(e, rival));
            named.push(there);
        }
    }
    messages
}

/// Describes a minimum that the data do not exclude.
fn ambiguity(e: &Estimate<'_>, rival: &Minimum) -> String {
    let v = e.problem.unpack(&rival.parameters).folded();
    format!(
        "Another surface fits as well (χ² higher by {:.2}): θr {:.2}°, αu {:.4}, αv {:.4}, azimuth offset {:.2}°. The \
         uncertainties cover both. Measure more azimuths or tilts to distinguish them.",
        (rival.cost - e.minimum.cost).max(0.0),
        v.theta_r.to_degrees(),
        v.alpha_u,
        v.alpha_v,
        v.azimuth_offset.to_degrees()
    )
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use crate::fit::FitOptions;
    use crate::fit::causes::findings::Code;
    use crate::fit::one_variant::estimate;
    use crate::fit::painted::{TRUTH, painted};
    use crate::geometry::Pose;
    use crate::model::Variant;

    #[test]
    fn minima_beside_each_other_are_named_once() {
        let poses = (0..60)
            .map(|n| Pose::from_deg(8.0 * f64::from(n / 12) - 16.0, 30.0 * f64::from(n % 12)));
        let set = painted(poses, &TRUTH, 1e-3, 1);
        let cancel = AtomicBool::new(false);
        let options = FitOptions::default();
        let mut e = estimate(&set, Variant::Sawtooth, &options, None, &cancel).unwrap();
        let here = e.values.folded();
        let mut other = |theta_r: f64, alpha_v: f64| {
            let mut rival = e.minimum.clone();
            rival.parameters = e.problem.pack(&Values {
                theta_r,
                alpha_v,
                ..here
            });
            e.rivals.push(rival);
        };
        other(0.3, 0.1);
        other(0.301, 0.101);
        other(0.3, 0.2);
        let messages = ambiguous(&e);
        assert_eq!(messages.len(), 2, "{messages:?}");
        assert!(messages[0].contains("αv 0.1000") && messages[1].contains("αv 0.2000"));
    }

    #[test]
    fn the_finding_that_explains_most_of_a_residual_is_named_with_its_advice() {
        let finding = |code, explains| Finding {
            code,
            explains,
            change_of_theta_r_deg: None,
            advice: format!("Do what {} asks.", Code::word(code)),
        };
        let found = [finding(Code::Tails, 0.2), finding(Code::Index, 0.9)];
        let text = unexplained(&found, false);
        assert!(
            text.contains("`index` explains 90 %") && text.ends_with("what index asks."),
            "{text}"
        );
        let text = unexplained(&found[..1], true);
        assert!(text.contains("rig.tilt_centre_px"), "{text}");
        let text = unexplained(&found[..1], false);
        assert!(text.contains("no start found the lobe"), "{text}");
    }
}
