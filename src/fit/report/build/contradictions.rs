//! Messages about stated values that the data contradict.

use super::spoken;
use crate::fit::causes::contradicted_values::{DENIED, Denial, denials, determines_the_material};
use crate::fit::causes::findings::{Code, Finding};
use crate::fit::estimate::Estimate;
use crate::fit::model_discrepancy::peak;
use crate::fit::problem::Quantity;
use crate::fit::uncertainty::budget::{Budget, Uncertainty};
use crate::wording::{percent, significant};

/// Stray light, as a share of the brightest signal, that changes no result and is not worth a look at the rig.
const FAINT: f64 = 1e-5;

/// Lists stated values that the data contradict, as messages. A value that a person stated is compared with that of the data
/// and all its errors, also those that all observations share.
pub(super) fn denied(e: &Estimate<'_>, u: &Uncertainty) -> Vec<String> {
    let top = peak(e.problem.set());
    let faint = |d: &Denial| {
        !d.by_user && d.quantity == Quantity::Background && e.values.background.abs() < FAINT * top
    };
    let denials = denials(e).into_iter();
    let material = determines_the_material(e);
    let denials = denials.filter(|d| (material || !d.is_of_material()) && !faint(d));
    let shared = |quantity: Quantity| {
        let j = e.problem.column(quantity);
        let without_scatter = j.map(|j| Budget {
            counting: 0.0,
            model: 0.0,
            prior: 0.0,
            ..u.budgets[j]
        });
        without_scatter.map_or(0.0, |budget| budget.combined())
    };
    let denials = denials.filter_map(|mut denial| {
        if denial.by_user {
            denial.deviations = denial.deviations_with(shared(denial.quantity));
        }
        (denial.deviations > DENIED).then_some(denial)
    });
    let messages = denials.map(|denial| {
        let Denial {
            quantity,
            prior,
            by_user,
            deviations,
            leverage,
            ..
        } = denial;
        let off = match deviations {
            ..1000.0 => format!("about {deviations:.0} standard deviations"),
            _ => "thousands of standard deviations".to_owned(),
        };
        let (mean, std) = (prior.mean, significant(prior.std));
        match quantity {
            _ if by_user => format!(
                "The data contradict the stated {} by {off}{}. Check the statement, or fit without it.",
                spoken(quantity),
                match prior.mean {
                    0.0 => String::new(),
                    mean => format!(
                        " (its standard uncertainty is {} of its value)",
                        percent(prior.std / mean.abs())
                    ),
                }
            ),
            Quantity::Background if e.values.background < prior.mean => format!(
                "The fitted stray light is negative ({} of the brightest signal, {off} from that of a darkened rig): the \
                 dark frames or the black level are too bright. The offset is corrected; check the dark frames.",
                percent((e.values.background / peak(e.problem.set())).abs())
            ),
            Quantity::Background => format!(
                "The fitted stray light is {} of the brightest signal, {off} from that of a darkened rig. It is \
                 subtracted; look for light that does not come from the lamp.",
                percent(e.values.background / peak(e.problem.set()))
            ),
            _ => format!(
                "The data contradict the stated {}: they give about {}, {off} from {mean} (u = {std}). Check the \
                 material of the sample and the certificate of the white reference; an error of the certificate \
                 changes ρd by the same share.",
                spoken(quantity),
                significant(without_prior(e, quantity, mean, leverage))
            ),
        }
    });
    messages.collect()
}

/// Returns the value that the data give without the pull of the prior, to first order.
fn without_prior(e: &Estimate<'_>, quantity: Quantity, mean: f64, leverage: f64) -> f64 {
    mean + (e.values.natural(quantity) - mean) / (1.0 - leverage)
}

/// Returns the finding for an index that the data contradict, if they do.
pub(super) fn index(e: &Estimate<'_>) -> Option<Finding> {
    let known = |f: &Finding| f.code == Code::Index;
    if !determines_the_material(e) || e.findings.iter().any(known) {
        return None;
    }
    let denials = denials(e).into_iter().filter(Denial::is_of_material);
    let worst = denials.max_by(|a, b| a.deviations.total_cmp(&b.deviations))?;
    // Without the certificate χ² is lower by the square of the deviations. Earlier findings have explained their
    // shares.
    let chi2: f64 = e.minimum.residuals.iter().map(|r| r * r).sum();
    let others = e.findings.iter().map(|f| f.explains).fold(0.0, f64::max);
    let share = (worst.deviations.powi(2) / chi2).min(1.0);
    let theta_r = e.problem.column(Quantity::ThetaR);
    let sign = e.values.theta_r.signum();
    Some(Finding {
        code: Code::Index,
        explains: (1.0 - others) * share,
        change_of_theta_r_deg: theta_r.map(|j| (sign * worst.shift[j]).to_degrees()),
        advice: format!(
            "The data give an {} of about {}; the manifest states {}. Check the material of the sample and the \
             certificate of the white reference.",
            spoken(worst.quantity),
            significant(without_prior(
                e,
                worst.quantity,
                worst.prior.mean,
                worst.leverage
            )),
            worst.prior.mean
        ),
    })
}
