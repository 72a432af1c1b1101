//! Refits ambiguous pixels, which may have ended in a local minimum.
//!
//! If poses are few, a lobe has a rival: another angle, width and lean that explain the same pixel almost as well,
//! with an equally small uncertainty. A single pixel's χ² hardly separates the two. That few other pixels have
//! similar parameters is better evidence of a wrong minimum. Such pixels descend again from another leader, the most
//! promising first, as long as enough of them improve: on a map with a large model error everywhere, most candidates
//! are false alarms, and refitting all would cost as much as the map.

use super::run::{Run, better, freedom, usual_chi2_max};
use super::settle::Settled;
use super::solve::{End, PixelFit};
use super::start::near;
use super::{REFRESHES, kernel::Parameters};
use crate::robust::reduced_chi2_at;

/// Normal quantile of χ² from which a pixel is a candidate even if many pixels are like it.
const UNEASY: f64 = 3.0;
/// One pixel in this number is refitted first, and twice as many in each further round.
const FIRST: usize = 128;
/// Of the refitted pixels, one in this number must end deeper for another round to follow.
const PAYS: usize = 8;
/// Gain, in usual χ² units, that counts as deeper: a smaller one may be the same minimum with other costly terms.
const DEEPER: f64 = 4.0;

/// An ambiguous pixel.
struct Doubt {
    /// Its index among the fits.
    at: usize,
    /// The best leader that is neither the pixel's start nor near its end.
    other: Parameters,
    /// χ² of that leader, before any descent, less the χ² of the pixel's end.
    worse: f64,
}

/// Refits the ambiguous ones of these fits; returns the evaluations spent. `starts` are the starts of the fits.
pub(super) fn look_again(
    run: &Run<'_>,
    settled: &Settled,
    chosen: &[usize],
    starts: &[Parameters],
    fits: &mut [PixelFit],
) -> f64 {
    let doubts = doubts(run, settled, chosen, starts, fits);
    let (mut left, mut count) = (doubts.as_slice(), chosen.len().div_ceil(FIRST));
    let mut spent = 0.0;
    while !left.is_empty() {
        let now;
        (now, left) = left.split_at(count.min(left.len()));
        let mut deeper = 0;
        let pixels: Vec<usize> = now.iter().map(|doubt| chosen[doubt.at]).collect();
        let others: Vec<Parameters> = now.iter().map(|doubt| doubt.other).collect();
        let found = run.fit(&pixels, &others, REFRESHES);
        for (at, again) in now.iter().map(|doubt| doubt.at).zip(found) {
            spent += f64::from(again.evaluations);
            let gain = fits[at].chi2 - again.chi2;
            deeper += usize::from(again.end == End::Converged && gain > DEEPER * settled.birge);
            if better(&again, &fits[at]) {
                fits[at] = again;
            }
        }
        if deeper * PAYS < now.len() {
            break;
        }
        count *= 2;
    }
    spent
}

/// Returns the ambiguous fits, sorted by the excess χ² of their rival. Fits beyond the usual χ² are excluded: they have
/// been refitted already and are flagged.
fn doubts(
    run: &Run<'_>,
    settled: &Settled,
    chosen: &[usize],
    starts: &[Parameters],
    fits: &[PixelFit],
) -> Vec<Doubt> {
    let n = run.batch.observations;
    let (mut signal, mut weight) = (vec![0.0; n], vec![0.0; n]);
    let mut doubts = Vec::new();
    for (at, fit) in fits.iter().enumerate() {
        let freedom = freedom(fit);
        let reduced = fit.chi2 / freedom / settled.birge;
        let uneasy =
            reduced > reduced_chi2_at(freedom, UNEASY) || !settled.leaders.many_like(&fit.p);
        if fit.end != End::Converged || reduced > usual_chi2_max(freedom) || !uneasy {
            continue;
        }
        run.read(chosen[at], &mut signal, &mut weight);
        let other = |p: &Parameters| *p != starts[at] && !near(p, &fit.p);
        // A pixel without a rival leader keeps its fit: descents from templates lengthened maps of metal by half
        // for little gain.
        if let Some((other, chi2)) = settled.leaders.best_of(&signal, &weight, other) {
            let worse = chi2 - fit.chi2;
            doubts.push(Doubt { at, other, worse });
        }
    }
    doubts.sort_by(|a, b| a.worse.total_cmp(&b.worse));
    doubts
}
