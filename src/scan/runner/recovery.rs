//! From a fault to the next attempt: back-off, reconnecting, homing, and the report of what was overcome.

use std::collections::BTreeSet;
use std::time::Duration;

use super::{Ending, Runner, ScanRun};
use crate::bench::stage::{Stage, StageError};
use crate::frame::FrameKind;
use crate::geometry::Pose;
use crate::scan::faults::{Attempts, FaultKind, Reaction, Verdict};
use crate::scan::plan::Shot;
use crate::scan::recorder::Recovery;
use crate::scan::state::ScanState;
use crate::scan::visit::VisitError;
use crate::wording::counted;

/// How the scan continues after a fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Recovered {
    /// With another attempt; the rig is ready.
    Again,
    /// Without the point.
    Skipped,
}

/// A fault that the scan has not overcome yet.
#[derive(Debug, Clone)]
pub(super) struct Trouble {
    code: String,
    what: String,
    since: Duration,
    failures: usize,
    points: BTreeSet<u32>,
    attended: bool,
}

impl Trouble {
    /// A fault that began at the time `since`.
    pub(super) fn new(code: &str, what: &str, since: Duration) -> Trouble {
        Trouble {
            code: code.into(),
            what: what.into(),
            since,
            failures: 1,
            points: BTreeSet::new(),
            attended: false,
        }
    }

    /// Adds points that have to be taken again.
    pub(super) fn add(&mut self, points: BTreeSet<u32>) {
        self.points.extend(points);
    }

    /// Notes that a person resumed the scan.
    pub(super) fn attended(&mut self) {
        self.attended = true;
    }

    /// Returns the trouble that a resumed scan begins with: it was interrupted.
    pub(super) fn of_a_run_after(run: &ScanRun) -> Option<Trouble> {
        (!run.done.is_empty()).then(|| Trouble {
            code: "scan-interrupted".into(),
            what: "the scan was interrupted".into(),
            since: run.clock.now(),
            failures: 0,
            points: BTreeSet::new(),
            attended: true,
        })
    }
}

