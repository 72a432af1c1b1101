//! An early result for runs that may be stopped: separate photons in small equal replicates.
//!
//! A batch of a run may take many seconds, and the error is known only after several. A preview is
//! a result after its first round, and all its photons so far count. They are not part of the run,
//! so the result of a whole run does not depend on it. Rounds have few photons at first, then as
//! many as were traced before, later an eighth of that; the part of a round that a stop interrupts
//! is dropped.

use rayon::prelude::*;

use super::super::rng::Purpose;
use super::division::{BATCH_MAX, PartialRun, StopPolicy, batches, share};
use super::task::{CHECK_INTERVAL, StopCheck, Task};
use crate::trace::counting::tally::{TallyBatch, Totals};
use crate::trace::photons::light::PhotonState;
use crate::trace::photons::walk::Waiting;

/// Number of replicates of a preview.
const REPLICATES: u64 = 16;
/// Photons of each replicate in the first round: in some scenes each takes a second.
const FIRST: u64 = 1 << 2;
/// Photons of each replicate up to which rounds double.
const DOUBLING: u64 = 1 << 6;
/// After that, a round adds this fraction (one over) of the photons so far.
const GROWTH: u64 = 8;
/// Largest number of photons of each replicate in one round.
const ROUND_MAX: u64 = 1 << 12;
/// Fraction (one over) of the photons by which their number grows until the next estimate of the
/// error.
pub(super) const ESTIMATE_GROWTH: u64 = 4;
/// Fraction (one over) of a batch for a preview if a stop is exceptional.
const SHARE: u64 = 8;
/// Fraction (one over) of the run for a preview if a stop is likely, and the number of largest
/// batches that bounds it: after these, whole batches soon are more accurate.
const SHARE_ANY_TIME: (u64, u64) = (16, 16);

/// Largest number of photons of the preview of a run.
pub(super) fn most(photons: u64, ending: StopPolicy) -> u64 {
    match ending {
        StopPolicy::AtLast => share(photons, batches(photons), 0) / SHARE,
        StopPolicy::AnyTime | StopPolicy::Within(_) => {
            let (of_run, largest) = SHARE_ANY_TIME;
            (photons / of_run).min(largest * BATCH_MAX)
        }
    }
}

/// A preview in progress.
pub(super) struct Preview<L: PhotonState> {
    replicates: Vec<Replicate<L>>,
    /// Photons of each replicate so far.
    each: u64,
    /// Largest number of photons in all.
    most: u64,
    /// Whether the error decides when it ends.
    estimates_error: bool,
}

/// One of the equal parts of a preview.
struct Replicate<L: PhotonState> {
    batch: TallyBatch,
    /// The round in progress.
    round: TallyBatch,
    waiting: Waiting<L>,
}

impl<L: PhotonState> Preview<L> {
    pub(super) fn new(task: &Task<'_>, ending: StopPolicy) -> Self {
        let most = if task.preview_only {
            task.photons
        } else {
            most(task.photons, ending)
        };
        let count = if most >= REPLICATES * DOUBLING {
            REPLICATES
        } else {
            0
        };
        let empty = |_| Replicate {
            batch: TallyBatch::new::<L>(task.grid),
            round: TallyBatch::new::<L>(task.grid),
            waiting: Waiting::none(),
        };
        Preview {
            replicates: (0..count).map(empty).collect(),
            each: 0,
            most,
            estimates_error: !matches!(ending, StopPolicy::AtLast),
        }
    }

    /// Traces rounds until all photons are traced or the run is stopped.
    pub(super) fn go_on(&mut self, task: &Task<'_>, check: &StopCheck<'_>) {
        let (mut round, mut next_estimate) = (0, CHECK_INTERVAL);
        loop {
            let doubled = self.each.clamp(FIRST, DOUBLING);
            let size = (self.each / GROWTH).clamp(doubled, ROUND_MAX);
            if self.photons() + REPLICATES * size > self.most {
                return;
            }
            let replicates = self.replicates.par_iter_mut().enumerate().with_max_len(1);
            let done = replicates.map(|(n, own)| {
                let name = (Purpose::Preview, REPLICATES * round + n as u64);
                task.batch::<L>(name, size, &|_| true, &mut own.waiting, &mut own.round)
            });
            if !done.reduce(|| true, |a, b| a && b) {
                return;
            }
            for own in &mut self.replicates {
                own.batch.take(&mut own.round);
            }
            self.each += size;
            round += 1;
            let photons = self.photons();
            let relative_error = (self.estimates_error && photons >= next_estimate).then(|| {
                next_estimate = photons + photons / ESTIMATE_GROWTH;
                // Only m00 is needed.
                self.counted(task, 1).relative_error()
            });
            check.counted(photons);
            if check.is_stopped() || !check.report(None, relative_error.flatten()) {
                return;
            }
        }
    }

