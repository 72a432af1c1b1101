//! The points that reference checks may have to withdraw, and which of them are confirmed.

use std::time::Duration;

use crate::frame::FrameKind;
use crate::scan::look::Look;
use crate::scan::plan::Shot;
use crate::scan::reference::{Covered, Visited, forget};

/// A point that was accepted, and how it looks.
#[derive(Debug, Clone)]
pub(super) struct Seen {
    pub shot: Shot,
    /// Of the first frame that can be compared.
    pub look: Option<Look>,
    predicted: Duration,
    /// Change of the light until then.
    pub drift: f64,
    /// Number of points, from the first one remembered, when a look at it last agreed, or when it was taken.
    agreed_after: usize,
}

/// The points of the sample that this run and earlier ones took.
#[derive(Debug, Default)]
pub(super) struct Points {
    /// Accepted points, in the order taken.
    pub seen: Vec<Seen>,
    /// Which of them the reference checks covered.
    pub covered: Covered,
    /// How many of them were taken before an axis was homed: a slip that the homing mended shows only at the last of them.
    pub before_homing: usize,
    /// Points that no check can confirm any more.
    pub never_confirmed: usize,
    /// Change of the light over all checks.
    pub drift: f64,
    /// Whether it was reported.
    pub drift_reported: bool,
}

/// What the picture at a point, which has changed, says about the points before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Change {
    /// It came after the picture there was last as before.
    Since,
    /// A homing mended it, whenever it was.
    BeforeHoming,
    /// It lasts, so nothing that was taken before fits to it.
    Lasting,
}

impl Points {
    /// An axis was homed: the points so far may have been taken before a slip that shows no more.
    pub(super) fn homed(&mut self) {
        self.before_homing = self.seen.len();
    }

    /// Points without a look at a reference pose that would confirm them.
    pub(super) fn unconfirmed(&self) -> usize {
        let visited = self.visited();
        let trusted = self.covered.trusted(&visited);
        self.never_confirmed + visited.len().saturating_sub(trusted)
    }

    pub(super) fn visited(&self) -> Vec<Visited> {
        let of_point = |seen: &Seen| Visited {
            target: seen.shot.target.expect("only such points are remembered"),
            predicted: seen.predicted,
            exposure: seen.shot.longest_exposure(),
            level: seen
                .look
                .as_ref()
                .map(|look| look.level_dn() / look.exposure_s()),
        };
        self.seen.iter().map(of_point).collect()
    }

    /// Remembers an accepted point of the sample.
    pub(super) fn remember(&mut self, shot: &Shot, looks: &[Look], predicted_s: f64) {
        if shot.kind != FrameKind::Sample || shot.target.is_none() {
            return;
        }
        self.seen.push(Seen {
            agreed_after: self.seen.len() + 1,
            shot: shot.clone(),
            look: looks.iter().find(|look| look.is_comparable()).cloned(),
            predicted: Duration::try_from_secs_f64(predicted_s).unwrap_or_default(),
            drift: self.drift,
        });
        let before = self.seen.len();
        self.never_confirmed += forget(&mut self.seen, &mut self.covered);
        let forgotten = before - self.seen.len();
        for seen in &mut self.seen {
            seen.agreed_after -= forgotten.min(seen.agreed_after);
        }
        self.before_homing = self.before_homing.saturating_sub(forgotten);
    }

    /// Takes out the points that may be wrong since the picture at a point has changed.
    pub(super) fn take_suspects(&mut self, index: usize, change: Change) -> Vec<Seen> {
        let from = match change {
            // A pose that shows less may have confirmed more.
            Change::Since => Covered::suspect_from(self.seen[index].agreed_after, &self.visited()),
            Change::BeforeHoming => self.covered.confirmed,
            Change::Lasting => 0,
        };
        let suspects = self.seen.split_off(from);
        for seen in &mut self.seen {
            seen.agreed_after = seen.agreed_after.min(from);
        }
        self.covered.confirmed = self.covered.confirmed.min(from);
        self.covered.checked = self.covered.checked.min(from);
        suspects
    }

    /// The picture at a point is as before, but for a change of the level by this share.
    pub(super) fn agreed(&mut self, index: usize, level: f64) {
        let (before, since) = (self.drift, self.covered.checked);
        self.drift += level;
        // The light changes steadily from one check to the next.
        let n = self.seen.len().saturating_sub(since);
        for (i, seen) in self.seen[since..].iter_mut().enumerate() {
            seen.drift = before + level * (i + 1) as f64 / n as f64;
        }
        self.seen[index].agreed_after = self.seen.len();
        let visited = self.visited();
        self.covered.agreed(index, &visited);
    }
}
