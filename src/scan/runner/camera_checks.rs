//! Checks of the camera over several frames: one whose buffer is behind returns the frame of an earlier pose, kind or exposure.

use super::{Ending, Runner};
use crate::frame::{FrameKind, FrameTag};
use crate::scan::frame_rules::FrameRules;
use crate::scan::look::Look;
use crate::scan::plan::Shot;
use crate::scan::recorder::{Rejected, Visit};
use crate::scan::tag_history::off_temperature;
use crate::scan::visit::VisitError;
use crate::wording::percent;

/// Largest difference of two frames of one pose, beyond noise: lamps flicker less.
const SAME_POSE_SHARE: f64 = 0.01;
/// Largest difference of frames of two poses that look alike.
const ALIKE_SHARE: f64 = 0.002;
/// Points at the begin of a run, and after a fault of the camera, whose frames are confirmed by another one.
const CONFIRMED_POINTS: u32 = 2;
/// Frames that a camera's buffer may hold: this number is discarded where they may be old, and confirms a frame that looks like
/// one of the place before.
const BUFFERED_FRAMES_MAX: u32 = 4;
/// Poses that were confirmed to look like the pose before, after which the scan no longer confirms such frames.
const ALIKE_POSES_MAX: u32 = 3;

/// What these checks remember.
#[derive(Debug)]
pub(super) struct CameraChecks {
    /// The last accepted point, of any kind.
    last: Option<(Shot, Vec<Look>)>,
    /// The dark frames of this run that were accepted last.
    dark: Vec<Look>,
    /// Points whose frames still have to be confirmed.
    to_confirm: u32,
    /// Points of the present kind that looked like the one before and were confirmed.
    alike: u32,
    /// Frames to discard of a camera that does not state when it exposed them: they may be older than the run, or than its last
    /// fault.
    to_discard: u32,
}

impl CameraChecks {
    pub(super) fn new() -> CameraChecks {
        CameraChecks {
            last: None,
            dark: Vec::new(),
            to_confirm: CONFIRMED_POINTS,
            alike: 0,
            to_discard: BUFFERED_FRAMES_MAX,
        }
    }

    /// A visit failed, or its frames were rejected: the next frames may be those, or older ones.
    pub(super) fn doubt(&mut self) {
        self.to_confirm = CONFIRMED_POINTS;
        self.to_discard = BUFFERED_FRAMES_MAX;
    }

    /// Remembers an accepted point.
    pub(super) fn remember(&mut self, shot: &Shot, looks: Vec<Look>) {
        if self
            .last
            .as_ref()
            .is_some_and(|(last, _)| last.kind != shot.kind)
        {
            self.alike = 0;
        }
        if shot.kind == FrameKind::Dark {
            self.dark.clone_from(&looks);
        }
        self.last = Some((shot.clone(), looks));
    }

    /// The first frame of a run is compared with those of no other pose.
    pub(super) fn forget_the_last(&mut self) {
        self.last = None;
    }

    /// Whether frames look like those of the last point, which was elsewhere or of another kind. The exposures do not count: a
    /// camera whose buffer is behind returns the frame of another one.
    fn looks_like_the_last(&self, shot: &Shot, looks: &[Look]) -> bool {
        let Some((last, seen)) = &self.last else {
            return false;
        };
        let moved = (last.kind, last.target) != (shot.kind, shot.target);
        let alike = |look: &Look| {
            let mut differences = seen.iter().filter_map(|seen| seen.compare(look));
            differences.any(|found| found.is_within(ALIKE_SHARE))
        };
        moved && looks.iter().any(alike)
    }

    /// Returns what is wrong with a white reference that is not brighter than the dark frames of its longest exposure.
    pub(super) fn as_dark(
        &self,
        shot: &Shot,
        looks: &[Look],
        rules: &FrameRules,
    ) -> Option<Rejected> {
        if shot.kind != FrameKind::Flat {
            return None;
        }
        let by_exposure = |a: &&Look, b: &&Look| a.exposure_s().total_cmp(&b.exposure_s());
        let longest = looks.iter().max_by(by_exposure)?;
        let dark = self
            .dark
            .iter()
            .find(|dark| dark.has_exposure_of(longest))?;
        let is_brighter = longest.level_dn() > dark.level_dn()
            && !longest.agrees_with(dark, shot.kind, SAME_POSE_SHARE, rules);
        (!is_brighter).then(|| {
            Rejected::Otherwise(format!(
                "the white reference is no brighter than the dark frames ({:.0} DN and {:.0} DN above the black level in {} s); \
                 check lamp and lens cap, and whether the camera returned an old frame",
                longest.level_dn(),
                dark.level_dn(),
                longest.exposure_s()
            ))
        })
    }
}

