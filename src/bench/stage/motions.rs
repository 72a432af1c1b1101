//! Homing and moves of the stage: limits and forbidden regions are checked before each motion, and a failure of one axis
//! stops both.

use std::time::Duration;

use tracing::{debug, warn};

use super::Stage;
use super::error::StageError;
use super::regions::MoveOrder;
use crate::bench::AxisName;
use crate::geometry::Pose;
use crate::units::Angle;

impl Stage {
    /// Homes an axis. It moves to the end of its travel. Beside forbidden regions the other axis
    /// first moves to its safe angle, if it is not free of them.
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
        let outcome = async {
            self.clear_the_way_home(axis, stops).await?;
            self.axis(axis).home(stops).await
        };
        let outcome = outcome.await;
        self.or_stop(outcome).await
    }

    /// Homes both axes, in the order of the settings.
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
        if let Some(sequence) = self.inner.settings.homing.sequence() {
            for axis in sequence {
                self.home_since(axis, stops).await?;
            }
            return Ok(());
        }
        let (tilt, turn) = (&self.inner.theta_c, &self.inner.phi_s);
        let outcome = futures::try_join!(tilt.home(stops), turn.home(stops)).map(|_| ());
        self.or_stop(outcome).await
    }

    /// Makes sure that the other axis is where this one can be homed.
    async fn clear_the_way_home(&self, axis: AxisName, stops: u64) -> Result<(), StageError> {
        let settings = &self.inner.settings;
        let Some([first, second]) = settings.homing.sequence() else {
            return Ok(());
        };
        if settings.forbidden.is_empty() {
            return Ok(());
        }
        let other = if axis == first { second } else { first };
        let status = self.status().await?;
        if !status.axis(other).homed {
            // The settings state that the first axis may home wherever the other one is.
            return match axis == first {
                true => Ok(()),
                false => Err(StageError::HomingOrder { axis, first }),
            };
        }
        let at = status.axis(other).position;
        let Some(region) = settings.region_across(other, at) else {
            return Ok(());
        };
        let Some(safe_deg) = settings.homing.safe_deg(other) else {
            return Err(StageError::HomingBlocked {
                axis,
                other,
                region: Box::new(region.clone()),
            });
        };
        let safe = Angle::from_deg(safe_deg);
        match status.axis(axis).homed {
            true => settings.check_way(status.pose(), with_axis(status.pose(), other, safe))?,
            false => settings.check_lone_way(other, at, safe)?,
        }
        self.axis(other).move_to(safe, stops).await.map(|_| ())
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
        self.check_move(axis, target).await?;
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

    /// Checks a move of one axis against its limits and the forbidden regions; the other axis stays
    /// where it is.
    ///
    /// # Errors
    /// [`StageError::OutsideLimits`], [`StageError::Forbidden`], or a device that does not answer.
    pub async fn check_move(&self, axis: AxisName, target: Angle) -> Result<(), StageError> {
        let settings = &self.inner.settings;
        settings.check_limit(axis, target)?;
        if settings.forbidden.is_empty() {
            return Ok(());
        }
        let status = self.status().await?;
        let other = match axis {
            AxisName::ThetaC => AxisName::PhiS,
            AxisName::PhiS => AxisName::ThetaC,
        };
        if !status.axis(other).homed {
            let from = status.axis(axis).position;
            return settings.check_lone_way(axis, from, target);
        }
        let from = status.pose();
        let mut engaged = [true, true];
        engaged[usize::from(axis == AxisName::PhiS)] = self.axis(axis).engaged();
        settings
            .move_order(from, with_axis(from, axis, target), engaged)
            .map(|_| ())
    }

    /// Moves both axes, waits for them to settle, and returns the pose read back. They move
    /// concurrently, or one after the other where only this is free of forbidden regions.
    ///
    /// # Errors
    /// [`StageError`]; both axes have then been stopped as far as they can be reached.
    pub async fn move_pose(&self, target: Pose) -> Result<Pose, StageError> {
        self.move_pose_since(target, self.stops()).await
    }

    /// Checks a move of both axes against the limits and the forbidden regions.
    ///
    /// # Errors
    /// [`StageError::OutsideLimits`], [`StageError::Forbidden`], or a device that does not answer.
    pub async fn check_move_pose(&self, target: Pose) -> Result<(), StageError> {
        self.inner.settings.check_limits(target)?;
        self.order_to(target).await.map(|_| ())
    }

    /// As [`Stage::move_pose`], unless there has been a stop since [`Stage::stops`] returned `stops`.
    ///
    /// # Errors
    /// As [`Stage::move_pose`]; [`StageError::Stopped`] if there was a stop.
    pub async fn move_pose_since(&self, target: Pose, stops: u64) -> Result<Pose, StageError> {
        self.inner.settings.check_limits(target)?;
        let order = self.order_to(target).await?;
        let (tilt, turn) = (&self.inner.theta_c, &self.inner.phi_s);
        let outcome = async {
            let tilted = tilt.move_to(target.theta_c, stops);
            let turned = turn.move_to(target.phi_s, stops);
            let ((theta_c, tilted), (phi_s, turned)) = match order {
                MoveOrder::Together => futures::try_join!(tilted, turned)?,
                MoveOrder::ThetaCFirst => (tilted.await?, turned.await?),
                MoveOrder::PhiSFirst => {
                    let turned = turned.await?;
                    (tilted.await?, turned)
                }
            };
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

    /// Returns the order in which the axes may move from where they are.
    async fn order_to(&self, target: Pose) -> Result<MoveOrder, StageError> {
        let settings = &self.inner.settings;
        if settings.forbidden.is_empty() {
            return Ok(MoveOrder::Together);
        }
        let status = self.status().await?;
        for axis in AxisName::ALL {
            if !status.axis(axis).homed {
                // The position is unknown; the move itself would report a restart.
                self.axis(axis).check_reference().await?;
            }
        }
        let engaged = [self.inner.theta_c.engaged(), self.inner.phi_s.engaged()];
        settings.move_order(status.pose(), target, engaged)
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

    /// If an operation on one axis fails, stops the other axis too.
    pub(super) async fn or_stop<T>(&self, outcome: Result<T, StageError>) -> Result<T, StageError> {
        // Two devices at one address explain most other errors.
        let outcome = match (self.inner.watch.check(&self.inner.line), outcome) {
            (Ok(()), outcome) => outcome,
            (Err(conflict), _) => Err(conflict),
        };
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
}

/// A pose with one axis elsewhere.
fn with_axis(mut pose: Pose, axis: AxisName, angle: Angle) -> Pose {
    match axis {
        AxisName::ThetaC => pose.theta_c = angle,
        AxisName::PhiS => pose.phi_s = angle,
    }
    pose
}
