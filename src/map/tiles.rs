//! Tiles of the map: the sample of pixels that determines the shared quantities, and the fit of every pixel, tile by
//! tile on all cores, in an order that spreads over the field.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use rayon::prelude::*;

use super::calibration::{GlobalCalibration, LOBE_SIGNIFICANCE};
use super::layers::{Answer, FEW_OBSERVATIONS, Layers, NOT_IDENTIFIABLE};
use super::run::{Batch, Run, better, freedom, usual_chi2_max};
use super::signals::planes::Planes;
use super::solve::kernel::FREE;
use super::solve::starts::QUARTERS;
use super::solve::{End, PixelFit};
use super::{MapError, Progress, Stage};
use crate::shard::Shard;

/// Number of tiles and of pixels from which the shared quantities are determined.
const SAMPLED_TILES: usize = 32;
const SAMPLED_PIXELS: usize = 2048;

/// Returns a sample of pixels from tiles spread over the map.
pub(super) fn sampled(planes: &Planes) -> Result<Batch, MapError> {
    let tiles = planes.tiles();
    let taken = tiles.min(SAMPLED_TILES);
    let per_tile = SAMPLED_PIXELS.div_ceil(taken);
    let batches = (0..taken)
        .map(|k| {
            let tile = k * tiles / taken;
            let length = planes.range(tile).len();
            // An odd stride does not divide common widths, so the columns differ.
            let stride = (length / per_tile).max(1) | 1;
            Batch::of_tile(planes, tile, |i| i % stride == k % stride)
        })
        .collect::<Result<Vec<_>, _>>()
        .map_err(MapError::Scratch)?;
    Ok(Batch::join(batches))
}

/// The fits of all tiles, or of those of a shard.
pub(super) struct Tiles {
    pub(super) layers: Layers,
    pub(super) evaluations: f64,
    /// Pixels that were visited.
    pub(super) pixels: usize,
}

/// Returns the tiles of a shard, in an order that spreads over the field.
pub(super) fn tiles_of(planes: &Planes, shard: Shard) -> Vec<usize> {
    let spread = (0..).zip(spread_out(planes.tiles()));
    let own = spread.filter(|(n, _)| shard.has(*n));
    own.map(|(_, tile)| tile).collect()
}

/// Fits the pixels of a shard, tile by tile on all cores, until `late` returns true.
pub(super) fn fit_tiles(
    planes: &Planes,
    settled: &GlobalCalibration,
    shard: Shard,
    late: &(dyn Fn() -> bool + Sync),
    progress: &(dyn Fn(Progress) + Sync),
    cancel: &AtomicBool,
) -> Result<Tiles, MapError> {
    let view = &settled.view;
    let amplitude = settled.costly.is_amplitude();
    let answered = Mutex::new((Layers::new(view.width, view.height, amplitude), 0.0));
    let done = AtomicUsize::new(0);
    let own = tiles_of(planes, shard);
    let total = own.iter().map(|tile| planes.range(*tile).len()).sum();
    own.into_par_iter().with_max_len(1).try_for_each(|tile| {
        if cancel.load(Ordering::Relaxed) {
            return Err(MapError::Cancelled);
        }
        if late() {
            return Ok(());
        }
        let batch = Batch::of_tile(planes, tile, |_| true).map_err(MapError::Scratch)?;
        let run = Run {
            batch: &batch,
            globals: &settled.globals,
            costly: &settled.costly,
            view,
            beside: settled.beside.as_ref(),
        };
        let (answers, spent) = fit_batch(&run, settled);
        let mut answered = answered.lock().expect("no holder of this lock panics");
        for (pixel, answer) in batch.pixels.iter().zip(&answers) {
            answered.0.put(*pixel, answer);
        }
        answered.1 += spent;
        drop(answered);
        progress(Progress {
            stage: Stage::Fitting,
            done: done.fetch_add(batch.pixels.len(), Ordering::Relaxed) + batch.pixels.len(),
            total,
        });
        Ok(())
    })?;
    let (layers, evaluations) = answered
        .into_inner()
        .expect("no holder of this lock panics");
    Ok(Tiles {
        layers,
        evaluations,
        pixels: done.into_inner(),
    })
}

/// Returns the numbers below `count` in an order of which every beginning is spread over all, the middle first: in
/// bit-reversed order, shifted by one half.
pub(super) fn spread_out(count: usize) -> Vec<usize> {
    let bits = usize::BITS - count.saturating_sub(1).leading_zeros();
    (0..1usize << bits)
        .map(|n| n.reverse_bits() >> (usize::BITS - bits.max(1)))
        .filter(|n| *n < count)
        .map(|n| (n + count / 2) % count)
        .collect()
}

/// Fits the pixels of a batch that show a lobe; those that no leader fits start again from every quarter turn. Returns the
/// results and the evaluations spent.
fn fit_batch(run: &Run<'_>, settled: &GlobalCalibration) -> (Vec<Answer>, f64) {
    let amplitude = settled.costly.is_amplitude();
    let birge = settled.birge;
    let n = run.batch.observations;
    let mut answers: Vec<Answer> = Vec::with_capacity(run.batch.pixels.len());
    let (mut chosen, mut mattes) = (Vec::new(), Vec::new());
    let (mut signal, mut weight) = (vec![0.0; n], vec![0.0; n]);
    for index in 0..run.batch.pixels.len() {
        let used = run.batch.used(index);
        if used <= FREE {
            answers.push(Answer::none(FEW_OBSERVATIONS, used));
            continue;
        }
        answers.push(Answer::none(NOT_IDENTIFIABLE, used));
        // A pixel that a matte surface explains is not fitted.
        run.read(index, &mut signal, &mut weight);
        if let Some((_, matte)) = settled.matte.best(&signal, &weight)
            && matte > birge * (used as f64 - 1.0 + LOBE_SIGNIFICANCE)
        {
            chosen.push(index);
            mattes.push(matte);
        }
    }
    let mut fits = run.fit_from(&chosen, std::slice::from_ref(&settled.leaders));
    let mut spent: f64 = fits.iter().map(|f| f64::from(f.evaluations)).sum();
    let is_doubtful = |fit: &PixelFit| {
        let freedom = freedom(fit);
        fit.end != End::Converged
            || fit.covariance.is_none()
            || fit.chi2 / freedom > birge * usual_chi2_max(freedom)
    };
    let doubtful: Vec<usize> = (0..fits.len())
        .filter(|at| is_doubtful(&fits[*at]))
        .collect();
    let again: Vec<usize> = doubtful.iter().map(|at| chosen[*at]).collect();
    for (at, fit) in doubtful.iter().zip(run.fit_from(&again, &settled.quarters)) {
        spent += f64::from(fit.evaluations) * QUARTERS as f64;
        if better(&fit, &fits[*at]) {
            fits[*at] = fit;
        }
    }
    for ((index, fit), matte) in chosen.iter().zip(&fits).zip(mattes) {
        let mut answer = Answer::of(fit, birge, n, amplitude);
        if matte - fit.chi2 < birge * LOBE_SIGNIFICANCE {
            answer = Answer::none(answer.flags | NOT_IDENTIFIABLE, fit.n_used);
        }
        answers[*index] = answer;
    }
    (answers, spent)
}
