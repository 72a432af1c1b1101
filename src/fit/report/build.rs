//! Turns an estimate into the report: status, parameters with their budgets, warnings, and what was left out.
//!
//! Call [`report_of`], or [`report_with`] if the uncertainties are known already. [`crate::fit::model_selection`] compares the
//! variants and selects the one to report.

pub(in crate::fit) mod causes;
mod contradictions;
mod conventions;
mod doubts;
mod omissions;
mod rig_slips;
mod status;

use super::{
    FEW_POSES, FitReport, FittedObservation, Freedom, Parameter, Parameters, SlopeDistribution,
    Starts, Status, Timing, VariantName, VariantSummary,
};
use crate::fit::causes::findings::Finding;
use crate::fit::causes::lamp_drift::{Drift, drift};
use crate::fit::causes::wedge;
use crate::fit::estimate::Estimate;
use crate::fit::known::{drift_std, reference_std};
use crate::fit::model_discrepancy;
use crate::fit::model_discrepancy::{LOUD, few, peak};
use crate::fit::problem::{Quantity, Values};
use crate::fit::uncertainty::budget::{Budget, Uncertainty, tied, uncertainty};
use crate::fit::uncertainty::parameter_covariance;
use crate::fit::uncertainty::parameter_covariance::per_solver_unit;
use crate::material::Material;
use crate::model::extended::slopes::{gamma, half_width_over_alpha};
use crate::observation::ObservationSet;
use crate::wording::counted;
use contradictions::denied;
use conventions::other_convention;
use doubts::{ambiguous, darkness, unexplained, unfinished};
use rig_slips::{rig_slips, steeper_than_stated};
pub(in crate::fit) use status::status;

/// Standard uncertainty above which an angle counts as undetermined, rad.
const HOPELESS_ANGLE: f64 = 0.35;
/// The same for the logarithm of a roughness.
const HOPELESS_LOG_ALPHA: f64 = 1.0;
/// The same for translucency, tail, crest radius and share of lands.
const HOPELESS_REAL: f64 = 0.5;
/// The same for the diffuse reflectance.
const HOPELESS_RHO_D: f64 = 0.5;

/// Name and version of the program with its commit.
pub(in crate::fit) fn build() -> String {
    concat!("ridged ", env!("RIDGED_VERSION")).to_owned()
}

/// Name and version of the program.
pub(in crate::fit) fn program() -> String {
    concat!("ridged ", env!("CARGO_PKG_VERSION")).to_owned()
}

