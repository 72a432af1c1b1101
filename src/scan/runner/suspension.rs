//! Suspensions: the scan pauses for a condition that passes by itself, and resumes by itself.

use std::time::Duration;

use super::{CommandRequest, Ending, Runner};
use crate::bench::stage::{Flag, Stage};
use crate::bench::watched_value::WatchedValue;
use crate::bench::{AxisName, CaptureRequest};
use crate::frame::FrameKind;
use crate::geometry::Pose;
use crate::scan::faults::Attempts;
use crate::scan::recorder::{RecordError, Recovery};
use crate::scan::state::ScanState;
use crate::scan::tag_history::off_temperature;
use crate::scan::visit::VisitError;

/// Time between two looks at the condition.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// Least time between two runs of the external programs while the scan runs.
const WATCH_EVERY: Duration = Duration::from_secs(5);
/// Share of a tolerance within which a value counts as calm again.
const CALM_SHARE: f64 = 0.5;

/// Settings of the suspensions.
#[derive(Debug, Clone, PartialEq)]
pub struct SuspendRules {
    /// Largest number of suspensions of a scan; the next one pauses it for a person.
    pub times_max: u32,
    /// How long a condition has to be over.
    pub calm: Duration,
    /// Longest suspension; then the scan waits for a person.
    pub longest: Duration,
    /// Values of external programs.
    pub watched: Vec<WatchedValue>,
}

/// What the suspensions of a scan need to know.
#[derive(Debug, Default)]
pub(super) struct Suspensions {
    times: u32,
    /// Temperature of the sensor that the last frame states, where it is off its set point.
    off_temperature_c: Option<f64>,
    /// Code of a condition in spite of which a person resumed the scan; it counts again once it was over.
    overridden: Option<&'static str>,
    /// When the external programs were last run.
    watched_at: Option<Duration>,
}

impl Suspensions {
    pub(super) fn note_temperature(&mut self, off_temperature_c: Option<f64>) {
        self.off_temperature_c = off_temperature_c;
    }
}

/// A condition that passes by itself.
struct Condition {
    code: &'static str,
    what: String,
}

