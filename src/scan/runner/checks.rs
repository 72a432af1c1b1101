//! Checks over several frames: a camera that lags behind, a stage that slipped, a lamp that drifts.

use std::collections::BTreeSet;
use std::time::Duration;

use super::recovery::Trouble;
use super::{Ending, Runner};
use crate::bench::AxisName;
use crate::frame::FrameKind;
use crate::frame::FrameTag;
use crate::geometry::Pose;
use crate::scan::faults::Attempts;
use crate::scan::frame_rules::FrameRules;
use crate::scan::look::{Difference, Look};
use crate::scan::plan::{Shot, Step};
use crate::scan::recorder::{Rejected, Visit};
use crate::scan::reference::{Aim, Covered, Detour, Visited, Ways, forget};
use crate::scan::tag_history::off_temperature;
use crate::scan::visit::VisitError;
use crate::wording::{counted, percent};

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
/// Changes at a reference pose after which the points that no check confirmed are taken again; after more, all points are.
const BLOCK_CHANGES: u32 = 2;

/// A point that was accepted, and how it looks.
#[derive(Debug, Clone)]
struct Seen {
    shot: Shot,
    /// Of the first frame that can be compared.
    look: Option<Look>,
    predicted: Duration,
    /// Change of the light until then.
    drift: f64,
    /// Number of points, from the first one remembered, when a look at it last agreed, or when it was taken.
    agreed_after: usize,
}

/// What the checks remember.
#[derive(Debug)]
pub(super) struct Checks {
    /// Accepted points of the sample, in the order taken.
    points: Vec<Seen>,
    /// Which of them the reference checks covered.
    covered: Covered,
    /// How many of them were taken before an axis was homed: a slip that the homing mended shows only at the last of them.
    before_homing: usize,
    /// Points that no check can confirm any more.
    never_confirmed: usize,
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
    /// Change of the light over all checks, and whether it was reported.
    drift: f64,
    drift_reported: bool,
}

impl Checks {
    pub(super) fn new() -> Checks {
        Checks {
            points: Vec::new(),
            covered: Covered::default(),
            before_homing: 0,
            never_confirmed: 0,
            last: None,
            dark: Vec::new(),
            to_confirm: CONFIRMED_POINTS,
            alike: 0,
            to_discard: BUFFERED_FRAMES_MAX,
            drift: 0.0,
            drift_reported: false,
        }
    }

    /// A visit failed, or its frames were rejected: the next frames may be those, or older ones.
    pub(super) fn doubt_the_camera(&mut self) {
        self.to_confirm = CONFIRMED_POINTS;
        self.to_discard = BUFFERED_FRAMES_MAX;
    }

    /// An axis was homed: the points so far may have been taken before a slip that shows no more.
    pub(super) fn homed(&mut self) {
        self.before_homing = self.points.len();
    }

    /// Points without a look at a reference pose that would confirm them.
    fn unconfirmed(&self) -> usize {
        let visited = self.visited();
        let trusted = self.covered.trusted(&visited);
        self.never_confirmed + visited.len().saturating_sub(trusted)
    }

    fn visited(&self) -> Vec<Visited> {
        let of_point = |seen: &Seen| Visited {
            target: seen.shot.target.expect("only such points are remembered"),
            predicted: seen.predicted,
            exposure: seen.shot.longest_exposure(),
            level: seen
                .look
                .as_ref()
                .map(|look| look.level_dn() / look.exposure_s()),
        };
        self.points.iter().map(of_point).collect()
    }

