//! Stiff and extreme cases of everything that computes, each with what is expected and what was found.
//!
//! Call [`run`]. Expectations are never the program's own words: they come from tables in 60-digit
//! arithmetic (`tests/data/extreme`, made by `tools/extreme_reference.py`), from laws (reciprocity,
//! conservation of energy, a change of units), from closed limits (a roughness or an index step that
//! vanishes), from a truth that was put in, or are a refusal by name. No reference value and no
//! tolerance of a row stands in this code: [`criterion`] has one tolerance per kind of expectation,
//! derived there. It reads no files and knows no terminal.

pub mod criterion;
mod fits;
mod forms;
mod frames;
mod maps;
mod traced;

use std::sync::atomic::{AtomicBool, Ordering};

use serde::Serialize;

use criterion::Judged;

use crate::model::LeftOut;

/// How much time a check may take.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Effort {
    /// Without the million observations and with fewer photons: for a debug build.
    Quick,
    /// Everything.
    Full,
}

/// One case.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Which part of the program.
    pub area: &'static str,
    /// What is extreme about it.
    pub case: String,
    /// What is compared.
    pub quantity: String,
    /// Where the expectation comes from.
    pub source: &'static str,
    /// Expected, found, allowed, and whether that is as expected.
    #[serde(flatten)]
    pub judged: Judged,
}

impl Row {
    fn new(
        area: &'static str,
        case: impl Into<String>,
        quantity: impl Into<String>,
        source: &'static str,
        judged: Judged,
    ) -> Self {
        Row {
            area,
            case: case.into(),
            quantity: quantity.into(),
            source,
            judged,
        }
    }
}

/// A part of the table.
type Part = fn(Effort, &AtomicBool) -> Vec<Row>;

const PARTS: [(&str, Part); 5] = [
    ("closed forms", forms::rows),
    ("tracer", traced::rows),
    ("frames", frames::rows),
    ("fits", fits::rows),
    ("maps", maps::rows),
];

/// What a check of some effort does without.
#[must_use]
pub fn left_out(effort: Effort) -> Vec<LeftOut> {
    match effort {
        Effort::Full => Vec::new(),
        Effort::Quick => vec![
            LeftOut::new(
                "the fit of a million observations",
                "--quick: it takes as long as all others together",
                None,
            ),
            LeftOut::new(
                "most photons and most pixels",
                "--quick: sampled values are compared within wider standard errors",
                None,
            ),
        ],
    }
}

/// Computes all rows; `started` is told the name of each part before it starts and how many parts are
/// done of how many. Ends early, with the rows so far, once `cancel` is raised.
pub fn run(
    effort: Effort,
    cancel: &AtomicBool,
    started: &mut dyn FnMut(&str, usize, usize),
) -> Vec<Row> {
    let mut rows = Vec::new();
    for (done, (name, part)) in PARTS.iter().enumerate() {
        if cancel.load(Ordering::Relaxed) {
            break;
        }
        started(name, done, PARTS.len());
        rows.extend(part(effort, cancel));
    }
    rows
}
