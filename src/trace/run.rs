//! A run: traces photons in batches on all cores, until a stop condition is met.
//!
//! Call [`trace`], or [`resume`] to continue an earlier run. Batches are large, so that strata are
//! effective; a run that may stop before several batches are finished also produces a preview of
//! small replicates (`preview`).

mod sketch;

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rayon::prelude::*;

use super::grid::Grid;
use super::launch::FirstHits;
use super::light::{Light, Polarised, Scalar};
use super::paired::Paired;
use super::plane::directions;
use super::rng::{Purpose, Stream};
use super::scene::Prepared;
use super::tally::{Batch, Totals};
use super::walk::{Method, Waiting, Walk, worth_splitting};
use sketch::Sketch;

/// Part of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// 1 to `of`.
    pub number: u64,
    /// Number of parts.
    pub of: u64,
}

impl Shard {
    /// The whole run.
    pub const WHOLE: Shard = Shard { number: 1, of: 1 };

    /// Checks that every part of a run with this number of photons has photons.
    ///
    /// # Errors
    /// The largest number of parts of the run.
    pub fn check(self, photons: u64) -> Result<(), u64> {
        let most = batches(photons);
        if self.of <= most { Ok(()) } else { Err(most) }
    }

    /// Numbers of its batches in a run with this number of photons.
    fn batches(self, photons: u64) -> impl Iterator<Item = u64> {
        (0..batches(photons)).filter(move |batch| batch % self.of == self.number - 1)
    }
}

/// Time limit of a run, on the caller's clock.
#[derive(Debug, Clone, Copy)]
pub struct TimeLimit {
    /// Seconds from the start of the run.
    pub seconds: f64,
    /// Seconds since a fixed moment.
    pub now_s: fn() -> f64,
}

/// Whether a run may end before its last photon.
#[derive(Debug, Clone, Copy)]
pub enum Ending {
    /// A limit on error or time may end the run at any moment. The photons traced until then must
    /// be a result, so some of the first photons may be traced only for that.
    AnyTime,
    /// As `AnyTime`, with a known time limit: a surface analysis that would take most of the time
    /// is abandoned in favour of photons that do not need it.
    Within(TimeLimit),
    /// All photons are wanted; a stop is exceptional.
    AtLast,
}

impl Ending {
    /// The policy of a run with an optional time limit on a clock and an optional target error.
    #[must_use]
    pub fn of(seconds: Option<f64>, now_s: fn() -> f64, target_error: Option<f64>) -> Self {
        match (seconds, target_error) {
            (Some(seconds), _) => Ending::Within(TimeLimit { seconds, now_s }),
            (None, Some(_)) => Ending::AnyTime,
            (None, None) => Ending::AtLast,
        }
    }
}

/// The light that every path of a run carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Follow {
    /// Polarised or scalar light, as the scene requires.
    Scene,
    /// Both, for their difference ([`Paired`]).
    Both,
}

/// The finished part of a run: everything needed to continue it. If a whole run was stopped before
/// its batches are more accurate, it contains the preview instead: separate photons in smaller
/// replicates, which are not part of the run.
#[derive(Debug, Clone, PartialEq)]
pub struct SoFar {
    /// The counted light.
    pub totals: Totals,
    /// Numbers of the finished batches, ascending; empty for a preview.
    pub batches: Vec<u64>,
}

impl SoFar {
    /// Restores a stored shard of a run with this number of photons; `None` if it does not match:
    /// batches that the shard does not have, or another number of photons.
    #[must_use]
    pub fn kept(totals: Totals, batches: Vec<u64>, photons: u64, shard: Shard) -> Option<Self> {
        if batches.is_empty() {
            // A preview is a result, but not part of the run.
            let totals = Totals::new(totals.grid(), totals.elements());
            return Some(SoFar { totals, batches });
        }
        let count = self::batches(photons);
        let known = |batch: &u64| *batch < count && batch % shard.of == shard.number - 1;
        let rising = batches.windows(2).all(|pair| pair[0] < pair[1]);
        if !(rising && batches.iter().all(known)) {
            return None;
        }
        let traced: u64 = batches.iter().map(|b| share(photons, count, *b)).sum();
        (traced == totals.photons()).then_some(SoFar { totals, batches })
    }

    /// Whether a shard of a run with this number of photons is finished.
    #[must_use]
    pub fn is_complete(&self, photons: u64, shard: Shard) -> bool {
        self.batches.len() == shard.batches(photons).count()
    }
}

