//! Reads, reduces and fits a series in one call, and reports the seconds of each step.
//!
//! Command line and daemon call [`analyse`], or [`analyse_together`] for several scans of one sample. Frames come from any
//! [`FrameSource`]; progress goes to a callback.

use std::ops::RangeInclusive;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use crate::fit::convergence_trace::Time;
use crate::fit::joint::{JointError, JointReport, Scan};
use crate::fit::report::LeftOut;
use crate::fit::traced::TracingProgress;
use crate::fit::{self, FitOptions, FitReport};
use crate::geometry::Pose;
use crate::model::Surface;
use crate::model::left_out::POLARISATION;
use crate::observation::ObservationSet;
use crate::plan;
use crate::reduction::{CountedReads, FrameSource, ReductionError, reduce};
use crate::series::Manifest;
use crate::trace::surfaces::ridge_map::RidgeFacts;
use crate::trace::surfaces::surface_profile::SurfaceProfile;
use crate::wording::percent;

/// Range of the number of starts of a search, per variant.
pub const STARTS: RangeInclusive<i64> = 1..=1024;
/// Range of the number of series that a bootstrap draws; fewer give no interval.
pub const DRAWS: RangeInclusive<i64> = 20..=100_000;

/// Options of an analysis.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AnalysisOptions {
    /// Region of a sample that has several.
    pub region: Option<String>,
    /// Variant, starts, seed.
    pub fit: FitOptions,
    /// Measured shape of the sample, for the ray tracer; the ideal sawtooth if not given.
    pub profile: Option<SurfaceProfile>,
    /// Facts about the height map that the profile comes from.
    pub height_map: Option<RidgeFacts>,
    /// Notes on ambiguities in the shape's file.
    pub shape_notes: Vec<String>,
    /// Time limit of the fit, s: searches, ray tracer and bootstrap end then, and their results so far count.
    pub max_seconds: Option<f64>,
    /// Record every step of a descent to the minimum (`iterations` of the report).
    pub iterations: bool,
}

/// Progress of an analysis. Frames whose sums are kept are not read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Progress {
    /// Frames are read and reduced.
    Reducing {
        /// Frames read.
        done: usize,
        /// Frames in the series.
        total: usize,
    },
    /// The model is being fitted.
    Fitting,
    /// The ray tracer runs.
    Tracing {
        /// Paths traced.
        done: u64,
        /// Paths planned.
        total: u64,
    },
}

