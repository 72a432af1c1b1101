//! A run: traces photons in batches on all cores, until a stop condition is met.
//!
//! Call [`trace`], or [`resume`] to continue an earlier run. Batches are large, so that strata are
//! effective; a run that may stop before several batches are finished also produces a preview of
//! small replicates (`preview`).

mod division;
mod preview;
mod task;

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64};

use rayon::prelude::*;

use super::counting::grid::DirectionGrid;
use super::counting::plane::directions;
use super::counting::tally::{TallyBatch, Totals};
use super::photons::light::{PhotonState, Polarised, ScalarState};
use super::photons::paired::Paired;
use super::photons::walk::{Waiting, Walk, worth_splitting};
use super::rng::Purpose;
use super::scene::PreparedScene;
use super::visibility::primary_hits::PrimaryHits;
pub use division::{Follow, PartialRun, StopPolicy, TimeLimit, TraceProgress, check_shard};
use division::{batches, batches_of, share};
use preview::Preview;
pub use task::CHECK_INTERVAL;
use task::{StopCheck, Task};

pub use crate::shard::Shard;

/// Largest fraction of a limited time for the surface analysis.
const ANALYSIS_SHARE_MAX: f64 = 0.5;
/// Largest fraction of that time for the first part of the analysis.
const ANALYSIS_START_SHARE: f64 = 0.1;
/// Batches between two estimates of the error, if a target error may end the run.
const ERROR_INTERVAL: usize = 4;
/// Batches between two estimates of the error, if it is only reported.
const ERROR_INTERVAL_REPORTED: usize = 16;

/// Traces a shard of a scene. `proceed` is called from time to time, from any thread, and returns
/// whether to continue. After a stop, the finished batches count, or a preview of smaller ones if
/// they are too few ([`PartialRun`]). The result depends on the scene and on the finished work,
/// never on threads. [`PreparedScene::plane`] is ignored here because it takes time; use [`resume`]
/// or [`trace_following`].
pub fn trace(
    prepared: &PreparedScene,
    shard: Shard,
    proceed: &(dyn Fn(&TraceProgress) -> bool + Sync),
) -> Totals {
    trace_photons(prepared, Follow::Scene, prepared.photons, shard, proceed)
}

/// As [`trace`], continuing from `before`. The result of all batches equals that of an
/// uninterrupted run bit for bit, whatever the stops.
///
/// # Panics
/// `before` has other bins than the scene.
pub fn resume(
    prepared: &PreparedScene,
    shard: Shard,
    before: Option<PartialRun>,
    ending: StopPolicy,
    proceed: &(dyn Fn(&TraceProgress) -> bool + Sync),
) -> PartialRun {
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
        resume_as::<ScalarState>(prepared, grid, photons, part, proceed)
    }
}

/// As [`trace`], with another number of photons than the scene's.
pub fn trace_photons(
    prepared: &PreparedScene,
    follow: Follow,
    photons: u64,
    shard: Shard,
    proceed: &(dyn Fn(&TraceProgress) -> bool + Sync),
) -> Totals {
    let grid = prepared.grid;
    match follow {
        Follow::Both => trace_as::<Paired>(prepared, grid, photons, shard, proceed),
        Follow::Scene if prepared.polarised => {
            trace_as::<Polarised>(prepared, grid, photons, shard, proceed)
        }
        Follow::Scene => trace_as::<ScalarState>(prepared, grid, photons, shard, proceed),
    }
}

/// Traces a whole run whose paths carry the given light; [`trace`] with a [`StopPolicy`].
pub fn trace_following(
    prepared: &PreparedScene,
    follow: Follow,
    ending: StopPolicy,
    proceed: &(dyn Fn(&TraceProgress) -> bool + Sync),
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
        Follow::Scene => resume_as::<ScalarState>(prepared, grid, photons, part, proceed),
    };
    so_far.totals
}

/// The same for any kind of light, bins and number of photons.
pub(super) fn trace_as<L: PhotonState>(
    prepared: &PreparedScene,
    grid: DirectionGrid,
    photons: u64,
    shard: Shard,
    proceed: &(dyn Fn(&TraceProgress) -> bool + Sync),
) -> Totals {
    let part = Part { shard, ..Part::ALL };
    resume_as::<L>(prepared, grid, photons, part, proceed).totals
}

