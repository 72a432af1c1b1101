//! The stages and the camera, as the one owner holds them.
//!
//! Whoever has the [`Rig`] may move and take frames; it cannot be had twice. Others only get a
//! clone of the connected [`Stage`] by [`Rig::watch`], to ask where it is and to stop it.

use std::sync::Arc;

use tokio::sync::watch;

use crate::bench::Camera;
use crate::bench::port::PortSeam;
use crate::bench::stage::{PortAddress, Stage, StageError, StageSettings};
use crate::clock::Clock;

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

/// The stages and the camera of one rig.
pub struct Rig {
    link: StageLink,
    stage: watch::Sender<Option<Stage>>,
    /// Takes the frames.
    pub camera: Box<dyn Camera>,
}

impl Rig {
    /// A rig that is not connected yet.
    #[must_use]
    pub fn new(link: StageLink, camera: Box<dyn Camera>) -> Self {
        Rig {
            link,
            stage: watch::Sender::new(None),
            camera,
        }
    }

    /// How the stages are reached.
    #[must_use]
    pub fn link(&self) -> &StageLink {
        &self.link
    }

    /// The connected stage, for those who only look or stop.
    #[must_use]
    pub fn watch(&self) -> watch::Receiver<Option<Stage>> {
        self.stage.subscribe()
    }

    /// The connected stage; connects if there is none.
    ///
    /// # Errors
    /// Why the port or the controller cannot be had.
    pub async fn connect(&mut self) -> Result<Stage, StageError> {
        if let Some(stage) = self.stage.borrow().clone() {
            return Ok(stage);
        }
        let StageLink {
            port,
            settings,
            clock,
            seam,
        } = self.link.clone();
        let stage = Stage::connect(port, settings, clock, seam).await?;
        self.stage.send_replace(Some(stage.clone()));
        Ok(stage)
    }

    /// A stage that answers and knows its reference: connects and homes as needed.
    ///
    /// # Errors
    /// What connecting or homing says; a lost link is let go, so that the next call connects anew.
    pub async fn make_ready(&mut self) -> Result<Stage, StageError> {
        let stage = self.connect().await?;
        let ready = async {
            if !stage.status().await?.all_homed() {
                stage.home_all().await?;
            }
            Ok(())
        };
        match ready.await {
            Ok(()) => Ok(stage),
            Err(error) => {
                self.let_go_if_lost(&error);
                Err(error)
            }
        }
    }

    /// Forgets the stage if the error says that the link is gone.
    pub fn let_go_if_lost(&self, error: &StageError) {
        if error.is_disconnect() {
            self.stage.send_replace(None);
        }
    }
}
