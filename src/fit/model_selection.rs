//! Fits all variants to one set of observations and selects between them.
//!
//! The selection uses QAIC. With counting errors only, every χ² is in the thousands and the ordinary criterion selects
//! the largest model. χ² is therefore divided by ĉ, the reduced χ² of the variant that fits the data best (at least 1),
//! and another variant is selected only for a clear gain.

use std::sync::atomic::{AtomicBool, Ordering};

use super::causes::findings::{Finding, sorted};
use super::convergence_trace::{Time, retrace};
use super::estimate::Estimate;
use super::fitting::{Changed, Fits, Fitting};
use super::higher_order::HigherOrder;
use super::model_discrepancy::LOUD;
use super::quantity::Quantity;
use super::report::build::{report_with, spoken, status, summary};
use super::report::refusals::{empty, refusal};
use super::report::{FitReport, LeftOut, Status, TracerReport, VariantName};
use super::subsample;
use super::traced::{Watch, estimate_traced};
use super::uncertainty::budget::{Uncertainty, judged, uncertainty};
use super::uncertainty::intervals;
use super::{FitOptions, VariantChoice};
use crate::observation::ObservationSet;
use crate::trace::surfaces::surface_profile::SurfaceProfile;
use crate::wording::{percent, significant};

/// Gain in QAIC that counts as clear.
const CLEAR_QAIC: f64 = 10.0;
/// ĉ above which no variant is adequate.
const INADEQUATE: f64 = 4.0;
/// Ratio of root mean square residuals from which the printed lobe does not describe a sample that the sawtooth does.
const MUCH_LARGER: f64 = 1.5;
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

/// [`fit_with_tracer`] for a set that can be fitted.
fn fit_each(
    set: &ObservationSet,
    options: &FitOptions,
    higher_order: Option<HigherOrder<'_>>,
    tracer: &Tracer<'_>,
    cancel: &AtomicBool,
) -> FitReport {
    let fitting = Fitting {
        options,
        higher_order,
        time: tracer.time,
        cancel,
    };
    let mut changed: Option<Changed> = None;
    loop {
        let (set, causes) = match &changed {
            Some(changed) => (&changed.set, changed.causes.as_slice()),
            None => (set, &[][..]),
        };
        let next = {
            let fits = fitting.fits(set, causes);
            match fitting.changed(set, &fits, causes) {
                Some(next) => next,
                None => return selected(set, &fits, options, tracer, cancel, causes),
            }
        };
        changed = Some(next);
    }
}

/// Traces if that is asked for, selects a variant, and reports it; `causes` are those for which the set was changed.
fn selected(
    set: &ObservationSet,
    fits: &Fits<'_>,
    options: &FitOptions,
    tracer: &Tracer<'_>,
    cancel: &AtomicBool,
    causes: &[Finding],
) -> FitReport {
    let traced = fits
        .to_trace(options, tracer.profile)
        .and_then(|s| estimate_traced(s, options, tracer.profile, tracer.watch, cancel));
    if cancel.load(Ordering::Relaxed) {
        return empty(set, options, Status::Cancelled);
    }
    let variants = Variants {
        paper: fits.paper.as_ref(),
        sawtooth: fits.sawtooth.as_ref(),
        traced: traced.as_ref(),
        count: set.observations.len(),
    };
    let chosen = variants.chosen(options.variant);
    let Some(main) = variants.get(chosen) else {
        let untraced = chosen == VariantName::Traced && variants.sawtooth.is_some();
        let status = if untraced {
            Status::Stalled
        } else {
            Status::NotFinite
        };
        return empty(set, options, status);
    };
    let judge = variants
        .traced
        .filter(|_| chosen != VariantName::Traced && options.judge);
    let u = match judge {
        Some(traced) => judged(main, traced),
        None => uncertainty(main),
    };
    let mut report = report_with(main, &u, chosen);
    report
        .findings
        .retain(|found| !causes.iter().any(|cause| cause.code.is_like(found.code)));
    report.findings.extend_from_slice(causes);
    report.findings = sorted(report.findings);
    report.tracer = variants.traced.and_then(|e| tracer.report(e));
    report.warnings.extend(of_tracer(&report, options));
    if options.profile || options.bootstrap > 0 {
        let enough = || tracer.time.is_some_and(|t| !t.allows());
        intervals::add(&mut report, main, &u, options, &enough, cancel);
    }
    if let Some(time) = tracer.time.filter(|t| t.retrace) {
        report.iterations = retrace(main, &u, options.seed, time, cancel);
    }
    variants.add_to(&mut report, chosen, &u);
    report
}

/// Warnings about the ray tracer.
fn of_tracer(report: &FitReport, options: &FitOptions) -> Vec<String> {
    let mut warnings = Vec::new();
    if options.judge && report.tracer.is_none() {
        warnings.push(
            "The ray tracer did not finish, so the budget line `model` is estimated from the residuals. Allow more time."
                .to_owned(),
        );
    }
    if report.tracer.is_some_and(|t| !t.polarised) {
        warnings.push(
            "Light was traced without polarisation, because the unpolarised model fits these data better. Data of an \
             unpolarised renderer cause this; for a real sample, check the residuals."
                .to_owned(),
        );
    }
    warnings
}

