//! Messages about an end that is in doubt: not explained, not reached, ambiguous, or without a lobe.

use super::status::promised;
use crate::fit::budget::Uncertainty;
use crate::fit::estimate::Estimate;
use crate::fit::findings::Finding;
use crate::fit::problem::Values;
use crate::fit::report::Status;
use crate::fit::search::APART;
use crate::fit::solver::Minimum;
use crate::fit::start::distance;
use crate::wording::{percent, significant};

/// Share of χ² from which a finding is the cause of a residual.
const MOST: f64 = 0.5;

/// Says what to do about residuals that exceed noise and model error: follow the finding that explains most of them, if
/// there is one.
pub(super) fn unexplained(findings: &[Finding]) -> String {
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
