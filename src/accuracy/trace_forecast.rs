//! How long a trace will take, told before it starts, from short runs of it.
//!
//! [`of_run`] for one run of a scene, [`of_runs`] for several alike (angles, wavelengths).

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, OnceLock};
use std::time::Instant;

use crate::forecast::Forecast;
use crate::trace::run::{self, Follow, Shard, trace_few, trace_photons};
use crate::trace::scene::Prepared;

/// Share of the run that the larger of the two short runs takes.
const SHARE: u64 = 32;
/// The same of a third run, where the start takes most of the time of both.
const LONGER_SHARE: u64 = 8;
/// Photons of two runs so short that they do without the start of a longer one; in as many batches as those have, each
/// of which takes its time however few photons it has.
const FEW: (u64, u64) = (64, 1024);
/// Of several runs so many are tried; the others are taken to lie between them.
const TRIED: usize = 3;

/// What is asked of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Asked {
    /// What its paths carry.
    pub follow: Follow,
    /// Relative error at which it ends; with its last photon if not given.
    pub target_error: Option<f64>,
}

impl Asked {
    /// All photons of the scene, followed as it says.
    pub const ALL: Asked = Asked {
        follow: Follow::Scene,
        target_error: None,
    };
}

/// What a forecast itself may take.
#[derive(Debug, Clone, Copy)]
pub struct Patience<'a> {
    /// Seconds after which the forecast is made of what is known by then.
    pub seconds: f64,
    /// Ends it at once.
    pub cancel: &'a AtomicBool,
}

/// A run begins after so many seconds of forecasting, forecast or not,
const USUAL_S: f64 = 3.0;
/// and after this share of a limited time.
const USUAL_SHARE: f64 = 0.1;

impl<'a> Patience<'a> {
    /// What a forecast may take of the time that a run is allowed.
    #[must_use]
    pub fn usual(max_seconds: Option<f64>, cancel: &'a AtomicBool) -> Patience<'a> {
        let share = max_seconds.map_or(f64::INFINITY, |max_s| USUAL_SHARE * max_s);
        let seconds = share.min(USUAL_S);
        Patience { seconds, cancel }
    }

    /// Whether there is still some, for what began at `started`.
    fn lasts(&self, started: Instant) -> bool {
        !self.cancel.load(Ordering::Relaxed) && started.elapsed().as_secs_f64() < self.seconds
    }
}

/// One short run: photons traced, seconds until the first of them were done, photons by then, seconds in all, relative
/// error.
#[derive(Debug, Clone, Copy)]
struct Trial {
    photons: u64,
    start_s: f64,
    at_start: u64,
    seconds: f64,
    error: Option<f64>,
}

impl Trial {
    /// Seconds of a photon, of one run alone whose batches take `batches_s` without any; `None` where nothing is left.
    fn per_photon(&self, batches_s: f64) -> Option<f64> {
        let photons = self.photons.saturating_sub(self.at_start);
        let seconds = self.seconds - self.start_s - batches_s;
        (photons > 0 && seconds > 0.0).then(|| seconds / photons as f64)
    }

    /// Seconds of a photon, by how much longer it took than a run of fewer photons; where other work on the machine hid
    /// that, at most what all of it took after its start.
    fn pace_beyond(&self, fewer: &Trial) -> f64 {
        let seconds = self.seconds - fewer.seconds;
        if self.photons > fewer.photons && seconds > 0.0 {
            return seconds / (self.photons - fewer.photons) as f64;
        }
        let all = self.seconds / self.photons.max(1) as f64;
        self.per_photon(0.0).unwrap_or(all)
    }
}

/// How far the look at the surface has come that stands before a run's first photon: share and seconds, at first and last.
#[derive(Debug, Default)]
struct Looked(Mutex<Option<[(f64, f64); 2]>>);

impl Looked {
    /// A share of it is done.
    fn at(&self, share: f64, seconds: f64) {
        let mut marks = self.0.lock().expect("no holder of this lock panics");
        match marks.as_mut() {
            Some([_, last]) if share > last.0 => *last = (share, seconds),
            Some(_) => {}
            None => *marks = Some([(share, seconds); 2]),
        }
    }

