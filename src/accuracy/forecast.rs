//! How long a trace will take, told before it starts, from two short runs of it.

use std::time::Instant;

use serde::Serialize;

use crate::trace::run::{Shard, trace_photons};
use crate::trace::scene::Prepared;

/// What a run will take.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Forecast {
    /// Seconds, start included.
    pub seconds: f64,
    /// Photons that it will trace.
    pub photons: u64,
    /// Mean relative error of a reflected bin at its end.
    pub relative_error: Option<f64>,
}

impl std::fmt::Display for Forecast {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "about {:.1} s for {} photons",
            self.seconds, self.photons
        )?;
        match self.relative_error {
            Some(error) => write!(f, ", error of a reflected bin about {:.2} %", 100.0 * error),
            None => Ok(()),
        }
    }
}

/// Share of the run that the larger of the two short runs takes.
const SHARE: u64 = 32;

/// Forecasts a run of the scene's photons, or of as many as `target_error` needs (no more than those).
///
/// Two short runs part what a run costs at its start (shapes, first hits) from what a photon costs; the
/// error falls with the root of the photons once the bins that matter have been hit.
#[must_use]
pub fn of_run(prepared: &Prepared, target_error: Option<f64>) -> Forecast {
    let large = (prepared.photons / SHARE)
        .clamp(1_000, 500_000)
        .min(prepared.photons);
    let small = (large / 4).max(1);
    let timed = |photons: u64| {
        let started = Instant::now();
        let totals = trace_photons(prepared, photons, Shard::WHOLE, &|_| true);
        (started.elapsed().as_secs_f64(), totals.relative_error())
    };
    // The better of two: other work on the machine only ever adds.
    let better = |photons: u64| {
        let (first, error) = timed(photons);
        (first.min(timed(photons).0), error)
    };
    let (little, _) = better(small);
    let (more, error) = better(large);
    let per_photon =
        ((more - little) / (large - small).max(1) as f64).max(0.2 * more / large as f64);
    let start = (more - per_photon * large as f64).max(0.0);
    let photons = match (target_error, error) {
        (Some(target), Some(error)) => {
            let needed = large as f64 * (error / target).powi(2);
            // Blocks are whole: a run ends at the first one whose error is small enough.
            (needed as u64).clamp(1, prepared.photons)
        }
        _ => prepared.photons,
    };
    Forecast {
        seconds: start + per_photon * photons as f64,
        photons,
        relative_error: error.map(|e| e * (large as f64 / photons as f64).sqrt()),
    }
}
