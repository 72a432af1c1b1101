//! How long a trace or a fit will take, told before it starts, from short runs of it.
//!
//! [`of_run`] for a scene of the tracer, [`of_analysis`] for a series that is reduced and fitted (a fit, a
//! verdict), [`of_reduction`] for one that is reduced alone (a contrast). Maps have a file of their own, and so
//! have predictions. All speak in [`Forecast`]s.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use super::fits::painted;
use crate::analysis::AnalysisOptions;
use crate::fit::problem::Values;
use crate::fit::traced::ridged_surface;
use crate::fit::{FitOptions, VariantChoice, fit};
use crate::forecast::Forecast;
use crate::frame::{Frame, FrameKind};
use crate::geometry::Pose;
use crate::model::Surface;
use crate::observation::ObservationSet;
use crate::reduction::{FrameReadError, FrameSource, reduce};
use crate::series::{FrameRow, Manifest};
use crate::trace::ridged::RadianceOptions;
use crate::trace::run::{Shard, trace_few, trace_photons};
use crate::trace::scene::Prepared;

/// Share of the run that the larger of the two short runs takes.
const SHARE: u64 = 32;

/// The same of a third run, where the start takes most of the time of both.
const LONGER_SHARE: u64 = 8;

/// Photons of two runs so short that they do without the start of a longer one.
const FEW: (u64, u64) = (16, 512);

/// What a forecast itself may take.
#[derive(Debug, Clone, Copy)]
pub struct Patience<'a> {
    /// Seconds after which the forecast is made of what is known by then.
    pub seconds: f64,
    /// Ends it at once.
    pub cancel: &'a AtomicBool,
}

/// One short run: photons traced, seconds, relative error.
#[derive(Debug, Clone, Copy)]
struct Trial {
    photons: u64,
    seconds: f64,
    error: Option<f64>,
}

/// Forecasts a run of the scene's photons, or of as many as `target_error` needs (no more than those).
///
/// Two short runs part what a run costs at its start (shapes, first hits) from what a photon costs; the
/// error falls with the root of the photons once the bins that matter have been hit. Where patience ends
/// early the forecast is of the runs by then, and none where not even the first came to anything.
#[must_use]
pub fn of_run(
    prepared: &Prepared,
    target_error: Option<f64>,
    patience: Patience<'_>,
) -> Option<Forecast> {
    if patience.cancel.load(Ordering::Relaxed) || patience.seconds <= 0.0 {
        return None;
    }
    // What a surface computes once and keeps is no part of the run that follows.
    drop(trace_few(prepared, FEW.0.min(prepared.photons)));
    let large = (prepared.photons / SHARE)
        .clamp(1_000, 500_000)
        .min(prepared.photons);
    let small = (large / 4).max(1);
    let begun = Instant::now();
    let go_on = || {
        !patience.cancel.load(Ordering::Relaxed) && begun.elapsed().as_secs_f64() < patience.seconds
    };
    let timed = |photons: u64| -> Option<Trial> {
        if !go_on() {
            return None;
        }
        let started = Instant::now();
        let totals = trace_photons(prepared, photons, Shard::WHOLE, &|_| go_on());
        (totals.photons() > 0).then(|| Trial {
            photons: totals.photons(),
            seconds: started.elapsed().as_secs_f64(),
            error: totals.relative_error(),
        })
    };
    // The better of two: other work on the machine only ever adds.
    let better = |photons: u64| {
        let first = timed(photons)?;
        let again = timed(photons).filter(|again| again.photons == first.photons);
        let seconds = again.map_or(first.seconds, |again| again.seconds.min(first.seconds));
        Some(Trial { seconds, ..first })
    };
    let Some(little) = better(small) else {
        return of_slow_start(
            prepared,
            begun.elapsed().as_secs_f64(),
            target_error,
            patience,
        );
    };
    let more = better(large).filter(|more| more.photons > little.photons);
    let known = more.unwrap_or(little);
    // Where the start costs more than the photons a small difference would be magnified: a longer run tells.
    let longer = (prepared.photons / LONGER_SHARE).max(large);
    let upper = match more {
        Some(more) if more.seconds < 1.5 * little.seconds && longer > large => timed(longer)
            .filter(|upper| upper.photons > more.photons)
            .unwrap_or(more),
        _ => known,
    };
    let per_photon = if upper.photons > little.photons {
        ((upper.seconds - little.seconds) / (upper.photons - little.photons) as f64).max(0.0)
    } else {
        // One run alone cannot part the start from the photons.
        little.seconds / little.photons as f64
    };
    let start = (upper.seconds - per_photon * upper.photons as f64).max(0.0);
    let (photons, error) = until_target(prepared, &known, target_error);
    Some(Forecast {
        at_most: upper.photons == little.photons,
        ..Forecast::about(start + per_photon * photons as f64)
            .for_work(photons, "photons")
            .to_error(error, "a reflected bin")
    })
}