    /// Seconds of all of it at its pace so far, which begins once it has begun: what a surface works out for it alone
    /// comes first. `spent_s` where it has no pace yet.
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

/// A run that does without the start of a longer one; `None` where patience ends before anything is counted.
fn few(prepared: &Prepared, asked: Asked, photons: u64, patience: Patience<'_>) -> Option<Trial> {
    let started = Instant::now();
    let photons = photons.min(prepared.photons);
    let totals = trace_few(prepared, asked.follow, photons, &|| patience.lasts(started));
    (totals.photons() > 0).then(|| Trial {
        photons: totals.photons(),
        start_s: 0.0,
        at_start: 0,
        seconds: started.elapsed().as_secs_f64(),
        error: totals.relative_error(),
    })
}

/// Forecasts a run of the scene's photons, or of as many as the target error needs (no more than those).
///
/// Where patience ends within the look at the surface it is a bound: the pace of the beginning of a look, and of photons
/// without one, are those of the costliest.
///
/// Two short runs part what a run costs at its start (shapes, first hits) from what a photon costs; the
/// error falls with the root of the photons once the bins that matter have been hit. Where patience ends
/// early the forecast is of the runs by then, and none where not even the first came to anything.
#[must_use]
pub fn of_run(prepared: &Prepared, asked: Asked, patience: Patience<'_>) -> Option<Forecast> {
    if patience.cancel.load(Ordering::Relaxed) || patience.seconds <= 0.0 {
        return None;
    }
    // What a surface computes once and keeps is no part of the run that follows.
    few(prepared, asked, FEW.0, patience)?;
    let large = (prepared.photons / SHARE)
        .clamp(1_000, 500_000)
        .min(prepared.photons);
    let small = (large / 4).max(1);
    let begun = Instant::now();
    let looked = Looked::default();
    let go_on = || patience.lasts(begun);
    let timed = |photons: u64| -> Option<Trial> {
        if !go_on() {
            return None;
        }
        let started = Instant::now();
        let first = OnceLock::new();
        let totals = trace_photons(prepared, asked.follow, photons, Shard::WHOLE, &|p| {
            match p.look {
                Some(share) => looked.at(share, started.elapsed().as_secs_f64()),
                None => {
                    first.get_or_init(|| (started.elapsed().as_secs_f64(), p.photons));
                }
            }
            go_on()
        });
        // Stopped before the look at the surface was over, a run has a sketch that tells nothing of its pace.
        let (start_s, at_start) = first.get().copied()?;
        (totals.photons() > 0).then(|| Trial {
            photons: totals.photons(),
            start_s,
            at_start,
            seconds: started.elapsed().as_secs_f64(),
            error: totals.relative_error(),
        })
    };
    // The better of two: other work on the machine only ever adds.
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
        let told = of_slow_start(prepared, looked.whole_s(spent_s), asked, patience)?;
        return Some(Forecast {
            at_most: true,
            ..told
        });
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
        upper.pace_beyond(&little)
    } else {
        // One run alone: its batches take their time too, and where they are all that it took it had hardly a photon.
        let none = few(prepared, asked, FEW.0, patience)?;
        match little.per_photon(none.seconds) {
            Some(per_photon) => per_photon,
            None => return of_slow_start(prepared, little.start_s, asked, patience),
        }
    };
    let start = (upper.seconds - per_photon * upper.photons as f64).max(0.0);
    Some(told(prepared, asked, &known, start, per_photon))
}

/// The same where patience ended before the start of a run was over, which takes `start_s`: a few photons without it tell
/// what one costs.
fn of_slow_start(
    prepared: &Prepared,
    start_s: f64,
    asked: Asked,
    patience: Patience<'_>,
) -> Option<Forecast> {
    if patience.cancel.load(Ordering::Relaxed) {
        return None;
    }
    let little = few(prepared, asked, FEW.0, patience)?;
    // Photons so costly that a few take as long as there is patience say enough.
    let more = few(prepared, asked, FEW.1, patience).unwrap_or(little);
    let per_photon = more.pace_beyond(&little);
    Some(told(prepared, asked, &more, start_s, per_photon))
}

/// The forecast of a run that costs so much to start and so much per photon.
fn told(prepared: &Prepared, asked: Asked, known: &Trial, start: f64, per_photon: f64) -> Forecast {
    let (photons, error) = until_target(prepared, known, asked.target_error);
    let traced = match asked.target_error {
        Some(_) => run::traced_until(prepared.photons, photons),
        None => photons,
    };
    Forecast::about(start + per_photon * traced as f64)
        .for_work(photons, "photons")
        .to_error(error, "a reflected bin")
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
            let least = run::LOOK.min(prepared.photons);
            (needed as u64).clamp(least, prepared.photons)
        }
        _ => prepared.photons,
    };
    let error = known
        .error
        .map(|e| e * (known.photons as f64 / photons as f64).sqrt());
    (photons, error)
}

/// Forecasts `count` runs that differ by what `make` makes of their number, which takes its time too: as many as
/// patience allows are tried, evenly spread, the others taken to cost what those do on average.
#[must_use]
pub fn of_runs(
    count: usize,
    make: &dyn Fn(usize) -> Option<Prepared>,
    asked: Asked,
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
        let Some(told) = of_run(&prepared, asked, patience) else {
            break;
        };
        found.push(Forecast {
            seconds: made_s + told.seconds,
            ..told
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
        let looked = Looked::default();
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
        let trial = |photons, seconds| Trial {
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
        let told = |seconds, cancelled| {
            let cancel = &AtomicBool::new(cancelled);
            of_run(&prepared, Asked::ALL, Patience { seconds, cancel })
        };
        assert_eq!(told(f64::INFINITY, true), None);
        assert_eq!(told(0.0, false), None);
        let forecast = told(f64::INFINITY, false).unwrap();
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
        let told = |seconds| of_run(&prepared, Asked::ALL, Patience { seconds, cancel });
        let told: Vec<Forecast> = [0.001, 0.003].into_iter().filter_map(told).collect();
        assert!(!told.is_empty());
        for told in told {
            assert!(
                told.at_most && told.to_string().starts_with("at most"),
                "{told}"
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
        let asked = Asked {
            follow: Follow::Both,
            target_error: None,
        };
        let told = of_runs(9, &make, asked, Patience { seconds, cancel }).unwrap();
        assert_eq!(*made.borrow(), [0, 4, 8]);
        assert!(told.seconds > 0.0 && !told.at_most, "{told:?}");
        assert_eq!(told.amount.as_ref().unwrap().count, 9 * 40_000);
    }
}
