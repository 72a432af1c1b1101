//! One axis on its line: where is it, home it, bring it somewhere and prove that it is there.
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
//! Arrival is a polled IDLE with no fault or interruption flag and the counter within tolerance of
//! the target, never an alert. Only absolute moves are sent, and after a lost reply the position is
//! read again before anything is sent twice.

use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use super::error::{StageError, refusal_meaning};
use super::settings::{AxisSettings, Rates};
use crate::bench::AxisName;
use crate::bench::line::{Line, LineError};
use crate::bench::wire::zaber::{Activity, Command, Reply, decode_warnings};
use crate::bench::wire::zaber_flags::{Flag, FlagClass};
use crate::clock::Clock;
use crate::units::Angle;

/// While a move is far from its end it is looked at this often.
const POLL_COARSE: Duration = Duration::from_millis(200);
/// Around the predicted end this often; one poll takes about 3 ms at 115200 baud.
const POLL_FINE: Duration = Duration::from_millis(3);
/// This long after the predicted end it is no longer worth the traffic.
const FINE_AFTER_END: Duration = Duration::from_millis(250);
/// An axis that stands still at the wrong place is sent there again this often.
const ATTEMPTS: u32 = 3;
/// Speed data are microsteps per second times this.
const SPEED_UNIT: f64 = 1.6384;
/// Acceleration data are microsteps per second squared times this.
const ACCELERATION_UNIT: f64 = 1.6384 / 10_000.0;

/// What an axis's device is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Identity {
    pub serial: u32,
    pub device_id: u32,
    pub firmware: String,
}

/// What one look at an axis says.
#[derive(Debug, Clone)]
pub(super) struct Look {
    pub counts: i64,
    pub activity: Activity,
    pub flag: Option<Flag>,
}

/// What an axis is waited for to end.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Motion {
    /// A move that should take so long.
    Move { predicted: Duration },
    /// The way to the reference: how long that is, nobody knows before.
    Homing,
    /// The ramp of a stop of our own.
    Stop,
}

#[derive(Debug, Default)]
struct Memory {
    /// The last move ended going up: the play of the gear is taken up.
    engaged: bool,
    /// It has had a reference since it was connected.
    referenced: bool,
    uptime: Option<u64>,
}

/// One axis. Whoever moves it holds `turn`.
pub(super) struct Axis {
    pub name: AxisName,
    pub settings: AxisSettings,
    pub counts_per_turn: f64,
    pub rates: Rates,
    pub identity: Identity,
    pub line: Line,
    pub clock: Arc<dyn Clock>,
    pub turn: tokio::sync::Mutex<()>,
    memory: Mutex<Memory>,
}

impl Axis {
    /// Identifies the device, applies the settings and reads them back. The axis stands still.
    pub async fn connect(
        name: AxisName,
        settings: AxisSettings,
        line: Line,
        clock: Arc<dyn Clock>,
    ) -> Result<Axis, StageError> {
        let mut axis = Axis {
            name,
            counts_per_turn: 1.0,
            rates: Rates {
                speed_deg_s: 1.0,
                acceleration_deg_s2: 1.0,
            },
            identity: Identity {
                serial: 0,
                device_id: 0,
                firmware: String::new(),
            },
            settings,
            line,
            clock,
            turn: tokio::sync::Mutex::new(()),
            memory: Mutex::default(),
        };
        axis.identify().await?;
        axis.learn_scale().await?;
        axis.check_travel().await?;
        axis.apply_rates().await?;
        axis.check_uptime().await?;
        let flags = axis.flags().await?;
        axis.memory().referenced = !flags.contains(&Flag::NoReference);
        Ok(axis)
    }

    async fn identify(&mut self) -> Result<(), StageError> {
        let serial: u32 = self.get_number("system.serial").await?;
        if let Some(expected) = self.settings.serial
            && expected != serial
        {
            return Err(StageError::WrongDevice {
                axis: self.name,
                address: self.settings.address,
                expected,
                found: serial,
            });
        }
        self.identity = Identity {
            serial,
            device_id: self.get_number("device.id").await?,
            firmware: self.ask_controller("get version").await?.data,
        };
        Ok(())
    }