/// The same where patience ended before the start of a run was over, after `start_s`: a few photons without it tell what
/// one costs.
fn of_slow_start(
    prepared: &Prepared,
    start_s: f64,
    target_error: Option<f64>,
    patience: Patience<'_>,
) -> Option<Forecast> {
    if patience.cancel.load(Ordering::Relaxed) {
        return None;
    }
    let timed = |photons: u64| {
        let started = Instant::now();
        let totals = trace_few(prepared, photons.min(prepared.photons));
        Trial {
            photons: totals.photons(),
            seconds: started.elapsed().as_secs_f64(),
            error: totals.relative_error(),
        }
    };
    let little = timed(FEW.0);
    // Photons so dear that a few take as long as there is patience say enough.
    let more = if little.seconds < patience.seconds {
        timed(FEW.1)
    } else {
        little
    };
    let per_photon = if more.photons > little.photons {
        ((more.seconds - little.seconds) / (more.photons - little.photons) as f64).max(0.0)
    } else {
        more.seconds / more.photons.max(1) as f64
    };
    let (photons, error) = until_target(prepared, &more, target_error);
    Some(
        Forecast::about(start_s + per_photon * photons as f64)
            .for_work(photons, "photons")
            .to_error(error, "a reflected bin"),
    )
}

/// Photons after which a run stops, and its error by then, from a shorter one.
fn until_target(
    prepared: &Prepared,
    known: &Trial,
    target_error: Option<f64>,
) -> (u64, Option<f64>) {
    let photons = match (target_error, known.error) {
        (Some(target), Some(error)) => {
            let needed = known.photons as f64 * (error / target).powi(2);
            (needed as u64).clamp(1, prepared.photons)
        }
        _ => prepared.photons,
    };
    let error = known
        .error
        .map(|e| e * (known.photons as f64 / photons as f64).sqrt());
    (photons, error)
}

/// Of so many poses one is read.
const THINNED: usize = 6;

/// A series with a few of its sample frames.
pub(super) struct Thinned<'a> {
    source: &'a dyn FrameSource,
    rows: Vec<FrameRow>,
    places: Vec<usize>,
}

impl<'a> Thinned<'a> {
    /// With one pose of so many.
    pub(super) fn new(source: &'a dyn FrameSource, every: usize) -> Self {
        let mut poses: Vec<Pose> = Vec::new();
        let mut thinned = Thinned {
            source,
            rows: Vec::new(),
            places: Vec::new(),
        };
        for (place, row) in source.rows().iter().enumerate() {
            let kept = match row.kind {
                FrameKind::Dark | FrameKind::Flat => true,
                FrameKind::Sample => {
                    if poses.last() != Some(&row.pose()) {
                        poses.push(row.pose());
                    }
                    poses.len() % every == 1 % every
                }
            };
            if kept {
                thinned.rows.push(row.clone());
                thinned.places.push(place);
            }
        }
        thinned
    }
}

impl FrameSource for Thinned<'_> {
    fn manifest(&self) -> &Manifest {
        self.source.manifest()
    }

    fn rows(&self) -> &[FrameRow] {
        &self.rows
    }

    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        self.source.read(self.places[index])
    }
}

/// Names of the parts.
pub const READ: &str = "to read and reduce";
/// The descents.
pub const FIT: &str = "to fit";
/// The ray tracer's passes.
pub const TRACE: &str = "to trace";
/// Fits of drawn series.
pub const BOOTSTRAP: &str = "for the bootstrap";

