//! A run: photons in blocks of batches over all cores, until enough.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use super::launch::FirstHits;
use super::light::{Light, Polarised, Scalar};
use super::paired::Paired;
use super::rng::{Purpose, Stream};
use super::scene::Prepared;
use super::tally::{Batch, Block, Grid, Totals};
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

/// Photons are dealt out in this many blocks at least, and none is larger than [`BLOCK_MAX`].
const BLOCKS_MIN: u64 = 16;
/// Batches per block: 64 replicates and more, so that standard errors are known to 9 %. More of them would
/// each be smaller, and strata pay only where there are several to a triangle.
const BATCHES: u64 = 4;
/// Largest block: what is lost at most per thread when a run is stopped.
const BLOCK_MAX: u64 = 1 << 22;
/// Photons between two looks at the stop conditions.
const LOOK: u64 = 1 << 13;

/// The photons `[first, end)` of one block.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Span {
    first: u64,
    end: u64,
}

/// The plan of a run of so many photons: how they fall into blocks.
fn blocks(photons: u64) -> u64 {
    BLOCKS_MIN.max(photons.div_ceil(BLOCK_MAX)).min(photons)
}

fn span(photons: u64, parts: u64, part: u64) -> Span {
    // 128 bits: photons × parts may pass 64.
    let cut = |n: u64| (u128::from(photons) * u128::from(n) / u128::from(parts)) as u64;
    Span {
        first: cut(part),
        end: cut(part + 1),
    }
}

/// Traces a shard of a scene. `proceed` is asked from time to time, from any thread, whether to go
/// on; the blocks that are finished by then count. The result depends on the scene and on which blocks
/// were finished, never on threads.
pub fn trace(
    prepared: &Prepared,
    shard: Shard,
    proceed: &(dyn Fn(&Progress) -> bool + Sync),
) -> Totals {
    trace_photons(prepared, prepared.photons, shard, proceed)
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
    let walk = walk_of(prepared);
    let first_hits = FirstHits::new::<L>(&walk, grid);
    trace_from::<L>(
        &walk,
        first_hits,
        prepared.seed,
        grid,
        photons,
        shard,
        proceed,
    )
}

/// A short run in bins of its own that does without the look at every triangle, which pays for thousands of
/// photons only.
pub(super) fn trace_briefly<L: Light>(prepared: &Prepared, grid: Grid, photons: u64) -> Totals {
    let walk = walk_of(prepared);
    trace_from::<L>(
        &walk,
        None,
        prepared.seed,
        grid,
        photons,
        Shard::WHOLE,
        &|_| true,
    )
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

fn trace_from<L: Light>(
    walk: &Walk<'_>,
    first_hits: Option<FirstHits<'_>>,
    seed: u64,
    grid: Grid,
    photons: u64,
    shard: Shard,
    proceed: &(dyn Fn(&Progress) -> bool + Sync),
) -> Totals {
    let count = blocks(photons);
    let mine: Vec<u64> = (0..count)
        .filter(|block| block % shard.of == shard.number - 1)
        .collect();
    let planned = mine
        .iter()
        .map(|&b| span(photons, count, b))
        .map(|s| s.end - s.first)
        .sum();
    let totals = Mutex::new(Totals::new(grid, L::ELEMENTS));
    let stopped = AtomicBool::new(false);
    mine.par_iter().with_max_len(1).for_each_init(
        || {
            let batch = Batch::new::<L>(grid);
            let block = Block::like(&batch);
            (batch, block)
        },
        |(batch, block), &number| {
            if stopped.load(Ordering::Relaxed) {
                return;
            }
            let span = span(photons, count, number);
            let so_far = Progress {
                photons: totals
                    .lock()
                    .expect("no thread panics while it adds")
                    .photons(),
                photons_planned: planned,
                relative_error: None,
            };
            let go_on = || {
                let go_on = !stopped.load(Ordering::Relaxed) && proceed(&so_far);
                if !go_on {
                    stopped.store(true, Ordering::Relaxed);
                }
                go_on
            };
            let job = Job {
                walk,
                first_hits: first_hits.as_ref(),
                seed,
                number,
                go_on: &go_on,
            };
            if !job.trace::<L>(span, batch, block) {
                return;
            }
            let mut totals = totals.lock().expect("no thread panics while it adds");
            totals.add(block, span.end - span.first);
            block.clear();
            let progress = Progress {
                photons: totals.photons(),
                photons_planned: planned,
                relative_error: totals.relative_error(),
            };
            drop(totals);
            if !proceed(&progress) {
                stopped.store(true, Ordering::Relaxed);
            }
        },
    );
    let mut totals = totals.into_inner().expect("no thread panics while it adds");
    if let Some(first_hits) = &first_hits {
        totals.include(&first_hits.known);
    }
    totals
}

/// One block of a run.
struct Job<'a> {
    walk: &'a Walk<'a>,
    first_hits: Option<&'a FirstHits<'a>>,
    seed: u64,
    number: u64,
    /// Whether to go on, asked every [`LOOK`] photons.
    go_on: &'a (dyn Fn() -> bool + Sync),
}

impl Job<'_> {
    /// `false` where it was stopped: what is in the batch and the block then is of no use.
    fn trace<L: Light>(&self, span: Span, batch: &mut Batch, block: &mut Block) -> bool {
        let size = span.end - span.first;
        let parts = BATCHES.min(size);
        let mut waiting = Waiting::none();
        for part in 0..parts {
            let inner = self::span(size, parts, part);
            let replicate = self.number * BATCHES + part;
            // A batch's photons are numbered within it: 2^20 at most, and four times as many starts.
            let stream = |n: u64| Stream::new(self.seed, Purpose::Photon, (replicate << 24) + n);
            let photons = inner.end - inner.first;
            match self.first_hits {
                Some(first_hits) => {
                    let go_on = |n: u64| !n.is_multiple_of(LOOK) || (self.go_on)();
                    if !first_hits.batch::<L>(
                        self.walk,
                        photons,
                        stream,
                        go_on,
                        &mut waiting,
                        batch,
                    ) {
                        return false;
                    }
                }
                None => {
                    for n in 0..photons {
                        if n.is_multiple_of(LOOK) && !(self.go_on)() {
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
                        self.walk
                            .photon::<L>(x, y, &mut random, &mut waiting, batch);
                    }
                }
            }
            block.take(batch);
        }
        true
    }
}
