//! Faults on a line: bytes lost, garbled, late or duplicated, or the plug pulled.
//!
//! [`ScriptedFaults`] is the seam to pass when a port is opened. A rule names the command whose
//! reply is affected, so a test states what happens and does not depend on time.

use std::collections::VecDeque;
use std::io;
use std::sync::{Arc, Mutex, MutexGuard};
use std::time::Duration;

use crate::bench::port::{Port, PortSeam};

/// The fault of one exchange.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum LineFault {
    /// The command never reaches the device.
    LoseCommand,
    /// One bit of the command flips.
    GarbleCommand,
    /// The reply never reaches the host.
    LoseReply,
    /// One bit of the reply flips.
    GarbleReply,
    /// One byte of the reply is missing.
    DropByte,
    /// The reply comes only after the host's next command.
    LateReply,
    /// The reply comes twice.
    DoubleReply,
    /// These bytes precede the reply.
    Before(Vec<u8>),
    /// The reply's last word is replaced by this one, with a valid checksum.
    Says(String),
    /// The plug is pulled before the reply comes.
    Unplug,
}

#[derive(Debug)]
struct Rule {
    command_contains: String,
    fault: LineFault,
    times: u32,
}

#[derive(Debug, Default)]
struct Script {
    rules: Vec<Rule>,
    unplugged: bool,
    happened: u32,
}

/// Scripted faults; clones share one script.
#[derive(Debug, Clone, Default)]
pub struct ScriptedFaults {
    script: Arc<Mutex<Script>>,
}

impl ScriptedFaults {
    /// Makes a line without faults, until rules are added.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Applies `fault` to the next `times` exchanges whose command contains these words.
    pub fn on(&self, command_contains: &str, fault: LineFault, times: u32) {
        self.script().rules.push(Rule {
            command_contains: command_contains.to_owned(),
            fault,
            times,
        });
    }

    /// Pulls the plug: all ports opened so far fail permanently.
    pub fn unplug(&self) {
        self.script().unplugged = true;
    }

    /// Inserts the plug again: ports opened from now on work.
    pub fn plug_in(&self) {
        self.script().unplugged = false;
    }

    /// Number of faults so far.
    #[must_use]
    pub fn happened(&self) -> u32 {
        self.script().happened
    }

    fn script(&self) -> MutexGuard<'_, Script> {
        self.script.lock().expect("no holder of this lock panics")
    }
}

impl PortSeam for ScriptedFaults {
    fn wrap(&self, port: Box<dyn Port>) -> Box<dyn Port> {
        Box::new(FaultyPort {
            inner: port,
            faults: self.clone(),
            pending: None,
            partial: Vec::new(),
            ready: VecDeque::new(),
            late: Vec::new(),
            gone: false,
        })
    }
}

struct FaultyPort {
    inner: Box<dyn Port>,
    faults: ScriptedFaults,
    pending: Option<LineFault>,
    partial: Vec<u8>,
    ready: VecDeque<u8>,
    late: Vec<u8>,
    gone: bool,
}

impl FaultyPort {
    fn check_plug(&mut self) -> io::Result<()> {
        self.gone |= self.faults.script().unplugged;
        if self.gone {
            return Err(io::Error::new(
                io::ErrorKind::BrokenPipe,
                "the plug was pulled",
            ));
        }
        Ok(())
    }

    /// Passes on one whole line from the device, with its fault.
    fn pass_on(&mut self, mut line: Vec<u8>) {
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
            Some(LineFault::Before(bytes)) => self.ready.extend(bytes),
            Some(LineFault::Says(word)) => {
                let last = line.iter().rposition(|byte| *byte == b' ');
                line.truncate(last.map_or(0, |space| space + 1));
                line.extend(word.as_bytes());
                line.extend(b"\r\n");
            }
            Some(LineFault::Unplug) => self.gone = true,
        }
        self.ready.extend(line);
    }
}

impl Port for FaultyPort {
    fn read(&mut self, buffer: &mut [u8], wait: Duration) -> io::Result<usize> {
        self.check_plug()?;
        if self.ready.is_empty() {
            let mut bytes = [0; 512];
            let n = self.inner.read(&mut bytes, wait)?;
            for &byte in &bytes[..n] {
                self.partial.push(byte);
                if byte == b'\n' {
                    let line = std::mem::take(&mut self.partial);
                    self.pass_on(line);
                }
            }
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
        let text = String::from_utf8_lossy(bytes).into_owned();
        self.pending = None;
        {
            let mut script = self.faults.script();
            let rule = script
                .rules
                .iter_mut()
                .find(|rule| rule.times > 0 && text.contains(&rule.command_contains));
            if let Some(rule) = rule {
                rule.times -= 1;
                self.pending = Some(rule.fault.clone());
                script.happened += 1;
            }
        }
        self.ready.extend(self.late.drain(..));
        match self.pending {
            Some(LineFault::LoseCommand) => Ok(()),
            Some(LineFault::GarbleCommand) => {
                let mut garbled = bytes.to_vec();
                let middle = garbled.len() / 2;
                garbled[middle] ^= 1;
                self.inner.write(&garbled)
            }
            _ => self.inner.write(bytes),
        }
    }
}
