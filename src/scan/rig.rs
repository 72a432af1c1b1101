//! The stages and the camera, as the one owner holds them.
//!
//! Whoever has the [`Rig`] may move and take frames; it cannot be had twice. Others only get its
//! [`Reach`], to ask where the stages are and to stop them.

use std::collections::BTreeSet;

use super::reach::{Reach, StageLink};
use crate::bench::stage::{Stage, StageError};
use crate::bench::{AxisName, Camera};

/// The stages and the camera of one rig.
pub struct Rig {
    reach: Reach,
    /// Takes the frames.
    pub camera: Box<dyn Camera>,
}

impl Rig {
    /// A rig that is not connected yet.
    #[must_use]
    pub fn new(link: StageLink, camera: Box<dyn Camera>) -> Self {
        Rig {
            reach: Reach::new(link),
            camera,
        }
    }

    /// How the stages are reached.
    #[must_use]
    pub fn link(&self) -> &StageLink {
        self.reach.link()
    }

    /// The way to the stages, for those who only look or stop.
    #[must_use]
    pub fn reach(&self) -> &Reach {
        &self.reach
    }

    /// The connected stage; connects if there is none.
    ///
    /// # Errors
    /// Why the port or the controller cannot be had.
    pub async fn connect(&mut self) -> Result<Stage, StageError> {
        self.reach.connect().await
    }

    /// A stage that answers and knows its reference: connects, and homes what has none and what is `doubted`. Drivers
    /// that are off are switched on, and parked axes unparked, only where a person has just asked for motion
    /// (`by_a_person`).
    ///
    /// # Errors
    /// What connecting or homing says; a lost link is let go, so that the next call connects anew.
    /// [`StageError::Stopped`], and nothing is homed, after a stop since it was called.
    pub async fn make_ready(
        &mut self,
        doubted: &BTreeSet<AxisName>,
        by_a_person: bool,
    ) -> Result<Stage, StageError> {
        let asked_after = self.reach.stops();
        let stage = self.connect().await?;
        // Taken first: a stop from here on overtakes the homing, one before shows in the count.
        let stops_of_stage = stage.stops();
        let ready = async {
            if self.reach.stops() != asked_after {
                return Err(StageError::Stopped);
            }
            if by_a_person {
                for axis in AxisName::ALL {
                    stage.release(axis).await?;
                }
            }
            if !stage.status().await?.all_homed() {
                return stage.home_all_since(stops_of_stage).await;
            }
            for axis in doubted {
                stage.home_since(*axis, stops_of_stage).await?;
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
            self.reach.let_go();
        }
    }
}