/// Progress of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Finished fraction of the surface analysis that precedes the first photon; `None` once
    /// photons are traced.
    pub look: Option<f64>,
    /// Photons traced so far.
    pub photons: u64,
    /// Photons that will be traced unless the run is stopped.
    pub photons_planned: u64,
    /// [`Totals::relative_error`] of these photons, updated from time to time.
    pub relative_error: Option<f64>,
}

/// Least number of batches: independent replicates, so that standard errors are known to 9 %. More
/// batches would be smaller, and strata are effective only if there are several per triangle.
const BATCHES_MIN: u64 = 64;
/// Largest batch: the photons that each thread loses at most when a run is stopped.
const BATCH_MAX: u64 = 1 << 20;
/// Largest fraction of a limited time for the surface analysis.
const LOOK_LIMIT_SHARE: f64 = 0.5;
/// Largest fraction of that time for the first part of the analysis.
const LOOK_START: f64 = 0.1;
/// Photons between two checks of the stop conditions, and before the first estimate of the error.
pub const LOOK: u64 = 1 << 13;
/// Batches between two estimates of the error, if a target error may end the run.
const LOOK_BATCHES: usize = 4;
/// Batches between two estimates of the error, if it is only reported.
const LOOK_BATCHES_TOLD: usize = 16;

/// Number of batches of a run with this number of photons.
fn batches(photons: u64) -> u64 {
    BATCHES_MIN.max(photons.div_ceil(BATCH_MAX)).min(photons)
}

/// Number of photons in one batch.
fn share(photons: u64, batches: u64, number: u64) -> u64 {
    // 128 bits, because photons × batches may exceed 64.
    let until = |n: u64| (u128::from(photons) * u128::from(n) / u128::from(batches)) as u64;
    until(number + 1) - until(number)
}

/// Traces a shard of a scene. `proceed` is called from time to time, from any thread, and returns
/// whether to continue. After a stop, the finished batches count, or a preview of smaller ones if
/// they are too few ([`PartialRun`]). The result depends on the scene and on the finished work,
/// never on threads. [`PreparedScene::plane`] is ignored here because it takes time; use [`resume`]
/// or [`trace_following`].
pub fn trace(
    prepared: &Prepared,
    shard: Shard,
    proceed: &(dyn Fn(&Progress) -> bool + Sync),
) -> Totals {
    trace_photons(prepared, Follow::Scene, prepared.photons, shard, proceed)
}

/// As [`trace`], continuing from `before`. The result of all batches equals that of an
/// uninterrupted run bit for bit, whatever the stops.
///
/// # Panics
/// `before` has other bins than the scene.
pub fn resume(
    prepared: &Prepared,
    shard: Shard,
    before: Option<SoFar>,
    ending: Ending,
    proceed: &(dyn Fn(&Progress) -> bool + Sync),
) -> SoFar {
    let (grid, photons) = (prepared.grid, prepared.photons);
    let part = Part {
        shard,
        before,
        ending,
        plane: prepared.plane,
    };
    if prepared.polarised {
        resume_as::<Polarised>(prepared, grid, photons, part, proceed)
    } else {
        resume_as::<Scalar>(prepared, grid, photons, part, proceed)
    }
}

/// As [`trace`], with another number of photons than the scene's.
pub fn trace_photons(
    prepared: &Prepared,
    follow: Follow,
    photons: u64,
    shard: Shard,
    proceed: &(dyn Fn(&Progress) -> bool + Sync),
) -> Totals {
    let grid = prepared.grid;
    match follow {
        Follow::Both => trace_as::<Paired>(prepared, grid, photons, shard, proceed),
        Follow::Scene if prepared.polarised => {
            trace_as::<Polarised>(prepared, grid, photons, shard, proceed)
        }
        Follow::Scene => trace_as::<Scalar>(prepared, grid, photons, shard, proceed),
    }
}

/// Traces a whole run whose paths carry the given light; [`trace`] with a [`StopPolicy`].
pub fn trace_following(
    prepared: &Prepared,
    follow: Follow,
    ending: Ending,
    proceed: &(dyn Fn(&Progress) -> bool + Sync),
) -> Totals {
    let (grid, photons) = (prepared.grid, prepared.photons);
    let part = Part {
        ending,
        plane: prepared.plane,
        ..Part::ALL
    };
    let so_far = match follow {
        Follow::Both => resume_as::<Paired>(prepared, grid, photons, part, proceed),
        Follow::Scene if prepared.polarised => {
            resume_as::<Polarised>(prepared, grid, photons, part, proceed)
        }
        Follow::Scene => resume_as::<Scalar>(prepared, grid, photons, part, proceed),
    };
    so_far.totals
}

