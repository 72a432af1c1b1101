//! Looks at reference poses: a stage that slipped and a lamp that changed show there, and what may be wrong is taken again.

use std::collections::BTreeSet;

use super::camera_checks::is_timed;
use super::points::{Change, Seen};
use super::recovery::Trouble;
use super::{Ending, Runner};
use crate::bench::AxisName;
use crate::geometry::Pose;
use crate::scan::faults::Attempts;
use crate::scan::look::{Difference, Look};
use crate::scan::plan::{Shot, Step};
use crate::scan::reference::{Aim, Detour, SLIP_LARGE, Visited, Ways};
use crate::scan::visit::VisitError;
use crate::wording::{counted, percent};

/// Changes at a reference pose after which the points that no check confirmed are taken again; after more, all points are.
const BLOCK_CHANGES: u32 = 2;

impl Runner<'_> {
    /// Remembers an accepted point for the checks to come.
    pub(super) fn remember_look(&mut self, shot: &Shot, looks: Vec<Look>, predicted_s: f64) {
        if self.run.settings.reference.every > 0 {
            self.points.remember(shot, &looks, predicted_s);
        }
        self.camera_checks.remember(shot, looks);
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
        self.points.homed();
        // The first frame of this run is compared with those of no other pose.
        self.camera_checks.forget_the_last();
    }

    /// Returns to a reference pose if it is time or an axis was homed, and takes the points that may be wrong again if the
    /// picture changed.
    /// `next` is where the scan goes then; `None` after the last point.
    pub(super) async fn check_reference(&mut self, next: Option<Pose>) -> Result<(), Ending> {
        let rules = self.run.settings.reference;
        let points = self.points.seen.len() - self.points.covered.checked;
        let mut is_due = rules.is_due(points, next.is_some());
        if !is_due && self.points.before_homing == 0 {
            return Ok(());
        }
        let mut suspect: Option<Trouble> = None;
        let mut changes = 0;
        let mut aim = Aim::Both;
        let mut looked_at = Vec::new();
        loop {
            let homed_after = std::mem::take(&mut self.points.before_homing);
            let before_homing = self.last_before(homed_after, next);
            let is_of_homing = before_homing.is_some();
            let detour = match before_homing {
                None if is_due => self.reference_pose(next, aim),
                before_homing => before_homing,
            };
            let Some(detour) = detour else {
                match self.next_aim(aim, &mut looked_at, next).await? {
                    Some(more) if is_due => aim = more,
                    _ => break,
                }
                continue;
            };
            let started = self.run.clock.now();
            let seen = self.points.seen[detour.index].clone();
            let outcome = self.compare_at(&seen, detour).await?;
            let took = self.run.clock.now().saturating_sub(started);
            self.totals.progress.elapsed_s += took.as_secs_f64();
            self.totals.ideal_s += detour.takes.as_secs_f64();
            self.totals.predicted_done_s += detour.takes.as_secs_f64();
            let why = match outcome {
                Ok(_) if is_of_homing => {
                    let covered = &mut self.points.covered;
                    covered.confirmed = covered.confirmed.max(homed_after);
                    continue;
                }
                Ok(level) => {
                    self.points.agreed(detour.index, level);
                    self.report_drift().await;
                    if matches!(aim, Aim::Both | Aim::Axis(_)) {
                        looked_at.push(detour.index);
                    }
                    match self.next_aim(aim, &mut looked_at, next).await? {
                        Some(more) => aim = more,
                        None => break,
                    }
                    continue;
                }
                Err(why) => why,
            };
            changes += 1;
            let change = match aim {
                _ if changes > BLOCK_CHANGES => Change::Lasting,
                _ if is_of_homing => Change::BeforeHoming,
                // The picture here was as before until the homing: this point was taken wrong, and others before it.
                Aim::Again(_) => Change::Lasting,
                Aim::Both | Aim::Axis(_) | Aim::Confirm => Change::Since,
            };
            aim = Aim::Both;
            looked_at.clear();
            is_due = true;
            let block = self.points.take_suspects(detour.index, change);
            let points: BTreeSet<u32> = block.iter().map(|seen| seen.shot.index).collect();
            let count = counted(points.len(), "point");
            self.withdraw(&points, &why).await?;
            // A stage that slipped is right again after homing.
            self.doubted.extend(AxisName::ALL);
            self.camera_checks.doubt();
            let suspect =
                suspect.get_or_insert_with(|| Trouble::new("reference-changed", &why, started));
            suspect.add(points);
            if changes == 1 {
                let message = format!("{why}; the scan homes the stages and takes {count} again");
                self.recorder.alarm("reference-changed", &message).await;
            } else {
                let reason = format!(
                    "{why}, also after the points were taken again; check lamp, sample, stages and camera, then resume: the scan \
                     takes {count} again (scan.reference_change_max is the limit; a white reference from before a change of the \
                     lamp does not count for it)"
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
        if next.is_none() && self.points.unconfirmed() == 0 {
            self.rig.access().set_may_have_slipped(false);
        }
        if is_due {
            self.points.covered.checked = self.points.seen.len();
        }
        if let Some(trouble) = suspect {
            self.report(trouble, "the reference pose looks the same again")
                .await;
        }
        Ok(())
    }

    /// Chooses among the visited points with the ways of the rig.
    fn among_points<T>(
        &self,
        next: Option<Pose>,
        choose: impl FnOnce(&[Visited], &Ways<'_>) -> T,
    ) -> T {
        let move_time = |from, to| self.move_times.predict(from, to);
        let limits = self.rig.limits();
        let ways = Ways {
            move_time: &move_time,
            limits: &limits,
            next,
            slips_show: self.slips_show,
        };
        choose(&self.points.visited(), &ways)
    }

    /// Returns the way to the last point before a homing after `homed_after` points, unless a check confirmed them.
    fn last_before(&self, homed_after: usize, next: Option<Pose>) -> Option<Detour> {
        let mut newest_first = (self.points.covered.confirmed..homed_after).rev();
        self.among_points(next, |visited, ways| {
            let index = newest_first.find(|index| visited[*index].level.is_some())?;
            ways.detour(visited.last()?.target, index, &visited[index])
        })
    }

    /// Returns the way to the reference pose to compare now.
    fn reference_pose(&self, next: Option<Pose>, aim: Aim) -> Option<Detour> {
        let rules = self.run.settings.reference;
        let covered = self.points.covered;
        self.among_points(next, |visited, ways| {
            rules.choose(visited, covered, ways, aim)
        })
    }

    /// Returns what another look after the last point is for, after looks at these points: the axis that they show less, then the
    /// points that they do not confirm, and then a slip that came before the looks' own points. Such a slip lasts until the axes
    /// are homed, so they are homed, and the same points are looked at again.
    async fn next_aim(
        &mut self,
        aim: Aim,
        looked_at: &mut Vec<usize>,
        next: Option<Pose>,
    ) -> Result<Option<Aim>, Ending> {
        if next.is_some() || self.slips_show {
            return Ok(None);
        }
        let rules = self.run.settings.reference;
        let visited = self.points.visited();
        let axes = match aim {
            Aim::Both => &AxisName::ALL[..],
            Aim::Axis(AxisName::ThetaC) => &[AxisName::PhiS],
            Aim::Axis(AxisName::PhiS) | Aim::Confirm | Aim::Again(_) => &[],
        };
        let shown_less = |axis: &&AxisName| {
            !looked_at.is_empty() && rules.show_worse(&visited, looked_at, **axis)
        };
        if let Some(axis) = axes.iter().find(shown_less) {
            return Ok(Some(Aim::Axis(*axis)));
        }
        let confirms_all = self.points.unconfirmed() == self.points.never_confirmed;
        if matches!(aim, Aim::Both | Aim::Axis(_)) && !confirms_all {
            return Ok(Some(Aim::Confirm));
        }
        if !matches!(aim, Aim::Again(_)) && !looked_at.is_empty() {
            let least = |axis| rules.least_slip(&visited, axis);
            let is_shown = |axis| least(axis).is_some_and(|least| least <= SLIP_LARGE);
            if !AxisName::ALL.into_iter().any(is_shown) {
                return Ok(None);
            }
            self.doubted.extend(AxisName::ALL);
            let from = visited.last().map(|last| last.target);
            self.make_ready_again().await?;
            let homing = from.map(|from| self.move_times.predict_homing(from).0);
            self.totals.predicted_done_s += homing.unwrap_or_default().as_secs_f64();
        }
        Ok(looked_at.pop().map(Aim::Again))
    }

    /// States what the checks of a complete scan cannot exclude on axes without encoders.
    pub(super) fn unconfirmed(&self) -> Option<String> {
        if self.slips_show {
            return None;
        }
        let count = self.points.unconfirmed();
        let points = (count > 0).then(|| {
            format!(
                "{} of the sample could not be confirmed at a reference pose: a slip of an axis without an encoder, or a change \
                 of the lamp, would not show there",
                counted(count, "point")
            )
        });
        let rules = self.run.settings.reference;
        let visited = self.points.visited();
        let unseen = AxisName::ALL.into_iter().filter_map(|axis| {
            let least = rules.least_slip(&visited, axis)?;
            (least > SLIP_LARGE).then(|| {
                format!(
                    "a slip of {axis} by less than {:.0}° would show at no point of the scan: their pictures hardly depend on it",
                    least.deg().min(360.0)
                )
            })
        });
        let parts: Vec<String> = points.into_iter().chain(unseen).collect();
        (!parts.is_empty()).then(|| parts.join("; "))
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
        let before = &before.brighter_by(self.points.drift - seen.drift);
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
        let (drift, limit) = (self.points.drift, self.run.settings.reference.change_max);
        if drift.abs() <= limit || self.points.drift_reported {
            return;
        }
        self.points.drift_reported = true;
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
