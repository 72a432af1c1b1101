//! Jogging: an axis moves while it is renewed, and stops by itself when it is not.
//!
//! The order expires unless the client renews it. Beyond that, each step is a short absolute move within limits and
//! outside forbidden regions, so that the axis stops even if this program or the line fails.

use std::time::{Duration, Instant};

use tokio::sync::watch;

use super::Stage;
use super::error::StageError;
use super::ways::Room;
use crate::bench::AxisName;
use crate::units::Angle;

/// Real time between two steps.
const STEP: Duration = Duration::from_millis(100);
/// Least length of a step on the stage's clock.
const AHEAD_S: f64 = 0.6;
/// Length of a step in intervals between steps: on a clock that runs fast the interval is long.
const AHEAD_INTERVALS: f64 = 4.0;
/// Greatest length of a step.
const AHEAD_S_MAX: f64 = 60.0;

/// What a jog should do now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JogOrder {
    /// Speed and direction; 0 ends the jog. A greater speed than that of the axis is limited to it.
    pub speed_deg_s: f64,
    /// The jog ends then, unless it is renewed. Real time: it depends on a person.
    pub until: Instant,
}

impl JogOrder {
    fn is_over(&self) -> bool {
        self.speed_deg_s == 0.0 || Instant::now() >= self.until
    }
}

impl Stage {
    /// Jogs an axis while `order` is renewed and its sender exists, unless there has been a stop since
    /// [`Stage::stops`] returned `stops`. `at_end` learns why the axis waits at the end of its way;
    /// `None` while it moves. Returns where the axis came to rest.
    ///
    /// # Errors
    /// [`StageError`]; both axes have then been stopped as far as they can be reached.
    pub async fn jog(
        &self,
        axis: AxisName,
        mut order: watch::Receiver<JogOrder>,
        stops: u64,
        mut at_end: impl FnMut(Option<String>),
    ) -> Result<Angle, StageError> {
        let outcome = async {
            let _turn = self.axis(axis).take_turn()?;
            self.axis(axis).begin_jog().await?;
            let mut last_step = self.inner.clock.now();
            let mut interval_s = 0.0_f64;
            loop {
                let now = *order.borrow_and_update();
                if now.is_over() || order.has_changed().is_err() {
                    break;
                }
                let upwards = now.speed_deg_s > 0.0;
                let room = self.jog_room(axis, upwards).await?;
                let ahead_s = (AHEAD_INTERVALS * interval_s).clamp(AHEAD_S, AHEAD_S_MAX);
                let is_at_end = self
                    .axis(axis)
                    .jog_on(now.speed_deg_s, ahead_s, room.end, stops)
                    .await?;
                at_end(is_at_end.then(|| reason(axis, &room)));
                let step = STEP.min(now.until.saturating_duration_since(Instant::now()));
                tokio::select! {
                    biased;
                    () = self.inner.line.stopped_since(stops) => return Err(StageError::Stopped),
                    // A sender that is gone is seen at the next turn.
                    _ = order.changed() => {}
                    () = tokio::time::sleep(step) => {}
                }
                let began = self.inner.clock.now();
                interval_s = began.saturating_sub(last_step).as_secs_f64();
                last_step = began;
            }
            self.axis(axis).end_jog(stops).await
        };
        let outcome = outcome.await;
        self.or_stop(outcome).await
    }

    /// Checks that an axis may be jogged. Nothing moves.
    ///
    /// # Errors
    /// [`StageError`] of an axis without reference or with a fault, or of a device that does not answer.
    pub async fn check_jog(&self, axis: AxisName) -> Result<(), StageError> {
        self.axis(axis).begin_jog().await?;
        self.jog_room(axis, true).await.map(|_| ())
    }

    /// How far the axis may be jogged from where the stages are.
    async fn jog_room(&self, axis: AxisName, upwards: bool) -> Result<Room, StageError> {
        let settings = &self.inner.settings;
        let status = self.status().await?;
        if !settings.forbidden.is_empty() {
            for other in AxisName::ALL {
                if !status.axis(other).homed {
                    self.axis(other).check_reference().await?;
                }
            }
        }
        Ok(settings.jog_room(axis, status.pose(), upwards))
    }
}

fn reason(axis: AxisName, room: &Room) -> String {
    match &room.region {
        Some(region) => format!("{axis} stops before the forbidden region {region}"),
        None => format!("{axis} is at its limit, {}", room.end),
    }
}