/// The part of a run to trace.
struct Part {
    shard: Shard,
    before: Option<PartialRun>,
    ending: StopPolicy,
    /// Whether [`PreparedScene::plane`] applies.
    plane: bool,
}

impl Part {
    const ALL: Part = Part {
        shard: Shard::WHOLE,
        before: None,
        ending: StopPolicy::AtLast,
        plane: false,
    };

    /// Time limit of the surface analysis; `None` if it must be finished in any case.
    fn look_limit(&self) -> Option<TimeLimit> {
        let whole = self.before.is_none() && self.shard.of == 1;
        match self.ending {
            StopPolicy::Within(limit) if whole => Some(TimeLimit {
                seconds: ANALYSIS_SHARE_MAX * limit.seconds,
                ..limit
            }),
            _ => None,
        }
    }

    /// Number of its photons in a run with this number of photons.
    fn planned(&self, photons: u64) -> u64 {
        let of = batches_of(self.shard, photons);
        of.map(|b| share(photons, batches(photons), b)).sum()
    }
}

fn resume_as<L: PhotonState>(
    prepared: &PreparedScene,
    grid: DirectionGrid,
    photons: u64,
    part: Part,
    proceed: &(dyn Fn(&TraceProgress) -> bool + Sync),
) -> PartialRun {
    // A preview is never continued.
    let before = part.before.filter(|b| !b.batches.is_empty());
    let part = Part { before, ..part };
    let before = part.before.as_ref();
    let check = StopCheck {
        proceed,
        photons: AtomicU64::new(before.map_or(0, |b| b.totals.photons())),
        photons_planned: part.planned(photons),
        stopped: AtomicBool::new(false),
    };
    let go_on = |_| check.go_on();
    let walk = walk_of(prepared, &go_on);
    let limit = part.look_limit().map(|limit| ((limit.now_s)(), limit));
    let in_time = |share: f64| {
        limit.is_none_or(|(begun_s, TimeLimit { seconds, now_s })| {
            now_s() - begun_s
                <= (ANALYSIS_START_SHARE + (1.0 - ANALYSIS_START_SHARE) * share) * seconds
        })
    };
    let analysis = PrimaryHits::new::<L>(&walk, grid, photons, &|share| {
        check.report(Some(share), None) && in_time(share)
    });
    let task = Task {
        walk: &walk,
        preview_only: analysis.is_err(),
        primary_hits: analysis.unwrap_or_default(),
        seed: prepared.seed,
        grid,
        plane: directions(grid, prepared.phi_i_deg())
            .filter(|_| part.plane)
            .map(|all| all.into_iter().map(|(_, bins)| bins).collect()),
        photons,
    };
    task.trace::<L>(part, &check)
}

/// Traces a short run in its own bins without the analysis of every triangle, which is worth its
/// time only for thousands of photons. Runs with different `number` have independent random
/// numbers. Batches that `go_on` ends, given their work so far ([`TallyBatch::work`]), are left
/// out.
pub(super) fn trace_briefly<L: PhotonState>(
    prepared: &PreparedScene,
    grid: DirectionGrid,
    photons: u64,
    number: u64,
    go_on: &(dyn Fn(u64) -> bool + Sync),
) -> Totals {
    // The multiplier is odd, so different numbers give different seeds.
    let apart = number.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let task = Task {
        walk: &walk_of(prepared, go_on),
        primary_hits: None,
        preview_only: false,
        seed: prepared.seed.wrapping_add(apart),
        grid,
        plane: None,
        photons,
    };
    let check = StopCheck {
        proceed: &|_| true,
        photons: AtomicU64::new(0),
        photons_planned: photons,
        stopped: AtomicBool::new(false),
    };
    task.trace::<L>(Part::ALL, &check).totals
}

/// Traces a short run to measure the cost of a photon, without the analysis of every triangle: its
/// photons cost slightly more than those of a run with it. Values that a surface computes once and
/// caches are available afterwards. `go_on` is called from time to time; if it returns false, fewer
/// photons, or none, are counted.
#[must_use]
pub fn trace_few(
    prepared: &PreparedScene,
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
        Follow::Scene => trace_briefly::<ScalarState>(prepared, grid, photons, 0, &go_on),
    }
}