    async fn learn_scale(&mut self) -> Result<(), StageError> {
        let told: Option<f64> = match self.get_finite("limit.cycle.dist").await {
            Ok(counts) => Some(counts).filter(|c| *c > 0.0),
            Err(StageError::Refused { code, .. }) if code == "BADAXIS" => {
                return Err(StageError::NoSuchAxis {
                    axis: self.name,
                    address: self.settings.address,
                    number: self.settings.axis,
                });
            }
            Err(StageError::Refused { .. } | StageError::Unreadable { .. }) => None,
            Err(error) => return Err(error),
        };
        self.counts_per_turn = match (told, self.settings.counts_per_turn) {
            (Some(found), Some(expected)) if (found / expected - 1.0).abs() > 1e-6 => {
                return Err(StageError::Disagreement {
                    axis: self.name,
                    name: "limit.cycle.dist",
                    expected,
                    found,
                });
            }
            (Some(counts), _) | (None, Some(counts)) => counts,
            (None, None) => return Err(StageError::NoScale { axis: self.name }),
        };
        Ok(())
    }

    /// The settings' limits, with the room for the approach, must lie within the device's.
    async fn check_travel(&self) -> Result<(), StageError> {
        let needed = (
            self.settings.limit_min - self.settings.backlash,
            self.settings.limit_max,
        );
        let (low, high) = (self.counts(needed.0), self.counts(needed.1));
        let (low, high) = (low.min(high), low.max(high));
        let min = self.get_finite("limit.min").await?;
        let max = self.get_finite("limit.max").await?;
        if min <= low as f64 && max >= high as f64 {
            return Ok(());
        }
        let device_angle = |counts: f64| Angle::from_deg(counts / self.counts_per_turn * 360.0);
        Err(StageError::BeyondTravel {
            axis: self.name,
            needed_min: device_angle(low as f64),
            needed_max: device_angle(high as f64),
            travel_min: device_angle(min),
            travel_max: device_angle(max),
        })
    }

    async fn apply_rates(&mut self) -> Result<(), StageError> {
        let counts_per_deg = self.counts_per_turn / 360.0;
        let mut rates = [0.0; 2];
        for (rate, (name, unit, wanted)) in rates.iter_mut().zip([
            ("maxspeed", SPEED_UNIT, self.settings.max_speed_deg_s),
            (
                "accel",
                ACCELERATION_UNIT,
                self.settings.acceleration_deg_s2,
            ),
        ]) {
            let to_data = counts_per_deg * unit;
            let wanted = wanted.map(|w| (w * to_data).round().max(1.0));
            if let Some(wanted) = wanted {
                self.ask(&format!("set {name} {wanted:.0}")).await?;
            }
            let found = self.get_finite(name).await?;
            if let Some(expected) = wanted
                && (found - expected).abs() > 1.0
            {
                return Err(StageError::Disagreement {
                    axis: self.name,
                    name,
                    expected,
                    found,
                });
            }
            // 0 means "no limit" to some devices; then the guess only makes the wait finer.
            *rate = found.max(1.0) / to_data;
        }
        self.rates = Rates {
            speed_deg_s: rates[0],
            acceleration_deg_s2: rates[1],
        };
        Ok(())
    }

