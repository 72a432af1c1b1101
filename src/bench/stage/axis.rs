//! One axis on its line: reads its position, homes it, moves it and verifies its arrival.
//!
//! ```text
//!            ┌──────────── connect: stopped, identified, settings applied and read back
//!            ▼
//!   not referenced ──home──▶ homing ──idle, no flag──▶ at rest ◀─────────────────────────┐
//!            ▲                  │                        │ move                          │
//!            │                  │ fault, NI, NC          ▼                               │
//!            │                  ▼              [detour below the target] ─▶ approach ────┤ idle, no flag,
//!            └── WR, uptime fell, FS, WL … ◀───────────── moving                         │ within tolerance
//!                                                          │ stop, NI, NC, too late      │
//!                                                          └──────▶ stopped ─────────────┘ next move
//! ```
//!
//! An axis has arrived when a poll reads IDLE without a fault or interruption flag and a counter
//! within tolerance of the target; alerts are never used. Only absolute moves are sent. After a
//! lost reply the position is read before a command is repeated.

mod connection;
mod encoder;
mod flags;
mod homing;
mod jog;
mod profile;
mod queries;

use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use self::encoder::Encoder;
use self::profile::ProfileEntry;
use super::error::StageError;
use super::identity::DeviceIdentity;
use super::notice::Notices;
use super::prediction::Rates;
use super::settings::AxisSettings;
use crate::bench::AxisName;
use crate::bench::line::{LineError, PortLine};
use crate::bench::wire::zaber::{Activity, Reply};
use crate::bench::wire::zaber_flags::{Flag, FlagClass};
use crate::clock::Clock;
use crate::units::Angle;

/// Speed data are in microsteps per second times this.
const SPEED_UNIT: f64 = 1.6384;
/// Polling interval while a move is far from its end.
const POLL_COARSE: Duration = Duration::from_millis(200);
/// Polling interval of homing after a limit sensor was hit, to find the lost steps.
const POLL_LOST_STEPS: Duration = Duration::from_millis(20);
/// Time between two readings that must agree before an axis away from its target counts as at rest.
const REST_CHECK: Duration = Duration::from_millis(50);
/// Wait before a command is repeated that the device refuses for a moment (AGAIN, STATUSBUSY).
const PASSING_WAIT: Duration = Duration::from_millis(50);
/// Two stalls within this angle are at the same place.
const SAME_PLACE_DEG: f64 = 1.0;
/// Polling interval around the predicted end; one poll takes about 3 ms at 115200 baud.
const POLL_FINE: Duration = Duration::from_millis(3);
/// Fine polling ends this long after the predicted end, to limit the traffic.
const FINE_AFTER_END: Duration = Duration::from_millis(250);
/// Number of times that an axis at rest at a wrong position is sent to its target.
const ATTEMPTS: u32 = 3;

/// Position and state of an axis, from one reply.
#[derive(Debug, Clone)]
pub(super) struct AxisReading {
    pub counts: i64,
    pub activity: Activity,
    pub flag: Option<Flag>,
    /// Counts of the last poll of the motion that showed it moving.
    pub last_moving: Option<i64>,
}

/// The motion whose end is awaited.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Motion {
    /// A move with its predicted duration.
    Move { predicted: Duration },
    /// The way to the reference position, whose length is unknown.
    Homing,
    /// The ramp of a stop that this program sent.
    Stop,
}

#[derive(Debug, Default)]
struct Memory {
    /// The last move ended upwards, so the play of the gear is taken up.
    engaged: bool,
    /// The axis has had a reference position since it was connected.
    referenced: bool,
    uptime: Option<u64>,
    /// The device has its profile: no restart since it was last read.
    profile_holds: bool,
    encoder: Encoder,
    /// Where the axis stalled last; none once it has passed that place.
    stalled_at: Option<Angle>,
    /// Where it hit a limit sensor, until it is homed.
    limit_hit_at: Option<Angle>,
    /// This program stopped its last motion, so the flag of an interruption says nothing to a person.
    stopped_by_us: bool,
}

