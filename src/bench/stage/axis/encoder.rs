//! Compares the encoder with the counter, on devices that have one: a slip raises no flag.

use super::super::error::StageError;
use super::{Axis, AxisReading};
use crate::bench::wire::zaber::Activity;
use crate::units::Angle;

/// Readings that must all show a slip: one in 256 garbled replies passes the checksum.
const READINGS: u32 = 3;
/// An encoder is trusted once it has followed a move of at least this many degrees.
const TRIAL_DEG: f64 = 1.0;
/// Share of that move by which it may differ: another unit differs by more, a slip by less.
const TRIAL_SHARE: f64 = 0.5;

/// What is known of an axis's encoder.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) enum Encoder {
    /// The device has none, or it does not count in the unit of the position.
    #[default]
    Absent,
    /// Encoder and counter when both were read first.
    Known {
        encoder: i64,
        counter: i64,
        /// Encoder less counter without a slip: as found after the homing. 0, as on devices that set both, for an axis that
        /// was homed before it was connected: what differs may be a slip.
        apart: i64,
        /// Whether it followed a long move.
        trusted: bool,
    },
}

impl Axis {
    async fn read_encoder(&self) -> Result<Option<i64>, StageError> {
        match self.get_finite("encoder.pos").await {
            Ok(counts) => Ok(Some(counts.round() as i64)),
            Err(StageError::Refused { .. } | StageError::Unreadable { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Reads encoder and counter of an axis whose homing was not awaited.
    pub(super) async fn meet_encoder(&self) -> Result<(), StageError> {
        self.read_both(Some(0)).await
    }

    /// Takes the present positions of encoder and counter as equal.
    pub(super) async fn reference_encoder(&self) -> Result<(), StageError> {
        self.read_both(None).await
    }

    async fn read_both(&self, apart: Option<i64>) -> Result<(), StageError> {
        let counter = self.read().await?.counts;
        let encoder = match self.read_encoder().await? {
            Some(encoder) => Encoder::Known {
                encoder,
                counter,
                apart: apart.unwrap_or(encoder - counter),
                trusted: false,
            },
            None => Encoder::Absent,
        };
        self.memory().encoder = encoder;
        Ok(())
    }

    /// Goes on comparing encoder and counter as the last connection did, if this is the same device and it kept its
    /// reference: a slip before or between the two would be taken as the device's own difference.
    pub fn carry_on(&self, last: &Axis) {
        let before = last.memory();
        let mut now = self.memory();
        let restarted = match (before.uptime, now.uptime) {
            (Some(before), Some(now)) => now < before,
            _ => false,
        };
        let same = last.identity.is_same_device(&self.identity);
        if same && before.referenced && now.referenced && !restarted {
            now.encoder = before.encoder;
        }
    }

    /// Encoder less counter without a slip; `None` without an encoder.
    pub(super) fn apart(&self) -> Option<i64> {
        match self.memory().encoder {
            Encoder::Known { apart, .. } => Some(apart),
            Encoder::Absent => None,
        }
    }

    /// Whether the device has an encoder, which shows slips.
    pub fn has_encoder(&self) -> bool {
        self.apart().is_some()
    }

    /// Returns how far encoder and counter have moved apart since the last reference; zero without
    /// an encoder.
    pub(super) async fn slip(&self) -> Result<Angle, StageError> {
        let Some(expected) = self.apart() else {
            return Ok(Angle::ZERO);
        };
        let mut least = f64::INFINITY;
        for _ in 0..READINGS {
            let Some(now) = self.read_encoder().await? else {
                return Ok(Angle::ZERO);
            };
            let at = self.read().await?;
            if at.activity == Activity::Busy {
                return Ok(Angle::ZERO);
            }
            let apart = (now - at.counts - expected) as f64;
            if apart.abs() < least.abs() {
                least = apart;
            }
            if !self.is_slip(least) {
                break;
            }
        }
        Ok(Angle::from_deg(least / self.counts_per_turn * 360.0))
    }

    pub(super) fn is_slip(&self, counts: f64) -> bool {
        let tolerance = self.settings.encoder_tolerance.deg() / 360.0 * self.counts_per_turn;
        counts.abs() > tolerance.max(1.0)
    }

    /// Checks after a move that the axis went where its counter says.
    ///
    /// # Errors
    /// [`StageError::Slipped`].
    pub(super) async fn check_encoder(&self, arrived: &AxisReading) -> Result<(), StageError> {
        let Encoder::Known {
            encoder,
            counter,
            trusted,
            ..
        } = self.memory().encoder
        else {
            return Ok(());
        };
        let moved = (arrived.counts - counter) as f64;
        if !trusted && moved.abs() >= TRIAL_DEG / 360.0 * self.counts_per_turn {
            let followed = self.read_encoder().await?.map(|now| (now - encoder) as f64);
            if followed.is_none_or(|followed| (followed / moved - 1.0).abs() > TRIAL_SHARE) {
                tracing::info!(
                    "{}: the encoder does not count in the unit of the position and is not compared with it",
                    self.name
                );
                self.memory().encoder = Encoder::Absent;
                return Ok(());
            }
            if let Encoder::Known { trusted, .. } = &mut self.memory().encoder {
                *trusted = true;
            }
        }
        self.check_slip().await
    }

    /// Checks an axis at rest for a slip since it was homed.
    ///
    /// # Errors
    /// [`StageError::Slipped`].
    pub async fn check_slip(&self) -> Result<(), StageError> {
        let slip = self.slip().await?;
        let counts = slip.deg() / 360.0 * self.counts_per_turn;
        if !self.is_slip(counts) {
            return Ok(());
        }
        self.memory().engaged = false;
        Err(StageError::Slipped {
            axis: self.name,
            slip,
        })
    }
}