    /// Takes out the points that may be wrong since the picture at a point has changed.
    fn take_suspects(&mut self, index: usize, is_of_homing: bool, changes: u32) -> Vec<Seen> {
        let visited = self.visited();
        let from = match (changes, is_of_homing) {
            // A homing mended it, whenever it was.
            (..=BLOCK_CHANGES, true) => self.covered.confirmed,
            // It came after the picture here was as before. A pose that shows less may have confirmed more.
            (..=BLOCK_CHANGES, false) => {
                Covered::suspect_from(self.points[index].agreed_after, &visited)
            }
            // What changed lasts, so nothing that was taken before fits to it.
            _ => 0,
        };
        let suspects = self.points.split_off(from);
        for seen in &mut self.points {
            seen.agreed_after = seen.agreed_after.min(from);
        }
        self.covered.confirmed = self.covered.confirmed.min(from);
        self.covered.checked = self.covered.checked.min(from);
        suspects
    }

    /// The picture at a point is as before, but for a change of the level by this share.
    fn agreed(&mut self, index: usize, level: f64) {
        let (before, since) = (self.drift, self.covered.checked);
        self.drift += level;
        // The light changes steadily from one check to the next.
        let n = self.points.len().saturating_sub(since);
        for (i, seen) in self.points[since..].iter_mut().enumerate() {
            seen.drift = before + level * (i + 1) as f64 / n as f64;
        }
        self.points[index].agreed_after = self.points.len();
        let visited = self.visited();
        self.covered.agreed(index, &visited);
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

/// The look to compare of a point: of the first frame that has light and is not full.
fn comparable(looks: &[Look]) -> Option<&Look> {
    looks.iter().find(|look| look.is_comparable())
}

impl Runner<'_> {
    /// Returns whether the frames of this visit have to be discarded: the buffer of a camera that does not state when it exposed
    /// them may have held them since before the run, or since a fault. What they show does not matter.
    pub(super) fn discards(&mut self, visit: &Visit) -> bool {
        let disturbed = matches!(visit.rejected, Some(Rejected::Disturbed(_)));
        let left = self.checks.to_discard;
        if left == 0 || disturbed || is_timed(visit) {
            return false;
        }
        let frames = u32::try_from(visit.frames.len()).unwrap_or(u32::MAX);
        self.checks.to_discard = left.saturating_sub(frames);
        true
    }

    /// Confirms frames that may be those of an earlier point by further frames at the same place. They are taken in the reverse
    /// order of exposures: the frames of a camera whose buffer is behind then have other exposures than before.
    pub(super) async fn confirm(
        &mut self,
        shot: &Shot,
        looks: &[Look],
    ) -> Result<Confirmed, Ending> {
        let is_alike = self.checks.looks_like_the_last(shot, looks);
        let alike = is_alike && self.checks.alike < ALIKE_POSES_MAX;
        let mut left = match (alike, self.checks.to_confirm > 0) {
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
        self.checks.to_confirm = self.checks.to_confirm.saturating_sub(1);
        if alike {
            self.checks.alike += 1;
        }
        Ok(Confirmed::Yes)
    }

    /// Remembers an accepted point for the checks to come.
    pub(super) fn remember_look(&mut self, shot: &Shot, looks: Vec<Look>, predicted_s: f64) {
        let checks = &mut self.checks;
        if checks
            .last
            .as_ref()
            .is_some_and(|last| last.0.kind != shot.kind)
        {
            checks.alike = 0;
        }
        if shot.kind == FrameKind::Dark {
            checks.dark.clone_from(&looks);
        }
        let is_covered = shot.kind == FrameKind::Sample && shot.target.is_some();
        if is_covered && self.run.settings.reference.every > 0 {
            checks.points.push(Seen {
                agreed_after: checks.points.len() + 1,
                shot: shot.clone(),
                look: comparable(&looks).cloned(),
                predicted: Duration::try_from_secs_f64(predicted_s).unwrap_or_default(),
                drift: checks.drift,
            });
            let before = checks.points.len();
            checks.never_confirmed += forget(&mut checks.points, &mut checks.covered);
            let forgotten = before - checks.points.len();
            for seen in &mut checks.points {
                seen.agreed_after -= forgotten.min(seen.agreed_after);
            }
            checks.before_homing = checks.before_homing.saturating_sub(forgotten);
        }
        checks.last = Some((shot.clone(), looks));
    }

    /// Remembers the points of earlier runs that no check covered.
    pub(super) fn remember_unchecked(&mut self, steps: &[Step]) {
        for (index, looks) in std::mem::take(&mut self.run.unchecked) {
            let predicted_s = self.in_turn_s.get(&index).copied().unwrap_or_default();
            let shot = steps.iter().find_map(|step| match step {
                Step::Shot(shot) if shot.index == index => Some(shot),
                Step::Shot(_) | Step::Operator(_) => None,
            });
            if let Some(shot) = shot.filter(|shot| self.run.done.contains(&shot.index)) {
                self.remember_look(shot, looks, predicted_s);
            }
        }
        // The axes were homed as this run began, or their encoders show what happened.
        self.checks.homed();
        // The first frame of this run is compared with those of no other pose.
        self.checks.last = None;
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

    /// Returns to a reference pose if it is time or an axis was homed, and takes the points that may be wrong again if the
    /// picture changed.
    /// `next` is where the scan goes then; `None` after the last point.
    pub(super) async fn check_reference(&mut self, next: Option<Pose>) -> Result<(), Ending> {
        let rules = self.run.settings.reference;
        let points = self.checks.points.len() - self.checks.covered.checked;
        let mut is_due = rules.is_due(points, next.is_some());
        if !is_due && self.checks.before_homing == 0 {
            return Ok(());
        }
        let mut suspect: Option<Trouble> = None;
        let mut changes = 0;
        let mut aim = Aim::Both;
        loop {
            let homed_after = std::mem::take(&mut self.checks.before_homing);
            let before_homing = self.last_before(homed_after, next);
            let is_of_homing = before_homing.is_some();
            let detour = match before_homing {
                None if is_due => self.reference_pose(next, aim),
                before_homing => before_homing,
            };
            let Some(detour) = detour else {
                if matches!(aim, Aim::Axis(_)) {
                    aim = Aim::Confirm;
                    continue;
                }
                break;
            };
            let started = self.run.clock.now();
            let seen = self.checks.points[detour.index].clone();
            let outcome = self.compare_at(&seen, detour).await?;
            let took = self.run.clock.now().saturating_sub(started);
            self.totals.progress.elapsed_s += took.as_secs_f64();
            self.totals.ideal_s += detour.takes.as_secs_f64();
            self.totals.predicted_done_s += detour.takes.as_secs_f64();
            let why = match outcome {
                Ok(_) if is_of_homing => {
                    let covered = &mut self.checks.covered;
                    covered.confirmed = covered.confirmed.max(homed_after);
                    continue;
                }
                Ok(level) => {
                    self.checks.agreed(detour.index, level);
                    self.report_drift().await;
                    match self.next_aim(aim, detour.index, next) {
                        Some(more) => aim = more,
                        None => break,
                    }
                    continue;
                }
                Err(why) => why,
            };
            changes += 1;
            aim = Aim::Both;
            is_due = true;
            let block = self
                .checks
                .take_suspects(detour.index, is_of_homing, changes);
            let points: BTreeSet<u32> = block.iter().map(|seen| seen.shot.index).collect();
            let count = counted(points.len(), "point");
            self.withdraw(&points, &why).await?;
            // A stage that slipped is right again after homing.
            self.doubted.extend(AxisName::ALL);
            self.checks.doubt_the_camera();
            let suspect =
                suspect.get_or_insert_with(|| Trouble::new("reference-changed", &why, started));
            suspect.add(points);
            if changes == 1 {
                let message = format!("{why}; the scan homes the stages and takes {count} again");
                self.recorder.alarm("reference-changed", &message).await;
            } else {
                let reason = format!(
                    "{why}, also after the points were taken again; check lamp, sample, stages and camera, then resume: the scan \
                     takes {count} again (scan.reference_change_max is the limit)"
                );
                self.hold_with(&reason, Some("reference-changed"), None)
                    .await?;
                self.make_ready().await?;
                suspect.attended();
            }
            for seen in &block {
                self.take(&seen.shot).await?;
            }
        }
        if next.is_none() && self.checks.unconfirmed() == 0 {
            self.rig.access().set_may_have_slipped(false);
        }
        if is_due {
            self.checks.covered.checked = self.checks.points.len();
        }
        if let Some(trouble) = suspect {
            self.report(trouble, "the reference pose looks the same again")
                .await;
        }
        Ok(())
    }

    /// Returns the way to the last point before a homing after `homed_after` points, unless a check confirmed them.
    fn last_before(&self, homed_after: usize, next: Option<Pose>) -> Option<Detour> {
        let visited = self.checks.visited();
        let unconfirmed = self.checks.covered.confirmed..homed_after;
        let mut newest_first = unconfirmed.rev();
        let index = newest_first.find(|index| visited[*index].level.is_some())?;
        let move_time = |from, to| self.move_times.predict(from, to);
        let limits = self.rig.limits();
        let ways = Ways {
            move_time: &move_time,
            limits: &limits,
            next,
            slips_show: self.slips_show,
        };
        ways.detour(visited.last()?.target, index, &visited[index])
    }

    /// Returns what another look after the last point is for, after one that agreed: the axis that it shows less, then the points
    /// that it does not confirm.
    fn next_aim(&self, aim: Aim, index: usize, next: Option<Pose>) -> Option<Aim> {
        if next.is_some() || self.slips_show {
            return None;
        }
        let rules = self.run.settings.reference;
        let visited = self.checks.visited();
        let other_axis = match aim {
            Aim::Both => rules.shown_worse(&visited, index),
            Aim::Axis(_) | Aim::Confirm => None,
        };
        let confirms_all = self.checks.unconfirmed() == self.checks.never_confirmed;
        match other_axis {
            Some(axis) => Some(Aim::Axis(axis)),
            None => (!confirms_all && aim != Aim::Confirm).then_some(Aim::Confirm),
        }
    }

    /// Returns the way to the reference pose to compare now.
    fn reference_pose(&self, next: Option<Pose>, aim: Aim) -> Option<Detour> {
        let visited = self.checks.visited();
        let rules = self.run.settings.reference;
        let move_time = |from, to| self.move_times.predict(from, to);
        let limits = self.rig.limits();
        let ways = Ways {
            move_time: &move_time,
            limits: &limits,
            next,
            slips_show: self.slips_show,
        };
        rules.choose(&visited, self.checks.covered, &ways, aim)
    }

    /// States how many points of a complete scan nothing confirmed: neither an encoder nor a look at a reference pose.
    pub(super) fn unconfirmed(&self) -> Option<String> {
        let count = self.checks.unconfirmed();
        (count > 0 && !self.slips_show).then(|| {
            format!(
                "{} of the sample could not be confirmed at a reference pose: a slip of an axis without an encoder, or a change \
                 of the lamp, would not show there",
                counted(count, "point")
            )
        })
    }

    /// Compares the picture at a pose with an earlier one: the change of its level, or what is wrong.
    async fn compare_at(
        &mut self,
        seen: &Seen,
        detour: Detour,
    ) -> Result<Result<f64, String>, Ending> {
        let limit = self.run.settings.reference.change_max;
        let shot = &Shot {
            target: Some(detour.target),
            ..seen.shot.clone()
        };
        let before = seen.look.as_ref().expect("only such points are chosen");
        // With the light of the last check: what changed slowly until then is in the drift.
        let before = &before.brighter_by(self.checks.drift - seen.drift);
        let agrees = |found: &Option<Difference>| found.is_some_and(|d| d.is_within(limit));
        let (now, timed) = self.look_at(shot, before.exposure_s()).await?;
        let first = before.difference(&now);
        if agrees(&first) {
            return Ok(Ok(first.map_or(0.0, |found| found.level)));
        }
        // Once more, since a single frame may be wrong by itself; where it was taken, since another turn may look different.
        let is_elsewhere = shot.target != seen.shot.target;
        let (now, _) = self.look_at(&seen.shot, before.exposure_s()).await?;
        let second = before.difference(&now);
        let pose = shot.pose.map_or_else(String::new, |pose| {
            format!("theta_c {:.3}, phi_s {:.3}", pose.theta_c, pose.phi_s)
        });
        match (agrees(&second), timed || is_elsewhere) {
            (true, true) => Ok(Ok(second.map_or(0.0, |found| found.level))),
            (true, false) => Ok(Err(format!(
                "at the reference pose ({pose}) only the second frame shows the picture that was taken there: the camera \
                 returns frames of earlier poses"
            ))),
            (false, _) => Ok(Err(match second {
                Some(found) => format!(
                    "the picture at the reference pose ({pose}) changed: level {:+.1} %, pattern {} (allowed {}): the lamp \
                     drifted, the sample moved, or a stage slipped",
                    100.0 * found.level,
                    percent(found.pattern),
                    percent(limit)
                ),
                None => format!("the picture at the reference pose ({pose}) is dark or full now"),
            })),
        }
    }

    /// Takes a frame at a point that is not recorded; returns how it looks, and whether its exposure is timed.
    async fn look_at(&mut self, shot: &Shot, exposure_s: f64) -> Result<(Look, bool), Ending> {
        let probe = probe_of(shot, exposure_s);
        let mut attempts = Attempts::default();
        loop {
            let error = match self.visit(&probe, 0).await? {
                None => continue,
                Some(Err(error)) => error,
                Some(Ok(visit)) => match (&visit.rejected, visit.frames.first()) {
                    (None, Some(taken)) => {
                        let rules = &self.run.settings.frame;
                        let look = Look::of(&taken.captured.frame, exposure_s, rules);
                        return Ok((look, is_timed(&visit)));
                    }
                    (Some(why), _) => VisitError::Frames(why.clone()),
                    (None, None) => continue,
                },
            };
            self.recover(error, &mut attempts, None, false).await?;
        }
    }

    /// Marks accepted points as not counting; they will be taken again.
    async fn withdraw(&mut self, points: &BTreeSet<u32>, why: &str) -> Result<(), Ending> {
        let withdrawn: Vec<u32> = points.iter().copied().collect();
        for index in &withdrawn {
            if !self.run.done.remove(index) {
                continue;
            }
            let frames = self.frames_of.get(index).copied().unwrap_or_default();
            let progress = &mut self.totals.progress;
            progress.shots_done = progress.shots_done.saturating_sub(1);
            progress.frames_done = progress.frames_done.saturating_sub(frames);
            let share_s = self.in_turn_s.get(index).copied().unwrap_or_default();
            self.totals.predicted_done_s = (self.totals.predicted_done_s - share_s).max(0.0);
        }
        self.recorder.withdraw(&withdrawn, why).await?;
        Ok(())
    }

    /// Reports the change of the light over all checks once it exceeds the limit.
    async fn report_drift(&mut self) {
        let (drift, limit) = (self.checks.drift, self.run.settings.reference.change_max);
        if drift.abs() <= limit || self.checks.drift_reported {
            return;
        }
        self.checks.drift_reported = true;
        let message = format!(
            "the light changed by {:+.1} % since the first points of the scan; check the lamp (fits allow for a slow drift: \
             rig.lamp_drift_std)",
            100.0 * drift
        );
        self.recorder.alarm("lamp-drift", &message).await;
    }
}

/// The same point with one frame of one exposure.
fn probe_of(shot: &Shot, exposure_s: f64) -> Shot {
    Shot {
        exposures_s: vec![exposure_s],
        repeats: 1,
        ..shot.clone()
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
