//! Shared access to the stages: reads positions and stops motion, and never moves anything.
//!
//! The link is owned here. [`StageAccess::let_go`] closes it for every handle, wherever it is held, and connecting waits
//! until the port of the last link is closed. So the daemon never finds a port in use by itself.
//! [`StageAccess::stop`] stops the connected stage. It connects first if the link is lost or was never opened. A stop that is not
//! confirmed stands: it is sent again until the stages confirm it, or until a person requests motion.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::{Duration, Instant};

use crate::bench::port::PortAddress;
use crate::bench::stage::{Notices, OpenLine, Stage, StageError, StageIdentity, StageLink};

/// Time between two attempts at a stop that is not confirmed. In real time, as the port answers.
const STOP_AGAIN_AFTER: Duration = Duration::from_millis(500);

/// The link to the stages, shared by the runner and all clients that may stop them; cheap to clone.
#[derive(Clone)]
pub struct StageAccess {
    inner: Arc<Inner>,
}

struct Inner {
    link: StageLink,
    /// The last link, which may be closed; `None` before the first.
    last: Mutex<Option<Stage>>,
    /// Held while the port is opened: it has one owner.
    opening: tokio::sync::Mutex<()>,
    /// The line of the stages that are being connected.
    connecting: Mutex<Option<OpenLine>>,
    /// Number of stops so far. A motion requested before a stop does not start after it.
    stops: AtomicU64,
    /// Whether the daemon may move the axes by itself: a person has requested motion, and since then neither a person nor a
    /// fault of the stages has stopped them.
    may_move_unasked: AtomicBool,
    /// Whether an axis may have slipped since both were homed: a scan began, and nothing confirmed its points. Only matters for
    /// axes without an encoder.
    may_have_slipped: AtomicBool,
    /// Number of motions that a person has requested so far.
    motions_requested: AtomicU64,
    /// The number of requested motions at the stop that stands; `None` while none does.
    standing_stop: Mutex<Option<u64>>,
    /// Where the controllers answered last, if not on the port of the settings.
    found_on: Mutex<Option<PortAddress>>,
    controllers: Mutex<Controllers>,
    notices: Notices,
}

/// The controllers of the rig.
#[derive(Default)]
struct Controllers {
    /// Those that may be connected; any before the first connection.
    expected: Option<StageIdentity>,
    /// Those that were refused at the last attempt.
    refused: Option<StageIdentity>,
}

impl StageAccess {
    pub(super) fn new(link: StageLink) -> Self {
        StageAccess {
            inner: Arc::new(Inner {
                link,
                last: Mutex::new(None),
                opening: tokio::sync::Mutex::new(()),
                connecting: Mutex::default(),
                stops: AtomicU64::new(0),
                may_move_unasked: AtomicBool::new(false),
                may_have_slipped: AtomicBool::new(true),
                motions_requested: AtomicU64::new(0),
                standing_stop: Mutex::default(),
                found_on: Mutex::default(),
                controllers: Mutex::default(),
                notices: Notices::default(),
            }),
        }
    }

    /// Returns the address and settings of the stages.
    #[must_use]
    pub fn link(&self) -> &StageLink {
        &self.inner.link
    }

    /// Returns the connected stage.
    #[must_use]
    pub fn stage(&self) -> Option<Stage> {
        self.last().clone().filter(|stage| !stage.is_closed())
    }

