//! Stages and camera, as their single owner holds them.
//!
//! The owner of the [`Rig`] moves the stages and takes frames; the type cannot be cloned. Everyone else gets its
//! [`StageAccess`], which reads positions and stops the stages.

use std::collections::BTreeSet;

use super::plan::TravelLimits;
use super::stage_access::StageAccess;
use crate::bench::stage::{Stage, StageError, StageLink};
use crate::bench::{AxisName, Camera};

/// The stages and the camera of one rig.
pub struct Rig {
    access: StageAccess,
    /// The camera.
    pub camera: Box<dyn Camera>,
}

impl Rig {
    /// Makes a rig that is not connected yet.
    #[must_use]
    pub fn new(link: StageLink, camera: Box<dyn Camera>) -> Self {
        Rig {
            access: StageAccess::new(link),
            camera,
        }
    }

    /// Returns the address and settings of the stages.
    #[must_use]
    pub fn link(&self) -> &StageLink {
        self.access.link()
    }

    /// Returns where the axes may go.
    #[must_use]
    pub fn limits(&self) -> TravelLimits {
        let settings = &self.link().settings;
        TravelLimits {
            theta_c: (settings.theta_c.limit_min, settings.theta_c.limit_max),
            phi_s: (settings.phi_s.limit_min, settings.phi_s.limit_max),
        }
    }

    /// Returns the access that reads positions and stops the stages.
    #[must_use]
    pub fn access(&self) -> &StageAccess {
        &self.access
    }

    /// Returns the connected stage; connects first if necessary.
    ///
    /// # Errors
    /// [`StageError`] where port or controller cannot be opened.
    pub async fn connect(&mut self) -> Result<Stage, StageError> {
        self.access.connect().await
    }

    /// Returns a stage that answers and has its reference: connects, then homes axes without a reference and axes that are
    /// `doubted`. Drivers are switched on and parked axes unparked only if a user has just requested motion (`by_a_person`).
    /// Axes that lost their reference are homed only then, or if `may_home`: power that returns starts no motion by itself.
    ///
    /// # Errors
    /// [`StageError`] of connecting or homing; [`StageError::PowerCycled`] if an axis lost its reference and must not be
    /// homed. A lost link is dropped, so that the next call connects again. After a stop
    /// since the call: [`StageError::Stopped`], and no axis is homed.
    pub async fn make_ready(
        &mut self,
        doubted: &BTreeSet<AxisName>,
        by_a_person: bool,
        may_home: bool,
    ) -> Result<Stage, StageError> {
        let asked_after = self.access.stops();
        let stage = self.connect().await?;
        // Read first: a later stop interrupts the homing, an earlier one shows in the count.
        let stops_of_stage = stage.stops();
        let ready = async {
            if self.access.stops() != asked_after {
                return Err(StageError::Stopped);
            }
            if by_a_person {
                for axis in AxisName::ALL {
                    stage.release(axis).await?;
                }
            }
            let status = stage.status().await?;
            let unhomed = AxisName::ALL
                .into_iter()
                .find(|axis| !status.axis(*axis).homed);
            if let Some(axis) = unhomed
                && !(by_a_person || may_home)
            {
                return Err(StageError::PowerCycled { axis });
            }
            if unhomed.is_some() || doubted.len() == AxisName::ALL.len() {
                stage.home_all_since(stops_of_stage).await?;
                self.access.set_may_have_slipped(false);
                return Ok(());
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

    /// Drops the stage: what it did meanwhile is unknown. The next connection stops all motion first.
    pub fn let_go(&self) {
        self.access.let_go();
    }

    /// Drops the stage if the error says that the link is lost.
    pub fn let_go_if_lost(&self, error: &StageError) {
        if error.is_disconnect() {
            self.access.let_go();
        }
    }
}
