//! All variants on one set of observations, the choice between them, and the report.
//!
//! The choice follows QAIC: with counting errors alone every χ² is in the thousands and the plain
//! criterion takes the largest model, so χ² is divided by ĉ, the reduced χ² of the richest variant
//! (at least 1), and another variant is taken only for a clear gain.

use std::sync::atomic::{AtomicBool, Ordering};

use super::budget::{Budget, Uncertainty, judged, tied, uncertainty};
use super::estimate::{Estimate, LOUD, Tier, estimate, free_quantities, peak};
use super::intervals;
use super::problem::{Quantity, Values, drift_std, reference_std};
use super::report::{
    FitReport, FittedObservation, Freedom, LeftOut, Parameter, Parameters, Starts, Status, Timing,
    TracerReport, VariantName, VariantSummary,
};
use super::solver::Minimum;
use super::thin;
use super::traced::{Watch, estimate_traced};
use super::trail::{Time, retrace};
use super::{FitOptions, VariantChoice};
use crate::material::Material;
use crate::model::{Variant, left_out};
use crate::observation::ObservationSet;
use crate::trace::profile::Profile;

/// Gain in QAIC that counts as clear.
const CLEAR_GAIN: f64 = 10.0;
/// ĉ above which no variant may be called adequate.
const INADEQUATE: f64 = 4.0;
/// Standard uncertainty beyond which an angle is as good as unknown, rad.
const HOPELESS_ANGLE: f64 = 0.35;
/// The same for the logarithm of a roughness.
const HOPELESS_LOG_ALPHA: f64 = 1.0;
/// The same for the diffuse reflectance.
const HOPELESS_RHO_D: f64 = 0.5;

/// What the ray tracer is told beside the options.
pub struct Tracer<'t> {
    /// The shape to trace on; the ideal sawtooth if not given.
    pub profile: Option<&'t Profile>,
    /// Sees how it gets on, and may end it.
    pub watch: Watch<'t>,
    /// The caller's clock, where there is one.
    pub time: Option<Time<'t>>,
}

impl Tracer<'static> {
    /// On the ideal sawtooth, to its own end.
    pub const UNTOLD: Self = Tracer {
        profile: None,
        watch: &|_| true,
        time: None,
    };
}

impl Tracer<'_> {
    /// What the report says of a tracing.
    fn report(&self, e: &Estimate<'_>) -> Option<TracerReport> {
        let done = e.traced.as_ref()?;
        let profile = self.profile.and_then(Profile::effective_ridge_angle);
        Some(TracerReport {
            passes: done.passes,
            paths_per_pose: done.paths,
            error: done.error,
            polarised: done.polarised,
            end: done.end,
            profile_theta_r_deg: profile.map(f64::to_degrees),
        })
    }
}

/// Fits every variant and reports the one asked for, or the best; the ray tracer is told nothing.
#[must_use]
pub fn fit_with_tier(
    set: &ObservationSet,
    options: &FitOptions,
    tier: Option<Tier<'_>>,
    cancel: &AtomicBool,
) -> FitReport {
    fit_with_tracer(set, options, tier, &Tracer::UNTOLD, cancel)
}

/// Fits every variant and reports the one asked for, or the best.
#[must_use]
pub fn fit_with_tracer(
    set: &ObservationSet,
    options: &FitOptions,
    tier: Option<Tier<'_>>,
    tracer: &Tracer<'_>,
    cancel: &AtomicBool,
) -> FitReport {
    if let Some(status) = refusal(set) {
        return empty(set, options, status);
    }
    let merged = thin::merged(set, options.loss);
    let all = merged.as_ref().map_or(set, |m| &m.set);
    // The ray tracer looks at every pose for itself, so it gets no more than stand for all.
    let asked = options.variant == VariantChoice::Traced || options.judge;
    let kept = thin::representative(all).filter(|_| asked);
    let few = kept.map(|kept| thin::subset(all, &kept));
    let mut report = fit_each(few.as_ref().unwrap_or(all), options, tier, tracer, cancel);
    if let Some(few) = few {
        let (kept, of) = (few.observations.len(), all.observations.len());
        report.left_out.push(LeftOut::new(
            format!("{} of {of} observations", of - kept),
            "the ray tracer works pose by pose; those that are kept are spread over the poses, with the \
             brightest of each neighbourhood. The counting noise is theirs alone",
            None,
        ));
    }
    if let Some(merged) = merged {
        let poses = merged.set.observations.len();
        report.left_out.push(LeftOut::new(
            "repeats of a pose one by one",
            format!(
                "{} observations at {poses} poses: least squares see the weighted mean of repeats; what \
                 they scatter is in chi-square",
                merged.observations
            ),
            Some(0.0),
        ));
        let (chi2, freedom) = merged.within;
        let counting = report.freedom.counting;
        for reduced in [
            &mut report.chi2_reduced,
            &mut report.chi2_reduced_without_model,
        ] {
            *reduced = (*reduced * counting + chi2) / (counting + freedom).max(1.0);
        }
        report.freedom.counting += freedom;
        report.n_observations = merged.observations;
    }
    report
}

