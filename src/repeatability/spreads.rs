//! Components of variance as standard deviations with degrees of freedom and intervals.

use rand::SeedableRng;
use rand_distr::{ChiSquared, Distribution};
use serde::Serialize;

use super::anova::{Share, components};
use super::design::{Factors, VarianceSource};
use crate::wording::counted;

/// Degrees of freedom of a mean square, at least, for an interval: with one, the interval spans a factor of 70.
const FREEDOM_MIN: usize = 2;
const DRAWS: usize = 20_000;
const SEED: u64 = 37;
/// Distinct categories: √2 of the parts' standard deviation over that of the gauge; the manual has 1.41.
const CATEGORIES: f64 = 1.41;

/// A standard deviation with its degrees of freedom and interval.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct GaugeSpread {
    /// Standard deviation, in the unit of the parameter; 0 for a component that the data do not show.
    pub std: f64,
    /// Effective degrees of freedom.
    pub degrees_of_freedom: Option<f64>,
    /// Interval of 95 % for the standard deviation.
    pub interval: Option<[f64; 2]>,
    /// Share of the standard deviation of the total, percent; the shares of components do not add up to 100.
    pub percent_of_total: Option<f64>,
    /// Why there is no interval.
    pub note: Option<String>,
}

/// A number with its interval.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct GaugeNumber {
    /// Estimate.
    pub value: f64,
    /// Interval of 95 %.
    pub interval: Option<[f64; 2]>,
    /// Why there is no interval.
    pub note: Option<String>,
}

/// Variances of the components in one draw, or of the estimate.
#[derive(Debug, Clone, Copy, Default)]
struct Variances {
    repeat: f64,
    group: f64,
    part: f64,
}

impl Variances {
    fn gauge(self) -> f64 {
        self.repeat + self.group
    }

    fn total(self) -> f64 {
        self.gauge() + self.part
    }
}

/// The components of variance with their draws.
pub(super) struct Evaluation<'a> {
    sources: Vec<VarianceSource>,
    found: &'a [Share],
    weights: Vec<Vec<f64>>,
    draws: Vec<Variances>,
}

impl<'a> Evaluation<'a> {
    /// Solves the analysis and draws from it.
    pub(super) fn new(factors: &Factors, found: &'a [Share]) -> Self {
        let sources = factors.iter().map(|(source, _)| *source);
        let mut evaluation = Evaluation {
            sources: sources.chain([VarianceSource::Repeat]).collect(),
            found,
            weights: components(found),
            draws: Vec::new(),
        };
        let mut random = rand_pcg::Pcg64::seed_from_u64(SEED);
        let spreads: Option<Vec<ChiSquared<f64>>> = found
            .iter()
            .map(|share| ChiSquared::new(share.degrees_of_freedom as f64).ok())
            .collect();
        let Some(spreads) = spreads else {
            return evaluation;
        };
        evaluation.draws = (0..DRAWS)
            .map(|_| {
                let drawn: Vec<f64> = found
                    .iter()
                    .zip(&spreads)
                    .map(|(share, spread)| share.sum_of_squares / spread.sample(&mut random))
                    .collect();
                evaluation.variances(&drawn)
            })
            .collect();
        evaluation
    }

    fn variances(&self, mean_squares: &[f64]) -> Variances {
        let mut all = Variances::default();
        for (source, weights) in self.sources.iter().zip(&self.weights) {
            let products = weights.iter().zip(mean_squares).map(|(w, ms)| w * ms);
            let variance = products.sum::<f64>().max(0.0);
            match source {
                VarianceSource::Part => all.part += variance,
                VarianceSource::Group | VarianceSource::Interaction => all.group += variance,
                VarianceSource::Repeat => all.repeat += variance,
            }
        }
        all
    }

    fn estimate(&self) -> Variances {
        let mean_squares: Vec<f64> = self.found.iter().map(Share::mean_square).collect();
        self.variances(&mean_squares)
    }

    /// Effective degrees of freedom of the sum of these components (Satterthwaite).
    fn freedom(&self, of: &[VarianceSource]) -> Option<f64> {
        let mut sum = vec![0.0; self.found.len()];
        for (source, weights) in self.sources.iter().zip(&self.weights) {
            if of.contains(source) {
                for (total, weight) in sum.iter_mut().zip(weights) {
                    *total += weight;
                }
            }
        }
        let parts = sum.iter().zip(self.found).map(|(weight, share)| {
            let part = weight * share.mean_square();
            (part, part * part / share.degrees_of_freedom as f64)
        });
        let (sum, squares) = parts.fold((0.0, 0.0), |(a, b), (c, d)| (a + c, b + d));
        (sum > 0.0 && squares > 0.0).then(|| sum * sum / squares)
    }

