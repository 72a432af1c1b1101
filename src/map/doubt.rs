//! A second look at pixels that may have ended in a minimum beside the deepest.
//!
//! Where poses are few, a lobe has a double: another angle, width and lean that explain the same pixel not much worse,
//! with an uncertainty as small as the right one's. χ² alone tells a single pixel little of that; that few others look
//! like its end tells more. Such pixels descend again from another leader, the most promising first, for as long as that
//! pays: on a map whose model misses much everywhere, most doubts come to nothing and would cost as much as the map.

use super::run::{Run, better, chi2_max, freedom, usual_chi2_max};
use super::settle::Settled;
use super::solve::{End, PixelFit};
use super::start::near;
use super::{REFRESHES, kernel::Parameters};

/// Normal quantile of χ² from which a pixel is doubted although many look like it.
const UNEASY: f64 = 3.0;
/// One pixel in so many is looked at first; twice as many next.
const FIRST: usize = 128;
/// Of those looked at, one in so many has to end deeper for more to follow.
const PAYS: usize = 8;
/// By how many usual χ² units: what lies less deep may be the same minimum with other costly terms.
const DEEPER: f64 = 4.0;

/// A pixel that is doubted.
struct Doubt {
    /// Its place among the fits.
    at: usize,
    /// The best of the leaders that it neither came from nor looks like.
    other: Parameters,
    /// By how much that explains it worse than its end does, before any descent.
    worse: f64,
}

/// Lets doubtful ones of these fits descend again; returns the evaluations spent. `starts` are where they came from.
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

/// The doubtful among the fits, those first which another leader explains least worse than their end does. What is beyond
/// the usual has been looked at already, and says so.
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
        let uneasy = reduced > chi2_max(freedom, UNEASY) || !settled.leaders.many_like(&fit.p);
        if fit.end != End::Converged || reduced > usual_chi2_max(freedom) || !uneasy {
            continue;
        }
        run.read(chosen[at], &mut signal, &mut weight);
        let other = |p: &Parameters| *p != starts[at] && !near(p, &fit.p);
        // Without one it is left at that: descents from templates made maps of metal half as dear again for little.
        if let Some((other, chi2)) = settled.leaders.best_of(&signal, &weight, other) {
            let worse = chi2 - fit.chi2;
            doubts.push(Doubt { at, other, worse });
        }
    }
    doubts.sort_by(|a, b| a.worse.total_cmp(&b.worse));
    doubts
}
