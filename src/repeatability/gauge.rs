//! Gauge R&R: the scatter of results by repeatability, reproducibility (operators or days) and parts.
//!
//! Parts and groups (operators or days) are random factors of an analysis of variance ([`super::anova`]): crossed where
//! parts were measured by several groups, nested where each part belongs to one group or each group to one part. The
//! interaction is pooled with the repeatability where it is not significant, as in the manual of the AIAG (*Measurement
//! Systems Analysis*, 4th edition, 2010, chapter III.B). Negative components count as zero.
//!
//! *Intervals* are generalised confidence intervals of 95 % (Hamada and Weerahandi, *Measurement system assessment via
//! generalized inference*, J. Quality Technology 32, 2000): in every draw each mean square is divided by its own χ²/ν, and
//! all quantities follow from the same draws. For balanced data of normal errors and one mean square this is the χ²
//! interval itself. The seed is fixed, so the same scans give the same interval. *Degrees of freedom* are effective ones
//! (Satterthwaite).

use serde::Serialize;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

use super::anova::{Share, shares};
use super::design::{Factors, count, design, is_balanced};
pub use super::design::{GaugeDesign, GroupedBy, VarianceSource};
use super::spreads::{Evaluation, Quantities};
pub use super::spreads::{GaugeNumber, GaugeSpread};

/// An interaction with a larger probability is pooled with the repeatability.
const POOLED_ABOVE: f64 = 0.05;

/// A row of the analysis of variance.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct VarianceRow {
    /// Source of the variation.
    pub source: VarianceSource,
    /// Degrees of freedom.
    pub degrees_of_freedom: usize,
    /// Sum of squares, in the square of the parameter's unit.
    pub sum_of_squares: f64,
    /// Mean square, same unit.
    pub mean_square: f64,
}

/// A gauge R&R study.
#[derive(Debug, Clone, PartialEq, Serialize, utoipa::ToSchema)]
pub struct Gauge {
    /// How parts and groups are combined.
    pub design: GaugeDesign,
    /// What the groups are; null without groups.
    pub by: Option<GroupedBy>,
    /// Number of parts.
    pub n_parts: usize,
    /// Number of operators or days; 0 without groups.
    pub n_groups: usize,
    /// Whether all combinations have the same number of scans.
    pub balanced: bool,
    /// Probability of an interaction at least this large by chance; null where it cannot be tested.
    pub interaction_probability: Option<f64>,
    /// Whether the interaction is pooled with the repeatability.
    pub interaction_pooled: bool,
    /// The analysis of variance.
    pub rows: Vec<VarianceRow>,
    /// Repeated scans of one part by one group (equipment variation).
    pub repeatability: GaugeSpread,
    /// Differences between groups, with the interaction (appraiser variation); null without groups.
    pub reproducibility: Option<GaugeSpread>,
    /// Repeatability and reproducibility together (R&R).
    pub gauge: GaugeSpread,
    /// Differences between parts; null for one part.
    pub part_to_part: Option<GaugeSpread>,
    /// Gauge and parts together; null for one part.
    pub total: Option<GaugeSpread>,
    /// %GRR: standard deviation of the gauge as a share of the total, percent; null for one part.
    pub gauge_percent: Option<GaugeNumber>,
    /// Number of distinct categories of parts that the gauge can distinguish; null for one part.
    pub distinct_categories: Option<GaugeNumber>,
    /// What limits the study.
    pub notes: Vec<String>,
}

/// Evaluates results of parts (and groups, if there are any), each by the level of its value.
///
/// # Errors
/// Why the results have no components of variance, and what to measure.
pub fn gauge(
    values: &[f64],
    parts: &[usize],
    groups: Option<(GroupedBy, &[usize])>,
) -> Result<Gauge, String> {
    let by = groups.map(|(by, _)| by);
    let word = by.map_or("group", GroupedBy::as_str);
    let levels = groups.map(|(_, levels)| levels);
    let mut notes = Vec::new();
    let (design, mut factors) = design(parts, levels, word, &mut notes)?;
    let evaluate = |factors: &Factors| {
        let levels: Vec<Vec<usize>> = factors.iter().map(|(_, levels)| levels.clone()).collect();
        shares(values, &levels)
    };
    let mut found = evaluate(&factors);
    let rest = |found: &[Share]| found.last().map_or(0, |share| share.degrees_of_freedom);
    let has_interaction = |factors: &Factors| {
        factors.last().map(|(source, _)| *source) == Some(VarianceSource::Interaction)
    };
    if rest(&found) == 0 && has_interaction(&factors) {
        notes.push(format!(
            "No {word} measured a part twice: the repeatability contains the interaction."
        ));
        factors.pop();
        found = evaluate(&factors);
    }
    if rest(&found) == 0 {
        let same = match by {
            Some(GroupedBy::Operator) => " by one operator",
            Some(GroupedBy::Day) => " on one day",
            None => "",
        };
        return Err(format!(
            "no part was measured twice{same}: repeatability needs at least two scans of a part{same}"
        ));
    }
    let mut pooled = false;
    let mut probability = None;
    if has_interaction(&factors) {
        let share = &found[factors.len() - 1];
        if share.degrees_of_freedom > 0 {
            probability = exceeded(share, &found[factors.len()]);
        }
        pooled = share.degrees_of_freedom == 0 || probability.is_some_and(|p| p > POOLED_ABOVE);
        if pooled {
            factors.pop();
            found = evaluate(&factors);
        }
    }
    let evaluation = Evaluation::new(&factors, &found);
    let has = |source| factors.iter().any(|(s, _)| *s == source);
    let n_parts = count(parts);
    let n_groups = levels.map_or(0, count);
    let quantities = Quantities::of(
        &evaluation,
        has(VarianceSource::Group),
        n_groups,
        n_parts,
        word,
    );
    Ok(Gauge {
        design,
        by: by.filter(|_| has(VarianceSource::Group)),
        n_parts,
        n_groups,
        balanced: is_balanced(parts, levels),
        interaction_probability: probability,
        interaction_pooled: pooled && probability.is_some(),
        rows: rows(&factors, &found),
        repeatability: quantities.repeatability,
        reproducibility: quantities.reproducibility,
        gauge: quantities.gauge,
        part_to_part: quantities.part_to_part,
        total: quantities.total,
        gauge_percent: quantities.gauge_percent,
        distinct_categories: quantities.distinct_categories,
        notes,
    })
}

fn exceeded(share: &Share, rest: &Share) -> Option<f64> {
    let f = share.mean_square() / rest.mean_square();
    let distribution = FisherSnedecor::new(
        share.degrees_of_freedom as f64,
        rest.degrees_of_freedom as f64,
    )
    .ok()?;
    f.is_finite().then(|| distribution.sf(f))
}

fn rows(factors: &Factors, found: &[Share]) -> Vec<VarianceRow> {
    let sources = factors.iter().map(|(source, _)| *source);
    let sources = sources.chain([VarianceSource::Repeat]);
    let all = sources.zip(found).map(|(source, share)| VarianceRow {
        source,
        degrees_of_freedom: share.degrees_of_freedom,
        sum_of_squares: share.sum_of_squares,
        mean_square: share.mean_square(),
    });
    all.collect()
}

#[cfg(test)]
#[path = "gauge_tests.rs"]
mod tests;
