//! Forecasts the duration of a fit.
//!
//! A search continues while the data leave a doubt, so its duration depends on the data. Call [`outlook`]: it runs the
//! first round of the fit, settles its result, derives the rounds that will follow, and times a small share of one
//! round and one integration. The caller provides the clock.

use std::sync::atomic::AtomicBool;

use rayon::prelude::*;

use super::candidates::{self, POOL, SCAN, Wanted};
use super::covariance::{Scaling, covariance};
use super::coverage::COVERAGE_FACTOR;
use super::estimate::{Tier, few_directions};
use super::opening::Opening;
use super::problem::{Problem, Values};
use super::profile::{bootstrap, profile};
use super::search::{
    CALM, Effort, FINE, FOLLOWED, OTHER_ROUGHNESSES, PROMISING_EVERY, REFINED, REFINED_IN_ROUND,
    REFINED_THOROUGHLY, RIVALS, ROUGH, descend, descended_in_round, many_minima, over_shapes,
    usable,
};
use super::settle::{DOUBTFUL, NARROW_TRIALS, Settled, TRIALS};
use super::solver::{Minimum, minimise};
use super::thin;
use super::variants::refused;
use super::{FitOptions, VariantChoice};
use crate::material::Material;
use crate::model::Variant;
use crate::observation::ObservationSet;

/// Candidates that are descended to time one, and shapes whose roughnesses are scanned.
const TRIED: usize = 8;
const SCANNED: usize = 2;
/// The forecast descends one in this many of the unselected starts of a round.
const PLAIN_TRIED: u32 = 24;
/// Descents per start of a thorough round: every third start is descended twice.
const DESCENTS: f64 = 4.0 / 3.0;
/// Ends reached from the images of a round.
const IMAGES: f64 = 7.0;
/// Descents needed to settle an end again with other weights: such ends are in valleys.
const SETTLING: f64 = 10.0;
/// Passes of tier and refit from the end of a search.
const PASSES: f64 = 3.5;
/// Passes of tier and refit from another end. It starts farther from its minimum, on a surface that costs more.
const TRIAL_PASSES: f64 = 8.0;
/// Rounds before the calm ones in a search that persists.
const BEFORE_CALM: usize = 2;
/// Evaluations of all observations of very large series, per variant.
const EVALUATIONS_OF_ALL: f64 = 40.0;
/// Series drawn to time a bootstrap.
const DRAWN: u32 = 20;

/// Forecast of the duration of a fit, s.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outlook {
    /// Searches, settling and integrated double reflections of both closed variants.
    pub search_s: f64,
    /// Profile-likelihood intervals.
    pub profile_s: f64,
    /// Bootstrap intervals.
    pub bootstrap_s: f64,
    /// End of the first round of the sawtooth.
    pub values: Values,
}

/// Inputs of a forecast.
struct Look<'o> {
    options: &'o FitOptions,
    now: &'o dyn Fn() -> f64,
    cancel: &'o AtomicBool,
}

impl Look<'_> {
    /// Runs some work and returns its result and its seconds.
    fn timed<T>(&self, work: impl FnOnce() -> T) -> (T, f64) {
        let before = (self.now)();
        let found = work();
        (found, (self.now)() - before)
    }
}

/// Forecasts the duration of a fit of these observations by the clock `now` (s), without the passes of the ray tracer.
/// Returns `None` if there is nothing to fit.
#[must_use]
pub fn outlook(
    set: &ObservationSet,
    options: &FitOptions,
    tier: Option<Tier<'_>>,
    now: &dyn Fn() -> f64,
    cancel: &AtomicBool,
) -> Option<Outlook> {
    if refused(set, options).is_some() {
        return None;
    }
    let look = Look {
        options,
        now,
        cancel,
    };
    let few = thin::representative(set).map(|kept| thin::subset(set, &kept));
    let seen = few.as_ref().unwrap_or(set);
    let (printed, paper_s) = look.variant(seen, Variant::Paper, None)?;
    let (sawtooth, sawtooth_s) = look.variant(seen, Variant::Sawtooth, tier)?;
    let values = sawtooth.problem.unpack(&sawtooth.minimum.parameters);
    let mut search_s = paper_s + sawtooth_s;
    if few.is_some() {
        let free = sawtooth.problem.free().to_vec();
        let all = Problem::new(set, Variant::Sawtooth, free, values);
        let (_, evaluation_s) = look.timed(|| std::hint::black_box(all.predicted(&values)));
        search_s += 2.0 * EVALUATIONS_OF_ALL * evaluation_s;
    }
    let main = match options.variant {
        VariantChoice::Paper => printed,
        _ => sawtooth,
    };
    Some(Outlook {
        search_s,
        profile_s: if options.profile {
            look.profiles(&main)
        } else {
            0.0
        },
        bootstrap_s: look.draws(&main),
        values,
    })
}