/// Seconds of reading and reducing, from a sixth of the poses. `None` where those give no observations.
fn reduction_s(source: &dyn FrameSource, region: Option<&str>, cancel: &AtomicBool) -> Option<f64> {
    let layout = source.manifest().sample.layout.as_ref();
    let region = region.or(layout.map(|_| "even"));
    let thinned = Thinned::new(source, THINNED);
    let started = Instant::now();
    reduce(&thinned, region, cancel).ok()?;
    let share = source.rows().len() as f64 / thinned.rows.len().max(1) as f64;
    Some(share * started.elapsed().as_secs_f64())
}

/// Poses of a series' sample frames.
fn poses_of(source: &dyn FrameSource) -> Vec<Pose> {
    let samples = source.rows().iter().filter(|r| r.kind == FrameKind::Sample);
    let mut poses: Vec<Pose> = samples.map(FrameRow::pose).collect();
    poses.dedup();
    poses
}

/// Forecasts the reduction of a series alone.
#[must_use]
pub fn of_reduction(
    source: &dyn FrameSource,
    region: Option<&str>,
    cancel: &AtomicBool,
) -> Option<Forecast> {
    let reduce_s = reduction_s(source, region, cancel)?;
    let poses = poses_of(source).len() as u64;
    Some(Forecast::of_parts([(READ, reduce_s)]).for_work(poses, "poses"))
}

/// Forecasts the analysis of a series by the usual fit.
#[must_use]
pub fn of_series(source: &dyn FrameSource, cancel: &AtomicBool) -> Option<Forecast> {
    of_analysis(source, &AnalysisOptions::default(), cancel)
}

/// Forecasts the analysis of a series: a sixth of its poses are read and reduced, and a surface as samples have
/// it is fitted at all of its poses with what the options ask for; of that surface a few poses are traced where the
/// ray tracer is asked, and few series are drawn where a bootstrap is. `None` where those frames give no
/// observations.
#[must_use]
pub fn of_analysis(
    source: &dyn FrameSource,
    options: &AnalysisOptions,
    cancel: &AtomicBool,
) -> Option<Forecast> {
    let reduce_s = reduction_s(source, options.region.as_deref(), cancel)?;
    let manifest = source.manifest();
    let poses = poses_of(source);
    let metal = manifest.material().index().1 > 0.0;
    let surface = Surface {
        theta_r: 12f64.to_radians(),
        alpha_u: 0.1,
        alpha_v: 0.1,
        rho_d: if metal { 0.0 } else { 0.3 },
        amplitude: 1.0,
    };
    let set = painted(
        manifest.rig_geometry(),
        manifest.material(),
        &surface,
        &poses,
        0.01,
    );
    let asked = &options.fit;
    let traces = asked.judge || asked.variant == VariantChoice::Traced;
    let closed = FitOptions {
        variant: if asked.variant == VariantChoice::Traced {
            VariantChoice::Auto
        } else {
            asked.variant
        },
        judge: false,
        bootstrap: 0,
        ..asked.clone()
    };
    let timed = |options: &FitOptions| {
        let started = Instant::now();
        std::hint::black_box(fit(&set, options, cancel));
        started.elapsed().as_secs_f64()
    };
    let fit_s = timed(&closed);
    let bootstrap_s = if asked.bootstrap > 0 {
        let drawn = FitOptions {
            bootstrap: asked.bootstrap.min(DRAWN),
            ..closed.clone()
        };
        let drawn_s = timed(&drawn);
        // Other work on the machine may make the shorter one look longer: then all of it is a bound.
        let extra = Some(drawn_s - fit_s).filter(|s| *s > 0.0);
        extra.unwrap_or(drawn_s) / f64::from(drawn.bootstrap) * f64::from(asked.bootstrap)
    } else {
        0.0
    };
    let (trace_s, error) = if traces {
        tracing(&set, &surface, asked, options)?
    } else {
        (0.0, None)
    };
    let told = Forecast::of_parts([
        (READ, reduce_s),
        (FIT, fit_s),
        (TRACE, trace_s),
        (BOOTSTRAP, bootstrap_s),
    ]);
    // The limit is on the time of fitting, and what it ends is the tracer and the bootstrap.
    let least = reduce_s + fit_s;
    let limit = options.max_seconds.map(|s| least.max(reduce_s + s));
    Some(
        told.for_work(poses.len() as u64, "poses")
            .to_error(error, "a traced radiance, of the peak,")
            .within(limit),
    )
}

