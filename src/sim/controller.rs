//! The chain of two simulated controllers: bytes in, bytes out.
//!
//! Address 1 turns θc, address 2 φs, one axis each. [`Controller::receive`] is the one function to
//! call; [`Controller::poll`] gives the alerts that are due. Both are pure but for the world's
//! clock. Knows no port.

use std::sync::Arc;

use super::device::{Answer, Device, Reject};
use super::device_settings::COMMAND_PACKETS_MAX;
use super::world::World;
use crate::bench::AxisName;
use crate::bench::wire::zaber::{
    Activity, Alert, Command, Info, PACKET_BYTES_MAX, Reply, decode_command,
};
use crate::bench::wire::zaber_stream::{Assembled, CommandAssembler, Lines};

/// Two controllers on one line.
#[derive(Debug)]
pub struct Controller {
    devices: [Device; 2],
    lines: Lines,
    assembler: CommandAssembler,
}

impl Controller {
    /// The controllers of a world, just powered up.
    #[must_use]
    pub fn new(world: &Arc<World>) -> Self {
        Controller {
            devices: AxisName::ALL.map(|axis| Device::new(Arc::clone(world), axis)),
            lines: Lines::of_commands(),
            assembler: CommandAssembler::default(),
        }
    }

    /// Takes bytes from the host and gives what goes back, alerts that became due included.
    pub fn receive(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        for line in self.lines.push(bytes) {
            out.extend(self.poll());
            // A garbled command is not executed, and nobody answers it.
            let Ok(packet) = decode_command(&line) else {
                continue;
            };
            let checked = packet.checked;
            // The line feed is off, and it counts.
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

    /// Alerts that are due.
    pub fn poll(&mut self) -> Vec<u8> {
        let mut out = Vec::new();
        for device in &mut self.devices {
            let ended = device.refresh();
            if ended && device.settings.alert && device.powered() {
                let alert = Alert {
                    address: device.address(),
                    axis: 1,
                    activity: Activity::Idle,
                    flag: device.flag(),
                    data: String::new(),
                };
                let line = alert.encode(device.settings.checksum);
                out.extend(line.expect("an alert of its own holds nothing reserved"));
            }
        }
        out
    }

    /// Whether an alert may become due without a byte from the host.
    #[must_use]
    pub fn may_alert(&self) -> bool {
        let due = |d: &Device| d.settings.alert && d.activity() == Activity::Busy;
        self.devices.iter().any(due)
    }

    /// A new client is on the line: what the last one left unfinished is forgotten.
    pub fn new_client(&mut self) {
        self.lines.clear();
        self.assembler = CommandAssembler::default();
    }

    fn answer(&mut self, command: &Command, checked: bool, out: &mut Vec<u8>) {
        let renumbered = renumbering(command);
        for (position, device) in self.devices.iter_mut().enumerate() {
            let addressed = command.address == 0 || command.address == device.address();
            if !addressed || !device.powered() {
                continue;
            }
            let answer = match renumbered {
                Some(Ok(first)) => {
                    let step = if command.address == 0 {
                        position as u8
                    } else {
                        0
                    };
                    device.settings.address = first + step;
                    Ok("0".to_owned()).into()
                }
                Some(Err(reject)) => Err(reject).into(),
                None => device.execute(command.axis, &command.words),
            };
            device.refresh();
            reply(device, command, checked, answer, out);
        }
    }

    fn refuse(&mut self, command: &Command, checked: bool, out: &mut Vec<u8>) {
        for device in &self.devices {
            let addressed = command.address == 0 || command.address == device.address();
            if addressed && device.powered() {
                reply(device, command, checked, Err(Reject::BadSplit).into(), out);
            }
        }
    }
}

/// `renumber [N]`: the first new address, or why not. `None` for every other command.
fn renumbering(command: &Command) -> Option<Result<u8, Reject>> {
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

fn reply(device: &Device, command: &Command, checked: bool, answer: Answer, out: &mut Vec<u8>) {
    // A host that sends checksums can read them.
    let with_checksum = checked || device.settings.checksum;
    let (accepted, data) = match answer.data {
        Ok(data) => (true, data),
        Err(reject) => (false, reject.as_str().to_owned()),
    };
    let reply = Reply {
        address: device.address(),
        axis: command.axis.min(9),
        id: command.id,
        accepted,
        activity: device.activity(),
        flag: device.flag(),
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