/// One axis. The task that moves it holds `turn`.
pub(super) struct Axis {
    pub name: AxisName,
    pub settings: AxisSettings,
    pub counts_per_turn: f64,
    pub rates: Rates,
    pub identity: DeviceIdentity,
    /// Settings of the device that a move depends on.
    profile: Vec<ProfileEntry>,
    pub line: PortLine,
    pub clock: Arc<dyn Clock>,
    notices: Notices,
    pub turn: tokio::sync::Mutex<()>,
    memory: Mutex<Memory>,
}

impl Axis {
    /// Whether a flag is worth a warning.
    pub fn is_news(&self, flag: Flag) -> bool {
        flag != Flag::MovementInterrupted || !self.memory().stopped_by_us
    }

    fn memory(&self) -> MutexGuard<'_, Memory> {
        self.memory.lock().expect("no holder of this lock panics")
    }

    /// Returns the device's counts for a recorded angle.
    fn counts(&self, recorded: Angle) -> i64 {
        let deg = if self.settings.reversed {
            self.settings.zero - recorded
        } else {
            recorded + self.settings.zero
        }
        .deg();
        (deg / 360.0 * self.counts_per_turn).round() as i64
    }

    /// Returns the recorded angle for a count.
    pub fn recorded(&self, counts: i64) -> Angle {
        let device = Angle::from_deg(counts as f64 / self.counts_per_turn * 360.0);
        if self.settings.reversed {
            self.settings.zero - device
        } else {
            device - self.settings.zero
        }
    }

    /// Waits on the clock; returns [`StageError::Stopped`] if the stage is stopped meanwhile.
    async fn wait(&self, duration: Duration, stops: u64) -> Result<(), StageError> {
        tokio::select! {
            biased;
            () = self.line.stopped_since(stops) => Err(StageError::Stopped),
            () = self.clock.sleep(duration) => Ok(()),
        }
    }

    fn check_stop(&self, stops: u64) -> Result<(), StageError> {
        if self.line.stops() == stops {
            Ok(())
        } else {
            self.memory().engaged = false;
            Err(StageError::Stopped)
        }
    }

    /// Polls until the axis is idle or a flag shows that the motion was lost (this program's own
    /// stop excepted). Time counts from the call, when the device has acknowledged the command.
    async fn await_idle(&self, motion: Motion, stops: u64) -> Result<AxisReading, StageError> {
        let began = self.clock.now();
        let (predicted, deadline) = match motion {
            Motion::Move { predicted } => {
                (predicted, predicted.mul_f64(1.5) + Duration::from_secs(1))
            }
            Motion::Homing => {
                let allowed = Duration::from_secs_f64(self.settings.home_timeout_s);
                (Duration::ZERO, allowed)
            }
            Motion::Stop => (Duration::ZERO, self.stopping_time()),
        };
        let mut last_moving = None;
        loop {
            let waited = self.clock.now().saturating_sub(began);
            let reading = self.read().await?;
            self.check_stop(stops)?;
            // A motion that another command has replaced need not be awaited.
            let lost = motion != Motion::Stop && reading.flag.is_some_and(ends_a_motion);
            if reading.activity == Activity::Idle || lost {
                return Ok(AxisReading {
                    last_moving,
                    ..reading
                });
            }
            last_moving = Some(reading.counts);
            // The reading must have started after the deadline, so that a slow line or a fast clock
            // does not turn a good move into a late one.
            if waited > deadline {
                return Err(self.late(motion, waited));
            }
            let pause = if waited < predicted {
                (predicted - waited).min(POLL_COARSE)
            } else if motion == Motion::Homing && self.memory().limit_hit_at.is_some() {
                POLL_LOST_STEPS
            } else if waited < predicted + FINE_AFTER_END {
                POLL_FINE
            } else {
                POLL_COARSE
            };
            self.wait(pause, stops).await?;
        }
    }

    fn late(&self, motion: Motion, waited: Duration) -> StageError {
        let axis = self.name;
        let predicted = match motion {
            Motion::Homing => {
                let home_timeout_s = self.settings.home_timeout_s;
                return StageError::HomingTimedOut {
                    axis,
                    home_timeout_s,
                };
            }
            Motion::Move { predicted } => predicted,
            Motion::Stop => self.stopping_time(),
        };
        StageError::TimedOut {
            axis,
            waited_s: waited.as_secs_f64(),
            predicted_s: predicted.as_secs_f64(),
        }
    }

    /// Moves the axis to a recorded angle; returns the angle read back and whether the axis had to
    /// move. The caller has checked the limits.
    pub async fn move_to(&self, target: Angle, stops: u64) -> Result<(Angle, bool), StageError> {
        let _turn = self.take_turn()?;
        let goal = self.counts(target);
        let mut moved = false;
        let mut reading = self.read().await?;
        if reading.activity == Activity::Busy {
            reading = self.bring_to_rest(stops).await?;
        }
        self.check_before(&reading).await?;
        self.verify_profile().await?;
        let began_at = self.recorded(reading.counts);
        for attempt in 1..=ATTEMPTS {
            self.check_before(&reading).await?;
            let from = self.recorded(reading.counts);
            let engaged = self.memory().engaged;
            if engaged && (goal - reading.counts).abs() as f64 <= 0.5 * self.tolerance_counts() {
                break;
            }
            moved = true;
            if self.settings.needs_detour(from, target, engaged) {
                let below = target - self.settings.backlash;
                reading = self.drive(&reading, below, stops).await?;
                self.check_flags(&reading).await?;
            }
            reading = self.drive(&reading, target, stops).await?;
            self.check_flags(&reading).await?;
            if self.is_there(&reading, goal) {
                self.memory().engaged = true;
                // An axis that stalled on the way approaches once more.
                if attempt < ATTEMPTS && self.clear_recovered_stall(&reading).await? {
                    continue;
                }
                break;
            }
        }
        self.check_stop(stops)?;
        if !self.is_there(&reading, goal) {
            return Err(StageError::Missed {
                axis: self.name,
                target,
                found: self.recorded(reading.counts),
            });
        }
        self.check_uptime().await?;
        self.check_encoder(&reading).await?;
        self.forget_stall_between(began_at, target);
        Ok((self.recorded(reading.counts), moved))
    }

    /// The place of the last stall was passed.
    fn forget_stall_between(&self, from: Angle, to: Angle) {
        let mut memory = self.memory();
        let (low, high) = if from < to { (from, to) } else { (to, from) };
        if memory.stalled_at.is_some_and(|at| low <= at && at <= high) {
            memory.stalled_at = None;
        }
    }

    /// Waits until two readings agree: a controller may report idle while it moves, and a garbled
    /// reply may pass the checksum. A command that is repeated too early would interrupt the first.
    async fn await_rest_elsewhere(
        &self,
        mut last: AxisReading,
        goal: i64,
        stops: u64,
    ) -> Result<AxisReading, StageError> {
        let longest = self
            .rates
            .duration(self.settings.limit_max - self.settings.limit_min);
        let deadline = longest.mul_f64(1.5) + Duration::from_secs(1);
        let began = self.clock.now();
        loop {
            self.wait(REST_CHECK, stops).await?;
            let waited = self.clock.now().saturating_sub(began);
            let reading = self.read().await?;
            let rests =
                (reading.counts - last.counts).abs() as f64 <= 0.5 * self.tolerance_counts();
            if self.is_there(&reading, goal) || rests && reading.activity == Activity::Idle {
                return Ok(reading);
            }
            if waited > deadline {
                return Err(self.late(Motion::Move { predicted: longest }, waited));
            }
            last = reading;
        }
    }

    fn tolerance_counts(&self) -> f64 {
        let counts = self.settings.tolerance.deg() / 360.0 * self.counts_per_turn;
        counts.max(1.0)
    }

    fn is_there(&self, reading: &AxisReading, goal: i64) -> bool {
        reading.activity == Activity::Idle
            && (reading.counts - goal).abs() as f64 <= self.tolerance_counts()
    }

    /// Whether the play of the gear is taken up.
    pub fn engaged(&self) -> bool {
        self.memory().engaged
    }

    /// Makes one absolute move from rest to rest.
    async fn drive(
        &self,
        from: &AxisReading,
        to: Angle,
        stops: u64,
    ) -> Result<AxisReading, StageError> {
        let counts = self.counts(to);
        self.memory().engaged = false;
        let predicted = self.rates.duration(to - self.recorded(from.counts));
        let words = format!("move abs {counts}");
        self.start(&words, Some(counts), stops).await?;
        let reading = self.await_idle(Motion::Move { predicted }, stops).await?;
        let lost = reading.flag.is_some_and(ends_a_motion);
        match lost || self.is_there(&reading, counts) {
            true => Ok(reading),
            false => self.await_rest_elsewhere(reading, counts, stops).await,
        }
    }

    /// Sends a motion command. If the reply is lost, the position is read before the command is
    /// repeated: a repeated command would interrupt the first one if that arrived.
    ///
    /// A device that refuses the command for a moment is asked again within the time of a stop.
    async fn start(&self, words: &str, goal: Option<i64>, stops: u64) -> Result<(), StageError> {
        self.memory().stopped_by_us = false;
        let mut attempt = 0;
        let passing_until = self.clock.now() + self.stopping_time();
        loop {
            attempt += 1;
            match self.line.command_once(&self.command(words), stops).await {
                Ok(reply) if is_passing(&reply) && self.clock.now() < passing_until => {
                    attempt -= 1;
                    self.wait(PASSING_WAIT, stops).await?;
                }
                Ok(reply) => return self.accepted(words, reply).map(|_| ()),
                Err(LineError::NoReply { .. }) => {
                    let reading = self.read().await?;
                    self.check_stop(stops)?;
                    let under_way = reading.activity == Activity::Busy;
                    let there = goal.is_some_and(|goal| self.is_there(&reading, goal));
                    if under_way || there {
                        return Ok(());
                    }
                    // The device answers queries but does not execute the command.
                    if attempt == ATTEMPTS {
                        return Err(StageError::NotCarriedOut {
                            axis: self.name,
                            command: words.to_owned(),
                            attempts: ATTEMPTS,
                        });
                    }
                }
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Enables the motor's driver if the flags show that it is off, and unparks a parked axis.
    /// Nothing moves.
    pub async fn release(&self) -> Result<(), StageError> {
        if self.flags().await?.into_iter().any(Flag::is_driver_off) {
            self.ask("driver enable").await?;
        }
        match self.ask("get parking.state").await {
            Ok(reply) if reply.data == "1" => self.unpark().await,
            // A device without parking rejects the command.
            Ok(_) | Err(StageError::Refused { .. }) => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// Unparks an axis. Nothing moves.
    pub async fn unpark(&self) -> Result<(), StageError> {
        self.ask("tools parking unpark").await.map(|_| ())
    }

    /// Stops an axis that moves although no caller awaits it: the future of its move was dropped,
    /// or another host sent a command.
    async fn bring_to_rest(&self, stops: u64) -> Result<AxisReading, StageError> {
        self.line.command_once(&self.command("stop"), stops).await?;
        self.memory().engaged = false;
        self.await_idle(Motion::Stop, stops).await
    }

    /// Longest duration of a stop.
    pub fn stopping_time(&self) -> Duration {
        let ramp = self.rates.speed_deg_s / self.rates.acceleration_deg_s2;
        Duration::from_secs(1) + Duration::try_from_secs_f64(ramp * 2.0).unwrap_or_default()
    }

    /// Waits after a stop until the axis is idle, regardless of flags.
    pub async fn await_rest(&self) -> Result<(), StageError> {
        {
            let mut memory = self.memory();
            (memory.engaged, memory.stopped_by_us) = (false, true);
        }
        let began = self.clock.now();
        loop {
            let waited = self.clock.now().saturating_sub(began);
            let reply = self.line.ask_soon(&self.command("get pos")).await?;
            if reply.activity == Activity::Idle {
                return Ok(());
            }
            if waited > self.stopping_time() {
                return Err(self.late(Motion::Stop, waited));
            }
            self.clock.sleep(POLL_FINE * 5).await;
        }
    }

    pub fn take_turn(&self) -> Result<tokio::sync::MutexGuard<'_, ()>, StageError> {
        self.turn
            .try_lock()
            .map_err(|_| StageError::Busy { axis: self.name })
    }
}

/// Returns whether a device refused a command that it may accept a moment later.
fn is_passing(reply: &Reply) -> bool {
    !reply.accepted && matches!(reply.data.as_str(), "AGAIN" | "STATUSBUSY")
}

/// Returns whether a motion with this flag raised cannot arrive.
fn ends_a_motion(flag: Flag) -> bool {
    matches!(flag.class(), FlagClass::Fault | FlagClass::Interrupted)
}
