//! What a reduction has to tell besides its numbers: frames left out, and warnings.

use crate::observation::RejectedFrame;
use crate::series::FrameRow;

/// Why one frame is left out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Rejection {
    /// Stable word.
    pub(super) reason: &'static str,
    /// What was seen.
    pub(super) detail: String,
}

impl Rejection {
    pub(super) fn new(reason: &'static str, detail: impl Into<String>) -> Self {
        Rejection {
            reason,
            detail: detail.into(),
        }
    }
}

/// Rejected frames and warnings as they come up.
#[derive(Debug, Default)]
pub(super) struct Journal {
    rejected: Vec<(usize, Rejection)>,
    warnings: Vec<String>,
}

impl Journal {
    /// Leaves frame `index` out. The first reason stays.
    pub(super) fn reject(&mut self, index: usize, rejection: Rejection) {
        if !self.has_rejected(index) {
            self.rejected.push((index, rejection));
        }
    }

    pub(super) fn has_rejected(&self, index: usize) -> bool {
        self.rejected.iter().any(|(i, _)| *i == index)
    }

    /// Frames that were left out for one reason, in the order in which they came up.
    pub(super) fn rejected_for(&self, reason: &str) -> impl Iterator<Item = (usize, &Rejection)> {
        let rejected = self.rejected.iter();
        rejected
            .filter(move |(_, rejection)| rejection.reason == reason)
            .map(|(index, rejection)| (*index, rejection))
    }

    pub(super) fn warn(&mut self, sentence: String) {
        if !self.warnings.contains(&sentence) {
            self.warnings.push(sentence);
        }
    }

    /// Rejected frames sorted by file name, and the warnings in the order they came up.
    pub(super) fn close(mut self, rows: &[FrameRow]) -> (Vec<RejectedFrame>, Vec<String>) {
        self.rejected
            .sort_by(|a, b| rows[a.0].file.cmp(&rows[b.0].file));
        let rejected = self
            .rejected
            .into_iter()
            .map(|(index, rejection)| RejectedFrame {
                file: rows[index].file.clone(),
                reason: rejection.reason.to_owned(),
                detail: rejection.detail,
            })
            .collect();
        (rejected, self.warnings)
    }
}
