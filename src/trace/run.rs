//! A run: photons in blocks of batches over all cores, until enough.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use rayon::prelude::*;

use super::grid::Grid;
use super::launch::FirstHits;
use super::light::{Light, Polarised, Scalar};
use super::paired::Paired;
use super::rng::{Purpose, Stream};
use super::scene::Prepared;
use super::tally::{Batch, Block, Totals};
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

    /// Numbers of its blocks, of a run of so many photons.
    fn blocks(self, photons: u64) -> impl Iterator<Item = u64> {
        (0..blocks(photons)).filter(move |block| block % self.of == self.number - 1)
    }
}

/// What was done of a run: all that is needed to go on with it.
#[derive(Debug, Clone, PartialEq)]
pub struct SoFar {
    /// What was counted.
    pub totals: Totals,
    /// Numbers of the finished blocks, rising.
    pub blocks: Vec<u64>,
}

impl SoFar {
    /// What was kept of a shard of a run of so many photons; `None` where it cannot be that: blocks that the
    /// shard does not have, or other photons than theirs.
    #[must_use]
    pub fn kept(totals: Totals, blocks: Vec<u64>, photons: u64, shard: Shard) -> Option<Self> {
        let count = self::blocks(photons);
        let known = |block: &u64| *block < count && block % shard.of == shard.number - 1;
        let rising = blocks.windows(2).all(|pair| pair[0] < pair[1]);
        if !(rising && blocks.iter().all(known)) {
            return None;
        }
        let traced: u64 = blocks.iter().map(|b| span(photons, count, *b).size()).sum();
        (traced == totals.photons()).then_some(SoFar { totals, blocks })
    }

    /// Whether nothing is left to trace of a shard of a run of so many photons.
    #[must_use]
    pub fn is_complete(&self, photons: u64, shard: Shard) -> bool {
        self.blocks.len() == shard.blocks(photons).count()
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

impl Span {
    fn size(self) -> u64 {
        self.end - self.first
    }
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

/// [`trace`], going on from what was done `before`. Whatever the stops, the result of all blocks is that of one
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
/// photons only.
pub(super) fn trace_briefly<L: Light>(prepared: &Prepared, grid: Grid, photons: u64) -> Totals {
    let task = Task {
        walk: &walk_of(prepared),
        first_hits: None,
        seed: prepared.seed,
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
        let count = blocks(photons);
        let planned = shard
            .blocks(photons)
            .map(|b| span(photons, count, b).size())
            .sum();
        let before = before.unwrap_or_else(|| SoFar {
            totals: Totals::new(grid, L::ELEMENTS),
            blocks: Vec::new(),
        });
        assert!(
            before.totals.grid() == grid && before.totals.elements() == L::ELEMENTS,
            "what was done before has the scene's bins"
        );
        let left: Vec<u64> = shard
            .blocks(photons)
            .filter(|block| before.blocks.binary_search(block).is_err())
            .collect();
        let so_far = Mutex::new(before);
        let lock = || so_far.lock().expect("no thread panics while it adds");
        let stopped = AtomicBool::new(false);
        left.par_iter().with_max_len(1).for_each_init(
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
                let at_start = Progress {
                    photons: lock().totals.photons(),
                    photons_planned: planned,
                    relative_error: None,
                };
                let go_on = || {
                    let go_on = !stopped.load(Ordering::Relaxed) && proceed(&at_start);
                    if !go_on {
                        stopped.store(true, Ordering::Relaxed);
                    }
                    go_on
                };
                let job = Job {
                    walk: self.walk,
                    first_hits: self.first_hits.as_ref(),
                    seed: self.seed,
                    number,
                    go_on: &go_on,
                };
                if !job.trace::<L>(span, batch, block) {
                    return;
                }
                let mut so_far = lock();
                so_far.totals.add(block, span.size());
                if let Some(first_hits) = &self.first_hits {
                    so_far.totals.include(&first_hits.known, span.size());
                }
                so_far.blocks.push(number);
                let progress = Progress {
                    photons: so_far.totals.photons(),
                    photons_planned: planned,
                    relative_error: so_far.totals.relative_error(),
                };
                drop(so_far);
                block.clear();
                if !proceed(&progress) {
                    stopped.store(true, Ordering::Relaxed);
                }
            },
        );
        let mut so_far = so_far.into_inner().expect("no thread panics while it adds");
        so_far.blocks.sort_unstable();
        so_far
    }
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
        let size = span.size();
        let parts = BATCHES.min(size);
        let mut waiting = Waiting::none();
        for part in 0..parts {
            let inner = self::span(size, parts, part);
            let replicate = self.number * BATCHES + part;
            // A batch's photons are numbered within it: 2^20 at most, and four times as many starts.
            let stream = |n: u64| Stream::new(self.seed, Purpose::Photon, (replicate << 24) + n);
            let photons = inner.size();
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