    fn memory(&self) -> MutexGuard<'_, Memory> {
        self.memory.lock().expect("no holder of this lock panics")
    }

    /// Counts of the device for a recorded angle.
    fn counts(&self, recorded: Angle) -> i64 {
        let deg = if self.settings.reversed {
            self.settings.zero - recorded
        } else {
            recorded + self.settings.zero
        }
        .deg();
        (deg / 360.0 * self.counts_per_turn).round() as i64
    }

    /// The recorded angle at a count.
    pub fn recorded(&self, counts: i64) -> Angle {
        let device = Angle::from_deg(counts as f64 / self.counts_per_turn * 360.0);
        if self.settings.reversed {
            self.settings.zero - device
        } else {
            device - self.settings.zero
        }
    }

    fn command(&self, words: &str) -> Command {
        Command::new(self.settings.address, self.settings.axis, words)
    }

    /// Asks the axis something that may be asked twice.
    async fn ask(&self, words: &str) -> Result<Reply, StageError> {
        let reply = self.line.ask(&self.command(words)).await?;
        self.accepted(words, reply)
    }

    /// Asks the controller that the axis is plugged into, which may have others.
    pub async fn ask_controller(&self, words: &str) -> Result<Reply, StageError> {
        let command = Command::new(self.settings.address, 0, words);
        let reply = self.line.ask(&command).await?;
        self.accepted(words, reply)
    }

    fn accepted(&self, words: &str, reply: Reply) -> Result<Reply, StageError> {
        if reply.accepted {
            return Ok(reply);
        }
        Err(StageError::Refused {
            axis: self.name,
            command: words.to_owned(),
            meaning: refusal_meaning(&reply.data),
            code: reply.data,
        })
    }

    /// A number of the controller's.
    async fn get_number<N: std::str::FromStr>(&self, name: &str) -> Result<N, StageError> {
        let command = format!("get {name}");
        let reply = self.ask_controller(&command).await?;
        self.number(&command, &reply.data)
    }

    /// A number of the axis that is finite: `inf` and `nan` are words to a parser, and no answer.
    async fn get_finite(&self, name: &str) -> Result<f64, StageError> {
        let command = format!("get {name}");
        let reply = self.ask(&command).await?;
        let value: f64 = self.number(&command, &reply.data)?;
        match value.is_finite() {
            true => Ok(value),
            false => Err(self.unreadable(&command, reply.data)),
        }
    }

    fn number<N: std::str::FromStr>(&self, command: &str, data: &str) -> Result<N, StageError> {
        data.trim()
            .parse()
            .map_err(|_| self.unreadable(command, data.to_owned()))
    }

    fn unreadable(&self, command: &str, answer: String) -> StageError {
        StageError::Unreadable {
            axis: self.name,
            command: command.to_owned(),
            answer,
        }
    }

    /// Position, activity and highest flag in one exchange.
    pub async fn look(&self) -> Result<Look, StageError> {
        let reply = self.ask("get pos").await?;
        Ok(Look {
            counts: self.number("get pos", &reply.data)?,
            activity: reply.activity,
            flag: reply.flag,
        })
    }

    /// All flags that are up.
    pub async fn flags(&self) -> Result<Vec<Flag>, StageError> {
        let reply = self.ask("warnings").await?;
        decode_warnings(&reply.data).map_err(|_| self.unreadable("warnings", reply.data))
    }

    /// Notices a restart of the device: its uptime falls.
    async fn check_uptime(&self) -> Result<(), StageError> {
        let uptime: u64 = match self.get_number("system.uptime").await {
            Ok(uptime) => uptime,
            // A device that does not count still shows WR after a restart.
            Err(StageError::Refused { .. }) => return Ok(()),
            Err(error) => return Err(error),
        };
        let mut memory = self.memory();
        let before = memory.uptime.replace(uptime);
        if before.is_some_and(|before| uptime < before) {
            memory.referenced = false;
            memory.engaged = false;
            return Err(StageError::PowerCycled { axis: self.name });
        }
        Ok(())
    }

    /// Waits on the clock, unless the stage is stopped meanwhile.
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

    /// Looks until the axis is idle, or until a flag says that the motion was lost, unless it is a
    /// stop of our own that did it. Time counts from now, when the device has taken the command.
    async fn await_idle(&self, motion: Motion, stops: u64) -> Result<Look, StageError> {
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
            let look = self.look().await?;
            self.check_stop(stops)?;
            // A motion that is not ours any more need not be waited for.
            let lost = motion != Motion::Stop && look.flag.is_some_and(ends_a_motion);
            if look.activity == Activity::Idle || lost {
                return Ok(look);
            }
            // Judged by a look that began after the deadline, so that a slow line, or a fast clock,
            // does not make a good move a late one.
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

    /// What the flags say about the motion that just ended, or the one that is to begin.
    async fn check_flags(&self, look: &Look) -> Result<(), StageError> {
        if look.flag.is_none() {
            return Ok(());
        }
        let flags = self.flags().await?;
        let position = self.recorded(look.counts);
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

    /// Finds the reference position.
    pub async fn home(&self, stops: u64) -> Result<(), StageError> {
        let _turn = self.take_turn()?;
        self.memory().engaged = false;
        // Flags of an earlier failure would be taken for this motion's; the ones that matter stay up.
        self.ask("warnings clear").await?;
        self.start("home", None, stops).await?;
        let look = self.await_idle(Motion::Homing, stops).await?;
        if look.flag.is_some() {
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
            // A restart before this homing does not matter any more, one during it shows as WR.
            memory.uptime = None;
        }
        self.check_uptime().await
    }

    /// Brings the axis to a recorded angle and gives the one read back. The limits have been checked.
    /// True if it had to move.
    pub async fn move_to(&self, target: Angle, stops: u64) -> Result<(Angle, bool), StageError> {
        let _turn = self.take_turn()?;
        let goal = self.counts(target);
        let mut moved = false;
        let mut look = self.look().await?;
        if look.activity == Activity::Busy {
            look = self.quieten(stops).await?;
        }
        for _ in 0..ATTEMPTS {
            self.check_before(&look).await?;
            let from = self.recorded(look.counts);
            let engaged = self.memory().engaged;
            if engaged && (goal - look.counts).abs() as f64 <= 0.5 * self.tolerance_counts() {
                break;
            }
            moved = true;
            if self.settings.needs_detour(from, target, engaged) {
                let below = target - self.settings.backlash;
                look = self.drive(&look, below, stops).await?;
                self.check_flags(&look).await?;
            }
            look = self.drive(&look, target, stops).await?;
            self.check_flags(&look).await?;
            if !self.is_there(&look, goal) {
                // One misread in 256 garbled replies passes the checksum: ask again before acting.
                look = self.look().await?;
            }
            if self.is_there(&look, goal) {
                self.memory().engaged = true;
                break;
            }
        }
        self.check_stop(stops)?;
        if !self.is_there(&look, goal) {
            return Err(StageError::Missed {
                axis: self.name,
                target,
                found: self.recorded(look.counts),
            });
        }
        self.check_uptime().await?;
        Ok((self.recorded(look.counts), moved))
    }

    /// Before a move: interruptions of earlier motions do not matter, faults and the reference do.
    async fn check_before(&self, look: &Look) -> Result<(), StageError> {
        match self.check_flags(look).await {
            Err(StageError::Interrupted { .. }) => {
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

    fn is_there(&self, look: &Look, goal: i64) -> bool {
        look.activity == Activity::Idle
            && (look.counts - goal).abs() as f64 <= self.tolerance_counts()
    }

    /// One absolute move from rest to rest.
    async fn drive(&self, from: &Look, to: Angle, stops: u64) -> Result<Look, StageError> {
        let counts = self.counts(to);
        self.memory().engaged = false;
        let predicted = self.rates.duration(to - self.recorded(from.counts));
        let words = format!("move abs {counts}");
        self.start(&words, Some(counts), stops).await?;
        self.await_idle(Motion::Move { predicted }, stops).await
    }

    /// Sends a motion command. If the reply is lost the axis is looked at before anything is sent
    /// again: a second command would interrupt the first one, if that arrived.
    async fn start(&self, words: &str, goal: Option<i64>, stops: u64) -> Result<(), StageError> {
        let mut attempt = 0;
        loop {
            attempt += 1;
            match self.line.command_once(&self.command(words), stops).await {
                Ok(reply) => return self.accepted(words, reply).map(|_| ()),
                Err(error @ LineError::NoReply { .. }) => {
                    let look = self.look().await?;
                    self.check_stop(stops)?;
                    let under_way = look.activity == Activity::Busy;
                    let there = goal.is_some_and(|goal| self.is_there(&look, goal));
                    if under_way || there {
                        return Ok(());
                    }
                    // It answers what it is asked, and does not do what it is told.
                    if attempt == ATTEMPTS {
                        return Err(error.into());
                    }
                }
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Switches the motor's driver on where the flags say that it is off, and unparks a parked axis. Nothing moves by
    /// that.
    pub async fn release(&self) -> Result<(), StageError> {
        if self.flags().await?.into_iter().any(Flag::is_driver_off) {
            self.ask("driver enable").await?;
        }
        match self.ask("get parking.state").await {
            Ok(reply) if reply.data == "1" => self.unpark().await,
            // A device that cannot be parked does not know the word.
            Ok(_) | Err(StageError::Refused { .. }) => Ok(()),
            Err(error) => Err(error),
        }
    }

    /// Lets an axis move again that was parked. Nothing moves by that.
    pub async fn unpark(&self) -> Result<(), StageError> {
        self.ask("tools parking unpark").await.map(|_| ())
    }

    /// Brings an axis to rest that moves without our doing: a move whose future was dropped, or a
    /// foreign command.
    async fn quieten(&self, stops: u64) -> Result<Look, StageError> {
        self.line.command_once(&self.command("stop"), stops).await?;
        self.memory().engaged = false;
        self.await_idle(Motion::Stop, stops).await
    }

    /// The longest that a stop may take.
    pub fn stopping_time(&self) -> Duration {
        let ramp = self.rates.speed_deg_s / self.rates.acceleration_deg_s2;
        Duration::from_secs(1) + Duration::try_from_secs_f64(ramp * 2.0).unwrap_or_default()
    }

    /// After a stop: waits until the axis is idle, whatever else happens.
    pub async fn await_rest(&self) -> Result<(), StageError> {
        self.memory().engaged = false;
        let began = self.clock.now();
        loop {
            let waited = self.clock.now().saturating_sub(began);
            if self.look().await?.activity == Activity::Idle {
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

/// Whether a motion with this flag up will not arrive.
fn ends_a_motion(flag: Flag) -> bool {
    matches!(flag.class(), FlagClass::Fault | FlagClass::Interrupted)
}
