//! The chain of simulated controllers: bytes in, bytes out.
//!
//! Address 1 turns θc and address 2 φs, one axis each; or address 1 turns both, as its axes 1 and
//! 2. [`Controller::receive`] is the function to call; [`Controller::poll`] returns the alerts that
//! are due. Both depend only on their input and the world's clock. Knows no port.

use std::sync::Arc;

use super::device::settings::COMMAND_PACKETS_MAX;
use super::device::{CommandResult, Reject};
use super::unit::Unit;
use super::world::World;
use crate::bench::AxisName;
use crate::bench::wire::zaber::{
    Activity, Alert, DeviceCommand, Info, PACKET_BYTES_MAX, Reply, decode_command,
};
use crate::bench::wire::zaber_stream::{Assembled, CommandAssembler, LineSplitter};

/// What a server puts on a line: it takes bytes and returns bytes.
pub trait LineDevice: Send + 'static {
    /// Takes bytes from the host and returns the reply bytes, with the alerts that became due.
    fn receive(&mut self, bytes: &[u8]) -> Vec<u8>;
    /// Returns the alerts that are due.
    fn poll(&mut self) -> Vec<u8>;
    /// Whether an alert may become due without a byte from the host.
    fn may_alert(&self) -> bool;
    /// Drops an unfinished command of the previous client.
    fn new_client(&mut self);
}

impl LineDevice for Controller {
    fn receive(&mut self, bytes: &[u8]) -> Vec<u8> {
        Controller::receive(self, bytes)
    }

    fn poll(&mut self) -> Vec<u8> {
        Controller::poll(self)
    }

    fn may_alert(&self) -> bool {
        Controller::may_alert(self)
    }

    fn new_client(&mut self) {
        Controller::new_client(self);
    }
}

/// The controllers on one line.
#[derive(Debug)]
pub struct Controller {
    units: Vec<Unit>,
    lines: LineSplitter,
    assembler: CommandAssembler,
}

impl Controller {
    /// Makes the two controllers of a world, just powered up.
    #[must_use]
    pub fn new(world: &Arc<World>) -> Self {
        let units = AxisName::ALL.map(|axis| Unit::new(world, &[axis]));
        Controller::of(units.into())
    }

    /// Makes one controller with both axes.
    #[must_use]
    pub fn with_both_axes(world: &Arc<World>) -> Self {
        Controller::of(vec![Unit::new(world, &AxisName::ALL)])
    }

    fn of(units: Vec<Unit>) -> Self {
        Controller {
            units,
            lines: LineSplitter::of_commands(),
            assembler: CommandAssembler::default(),
        }
    }

    /// Takes bytes from the host and returns the reply bytes, with the alerts that became due.
    pub fn receive(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        for line in self.lines.push(bytes) {
            out.extend(self.poll());
            // A garbled command is neither executed nor answered.
            let Ok(packet) = decode_command(&line) else {
                continue;
            };
            let checked = packet.checked;
            // The line feed has been removed but counts for the length.
            let too_long = line.len() + 1 > PACKET_BYTES_MAX;
            match self.assembler.accept(packet, COMMAND_PACKETS_MAX) {
                Assembled::Pending if !too_long => {}
                Assembled::Whole(command) if !too_long => self.answer(&command, checked, &mut out),
                Assembled::Whole(command) | Assembled::BadSplit(command) => {
                    self.refuse(&command, checked, &mut out);
                }
                Assembled::Pending => self.assembler = CommandAssembler::default(),
            }
        }
        out
    }

    /// Returns the alerts that are due.
    pub fn poll(&mut self) -> Vec<u8> {
        let mut out = Vec::new();
        for unit in &mut self.units {
            for axis in unit.refresh() {
                if !unit.alerts() {
                    continue;
                }
                let alert = Alert {
                    address: unit.address(),
                    axis,
                    activity: Activity::Idle,
                    flag: unit.flag(axis),
                    data: String::new(),
                };
                let line = alert.encode(unit.checksum());
                out.extend(line.expect("an alert of its own holds nothing reserved"));
            }
        }
        out
    }

    /// Whether an alert may become due without a byte from the host.
    #[must_use]
    pub fn may_alert(&self) -> bool {
        let due = |unit: &Unit| unit.alerts() && unit.activity(0) == Activity::Busy;
        self.units.iter().any(due)
    }

    /// Drops an unfinished command of the previous client.
    pub fn new_client(&mut self) {
        self.lines.clear();
        self.assembler = CommandAssembler::default();
    }

    fn answer(&mut self, command: &DeviceCommand, checked: bool, out: &mut Vec<u8>) {
        let renumbered = renumbering(command);
        for (position, unit) in self.units.iter_mut().enumerate() {
            let addressed = command.address == 0 || command.address == unit.address();
            if !addressed || !unit.powered() {
                continue;
            }
            let answer = match renumbered {
                Some(Ok(first)) => {
                    let step = if command.address == 0 {
                        position as u8
                    } else {
                        0
                    };
                    unit.set_address(first + step);
                    Ok("0".to_owned()).into()
                }
                Some(Err(reject)) => Err(reject).into(),
                None => unit.execute(command.axis, &command.words),
            };
            unit.refresh();
            reply(unit, command, checked, answer, out);
        }
    }

    fn refuse(&mut self, command: &DeviceCommand, checked: bool, out: &mut Vec<u8>) {
        for unit in &self.units {
            let addressed = command.address == 0 || command.address == unit.address();
            if addressed && unit.powered() {
                reply(unit, command, checked, Err(Reject::BadSplit).into(), out);
            }
        }
    }
}

/// `renumber [N]`: the first new address, or the reason of a refusal. `None` for all other
/// commands.
fn renumbering(command: &DeviceCommand) -> Option<Result<u8, Reject>> {
    let rest = command.words.strip_prefix("renumber")?;
    if command.axis != 0 {
        return Some(Err(Reject::DeviceOnly));
    }
    let first = match rest.trim() {
        "" if command.address == 0 => 1,
        text => match text.parse() {
            Ok(first @ 1..=98) => first,
            _ => return Some(Err(Reject::BadData)),
        },
    };
    Some(Ok(first))
}

fn reply(
    unit: &Unit,
    command: &DeviceCommand,
    checked: bool,
    answer: CommandResult,
    out: &mut Vec<u8>,
) {
    // A host that sends checksums can also check them.
    let with_checksum = checked || unit.checksum();
    let (accepted, data) = match answer.data {
        Ok(data) => (true, data),
        Err(reject) => (false, reject.as_str().to_owned()),
    };
    let reply = Reply {
        address: unit.address(),
        axis: command.axis.min(9),
        id: command.id,
        accepted,
        activity: unit.activity(command.axis),
        flag: unit.flag(command.axis),
        data,
    };
    let bytes = reply.encode(with_checksum);
    out.extend(bytes.expect("data came in over the line, so it can go out"));
    for text in answer.infos {
        let info = Info {
            address: reply.address,
            axis: reply.axis,
            id: reply.id,
            text: text.to_owned(),
        };
        out.extend(
            info.encode(with_checksum)
                .expect("help holds nothing reserved"),
        );
    }
}

#[cfg(test)]
#[path = "controller_tests.rs"]
mod tests;