    /// Photons of all replicates.
    pub(super) fn photons(&self) -> u64 {
        self.each * self.replicates.len() as u64
    }

    /// Whether the run has counted fewer photons, or too few batches to estimate its error.
    pub(super) fn is_more_accurate_than(&self, run: &PartialRun) -> bool {
        self.each > 0 && (run.batches.len() < 2 || run.totals.photons() < self.photons())
    }

    /// The counted light so far.
    pub(super) fn totals(&self, task: &Task<'_>) -> Totals {
        self.counted(task, L::ELEMENTS)
    }

    fn counted(&self, task: &Task<'_>, elements: usize) -> Totals {
        let mut totals = task.empty(elements);
        for own in &self.replicates {
            totals.count(&own.batch, self.each);
        }
        if let Some(primary_hits) = &task.primary_hits {
            totals.include(&primary_hits.known, self.photons());
        }
        totals
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicU64, Ordering};

    use super::super::super::scene::{PreparedScene, Scene};
    use super::super::{Shard, TimeLimit, TraceProgress, resume, trace};
    use super::*;

    fn scene(interface: &str, photons: u64) -> PreparedScene {
        let text = format!(
            "[light]\ntheta_i_deg = 40.0\n[[interface]]\n{interface}\nbelow = {{ n = 1.5 }}\n[run]\n\
             photons = {photons}\ntheta_bins = 9\nphi_bins = 12\n"
        );
        let scene = Scene::parse(&text).unwrap();
        let mut prepared = scene.prepare(&|_| Err(String::new())).unwrap();
        // As in `trace`, with which these runs are compared.
        prepared.plane = false;
        prepared
    }

    /// Batches of 2^18 photons for 2^24 photons: far more than a test traces.
    fn ridges(photons: u64) -> PreparedScene {
        scene(
            "shape = \"ridges\"\ntheta_r_deg = 20.0\npitch_um = 50.0",
            photons,
        )
    }

    fn rough(photons: u64) -> PreparedScene {
        scene(
            "shape = \"beckmann\"\nalpha_u = 0.3\nalpha_v = 0.3\ncells = 16",
            photons,
        )
    }

    fn trace_anytime(
        scene: &PreparedScene,
        proceed: &(dyn Fn(&TraceProgress) -> bool + Sync),
    ) -> Totals {
        resume(scene, Shard::WHOLE, None, StopPolicy::AnyTime, proceed).totals
    }

    #[test]
    fn a_run_without_time_for_the_surface_analysis_is_a_preview_that_agrees_with_the_whole() {
        let run = rough(60_000);
        let sketched =
            |ending, until: u64| resume(&run, Shard::WHOLE, None, ending, &|p| p.photons < until);
        let within = |seconds| {
            // A second passes at each reading of this clock.
            fn now_s() -> f64 {
                static NOW_S: AtomicU64 = AtomicU64::new(0);
                NOW_S.fetch_add(1, Ordering::Relaxed) as f64
            }
            StopPolicy::Within(TimeLimit { seconds, now_s })
        };
        // One run abandoned by the time limit, one stopped by the user.
        let hurried = sketched(within(1.0), 1 << 15);
        let stopped = sketched(StopPolicy::AtLast, 0);
        assert_eq!(hurried.batches.len() + stopped.batches.len(), 0);
        assert_eq!(stopped.totals.photons(), REPLICATES * FIRST);
        let (photons, some) = (hurried.totals.photons(), hurried.totals.energies());
        assert!((1 << 15..60_000).contains(&photons), "{photons}");
        let all = trace(&run, Shard::WHOLE, &|_| true).energies();
        for (a, b) in [
            (some.reflected_all, all.reflected_all),
            (some.transmitted_all, all.transmitted_all),
        ] {
            assert!(
                (a.value - b.value).abs() < 4.0 * a.std.hypot(b.std),
                "{a:?} {b:?}"
            );
        }
        // With enough time it is the whole run, bit for bit.
        let whole = resume(&run, Shard::WHOLE, None, within(1e6), &|_| true);
        assert_eq!(whole.totals.energies(), all);
    }

