//! A second look at pixels that may have ended in a minimum beside the deepest.
//!
//! Where poses are few, a lobe has a double: another angle, width and lean that explain the same pixel not much worse,
//! with an uncertainty as small as the right one's. χ² alone tells a single pixel little of that; that few others look
//! like its end tells more. Such pixels descend again from elsewhere, the most promising first, for as long as that
//! pays: on a map whose model misses much everywhere, most doubts come to nothing and would cost as much as the map.

use super::run::{Run, better, chi2_max, freedom, usual_chi2_max};
use super::settle::Settled;
use super::solve::{End, PixelFit};
use super::start::{self, near};
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
    /// The best of the leaders that it neither came from nor looks like, and its χ² before any descent.
    other: Option<(Parameters, f64)>,
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
        for (at, again) in from_elsewhere(run, settled, chosen, now) {
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
        let other = settled.leaders.best_of(&signal, &weight, other);
        doubts.push(Doubt { at, other });
    }
    let worse = |doubt: &Doubt| match doubt.other {
        Some((_, chi2)) => chi2 - fits[doubt.at].chi2,
        None => f64::INFINITY,
    };
    doubts.sort_by(|a, b| worse(a).total_cmp(&worse(b)));
    doubts
}

/// Fits from the other leader, or from every quarter's template where there is none, by their place.
fn from_elsewhere(
    run: &Run<'_>,
    settled: &Settled,
    chosen: &[usize],
    doubts: &[Doubt],
) -> Vec<(usize, PixelFit)> {
    let (led, alone): (Vec<&Doubt>, Vec<&Doubt>) = doubts.iter().partition(|d| d.other.is_some());
    let pixels =
        |doubts: &[&Doubt]| -> Vec<usize> { doubts.iter().map(|d| chosen[d.at]).collect() };
    let others = led.iter().filter_map(|d| d.other);
    let others: Vec<Parameters> = others.map(|(leader, _)| leader).collect();
    let mut fits = run.fit(&pixels(&led), &others, REFRESHES);
    if !alone.is_empty() {
        let found = run.fit_from_templates(&pixels(&alone), &settled.templates);
        fits.extend(found.into_iter().map(|fit| PixelFit {
            evaluations: fit.evaluations * start::QUARTERS as f32,
            ..fit
        }));
    }
    let places = led.iter().chain(&alone).map(|d| d.at);
    places.zip(fits).collect()
}