/// [`fit_with_tracer`] of a set that can be fitted at all.
fn fit_each(
    set: &ObservationSet,
    options: &FitOptions,
    tier: Option<Tier<'_>>,
    tracer: &Tracer<'_>,
    cancel: &AtomicBool,
) -> FitReport {
    let run = |variant: Variant| {
        let tier = tier.filter(|_| variant == Variant::Sawtooth);
        estimate(set, variant, options, tier, cancel)
    };
    let (paper, sawtooth) = (run(Variant::Paper), run(Variant::Sawtooth));
    let asked = options.variant == VariantChoice::Traced || options.judge;
    let traced = sawtooth.as_ref().filter(|_| asked);
    let traced =
        traced.and_then(|s| estimate_traced(s, options, tracer.profile, tracer.watch, cancel));
    if cancel.load(Ordering::Relaxed) {
        return empty(set, options, Status::Cancelled);
    }
    let fitted = [
        (VariantName::Paper, &paper),
        (VariantName::Sawtooth, &sawtooth),
        (VariantName::Traced, &traced),
    ];
    let dispersion = traced
        .as_ref()
        .or(sawtooth.as_ref())
        .map_or(1.0, |e| e.chi2_reduced_without_model.max(1.0));
    let criterion = |e: &Option<Estimate<'_>>| {
        e.as_ref().map_or(f64::INFINITY, |e| {
            let n = e.fitted;
            let freedom = set.observations.len().saturating_sub(n).max(1) as f64;
            e.chi2_reduced_without_model * freedom / dispersion + 2.0 * n as f64
        })
    };
    let chosen = match options.variant {
        VariantChoice::Paper => VariantName::Paper,
        VariantChoice::Sawtooth => VariantName::Sawtooth,
        VariantChoice::Traced => VariantName::Traced,
        VariantChoice::Auto if criterion(&paper) + CLEAR_GAIN < criterion(&sawtooth) => {
            VariantName::Paper
        }
        VariantChoice::Auto => VariantName::Sawtooth,
    };
    let main = match chosen {
        VariantName::Paper => &paper,
        VariantName::Sawtooth => &sawtooth,
        VariantName::Traced => &traced,
    };
    let Some(main) = main else {
        let untraced = chosen == VariantName::Traced && sawtooth.is_some();
        let status = if untraced {
            Status::Stalled
        } else {
            Status::NotFinite
        };
        return empty(set, options, status);
    };
    let judge = traced
        .as_ref()
        .filter(|_| chosen != VariantName::Traced && options.judge);
    let u = match judge {
        Some(traced) => judged(main, traced),
        None => uncertainty(main),
    };
    let mut report = report_with(main, &u, chosen);
    report.tracer = traced.as_ref().and_then(|e| tracer.report(e));
    if options.judge && traced.is_none() {
        report.warnings.push(
            "the ray tracer came to no end: the model's line is what the residuals tell".to_owned(),
        );
    }
    if report.tracer.is_some_and(|t| !t.polarised) {
        report.warnings.push(
            "the data are explained better where light is not polarised between the facets, as a \
             renderer without polarisation makes them: so it was traced"
                .to_owned(),
        );
    }
    if options.profile || options.bootstrap > 0 {
        let enough = || tracer.time.is_some_and(|t| !t.allows());
        intervals::add(&mut report, main, &u, options, &enough, cancel);
    }
    if let Some(time) = tracer.time.filter(|t| t.retrace) {
        report.iterations = retrace(main, &u, options.seed, time, cancel);
    }
    for (name, each) in fitted {
        if let Some(e) = each {
            let status = if name == chosen {
                report.status
            } else {
                status(e, &uncertainty(e))
            };
            report
                .variants
                .push(summary(e, name, status, criterion(each)));
        }
    }
    if let (Some(paper), Some(sawtooth)) = (&paper, &sawtooth) {
        report.warnings.extend(comparison(paper, sawtooth));
    }
    if dispersion > INADEQUATE {
        let name = if traced.is_some() {
            "traced"
        } else {
            "sawtooth"
        };
        report.warnings.push(format!(
            "no variant explains the data to their counting noise (reduced chi-square {dispersion:.3} \
             for {name}); what the model misses is in the uncertainties as `model`"
        ));
    }
    report
}

