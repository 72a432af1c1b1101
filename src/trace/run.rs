//! A run: photons in batches over all cores, until enough.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use super::grid::Grid;
use super::launch::FirstHits;
use super::light::{Light, Polarised, Scalar};
use super::paired::Paired;
use super::rng::{Purpose, Stream};
use super::scene::Prepared;
use super::tally::{Batch, Totals};
use super::walk::{Method, Waiting, Walk};

/// Which part of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// 1 to `of`.
    pub number: u64,
    /// How many parts.
    pub of: u64,
}

impl Shard {
    /// The whole run.
    pub const WHOLE: Shard = Shard { number: 1, of: 1 };

    /// Numbers of its batches, of a run of so many photons.
    fn batches(self, photons: u64) -> impl Iterator<Item = u64> {
        (0..batches(photons)).filter(move |batch| batch % self.of == self.number - 1)
    }
}

/// What was done of a run: all that is needed to go on with it. Where a whole run was stopped before its first batch was
/// finished it holds a sketch: photons of their own in smaller replicates, which are no part of the run.
#[derive(Debug, Clone, PartialEq)]
pub struct SoFar {
    /// What was counted.
    pub totals: Totals,
    /// Numbers of the finished batches, rising; none of a sketch.
    pub batches: Vec<u64>,
}

impl SoFar {
    /// What was kept of a shard of a run of so many photons; `None` where it cannot be that: batches that the
    /// shard does not have, or other photons than theirs.
    #[must_use]
    pub fn kept(totals: Totals, batches: Vec<u64>, photons: u64, shard: Shard) -> Option<Self> {
        if batches.is_empty() {
            // A sketch is a result, but no part of the run.
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

    /// Whether nothing is left to trace of a shard of a run of so many photons.
    #[must_use]
    pub fn is_complete(&self, photons: u64, shard: Shard) -> bool {
        self.batches.len() == shard.batches(photons).count()
    }
}

/// How far a run is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// Photons traced so far.
    pub photons: u64,
    /// Photons that will be traced if nothing stops it.
    pub photons_planned: u64,
    /// [`Totals::relative_error`] so far, looked at from time to time.
    pub relative_error: Option<f64>,
}

/// Photons are dealt out in this many batches at least: as many independent replicates, so that standard errors are
/// known to 9 %. More of them would each be smaller, and strata pay only where there are several to a triangle.
const BATCHES_MIN: u64 = 64;
/// Largest batch: what is lost at most per thread when a run is stopped.
const BATCH_MAX: u64 = 1 << 20;
/// Replicates of a first sketch,
const SKETCH_BATCHES: u64 = 16;
/// the photons of each of its first round,
const SKETCH_PHOTONS: u64 = 1 << 9;
/// by how much a round is larger than the one before,
const SKETCH_GROWTH: u64 = 4;
/// and the share of a batch that all rounds take at most.
const SKETCH_SHARE: u64 = 8;
/// Photons between two looks at the stop conditions,
const LOOK: u64 = 1 << 13;
/// and batches between two looks at the error.
const LOOK_BATCHES: usize = 4;

/// In how many batches a run of so many photons is dealt out.
fn batches(photons: u64) -> u64 {
    BATCHES_MIN.max(photons.div_ceil(BATCH_MAX)).min(photons)
}

/// Photons of one batch.
fn share(photons: u64, batches: u64, number: u64) -> u64 {
    // 128 bits: photons × batches may pass 64.
    let until = |n: u64| (u128::from(photons) * u128::from(n) / u128::from(batches)) as u64;
    until(number + 1) - until(number)
}

/// Traces a shard of a scene. `proceed` is asked from time to time, from any thread, whether to go
/// on; the batches that are finished by then count, and before there is one a sketch of smaller ones ([`SoFar`]). The
/// result depends on the scene and on which batches
/// were finished, never on threads.
pub fn trace(
    prepared: &Prepared,
    shard: Shard,
    proceed: &(dyn Fn(&Progress) -> bool + Sync),
) -> Totals {
    trace_photons(prepared, prepared.photons, shard, proceed)
}

/// [`trace`], going on from what was done `before`. Whatever the stops, the result of all batches is that of one
/// run, bit by bit.
///
/// # Panics
/// Where `before` has other bins than the scene.
pub fn resume(
    prepared: &Prepared,
    shard: Shard,
    before: Option<SoFar>,
    proceed: &(dyn Fn(&Progress) -> bool + Sync),
) -> SoFar {
    let (grid, photons) = (prepared.grid, prepared.photons);
    if prepared.polarised {
        resume_as::<Polarised>(prepared, grid, photons, shard, before, proceed)
    } else {
        resume_as::<Scalar>(prepared, grid, photons, shard, before, proceed)
    }
}

/// [`trace`] with another number of photons than the scene's.
pub fn trace_photons(
    prepared: &Prepared,
    photons: u64,
    shard: Shard,
    proceed: &(dyn Fn(&Progress) -> bool + Sync),
) -> Totals {
    if prepared.polarised {
        trace_as::<Polarised>(prepared, prepared.grid, photons, shard, proceed)
    } else {
        trace_as::<Scalar>(prepared, prepared.grid, photons, shard, proceed)
    }
}

/// As [`trace`], but every path is followed with and without polarisation ([`Paired`]).
pub fn trace_paired(
    prepared: &Prepared,
    shard: Shard,
    proceed: &(dyn Fn(&Progress) -> bool + Sync),
) -> Totals {
    trace_as::<Paired>(prepared, prepared.grid, prepared.photons, shard, proceed)
}

/// The same for any kind of light, bins and number of photons.
pub(super) fn trace_as<L: Light>(
    prepared: &Prepared,
    grid: Grid,
    photons: u64,
    shard: Shard,
    proceed: &(dyn Fn(&Progress) -> bool + Sync),
) -> Totals {
    resume_as::<L>(prepared, grid, photons, shard, None, proceed).totals
}

fn resume_as<L: Light>(
    prepared: &Prepared,
    grid: Grid,
    photons: u64,
    shard: Shard,
    before: Option<SoFar>,
    proceed: &(dyn Fn(&Progress) -> bool + Sync),
) -> SoFar {
    let walk = walk_of(prepared);
    let task = Task {
        walk: &walk,
        first_hits: FirstHits::new::<L>(&walk, grid, photons),
        seed: prepared.seed,
        grid,
        photons,
        shard,
    };
    task.trace::<L>(before, proceed)
}

/// A short run in bins of its own that does without the look at every triangle, which pays for thousands of
/// photons only. Runs of another `number` have random numbers of their own.
pub(super) fn trace_briefly<L: Light>(
    prepared: &Prepared,
    grid: Grid,
    photons: u64,
    number: u64,
) -> Totals {
    // An odd multiplier: no two numbers share a seed.
    let apart = number.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let task = Task {
        walk: &walk_of(prepared),
        first_hits: None,
        seed: prepared.seed.wrapping_add(apart),
        grid,
        photons,
        shard: Shard::WHOLE,
    };
    task.trace::<L>(None, &|_| true).totals
}

fn walk_of(prepared: &Prepared) -> Walk<'_> {
    Walk {
        stack: &prepared.stack,
        method: prepared.method,
        stokes: prepared.stokes,
        k: prepared.k,
        s: prepared.s,
        interactions_max: prepared.interactions_max,
    }
}

