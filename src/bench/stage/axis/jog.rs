//! Steps of a jog: short absolute moves that are renewed, so that the axis stops by itself when they end.

use super::super::error::StageError;
use super::{Axis, AxisReading, Motion, SPEED_UNIT};
use crate::bench::line::LineError;
use crate::bench::wire::zaber::Activity;
use crate::bench::wire::zaber_flags::FlagClass;
use crate::units::Angle;

impl Axis {
    /// Checks that the axis may be jogged; returns where it is.
    pub async fn begin_jog(&self) -> Result<AxisReading, StageError> {
        let reading = self.read().await?;
        self.check_before(&reading).await?;
        self.verify_profile().await?;
        self.memory().engaged = false;
        Ok(reading)
    }

    /// Sends the axis on in one direction for at most `ahead_s`, never beyond `end`. Returns whether
    /// it is at the end.
    pub async fn jog_on(
        &self,
        speed_deg_s: f64,
        ahead_s: f64,
        end: Angle,
        stops: u64,
    ) -> Result<bool, StageError> {
        let reading = self.read().await?;
        self.check_stop(stops)?;
        self.check_jog_flags(&reading).await?;
        let here = self.recorded(reading.counts);
        let speed = speed_deg_s.abs().min(self.rates.speed_deg_s);
        let way = Angle::from_deg(speed * ahead_s);
        let upwards = speed_deg_s > 0.0;
        let left = if upwards { end - here } else { here - end };
        let way = if way < left { way } else { left };
        let target = if upwards { here + way } else { here - way };
        if left <= self.settings.tolerance {
            return Ok(reading.activity == Activity::Idle);
        }
        let data = (speed * self.counts_per_turn / 360.0 * SPEED_UNIT)
            .round()
            .max(1.0);
        let words = format!("move abs {} {data:.0}", self.counts(target));
        match self.line.command_once(&self.command(&words), stops).await {
            // A step that is lost or refused for a moment is replaced by the next one.
            Ok(reply) if super::is_passing(&reply) => Ok(false),
            Ok(reply) => self.accepted(&words, reply).map(|_| false),
            Err(LineError::NoReply { .. }) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    /// Stops the axis and returns where it came to rest.
    pub async fn end_jog(&self, stops: u64) -> Result<Angle, StageError> {
        self.ask("stop").await?;
        let reading = self.await_idle(Motion::Stop, stops).await?;
        self.check_jog_flags(&reading).await?;
        self.memory().stopped_by_us = true;
        Ok(self.recorded(reading.counts))
    }

    /// As [`Axis::check_flags`], but each step of a jog interrupts the one before it.
    async fn check_jog_flags(&self, reading: &AxisReading) -> Result<(), StageError> {
        match reading.flag.map(|flag| flag.class()) {
            None | Some(FlagClass::Interrupted | FlagClass::Informational) => Ok(()),
            Some(FlagClass::Fault | FlagClass::ReferenceLost) => self.check_flags(reading).await,
        }
    }
}