fn comparison(paper: &Estimate<'_>, sawtooth: &Estimate<'_>) -> Option<String> {
    let ratio = paper.rms_residual / sawtooth.rms_residual;
    (ratio >= 1.5).then(|| {
        format!(
            "the variant paper leaves {ratio:.3} × the residual of sawtooth ({:.3} % against {:.3} % \
             of the largest observation, rms)",
            100.0 * paper.rms_residual,
            100.0 * sawtooth.rms_residual
        )
    })
}

/// Why a set cannot be fitted at all.
fn refusal(set: &ObservationSet) -> Option<Status> {
    let finite = |v: f64| v.is_finite();
    let samples = set.observations.iter().all(|o| {
        finite(o.signal)
            && finite(o.sigma)
            && o.sigma > 0.0
            && o.pose.theta_c.is_finite()
            && o.pose.phi_s.is_finite()
    });
    let flats = set
        .flats
        .iter()
        .all(|f| finite(f.signal) && finite(f.sigma) && f.sigma > 0.0 && f.theta_c.is_finite());
    let prior = finite(set.background.mean) && set.background.std > 0.0;
    if !(samples && flats && prior) {
        return Some(Status::NotFinite);
    }
    // The offsets and the stray light have help from flats and prior, the surface has none.
    let needed = free_quantities(set, Variant::Sawtooth).0.len() + 1;
    (set.observations.len() < needed).then_some(Status::TooFewObservations)
}

/// Why a set cannot be fitted at all, in words.
pub(super) fn refused(set: &ObservationSet, options: &FitOptions) -> Option<String> {
    let status = refusal(set)?;
    empty(set, options, status).warnings.pop()
}

/// A report without numbers.
fn empty(set: &ObservationSet, options: &FitOptions, status: Status) -> FitReport {
    let reason = match status {
        Status::TooFewObservations => format!(
            "{} observations are fewer than the free parameters and one; take more poses",
            set.observations.len()
        ),
        Status::NotFinite => {
            "an observation, its uncertainty or the model's value for it is not a \
                              finite number; look at the reduction"
                .to_owned()
        }
        Status::Cancelled => "stopped before the fit was done".to_owned(),
        Status::Stalled if options.variant == VariantChoice::Traced => {
            "the ray tracer did not finish its first pass; allow it more time".to_owned()
        }
        _ => "no minimum was reached".to_owned(),
    };
    let none = || Parameter::unknown(reason.clone());
    let mut warnings = set.warnings.clone();
    warnings.push(reason.clone());
    FitReport {
        variant: match options.variant {
            VariantChoice::Paper => VariantName::Paper,
            VariantChoice::Sawtooth | VariantChoice::Auto => VariantName::Sawtooth,
            VariantChoice::Traced => VariantName::Traced,
        },
        status,
        n_observations: set.observations.len(),
        n_frames_used: set.n_frames_used,
        region: set.region.clone(),
        parameters: Parameters {
            theta_r_deg: none(),
            alpha_u: none(),
            alpha_v: none(),
            rho_d: none(),
            scale: none(),
            background: none(),
            azimuth_offset_deg: none(),
            tilt_offset_deg: none(),
        },
        rms_residual: 0.0,
        model_discrepancy: 0.0,
        chi2_reduced: 0.0,
        chi2_reduced_without_model: 0.0,
        rejected_frames: set.rejected_frames.clone(),
        warnings,
        variants: Vec::new(),
        left_out: Vec::new(),
        tracer: None,
        fitted: Vec::new(),
        starts: Starts::default(),
        iterations: Vec::new(),
        freedom: Freedom::default(),
        timing_s: Timing::default(),
        program: program(),
    }
}

fn program() -> String {
    concat!("ridged ", env!("CARGO_PKG_VERSION")).to_owned()
}

