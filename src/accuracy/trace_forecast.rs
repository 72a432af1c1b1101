//! Estimates the duration of a trace from short runs of it, before it starts.
//!
//! [`of_run`] is for one run of a scene, [`of_runs`] for several similar ones (angles, wavelengths).

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock};
use std::time::Instant;

use crate::forecast::Forecast;
use crate::trace::run::{self, Follow, Shard, trace_few, trace_photons};
use crate::trace::scene::PreparedScene;

/// The larger of the two short runs has one photon in this many.
const SHARE: u64 = 32;
/// A third run, where the start dominates both, has one photon in this many.
const LONGER_SHARE: u64 = 8;
/// Photons of two runs so short that they omit the start of a longer one. They have as many batches as a longer one, and a
/// batch takes some time however few photons it has.
const FEW: (u64, u64) = (64, 1024);
/// Number of runs that are tried, of several; the others are interpolated.
const TRIED: usize = 3;

/// A run to forecast.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TraceExtent {
    /// What its paths carry.
    pub follow: Follow,
    /// Relative error at which it ends; without it, it ends with its last photon.
    pub target_error: Option<f64>,
}

impl TraceExtent {
    /// All photons of the scene, with the scene's polarisation.
    pub const ALL: TraceExtent = TraceExtent {
        follow: Follow::Scene,
        target_error: None,
    };
}

/// The time that a forecast itself may take.
#[derive(Debug, Clone, Copy)]
pub struct Patience<'a> {
    /// Seconds after which the forecast is made from the results so far.
    pub seconds: f64,
    /// Ends the forecast at once.
    pub cancel: &'a AtomicBool,
}

/// Longest time of a forecast, s.
const USUAL_S: f64 = 3.0;
/// Longest time of a forecast, as a share of the time limit of the run.
const USUAL_SHARE: f64 = 0.1;

impl<'a> Patience<'a> {
    /// The default for a run with this time limit.
    #[must_use]
    pub fn usual(max_seconds: Option<f64>, cancel: &'a AtomicBool) -> Patience<'a> {
        let share = max_seconds.map_or(f64::INFINITY, |max_s| USUAL_SHARE * max_s);
        let seconds = share.min(USUAL_S);
        Patience { seconds, cancel }
    }

    /// Whether time is left for work that began at `started`.
    fn lasts(&self, started: Instant) -> bool {
        !self.cancel.load(Ordering::Relaxed) && started.elapsed().as_secs_f64() < self.seconds
    }
}

/// One short run: photons traced, seconds until the first of them were done, their number, seconds in total, relative
/// error.
#[derive(Debug, Clone, Copy)]
struct TrialRun {
    photons: u64,
    start_s: f64,
    at_start: u64,
    seconds: f64,
    error: Option<f64>,
}

impl TrialRun {
    /// Seconds per photon from this run alone. `batches_s` is the time of empty batches; `None` where no time is left.
    fn per_photon(&self, batches_s: f64) -> Option<f64> {
        let photons = self.photons.saturating_sub(self.at_start);
        let seconds = self.seconds - self.start_s - batches_s;
        (photons > 0 && seconds > 0.0).then(|| seconds / photons as f64)
    }

    /// Seconds per photon from the difference to a run of fewer photons. Where other work on the machine hides the
    /// difference, an upper bound from the time after the start.
    fn pace_beyond(&self, fewer: &TrialRun) -> f64 {
        let seconds = self.seconds - fewer.seconds;
        if self.photons > fewer.photons && seconds > 0.0 {
            return seconds / (self.photons - fewer.photons) as f64;
        }
        let all = self.seconds / self.photons.max(1) as f64;
        self.per_photon(0.0).unwrap_or(all)
    }
}

/// Progress of the preparation of a surface before the first photon: share and seconds, of the first and last report.
#[derive(Debug, Default)]
struct PreparationPace(Mutex<Option<[(f64, f64); 2]>>);

impl PreparationPace {
    /// Records the finished share.
    fn at(&self, share: f64, seconds: f64) {
        let mut marks = self.0.lock().expect("no holder of this lock panics");
        match marks.as_mut() {
            Some([_, last]) if share > last.0 => *last = (share, seconds),
            Some(_) => {}
            None => *marks = Some([(share, seconds); 2]),
        }
    }

