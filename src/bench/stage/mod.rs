//! The stage: two axes on one line, addressed in recorded angles.
//!
//! [`Stage::connect`] opens the port and verifies the devices; [`Stage::move_pose`] is the function
//! that a scan calls. A move has succeeded only when the position read back is within tolerance. A
//! stop is never refused: it is sent before all waiting commands, and commands issued before it are
//! not sent after it. Knows no scan, camera or sample. The head of `axis.rs` draws the states of an
//! axis. The files of `axis/`, `error.rs` and `port_search.rs` speak Zaber ASCII ([`super::wire::zaber`]); another
//! protocol is translated below the line.

mod axis;
mod connect;
mod error;
mod homing_order;
mod identity;
mod jog;
mod line_watch;
mod motions;
mod notice;
mod port_search;
mod prediction;
mod regions;
mod settings;
mod status;
mod ways;

use std::sync::Arc;
use std::time::Duration;

pub use self::connect::{OpenLine, StageLink};
pub use self::error::StageError;
pub use self::homing_order::{HomingOrder, HomingSettings};
pub use self::identity::{DeviceIdentity, OtherStages, StageIdentity};
pub use self::jog::JogOrder;
pub use self::notice::{Notices, StageNotice};
pub use self::prediction::MoveTimes;
pub use self::regions::{Forbidden, ForbiddenRegion};
pub use self::settings::{AxisSettings, StageSettings};
pub use self::status::{AxisStatus, StageStatus};
pub use super::AxisName;
pub use super::port::{NoFaults, PortAddress, PortSeam};
pub use super::wire::zaber_flags::{Flag, FlagClass};

use self::axis::Axis;
use self::line_watch::LineWatch;
use super::line::PortLine;
use super::wire::zaber::Activity;
use crate::clock::Clock;
use crate::geometry::Pose;

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
    watch: LineWatch,
    theta_c: Axis,
    phi_s: Axis,
}

impl Stage {
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
        self.inner.watch.report_foreign_traffic(&self.inner.line);
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
                warnings: {
                    let news = flags.iter().filter(|flag| axis.is_news(**flag));
                    news.map(flag_text).collect()
                },
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

    /// The error of everything that is asked of a closed stage.
    #[must_use]
    pub fn loss(&self) -> StageError {
        self.inner.line.loss().into()
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
        let (replies, failure) = self.inner.line.stop_each(&addresses).await;
        // An axis whose controller did not answer gives no answer about its rest; the other one may still come to rest.
        let rest = async |axis: &Axis| match replies
            .iter()
            .any(|reply| reply.address == axis.settings.address)
        {
            true => axis.await_rest().await,
            false => Ok(()),
        };
        let (theta_c, phi_s) = futures::join!(rest(&self.inner.theta_c), rest(&self.inner.phi_s));
        match failure {
            Some(error) => Err(error.into()),
            None => theta_c.and(phi_s),
        }
    }

    /// Waits until both axes are at rest after a stop.
    ///
    /// # Errors
    /// [`StageError`] if a device does not answer, or does not come to rest.
    pub async fn at_rest(&self) -> Result<(), StageError> {
        let (theta_c, phi_s) = futures::join!(
            self.inner.theta_c.await_rest(),
            self.inner.phi_s.await_rest()
        );
        theta_c.and(phi_s)
    }

    /// Takes over what the last connection knew of devices that kept their reference: how their encoders stood to their
    /// counters.
    pub fn carry_on(&self, last: &Stage) {
        self.inner.theta_c.carry_on(&last.inner.theta_c);
        self.inner.phi_s.carry_on(&last.inner.phi_s);
    }

    /// Checks both axes at rest for a slip since they were homed, by their encoders: the counter
    /// does not show a slip. Finds nothing on a device without an encoder.
    ///
    /// # Errors
    /// [`StageError::Slipped`], or a device that does not answer.
    pub async fn check_slip(&self) -> Result<(), StageError> {
        self.inner.theta_c.check_slip().await?;
        self.inner.phi_s.check_slip().await
    }

    /// Whether both axes have an encoder, so that a slip shows after the move.
    #[must_use]
    pub fn shows_slips(&self) -> bool {
        self.inner.theta_c.has_encoder() && self.inner.phi_s.has_encoder()
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
        StageIdentity {
            theta_c: self.inner.theta_c.identity.clone(),
            phi_s: self.inner.phi_s.identity.clone(),
        }
    }
}

fn flag_text(flag: &Flag) -> String {
    format!("{flag}: {}", flag.meaning())
}
