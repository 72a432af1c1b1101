//! The stage: two axes on one line, addressed in recorded angles.
//!
//! [`Stage::connect`] opens the port and verifies the devices; [`Stage::move_pose`] is the function
//! that a scan calls. A move has succeeded only when the position read back is within tolerance. A
//! stop is never refused: it is sent before all waiting commands, and commands issued before it are
//! not sent after it. Knows no scan, camera or sample. The head of `axis.rs` draws the states of an
//! axis.

mod axis;
mod error;
mod settings;

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use serde::{Serialize, Serializer};
use tracing::{debug, info, warn};

pub use self::error::StageError;
pub use self::settings::{AxisSettings, MoveTimes, StageSettings};
pub use super::AxisName;
pub use super::port::{NoFaults, PortAddress, PortSeam};
pub use super::wire::zaber_flags::{Flag, FlagClass};

use self::axis::Axis;
use super::line::{LineSettings, PortLine};
use super::wire::zaber::Activity;
use crate::clock::Clock;
use crate::geometry::Pose;
use crate::units::Angle;

/// Two axes on one line. Cheap to clone; the line closes with the last clone, or for all clones with
/// [`Stage::close`].
#[derive(Clone)]
pub struct Stage {
    inner: Arc<Inner>,
}

struct Inner {
    address: PortAddress,
    settings: StageSettings,
    clock: Arc<dyn Clock>,
    line: PortLine,
    theta_c: Axis,
    phi_s: Axis,
}

/// Positions and flags of both axes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StageStatus {
    /// The tilt axis.
    pub theta_c: AxisStatus,
    /// The rotation axis.
    pub phi_s: AxisStatus,
}

/// Position and flags of an axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AxisStatus {
    /// Position read from the device, as a recorded angle.
    #[serde(rename = "position_deg", serialize_with = "degrees")]
    pub position: Angle,
    /// Whether the axis is moving.
    pub moving: bool,
    /// Whether the axis has been homed since power-up.
    pub homed: bool,
    /// Raised flags, each with its meaning.
    pub warnings: Vec<String>,
    /// The same flags as the device names them.
    #[serde(skip)]
    pub flags: Vec<Flag>,
    /// Serial number of its controller.
    pub serial: u32,
}

fn degrees<S: Serializer>(angle: &Angle, s: S) -> Result<S::Ok, S::Error> {
    s.serialize_f64((angle.deg() * 1e10).round() / 1e10)
}

impl StageStatus {
    /// Both positions.
    #[must_use]
    pub fn pose(&self) -> Pose {
        Pose {
            theta_c: self.theta_c.position,
            phi_s: self.phi_s.position,
        }
    }

    /// The status of one axis.
    #[must_use]
    pub fn axis(&self, axis: AxisName) -> &AxisStatus {
        match axis {
            AxisName::ThetaC => &self.theta_c,
            AxisName::PhiS => &self.phi_s,
        }
    }

    /// Whether both axes have been homed since power-up.
    #[must_use]
    pub fn all_homed(&self) -> bool {
        self.theta_c.homed && self.phi_s.homed
    }
}

/// Identity of the connected devices.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct StageIdentity {
    /// The tilt axis's device.
    pub theta_c: DeviceIdentity,
    /// The rotation axis's device.
    pub phi_s: DeviceIdentity,
}

/// Identity of one device.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct DeviceIdentity {
    /// Serial number.
    pub serial: u32,
    /// The manufacturer's product number.
    pub device_id: u32,
    /// Firmware version.
    pub firmware: String,
}

impl Stage {
    /// Opens the port, stops all motion, verifies the devices against the settings, applies the
    /// settings and reads them back. Moves nothing.
    ///
    /// # Errors
    /// [`StageError`] names the cause and the remedy; the port is closed again.
    pub async fn connect(
        port: PortAddress,
        settings: StageSettings,
        clock: Arc<dyn Clock>,
        seam: Arc<dyn PortSeam>,
    ) -> Result<Stage, StageError> {
        settings.validate()?;
        let line_settings = LineSettings {
            reply_timeout: Duration::from_millis(settings.reply_timeout_ms),
            attempts: settings.attempts,
        };
        let (address, baud) = (port.clone(), settings.baud);
        // Opening can take seconds: a TCP connection, or a port that has just been plugged in.
        let line = tokio::task::spawn_blocking(move || {
            PortLine::open(&address, baud, line_settings, seam.as_ref())
        })
        .await
        .expect("opening a port does not panic")?;

        let connected = Stage::take_over(&line, port, settings, clock).await;
        if connected.is_err() {
            line.close();
            line.closed().await;
        }
        connected
    }