    fn last(&self) -> MutexGuard<'_, Option<Stage>> {
        let last = &self.inner.last;
        last.lock().expect("no holder of this lock panics")
    }

    /// Returns the number of stops so far.
    #[must_use]
    pub fn stops(&self) -> u64 {
        self.inner.stops.load(Ordering::SeqCst)
    }

    /// Returns whether the daemon may move the axes by itself, as for parking: a person has requested motion, and since then
    /// neither a person nor a fault of the stages has stopped them.
    #[must_use]
    pub fn may_move_unasked(&self) -> bool {
        self.inner.may_move_unasked.load(Ordering::SeqCst)
    }

    /// A person has requested motion. A stop that stands ends.
    pub fn allow_unasked_motion(&self) {
        self.inner.motions_requested.fetch_add(1, Ordering::SeqCst);
        self.inner.may_move_unasked.store(true, Ordering::SeqCst);
    }

    /// A person or a fault of the stages has stopped the axes.
    pub fn forbid_unasked_motion(&self) {
        self.inner.may_move_unasked.store(false, Ordering::SeqCst);
    }

    /// Returns whether an axis without an encoder may have slipped since both were homed.
    pub(super) fn may_have_slipped(&self) -> bool {
        self.inner.may_have_slipped.load(Ordering::SeqCst)
    }

    /// Notes that both axes are where their counters say, or may no longer be there.
    pub(super) fn set_may_have_slipped(&self, may: bool) {
        self.inner.may_have_slipped.store(may, Ordering::SeqCst);
    }

    /// Returns whether a link was lost. An axis that moved then may still move.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.last().as_ref().is_some_and(Stage::is_closed)
    }

    /// Returns why the last link was lost; `None` while it is open, and before the first.
    #[must_use]
    pub fn loss(&self) -> Option<StageError> {
        self.last()
            .as_ref()
            .filter(|stage| stage.is_closed())
            .map(Stage::loss)
    }

    pub(super) async fn connect(&self) -> Result<Stage, StageError> {
        if let Some(stage) = self.stage() {
            return Ok(stage);
        }
        // On its own task: a caller that gives up in the middle would leave the port open.
        let opening = tokio::spawn(self.clone().open());
        match opening.await {
            Ok(opened) => opened,
            Err(broken) => std::panic::resume_unwind(broken.into_panic()),
        }
    }

    async fn open(self) -> Result<Stage, StageError> {
        let _alone = self.inner.opening.lock().await;
        if let Some(stage) = self.stage() {
            return Ok(stage);
        }
        let last = self.last().clone();
        if let Some(last) = &last {
            last.closed().await;
        }
        let stage = self.open_somewhere().await?;
        if let Some(last) = &last {
            stage.carry_on(last);
        }
        {
            let mut controllers = self.controllers();
            controllers.expected.get_or_insert_with(|| stage.identity());
            controllers.refused = None;
        }
        *self.last() = Some(stage.clone());
        Ok(stage)
    }

    /// Opens the port where the controllers were found last, else the named one, else the port on which they answer.
    async fn open_somewhere(&self) -> Result<Stage, StageError> {
        let named = &self.inner.link;
        let expected = self.controllers().expected.clone();
        let connect = async |port: PortAddress| {
            let link = StageLink {
                port,
                ..named.clone()
            };
            let notices = &self.inner.notices;
            let opened = |line| *self.connecting() = Some(line);
            let connected =
                Stage::connect_stoppable(&link, expected.as_ref(), notices, opened).await;
            *self.connecting() = None;
            connected
        };
        let elsewhere = self.found_on().clone();
        if let Some(port) = elsewhere
            && let Ok(stage) = connect(port).await
        {
            return Ok(stage);
        }
        let error = match connect(named.port.clone()).await {
            Ok(stage) => {
                *self.found_on() = None;
                return Ok(stage);
            }
            Err(error) => error,
        };
        self.controllers().refused = match &error {
            StageError::OtherStages(other) => Some(other.found.clone()),
            _ => None,
        };
        if !error.may_be_elsewhere() {
            return Err(error);
        }
        let Some(port) = Stage::find_elsewhere(named, expected.as_ref()).await else {
            return Err(error);
        };
        let Ok(stage) = connect(port.clone()).await else {
            return Err(error);
        };
        self.inner.notices.port_changed(&named.port, &port);
        *self.found_on() = Some(port);
        Ok(stage)
    }

    fn connecting(&self) -> MutexGuard<'_, Option<OpenLine>> {
        let connecting = &self.inner.connecting;
        connecting.lock().expect("no holder of this lock panics")
    }

    fn found_on(&self) -> MutexGuard<'_, Option<PortAddress>> {
        let found_on = &self.inner.found_on;
        found_on.lock().expect("no holder of this lock panics")
    }

    fn controllers(&self) -> MutexGuard<'_, Controllers> {
        let controllers = &self.inner.controllers;
        controllers.lock().expect("no holder of this lock panics")
    }

    /// Sets the controllers that may be connected from now on; `None` accepts those that answer first.
    pub fn expect(&self, controllers: Option<StageIdentity>) {
        *self.controllers() = Controllers {
            expected: controllers,
            refused: None,
        };
    }

    /// Returns the controllers that were refused at the last attempt to connect.
    #[must_use]
    pub fn refused(&self) -> Option<StageIdentity> {
        self.controllers().refused.clone()
    }

    /// Returns what reports what a person should learn of the stages.
    #[must_use]
    pub fn notices(&self) -> &Notices {
        &self.inner.notices
    }

    /// Closes the link for all handles.
    pub(super) fn let_go(&self) {
        if let Some(stage) = &*self.last() {
            stage.close();
        }
    }

    /// Stops both axes at once and waits until they stand still. A stop that fails stands: it is sent again in the background.
    ///
    /// # Errors
    /// [`StageError`] if the stages could not be reached: they may be moving.
    pub async fn stop(&self) -> Result<(), StageError> {
        let requested = self.motions_requested();
        // Before the stop is sent: a motion checks this count last.
        self.inner.stops.fetch_add(1, Ordering::SeqCst);
        let stopped = self.stop_once().await;
        if stopped.is_err() {
            self.stand(requested);
        }
        stopped
    }

    fn motions_requested(&self) -> u64 {
        self.inner.motions_requested.load(Ordering::SeqCst)
    }

    fn standing_stop(&self) -> MutexGuard<'_, Option<u64>> {
        let standing = &self.inner.standing_stop;
        standing.lock().expect("no holder of this lock panics")
    }

    /// Lets a stop that was not confirmed stand, unless a person has requested motion since then.
    fn stand(&self, requested: u64) {
        let was_standing = self.standing_stop().replace(requested).is_some();
        if !was_standing {
            tokio::spawn(self.clone().repeat_stop());
        }
    }

    /// Stops what a scan has cut short. A stop that fails stands, and is in the log.
    pub(super) async fn stop_connected(&self) {
        let requested = self.motions_requested();
        if let Some(stage) = self.stage()
            && let Err(error) = stage.stop().await
        {
            tracing::error!(%error, "the stop of a scan did not reach the stage: {error}");
            self.stand(requested);
        }
    }

    /// Sends the stop that stands until it is confirmed, or until a person requests motion.
    async fn repeat_stop(self) {
        loop {
            tokio::time::sleep(STOP_AGAIN_AFTER).await;
            {
                let mut standing = self.standing_stop();
                if *standing != Some(self.motions_requested()) {
                    *standing = None;
                    return;
                }
            }
            if self.stop_once().await.is_ok() {
                *self.standing_stop() = None;
                tracing::warn!("the stop that had failed has reached the stages; they are at rest");
                return;
            }
        }
    }

    async fn stop_once(&self) -> Result<(), StageError> {
        if let Some(stage) = self.stage() {
            match stage.stop().await {
                // The port is closed; the axes continue their last motion.
                Err(StageError::Disconnected(_)) => {}
                other => return other,
            }
        }
        // Connecting stops what moves before it asks for anything. Another task may be past that.
        let connecting = self.connecting().clone();
        if let Some(line) = connecting {
            // Its failure is that of the connection.
            line.stop().await.ok();
        }
        let stage = self.connect().await?;
        // Another task may have connected and started a motion.
        stage.stop().await
    }

    /// Ends a stop that stands: the daemon ends.
    pub fn end_standing_stop(&self) {
        self.inner.motions_requested.fetch_add(1, Ordering::SeqCst);
    }

    /// As [`StageAccess::stop_what_may_move`], again and again until it succeeds, for about `limit` of real time.
    ///
    /// # Errors
    /// The last one.
    pub async fn stop_within(&self, limit: Duration) -> Result<(), StageError> {
        let began = Instant::now();
        loop {
            match self.stop_what_may_move().await {
                Err(_) if began.elapsed() < limit => tokio::time::sleep(STOP_AGAIN_AFTER).await,
                outcome => return outcome,
            }
        }
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
