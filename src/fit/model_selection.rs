//! Fits all variants to one set of observations and selects between them.
//!
//! The selection uses QAIC. With counting errors only, every χ² is in the thousands and the ordinary criterion selects
//! the largest model. χ² is therefore divided by ĉ, the reduced χ² of the variant that fits the data best (at least 1),
//! and another variant is selected only for a clear gain.

use std::sync::atomic::{AtomicBool, Ordering};

use super::causes::findings::{Code, Finding, sorted};
use super::causes::lamp_drift::{to_correct, without};
use super::causes::suspects::{BLAMES, investigated};
use super::causes::{camera_response, downweighting};
use super::convergence_trace::{Time, retrace};
use super::estimate::Estimate;
use super::higher_order::HigherOrder;
use super::least_squares::levenberg_marquardt::Ending;
use super::model_discrepancy::LOUD;
use super::one_variant::estimate_until;
use super::quantity::Quantity;
use super::report::build::{report_with, spoken, status, summary};
use super::report::refusals::{empty, refusal};
use super::report::{FitReport, LeftOut, Status, TracerReport, VariantName};
use super::subsample;
use super::traced::{Watch, estimate_traced};
use super::uncertainty::budget::{Uncertainty, judged, uncertainty};
use super::uncertainty::intervals;
use super::{FitOptions, VariantChoice};
use crate::deadline;
use crate::model::Variant;
use crate::observation::ObservationSet;
use crate::trace::surfaces::surface_profile::SurfaceProfile;
use crate::wording::significant;

/// Gain in QAIC that counts as clear.
const CLEAR_QAIC: f64 = 10.0;
/// ĉ above which no variant is adequate.
const INADEQUATE: f64 = 4.0;
/// Ratio of root mean square residuals from which the printed lobe does not describe a sample that the sawtooth does.
const MUCH_LARGER: f64 = 1.5;
/// Largest share of the squared model error that a cause may leave in order to be named.
const EXPLAINED: f64 = 0.5;
/// Factor by which `traced` has to be less certain than `sawtooth` for the report to say why.
const LESS_CERTAIN: f64 = 1.2;

/// Inputs of the ray tracer beside the options.
pub struct Tracer<'t> {
    /// The shape to trace; the ideal sawtooth if none is given.
    pub profile: Option<&'t SurfaceProfile>,
    /// Follows the progress and may end it.
    pub watch: Watch<'t>,
    /// The caller's clock, if there is one.
    pub time: Option<Time<'t>>,
}

impl Tracer<'static> {
    /// Traces the ideal sawtooth to the end.
    pub const PLAIN: Self = Tracer {
        profile: None,
        watch: &|_| true,
        time: None,
    };
}

impl Tracer<'_> {
    /// Reports on a tracing.
    fn report(&self, e: &Estimate<'_>) -> Option<TracerReport> {
        let done = e.traced.as_ref()?;
        let profile = self.profile.and_then(SurfaceProfile::effective_ridge_angle);
        Some(TracerReport {
            passes: done.passes,
            paths_per_pose: done.paths,
            error: done.error,
            polarised: done.polarised,
            end: done.end,
            profile_theta_r_deg: profile.map(f64::to_degrees),
            profile_turned: self.profile.is_some_and(SurfaceProfile::is_turned),
            height_map: None,
        })
    }
}

/// Fits every variant without a higher order and reports the requested one, or the best; the ray tracer has default
/// inputs.
#[must_use]
pub fn fit_without_higher_order(
    set: &ObservationSet,
    options: &FitOptions,
    cancel: &AtomicBool,
) -> FitReport {
    fit_with_tracer(set, options, None, &Tracer::PLAIN, cancel)
}

