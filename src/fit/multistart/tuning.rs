//! The constants of the search in one table, each with its reason.
//!
//! `cargo bench --bench fit_strata -- --constants` runs the search with each of them at half and at twice its value.

/// Values of the constants of a search. Counts are whole numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tuning {
    /// Starts of the first round if noise alone separates the minima, or other weights are tried.
    pub first_round: f64,
    /// Starts of all rounds.
    pub most_starts: f64,
    /// Starts that have reached the best minimum before a search ends.
    pub reached: f64,
    /// Evaluations of a start.
    pub evaluations: f64,
    /// Different ends of a round that are refined.
    pub refined: f64,
    /// Rise of the cost above the best minimum up to which minima are counted; less if the weights allow for more than
    /// the scatter.
    pub counted_rise: f64,
    /// Divisor of the number of starts if they descend one by one.
    pub one_by_one: f64,
}

/// One of the constants with its reason.
#[derive(Debug, Clone, Copy)]
pub struct Constant {
    /// Its name.
    pub name: &'static str,
    /// Why it has about this value.
    pub reason: &'static str,
    /// Its place.
    pub of: fn(&mut Tuning) -> &mut f64,
}

impl Tuning {
    /// The values in use.
    pub const DEFAULT: Tuning = Tuning {
        first_round: 1024.0,
        most_starts: 16384.0,
        reached: 2.0,
        evaluations: 60.0,
        refined: 24.0,
        counted_rise: 25.0,
        one_by_one: 64.0,
    };

    /// All constants with their reasons.
    pub const TABLE: [Constant; 7] = [
        Constant {
            name: "first_round",
            reason: "basins of one part in 300 are found, too; the rule alone would ask for 17 starts after one near minimum",
            of: |t| &mut t.first_round,
        },
        Constant {
            name: "most_starts",
            reason: "limits the time if noise makes more than 90 near minima",
            of: |t| &mut t.most_starts,
        },
        Constant {
            name: "reached",
            reason: "a deeper minimum with as wide a basin is missed in exp(−2), 14 %, of the searches that end",
            of: |t| &mut t.reached,
        },
        Constant {
            name: "evaluations",
            reason: "most descents are near their minimum after 60; the refinement continues the others",
            of: |t| &mut t.evaluations,
        },
        Constant {
            name: "refined",
            reason: "the deepest minimum may begin as one of the less deep ends of a round",
            of: |t| &mut t.refined,
        },
        Constant {
            name: "counted_rise",
            reason: "five standard deviations; minima above it do not compete with the best",
            of: |t| &mut t.counted_rise,
        },
        Constant {
            name: "one_by_one",
            reason: "outside of lanes a descent takes much longer; the first round then has 16",
            of: |t| &mut t.one_by_one,
        },
    ];
}

impl Default for Tuning {
    fn default() -> Self {
        Tuning::DEFAULT
    }
}