/// The fitted variants, to select from.
struct Variants<'v, 'a> {
    paper: Option<&'v Estimate<'a>>,
    sawtooth: Option<&'v Estimate<'a>>,
    traced: Option<&'v Estimate<'a>>,
    /// Number of observations.
    count: usize,
}

impl<'v, 'a> Variants<'v, 'a> {
    fn get(&self, name: VariantName) -> Option<&'v Estimate<'a>> {
        match name {
            VariantName::Paper => self.paper,
            VariantName::Sawtooth => self.sawtooth,
            VariantName::Traced => self.traced,
        }
    }

    fn fitted(&self) -> impl Iterator<Item = (VariantName, &'v Estimate<'a>)> {
        let names = [
            VariantName::Paper,
            VariantName::Sawtooth,
            VariantName::Traced,
        ];
        let each = names.map(|name| self.get(name).map(|e| (name, e)));
        each.into_iter().flatten()
    }

    /// Returns the variant that fits best, and ĉ. If the most complex variant explained nothing, its scatter would make all equal.
    fn best(&self) -> (VariantName, f64) {
        let reduced =
            |(name, e): (VariantName, &Estimate<'_>)| (name, e.chi2_reduced_without_model);
        let best = self
            .fitted()
            .map(reduced)
            .min_by(|a, b| a.1.total_cmp(&b.1));
        best.map_or((VariantName::Sawtooth, 1.0), |(name, chi2)| {
            (name, chi2.max(1.0))
        })
    }

    /// QAIC of a variant.
    fn criterion(&self, e: &Estimate<'_>) -> f64 {
        let (_, dispersion) = self.best();
        let freedom = self.count.saturating_sub(e.fitted).max(1) as f64;
        e.chi2_reduced_without_model * freedom / dispersion + 2.0 * e.fitted as f64
    }

    fn chosen(&self, choice: VariantChoice) -> VariantName {
        let of = |e: Option<&Estimate<'_>>| e.map_or(f64::INFINITY, |e| self.criterion(e));
        match choice {
            VariantChoice::Paper => VariantName::Paper,
            VariantChoice::Sawtooth => VariantName::Sawtooth,
            VariantChoice::Traced => VariantName::Traced,
            VariantChoice::Auto
                if of(self.paper) + CLEAR_QAIC < of(self.sawtooth)
                    && describes(self.paper, self.sawtooth) =>
            {
                VariantName::Paper
            }
            VariantChoice::Auto => VariantName::Sawtooth,
        }
    }

    /// Lists the variants in the report of the chosen one, whose uncertainty is `u`, and compares them.
    fn add_to(&self, report: &mut FitReport, chosen: VariantName, u: &Uncertainty) {
        for (name, e) in self.fitted() {
            let status = if name == chosen {
                report.status
            } else {
                status(e, &uncertainty(e))
            };
            let row = summary(e, name, status, self.criterion(e));
            report.variants.push(row);
        }
        if let (Some(paper), Some(sawtooth)) = (self.paper, self.sawtooth) {
            // Only a fit of variant paper leaves something to do.
            match chosen {
                VariantName::Paper => report.warnings.extend(comparison(paper, sawtooth)),
                _ => report.notes.extend(comparison(paper, sawtooth)),
            }
        }
        if let (VariantName::Traced, Some(traced), Some(sawtooth)) =
            (chosen, self.traced, self.sawtooth)
        {
            report.notes.extend(less_certain(traced, u, sawtooth));
        }
        let (best, dispersion) = self.best();
        if dispersion > INADEQUATE {
            report.notes.push(format!(
                "No variant explains the data to their counting noise (reduced χ² {} for {best}). The budget line \
                 `model` contains the model error.",
                significant(dispersion)
            ));
        }
    }
}

/// Whether the printed lobe describes the sample: its model error is small, its residual is not much larger than that of the
/// sawtooth, and its ρd is that of a surface. QAIC alone may prefer it where the errors are shares of the signals, so that dim
/// poses count most, or where neither describes the sample.
fn describes(paper: Option<&Estimate<'_>>, sawtooth: Option<&Estimate<'_>>) -> bool {
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
            "The RMS residual of variant paper is {} × that of sawtooth ({} against {} of the peak). Use sawtooth for this \
             sample.",
            significant(ratio),
            percent(paper.rms_residual),
            percent(sawtooth.rms_residual)
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
    use crate::model::Variant;

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
            describes(Some(&paper), Some(&sawtooth))
        };
        assert!(as_if(0.3, 1.1, 0.01));
        assert!(!as_if(0.3, 12.0, 0.01));
        assert!(!as_if(0.3, 1.0, 0.1));
        assert!(!as_if(-0.15, 1.0, 0.01) && !as_if(291.0, 1.0, 0.01));
    }
}