/// Number of photons that a run of `photons` traces in all if its error is small enough after
/// `needed` counted photons: photons of the preview are not part of the run, and the error is
/// estimated only from time to time.
#[must_use]
pub fn traced_until(photons: u64, needed: u64) -> u64 {
    let preview = preview::most(photons, StopPolicy::AnyTime);
    if needed <= preview {
        // Half of the photons traced between two estimates.
        return (needed + needed / (2 * preview::ESTIMATE_GROWTH)).min(preview);
    }
    let count = batches(photons);
    let interval = ERROR_INTERVAL as u64 * photons.div_ceil(count).max(1);
    preview
        + needed
            .div_ceil(interval)
            .saturating_mul(interval)
            .min(photons)
}

pub(super) fn walk_of<'a>(
    prepared: &'a PreparedScene,
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

impl Task<'_> {
    fn trace<L: PhotonState>(&self, part: Part, check: &StopCheck<'_>) -> PartialRun {
        let (grid, photons) = (self.grid, self.photons);
        let count = batches(photons);
        let Part {
            shard,
            before,
            ending,
            ..
        } = part;
        let preview = (before.is_none() && shard.of == 1).then(|| {
            let mut preview = Preview::<L>::new(self, ending);
            preview.go_on(self, check);
            preview
        });
        // Stopped already: with many bins, empty totals alone take seconds.
        if let Some(preview) = preview.as_ref().filter(|s| s.photons() > 0)
            && check.is_stopped()
        {
            return PartialRun {
                totals: preview.totals(self),
                batches: Vec::new(),
            };
        }
        let before = before.unwrap_or_else(|| PartialRun {
            totals: self.empty(L::ELEMENTS),
            batches: Vec::new(),
        });
        assert!(
            before.totals.grid() == grid && before.totals.elements() == L::ELEMENTS,
            "what was done before has the scene's bins"
        );
        let left: Vec<u64> = batches_of(shard, photons)
            .filter(|batch| before.batches.binary_search(batch).is_err())
            .collect();
        let complete = before.batches.len() + left.len();
        let batches_per_estimate = match ending {
            StopPolicy::AtLast => ERROR_INTERVAL_REPORTED,
            StopPolicy::AnyTime | StopPolicy::Within(_) => ERROR_INTERVAL,
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
            if self.preview_only || check.is_stopped() {
                return;
            }
            let (mut batch, mut waiting) = spare()
                .pop()
                .unwrap_or_else(|| (TallyBatch::new::<L>(grid), Waiting::none()));
            let share = share(photons, count, number);
            let go_on = |n: u64| !n.is_multiple_of(CHECK_INTERVAL) || check.go_on();
            let name = (Purpose::Photon, number);
            if !self.batch::<L>(name, share, &go_on, &mut waiting, &mut batch) {
                return;
            }
            let mut so_far = lock();
            so_far.totals.take(&mut batch, share);
            so_far.batches.push(number);
            let is_due = so_far.batches.len().is_multiple_of(batches_per_estimate);
            let totals = &so_far.totals;
            let known = self.primary_hits.as_ref().map(|f| &f.known);
            let known = known.map(|known| (known, totals.photons() - with_known));
            // Until the batches are more accurate, the preview's photons count.
            check.counted(totals.photons());
            let relative_error = is_due.then(|| totals.relative_error_with(known)).flatten();
            drop(so_far);
            spare().push((batch, waiting));
            check.report(None, relative_error);
        });
        let mut so_far = counted
            .into_inner()
            .expect("no thread panics while it adds");
        if let Some(primary_hits) = &self.primary_hits {
            let photons = so_far.totals.photons() - with_known;
            so_far.totals.include(&primary_hits.known, photons);
        }
        so_far.batches.sort_unstable();
        let preview = preview.filter(|_| so_far.batches.len() < complete);
        match preview.filter(|s| s.is_more_accurate_than(&so_far)) {
            Some(preview) => PartialRun {
                totals: preview.totals(self),
                batches: Vec::new(),
            },
            None => so_far,
        }
    }
}