fn status(e: &Estimate<'_>, uncertainty: &Uncertainty) -> Status {
    use super::solver::Ending;
    match e.minimum.ending {
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

/// Whether ridge angle or roughness is as good as unknown: an open direction by any other name.
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

/// The report on one fitted variant, the others not compared.
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
        warnings.push(format!("the data cannot tell apart: {}", names.join(", ")));
    }
    if !e.explained {
        warnings.push(
            "the fit leaves more than noise and the model's misfit account for: no start may have found \
             the lobe; look at the residuals, take more poses around the bright spot or more starts"
                .to_owned(),
        );
    }
    if e.discrepancy > LOUD && variant != VariantName::Paper {
        warnings.push(format!(
            "the model misses the data by {:.1} % of the signals: ridges of one angle and roughness are \
             described three times better, so this is another surface or another minimum; do not \
             trust the parameters before --variant traced or a look at the residuals confirms them",
            100.0 * e.discrepancy
        ));
    }
    let light = e.loss_weights.iter().filter(|w| **w < 0.1).count();
    if light > 0 {
        warnings.push(format!(
            "{light} of {} observations are outliers: the loss leaves them less than a tenth of \
             their weight",
            e.loss_weights.len()
        ));
    }
    for rival in &e.rivals {
        warnings.push(ambiguity(e, rival));
    }
    for &j in &e.minimum.at_bound {
        warnings.push(format!(
            "{} stands at the end of its range",
            spoken(e.problem.free()[j])
        ));
    }
    if variant == VariantName::Paper
        && let Some(rho_d) = parameters.rho_d.value
        && !(0.0..=1.0).contains(&rho_d)
    {
        warnings.push(format!(
            "ρd = {rho_d:.3} is no reflectance: the printed lobe does not describe this sample"
        ));
    }
    if set.white_reference.is_none() {
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
    FitReport {
        variant,
        status,
        n_observations: set.observations.len(),
        n_frames_used: set.n_frames_used,
        region: set.region.clone(),
        parameters,
        rms_residual: e.rms_residual,
        model_discrepancy: e.misfit.iter().copied().fold(0.0, f64::max) / peak,
        chi2_reduced: u.covariance.chi2_reduced,
        chi2_reduced_without_model: e.chi2_reduced_without_model,
        rejected_frames: set.rejected_frames.clone(),
        warnings,
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
    }
}

/// Tells of a minimum that the data do not exclude.
fn ambiguity(e: &Estimate<'_>, rival: &Minimum) -> String {
    let v = e.problem.unpack(&rival.parameters).folded();
    format!(
        "another surface fits as well (χ² higher by {:.2}): θr {:.2}°, αu {:.4}, αv {:.4}, azimuth \
         offset {:.2}°; the uncertainties cover both, more azimuths would tell them apart",
        (rival.cost - e.minimum.cost).max(0.0),
        v.theta_r.to_degrees(),
        v.alpha_u,
        v.alpha_v,
        v.azimuth_offset.to_degrees()
    )
}

/// The parameter's name as a person says it.
fn spoken(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::ThetaR => "θr",
        Quantity::AlphaU => "αu",
        Quantity::AlphaV => "αv",
        Quantity::RhoD => "ρd",
        Quantity::Scale => "scale k",
        Quantity::Background => "stray light",
        Quantity::AzimuthOffset => "azimuth offset",
        Quantity::TiltOffset => "tilt offset",
        Quantity::Eta => "index n",
        Quantity::K => "index k",
    }
}

