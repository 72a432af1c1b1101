//! All variants on one set of observations, and the choice between them.
//!
//! The choice follows QAIC: with counting errors alone every χ² is in the thousands and the plain
//! criterion takes the largest model, so χ² is divided by ĉ, the reduced χ² of the variant that explains
//! the data best (at least 1), and another variant is taken only for a clear gain.

use std::sync::atomic::{AtomicBool, Ordering};

use super::budget::{judged, uncertainty};
use super::drift::{drift, without};
use super::estimate::{Estimate, Tier, estimate_until, free_quantities};
use super::intervals;
use super::report::{
    FitReport, Freedom, LeftOut, Parameter, Parameters, Starts, Status, Timing, TracerReport,
    VariantName,
};
use super::reporting::{program, report_with, status, summary};
use super::suspects::investigated;
use super::traced::{Watch, estimate_traced};
use super::trail::{Time, retrace};
use super::{FitOptions, VariantChoice};
use super::{thin, wedge};
use crate::model::Variant;
use crate::observation::ObservationSet;
use crate::trace::profile::Profile;
use crate::wording::counted;

/// Gain in QAIC that counts as clear.
const CLEAR_GAIN: f64 = 10.0;
/// ĉ above which no variant may be called adequate.
const INADEQUATE: f64 = 4.0;

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
            profile_turned: self.profile.is_some_and(Profile::is_turned),
            height_map: None,
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
        let reduced = [
            &mut report.chi2_reduced,
            &mut report.chi2_reduced_without_model,
        ];
        for reduced in reduced.into_iter().flatten() {
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
        let late = || tracer.time.is_some_and(|time| !time.allows());
        estimate_until(set, variant, options, tier, &late, cancel)
    };
    let (paper, ideal) = (run(Variant::Paper), run(Variant::Sawtooth));
    let enough = tracer.time.is_some_and(|time| !time.allows());
    let sawtooth = match &ideal {
        Some(ideal) if !enough => Some(investigated(ideal.clone(), options, tier, cancel)),
        _ => ideal.clone(),
    };
    if set.lamp.is_none()
        && let Some(drift) = sawtooth.as_ref().and_then(drift)
        && !(enough || cancel.load(Ordering::Relaxed))
        && let Some(steady) = without(set, drift.lamp)
    {
        // All of it again, on what a steady lamp would have shown.
        return fit_each(&steady, options, tier, tracer, cancel);
    }
    let asked = options.variant == VariantChoice::Traced || options.judge;
    // A measured profile has its own crests.
    let round = |s: &&Estimate<'_>| tracer.profile.is_some() && s.values.real.crest > 0.0;
    let traced = sawtooth.as_ref().filter(|_| asked);
    let traced = match traced {
        Some(s) if round(&s) => ideal.as_ref(),
        traced => traced,
    };
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
    // Of the best, not of the richest: where that explains nothing, its scatter would make all alike.
    let (best, dispersion) = fitted
        .iter()
        .filter_map(|(name, e)| Some((*name, e.as_ref()?.chi2_reduced_without_model)))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .map_or((VariantName::Sawtooth, 1.0), |(name, chi2)| {
            (name, chi2.max(1.0))
        });
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
            "the ray tracer did not finish; the `model` contribution is estimated from the residuals"
                .to_owned(),
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
        report.notes.push(format!(
            "no variant explains the data to their counting noise (reduced chi-square {dispersion:.3} \
             for {best}); what the model misses is in the uncertainties as `model`"
        ));
    }
    report
}

fn comparison(paper: &Estimate<'_>, sawtooth: &Estimate<'_>) -> Option<String> {
    let ratio = paper.rms_residual / sawtooth.rms_residual;
    (ratio >= 1.5).then(|| {
        format!(
            "the variant paper leaves {ratio:.*} × the residual of sawtooth ({:.3} % against {:.3} % \
             of the largest observation, rms)",
            if ratio < 10.0 { 2 } else { 0 },
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
            "{} cannot determine the free parameters and their scatter; take more poses",
            counted(set.observations.len(), "observation")
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
        reference_plane: wedge::plane(set),
        wedge_across: None,
        parameters: Parameters {
            theta_r_deg: none(),
            alpha_u: none(),
            alpha_v: none(),
            rho_d: none(),
            scale: none(),
            background: none(),
            azimuth_offset_deg: none(),
            tilt_offset_deg: none(),
            translucency: None,
            crest_radius: None,
        },
        rms_residual: None,
        model_discrepancy: None,
        chi2_reduced: None,
        chi2_reduced_without_model: None,
        rejected_frames: set.rejected_frames.clone(),
        warnings,
        notes: Vec::new(),
        findings: Vec::new(),
        slope_distribution: None,
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
