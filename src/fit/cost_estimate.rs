//! Forecasts the duration of a fit.
//!
//! A search continues until its stopping rule is met, so its duration depends on the data. Call [`outlook`]: it runs the
//! first round of the fit, settles its result, derives the starts that will follow from the minima found, and times one
//! integration. The caller provides the clock.

use std::sync::atomic::AtomicBool;

use super::higher_order::{HigherOrder, dispensable, two_bounces};
use super::multistart::RIVALS;
use super::problem::{Problem, Values};
use super::report::refusals::refused;
use super::reweighting::{DOUBTFUL, NEAR_TRIALS, TRIALS, WeightedFit};
use super::search_setup::Opening;
use super::subsample;
use super::uncertainty::covariance::covariance;
use super::uncertainty::coverage::COVERAGE_FACTOR;
use super::uncertainty::profile::{bootstrap, profile};
use super::{FitOptions, VariantChoice};
use crate::material::Material;
use crate::model::Variant;
use crate::observation::ObservationSet;

/// Descents needed to settle an end again with other weights: such ends are in valleys.
const SETTLING: f64 = 10.0;
/// Passes of higher order and refit from the end of a search.
const USUAL_PASSES: f64 = 3.5;
/// Passes of higher order and refit from another end. It starts farther from its minimum, on a surface that costs more.
const TRIAL_PASSES: f64 = 8.0;
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
    let few = subsample::representative(set).map(|kept| subsample::subset(set, &kept));
    let seen = few.as_ref().unwrap_or(set);
    let (printed, paper_s) = look.variant(seen, Variant::Paper, None)?;
    let (sawtooth, sawtooth_s) = look.variant(seen, Variant::Sawtooth, Some(&two_bounces))?;
    let values = sawtooth.values();
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
        higher_order: Option<HigherOrder<'_>>,
    ) -> Option<(WeightedFit<'a>, f64)> {
        let (options, cancel) = (self.options, self.cancel);
        let (opening, opened_s) = self.timed(|| Opening::new(set, variant, options));
        let weighing = opening.weighing(options, cancel);
        let (mut search, opened_search_s) =
            self.timed(|| opening.search(options, &|| false, cancel));
        let goes_on = !options.starts_alone;
        let (first, most) = (options.tuning.first_round, options.tuning.most_starts);
        let ((), round_s) = self.timed(|| search.round(&opening.problem, first as u32));
        let ((), images_s) = self.timed(|| search.images(&opening.problem));
        let expected = search.starts_expected(&opening.problem);
        let rounds = |least: f64| expected.clamp(least, most.max(least)) / first;
        let least = if options.misfit { 0.0 } else { first };
        let mut settled = opening.settling(search.best()?.clone(), options);
        let ((), settled_s) = self.timed(|| settled.settle(&weighing));
        let noise_alone = settled.discrepancy == 0.0;
        let misfit = goes_on && options.misfit;
        let again = misfit && higher_order.is_some() && settled.has_rivals();
        let mut seconds = opened_s + opened_search_s + settled_s;
        if goes_on {
            seconds += rounds(least) * round_s + images_s;
        }
        if misfit && settled.doubted() {
            seconds += rounds(first) * round_s + RIVALS as f64 * SETTLING * images_s;
        }
        if again {
            seconds += rounds(first) * round_s;
        }
        if misfit && noise_alone {
            seconds += rounds(first) * round_s + images_s;
        }
        if let Some(higher_order) = higher_order {
            let values = settled.values();
            let (_, higher_order_s) = self.timed(|| higher_order(&settled.problem, &values));
            let mut trials = 0;
            if again && !noise_alone {
                trials += NEAR_TRIALS;
            }
            if settled.discrepancy > DOUBTFUL {
                trials += TRIALS;
            }
            // Plastic is fitted with polarisation and without.
            let ways = match settled.problem.set().material {
                Material::Dielectric { .. } => 2.0,
                Material::Conductor { .. } => 1.0,
            };
            let passes = if dispensable(&settled.problem, &values, higher_order, options).is_none()
            {
                ways * USUAL_PASSES + TRIAL_PASSES * trials as f64
            } else {
                1.0
            };
            seconds += passes * (higher_order_s + settled_s);
        }
        Some((settled, seconds))
    }

    /// Forecasts the seconds of all profiles from one.
    fn profiles(&self, main: &WeightedFit<'_>) -> f64 {
        let (problem, minimum) = (&main.problem, &main.minimum);
        let rows = problem.residual_count();
        let count = problem.free().len();
        if minimum.jacobian.len() != rows * count {
            return 0.0;
        }
        let known = covariance(&minimum.jacobian, rows, &minimum.residuals);
        let guess = COVERAGE_FACTOR * known.matrix[(0, 0)].sqrt();
        let rise = COVERAGE_FACTOR * COVERAGE_FACTOR;
        let (_, one_s) = self.timed(|| profile(problem, minimum, 0, guess, rise, self.cancel));
        count as f64 * one_s
    }

    /// Forecasts the seconds of all drawn series from a few.
    fn draws(&self, main: &WeightedFit<'_>) -> f64 {
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

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use crate::fit::painted::{TRUTH, painted};
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
        outlook(set, options, &now, &AtomicBool::new(false))
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