    /// Fewest degrees of freedom of the mean squares of these sources.
    fn fewest(&self, of: &[VarianceSource]) -> Option<(VarianceSource, usize)> {
        let all = self.sources.iter().zip(self.found);
        let all = all.filter(|(source, _)| of.contains(source));
        all.map(|(source, share)| (*source, share.degrees_of_freedom))
            .min_by_key(|(_, freedom)| *freedom)
    }

    fn interval(&self, quantity: impl Fn(Variances) -> f64) -> Option<[f64; 2]> {
        let mut all: Vec<f64> = self.draws.iter().map(|draw| quantity(*draw)).collect();
        all.sort_by(f64::total_cmp);
        let at =
            |share: f64| all.get((share * (all.len().saturating_sub(1)) as f64).round() as usize);
        let ends = [*at(0.025)?, *at(0.975)?];
        ends.iter().all(|end| end.is_finite()).then_some(ends)
    }
}

/// All quantities of a study.
pub(super) struct Quantities {
    pub(super) repeatability: GaugeSpread,
    pub(super) reproducibility: Option<GaugeSpread>,
    pub(super) gauge: GaugeSpread,
    pub(super) part_to_part: Option<GaugeSpread>,
    pub(super) total: Option<GaugeSpread>,
    pub(super) gauge_percent: Option<GaugeNumber>,
    pub(super) distinct_categories: Option<GaugeNumber>,
}

impl Quantities {
    /// Returns the quantities of a study; `word` is what a group is.
    pub(super) fn of(
        evaluation: &Evaluation,
        has_groups: bool,
        n_groups: usize,
        n_parts: usize,
        word: &str,
    ) -> Quantities {
        use VarianceSource::{Group, Interaction, Part, Repeat};
        let estimate = evaluation.estimate();
        let has_parts = evaluation.sources.contains(&Part);
        let too_few = |of: &[VarianceSource]| {
            let (source, freedom) = evaluation.fewest(of)?;
            (freedom < FREEDOM_MIN).then(|| match source {
                Group => format!(
                    "{} are too few for an interval: measure with at least 3",
                    counted(n_groups, word)
                ),
                Part => format!(
                    "{} are too few for an interval: measure at least 3",
                    counted(n_parts, "part")
                ),
                Interaction | Repeat => {
                    "too few repeated scans for an interval: repeat more".to_owned()
                }
            })
        };
        let spread = |of: &[VarianceSource], variance: fn(Variances) -> f64| {
            let note = too_few(of);
            let interval = match note {
                Some(_) => None,
                None => evaluation.interval(|draw| variance(draw).sqrt()),
            };
            let total = estimate.total().sqrt();
            GaugeSpread {
                std: variance(estimate).sqrt(),
                degrees_of_freedom: evaluation.freedom(of),
                interval,
                percent_of_total: (has_parts && total > 0.0)
                    .then(|| 100.0 * variance(estimate).sqrt() / total),
                note,
            }
        };
        let number = |quantity: &dyn Fn(Variances) -> f64| {
            let value = quantity(estimate);
            let note = too_few(&[Repeat, Group, Interaction, Part]);
            let interval = match note {
                Some(_) => None,
                None => evaluation.interval(quantity),
            };
            (has_parts && value.is_finite()).then_some(GaugeNumber {
                value,
                interval,
                note,
            })
        };
        let categories = |v: Variances| (CATEGORIES * (v.part / v.gauge()).sqrt()).floor().max(1.0);
        let all = [Repeat, Group, Interaction, Part];
        Quantities {
            repeatability: spread(&[Repeat], |v| v.repeat),
            reproducibility: has_groups.then(|| spread(&[Group, Interaction], |v| v.group)),
            gauge: spread(&[Repeat, Group, Interaction], Variances::gauge),
            part_to_part: has_parts.then(|| spread(&[Part], |v| v.part)),
            total: has_parts.then(|| spread(&all, Variances::total)),
            gauge_percent: number(&|v| 100.0 * (v.gauge() / v.total()).sqrt()),
            distinct_categories: number(&categories),
        }
    }
}
