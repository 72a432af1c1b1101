//! Stiff and extreme cases of every computation, each with its expected and its actual result.
//!
//! Call [`run`]. Expected values never come from the program itself. They come from tables in 60-digit
//! arithmetic (`tests/data/extreme`, made by `tools/extreme_reference.py`), from laws (reciprocity,
//! conservation of energy, a change of units), from closed limits (a roughness or an index step that
//! vanishes) or from a known truth; or the case must be refused with a stated reason. This code contains neither reference
//! values nor tolerances of single rows: [`criterion`] derives one tolerance per kind of expectation.
//! This module reads no files and prints nothing.

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

/// Extent of a check.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CheckEffort {
    /// Without the million observations and with fewer photons: for a debug build.
    Quick,
    /// Everything.
    Full,
}

/// One case of a check.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CheckRow {
    /// The part of the program.
    pub area: &'static str,
    /// The extreme property.
    pub case: String,
    /// The compared quantity.
    pub quantity: String,
    /// Source of the expected value.
    pub source: &'static str,
    /// Expected and actual value, tolerance, and whether they agree.
    #[serde(flatten)]
    pub judged: Judged,
}

impl CheckRow {
    fn new(
        area: &'static str,
        case: impl Into<String>,
        quantity: impl Into<String>,
        source: &'static str,
        judged: Judged,
    ) -> Self {
        CheckRow {
            area,
            case: case.into(),
            quantity: quantity.into(),
            source,
            judged,
        }
    }
}

/// Computes a part of the rows.
pub type CheckPart = fn(CheckEffort, &AtomicBool) -> Vec<CheckRow>;

/// Names of the parts, and the functions that compute them.
pub const PARTS: [(&str, CheckPart); 5] = [
    ("closed forms", forms::rows),
    ("tracer", traced::rows),
    ("frames", frames::rows),
    ("fits", fits::rows),
    ("maps", maps::rows),
];

/// The cases that an effort omits.
#[must_use]
pub fn left_out(effort: CheckEffort) -> Vec<LeftOut> {
    match effort {
        CheckEffort::Full => Vec::new(),
        CheckEffort::Quick => vec![
            LeftOut::new(
                "the fit of a million observations",
                "--quick: it takes as long as all other cases together",
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

/// Computes all rows. `started` gets the name of each part before it starts, and the numbers of finished and of all parts.
/// Ends early, with the rows so far, once `cancel` is raised.
pub fn run(
    effort: CheckEffort,
    cancel: &AtomicBool,
    started: &mut dyn FnMut(&str, usize, usize),
) -> Vec<CheckRow> {
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
