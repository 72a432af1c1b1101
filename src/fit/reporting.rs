//! Turns an estimate into the report: status, parameters with their budgets, warnings, and what was left out.
//!
//! Call [`report_of`], or [`report_with`] if the uncertainties are known already. [`super::variants`] compares the
//! variants and selects the one to report.

use nalgebra::DVector;

use super::budget::{Budget, Uncertainty, tied, uncertainty};
use super::denials::{Denial, denials};
use super::drift::{Drift, drift};
use super::estimate::Estimate;
use super::findings;
use super::known::{drift_std, reference_std};
use super::misfit::{self, LOUD, few, peak};
use super::parameter_covariance::{self, per_solver_unit};
use super::problem::{Quantity, Values};
use super::report::{
    FEW_POSES, FitReport, FittedObservation, Freedom, LeftOut, Parameter, Parameters,
    SlopeDistribution, Starts, Status, Timing, VariantName, VariantSummary,
};
use super::solver::Minimum;
use super::wedge;
use crate::material::Material;
use crate::model::extended::slopes::{gamma, half_width_over_alpha};
use crate::model::left_out;
use crate::observation::ObservationSet;
use crate::wording::{counted, percent, significant};

/// Standard uncertainty above which an angle counts as undetermined, rad.
const HOPELESS_ANGLE: f64 = 0.35;
/// The same for the logarithm of a roughness.
const HOPELESS_LOG_ALPHA: f64 = 1.0;
/// The same for translucency, tail and crest radius.
const HOPELESS_REAL: f64 = 0.5;
/// The same for the diffuse reflectance.
const HOPELESS_RHO_D: f64 = 0.5;

/// Name and version of the program with its commit.
pub(super) fn build() -> String {
    concat!("ridged ", env!("RIDGED_VERSION")).to_owned()
}

/// Name and version of the program.
pub(super) fn program() -> String {
    concat!("ridged ", env!("CARGO_PKG_VERSION")).to_owned()
}

/// Decrease of the cost promised by a further step, below which an end counts as a minimum: a thousandth of a standard
/// uncertainty away.
const AT_BOTTOM: f64 = 1e-6;

pub(super) fn status(e: &Estimate<'_>, uncertainty: &Uncertainty) -> Status {
    use super::solver::Ending;
    let ending = match e.minimum.ending {
        // In a flat valley the cost stops falling before the steps are short.
        Ending::ConvergedByCost | Ending::Stalled | Ending::MaxIterations
            if promised(&e.minimum, uncertainty) <= AT_BOTTOM =>
        {
            Ending::ConvergedByGradient
        }
        ending => ending,
    };
    match ending {
        Ending::Cancelled => Status::Cancelled,
        Ending::NotFinite => Status::NotFinite,
        _ if !uncertainty.covariance.null_directions.is_empty() => Status::RankDeficient,
        Ending::RankDeficient => Status::RankDeficient,
        Ending::ConvergedByStep | Ending::ConvergedByGradient if !e.explained => Status::Stalled,
        _ if shape_unknown(e, uncertainty) => Status::RankDeficient,
        Ending::ConvergedByStep | Ending::ConvergedByGradient if !e.minimum.at_bound.is_empty() => {
            Status::AtBound
        }
        Ending::ConvergedByStep | Ending::ConvergedByGradient => Status::Converged,
        Ending::ConvergedByCost | Ending::Stalled | Ending::MaxIterations => Status::Stalled,
    }
}

/// Predicts by how much one more step lowers the cost, from the derivatives at an end: gᵀ C g.
fn promised(end: &Minimum, uncertainty: &Uncertainty) -> f64 {
    let (m, n) = (end.residuals.len(), end.parameters.len());
    let covariance = &uncertainty.covariance.matrix;
    if end.jacobian.len() != m * n || covariance.nrows() != n {
        return f64::INFINITY;
    }
    let columns = end.jacobian.chunks_exact(m.max(1));
    let along = |column: &[f64]| column.iter().zip(&end.residuals).map(|(j, r)| j * r).sum();
    let gradient = DVector::from_iterator(n, columns.map(along));
    gradient.dot(&(covariance * &gradient))
}

