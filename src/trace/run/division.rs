//! How a run is divided into shards and batches, when it may stop, and what a stopped run has finished.

use crate::shard::Shard;
use crate::trace::counting::tally::Totals;

/// Checks that every shard of a run with this number of photons has photons.
///
/// # Errors
/// The largest number of shards of the run.
pub fn check_shard(shard: Shard, photons: u64) -> Result<(), u64> {
    let most = batches(photons);
    if shard.of <= most { Ok(()) } else { Err(most) }
}

/// Numbers of the batches of a shard in a run with this number of photons.
pub(super) fn batches_of(shard: Shard, photons: u64) -> impl Iterator<Item = u64> {
    (0..batches(photons)).filter(move |batch| shard.has(*batch))
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
pub enum StopPolicy {
    /// A limit on error or time may end the run at any moment. The photons traced until then must
    /// be a result, so some of the first photons may be traced only for that.
    AnyTime,
    /// As `AnyTime`, with a known time limit: a surface analysis that would take most of the time
    /// is abandoned in favour of photons that do not need it.
    Within(TimeLimit),
    /// All photons are wanted; a stop is exceptional.
    AtLast,
}

impl StopPolicy {
    /// The policy of a run with an optional time limit on a clock and an optional target error.
    #[must_use]
    pub fn of(seconds: Option<f64>, now_s: fn() -> f64, target_error: Option<f64>) -> Self {
        match (seconds, target_error) {
            (Some(seconds), _) => StopPolicy::Within(TimeLimit { seconds, now_s }),
            (None, Some(_)) => StopPolicy::AnyTime,
            (None, None) => StopPolicy::AtLast,
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
pub struct PartialRun {
    /// The counted light.
    pub totals: Totals,
    /// Numbers of the finished batches, ascending; empty for a preview.
    pub batches: Vec<u64>,
}

impl PartialRun {
    /// Restores a stored shard of a run with this number of photons; `None` if it does not match:
    /// batches that the shard does not have, or another number of photons.
    #[must_use]
    pub fn kept(totals: Totals, batches: Vec<u64>, photons: u64, shard: Shard) -> Option<Self> {
        if batches.is_empty() {
            // A preview is a result, but not part of the run.
            let totals = Totals::new(totals.grid(), totals.elements());
            return Some(PartialRun { totals, batches });
        }
        let count = self::batches(photons);
        let known = |batch: &u64| *batch < count && shard.has(*batch);
        let rising = batches.windows(2).all(|pair| pair[0] < pair[1]);
        if !(rising && batches.iter().all(known)) {
            return None;
        }
        let traced: u64 = batches.iter().map(|b| share(photons, count, *b)).sum();
        (traced == totals.photons()).then_some(PartialRun { totals, batches })
    }

    /// Whether a shard of a run with this number of photons is finished.
    #[must_use]
    pub fn is_complete(&self, photons: u64, shard: Shard) -> bool {
        self.batches.len() == batches_of(shard, photons).count()
    }
}

/// Progress of a run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TraceProgress {
    /// Finished fraction of the surface analysis that precedes the first photon; `None` once
    /// photons are traced.
    pub surface_analysis: Option<f64>,
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
pub(super) const BATCH_MAX: u64 = 1 << 20;
/// Number of batches of a run with this number of photons.
pub(super) fn batches(photons: u64) -> u64 {
    BATCHES_MIN.max(photons.div_ceil(BATCH_MAX)).min(photons)
}

/// Number of photons in one batch.
pub(super) fn share(photons: u64, batches: u64, number: u64) -> u64 {
    // 128 bits, because photons × batches may exceed 64.
    let until = |n: u64| (u128::from(photons) * u128::from(n) / u128::from(batches)) as u64;
    until(number + 1) - until(number)
}
