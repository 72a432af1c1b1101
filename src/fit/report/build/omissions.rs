//! What a fit left out, with what that may cost.

use crate::fit::estimate::Estimate;
use crate::fit::problem::Quantity;
use crate::fit::report::{LeftOut, VariantName};
use crate::geometry::field::SUMMED_WITHIN;
use crate::material::Material;
use crate::model::left_out;

/// Lists what the fit of a variant left out.
pub(super) fn all_left_out(e: &Estimate<'_>, variant: VariantName) -> Vec<LeftOut> {
    let cones = &e.problem.set().rig.cones;
    let narrow = e.values.alpha_u.min(e.values.alpha_v);
    let mut list: Vec<LeftOut> = left_out::lens(cones).into_iter().collect();
    if variant != VariantName::Traced
        && !(variant == VariantName::Sawtooth && e.takes_higher_order())
    {
        list.push(left_out::cone_average(cones, narrow));
    }
    match variant {
        VariantName::Traced => {}
        VariantName::Paper => list.push(left_out::ideal_profile()),
        // Rounded crests are among the real terms below.
        VariantName::Sawtooth => list.push(left_out::burrs_and_draft(e.values.real.crest > 0.0)),
    }
    match variant {
        VariantName::Traced => list.push(LeftOut::new(
            "multiple reflections within the roughness of a facet",
            "the tracer reflects light from one microfacet per hit, with Smith's masking",
            None,
        )),
        VariantName::Paper => list.push(left_out::printed_lobe(Some(e.rms_residual))),
        VariantName::Sawtooth => {
            if let Some(cost) = e.higher_order_left_out {
                list.push(LeftOut::new(
                    "two-bounce quadrature",
                    "it changes less than the tolerance at poses spread over the data",
                    Some(cost),
                ));
            } else if !e.takes_higher_order() {
                list.push(LeftOut::new(
                    "two-bounce quadrature",
                    "the closed form fits these data better without the integrated second bounce",
                    Some(e.rms_residual),
                ));
            }
            list.push(left_out::third_bounce());
            list.extend(real_terms(e));
        }
    }
    list.extend(polarisation(e, variant));
    list.extend(directions(e));
    if e.problem.set().wedge_std.is_none() {
        list.push(left_out::wedge());
    }
    if e.problem.set().theta_l_std.is_none() {
        list.push(left_out::lamp_angle());
    }
    if e.cut_short {
        list.push(LeftOut::new(
            "the rest of the search",
            "the time limit ended it; a deeper minimum may have been missed",
            None,
        ));
    }
    if let Some(thinned) = &e.thinned {
        let (kept, of) = (thinned.kept.len(), e.problem.set().observations.len());
        list.push(LeftOut::new(
            format!("{} of {of} observations in the search and in `fitted`", of - kept),
            "the search uses observations spread over the poses, with the brightest of each neighbourhood; descent, \
             weights and uncertainties use all. A minimum that only the others show would be missed",
            None,
        ));
        if let Some((nodes, error)) = thinned.interpolated {
            list.push(LeftOut::new(
                "two-bounce quadrature at every pose",
                format!("integrated at {nodes} poses and interpolated between them"),
                Some(error),
            ));
        }
    }
    list
}

/// Lists the terms of real samples that this fit omits.
fn real_terms(e: &Estimate<'_>) -> Vec<LeftOut> {
    let there = |q: &Quantity| {
        e.problem.is_extended() && (e.problem.free().contains(q) || e.held.contains(q))
    };
    let body = matches!(e.problem.set().material, Material::Dielectric { .. });
    let names = [
        (Quantity::Translucency, "translucency of the body"),
        (Quantity::Tail, "tails of the slope distribution"),
        (Quantity::CrestRadius, "rounded crests"),
        (Quantity::Land, "flat lands between the ridges"),
        (
            Quantity::Wedge,
            "tilt of the sample across the ridges, beyond the azimuth that it causes",
        ),
        (
            Quantity::LampTurn,
            "turn of the lamp about the camera's axis",
        ),
    ];
    names
        .into_iter()
        .filter(|(q, _)| !there(q) && (body || *q != Quantity::Translucency))
        .map(|(_, what)| left_out::real_term(what, e.rms_residual, e.investigated))
        .collect()
}

/// The directions over the field of a near camera or lamp that the sums of this fit skip.
fn directions(e: &Estimate<'_>) -> Option<LeftOut> {
    let set = e.problem.set();
    let whole = set.field?;
    let few = set.views.iter().map(Vec::len).max()?;
    let pixels = whole.field.width * whole.field.height;
    Some(LeftOut::new(
        format!("directions of all but {few} of {pixels} points of the field"),
        format!(
            "these sum lobes of α = {:.3} and wider ones within {SUMMED_WITHIN:e} of their top",
            whole.narrowest
        ),
        None,
    ))
}

/// Whether the second reflection depends on the polarisation caused by the first. For metals the closed form includes
/// it, too.
fn polarisation(e: &Estimate<'_>, variant: VariantName) -> Option<LeftOut> {
    let metal = matches!(e.problem.set().material, Material::Conductor { .. });
    let followed = match variant {
        // It has no second reflection.
        VariantName::Paper => true,
        VariantName::Sawtooth => metal || (e.takes_higher_order() && e.problem.is_polarised()),
        VariantName::Traced => e.traced.as_ref().is_none_or(|t| t.polarised),
    };
    let by_data = e.takes_higher_order() || variant == VariantName::Traced;
    (!followed).then(|| {
        left_out::polarisation(if by_data {
            "the unpolarised model fits these data better"
        } else {
            "lamp and camera do not polarise, so single reflections do not depend on it; the closed form omits it for \
             double reflections on plastic"
        })
    })
}