/// Why an analysis has no report.
#[derive(Debug, thiserror::Error)]
pub enum AnalysisError {
    /// The frames give no observations.
    #[error(transparent)]
    Reduction(#[from] ReductionError),
    /// The cancel flag was raised.
    #[error("the analysis was cancelled")]
    Cancelled,
}

/// Why a joint analysis has no report.
#[derive(Debug, thiserror::Error)]
pub enum JointAnalysisError {
    /// One of the scans gives no observations, or the analysis was cancelled.
    #[error(transparent)]
    Scan(#[from] AnalysisError),
    /// The scans cannot be fitted together.
    #[error(transparent)]
    Joint(#[from] JointError),
}

/// A report with its observations.
#[derive(Debug, Clone, PartialEq)]
pub struct Analysis {
    /// The fitted observations.
    pub observations: ObservationSet,
    /// The report.
    pub report: FitReport,
}

/// Reads, reduces and fits; `progress` may be called from several threads at once.
///
/// # Errors
/// [`AnalysisError`]. A failed fit is a report with that status.
pub fn analyse(
    source: &dyn FrameSource,
    options: &AnalysisOptions,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Analysis, AnalysisError> {
    let observed = observe(source, options.region.as_deref(), progress, cancel)?;
    fitted(observed, Some(source.manifest()), options, progress, cancel)
}

/// Fits observations that do not come from frames, such as a goniometer's.
///
/// # Errors
/// [`AnalysisError::Cancelled`]. A failed fit is a report with that status.
pub fn analyse_observations(
    observations: ObservationSet,
    options: &AnalysisOptions,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Analysis, AnalysisError> {
    let observed = Observed {
        observations,
        read_s: 0.0,
        reduce_s: 0.0,
    };
    fitted(observed, None, options, progress, cancel)
}

/// Fits. With a manifest, the report lists what the plan of the series leaves out.
fn fitted(
    observed: Observed,
    manifest: Option<&Manifest>,
    options: &AnalysisOptions,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Analysis, AnalysisError> {
    let Observed {
        observations,
        read_s,
        reduce_s,
    } = observed;
    progress(Progress::Fitting);
    let fitting = Instant::now();
    let watch = |p: TracingProgress| {
        progress(Progress::Tracing {
            done: p.done,
            total: p.planned,
        });
        let spent = fitting.elapsed().as_secs_f64();
        options.max_seconds.is_none_or(|limit| spent < limit)
    };
    let profile = options.profile.as_ref();
    let time = Time {
        now: &|| fitting.elapsed().as_secs_f64(),
        limit_s: options.max_seconds,
        retrace: options.iterations,
    };
    let mut report = fit::fit_watched(
        &observations,
        &options.fit,
        profile,
        &watch,
        Some(time),
        cancel,
    );
    let tolerance = options.fit.tolerance;
    if let Some(manifest) = manifest {
        leave_out(&mut report, manifest, &observations, tolerance);
    }
    if let (Some(tracer), Some(facts)) = (&mut report.tracer, options.height_map) {
        tracer.height_map = Some(facts);
        report.left_out.extend(facts.left_out());
    }
    if let Some(profile) = profile {
        let notes = options.shape_notes.iter();
        report
            .warnings
            .extend(notes.map(|note| format!("the file of the measured shape: {note}")));
        report
            .warnings
            .extend(fit::causes::measured_shape::contradictions(
                profile,
                options.height_map.as_ref(),
                &report.parameters.theta_r_deg,
                manifest.and_then(|m| m.sample.pitch_length_um),
            ));
    }
    if cancel.load(Ordering::Relaxed) {
        return Err(AnalysisError::Cancelled);
    }
    report.timing_s = fit::report::Timing {
        read: read_s,
        reduce: reduce_s,
        fit: fitting.elapsed().as_secs_f64(),
    };
    Ok(Analysis {
        observations,
        report,
    })
}

/// Replaces the general entries of the report's `left_out` by those of the series' plan, with their costs at the fitted
/// surface. Costs above the user's tolerance are warnings.
fn leave_out(
    report: &mut FitReport,
    manifest: &Manifest,
    set: &ObservationSet,
    tolerance: Option<f64>,
) {
    let p = &report.parameters;
    let (Some(theta_r_deg), Some(alpha_u), Some(alpha_v)) =
        (p.theta_r_deg.value, p.alpha_u.value, p.alpha_v.value)
    else {
        return;
    };
    let surface = Surface {
        theta_r: theta_r_deg.to_radians(),
        alpha_u,
        alpha_v,
        rho_d: p.rho_d.value.unwrap_or(0.0).clamp(0.0, 1.0),
        amplitude: 1.0,
    };
    let poses: Vec<Pose> = set.observations.iter().map(|o| o.pose).collect();
    let allowed = tolerance.unwrap_or(plan::TOLERANCE);
    let plan = plan::series::over(manifest, &poses, &[surface], allowed);
    // The fit decides whether it follows polarisation; the plan gives the cost.
    let polarisation = plan.on(plan::Decision::Polarisation);
    if let Some(known) = report.left_out.iter_mut().find(|l| l.what == POLARISATION) {
        known.cost = polarisation.and_then(|choice| choice.cost);
    }
    let others = |c: &&plan::PlanChoice| c.decision != plan::Decision::Polarisation;
    for choice in plan.left_out().filter(others) {
        let entry = LeftOut {
            what: choice.what.clone(),
            why: choice.why.clone(),
            cost: choice.cost,
        };
        match report.left_out.iter_mut().find(|l| l.what == entry.what) {
            Some(known) => *known = entry,
            // The fit reports a third bounce itself.
            None if choice.decision == plan::Decision::Bounces => {}
            None => report.left_out.push(entry),
        }
    }
    let beyond = |left: &&LeftOut| left.cost.is_some_and(|cost| cost > allowed);
    if tolerance.is_some() {
        let warnings = report.left_out.iter().filter(beyond).map(|left| {
            format!(
                "beyond the tolerance of {}: without {} the brightest radiance may be {} off; the variant traced has \
                 all that the others leave out",
                percent(allowed),
                left.what,
                percent(left.cost.unwrap_or_default())
            )
        });
        report.warnings.extend(warnings);
    }
}

/// Returns what any of several reports leaves out, each with its largest cost.
fn worst_of<'r>(reports: impl Iterator<Item = &'r FitReport>) -> Vec<LeftOut> {
    let mut all: Vec<LeftOut> = Vec::new();
    for left in reports.flat_map(|r| &r.left_out) {
        match all.iter_mut().find(|known| known.what == left.what) {
            Some(known) if left.cost > known.cost => *known = left.clone(),
            Some(_) => {}
            None => all.push(left.clone()),
        }
    }
    all
}

/// A joint report with its observations, by scan.
#[derive(Debug, Clone, PartialEq)]
pub struct JointAnalysis {
    /// The fitted observations.
    pub observations: Vec<ObservationSet>,
    /// The report.
    pub report: JointReport,
}

/// Reads and reduces several scans of one sample and fits them together. Each source comes with its name in the report.
///
/// # Errors
/// [`JointAnalysisError`]. A failed fit is a report with that status.
pub fn analyse_together(
    sources: &[(&str, &dyn FrameSource)],
    options: &AnalysisOptions,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<JointAnalysis, JointAnalysisError> {
    let (mut observations, mut read, mut reduce) = (Vec::new(), 0.0, 0.0);
    for (_, source) in sources {
        let observed = observe(*source, options.region.as_deref(), progress, cancel)?;
        observations.push(observed.observations);
        read += observed.read_s;
        reduce += observed.reduce_s;
    }
    progress(Progress::Fitting);
    let fitting = Instant::now();
    let scans: Vec<Scan<'_>> = sources
        .iter()
        .zip(&observations)
        .map(|((name, _), set)| Scan { name, set })
        .collect();
    let limit = options.max_seconds;
    let late = || limit.is_some_and(|limit| fitting.elapsed().as_secs_f64() >= limit);
    let higher_order = &fit::higher_order::two_bounces;
    let mut report = fit::joint::fit_joint(&scans, &options.fit, higher_order, &late, cancel)
        .map_err(|error| match error {
            JointError::Cancelled => AnalysisError::Cancelled.into(),
            other => JointAnalysisError::from(other),
        })?;
    for ((scan, (_, source)), set) in report.scans.iter_mut().zip(sources).zip(&observations) {
        let tolerance = options.fit.tolerance;
        leave_out(&mut scan.report, source.manifest(), set, tolerance);
    }
    report.report.left_out = worst_of(report.scans.iter().map(|scan| &scan.report));
    report.report.timing_s = fit::report::Timing {
        read,
        reduce,
        fit: fitting.elapsed().as_secs_f64(),
    };
    Ok(JointAnalysis {
        observations,
        report,
    })
}

/// Observations with the seconds of reading and reducing.
struct Observed {
    observations: ObservationSet,
    read_s: f64,
    reduce_s: f64,
}

fn observe(
    source: &dyn FrameSource,
    region: Option<&str>,
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Observed, AnalysisError> {
    let started = Instant::now();
    let report = |done, total| progress(Progress::Reducing { done, total });
    let timed = CountedReads::new(source, &report);
    let observations = match reduce(&timed, region, cancel) {
        Err(ReductionError::Cancelled) => return Err(AnalysisError::Cancelled),
        other => other?,
    };
    let both_s = started.elapsed().as_secs_f64();
    // Several threads read at once: the sum of their times over their number is the share of reading.
    let threads = rayon::current_num_threads().max(1) as f64;
    let read_s = (timed.summed_s() / threads).min(both_s);
    Ok(Observed {
        observations,
        read_s,
        reduce_s: both_s - read_s,
    })
}
