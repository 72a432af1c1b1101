//! How long a trace or a fit will take, told before it starts, from short runs of it.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use serde::Serialize;

use super::fits::painted;
use crate::fit::{FitOptions, fit};
use crate::frame::{Frame, FrameKind};
use crate::geometry::Pose;
use crate::model::Surface;
use crate::reduction::{FrameReadError, FrameSource, reduce};
use crate::series::{FrameRow, Manifest};
use crate::trace::run::{Shard, trace_photons};
use crate::trace::scene::Prepared;

/// What a run will take.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Forecast {
    /// Seconds, start included.
    pub seconds: f64,
    /// Whether `seconds` is a bound, not an estimate: one short run alone was waited for, and its start
    /// cannot be told from its photons.
    pub at_most: bool,
    /// Photons that it will trace.
    pub photons: u64,
    /// Relative error of the reflected bins (root mean square) at its end.
    pub relative_error: Option<f64>,
}

impl std::fmt::Display for Forecast {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} {:.1} s for {} photons",
            if self.at_most { "at most" } else { "about" },
            self.seconds,
            self.photons
        )?;
        match self.relative_error {
            Some(error) => write!(f, ", error of a reflected bin about {:.2} %", 100.0 * error),
            None => Ok(()),
        }
    }
}

/// Share of the run that the larger of the two short runs takes.
const SHARE: u64 = 32;

/// The same of a third run, where the start takes most of the time of both.
const LONGER_SHARE: u64 = 8;

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
    let little = better(small)?;
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
    let photons = match (target_error, known.error) {
        (Some(target), Some(error)) => {
            let needed = known.photons as f64 * (error / target).powi(2);
            // Blocks are whole: a run ends at the first one whose error is small enough.
            (needed as u64).clamp(1, prepared.photons)
        }
        _ => prepared.photons,
    };
    Some(Forecast {
        seconds: start + per_photon * photons as f64,
        at_most: upper.photons == little.photons,
        photons,
        relative_error: known
            .error
            .map(|e| e * (known.photons as f64 / photons as f64).sqrt()),
    })
}

/// What the analysis of a series will take.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SeriesForecast {
    /// Seconds in all.
    pub seconds: f64,
    /// Of these, reading and reducing frames.
    pub reduce_s: f64,
    /// Of these, the fit of all variants.
    pub fit_s: f64,
}

impl std::fmt::Display for SeriesForecast {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "about {:.1} s: {:.1} s to read and reduce, {:.1} s to fit",
            self.seconds, self.reduce_s, self.fit_s
        )
    }
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

/// Forecasts the analysis of a series: a sixth of its poses are read and reduced, and a surface as samples have
/// it is fitted at all of its poses. `None` where those frames give no observations.
#[must_use]
pub fn of_series(source: &dyn FrameSource, cancel: &AtomicBool) -> Option<SeriesForecast> {
    let manifest = source.manifest();
    let region = manifest.sample.layout.as_ref().map(|_| "even");
    let thinned = Thinned::new(source, THINNED);
    let started = Instant::now();
    reduce(&thinned, region, cancel).ok()?;
    let share = source.rows().len() as f64 / thinned.rows.len().max(1) as f64;
    let reduce_s = share * started.elapsed().as_secs_f64();
    let mut poses: Vec<Pose> = source
        .rows()
        .iter()
        .filter(|r| r.kind == FrameKind::Sample)
        .map(FrameRow::pose)
        .collect();
    poses.dedup();
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
    let started = Instant::now();
    std::hint::black_box(fit(&set, &FitOptions::default(), cancel));
    let fit_s = started.elapsed().as_secs_f64();
    Some(SeriesForecast {
        seconds: reduce_s + fit_s,
        reduce_s,
        fit_s,
    })
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
        assert_eq!(forecast.photons, 40_000);
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
        assert!(told.reduce_s > 0.0 && told.fit_s > 0.0);
        assert!((told.seconds - told.reduce_s - told.fit_s).abs() < 1e-12);
    }
}