/// The same for any kind of light, bins and number of photons.
pub(super) fn trace_as<L: Light>(
    prepared: &Prepared,
    grid: Grid,
    photons: u64,
    shard: Shard,
    proceed: &(dyn Fn(&Progress) -> bool + Sync),
) -> Totals {
    let part = Part { shard, ..Part::ALL };
    resume_as::<L>(prepared, grid, photons, part, proceed).totals
}

/// The part of a run to trace.
struct Part {
    shard: Shard,
    before: Option<SoFar>,
    ending: Ending,
    /// Whether [`PreparedScene::plane`] applies.
    plane: bool,
}

impl Part {
    const ALL: Part = Part {
        shard: Shard::WHOLE,
        before: None,
        ending: Ending::AtLast,
        plane: false,
    };

    /// Time limit of the surface analysis; `None` if it must be finished in any case.
    fn look_limit(&self) -> Option<TimeLimit> {
        let whole = self.before.is_none() && self.shard.of == 1;
        match self.ending {
            Ending::Within(limit) if whole => Some(TimeLimit {
                seconds: LOOK_LIMIT_SHARE * limit.seconds,
                ..limit
            }),
            _ => None,
        }
    }

    /// Number of its photons in a run with this number of photons.
    fn planned(&self, photons: u64) -> u64 {
        let of = self.shard.batches(photons);
        of.map(|b| share(photons, batches(photons), b)).sum()
    }
}

fn resume_as<L: Light>(
    prepared: &Prepared,
    grid: Grid,
    photons: u64,
    part: Part,
    proceed: &(dyn Fn(&Progress) -> bool + Sync),
) -> SoFar {
    // A preview is never continued.
    let before = part.before.filter(|b| !b.batches.is_empty());
    let part = Part { before, ..part };
    let before = part.before.as_ref();
    let asked = Asked {
        proceed,
        photons: AtomicU64::new(before.map_or(0, |b| b.totals.photons())),
        photons_planned: part.planned(photons),
        stopped: AtomicBool::new(false),
    };
    let go_on = |_| asked.go_on();
    let walk = walk_of(prepared, &go_on);
    let limit = part.look_limit().map(|limit| ((limit.now_s)(), limit));
    let in_time = |share: f64| {
        limit.is_none_or(|(begun_s, TimeLimit { seconds, now_s })| {
            now_s() - begun_s <= (LOOK_START + (1.0 - LOOK_START) * share) * seconds
        })
    };
    let looked = FirstHits::new::<L>(&walk, grid, photons, &|share| {
        asked.tell(Some(share), None) && in_time(share)
    });
    let task = Task {
        walk: &walk,
        sketch_only: looked.is_err(),
        first_hits: looked.unwrap_or_default(),
        seed: prepared.seed,
        grid,
        plane: directions(grid, prepared.phi_i_deg())
            .filter(|_| part.plane)
            .map(|all| all.into_iter().map(|(_, bins)| bins).collect()),
        photons,
    };
    task.trace::<L>(part, &asked)
}

/// Traces a short run in its own bins without the analysis of every triangle, which is worth its
/// time only for thousands of photons. Runs with different `number` have independent random
/// numbers. Batches that `go_on` ends, given their work so far ([`TallyBatch::work`]), are left
/// out.
pub(super) fn trace_briefly<L: Light>(
    prepared: &Prepared,
    grid: Grid,
    photons: u64,
    number: u64,
    go_on: &(dyn Fn(u64) -> bool + Sync),
) -> Totals {
    // The multiplier is odd, so different numbers give different seeds.
    let apart = number.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let task = Task {
        walk: &walk_of(prepared, go_on),
        first_hits: None,
        sketch_only: false,
        seed: prepared.seed.wrapping_add(apart),
        grid,
        plane: None,
        photons,
    };
    let asked = Asked {
        proceed: &|_| true,
        photons: AtomicU64::new(0),
        photons_planned: photons,
        stopped: AtomicBool::new(false),
    };
    task.trace::<L>(Part::ALL, &asked).totals
}

