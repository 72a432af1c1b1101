//! How parts and groups of a study are combined, and the factors of its analysis of variance.

use serde::{Deserialize, Serialize};

/// What reproducibility is taken over.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum GroupedBy {
    /// The person at the rig.
    Operator,
    /// The day of the scan in UTC.
    Day,
}

impl GroupedBy {
    /// The word used in requests and messages.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            GroupedBy::Operator => "operator",
            GroupedBy::Day => "day",
        }
    }
}

/// How parts and groups are combined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum GaugeDesign {
    /// Parts were measured by several groups.
    Crossed,
    /// Each part belongs to one group.
    PartsWithinGroups,
    /// Each group measured one part.
    GroupsWithinParts,
    /// Several parts without groups.
    PartsOnly,
    /// One part by several groups.
    GroupsOnly,
}

/// A source of variation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum VarianceSource {
    /// Differences between parts.
    Part,
    /// Differences between operators or days.
    Group,
    /// Differences between groups that differ from part to part.
    Interaction,
    /// Repeated scans of one part by one group.
    Repeat,
}

/// Sources with the level of each value, in the order of the analysis.
pub(super) type Factors = Vec<(VarianceSource, Vec<usize>)>;

/// Number of levels.
pub(super) fn count(levels: &[usize]) -> usize {
    levels.iter().max().map_or(0, |last| last + 1)
}

/// For each level of one factor, the number of levels of another one beside it.
fn beside(of: &[usize], other: &[usize]) -> Vec<usize> {
    let mut seen = vec![std::collections::BTreeSet::new(); count(of)];
    for (level, partner) in of.iter().zip(other) {
        seen[*level].insert(*partner);
    }
    seen.iter().map(std::collections::BTreeSet::len).collect()
}

/// Levels of the combinations of part and group.
pub(super) fn cells(parts: &[usize], groups: &[usize]) -> Vec<usize> {
    let mut known: Vec<(usize, usize)> = Vec::new();
    let pairs = parts.iter().copied().zip(groups.iter().copied());
    pairs
        .map(|pair| match known.iter().position(|other| *other == pair) {
            Some(at) => at,
            None => {
                known.push(pair);
                known.len() - 1
            }
        })
        .collect()
}

/// Whether all combinations have the same number of values.
pub(super) fn is_balanced(parts: &[usize], groups: Option<&[usize]>) -> bool {
    let cells = groups.map_or_else(|| parts.to_vec(), |groups| cells(parts, groups));
    let mut sizes = vec![0; count(&cells)];
    for cell in &cells {
        sizes[*cell] += 1;
    }
    let complete = groups.is_none_or(|groups| {
        let (of_parts, of_groups) = (beside(parts, groups), beside(groups, parts));
        let even = |all: &[usize]| all.windows(2).all(|pair| pair[0] == pair[1]);
        even(&of_parts) && even(&of_groups)
    });
    complete && sizes.windows(2).all(|pair| pair[0] == pair[1])
}

/// Chooses the design that the data allow.
///
/// # Errors
/// Why there is none, and what to measure.
pub(super) fn design(
    parts: &[usize],
    groups: Option<&[usize]>,
    word: &str,
    notes: &mut Vec<String>,
) -> Result<(GaugeDesign, Factors), String> {
    use VarianceSource::{Group, Interaction, Part};
    let of_parts = || (Part, parts.to_vec());
    let Some(groups) = groups.filter(|groups| count(groups) > 1) else {
        if count(parts) < 2 {
            return Err(
                "one part, without groups: gauge R&R needs several parts, or scans of this part by several operators or on \
                 several days"
                    .into(),
            );
        }
        notes.push(match groups {
            Some(_) => format!("One {word}: reproducibility cannot be determined."),
            None => "No operators and one day: reproducibility cannot be determined.".to_owned(),
        });
        return Ok((GaugeDesign::PartsOnly, vec![of_parts()]));
    };
    let of_groups = || (Group, groups.to_vec());
    if count(parts) < 2 {
        return Ok((GaugeDesign::GroupsOnly, vec![of_groups()]));
    }
    let one = |all: Vec<usize>| all.iter().all(|n| *n == 1);
    let part_has_one = one(beside(parts, groups));
    let group_has_one = one(beside(groups, parts));
    Ok(match (part_has_one, group_has_one) {
        (true, true) => {
            notes.push(format!(
                "Each part has its own {word}: differences between parts contain those between {word}s."
            ));
            (GaugeDesign::PartsOnly, vec![of_parts()])
        }
        (true, false) => (
            GaugeDesign::PartsWithinGroups,
            vec![of_groups(), of_parts()],
        ),
        (false, true) => (
            GaugeDesign::GroupsWithinParts,
            vec![of_parts(), of_groups()],
        ),
        (false, false) => {
            let cells = (Interaction, cells(parts, groups));
            (GaugeDesign::Crossed, vec![of_parts(), of_groups(), cells])
        }
    })
}
