//! Estimates the duration of a fit from short runs of it, before it starts.
//!
//! [`of_analysis`] is for a series that is reduced and fitted (a fit, a verdict), [`of_reduction`] for one that is only
//! reduced (a contrast). Traces, maps and predictions have their own files. All return a [`Forecast`].

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use crate::analysis::AnalysisOptions;
use crate::fit::VariantChoice;
use crate::fit::cost_estimate::{Outlook, outlook};
use crate::fit::problem::Values;
use crate::fit::traced::ridged_surface;
use crate::forecast::Forecast;
use crate::frame::FrameKind;
use crate::geometry::Pose;
use crate::observation::ObservationSet;
use crate::reduction::{FrameSource, reduce};
use crate::series::FrameRow;
use crate::trace::pose_radiance::RadianceOptions;

/// Name of the part for reading and reducing.
pub const READ: &str = "to read and reduce";
/// Name of the part for the descents.
pub const FIT: &str = "to fit";
/// Name of the part for the passes of the ray tracer.
pub const TRACE: &str = "to trace";
/// Name of the part for fits of resampled series.
pub const BOOTSTRAP: &str = "for the bootstrap";

/// What reading and reducing gives a forecast. The reduction is that of the work itself: what it computes of the frames is
/// kept, and the work reads none of them again.
struct ReducedSeries {
    set: ObservationSet,
    seconds: f64,
}

impl ReducedSeries {
    /// `None` where the frames give no observations.
    fn of(source: &dyn FrameSource, region: Option<&str>, cancel: &AtomicBool) -> Option<Self> {
        let layout = source.manifest().sample.layout.as_ref();
        let region = region.or(layout.map(|_| "even"));
        let started = Instant::now();
        let set = reduce(source, region, cancel).ok()?;
        Some(ReducedSeries {
            set,
            seconds: started.elapsed().as_secs_f64(),
        })
    }
}

/// Poses of a series' sample frames.
fn poses_of(source: &dyn FrameSource) -> Vec<Pose> {
    let samples = source.rows().iter().filter(|r| r.kind == FrameKind::Sample);
    let mut poses: Vec<Pose> = samples.map(FrameRow::pose).collect();
    poses.dedup();
    poses
}

/// Forecasts only the reduction of a series.
#[must_use]
pub fn of_reduction(
    source: &dyn FrameSource,
    region: Option<&str>,
    cancel: &AtomicBool,
) -> Option<Forecast> {
    let reduce_s = ReducedSeries::of(source, region, cancel)?.seconds;
    let poses = poses_of(source).len() as u64;
    Some(Forecast::of_parts([(READ, reduce_s)]).for_work(poses, "poses"))
}

/// Forecasts the analysis of a series with default options.
#[must_use]
pub fn of_series(source: &dyn FrameSource, cancel: &AtomicBool) -> Option<Forecast> {
    of_analysis(source, &AnalysisOptions::default(), cancel)
}

/// Forecasts the analysis of a series: its frames are read and reduced, the fit's own quick look says what will follow it,
/// and a share of that is tried; a few poses are traced where the ray tracer is asked. `None` where the frames give no
/// observations.
#[must_use]
pub fn of_analysis(
    source: &dyn FrameSource,
    options: &AnalysisOptions,
    cancel: &AtomicBool,
) -> Option<Forecast> {
    let ReducedSeries {
        set,
        seconds: reduce_s,
    } = ReducedSeries::of(source, options.region.as_deref(), cancel)?;
    let poses = poses_of(source);
    let asked = &options.fit;
    let begun = Instant::now();
    let now = || begun.elapsed().as_secs_f64();
    let outlook = outlook(&set, asked, &now, cancel);
    let traces = asked.judge || asked.variant == VariantChoice::Traced;
    let (trace_s, error) = match &outlook {
        Some(outlook) if traces => tracing(&set, &outlook.values, options)?,
        _ => (0.0, None),
    };
    let of = |seconds: fn(&Outlook) -> f64| outlook.as_ref().map_or(0.0, seconds);
    let fit_s = of(|o| o.search_s + o.profile_s);
    let forecast = Forecast::of_parts([
        (READ, reduce_s),
        (FIT, fit_s),
        (TRACE, trace_s),
        (BOOTSTRAP, of(|o| o.bootstrap_s)),
    ]);
    // The limit applies to the fit.
    let limit = options.max_seconds.map(|s| reduce_s + s);
    Some(
        forecast
            .for_work(poses.len() as u64, "poses")
            .to_error(error, "a traced radiance, of the peak,")
            .within(limit),
    )
}