impl Look<'_> {
    /// Returns the settled end of a variant's first round, and the seconds of its complete estimate.
    fn variant<'a>(
        &self,
        set: &'a ObservationSet,
        variant: Variant,
        tier: Option<Tier<'_>>,
    ) -> Option<(Settled<'a>, f64)> {
        let (options, cancel) = (self.options, self.cancel);
        let (opening, opened_s) = self.timed(|| Opening::new(set, variant, options));
        let weighing = opening.weighing(options, cancel);
        let (search, looked_s) = self.timed(|| opening.search(options, &|| false, cancel));
        let mut settled = opening.settling(search.best()?.clone(), options);
        let ((), settled_s) = self.timed(|| settled.settle(&weighing));
        let goes_on = !options.starts_alone;
        let rounds = opening
            .rounds(&search, options)
            .max(usize::from(goes_on && few_directions(set)));
        let open = settled.open();
        let noise_alone = settled.discrepancy == 0.0;
        let misfit = options.misfit;
        let demands = goes_on && misfit && settled.doubted();
        let again = goes_on && misfit && tier.is_some() && settled.narrow();
        let many = goes_on && many_minima(&settled.problem, &settled.minimum);
        let persists = many && (noise_alone || !misfit);
        let mut seconds = opened_s + looked_s + settled_s;
        if rounds > 0 || demands || again || persists {
            let costs = self.costs(&opening.problem, &opening.fixed);
            let first = Effort::first(options);
            let later = if open { Effort::NOISE } else { first };
            seconds += rounds as f64 * costs.round(first);
            if demands {
                seconds += costs.thorough(later) + RIVALS as f64 * SETTLING * costs.fine_s;
            }
            if again {
                seconds += costs.thorough(later);
            }
            if persists {
                let plain = f64::from(descended_in_round(&opening.problem)) * costs.plain_s;
                let promising = costs.round(Effort::NOISE) / PROMISING_EVERY as f64;
                let fine = (FOLLOWED + REFINED_IN_ROUND) as f64 * costs.fine_s;
                let each = promising + plain + fine;
                seconds += (CALM + BEFORE_CALM) as f64 * each;
            }
        }
        if let Some(tier) = tier {
            let values = settled.problem.unpack(&settled.minimum.parameters);
            let (_, tier_s) = self.timed(|| tier(&settled.problem, &values));
            let mut trials = 0;
            if again && !noise_alone {
                trials += NARROW_TRIALS;
            }
            if settled.discrepancy > DOUBTFUL {
                trials += TRIALS;
            }
            // Plastic is fitted with polarisation and without.
            let ways = match settled.problem.set().material {
                Material::Dielectric { .. } => 2.0,
                Material::Conductor { .. } => 1.0,
            };
            let passes = if thin::dispensable(&settled, tier, options).is_none() {
                ways * PASSES + TRIAL_PASSES * trials as f64
            } else {
                1.0
            };
            seconds += passes * (tier_s + settled_s);
        }
        Some((settled, seconds))
    }

    /// Times the parts of a round from a few of each.
    fn costs(&self, problem: &Problem<'_>, fallback: &Values) -> Costs {
        let wanted = Wanted {
            scanned: SCANNED,
            starts: TRIED,
            seed: self.options.seed,
        };
        let (starts, judged_s) = self.timed(|| candidates::starts(problem, fallback, None, wanted));
        let cancel = self.cancel;
        let (ends, descended_s) = self.timed(|| {
            let ends = starts
                .par_iter()
                .map(|v| over_shapes(problem, v, &ROUGH, cancel));
            ends.filter(usable).collect::<Vec<Minimum>>()
        });
        let bounds = problem.bounds();
        // Enough to fill all lanes of all processors.
        let count = (descended_in_round(problem) / PLAIN_TRIED).max(TRIED as u32);
        let plain = candidates::plain(problem, fallback, count, self.options.seed);
        let (_, plain_s) = self.timed(|| descend(problem, &plain, &|| false, cancel));
        let (_, refined_s) = self.timed(|| {
            let fine = |m: &Minimum| minimise(problem, &m.parameters, &bounds, &FINE, cancel);
            ends.par_iter().map(fine).collect::<Vec<Minimum>>()
        });
        let judged = f64::from(POOL) + SCANNED as f64 * f64::from(SCAN * SCAN);
        Costs {
            residuals: problem.residual_count(),
            judged_s: judged_s / judged,
            rough_s: descended_s / starts.len().max(1) as f64,
            plain_s: plain_s / plain.len().max(1) as f64,
            fine_s: refined_s / ends.len().max(1) as f64,
        }
    }

    /// Forecasts the seconds of all profiles from one.
    fn profiles(&self, main: &Settled<'_>) -> f64 {
        let (problem, minimum) = (&main.problem, &main.minimum);
        let rows = problem.residual_count();
        let count = problem.free().len();
        if minimum.jacobian.len() != rows * count {
            return 0.0;
        }
        let known = covariance(
            &minimum.jacobian,
            rows,
            &minimum.residuals,
            Scaling::Absolute,
        );
        let guess = COVERAGE_FACTOR * known.matrix[(0, 0)].sqrt();
        let rise = COVERAGE_FACTOR * COVERAGE_FACTOR;
        let (_, one_s) = self.timed(|| profile(problem, minimum, 0, guess, rise, self.cancel));
        count as f64 * one_s
    }

    /// Forecasts the seconds of all drawn series from a few.
    fn draws(&self, main: &Settled<'_>) -> f64 {
        let wanted = self.options.bootstrap;
        if wanted == 0 {
            return 0.0;
        }
        let drawn = wanted.min(DRAWN);
        let (_, few_s) = self.timed(|| {
            let (problem, minimum) = (&main.problem, &main.minimum);
            bootstrap(
                problem,
                minimum,
                drawn,
                self.options.seed,
                &|| false,
                self.cancel,
            )
        });
        few_s / f64::from(drawn) * f64::from(wanted)
    }
}

