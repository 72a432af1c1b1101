//! What a reduction has to tell besides its numbers: frames left out, and warnings.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use crate::observation::RejectedFrame;
use crate::series::FrameRow;

/// Why one frame is left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Rejection {
    /// Stable word.
    pub(super) reason: Cow<'static, str>,
    /// What was seen.
    pub(super) detail: String,
}

impl Rejection {
    pub(super) fn new(reason: &'static str, detail: impl Into<String>) -> Self {
        Rejection {
            reason: reason.into(),
            detail: detail.into(),
        }
    }
}

/// Rejected frames and warnings as they come up.
#[derive(Debug, Clone, Default)]
pub(super) struct ReductionLog {
    rejected: Vec<(usize, Rejection)>,
    warnings: Vec<String>,
}

impl ReductionLog {
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

    /// Takes over what another log has.
    pub(super) fn extend(&mut self, other: &ReductionLog) {
        for (index, rejection) in &other.rejected {
            self.reject(*index, rejection.clone());
        }
        for sentence in &other.warnings {
            self.warn(sentence.clone());
        }
    }

    /// Frames that were left out, with their places in the list, and the warnings.
    pub(super) fn parts(&self) -> (&[(usize, Rejection)], &[String]) {
        (&self.rejected, &self.warnings)
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
                reason: rejection.reason.into_owned(),
                detail: rejection.detail,
            })
            .collect();
        (rejected, self.warnings)
    }
}
