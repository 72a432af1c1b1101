//! Why a profile is invalid; the messages are for its author.

/// Why a profile is invalid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ProfileError {
    /// The roundings meet each other.
    #[error(
        "round_um = {round} is too large: the roundings of crest and valley would meet (largest: {largest:.3})"
    )]
    TooRound {
        /// The requested radius.
        round: f64,
        /// The largest possible radius.
        largest: f64,
    },
    /// The table is not a profile.
    #[error("expected a profile of two columns, v and height, got {columns} columns")]
    NotTwoColumns {
        /// Number of columns.
        columns: usize,
    },
    /// The heights are a map.
    #[error(
        "this is a map of {rows} rows of heights, not a profile: give one row, or shape = \"file\""
    )]
    Map {
        /// Number of rows.
        rows: usize,
    },
    /// Too few rows for a period.
    #[error("a profile needs three rows or more, v and height each; there are {rows}")]
    TooShort {
        /// Number of rows.
        rows: usize,
    },
    /// A position does not increase.
    #[error(
        "row {row}: v = {v} does not increase: sort the rows by v; overhanging walls are not traced"
    )]
    NotIncreasing {
        /// From 1, for the first row of numbers.
        row: usize,
        /// Its position.
        v: f64,
    },
    /// A row without a finite number.
    #[error("row {row}: position or height is not a finite number")]
    NotFinite {
        /// From 1, for the first row of numbers.
        row: usize,
    },
    /// The two ends do not meet.
    #[error(
        "the last row must close the period, but its height {last} differs from the first height {first}: level the profile and crop it to whole periods"
    )]
    Open {
        /// First height.
        first: f64,
        /// Last height.
        last: f64,
    },
    /// The profile has no facets.
    #[error("no part of the profile leans towards +v: check that it is neither flat nor reversed")]
    LeansNowhere,
    /// The riser would be too flat.
    #[error(
        "draft_deg = {draft_deg} is too large: the riser would be flat (it must be below {limit_deg:.1})"
    )]
    TooFlat {
        /// The requested draft.
        draft_deg: f64,
        /// The upper limit.
        limit_deg: f64,
    },
}