/// Fits every variant and reports the requested one, or the best.
#[must_use]
pub fn fit_with_tracer(
    set: &ObservationSet,
    options: &FitOptions,
    higher_order: Option<HigherOrder<'_>>,
    tracer: &Tracer<'_>,
    cancel: &AtomicBool,
) -> FitReport {
    if let Some(status) = refusal(set) {
        return empty(set, options, status);
    }
    let merged = subsample::merged(set, options.loss);
    let all = merged.as_ref().map_or(set, |m| &m.set);
    // The ray tracer computes every pose separately, so it only gets the representative ones.
    let asked = options.variant == VariantChoice::Traced || options.judge;
    let kept = subsample::representative(all).filter(|_| asked);
    let few = kept.map(|kept| subsample::subset(all, &kept));
    let mut report = fit_each(
        few.as_ref().unwrap_or(all),
        options,
        higher_order,
        tracer,
        cancel,
        &[],
    );
    if let Some(few) = few {
        let (kept, of) = (few.observations.len(), all.observations.len());
        report.left_out.push(LeftOut::new(
            format!("{} of {of} observations", of - kept),
            "the ray tracer computes pose by pose; the observations used are spread over the poses, with the brightest of \
             each neighbourhood, and the counting noise is only theirs",
            None,
        ));
    }
    if let Some(merged) = merged {
        let poses = merged.set.observations.len();
        report.left_out.push(LeftOut::new(
            "repeats of a pose one by one",
            format!(
                "{} observations at {poses} poses are merged to weighted means, which is exact for least squares; χ² \
                 includes their scatter",
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

/// [`fit_with_tracer`] for a set that can be fitted; `carried` are the causes for which it was changed.
fn fit_each(
    set: &ObservationSet,
    options: &FitOptions,
    higher_order: Option<HigherOrder<'_>>,
    tracer: &Tracer<'_>,
    cancel: &AtomicBool,
    carried: &[Finding],
) -> FitReport {
    let late = || tracer.time.is_some_and(|time| !time.allows());
    let known = |code: Code| carried.iter().any(|f| f.code == code);
    let poses_known = known(Code::BadPose) || known(Code::BadBlock);
    let blameless: Vec<Code> = BLAMES
        .into_iter()
        .filter(|code| match code {
            Code::LampDrift => set.lamp.is_some(),
            _ => poses_known,
        })
        .collect();
    let mut finer = None;
    let mut attempt = |over: &AtomicBool| {
        let run = |variant: Variant| {
            let higher_order = higher_order.filter(|_| variant == Variant::Sawtooth);
            estimate_until(set, variant, options, higher_order, &late, over)
        };
        let (paper, ideal) = (run(Variant::Paper), run(Variant::Sawtooth));
        finer = ideal.as_ref().and_then(Estimate::with_finer_views);
        let sawtooth = match &ideal {
            Some(ideal) if finer.is_none() && !late() => Some(investigated(
                ideal.clone(),
                options,
                higher_order,
                &blameless,
                over,
            )),
            _ => ideal.clone(),
        };
        [paper, ideal, sawtooth]
    };
    // A descent of a near rig may take longer than the limit: the flag ends it in the midst of it.
    let is_limited = tracer.time.is_some_and(|time| time.limit_s.is_some());
    let mut all = match is_limited {
        true => deadline::flagging(&late, cancel, attempt),
        false => attempt(cancel),
    };
    let enough = late();
    for e in all.iter_mut().flatten() {
        if enough && e.minimum.ending == Ending::Cancelled {
            e.minimum.ending = Ending::MaxIterations;
            e.cut_short = true;
        }
    }
    if let Some(finer) = finer
        && !(enough || cancel.load(Ordering::Relaxed))
    {
        return fit_each(&finer, options, higher_order, tracer, cancel, carried);
    }
    let [paper, ideal, sawtooth] = all;
    let may_go_on = || !(enough || cancel.load(Ordering::Relaxed));
    let again = |set: &ObservationSet| {
        let attempt = |over: &AtomicBool| {
            let e = estimate_until(set, Variant::Sawtooth, options, higher_order, &late, over)?;
            Some(investigated(e, options, higher_order, &BLAMES, over).discrepancy)
        };
        match is_limited {
            true => deadline::flagging(&late, cancel, attempt),
            false => attempt(cancel),
        }
    };
    let explained_by = |set: &ObservationSet| {
        let left = (again(set)? / sawtooth.as_ref()?.discrepancy).powi(2);
        (left < EXPLAINED).then_some(1.0 - left)
    };
    let blame = sawtooth.as_ref().and_then(|e| e.blame.as_deref());
    let with = |finding: Finding| [carried, &[finding]].concat();
    if may_go_on()
        && let Some(e) = &sawtooth
        && let Some(decided) = camera_response::decided(set, e.discrepancy, again)
    {
        return fit_each(&decided, options, higher_order, tracer, cancel, carried);
    }
    if may_go_on()
        && !known(Code::WhiteReference)
        && let Some((lighter, mut finding)) = sawtooth.as_ref().and_then(downweighting::of_flats)
        && let Some(explains) = explained_by(&lighter)
        && blame
            .is_none_or(|blame| explained_by(&blame.set).is_none_or(|by_blame| by_blame < explains))
    {
        finding.explains = explains;
        return fit_each(
            &lighter,
            options,
            higher_order,
            tracer,
            cancel,
            &with(finding),
        );
    }
    if may_go_on()
        && let Some(blame) = blame
    {
        let carried = [carried, blame.finding.as_slice()].concat();
        return fit_each(&blame.set, options, higher_order, tracer, cancel, &carried);
    }
    if may_go_on()
        && !poses_known
        && let Some((lighter, finding)) = sawtooth.as_ref().and_then(downweighting::of)
        && explained_by(&lighter).is_some()
    {
        return fit_each(
            &lighter,
            options,
            higher_order,
            tracer,
            cancel,
            &with(finding),
        );
    }
    if set.lamp.is_none()
        && let Some(lamp) = sawtooth.as_ref().and_then(to_correct)
        && may_go_on()
        && let Some(steady) = without(set, lamp)
    {
        // Fits everything again to the observations of a steady lamp.
        return fit_each(&steady, options, higher_order, tracer, cancel, carried);
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
    // Uses ĉ of the best variant, not of the most complex one: if that one explains nothing, its scatter would make all
    // equal.
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
        VariantChoice::Auto
            if criterion(&paper) + CLEAR_QAIC < criterion(&sawtooth)
                && describes(&paper, &sawtooth) =>
        {
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
    let of_poses = |code: Code| matches!(code, Code::BadPose | Code::BadBlock);
    let again = |code: Code| known(code) || (poses_known && of_poses(code));
    report.findings.retain(|f| !again(f.code));
    report.findings.extend_from_slice(carried);
    report.findings = sorted(report.findings);
    report.tracer = traced.as_ref().and_then(|e| tracer.report(e));
    if options.judge && traced.is_none() {
        report.warnings.push(
            "The ray tracer did not finish, so the budget line `model` is estimated from the residuals. Allow more time."
                .to_owned(),
        );
    }
    if report.tracer.is_some_and(|t| !t.polarised) {
        report.warnings.push(
            "Light was traced without polarisation, because the unpolarised model fits these data better. Data of an \
             unpolarised renderer cause this; for a real sample, check the residuals."
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
        // Only a fit of variant paper leaves something to do.
        match chosen {
            VariantName::Paper => report.warnings.extend(comparison(paper, sawtooth)),
            _ => report.notes.extend(comparison(paper, sawtooth)),
        }
    }
    if let (VariantName::Traced, Some(sawtooth)) = (chosen, &sawtooth) {
        report.notes.extend(less_certain(main, &u, sawtooth));
    }
    if dispersion > INADEQUATE {
        report.notes.push(format!(
            "No variant explains the data to their counting noise (reduced χ² {} for {best}). The budget line \
             `model` contains the model error.",
            significant(dispersion)
        ));
    }
    report
}

/// Whether the printed lobe describes the sample: its model error is small, its residual is not much larger than that of the
/// sawtooth, and its ρd is that of a surface. QAIC alone may prefer it where the errors are shares of the signals, so that dim
/// poses count most, or where neither describes the sample.
fn describes(paper: &Option<Estimate<'_>>, sawtooth: &Option<Estimate<'_>>) -> bool {
    let (Some(paper), Some(sawtooth)) = (paper, sawtooth) else {
        return true;
    };
    (0.0..=1.0).contains(&paper.values.rho_d)
        && paper.discrepancy <= LOUD
        && paper.rms_residual < MUCH_LARGER * sawtooth.rms_residual
}

fn comparison(paper: &Estimate<'_>, sawtooth: &Estimate<'_>) -> Option<String> {
    let ratio = paper.rms_residual / sawtooth.rms_residual;
    (ratio >= MUCH_LARGER).then(|| {
        format!(
            "The RMS residual of variant paper is {ratio:.*} × that of sawtooth ({:.3} % against {:.3} % of the peak). \
             Use sawtooth for this sample.",
            if ratio < 10.0 { 2 } else { 0 },
            100.0 * paper.rms_residual,
            100.0 * sawtooth.rms_residual
        )
    })
}

/// Names the results that the tracer leaves less certain than the closed form, and the cause.
fn less_certain(
    traced: &Estimate<'_>,
    of_traced: &Uncertainty,
    sawtooth: &Estimate<'_>,
) -> Option<String> {
    let results = [
        Quantity::ThetaR,
        Quantity::AlphaU,
        Quantity::AlphaV,
        Quantity::RhoD,
    ];
    let of_sawtooth = uncertainty(sawtooth);
    let mut names = Vec::new();
    let (mut line, mut most) = ("", 0.0);
    for q in results {
        let (Some(i), Some(j)) = (traced.problem.column(q), sawtooth.problem.column(q)) else {
            continue;
        };
        let (mine, its) = (&of_traced.budgets[i], &of_sawtooth.budgets[j]);
        if mine.combined() <= LESS_CERTAIN * its.combined() {
            continue;
        }
        names.push(spoken(q));
        for ((name, part), (_, other)) in mine.named().into_iter().zip(its.named()) {
            let growth = (part - other) / mine.combined();
            if growth > most {
                (line, most) = (name, growth);
            }
        }
    }
    if names.is_empty() {
        return None;
    }
    let error = 100.0 * traced.traced.as_ref()?.error;
    let [own, closed] = [traced, sawtooth].map(|e| 100.0 * e.rms_residual);
    let cause = if error > closed {
        format!(
            "The standard error of the traced radiances ({error:.3} % of the peak) exceeds the residual of sawtooth \
             ({closed:.3} %). A smaller one (--tracer-error) costs time."
        )
    } else {
        format!("Its residual is {own:.3} % of the peak, and that of sawtooth {closed:.3} %.")
    };
    Some(format!(
        "Variant traced is less certain about {} than sawtooth, mostly by the budget line `{line}`. {cause}",
        names.join(", ")
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::one_variant::estimate;
    use crate::fit::painted::{TRUTH, painted};
    use crate::geometry::Pose;

    #[test]
    fn the_printed_lobe_is_not_chosen_against_its_residual_or_its_reflectance() {
        let poses = (0..60)
            .map(|n| Pose::from_deg(8.0 * f64::from(n / 12) - 16.0, 30.0 * f64::from(n % 12)));
        let set = painted(poses, &TRUTH, 1e-3, 1);
        let never = AtomicBool::new(false);
        let fitted = |variant| estimate(&set, variant, &FitOptions::default(), None, &never);
        let (paper, sawtooth) = (fitted(Variant::Paper), fitted(Variant::Sawtooth));
        let as_if = |rho_d: f64, ratio: f64, discrepancy: f64| {
            let (mut paper, sawtooth) = (paper.clone().unwrap(), sawtooth.clone().unwrap());
            paper.values.rho_d = rho_d;
            paper.discrepancy = discrepancy;
            paper.rms_residual = ratio * sawtooth.rms_residual;
            describes(&Some(paper), &Some(sawtooth))
        };
        assert!(as_if(0.3, 1.1, 0.01));
        assert!(!as_if(0.3, 12.0, 0.01));
        assert!(!as_if(0.3, 1.0, 0.1));
        assert!(!as_if(-0.15, 1.0, 0.01) && !as_if(291.0, 1.0, 0.01));
    }
}
