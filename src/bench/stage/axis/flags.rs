//! What the warning flags of an axis mean for its motions.

use tracing::warn;

use super::super::error::StageError;
use super::{Axis, AxisReading, SAME_PLACE_DEG};
use crate::bench::wire::zaber_flags::{Flag, FlagClass};
use crate::units::Angle;

impl Axis {
    /// Returns the error that the flags imply for the motion that just ended or is about to start.
    pub(super) async fn check_flags(&self, reading: &AxisReading) -> Result<(), StageError> {
        if reading.flag.is_none() {
            return Ok(());
        }
        let flags = self.flags().await?;
        let position = self.recorded(reading.counts);
        let axis = self.name;
        for flag in flags {
            match (flag.class(), flag) {
                (FlagClass::Fault, Flag::Stalled) => return Err(self.stalled(position)),
                (FlagClass::Fault, _) => {
                    if matches!(flag, Flag::UnexpectedLimit | Flag::LimitError) {
                        self.memory().limit_hit_at.get_or_insert(position);
                    }
                    return Err(StageError::Fault { axis, flag });
                }
                (FlagClass::ReferenceLost, _) => return Err(self.reference_lost()),
                (FlagClass::Interrupted, _) => return Err(StageError::Interrupted { axis, flag }),
                (FlagClass::Informational, _) => {}
            }
        }
        Ok(())
    }

    fn stalled(&self, position: Angle) -> StageError {
        let before = self.memory().stalled_at.replace(position);
        StageError::Stalled {
            axis: self.name,
            position,
            again: before.is_some_and(|b| (b - position).abs().deg() < SAME_PLACE_DEG),
        }
    }

    /// Checks that the axis has a reference position.
    pub async fn check_reference(&self) -> Result<(), StageError> {
        let reading = self.read().await?;
        self.check_before(&reading).await
    }

    /// The device shows that it has no reference. If it had one, it restarted.
    fn reference_lost(&self) -> StageError {
        let axis = self.name;
        let mut memory = self.memory();
        memory.engaged = false;
        memory.uptime = None;
        memory.profile_holds = false;
        match std::mem::take(&mut memory.referenced) {
            true => StageError::PowerCycled { axis },
            false => StageError::NotReferenced { axis },
        }
    }

    /// Clears the flag of a stall that the axis recovered from; returns whether it was raised. The
    /// next move then approaches from below again.
    pub(super) async fn clear_recovered_stall(
        &self,
        reading: &AxisReading,
    ) -> Result<bool, StageError> {
        if reading.flag.is_none() || !self.flags().await?.contains(&Flag::StallRecovered) {
            return Ok(false);
        }
        warn!(axis = %self.name, "{} stalled and recovered on the way; it approaches once more", self.name);
        self.ask("warnings clear").await?;
        self.memory().engaged = false;
        Ok(true)
    }

    /// Checks the flags before a move: interruptions of earlier motions are ignored, faults and a
    /// lost reference are not.
    pub(super) async fn check_before(&self, reading: &AxisReading) -> Result<(), StageError> {
        match self.check_flags(reading).await {
            Err(StageError::Interrupted { .. }) => {
                self.memory().engaged = false;
                Ok(())
            }
            // An axis that was pushed is sent to its target again, which also clears the flag.
            Ok(()) if reading.flag.is_some() && self.flags().await?.contains(&Flag::Displaced) => {
                self.memory().engaged = false;
                Ok(())
            }
            other => other,
        }
    }
}
