//! Shared access to the stages: reads positions and stops motion, and never moves anything.
//!
//! [`StageAccess::stop`] stops the connected stage. It connects first if the link is lost or was never opened.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use tokio::sync::{Mutex, watch};

use crate::bench::port::{PortError, PortSeam};
use crate::bench::stage::{PortAddress, Stage, StageError, StageSettings};
use crate::clock::{Clock, SystemClock};

/// Attempts to open a port that is in use, and the time between them. Ports close in real time, independent of the rig's
/// clock.
const CLOSING_TRIES: u32 = 20;
const CLOSING_WAIT: Duration = Duration::from_millis(50);

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

/// The link to the stages, shared by the runner and all clients that may stop them; cheap to clone.
#[derive(Clone)]
pub struct StageAccess {
    inner: Arc<Inner>,
}

struct Inner {
    link: StageLink,
    stage: watch::Sender<Option<Stage>>,
    /// Held while the port is opened: it has one owner.
    opening: Mutex<()>,
    /// Number of stops so far. A motion requested before a stop does not start after it.
    stops: AtomicU64,
    was_connected: AtomicBool,
}

impl StageAccess {
    pub(super) fn new(link: StageLink) -> Self {
        StageAccess {
            inner: Arc::new(Inner {
                link,
                stage: watch::Sender::new(None),
                opening: Mutex::new(()),
                stops: AtomicU64::new(0),
                was_connected: AtomicBool::new(false),
            }),
        }
    }

    /// Returns the address and settings of the stages.
    #[must_use]
    pub fn link(&self) -> &StageLink {
        &self.inner.link
    }

    /// Watches the connected stage.
    #[must_use]
    pub fn watch(&self) -> watch::Receiver<Option<Stage>> {
        self.inner.stage.subscribe()
    }

    fn stage(&self) -> Option<Stage> {
        self.inner.stage.borrow().clone()
    }

    /// Returns the number of stops so far.
    #[must_use]
    pub fn stops(&self) -> u64 {
        self.inner.stops.load(Ordering::SeqCst)
    }

    /// Returns whether a link was lost. An axis that moved then may still move.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.inner.was_connected.load(Ordering::SeqCst) && self.inner.stage.borrow().is_none()
    }

    pub(super) async fn connect(&self) -> Result<Stage, StageError> {
        if let Some(stage) = self.stage() {
            return Ok(stage);
        }
        let _alone = self.inner.opening.lock().await;
        if let Some(stage) = self.stage() {
            return Ok(stage);
        }
        let StageLink {
            port,
            settings,
            clock,
            seam,
        } = self.inner.link.clone();
        let mut tries = 0;
        let stage = loop {
            let (port, seam) = (port.clone(), Arc::clone(&seam));
            let connecting = Stage::connect(port, settings.clone(), Arc::clone(&clock), seam);
            match connecting.await {
                // A link that was just dropped is still closing its port; only a port that stays in use belongs to another
                // program.
                Err(StageError::Port(PortError::InUse { .. })) if tries < CLOSING_TRIES => {
                    tries += 1;
                    SystemClock::new().sleep(CLOSING_WAIT).await;
                }
                other => break other?,
            }
        };
        self.inner.was_connected.store(true, Ordering::SeqCst);
        self.inner.stage.send_replace(Some(stage.clone()));
        Ok(stage)
    }

    pub(super) fn let_go(&self) {
        self.inner.stage.send_replace(None);
    }

    /// Stops both axes at once and waits until they stand still.
    ///
    /// # Errors
    /// [`StageError`] if the stages could not be reached: they may be moving.
    pub async fn stop(&self) -> Result<(), StageError> {
        // Before the stop is sent: a motion checks this count last.
        self.inner.stops.fetch_add(1, Ordering::SeqCst);
        if let Some(stage) = self.stage() {
            match stage.stop().await {
                // The port is closed; the axes continue their last motion.
                Err(StageError::Disconnected(_)) => {
                    self.inner.stage.send_if_modified(|now| {
                        let same = now.as_ref().is_some_and(|now| now.is_same(&stage));
                        if same {
                            *now = None;
                        }
                        same
                    });
                }
                other => return other,
            }
        }
        // Connecting stops what moves before it asks for anything.
        let stage = self.connect().await?;
        // Another task may have connected and started a motion.
        stage.stop().await
    }

    /// Stops the stages if a link is open or was lost; leaves a port alone that was never opened. Logs a failure.
    ///
    /// # Errors
    /// As [`StageAccess::stop`].
    pub async fn stop_what_may_move(&self) -> Result<(), StageError> {
        if self.stage().is_none() && !self.is_lost() {
            return Ok(());
        }
        match self.stop().await {
            Ok(()) | Err(StageError::Stopped) => Ok(()),
            Err(error) => {
                tracing::error!(%error, "the stages could not be stopped: {error}; look at the rig");
                Err(error)
            }
        }
    }
}
