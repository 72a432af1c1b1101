//! The way to the stages that everybody has: to ask where they are, and to stop them.
//!
//! [`Reach::stop`] is the one function to call when something shall stand still: it stops the
//! connected stage, and connects first where the link is lost or was never there. Moves nothing.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

use tokio::sync::{Mutex, watch};

use crate::bench::port::{PortError, PortSeam};
use crate::bench::stage::{PortAddress, Stage, StageError, StageSettings};
use crate::clock::{Clock, SystemClock};

/// How often, and how long apart, a port that is in use is asked for again: in real time, in which ports close whatever
/// the rig's clock says.
const CLOSING_TRIES: u32 = 20;
const CLOSING_WAIT: Duration = Duration::from_millis(50);

/// How to reach the stages.
#[derive(Clone)]
pub struct StageLink {
    /// Serial port or TCP address.
    pub port: PortAddress,
    /// Limits, backlash, speeds.
    pub settings: StageSettings,
    /// Time for waits and deadlines.
    pub clock: Arc<dyn Clock>,
    /// Where faults can be put into the port.
    pub seam: Arc<dyn PortSeam>,
}

/// One link to the stages, shared by who moves them and who stops them; cheap to clone.
#[derive(Clone)]
pub struct Reach {
    inner: Arc<Inner>,
}

struct Inner {
    link: StageLink,
    stage: watch::Sender<Option<Stage>>,
    /// A port has one owner: whoever opens it does so alone.
    opening: Mutex<()>,
    /// How often the stages were told to stop. What was asked for before does not begin after.
    stops: AtomicU64,
    was_connected: AtomicBool,
}

impl Reach {
    pub(super) fn new(link: StageLink) -> Self {
        Reach {
            inner: Arc::new(Inner {
                link,
                stage: watch::Sender::new(None),
                opening: Mutex::new(()),
                stops: AtomicU64::new(0),
                was_connected: AtomicBool::new(false),
            }),
        }
    }

    /// How the stages are reached.
    #[must_use]
    pub fn link(&self) -> &StageLink {
        &self.inner.link
    }

    /// The connected stage, as it comes and goes.
    #[must_use]
    pub fn watch(&self) -> watch::Receiver<Option<Stage>> {
        self.inner.stage.subscribe()
    }

    fn stage(&self) -> Option<Stage> {
        self.inner.stage.borrow().clone()
    }

    /// How often the stages were told to stop.
    #[must_use]
    pub fn stops(&self) -> u64 {
        self.inner.stops.load(Ordering::SeqCst)
    }

    /// Whether there was a link and it is gone: what moved then may move still.
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
                // Who let go of a link a moment ago still closes its port: only what stays so is another program.
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

    /// Stops both axes at once, whoever moves them, and waits until they stand.
    ///
    /// # Errors
    /// [`StageError`] if they could not be reached: they may be moving.
    pub async fn stop(&self) -> Result<(), StageError> {
        // Before the stages hear of it: who begins a motion looks at this last.
        self.inner.stops.fetch_add(1, Ordering::SeqCst);
        if let Some(stage) = self.stage() {
            match stage.stop().await {
                // Its port is closed; the axes go on with what they were told last.
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
        // Somebody else may have been the one who connected, and gone on to move.
        stage.stop().await
    }

    /// The same where there ever was a link: what moved when it was lost may move still, and a port that was never
    /// opened is left alone. Tells the log what it does not reach.
    ///
    /// # Errors
    /// As [`Reach::stop`].
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
