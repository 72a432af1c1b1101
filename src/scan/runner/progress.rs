//! How far a scan is: predicted times of its points and checks, and the pace so far.

use std::time::Duration;

use super::Runner;
use crate::geometry::Pose;
use crate::scan::event::Progress;
use crate::scan::plan::{Shot, Step};
use crate::scan::reference::Times;

/// State that grows with every point. Restored as a whole if a point could not be recorded.
#[derive(Clone, Copy, Default)]
pub(super) struct ProgressState {
    pub progress: Progress,
    /// Predicted time of the finished points, with those of earlier runs.
    pub predicted_done_s: f64,
    /// Predicted time of the points of this run, retakes included.
    pub ideal_s: f64,
    /// Last position read from the stages; `None` when unknown.
    pub at: Option<Pose>,
}

impl ProgressState {
    /// States which part of the predicted time `total_s`, s, is done, and the time left at a pace: spent over predicted time.
    fn state_share(&mut self, total_s: f64, pace: f64) {
        if total_s > 0.0 {
            self.progress.fraction = self.predicted_done_s / total_s;
        }
        self.progress.time_left_s = Some((total_s - self.predicted_done_s).max(0.0) * pace);
    }
}

impl Runner<'_> {
    /// Returns the totals of the plan and of the points that earlier runs finished.
    pub(super) fn count_what_is_left(&mut self) -> ProgressState {
        let mut totals = ProgressState::default();
        totals.progress.elapsed_s = self.run.elapsed_s;
        let move_time = |from, to| self.move_times.predict(from, to);
        let start = self.totals.at.unwrap_or(Pose::from_deg(0.0, 0.0));
        let reference = self.run.settings.reference;
        let limits = self.rig.limits();
        let times = Times {
            of_move: &move_time,
            of_homing: &|from| self.move_times.predict_homing(from),
        };
        let steps = &self.run.steps;
        let checks = reference.predicted(steps, start, &limits, times, self.slips_show);
        self.predicted_total_s = checks.as_secs_f64();
        let mut at = None;
        for step in &self.run.steps {
            let Step::Shot(shot) = step else { continue };
            totals.progress.shots_total += 1;
            totals.progress.frames_total += shot.n_frames();
            let predicted = self.predict(at, shot);
            at = shot.target.or(at);
            self.predicted_total_s += predicted;
            self.in_turn_s.insert(shot.index, predicted);
            self.frames_of.insert(shot.index, shot.n_frames());
            if self.run.done.contains(&shot.index) {
                totals.progress.shots_done += 1;
                totals.progress.frames_done += shot.n_frames();
                totals.predicted_done_s += predicted;
            }
        }
        // A resumed scan is as far as its points, also before its first new one.
        totals.state_share(self.predicted_total_s, 1.0);
        totals
    }

    fn predict(&self, at: Option<Pose>, shot: &Shot) -> f64 {
        let motion = match (at, shot.target) {
            (Some(at), Some(target)) => self.move_times.predict(at, target),
            _ => Duration::ZERO,
        };
        motion.as_secs_f64() + shot.exposure_total_s()
    }

    pub(super) fn count(&mut self, shot: &Shot, accepted: bool) {
        let predicted = self.predict(self.totals.at, shot);
        let totals = &mut self.totals;
        totals.ideal_s += predicted;
        totals.at = shot.target.or(totals.at);
        if !accepted {
            return;
        }
        totals.progress.shots_done += 1;
        totals.progress.frames_done += shot.n_frames();
        let in_turn_s = self.in_turn_s.get(&shot.index).copied();
        let done_s = totals.predicted_done_s + in_turn_s.unwrap_or(predicted);
        totals.predicted_done_s = done_s.min(self.predicted_total_s);
        // Pace of this run so far; the first point has none.
        let spent_s = totals.progress.elapsed_s - self.run.elapsed_s;
        let pace = if spent_s > 0.0 && totals.ideal_s > predicted {
            spent_s / (totals.ideal_s - predicted)
        } else {
            1.0
        };
        totals.state_share(self.predicted_total_s, pace);
    }
}