    #[test]
    fn a_run_stopped_at_once_has_a_preview_that_agrees_with_the_whole() {
        let long = ridges(1 << 24);
        let resume = |before| {
            let until = 1 << 13;
            resume(&long, Shard::WHOLE, before, StopPolicy::AtLast, &|p| {
                p.photons < until
            })
        };
        let stopped = resume(None);
        assert_eq!(stopped.batches, Vec::<u64>::new());
        assert!(!stopped.is_complete(1 << 24, Shard::WHOLE));
        let totals = &stopped.totals;
        assert_eq!(totals.batches(), REPLICATES);
        // All traced rounds count, and a stop is at most an eighth late.
        let photons = totals.photons();
        assert!(
            ((1 << 13)..=(1 << 13) * 9 / 8).contains(&photons),
            "{photons}"
        );
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
        // A preview is not continued, neither from memory nor from a file.
        assert_eq!(resume(Some(stopped.clone())), stopped);
        let kept = PartialRun::kept(stopped.totals, Vec::new(), 1 << 24, Shard::WHOLE).unwrap();
        assert_eq!(kept.totals.photons(), 0);
        // A shard is not a result by itself, so it has no preview.
        let shard = Shard { number: 1, of: 2 };
        let part = super::super::resume(&long, shard, None, StopPolicy::AtLast, &|_| false);
        assert_eq!(part.totals.photons(), 0);
    }

    #[test]
    fn if_a_stop_is_exceptional_a_preview_takes_at_most_an_eighth_of_a_batch() {
        let long = rough(1 << 24);
        let last = AtomicU64::new(0);
        let most = (1 << 24) / 64 / SHARE;
        let run = resume(&long, Shard::WHOLE, None, StopPolicy::AtLast, &|p| {
            let before = last.swap(p.photons, Ordering::Relaxed);
            // In the first batch the number does not change, nor within a round; no round begins
            // that would exceed the limit.
            before != p.photons || 9 * p.photons < 8 * most
        });
        let photons = run.totals.photons();
        assert!(photons <= most && 9 * photons >= 8 * most, "{photons}");
    }

    #[test]
    fn a_run_that_may_stop_ends_soon_after_its_error_is_small_enough() {
        let long = rough(1 << 26);
        let until = |goal: f64| {
            let large = |p: &TraceProgress| p.relative_error.is_none_or(|e| e > goal);
            trace_anytime(&long, &large)
        };
        let first = until(f64::INFINITY);
        assert_eq!(first.photons(), CHECK_INTERVAL);
        let goal = 0.5 * first.relative_error().unwrap();
        let totals = until(goal);
        let reached = totals.relative_error().unwrap();
        assert!(reached <= goal && reached > 0.8 * goal, "{reached}");
        // Four times as many photons, and far fewer than a batch of 2^20.
        let times = totals.photons() as f64 / first.photons() as f64;
        assert!((2.0..8.0).contains(&times), "{times}");
        assert_eq!(totals, until(goal));
    }

    #[test]
    fn batches_replace_the_preview_once_they_are_more_accurate() {
        let run = ridges(1 << 16);
        let whole = trace(&run, Shard::WHOLE, &|_| true);
        assert_eq!(trace_anytime(&run, &|_| true), whole);
        let sketch_most = (1 << 16) / SHARE_ANY_TIME.0;
        for until in [sketch_most / 2, 3 * sketch_most] {
            let part = resume(&run, Shard::WHOLE, None, StopPolicy::AnyTime, &|p| {
                p.photons < until
            });
            assert!(part.totals.photons() >= until);
            assert_eq!(part.batches.is_empty(), until < sketch_most);
        }
    }
}
