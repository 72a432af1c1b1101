//! A run that is ready to start: its surfaces and starts, the tracing of one batch, and the check of the stop conditions.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::super::rng::{Purpose, RandomStream};
use super::division::TraceProgress;
use crate::trace::counting::grid::DirectionGrid;
use crate::trace::counting::tally::{TallyBatch, Totals};
use crate::trace::photons::light::PhotonState;
use crate::trace::photons::walk::{Method, Waiting, Walk};
use crate::trace::visibility::primary_hits::PrimaryHits;

/// Photons between two checks of the stop conditions, and before the first estimate of the error.
pub const CHECK_INTERVAL: u64 = 1 << 13;

/// The callback that decides whether to continue, and whether it refused.
pub(super) struct StopCheck<'a> {
    pub(super) proceed: &'a (dyn Fn(&TraceProgress) -> bool + Sync),
    pub(super) photons: AtomicU64,
    pub(super) photons_planned: u64,
    pub(super) stopped: AtomicBool,
}

impl StopCheck<'_> {
    pub(super) fn is_stopped(&self) -> bool {
        self.stopped.load(Ordering::Relaxed)
    }

    /// Reports the photons so far and further progress; returns `false` from the first refusal on.
    pub(super) fn report(
        &self,
        surface_analysis: Option<f64>,
        relative_error: Option<f64>,
    ) -> bool {
        let progress = TraceProgress {
            surface_analysis,
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
    pub(super) fn go_on(&self) -> bool {
        !self.is_stopped() && self.report(None, None)
    }

    /// Adds counted photons.
    pub(super) fn counted(&self, photons: u64) {
        self.photons.fetch_max(photons, Ordering::Relaxed);
    }
}

/// A run, ready to start.
pub(super) struct Task<'a> {
    pub(super) walk: &'a Walk<'a>,
    pub(super) primary_hits: Option<PrimaryHits<'a>>,
    /// Whether the surface analysis was abandoned: photons without it are not part of the run.
    pub(super) preview_only: bool,
    pub(super) seed: u64,
    pub(super) grid: DirectionGrid,
    /// Bins of the directions for which products are accumulated.
    pub(super) plane: Option<Vec<Vec<usize>>>,
    pub(super) photons: u64,
}

impl Task<'_> {
    /// Totals without photons.
    pub(super) fn empty(&self, elements: usize) -> Totals {
        Totals::new(self.grid, elements)
            .with_directions(self.plane.clone())
            .of_layers(self.walk.stack.interfaces.len() > 1)
    }

    /// Traces one batch with its own random numbers; `go_on` is called before each photon. Returns
    /// `false` if stopped; the batch is then invalid.
    pub(super) fn batch<L: PhotonState>(
        &self,
        (purpose, number): (Purpose, u64),
        photons: u64,
        go_on: &impl Fn(u64) -> bool,
        waiting: &mut Waiting<L>,
        batch: &mut TallyBatch,
    ) -> bool {
        // A batch's photons are numbered within it: at most 2^20, with up to four times as many
        // starts.
        let stream = |n: u64| RandomStream::new(self.seed, purpose, (number << 24) + n);
        if let Some(primary_hits) = &self.primary_hits {
            return primary_hits.batch::<L>(self.walk, photons, stream, go_on, waiting, batch);
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