/// Poses of the timed tracing, and paths of its two runs.
const TRACED: (usize, [u64; 2]) = (6, [256, 2048]);
/// Passes over all poses with the initial number of paths, for metals and for dielectrics, where both polarised and
/// scalar light are traced.
const PASSES: (f64, f64) = (3.0, 5.0);
/// Growth of the paths, relative to the initial passes, until their line of the budget is small, without a target error.
const GROWTH: f64 = 1.0;

/// Seconds of the passes of the ray tracer, and the standard error at their end as a share of the peak.
fn tracing(
    set: &ObservationSet,
    values: &Values,
    options: &AnalysisOptions,
) -> Option<(f64, Option<f64>)> {
    let fit = &options.fit;
    let (_, k) = set.material.index();
    let ridged = ridged_surface(set, values, options.profile.as_ref())?;
    let every = set.observations.len().div_ceil(TRACED.0).max(1);
    let trial = |paths: u64| {
        let started = Instant::now();
        let (mut square, mut peak, mut count) = (0.0, f64::MIN_POSITIVE, 0.0);
        for o in set.observations.iter().step_by(every) {
            let options = RadianceOptions {
                paths,
                seed: 1,
                cones: set.rig.cones,
                polarised: true,
            };
            let found = ridged.radiance(&set.rig.directions(o.pose), &options);
            square += found.std * found.std;
            peak = found.value.max(peak);
            count += 1.0;
        }
        let seconds = started.elapsed().as_secs_f64() / f64::max(count, 1.0);
        (seconds, (square / f64::max(count, 1.0)).sqrt() / peak)
    };
    let (little_s, _) = trial(TRACED.1[0]);
    let (more_s, error) = trial(TRACED.1[1]);
    let extra = Some(more_s - little_s).filter(|s| *s > 0.0);
    let per_path = extra.map_or(more_s / TRACED.1[1] as f64, |s| {
        s / (TRACED.1[1] - TRACED.1[0]) as f64
    });
    let poses = set.observations.len() as f64;
    let first = fit.tracer.paths.max(1) as f64;
    let at_first = error * (TRACED.1[1] as f64 / first).sqrt();
    let passes = if k > 0.0 { PASSES.0 } else { PASSES.1 };
    // Standard errors fall with the root of the paths.
    let (grown, error) = match fit.tracer.target_error {
        Some(target) if at_first > target => {
            let needed =
                (1.2 * (at_first / target).powi(2)).min(fit.tracer.paths_max as f64 / first);
            (2.0 * needed, at_first / needed.sqrt())
        }
        Some(_) => (0.0, at_first),
        None => (GROWTH * passes, at_first),
    };
    Some((poses * per_path * first * (passes + grown), Some(error)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::series::Series;

    #[test]
    fn a_series_is_forecast_in_its_parts() {
        let series = Series::open("tests/data/series/paper-rig-full".as_ref()).unwrap();
        let reported = of_series(&series, &AtomicBool::new(false)).unwrap();
        assert!(reported.part(READ) > 0.0 && reported.part(FIT) > 0.0);
        assert!((reported.seconds - reported.part(READ) - reported.part(FIT)).abs() < 1e-12);
        assert_eq!(reported.part(TRACE), 0.0);
        let alone = of_reduction(&series, None, &AtomicBool::new(false)).unwrap();
        assert!(alone.seconds > 0.0 && alone.parts.len() == 1);
    }

    #[test]
    fn a_forecast_includes_the_options_of_the_fit_and_the_time_limit() {
        let series = Series::open("tests/data/series/paper-rig-full".as_ref()).unwrap();
        let mut options = AnalysisOptions::default();
        options.fit.variant = VariantChoice::Traced;
        options.fit.tracer.paths = 64;
        options.fit.bootstrap = 20;
        options.fit.starts = 1;
        let forecast = |options: &AnalysisOptions| {
            of_analysis(&series, options, &AtomicBool::new(false)).unwrap()
        };
        let all = forecast(&options);
        assert!(all.part(TRACE) > 0.0 && all.part(BOOTSTRAP) > 0.0, "{all}");
        assert!(all.error.as_ref().unwrap().value > 0.0 && !all.cut_short);
        options.max_seconds = Some(1e-6);
        let cut = forecast(&options);
        assert!(cut.cut_short && cut.seconds < cut.parts.iter().map(|p| p.seconds).sum());
    }
}