fn no_reference(set: &ObservationSet, variant: VariantName, values: &Values) -> String {
    let half = set.rig.theta_l.deg() / 2.0;
    let mut text = format!(
        "k, ρd and η cannot be told apart on this rig: the difference angle is {}° in every frame; a \
         white reference fixes k",
        (half * 1e4).round() / 1e4
    );
    if variant != VariantName::Paper && matches!(set.material, Material::Dielectric { .. }) {
        text += &format!(
            " (if the Fresnel peak of the {variant} variant is taken as calibration, ρd reads {:.3}: \
             that hangs on the model and is not traceable)",
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
                    "a metal sends no light back from below its surface: there is no ρd to measure",
                ),
                Quantity::RhoD => Parameter::unknown(no_reference(set, variant, &e.values)),
                _ => Parameter::unknown("not fitted"),
            };
        };
        // From the solver's units to those of the report.
        let (value, factor, hopeless) = match q {
            Quantity::ThetaR => {
                let deg = 1f64.to_degrees();
                (values.theta_r.to_degrees(), deg, HOPELESS_ANGLE)
            }
            Quantity::AzimuthOffset => (
                values.azimuth_offset.to_degrees(),
                1f64.to_degrees(),
                HOPELESS_ANGLE,
            ),
            Quantity::TiltOffset => (
                values.tilt_offset.to_degrees(),
                1f64.to_degrees(),
                HOPELESS_ANGLE,
            ),
            Quantity::AlphaU => (values.alpha_u, values.alpha_u, HOPELESS_LOG_ALPHA),
            Quantity::AlphaV => (values.alpha_v, values.alpha_v, HOPELESS_LOG_ALPHA),
            Quantity::RhoD if variant == VariantName::Paper => (values.rho_d, 1.0, f64::INFINITY),
            Quantity::RhoD => (values.rho_d, 1.0, HOPELESS_RHO_D),
            Quantity::Scale => (values.scale, 1.0, f64::INFINITY),
            Quantity::Eta | Quantity::K => (values.inner(q), 1.0, f64::INFINITY),
            Quantity::Background if absolute => (
                values.background / values.scale,
                1.0 / values.scale,
                f64::INFINITY,
            ),
            Quantity::Background => (values.background, 1.0, f64::INFINITY),
        };
        if !u.covariance.identifiable[j] {
            return Parameter::unknown(format!(
                "{} takes part in a direction that the data leave open",
                spoken(q)
            ));
        }
        let inner = u.budgets[j];
        if !(value.is_finite() && inner.combined() < hopeless) {
            return Parameter::unknown(format!("these poses do not determine {}", spoken(q)));
        }
        Parameter::known(value, inner.scaled(factor), effective_freedom(&inner, u))
    };
    let mut rho_d = of(Quantity::RhoD);
    if !absolute && !metal && !e.held.contains(&Quantity::RhoD) {
        rho_d = Parameter::unknown(no_reference(set, variant, &e.values));
    }
    Parameters {
        theta_r_deg: of(Quantity::ThetaR),
        alpha_u: of(Quantity::AlphaU),
        alpha_v: of(Quantity::AlphaV),
        rho_d,
        scale: scale(e, variant, of(Quantity::Scale)),
        background: of(Quantity::Background),
        azimuth_offset_deg: of(Quantity::AzimuthOffset),
        tilt_offset_deg: of(Quantity::TiltOffset),
    }
}

/// A parameter that the user holds: its value, and no uncertainty that the data could give it.
fn held(values: &Values, quantity: Quantity) -> Parameter {
    let value = values.natural(quantity);
    Parameter {
        value: Some(match quantity {
            Quantity::ThetaR | Quantity::AzimuthOffset | Quantity::TiltOffset => value.to_degrees(),
            _ => value,
        }),
        ..Parameter::unknown("held at this value as told")
    }
}

fn scale(e: &Estimate<'_>, variant: VariantName, fitted: Parameter) -> Parameter {
    let set = e.problem.set();
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
                "signal per radiance; hangs on the model's Fresnel peak, not traceable".to_owned(),
            ),
            ..fitted
        },
    }
}

/// Of the parts that come from scatter. Where no groups could be left out, the model's part comes
/// from the residuals too.
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

/// Welch–Satterthwaite with the model's part as the only one of few degrees of freedom beside the
/// residuals; null from a thousand on.
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
    if variant != VariantName::Traced {
        list.push(left_out::ideal_profile());
    }
    match variant {
        VariantName::Traced => list.push(LeftOut::new(
            "bounces among the facets' own roughness",
            "below the profile light meets one microfacet per hit, with Smith's masking",
            None,
        )),
        VariantName::Paper => list.push(left_out::printed_lobe(Some(e.rms_residual))),
        VariantName::Sawtooth => {
            if let Some(cost) = e.tier_left_out {
                list.push(LeftOut::new(
                    "two-bounce quadrature",
                    "at poses spread over the data it changes less than the tolerance",
                    Some(cost),
                ));
            } else if !e.takes_tier() {
                list.push(LeftOut::new(
                    "two-bounce quadrature",
                    "the closed form describes these data better than with its second bounce \
                     integrated",
                    Some(e.rms_residual),
                ));
            }
            list.push(left_out::third_bounce());
        }
    }
    if let Some(thinned) = &e.thinned {
        let (kept, of) = (thinned.kept.len(), e.problem.set().observations.len());
        list.push(LeftOut::new(
            format!("{} of {of} observations while looking for the minimum, and in `fitted`", of - kept),
            "the others are spread over the poses, with the brightest of each neighbourhood; descent, \
             weights and uncertainties are of all. A minimum that only the rest shows would be missed",
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