/// What confirming a visit's frames showed.
pub(super) enum Confirmed {
    Yes,
    No(Rejected),
    Failed(VisitError),
    /// The stop button was pressed, and the scan resumed.
    Stopped,
}

/// Returns how the frames of a visit look, one of each exposure.
pub(super) fn looks_of(visit: &Visit, rules: &FrameRules) -> Vec<Look> {
    let first = visit.frames.iter().filter(|taken| taken.repeat == 0);
    first
        .map(|taken| Look::of(&taken.captured.frame, taken.exposure_s, rules))
        .collect()
}

/// Whether the camera states when each exposure began; then no frame can be an older one.
pub(super) fn is_timed(visit: &Visit) -> bool {
    let tag = |tag: &FrameTag| tag.exposure_start.is_some();
    visit.frames.iter().all(|taken| tag(&taken.captured.tag))
}

impl Runner<'_> {
    /// Returns whether the frames of this visit have to be discarded: the buffer of a camera that does not state when it exposed
    /// them may have held them since before the run, or since a fault. What they show does not matter.
    pub(super) fn discards(&mut self, visit: &Visit) -> bool {
        let disturbed = matches!(visit.rejected, Some(Rejected::Disturbed(_)));
        let left = self.camera_checks.to_discard;
        if left == 0 || disturbed || is_timed(visit) {
            return false;
        }
        let frames = u32::try_from(visit.frames.len()).unwrap_or(u32::MAX);
        self.camera_checks.to_discard = left.saturating_sub(frames);
        true
    }

    /// Confirms frames that may be those of an earlier point by further frames at the same place. They are taken in the reverse
    /// order of exposures: the frames of a camera whose buffer is behind then have other exposures than before.
    pub(super) async fn confirm(
        &mut self,
        shot: &Shot,
        looks: &[Look],
    ) -> Result<Confirmed, Ending> {
        let is_alike = self.camera_checks.looks_like_the_last(shot, looks);
        let alike = is_alike && self.camera_checks.alike < ALIKE_POSES_MAX;
        let mut left = match (alike, self.camera_checks.to_confirm > 0) {
            (true, _) => BUFFERED_FRAMES_MAX,
            (false, true) => 1,
            (false, false) => return Ok(Confirmed::Yes),
        };
        let probe = Shot {
            exposures_s: shot.exposures_s.iter().rev().copied().collect(),
            repeats: 1,
            ..shot.clone()
        };
        while left > 0 {
            let again = match self.visit(&probe, 0).await? {
                None => return Ok(Confirmed::Stopped),
                Some(Err(error)) => return Ok(Confirmed::Failed(error)),
                Some(Ok(visit)) => {
                    if let Some(why) = visit.rejected {
                        return Ok(Confirmed::No(why));
                    }
                    looks_of(&visit, &self.run.settings.frame)
                }
            };
            let rules = &self.run.settings.frame;
            for again in &again {
                let mut same = looks.iter().filter(|first| first.has_exposure_of(again));
                if let Some(first) =
                    same.find(|first| !first.agrees_with(again, shot.kind, SAME_POSE_SHARE, rules))
                {
                    let why = lagging(first, again);
                    return Ok(Confirmed::No(Rejected::Otherwise(why)));
                }
            }
            left = left.saturating_sub(u32::try_from(again.len()).unwrap_or(u32::MAX).max(1));
        }
        self.camera_checks.to_confirm = self.camera_checks.to_confirm.saturating_sub(1);
        if alike {
            self.camera_checks.alike += 1;
        }
        Ok(Confirmed::Yes)
    }

    /// Notes a temperature that is off its set point, for the suspension before the next attempt.
    pub(super) fn note_temperature(&mut self, visit: &Visit) {
        let rules = &self.run.settings.tags;
        let off = visit
            .frames
            .iter()
            .find_map(|taken| off_temperature(&taken.captured.tag, rules, 1.0));
        self.suspensions.note_temperature(off);
    }
}

fn lagging(first: &Look, again: &Look) -> String {
    let by = first.difference(again).map_or_else(
        || "one of them shows no light, or is full".to_owned(),
        |found| format!("they differ by {}", percent(found.total)),
    );
    format!(
        "two frames of one pose and exposure do not show the same ({by}): the camera returned a frame of an earlier pose or of \
         another exposure, or the light flickers; check the camera's buffer and the lamp (frames that state exposure_start \
         are checked without this)"
    )
}