/// Traces a short run to measure the cost of a photon, without the analysis of every triangle: its
/// photons cost slightly more than those of a run with it. Values that a surface computes once and
/// caches are available afterwards. `go_on` is called from time to time; if it returns false, fewer
/// photons, or none, are counted.
#[must_use]
pub fn trace_few(
    prepared: &Prepared,
    follow: Follow,
    photons: u64,
    go_on: &(dyn Fn() -> bool + Sync),
) -> Totals {
    let grid = prepared.grid;
    let go_on = |_| go_on();
    match follow {
        Follow::Both => trace_briefly::<Paired>(prepared, grid, photons, 0, &go_on),
        Follow::Scene if prepared.polarised => {
            trace_briefly::<Polarised>(prepared, grid, photons, 0, &go_on)
        }
        Follow::Scene => trace_briefly::<Scalar>(prepared, grid, photons, 0, &go_on),
    }
}

/// Number of photons that a run of `photons` traces in all if its error is small enough after
/// `needed` counted photons: photons of the preview are not part of the run, and the error is
/// estimated only from time to time.
#[must_use]
pub fn traced_until(photons: u64, needed: u64) -> u64 {
    let sketch = sketch::most(photons, Ending::AnyTime);
    if needed <= sketch {
        // Half of the photons traced between two estimates.
        return (needed + needed / (2 * sketch::LOOK_SHARE)).min(sketch);
    }
    let count = batches(photons);
    let looked = LOOK_BATCHES as u64 * photons.div_ceil(count).max(1);
    sketch + needed.div_ceil(looked).saturating_mul(looked).min(photons)
}

pub(super) fn walk_of<'a>(
    prepared: &'a Prepared,
    go_on: &'a (dyn Fn(u64) -> bool + Sync),
) -> Walk<'a> {
    Walk {
        stack: &prepared.stack,
        method: prepared.method,
        stokes: prepared.stokes,
        k: prepared.k,
        s: prepared.s,
        interactions_max: prepared.interactions_max,
        worth_splitting: worth_splitting(&prepared.stack),
        go_on,
    }
}

/// The callback that decides whether to continue, and whether it refused.
struct Asked<'a> {
    proceed: &'a (dyn Fn(&Progress) -> bool + Sync),
    photons: AtomicU64,
    photons_planned: u64,
    stopped: AtomicBool,
}

impl Asked<'_> {
    fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }

    /// Reports the photons so far and further progress; returns `false` from the first refusal on.
    fn tell(&self, look: Option<f64>, relative_error: Option<f64>) -> bool {
        let progress = Progress {
            look,
            photons: self.photons.load(Ordering::Relaxed),
            photons_planned: self.photons_planned,
            relative_error,
        };
        if !(self.proceed)(&progress) {
            self.stopped.store(true, Ordering::Relaxed);
        }
        !self.is_stopped()
    }

    /// Asks while photons are being traced.
    fn go_on(&self) -> bool {
        !self.is_stopped() && self.tell(None, None)
    }

    /// Adds counted photons.
    fn counted(&self, photons: u64) {
        self.photons.fetch_max(photons, Ordering::Relaxed);
    }
}

/// A run, ready to start.
struct Task<'a> {
    walk: &'a Walk<'a>,
    first_hits: Option<FirstHits<'a>>,
    /// Whether the surface analysis was abandoned: photons without it are not part of the run.
    sketch_only: bool,
    seed: u64,
    grid: Grid,
    /// Bins of the directions for which products are accumulated.
    plane: Option<Vec<Vec<usize>>>,
    photons: u64,
}

