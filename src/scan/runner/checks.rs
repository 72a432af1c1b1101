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
use crate::scan::reference::Visited;
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
/// Times that the points of one block are taken again before the scan pauses.
const BLOCK_RETAKES: u32 = 1;

/// A point that was accepted, and how its frames look.
#[derive(Debug, Clone)]
struct Seen {
    shot: Shot,
    looks: Vec<Look>,
    predicted: Duration,
}

/// What the checks remember.
#[derive(Debug)]
pub(super) struct Checks {
    /// Points since the last check of the reference, in the order taken.
    block: Vec<Seen>,
    /// How many of them were taken before an axis was homed, or before this run: a slip that the homing mended shows only at
    /// the last of them.
    before_homing: usize,
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
            block: Vec::new(),
            before_homing: 0,
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
        self.before_homing = self.block.len();
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
        checks.last = Some((shot.clone(), looks.clone()));
        let covered = shot.kind == FrameKind::Sample && shot.target.is_some();
        if covered && self.run.settings.reference.every > 0 {
            checks.block.push(Seen {
                shot: shot.clone(),
                looks,
                predicted: Duration::try_from_secs_f64(predicted_s).unwrap_or_default(),
            });
        }
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
        // A person may have homed the axes since then.
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

    /// Returns to a reference pose if it is time or an axis was homed, and takes the points since the last check again if the
    /// picture changed.
    /// `next` is where the scan goes then; `None` after the last point.
    pub(super) async fn check_reference(&mut self, next: Option<Pose>) -> Result<(), Ending> {
        let rules = self.run.settings.reference;
        let is_due = rules.is_due(self.checks.block.len(), next.is_some());
        if !is_due && self.checks.before_homing == 0 {
            return Ok(());
        }
        let mut suspect: Option<Trouble> = None;
        let mut retakes = 0;
        while let Some((seen, look, predicted)) =
            self.reference_pose(next, is_due || suspect.is_some())
        {
            let started = self.run.clock.now();
            let outcome = self.compare_at(&seen.shot, &look).await?;
            let took = self.run.clock.now().saturating_sub(started);
            self.totals.progress.elapsed_s += took.as_secs_f64();
            self.totals.ideal_s += predicted.as_secs_f64();
            self.totals.predicted_done_s += predicted.as_secs_f64();
            let why = match outcome {
                Ok(_) if std::mem::take(&mut self.checks.before_homing) > 0 => match is_due {
                    true => continue,
                    false => break,
                },
                Ok(level) => {
                    self.note_drift(level).await;
                    break;
                }
                Err(why) => why,
            };
            let block = std::mem::take(&mut self.checks.block);
            self.checks.before_homing = 0;
            let points: BTreeSet<u32> = block.iter().map(|seen| seen.shot.index).collect();
            let count = counted(points.len(), "point");
            self.withdraw(&points, &why).await?;
            // A stage that slipped is right again after homing.
            self.doubted.extend(AxisName::ALL);
            self.checks.doubt_the_camera();
            let suspect =
                suspect.get_or_insert_with(|| Trouble::new("reference-changed", &why, started));
            suspect.add(points);
            if retakes < BLOCK_RETAKES {
                let message = format!(
                    "{why}; the scan homes the stages and takes the {count} since the last check again"
                );
                self.recorder.alarm("reference-changed", &message).await;
            } else {
                let reason = format!(
                    "{why}, also after the {count} since the last check were taken again; check lamp, sample, stages and \
                     camera, then resume: the scan takes these points again (scan.reference_change_max is the limit)"
                );
                self.hold_with(&reason, Some("reference-changed"), None)
                    .await?;
                self.make_ready().await?;
                suspect.attended();
                retakes = 0;
            }
            retakes += 1;
            for seen in &block {
                self.take(&seen.shot).await?;
            }
        }
        self.checks.before_homing = 0;
        if is_due {
            self.checks.block.clear();
        }
        if let Some(trouble) = suspect {
            self.report(trouble, "the reference pose looks the same again")
                .await;
        }
        Ok(())
    }

    /// Returns the point to return to, its look and the time it takes: the last one before a homing, else, if it is time, one of
    /// those since the last check.
    fn reference_pose(&self, next: Option<Pose>, is_due: bool) -> Option<(Seen, Look, Duration)> {
        let block = &self.checks.block;
        let visited: Vec<Visited> = block
            .iter()
            .map(|seen| Visited {
                target: seen.shot.target.expect("only such points are remembered"),
                predicted: seen.predicted,
                exposure: seen.shot.longest_exposure(),
            })
            .collect();
        let move_time = |from, to| self.move_times.predict(from, to);
        let before_homing = block[..self.checks.before_homing].iter().rev();
        let mut comparables =
            before_homing.filter_map(|seen| Some((seen, comparable(&seen.looks)?)));
        if let Some((seen, look)) = comparables.next() {
            let way = visited.last().zip(seen.shot.target);
            let way = way.map_or(Duration::ZERO, |(at, to)| move_time(at.target, to));
            let takes = way + seen.shot.longest_exposure();
            return Some((seen.clone(), look.clone(), takes));
        }
        if !is_due {
            return None;
        }
        let rules = self.run.settings.reference;
        let (chosen, takes) = rules.choose(&visited, next, &move_time)?;
        // From there on, the first pose that shows light.
        let (seen, look) = block[chosen..block.len() - 1]
            .iter()
            .find_map(|seen| Some((seen, comparable(&seen.looks)?)))?;
        Some((seen.clone(), look.clone(), takes))
    }

    /// Compares the picture at a pose with an earlier one: the change of its level, or what is wrong.
    async fn compare_at(
        &mut self,
        shot: &Shot,
        before: &Look,
    ) -> Result<Result<f64, String>, Ending> {
        let limit = self.run.settings.reference.change_max;
        let agrees = |found: &Option<Difference>| found.is_some_and(|d| d.is_within(limit));
        let (now, timed) = self.look_at(shot, before.exposure_s()).await?;
        let first = before.difference(&now);
        if agrees(&first) {
            return Ok(Ok(first.map_or(0.0, |found| found.level)));
        }
        // Once more: a single frame may be wrong by itself.
        let (now, _) = self.look_at(shot, before.exposure_s()).await?;
        let second = before.difference(&now);
        let pose = shot.pose.map_or_else(String::new, |pose| {
            format!("theta_c {:.3}, phi_s {:.3}", pose.theta_c, pose.phi_s)
        });
        match (agrees(&second), timed) {
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

    /// Adds up the change of the light over the checks, and reports it once it exceeds the limit.
    async fn note_drift(&mut self, level: f64) {
        self.checks.drift += level;
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
