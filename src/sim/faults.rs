//! Faults put into a simulated rig: on the line to the stages, in the stages, the camera and the disk.
//!
//! A fault on the line is a [`LineFault`] of one exchange. [`FaultyLine`] applies it, on either side of the line. What
//! happens when comes from a [`FaultSource`]: [`ScriptedFaults`] for tests, or the [`injector::FaultInjector`] of a plan
//! that a user writes or a seed draws. [`FaultySeam`] is the seam to pass when a port is opened, [`camera::FaultyCamera`]
//! and [`disk::FaultyDisk`] wrap the other devices.

pub mod camera;
pub mod controller;
pub mod disk;
pub mod injector;
mod line;
pub mod plan;

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard};

use crate::bench::port::{NoFaults, Port, PortAddress, PortError, PortSeam};
use crate::bench::wire::zaber::Activity;
pub use line::{FaultyLine, FaultySeam};

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
    /// The command does not reach the device, and this reason of a refusal comes back.
    Refuse(String),
    /// The reply says that the axis moves, or does not, whatever it does.
    Claims(Activity),
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

/// Decides which exchange has a fault.
pub trait FaultSource: fmt::Debug + Send + Sync + 'static {
    /// The fault of the exchange that this command begins.
    fn of_command(&self, command: &str) -> Option<LineFault>;

    /// Whether the plug is out now.
    fn unplugged(&self) -> bool;
}

impl FaultSource for ScriptedFaults {
    fn of_command(&self, command: &str) -> Option<LineFault> {
        let mut script = self.script();
        let rule = script
            .rules
            .iter_mut()
            .find(|rule| rule.times > 0 && command.contains(&rule.command_contains))?;
        rule.times -= 1;
        let fault = rule.fault.clone();
        script.happened += 1;
        Some(fault)
    }

    fn unplugged(&self) -> bool {
        self.script().unplugged
    }
}

impl PortSeam for ScriptedFaults {
    fn open(&self, address: &PortAddress, baud: u32) -> Result<Box<dyn Port>, PortError> {
        FaultySeam::over(Arc::new(NoFaults), Arc::new(self.clone())).open(address, baud)
    }
}
