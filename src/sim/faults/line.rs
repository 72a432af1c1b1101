//! Applies the faults of a line to its bytes.

use std::collections::VecDeque;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use super::{FaultSource, LineFault};
use crate::bench::port::{Port, PortAddress, PortError, PortSeam};
use crate::bench::wire::zaber::{Activity, MessageBody, Reply, decode_command, decode_message};

/// The faults of one line, as state between a command and its reply.
#[derive(Debug)]
pub struct FaultyLine {
    source: Arc<dyn FaultSource>,
    pending: Option<LineFault>,
    partial: Vec<u8>,
    late: Vec<u8>,
    gone: bool,
}

impl FaultyLine {
    /// Makes a line whose faults come from `source`.
    #[must_use]
    pub fn new(source: Arc<dyn FaultSource>) -> Self {
        FaultyLine {
            source,
            pending: None,
            partial: Vec::new(),
            late: Vec::new(),
            gone: false,
        }
    }

    /// Whether the plug is out, or was pulled since the line was opened.
    fn is_gone(&mut self) -> bool {
        self.gone |= self.source.unplugged();
        self.gone
    }

    /// Takes a command from the host; returns the bytes that reach the device, and those that reach the host before the
    /// reply.
    pub fn command(&mut self, bytes: &[u8]) -> (Vec<u8>, Vec<u8>) {
        let text = String::from_utf8_lossy(bytes);
        self.pending = self.source.of_command(&text);
        let mut early = std::mem::take(&mut self.late);
        let mut to_device = bytes.to_vec();
        match self.pending {
            Some(LineFault::LoseCommand) => to_device.clear(),
            Some(LineFault::Refuse(ref code)) => {
                early.extend(refusal(bytes, code));
                to_device.clear();
            }
            Some(LineFault::GarbleCommand) => {
                let middle = to_device.len() / 2;
                to_device[middle] ^= 1;
            }
            _ => {}
        }
        (to_device, early)
    }

    /// Takes bytes from the device and returns those that reach the host.
    pub fn reply(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut out = Vec::new();
        for &byte in bytes {
            self.partial.push(byte);
            if byte == b'\n' {
                let line = std::mem::take(&mut self.partial);
                self.pass_on(line, &mut out);
            }
        }
        out
    }

    /// Passes on one whole line from the device, with its fault.
    fn pass_on(&mut self, mut line: Vec<u8>, out: &mut Vec<u8>) {
        match self.pending.take() {
            None | Some(LineFault::LoseCommand | LineFault::GarbleCommand) => {}
            Some(LineFault::LoseReply) => line.clear(),
            Some(LineFault::GarbleReply) => {
                let middle = line.len() / 2;
                line[middle] ^= 1;
            }
            Some(LineFault::DropByte) => {
                line.remove(line.len() / 2);
            }
            Some(LineFault::LateReply) => self.late.append(&mut line),
            Some(LineFault::DoubleReply) => line.extend_from_within(..),
            Some(LineFault::Before(bytes)) => out.extend(bytes),
            Some(LineFault::Says(word)) => {
                let last = line.iter().rposition(|byte| *byte == b' ');
                line.truncate(last.map_or(0, |space| space + 1));
                line.extend(word.as_bytes());
                line.extend(b"\r\n");
            }
            Some(LineFault::Claims(activity)) => line = claiming(activity, &line),
            // Its command was not passed on, so this is another line.
            Some(LineFault::Refuse(_)) => {}
            Some(LineFault::Unplug) => self.gone = true,
        }
        out.extend(line);
    }
}

/// The refusal of a command by its device.
fn refusal(command: &[u8], code: &str) -> Vec<u8> {
    let Ok(packet) = decode_command(command.trim_ascii_end()) else {
        return Vec::new();
    };
    let reply = Reply {
        address: packet.command.address,
        axis: packet.command.axis,
        id: packet.command.id,
        accepted: false,
        activity: Activity::Idle,
        flag: None,
        data: code.to_owned(),
    };
    reply.encode(packet.checked).unwrap_or_default()
}

/// The same reply with another activity.
fn claiming(activity: Activity, line: &[u8]) -> Vec<u8> {
    let decoded = decode_message(line.trim_ascii_end());
    match decoded.map(|message| (message.body, message.checked)) {
        Ok((MessageBody::Reply(reply), checked)) => {
            let reply = Reply { activity, ..reply };
            reply.encode(checked).unwrap_or_else(|_| line.to_owned())
        }
        _ => line.to_owned(),
    }
}

/// Ports with faults: the seam to pass when a port is opened.
#[derive(Clone)]
pub struct FaultySeam {
    beneath: Arc<dyn PortSeam>,
    source: Arc<dyn FaultSource>,
}

impl FaultySeam {
    /// Adds the faults of `source` to the ports that `beneath` opens.
    #[must_use]
    pub fn over(beneath: Arc<dyn PortSeam>, source: Arc<dyn FaultSource>) -> Self {
        FaultySeam { beneath, source }
    }
}

impl PortSeam for FaultySeam {
    fn open(&self, address: &PortAddress, baud: u32) -> Result<Box<dyn Port>, PortError> {
        if self.source.unplugged() {
            return Err(PortError::Missing {
                address: address.clone(),
                present: "no serial port is present".to_owned(),
            });
        }
        Ok(Box::new(FaultyPort {
            inner: self.beneath.open(address, baud)?,
            line: FaultyLine::new(Arc::clone(&self.source)),
            ready: VecDeque::new(),
        }))
    }
}

struct FaultyPort {
    inner: Box<dyn Port>,
    line: FaultyLine,
    ready: VecDeque<u8>,
}

impl FaultyPort {
    fn check_plug(&mut self) -> io::Result<()> {
        match self.line.is_gone() {
            false => Ok(()),
            true => Err(io::Error::new(
                io::ErrorKind::BrokenPipe,
                "the plug was pulled",
            )),
        }
    }
}

impl Port for FaultyPort {
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        self.check_plug()?;
        if self.ready.is_empty() {
            let mut bytes = [0; 512];
            let n = self.inner.read(&mut bytes, wait)?;
            self.ready.extend(self.line.reply(&bytes[..n]));
            self.check_plug()?;
        }
        let n = buffer.len().min(self.ready.len());
        for (place, byte) in buffer.iter_mut().zip(self.ready.drain(..n)) {
            *place = byte;
        }
        Ok(n)
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.check_plug()?;
        let (to_device, early) = self.line.command(bytes);
        self.ready.extend(early);
        // A fault of the stages may be due with this command, the pulled plug among them.
        self.check_plug()?;
        match to_device.is_empty() {
            true => Ok(()),
            false => self.inner.write(&to_device),
        }
    }

    fn now(&self) -> Duration {
        self.inner.now()
    }
}