impl Task<'_> {
    /// Totals without photons.
    fn empty(&self, elements: usize) -> Totals {
        Totals::new(self.grid, elements)
            .with_directions(self.plane.clone())
            .of_layers(self.walk.stack.interfaces.len() > 1)
    }

    fn trace<L: Light>(&self, part: Part, asked: &Asked<'_>) -> SoFar {
        let (grid, photons) = (self.grid, self.photons);
        let count = batches(photons);
        let Part {
            shard,
            before,
            ending,
            ..
        } = part;
        let sketch = (before.is_none() && shard.of == 1).then(|| {
            let mut sketch = Sketch::<L>::new(self, ending);
            sketch.go_on(self, asked);
            sketch
        });
        // Stopped already: with many bins, empty totals alone take seconds.
        if let Some(sketch) = sketch.as_ref().filter(|s| s.photons() > 0)
            && asked.is_stopped()
        {
            return SoFar {
                totals: sketch.totals(self),
                batches: Vec::new(),
            };
        }
        let before = before.unwrap_or_else(|| SoFar {
            totals: self.empty(L::ELEMENTS),
            batches: Vec::new(),
        });
        assert!(
            before.totals.grid() == grid && before.totals.elements() == L::ELEMENTS,
            "what was done before has the scene's bins"
        );
        let left: Vec<u64> = shard
            .batches(photons)
            .filter(|batch| before.batches.binary_search(batch).is_err())
            .collect();
        let complete = before.batches.len() + left.len();
        let look_batches = match ending {
            Ending::AtLast => LOOK_BATCHES_TOLD,
            Ending::AnyTime | Ending::Within(_) => LOOK_BATCHES,
        };
        // The analytic part must still be added: that takes as long for one batch as for all, so it
        // is done once.
        let with_known = before.totals.photons();
        let counted = Mutex::new(before);
        let lock = || counted.lock().expect("no thread panics while it adds");
        // Empty batches are reused, one per thread, because allocating megabytes takes time.
        let spare = Mutex::new(Vec::new());
        let spare = || spare.lock().expect("no thread panics while it takes one");
        left.par_iter().with_max_len(1).for_each(|&number| {
            if self.sketch_only || asked.is_stopped() {
                return;
            }
            let (mut batch, mut waiting) = spare()
                .pop()
                .unwrap_or_else(|| (Batch::new::<L>(grid), Waiting::none()));
            let share = share(photons, count, number);
            let go_on = |n: u64| !n.is_multiple_of(LOOK) || asked.go_on();
            let name = (Purpose::Photon, number);
            if !self.batch::<L>(name, share, &go_on, &mut waiting, &mut batch) {
                return;
            }
            let mut so_far = lock();
            so_far.totals.take(&mut batch, share);
            so_far.batches.push(number);
            let look = so_far.batches.len().is_multiple_of(look_batches);
            let totals = &so_far.totals;
            let known = self.first_hits.as_ref().map(|f| &f.known);
            let known = known.map(|known| (known, totals.photons() - with_known));
            // Until the batches are more accurate, the preview's photons count.
            asked.counted(totals.photons());
            let relative_error = look.then(|| totals.relative_error_with(known)).flatten();
            drop(so_far);
            spare().push((batch, waiting));
            asked.tell(None, relative_error);
        });
        let mut so_far = counted
            .into_inner()
            .expect("no thread panics while it adds");
        if let Some(first_hits) = &self.first_hits {
            let photons = so_far.totals.photons() - with_known;
            so_far.totals.include(&first_hits.known, photons);
        }
        so_far.batches.sort_unstable();
        let sketch = sketch.filter(|_| so_far.batches.len() < complete);
        match sketch.filter(|s| s.says_more_than(&so_far)) {
            Some(sketch) => SoFar {
                totals: sketch.totals(self),
                batches: Vec::new(),
            },
            None => so_far,
        }
    }

    /// Traces one batch with its own random numbers; `go_on` is called before each photon. Returns
    /// `false` if stopped; the batch is then invalid.
    fn batch<L: Light>(
        &self,
        (purpose, number): (Purpose, u64),
        photons: u64,
        go_on: &impl Fn(u64) -> bool,
        waiting: &mut Waiting<L>,
        batch: &mut Batch,
    ) -> bool {
        // A batch's photons are numbered within it: at most 2^20, with up to four times as many
        // starts.
        let stream = |n: u64| Stream::new(self.seed, purpose, (number << 24) + n);
        if let Some(first_hits) = &self.first_hits {
            return first_hits.batch::<L>(self.walk, photons, stream, go_on, waiting, batch);
        }
        for n in 0..photons {
            if !go_on(n) {
                return false;
            }
            let mut random = stream(n);
            let (x, y) = match self.walk.method {
                Method::Analog => (random.uniform(), random.uniform()),
                // A profile is constant along x.
                Method::Split => {
                    let y = (n as f64 + random.uniform()) / photons as f64;
                    (random.uniform(), y)
                }
            };
            self.walk.photon::<L>(x, y, &mut random, waiting, batch);
            if batch.given_up {
                return false;
            }
        }
        true
    }
}
