//! Connecting a stage: opens the port, stops all motion, verifies the controllers, applies the settings.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Duration;

use tracing::info;

use super::axis::Axis;
use super::error::StageError;
use super::identity::{OtherStages, StageIdentity};
use super::line_watch::LineWatch;
use super::notice::Notices;
use super::port_search;
use super::settings::StageSettings;
use super::{Inner, Stage};
use crate::bench::AxisName;
use crate::bench::line::{LineSettings, PortLine};
use crate::bench::port::{PortAddress, PortSeam};
use crate::clock::Clock;

/// Address and settings of the stages.
#[derive(Clone)]
pub struct StageLink {
    /// Serial port or TCP address.
    pub port: PortAddress,
    /// Limits, backlash, speeds.
    pub settings: StageSettings,
    /// Time for waits and deadlines.
    pub clock: Arc<dyn Clock>,
    /// Injects faults into the port, in tests.
    pub seam: Arc<dyn PortSeam>,
}

/// A line whose devices are not verified yet: it can only be stopped.
#[derive(Clone)]
pub struct OpenLine {
    line: PortLine,
    addresses: Vec<u8>,
}

impl OpenLine {
    /// Stops both axes before all waiting commands.
    ///
    /// # Errors
    /// [`StageError`] if a device does not answer.
    pub async fn stop(&self) -> Result<(), StageError> {
        self.line.stop(&self.addresses).await?;
        Ok(())
    }
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
        let link = StageLink {
            port,
            settings,
            clock,
            seam,
        };
        Stage::connect_known(&link, None, &Notices::default()).await
    }

    /// As [`Stage::connect`], but refuses controllers other than `expected`; a serial number in the
    /// settings wins over the expected one. What a person should learn goes to `notices`.
    ///
    /// # Errors
    /// As [`Stage::connect`]; [`StageError::OtherStages`] for other controllers.
    pub async fn connect_known(
        link: &StageLink,
        expected: Option<&StageIdentity>,
        notices: &Notices,
    ) -> Result<Stage, StageError> {
        Stage::connect_stoppable(link, expected, notices, |_| {}).await
    }

    /// As [`Stage::connect_known`]; `opened` gets the line while the devices are still being verified.
    ///
    /// # Errors
    /// As [`Stage::connect_known`].
    pub async fn connect_stoppable(
        link: &StageLink,
        expected: Option<&StageIdentity>,
        notices: &Notices,
        opened: impl FnOnce(OpenLine),
    ) -> Result<Stage, StageError> {
        link.settings.validate()?;
        let line_settings = LineSettings {
            reply_timeout: Duration::from_millis(link.settings.reply_timeout_ms),
            attempts: link.settings.attempts,
        };
        let (address, baud) = (link.port.clone(), link.settings.baud);
        let seam = Arc::clone(&link.seam);
        // Opening can take seconds: a TCP connection, or a port that has just been plugged in.
        let line = tokio::task::spawn_blocking(move || {
            PortLine::open(&address, baud, line_settings, seam.as_ref())
        })
        .await
        .expect("opening a port does not panic")?;
        opened(OpenLine {
            line: line.clone(),
            addresses: link.settings.addresses(),
        });
        let connected = Stage::take_over(&line, link, expected, notices).await;
        if connected.is_err() {
            line.close();
            line.closed().await;
        }
        connected
    }

    /// Returns another port on which the controllers of this rig answer; `None` if their serial
    /// numbers are unknown, or no port has them.
    pub async fn find_elsewhere(
        link: &StageLink,
        expected: Option<&StageIdentity>,
    ) -> Option<PortAddress> {
        let serial = |axis: AxisName| {
            let stated = link.settings.axis(axis).serial;
            stated.or_else(|| Some(expected?.axis(axis).serial))
        };
        let serials = [serial(AxisName::ThetaC)?, serial(AxisName::PhiS)?];
        port_search::find(&link.port, &link.settings, serials, &link.seam).await
    }

    /// Stops what moves on an open line, verifies the devices and applies the settings.
    async fn take_over(
        line: &PortLine,
        link: &StageLink,
        expected: Option<&StageIdentity>,
        notices: &Notices,
    ) -> Result<Stage, StageError> {
        let StageLink {
            port,
            settings,
            clock,
            ..
        } = link;
        // A program that died may have left a move running that this session did not request.
        line.stop(&settings.addresses()).await?;
        find_conflicts(line).await?;
        let identify = |name: AxisName| {
            let settings = settings.axis(name).clone();
            Axis::identify(
                name,
                settings,
                line.clone(),
                Arc::clone(clock),
                notices.clone(),
            )
        };
        let mut theta_c = identify(AxisName::ThetaC).await?;
        let mut phi_s = identify(AxisName::PhiS).await?;
        check_identity([&theta_c, &phi_s], expected)?;
        let mut all_checked = true;
        for axis in [&mut theta_c, &mut phi_s] {
            axis.set_up().await?;
            all_checked &= axis.set_up_line().await?;
        }
        if all_checked {
            line.require_checksums();
        }
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
                address: port.clone(),
                settings: settings.clone(),
                clock: Arc::clone(clock),
                line: line.clone(),
                watch: LineWatch::new(notices.clone()),
                theta_c,
                phi_s,
            }),
        })
    }
}

/// Refuses controllers other than those of the settings, and others than the expected ones where
/// the settings state no serial number.
fn check_identity(axes: [&Axis; 2], expected: Option<&StageIdentity>) -> Result<(), StageError> {
    for axis in axes {
        axis.check_serial()?;
    }
    let [theta_c, phi_s] = axes;
    let found = StageIdentity {
        theta_c: theta_c.identity.clone(),
        phi_s: phi_s.identity.clone(),
    };
    let Some(expected) = expected else {
        return Ok(());
    };
    let is_other = |axis: &Axis| {
        axis.settings.serial.is_none() && !expected.axis(axis.name).is_same_device(&axis.identity)
    };
    match axes.into_iter().any(is_other) {
        true => Err(StageError::OtherStages(Box::new(OtherStages {
            expected: expected.clone(),
            found,
        }))),
        false => Ok(()),
    }
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