/// Seconds per item when many items run on all processors.
struct Costs {
    residuals: usize,
    /// Judging a candidate with its best amplitudes.
    judged_s: f64,
    /// A descent that only has to come near a minimum.
    rough_s: f64,
    /// The same from one of the many unselected starts.
    plain_s: f64,
    /// A descent to full accuracy.
    fine_s: f64,
}

impl Costs {
    /// Seconds of a round of candidates.
    fn thorough(&self, effort: Effort) -> f64 {
        let judged = f64::from(POOL) + effort.scanned as f64 * f64::from(SCAN * SCAN);
        let starts = effort.starts(self.residuals) as f64;
        judged * self.judged_s
            + DESCENTS * starts * self.rough_s
            + REFINED_THOROUGHLY as f64 * self.fine_s
    }

    /// Seconds of the same with other roughnesses and the images of its best ends.
    fn round(&self, effort: Effort) -> f64 {
        let again = effort.rescanned as f64;
        self.thorough(effort)
            + again * f64::from(SCAN * SCAN) * self.judged_s
            + again * OTHER_ROUGHNESSES as f64 * self.rough_s
            + (REFINED as f64 + IMAGES) * self.fine_s
    }
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::super::painted::{TRUTH, painted};
    use super::super::tier::two_bounces;
    use super::*;
    use crate::geometry::Pose;

    fn grid(tilts: u32, turns: u32) -> Vec<Pose> {
        let step = 360.0 / f64::from(turns);
        let turns = (0..turns).map(move |p| step * f64::from(p));
        turns
            .flat_map(|p| (0..tilts).map(move |t| Pose::from_deg(5.0 * f64::from(t) - 20.0, p)))
            .collect()
    }

    /// Forecasts with a clock that advances by a second at each reading, so that it counts pieces of work.
    fn forecast(set: &ObservationSet, options: &FitOptions) -> Option<Outlook> {
        let ticks = Cell::new(0.0);
        let now = || {
            ticks.set(ticks.get() + 1.0);
            ticks.get()
        };
        outlook(
            set,
            options,
            Some(&two_bounces),
            &now,
            &AtomicBool::new(false),
        )
    }

    #[test]
    fn doubtful_data_are_forecast_to_take_longer() {
        let seen = painted(grid(9, 12).into_iter(), &TRUTH, 1e-3, 1);
        let narrow = Values {
            alpha_u: 0.02,
            alpha_v: 0.02,
            ..TRUTH
        };
        let missed = painted(grid(4, 6).into_iter(), &narrow, 1e-3, 1);
        let options = FitOptions::default();
        let (clear, doubtful) = (forecast(&seen, &options), forecast(&missed, &options));
        let (clear, doubtful) = (clear.unwrap(), doubtful.unwrap());
        assert!(doubtful.search_s > clear.search_s, "{clear:?} {doubtful:?}");
        assert_eq!((clear.profile_s, clear.bootstrap_s), (0.0, 0.0));
        assert!((clear.values.folded().theta_r - TRUTH.theta_r).abs() < 0.01);
    }

    #[test]
    fn only_requested_intervals_are_forecast_and_nothing_if_no_fit_is_possible() {
        let seen = painted(grid(9, 12).into_iter(), &TRUTH, 1e-3, 1);
        let options = FitOptions {
            profile: true,
            bootstrap: 200,
            ..FitOptions::default()
        };
        let all = forecast(&seen, &options).unwrap();
        // One profile is timed for all, and 20 series for 200.
        assert!(
            all.profile_s >= 6.0 && (all.bootstrap_s - 10.0).abs() < 1e-9,
            "{all:?}"
        );
        let two = painted(grid(2, 1).into_iter(), &TRUTH, 1e-3, 1);
        assert_eq!(forecast(&two, &options), None);
    }
}