    /// Stops what moves on an open line, verifies the devices and applies the settings.
    async fn take_over(
        line: &PortLine,
        port: PortAddress,
        settings: StageSettings,
        clock: Arc<dyn Clock>,
    ) -> Result<Stage, StageError> {
        let addresses = settings.addresses();
        // A program that died may have left a move running that this session did not request.
        line.stop(&addresses).await?;
        find_conflicts(line).await?;
        let connect = |name: AxisName| {
            let settings = settings.axis(name).clone();
            Axis::connect(name, settings, line.clone(), Arc::clone(&clock))
        };
        let theta_c = connect(AxisName::ThetaC).await?;
        let phi_s = connect(AxisName::PhiS).await?;
        set_up_line(line, [&theta_c, &phi_s]).await?;
        for axis in [&theta_c, &phi_s] {
            axis.await_rest().await?;
            info!(
                axis = %axis.name,
                serial = axis.identity.serial,
                "{}: device {} with firmware {} on {port}, {:.0} microsteps per turn, {:.1} deg/s",
                axis.name,
                axis.identity.device_id,
                axis.identity.firmware,
                axis.counts_per_turn,
                axis.rates.speed_deg_s,
            );
        }
        Ok(Stage {
            inner: Arc::new(Inner {
                address: port,
                settings,
                clock,
                line: line.clone(),
                theta_c,
                phi_s,
            }),
        })
    }

    fn axis(&self, axis: AxisName) -> &Axis {
        match axis {
            AxisName::ThetaC => &self.inner.theta_c,
            AxisName::PhiS => &self.inner.phi_s,
        }
    }

    /// Reads the state of both axes, also while another clone moves them.
    ///
    /// # Errors
    /// [`StageError`] if a device does not answer.
    pub async fn status(&self) -> Result<StageStatus, StageError> {
        let read = async |axis: &Axis| -> Result<AxisStatus, StageError> {
            let reading = axis.read().await?;
            let flags = match reading.flag {
                Some(_) => axis.flags().await?,
                None => Vec::new(),
            };
            Ok(AxisStatus {
                position: axis.recorded(reading.counts),
                moving: reading.activity == Activity::Busy,
                homed: !flags.iter().any(|f| f.class() == FlagClass::ReferenceLost),
                warnings: flags.iter().map(flag_text).collect(),
                flags,
                serial: axis.identity.serial,
            })
        };
        Ok(StageStatus {
            theta_c: read(&self.inner.theta_c).await?,
            phi_s: read(&self.inner.phi_s).await?,
        })
    }

    /// Makes an axis ready to move: enables its motor driver if its flags show that it is off
    /// (emergency stop, power failure), and unparks it. Moves nothing. Call this only at an
    /// operator's request: a driver that is off, or a parked axis, may protect a person's hands.
    ///
    /// # Errors
    /// [`StageError::Refused`] while the cause persists, or if the device does not answer.
    pub async fn release(&self, axis: AxisName) -> Result<(), StageError> {
        self.axis(axis).release().await
    }

    /// Unparks an axis; it keeps its position. Moves nothing.
    ///
    /// # Errors
    /// [`StageError`] if the device refuses or does not answer.
    pub async fn unpark(&self, axis: AxisName) -> Result<(), StageError> {
        self.axis(axis).unpark().await
    }

    /// Homes an axis. It moves to the end of its travel.
    ///
    /// # Errors
    /// [`StageError`]; both axes have then been stopped as far as they can be reached.
    pub async fn home(&self, axis: AxisName) -> Result<(), StageError> {
        self.home_since(axis, self.stops()).await
    }

