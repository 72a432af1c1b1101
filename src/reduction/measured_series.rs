//! All frames of a series measured under one calibration, and the levels that they give.

use super::cache::{self, Kept};
use super::calibration_sums::Calibration;
use super::load::{self, Calls};
use super::measure::Measured;
use super::outcomes::{self, Outcomes, Wanted};
use super::reduction_log::ReductionLog;
use super::refusals::ReductionError;
use super::region::{Placement, Segments};
use super::register;
use super::scale::{self, Scale};
use super::series_context::SeriesContext;
use crate::frame::FrameKind;

/// The measured frames of a series, before poses are merged.
pub(super) struct MeasuredSeries {
    pub(super) segments: Segments,
    pub(super) calibration: Calibration,
    pub(super) scale: Scale,
    outcomes: Outcomes,
    /// Frames left out and warnings about the board.
    log_of_board: ReductionLog,
}

impl MeasuredSeries {
    /// Measures the frames that the cache lacks, finds the board, and compares exposures for the camera's curve.
    pub(super) fn of(
        calls: &Calls<'_>,
        series: &SeriesContext,
        kept: &mut Kept,
        region: Option<&str>,
        mut segments: Segments,
    ) -> Result<Self, ReductionError> {
        let source = calls.source;
        let base = outcomes::calibration(calls, series, kept, None)?;
        let measure = |segments: &Segments, calibration: &Calibration, kept: &mut Kept| {
            let part = cache::part_of(region, &segments.placement());
            let wanted = Wanted {
                sums: Some((segments, &part)),
                pictures: matches!(segments, Segments::Patches { .. }),
            };
            outcomes::outcomes(calls, series, kept, (&base, calibration), wanted)
        };
        // The board is expected where it was last, so that its frames are read once unless it moved.
        segments.place(kept.placement);
        let mut seen = measure(&segments, &base, kept)?;
        let mut log = ReductionLog::default();
        if let Segments::Patches { board, .. } = &mut segments {
            let before = board.placement;
            board.placement = Placement::default();
            register::register(source.rows(), &seen.pictures, board, &mut log);
            if source.is_growing() && board.placement.is_near(&before, board) {
                board.placement = before;
            }
            kept.placement = board.placement;
            if board.placement != before {
                seen = measure(&segments, &base, kept)?;
            }
        }
        let detector = outcomes::detector(source, &base, &seen);
        let mut calibration = base.clone();
        if let Some(judged) = scale::judged_otherwise(source, series, &base, &detector) {
            calibration = outcomes::calibration(calls, series, kept, Some(judged))?;
            seen = measure(&segments, &calibration, kept)?;
        }
        let scale = Scale::of(source, series, &calibration, &detector);
        Ok(MeasuredSeries {
            segments,
            calibration,
            scale,
            outcomes: seen,
            log_of_board: log,
        })
    }

    /// Returns the levels of the frames that can be used, and says in the log which cannot and why.
    pub(super) fn frames(
        &self,
        calls: &Calls<'_>,
        series: &SeriesContext,
        kept: &Kept,
        log: &mut ReductionLog,
    ) -> Result<Vec<Measured>, ReductionError> {
        let source = calls.source;
        let scale = &self.scale;
        scale::log_calibration(source, series, &self.calibration, &scale.detector, log);
        log.extend(&self.log_of_board);
        let mut frames = Vec::new();
        self.outcomes.each(calls, series, kept, |index, outcome| {
            if log.has_rejected(index) {
                return;
            }
            match scale.measured(source.rows(), index, outcome) {
                Ok(frame) => frames.push(frame),
                Err(rejection) => log.reject(index, rejection),
            }
        })?;
        load::refuse_impossible(calls, FrameKind::Sample, log)?;
        Ok(frames)
    }
}