    /// Estimated seconds of the whole preparation, from its pace since the first report; `spent_s` without a second report.
    fn whole_s(&self, spent_s: f64) -> f64 {
        let marks = self.0.lock().expect("no holder of this lock panics");
        match *marks {
            Some([(from, begun_s), (to, seconds)]) if to > from => {
                begun_s + (1.0 - from) * (seconds - begun_s) / (to - from)
            }
            _ => spent_s,
        }
    }
}

/// A run without the start of a longer one; `None` where the time ends before a photon is counted.
fn few(
    prepared: &PreparedScene,
    asked: TraceExtent,
    photons: u64,
    patience: Patience<'_>,
) -> Option<TrialRun> {
    let started = Instant::now();
    let photons = photons.min(prepared.photons);
    let totals = trace_few(prepared, asked.follow, photons, &|| patience.lasts(started));
    (totals.photons() > 0).then(|| TrialRun {
        photons: totals.photons(),
        start_s: 0.0,
        at_start: 0,
        seconds: started.elapsed().as_secs_f64(),
        error: totals.relative_error(),
    })
}

/// Forecasts a run of the scene's photons, or of the number that the target error needs, if that is smaller.
///
/// Two short runs separate the cost of the start (shapes, first hits) from the cost of a photon. The
/// error falls with the root of the photons once the relevant bins have been hit. Where the time ends
/// early, the forecast uses the runs so far; it is `None` without any.
///
/// Where the time ends during the preparation of the surface, the forecast is an upper bound: the beginning of a
/// preparation, and photons without one, are the costliest.
#[must_use]
pub fn of_run(
    prepared: &PreparedScene,
    asked: TraceExtent,
    patience: Patience<'_>,
) -> Option<Forecast> {
    if patience.cancel.load(Ordering::Relaxed) || patience.seconds <= 0.0 {
        return None;
    }
    // The run that follows does not repeat what a surface computes once and keeps.
    few(prepared, asked, FEW.0, patience)?;
    let large = (prepared.photons / SHARE)
        .clamp(1_000, 500_000)
        .min(prepared.photons);
    let small = (large / 4).max(1);
    let begun = Instant::now();
    let looked = PreparationPace::default();
    let go_on = || patience.lasts(begun);
    let timed = |photons: u64| -> Option<TrialRun> {
        if !go_on() {
            return None;
        }
        let started = Instant::now();
        let first = OnceLock::new();
        let totals = trace_photons(prepared, asked.follow, photons, Shard::WHOLE, &|p| {
            match p.surface_analysis {
                Some(share) => looked.at(share, started.elapsed().as_secs_f64()),
                None => {
                    first.get_or_init(|| (started.elapsed().as_secs_f64(), p.photons));
                }
            }
            go_on()
        });
        // A run that is stopped during the preparation has no pace yet.
        let (start_s, at_start) = first.get().copied()?;
        (totals.photons() > 0).then(|| TrialRun {
            photons: totals.photons(),
            start_s,
            at_start,
            seconds: started.elapsed().as_secs_f64(),
            error: totals.relative_error(),
        })
    };
    // The faster of two: other work on the machine only adds time.
    let better = |photons: u64| {
        let first = timed(photons)?;
        let again = timed(photons).filter(|again| again.photons == first.photons);
        Some(
            again
                .filter(|again| again.seconds < first.seconds)
                .unwrap_or(first),
        )
    };
    let Some(little) = better(small) else {
        let spent_s = begun.elapsed().as_secs_f64();
        let forecast = of_slow_start(prepared, looked.whole_s(spent_s), asked, patience)?;
        return Some(Forecast {
            at_most: true,
            ..forecast
        });
    };
    let more = better(large).filter(|more| more.photons > little.photons);
    let known = more.unwrap_or(little);
    // Where the start dominates, the difference of two short runs is inaccurate; a longer run is added.
    let longer = (prepared.photons / LONGER_SHARE).max(large);
    let upper = match more {
        Some(more) if more.seconds < 1.5 * little.seconds && longer > large => timed(longer)
            .filter(|upper| upper.photons > more.photons)
            .unwrap_or(more),
        _ => known,
    };
    let per_photon = if upper.photons > little.photons {
        upper.pace_beyond(&little)
    } else {
        // From one run alone, the time of empty batches is subtracted.
        let none = few(prepared, asked, FEW.0, patience)?;
        match little.per_photon(none.seconds) {
            Some(per_photon) => per_photon,
            None => return of_slow_start(prepared, little.start_s, asked, patience),
        }
    };
    let start = (upper.seconds - per_photon * upper.photons as f64).max(0.0);
    Some(forecast_of(prepared, asked, &known, start, per_photon))
}

/// Forecasts a run whose start takes `start_s`, longer than the forecast may take: a few photons without the start give the
/// cost of one.
fn of_slow_start(
    prepared: &PreparedScene,
    start_s: f64,
    asked: TraceExtent,
    patience: Patience<'_>,
) -> Option<Forecast> {
    if patience.cancel.load(Ordering::Relaxed) {
        return None;
    }
    let little = few(prepared, asked, FEW.0, patience)?;
    // Photons may be so costly that the few use all of the time.
    let more = few(prepared, asked, FEW.1, patience).unwrap_or(little);
    let per_photon = more.pace_beyond(&little);
    Some(forecast_of(prepared, asked, &more, start_s, per_photon))
}

/// The forecast of a run with these seconds for the start and per photon.
fn forecast_of(
    prepared: &PreparedScene,
    asked: TraceExtent,
    known: &TrialRun,
    start: f64,
    per_photon: f64,
) -> Forecast {
    let (photons, error) = until_target(prepared, known, asked.target_error);
    let traced = match asked.target_error {
        Some(_) => run::traced_until(prepared.photons, photons),
        None => photons,
    };
    Forecast::about(start + per_photon * traced as f64)
        .for_work(photons, "photons")
        .to_error(error, "a reflected bin")
}

/// Photons after which a run stops, and its error then, from a shorter run.
fn until_target(
    prepared: &PreparedScene,
    known: &TrialRun,
    target_error: Option<f64>,
) -> (u64, Option<f64>) {
    let photons = match (target_error, known.error) {
        (Some(target), Some(error)) => {
            let needed = known.photons as f64 * (error / target).powi(2);
            let least = run::CHECK_INTERVAL.min(prepared.photons);
            (needed as u64).clamp(least, prepared.photons)
        }
        _ => prepared.photons,
    };
    let error = known
        .error
        .map(|e| e * (known.photons as f64 / photons as f64).sqrt());
    (photons, error)
}

/// Forecasts `count` runs, each prepared by `make` from its number; preparation counts. Up to three are tried,
/// evenly spread, and the others are assumed to cost their mean.
#[must_use]
pub fn of_runs(
    count: usize,
    make: &dyn Fn(usize) -> Option<PreparedScene>,
    asked: TraceExtent,
    patience: Patience<'_>,
) -> Option<Forecast> {
    let tried = count.min(TRIED);
    let begun = Instant::now();
    let mut found: Vec<Forecast> = Vec::new();
    for n in 0..tried {
        let left = patience.seconds - begun.elapsed().as_secs_f64();
        let started = Instant::now();
        let Some(prepared) = (left > 0.0)
            .then(|| make(n * (count - 1) / (tried - 1).max(1)))
            .flatten()
        else {
            break;
        };
        let made_s = started.elapsed().as_secs_f64();
        let patience = Patience {
            seconds: (left - made_s) / (tried - n) as f64,
            ..patience
        };
        let Some(forecast) = of_run(&prepared, asked, patience) else {
            break;
        };
        found.push(Forecast {
            seconds: made_s + forecast.seconds,
            ..forecast
        });
    }
    let at_most = found.iter().any(|f| f.at_most);
    let share = count as f64 / found.len() as f64;
    let seconds = share * found.iter().map(|f| f.seconds).sum::<f64>();
    let counted = found.iter().filter_map(|f| f.amount.as_ref());
    let photons = share * counted.map(|a| a.count as f64).sum::<f64>();
    let first = found.into_iter().next()?;
    let forecast = Forecast {
        seconds,
        at_most,
        ..first
    };
    Some(forecast.for_work(photons as u64, "photons"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_look_takes_what_it_takes_to_begin_and_then_goes_at_its_pace() {
        let looked = PreparationPace::default();
        assert_eq!(looked.whole_s(0.7), 0.7);
        looked.at(0.0, 0.5);
        assert_eq!(looked.whole_s(0.7), 0.7);
        for (share, seconds) in [(0.25, 1.0), (0.125, 1.1), (0.5, 1.5)] {
            looked.at(share, seconds);
        }
        assert_eq!(looked.whole_s(2.0), 0.5 + 2.0);
    }

    #[test]
    fn a_difference_lost_in_other_work_does_not_make_photons_free() {
        let trial = |photons, seconds| TrialRun {
            photons,
            start_s: 0.5,
            at_start: 0,
            seconds,
            error: None,
        };
        let little = trial(1_000, 1.0);
        assert_eq!(trial(5_000, 3.0).pace_beyond(&little), 2.0 / 4_000.0);
        assert_eq!(trial(5_000, 0.9).pace_beyond(&little), 0.4 / 5_000.0);
        // All of it was the start.
        assert_eq!(trial(5_000, 0.5).pace_beyond(&little), 0.5 / 5_000.0);
    }

    #[test]
    fn a_run_is_forecast_only_while_there_is_patience() {
        let text =
            "[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }\n[run]\nphotons = 40_000\n";
        let scene = crate::trace::scene::Scene::parse(text).unwrap();
        let prepared = scene.prepare(&|_| Err(String::new())).unwrap();
        let reported = |seconds, cancelled| {
            let cancel = &AtomicBool::new(cancelled);
            of_run(&prepared, TraceExtent::ALL, Patience { seconds, cancel })
        };
        assert_eq!(reported(f64::INFINITY, true), None);
        assert_eq!(reported(0.0, false), None);
        let forecast = reported(f64::INFINITY, false).unwrap();
        assert_eq!(forecast.amount.as_ref().unwrap().count, 40_000);
        assert!(!forecast.at_most && forecast.seconds > 0.0, "{forecast:?}");
    }

    #[test]
    fn a_run_whose_look_at_its_surface_outlasts_all_patience_is_bounded_not_estimated() {
        let text = "[light]\ntheta_i_deg = 60.0\n[[interface]]\nshape = \"beckmann\"\nalpha_u = 0.3\nalpha_v = 0.3\n\
                    cells = 400\nbelow = { n = 1.5 }\n[run]\nphotons = 4_000_000\n";
        let scene = crate::trace::scene::Scene::parse(text).unwrap();
        let prepared = scene.prepare(&|_| Err(String::new())).unwrap();
        let cancel = &AtomicBool::new(false);
        // A look at 320,000 triangles takes many times this; the first photons do not.
        let reported = |seconds| of_run(&prepared, TraceExtent::ALL, Patience { seconds, cancel });
        let forecasts: Vec<Forecast> = [0.001, 0.003].into_iter().filter_map(reported).collect();
        assert!(!forecasts.is_empty());
        for reported in forecasts {
            assert!(
                reported.at_most && reported.to_string().starts_with("at most"),
                "{reported}"
            );
        }
    }

    #[test]
    fn runs_alike_cost_their_making_too_and_those_not_tried_the_mean() {
        let text =
            "[[interface]]\nshape = \"flat\"\nbelow = { n = 1.5 }\n[run]\nphotons = 40_000\n";
        let scene = crate::trace::scene::Scene::parse(text).unwrap();
        let made = std::cell::RefCell::new(Vec::new());
        let make = |n: usize| {
            made.borrow_mut().push(n);
            scene.prepare(&|_| Err(String::new())).ok()
        };
        let cancel = &AtomicBool::new(false);
        let seconds = f64::INFINITY;
        let asked = TraceExtent {
            follow: Follow::Both,
            target_error: None,
        };
        let reported = of_runs(9, &make, asked, Patience { seconds, cancel }).unwrap();
        assert_eq!(*made.borrow(), [0, 4, 8]);
        assert!(reported.seconds > 0.0 && !reported.at_most, "{reported:?}");
        assert_eq!(reported.amount.as_ref().unwrap().count, 9 * 40_000);
    }
}
