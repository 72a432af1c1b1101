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
mod queries;

use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use tracing::warn;

use super::error::StageError;
use super::settings::{AxisSettings, Rates};
use crate::bench::AxisName;
use crate::bench::line::{LineError, PortLine};
use crate::bench::wire::zaber::Activity;
use crate::bench::wire::zaber_flags::{Flag, FlagClass};
use crate::clock::Clock;
use crate::units::Angle;

/// Polling interval while a move is far from its end.
const POLL_COARSE: Duration = Duration::from_millis(200);
/// Polling interval around the predicted end; one poll takes about 3 ms at 115200 baud.
const POLL_FINE: Duration = Duration::from_millis(3);
/// Fine polling ends this long after the predicted end, to limit the traffic.
const FINE_AFTER_END: Duration = Duration::from_millis(250);
/// Number of times that an axis at rest at a wrong position is sent to its target.
const ATTEMPTS: u32 = 3;

/// Identity of an axis's controller.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct ControllerIdentity {
    pub serial: u32,
    pub device_id: u32,
    pub firmware: String,
}

/// Position and state of an axis, from one reply.
#[derive(Debug, Clone)]
pub(super) struct AxisReading {
    pub counts: i64,
    pub activity: Activity,
    pub flag: Option<Flag>,
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
    /// The device has no encoder that it reports.
    no_encoder: bool,
}

/// One axis. The task that moves it holds `turn`.
pub(super) struct Axis {
    pub name: AxisName,
    pub settings: AxisSettings,
    pub counts_per_turn: f64,
    pub rates: Rates,
    pub identity: ControllerIdentity,
    pub line: PortLine,
    pub clock: Arc<dyn Clock>,
    pub turn: tokio::sync::Mutex<()>,
    memory: Mutex<Memory>,
}