/// What the threads of a run share.
struct Counted {
    so_far: SoFar,
    /// Photons whose known part is still to be added: that takes as long for one as for all.
    without_known: u64,
}

impl Counted {
    fn include(&mut self, first_hits: Option<&FirstHits<'_>>) {
        if let Some(first_hits) = first_hits {
            let photons = std::mem::take(&mut self.without_known);
            self.so_far.totals.include(&first_hits.known, photons);
        }
    }
}

/// A shard of a run, ready to start.
struct Task<'a> {
    walk: &'a Walk<'a>,
    first_hits: Option<FirstHits<'a>>,
    seed: u64,
    grid: Grid,
    photons: u64,
    shard: Shard,
}

impl Task<'_> {
    fn trace<L: Light>(
        &self,
        before: Option<SoFar>,
        proceed: &(dyn Fn(&Progress) -> bool + Sync),
    ) -> SoFar {
        let (grid, photons, shard) = (self.grid, self.photons, self.shard);
        let count = batches(photons);
        let planned = shard
            .batches(photons)
            .map(|b| share(photons, count, b))
            .sum();
        // Nobody goes on with a sketch.
        let before = before.filter(|b| !b.batches.is_empty());
        let fresh = before.is_none();
        let before = before.unwrap_or_else(|| SoFar {
            totals: Totals::new(grid, L::ELEMENTS),
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
        let sketch = if fresh && shard.of == 1 {
            self.sketch::<L>(&|| {
                proceed(&Progress {
                    photons: 0,
                    photons_planned: planned,
                    relative_error: None,
                })
            })
        } else {
            None
        };
        let counted = Mutex::new(Counted {
            so_far: before,
            without_known: 0,
        });
        let lock = || counted.lock().expect("no thread panics while it adds");
        let stopped = AtomicBool::new(false);
        // Empty batches are kept: one per thread is made, since megabytes take their time.
        let spare = Mutex::new(Vec::new());
        let spare = || spare.lock().expect("no thread panics while it takes one");
        left.par_iter().with_max_len(1).for_each(|&number| {
            if stopped.load(Ordering::Relaxed) {
                return;
            }
            let (mut batch, mut waiting) = spare()
                .pop()
                .unwrap_or_else(|| (Batch::new::<L>(grid), Waiting::none()));
            let share = share(photons, count, number);
            let at_start = Progress {
                photons: lock().so_far.totals.photons(),
                photons_planned: planned,
                relative_error: None,
            };
            let go_on = |n: u64| {
                if !n.is_multiple_of(LOOK) {
                    return true;
                }
                let go_on = !stopped.load(Ordering::Relaxed) && proceed(&at_start);
                if !go_on {
                    stopped.store(true, Ordering::Relaxed);
                }
                go_on
            };
            let name = (Purpose::Photon, number);
            if !self.batch::<L>(name, share, &go_on, &mut waiting, &mut batch) {
                return;
            }
            let mut counted = lock();
            counted.so_far.totals.take(&mut batch, share);
            counted.so_far.batches.push(number);
            counted.without_known += share;
            let look = counted.so_far.batches.len().is_multiple_of(LOOK_BATCHES);
            if look {
                counted.include(self.first_hits.as_ref());
            }
            let totals = &counted.so_far.totals;
            let progress = Progress {
                photons: totals.photons(),
                photons_planned: planned,
                relative_error: look.then(|| totals.relative_error()).flatten(),
            };
            drop(counted);
            spare().push((batch, waiting));
            if !proceed(&progress) {
                stopped.store(true, Ordering::Relaxed);
            }
        });
        let mut counted = counted
            .into_inner()
            .expect("no thread panics while it adds");
        counted.include(self.first_hits.as_ref());
        let mut so_far = counted.so_far;
        so_far.batches.sort_unstable();
        if so_far.batches.is_empty()
            && let Some(totals) = sketch
        {
            so_far.totals = totals;
        }
        so_far
    }

    /// A result for whoever stops before the first batch is finished, where that is many times as large: rounds of
    /// equal replicates, each larger than the one before, of which the last finished one counts. Its photons are none of
    /// the run's, so what the run counts does not depend on it.
    fn sketch<L: Light>(&self, go_on: &(dyn Fn() -> bool + Sync)) -> Option<Totals> {
        let least = share(self.photons, batches(self.photons), 0) / SKETCH_SHARE;
        let (mut size, mut spent) = (SKETCH_PHOTONS, 0);
        let mut sketch = None;
        while spent + SKETCH_BATCHES * size <= least {
            let round = self.round::<L>(spent, size, go_on);
            let whole = round.batches() == SKETCH_BATCHES;
            if round.batches() > 0 && (whole || sketch.is_none()) {
                sketch = Some(round);
            }
            if !whole {
                break;
            }
            spent += SKETCH_BATCHES * size;
            size *= SKETCH_GROWTH;
        }
        sketch
    }

    /// One round of a sketch: replicates of `size` photons each, named by the photons before them.
    fn round<L: Light>(&self, before: u64, size: u64, go_on: &(dyn Fn() -> bool + Sync)) -> Totals {
        let totals = Mutex::new(Totals::new(self.grid, L::ELEMENTS));
        let look = |photon: u64| !photon.is_multiple_of(SKETCH_PHOTONS) || go_on();
        let empty = || (Batch::new::<L>(self.grid), Waiting::none());
        (0..SKETCH_BATCHES as usize)
            .into_par_iter()
            .with_max_len(1)
            .for_each_init(empty, |(batch, waiting), n| {
                let name = (Purpose::Sketch, before / SKETCH_PHOTONS + n as u64);
                if self.batch::<L>(name, size, &look, waiting, batch) {
                    let mut totals = totals.lock().expect("no thread panics while it adds");
                    totals.take(batch, size);
                } else {
                    batch.clear();
                    *waiting = Waiting::none();
                }
            });
        let mut totals = totals.into_inner().expect("no thread panics while it adds");
        if let Some(first_hits) = &self.first_hits {
            let photons = totals.photons();
            totals.include(&first_hits.known, photons);
        }
        totals
    }

    /// One batch with random numbers of its own name; `go_on` is asked before each photon. `false` where it was told to stop: what is in the batch then
    /// is of no use.
    fn batch<L: Light>(
        &self,
        (purpose, number): (Purpose, u64),
        photons: u64,
        go_on: &impl Fn(u64) -> bool,
        waiting: &mut Waiting<L>,
        batch: &mut Batch,
    ) -> bool {
        // A batch's photons are numbered within it: 2^20 at most, and four times as many starts.
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
                // A profile is the same all along x.
                Method::Split => {
                    let y = (n as f64 + random.uniform()) / photons as f64;
                    (random.uniform(), y)
                }
            };
            self.walk.photon::<L>(x, y, &mut random, waiting, batch);
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::super::scene::Scene;
    use super::*;

    fn scene(interface: &str, photons: u64) -> Prepared {
        let text = format!(
            "[light]\ntheta_i_deg = 40.0\n[[interface]]\n{interface}\nbelow = {{ n = 1.5 }}\n[run]\n\
             photons = {photons}\ntheta_bins = 9\nphi_bins = 12\n"
        );
        let scene = Scene::parse(&text).unwrap();
        scene.prepare(&|_| Err(String::new())).unwrap()
    }

    #[test]
    fn a_run_stopped_before_its_first_batch_has_a_sketch_that_agrees_with_the_whole() {
        // Batches of 2^18 photons: far more than are traced before the stop.
        let ridges = |photons| {
            scene(
                "shape = \"ridges\"\ntheta_r_deg = 20.0\npitch_um = 50.0",
                photons,
            )
        };
        let long = ridges(1 << 24);
        let looks = std::sync::atomic::AtomicU64::new(0);
        let stopped = resume(&long, Shard::WHOLE, None, &|_| {
            looks.fetch_add(1, Ordering::Relaxed) < 40
        });
        assert_eq!(stopped.batches, Vec::<u64>::new());
        assert!(!stopped.is_complete(1 << 24, Shard::WHOLE));
        let totals = &stopped.totals;
        assert_eq!(totals.photons(), SKETCH_BATCHES * SKETCH_PHOTONS);
        let (few, many) = (
            totals.energies(),
            trace(&ridges(60_000), Shard::WHOLE, &|_| true).energies(),
        );
        for (a, b) in [
            (few.reflected_all, many.reflected_all),
            (few.transmitted_all, many.transmitted_all),
        ] {
            let std = a.std.hypot(b.std);
            assert!(
                a.std > 0.0 && (a.value - b.value).abs() < 4.5 * std,
                "{a:?} {b:?}"
            );
        }
        let sum = few.reflected_all.value + few.transmitted_all.value + few.truncated.value;
        assert!((sum - 1.0).abs() < 1e-9, "{sum}");
        // Nothing of it is carried on, from memory or from what a file kept.
        let none = |before| resume(&long, Shard::WHOLE, before, &|_| false);
        assert_eq!(none(Some(stopped.clone())).totals.photons(), 0);
        let kept = SoFar::kept(stopped.totals, Vec::new(), 1 << 24, Shard::WHOLE).unwrap();
        assert_eq!(kept.totals.photons(), 0);
        // A shard is no result of its own, so it has none.
        let shard = Shard { number: 1, of: 2 };
        let looks = std::sync::atomic::AtomicU64::new(0);
        let part = resume(&long, shard, None, &|_| {
            looks.fetch_add(1, Ordering::Relaxed) < 40
        });
        assert_eq!(part.totals.photons(), 0);
    }

    #[test]
    fn a_sketch_grows_by_whole_rounds_and_takes_little_of_a_batch() {
        let rough = "shape = \"beckmann\"\nalpha_u = 0.3\nalpha_v = 0.3\ncells = 16";
        let long = scene(rough, 1 << 24);
        let (walk, grid) = (walk_of(&long), long.grid);
        let task = Task {
            walk: &walk,
            first_hits: FirstHits::new::<Scalar>(&walk, grid, long.photons),
            seed: 1,
            grid,
            photons: long.photons,
            shard: Shard::WHOLE,
        };
        let sketch = |looks: u64| {
            let left = std::sync::atomic::AtomicU64::new(looks);
            let totals = task.sketch::<Scalar>(&|| {
                left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |n| n.checked_sub(1))
                    .is_ok()
            });
            totals.map_or(0, |t| t.photons())
        };
        assert_eq!(sketch(0), 0);
        let whole = sketch(u64::MAX);
        // Rounds of 2^13 and four times as many: the next would pass an eighth of 2^18.
        assert_eq!(whole, SKETCH_BATCHES * SKETCH_PHOTONS);
        assert!(whole <= (1 << 18) / SKETCH_SHARE);
        // One thread, or all might stop within their first replicate.
        let alone = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        let few = alone.unwrap().install(|| sketch(5));
        assert!(
            few > 0 && few < whole && few.is_multiple_of(SKETCH_PHOTONS),
            "{few}"
        );
    }
}