    /// Homes an axis, unless there has been a stop since [`Stage::stops`] returned `stops`.
    ///
    /// # Errors
    /// As [`Stage::home`]; [`StageError::Stopped`] without motion if there was a stop.
    pub async fn home_since(&self, axis: AxisName, stops: u64) -> Result<(), StageError> {
        let outcome = self.axis(axis).home(stops).await;
        self.or_stop(outcome).await
    }

    /// Homes both axes concurrently.
    ///
    /// # Errors
    /// As [`Stage::home`].
    pub async fn home_all(&self) -> Result<(), StageError> {
        self.home_all_since(self.stops()).await
    }

    /// Homes both axes, unless there has been a stop since [`Stage::stops`] returned `stops`.
    ///
    /// # Errors
    /// As [`Stage::home_since`].
    pub async fn home_all_since(&self, stops: u64) -> Result<(), StageError> {
        let (tilt, turn) = (&self.inner.theta_c, &self.inner.phi_s);
        let outcome = futures::try_join!(tilt.home(stops), turn.home(stops)).map(|_| ());
        self.or_stop(outcome).await
    }

    /// Moves one axis to a recorded angle, waits for it to settle, and returns the angle read back.
    ///
    /// # Errors
    /// [`StageError`]; both axes have then been stopped as far as they can be reached.
    pub async fn move_to(&self, axis: AxisName, target: Angle) -> Result<Angle, StageError> {
        self.move_since(axis, target, self.stops()).await
    }

    /// As [`Stage::move_to`], unless there has been a stop since [`Stage::stops`] returned `stops`.
    ///
    /// # Errors
    /// As [`Stage::move_to`]; [`StageError::Stopped`] if there was a stop.
    pub async fn move_since(
        &self,
        axis: AxisName,
        target: Angle,
        stops: u64,
    ) -> Result<Angle, StageError> {
        self.inner.settings.check_limit(axis, target)?;
        let outcome = async {
            let (angle, moved) = self.axis(axis).move_to(target, stops).await?;
            let settle_ms = self.inner.settings.axis(axis).settle_ms;
            self.settle(if moved { settle_ms } else { 0 }, stops)
                .await?;
            Ok(angle)
        }
        .await;
        self.or_stop(outcome).await
    }

    /// Moves both axes concurrently, waits for them to settle, and returns the pose read back.
    ///
    /// # Errors
    /// [`StageError`]; both axes have then been stopped as far as they can be reached.
    pub async fn move_pose(&self, target: Pose) -> Result<Pose, StageError> {
        self.inner.settings.check_limits(target)?;
        let stops = self.stops();
        let (tilt, turn) = (&self.inner.theta_c, &self.inner.phi_s);
        let outcome = async {
            let ((theta_c, tilted), (phi_s, turned)) = futures::try_join!(
                tilt.move_to(target.theta_c, stops),
                turn.move_to(target.phi_s, stops)
            )?;
            let settle_ms = [(tilt, tilted), (turn, turned)]
                .into_iter()
                .map(|(axis, moved)| if moved { axis.settings.settle_ms } else { 0 })
                .max();
            self.settle(settle_ms.unwrap_or(0), stops).await?;
            debug!("stage at theta_c = {theta_c:.4}, phi_s = {phi_s:.4}");
            Ok(Pose { theta_c, phi_s })
        }
        .await;
        self.or_stop(outcome).await
    }

    async fn settle(&self, settle_ms: u64, stops: u64) -> Result<(), StageError> {
        if settle_ms == 0 {
            return Ok(());
        }
        let settle = self.inner.clock.sleep(Duration::from_millis(settle_ms));
        tokio::select! {
            biased;
            () = self.inner.line.stopped_since(stops) => Err(StageError::Stopped),
            () = settle => Ok(()),
        }
    }

    /// Closes the port for all clones: what they still wait for, and all that they ask later, fails
    /// with [`StageError::Disconnected`]. Stops nothing.
    pub fn close(&self) {
        self.inner.line.close();
    }