impl Axis {
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
        loop {
            let waited = self.clock.now().saturating_sub(began);
            let reading = self.read().await?;
            self.check_stop(stops)?;
            // A motion that another command has replaced need not be awaited.
            let lost = motion != Motion::Stop && reading.flag.is_some_and(ends_a_motion);
            if reading.activity == Activity::Idle || lost {
                return Ok(reading);
            }
            // The reading must have started after the deadline, so that a slow line or a fast clock
            // does not turn a good move into a late one.
            if waited > deadline {
                return Err(self.late(motion, waited));
            }
            let pause = if waited < predicted {
                (predicted - waited).min(POLL_COARSE)
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

    /// Returns the error that the flags imply for the motion that just ended or is about to start.
    async fn check_flags(&self, reading: &AxisReading) -> Result<(), StageError> {
        if reading.flag.is_none() {
            return Ok(());
        }
        let flags = self.flags().await?;
        let position = self.recorded(reading.counts);
        let axis = self.name;
        for flag in flags {
            match (flag.class(), flag) {
                (FlagClass::Fault, Flag::Stalled) => {
                    return Err(StageError::Stalled { axis, position });
                }
                (FlagClass::Fault, _) => return Err(StageError::Fault { axis, flag }),
                (FlagClass::ReferenceLost, Flag::NoReference) => {
                    let mut memory = self.memory();
                    memory.engaged = false;
                    memory.uptime = None;
                    return Err(if std::mem::take(&mut memory.referenced) {
                        StageError::PowerCycled { axis }
                    } else {
                        StageError::NotReferenced { axis }
                    });
                }
                (FlagClass::ReferenceLost, _) => return Err(StageError::NotReferenced { axis }),
                (FlagClass::Interrupted, _) => return Err(StageError::Interrupted { axis, flag }),
                (FlagClass::Informational, _) => {}
            }
        }
        Ok(())
    }

    /// Moves to the reference position.
    pub async fn home(&self, stops: u64) -> Result<(), StageError> {
        let _turn = self.take_turn()?;
        self.memory().engaged = false;
        // Flags of an earlier failure would be attributed to this motion; lasting ones stay raised.
        self.ask("warnings clear").await?;
        self.start("home", None, stops).await?;
        let reading = self.await_idle(Motion::Homing, stops).await?;
        if reading.flag.is_some() {
            let axis = self.name;
            for flag in self.flags().await? {
                match flag.class() {
                    FlagClass::Interrupted => return Err(StageError::Interrupted { axis, flag }),
                    FlagClass::Fault | FlagClass::ReferenceLost => {
                        return Err(StageError::HomingFailed { axis, flag });
                    }
                    FlagClass::Informational => {}
                }
            }
        }
        {
            let mut memory = self.memory();
            memory.referenced = true;
            // A restart before this homing has no effect any more; one during it shows as WR.
            memory.uptime = None;
        }
        self.check_uptime().await
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
            if !self.is_there(&reading, goal) {
                // One in 256 garbled replies passes the checksum: read again before acting.
                reading = self.read().await?;
            }
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
        self.check_encoder(reading.counts).await?;
        Ok((self.recorded(reading.counts), moved))
    }

    /// Clears the flag of a stall that the axis recovered from; returns whether it was raised. The
    /// next move then approaches from below again.
    async fn clear_recovered_stall(&self, reading: &AxisReading) -> Result<bool, StageError> {
        if reading.flag.is_none() || !self.flags().await?.contains(&Flag::StallRecovered) {
            return Ok(false);
        }
        warn!(axis = %self.name, "{} stalled and recovered on the way; it approaches once more", self.name);
        self.ask("warnings clear").await?;
        self.memory().engaged = false;
        Ok(true)
    }

    /// Checks the flags before a move: interruptions of earlier motions are ignored, faults and a
    /// lost reference are not.
    async fn check_before(&self, reading: &AxisReading) -> Result<(), StageError> {
        match self.check_flags(reading).await {
            Err(StageError::Interrupted { .. }) => {
                self.memory().engaged = false;
                Ok(())
            }
            // An axis that was pushed is sent to its target again, which also clears the flag.
            Ok(()) if reading.flag.is_some() && self.flags().await?.contains(&Flag::Displaced) => {
                self.memory().engaged = false;
                Ok(())
            }
            other => other,
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
        self.await_idle(Motion::Move { predicted }, stops).await
    }

    /// Sends a motion command. If the reply is lost, the position is read before the command is
    /// repeated: a repeated command would interrupt the first one if that arrived.
    async fn start(&self, words: &str, goal: Option<i64>, stops: u64) -> Result<(), StageError> {
        let mut attempt = 0;
        loop {
            attempt += 1;
            match self.line.command_once(&self.command(words), stops).await {
                Ok(reply) => return self.accepted(words, reply).map(|_| ()),
                Err(error @ LineError::NoReply { .. }) => {
                    let reading = self.read().await?;
                    self.check_stop(stops)?;
                    let under_way = reading.activity == Activity::Busy;
                    let there = goal.is_some_and(|goal| self.is_there(&reading, goal));
                    if under_way || there {
                        return Ok(());
                    }
                    // The device answers queries but does not execute the command.
                    if attempt == ATTEMPTS {
                        return Err(error.into());
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
        self.memory().engaged = false;
        let began = self.clock.now();
        loop {
            let waited = self.clock.now().saturating_sub(began);
            if self.read().await?.activity == Activity::Idle {
                return Ok(());
            }
            if waited > self.stopping_time() {
                return Err(self.late(Motion::Stop, waited));
            }
            self.clock.sleep(POLL_FINE * 5).await;
        }
    }

    fn take_turn(&self) -> Result<tokio::sync::MutexGuard<'_, ()>, StageError> {
        self.turn
            .try_lock()
            .map_err(|_| StageError::Busy { axis: self.name })
    }
}

/// Returns whether a motion with this flag raised cannot arrive.
fn ends_a_motion(flag: Flag) -> bool {
    matches!(flag.class(), FlagClass::Fault | FlagClass::Interrupted)
}
