//! Why a profile cannot be made, in words for who wrote it.

/// Why a profile cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ProfileError {
    /// The roundings meet each other.
    #[error(
        "round_um = {round} is too large: the roundings of crest and valley would meet (largest: {largest:.3})"
    )]
    TooRound {
        /// What was asked.
        round: f64,
        /// What would still go.
        largest: f64,
    },
    /// A table that is no profile.
    #[error("a profile has two columns, v and height, not {columns}")]
    NotTwoColumns {
        /// What it has.
        columns: usize,
    },
    /// A map that is no profile.
    #[error(
        "this is a map of {rows} rows of heights, not a profile: give one row, or shape = \"file\""
    )]
    Map {
        /// Rows that it has.
        rows: usize,
    },
    /// Too few rows for a period.
    #[error("a profile needs three rows or more, v and height each; there are {rows}")]
    TooShort {
        /// How many there are.
        rows: usize,
    },
    /// A position that does not come after the one before it.
    #[error("row {row}: v = {v} does not increase; overhanging walls are not traced")]
    NotIncreasing {
        /// 1 for the first row of numbers.
        row: usize,
        /// Its position.
        v: f64,
    },
    /// A row without a number.
    #[error("row {row}: position or height is not a finite number")]
    NotFinite {
        /// 1 for the first row of numbers.
        row: usize,
    },
    /// The two ends do not meet.
    #[error(
        "the last row closes the period, but its height {last} is not the first one's {first}: level the profile and cut it to whole periods"
    )]
    Open {
        /// First height.
        first: f64,
        /// Last height.
        last: f64,
    },
    /// No facets.
    #[error("no part of the profile leans towards +v; is it flat or reversed?")]
    LeansNowhere,
    /// The riser would not rise.
    #[error(
        "draft_deg = {draft_deg} is too large: the riser would lie flat (it must be below {limit_deg:.1})"
    )]
    TooFlat {
        /// What was asked.
        draft_deg: f64,
        /// What it must be below.
        limit_deg: f64,
    },
}
