//! Homing an axis, and the steps that it had lost before.

use super::super::error::StageError;
use super::encoder::Encoder;
use super::{Axis, AxisReading, Motion};
use crate::bench::wire::zaber_flags::FlagClass;
use crate::units::Angle;

impl Axis {
    /// Moves to the reference position. If encoder and counter then differ otherwise than after the last homing, it homes
    /// again: a slip before the first reading of the encoder would be taken as the device's own difference, and does not
    /// repeat.
    pub async fn home(&self, stops: u64) -> Result<(), StageError> {
        let _turn = self.take_turn()?;
        let expected = self.apart().unwrap_or_default();
        self.seek_reference(stops).await?;
        if self
            .apart()
            .is_some_and(|apart| self.is_slip((apart - expected) as f64))
        {
            self.seek_reference(stops).await?;
        }
        Ok(())
    }

    async fn seek_reference(&self, stops: u64) -> Result<(), StageError> {
        self.memory().engaged = false;
        // Flags of an earlier failure would be attributed to this motion; lasting ones stay raised.
        self.ask("warnings clear").await?;
        self.restore_profile().await?;
        let has_hit_a_limit = self.memory().limit_hit_at.is_some();
        let slip = match has_hit_a_limit {
            true => Some(self.slip().await?),
            false => None,
        };
        self.start("home", None, stops).await?;
        let reading = self.await_idle(Motion::Homing, stops).await?;
        if reading.flag.is_some() {
            let axis = self.name;
            for flag in self.flags().await? {
                match flag.class() {
                    FlagClass::Interrupted => return Err(StageError::Interrupted { axis, flag }),
                    FlagClass::Fault | FlagClass::ReferenceLost => {
                        return Err(StageError::HomingFailed { axis, flag });
                    }
                    FlagClass::Informational => {}
                }
            }
        }
        {
            let mut memory = self.memory();
            memory.referenced = true;
            // A restart before this homing has no effect any more; one during it shows as WR.
            memory.uptime = None;
        }
        let hit_at = self.memory().limit_hit_at.take();
        if let (Some(hit_at), Some(slip)) = (hit_at, slip) {
            self.report_lost_steps(hit_at, slip, &reading);
        }
        self.reference_encoder().await?;
        self.check_uptime().await
    }

    /// Reports how many steps were lost at a limit sensor: by the encoder, or by the last count
    /// before the reference was set.
    fn report_lost_steps(&self, hit_at: Angle, slip: Angle, homed: &AxisReading) {
        let by_encoder = self.memory().encoder != Encoder::Absent;
        let (lost, by) = match (by_encoder, homed.last_moving) {
            (true, _) => (slip.abs(), "by the encoder"),
            (false, Some(last)) => {
                let counts = (last - homed.counts) as f64;
                let deg = (counts / self.counts_per_turn * 360.0).abs();
                let by = "by the last count before the reference, to about 0.1°";
                (Angle::from_deg(deg), by)
            }
            (false, None) => return,
        };
        let message = format!(
            "{axis} hit a limit sensor at {hit_at:.3} and was homed: it had lost {lost:.3} of steps ({by}). If this is more \
             than its tolerance, repeat the points before it, and check limits and load of the axis",
            axis = self.name,
        );
        self.notices.send("stage-lost-steps", message);
    }
}