/// Lists stated values that the data contradict, as messages.
fn denied(e: &Estimate<'_>) -> Vec<String> {
    // If the model error is large, a fitted index absorbs it and says nothing about the material.
    let loud = e.discrepancy > LOUD;
    let material = |d: &Denial| !d.by_user && matches!(d.quantity, Quantity::Eta | Quantity::K);
    let denials = denials(e).into_iter().filter(|d| !(loud && material(d)));
    let messages = denials.map(|denial| {
        let Denial {
            quantity,
            prior,
            by_user,
            deviations,
            leverage,
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

/// Whether ridge angle or roughness is practically undetermined, which is equivalent to a null direction.
fn shape_unknown(e: &Estimate<'_>, u: &Uncertainty) -> bool {
    e.problem.free().iter().enumerate().any(|(j, q)| {
        let limit = match q {
            Quantity::ThetaR => HOPELESS_ANGLE,
            Quantity::AlphaU | Quantity::AlphaV => HOPELESS_LOG_ALPHA,
            _ => return false,
        };
        let std = u.budgets[j].combined();
        std.is_nan() || std >= limit
    })
}

pub(super) fn summary(
    e: &Estimate<'_>,
    variant: VariantName,
    status: Status,
    qaic: f64,
) -> VariantSummary {
    let values = e.values.folded();
    let free = |q| e.problem.free().contains(&q);
    VariantSummary {
        variant,
        status,
        rms_residual: e.rms_residual,
        chi2_reduced_without_model: e.chi2_reduced_without_model,
        qaic,
        theta_r_deg: Some(values.theta_r.to_degrees()),
        alpha_u: Some(values.alpha_u),
        alpha_v: Some(values.alpha_v),
        rho_d: (free(Quantity::RhoD) && e.problem.set().white_reference.is_some())
            .then_some(values.rho_d),
    }
}

/// Reports on one fitted variant without comparing others.
#[must_use]
pub fn report_of(e: &Estimate<'_>, variant: VariantName) -> FitReport {
    report_with(e, &uncertainty(e), variant)
}

pub(super) fn report_with(e: &Estimate<'_>, u: &Uncertainty, variant: VariantName) -> FitReport {
    let set = e.problem.set();
    let status = status(e, u);
    let mut warnings = set.warnings.clone();
    let parameters = parameters(e, u, variant);
    for direction in &u.covariance.null_directions {
        let names: Vec<&str> = tied(e.problem.free(), direction)
            .into_iter()
            .map(spoken)
            .collect();
        warnings.push(format!(
            "These data cannot separate {}. Hold one of them, state a prior, or measure more poses.",
            names.join(", ")
        ));
    }
    if !e.explained {
        warnings.push(
            "The residuals exceed noise and model error; possibly no start found the lobe. Check the residuals, and \
             measure more poses around the bright spot or allow more starts."
                .to_owned(),
        );
    }
    if e.discrepancy > LOUD && variant != VariantName::Paper {
        let way_out = match variant {
            VariantName::Traced => "a check of the residuals and of the traced shape",
            _ => "--variant traced or a check of the residuals",
        };
        warnings.push(format!(
            "The model error is {:.1} % of the signals, over three times that of ridges with one angle and roughness: \
             this is another surface or another minimum. Do not use the parameters before {way_out} confirms them.",
            100.0 * e.discrepancy
        ));
    }
    let observations = e.loss_weights.len();
    let unknown = e.discrepancy > 0.0 && few(misfit::freedom(observations, e.fitted));
    let few_poses = (unknown && variant == VariantName::Sawtooth).then(|| {
        format!(
            "{} for {} free parameters {FEW_POSES}. The budget line `model` contains its usual size on ridges. Measure \
             more azimuths or tilts to reduce it.",
            counted(observations, "observation"),
            e.fitted
        )
    });
    let light = e.loss_weights.iter().filter(|w| **w < 0.1).count();
    if light > 0 {
        warnings.push(format!(
            "{light} of {} observations are outliers: the loss gives them less than a tenth of their weight. Check \
             their frames.",
            e.loss_weights.len()
        ));
    }
    for rival in &e.rivals {
        let message = ambiguity(e, rival);
        // Different minima can give the same message.
        if !warnings.contains(&message) {
            warnings.push(message);
        }
    }
    let drift = drift(e);
    warnings.extend(drift.as_ref().map(Drift::message));
    warnings.extend(denied(e));
    warnings.extend(unfinished(e, u, status));
    for &j in &e.minimum.at_bound {
        warnings.push(format!(
            "{} is at a limit of its range. If its value is known, hold it or state a prior; otherwise check the residuals.",
            spoken(e.problem.free()[j])
        ));
    }
    if variant == VariantName::Paper
        && let Some(rho_d) = parameters.rho_d.value
        && !(0.0..=1.0).contains(&rho_d)
    {
        warnings.push(format!(
            "ρd = {rho_d:.3} is not between 0 and 1: the printed lobe does not describe this sample. Use --variant \
             sawtooth."
        ));
    }
    if set.white_reference.is_none() && !is_anchored(e) {
        warnings.push(no_reference(set, variant, &e.values));
    }
    let predicted = e.problem.predicted(&e.values);
    let listed: Vec<usize> = match &e.thinned {
        Some(thinned) => thinned.kept.clone(),
        None => (0..set.observations.len()).collect(),
    };
    let listed = listed.into_iter().map(|i| {
        let o = &set.observations[i];
        FittedObservation {
            theta_c_deg: o.pose.theta_c.deg_for_tables(),
            phi_s_deg: o.pose.phi_s.deg_for_tables(),
            signal: o.signal,
            sigma: o.sigma,
            fitted: predicted[i],
        }
    });
    let fitted = listed.collect();
    let peak = peak(set);
    let across = wedge::of_report(set, &parameters);
    let is_absolute = set.white_reference.is_some();
    let covariance =
        parameter_covariance::of(e.problem.free(), u, &e.values, &parameters, is_absolute);
    FitReport {
        variant,
        status,
        n_observations: set.observations.len(),
        n_frames_used: set.n_frames_used,
        region: set.region.clone(),
        reference_plane: wedge::plane(set),
        wedge_across: across,
        rms_residual: Some(e.rms_residual),
        model_discrepancy: Some(e.misfit.iter().copied().fold(0.0, f64::max) / peak),
        chi2_reduced: Some(u.covariance.chi2_reduced),
        chi2_reduced_without_model: Some(e.chi2_reduced_without_model),
        rejected_frames: set.rejected_frames.clone(),
        warnings,
        notes: few_poses.into_iter().collect(),
        findings: match variant {
            VariantName::Paper => Vec::new(),
            _ => findings::all(e, drift.as_ref(), across.as_ref()),
        },
        slope_distribution: (variant != VariantName::Paper)
            .then(|| slope_distribution(e, &parameters)),
        parameters,
        covariance: Some(covariance),
        variants: Vec::new(),
        left_out: all_left_out(e, variant),
        tracer: None,
        fitted,
        starts: Starts {
            tried: e.starts.tried,
            at_minimum: e.starts.at_minimum,
            elsewhere: e.starts.elsewhere,
            not_converged: e.starts.not_converged,
        },
        iterations: Vec::new(),
        freedom: freedom(u),
        timing_s: Timing::default(),
        program: program(),
        build: build(),
    }
}

/// Explains why a fit stalled.
fn unfinished(e: &Estimate<'_>, u: &Uncertainty, status: Status) -> Option<String> {
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

/// Returns the name of a parameter as users know it.
fn spoken(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::ThetaR => "θr",
        Quantity::AlphaU => "αu",
        Quantity::AlphaV => "αv",
        Quantity::RhoD => "ρd",
        Quantity::Scale => "gain g (scale)",
        Quantity::Background => "stray light",
        Quantity::AzimuthOffset => "azimuth offset",
        Quantity::TiltOffset => "tilt offset",
        Quantity::Eta => "index n",
        Quantity::K => "index k",
        Quantity::Translucency => "translucency τ",
        Quantity::Tail => "tail of the slope distribution",
        Quantity::CrestRadius => "crest radius",
    }
}

/// Whether the user states what a white reference would: the gain, or ρd itself.
fn is_anchored(e: &Estimate<'_>) -> bool {
    let with_prior = e.problem.stated().iter().map(|(q, _)| q);
    let mut stated = e.held.iter().chain(with_prior);
    stated.any(|q| matches!(q, Quantity::Scale | Quantity::RhoD))
}

fn no_reference(set: &ObservationSet, variant: VariantName, values: &Values) -> String {
    let half = set.rig.theta_l.deg() / 2.0;
    let freely = set.views.first().is_some_and(|views| views.len() == 1);
    let mut text = match freely {
        true => "g, ρd and η cannot be separated from relative values. Give the values on an absolute scale to fix the gain g.".to_owned(),
        false => format!(
            "g, ρd and η cannot be separated on this rig: the difference angle is {}° in every frame. Measure a white \
             reference to fix the gain g.",
            (half * 1e4).round() / 1e4
        ),
    };
    if variant != VariantName::Paper && matches!(set.material, Material::Dielectric { .. }) {
        text += &format!(
            " With the Fresnel peak of the {variant} variant as calibration, ρd would be {:.3}; this value depends on the \
             model and is not traceable.",
            values.rho_d
        );
    }
    text
}

fn parameters(e: &Estimate<'_>, u: &Uncertainty, variant: VariantName) -> Parameters {
    let set = e.problem.set();
    let values = e.values.folded();
    let absolute = set.white_reference.is_some();
    let metal = matches!(set.material, Material::Conductor { .. });
    let of = |q: Quantity| -> Parameter {
        let Some(j) = e.problem.free().iter().position(|f| *f == q) else {
            return match q {
                _ if e.held.contains(&q) => held(&values, q),
                Quantity::RhoD if metal => Parameter::unknown(
                    "a metal returns no light from below its surface, so it has no ρd",
                ),
                Quantity::RhoD => Parameter::unknown(no_reference(set, variant, &e.values)),
                _ => Parameter::unknown("not fitted"),
            };
        };
        let (value, hopeless) = match q {
            Quantity::ThetaR => (values.theta_r.to_degrees(), HOPELESS_ANGLE),
            Quantity::AzimuthOffset => (values.azimuth_offset.to_degrees(), HOPELESS_ANGLE),
            Quantity::TiltOffset => (values.tilt_offset.to_degrees(), HOPELESS_ANGLE),
            Quantity::AlphaU => (values.alpha_u, HOPELESS_LOG_ALPHA),
            Quantity::AlphaV => (values.alpha_v, HOPELESS_LOG_ALPHA),
            Quantity::RhoD if variant == VariantName::Paper => (values.rho_d, f64::INFINITY),
            Quantity::RhoD => (values.rho_d, HOPELESS_RHO_D),
            Quantity::Scale => (values.scale, f64::INFINITY),
            Quantity::Eta | Quantity::K => (values.inner(q), f64::INFINITY),
            Quantity::Translucency | Quantity::Tail | Quantity::CrestRadius => {
                (values.inner(q), HOPELESS_REAL)
            }
            Quantity::Background if absolute => (values.background / values.scale, f64::INFINITY),
            Quantity::Background => (values.background, f64::INFINITY),
        };
        if !u.covariance.identifiable[j] {
            return Parameter::unknown(format!(
                "these data cannot separate {} from other parameters",
                spoken(q)
            ));
        }
        let inner = u.budgets[j];
        if !(value.is_finite() && inner.combined() < hopeless) {
            let beside_the_model = Budget {
                model: 0.0,
                shape: 0.0,
                ..inner
            };
            let poor = e.discrepancy > LOUD && beside_the_model.combined() < hopeless;
            let reason = if value.is_finite() && poor {
                "the variant does not describe this sample; its model error is too large to determine"
            } else {
                "these poses do not determine"
            };
            return Parameter::unknown(format!("{reason} {}", spoken(q)));
        }
        let factor = per_solver_unit(q, &values, absolute);
        Parameter::known(value, inner.scaled(factor), effective_freedom(&inner, u))
    };
    let mut rho_d = of(Quantity::RhoD);
    if !absolute && !metal && !is_anchored(e) {
        rho_d = Parameter::unknown(no_reference(set, variant, &e.values));
    }
    let there = |q: Quantity| {
        e.problem.is_extended() && (e.problem.free().contains(&q) || e.held.contains(&q))
    };
    Parameters {
        theta_r_deg: of(Quantity::ThetaR),
        alpha_u: of(Quantity::AlphaU),
        alpha_v: of(Quantity::AlphaV),
        rho_d,
        scale: scale(e, variant, of(Quantity::Scale)),
        background: of(Quantity::Background),
        azimuth_offset_deg: of(Quantity::AzimuthOffset),
        tilt_offset_deg: of(Quantity::TiltOffset),
        translucency: there(Quantity::Translucency).then(|| of(Quantity::Translucency)),
        crest_radius: there(Quantity::CrestRadius).then(|| of(Quantity::CrestRadius)),
    }
}

/// Describes the slope distribution of the facets.
fn slope_distribution(e: &Estimate<'_>, parameters: &Parameters) -> SlopeDistribution {
    let tail = e.values.real.tail;
    let ratio = half_width_over_alpha(tail);
    let half_width = |p: &Parameter| p.value.map(|alpha| alpha * ratio);
    let shape = gamma(tail).filter(|_| e.problem.is_extended());
    SlopeDistribution {
        name: match shape {
            Some(_) => "student-t".to_owned(),
            None => "beckmann".to_owned(),
        },
        shape,
        alpha_half_width_u: half_width(&parameters.alpha_u),
        alpha_half_width_v: half_width(&parameters.alpha_v),
    }
}

/// Reports a parameter that the user holds: its value, without an uncertainty.
fn held(values: &Values, quantity: Quantity) -> Parameter {
    let value = values.natural(quantity);
    Parameter {
        value: Some(match quantity {
            Quantity::ThetaR | Quantity::AzimuthOffset | Quantity::TiltOffset => value.to_degrees(),
            _ => value,
        }),
        ..Parameter::unknown("held at the stated value")
    }
}

fn scale(e: &Estimate<'_>, variant: VariantName, fitted: Parameter) -> Parameter {
    let set = e.problem.set();
    let stated = e
        .problem
        .stated()
        .iter()
        .any(|(q, _)| *q == Quantity::Scale);
    if stated || e.held.contains(&Quantity::Scale) {
        return fitted;
    }
    if set.white_reference.is_some() {
        let budget = Budget {
            reference: reference_std(set),
            drift: drift_std(set),
            ..Budget::default()
        };
        return Parameter {
            note: Some("fixed by the white reference".to_owned()),
            ..Parameter::known(1.0, budget, None)
        };
    }
    match variant {
        VariantName::Paper => Parameter::unknown(no_reference(set, variant, &e.values)),
        VariantName::Sawtooth | VariantName::Traced => Parameter {
            note: Some(
                "signal per radiance, calibrated by the Fresnel peak of the model; not traceable"
                    .to_owned(),
            ),
            ..fitted
        },
    }
}

/// Returns the degrees of freedom of the parts that come from scatter. If no groups could be left out, the model part
/// comes from the residuals too.
fn freedom(u: &Uncertainty) -> Freedom {
    let counting = u.covariance.degrees_of_freedom.max(1) as f64;
    Freedom {
        counting,
        model: if u.model_freedom.is_finite() {
            u.model_freedom.max(1.0)
        } else {
            counting
        },
    }
}

/// Effective degrees of freedom by Welch–Satterthwaite. Apart from the residuals only the model part has few degrees of
/// freedom. None from 1000 on.
fn effective_freedom(budget: &Budget, u: &Uncertainty) -> Option<f64> {
    let total = budget.combined().powi(4);
    let Freedom { counting, model } = freedom(u);
    let parts = budget.model.powi(4) / model + budget.counting.powi(4) / counting;
    let freedom = total / parts;
    (freedom.is_finite() && freedom < 1000.0).then_some(freedom)
}

fn all_left_out(e: &Estimate<'_>, variant: VariantName) -> Vec<LeftOut> {
    let cones = &e.problem.set().rig.cones;
    let narrow = e.values.alpha_u.min(e.values.alpha_v);
    let mut list: Vec<LeftOut> = left_out::lens(cones).into_iter().collect();
    if variant != VariantName::Traced && !(variant == VariantName::Sawtooth && e.takes_tier()) {
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
            if let Some(cost) = e.tier_left_out {
                list.push(LeftOut::new(
                    "two-bounce quadrature",
                    "it changes less than the tolerance at poses spread over the data",
                    Some(cost),
                ));
            } else if !e.takes_tier() {
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
    ];
    names
        .into_iter()
        .filter(|(q, _)| !there(q) && (body || *q != Quantity::Translucency))
        .map(|(_, what)| left_out::real_term(what, e.rms_residual, e.investigated))
        .collect()
}

/// Whether the second reflection depends on the polarisation caused by the first. For metals the closed form includes
/// it, too.
fn polarisation(e: &Estimate<'_>, variant: VariantName) -> Option<LeftOut> {
    let metal = matches!(e.problem.set().material, Material::Conductor { .. });
    let followed = match variant {
        // It has no second reflection.
        VariantName::Paper => true,
        VariantName::Sawtooth => metal || (e.takes_tier() && e.problem.is_polarised()),
        VariantName::Traced => e.traced.as_ref().is_none_or(|t| t.polarised),
    };
    let by_data = e.takes_tier() || variant == VariantName::Traced;
    (!followed).then(|| {
        left_out::polarisation(if by_data {
            "the unpolarised model fits these data better"
        } else {
            "lamp and camera do not polarise, so single reflections do not depend on it; the closed form omits it for \
             double reflections on plastic"
        })
    })
}