/// Series drawn to time a bootstrap.
const DRAWN: u32 = 20;
/// Poses that are traced to time a tracing, and paths of the two trials.
const TRACED: (usize, [u64; 2]) = (6, [256, 2048]);
/// Passes over all poses at the paths that a tracing begins with: metal is polarised from the start, of a
/// dielectric both kinds of light are looked at.
const PASSES: (f64, f64) = (3.0, 5.0);
/// By how much paths grow from there until their line of the budget is small, where nobody names an error.
const GROWTH: f64 = 1.0;

/// Seconds of the ray tracer's passes, and the standard error at their end as a share of the peak.
fn tracing(
    set: &ObservationSet,
    surface: &Surface,
    fit: &FitOptions,
    options: &AnalysisOptions,
) -> Option<(f64, Option<f64>)> {
    let (eta, k) = set.material.index();
    let values = Values {
        theta_r: surface.theta_r,
        alpha_u: surface.alpha_u,
        alpha_v: surface.alpha_v,
        rho_d: surface.rho_d,
        scale: 1.0,
        background: 0.0,
        azimuth_offset: 0.0,
        tilt_offset: 0.0,
        eta,
        k,
    };
    let ridged = ridged_surface(set, &values, options.profile.as_ref())?;
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
    fn a_run_is_forecast_only_while_there_is_patience() {
        let text =
            "[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }\n[run]\nphotons = 40_000\n";
        let scene = crate::trace::scene::Scene::parse(text).unwrap();
        let prepared = scene.prepare(&|_| Err(String::new())).unwrap();
        let told = |seconds, cancelled| {
            let cancel = &AtomicBool::new(cancelled);
            of_run(&prepared, None, Patience { seconds, cancel })
        };
        assert_eq!(told(f64::INFINITY, true), None);
        assert_eq!(told(0.0, false), None);
        let forecast = told(f64::INFINITY, false).unwrap();
        assert_eq!(forecast.amount.as_ref().unwrap().count, 40_000);
        assert!(!forecast.at_most && forecast.seconds > 0.0, "{forecast:?}");
    }

    #[test]
    fn a_series_is_forecast_from_all_its_calibrations_and_a_sixth_of_its_poses() {
        let series = Series::open("tests/data/series/paper-rig-full".as_ref()).unwrap();
        let thinned = Thinned::new(&series, THINNED);
        let count = |rows: &[FrameRow], sample: bool| {
            let kind = |r: &&FrameRow| (r.kind == FrameKind::Sample) == sample;
            rows.iter().filter(kind).count()
        };
        let (all, some) = (FrameSource::rows(&series), thinned.rows());
        assert_eq!(count(all, false), count(some, false));
        assert!(
            count(some, true) * THINNED >= count(all, true)
                && count(some, true) < count(all, true) / 3
        );
        // What is read is what its row says.
        for (place, row) in some.iter().enumerate() {
            assert_eq!(row.file, all[thinned.places[place]].file);
        }
        let told = of_series(&series, &AtomicBool::new(false)).unwrap();
        assert!(told.part(READ) > 0.0 && told.part(FIT) > 0.0);
        assert!((told.seconds - told.part(READ) - told.part(FIT)).abs() < 1e-12);
        assert_eq!(told.part(TRACE), 0.0);
        let alone = of_reduction(&series, None, &AtomicBool::new(false)).unwrap();
        assert!(alone.seconds > 0.0 && alone.parts.len() == 1);
    }

    #[test]
    fn what_a_fit_is_asked_for_is_forecast_and_a_limit_cuts_it() {
        let series = Series::open("tests/data/series/paper-rig-full".as_ref()).unwrap();
        let mut options = AnalysisOptions::default();
        options.fit.variant = VariantChoice::Traced;
        options.fit.tracer.paths = 64;
        options.fit.bootstrap = 20;
        options.fit.starts = 1;
        let told = |options: &AnalysisOptions| {
            of_analysis(&series, options, &AtomicBool::new(false)).unwrap()
        };
        let all = told(&options);
        assert!(all.part(TRACE) > 0.0 && all.part(BOOTSTRAP) > 0.0, "{all}");
        assert!(all.error.as_ref().unwrap().value > 0.0 && !all.cut_short);
        options.max_seconds = Some(1e-6);
        let cut = told(&options);
        assert!(cut.cut_short && cut.seconds < cut.parts.iter().map(|p| p.seconds).sum());
    }
}
