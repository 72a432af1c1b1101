//! The commands of an axis that may be repeated: queries of its position, flags and settings.

use super::super::error::{StageError, refusal_meaning};
use super::{Axis, AxisReading, PASSING_WAIT, is_passing};
use crate::bench::wire::zaber::{DeviceCommand, Reply, decode_warnings};
use crate::bench::wire::zaber_flags::Flag;

impl Axis {
    pub(super) fn command(&self, words: &str) -> DeviceCommand {
        DeviceCommand::new(self.settings.address, self.settings.axis, words)
    }

    /// Sends the axis a command that may be repeated.
    pub(super) async fn ask(&self, words: &str) -> Result<Reply, StageError> {
        self.ask_patiently(self.command(words)).await
    }

    /// Asks again while the device refuses for a moment, at most for the time of a stop.
    async fn ask_patiently(&self, command: DeviceCommand) -> Result<Reply, StageError> {
        let until = self.clock.now() + self.stopping_time();
        loop {
            let reply = self.line.ask(&command).await?;
            if !is_passing(&reply) || self.clock.now() >= until {
                return self.accepted(&command.words, reply);
            }
            self.clock.sleep(PASSING_WAIT).await;
        }
    }

    /// Sends a command to the controller of the axis, which may have other axes.
    pub async fn ask_controller(&self, words: &str) -> Result<Reply, StageError> {
        let command = DeviceCommand::new(self.settings.address, 0, words);
        self.ask_patiently(command).await
    }

    pub(super) fn accepted(&self, words: &str, reply: Reply) -> Result<Reply, StageError> {
        if reply.accepted {
            return Ok(reply);
        }
        Err(StageError::Refused {
            axis: self.name,
            command: words.to_owned(),
            meaning: refusal_meaning(&reply.data),
            code: reply.data,
        })
    }

    /// Reads a numeric setting of the controller.
    pub(super) async fn get_number<N: std::str::FromStr>(
        &self,
        name: &str,
    ) -> Result<N, StageError> {
        let command = format!("get {name}");
        let reply = self.ask_controller(&command).await?;
        self.number(&command, &reply.data)
    }

    /// Reads a finite numeric setting of the axis; the parser would accept `inf` and `nan`.
    pub(super) async fn get_finite(&self, name: &str) -> Result<f64, StageError> {
        let command = format!("get {name}");
        let reply = self.ask(&command).await?;
        let value: f64 = self.number(&command, &reply.data)?;
        match value.is_finite() {
            true => Ok(value),
            false => Err(self.unreadable(&command, reply.data)),
        }
    }

    fn number<N: std::str::FromStr>(&self, command: &str, data: &str) -> Result<N, StageError> {
        data.trim()
            .parse()
            .map_err(|_| self.unreadable(command, data.to_owned()))
    }

    fn unreadable(&self, command: &str, answer: String) -> StageError {
        StageError::Unreadable {
            axis: self.name,
            command: command.to_owned(),
            answer,
        }
    }

    /// Reads position, activity and highest flag in one exchange.
    pub async fn read(&self) -> Result<AxisReading, StageError> {
        let reply = self.ask("get pos").await?;
        Ok(AxisReading {
            counts: self.number("get pos", &reply.data)?,
            activity: reply.activity,
            flag: reply.flag,
            last_moving: None,
        })
    }

    /// Reads all raised flags.
    pub async fn flags(&self) -> Result<Vec<Flag>, StageError> {
        let reply = self.ask("warnings").await?;
        decode_warnings(&reply.data).map_err(|_| self.unreadable("warnings", reply.data))
    }

    /// Detects a restart of the device: its uptime is shorter than before.
    pub(super) async fn check_uptime(&self) -> Result<(), StageError> {
        let uptime: u64 = match self.get_number("system.uptime").await {
            Ok(uptime) => uptime,
            // A device without an uptime counter still shows WR after a restart.
            Err(StageError::Refused { .. }) => return Ok(()),
            Err(error) => return Err(error),
        };
        let mut memory = self.memory();
        let before = memory.uptime.replace(uptime);
        if before.is_some_and(|before| uptime < before) {
            memory.referenced = false;
            memory.engaged = false;
            memory.profile_holds = false;
            return Err(StageError::PowerCycled { axis: self.name });
        }
        Ok(())
    }
}