pub(in crate::fit) fn summary(
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

pub(in crate::fit) fn report_with(
    e: &Estimate<'_>,
    u: &Uncertainty,
    variant: VariantName,
) -> FitReport {
    let set = e.problem.set();
    let parameters = parameters(e, u, variant);
    let causes = Causes::of(e, u, variant, &parameters);
    let is_absolute = set.white_reference.is_some();
    let covariance =
        parameter_covariance::of(e.problem.free(), u, &e.values, &parameters, is_absolute);
    FitReport {
        variant,
        status: status(e, u),
        n_observations: set.observations.len(),
        n_frames_used: set.n_frames_used,
        region: set.region.clone(),
        reference_plane: wedge::plane(set),
        wedge_across: causes.across,
        rms_residual: Some(e.rms_residual),
        model_discrepancy: Some(e.misfit.iter().copied().fold(0.0, f64::max) / peak(set)),
        chi2_reduced: Some(u.covariance.chi2_reduced),
        chi2_reduced_without_model: Some(e.chi2_reduced_without_model),
        rejected_frames: set.rejected_frames.clone(),
        warnings: warnings(e, u, variant, &parameters, &causes),
        notes: few_poses(e, variant).into_iter().collect(),
        findings: causes.findings,
        slope_distribution: (variant != VariantName::Paper)
            .then(|| slope_distribution(e, &parameters)),
        parameters,
        covariance: Some(covariance),
        variants: Vec::new(),
        left_out: omissions::all_left_out(e, variant),
        tracer: None,
        fitted: fitted_observations(e),
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

/// What explains the differences between the data and the model.
struct Causes {
    drift: Option<Drift>,
    across: Option<wedge::Across>,
    findings: Vec<Finding>,
}

impl Causes {
    fn of(
        e: &Estimate<'_>,
        u: &Uncertainty,
        variant: VariantName,
        parameters: &Parameters,
    ) -> Self {
        let drift = drift(e);
        let across = causes::across(e, u, parameters);
        let findings = match variant {
            VariantName::Paper => Vec::new(),
            _ => causes::all(e, drift.as_ref(), across.as_ref()),
        };
        Causes {
            drift,
            across,
            findings,
        }
    }
}

/// Returns the warnings: of the reduction, of the model, of the rig, of the search, of single parameters.
fn warnings(
    e: &Estimate<'_>,
    u: &Uncertainty,
    variant: VariantName,
    parameters: &Parameters,
    causes: &Causes,
) -> Vec<String> {
    let set = e.problem.set();
    let mut warnings = set.warnings.clone();
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
        warnings.push(unexplained(&causes.findings, set.is_of_near_rig()));
    }
    if e.discrepancy > LOUD && variant != VariantName::Paper {
        warnings.extend(other_convention(set));
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
    let light = e.loss_weights.iter().filter(|w| **w < 0.1).count();
    if light > 0 {
        warnings.push(format!(
            "{light} of {} observations are outliers: the loss gives them less than a tenth of their weight. Check \
             their frames.",
            e.loss_weights.len()
        ));
    }
    warnings.extend(ambiguous(e));
    warnings.extend(causes.drift.as_ref().map(Drift::message));
    warnings.extend(denied(e, u));
    warnings.extend(rig_slips(e, u));
    let across = causes.across.as_ref();
    warnings.extend(across.and_then(|across| steeper_than_stated(set, across)));
    warnings.extend(unfinished(e, u, status(e, u)));
    // Without a lobe, limits of its shape mean nothing.
    let of_lobe = |q: Quantity| matches!(q, Quantity::AlphaU | Quantity::AlphaV);
    let free = e.problem.free();
    let at_bound = e.minimum.at_bound.iter().copied();
    for j in at_bound.filter(|j| e.no_lobe.is_none() || !of_lobe(free[*j])) {
        warnings.push(format!(
            "{} is at a limit of its range. If its value is known, hold it or state a prior; otherwise check the residuals.",
            spoken(free[j])
        ));
    }
    warnings.extend(e.no_lobe.as_ref().map(|dark| darkness(e, dark)));
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
    warnings
}

/// Notes that there are too few poses to determine the model error.
fn few_poses(e: &Estimate<'_>, variant: VariantName) -> Option<String> {
    let observations = e.loss_weights.len();
    let unknown = e.discrepancy > 0.0 && few(model_discrepancy::freedom(observations, e.fitted));
    (unknown && variant == VariantName::Sawtooth).then(|| {
        format!(
            "{} for {} free parameters {FEW_POSES}. The budget line `model` contains its usual size on ridges. Measure \
             more azimuths or tilts to reduce it.",
            counted(observations, "observation"),
            e.fitted
        )
    })
}

/// Lists the observations that the fit used, each with the fitted signal.
fn fitted_observations(e: &Estimate<'_>) -> Vec<FittedObservation> {
    let observations = &e.problem.set().observations;
    let predicted = e.problem.predicted(&e.values);
    let listed: Vec<usize> = match &e.thinned {
        Some(thinned) => thinned.kept.clone(),
        None => (0..observations.len()).collect(),
    };
    let listed = listed.into_iter().map(|i| {
        let o = &observations[i];
        FittedObservation {
            theta_c_deg: o.pose.theta_c.deg_for_tables(),
            phi_s_deg: o.pose.phi_s.deg_for_tables(),
            signal: o.signal,
            sigma: o.sigma,
            fitted: predicted[i],
        }
    });
    listed.collect()
}

/// Returns the name of a parameter as users know it.
pub(in crate::fit) fn spoken(quantity: Quantity) -> &'static str {
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
        Quantity::Land => "share of flat lands",
        Quantity::Wedge => "wedge of the sample",
        Quantity::LampTurn => "azimuth of the lamp",
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
    let mut text = match set.is_of_goniometer() {
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
        let Some(j) = e.problem.column(q) else {
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
            Quantity::Translucency | Quantity::Tail | Quantity::CrestRadius | Quantity::Land => {
                (values.inner(q), HOPELESS_REAL)
            }
            Quantity::Wedge | Quantity::LampTurn => (values.inner(q).to_degrees(), HOPELESS_ANGLE),
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
        land_share: there(Quantity::Land).then(|| of(Quantity::Land)),
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