impl Runner<'_> {
    /// Pauses while a condition of the rig or of an external program asks for it.
    pub(super) async fn suspend_if_needed(&mut self, exposure_s: f64) -> Result<(), Ending> {
        let condition = loop {
            match self.condition(false).await? {
                // A pause that a person asked for comes first; a suspended scan would resume by itself.
                Ok(Some(_)) if self.state == ScanState::Pausing => self.pause_if_asked().await?,
                Ok(condition) => break condition,
                Err(cut) => self.cut_short(cut).await?,
            }
        };
        let Some(condition) = condition else {
            self.suspensions.overridden = None;
            return Ok(());
        };
        if self.suspensions.overridden == Some(condition.code) {
            return Ok(());
        }
        let rules = self.run.settings.suspend.clone();
        let Condition { code, what } = condition;
        if self.suspensions.times >= rules.times_max {
            let reason = format!(
                "{what}; the scan was suspended {} times before; fix it, then resume (scan.suspend_times_max)",
                self.suspensions.times
            );
            self.suspensions.times = 0;
            self.hold_with(&reason, Some(code), None).await?;
            return self.make_ready().await;
        }
        self.suspensions.times += 1;
        let started = self.run.clock.now();
        let calm_s = rules.calm.as_secs_f64();
        let reason = format!(
            "suspended: {what}; the scan resumes by itself once this is over for {calm_s} s"
        );
        self.recorder.alarm(code, &reason).await;
        self.enter(ScanState::Paused, Some(&reason)).await?;
        let mut calm_since: Option<Duration> = None;
        let attended = loop {
            if self.is_resumed_within(LOOK_EVERY).await? {
                break true;
            }
            if !self.rig.access().may_move_unasked() {
                // Stopped meanwhile: only a person continues it.
                self.enter(ScanState::Running, None).await?;
                self.hold_with(VisitError::STOPPED, None, None).await?;
                break true;
            }
            let now = self.run.clock.now();
            let condition = match self.look_at_temperature(exposure_s).await? {
                Some(cut) => Err(cut),
                None => self.condition(true).await?,
            };
            match condition {
                Err(cut) => match self.is_resumed_by(cut).await? {
                    true => break true,
                    false => continue,
                },
                Ok(Some(_)) => calm_since = None,
                Ok(None)
                    if now.saturating_sub(*calm_since.get_or_insert(now)) >= rules.calm
                        && self.rig.access().may_move_unasked() =>
                {
                    self.enter(ScanState::Running, None).await?;
                    break false;
                }
                Ok(None) => {}
            }
            if now.saturating_sub(started) > rules.longest {
                let reason = format!(
                    "{what}, for more than {} s; fix it, then resume",
                    rules.longest.as_secs_f64()
                );
                self.enter(ScanState::Running, None).await?;
                self.hold_with(&reason, Some(code), None).await?;
                break true;
            }
        };
        if attended {
            self.suspensions.note_temperature(None);
            self.suspensions.overridden = Some(code);
        }
        let took_s = self.run.clock.now().saturating_sub(started).as_secs_f64();
        let how = match attended {
            true => "a person resumed the scan",
            false => "the scan resumed by itself",
        };
        let recovery = Recovery {
            code: code.into(),
            message: format!("{what}; {how}"),
            took_s,
            points: Vec::new(),
            attended,
        };
        self.recorder.recovered(recovery).await;
        // Nothing is known of what happened meanwhile.
        match self.ready(attended).await? {
            Ok(()) => Ok(()),
            Err(error) => {
                let mut attempts = Attempts::default();
                let error = VisitError::Stage(error);
                self.recover(error, &mut attempts, None, attended)
                    .await
                    .map(|_| ())
            }
        }
    }

    /// Returns the first condition that holds, or the order that came meanwhile. `is_back`: values have to be inside their
    /// limits by their hysteresis.
    async fn condition(
        &mut self,
        is_back: bool,
    ) -> Result<Result<Option<Condition>, CommandRequest>, RecordError> {
        let found = self.suspensions.off_temperature_c;
        let wanted = self.run.settings.tags.temperature_c;
        let now = self.run.clock.now();
        let watched_at = self.suspensions.watched_at;
        let is_recent = watched_at.is_some_and(|at| now.saturating_sub(at) < WATCH_EVERY);
        let watched = match is_recent && !is_back {
            true => Vec::new(),
            false => self.run.settings.suspend.watched.clone(),
        };
        let look = Conditions {
            stage: self.rig.access().stage(),
            temperature_c: found.map(|found| (found, wanted.unwrap_or(found))),
            watched,
        };
        let found = self.orders().during(look.first(is_back)).await?;
        // A program that an order cut short has not answered.
        if found.is_ok() && (!is_recent || is_back) {
            self.suspensions.watched_at = Some(now);
        }
        Ok(found)
    }

    /// Reads the temperature from a frame that is not recorded, if it was off its set point. Returns the order that came
    /// meanwhile.
    async fn look_at_temperature(
        &mut self,
        exposure_s: f64,
    ) -> Result<Option<CommandRequest>, RecordError> {
        if self.suspensions.off_temperature_c.is_none() {
            return Ok(None);
        }
        let request = CaptureRequest {
            kind: FrameKind::Sample,
            pose: self.totals.at.unwrap_or(Pose::from_deg(0.0, 0.0)),
            exposure_s,
            repeat: 0,
        };
        let (orders, rig) = self.orders_and_rig();
        let captured = orders.during(rig.camera.capture(&request)).await?;
        self.tags.interrupted();
        match captured {
            Ok(Ok(captured)) => {
                let rules = &self.run.settings.tags;
                let off = off_temperature(&captured.tag, rules, CALM_SHARE);
                self.suspensions.note_temperature(off);
                Ok(None)
            }
            // A camera that fails is a fault of the next point.
            Ok(Err(_)) => Ok(None),
            Err(cut) => Ok(Some(cut)),
        }
    }
}

/// Where conditions are looked for, in this order.
struct Conditions {
    stage: Option<Stage>,
    /// Temperature of the sensor and its set point, °C, where they differ.
    temperature_c: Option<(f64, f64)>,
    watched: Vec<WatchedValue>,
}

impl Conditions {
    async fn first(self, is_back: bool) -> Option<Condition> {
        if let Some(stage) = self.stage
            // A stage that does not answer is a fault of the next move.
            && let Ok(status) = stage.status().await
        {
            for axis in AxisName::ALL {
                let raised = status
                    .axis(axis)
                    .flags
                    .iter()
                    .find(|flag| matches!(flag, Flag::SupplyVoltageLow | Flag::ControllerHot));
                if let Some(flag) = raised {
                    return Some(Condition {
                        code: "stage-supply",
                        what: format!("{axis} reports {flag} ({})", flag.meaning()),
                    });
                }
            }
        }
        if let Some((found, wanted)) = self.temperature_c {
            return Some(Condition {
                code: "camera-temperature",
                what: format!(
                    "the camera's sensor is at {found} °C instead of {wanted} °C, and its dark frames do not hold"
                ),
            });
        }
        for value in &self.watched {
            if let Some(what) = value.problem(is_back).await {
                let code = "external-condition";
                return Some(Condition { code, what });
            }
        }
        None
    }
}