impl Runner<'_> {
    /// Connects and homes the rig for a person who has just requested motion, until it is ready.
    pub(super) async fn make_ready(&mut self) -> Result<(), Ending> {
        self.make_ready_for(true).await
    }

    /// Homes the axes that are doubted, by itself.
    pub(super) async fn make_ready_again(&mut self) -> Result<(), Ending> {
        self.make_ready_for(false).await
    }

    async fn make_ready_for(&mut self, by_a_person: bool) -> Result<(), Ending> {
        let Err(error) = self.ready(by_a_person).await? else {
            return Ok(());
        };
        let (error, mut attempts) = (VisitError::Stage(error), Attempts::default());
        let recovered = self.recover(error, &mut attempts, None, by_a_person);
        recovered.await.map(|_| ())
    }

    /// Returns the connected stage; `None` where it was stopped and resumed. An axis whose position is doubted is homed first.
    pub(super) async fn stage_for_a_move(
        &mut self,
    ) -> Result<Option<Result<Stage, StageError>>, Ending> {
        if !self.doubted.is_empty()
            && let Err(error) = self.ready(false).await?
        {
            return Ok(Some(Err(error)));
        }
        let (orders, rig) = self.orders_and_rig();
        match orders.during(rig.connect()).await? {
            Ok(outcome) => Ok(Some(outcome)),
            Err(cut) => {
                self.cut_short(cut).await?;
                Ok(None)
            }
        }
    }

    /// Connects, and homes what has no trusted position. Orders are obeyed meanwhile: after a stop it begins again once a
    /// person has resumed the scan.
    pub(super) async fn ready(
        &mut self,
        mut by_a_person: bool,
    ) -> Result<Result<(), StageError>, Ending> {
        let may_home = self.run.settings.faults.home_after_power_cycle;
        loop {
            let doubted = self.doubted.clone();
            let (orders, rig) = self.orders_and_rig();
            let made_ready = async {
                let stage = rig.make_ready(&doubted, by_a_person, may_home).await?;
                let status = stage.status().await?;
                Ok::<_, StageError>((stage.move_times(), stage.shows_slips(), status.pose()))
            };
            match orders.during(made_ready).await? {
                Ok(Ok((move_times, slips_show, pose))) => {
                    if !std::mem::take(&mut self.doubted).is_empty() {
                        self.points.homed();
                    }
                    self.move_times = move_times;
                    self.slips_show = slips_show;
                    self.totals.at = Some(pose);
                    return Ok(Ok(()));
                }
                Ok(Err(error)) => return Ok(Err(error)),
                Err(cut) => {
                    self.stop_motion().await;
                    self.pause_or_end(cut).await?;
                    by_a_person = true;
                }
            }
        }
    }

    /// Stops what an order has cut short.
    pub(super) async fn stop_motion(&mut self) {
        self.totals.at = None;
        self.rig.access().stop_connected().await;
    }

    /// Reacts to a fault as the settings say until the rig is ready for another attempt at the point. `by_a_person`: a person has
    /// just requested motion.
    pub(super) async fn recover(
        &mut self,
        mut error: VisitError,
        attempts: &mut Attempts,
        shot: Option<&Shot>,
        mut by_a_person: bool,
    ) -> Result<Recovered, Ending> {
        loop {
            if let VisitError::Stage(error) = &error {
                self.doubted.extend(error.axis_to_home());
                self.rig.let_go_if_lost(error);
            }
            if error.contradicts_the_plan() {
                return self.fail(&error.to_string()).await;
            }
            let (kind, now) = (error.kind(), self.run.clock.now());
            self.note_failure(&error, now, shot);
            attempts.count(kind, now);
            let mut stopped = false;
            match self.run.settings.faults.judge(kind, attempts, now) {
                Verdict::RetryAfter(wait) => {
                    self.warn_of_retry(&error, kind, attempts, wait).await;
                    stopped = self.rest(wait).await?;
                }
                Verdict::GiveUp(Reaction::Abort) => {
                    let why =
                        format!("{error}; the settings end a scan at this fault (scan.reactions)");
                    if let Some(code) = error.code() {
                        self.recorder.alarm(code, &why).await;
                    }
                    return self.fail(&why).await;
                }
                Verdict::GiveUp(Reaction::Skip)
                    if let Some(shot) = shot.filter(|shot| shot.kind == FrameKind::Sample) =>
                {
                    self.skip(shot, &error).await;
                    // Stages that are not ready are a fault of the next point.
                    return Ok(Recovered::Skipped);
                }
                Verdict::GiveUp(_) => {
                    self.hold(&error).await?;
                    *attempts = Attempts::default();
                    by_a_person = true;
                    // By resuming after this fault the operator confirms the sample. Resuming after another fault
                    // confirms nothing.
                    if let VisitError::Frames(rejected) = &error {
                        self.run.settings.frame.confirmed.note(rejected);
                    }
                }
            }
            by_a_person |= stopped;
            let of_the_stages =
                matches!(error, VisitError::Stage(_) | VisitError::Suspended { .. });
            if !stopped && !of_the_stages {
                return Ok(Recovered::Again);
            }
            match self.ready(by_a_person).await? {
                Ok(()) => {
                    attempts.linked();
                    return Ok(Recovered::Again);
                }
                Err(next) => error = VisitError::Stage(next),
            }
        }
    }

    async fn fail<T>(&mut self, why: &str) -> Result<T, Ending> {
        self.enter(ScanState::Failed, Some(why)).await?;
        Err(Ending::Recorded(ScanState::Failed))
    }

    async fn skip(&mut self, shot: &Shot, error: &VisitError) {
        self.skipped.insert(shot.index);
        self.trouble = None;
        let point = name_of(shot);
        let why = format!("{error}; the scan continues without {point} (scan.reactions)");
        self.recorder.alarm("point-skipped", &why).await;
    }

    /// Logs a retry. A lost link is an alarm at once: the stages cannot be stopped while it lasts.
    async fn warn_of_retry(
        &mut self,
        error: &VisitError,
        kind: FaultKind,
        attempts: &Attempts,
        wait: Duration,
    ) {
        let wait_s = wait.as_secs_f64();
        tracing::warn!(wait_s, "{error}; next attempt in {wait_s:.1} s");
        if kind == FaultKind::Link && attempts.has_just_lost_the_link() {
            let for_s = self.run.settings.faults.reconnect_for.as_secs_f64();
            let message =
                format!("{error}; the scan reconnects by itself for up to {for_s} s, then pauses");
            let code = error.code().unwrap_or("stage-disconnected");
            self.recorder.alarm(code, &message).await;
        }
    }

    fn note_failure(&mut self, error: &VisitError, now: Duration, shot: Option<&Shot>) {
        let Some(code) = error.code() else { return };
        let trouble = self.trouble.get_or_insert_with(|| Trouble {
            failures: 0,
            ..Trouble::new(code, &error.to_string(), now)
        });
        trouble.failures += 1;
        trouble.points.extend(shot.map(|shot| shot.index));
    }

    /// Notes that frames were discarded before those of this point.
    pub(super) fn note_discarded(&mut self, shot: &Shot, why: &str) {
        let now = self.run.clock.now();
        let trouble = self
            .trouble
            .get_or_insert_with(|| Trouble::new("frame-stale", why, now));
        trouble.points.insert(shot.index);
    }

    /// Notes that a person had to resume the scan.
    pub(super) fn note_pause(&mut self, code: &str, reason: &str) {
        let now = self.run.clock.now();
        let trouble = self
            .trouble
            .get_or_insert_with(|| Trouble::new(code, reason, now));
        trouble.attended = true;
    }

    /// Reports the fault that this accepted point ends, if there was one.
    pub(super) async fn report_recovery(&mut self, shot: &Shot) {
        if let Some(mut trouble) = self.trouble.take() {
            trouble.points.insert(shot.index);
            let then = format!("{} counts", name_of(shot));
            self.report(trouble, &then).await;
        }
    }

    /// Reports the end of a fault.
    pub(super) async fn report(&mut self, trouble: Trouble, then: &str) {
        let now = self.run.clock.now();
        let how = match (trouble.attended, trouble.failures) {
            (true, _) => "a person resumed the scan".to_owned(),
            (false, failures) => {
                format!(
                    "the scan recovered by itself after {}",
                    counted(failures, "failure")
                )
            }
        };
        let recovery = Recovery {
            message: format!("{}; {how}: {then}", trouble.what),
            code: trouble.code,
            took_s: now.saturating_sub(trouble.since).as_secs_f64(),
            points: trouble.points.into_iter().collect(),
            attended: trouble.attended,
        };
        self.recorder.recovered(recovery).await;
    }
}

/// Returns a point in words.
fn name_of(shot: &Shot) -> String {
    match shot.pose {
        Some(Pose { theta_c, phi_s }) => format!(
            "the {} point at theta_c {theta_c:.3}, phi_s {phi_s:.3}",
            shot.kind.as_str()
        ),
        None => format!("the {} frames", shot.kind.as_str()),
    }
}
