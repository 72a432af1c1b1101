//! Messages about stated values that the data contradict.

use super::spoken;
use crate::fit::denials::{Denial, denials, tells_the_material};
use crate::fit::estimate::Estimate;
use crate::fit::misfit::peak;
use crate::fit::problem::Quantity;
use crate::wording::{percent, significant};

/// Stray light, as a share of the brightest signal, that changes no result and is not worth a look at the rig.
const FAINT: f64 = 1e-5;

/// Lists stated values that the data contradict, as messages.
pub(super) fn denied(e: &Estimate<'_>) -> Vec<String> {
    let top = peak(e.problem.set());
    let faint = |d: &Denial| {
        !d.by_user && d.quantity == Quantity::Background && e.values.background.abs() < FAINT * top
    };
    let denials = denials(e).into_iter();
    let told = tells_the_material(e);
    let denials = denials.filter(|d| (told || !d.is_of_material()) && !faint(d));
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
                // Without the pull of the prior.
                significant(mean + (e.values.natural(quantity) - mean) / (1.0 - leverage))
            ),
        }
    });
    messages.collect()
}