    /// Whether the port is closed: by [`Stage::close`], or because the connection was lost.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.inner.line.is_closed()
    }

    /// Completes when the port of a closed stage may be opened again.
    pub async fn closed(&self) {
        self.inner.line.closed().await;
    }

    /// Number of stops so far, for a motion that starts later than it was requested.
    #[must_use]
    pub fn stops(&self) -> u64 {
        self.inner.line.stops()
    }

    /// Stops both axes before all waiting commands, and waits until they are at rest. Never
    /// refused; a move in progress ends with [`StageError::Stopped`].
    ///
    /// # Errors
    /// [`StageError`] if a device does not answer, or does not come to rest.
    pub async fn stop(&self) -> Result<(), StageError> {
        let addresses = self.inner.settings.addresses();
        let heard = self.inner.line.stop(&addresses).await;
        // Wait even if one axis did not answer: the other one may still come to rest.
        let rest = futures::join!(
            self.inner.theta_c.await_rest(),
            self.inner.phi_s.await_rest()
        );
        heard?;
        rest.0?;
        rest.1
    }

    /// If an operation on one axis fails, stops the other axis too.
    async fn or_stop<T>(&self, outcome: Result<T, StageError>) -> Result<T, StageError> {
        if let Err(error) = &outcome {
            let nothing_moves = matches!(
                error,
                StageError::Stopped | StageError::Disconnected(_) | StageError::Busy { .. }
            );
            if !nothing_moves && let Err(second) = self.stop().await {
                warn!("after the error \"{error}\" the stage could not be stopped: {second}");
            }
        }
        outcome
    }

    /// Checks a pose against the limits.
    ///
    /// # Errors
    /// [`StageError::OutsideLimits`], or [`StageError::NotANumber`].
    pub fn check_limits(&self, pose: Pose) -> Result<(), StageError> {
        self.inner.settings.check_limits(pose)
    }

    /// Predicts the duration of a move with the speeds read from the devices, including backlash
    /// detours and settling.
    #[must_use]
    pub fn predicted_move(&self, from: Pose, to: Pose) -> Duration {
        self.move_times().predict(from, to)
    }

    /// Returns what predicts the moves of this stage. It holds no link.
    #[must_use]
    pub fn move_times(&self) -> MoveTimes {
        MoveTimes {
            settings: self.inner.settings.clone(),
            theta_c: self.inner.theta_c.rates,
            phi_s: self.inner.phi_s.rates,
        }
    }

    /// The settings used for the connection.
    #[must_use]
    pub fn settings(&self) -> &StageSettings {
        &self.inner.settings
    }

    /// The port's address.
    #[must_use]
    pub fn address(&self) -> &PortAddress {
        &self.inner.address
    }

    /// The devices found.
    #[must_use]
    pub fn identity(&self) -> StageIdentity {
        let of = |axis: &Axis| DeviceIdentity {
            serial: axis.identity.serial,
            device_id: axis.identity.device_id,
            firmware: axis.identity.firmware.clone(),
        };
        StageIdentity {
            theta_c: of(&self.inner.theta_c),
            phi_s: of(&self.inner.phi_s),
        }
    }
}

fn flag_text(flag: &Flag) -> String {
    format!("{flag}: {}", flag.meaning())
}

/// Refuses two devices with one address, which would both execute every command.
async fn find_conflicts(line: &PortLine) -> Result<(), StageError> {
    let mut serials: BTreeMap<u8, String> = BTreeMap::new();
    for reply in line.ask_everyone("get system.serial").await? {
        let other = serials.insert(reply.address, reply.data.clone());
        if other.is_some_and(|serial| serial != reply.data) {
            let address = reply.address;
            return Err(StageError::AddressConflict { address });
        }
    }
    Ok(())
}

/// Enables checksums on every reply and disables alerts, which would only fill the line.
async fn set_up_line(line: &PortLine, axes: [&Axis; 2]) -> Result<(), StageError> {
    let mut all_checked = true;
    for axis in axes {
        for setting in ["comm.checksum 1", "comm.alert 0"] {
            match axis.ask_controller(&format!("set {setting}")).await {
                Ok(_) => {}
                // Older firmware lacks this setting.
                Err(StageError::Refused { .. }) => all_checked &= !setting.contains("checksum"),
                Err(error) => return Err(error),
            }
        }
        if all_checked {
            let reply = axis.ask_controller("get comm.checksum").await?;
            all_checked = reply.data == "1";
        }
    }
    if all_checked {
        line.require_checksums();
    }
    Ok(())
}
